"""Road users at one instant, as detectors and trackers hand them to a writer."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from toolkit.arrays import Shaped
from toolkit.boxes import check_boxes
from toolkit.frame import SensorCloud
from toolkit.frozen import set_fields
from toolkit.geometry import MAX_COORDINATE_M
from toolkit.objects import Detections
from toolkit.tracking.tracks import Tracks

MAX_OBJECT_SPEED_M_S = 1e4  # no road user comes near


@dataclass(frozen=True, eq=False)
class Instant:
    """Detections or tracks of one instant.

    Attributes:
        time_s: Seconds, NaN if unknown.
        boxes: (n, 7), see `toolkit.boxes`, world frame.
        labels: Class numbers or names of `toolkit.objects.LABELS`, kept as int64.
        scores: (n,), higher is surer.
        ids: (n,) track numbers, None for detections that nobody tracked.
        velocities: (n, 3) m/s in the world frame, None or NaN if unknown.
        clouds: Clouds of the instant, for writers that take points.
        ages: (n,) seconds since the first detection of each track, None if unknown.

    Raises:
        ValueError: Lengths do not fit, a box, score or age is not finite, a box has no size or is
            as far as no map reaches, a velocity is infinite or beyond `MAX_OBJECT_SPEED_M_S`, or an
            id is negative or there twice.

    >>> car = np.array([[0, 0, 1, 4, 2, 1.5, 0]])
    >>> vehicle = np.array(["vehicle"])
    >>> Instant(0.1, car, vehicle, np.array([0.9]), ids=np.array([7])).ids
    array([7])
    >>> Instant(0.1, car, vehicle, np.array([np.nan]))
    Traceback (most recent call last):
    ValueError: scores must be finite, got [nan]: leave such objects out
    """

    time_s: float
    boxes: Shaped[np.ndarray, "n 7"]
    labels: Shaped[np.ndarray, " n"]
    scores: Shaped[np.ndarray, " n"]
    ids: Shaped[np.ndarray, " n"] | None = None
    velocities: Shaped[np.ndarray, "n 3"] | None = None
    clouds: Sequence[SensorCloud] = ()
    ages: Shaped[np.ndarray, " n"] | None = None

    def __post_init__(self) -> None:
        """Check all fields, and replace them by arrays of the stated types and shapes."""
        detections = Detections(check_boxes(self.boxes), self.scores, self.labels)
        count = len(detections)
        # x, y, z, length, width and height
        if not (np.abs(detections.boxes[:, :6]) <= MAX_COORDINATE_M).all():
            raise ValueError(
                f"boxes must lie within {MAX_COORDINATE_M:g} m of the origin, got "
                f"{np.abs(detections.boxes[:, :6]).max():g}: give metres"
            )
        if not np.isfinite(detections.scores).all():
            raise ValueError(
                f"scores must be finite, got {_first_not_finite(detections.scores)}: leave such "
                "objects out"
            )
        set_fields(
            self,
            time_s=float(self.time_s),
            boxes=detections.boxes,
            labels=detections.labels,
            scores=detections.scores,
            ids=None if self.ids is None else _check_ids(self.ids, count),
            velocities=None
            if self.velocities is None
            else _check_velocities(self.velocities, count),
            ages=None if self.ages is None else _check_ages(self.ages, count),
        )

    def __len__(self) -> int:
        return len(self.boxes)

    @staticmethod
    def from_detections(
        time_s: float, detections: Detections, clouds: Sequence[SensorCloud] = ()
    ) -> "Instant":
        """Return detections without ids and velocities as an instant."""
        return Instant(
            time_s, detections.boxes, detections.labels, detections.scores, clouds=clouds
        )

    @staticmethod
    def from_tracks(time_s: float, tracks: Tracks, clouds: Sequence[SensorCloud] = ()) -> "Instant":
        """Return tracks as an instant, with their ids, velocities and ages."""
        return Instant(
            time_s,
            tracks.boxes,
            tracks.labels,
            tracks.scores,
            ids=tracks.ids,
            velocities=tracks.velocities,
            clouds=clouds,
            ages=tracks.ages,
        )

    def list_ids(self) -> list[int]:
        """List the track number of each row. Raises ValueError for detections without ids."""
        if self.ids is None:
            raise ValueError("the detections have no ids: write them through open_writer")
        return [int(number) for number in self.ids]

    def known_velocities(self) -> list[tuple[float, float, float] | None]:
        """List the velocity of each row (m/s), None if it is unknown."""
        if self.velocities is None:
            return [None] * len(self)
        rows = [tuple(row) for row in self.velocities.tolist()]
        is_known = np.isfinite(self.velocities).all(axis=1).tolist()
        return [row if known else None for row, known in zip(rows, is_known, strict=True)]


def _check_ids(ids: ArrayLike, count: int) -> np.ndarray:
    """Return track numbers as int64.

    count: number of boxes. Raises ValueError for ids that are no whole numbers from 0, one a box,
    or that repeat."""
    numbers = np.asarray(ids)
    if numbers.size == 0:
        numbers = numbers.astype(np.int64)
    if numbers.shape != (count,) or numbers.dtype.kind not in "iu":
        raise ValueError(
            f"ids must be one whole number for each of the {count} boxes, got {numbers.dtype} of "
            f"shape {numbers.shape}"
        )
    if count and numbers.min() < 0:
        raise ValueError(f"ids must not be negative, got {int(numbers.min())}: count from 0")
    different_ids, repetitions = np.unique(numbers, return_counts=True)
    if (repetitions > 1).any():
        repeated_id = int(different_ids[repetitions > 1][0])
        raise ValueError(
            f"ids of one instant must differ, got {repeated_id} twice: number the objects apart"
        )
    return numbers.astype(np.int64)


def _check_velocities(velocities: ArrayLike, count: int) -> np.ndarray:
    """Return velocities (m/s) as float64 (count, 3), NaN if unknown.

    count: number of boxes. Raises ValueError for another shape and impossible speeds."""
    rows = np.asarray(velocities, np.float64)
    if rows.size == 0:
        rows = rows.reshape(-1, 3)
    if rows.shape != (count, 3):
        raise ValueError(
            f"velocities must be 3 numbers for each of the {count} boxes, got shape {rows.shape}"
        )
    if (np.abs(rows) > MAX_OBJECT_SPEED_M_S).any():  # False for NaN
        fastest = float(np.nanmax(np.abs(rows)))
        raise ValueError(
            f"velocities must be at most {MAX_OBJECT_SPEED_M_S:g} m/s, got {fastest:g}: give NaN "
            "if unknown"
        )
    return rows


def _check_ages(ages: ArrayLike, count: int) -> np.ndarray:
    """Return ages (s) as float64 (count,).

    count: number of boxes. Raises ValueError for another shape, and for ages that are not finite or
    negative."""
    seconds = np.asarray(ages, np.float64)
    if seconds.shape != (count,):
        raise ValueError(
            f"ages must be one number for each of the {count} boxes, got shape {seconds.shape}"
        )
    is_wrong = ~(np.isfinite(seconds) & (seconds >= 0))
    if is_wrong.any():
        raise ValueError(f"ages must be seconds from 0, got {seconds[is_wrong][0]:g}")
    return seconds


def _first_not_finite(values: np.ndarray) -> list[float]:
    """List up to three values that are not finite, for an error's text."""
    return [float(value) for value in values[~np.isfinite(values)][:3]]
