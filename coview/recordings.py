"""The recording a command reads."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from coview.arguments import check_least

if TYPE_CHECKING:
    from toolkit.datasets.dataset import CoopDataset


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
