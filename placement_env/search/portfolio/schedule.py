"""`Schedule`: time of a portfolio, and `TimedEvaluator`, which stops when its time is up.

Unused time of a stage goes to the next.
"""

import time
from dataclasses import dataclass, field, replace

import numpy as np

from placement_env.analysis.case_figures import CaseFigures
from placement_env.analysis.intervals import BLOCK_FRAMES
from placement_env.search.portfolio.evaluators import CasesEvaluator, Frames, Report
from placement_env.subsets import Sets
from toolkit.arrays import Float64
from toolkit.runtime.run import Processes

SEARCH_TIME_SHARE = 0.3  # portfolio's time for searches; races and judgement share the rest
FULL_TRAFFIC_S = 120.0  # time from which all frames are simulated; less time, fewer frames
MIN_FRAMES = BLOCK_FRAMES  # fewest in a part of traffic
RAY_FRAMES = 16  # between two looks at the clock if Ray runs the processes


@dataclass(eq=False)
class TimedEvaluator:
    """Evaluation frame by frame until time is up, which reports the number of frames done.

    It is called with the same frames in the same order every time, for fewer and fewer sets.

    Attributes:
        evaluator: Evaluator of sets on given frames.
        end_s: End of the time by the monotonic clock (s).
        frames_between_looks: Frames between two looks at the clock.
        min_frames: Number of frames done regardless of time.
        done: Number of frames done so far, from the first one.
    """

    evaluator: CasesEvaluator
    end_s: float
    frames_between_looks: int = 1
    min_frames: int = 1
    done: int = 0

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.evaluator.frames

    def mean_ap(self, sets: Sets, frames: Frames) -> Float64[np.ndarray, " n"]:
        """Mean AP over the detector's IoU thresholds, regardless of the time."""
        return self.evaluator.mean_ap(sets, frames)

    def evaluate(self, sets: Sets, frames: Frames, progress: Report | None = None) -> CaseFigures:
        """Evaluate the sets on as many frames as time allows, at least `min_frames`.

        New frames are evaluated a few at a time, with looks at the clock between; then all of them
        together. Frames done in earlier calls are not evaluated singly again. `CaseFigures.used` is
        the number of frames used, None for all. progress: called with the number of frames done.
        """
        while self.done < len(frames):
            if self.done >= self.min_frames and time.monotonic() >= self.end_s:
                break
            next_frames = frames[self.done : self.done + self.frames_between_looks]
            self.evaluator.evaluate(sets, next_frames)  # for its detections, which are kept
            self.done += len(next_frames)
            if progress is not None:
                progress(self.done)
        used_count = min(self.done, len(frames))
        figures = self.evaluator.evaluate(sets, frames[:used_count])
        return replace(figures, used=None if used_count == len(frames) else used_count)


FrameEvaluator = CasesEvaluator | TimedEvaluator


@dataclass(frozen=True)
class Schedule:
    """Time for searches, race and assessment of a portfolio.

    Attributes:
        seconds: Time for everything (s), None for no limit.
        frames_between_looks: Frames between two looks at the clock.
        began: Begin by the monotonic clock (s).
    """

    seconds: float | None = None
    frames_between_looks: int = 1
    began: float = field(default_factory=time.monotonic)

    @staticmethod
    def from_processes(seconds: float | None, processes: Processes) -> "Schedule":
        """Schedule from now on, for frames that are evaluated in these processes.

        Between two looks at the clock there are enough frames to keep all processes busy.

        seconds: time for everything, None for no limit.
        """
        if processes.ray:
            return Schedule(seconds, frames_between_looks=RAY_FRAMES)
        # 2: so that no process waits while another one finishes
        return Schedule(
            seconds, frames_between_looks=1 if processes.has_one_process else 2 * processes.count
        )

    @property
    def remaining_s(self) -> float:
        """Remaining seconds, infinite without a limit."""
        return np.inf if self.seconds is None else self.began + self.seconds - time.monotonic()

    def search_seconds(self, searches: int) -> float | None:
        """Seconds of each search if this number of searches share their part of the time.

        None without a limit.
        """
        return None if self.seconds is None else self.seconds * SEARCH_TIME_SHARE / searches

    def limit_frames(self, frames: int) -> int:
        """Number of frames of one part of traffic that fit into the time, in whole blocks.

        frames: number of frames without a limit, which is returned for `FULL_TRAFFIC_S` seconds or
        more.
        """
        if self.seconds is None or self.seconds >= FULL_TRAFFIC_S:
            return frames
        blocks = int(frames * self.seconds / FULL_TRAFFIC_S) // BLOCK_FRAMES
        return min(frames, max(MIN_FRAMES, blocks * BLOCK_FRAMES))

    def limit(
        self, evaluator: CasesEvaluator, share: float = 1.0, min_frames: int = MIN_FRAMES
    ) -> FrameEvaluator:
        """Evaluator that stops after a share of the remaining time, but not before `min_frames`.

        Without a limit the evaluator comes back unchanged.
        """
        if self.seconds is None:
            return evaluator
        return TimedEvaluator(
            evaluator,
            end_s=time.monotonic() + share * self.remaining_s,
            frames_between_looks=self.frames_between_looks,
            min_frames=min_frames,
        )
