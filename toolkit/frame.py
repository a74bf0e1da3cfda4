"""One instant: what every sensor measured, and what was there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Float32
from toolkit.objects import Objects
from toolkit.sensors.sensor import Sensor


@dataclass(frozen=True)
class Frame:
    """sensors and measurements belong together by position: measurements[i] is (rows, columns) float32 of sensors[i],
    depth (camera) or range (lidar) in metres, 0 where nothing returned. objects: ground truth, world frame.
    time: seconds since the recording began. index: its number in its dataset. shifts: for each sensor how far (m, world
    frame) each pixel's point lies off its ray, None for nowhere; empty where no sensor has any (see
    `toolkit.sensors.error_terms`).
    """

    sensors: tuple[Sensor, ...]
    measurements: tuple[Float32[np.ndarray, "_ _"], ...]
    objects: Objects
    time: float = 0.0
    index: int = 0
    shifts: tuple[Float32[np.ndarray, "_ _ 3"] | None, ...] = ()

    def __post_init__(self) -> None:
        if len(self.sensors) != len(self.measurements):
            raise ValueError(f"{len(self.sensors)} sensors but {len(self.measurements)} measurements")
        if self.shifts and len(self.shifts) != len(self.sensors):
            raise ValueError(f"{len(self.sensors)} sensors but {len(self.shifts)} shifts: give one each, or none")
        names = [sensor.name for sensor in self.sensors]
        if len(set(names)) < len(names):
            raise ValueError(f"the sensors of a frame must have different names, got {names}: rename one")
        for sensor, measurement in zip(self.sensors, self.measurements, strict=True):
            if measurement.shape != sensor.model.shape:
                raise ValueError(
                    f"sensor {sensor.name!r} measures {sensor.model.shape} pixels, got an image of {measurement.shape}"
                )


def empty_scene(frames: Sequence[Frame], sample: int = 100) -> Frame:
    """What each sensor measures behind all that moves: the farthest return of each pixel over `sample` spread frames.

    Nothing returned counts as farthest, so a pixel that ever sees the sky is 0. Raises ValueError without frames.
    """
    if not len(frames):
        raise ValueError("there must be a frame to see the empty scene in, got none")
    farthest: list[np.ndarray] = []
    for k in np.unique(np.linspace(0, len(frames) - 1, min(sample, len(frames))).astype(int)):
        seen = [np.where(image > 0, image, np.inf) for image in frames[int(k)].measurements]
        farthest = [np.maximum(*pair) for pair in zip(farthest, seen, strict=True)] if farthest else seen
    still = tuple(np.where(np.isfinite(depth), depth, 0).astype(np.float32) for depth in farthest)
    return Frame(frames[0].sensors, still, Objects.empty())
