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

_MOVED_M = 0.3  # nearer than the empty scene


def read_images(
    dataset: CoopDataset, frames: Sequence[int]
) -> "tuple[list[SensorImages], list[Finding]]":
    """Measurements of some frames as stored, in any unit.

    Frames that cannot be read become findings."""
    views = []
    findings = []
    for sensor, name, index, stride in dataset.channels:
        images = dataset.open_dataset(name)
        depth = np.zeros((len(frames), *sensor.model.shape), np.float32)
        for i, k in enumerate(frames):
            try:
                image = hdf5.rows(images, name, k if index is None else (k, index))
            except OSError as error:
                where = f"{name}, frame {k}"
                remedy = "restore the file"
                findings.append(report_error(where, "damaged image", str(error), remedy))
                continue
            with np.errstate(over="ignore"):
                depth[i] = image[::stride, ::stride]
        depth = np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0))
        rays = sensor.model.rays().reshape(-1, 3)
        views.append(SensorImages(sensor, rays, depth.reshape(len(frames), -1)))
    return views, findings


@dataclass(frozen=True, eq=False)
class SensorImages:
    """Images of one sensor.

    rays: (pixels, 3), in its frame; depth: (frames, pixels), 0 for no return."""

    sensor: Sensor
    rays: Float32[np.ndarray, "pixels 3"]
    depth: Float32[np.ndarray, "frames pixels"]

    def moving(self) -> Bool[np.ndarray, "frames pixels"]:
        """Mask of the pixels that show a moving object, one that is missing in another frame."""
        # a frame without any return shows nothing of the scene
        seen = self.depth[(self.depth > 0).any(axis=1)]
        if len(seen) < 3:
            return np.zeros(self.depth.shape, bool)
        background = np.where(seen > 0, seen, np.inf).max(axis=0)
        return (self.depth > 0) & (self.depth < 100) & (self.depth < background * 0.99 - _MOVED_M)

    def points(self, frame: int) -> Float32[np.ndarray, "_ 3"]:
        """Points of one frame, site frame."""
        seen = self.depth[frame] > 0
        return transform(self.sensor.pose, self.rays[seen] * self.depth[frame, seen, None])
