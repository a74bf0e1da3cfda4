"""Where sensors look: heading and tilt of a pose, and the pose of a heading and tilt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from toolkit.arrays import Float64
from toolkit.geometry import look, pose
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor


def aims(sensors: Sequence[Sensor]) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Heading and tilt below the horizon (rad) of each sensor."""
    axis = [2 if isinstance(sensor.model, DepthCamera) else 0 for sensor in sensors]
    x, y, z = np.array([sensor.pose[:3, k] for sensor, k in zip(sensors, axis, strict=True)]).T
    return np.arctan2(y, x), np.arctan2(-z, np.hypot(x, y))


def aimed(sensor: Sensor, position: Float64[np.ndarray, "3"], heading: float, tilt: float) -> Sensor:
    """The sensor elsewhere, without roll; angles as of `aims`."""
    x, y, z = position.tolist()
    camera = isinstance(sensor.model, DepthCamera)
    there = look((x, y, z), heading, tilt) if camera else pose(x, y, z, yaw=heading, pitch=tilt)
    return replace(sensor, pose=there)
