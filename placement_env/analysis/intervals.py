"""Intervals of figures over frames, by a block bootstrap.

Objects of the simulated traffic live four frames (paper section III; parked ones too), so frames
are not independent, but blocks of two lives nearly are: 0-7, 8-15 and so on. In blocks of one life,
objects often live on in the next block, which would show a fifth too little spread. Blocks are
drawn with replacement, as many as there are, and the interval holds the middle share of the figures
of the draws (percentile bootstrap; Efron and Tibshirani 1993, chapter 13; blocks: Künsch 1989).

Few blocks spread too little when drawn, so the share is widened by Student's t and n/(n - 1)
(expanded percentiles; Hesterberg 2015); fewer than `MIN_BLOCKS` have no interval (NaN). If all
draws agree, for example because everything is detected, the ends are Wilson's (1927) for as many
independent objects. Draws that leave a figure undefined, such as AP without a vehicle, are left
out. The same seed gives the same draws, so figures of several sensor sets on the same frames can be
compared draw by draw.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from placement_env.checks import check_whole
from placement_env.fidelity.detector import IGNORED, Outcome
from toolkit.arrays import Float64, Int64, Mask, Shaped
from toolkit.detection.metrics import average_precision, precision_recall
from toolkit.share_intervals import wilson_interval
from toolkit.traffic.spawner import LIFE

BLOCK_FRAMES = 2 * LIFE
MIN_BLOCKS = 10  # for an interval
RESAMPLES = 1000  # draws of a bootstrap
AP_TOLERANCE = 0.01  # difference that does not matter
MIN_SURE_FRAMES = 20  # for a statement on the confidence of a comparison
MIN_SURE_OBJECTS = 20  # for a statement on the confidence of a comparison
MAX_SURE_SHARE = 0.99  # highest confidence that resamples can distinguish
MAX_HELD_NUMBERS = 1 << 16  # in one step, so that they stay in the processor's cache
Resamples = Float64[np.ndarray, " resamples"]
Draws = Int64[np.ndarray, "resamples frames"]  # how often each resample draws each frame


class Interval(NamedTuple):
    """Lower and upper end; NaN if undefined in some draw."""

    low: float
    high: float


def block_draws(
    frames: int, *, block: int | None = None, resamples: int = RESAMPLES, seed: int = 0
) -> Draws:
    """Number of times that each resample draws each frame; equal for frames of one block.

    Args:
        frames: Number of consecutive frames.
        block: Frames of a block, None for `BLOCK_FRAMES`.
        resamples: Number of draws.
        seed: Seed of the draws.

    Raises ValueError for a number that is not a whole one from 1 up.
    """
    block_frames = BLOCK_FRAMES if block is None else block
    for name, value in (("frames", frames), ("block", block_frames), ("resamples", resamples)):
        check_whole(name, value, least=1)
    return draws_of_blocks(np.arange(frames) // block_frames, resamples=resamples, seed=seed)


def draws_of_blocks(
    blocks: Int64[np.ndarray, " frames"], *, resamples: int = RESAMPLES, seed: int = 0
) -> Draws:
    """Number of times that each resample draws each frame; equal for frames of one block.

    Args:
        blocks: Number of each frame's block, in any order.
        resamples: Number of draws.
        seed: Seed of the draws."""
    block_numbers, block_index = np.unique(blocks, return_inverse=True)
    block_count = len(block_numbers)
    chances = np.full(block_count, 1 / block_count)  # one for each block
    # how often each block is drawn; axes: resample, block
    block_counts = np.random.default_rng(seed).multinomial(block_count, chances, size=resamples)
    return np.asarray(block_counts[:, block_index], np.int64)


def ratio_interval(
    parts: ArrayLike, wholes: ArrayLike, *, seed: int = 0, confidence: float = 0.95
) -> Interval:
    """Interval of sum(parts) / sum(wholes) over frames, such as recall or a mean.

    Args:
        parts: Numerator of each frame, such as its number of hits.
        wholes: Denominator of each frame, such as its number of objects.
        seed: Seed of the resamples.
        confidence: Share of the resamples that the interval holds.

    Raises ValueError if the numbers of parts and wholes differ.
    """
    numerators = np.asarray(parts, np.float64)
    denominators = np.asarray(wholes, np.float64)
    if numerators.ndim != 1 or numerators.shape != denominators.shape:
        raise ValueError(
            f"there must be one part and one whole per frame, got {numerators.shape} and "
            f"{denominators.shape}"
        )
    ratios = resample_ratio(block_draws(len(numerators), seed=seed), numerators, denominators)
    return percentiles(ratios, count_blocks(len(numerators)), confidence=confidence)


def resample_ratio(
    draws: Shaped[np.ndarray, "resamples k"],
    parts: Shaped[np.ndarray, " k"],
    wholes: Shaped[np.ndarray, " k"],
) -> Resamples:
    """Return sum(parts) / sum(wholes) over k frames or blocks in each resample, NaN without wholes.

    draws: how often each resample draws each frame or block."""
    sums = draws @ wholes
    return np.divide(draws @ parts, sums, out=np.full(len(sums), np.nan), where=sums != 0)


def mean_interval(values: Sequence[float], *, seed: int = 0, confidence: float = 0.95) -> Interval:
    """Interval of the mean of independent values; NaN for fewer than `MIN_BLOCKS`.

    Args:
        values: Finite values, such as the error of each road user.
        seed: Seed of the resamples.
        confidence: Share of the resamples that the interval holds."""
    count = len(values)
    if count < MIN_BLOCKS:
        return Interval(math.nan, math.nan)
    draws = draws_of_blocks(np.arange(count), seed=seed)
    means = draws @ np.asarray(values, np.float64) / count
    return percentiles(means, count, confidence=confidence)


def count_blocks(frames: int) -> int:
    """Number of blocks of `BLOCK_FRAMES` consecutive frames; the last one may be shorter."""
    return -(-frames // BLOCK_FRAMES)  # rounded up


def percentiles(
    figures: Resamples,
    blocks: float = math.inf,
    *,
    confidence: float = 0.95,
    fewest: int = MIN_BLOCKS,
) -> Interval:
    """Interval that holds the middle share of the figures of some resamples.

    Args:
        figures: Figure of each resample; NaNs are left out.
        blocks: Number of blocks of frames that each figure is drawn from; the fewer they are, the
            more the share is widened.
        confidence: Share of the figures, before it is widened.
        fewest: Number of blocks below which the interval is NaN.

    Raises ValueError for a confidence outside (0, 1).
    """
    if not 0 < confidence < 1:
        raise ValueError(f"confidence must lie between 0 and 1, got {confidence}: 0.95 is usual")
    known_figures = figures[~np.isnan(figures)]
    if not len(known_figures) or blocks < fewest:
        return Interval(math.nan, math.nan)
    tail = (1 - confidence) / 2  # share of the figures below the interval
    if math.isfinite(blocks):
        from scipy.special import ndtr, stdtrit  # takes a tenth of what a command loads

        # quantile of Student's t, taken as one of the normal distribution (Hesterberg 2015)
        quantile = math.sqrt(blocks / (blocks - 1)) * stdtrit(blocks - 1, tail)
        tail = float(ndtr(quantile))
    positions = (len(known_figures) - 1) * np.array([tail, 1 - tail])
    # as np.quantile, in a third of its time
    low, high = np.interp(positions, np.arange(len(known_figures)), np.sort(known_figures))
    return Interval(float(low), float(high))


def figure_interval(
    figure: float,
    resamples: Resamples,
    *,
    blocks: float,
    objects: int = 0,
    confidence: float = 0.95,
    fewest: int = MIN_BLOCKS,
) -> Interval:
    """Interval of a share such as AP from its resamples, widened to hold the share.

    If all resamples agree, the interval is Wilson's for objects / `LIFE` independent objects, as
    one road user is an object in about `LIFE` frames.

    Args:
        figure: The share, in all frames.
        resamples: The share in each resample.
        blocks: Number of blocks of frames that a resample draws.
        objects: Number of objects behind the share, in all frames; 0 for no Wilson's interval.
        confidence: Share of the resamples that the interval holds.
        fewest: Number of blocks below which there is no interval.
    """
    low, high = percentiles(resamples, blocks, confidence=confidence, fewest=fewest)
    if low == high and objects:
        low, high = share_interval(figure, objects / LIFE, confidence)
    return Interval(low=min(low, figure), high=max(high, figure))


def share_interval(share: float, count: float, confidence: float) -> Interval:
    """Wilson's score interval of a share of independent objects.

    Args:
        share: Observed share, 0 to 1.
        count: Number of objects, not always whole.
        confidence: Level of the interval."""
    return Interval(*wilson_interval(share, count, confidence))


def describe_interval(low: float, high: float, digits: int = 3) -> str:
    """Words for an interval: "0.812 to 0.934", or why there is no interval if an end is NaN."""
    if math.isnan(low) or math.isnan(high):
        return f"no interval from fewer than {MIN_BLOCKS * BLOCK_FRAMES} frames"
    return f"{low:.{digits}f} to {high:.{digits}f}"


def describe_sureness(confidence: float) -> str:
    """Words for a confidence: at most "over 99%", since resamples never make certain."""
    return f"over {MAX_SURE_SHARE:.0%}" if confidence > MAX_SURE_SHARE else f"{confidence:.0%}"


def is_comparable(frames: int, objects: int) -> bool:
    """True if there are enough frames and objects to state the confidence of a comparison of
    sets."""
    return frames >= MIN_SURE_FRAMES and objects >= MIN_SURE_OBJECTS


def share_beyond_reach(figures: Resamples, tolerance: float = AP_TOLERANCE) -> float:
    """Share of the resamples of an AP or reward that are at least 1 - tolerance.

    As no figure is above 1, nothing can exceed these by more than the tolerance. So the share is a
    lower bound on the confidence that no other set is better. NaNs are left out.
    """
    known_figures = figures[~np.isnan(figures)]
    return float((known_figures >= 1 - tolerance).mean()) if len(known_figures) else 0.0


def frames_for_width(frames: int, width: float, target_width: float) -> int:
    """Number of frames, in whole blocks, that should narrow an interval to the target width.

    frames, width: number of frames and width of the present interval. A width falls with the root
    of the number of frames."""
    return BLOCK_FRAMES * math.ceil(frames * (width / target_width) ** 2 / BLOCK_FRAMES)


def is_as_good(figures: Resamples, best: Resamples, blocks: float) -> bool:
    """True if a figure is certainly within `AP_TOLERANCE` of the best.

    The interval of their differences must be within the tolerance; two figures whose separate
    intervals overlap may still differ.

    Args:
        figures: The figure in each resample.
        best: The best figure in the same resamples.
        blocks: Number of blocks of frames that a resample draws.
    """
    return bool(percentiles(best - figures, blocks).high <= AP_TOLERANCE)


@dataclass(frozen=True, eq=False)
class Tally:
    """Detections of one sensor set that count, and the number of objects in each frame.

    Attributes:
        scores: Score of each detection.
        hit: True if it hits an object.
        frame: Frame of each detection, from 0.
        truths: Number of objects in each frame.
    """

    scores: Float64[np.ndarray, " n"]
    hit: Mask
    frame: Int64[np.ndarray, " n"]
    truths: Int64[np.ndarray, " frames"]

    @staticmethod
    def from_outcomes(
        outcomes: Sequence[Outcome], truths: Int64[np.ndarray, " frames"], iou_index: int
    ) -> "Tally":
        """Tally of one set from its outcome in each frame.

        Args:
            outcomes: Outcome of the set in each frame.
            truths: Number of objects in each frame.
            iou_index: Row of `Outcome.truth`, which has one for each IoU threshold.
        """
        scores = []
        hit = []
        for outcome in outcomes:
            # object that each detection hits, or a negative number
            truth = outcome.truth[iou_index]
            is_counted = truth != IGNORED
            scores.append(outcome.scores[is_counted])
            hit.append(truth[is_counted] >= 0)
        return Tally.of_frames(scores, hit, truths)

    @staticmethod
    def of_frames(
        scores: Sequence[np.ndarray],
        hit: Sequence[np.ndarray],
        truths: Sequence[int] | Int64[np.ndarray, " frames"],
    ) -> "Tally":
        """Tally of the detections that count.

        Args:
            scores: For each frame, the score of each detection.
            hit: For each frame, True for each detection that hits an object.
            truths: Number of objects in each frame.
        """
        counts = [len(frame_scores) for frame_scores in scores]
        return Tally(
            scores=np.concatenate(scores),
            hit=np.concatenate(hit),
            frame=np.repeat(np.arange(len(scores)), counts),
            truths=np.asarray(truths, np.int64),
        )

    @property
    def ap(self) -> float:
        """Average precision; NaN without objects."""
        object_count = int(self.truths.sum())
        if not object_count:
            return float("nan")
        return average_precision(precision_recall(self.scores, self.hit, object_count))

    @property
    def recall(self) -> float:
        """Share of the objects that were hit; NaN without objects."""
        object_count = int(self.truths.sum())
        return float(self.hit.sum() / object_count) if object_count else float("nan")

    @property
    def precision(self) -> float:
        """Share of detections that hit; NaN without a detection."""
        return float(self.hit.mean()) if len(self.hit) else float("nan")

    def resamples(self, *, seed: int = 0, draws: Draws | None = None) -> Resamples:
        """All-point interpolated AP of each resample of blocks of frames; NaN without objects.

        One seed draws the same blocks for every tally. draws: how often each resample (row) has
        each frame (column), from `draws_of_blocks`; None for blocks of consecutive frames.
        """
        draws = block_draws(len(self.truths), seed=seed) if draws is None else draws
        order = np.argsort(-self.scores)
        scores = self.scores[order]
        hits = self.hit[order]
        frame = self.frame[order]
        # detections of equal scores come together: only the last row of each score counts
        is_last = np.append(scores[1:] != scores[:-1], True)[: len(scores)]
        last_rows = np.flatnonzero(is_last)
        batch_size = max(1, MAX_HELD_NUMBERS // max(len(frame), 1))
        aps = []
        for first in range(0, len(draws), batch_size):
            batch_draws = draws[first : first + batch_size]
            weights = batch_draws[:, frame]  # how often each resample has each detection
            object_counts = batch_draws @ self.truths  # in each resample
            detections_so_far = np.cumsum(weights, axis=1)[:, last_rows]
            hits_so_far = np.cumsum(weights * hits, axis=1)[:, last_rows]
            precision = np.divide(
                hits_so_far,
                detections_so_far,
                out=np.zeros(detections_so_far.shape),
                where=detections_so_far > 0,
            )
            # highest precision at this recall or a higher one
            envelope = np.maximum.accumulate(precision[:, ::-1], axis=1)[:, ::-1]
            area = (np.diff(hits_so_far, prepend=0) * envelope).sum(axis=1)
            no_aps = np.full(len(object_counts), np.nan)
            aps.append(np.divide(area, object_counts, out=no_aps, where=object_counts > 0))
        return np.concatenate(aps)

    def interval(self, *, confidence: float = 0.95, seed: int = 0) -> Interval:
        """Interval of the AP over blocks of frames; NaN for few blocks, or without objects.

        confidence: share of the resamples that it holds; seed: seed of the resamples."""
        return figure_interval(
            self.ap,
            self.resamples(seed=seed),
            blocks=count_blocks(len(self.truths)),
            objects=int(self.truths.sum()),
            confidence=confidence,
        )
