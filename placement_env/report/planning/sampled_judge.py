"""`SampledJudge`: sets in a sample of the frames, next to a whole set judged in all.

Parts of the chosen set and other fusion schemes are only compared with the chosen set, so they are
judged in some frames of each block. Their figures in all frames are estimated as the whole set's,
times the ratio of both in the sample (ratio estimate of survey sampling; Cochran 1977). Resamples
draw the same blocks for all, so the intervals contain the error of the sample.
"""

from dataclasses import dataclass

import numpy as np

from placement_env.analysis.case_figures import scale_figures
from placement_env.analysis.intervals import BLOCK_FRAMES
from placement_env.cases import Cases
from placement_env.report.content import Judgement
from placement_env.report.planning.judging import DrawnAPs, Judge, build_judgement
from placement_env.search.portfolio.evaluators import Frames, Report
from toolkit.arrays import Bool

SAMPLE_STRIDE = 3  # between sampled frames of a block
MIN_SAMPLED_FRAMES = 96  # with fewer frames, all are used


def sample_frames(frames: int) -> Frames:
    """Return the numbers of the sampled frames, ascending: all if there are few.

    Every block has some, so that its objects count.

    frames: number of all frames."""
    all_frames = np.arange(frames)
    if frames < MIN_SAMPLED_FRAMES:
        return all_frames
    return all_frames[all_frames % BLOCK_FRAMES % SAMPLE_STRIDE == 0]


@dataclass(frozen=True, eq=False)
class SampledJudge:
    """Judge of sets in a sample of the frames, next to a whole set.

    Attributes:
        whole_judge: Judge of the whole set.
        whole_set: The whole set as the only row."""

    whole_judge: Judge
    whole_set: Bool[np.ndarray, "1 candidates"]

    @property
    def frames(self) -> Frames:
        """Numbers of the sampled frames, ascending."""
        return sample_frames(self.whole_judge.frames)

    def judge_sets(
        self,
        judge: Judge,
        sets: Bool[np.ndarray, "n candidates"],
        cases: Cases,
        progress: Report | None = None,
    ) -> tuple[list[Judgement], DrawnAPs]:
        """Judge sets over cases; return one result for each set, and AP in each resample.

        Frames and objects are counted in the sample.

        Args:
            judge: Judge of the sets, on the frames of the whole set's.
            sets: A row of booleans over all candidates for each set.
            cases: Conditions to reduce over.
            progress: Called with the number of frames done."""
        if not len(sets):
            return [], np.empty((0, 0))
        whole_judge = self.whole_judge
        figures = judge.evaluate(sets, cases, self.frames, progress)
        if len(self.frames) < whole_judge.frames:
            whole_figures = whole_judge.evaluate(
                self.whole_set, cases, np.arange(whole_judge.frames)
            )
            sampled_figures = whole_judge.evaluate(self.whole_set, cases, self.frames)
            figures = scale_figures(figures, sampled_figures[0], whole_figures[0])
        classes = judge.detected.classes
        judgements = [build_judgement(figures[n], self.frames, classes) for n in range(len(sets))]
        return judgements, figures.resamples
