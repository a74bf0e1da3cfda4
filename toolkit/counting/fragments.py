"""Fragments: tracks that break while a road user is hidden, joined by the expected way.

Some begin again before they end, and some are of a road user that has another track."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float64, Int64
from toolkit.counting.trajectories import MOVING_M_S, Trajectory
from toolkit.objects import HEAVY, VEHICLE

MAX_MOVING_GAP_S = 4.0  # between fragments that move
MAX_STANDING_GAP_S = 30.0
MAX_OVERLAP_S = 2.0  # that a fragment goes on after the next one has begun
SHADOW_SHARE = 0.5  # rows of a second track within the body of a longer one, per row
MAX_BREAK_M = 1.0  # from the place that is expected, more for each second of the gap
MAX_DRIFT_M_S = 1.0
MAX_BODY_M = 20.0
COURSE_ROWS = 8  # at the ends of a fragment, over which its velocity is a mean


class _Ends(NamedTuple):
    """Both ends of n fragments, a row for each.

    Attributes:
        first_times: time of the first row (s).
        last_times: time of the last row (s).
        first_points: x, y of the first row (m).
        last_points: x, y of the last row (m).
        first_velocities: mean velocity over the first `COURSE_ROWS` rows (m/s).
        last_velocities: mean velocity over the last `COURSE_ROWS` rows (m/s).
        are_vehicles: True for vehicles and heavy vehicles."""

    first_times: Float64[np.ndarray, " n"]
    last_times: Float64[np.ndarray, " n"]
    first_points: Float64[np.ndarray, "n 2"]
    last_points: Float64[np.ndarray, "n 2"]
    first_velocities: Float64[np.ndarray, "n 2"]
    last_velocities: Float64[np.ndarray, "n 2"]
    are_vehicles: Bool[np.ndarray, " n"]

    @classmethod
    def from_trajectories(cls, trajectories: Sequence[Trajectory]) -> "_Ends":
        """Ends of some fragments, at least one."""
        first_velocities = [user.velocities[:COURSE_ROWS].mean(axis=0) for user in trajectories]
        last_velocities = [user.velocities[-COURSE_ROWS:].mean(axis=0) for user in trajectories]
        return cls(
            first_times=np.array([user.times[0] for user in trajectories]),
            last_times=np.array([user.times[-1] for user in trajectories]),
            first_points=np.array([user.boxes[0, :2] for user in trajectories]),
            last_points=np.array([user.boxes[-1, :2] for user in trajectories]),
            first_velocities=np.array(first_velocities),
            last_velocities=np.array(last_velocities),
            are_vehicles=np.array([user.label in (VEHICLE, HEAVY) for user in trajectories]),
        )


def join_fragments(trajectories: Sequence[Trajectory]) -> list[Trajectory]:
    """Join each trajectory with the one that goes on along its expected way.

    A gap lasts at most `MAX_MOVING_GAP_S`, or `MAX_STANDING_GAP_S` if both sides stand; or both are
    at one place for at most `MAX_OVERLAP_S`. Nobody turns back in a gap. Classes must be alike:
    vehicle and heavy, or cyclist and pedestrian. Second tracks of one body are left out."""
    trajectories = _drop_shadows(trajectories)
    if not trajectories:
        return []
    ends = _Ends.from_trajectories(trajectories)
    order = np.argsort(ends.first_times, kind="stable")
    begins = ends.first_times[order]
    links = []
    for row, end in enumerate(ends.last_times.tolist()):
        span = [end - MAX_OVERLAP_S, end + MAX_STANDING_GAP_S]
        first, last = np.searchsorted(begins, span, side="right")
        followers = order[first:last]
        costs = _measure_breaks(ends, row, followers)
        gaps = np.abs(ends.first_times[followers] - end)
        for number in np.flatnonzero(costs <= 1).tolist():
            # the gap counts too: so a fragment in between goes before a later one
            link_cost = float(costs[number] + gaps[number])
            links.append((link_cost, row, int(followers[number])))
    following: dict[int, int] = {}  # row of the fragment after each
    preceded: set[int] = set()  # rows of the fragments that come after another
    # the cheapest links first, each fragment with one before it and one after it at most
    for _, row, follower in sorted(links):
        if row not in following and follower not in preceded:
            following[row] = follower
            preceded.add(follower)
    joined = []
    for row in range(len(trajectories)):
        if row in preceded:
            continue
        chain = [row]
        while chain[-1] in following:
            chain.append(following[chain[-1]])
        joined.append(_join([trajectories[number] for number in chain]))
    return joined


def _measure_breaks(
    ends: _Ends, row: int, followers: Int64[np.ndarray, " k"]
) -> Float64[np.ndarray, " k"]:
    """Distance of each follower from the way on which a fragment is expected to go on.

    As a share of the distance that is allowed: up to 1 both may be one road user. Infinite for
    other classes, for gaps that are too long and for followers that turn back.

    Args:
        ends: Ends of all fragments.
        row: Row of the fragment.
        followers: Rows of the fragments after it."""
    gaps = ends.first_times[followers] - ends.last_times[row]
    end_velocity = ends.last_velocities[row]
    velocities = ends.first_velocities[followers]
    is_moving = np.hypot(velocities[:, 0], velocities[:, 1]) >= MOVING_M_S
    was_moving = np.hypot(end_velocity[0], end_velocity[1]) >= MOVING_M_S
    is_standing = ~is_moving & ~was_moving
    # who stops or sets off has no direction at one end, only errors
    is_turning = is_moving & was_moving & (velocities @ end_velocity < 0)
    # half of the gap at each velocity, as if the speed changed evenly
    expected = ends.last_points[row] + gaps[:, None] * (end_velocity + velocities) / 2
    offsets = ends.first_points[followers] - expected
    reach = np.where(is_standing, MAX_BREAK_M, MAX_BREAK_M + MAX_DRIFT_M_S * np.abs(gaps))
    costs = np.hypot(offsets[:, 0], offsets[:, 1]) / reach
    max_gaps = np.where(is_standing, MAX_STANDING_GAP_S, MAX_MOVING_GAP_S)
    is_possible = (gaps <= max_gaps) & ~is_turning
    # a follower begins later, and ends later
    is_possible &= ends.first_times[followers] > ends.first_times[row]
    is_possible &= ends.last_times[followers] > ends.last_times[row]
    is_possible &= ends.are_vehicles[followers] == ends.are_vehicles[row]
    return np.where(is_possible, costs, np.inf)


def _drop_shadows(trajectories: Sequence[Trajectory]) -> list[Trajectory]:
    """Trajectories without those that are within the body of a longer one most of the time.

    They keep their order."""
    longest_first = sorted(range(len(trajectories)), key=lambda row: -len(trajectories[row].times))
    spans = np.array([[user.times[0], user.times[-1]] for user in trajectories]).reshape(-1, 2)
    lows = np.array([user.boxes[:, :2].min(axis=0) for user in trajectories]).reshape(-1, 2)
    highs = np.array([user.boxes[:, :2].max(axis=0) for user in trajectories]).reshape(-1, 2)
    is_kept = np.zeros(len(trajectories), np.bool_)
    for row in longest_first:
        # only longer trajectories, since no shorter one is kept yet
        is_near = is_kept & (spans[:, 0] <= spans[row, 1]) & (spans[:, 1] >= spans[row, 0])
        is_near &= (lows <= highs[row] + MAX_BODY_M).all(axis=1)
        is_near &= (highs >= lows[row] - MAX_BODY_M).all(axis=1)
        shares = [
            _measure_shadow(trajectories[row], trajectories[number])
            for number in np.flatnonzero(is_near).tolist()
        ]
        is_kept[row] = max(shares, default=0.0) < SHADOW_SHARE
    return [trajectories[row] for row in np.flatnonzero(is_kept).tolist()]


def _measure_shadow(trajectory: Trajectory, longer: Trajectory) -> float:
    """Share (0 to 1) of a trajectory's rows whose middle is then in the body of a longer one."""
    # the common times, then their rows in each
    common = np.intersect1d(trajectory.times, longer.times, assume_unique=True, return_indices=True)
    rows = common[1]
    longer_rows = common[2]
    points = trajectory.boxes[rows, :2]
    boxes = longer.boxes[longer_rows]
    dx = points[:, 0] - boxes[:, 0]
    dy = points[:, 1] - boxes[:, 1]
    cos = np.cos(boxes[:, 6])
    sin = np.sin(boxes[:, 6])
    is_within = np.abs(dx * cos + dy * sin) < boxes[:, 3] / 2
    is_within &= np.abs(dy * cos - dx * sin) < boxes[:, 4] / 2
    return float(is_within.sum() / len(trajectory.times))


def _join(fragments: Sequence[Trajectory]) -> Trajectory:
    """Trajectory of fragments in the order of time, with the id and class of the longest.

    Rows of a fragment after the next one has begun are left out."""
    if len(fragments) == 1:
        return fragments[0]
    longest = max(fragments, key=lambda fragment: len(fragment.times))
    parts = []
    for fragment, later in pairwise(fragments):
        end = int(np.searchsorted(fragment.times, later.times[0]))
        parts.append(fragment.select(slice(end)))
    parts.append(fragments[-1])
    return longest._replace(
        times=np.concatenate([piece.times for piece in parts]),
        boxes=np.concatenate([piece.boxes for piece in parts]),
        velocities=np.concatenate([piece.velocities for piece in parts]),
    )
