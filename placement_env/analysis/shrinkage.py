"""What is to be believed of several figures that were measured on few frames and predicted before.

Predictions p_i are off by a common amount m and, each by itself, by some τ; measured figures f_i by a noise of variance
v_i, which their resamples show. The figures that are likeliest then (empirical Bayes; Efron and Morris 1973) are

    p_i + m + w_i (f_i - p_i - m)         w_i = τ² / (τ² + v_i)
    m = mean (f_i - p_i)                  τ² = var (f_i - p_i) - mean v_i, but no less than `SURE`²

With much noise it is the predictions that rank, moved to where the figures are; with little the figures themselves.
What noise all share, such as frames that are hard for all, counts in none of it, and is added again in the end. Of few
blocks the resamples show too little noise, least for the set that was lucky in all of them, and none where all is found
in each: so v_i is no less than the mean over the sets, nor than `OF_A_BLOCK`² / blocks, and the draws spread as much.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64

SURE = 0.02  # in AP, by which predictions of sets that are near the best are off from each other, at least
OF_A_BLOCK = 0.05  # in AP, by which sets differ by chance on one block of frames, at least
FEWEST_SETS = 3  # of which it can be said how far predictions are off


class Shrunk(NamedTuple):
    """Figures of n sets as they are likeliest, and draws that spread as much as these are unsure."""

    figure: Float64[np.ndarray, " n"]
    resamples: Float64[np.ndarray, "n resamples"]


def shrunk(
    figure: Float64[np.ndarray, " n"],
    resamples: Float64[np.ndarray, "n resamples"],
    predicted: Float64[np.ndarray, " n"],
    blocks: float = math.inf,
) -> Shrunk:
    """Of n sets. resamples: of each figure, drawn alike for all; blocks: how many these draw from: of one nothing is
    known of the noise, so that predictions rank. Fewer than `FEWEST_SETS` sets, or figures that are not defined, are
    left as they are.

    >>> noisy = np.array([[0.5, 0.7], [0.7, 0.5], [0.6, 0.6]])
    >>> shrunk(np.array([0.62, 0.58, 0.6]), noisy, np.array([0.4, 0.5, 0.45])).figure.round(3)
    array([0.553, 0.647, 0.6  ])
    """
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
            unseen = np.maximum(max(variance.mean(), OF_A_BLOCK**2 / blocks) - variance, 0.0)
            noise = noise + np.sqrt(unseen)[:, None] * _of_unit_spread(noise.shape)
            variance = variance + unseen
        spread = max(SURE**2, float(off.var(ddof=1) - variance.mean()))
        weight = spread / (spread + variance)
    likeliest = predicted + shift + weight * (off - shift)
    return Shrunk(likeliest, likeliest[:, None] + np.sqrt(weight)[:, None] * noise + (common - common.mean()))


def _of_unit_spread(shape: tuple[int, int]) -> Float64[np.ndarray, "n resamples"]:
    """Rows of noise of mean 0 and variance 1, the same ones for the same shape."""
    drawn = np.random.default_rng(0).standard_normal(shape)
    drawn -= drawn.mean(axis=1, keepdims=True)
    return np.asarray(drawn / np.maximum(drawn.std(axis=1, keepdims=True), 1e-12))
