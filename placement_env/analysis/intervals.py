"""AP with an interval: a bootstrap over blocks of frames.

Neighbouring frames show nearly the same traffic, an object living four frames, so that frames are no independent
sample. Blocks of `BLOCK_FRAMES` consecutive frames are drawn with replacement, as many as there are, and the AP of each
draw is found as `toolkit.detection.metrics` defines it (Künsch 1989; percentile interval, Efron 1979). Draws without
anything to find are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from placement_env.fidelity.detector import IGNORED, Outcome
from toolkit.arrays import Bool, Float64, Int64
from toolkit.detection.metrics import average_precision, precision_recall

BLOCK_FRAMES = 4  # that an object lives
DRAWS = 1000
_AT_ONCE = 1 << 22  # figures in memory at once


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
        frame = np.repeat(np.arange(len(outcomes)), [len(each) for each in scores])
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


def interval(
    tally: Tally, *, block: int = BLOCK_FRAMES, draws: int = DRAWS, confidence: float = 0.95, seed: int = 0
) -> tuple[float, float]:
    """Interval of the AP; NaN where no draw has anything to find. The same tally and seed give the same interval."""
    first = np.arange(0, len(tally.truths), block)
    chosen = np.random.default_rng(seed).integers(len(first), size=(draws, len(first)))
    times = np.zeros((draws, len(first)), np.int64)
    np.add.at(times, (np.arange(draws)[:, None], chosen), 1)
    ap = weighted_ap(tally, np.repeat(times, block, axis=1)[:, : len(tally.truths)])
    ap = ap[np.isfinite(ap)]
    if not len(ap):
        return float("nan"), float("nan")
    low, high = np.quantile(ap, [(1 - confidence) / 2, (1 + confidence) / 2])
    return float(low), float(high)


def weighted_ap(tally: Tally, times: Int64[np.ndarray, "draws frames"]) -> Float64[np.ndarray, " draws"]:
    """AP of samples in which each frame comes so many times; NaN where a sample has nothing to find.

    >>> tally = Tally(np.array([0.9, 0.8]), np.array([True, False]), np.array([0, 1]), np.array([1, 1]))
    >>> weighted_ap(tally, np.array([[1, 1], [2, 0], [0, 2]]))
    array([0.5, 1. , 0. ])
    """
    order = np.argsort(-tally.scores, kind="stable")
    scores, hit, frame = tally.scores[order], tally.hit[order], tally.frame[order]
    ends = np.flatnonzero(np.append(scores[1:] != scores[:-1], True)[: len(scores)])
    to_find = times @ tally.truths
    ap = np.where(to_find > 0, 0.0, np.nan)
    if not len(scores):
        return ap
    step = max(1, _AT_ONCE // len(scores))
    for rows in (slice(begin, begin + step) for begin in range(0, len(times), step)):
        weight = times[rows][:, frame]
        found, all_of_them = np.cumsum(weight * hit, axis=1)[:, ends], np.cumsum(weight, axis=1)[:, ends]
        precision = found / np.maximum(all_of_them, 1)
        envelope = np.maximum.accumulate(precision[:, ::-1], axis=1)[:, ::-1]
        gained = np.diff(found, axis=1, prepend=0)
        ap[rows] += (gained * envelope).sum(axis=1) / np.maximum(to_find[rows], 1)
    return ap
