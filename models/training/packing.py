"""Writer of packed files (`models.training.packed`). Only pixels that differ from the empty site
are written."""

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import chain, groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import SupportsFloat

import h5py
import numpy as np

from models.training.packed import MARGIN, STEPS_PER_METRE, PackedFrames, Rig
from toolkit.arrays import Float32, Shaped
from toolkit.datasets.dataset import CoopDataset
from toolkit.frame import Frame, empty_scene
from toolkit.geometry import LEVEL, Slope
from toolkit.objects import Objects
from toolkit.runtime.files import writing
from toolkit.runtime.hdf5 import hdf5_file
from toolkit.sensors.models import SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

FARTHEST = (2**16 - 1) / STEPS_PER_METRE  # m
_CHUNK = 1 << 18
_Progress = Callable[[int], None]


@dataclass(frozen=True)
class Change:
    """Changes of one frame from the empty site."""

    pixels: tuple[Shaped[np.ndarray, " _"], ...]
    steps: tuple[Shaped[np.ndarray, " _"], ...]
    objects: Objects
    clouds: tuple[Float32[np.ndarray, "_ 3"], ...] | None = None


PackedRecording = tuple[Rig, Iterable[Change]]  # frames of one rig, ready to be written
LevelSample = tuple[
    tuple[str, ...], tuple[np.ndarray, ...], Objects, tuple[float, float, float, float]
]
"""Names of the sensors, their points (n, 3) on level ground, labelled objects, and area: xmin ymin
xmax ymax (m)."""


def recording(
    frames: Sequence[Frame],
    area: Iterable[SupportsFloat],
    height: float = 4.0,
    *,
    empty: Sequence[np.ndarray] | None = None,
    count: int | None = None,
    slope: Slope = LEVEL,
) -> PackedRecording:
    """Return frames of fixed sensors, each read when it is written.

    area: xmin ymin xmax ymax (m), height: of the crop (m); empty: measurements of the empty site
    per sensor, None to take them from the frames; count: only the first frames; slope: of the
    ground (m per m, x and y)."""
    empty = empty_scene(frames).images if empty is None else empty
    rig = Rig.seeing(frames[0].sensors, area, height, empty, slope)
    chosen = range(min(len(frames), len(frames) if count is None else count))
    return rig, (change(rig, frames[k]) for k in chosen)


def dataset_recording(dataset: CoopDataset, count: int | None = None) -> PackedRecording:
    """Return a recorded dataset, or its first `count` frames."""
    site = dataset.site
    return recording(dataset, site.area, site.height, count=count, slope=site.relief.slope)


def sample_recordings(
    samples: Iterable[LevelSample], height: float = 4.0
) -> Iterator[PackedRecording]:
    """Yield a recording for each run of samples with the same sensors and area. They must be
    written in order."""
    for (sensors, area), group in groupby(samples, key=lambda each: (each[0], each[3])):
        nothing = (np.zeros(0, np.uint32),) * len(sensors)
        still = (np.zeros(0, np.float32),) * len(sensors)
        stands = tuple(Sensor(name, SpinningLidar(), np.eye(4)) for name in sensors)
        changes = (
            Change(nothing, nothing, objects, tuple(clouds)) for _, clouds, objects, _ in group
        )
        yield Rig(stands, area, height, nothing, still), changes


def read_recordings(path: Path) -> list[PackedRecording]:
    """Read a packed file to write it again."""
    packed = PackedFrames(path)
    frames_of: list[list[Change]] = [[] for _ in packed.rigs]
    for k in range(len(packed)):
        pixels, steps = packed.changes(k)
        clouds = tuple(packed.points(k, None)) if packed.is_recorded(k) else None
        change = Change(tuple(pixels), tuple(steps), packed.objects(k), clouds)
        frames_of[packed.rigs.index(packed.rig(k))].append(change)
    return list(zip(packed.rigs, frames_of, strict=True))


def drawn_file(drawn: tuple[Site, tuple[Frame, ...], tuple[np.ndarray, ...]]) -> bytes:
    """Content of the packed file of a random site, its frames, and each sensor's measurement
    without traffic."""
    site, frames, empty = drawn
    with TemporaryDirectory() as folder:
        path = Path(folder, "one.packed")
        pack(
            [recording(frames, site.area, site.height, empty=empty, slope=site.relief.slope)], path
        )
        return path.read_bytes()


def join_packed(paths: Iterable[Path], unfinished: Path) -> int:
    """Write several packed files as one, and return the number of frames. Raises ValueError without
    any frame."""
    with hdf5_file(unfinished) as (file, check):
        return _write(file, (each for path in paths for each in read_recordings(path)), check)


def change(rig: Rig, frame: Frame) -> Change:
    """Find pixels that show something in the crop that the empty site does not, or the reverse."""
    pixels = []
    steps = []
    for s, measurement in enumerate(frame.images):
        still = np.zeros(measurement.size, np.float32)
        flat = measurement.ravel()
        still[rig.pixels[s]] = rig.depth[s]
        places = np.flatnonzero(flat != still).astype(np.uint32)
        depth = np.where(flat[places] < FARTHEST, flat[places], np.float32(0))
        seen = (depth > 0) & rig.in_crop(rig.world(s, places, depth), MARGIN)
        counts = seen | (still[places] > 0)  # or hides a point of the empty site
        pixels.append(places[counts])
        rounded = np.where(seen, np.maximum(np.rint(depth * STEPS_PER_METRE), 1), 0)
        steps.append(rounded.astype(np.uint16)[counts])
    return Change(tuple(pixels), tuple(steps), frame.objects)


def pack(
    recordings: Iterable[PackedRecording], out: Path, *, progress: _Progress | None = None
) -> int:
    """Write a packed file, complete or not at all, and return its number of frames. Raises
    ValueError without any frame, OSError if the disk is full."""
    with writing(out) as unfinished, hdf5_file(unfinished) as (file, check):
        return _write(file, recordings, check, progress)


def _write(
    file: h5py.File,
    recordings: Iterable[PackedRecording],
    check: Callable[[], None],
    progress: _Progress | None = None,
) -> int:
    pixels = _Column(file, "pixels", np.uint32)
    steps = _Column(file, "steps", np.uint16)
    rig_of_frame = list[int]()
    ends = list[np.ndarray]()
    objects = list[Objects]()
    recorded: dict[int, tuple[np.ndarray, ...]] = {}
    file.create_group("rigs")
    for r, (rig, changes) in enumerate(recordings):
        group = file.create_group(f"rigs/{r}")
        group.attrs["area"] = np.array(rig.area, np.float64)
        group.attrs["height"] = rig.height
        if rig.slope != LEVEL:
            group.attrs["slope"] = np.array(rig.slope, np.float64)
        models = [
            {"name": s.name, "type": type(s.model).__name__, "model": asdict(s.model)}
            for s in rig.sensors
        ]
        group.attrs["sensors"] = json.dumps(models)
        group["poses"] = np.stack([sensor.pose for sensor in rig.sensors])
        group["ends"] = np.cumsum([len(view) for view in rig.pixels])
        for name, columns in (("pixels", rig.pixels), ("depth", rig.depth)):
            data = np.concatenate(columns)
            group.create_dataset(
                name, data=data, compression="gzip" if len(data) else None, shuffle=len(data) > 0
            )
        for found in changes:
            ends.append(np.cumsum([pixels.length, *map(len, found.pixels)]))
            for pixel, step in zip(found.pixels, found.steps, strict=True):
                pixels.append(pixel)
                steps.append(step)
            if found.clouds is not None:
                metres = (np.asarray(cloud, np.float64) for cloud in found.clouds)
                recorded[len(objects)] = tuple(
                    np.rint(each * STEPS_PER_METRE).astype(np.int32) for each in metres
                )
            rig_of_frame.append(r)
            objects.append(found.objects)
            check()
            if progress:
                progress(len(objects))
    if not objects:
        raise ValueError("nothing to pack: the recordings hold no frames")
    pixels.flush()
    steps.flush()
    file["frames/rig"] = np.array(rig_of_frame, np.int32)
    file["frames/ends"] = _of_one_length(ends)
    file["boxes"] = np.concatenate([each.boxes for each in objects])
    file["labels"] = np.concatenate([each.labels for each in objects]).astype(np.int8)
    file["box_ends"] = np.cumsum([0, *map(len, objects)])
    if recorded:
        sizes = [[len(cloud) for cloud in clouds] for clouds in recorded.values()]
        starts = np.cumsum([0, *map(sum, sizes[:-1])])
        points = np.concatenate([np.zeros((0, 3), np.int32), *chain(*recorded.values())])
        file["clouds/frames"] = np.array(list(recorded), np.int64)
        file["clouds/ends"] = _of_one_length(
            [np.cumsum([at, *each]) for at, each in zip(starts, sizes, strict=True)]
        )
        options = (
            {"compression": "gzip", "compression_opts": 1, "shuffle": True} if len(points) else {}
        )
        file.create_dataset("clouds/points", data=points, **options)
    return len(objects)


def _of_one_length(ends: Sequence[np.ndarray]) -> np.ndarray:
    most = max(map(len, ends))
    return np.stack([np.pad(each, (0, most - len(each)), mode="edge") for each in ends])


class _Column:
    """Growing array of a file, written by chunks."""

    def __init__(self, file: h5py.File, name: str, dtype: type) -> None:
        options = {
            "chunks": (_CHUNK,),
            "compression": "gzip",
            "compression_opts": 1,
            "shuffle": True,
        }
        self._dataset = file.create_dataset(name, (0,), dtype, maxshape=(None,), **options)
        self._pending: list[np.ndarray] = []
        self._written = self.length = 0

    def append(self, values: np.ndarray) -> None:
        self._pending.append(values)
        self.length += len(values)
        if self.length - self._written >= 8 * _CHUNK:
            self.flush()

    def flush(self) -> None:
        self._dataset.resize(self.length, axis=0)
        if self.length > self._written:
            self._dataset[self._written :] = np.concatenate(self._pending)
        self._written = self.length
        self._pending.clear()
