"""Fragments: tracks that break while a road user is hidden, joined by the expected way."""

from collections.abc import Sequence

import numpy as np

from toolkit.arrays import Float64
from toolkit.counting.trajectories import MOVING_M_S, Trajectory
from toolkit.objects import HEAVY, VEHICLE

MAX_MOVING_GAP_S = 4.0  # between fragments that move
MAX_STANDING_GAP_S = 30.0
MAX_BREAK_M = 1.0  # from the place that is expected, more for each second of the gap
MAX_DRIFT_M_S = 1.0
COURSE_ROWS = 8  # at the ends of a fragment, over which its velocity is a mean


def join_fragments(trajectories: Sequence[Trajectory]) -> list[Trajectory]:
    """Join each trajectory with the one that goes on along its expected way.

    A gap lasts at most `MAX_MOVING_GAP_S`, or `MAX_STANDING_GAP_S` if both sides stand. Classes
    must be alike: vehicle and heavy, or cyclist and pedestrian."""
    order = sorted(range(len(trajectories)), key=lambda row: trajectories[row].times[0])
    begins = np.array([trajectories[row].times[0] for row in order])
    links = []
    for row, trajectory in enumerate(trajectories):
        end = trajectory.times[-1]
        first, last = np.searchsorted(begins, [end, end + MAX_STANDING_GAP_S], side="right")
        for number in order[first:last]:
            cost = _measure_break(trajectory, trajectories[number])
            if cost <= 1:
                links.append((cost, row, number))
    following: dict[int, int] = {}
    preceded: set[int] = set()
    for _, row, number in sorted(links):
        if row not in following and number not in preceded:
            following[row] = number
            preceded.add(number)
    joined = []
    for row in range(len(trajectories)):
        if row in preceded:
            continue
        chain = [row]
        while chain[-1] in following:
            chain.append(following[chain[-1]])
        joined.append(_join([trajectories[number] for number in chain]))
    return joined


def _measure_break(before: Trajectory, after: Trajectory) -> float:
    """Distance of two fragments from one way, 1 at most if they may be one, else infinite."""
    if (before.label in (VEHICLE, HEAVY)) != (after.label in (VEHICLE, HEAVY)):
        return float("inf")
    gap = float(after.times[0] - before.times[-1])
    end_velocity = before.velocities[-COURSE_ROWS:].mean(axis=0)
    begin_velocity = after.velocities[:COURSE_ROWS].mean(axis=0)
    is_standing = max(_length(end_velocity), _length(begin_velocity)) < MOVING_M_S
    if not 0 < gap <= (MAX_STANDING_GAP_S if is_standing else MAX_MOVING_GAP_S):
        return float("inf")
    # halfway by each velocity, as if the speed changed evenly
    expected = before.boxes[-1, :2] + gap * (end_velocity + begin_velocity) / 2
    offset = _length(after.boxes[0, :2] - expected)
    reach = MAX_BREAK_M if is_standing else MAX_BREAK_M + MAX_DRIFT_M_S * gap
    return offset / reach if offset <= reach else float("inf")


def _length(vector: Float64[np.ndarray, "2"]) -> float:
    """Length of a vector."""
    return float(np.hypot(vector[0], vector[1]))


def _join(fragments: Sequence[Trajectory]) -> Trajectory:
    """Trajectory of fragments in the order of time, with the id and class of the longest."""
    if len(fragments) == 1:
        return fragments[0]
    longest = max(fragments, key=lambda fragment: len(fragment.times))
    return longest._replace(
        times=np.concatenate([fragment.times for fragment in fragments]),
        boxes=np.concatenate([fragment.boxes for fragment in fragments]),
        velocities=np.concatenate([fragment.velocities for fragment in fragments]),
    )
