"""Intervals of figures that are measured over frames, by a bootstrap over blocks of consecutive frames.

Objects of the simulated traffic live four frames (paper section III; in `placement_env.fidelity.traffic` parked ones
too), so frames are not independent but blocks of four are nearly. Frames 0-3, 4-7 and so on form the blocks, the last
of which may be shorter; as many blocks as there are are drawn with replacement, the figure is computed from what was
drawn, and the interval holds the middle share of these figures (percentile bootstrap; Efron and Tibshirani 1993,
chapter 13; blocks: Künsch 1989). Draws that leave a figure undefined, such as AP without a vehicle, are left out. Same
seed, same draws: figures of several sensor sets on the same frames can be compared draw by draw.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from placement_env.checks import check_whole
from toolkit.arrays import Float64, Int64

BLOCK_FRAMES = 4  # frames that an object lives
RESAMPLES = 1000
HELD_AT_ONCE = 1 << 21  # numbers held at once


class Interval(NamedTuple):
    """Lower and upper end, NaN where the figure is undefined in every draw."""

    low: float
    high: float


def block_draws(
    frames: int, *, block: int = BLOCK_FRAMES, resamples: int = RESAMPLES, seed: int = 0
) -> Int64[np.ndarray, "resamples frames"]:
    """How often each frame is drawn in each resample: equal for all frames of a block.

    >>> block_draws(6, resamples=3)
    array([[1, 1, 1, 1, 1, 1],
           [1, 1, 1, 1, 1, 1],
           [0, 0, 0, 0, 2, 2]])
    """
    for name, value, least in (("frames", frames, 1), ("block", block, 1), ("resamples", resamples, 1)):
        check_whole(name, value, least=least)
    return draws_of_blocks(np.arange(frames) // block, resamples=resamples, seed=seed)


def draws_of_blocks(
    blocks: Int64[np.ndarray, " frames"], *, resamples: int = RESAMPLES, seed: int = 0
) -> Int64[np.ndarray, "resamples frames"]:
    """The same for frames in any order, of which it is said to which block each belongs.

    >>> draws_of_blocks(np.array([7, 2, 7]), resamples=3)
    array([[1, 1, 1],
           [1, 1, 1],
           [2, 0, 2]])
    """
    different, place = np.unique(blocks, return_inverse=True)
    shares = np.full(len(different), 1 / len(different))
    drawn = np.random.default_rng(seed).multinomial(len(different), shares, size=resamples)
    return np.asarray(drawn[:, place], np.int64)


def ap_resamples(
    scores: Sequence[ArrayLike],
    hits: Sequence[ArrayLike],
    to_find: Sequence[int],
    *,
    block: int = BLOCK_FRAMES,
    resamples: int = RESAMPLES,
    seed: int = 0,
    draws: Int64[np.ndarray, "resamples frames"] | None = None,
) -> Float64[np.ndarray, " resamples"]:
    """AP of each resample, NaN where it has nothing to find; arguments as of `ap_interval`. draws: how often each frame
    is drawn in each resample, None for blocks of frames that follow each other."""
    flat_scores, flat_hits, frame = _pooled(scores, hits, to_find)
    if draws is None:
        draws = block_draws(len(to_find), block=block, resamples=resamples, seed=seed)
    resamples = len(draws)
    order = np.argsort(-flat_scores, kind="stable")
    flat_scores, flat_hits, frame = flat_scores[order], flat_hits[order], frame[order]
    last_of_equals = np.flatnonzero(np.append(flat_scores[1:] != flat_scores[:-1], True)[: len(flat_scores)])
    truths = draws @ np.asarray(to_find, np.int64)
    at_once = max(1, HELD_AT_ONCE // max(len(frame), 1))
    parts = [
        _ap(draws[first : first + at_once][:, frame], flat_hits, last_of_equals, truths[first : first + at_once])
        for first in range(0, resamples, at_once)
    ]
    return np.concatenate(parts)


def ap_interval(
    scores: Sequence[ArrayLike],
    hits: Sequence[ArrayLike],
    to_find: Sequence[int],
    *,
    block: int = BLOCK_FRAMES,
    resamples: int = RESAMPLES,
    seed: int = 0,
    confidence: float = 0.95,
) -> Interval:
    """Interval of the AP (`toolkit.detection.metrics`) of what was detected in consecutive frames.

    scores, hits: per frame, of its detections that are not ignored, the score and whether it hit a truth; to_find: how
    many truths each frame has. Raises ValueError where these do not fit.

    >>> ap_interval([[0.9], [0.8, 0.7]], [[True], [False, True]], [1, 1], block=1)
    Interval(low=0.5, high=1.0)
    """
    return percentiles(
        ap_resamples(scores, hits, to_find, block=block, resamples=resamples, seed=seed), confidence=confidence
    )


def ratio_interval(
    parts: ArrayLike,
    wholes: ArrayLike,
    *,
    block: int = BLOCK_FRAMES,
    resamples: int = RESAMPLES,
    seed: int = 0,
    confidence: float = 0.95,
) -> Interval:
    """Interval of sum(parts) / sum(wholes), one of each per frame: recall, precision, a share of vehicles, a mean.

    >>> ratio_interval([1, 3], [2, 4], block=1)
    Interval(low=0.5, high=0.75)
    """
    part, whole = np.asarray(parts, np.float64), np.asarray(wholes, np.float64)
    if part.ndim != 1 or part.shape != whole.shape:
        raise ValueError(f"there must be one part and one whole per frame, got {part.shape} and {whole.shape}")
    draws = block_draws(len(part), block=block, resamples=resamples, seed=seed)
    sums = draws @ whole
    ratios = np.divide(draws @ part, sums, out=np.full(len(sums), np.nan), where=sums != 0)
    return percentiles(ratios, confidence=confidence)


def percentiles(figures: Float64[np.ndarray, " resamples"], *, confidence: float = 0.95) -> Interval:
    """The middle share of the figures that are defined."""
    if not 0 < confidence < 1:
        raise ValueError(f"confidence must lie between 0 and 1, got {confidence}: 0.95 is usual")
    defined = figures[~np.isnan(figures)]
    if not len(defined):
        return Interval(float("nan"), float("nan"))
    low, high = np.quantile(defined, [(1 - confidence) / 2, (1 + confidence) / 2])
    return Interval(float(low), float(high))


def interval_about(
    figure: float, resamples: Float64[np.ndarray, " resamples"], *, confidence: float = 0.95
) -> Interval:
    """The middle share of a figure's resamples, widened where the figure itself lies outside.

    >>> interval_about(0.9, np.full(1000, 0.5))
    Interval(low=0.5, high=0.9)
    """
    low, high = percentiles(resamples, confidence=confidence)
    return Interval(min(low, figure), max(high, figure))


def _pooled(
    scores: Sequence[ArrayLike], hits: Sequence[ArrayLike], to_find: Sequence[int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Score, whether it hit, and frame of each detection of all frames."""
    frames = len(to_find)
    rows: list[tuple[Any, Any]] = [
        (np.asarray(s, np.float64), np.asarray(h, bool)) for s, h in zip(scores, hits, strict=False)
    ]
    if not frames or not len(scores) == len(hits) == frames or any(s.shape != h.shape or s.ndim != 1 for s, h in rows):
        raise ValueError(
            "there must be scores, hits and a number to find for each frame, one hit per score, "
            f"got {len(scores)}, {len(hits)} and {frames} frames"
        )
    for k, ((_, hit), truths) in enumerate(zip(rows, to_find, strict=True)):
        if not hit.sum() <= truths:
            raise ValueError(f"frame {k} has {hit.sum()} hits, more than the {truths} there are to find")
    frame = np.repeat(np.arange(frames), [len(s) for s, _ in rows])
    return np.concatenate([s for s, _ in rows]), np.concatenate([h for _, h in rows]), frame


def _ap(
    weights: Int64[np.ndarray, "resamples n"],
    hits: np.ndarray,
    last_of_equals: np.ndarray,
    truths: Int64[np.ndarray, " resamples"],
) -> Float64[np.ndarray, " resamples"]:
    """All-point interpolated AP where detection i, best first, counts weights[:, i] times."""
    believed = np.cumsum(weights, axis=1)[:, last_of_equals]
    found = np.cumsum(weights * hits, axis=1)[:, last_of_equals]
    precision = np.divide(found, believed, out=np.zeros(believed.shape), where=believed > 0)
    envelope = np.maximum.accumulate(precision[:, ::-1], axis=1)[:, ::-1]
    area = (np.diff(found, axis=1, prepend=0) * envelope).sum(axis=1)
    return np.divide(area, truths, out=np.full(len(truths), np.nan), where=truths > 0)
