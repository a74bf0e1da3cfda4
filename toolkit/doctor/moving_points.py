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
        frame_index: index of the frame among those that are looked at.
        sensor_index: index of the sensor among the file's.
        rays: (p, 3) ray of each pixel in the sensor's frame; times the depth, it is the point (m).
        depth: (p,) measurement of each pixel."""

    frame_index: int
    sensor_index: int
    rays: Float64[np.ndarray, "p 3"]
    depth: Float64[np.ndarray, " p"]


def choose_witnesses(views: Sequence[SensorImages]) -> list[Witness]:
    """Choose at most `_POINTS_PER_FRAME` moving pixels of each sensor and frame, the same every
    time.

    views: images of each sensor. Results are sensor by sensor, then by frame."""
    rng = np.random.default_rng(0)
    witnesses = []
    for sensor_index, view in enumerate(views):
        for frame_index, is_moving in enumerate(view.mark_moving_pixels()):
            pixels = np.flatnonzero(is_moving)  # indices of the pixels
            if len(pixels) > _POINTS_PER_FRAME:
                pixels = rng.choice(pixels, _POINTS_PER_FRAME, replace=False)
            witnesses.append(
                Witness(
                    frame_index=frame_index,
                    sensor_index=sensor_index,
                    rays=view.rays[pixels].astype(np.float64),
                    depth=view.depth[frame_index, pixels].astype(np.float64),
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
    count_on_boxes = 0  # points
    for points, table in zip(clouds, rows, strict=True):
        if not len(points) or not len(table):
            continue
        # boxes in the site's frame, as the points are
        objects = published.parse_rows(table, map_SE3_site)
        centres = objects.boxes[:, :3]
        sizes = objects.boxes[:, 3:6]  # length, width, height
        yaw = objects.boxes[:, 6]
        # offsets of each point from each box's centre, (points, boxes) each
        x, y, z = (points.T[:, :, None] - centres.T[:, None, :]).astype(np.float32)
        cos = np.cos(yaw)
        sin = np.sin(yaw)
        # distances along each box's length, width and height: (3, points, boxes)
        offsets = np.abs([x * cos + y * sin, y * cos - x * sin, z])
        half_sizes = sizes.T[:, None, :] / 2
        is_inside = np.all(offsets <= half_sizes + _SLACK_M, axis=0)
        is_vehicle = np.isin(objects.labels, (VEHICLE, HEAVY))
        is_in_core = np.all(offsets <= half_sizes * _CORE_SHARE, axis=0) & is_vehicle
        is_on_box = np.any(is_inside, axis=1) & ~np.any(is_in_core, axis=1)  # for each point
        count_on_boxes += int(is_on_box.sum())
    return count_on_boxes / max(1, sum(map(len, clouds)))


def collect_clouds(
    witnesses: Sequence[Witness], sensors: Sequence[Sensor], frame_count: int
) -> list[Float64[np.ndarray, "_ 3"]]:
    """Points (m, site frame) of moving pixels in each frame.

    witnesses: moving pixels, each with the indices of its frame and of its sensor in `sensors`.
    Frames without moving pixels get an empty array."""
    arrays_by_frame: list[list[np.ndarray]] = [[np.zeros((0, 3))] for _ in range(frame_count)]
    for witness in witnesses:
        points_in_sensor = witness.rays * witness.depth[:, None]
        points_in_site = transform(sensors[witness.sensor_index].pose, points_in_sensor)
        arrays_by_frame[witness.frame_index].append(points_in_site)
    return [np.concatenate(arrays) for arrays in arrays_by_frame]
