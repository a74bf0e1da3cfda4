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

_SLACK_M = 0.1  # distance that a point may be outside its box
_CORE_SHARE = 0.6  # inner share of a vehicle's length, width and height, in which no sensor sees it
_POINTS_PER_FRAME = 100  # largest number of moving pixels of each sensor and frame
# published rows of one frame's objects, in CARLA's frame
Rows = Float64[np.ndarray, "_ 10"]


class Witness(NamedTuple):
    """Moving pixels of one sensor in one frame.

    Attributes:
        frame: index of the frame among those that are looked at.
        sensor: number of the sensor.
        rays: (p, 3) ray of each pixel in the sensor's frame; times the depth, it is the point.
        depth: (p,) measurement of each pixel."""

    frame: int
    sensor: int
    rays: Float64[np.ndarray, "p 3"]
    depth: Float64[np.ndarray, " p"]


def choose_witnesses(views: Sequence[SensorImages]) -> list[Witness]:
    """Choose at most `_POINTS_PER_FRAME` moving pixels of each sensor and frame, the same every
    time.

    views: images of each sensor. Results are sensor by sensor, then by frame."""
    rng = np.random.default_rng(0)
    witnesses = []
    for sensor_index, view in enumerate(views):
        for frame, is_moving in enumerate(view.moving()):
            pixels = np.flatnonzero(is_moving)
            if len(pixels) > _POINTS_PER_FRAME:
                pixels = rng.choice(pixels, _POINTS_PER_FRAME, replace=False)
            witnesses.append(
                Witness(
                    frame=frame,
                    sensor=sensor_index,
                    rays=view.rays[pixels].astype(np.float64),
                    depth=view.depth[frame, pixels].astype(np.float64),
                )
            )
    return witnesses


def share_on_boxes(clouds: Sequence[np.ndarray], rows: Sequence[Rows], map_SE3_site: Pose) -> float:
    """Share of all points, 0 to 1, that are on the boxes of their frame.

    A point is on a box if it is inside it, and not in the core of a vehicle.

    Args:
        clouds: moving points (n, 3) of each frame (m, site frame).
        rows: published rows of the objects of each frame.
        map_SE3_site: pose of the site in the map."""
    on_boxes = 0
    for points, table in zip(clouds, rows, strict=True):
        if not len(points) or not len(table):
            continue
        objects = published.parse_rows(table, map_SE3_site)
        # offsets of each point from each box's centre, (points, boxes) each
        x, y, z = (points.T[:, :, None] - objects.boxes.T[:3, None, :]).astype(np.float32)
        yaw = objects.boxes[:, 6]
        cos = np.cos(yaw)
        sin = np.sin(yaw)
        # distances along each box's length, width and height
        offsets = np.abs([x * cos + y * sin, y * cos - x * sin, z])
        half_sizes = objects.boxes.T[3:6, None, :] / 2
        is_inside = np.all(offsets <= half_sizes + _SLACK_M, axis=0)
        is_vehicle = np.isin(objects.labels, (VEHICLE, HEAVY))
        is_in_core = np.all(offsets <= half_sizes * _CORE_SHARE, axis=0) & is_vehicle
        on_boxes += int((np.any(is_inside, axis=1) & ~np.any(is_in_core, axis=1)).sum())
    return on_boxes / max(1, sum(map(len, clouds)))


def collect_clouds(
    witnesses: Sequence[Witness], sensors: Sequence[Sensor], frames: int
) -> list[Float64[np.ndarray, "_ 3"]]:
    """Points (m, site frame) of moving pixels in each frame.

    witnesses: moving pixels, each with the indices of its frame and of its sensor in `sensors`;
    frames: number of frames. Frames without moving pixels get an empty array."""
    arrays_by_frame: list[list[np.ndarray]] = [[np.zeros((0, 3))] for _ in range(frames)]
    for witness in witnesses:
        in_sensor = witness.rays * witness.depth[:, None]
        in_site = transform(sensors[witness.sensor].pose, in_sensor)
        arrays_by_frame[witness.frame].append(in_site)
    return [np.concatenate(arrays) for arrays in arrays_by_frame]
