"""Tracks of a file, frame by frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64
from toolkit.datasets.problem_kinds import Problems
from toolkit.exchange.instant import Instant
from toolkit.tracking.tracks import Tracks


class TrackFrame(NamedTuple):
    """Tracks of one frame of a file.

    Attributes:
        number: Number of the frame from 0; in JSON and CSV its place in the file.
        name: Name of the frame, "" if the format has no names.
        time: Time (s), NaN if the format has no times.
        tracks: Tracks; velocities are NaN if they are unknown.
        rectangles: (n, 4), left, top, right, bottom (px) in an image, NaN if unknown."""

    number: int
    name: str
    time: float
    tracks: Tracks
    rectangles: Float64[np.ndarray, "n 4"]


@dataclass(frozen=True, eq=False)
class TrackFile:
    """Tracks of a recording as a file holds them.

    Attributes:
        path: The file.
        frames: Its frames, in ascending order.
        is_complete: True if it lists frames without road users too.
        has_times: True if each frame has a time.
        problems: Number of rows left out, by kind."""

    path: Path
    frames: tuple[TrackFrame, ...]
    is_complete: bool
    has_times: bool
    problems: Problems


def make_tracks(
    instant: Instant,
    ages: Float64[np.ndarray, " n"] | None = None,
    unseen: Float64[np.ndarray, " n"] | None = None,
) -> Tracks:
    """Make tracks of a checked instant that has ids, with velocities of NaN if unknown.

    ages: seconds since the first detection of each track; unseen: seconds since the last one; both
    0 if None."""
    count = len(instant)
    velocities = instant.velocities
    if velocities is None:
        velocities = np.full((count, 3), np.nan)
    return Tracks(
        instant.boxes,
        instant.scores,
        instant.labels,
        ids=np.array(instant.list_ids(), np.int64),
        velocities=velocities,
        ages=np.zeros(count) if ages is None else ages,
        unseen=np.zeros(count) if unseen is None else unseen,
    )


def check_rising(frames: Sequence[TrackFrame]) -> None:
    """Raise ValueError for frames whose times do not rise."""
    for frame, later in pairwise(frames):
        if not later.time > frame.time:
            raise ValueError(
                f"times must rise, but {later.time:g} s of frame {later.name!r} follows "
                f"{frame.time:g} s"
            )
