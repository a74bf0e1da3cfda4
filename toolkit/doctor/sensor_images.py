"""Images of each sensor of a file, as they are stored."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Bool, Float32
from toolkit.datasets.dataset import CoopDataset
from toolkit.doctor.findings import Finding, report_error
from toolkit.geometry import transform
from toolkit.runtime import hdf5
from toolkit.sensors.sensor import Sensor

_MOVED_M = 0.3  # a pixel nearer than the empty scene by more than this shows a moving object
_MAX_MOVING_DEPTH_M = 100  # farther pixels are not used


def read_images(
    dataset: CoopDataset, frames: Sequence[int]
) -> "tuple[list[SensorImages], list[Finding]]":
    """Read the images of each sensor in some frames as stored, in whatever unit they are.

    frames: numbers of the frames in the file. Returns the images, and findings on images that
    cannot be read, whose pixels are 0."""
    views = []
    findings = []
    # name: dataset in the file; sensor_index: index of the sensor in it, None if it has one sensor;
    # stride: step of the pixels that are kept
    for sensor, name, sensor_index, stride in dataset.channels:
        images = dataset.open_dataset(name)
        depth = np.zeros((len(frames), *sensor.model.shape), np.float32)  # frame, row, column
        for i, frame in enumerate(frames):
            try:
                image = hdf5.rows(
                    images, name, frame if sensor_index is None else (frame, sensor_index)
                )
            except OSError as error:
                where = f"{name}, frame {frame}"
                remedy = "restore the file"
                findings.append(
                    report_error(
                        where=where, suspected="damaged image", evidence=str(error), remedy=remedy
                    )
                )
                continue
            with np.errstate(over="ignore"):  # numbers too large for float32 become inf
                depth[i] = image[::stride, ::stride]
        depth = np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0))
        rays = sensor.model.rays().reshape(-1, 3)
        views.append(SensorImages(sensor, rays, depth.reshape(len(frames), -1)))
    return views, findings


@dataclass(frozen=True, eq=False)
class SensorImages:
    """Images of one sensor in the frames that are looked at.

    Attributes:
        sensor: the sensor at its stored pose.
        rays: (pixels, 3) ray of each pixel in the sensor's frame; times the depth, it is the point.
        depth: (frames, pixels) measurements, 0 for no return."""

    sensor: Sensor
    rays: Float32[np.ndarray, "pixels 3"]
    depth: Float32[np.ndarray, "frames pixels"]

    def mark_moving_pixels(self) -> Bool[np.ndarray, "frames pixels"]:
        """Mask of the pixels that show a moving object, one that is missing in another frame.

        Nothing is marked with fewer than three frames that have a return."""
        # a frame without any return shows nothing of the scene
        usable_depth = self.depth[(self.depth > 0).any(axis=1)]  # (frames, pixels)
        if len(usable_depth) < 3:
            return np.zeros(self.depth.shape, bool)
        # farthest measurement of each pixel, infinite if it once has no return
        background = np.where(usable_depth > 0, usable_depth, np.inf).max(axis=0)
        is_near = (self.depth > 0) & (self.depth < _MAX_MOVING_DEPTH_M)
        # nearer than the background by 1 % and `_MOVED_M`
        return is_near & (self.depth < background * 0.99 - _MOVED_M)

    def points(self, frame: int) -> Float32[np.ndarray, "_ 3"]:
        """Points (m, site frame) of one frame. frame: row of `depth`."""
        has_return = self.depth[frame] > 0
        points_in_sensor = self.rays[has_return] * self.depth[frame, has_return, None]
        return transform(self.sensor.pose, points_in_sensor)
