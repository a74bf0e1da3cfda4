"""The recording a command reads."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from coview.arguments import check_least

if TYPE_CHECKING:
    from toolkit.datasets.dataset import CoopDataset
    from toolkit.datasets.records.fields import Samples
    from toolkit.datasets.sample import Sample
    from toolkit.detection.samples.detected import Detected


@contextmanager
def open_recording(dataset: Path, site: str | None, *, drop_invalid: bool = False) -> Iterator[CoopDataset]:
    """A recording, at a site of that name or file, or the one that it says itself; drop_invalid: without the objects
    that cannot be, which else are refused when their frame is read."""
    from toolkit.datasets.dataset import CoopDataset, UnknownSite
    from toolkit.datasets.published_layout import InvalidObjects
    from toolkit.sites.files import load_site

    place = load_site(site) if site else None
    try:
        recording = CoopDataset(dataset, place, drop_invalid=drop_invalid)
    except UnknownSite as error:
        raise ValueError(f"{dataset} does not say which site it shows, and shows none of ours: give --site") from error
    try:
        with recording:
            yield recording
    except InvalidObjects as error:
        raise ValueError(f"{error}: say --drop-invalid") from error


def frame_count(recording: CoopDataset, frames: int | None) -> int:
    """How many frames of a recording are wanted."""
    check_frames(frames)
    return len(recording) if frames is None else min(frames, len(recording))


def check_frames(frames: int | None) -> None:
    """Raise ValueError where no frame is wanted."""
    check_least("--frames", frames, 1, "leave it out for all")


def open_clouds(path: Path, layout: str, *, poses: Path | None = None, inverted: bool = False) -> Samples:
    """The samples of a recording of clouds; poses: a file of them, which only plain folders take."""
    from toolkit.datasets.layouts.folder import folder
    from toolkit.datasets.samples import open_samples

    if poses is None and not inverted:
        return open_samples(path, layout)
    if layout != "folder":
        raise ValueError(f"--poses and --inverted are for --layout folder: {layout} has its own")
    return folder(path, poses=poses, inverted=inverted)


def first_of(samples: Iterable[Sample], frames: int | None) -> Iterator[Sample]:
    """The first so many, all for None."""
    return islice(samples, frames)


def watched(found: Iterable[Detected], progress: Callable[[int], None]) -> Iterator[Detected]:
    """Detections as they come by; the bar moves, and the first thing to be said of the ground is."""
    said = False
    for done, each in enumerate(found, 1):
        if each.warning is not None and not said:
            warnings.warn(f"{each.sample.name}: {each.warning}", stacklevel=2)
            said = True
        progress(done)
        yield each
