"""Moving points, and their fit to the boxes of a frame.

Sensors do not move, so a pixel that is nearer than in other frames shows an object. Points of
such pixels must be on the objects' boxes: inside them, and near their surface rather than in
their core. The fit of boxes is the share of moving points that are."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64, Pose
from toolkit.datasets import published_layout as published
from toolkit.doctor.sensor_images import SensorImages
from toolkit.geometry import transform
from toolkit.objects import HEAVY, VEHICLE
from toolkit.sensors.sensor import Sensor

_SLACK_M = 0.1  # that a point may be outside its box
_CORE_SHARE = 0.6  # share of a vehicle's box in which a sensor sees nothing
_POINTS_PER_FRAME = 100  # for each sensor
Rows = Float64[np.ndarray, "_ 10"]


class Witness(NamedTuple):
    """Moving pixels of one sensor in one frame."""

    frame: int
    sensor: int
    rays: Float64[np.ndarray, "p 3"]
    depth: Float64[np.ndarray, " p"]


def choose_witnesses(views: Sequence[SensorImages]) -> list[Witness]:
    """Choose moving pixels of each sensor and frame, the same every time."""
    rng = np.random.default_rng(0)
    selected = []
    for i, view in enumerate(views):
        for frame, moving in enumerate(view.moving()):
            pixels = np.flatnonzero(moving)
            if len(pixels) > _POINTS_PER_FRAME:
                pixels = rng.choice(pixels, _POINTS_PER_FRAME, replace=False)
            rays = view.rays[pixels].astype(np.float64)
            depth = view.depth[frame, pixels].astype(np.float64)
            selected.append(Witness(frame, i, rays, depth))
    return selected


def share_on_boxes(clouds: Sequence[np.ndarray], rows: Sequence[Rows], map_SE3_site: Pose) -> float:
    """Share of points on the boxes of their frame.

    clouds: (n, 3) in the site's frame, one for each frame."""
    on_boxes = 0
    for points, table in zip(clouds, rows, strict=True):
        if not len(points) or not len(table):
            continue
        objects = published.parse_rows(table, map_SE3_site)
        x, y, z = (points.T[:, :, None] - objects.boxes.T[:3, None, :]).astype(np.float32)
        cos = np.cos(objects.boxes[:, 6])
        sin = np.sin(objects.boxes[:, 6])
        offsets = np.abs([x * cos + y * sin, y * cos - x * sin, z])
        half = objects.boxes.T[3:6, None, :] / 2
        inside = np.all(offsets <= half + _SLACK_M, axis=0)
        is_vehicle = np.isin(objects.labels, (VEHICLE, HEAVY))
        core = np.all(offsets <= half * _CORE_SHARE, axis=0) & is_vehicle
        on_boxes += int((np.any(inside, axis=1) & ~np.any(core, axis=1)).sum())
    return on_boxes / max(1, sum(map(len, clouds)))


def collect_clouds(
    witnesses: Sequence[Witness], sensors: Sequence[Sensor], frames: int
) -> list[Float64[np.ndarray, "_ 3"]]:
    """Points of the witnesses in each frame, site frame."""
    arrays_by_frame: list[list[np.ndarray]] = [[np.zeros((0, 3))] for _ in range(frames)]
    for witness in witnesses:
        arrays_by_frame[witness.frame].append(
            transform(sensors[witness.sensor].pose, witness.rays * witness.depth[:, None])
        )
    return [np.concatenate(arrays) for arrays in arrays_by_frame]
