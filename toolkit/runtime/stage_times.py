"""`StageTimes`: milliseconds of the stages of many frames, with median and percentiles."""

from collections import deque
from collections.abc import Mapping

import numpy as np

MAX_TIMES = 100_000  # newest times of a stage that are kept: 2.8 hours at 10 Hz
PERCENTILES = {"median": 50.0, "p95": 95.0, "p99": 99.0}

Percentiles = dict[str, float]


class StageTimes:
    """Times of stages by name, in the order in which the stages first appear.

    >>> times = StageTimes()
    >>> for ms in (10.0, 20.0, 30.0):
    ...     times.add("detect", ms)
    >>> times.summarise()
    {'detect': {'median': 20.0, 'p95': 29.0, 'p99': 29.8}}
    """

    def __init__(self, max_times: int = MAX_TIMES) -> None:
        self._max_times = max_times
        self._times: dict[str, deque[float]] = {}

    def add(self, stage: str, ms: float) -> None:
        """Add the time (ms) of a stage in one frame."""
        self._times.setdefault(stage, deque(maxlen=self._max_times)).append(ms)

    def add_all(self, stages: Mapping[str, float]) -> None:
        """Add the times (ms) of several stages of one frame."""
        for stage, ms in stages.items():
            self.add(stage, ms)

    def clear(self) -> None:
        """Forget all times."""
        self._times.clear()

    def summarise(self) -> dict[str, Percentiles]:
        """Return median, 95th and 99th percentile (ms) of each stage, to a hundredth."""
        summary = {}
        for stage, times in self._times.items():
            values = np.percentile(np.array(times), list(PERCENTILES.values()))
            rounded_values = [round(value, 2) for value in values.tolist()]
            summary[stage] = dict(zip(PERCENTILES, rounded_values, strict=True))
        return summary


def describe_times(summary: Mapping[str, Percentiles]) -> str:
    """Describe percentiles (ms) in a line for each stage.

    >>> print(describe_times({"detect": {"median": 20.0, "p95": 29.0, "p99": 29.8}}))
    detect: 20 ms in the median, 29 ms p95, 30 ms p99
    """
    lines = []
    for stage, row in summary.items():
        lines.append(
            f"{stage}: {row['median']:.0f} ms in the median, {row['p95']:.0f} ms p95, "
            f"{row['p99']:.0f} ms p99"
        )
    return "\n".join(lines)
