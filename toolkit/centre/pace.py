"""`PaceKeeper`: how often a centre detects, so that it keeps pace with its sensors.

If detection takes longer than there is time between two frames, frames queue and are dropped. A
centre then detects in every second frame only, or every third, and predicts the tracks in the
frames between, which takes a few milliseconds. The rate may also be fixed."""

from collections import deque
from dataclasses import dataclass

import numpy as np

MAX_EVERY = 10
MAX_LOAD = 0.9  # median work of a frame, as a share of the time that there is for it
MAX_SPARE_LOAD = 0.75  # such a share in 95 % of the frames at which it detects more often again
WORK_FRAMES = 20  # frames with detection whose work counts


@dataclass(frozen=True)
class PaceEvent:
    """Change of how often a centre detects, or that it cannot keep the rate that was set.

    Attributes:
        time_s: Time at which it was noticed (s).
        detect_every: Detection takes place in every frame (1), every second one (2), and so on.
        needed_every: The smallest such number that it can keep.
        work_ms: Median milliseconds of work on a frame with detection.
        interval_ms: Milliseconds from a frame to the next.
    """

    time_s: float
    detect_every: int
    needed_every: int
    work_ms: float
    interval_ms: float

    def as_dict(self) -> dict[str, object]:
        """Return the event as plain values."""
        return {
            "time_s": round(self.time_s, 3),
            "detect_every": self.detect_every,
            "needed_every": self.needed_every,
            "work_ms": round(self.work_ms, 1),
            "interval_ms": round(self.interval_ms, 1),
        }

    def __str__(self) -> str:
        """The change with its reason and remedy, in a line."""
        times = (
            f"{self.time_s:.2f} s: a frame takes {self.work_ms:.0f} ms, and the next comes after "
            f"{self.interval_ms:.0f} ms"
        )
        if self.needed_every > self.detect_every:
            return (
                f"{times}, so some will be dropped: set detect_every = {self.needed_every} in the "
                "configuration, or leave it out"
            )
        if self.detect_every == 1:
            return f"{times}: every frame is detected again"
        return (
            f"{times}: one frame in {self.detect_every} is detected, tracks are predicted between"
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


class PaceKeeper:
    """Choice of the frames in which a centre detects.

    Args:
        interval_s: Time from a frame to the next (s).
        detect_every: 1 for detection in every frame, 2 in every second one; None to choose it.
        parallel: Number of frames in which a centre detects at the same time.

    Attributes:
        detect_every: The present number.
    """

    def __init__(
        self, interval_s: float, detect_every: int | None = None, *, parallel: int = 1
    ) -> None:
        """Begin with a detection in every frame, or at the fixed rate.

        interval_s: time between frames (s); detect_every: k for every k-th frame, None to choose
        it; parallel: frames in which the centre detects at the same time."""
        self.detect_every = 1 if detect_every is None else detect_every
        self._is_fixed = detect_every is not None
        self._interval_s = interval_s
        self._parallel = parallel
        self._works_s: deque[float] = deque(maxlen=WORK_FRAMES)
        self._frames_to_wait = 0  # before the next detection
        self._is_overloaded = False  # at a fixed rate

    def is_due(self) -> bool:
        """Count a frame, and return True if detection is due in it."""
        if self._frames_to_wait:
            self._frames_to_wait -= 1
            return False
        self._frames_to_wait = self.detect_every - 1
        return True

    def add_work(self, work_s: float, time_s: float) -> PaceEvent | None:
        """Take the time of work on a frame with detection (s); return what it changes, if anything.

        "Every k" below means to detect in every k-th frame. time_s: present time (s)."""
        self._works_s.append(work_s)
        if len(self._works_s) < WORK_FRAMES:
            return None
        median_s = float(np.median(self._works_s))
        needed_every = self._find_every(median_s, MAX_LOAD)
        slow_s = float(np.percentile(self._works_s, 95))
        spare_every = self._find_every(slow_s, MAX_SPARE_LOAD)
        if self._is_fixed:
            return self._report_overload(time_s, median_s, needed_every, spare_every)
        if needed_every <= self.detect_every <= spare_every:
            return None
        self.detect_every = max(needed_every, min(spare_every, self.detect_every))
        self._works_s.clear()
        return self._describe(time_s, median_s, needed_every)

    def _report_overload(
        self, time_s: float, median_s: float, needed_every: int, spare_every: int
    ) -> PaceEvent | None:
        """Return an event when a fixed rate is too high, once until there is time to spare.

        median_s: work on a frame (s); needed_every: k, if there is time for detection in every k-th
        frame; spare_every: likewise, with time to spare."""
        if spare_every <= self.detect_every:
            self._is_overloaded = False
        if needed_every <= self.detect_every or self._is_overloaded:
            return None
        self._is_overloaded = True
        return self._describe(time_s, median_s, needed_every)

    def _find_every(self, work_s: float, load: float) -> int:
        """Return k, if there is time for detection in every k-th frame.

        work_s: work on a frame (s); load: share of the time that detection may take."""
        share_s = load * self._parallel * self._interval_s  # if detection is in every frame
        return min(max(1, int(np.ceil(work_s / share_s))), MAX_EVERY)

    def _describe(self, time_s: float, median_s: float, needed_every: int) -> PaceEvent:
        """Return an event at a time (s).

        median_s: work on a frame (s); needed_every: k, if there is time for detection in every k-th
        frame."""
        return PaceEvent(
            time_s,
            self.detect_every,
            needed_every,
            work_ms=1e3 * median_s,
            interval_ms=1e3 * self._interval_s,
        )
