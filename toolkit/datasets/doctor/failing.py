"""Sensors of a recording that freeze or go blind in the middle of it.

frozen    an image is one of before, pixel for pixel, although nobody is any more where that showed objects
blind     much less returns than in most frames, while other sensors see as ever
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from toolkit.arrays import Bool
from toolkit.boxes import count_points, iou_bev
from toolkit.datasets import published_layout as published
from toolkit.datasets.doctor.hypotheses import Rows, SensorImages
from toolkit.geometry import transform
from toolkit.sites.site import Site

SHOWN = 20  # points on an object that a sensor shows
USUAL = 0.9  # quantile of what returns in a frame that is usual
HALF_OF_IT = 0.5  # of what is usual, below which a sensor is blind


def frozen_frames(view: SensorImages, rows: Sequence[Rows], site: Site) -> Bool[np.ndarray, " frames"]:
    """In which frames a sensor repeats an image that showed objects where nobody is any more; rows: the published ones
    of each frame."""
    frozen, first = np.zeros(len(view.depth), bool), 0
    for k in range(1, len(view.depth)):
        if not (view.depth[k].any() and np.array_equal(view.depth[k], view.depth[k - 1])):
            first = k
            continue
        before, now = (published.objects_of(rows[i], site.map_SE3_site) for i in (first, k))
        gone = before.boxes[~(iou_bev(before.boxes, now.boxes) > 0).any(axis=1)]
        seen = view.depth[k] > 0
        points = transform(view.sensor.pose, view.rays[seen] * view.depth[k, seen, None])
        frozen[k] = bool((count_points(points, gone) >= SHOWN).any())
    return frozen


def blind_frames(views: Sequence[SensorImages]) -> Bool[np.ndarray, "sensors frames"]:
    """In which frames much less returns to a sensor than in most, and not to all of them."""
    returned = np.array([(view.depth > 0).sum(axis=1) for view in views])
    usual = np.quantile(returned, USUAL, axis=1)[:, None]
    blind = returned < HALF_OF_IT * usual
    return np.asarray(blind & ~blind.all(axis=0))


def failing_sensors(
    views: Sequence[SensorImages], rows: Sequence[Rows], site: Site, frames: Sequence[int]
) -> Iterator[tuple[str, str, str, str]]:
    """Of each sensor that fails: where, what is suspected, the evidence, a remedy. frames: numbers of the images."""
    if not views or not frames:
        return
    blind = blind_frames(views)
    for view, dark in zip(views, blind, strict=True):
        where = f"sensor {view.sensor.name}"
        frozen = frozen_frames(view, rows, site)
        if frozen.any():
            evidence = f"{_some(frozen, frames)} show objects where nobody is any more"
            yield where, "it is frozen", evidence, "leave these frames out, or the sensor"
        if dark.any():
            evidence = f"{_some(dark, frames)} return less than half of what is usual, other sensors see as ever"
            yield where, "it goes blind", evidence, "leave these frames out, or the sensor"


def _some(chosen: Bool[np.ndarray, " frames"], frames: Sequence[int]) -> str:
    """How many frames, and the first."""
    return (
        f"{int(chosen.sum())} of {len(frames)} frames that were looked at, the first is {frames[int(chosen.argmax())]},"
    )
