"""What the fusion centre wants to see of what sensors reported in boxes: places, what points there are worth, and about
how many bits each sensor takes for them.

Worth of a place: how unsure its surest box is, 1 - score, and how far the boxes of other sensors there disagree with
it, 1 - mean IoU; `LONE` for disagreement where no other sensor reports a box but some could see the place. Nothing
where only one sensor can: its box holds all there is to know.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from toolkit.arrays import Bool, Float64, Int64
from toolkit.boxes import iou_3d, iou_bev
from toolkit.detection.link.range_images import BITS_PER_PIXEL
from toolkit.objects import Detections
from toolkit.sensors.sensor import Sensor

LONE = 0.5
MARGIN_PIXELS = 1.5  # beyond the outermost rays, in which a place still counts as seen
LEAST_SEEN = 5.0  # expected pixels from which on a sensor may see a place


@dataclass(frozen=True, eq=False)
class Wants:
    """Places, the most wanted first: x, y, radius (m); gains; bits: expected of each sensor for each; of: by which
    sensors it may be seen."""

    places: Float64[np.ndarray, "n 3"]
    gains: Float64[np.ndarray, " n"]
    bits: Float64[np.ndarray, "sensors n"]
    of: Bool[np.ndarray, "sensors n"]


def wanted(centre: Detections, parts: Sequence[Detections], sensors: Sequence[Sensor], *, same_iou: float) -> Wants:
    """By gain per bit. centre: the boxes of all parts, those of one object suppressed; parts: what each sensor
    reported; same_iou: BEV IoU from which on two boxes are of one object."""
    boxes = centre.boxes
    pixels = np.array([expected_pixels(sensor, boxes) for sensor in sensors]).reshape(len(sensors), len(boxes))
    overlap = [iou_bev(boxes, part.boxes) > same_iou for part in parts]
    reports = np.array([each.any(axis=1) for each in overlap], bool).reshape(pixels.shape)
    best = np.array([iou_3d(boxes, part.boxes).max(axis=1, initial=0) for part in parts]).reshape(pixels.shape)
    sees = reports | (pixels >= LEAST_SEEN)
    others = reports.sum(axis=0) - 1
    agree = (np.where(reports, best, 0).sum(axis=0) - best.max(axis=0, initial=0)) / np.maximum(others, 1)
    gain = (1 - centre.scores) + np.where(others > 0, 1 - agree, LONE)
    gain = np.where(sees.sum(axis=0) > 1, gain, 0.0)
    bits = np.where(sees, BITS_PER_PIXEL * pixels, 0)
    order = np.argsort(-gain / np.maximum(bits.sum(axis=0), 1), kind="stable")
    order = order[gain[order] > 0]
    radius = np.hypot(boxes[:, 3], boxes[:, 4]) / 2
    places = np.column_stack([boxes[:, :2], radius])
    return Wants(places[order], gain[order], bits[:, order], sees[:, order])


def granted(most: int, wishes: Float64[np.ndarray, " sensors"]) -> Int64[np.ndarray, " sensors"]:
    """Bits of a link shared by what is wished for; never more than all together.

    >>> granted(1000, np.array([100.0, 300.0]))
    array([250, 750])
    """
    share = wishes / wishes.sum() if wishes.sum() > 0 else np.full(len(wishes), 1 / max(len(wishes), 1))
    return np.floor(max(most, 0) * share).astype(np.int64)


def expected_pixels(sensor: Sensor, boxes: Float64[np.ndarray, "n 7"]) -> Float64[np.ndarray, " n"]:
    """Pixels that bodies of these boxes cover if nothing stands before them: a quarter of their surface, which is what
    they show in the mean over all directions, over the solid angle of a pixel there. 0 out of view."""
    rays, columns = _directions(sensor), sensor.model.shape[1]
    offset = boxes[:, :3] - sensor.position
    away = np.linalg.norm(offset, axis=1)
    direction = offset / np.maximum(away, 1e-9)[:, None]
    closeness = direction @ rays
    nearest = closeness.argmax(axis=1)
    beside = np.where(nearest % columns > 0, nearest - 1, nearest + 1).clip(0, rays.shape[1] - 1)
    below = np.where(nearest >= columns, nearest - columns, nearest + columns).clip(0, rays.shape[1] - 1)
    across, along = (np.linalg.norm(rays[:, nearest] - rays[:, other], axis=0).clip(1e-6) for other in (beside, below))
    length, width, height = boxes[:, 3:6].T
    surface = (length * width + length * height + width * height) / 2
    off = np.linalg.norm(direction.T - rays[:, nearest], axis=0)
    seen = (off <= MARGIN_PIXELS * np.maximum(across, along)) & (away <= sensor.model.max_range)
    return np.where(seen, surface / np.maximum(away, 0.1) ** 2 / (across * along), 0.0)


@lru_cache(maxsize=64)
def _directions(sensor: Sensor) -> np.ndarray:
    rays = sensor.world_rays.astype(np.float64)
    return rays / np.linalg.norm(rays, axis=0)
