"""Tracks of a file by the frames of a recording."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from toolkit.display import describe_count
from toolkit.exchange.track_frames import TrackFile, TrackFrame
from toolkit.tracking.tracks import Tracks

MAX_TIME_GAP_S = 0.001  # between a frame's time in a recording and in a file of its tracks


class FrameKey(NamedTuple):
    """Key of a frame of a recording: number, name and time.

    Attributes:
        number: Its number.
        name: Its name, "" without one.
        time: Its time (s), NaN if unknown."""

    number: int
    name: str
    time: float

    def describe(self) -> str:
        """Return words for the frame."""
        time = f"{self.time:.6f} s" if np.isfinite(self.time) else ""
        if self.name:
            return f"{self.name!r} at {time}" if time else repr(self.name)
        return time or str(self.number)


class TrackLookup:
    """Tracks of a file by the frames of a recording.

    A frame is found by its time if both sides have times, else by its name if both have names, else
    by its number.

    file: the file."""

    def __init__(self, file: TrackFile) -> None:
        """Index the frames of a file of tracks by time, and by name or number."""
        self.file = file
        self._times = np.array([frame.time for frame in file.frames])
        self._has_names = all(frame.name for frame in file.frames)
        # index in `file.frames` by name, or by number if the frames have no names
        self._index_by_key: dict[str | int, int] = {}
        for index, frame in enumerate(file.frames):
            self._index_by_key[frame.name if self._has_names else frame.number] = index
        self._found_indices: set[int] = set()  # frames that `find` returned

    def find(self, key: FrameKey) -> Tracks | None:
        """Return the tracks of a frame, None if the file does not list it."""
        index = self.find_index(key)
        if index is None:
            return None
        self._found_indices.add(index)
        return self.file.frames[index].tracks

    def find_index(self, key: FrameKey) -> int | None:
        """Return the index in `file.frames` of a frame of the recording, None if it lacks it."""
        if self._is_timed(key):
            time_gaps = np.abs(self._times - key.time)
            if not len(time_gaps):
                return None
            nearest_index = int(time_gaps.argmin())
            return nearest_index if time_gaps[nearest_index] <= MAX_TIME_GAP_S else None
        return self._index_by_key.get(key.name if self._has_names else key.number)

    def list_tracks(self, keys: Sequence[FrameKey], *, is_part: bool = False) -> list[Tracks]:
        """List the tracks of each frame of a recording, empty in frames that the file leaves out.

        Args:
            keys: Frames of the recording.
            is_part: True if the recording goes on after these frames; later tracks are left out.

        Raises ValueError for a frame that a complete file lacks, and for frames of the file that
        are not among these."""
        matches = [self.find(key) for key in keys]
        self.check_all_used(len(keys), keys[-1] if is_part else None)
        missing = [key for key, tracks in zip(keys, matches, strict=True) if tracks is None]
        if self.file.is_complete and missing:
            raise ValueError(
                f"{self.file.path} lacks {len(missing)} of {describe_count(len(keys), 'frame')}, "
                f"the first {missing[0].describe()}: track the whole recording, or pass --frames"
            )
        return [Tracks.empty() if tracks is None else tracks for tracks in matches]

    def list_used(self) -> list[TrackFrame]:
        """List the frames of the file that were found, in its order."""
        return [self.file.frames[index] for index in sorted(self._found_indices)]

    def list_unused(self, last: FrameKey | None = None) -> list[TrackFrame]:
        """List the frames of the file that were never found.

        last: last frame of a part of the recording, after which frames of the file are passed over;
        None if the whole recording was looked up."""
        unused = []
        for index, frame in enumerate(self.file.frames):
            is_later = False
            if last is not None and self._is_timed(last):
                is_later = frame.time > last.time
            elif last is not None:
                is_later = frame.number > last.number
            if index not in self._found_indices and not is_later:
                unused.append(frame)
        return unused

    def check_all_used(self, frames: int, last: FrameKey | None = None) -> None:
        """Raise ValueError for a frame of the file that is not in the recording.

        frames: number of frames of the recording; last: last frame of a part of the recording, None
        if the whole recording was looked up."""
        for frame in self.list_unused(last):
            key = FrameKey(frame.number, frame.name, frame.time)
            raise ValueError(
                f"{self.file.path} has frame {key.describe()}, which is not among the recording's "
                f"{frames}: is it of another recording?"
            )

    def _is_timed(self, key: FrameKey) -> bool:
        """True if a frame of the recording and all frames of the file have times."""
        return self.file.has_times and bool(np.isfinite(key.time))
