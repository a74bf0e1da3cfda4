"""Judging: sensor sets by the detector on traffic that no search saw, with intervals and the number of vehicles."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from placement_env.analysis.tally import Tally
from placement_env.fidelity.detector import Detected, Outcome
from placement_env.report.content import CONFIDENCE, Judgement
from toolkit.arrays import Bool, Int64


@dataclass(frozen=True, eq=False)
class Judge:
    """The detector on one part of the traffic. seed: of the bootstrap."""

    detected: Detected
    seed: int

    def judge(
        self,
        sets: Bool[np.ndarray, "n C"],
        *,
        iou: float | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> list[Judgement]:
        """Judgement of each set over all frames. iou: None for the plan's own; progress: called with how many frames
        are done, where any has to be."""
        rows = [tuple(np.flatnonzero(row).tolist()) for row in sets]
        outcomes = self.detected.outcomes(dict.fromkeys(rows), range(self.frames), progress)
        return [judgement(self.tally(outcomes[row], iou), self.seed) for row in rows]

    def tally(self, outcomes: Sequence[Outcome], iou: float | None = None) -> Tally:
        """What became of one set's detections."""
        at = self.detected.ious.index(self.detected.iou if iou is None else iou)
        return Tally.of(outcomes, self.truths, at)

    def outcomes(self, chosen: tuple[int, ...]) -> list[Outcome]:
        """Of one set in every frame."""
        return self.detected.outcomes([chosen], range(self.frames))[chosen]

    @property
    def frames(self) -> int:
        """How many frames it judges by."""
        return self.detected.frames

    @property
    def truths(self) -> Int64[np.ndarray, " frames"]:
        """Vehicles to be found in each frame."""
        return np.array([self.detected.scored(k).sum() for k in range(self.frames)], np.int64)


def judgement(tally: Tally, seed: int) -> Judgement:
    """Figures of a tally in which there is something to find; the interval holds the AP itself."""
    low, high = tally.interval(confidence=CONFIDENCE, seed=seed)
    ap, precision = tally.ap, tally.precision
    return Judgement(
        ap=ap,
        low=min(low, ap),
        high=max(high, ap),
        recall=tally.recall,
        precision=None if math.isnan(precision) else precision,
        vehicles=int(tally.truths.sum()),
        frames=len(tally.truths),
    )
