"""Time of a portfolio: searches, race and judgement each get a share; what one leaves goes to the next.

The searches together may take `SEARCHING` of it; races and judgement share what is then left alike. They look at the
clock after every few frames and make do with the frames there was time for, so that the whole takes hardly longer than
it may; less time also means fewer frames to simulate and render.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from placement_env.analysis.intervals import BLOCK_FRAMES
from placement_env.search.portfolio.evaluators import Evaluated, Evaluator
from toolkit.arrays import Bool, Int64
from toolkit.runtime.run import Processes

SEARCHING = 0.3
LONG_ENOUGH = 120.0  # s, from which on all frames are simulated; of less time a proportional part
FEWEST = 2 * BLOCK_FRAMES  # frames of a part of traffic


@dataclass(eq=False)
class TimedEvaluator:
    """An evaluator that goes on from frame to frame until time is up, on the monotonic clock (s), and says how many it
    did. It is asked for the same frames in the same order every time, of which it has done some already, for fewer and
    fewer sets. at_once: frames between two looks at the clock; least: that are done whatever the time."""

    evaluator: Evaluator
    until: float
    at_once: int = 1
    least: int = 1
    done: int = field(default=0, init=False)

    @property
    def name(self) -> str:
        """Name of the fidelity."""
        return self.evaluator.name

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.evaluator.frames

    def count_objects(self, frames: Int64[np.ndarray, " k"]) -> int:
        """Number of objects to be found in these frames."""
        return self.evaluator.count_objects(frames)

    @property
    def spent(self) -> bool:
        """True where time is up."""
        return time.monotonic() >= self.until

    def evaluate(
        self,
        sets: Bool[np.ndarray, "n C"],
        frames: Int64[np.ndarray, " k"],
        progress: Callable[[int], None] | None = None,
    ) -> Evaluated:
        """The sets on as many of the frames as there is time for."""
        while self.done < len(frames) and not (self.done >= self.least and self.spent):
            part = frames[self.done : self.done + self.at_once]
            self.evaluator.evaluate(sets, part)
            self.done += len(part)
            if progress is not None:
                progress(self.done)
        counted = min(self.done, len(frames))
        found = self.evaluator.evaluate(sets, frames[:counted])
        return found._replace(frames=None if counted == len(frames) else counted)


@dataclass(frozen=True)
class Schedule:
    """seconds: for everything from now on, None for no limit; at_once: frames between two looks at the clock."""

    seconds: float | None = None
    at_once: int = 1
    began: float = field(default_factory=time.monotonic)

    @staticmethod
    def of(seconds: float | None, processes: Processes) -> Schedule:
        """Schedule that takes as many frames at once as keep the processes busy."""
        return Schedule(seconds, 16 if processes.ray else 1 if processes.alone else 2 * processes.count)

    @property
    def left(self) -> float:
        """Seconds that are left, infinite without a limit."""
        return np.inf if self.seconds is None else self.began + self.seconds - time.monotonic()

    def searching(self, searches: int) -> float | None:
        """Seconds of each search, of so many."""
        return None if self.seconds is None else self.seconds * SEARCHING / searches

    def frames(self, frames: int) -> int:
        """Number of frames of a part of traffic there is time for, in whole blocks."""
        if self.seconds is None or self.seconds >= LONG_ENOUGH:
            return frames
        blocks = int(frames * self.seconds / LONG_ENOUGH) // BLOCK_FRAMES
        return min(frames, max(FEWEST, blocks * BLOCK_FRAMES))

    def racing(self, evaluator: Evaluator, races: int = 1) -> Evaluator:
        """The evaluator of a race that begins now, of so many that are still to come with it."""
        return self._limit(evaluator, self.left / (races + 1), 1)

    def judging(self, evaluator: Evaluator) -> Evaluator:
        """The evaluator of sets that are judged from now on, on `FEWEST` frames at least: fewer say nothing."""
        return self._limit(evaluator, self.left, FEWEST)

    def _limit(self, evaluator: Evaluator, seconds: float, least: int) -> Evaluator:
        if self.seconds is None:
            return evaluator
        return TimedEvaluator(evaluator, time.monotonic() + seconds, self.at_once, least)
