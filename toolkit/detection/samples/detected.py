"""A detector in samples of clouds: points put on level ground about the sensors, detected in, boxes put back.

A detector that learnt on ground at z = 0 finds nothing in a raw cloud, whose origin is the lidar. So the ground is
found first (`toolkit.calibration.ground`), in every sample or, where the sensors stand still, once. Detectors work in
float32 about an origin near by: points are counted from the middle of the area to be detected in, and boxes are
brought back into the sample's world frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Literal

import numpy as np

from toolkit.arrays import Float64
from toolkit.calibration.ground import Ground, level, level_warning
from toolkit.datasets.sample import Sample
from toolkit.objects import Detections, Detector

Level = Literal["map", "plane", "none"]
LEVELS: tuple[Level, ...] = ("map", "plane", "none")


@dataclass(frozen=True, eq=False)
class Detected:
    """What was found in one sample, world frame.

    ground: below its points, counted from the middle; None where it was not levelled. level_ms, detect_ms: what finding
    the ground and detecting took. warning: of ground that is not at z = 0.
    """

    sample: Sample
    detections: Detections
    ground: Ground | None
    middle: Float64[np.ndarray, "2"]
    level_ms: float
    detect_ms: float
    warning: str | None = None


def detect_samples(
    samples: Iterable[Sample],
    detector: Detector,
    *,
    levelling: Level = "map",
    middle: Sequence[float] | None = None,
    still: bool = False,
    sensors: Sequence[str] | None = None,
) -> Iterator[Detected]:
    """What the detector finds in each sample, one after the other.

    detector: sees points counted from the middle; middle: x and y, world frame, of where it detects, the sensors' own
    when None; still: the sensors do not move, the ground is found once; sensors: only the clouds of these (names).
    A sample without points has no detections, one without ground is detected in as it is, with a warning.
    Raises ValueError for a levelling that there is not.
    """
    if levelling not in LEVELS:
        raise ValueError(f"levelling must be one of {', '.join(LEVELS)}, got {levelling!r}")
    kept: Ground | None = None
    for sample in samples:
        centre = middle_of(sample) if middle is None else np.array(middle, np.float64)
        points = sample.points(sensors) - [*centre, 0.0]
        start = perf_counter()
        ground, warning = (kept, None) if kept is not None else _levelled(points, levelling)
        if still:
            kept = ground
        upright = points if ground is None else ground.points(points)
        middle_time = perf_counter()
        found = detector(upright.astype(np.float32)) if len(points) else Detections.empty()
        end = perf_counter()
        boxes = found.boxes if ground is None or not len(found) else ground.boxes_back(found.boxes)
        placed = Detections(boxes + np.array([*centre, 0, 0, 0, 0, 0]), found.scores, found.labels)
        yield Detected(sample, placed, ground, centre, 1e3 * (middle_time - start), 1e3 * (end - middle_time), warning)


def middle_of(sample: Sample) -> Float64[np.ndarray, "2"]:
    """The middle of the sensors' places, world frame, to the metre; the origin where there is no sensor.

    >>> from toolkit.objects import Objects
    >>> middle_of(Sample("0", (), Objects.empty())).tolist()
    [0.0, 0.0]
    """
    places = [cloud.world_SE3_sensor[:2, 3] for cloud in sample.clouds]
    return np.asarray(np.round(np.mean(places, axis=0)), np.float64) if places else np.zeros(2)


def _levelled(points: np.ndarray, levelling: Level) -> tuple[Ground | None, str | None]:
    """The ground below points, and what is to be said of it."""
    if not len(points):
        return None, None
    if levelling == "none":
        return None, level_warning(points)
    try:
        return level(points, method=levelling), None
    except ValueError as error:
        return None, f"not levelled: {error}"
