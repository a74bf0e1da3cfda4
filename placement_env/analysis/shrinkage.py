"""Shrinkage: figures measured on few frames, corrected by predictions made before.

Predictions p_i are off by a common amount m and, each by itself, by some τ; measured figures f_i by
a noise of variance v_i, which their resamples show. The likeliest figures are then (empirical
Bayes; Efron and Morris 1973)

    p_i + m + w_i (f_i - p_i - m)         w_i = τ² / (τ² + v_i)
    m = mean (f_i - p_i)                  τ² = var (f_i - p_i) - mean v_i, but no less than
                                          `LEAST_SPREAD`²

With much noise the predictions rank, moved to the level of the figures; with little noise the
figures themselves do. Noise that all sets share, such as hard frames, counts in none of this and is
added again in the end. Resamples of few blocks show too little noise, least for a set that was
lucky in all of them, and none if everything was found in each: so v_i is no less than the mean over
the sets, nor than `LEAST_NOISE`² / blocks, and the draws spread as much."""

import math
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64

LEAST_SPREAD = (
    0.02  # least error in AP of a prediction, relative to those of other sets near the best
)
LEAST_NOISE = 0.05  # least difference in AP between sets by chance on one block of frames
FEWEST_SETS = 3  # needed to estimate the errors of predictions


class Shrunk(NamedTuple):
    """Likeliest figures of n sets, and draws that spread by their uncertainty."""

    figure: Float64[np.ndarray, " n"]
    resamples: Float64[np.ndarray, "n resamples"]


def shrink(
    figure: Float64[np.ndarray, " n"],
    resamples: Float64[np.ndarray, "n resamples"],
    predicted: Float64[np.ndarray, " n"],
    blocks: float = math.inf,
) -> Shrunk:
    """Shrink the figures of n sets towards their predictions.

    resamples: of each figure, with the same draws for all; blocks: number drawn from; one block
    says nothing about the noise, so predictions rank. Fewer than `FEWEST_SETS` sets, and undefined
    figures, are left as they are."""
    if len(figure) < FEWEST_SETS or not np.isfinite(figure).all():
        return Shrunk(figure, resamples)
    common = resamples.mean(axis=0)
    noise = resamples - common
    noise = noise - noise.mean(axis=1, keepdims=True)
    off = figure - predicted
    shift = off.mean()
    if blocks < 2:
        weight = np.zeros(len(figure))
    else:
        variance = noise.var(axis=1) / (1 - 1 / blocks)
        if math.isfinite(blocks):
            unseen = np.maximum(max(variance.mean(), LEAST_NOISE**2 / blocks) - variance, 0.0)
            # always the same for a shape
            drawn = np.random.default_rng(0).standard_normal(noise.shape)
            drawn -= drawn.mean(axis=1, keepdims=True)
            unit = np.asarray(drawn / np.maximum(drawn.std(axis=1, keepdims=True), 1e-12))
            noise = noise + np.sqrt(unseen)[:, None] * unit
            variance = variance + unseen
        spread = max(LEAST_SPREAD**2, float(off.var(ddof=1) - variance.mean()))
        weight = spread / (spread + variance)
    likeliest = predicted + shift + weight * (off - shift)
    return Shrunk(
        likeliest, likeliest[:, None] + np.sqrt(weight)[:, None] * noise + (common - common.mean())
    )
