"""`Classes`: the road users that count for an objective, their weights, and how their figures
become one.

The figure of a sensor set is the weighted mean of its classes' figures,

    AP = Σ_c w_c · AP_c / Σ_c w_c                 combine "mean"
    AP = min_c AP_c                               combine "worst": max-min, no class is bought at
                                                  another's expense

over the classes that have any objects; recall is combined like AP. A detection counts from the
usual IoU of its class, or a given one. The usual IoU is the objective's for vehicles and heavy
vehicles, and `SMALL_IOU` for cyclists and pedestrians, whose boxes lose far more IoU by the same
few centimetres (as in KITTI and Waymo).
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np

from placement_env.checks import check_choice, check_iou
from toolkit.arrays import Float64
from toolkit.class_names import check_classes
from toolkit.frozen import set_fields
from toolkit.objects import CYCLIST, LABELS, PEDESTRIAN, VEHICLE, label_index
from toolkit.runtime.cache import make_key

Combine = Literal["mean", "worst"]
SMALL_CLASSES = (LABELS[CYCLIST], LABELS[PEDESTRIAN])
SMALL_IOU = 0.5


@dataclass(frozen=True)
class Classes:
    """Classes of road users that count. Raises ValueError if the fields do not fit.

    Attributes:
        names: Names from `toolkit.objects.LABELS`; sorted into its order.
        weights: Weight of each class, equal if empty; scaled to sum to 1.
        combine: "mean" for the weighted mean of the classes, "worst" for the lowest class.
        ious: IoU from which a detection of each class counts, None for the usual one.
    """

    names: tuple[str, ...] = (LABELS[VEHICLE],)
    weights: tuple[float, ...] = ()
    combine: Combine = "mean"
    ious: tuple[float | None, ...] = ()

    def __post_init__(self) -> None:
        """Check, complete and sort the fields. Raises ValueError if they do not fit."""
        names = tuple(self.names)
        weights = tuple(self.weights)
        ious = tuple(self.ious)
        if isinstance(self.names, str) or not names or len(set(names)) < len(names):
            raise ValueError(
                f"classes must be one or several different ones of {', '.join(LABELS)}, got "
                f"{self.names}"
            )
        check_classes(names)
        weights = weights or (1.0,) * len(names)
        if len(weights) != len(names) or not all(0 < weight < math.inf for weight in weights):
            rule = (
                f"there must be a weight above 0 for each of {', '.join(names)}, got {self.weights}"
            )
            raise ValueError(f"{rule}: leave out a class that does not count")
        check_choice("combine", self.combine, get_args(Combine))
        if self.combine == "worst" and len(set(weights)) > 1:
            raise ValueError(
                f"the worst class takes no weights, got {self.weights}: omit them, or combine by "
                "mean"
            )
        ious = ious or (None,) * len(names)
        if len(ious) != len(names):
            raise ValueError(
                f"there must be an IoU for each of {', '.join(names)}, got {self.ious}"
            )
        for name, iou in zip(names, ious, strict=True):
            if iou is not None:
                check_iou(iou)
            if iou is not None and name == LABELS[VEHICLE]:
                raise ValueError(
                    "the IoU of vehicles is that of the objective: give iou, and None here"
                )
        order = sorted(range(len(names)), key=lambda k: LABELS.index(names[k]))
        total = float(sum(weights))
        ordered = [ious[k] for k in order]
        set_fields(
            self,
            names=tuple(names[k] for k in order),
            weights=tuple(float(weights[k]) / total for k in order),
            ious=tuple(None if iou is None else float(iou) for iou in ordered),
        )

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def labels(self) -> tuple[int, ...]:
        """Numbers of the classes (indices in `LABELS`), ascending."""
        return tuple(label_index(name) for name in self.names)

    @property
    def origin(self) -> dict[str, object]:
        """Fields of the classes as JSON values for files of results."""
        return {
            "names": self.names,
            "weights": self.weights,
            "combine": self.combine,
            "ious": self.ious,
        }

    @property
    def digest(self) -> str:
        """SHA-256 of everything that figures depend on."""
        return make_key(self.origin).hex()

    def get_iou(self, name: str, iou: float) -> float:
        """IoU from which a detection of a class counts.

        name: name of the class; iou: the objective's threshold, which vehicles always have."""
        class_iou = self.ious[self.names.index(name)]
        if class_iou is not None:
            return class_iou
        return SMALL_IOU if name in SMALL_CLASSES else iou

    def described(self, iou: float | tuple[float, ...] | None = None) -> str:
        """Description of the classes in words: "mean of 0.75 vehicle and 0.25 cyclist (IoU 0.5)".

        iou: threshold of the objective; a class with a different one is named with it. None names
        no IoU.
        """
        texts = list(self.names)
        if iou is not None:
            # 0 in place of the objective's IoU, so that only fixed ones differ from it
            class_ious = [self.get_iou(name, 0.0) for name in texts]
            texts = [
                name if class_iou in (0.0, iou) else f"{name} (IoU {class_iou:g})"
                for name, class_iou in zip(texts, class_ious, strict=True)
            ]
        if len(texts) == 1:
            return texts[0]
        if self.combine == "mean" and len(set(self.weights)) > 1:
            texts = [
                f"{weight:.2f} {text}" for weight, text in zip(self.weights, texts, strict=True)
            ]
        return f"{self.combine} of {join_names(texts)}"

    def combined(self, figures: Float64[np.ndarray, "n k"]) -> Float64[np.ndarray, " n"]:
        """Combine the figures of k classes to one figure for each of n sets.

        figures: NaN for a class without objects, which is left out; the result is NaN if all are.
        """
        if len(self) == 1:
            return figures[:, 0]
        is_defined = ~np.isnan(figures)
        if self.combine == "worst":
            worst = np.where(is_defined, figures, np.inf).min(axis=1)
            return np.where(is_defined.any(axis=1), worst, np.nan)
        weights = np.where(is_defined, self.weights, 0.0)
        weight_sums = weights.sum(axis=1)
        figure_sums = (np.where(is_defined, figures, 0.0) * weights).sum(axis=1)
        undefined = np.full(len(figures), np.nan)  # for sets without any weight
        return np.divide(figure_sums, weight_sums, out=undefined, where=weight_sums > 0)


def join_names(names: Sequence[str]) -> str:
    """Names as text: "a", "a and b", "a, b and c"; "none" without any."""
    if len(names) < 2:
        return names[0] if names else "none"
    return f"{', '.join(names[:-1])} and {names[-1]}"


def find_classes(classes: Classes | Iterable[str] | str) -> Classes:
    """Classes from `Classes`, which come back as they are, or from one or several names.

    Names get equal weights. Raises ValueError for anything else, or unknown names."""
    if isinstance(classes, Classes):
        return classes
    if not isinstance(classes, Iterable):
        raise ValueError(
            f"classes must be Classes or names of {', '.join(LABELS)}, got {classes!r}"
        )
    return Classes((classes,) if isinstance(classes, str) else tuple(classes))
