"""A recording packed for training: what each sensor sees of the empty site once, and per frame only what differs.

The packed file needs numpy and h5py alone, so training can move to a machine that has neither Open3D nor SUMO.
Depth stays noise-free; every reading draws fresh noise. Layout, all flat arrays with offsets:

    rigs/{r}                    attributes: area, height, sensors (JSON: name, model); poses (s, 4, 4)
    rigs/{r}/background/{s}     (rows, columns) float32, metres, 0 where nothing returns
    frames/rig, frames/ends     (t,) rig of each frame, and where its runs of pixels end
    pixels, steps               (p,) uint16 depth in 1/512 m, and uint32 pixel number (row · columns + column)
    boxes, labels, box_ends     objects of all frames, and where those of each frame end
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import h5py
import numpy as np

from toolkit.arrays import Float32
from toolkit.frame import Frame, empty_scene
from toolkit.objects import Objects
from toolkit.sensors import DepthCamera, Sensor, SpinningLidar

STEPS_PER_METRE = 512  # quantisation of the packed depth: 2 mm steps are far below the sensors' noise
FARTHEST = (2**16 - 1) / STEPS_PER_METRE
MARGIN = 0.2  # metres kept around the crop, so that noise can carry a point across its edge
_MODELS = {"DepthCamera": DepthCamera, "SpinningLidar": SpinningLidar}


@dataclass(frozen=True)
class Recording:
    """Frames of one rig: the sensors do not move. area: xmin ymin xmax ymax (m); crop: 0 < z < height (m)."""

    frames: Sequence[Frame]
    area: tuple[float, float, float, float]
    height: float = 4.0


def pack(recordings: Iterable[Recording], out: Path, *, progress: Callable[[int], None] | None = None) -> None:
    """Write the packed file of one or many recordings; it appears whole under its name, or not at all."""
    partial = out.with_name(out.name + ".partial")
    with h5py.File(partial, "w", libver="latest") as file:
        _Writer(file).write(recordings, progress)
    partial.replace(out)


class PackedFrames:
    """A packed file in memory: `points(k, rng)` per sensor and `objects(k)` of frame k, in the frame of its site."""

    def __init__(self, path: Path | str) -> None:
        try:
            with h5py.File(path, "r") as file:
                self._rig_of_frame = file["frames/rig"][:]
                self._ends = file["frames/ends"][:]  # (t, sensors + 1 at most), see _Writer
                self._pixels, self._steps = file["pixels"][:], file["steps"][:]
                self._boxes, self._labels = file["boxes"][:], file["labels"][:]
                self._box_ends = file["box_ends"][:]
                self.rigs = tuple(_Rig.read(file[f"rigs/{r}"]) for r in range(len(file["rigs"])))
        except (OSError, KeyError) as error:
            raise ValueError(f"{path} is not a whole packed file ({error}): make it again with coview pack") from error

    def __len__(self) -> int:
        return len(self._rig_of_frame)

    def area(self, k: int) -> tuple[float, float, float, float]:
        """Detection area of frame k: xmin ymin xmax ymax (m)."""
        return self.rigs[self._rig_of_frame[k]].area

    def sensors(self, k: int) -> int:
        """How many sensors frame k has."""
        return len(self.rigs[self._rig_of_frame[k]].sensors)

    def objects(self, k: int) -> Objects:
        """Ground truth of frame k, inside the area and around it."""
        start, end = self._box_ends[k], self._box_ends[k + 1]
        return Objects(self._boxes[start:end], self._labels[start:end])

    def points(
        self, k: int, rng: np.random.Generator, sensors: Iterable[int] | None = None
    ) -> list[Float32[np.ndarray, "_ 3"]]:
        """Cropped points of each chosen sensor (all when None) of frame k, with fresh noise."""
        rig = self.rigs[self._rig_of_frame[k]]
        chosen = range(len(rig.sensors)) if sensors is None else sensors
        clouds = []
        for s in chosen:
            start, end = self._ends[k, s], self._ends[k, s + 1]
            depth = self._steps[start:end].astype(np.float32) / STEPS_PER_METRE
            clouds.append(rig.points(s, self._pixels[start:end], depth, rng))
        return clouds


class _Rig:
    """The fixed sensors of one site, and of each the pixels (and their depth) that see the empty site in the crop."""

    def __init__(
        self,
        sensors: Sequence[Sensor],
        backgrounds: Sequence[np.ndarray],
        area: tuple[float, float, float, float],
        height: float,
    ) -> None:
        self.sensors, self.area, self.height = tuple(sensors), area, height
        self._low = np.array([area[0], area[1], 0.0], np.float32)
        self._high = np.array([area[2], area[3], height], np.float32)
        self.backgrounds = tuple(self._cut(s, b) for s, b in enumerate(backgrounds))

    @staticmethod
    def read(group: h5py.Group) -> _Rig:
        models = json.loads(group.attrs["sensors"])
        sensors = [
            Sensor(m["name"], _MODELS[m["type"]](**m["model"]), pose)
            for m, pose in zip(models, group["poses"][:], strict=True)
        ]
        backgrounds = [group[f"background/{s}"][:] for s in range(len(sensors))]
        return _Rig(sensors, backgrounds, tuple(group.attrs["area"].tolist()), float(group.attrs["height"]))

    def points(self, s: int, pixels: np.ndarray, depth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Noisy, cropped points where `pixels` show `depth` (0: nothing) and all others the background."""
        model, (back_pixels, back_depth) = self.sensors[s].model, self.backgrounds[s]
        changed = np.zeros(model.shape[0] * model.shape[1], bool)
        changed[pixels] = True
        still, seen = ~changed[back_pixels], depth > 0
        pixels = np.concatenate([back_pixels[still], pixels[seen]])
        depth = np.concatenate([back_depth[still], depth[seen]])
        depth += rng.standard_normal(len(depth), dtype=np.float32) * np.float32(model.sigma)
        points = self._world(s, pixels, depth)
        return points[self._inside(points, 0.0)]

    def near_crop(self, s: int, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Mask of returns inside the crop, give or take the margin."""
        return (depth > 0) & self._inside(self._world(s, pixels, depth), MARGIN)

    def _cut(self, s: int, background: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        depth = background.ravel()
        pixels = np.flatnonzero(self.near_crop(s, np.arange(len(depth)), depth))
        return pixels, depth[pixels]

    def _world(self, s: int, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
        sensor = self.sensors[s]
        rays = sensor.model.rays().reshape(-1, 3)[pixels] @ sensor.pose[:3, :3].T.astype(np.float32)
        return rays * depth[:, None] + sensor.position.astype(np.float32)

    def _inside(self, points: np.ndarray, margin: float) -> np.ndarray:
        return np.all((points > self._low - margin) & (points < self._high + margin), axis=1)


class _Writer:
    """Appends recordings to an open file."""

    def __init__(self, file: h5py.File) -> None:
        self.file = file
        self.total = 0
        self.pixels = self._growing("pixels", np.uint32)
        self.steps = self._growing("steps", np.uint16)

    def write(self, recordings: Iterable[Recording], progress: Callable[[int], None] | None) -> None:
        rig_of_frame: list[int] = []
        ends: list[np.ndarray] = []
        objects: list[Objects] = []
        for r, recording in enumerate(recordings):
            rig, backgrounds = self._rig(r, recording)
            for frame in recording.frames:
                ends.append(self._frame(rig, backgrounds, frame))
                rig_of_frame.append(r)
                objects.append(frame.objects)
                if progress:
                    progress(len(objects))
        if not objects:
            raise ValueError("nothing to pack: the recordings hold no frames")
        width = max(len(e) for e in ends)
        self.file["frames/rig"] = np.array(rig_of_frame, np.int32)
        self.file["frames/ends"] = np.stack([np.pad(e, (0, width - len(e)), mode="edge") for e in ends])
        self.file["boxes"] = np.concatenate([o.boxes for o in objects])
        self.file["labels"] = np.concatenate([o.labels for o in objects]).astype(np.int8)
        self.file["box_ends"] = np.concatenate([[0], np.cumsum([len(o) for o in objects])])

    def _rig(self, r: int, recording: Recording) -> tuple[_Rig, Sequence[np.ndarray]]:
        sensors = recording.frames[0].sensors
        backgrounds = empty_scene(recording.frames)
        group = self.file.create_group(f"rigs/{r}")
        group.attrs["area"], group.attrs["height"] = np.array(recording.area, np.float64), recording.height
        group.attrs["sensors"] = json.dumps(
            [{"name": s.name, "type": type(s.model).__name__, "model": asdict(s.model)} for s in sensors]
        )
        group["poses"] = np.stack([s.pose for s in sensors])
        for s, background in enumerate(backgrounds):
            group.create_dataset(f"background/{s}", data=background, compression="gzip", shuffle=True)
        return _Rig(sensors, backgrounds, recording.area, recording.height), backgrounds

    def _frame(self, rig: _Rig, backgrounds: Sequence[np.ndarray], frame: Frame) -> np.ndarray:
        ends = [self.total]
        for s, (measurement, background) in enumerate(zip(frame.measurements, backgrounds, strict=True)):
            pixels = np.flatnonzero(measurement != background).astype(np.uint32)
            depth = measurement.ravel()[pixels]
            depth = np.where(depth < FARTHEST, depth, 0).astype(np.float32)
            in_crop = rig.near_crop(s, pixels, depth)
            hides = np.isin(pixels, rig.backgrounds[s][0])  # occludes ground that would make a point
            keep = in_crop | hides
            steps = np.where(in_crop, np.maximum(np.rint(depth * STEPS_PER_METRE), 1), 0)
            self._append(pixels[keep], steps[keep].astype(np.uint16))
            ends.append(self.total)
        return np.array(ends, np.int64)

    def _append(self, pixels: np.ndarray, steps: np.ndarray) -> None:
        start, self.total = self.total, self.total + len(pixels)
        for dataset, values in ((self.pixels, pixels), (self.steps, steps)):
            dataset.resize(self.total, axis=0)
            dataset[start:] = values

    def _growing(self, name: str, dtype: type) -> h5py.Dataset:
        return self.file.create_dataset(
            name, (0,), dtype, maxshape=(None,), chunks=(1 << 18,), compression="gzip", compression_opts=1, shuffle=True
        )
