"""The mean over IoU thresholds, as in COCO: AP at 0.5, 0.55, ..., 0.95, of which none alone decides what is built."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import reduce
from operator import add
from typing import cast

import numpy as np

from placement_env.cases import COCO_STEP, IoUs
from placement_env.checks import check_iou
from placement_env.fidelity.combined.like import LikeFirst, LikeFirstByFrames
from placement_env.protocol import ByClass, ByFrames, ClassEstimates, Estimate, Fidelity
from toolkit.arrays import Bool


def iou_thresholds(iou: float | Iterable[float]) -> tuple[float, ...]:
    """One threshold, or several, ascending. Raises ValueError where one does not lie in (0, 1], or one comes twice.

    >>> iou_thresholds(0.7), iou_thresholds([0.9, 0.5])
    ((0.7,), (0.5, 0.9))
    """
    several = isinstance(iou, Iterable) and not isinstance(iou, str)
    found = tuple(sorted(iou)) if several else (iou,)  # type: ignore[arg-type]
    for each in found:
        check_iou(each)
    if not found or len(set(found)) < len(found):
        raise ValueError(f"IoU thresholds must be one or several different ones, got {iou!r}")
    return tuple(float(each) for each in found)  # type: ignore[arg-type]


def iou_range(text: str) -> tuple[float, ...]:
    """A threshold, or first:last in steps of 0.05, as --iou says. Raises ValueError where it is neither.

    >>> iou_range("0.7"), iou_range("0.85:0.95")
    ((0.7,), (0.85, 0.9, 0.95))
    """
    try:
        ends = [float(each) for each in text.split(":")]
    except ValueError:
        ends = []
    if len(ends) not in (1, 2) or not 0 < ends[0] <= ends[-1] <= 1:
        raise ValueError(f"--iou must lie above 0 and at most at 1, as 0.7 or 0.5:0.95, got {text}")
    if len(ends) == 1:
        return (ends[0],)
    return tuple(np.round(np.arange(ends[0], ends[1] + COCO_STEP / 2, COCO_STEP), 2).tolist())


def iou_text(iou: IoUs) -> str:
    """A threshold, or several, in words.

    >>> iou_text(0.7), iou_text((0.5, 0.55, 0.6))
    ('0.7', '0.5 to 0.6 (mean of 3 thresholds)')
    """
    if isinstance(iou, float | int):
        return f"{iou:g}"
    return f"{iou[0]:g} to {iou[-1]:g} (mean of {len(iou)} thresholds)"


class MeanFidelity(LikeFirst):
    """Sets scored by the mean of several fidelities, of one IoU threshold each; kbit are those of the first."""

    def __init__(self, fidelities: Sequence[Fidelity]) -> None:
        super().__init__(fidelities[0])
        self._fidelities = tuple(fidelities)

    def __call__(self, subsets: Bool[np.ndarray, "n C"], /) -> Estimate:
        """Mean AP and recall of each set."""
        return _mean([each(subsets) for each in self._fidelities])

    def by_class(self, subsets: Bool[np.ndarray, "n C"], /) -> ClassEstimates:
        """The same of each class."""
        found = [cast(ByClass, each).by_class(subsets) for each in self._fidelities]
        ap, recall = (reduce(add, (getattr(each, name) for each in found)) / len(found) for name in ("ap", "recall"))
        return ClassEstimates(ap, recall, found[0].kbit)


class MeanByFrames(MeanFidelity, LikeFirstByFrames):
    """The same of fidelities that score some frames alone."""

    def partial(self, subsets: Bool[np.ndarray, "n C"], frames: Sequence[int]) -> Estimate:
        """Mean figures of each set over these frames."""
        return _mean([cast(ByFrames, each).partial(subsets, frames) for each in self._fidelities])


def mean_of(fidelities: Sequence[Fidelity]) -> Fidelity:
    """The one fidelity, or the mean of several."""
    if len(fidelities) == 1:
        return fidelities[0]
    made = MeanByFrames if all(isinstance(each, ByFrames) for each in fidelities) else MeanFidelity
    return made(fidelities)


def _mean(found: Sequence[Estimate]) -> Estimate:
    ap, recall = (reduce(add, (getattr(each, name) for each in found)) / len(found) for name in ("ap", "recall"))
    return Estimate(ap, recall, found[0].kbit)
