"""Where sensors look: heading and tilt of a pose, and the pose of a heading and tilt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from toolkit.arrays import Float64
from toolkit.geometry import pose
from toolkit.sensors.sensor import Sensor


def aims(sensors: Sequence[Sensor]) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Heading and tilt below the horizon (rad) of each sensor."""
    turns = np.array([sensor.pose[:3, :3] for sensor in sensors]).reshape(-1, 3, 3)
    forward = np.array([sensor.model.body_SE3_sensor[0, :3] for sensor in sensors]).reshape(-1, 3)  # sensor frames
    x, y, z = np.einsum("nij,nj->in", turns, forward)
    return np.arctan2(y, x), np.arctan2(-z, np.hypot(x, y))


def aimed(sensor: Sensor, position: Float64[np.ndarray, "3"], heading: float, tilt: float) -> Sensor:
    """The sensor elsewhere, without roll; angles as of `aims`."""
    x, y, z = position.tolist()
    return replace(sensor, pose=pose(x, y, z, yaw=heading, pitch=tilt) @ sensor.model.body_SE3_sensor)
