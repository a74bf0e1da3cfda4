"""The layouts by name: how each is opened, and written where it can be."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from toolkit.datasets.layouts.argoverse_log import argoverse, write_argoverse
from toolkit.datasets.layouts.dair import dair, write_dair
from toolkit.datasets.layouts.folder import folder, write_folder
from toolkit.datasets.layouts.hdf5 import hdf5
from toolkit.datasets.layouts.hdf5_clouds import write_hdf5_clouds
from toolkit.datasets.layouts.kitti import kitti, write_kitti
from toolkit.datasets.layouts.nuscenes import nuscenes, write_nuscenes
from toolkit.datasets.layouts.openlabel import openlabel, write_openlabel
from toolkit.datasets.layouts.opv2v import opv2v, v2xreal, write_opv2v, write_v2xreal
from toolkit.datasets.layouts.rcooper import rcooper
from toolkit.datasets.layouts.rosbag import rosbag
from toolkit.datasets.layouts.rosbag_writer import write_rosbag
from toolkit.datasets.layouts.sustech import sustech, write_sustech
from toolkit.datasets.records.fields import Samples
from toolkit.datasets.sample import Sample


@dataclass(frozen=True)
class Layout:
    """opened: the samples of a path, read one by one; write: samples into a folder, and how many there were; file:
    whether it writes one file instead."""

    name: str
    opened: Callable[[Path], Samples]
    write: Callable[[Iterable[Sample], Path], int] | None = None
    file: bool = False


LAYOUTS = {
    layout.name: layout
    for layout in (
        Layout("folder", folder, write_folder),
        Layout("kitti", kitti, write_kitti),
        Layout("openlabel", openlabel, write_openlabel),
        Layout("dair", dair, write_dair),
        Layout("opv2v", opv2v, write_opv2v),
        Layout("v2xset", opv2v, write_opv2v),
        Layout("v2xreal", v2xreal, write_v2xreal),
        Layout("rcooper", rcooper),
        Layout("nuscenes", nuscenes, write_nuscenes),
        Layout("argoverse", argoverse, write_argoverse),
        Layout("sustech", sustech, write_sustech),
        Layout("rosbag", rosbag, write_rosbag),
        Layout("hdf5", hdf5, write_hdf5_clouds, file=True),
    )
}


def layout_named(name: str) -> Layout:
    """A layout. Raises ValueError, which lists them, for a name that is none.

    >>> layout_named("kiti")
    Traceback (most recent call last):
    ValueError: there is no layout 'kiti': choose among folder, kitti, ...
    """
    if name not in LAYOUTS:
        raise ValueError(f"there is no layout {name!r}: choose among {', '.join(LAYOUTS)}")
    return LAYOUTS[name]
