"""Contents of an HDF5 file of images: its groups, cameras and objects."""

from pathlib import Path

import h5py
import numpy as np

from toolkit.datasets import published_layout as published
from toolkit.runtime import hdf5

CLOUDS_KIND = "clouds"  # the attribute `coview` of a file of recorded clouds
_GROUPS = ("objects", "cameras", "coview", "coview/ranges", "coview/depth")


def open_file(path: str | Path) -> h5py.File:
    """Open an HDF5 file for reading.

    Raises FileNotFoundError or OSError, which state in one line what is wrong."""
    path = Path(path)
    if not path.exists():
        is_unfinished = path.with_name(path.name + ".parts").is_dir()
        hint = "check the path"
        if is_unfinished:
            hint = "its simulation is not finished, start it again to go on"
        raise FileNotFoundError(f"no dataset {path}: {hint}")
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder: give the HDF5 file itself")
    return hdf5.open_hdf5(path)


def object_rows(file: h5py.File, name: str) -> np.ndarray:
    """Read the objects of a frame as published rows (n, 10), with their values unchecked.

    name: dataset of the frame, such as "objects/0". Raises ValueError if they cannot be read."""
    rows = hdf5.find_array(file, name, kinds="fiub")
    if rows is None:
        raise ValueError(f"{name} is missing: every frame needs its objects, no rows for none")
    if not rows.ndim:
        raise ValueError(
            f"{name} must have {len(published.OBJECT_COLUMNS)} columns, got a single number"
        )
    return rows if rows.size else np.zeros((0, len(published.OBJECT_COLUMNS)))


def check_kinds(file: h5py.File) -> tuple[str, ...]:
    """Check that groups and datasets are as the layout expects; return the names of the cameras.

    Raises ValueError for a dataset in place of a group, for a group in place of a dataset, and for
    a file of recorded clouds."""
    if str(hdf5.read_node_attributes(file, "the file").get("coview", "")) == CLOUDS_KIND:
        raise ValueError("it holds recorded clouds, not images: give --layout hdf5")
    cameras = list_cameras(file)
    camera_groups = [f"cameras/{name}" for name in cameras]
    kinds = hdf5.find_kinds(file, ("dslices", *_GROUPS, *camera_groups))
    for name, kind in kinds.items():
        expected_kind = h5py.Dataset if name == "dslices" else h5py.Group
        if not issubclass(kind, expected_kind):
            words = f"{expected_kind.__name__.lower()}, got a {kind.__name__.lower()}"
            raise ValueError(f"{name} must be an HDF5 {words}: see toolkit.datasets.dataset")
    return cameras


def list_cameras(file: h5py.File) -> tuple[str, ...]:
    """Names of the depth cameras in the order of `dslices`.

    They start with d and are in alphabetical order."""
    return tuple(sorted(name for name in hdf5.child_names(file, "cameras") if name.startswith("d")))
