"""Motion of road users between frames: constant velocity with white acceleration (Kalman 1960)."""

import numpy as np

from toolkit.arrays import Bool, Float64

# by class of `LABELS`: vehicle, cyclist, pedestrian, heavy
ACCELERATIONS_M_S2 = np.array([3.0, 3.0, 2.0, 2.0])  # standard deviation, from step to step
FIRST_SPEEDS_M_S = np.array([9.0, 5.0, 1.5, 8.0])  # standard deviation, of a new track
MIN_RIDDEN_M = 3.0  # way on which a mean speed is judged
MAX_RUNNING_M_S = 4.0  # mean speed of people on foot in a street, faster than they jog


def is_too_fast_to_run(
    walked_m: Float64[np.ndarray, " n"], seconds: Float64[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Mask of ways that nobody covers on foot.

    walked_m: distance (m) from the first place of each; seconds: time since then."""
    return (walked_m > MIN_RIDDEN_M) & (walked_m > MAX_RUNNING_M_S * seconds)


def constant_velocities(
    seconds: Float64[np.ndarray, " n"],
) -> tuple[Float64[np.ndarray, "n 4 4"], Float64[np.ndarray, "n 4 4"]]:
    """Transition matrices of the state (x, y, vx, vy), and the covariance that each step adds.

    The covariance is for a white acceleration of 1 m/s² along each axis: multiply by the variance.

    seconds: times that pass, a transition for each."""
    count = len(seconds)
    steps = np.zeros((count, 4, 4))
    steps[:, [0, 1, 2, 3], [0, 1, 2, 3]] = 1.0
    steps[:, 0, 2] = seconds
    steps[:, 1, 3] = seconds
    noise = np.zeros((count, 4, 4))
    noise[:, [0, 1], [0, 1]] = seconds[:, None] ** 4 / 4
    noise[:, [2, 3], [2, 3]] = seconds[:, None] ** 2
    noise[:, [0, 1, 2, 3], [2, 3, 0, 1]] = seconds[:, None] ** 3 / 2
    return steps, noise
