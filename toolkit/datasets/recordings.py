"""Recordings in any layout: opened, written and cut. A layout is a module of `toolkit.datasets.layouts`, or plugs in by
an entry point of the group `coview.layouts`, whose name is the layout's and whose value is a `Layout`."""

from __future__ import annotations

import inspect
import itertools
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np

from toolkit.datasets.records import ENDINGS, Listing
from toolkit.frame import Frame, Recording, RecordingView
from toolkit.objects import label_index
from toolkit.runtime.files import writing_folder

GROUP = "coview.layouts"


@dataclass(frozen=True)
class Layout:
    """A way to write recordings down. module: where its functions are; reader: from a path to a recording; writer: of
    frames at a path, None for a layout that is only read; file: it writes one file instead of a folder."""

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
        """The writer, which returns the number of frames; a folder appears whole. ValueError for a read-only layout."""
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


_BUILT_IN = "folder kitti openlabel dair opv2v v2xset v2xreal rcooper nuscenes argoverse sustech rosbag hdf5"
_MODULES, _READERS = {"v2xset": "opv2v", "v2xreal": "opv2v"}, {"v2xset": "opv2v"}  # of layouts that share them
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
    """Return a layout by name. Raises ValueError for an unknown one.

    >>> find_layout("kiti")
    Traceback (most recent call last):
    ValueError: there is no layout 'kiti': choose among folder, kitti, ...
    """
    layout = LAYOUTS.get(name) or load_plugins().get(name)
    if layout is None:
        raise ValueError(f"there is no layout {name!r}: choose among {', '.join([*LAYOUTS, *load_plugins()])}")
    return layout


_SIGNS = {  # files, one of which only folders of these layouts have
    ("folder",): ("poses.json", "poses.txt", "poses.csv", "labels.json"),
    ("kitti",): ("training/velodyne", "label_2"),
    ("dair",): ("label/virtuallidar", "label/lidar", "infrastructure-side", "cooperative-vehicle-infrastructure"),
    ("nuscenes",): ("v1.0*/sample_data.json", "sample_data.json"),
    ("argoverse",): ("sensors/lidar/*.feather",),
    ("sustech",): ("lidar/../label/*.json",),
    ("rcooper",): ("data/*/*/*/lidar",),
    ("rosbag",): ("metadata.yaml",),
    ("opv2v", "v2xset", "v2xreal"): ("*/[0-9]*.yaml", "*/*/[0-9]*.yaml"),
}
_BAGS, _HDF5 = (".bag", ".mcap", ".db3"), (".hdf5", ".h5")


def guess_layout(path: str | Path) -> str:
    """Guess the layout of a path by its ending or, in a folder, by files that only one layout has.

    Raises ValueError for a folder that several layouts might have written, and a file that none writes.

    >>> guess_layout("north.pcd"), guess_layout("night.bag"), guess_layout("monday.hdf5")
    ('folder', 'rosbag', 'hdf5')
    """
    path = Path(path)
    if not path.is_dir():
        ending = path.suffix.lower()
        layout = "folder" if ending in ENDINGS else "rosbag" if ending in _BAGS else "hdf5"
        if layout == "hdf5" and ending not in _HDF5 and path.is_file() and not _head(path).startswith(b"\x89HDF"):
            raise ValueError(f"{path} is no recording: its ending is none of {', '.join((*_HDF5, *_BAGS, *ENDINGS))}")
        return layout
    guessed = next((names for names, signs in _SIGNS.items() if any(map(any, map(path.glob, signs)))), ())
    if not guessed:
        some = next((each for each in (*path.glob("*.json"), *path.glob("*/*.json")) if each.is_file()), None)
        return "openlabel" if some is not None and b'"openlabel"' in _head(some) else "folder"
    if len(guessed) > 1:
        raise ValueError(f"{path} has layout {' or '.join(guessed)}: say by --layout which it is")
    return guessed[0]


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(200)


def open_recording(path: str | Path, layout: str | None = None, **options: object) -> Recording:
    """Open a recording; its frames are read one by one.

    layout: a name of `LAYOUTS` or of a plug-in, guessed by the path when None. options: of its reader, such as poses
    and inverted of folder, site and drop_invalid of hdf5; None and False are not given. Invalid labels and points are
    left out, and counted in `Frame.problems`.

    Raises FileNotFoundError for a missing recording; ValueError for an unknown layout, an option that its
    reader does not have, and a damaged file.
    """
    path, name = Path(path), layout or guess_layout(path)
    if layout is None and name not in ("folder", "hdf5"):
        warnings.warn(f"{path} is read as layout {name}: say --layout for another", stacklevel=2)
    reader = find_layout(name).open
    given = {key: value for key, value in options.items() if value is not None and value is not False}
    unknown = given.keys() - inspect.signature(reader).parameters.keys()
    if unknown:
        listed = ", ".join(f"--{key.replace('_', '-')}" for key in options if key in unknown)
        raise ValueError(f"{listed} does not go with layout {name}, which has its own: leave it out")
    if not path.exists() and name != "hdf5":
        raise FileNotFoundError(f"no such recording: {path}")
    recording = reader(path, **given)
    if not isinstance(recording, Listing):
        return recording
    if recording.strays:
        warnings.warn(f"{path}: {recording.describe_strays()}", stacklevel=2)
    return replace(recording, path=path)


def read(path: str | Path, layout: str | None = None, *, classes: Sequence[str | int] | None = None) -> Iterator[Frame]:
    """Yield the frames of a recording with only their objects of `classes`. Raises the errors of `open_recording`."""
    return filter_classes(open_recording(path, layout), classes)


def filter_classes(frames: Iterable[Frame], classes: Sequence[str | int] | None) -> Iterator[Frame]:
    """Yield frames with only their objects of some classes, None for all. Raises ValueError for an unknown class."""
    wanted = None if classes is None else [label_index(label) for label in classes]
    return (frame if wanted is None else frame.of(np.isin(frame.objects.labels, wanted)) for frame in frames)


def write_recording(frames: Iterable[Frame], path: str | Path, layout: str) -> int:
    """Write frames in a layout; return how many.

    Boxes come back within a millimetre and a hundredth of a degree; classes get the layout's names for ours. Raises
    ValueError for a read-only layout.
    """
    return find_layout(layout).write(frames, Path(path))


@dataclass(frozen=True)
class Part(RecordingView):
    """Part of a recording's frames: the first `frames`, None for all, of every `every`-th. Raises ValueError for
    numbers below 1, and for a recording without frames."""

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
