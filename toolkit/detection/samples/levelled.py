"""Samples as a network is trained on them: clouds and objects on level ground, counted from the middle of the area.

Where the labels of a set are not complete, in KITTI beside the camera's image, points are left out: what nobody
labelled must not be learnt as background.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Float32
from toolkit.calibration.ground import Ground, level
from toolkit.datasets.sample import Sample
from toolkit.detection.samples.detected import DETECTION_REACH, Level, middle_of
from toolkit.detection.samples.views import CROP_HEIGHT
from toolkit.objects import Objects
from toolkit.points import inside

MARGIN_AROUND = 5.0  # m around the area, in which objects are kept, so that those on its edge are known


@dataclass(frozen=True, eq=False)
class LevelSample:
    """Names of sensors and their points in the area, below 4 m; objects in the area or close beside it; the area:
    xmin ymin xmax ymax (m), about the origin."""

    sensors: tuple[str, ...]
    clouds: tuple[Float32[np.ndarray, "_ 3"], ...]
    objects: Objects
    area: tuple[float, float, float, float]


def level_samples(
    samples: Iterable[Sample],
    *,
    levelling: Level = "map",
    middle: tuple[float, float] | None = None,
    half: tuple[float, float] = (DETECTION_REACH, DETECTION_REACH),
    still: bool = False,
) -> Iterator[LevelSample]:
    """Samples on level ground; arguments as of `toolkit.detection.samples.detected.detect_samples`. Samples without
    points, or without ground where it is looked for, are left out."""
    area = (-half[0], -half[1], half[0], half[1])
    kept: Ground | None = None
    for sample in samples:
        centre = middle_of(sample) if middle is None else np.array(middle, np.float64)
        points = sample.points() - [*centre, 0.0]
        if not len(points):
            continue
        if kept is None and levelling != "none":
            try:
                kept = level(points, method=levelling)
            except ValueError:
                continue
        yield _level_sample(sample, kept, centre, area)
        if not still:
            kept = None


def _level_sample(
    sample: Sample, ground: Ground | None, centre: np.ndarray, area: tuple[float, float, float, float]
) -> LevelSample:
    clouds = []
    for cloud in sample.clouds:
        points = cloud.in_world()
        # a point is where labels are complete if a small box there is
        small = np.column_stack([points, np.full((len(points), 3), 0.1), np.zeros(len(points))])
        points = points[sample.complete.covers(small)] - [*centre, 0.0]
        upright = (points if ground is None or not len(points) else ground.points(points)).astype(np.float32)
        clouds.append(upright[inside(upright, np.array(area), CROP_HEIGHT)])
    boxes = sample.objects.boxes - np.array([*centre, 0, 0, 0, 0, 0])
    boxes = boxes if ground is None or not len(boxes) else ground.boxes(boxes)
    near = (np.abs(boxes[:, :2]) <= np.array(area[2:]) + MARGIN_AROUND).all(axis=1)
    objects = Objects(boxes, sample.objects.labels, sample.objects.ids)[np.asarray(near)]
    return LevelSample(tuple(cloud.name for cloud in sample.clouds), tuple(clouds), objects, area)
