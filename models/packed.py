"""A packed recording in memory: what each sensor sees of the empty site once, and per frame only what differs.

The packed file needs numpy and h5py alone, so training can move to a machine that has neither Open3D nor SUMO.
Depth stays noise-free; every reading draws fresh noise. `models.packing` writes the file; its layout, flat arrays:

    rigs/{r}                    attributes: area, height, sensors (JSON: name, type, model); poses (s, 4, 4)
    rigs/{r}/pixels, depth      what the sensors see of the empty site within the crop, one sensor after the other:
                                uint32 pixel number (row · columns + column), float32 measurement (m)
    rigs/{r}/ends               (s,) where the pixels of each sensor end
    frames/rig, frames/ends     (t,) rig of each frame, and (t, s + 1) where the changed pixels of each sensor begin
                                and the last ones end
    pixels, steps               (p,) changed pixels, and their measurement in 1/512 m, 0 for none
    boxes, labels, box_ends     objects of all frames, and (t + 1,) where those of each frame begin
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import SupportsFloat

import h5py
import numpy as np

from toolkit.arrays import Bool, Float32, Shaped
from toolkit.objects import Objects
from toolkit.sensors.catalogue import make_model
from toolkit.sensors.sensor import Sensor

STEPS_PER_METRE = 512  # quantisation of what changes: 2 mm steps are far below the sensors' noise
MARGIN = 0.2  # m kept around the crop, so that noise can carry a point across its edge

Area = tuple[float, float, float, float]  # xmin ymin xmax ymax, m


class PackedFrames:
    """A packed file in memory: points and objects of frame k, in the frame of its site.

    Raises FileNotFoundError; ValueError where the file is damaged or no packed file.
    """

    def __init__(self, path: Path | str) -> None:
        if not Path(path).is_file():
            raise FileNotFoundError(f"no packed file {path}: make it with coview pack")
        try:
            with h5py.File(path, "r") as file:
                self._rig_of_frame, self._ends = file["frames/rig"][:], file["frames/ends"][:]
                self._pixels, self._steps = file["pixels"][:], file["steps"][:]
                self._boxes, self._labels = file["boxes"][:], file["labels"][:]
                self._box_ends = file["box_ends"][:]
                self.rigs = tuple(_read_rig(file[f"rigs/{r}"]) for r in range(len(file["rigs"])))
        except (OSError, KeyError) as error:
            raise ValueError(f"{path} is no whole packed file ({error}): make it again with coview pack") from error

    def __len__(self) -> int:
        return len(self._rig_of_frame)

    def rig(self, k: int) -> Rig:
        """The sensors of frame k, and where they look."""
        return self.rigs[self._rig_of_frame[k]]

    def objects(self, k: int) -> Objects:
        """Ground truth of frame k, inside the area and around it."""
        rows = slice(*self._box_ends[k : k + 2])
        return Objects(self._boxes[rows], self._labels[rows])

    def points(
        self, k: int, rng: np.random.Generator | None, sensors: Iterable[int] | None = None
    ) -> list[Float32[np.ndarray, "_ 3"]]:
        """Points inside the crop of each chosen sensor (None: all) of frame k, with fresh noise (None: without)."""
        rig = self.rig(k)
        clouds = []
        for s in range(len(rig.sensors)) if sensors is None else sensors:
            changed = slice(*self._ends[k, s : s + 2])
            depth = self._steps[changed].astype(np.float32) / STEPS_PER_METRE
            clouds.append(rig.points(s, self._pixels[changed], depth, rng))
        return clouds


@dataclass(frozen=True, eq=False)
class Rig:
    """Sensors that do not move, and the pixels of each that see the empty site inside the crop, with what they measure.

    The crop is the area (xmin ymin xmax ymax, m) below the height (m).
    """

    sensors: tuple[Sensor, ...]
    area: Area
    height: float
    pixels: tuple[Shaped[np.ndarray, " _"], ...]
    depth: tuple[Float32[np.ndarray, " _"], ...]

    @staticmethod
    def seeing(
        sensors: Iterable[Sensor], area: Iterable[SupportsFloat], height: float, empty: Iterable[np.ndarray]
    ) -> Rig:
        """The rig of sensors that measure the images `empty`, (rows, columns) each, of the site with nothing on it."""
        sensors, (xmin, ymin, xmax, ymax) = tuple(sensors), (float(side) for side in area)
        rig = Rig(sensors, (xmin, ymin, xmax, ymax), float(height), (), ())
        pixels, depth = [], []
        for s, image in enumerate(empty):
            seen = np.flatnonzero(image > 0).astype(np.uint32)
            seen = seen[rig.in_crop(rig.world(s, seen, image.ravel()[seen]), MARGIN)]
            pixels.append(seen)
            depth.append(image.ravel()[seen])
        return Rig(rig.sensors, rig.area, rig.height, tuple(pixels), tuple(depth))

    def points(
        self, s: int, changed: np.ndarray, measured: np.ndarray, rng: np.random.Generator | None
    ) -> Float32[np.ndarray, "n 3"]:
        """Noisy points in the crop where the pixels `changed` measure `measured` (0: nothing) and the others what is
        always there."""
        rows, columns = self.sensors[s].model.shape
        still = np.ones(rows * columns, bool)
        still[changed] = False
        still, seen = still[self.pixels[s]], measured > 0
        pixels = np.concatenate([self.pixels[s][still], changed[seen]])
        depth = np.concatenate([self.depth[s][still], measured[seen]])
        if rng is not None:
            depth += rng.standard_normal(len(depth), dtype=np.float32) * self.sensors[s].model.deviation(depth)
        points = self.world(s, pixels, depth)
        return points[self.in_crop(points)]

    def world(
        self, s: int, pixels: Shaped[np.ndarray, " n"], depth: Float32[np.ndarray, " n"]
    ) -> Float32[np.ndarray, "n 3"]:
        """Where the pixels of sensor s measure, in the frame of the site."""
        sensor = self.sensors[s]
        rays = sensor.model.rays().reshape(-1, 3).take(pixels, axis=0) @ sensor.pose[:3, :3].T.astype(np.float32)
        rays *= depth[:, None]
        rays += sensor.position.astype(np.float32)
        return rays

    def in_crop(self, points: Float32[np.ndarray, "n 3"], margin: float = 0.0) -> Bool[np.ndarray, " n"]:
        """Which points lie in the crop, widened by a margin (m)."""
        (x, y, z), (xmin, ymin, xmax, ymax) = points.T, self.area
        inside = (x >= xmin - margin) & (x <= xmax + margin) & (y >= ymin - margin) & (y <= ymax + margin)
        return inside & (z > -margin) & (z < self.height + margin)


def _read_rig(group: h5py.Group) -> Rig:
    models = json.loads(group.attrs["sensors"])
    sensors = tuple(
        Sensor(each["name"], make_model(each["type"], each["model"]), pose)
        for each, pose in zip(models, group["poses"][:], strict=True)
    )
    ends = group["ends"][:-1]
    pixels, depth = np.split(group["pixels"][:], ends), np.split(group["depth"][:], ends)
    area = tuple(group.attrs["area"].tolist())
    return Rig(sensors, area, float(group.attrs["height"]), tuple(pixels), tuple(depth))
