"""Time of a portfolio, shared by its stages.

Searches, race and judgement each get a share; unused time goes to the next. The searches together may take `SEARCHING`
of it; races and judgement share the rest equally. They check the clock every few frames and stop when time is up, so
the whole hardly exceeds its limit. Less time also means fewer frames to simulate and render.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from placement_env.analysis.intervals import BLOCK_FRAMES
from placement_env.search.portfolio.evaluators import Evaluated, Evaluator, Frames, Report, Sets
from toolkit.runtime.run import Processes

SEARCHING = 0.3
LONG_ENOUGH = 120.0  # s above which all frames are simulated; with less, a proportional part
FEWEST = 2 * BLOCK_FRAMES  # frames of a part of traffic


@dataclass(eq=False)
class TimedEvaluator:
    """Evaluate frame by frame until time is up, by the monotonic clock (s), and report the number of frames done.

    It is called with the same frames in the same order every time, some of them already done, for fewer and fewer sets.
    at_once: frames between two looks at the clock; least: frames done regardless of time.
    """

    evaluator: Evaluator
    until: float
    at_once: int = 1
    least: int = 1
    done: int = field(default=0, init=False)

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.evaluator.frames

    def evaluate(self, sets: Sets, frames: Frames, progress: Report | None = None) -> Evaluated:
        """Evaluate the sets on as many frames as time allows."""
        while self.done < len(frames) and (self.done < self.least or time.monotonic() < self.until):
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
    """Seconds for everything from now on, None for no limit. at_once: frames between two looks at the clock."""

    seconds: float | None = None
    at_once: int = 1
    began: float = field(default_factory=time.monotonic)

    @staticmethod
    def of(seconds: float | None, processes: Processes) -> Schedule:
        """Schedule with batches that keep the processes busy."""
        return Schedule(seconds, 16 if processes.ray else 1 if processes.alone else 2 * processes.count)

    @property
    def left(self) -> float:
        """Seconds that are left, infinite without a limit."""
        return np.inf if self.seconds is None else self.began + self.seconds - time.monotonic()

    def searching(self, searches: int) -> float | None:
        """Seconds of each search, for a number of searches."""
        return None if self.seconds is None else self.seconds * SEARCHING / searches

    def frames(self, frames: int) -> int:
        """Number of frames of one part of traffic that fit, in whole blocks."""
        if self.seconds is None or self.seconds >= LONG_ENOUGH:
            return frames
        blocks = int(frames * self.seconds / LONG_ENOUGH) // BLOCK_FRAMES
        return min(frames, max(FEWEST, blocks * BLOCK_FRAMES))

    def racing(self, evaluator: Evaluator, races: int = 1) -> Evaluator | TimedEvaluator:
        """Evaluator of a race that begins now. The number of races still to come includes this one."""
        return self._limit(evaluator, self.left / (races + 1), 1)

    def judging(self, evaluator: Evaluator) -> Evaluator | TimedEvaluator:
        """Evaluator of sets that are judged from now on. It uses at least `FEWEST` frames: fewer say nothing."""
        return self._limit(evaluator, self.left, FEWEST)

    def _limit(self, evaluator: Evaluator, seconds: float, least: int) -> Evaluator | TimedEvaluator:
        if self.seconds is None:
            return evaluator
        return TimedEvaluator(evaluator, time.monotonic() + seconds, self.at_once, least)
