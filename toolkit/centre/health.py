"""`HealthLog`: state of a running centre, a line of JSON every few seconds.

A line holds the time, the numbers of frames and of what was left out since the start, among it
frames that were dropped, frames with predicted tracks, and detections that came after their frame
was out, the present faults, and median, p95 and p99 of latency, stages, and age of the newest
detections behind the tracks since the line before. Lines are flushed one by one, so that a killed
process leaves all but the line it was writing."""

import json
import resource
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import TextIO

from toolkit.centre.running_centre import CentreEvent, CentreFrame, LeftOut
from toolkit.centre.sensor_monitor import Fault
from toolkit.centre.sensor_watch import FaultEvent
from toolkit.runtime.stage_times import StageTimes

LATENCY = "latency"
DETECTION_AGE = "detection_age"
HEALTH_EVERY_S = 10.0
_STATUS_FILE = Path("/proc/self/statm")
_BYTES_PER_MB = 1e6


class HealthLog:
    """Lines of health, and the summary of a whole run.

    Args:
        path: File to which lines are added, None to write none.
        every_s: Time between two lines (s).

    Attributes:
        frames: Number of frames so far.
        times: Latency, stages and age of detections of the newest frames.
        fault_counts: Numbers of faults that began, by sensor and fault.
    """

    def __init__(self, path: Path | None, every_s: float = HEALTH_EVERY_S) -> None:
        """Open the file, if there is one, to write at its end.

        every_s: time from one line to the next (s). Raises ValueError unless it is above 0."""
        if not every_s > 0:
            raise ValueError(f"health lines need more than 0 s between them, got {every_s:g}")
        self.frames = 0
        self.times = StageTimes()
        self.fault_counts: Counter[str] = Counter()
        self._recent = StageTimes()
        self._every_s = every_s
        self._next_s: float | None = None
        self._file: TextIO | None = None
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("a", encoding="utf-8", buffering=1)

    def add(self, frame: CentreFrame) -> None:
        """Add the times of a frame, and of the late detections that came with it."""
        self.frames += 1
        for times in (self.times, self._recent):
            times.add(LATENCY, frame.latency_ms)
            times.add_all(frame.stage_ms)
            if frame.detection_age_s is not None:
                times.add(DETECTION_AGE, 1e3 * frame.detection_age_s)
            for result in frame.late_detections:
                times.add("level", result.stand.ms)
                times.add("detect", result.detect_ms)

    def add_event(self, event: CentreEvent) -> None:
        """Count a fault that began."""
        if isinstance(event, FaultEvent) and event.fault is not None:
            self.fault_counts[f"{event.sensor} {event.fault.value}"] += 1

    def write_line(
        self, now_s: float, faults: Mapping[str, Fault], left_out: LeftOut, *, is_last: bool = False
    ) -> None:
        """Write a line if one is due.

        now_s: time of the sensors (s); faults: present faults by sensor; is_last: True to write
        one in any case."""
        if self._next_s is None:
            self._next_s = now_s + self._every_s
        if self._file is None or (now_s < self._next_s and not is_last):
            return
        self._next_s = max(self._next_s + self._every_s, now_s)
        line = {
            "time_s": round(now_s, 3),
            "frames": self.frames,
            **left_out.as_dict(),
            "faults": {name: fault.value for name, fault in faults.items()},
            "ms": self._recent.summarise(),
            "memory_mb": read_memory_mb(),
        }
        self._file.write(json.dumps(line) + "\n")
        self._recent.clear()

    def summarise(self) -> dict[str, object]:
        """Return the figures of the run: frames, faults that began, times and memory."""
        return {
            "frames": self.frames,
            "faults": dict(self.fault_counts),
            "ms": self.times.summarise(),
            "memory_mb": read_memory_mb(),
        }

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()


def read_memory_mb() -> float:
    """Return the memory of this process (MB): resident now, or its peak on other systems."""
    if _STATUS_FILE.exists():
        pages = int(_STATUS_FILE.read_text().split()[1])
        return round(pages * resource.getpagesize() / _BYTES_PER_MB, 1)
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3, 1)
