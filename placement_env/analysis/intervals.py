"""Intervals of figures over frames, by a block bootstrap.

Objects of the simulated traffic live four frames (paper section III; parked ones too), so frames
are not independent but blocks of two lives are nearly: 0-7, 8-15 and so on; blocks of one, whose
objects often live on in the next, would show a fifth too little spread. Blocks are drawn with
replacement, as many as there are, and the interval holds the middle share of the figures of the
draws (percentile bootstrap; Efron and Tibshirani 1993, chapter 13; blocks: Künsch 1989). Few blocks
spread too little when drawn, so the share is widened as Student's t and n/(n - 1) ask (expanded
percentiles; Hesterberg 2015); fewer than `FEWEST_BLOCKS` have no interval (NaN). Where all draws
agree, as when everything is found, the ends are Wilson's (1927) for as many independent objects.
Draws that leave a figure undefined, such as AP without a vehicle, are left out. The same seed gives
the same draws, so figures of several sensor sets on the same frames can be compared draw by
draw."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from placement_env.checks import check_whole
from placement_env.fidelity.detector import IGNORED, Outcome
from toolkit.arrays import Float64, Int64, Mask
from toolkit.detection.metrics import average_precision, precision_recall
from toolkit.traffic.spawner import LIFE

BLOCK_FRAMES = 2 * LIFE
FEWEST_BLOCKS = 10  # that have an interval
RESAMPLES = 1000
AP_TOLERANCE = 0.01  # difference in AP that does not matter
# below which nothing is said of how sure a comparison is
FEWEST_SURE_FRAMES = 20
FEWEST_SURE_OBJECTS = 20
MAX_SURE = 0.99  # beyond which a confidence from resamples is not told apart
HELD_AT_ONCE = 1 << 21  # numbers held in memory at once
Resamples = Float64[np.ndarray, " resamples"]
Draws = Int64[np.ndarray, "resamples frames"]  # how often each resample draws each frame


class Interval(NamedTuple):
    """Lower and upper end; NaN if undefined in some draw."""

    low: float
    high: float


def block_draws(
    frames: int, *, block: int | None = None, resamples: int = RESAMPLES, seed: int = 0
) -> Draws:
    """Count how often each resample draws each frame; frames of one block have equal counts.

    block: frames of one, None for `BLOCK_FRAMES`."""
    block = BLOCK_FRAMES if block is None else block
    for name, value in (("frames", frames), ("block", block), ("resamples", resamples)):
        check_whole(name, value, least=1)
    return draws_of_blocks(np.arange(frames) // block, resamples=resamples, seed=seed)


def draws_of_blocks(
    blocks: Int64[np.ndarray, " frames"], *, resamples: int = RESAMPLES, seed: int = 0
) -> Draws:
    """Count how often each resample draws each frame. blocks: of each frame, in any order."""
    different, place = np.unique(blocks, return_inverse=True)
    shares = np.full(len(different), 1 / len(different))
    drawn = np.random.default_rng(seed).multinomial(len(different), shares, size=resamples)
    return np.asarray(drawn[:, place], np.int64)


def ratio_interval(
    parts: ArrayLike, wholes: ArrayLike, *, seed: int = 0, confidence: float = 0.95
) -> Interval:
    """Return the interval of sum(parts) / sum(wholes), one of each per frame, such as recall or a
    mean."""
    part = np.asarray(parts, np.float64)
    whole = np.asarray(wholes, np.float64)
    if part.ndim != 1 or part.shape != whole.shape:
        raise ValueError(
            f"there must be one part and one whole per frame, got {part.shape} and {whole.shape}"
        )
    draws = block_draws(len(part), seed=seed)
    sums = draws @ whole
    ratios = np.divide(draws @ part, sums, out=np.full(len(sums), np.nan), where=sums != 0)
    return percentiles(ratios, count_blocks(len(part)), confidence=confidence)


def count_blocks(frames: int) -> int:
    """Number of blocks of consecutive frames."""
    return -(-frames // BLOCK_FRAMES)


def percentiles(
    figures: Resamples,
    blocks: float = math.inf,
    *,
    confidence: float = 0.95,
    fewest: int = FEWEST_BLOCKS,
) -> Interval:
    """Return the middle share of the defined figures. blocks: number that each is drawn from, NaN
    below `fewest`."""
    if not 0 < confidence < 1:
        raise ValueError(f"confidence must lie between 0 and 1, got {confidence}: 0.95 is usual")
    defined = figures[~np.isnan(figures)]
    if not len(defined) or blocks < fewest:
        return Interval(math.nan, math.nan)
    outside = (1 - confidence) / 2
    if math.isfinite(blocks):
        from scipy.special import ndtr, stdtrit  # takes a tenth of what a command loads

        outside = float(ndtr(math.sqrt(blocks / (blocks - 1)) * stdtrit(blocks - 1, outside)))
    places = (len(defined) - 1) * np.array([outside, 1 - outside])
    # as np.quantile, in a third of its time
    low, high = np.interp(places, np.arange(len(defined)), np.sort(defined))
    return Interval(float(low), float(high))


def figure_interval(
    figure: float,
    resamples: Resamples,
    *,
    blocks: float,
    objects: int = 0,
    confidence: float = 0.95,
    fewest: int = FEWEST_BLOCKS,
) -> Interval:
    """Return the interval of a share such as AP, widened to hold it.

    objects: number that it is a share of, in all frames; where all resamples agree, as many as live
    one after another count as independent."""
    low, high = percentiles(resamples, blocks, confidence=confidence, fewest=fewest)
    if low == high and objects:
        low, high = share_interval(figure, objects / LIFE, confidence)
    return Interval(min(low, figure), max(high, figure))


def share_interval(share: float, count: float, confidence: float) -> Interval:
    """Return Wilson's score interval of a share of independent objects."""
    z = NormalDist().inv_cdf((1 + confidence) / 2)
    middle = share + z**2 / (2 * count)
    spread = z * math.sqrt(share * (1 - share) / count + (z / (2 * count)) ** 2)
    return Interval(
        (middle - spread) / (1 + z**2 / count), min(1.0, (middle + spread) / (1 + z**2 / count))
    )


def describe_interval(low: float, high: float, digits: int = 3) -> str:
    """Words for an interval."""
    if math.isnan(low) or math.isnan(high):
        return f"no interval from fewer than {FEWEST_BLOCKS * BLOCK_FRAMES} frames"
    return f"{low:.{digits}f} to {high:.{digits}f}"


def describe_sureness(confidence: float) -> str:
    """Words for a confidence, which resamples never make certain."""
    return f"over {MAX_SURE:.0%}" if confidence > MAX_SURE else f"{confidence:.0%}"


def is_comparable(frames: int, objects: int) -> bool:
    """True if there are frames and objects enough to say how sure a comparison of sets is."""
    return frames >= FEWEST_SURE_FRAMES and objects >= FEWEST_SURE_OBJECTS


def share_beyond_reach(figures: Resamples, tolerance: float = AP_TOLERANCE) -> float:
    """Share of the resamples of an AP, or of a reward, that nothing exceeds by more than the
    tolerance, as it would be above 1. It bounds from below how sure it is that no other set is
    better."""
    defined = figures[~np.isnan(figures)]
    return float((defined >= 1 - tolerance).mean()) if len(defined) else 0.0


def frames_for_width(frames: int, width: float, wanted: float) -> int:
    """Frames, in whole blocks, that should narrow an interval of some frames to the wanted
    width."""
    return BLOCK_FRAMES * math.ceil(frames * (width / wanted) ** 2 / BLOCK_FRAMES)


def is_as_good(figures: Resamples, best: Resamples, blocks: float) -> bool:
    """True if a figure is surely within `AP_TOLERANCE` of the best: the whole interval of the
    paired loss is.

    Two figures whose intervals overlap may still differ; on the same frames the loss has an
    interval of its own."""
    return bool(percentiles(best - figures, blocks).high <= AP_TOLERANCE)


@dataclass(frozen=True, eq=False)
class Tally:
    """One sensor set's detections that count, and the number of truths to find in each frame.
    frame: from 0."""

    scores: Float64[np.ndarray, " n"]
    hit: Mask
    frame: Int64[np.ndarray, " n"]
    truths: Int64[np.ndarray, " frames"]

    @staticmethod
    def of(outcomes: Sequence[Outcome], truths: Int64[np.ndarray, " frames"], at: int) -> "Tally":
        """Tally outcomes at the IoU threshold of index `at`."""
        counts = [(each, each.truth[at] != IGNORED) for each in outcomes]
        hit = [each.truth[at, counted] >= 0 for each, counted in counts]
        return Tally.of_frames([each.scores[counted] for each, counted in counts], hit, truths)

    @staticmethod
    def of_frames(
        scores: Sequence[np.ndarray],
        hit: Sequence[np.ndarray],
        truths: Sequence[int] | Int64[np.ndarray, " frames"],
    ) -> "Tally":
        """Tally the detections that count, given frame by frame."""
        frame = np.repeat(np.arange(len(scores)), [len(each) for each in scores])
        return Tally(
            np.concatenate(scores), np.concatenate(hit), frame, np.asarray(truths, np.int64)
        )

    @property
    def ap(self) -> float:
        """Average precision; NaN without anything to find."""
        to_find = int(self.truths.sum())
        return (
            average_precision(precision_recall(self.scores, self.hit, to_find))
            if to_find
            else float("nan")
        )

    @property
    def recall(self) -> float:
        """Share of truths that were hit; NaN without truths."""
        to_find = int(self.truths.sum())
        return float(self.hit.sum() / to_find) if to_find else float("nan")

    @property
    def precision(self) -> float:
        """Share of detections that hit; NaN without a detection."""
        return float(self.hit.mean()) if len(self.hit) else float("nan")

    def resamples(self, *, seed: int = 0, draws: Draws | None = None) -> Resamples:
        """Return the all-point interpolated AP of each resample of blocks of frames; NaN without
        anything to find. One seed draws the same blocks for every tally. draws: of
        `draws_of_blocks`, None for consecutive frames."""
        draws = block_draws(len(self.truths), seed=seed) if draws is None else draws
        order = np.argsort(-self.scores)
        scores = self.scores[order]
        hits = self.hit[order]
        frame = self.frame[order]
        last_of_equals = np.flatnonzero(np.append(scores[1:] != scores[:-1], True)[: len(scores)])
        at_once = max(1, HELD_AT_ONCE // max(len(frame), 1))
        figures = []
        for some in (draws[first : first + at_once] for first in range(0, len(draws), at_once)):
            weights = some[:, frame]
            truths = some @ self.truths
            believed = np.cumsum(weights, axis=1)[:, last_of_equals]
            found = np.cumsum(weights * hits, axis=1)[:, last_of_equals]
            precision = np.divide(found, believed, out=np.zeros(believed.shape), where=believed > 0)
            envelope = np.maximum.accumulate(precision[:, ::-1], axis=1)[:, ::-1]
            area = (np.diff(found, prepend=0) * envelope).sum(axis=1)
            figures.append(
                np.divide(area, truths, out=np.full(len(truths), np.nan), where=truths > 0)
            )
        return np.concatenate(figures)

    def interval(self, *, confidence: float = 0.95, seed: int = 0) -> Interval:
        """Return the interval of the AP over blocks of frames. NaN for few of them, or nothing to
        find."""
        blocks = count_blocks(len(self.truths))
        objects = int(self.truths.sum())
        drawn = self.resamples(seed=seed)
        return figure_interval(
            self.ap, drawn, blocks=blocks, objects=objects, confidence=confidence
        )
