"""Writer of packed files (`models.training.packed`).

Only pixels that differ from the empty site are written.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import chain, groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, SupportsFloat

import h5py
import numpy as np

from models.training.packed import CROP_MARGIN_M, STEPS_PER_METRE, Area, PackedFrames, Rig
from toolkit.arrays import Float32, Shaped
from toolkit.datasets.dataset import CoopDataset
from toolkit.frame import Frame, empty_scene
from toolkit.geometry import LEVEL, Slope
from toolkit.objects import Objects
from toolkit.runtime.hdf5 import hdf5_file
from toolkit.runtime.writing import writing
from toolkit.sensors.models import SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

MAX_DEPTH_M = (2**16 - 1) / STEPS_PER_METRE  # steps are uint16
_CHUNK = 1 << 18  # values
_Progress = Callable[[int], None]  # takes the number of frames so far


@dataclass(frozen=True)
class Change:
    """Changes of one frame from the empty site.

    Attributes:
        pixels: Numbers of the changed pixels of each sensor.
        steps: Their measurements in 1/512 m, 0 for none.
        objects: Objects of the frame.
        clouds: Points of each sensor on level ground, if the frame has recorded clouds.
    """

    pixels: tuple[Shaped[np.ndarray, " _"], ...]
    steps: tuple[Shaped[np.ndarray, " _"], ...]
    objects: Objects
    clouds: tuple[Float32[np.ndarray, "_ 3"], ...] | None = None


PackedRecording = tuple[Rig, Iterable[Change]]  # frames of one rig, ready to be written
LevelSample = tuple[tuple[str, ...], tuple[np.ndarray, ...], Objects, Area]
"""Names of the sensors, their points (n, 3) on level ground, labelled objects, and area."""


def recording(
    frames: Sequence[Frame],
    area: Iterable[SupportsFloat],
    height: float = 4.0,
    *,
    empty: Sequence[np.ndarray] | None = None,
    count: int | None = None,
    slope: Slope = LEVEL,
) -> PackedRecording:
    """Frames of fixed sensors, ready to be packed; each is read when it is written.

    area: xmin ymin xmax ymax (m), height: top of the crop above the ground (m); empty: measurements
    of the empty site per sensor, None to take them from the frames; count: only so many of the
    first frames; slope: the ground's (m per m, x and y).
    """
    empty = empty_scene(frames).images if empty is None else empty
    rig = Rig.seeing(frames[0].sensors, area, height=height, empty=empty, slope=slope)
    frame_numbers = range(min(len(frames), len(frames) if count is None else count))
    return rig, (change(rig, frames[k]) for k in frame_numbers)


def dataset_recording(dataset: CoopDataset, count: int | None = None) -> PackedRecording:
    """Dataset, or its first `count` frames, ready to be packed."""
    site = dataset.site
    return recording(dataset, site.area, site.height, count=count, slope=site.relief.slope)


def sample_recordings(
    samples: Iterable[LevelSample], height: float = 4.0
) -> Iterator[PackedRecording]:
    """Yield a recording of clouds for each run of samples with the same sensors and area.

    Its frames read on in `samples`, so each must be written before the next is taken. Rigs have no
    view of the empty site, and sensors no meaningful pose or model. height: top of the crop above
    the ground (m).
    """

    def sensors_and_area(sample: LevelSample) -> tuple[tuple[str, ...], Area]:
        names, _, _, area = sample
        return names, area

    # a sample has names of sensors, a cloud of each, objects and area
    for (names, area), run in groupby(samples, key=sensors_and_area):
        no_pixels = (np.zeros(0, np.uint32),) * len(names)
        no_depth = (np.zeros(0, np.float32),) * len(names)
        rig = Rig(
            sensors=tuple(Sensor(name, SpinningLidar(), np.eye(4)) for name in names),
            area=area,
            height=height,
            pixels=no_pixels,
            depth=no_depth,
        )
        changes = (
            Change(pixels=no_pixels, steps=no_pixels, objects=objects, clouds=tuple(clouds))
            for _, clouds, objects, _ in run
        )
        yield rig, changes


def read_recordings(path: Path) -> list[PackedRecording]:
    """Recordings of a packed file, one for each rig, ready to be packed again."""
    packed = PackedFrames(path)
    changes_by_rig: list[list[Change]] = [[] for _ in packed.rigs]
    # frames of all rigs, in the order of the file
    for k in range(len(packed)):
        pixels, steps = packed.changes(k)
        clouds = tuple(packed.points(k, rng=None)) if packed.is_recorded(k) else None
        frame_change = Change(
            pixels=tuple(pixels), steps=tuple(steps), objects=packed.objects(k), clouds=clouds
        )
        changes_by_rig[packed.rigs.index(packed.rig(k))].append(frame_change)
    return list(zip(packed.rigs, changes_by_rig, strict=True))


def encode_packed_file(drawn: tuple[Site, tuple[Frame, ...], tuple[np.ndarray, ...]]) -> bytes:
    """Content of the packed file of a random site.

    drawn: the site, its frames, and each sensor's image (m) of the site without traffic.
    """
    site, frames, empty = drawn
    with TemporaryDirectory() as folder:
        path = Path(folder, "one.packed")
        pack(
            [recording(frames, site.area, site.height, empty=empty, slope=site.relief.slope)], path
        )
        return path.read_bytes()


def join_packed_files(paths: Iterable[Path], unfinished: Path) -> int:
    """Write several packed files as one, and return the number of frames.

    unfinished: file to write. Raises ValueError without any frame.
    """
    # check: function that raises OSError once the disk failed
    with hdf5_file(unfinished) as (file, check):
        recordings = (recording for path in paths for recording in read_recordings(path))
        return _write(file, recordings, check)


def change(rig: Rig, frame: Frame) -> Change:
    """Pixels that show something in the crop that the empty site does not, or the reverse.

    rig: sensors and their view of the empty site; frame: images of the same sensors. The result
    has pixels and measurements (in 1 / `STEPS_PER_METRE` m, 0 for nothing) of each sensor, and the
    frame's objects."""
    pixels = []
    steps = []
    for s, image in enumerate(frame.images):
        empty_depth = np.zeros(image.size, np.float32)  # 0 outside the crop
        empty_depth[rig.pixels[s]] = rig.depth[s]
        image_depth = image.ravel()
        changed_pixels = np.flatnonzero(image_depth != empty_depth).astype(np.uint32)
        changed_depth = image_depth[changed_pixels]
        depth = np.where(changed_depth < MAX_DEPTH_M, changed_depth, np.float32(0))
        is_in_crop = (depth > 0) & rig.in_crop(rig.world(s, changed_pixels, depth), CROP_MARGIN_M)
        # or hides a point of the empty site
        is_counted = is_in_crop | (empty_depth[changed_pixels] > 0)
        pixels.append(changed_pixels[is_counted])
        # at least one step, since 0 means nothing
        rounded = np.where(is_in_crop, np.maximum(np.rint(depth * STEPS_PER_METRE), 1), 0)
        steps.append(rounded.astype(np.uint16)[is_counted])
    return Change(pixels=tuple(pixels), steps=tuple(steps), objects=frame.objects)


def pack(
    recordings: Iterable[PackedRecording], out: Path, *, progress: _Progress | None = None
) -> int:
    """Write a packed file, complete or not at all, and return its number of frames.

    recordings: rigs with their frames; progress: called with the number of frames done, None for
    silence.

    Raises ValueError without any frame, OSError if the disk is full.
    """
    with writing(out) as unfinished, hdf5_file(unfinished) as (file, check):
        return _write(file, recordings, check, progress)


def _write(
    file: h5py.File,
    recordings: Iterable[PackedRecording],
    check: Callable[[], None],
    progress: _Progress | None = None,
) -> int:
    """Write recordings to an open file, and return the number of frames.

    check: raises OSError if the disk is full.
    """
    pixels = _Column(file, "pixels", np.uint32)
    steps = _Column(file, "steps", np.uint16)
    rig_of_frame = list[int]()
    ends = list[np.ndarray]()  # by frame: begin of each sensor's pixels, end of the last
    objects = list[Objects]()
    recorded: dict[int, tuple[np.ndarray, ...]] = {}  # clouds in steps, by number of the frame
    file.create_group("rigs")
    for r, (rig, changes) in enumerate(recordings):
        _write_rig(file.create_group(f"rigs/{r}"), rig)
        for frame_change in changes:
            ends.append(np.cumsum([pixels.length, *map(len, frame_change.pixels)]))
            for sensor_pixels, sensor_steps in zip(
                frame_change.pixels, frame_change.steps, strict=True
            ):
                pixels.append(sensor_pixels)
                steps.append(sensor_steps)
            if frame_change.clouds is not None:
                recorded[len(objects)] = tuple(map(_count_steps, frame_change.clouds))
            rig_of_frame.append(r)
            objects.append(frame_change.objects)
            check()
            if progress:
                progress(len(objects))
    if not objects:
        raise ValueError("nothing to pack: the recordings hold no frames")
    pixels.flush()
    steps.flush()
    file["frames/rig"] = np.array(rig_of_frame, np.int32)
    file["frames/ends"] = _of_one_length(ends)
    file["boxes"] = np.concatenate([frame_objects.boxes for frame_objects in objects])
    labels = np.concatenate([frame_objects.labels for frame_objects in objects])
    file["labels"] = labels.astype(np.int8)
    file["box_ends"] = np.cumsum([0, *map(len, objects)])
    if recorded:
        _write_clouds(file, recorded)
    return len(objects)


def _write_rig(group: h5py.Group, rig: Rig) -> None:
    """Write the sensors, the crop and the empty site of a rig to its group.

    The pixels and depths of all sensors are concatenated; "ends" holds the end of each sensor's."""
    group.attrs["area"] = np.array(rig.area, np.float64)
    group.attrs["height"] = rig.height
    if rig.slope != LEVEL:
        group.attrs["slope"] = np.array(rig.slope, np.float64)
    models = [
        {"name": sensor.name, "type": type(sensor.model).__name__, "model": asdict(sensor.model)}
        for sensor in rig.sensors
    ]
    group.attrs["sensors"] = json.dumps(models)
    group["poses"] = np.stack([sensor.pose for sensor in rig.sensors])
    group["ends"] = np.cumsum([len(view) for view in rig.pixels])
    for name, columns in (("pixels", rig.pixels), ("depth", rig.depth)):
        data = np.concatenate(columns)
        # HDF5 cannot compress an empty dataset
        group.create_dataset(
            name, data=data, compression="gzip" if len(data) else None, shuffle=len(data) > 0
        )


def _write_clouds(file: h5py.File, recorded: dict[int, tuple[np.ndarray, ...]]) -> None:
    """Write recorded clouds to the group "clouds", their points one after another.

    recorded: for the number of a frame, the points of each sensor (n, 3), in steps of the file."""
    # number of points of each sensor, for each frame
    sizes = [list(map(len, clouds)) for clouds in recorded.values()]
    # rows of the points: for each frame the first one, and then the end of each sensor's
    starts = np.cumsum([0, *map(sum, sizes[:-1])])
    ends = [np.cumsum([start, *row]) for start, row in zip(starts, sizes, strict=True)]
    points = np.concatenate([np.zeros((0, 3), np.int32), *chain(*recorded.values())])
    file["clouds/frames"] = np.array(list(recorded), np.int64)
    file["clouds/ends"] = _of_one_length(ends)
    options: dict[str, Any] = {}
    if len(points):
        options = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
    file.create_dataset("clouds/points", data=points, **options)


def _count_steps(cloud: np.ndarray) -> np.ndarray:
    """Coordinates (m) in whole steps of 1/512 m."""
    return np.rint(np.asarray(cloud, np.float64) * STEPS_PER_METRE).astype(np.int32)


def _of_one_length(ends: Sequence[np.ndarray]) -> np.ndarray:
    """Rows as one array; shorter ones repeat their last entry, which adds empty sensors."""
    length = max(map(len, ends))
    return np.stack([np.pad(row, (0, length - len(row)), mode="edge") for row in ends])


class _Column:
    """Growing array of a file, written by chunks."""

    def __init__(self, file: h5py.File, name: str, dtype: type) -> None:
        """Make the array in a file, empty. name: its path; dtype: type of its numbers."""
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
        """Add values at the end; they are written when enough are pending, or by `flush`."""
        self._pending.append(values)
        self.length += len(values)
        if self.length - self._written >= 8 * _CHUNK:
            self.flush()

    def flush(self) -> None:
        """Write all pending values."""
        self._dataset.resize(self.length, axis=0)
        if self.length > self._written:
            self._dataset[self._written :] = np.concatenate(self._pending)
        self._written = self.length
        self._pending.clear()
