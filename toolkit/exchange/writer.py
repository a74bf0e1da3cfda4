"""Protocol of the writers, and the checks that all of them share."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Protocol

import numpy as np

from toolkit.exchange.instant import Instant


class Writer(Protocol):
    """Writer of one file: made for a path, it takes instants in order of time, then closes.

    Attributes:
        problems: numbers of values that the format cannot hold, by kind.
    """

    @property
    def problems(self) -> Mapping[str, int]:
        """Numbers of values that the format cannot hold, by kind."""

    def write(self, instant: Instant) -> None:
        """Write the objects of an instant, which have ids."""

    def close(self) -> None:
        """Complete the file."""


class OrderedWriter:
    """Writer that checks the order of times, and numbers detections without ids.

    A detection that nobody tracked is an object of one instant: each gets a number that no other
    has, so that no format shows two as one.
    """

    def __init__(self, writer: Writer, name: str, *, needs_time: bool) -> None:
        """Wrap the writer of a format. name: the format's; needs_time: True if NaN is refused."""
        self._writer = writer
        self._name = name
        self._needs_time = needs_time
        self._last_s = -np.inf  # time of the instant written last
        self._next_id = 0  # for the next detection without an id

    @property
    def problems(self) -> Mapping[str, int]:
        """Numbers of values that the format cannot hold, by kind."""
        return self._writer.problems

    def write(self, instant: Instant) -> None:
        """Write the objects of an instant.

        Raises ValueError for a time that does not follow the last one, and an unknown time if the
        format needs it."""
        time_s = instant.time_s
        if np.isinf(time_s) or (self._needs_time and np.isnan(time_s)):
            raise ValueError(
                f"{self._name} needs the time of every frame, got {time_s:g}: name the clouds by "
                "their times, or write kitti-tracking or openlabel"
            )
        if time_s <= self._last_s:
            raise ValueError(
                f"times must rise, but {time_s:.6f} s follows {self._last_s:.6f} s: sort the "
                "frames, and write each recording to a file of its name"
            )
        self._last_s = self._last_s if np.isnan(time_s) else time_s
        if instant.ids is None:
            ids = np.arange(self._next_id, self._next_id + len(instant))
            self._next_id += len(instant)
            instant = replace(instant, ids=ids)
        self._writer.write(instant)

    def close(self) -> None:
        """Complete the file."""
        self._writer.close()


def nanoseconds(time_s: float) -> int:
    """Return seconds since 1970 as nanoseconds, to the microsecond that float64 holds.

    Raises ValueError for a time before 1970 or after 2262, which no clock of this kind shows."""
    microseconds = round(time_s * 1e6)
    if not 0 <= microseconds < 2**63 // 1000:
        raise ValueError(f"times must be seconds since 1970, got {time_s:g}: mend the times")
    return microseconds * 1000
