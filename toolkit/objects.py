"""Objects and detections of one frame."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from toolkit.arrays import Bool, Float32, Shaped
from toolkit.display import Card, Displayed, Table, describe_count
from toolkit.frozen import set_fields

LABELS = ("vehicle", "cyclist", "pedestrian", "heavy")
VEHICLE, CYCLIST, PEDESTRIAN, HEAVY = range(4)
# expected error (m) of the front, rear, left, right and top of a box whose faces are not measured
USUAL_DOUBTS_M = (0.15, 0.15, 0.08, 0.08, 0.06)


def label_index(label: str | int) -> int:
    """Return the class number of a name or number in `LABELS`, or raise ValueError."""
    if isinstance(label, str) and label in LABELS:
        return LABELS.index(label)
    if (
        isinstance(label, int | np.integer | float)
        and label == np.trunc(label)
        and 0 <= int(label) < len(LABELS)
    ):
        return int(label)
    raise ValueError(
        f"label must be one of {LABELS} or its number 0..{len(LABELS) - 1}, got {label!r}"
    )


_Selected = TypeVar("_Selected", bound="_Rows")


class _Rows(Displayed):
    """Base of dataclasses whose fields are columns of one length, a row for each box."""

    boxes: Shaped[np.ndarray, "n 7"]
    labels: Shaped[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.boxes)

    def __getitem__(self: _Selected, rows: object) -> _Selected:
        """Return the rows at a mask, slice or index array."""
        columns = (None if column is None else column[rows] for column in vars(self).values())
        return type(self)(*columns)

    def _card(self) -> Card:
        """Return title, facts, table and picture of the boxes, for `repr` and notebooks."""
        counts = np.bincount(self.labels, minlength=len(LABELS))
        counts_by_class = tuple(
            f"{number} {label}" for label, number in zip(LABELS, counts, strict=True) if number
        )
        return Card(
            title=type(self).__name__,
            facts=(describe_count(len(self), "box", "boxes"), *counts_by_class),
            tables={"boxes": self._tabulate},
            drawing="toolkit.viewing.still:draw_boxes",
        )

    def _tabulate(self) -> Table:
        """Return a table with a row for each box: class, further fields, and the box's columns."""
        class_names = {"label": [LABELS[label] for label in self.labels]}
        # such as "id" of the field `ids`
        further_columns = {
            name.removesuffix("s"): column
            for name, column in vars(self).items()
            if name not in ("boxes", "labels", "doubts", "velocities")
        }
        box_column_names = ("x", "y", "z", "length", "width", "height", "yaw")
        box_columns = dict(zip(box_column_names, self.boxes.T, strict=True))
        return class_names | further_columns | box_columns


@dataclass(frozen=True)
class Objects(_Rows):
    """Ground truth of one frame.

    Attributes:
        boxes: (n, 7), see `toolkit.boxes`, kept as float64.
        labels: Class numbers or names of `LABELS`, kept as int64; all vehicles by default.
        ids: Track numbers, kept as int64; 0 to n - 1 by default.

    Raises:
        ValueError: Shapes or labels do not fit.

    >>> Objects(np.array([[0, 0, 1, 4, 2, 1.5, 0]]), np.array(["vehicle"])).labels
    array([0])
    """

    boxes: Shaped[np.ndarray, "n 7"]
    labels: Shaped[np.ndarray, " n"] = None  # type: ignore[assignment]  # None: all vehicles
    ids: Shaped[np.ndarray, " n"] = None  # type: ignore[assignment]  # None: 0..n-1

    def __post_init__(self) -> None:
        boxes = _parse_boxes(self.boxes)
        ids = np.arange(len(boxes)) if self.ids is None else np.asarray(self.ids, np.int64)
        labels = _parse_labels(self.labels, len(boxes))
        set_fields(self, boxes=boxes, labels=labels, ids=_check_column(ids, "ids", len(boxes)))

    @staticmethod
    def empty() -> "Objects":
        """No objects."""
        return Objects(np.zeros((0, 7)))


@dataclass(frozen=True)
class Detections(_Rows):
    """Detector output of one frame.

    Attributes:
        boxes: As in `Objects`.
        scores: (n,), kept as float64; higher is surer.
        labels: As in `Objects`.
        doubts: (n, 5), expected error (m, above 0) of the front, rear, left, right and top face of
            each box, kept as float64; None from a detector that does not estimate it.
    """

    boxes: Shaped[np.ndarray, "n 7"]
    scores: Shaped[np.ndarray, " n"]
    labels: Shaped[np.ndarray, " n"] = None  # type: ignore[assignment]  # None: all vehicles
    doubts: Shaped[np.ndarray, "n 5"] | None = None

    def __post_init__(self) -> None:
        """Turn the fields into checked arrays. Raises ValueError for wrong shapes and values.

        doubts: errors to expect of the front, rear, left, right and top faces (n, 5), m."""
        boxes = _parse_boxes(self.boxes)
        scores = _check_column(np.asarray(self.scores, np.float64), "scores", len(boxes))
        doubts = None if self.doubts is None else np.asarray(self.doubts, np.float64)
        if doubts is not None and (doubts.shape != (len(boxes), 5) or not (doubts > 0).all()):
            raise ValueError(
                f"doubts must have shape ({len(boxes)}, 5), front rear left right top, and be "
                f"above 0 m, got {doubts.shape} from {doubts.min(initial=np.inf):g}"
            )
        labels = _parse_labels(self.labels, len(boxes))
        set_fields(self, boxes=boxes, scores=scores, labels=labels, doubts=doubts)

    @staticmethod
    def empty() -> "Detections":
        """No detections."""
        return Detections(np.zeros((0, 7)), np.zeros(0))

    @staticmethod
    def merge(parts: "Iterable[Detections]") -> "Detections":
        """Merge several lists of detections, in order; doubts stay if all that detect have them."""
        merged = [Detections.empty(), *parts]
        doubts = [part.doubts for part in merged if len(part)]
        known_doubts = [rows for rows in doubts if rows is not None]
        return Detections(
            boxes=np.concatenate([part.boxes for part in merged]),
            scores=np.concatenate([part.scores for part in merged]),
            labels=np.concatenate([part.labels for part in merged]),
            doubts=np.concatenate(known_doubts) if len(known_doubts) == len(doubts) > 0 else None,
        )


@runtime_checkable
class Detector(Protocol):
    """Anything that turns the points of one frame into detections, both in the world frame.

    Optional attributes: `labels`, the names of the classes it knows, and `digest`, a text that
    changes whenever its detections may change.
    """

    def __call__(self, points: Float32[np.ndarray, "n 3"], /) -> Detections:
        """Detect."""


@runtime_checkable
class UnionDetector(Detector, Protocol):
    """Detector that is fast for many unions of the same clouds."""

    def unions(
        self,
        clouds: Sequence[Float32[np.ndarray, "_ 3"]],
        unions: Bool[np.ndarray, "unions clouds"],
    ) -> Sequence[Detections]:
        """Return the detections in each union of clouds.

        They equal the detections in the joined clouds, up to rounding.

        unions: a row for each, True for its clouds.
        """


def quick_detector(detector: Detector) -> Detector:
    """Return a faster and less exact version of a detector, for comparing sensor sets.

    That is what its method `quick` returns, or the detector itself if it has none.
    """
    quick = getattr(detector, "quick", None)
    return quick() if callable(quick) else detector


def known_labels(detector: Detector) -> tuple[str, ...] | None:
    """Return the classes that a detector's attribute `labels` names, in the order of `LABELS`.

    None if it has no such attribute. Raises ValueError for anything but names of `LABELS`.
    """
    labels = getattr(detector, "labels", None)
    if labels is None:
        return None
    if isinstance(labels, str) or not isinstance(labels, Iterable):
        raise ValueError(
            f"labels of a detector must be a list of names of {LABELS}, got {labels!r}"
        )
    numbers = sorted(set(map(label_index, labels)))
    return tuple(LABELS[k] for k in numbers)


def check_known(detector: Detector, labels: Iterable[str]) -> None:
    """Raise ValueError for classes that a detector does not know.

    A detector without a list of its classes passes."""
    detector_labels = known_labels(detector)
    if detector_labels is None:
        return
    unknown = [label for label in labels if label not in detector_labels]
    if unknown:
        remedy = (
            "take one trained on all of them, such as the weights tjunction, or leave these "
            "classes out"
        )
        raise ValueError(
            f"the detector knows {', '.join(detector_labels)} only, not "
            f"{', '.join(unknown)}: {remedy}"
        )


def _parse_boxes(boxes: ArrayLike) -> np.ndarray:
    """Return boxes (n, 7) as float64; an empty list counts as no boxes.

    Raises ValueError for another shape. The numbers are not checked."""
    boxes = np.asarray(boxes, np.float64)
    if boxes.size == 0 and boxes.ndim < 2:
        return np.zeros((0, 7))
    if boxes.ndim != 2 or boxes.shape[1] != 7:
        raise ValueError(
            f"boxes must have shape (n, 7): x y z length width height yaw, got {boxes.shape}"
        )
    return boxes


def _parse_labels(labels: ArrayLike | None, n: int) -> np.ndarray:
    """Return the class numbers of n boxes as int64, vehicles for None.

    labels: numbers, or names of `LABELS`. Raises ValueError for anything else."""
    if labels is None:
        return np.full(n, VEHICLE, np.int64)
    labels = np.asarray(labels)
    # numbers, then texts or objects that are texts
    if labels.dtype.kind not in "biufUO":
        raise ValueError(
            f"labels must be numbers or names of {LABELS}, got an array of {labels.dtype}"
        )
    if labels.dtype.kind in "UO":
        labels = np.array([label_index(name) for name in labels.ravel()], np.int64)
    if labels.dtype.kind == "f" and not (labels == np.trunc(labels)).all():
        raise ValueError(
            f"labels must be whole numbers 0..{len(LABELS) - 1} {LABELS}, got {labels.tolist()}"
        )
    labels = _check_column(labels.astype(np.int64), "labels", n)
    if n and (labels.min() < 0 or labels.max() >= len(LABELS)):
        raise ValueError(
            f"labels must be 0..{len(LABELS) - 1} {LABELS}, got {sorted(set(labels.tolist()))}"
        )
    return labels


def _check_column(column: Shaped[np.ndarray, "..."], name: str, n: int) -> np.ndarray:
    """Return a column with one entry for each of n boxes, or raise ValueError by its name."""
    if column.shape != (n,):
        raise ValueError(
            f"{name} must have one entry for each of the {n} boxes, got shape {column.shape}"
        )
    return column
