"""The layouts by name: how each is opened, and written where it can be."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from toolkit.datasets.layouts.argoverse import argoverse, write_argoverse
from toolkit.datasets.layouts.dair import dair, write_dair
from toolkit.datasets.layouts.folder import folder, write_folder
from toolkit.datasets.layouts.hdf5 import hdf5, write_hdf5_clouds
from toolkit.datasets.layouts.kitti import kitti, write_kitti
from toolkit.datasets.layouts.nuscenes import nuscenes, write_nuscenes
from toolkit.datasets.layouts.openlabel import openlabel, write_openlabel
from toolkit.datasets.layouts.opv2v import opv2v, v2xreal, write_opv2v, write_v2xreal
from toolkit.datasets.layouts.rcooper import rcooper
from toolkit.datasets.layouts.rosbag import rosbag, write_rosbag
from toolkit.datasets.layouts.sustech import sustech, write_sustech
from toolkit.datasets.records import Samples
from toolkit.datasets.sample import Sample
from toolkit.objects import label_index


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


def read(path: str | Path, layout: str, *, classes: Sequence[str | int] | None = None) -> Iterator[Sample]:
    """The samples of a recording, in order, each read when its turn comes.

    layout: a name of `toolkit.datasets.recordings.LAYOUTS`; classes: only objects of these, names or numbers of
    `toolkit.objects.LABELS`. Labels that cannot be, points that are none and clouds without points are left out or
    empty, and counted in `Sample.problems`. Raises FileNotFoundError where there is no such recording, ValueError for
    an unknown layout or class and, naming it, for a file that is damaged.
    """
    return of_classes(open_samples(path, layout), classes)


def of_classes(samples: Iterable[Sample], classes: Sequence[str | int] | None) -> Iterator[Sample]:
    """The samples with only their objects of some classes, all for None. Raises ValueError for one that is none."""
    wanted = None if classes is None else [label_index(label) for label in classes]
    return (sample if wanted is None else sample.of(np.isin(sample.objects.labels, wanted)) for sample in samples)


def open_samples(path: str | Path, layout: str) -> Samples:
    """The samples of a recording, which say how many they are. Raises as `read`."""
    opened = layout_named(layout).opened
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"no such recording: {path}")
    return opened(path)


def write_samples(samples: Iterable[Sample], path: str | Path, layout: str) -> int:
    """Write samples in a layout, clouds, labels and poses; how many. Raises ValueError for a layout that is only read.

    Boxes come back within a millimetre and a hundredth of a degree. Classes are written by the layout's names for ours.
    """
    write = layout_named(layout).write
    if write is None:
        raise ValueError(f"layout {layout} is only read: write another, such as folder")
    return write(samples, Path(path))
