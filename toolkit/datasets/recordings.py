"""Recordings in any layout: opened, written and cut.

A layout is a module of `toolkit.datasets.layouts`, or plugs in by an entry point of the group
`coview.layouts`, whose name is the layout's and whose value is a `Layout`.

A frame as real sensors would measure it has errors that are drawn when the frame is read. Sensors
have their assumed poses, but measure from their true poses. Objects stay the truth."""

import inspect
import itertools
import warnings
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cache, cached_property
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import cast

import numpy as np

from toolkit.arrays import Float64
from toolkit.datasets.folders import BAG_ENDINGS, ENDINGS, list_bags
from toolkit.datasets.listing import Listing
from toolkit.frame import Frame, Frames, Recording, RecordingView
from toolkit.objects import label_index
from toolkit.runtime.writing import writing_folder
from toolkit.sensors.error_profiles import (
    PAPER_ERRORS,
    ErrorProfile,
    check_drawn,
    find_profile,
    only_own_noise,
)
from toolkit.sensors.readings import TrueImage
from toolkit.sensors.sensor import Sensor
from toolkit.sensors.track_velocities import velocities

GROUP = "coview.layouts"
_BUILT_IN = (
    "folder kitti openlabel dair opv2v v2xset v2xreal rcooper nuscenes argoverse sustech rosbag "
    "hdf5"
)
# modules of layouts that share them
_MODULES = {"v2xset": "opv2v", "v2xreal": "opv2v"}
_READERS = {"v2xset": "opv2v"}
_SIGNS = {  # files that only folders of these layouts have
    ("folder",): ("poses.json", "poses.txt", "poses.csv", "labels.json"),
    ("kitti",): ("training/velodyne", "label_2"),
    ("dair",): (
        "label/virtuallidar",
        "label/lidar",
        "infrastructure-side",
        "cooperative-vehicle-infrastructure",
    ),
    ("nuscenes",): ("v1.0*/sample_data.json", "sample_data.json"),
    ("argoverse",): ("sensors/lidar/*.feather",),
    ("sustech",): ("lidar/../label/*.json",),
    ("rcooper",): ("data/*/*/*/lidar",),
    ("rosbag",): ("metadata.yaml",),
    ("opv2v", "v2xset", "v2xreal"): ("*/[0-9]*.yaml", "*/*/[0-9]*.yaml"),
}
_HDF5 = (".hdf5", ".h5")


@dataclass(frozen=True)
class Layout:
    """File layout of recordings.

    Attributes:
        name: its name.
        module: module with its functions.
        reader: function from a path to a recording.
        writer: function that writes frames at a path, None for a layout that is only read.
        file: True if it writes one file instead of a folder.
    """

    name: str
    module: str
    reader: str
    writer: str | None = None
    file: bool = False

    @property
    def open(self) -> Callable[..., Recording]:
        """The reader."""
        return getattr(import_module(self.module), self.reader)

    @property
    def write(self) -> Callable[[Iterable[Frame], Path], int]:
        """The writer, which returns the number of frames; a folder appears whole.

        Raises ValueError for a read-only layout."""
        if self.writer is None:
            raise ValueError(f"layout {self.name} is only read: write another, such as folder")
        writer = getattr(import_module(self.module), self.writer)

        def write_whole(frames: Iterable[Frame], path: Path) -> int:
            numbers = itertools.count()
            counted = (frame for frame, _ in zip(frames, numbers, strict=False))
            with nullcontext(path) if self.file else writing_folder(path) as unfinished:
                writer(counted, unfinished)
            return next(numbers)

        return write_whole


LAYOUTS = {
    name: Layout(
        *(name, f"toolkit.datasets.layouts.{_MODULES.get(name, name)}", _READERS.get(name, name)),
        writer=None if name == "rcooper" else f"write_{_READERS.get(name, name)}",
        file=name == "hdf5",
    )
    for name in _BUILT_IN.split()
}


@cache
def load_plugins() -> dict[str, Layout]:
    """Layouts that other packages bring, by name."""
    return {point.name: point.load() for point in entry_points(group=GROUP)}


def find_layout(name: str) -> Layout:
    """Return a layout by name. Raises ValueError for an unknown one."""
    layout = LAYOUTS.get(name) or load_plugins().get(name)
    if layout is None:
        raise ValueError(
            f"there is no layout {name!r}: choose among {', '.join([*LAYOUTS, *load_plugins()])}"
        )
    return layout


def guess_layout(path: str | Path) -> str:
    """Guess the layout of a path by its ending or, in a folder, by files that only one layout has.

    Raises ValueError for a folder that several layouts might have written, and a file that no
    layout writes."""
    path = Path(path)
    if not path.is_dir():
        ending = path.suffix.lower()
        if ending in ENDINGS:
            return "folder"
        if ending in BAG_ENDINGS:
            return "rosbag"
        is_unknown = ending not in _HDF5 and path.is_file()
        if is_unknown and not _head(path).startswith(b"\x89HDF"):
            raise ValueError(
                f"{path} is no recording: its ending is none of "
                f"{', '.join((*_HDF5, *BAG_ENDINGS, *ENDINGS))}"
            )
        return "hdf5"
    guessed = next(
        (names for names, signs in _SIGNS.items() if any(map(any, map(path.glob, signs)))), ()
    )
    labels = path / "labels.json"
    if guessed == ("folder",) and labels.is_file() and b'"openlabel"' in _head(labels):
        guessed = ("openlabel",)
    if not guessed and list_bags(path):
        has_clouds = any(
            file.suffix.lower() in ENDINGS for file in (*path.glob("*"), *path.glob("*/*"))
        )
        guessed = () if has_clouds else ("rosbag",)
    if not guessed:
        candidates = (*path.glob("*.json"), *path.glob("*/*.json"))
        json_file = next((candidate for candidate in candidates if candidate.is_file()), None)
        is_openlabel = json_file is not None and b'"openlabel"' in _head(json_file)
        return "openlabel" if is_openlabel else "folder"
    if len(guessed) > 1:
        raise ValueError(f"{path} has layout {' or '.join(guessed)}: say by --layout which it is")
    return guessed[0]


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(200)


def open_recording(path: str | Path, layout: str | None = None, **options: object) -> Recording:
    """Open a recording; its frames are read one by one.

    layout: a name of `LAYOUTS` or of a plug-in, guessed by the path if None. options: options of
    its reader, such as poses and inverted of folder, site and drop_invalid of hdf5; None and False
    are not passed on. Invalid labels and points are left out, and counted in `Frame.problems`.

    Raises FileNotFoundError for a missing recording; ValueError for an unknown layout, an option
    that its reader does not have, and a damaged file."""
    path = Path(path)
    name = layout or guess_layout(path)
    if layout is None and name not in ("folder", "hdf5"):
        warnings.warn(f"{path} is read as layout {name}: say --layout for another", stacklevel=2)
    reader = find_layout(name).open
    reader_options = {
        key: value for key, value in options.items() if value is not None and value is not False
    }
    unknown = reader_options.keys() - inspect.signature(reader).parameters.keys()
    if unknown:
        listed = ", ".join(f"--{key.replace('_', '-')}" for key in options if key in unknown)
        raise ValueError(
            f"{listed} does not go with layout {name}, which has its own: leave it out"
        )
    if not path.exists() and name != "hdf5":
        raise FileNotFoundError(f"no such recording: {path}")
    recording = reader(path, **reader_options)
    if not isinstance(recording, Listing):
        return recording
    if recording.strays:
        warnings.warn(f"{path}: {recording.describe_strays()}", stacklevel=2)
    return replace(recording, path=path, load=_Loader(path, name, reader_options, recording.load))


@dataclass(frozen=True, eq=False)
class _Loader:
    """Read a frame by its name, also after a copy or in another process, which reopens the
    recording.

    Attributes:
        path: path of the recording.
        layout: its layout.
        options: options of the reader.
        load: the reader's function; None until it is needed in another process.
    """

    path: Path
    layout: str
    options: dict[str, object]
    load: Callable[[str], Frame] | None = None

    def __call__(self, name: str) -> Frame:
        return self._load(name)

    @cached_property
    def _load(self) -> Callable[[str], Frame]:
        if self.load is not None:
            return self.load
        recording = find_layout(self.layout).open(self.path, **self.options)
        return cast("Listing", recording).load

    def __getstate__(self) -> dict[str, object]:
        return {"path": self.path, "layout": self.layout, "options": self.options, "load": None}

    def __copy__(self) -> "_Loader":
        return self

    def __deepcopy__(self, memo: dict[int, object]) -> "_Loader":
        return self


def read(
    path: str | Path, layout: str | None = None, *, classes: Sequence[str | int] | None = None
) -> Iterator[Frame]:
    """Yield the frames of a recording with only their objects of `classes`.

    Raises the errors of `open_recording`."""
    return filter_classes(open_recording(path, layout), classes)


def filter_classes(frames: Iterable[Frame], classes: Sequence[str | int] | None) -> Iterator[Frame]:
    """Yield frames with only their objects of some classes, None for all.

    Raises ValueError for an unknown class."""
    class_numbers = None if classes is None else [label_index(label) for label in classes]
    return (
        frame if class_numbers is None else frame.of(np.isin(frame.objects.labels, class_numbers))
        for frame in frames
    )


def write_recording(frames: Iterable[Frame], path: str | Path, layout: str) -> int:
    """Write frames in a layout; return how many.

    Boxes come back within a millimetre and a hundredth of a degree; classes get the layout's names.
    Raises ValueError for a read-only layout."""
    return find_layout(layout).write(frames, Path(path))


@dataclass(frozen=True)
class Part(RecordingView):
    """Part of a recording's frames: the first `frames`, None for all, of every `every`-th.

    Raises ValueError for numbers below 1, and for a recording without frames."""

    frames: int | None = None
    every: int = 1

    def __post_init__(self) -> None:
        for name, value in (("every", self.every), ("frames", self.frames)):
            if value is not None and value < 1:
                raise ValueError(f"{name} must be at least 1, got {value}: leave it out for all")
        if not len(self.recording):
            raise ValueError("there is no frame in the recording: check the path and the layout")

    def __len__(self) -> int:
        count = -(-len(self.recording) // self.every)
        return count if self.frames is None else min(self.frames, count)

    def __getitem__(self, number: int) -> Frame:
        """Return the chosen frame of this number. Raises IndexError for an unknown one."""
        if not 0 <= number < len(self):
            raise IndexError(f"there is no frame {number}: {len(self)} are chosen, counted from 0")
        return self.recording[number * self.every]


@dataclass(frozen=True)
class Reads:
    """Options for reading a recording: sensor errors and length.

    errors: a profile or its name, only `paper` for recorded clouds, whose sensors have real errors;
    noise_seed: seed of the errors, None for no noise; frames: number of frames, None for all."""

    errors: ErrorProfile | str = PAPER_ERRORS
    noise_seed: int | None = 0
    frames: int | None = None

    def count(self, recording: Frames) -> int:
        """Number of frames to read. Raises ValueError if it is 0, and for a `frames` that is not
        whole."""
        total = min(len(recording), len(recording) if self.frames is None else self.frames)
        if total < 1 or isinstance(self.frames, float):
            raise ValueError(
                f"need one frame at least, a whole number, got {self.frames} of {len(recording)}"
            )
        return total

    def profile(self) -> ErrorProfile:
        """Return the error profile. Raises ValueError."""
        errors = find_profile(self.errors)
        check_drawn(errors, self.noise_seed)
        return errors


@dataclass(frozen=True)
class ReadRecording(RecordingView):
    """A recording with its sensors' errors, without limit on frames."""

    reads: Reads = Reads()

    def __getitem__(self, index: int) -> Frame:
        return read_frame(
            self.recording, index, errors=self.reads.errors, noise_seed=self.reads.noise_seed
        )


def read_frame(
    frames: Frames, k: int, *, errors: ErrorProfile | str = PAPER_ERRORS, noise_seed: int | None = 0
) -> Frame:
    """Read frame k with its sensors' errors, drawn from the seed.

    A seed of None means no noise, which only `paper` allows. Raises ValueError for an unknown
    profile, a negative seed, and a clock's offset if frames are too far apart to know
    velocities."""
    errors = find_profile(errors)
    frame = frames[k]
    check_drawn(errors, noise_seed)
    if noise_seed is None or not frame.has_images:
        if noise_seed is not None and errors.name != PAPER_ERRORS.name:
            raise ValueError(
                f"recorded clouds have errors of their own, got errors {errors.name!r}: leave "
                "them out"
            )
        return frame
    speed = None
    if errors.needs_velocities:
        around = [frames[index] for index in (k - 1, k + 1) if 0 <= index < len(frames)]
        speed = velocities(
            frame.objects, frame.time, [(neighbour.objects, neighbour.time) for neighbour in around]
        )
    return with_errors(frame, errors, noise_seed, velocities=speed)


def block_seed(seed: int, block: int) -> int:
    """Seed of the errors of one block of frames, as if all sensors were mounted again."""
    return int(np.random.default_rng([seed, block]).integers(2**31))


def with_errors(
    frame: Frame,
    errors: ErrorProfile | str,
    seed: int,
    *,
    velocities: Float64[np.ndarray, "n 3"] | None = None,
    numbers: Sequence[int] | None = None,
) -> Frame:
    """Add sensor errors to a frame, drawn from the seed, its index and each sensor's name.

    So a sensor measures the same whichever others are used. velocities: velocities of its objects
    (m/s), needed for a clock's offset; numbers: used instead of the sensors' names when drawing.
    Raises ValueError for a negative seed."""
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed}")
    errors = find_profile(errors)
    if numbers is None:
        numbers = [zlib.crc32(sensor.name.encode()) for sensor in frame.sensors]
    measured = list(zip(frame.sensors, frame.images, numbers, strict=True))
    if only_own_noise(errors):  # as `errors.read` draws it
        drawn = []
        for sensor, image, number in measured:
            rng = np.random.default_rng([seed, frame.index, number])
            drawn.append(sensor.model.noisy(image, rng))
        return replace(frame, measurements=tuple(drawn))
    readings = []
    assumed_sensors = []
    for sensor, measurement, number in measured:
        true = TrueImage(sensor, measurement, frame.objects, frame.time, velocities)
        reading = errors.read(true, seed=seed, sensor=number, frame=frame.index)
        readings.append(reading)
        if reading.pose is not sensor.pose:
            sensor = Sensor(sensor.name, sensor.model, reading.pose)
        assumed_sensors.append(sensor)
    measurements = tuple(reading.measurement for reading in readings)
    shifts = tuple(reading.shift for reading in readings)
    shifts = shifts if any(shift is not None for shift in shifts) else ()
    return replace(frame, sensors=tuple(assumed_sensors), measurements=measurements, shifts=shifts)
