"""Recordings of clouds in any layout as samples: `read`, and `write_samples` into another."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from toolkit.datasets.layouts.table import layout_named
from toolkit.datasets.records.fields import Samples
from toolkit.datasets.sample import Sample
from toolkit.objects import label_index


def read(path: str | Path, layout: str, *, classes: Sequence[str | int] | None = None) -> Iterator[Sample]:
    """The samples of a recording, in order, each read when its turn comes.

    layout: a name of `toolkit.datasets.layouts.table.LAYOUTS`; classes: only objects of these, names or numbers of
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
