"""Pace of a centre: whether detection and inputs are as fast as the sensors.

If detection takes longer than there is time between the frames in which it is due, it takes place
in fewer frames, and the tracks of the others are predicted. `PaceWatch` notices when that begins
and ends."""

from collections import deque
from dataclasses import dataclass

import numpy as np

MAX_SPARE_LOAD = 0.9  # median work, as a share of the time for it, from which it keeps pace again
WORK_FRAMES = 20  # newest frames whose work counts


@dataclass(frozen=True)
class PaceEvent:
    """Beginning or end of a time in which detection does not keep pace.

    Attributes:
        time_s: Time at which it was noticed (s).
        is_slow: True if it does not keep pace.
        work_ms: Median milliseconds of detection per frame.
        due_ms: Milliseconds from a frame in which it is due to the next.
    """

    time_s: float
    is_slow: bool
    work_ms: float
    due_ms: float

    def as_dict(self) -> dict[str, object]:
        """Return the event as plain values."""
        return {
            "time_s": round(self.time_s, 3),
            "is_slow": self.is_slow,
            "work_ms": round(self.work_ms, 1),
            "due_ms": round(self.due_ms, 1),
        }

    def __str__(self) -> str:
        """The change with its reason, in a line."""
        effect = (
            "some frames are not detected, their tracks are predicted"
            if self.is_slow
            else "no frame is left out any more"
        )
        return (
            f"{self.time_s:.2f} s: detection takes {self.work_ms:.0f} ms a frame and is due every "
            f"{self.due_ms:.0f} ms: {effect}"
        )


@dataclass(frozen=True)
class LagEvent:
    """Replay whose clock was set back, since it is read or simulated more slowly than its pace.

    Attributes:
        time_s: Time of the clock after it was set back (s).
        set_back_s: Seconds by which it was set back since the start.
    """

    time_s: float
    set_back_s: float

    def as_dict(self) -> dict[str, object]:
        """Return the event as plain values."""
        return {"time_s": round(self.time_s, 3), "set_back_s": round(self.set_back_s, 3)}

    def __str__(self) -> str:
        """Amount by which the clock was set back, and the remedy, in a line."""
        return (
            f"{self.time_s:.2f} s: the inputs cannot be read at their pace, and the clock was set "
            f"back by {self.set_back_s:.1f} s so far: set a lower speed in [replay]"
        )


class PaceWatch:
    """Watch over the time that detection takes.

    Args:
        due_ms: Milliseconds from a frame in which detection is due to the next.
        parallel: Number of frames in which detection takes place at the same time.
    """

    def __init__(self, due_ms: float, parallel: int = 1) -> None:
        """Begin without detections.

        due_ms: from a frame in which detection is due to the next (ms); parallel: frames in which
        it takes place at the same time."""
        self._due_ms = due_ms
        self._parallel = parallel
        self._works_ms: deque[float] = deque(maxlen=WORK_FRAMES)
        self._is_slow = False

    def add_work(self, work_ms: float, time_s: float) -> PaceEvent | None:
        """Take the time of a detection (ms); return an event if it begins or ends to be too slow.

        time_s: present time (s)."""
        self._works_ms.append(work_ms / self._parallel)
        if len(self._works_ms) < WORK_FRAMES:
            return None
        median_ms = float(np.median(self._works_ms))
        max_load = MAX_SPARE_LOAD if self._is_slow else 1.0
        is_slow = median_ms > max_load * self._due_ms
        if is_slow == self._is_slow:
            return None
        self._is_slow = is_slow
        return PaceEvent(time_s, is_slow, median_ms, self._due_ms)
