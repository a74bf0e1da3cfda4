"""Recordings of any layout, opened by name or by their files."""

import inspect
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cache, cached_property
from importlib.metadata import entry_points
from pathlib import Path
from typing import cast

from toolkit.datasets.folders import BAG_ENDINGS, ENDINGS, PCAP_ENDINGS, list_bags
from toolkit.datasets.layout import Layout
from toolkit.datasets.listing import Listing
from toolkit.frame import Frame, Recording

GROUP = "coview.layouts"
_BUILT_IN = (
    "folder kitti kitti-tracking openlabel dair opv2v v2xset v2xreal rcooper nuscenes argoverse "
    "sustech rosbag foxglove pcap hdf5"
)
# modules of layouts that share them
_MODULES = {"v2xset": "opv2v", "v2xreal": "opv2v", "kitti-tracking": "kitti_sequences"}
_READERS = {"v2xset": "opv2v", "kitti-tracking": "kitti_sequence"}
_ONLY_READ = ("rcooper", "foxglove", "kitti-tracking", "pcap")
_SIGNS = {  # files that only these layouts have in their folders
    ("folder",): ("poses.json", "poses.txt", "poses.csv", "labels.json"),
    ("kitti-tracking",): ("label_02", "training/label_02"),
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
LAYOUTS = {
    name: Layout(
        *(name, f"toolkit.datasets.layouts.{_MODULES.get(name, name)}", _READERS.get(name, name)),
        writer=None if name in _ONLY_READ else f"write_{_READERS.get(name, name)}",
        file=name == "hdf5",
    )
    for name in _BUILT_IN.split()
}


@cache
def load_plugins() -> dict[str, Layout]:
    """Return the layouts that other installed packages bring, by name."""
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
        if ending in PCAP_ENDINGS:
            return "pcap"
        if ending in BAG_ENDINGS:
            return "foxglove" if _is_foxglove(path) else "rosbag"
        has_other_ending = ending not in _HDF5 and path.is_file()
        if has_other_ending and not _head(path).startswith(b"\x89HDF"):  # as HDF5 files do
            raise ValueError(
                f"{path} is no recording: its ending is none of "
                f"{', '.join((*_HDF5, *BAG_ENDINGS, *PCAP_ENDINGS, *ENDINGS))}"
            )
        return "hdf5"
    return _guess_folder_layout(path)


def _guess_folder_layout(folder: Path) -> str:
    """Guess the layout of a folder by files that only one layout has, "folder" without any.

    Raises ValueError for a folder that several layouts might have written."""
    # layouts that might have written the folder
    layouts: tuple[str, ...] = ()
    for candidates, patterns in _SIGNS.items():
        if any(any(folder.glob(pattern)) for pattern in patterns):
            layouts = candidates
            break
    labels = folder / "labels.json"
    if layouts == ("folder",) and labels.is_file() and b'"openlabel"' in _head(labels):
        return "openlabel"
    if len(layouts) > 1:
        raise ValueError(f"{folder} has layout {' or '.join(layouts)}: say by --layout which it is")
    if layouts:
        return layouts[0]
    if list_bags(folder):
        files = (*folder.glob("*"), *folder.glob("*/*"))
        if not any(file.suffix.lower() in ENDINGS for file in files):
            return "foxglove" if _is_foxglove(list_bags(folder)[0]) else "rosbag"
    json_paths = (*folder.glob("*.json"), *folder.glob("*/*.json"))
    json_file = next((path for path in json_paths if path.is_file()), None)
    is_openlabel = json_file is not None and b'"openlabel"' in _head(json_file)
    return "openlabel" if is_openlabel else "folder"


def _is_foxglove(path: Path) -> bool:
    """True for an MCAP file whose header states no profile; bags of ROS state theirs."""
    if path.suffix.lower() != ".mcap" or not path.is_file():
        return False
    head = _head(path)
    # magic, kind and length of the header's record, length of the profile's name
    return head[:9] == b"\x89MCAP0\r\n\x01" and head[17:21] == bytes(4)


def _head(path: Path) -> bytes:
    """Return the first 200 bytes of a file."""
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
    unknown_options = reader_options.keys() - inspect.signature(reader).parameters.keys()
    if unknown_options:
        options_text = ", ".join(
            f"--{key.replace('_', '-')}" for key in options if key in unknown_options
        )
        raise ValueError(
            f"{options_text} does not go with layout {name}, which has its own: leave it out"
        )
    if not path.exists() and name != "hdf5":
        raise FileNotFoundError(f"no such recording: {path}")
    recording = reader(path, **reader_options)
    if not isinstance(recording, Listing):
        return recording
    if recording.strays:
        warnings.warn(f"{path}: {recording.describe_strays()}", stacklevel=2)
    loader = _Loader(path, layout=name, options=reader_options, load=recording.load)
    return replace(recording, path=path, load=loader)


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
        """Function that reads a frame by its name, from an opened recording if none was given."""
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


def write_recording(frames: Iterable[Frame], path: str | Path, layout: str) -> int:
    """Write frames in a layout; return how many.

    Boxes come back within a millimetre and a hundredth of a degree; classes get the layout's names.
    Raises ValueError for a read-only layout."""
    return find_layout(layout).write(frames, Path(path))
