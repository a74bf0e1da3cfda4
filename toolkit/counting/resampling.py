"""Trajectories with rows at least ten times a second, so that no place between two is missed.

Frames may be lost or far apart, and a hidden road user has no rows."""

from collections.abc import Sequence

import numpy as np

from toolkit.arrays import Float64
from toolkit.counting.trajectories import Trajectory

REFINED_STEP_S = 0.1
MAX_STEP_S = 0.15  # longer steps are divided
MAX_FILLED_S = 4.0  # longer gaps of one road user stay


def refine_trajectories(trajectories: Sequence[Trajectory]) -> list[Trajectory]:
    """Trajectories with rows at most `MAX_STEP_S` apart, on straight lines between known rows.

    Gaps above `MAX_FILLED_S` stay. Known rows stay too, and new ones are at the same times in all
    trajectories. One that needs no new rows is returned as it is."""
    if not trajectories:
        return []
    frame_times = np.unique(np.concatenate([user.times for user in trajectories]))
    times = _divide_steps(frame_times)
    return [_refine(trajectory, times) for trajectory in trajectories]


def _divide_steps(times: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " m"]:
    """Times (s, ascending) with new ones between them, which divide steps above `MAX_STEP_S`.

    All parts of a step are equal, about `REFINED_STEP_S`."""
    steps = np.diff(times)
    parts = np.where(steps > MAX_STEP_S, np.rint(steps / REFINED_STEP_S), 1).astype(np.int64)
    # one element for each part of each step from here on
    begin = np.repeat(np.cumsum(parts) - parts, parts)  # number of the step's first part
    number = np.arange(len(begin)) - begin  # number of each part in its step
    inner = np.repeat(times[:-1], parts) + number * np.repeat(steps / parts, parts)
    return np.append(inner, times[-1])


def _refine(trajectory: Trajectory, times: Float64[np.ndarray, " m"]) -> Trajectory:
    """Trajectory at some times, without those in its gaps above `MAX_FILLED_S`.

    times: times of all trajectories and those between them (s), ascending."""
    user_times = trajectory.times
    first, last = np.searchsorted(times, user_times[[0, -1]])
    new_times = times[first : last + 1]
    if len(new_times) == len(user_times):
        return trajectory
    next_row = np.searchsorted(user_times, new_times)
    gaps = user_times[next_row] - user_times[np.maximum(next_row - 1, 0)]
    is_known = user_times[next_row] == new_times
    new_times = new_times[is_known | (gaps <= MAX_FILLED_S)]
    # the seven columns of a box, the heading without jumps, then the velocity
    columns = np.column_stack(
        [trajectory.boxes[:, :6], np.unwrap(trajectory.boxes[:, 6]), trajectory.velocities]
    )
    filled = np.stack([np.interp(new_times, user_times, column) for column in columns.T], axis=1)
    return trajectory._replace(times=new_times, boxes=filled[:, :7], velocities=filled[:, 7:])
