"""Shrinkage: figures measured on few frames, corrected by earlier predictions.

Predictions p_i have a common error m and each a separate error of spread τ; measured figures f_i
have noise of variance v_i, which their resamples show. The likeliest figures are then (empirical
Bayes; Efron and Morris 1973)

    p_i + m + w_i (f_i - p_i - m)         w_i = τ² / (τ² + v_i)
    m = mean (f_i - p_i)                  τ² = var (f_i - p_i) - mean v_i, but at least
                                          `MIN_SPREAD_AP`²

With much noise the predictions rank, moved to the level of the figures; with little noise the
figures do. Noise that all sets share, such as hard frames, has no effect on this and is added in
the end. Resamples of few blocks show too little noise: least for a set that was lucky in all of
them, and zero if everything was detected in each. So v_i is at least the mean over the sets and at
least `MIN_NOISE_AP`² / blocks, and the draws spread as much.
"""

import math
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64

MIN_SPREAD_AP = 0.02  # error of a prediction relative to other sets near the best
MIN_NOISE_AP = 0.05  # chance difference between sets on one block of frames
MIN_SETS = 3  # to estimate the errors of predictions


class Shrunk(NamedTuple):
    """Likeliest figures of n sets, and draws that spread by their uncertainty.

    Attributes:
        figure: Likeliest figure of each set, such as its AP.
        resamples: Draws of each set's figure (columns), the same blocks of frames for all."""

    figure: Float64[np.ndarray, " n"]
    resamples: Float64[np.ndarray, "n resamples"]


def shrink(
    figure: Float64[np.ndarray, " n"],
    resamples: Float64[np.ndarray, "n resamples"],
    predicted: Float64[np.ndarray, " n"],
    blocks: float = math.inf,
) -> Shrunk:
    """Figures of n sets, shrunk towards their predictions, and draws of them.

    figure: measured AP or reward of each set; resamples: a row for each figure, with the same draws
    for all; predicted: earlier predictions of the figures; blocks: number of blocks that a resample
    draws. One block shows no noise, so the sets are then ranked by their predictions. Fewer than
    `MIN_SETS` sets, and undefined figures, are left as they are.
    """
    if len(figure) < MIN_SETS or not np.isfinite(figure).all():
        return Shrunk(figure, resamples)
    common_noise = resamples.mean(axis=0)  # shared by all sets, such as hard frames
    noise = resamples - common_noise
    noise = noise - noise.mean(axis=1, keepdims=True)
    errors = figure - predicted
    shift = errors.mean()  # m of the file's docstring
    if blocks < 2:  # no noise is known, so the predictions rank
        weight = np.zeros(len(figure))
    else:
        variance = noise.var(axis=1) / (1 - 1 / blocks)
        if math.isfinite(blocks):
            min_variance = max(variance.mean(), MIN_NOISE_AP**2 / blocks)
            missing_variance = np.maximum(min_variance - variance, 0.0)
            # noise of mean 0 and deviation 1, always the same for a shape
            unit_noise = np.random.default_rng(0).standard_normal(noise.shape)
            unit_noise -= unit_noise.mean(axis=1, keepdims=True)
            unit_noise /= np.maximum(unit_noise.std(axis=1, keepdims=True), 1e-12)
            noise = noise + np.sqrt(missing_variance)[:, None] * unit_noise
            variance = variance + missing_variance
        # τ² and w of the file's docstring
        error_variance = max(MIN_SPREAD_AP**2, float(errors.var(ddof=1) - variance.mean()))
        weight = error_variance / (error_variance + variance)
    likeliest = predicted + shift + weight * (errors - shift)
    # a figure that is shrunk by w keeps w of its variance, and the noise shared by all sets
    remaining_noise = np.sqrt(weight)[:, None] * noise
    draws = likeliest[:, None] + remaining_noise + (common_noise - common_noise.mean())
    return Shrunk(figure=likeliest, resamples=draws)
