"""Tallies: what became of one sensor set's detections in frame after frame, its figures and the interval of its AP."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from placement_env.analysis.intervals import Interval, ap_interval, ap_resamples
from placement_env.fidelity.detector import IGNORED, Outcome
from toolkit.arrays import Bool, Float64, Int64
from toolkit.detection.metrics import average_precision, precision_recall


@dataclass(frozen=True, eq=False)
class Tally:
    """What became of the detections that count, and what there was to find. scores: of each detection; hit: whether it
    hit; frame: in which, from 0; truths: how many were to be found in each frame."""

    scores: Float64[np.ndarray, " n"]
    hit: Bool[np.ndarray, " n"]
    frame: Int64[np.ndarray, " n"]
    truths: Int64[np.ndarray, " frames"]

    @staticmethod
    def of(outcomes: Sequence[Outcome], truths: Int64[np.ndarray, " frames"], at: int) -> Tally:
        """Of one sensor set in frame after frame, at the IoU threshold of index `at`."""
        counts = [each.truth[at] != IGNORED for each in outcomes]
        scores = [each.scores[counted] for each, counted in zip(outcomes, counts, strict=True)]
        hit = [each.truth[at, counted] >= 0 for each, counted in zip(outcomes, counts, strict=True)]
        return Tally.of_frames(scores, hit, truths)

    @staticmethod
    def of_frames(
        scores: Sequence[np.ndarray], hit: Sequence[np.ndarray], truths: Sequence[int] | Int64[np.ndarray, " frames"]
    ) -> Tally:
        """Of the detections that count in frame after frame."""
        frame = np.repeat(np.arange(len(scores)), [len(each) for each in scores])
        return Tally(np.concatenate(scores), np.concatenate(hit), frame, np.asarray(truths, np.int64))

    @property
    def ap(self) -> float:
        """Average precision; NaN without anything to find."""
        to_find = int(self.truths.sum())
        return average_precision(precision_recall(self.scores, self.hit, to_find)) if to_find else float("nan")

    @property
    def recall(self) -> float:
        """Share that was hit; NaN without anything to find."""
        to_find = int(self.truths.sum())
        return float(self.hit.sum() / to_find) if to_find else float("nan")

    @property
    def precision(self) -> float:
        """Share of the detections that hit; NaN without a detection."""
        return float(self.hit.mean()) if len(self.hit) else float("nan")

    def resamples(
        self, *, seed: int = 0, draws: Int64[np.ndarray, "resamples frames"] | None = None
    ) -> Float64[np.ndarray, " resamples"]:
        """AP of each resample of blocks of frames; of one seed the same blocks, whatever is tallied. draws: how often
        each frame is drawn in each, None for blocks of frames that follow each other."""
        return ap_resamples(*self._by_frame(), seed=seed, draws=draws)

    def interval(self, *, confidence: float = 0.95, seed: int = 0) -> Interval:
        """Interval of the AP by a bootstrap over blocks of frames; NaN where no draw has anything to find."""
        return ap_interval(*self._by_frame(), seed=seed, confidence=confidence)

    def _by_frame(self) -> tuple[list[np.ndarray], list[np.ndarray], list[int]]:
        rows = [np.flatnonzero(self.frame == k) for k in range(len(self.truths))]
        return [self.scores[row] for row in rows], [self.hit[row] for row in rows], self.truths.tolist()
