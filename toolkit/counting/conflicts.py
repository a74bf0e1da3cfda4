"""Conflicts: road users whose ways cross shortly after each other.

    PET  post-encroachment time (Allen, Shin and Cooper, TRR 667, 1978): the shortest time between
         the moments at which two bodies, as polygons on the ground, take up a common place; 0 if
         they ever do so together
    TTC  time to collision (Hayward, HRR 384, 1972): the shortest time, before the conflict, after
         which the bodies would touch if both kept their velocities

A conflict is a pair with a PET of at most `MAX_PET_S` whose courses differ by more than
`MIN_CROSSING_DEG`, both at the common place and at one and the same moment: not one who follows,
and not two side by side in a bend. Two people on foot have none."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, BoxRows, Float64, Int64
from toolkit.boxes import are_close
from toolkit.counting.trajectories import MOVING_M_S, Trajectory
from toolkit.objects import LABELS, PEDESTRIAN

MAX_PET_S = 5.0
MIN_CROSSING_DEG = 20.0
TTC_SPAN_S = 4.0  # before a conflict, in which the time to collision is looked for
MAX_PLACE_OFFSET_M = 4.0  # between a conflict and its true one
MAX_TIME_OFFSET_S = 1.5


class Conflict(NamedTuple):
    """Conflict of two road users.

    Attributes:
        first: number of the one who takes up the common place first.
        second: number of the other.
        labels: names of their classes.
        time: time at which the second one arrives there (s).
        x: place of the conflict, along x (m).
        y: place along y (m).
        pet_s: post-encroachment time (s).
        ttc_s: time to collision (s), infinite if they were never on a course to collide.
        angle_deg: angle between their courses there (degrees)."""

    first: int
    second: int
    labels: tuple[str, str]
    time: float
    x: float
    y: float
    pet_s: float
    ttc_s: float
    angle_deg: float


def find_conflicts(
    trajectories: Sequence[Trajectory],
    area: Float64[np.ndarray, "4"] | None = None,
    *,
    max_pet: float = MAX_PET_S,
) -> list[Conflict]:
    """Conflicts with a PET of at most `max_pet` seconds, in the order of time.

    area: xmin, ymin, xmax, ymax (m) in which their places are, None for anywhere."""
    moving = [trajectory for trajectory in trajectories if (trajectory.speeds > MOVING_M_S).any()]
    conflicts = []
    for one, other in _list_pairs(moving, max_pet):
        conflict = _find_conflict(one, other, max_pet)
        if conflict is None:
            continue
        point = np.array([conflict.x, conflict.y])
        if area is None or ((point >= area[:2]) & (point <= area[2:])).all():
            conflicts.append(conflict)
    return sorted(conflicts, key=lambda conflict: (conflict.time, conflict.first, conflict.second))


def _list_pairs(
    trajectories: Sequence[Trajectory], max_pet: float
) -> Iterator[tuple[Trajectory, Trajectory]]:
    """Yield pairs that are near the same places within `max_pet` seconds, not both on foot."""
    if not trajectories:
        return
    spans = np.array([[trajectory.times[0], trajectory.times[-1]] for trajectory in trajectories])
    radii = np.array([np.hypot(*trajectory.boxes[0, 3:5]) / 2 for trajectory in trajectories])
    lows = np.array([trajectory.boxes[:, :2].min(axis=0) for trajectory in trajectories])
    highs = np.array([trajectory.boxes[:, :2].max(axis=0) for trajectory in trajectories])
    lows -= radii[:, None]
    highs += radii[:, None]
    on_foot = np.array([trajectory.label == PEDESTRIAN for trajectory in trajectories])
    for row, trajectory in enumerate(trajectories):
        is_near = (spans[:, 0] <= spans[row, 1] + max_pet) & (
            spans[:, 1] >= spans[row, 0] - max_pet
        )
        is_near &= (lows <= highs[row]).all(axis=1) & (highs >= lows[row]).all(axis=1)
        is_near &= ~(on_foot & on_foot[row])
        is_near[: row + 1] = False
        for number in np.flatnonzero(is_near).tolist():
            yield trajectory, trajectories[number]


class _CommonPlaces(NamedTuple):
    """Rows of two trajectories at which they take up a common place, and move.

    Attributes:
        rows: rows of the first trajectory.
        other_rows: rows of the second one.
        gaps: time of the second one minus that of the first (s)."""

    rows: Int64[np.ndarray, " k"]
    other_rows: Int64[np.ndarray, " k"]
    gaps: Float64[np.ndarray, " k"]


def _find_conflict(one: Trajectory, other: Trajectory, max_pet: float) -> Conflict | None:
    """Conflict of two road users; None without one of at most `max_pet` seconds."""
    places = _find_common_places(one, other, max_pet)
    if not len(places.gaps):
        return None
    shortest = np.abs(places.gaps).min()
    nearest = np.flatnonzero(np.abs(places.gaps) <= shortest + 1e-6)
    middle = int(nearest[len(nearest) // 2])
    row = int(places.rows[middle])
    other_row = int(places.other_rows[middle])
    angle = _angle_deg(one.velocities[row], other.velocities[other_row])
    moment = (one.times[row] + other.times[other_row]) / 2
    together_angle = _angle_deg(_velocity_at(one, moment), _velocity_at(other, moment))
    if min(angle, together_angle) <= MIN_CROSSING_DEG:
        return None
    first, second = (one, other) if places.gaps[middle] >= 0 else (other, one)
    point = (one.boxes[row, :2] + other.boxes[other_row, :2]) / 2
    arrival = float(max(one.times[row], other.times[other_row]))
    return Conflict(
        first=first.id,
        second=second.id,
        labels=(LABELS[first.label], LABELS[second.label]),
        time=arrival,
        x=float(point[0]),
        y=float(point[1]),
        pet_s=float(shortest),
        ttc_s=_find_shortest_ttc(one, other, arrival),
        angle_deg=angle,
    )


def _find_common_places(one: Trajectory, other: Trajectory, max_pet: float) -> _CommonPlaces:
    """Rows of two trajectories, at most `max_pet` seconds apart, whose bodies overlap."""
    rows = np.flatnonzero(_mask_near(one, other))
    other_rows = np.flatnonzero(_mask_near(other, one))
    gaps = other.times[other_rows] - one.times[rows, None]
    offsets = other.boxes[other_rows, :2] - one.boxes[rows, None, :2]
    reach = (np.hypot(*one.boxes[0, 3:5]) + np.hypot(*other.boxes[0, 3:5])) / 2 + 0.5
    is_near = (np.square(offsets).sum(axis=2) < reach**2) & (np.abs(gaps) <= max_pet)
    near_rows, near_others = np.nonzero(is_near)
    pair_rows = rows[near_rows]
    pair_others = other_rows[near_others]
    is_common = are_close(one.boxes[pair_rows], other.boxes[pair_others], 0.0)
    return _CommonPlaces(
        pair_rows[is_common],
        pair_others[is_common],
        gaps[near_rows[is_common], near_others[is_common]],
    )


def _mask_near(trajectory: Trajectory, other: Trajectory) -> Bool[np.ndarray, " n"]:
    """Mask of the times at which a road user moves where another one may ever be."""
    margin = (np.hypot(*trajectory.boxes[0, 3:5]) + np.hypot(*other.boxes[0, 3:5])) / 2 + 0.5
    points = trajectory.boxes[:, :2]
    low = other.boxes[:, :2].min(axis=0) - margin
    high = other.boxes[:, :2].max(axis=0) + margin
    is_near = ((points >= low) & (points <= high)).all(axis=1)
    return is_near & (trajectory.speeds > MOVING_M_S)


def _velocity_at(trajectory: Trajectory, time: float) -> Float64[np.ndarray, "2"]:
    """Velocity (m/s) at a time, the first or last one beyond the ends."""
    row = int(np.clip(np.searchsorted(trajectory.times, time), 0, len(trajectory.times) - 1))
    return trajectory.velocities[row]


def _angle_deg(one: Float64[np.ndarray, "2"], other: Float64[np.ndarray, "2"]) -> float:
    """Angle between two directions (degrees, 0 to 180)."""
    cross = float(one[0] * other[1] - one[1] * other[0])
    return float(np.rad2deg(np.arctan2(abs(cross), float(one @ other))))


def _find_shortest_ttc(one: Trajectory, other: Trajectory, time: float) -> float:
    """Shortest time to collision (s) of two road users in the seconds before a time."""
    times, rows, other_rows = np.intersect1d(one.times, other.times, return_indices=True)
    is_before = (times <= time) & (times >= time - TTC_SPAN_S)
    rows = rows[is_before]
    other_rows = other_rows[is_before]
    seconds = time_to_collision(
        one.boxes[rows],
        other.boxes[other_rows],
        other.velocities[other_rows] - one.velocities[rows],
    )
    return float(seconds.min(initial=np.inf))


def time_to_collision(
    boxes: BoxRows, others: BoxRows, velocities: Float64[np.ndarray, "n 2"]
) -> Float64[np.ndarray, " n"]:
    """Seconds after which two bodies touch, row by row, if both keep their velocities.

    0 for bodies that touch now, infinite for those that never do. Along the normal of each edge the
    bodies overlap during an interval of time; they touch when all intervals have begun and none has
    ended.

    Args:
        boxes: Boxes of the first body.
        others: Boxes of the second body.
        velocities: Velocity of the second body as seen from the first (m/s)."""
    offsets = others[:, :2] - boxes[:, :2]
    begin = np.zeros(len(boxes))
    end = np.full(len(boxes), np.inf)
    for yaw in (boxes[:, 6], boxes[:, 6] + np.pi / 2, others[:, 6], others[:, 6] + np.pi / 2):
        normal = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
        reach = _half_extent(boxes, yaw) + _half_extent(others, yaw)
        distance = (offsets * normal).sum(axis=1)
        speed = (velocities * normal).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            bounds = np.sort([(-reach - distance) / speed, (reach - distance) / speed], axis=0)
        is_still = speed == 0
        is_apart = np.abs(distance) > reach
        begin = np.where(is_still, begin, np.maximum(begin, bounds[0]))
        end = np.where(is_still, np.where(is_apart, -1.0, end), np.minimum(end, bounds[1]))
    return np.where(begin <= end, begin, np.inf)


def _half_extent(boxes: BoxRows, yaw: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """Half of the extent (m) of each box along a direction (rad)."""
    turn = boxes[:, 6] - yaw
    return (boxes[:, 3] * np.abs(np.cos(turn)) + boxes[:, 4] * np.abs(np.sin(turn))) / 2


class ConflictMatches(NamedTuple):
    """Conflicts found up to a PET, next to the true ones.

    Attributes:
        found: number of conflicts found.
        right: number of these that are true ones, whose PET may be longer by the tolerance.
        true: number of true conflicts.
        detected: number of these that were found, whose found PET may be longer by the tolerance.
        pet_errors_s: errors of the PET of the true conflicts that were found (s)."""

    found: int
    right: int
    true: int
    detected: int
    pet_errors_s: tuple[float, ...]


def match_conflicts(
    found: Sequence[Conflict], true: Sequence[Conflict], *, max_pet: float, tolerance: float
) -> ConflictMatches:
    """Match conflicts with the true ones at the same place and time.

    Args:
        found: Conflicts found, also some with a longer PET than `max_pet` + `tolerance`.
        true: True conflicts, likewise.
        max_pet: PET up to which conflicts count (s).
        tolerance: Excess over `max_pet` that a partner may have (s)."""
    from scipy.optimize import linear_sum_assignment

    places = np.array([[conflict.x, conflict.y] for conflict in found]).reshape(-1, 2)
    true_places = np.array([[conflict.x, conflict.y] for conflict in true]).reshape(-1, 2)
    times = np.array([conflict.time for conflict in found])
    true_times = np.array([conflict.time for conflict in true])
    distances = np.hypot(*np.moveaxis(places[:, None] - true_places, 2, 0)) / MAX_PLACE_OFFSET_M
    delays = np.abs(times[:, None] - true_times) / MAX_TIME_OFFSET_S
    is_pair = (distances <= 1) & (delays <= 1)
    rows, columns = linear_sum_assignment(np.where(is_pair, distances + delays - 10, 0.0))
    partner = {}
    true_partner = {}
    for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
        if is_pair[row, column]:
            partner[row] = true[column]
            true_partner[column] = found[row]
    counted = [row for row, conflict in enumerate(found) if conflict.pet_s <= max_pet]
    counted_true = [row for row, conflict in enumerate(true) if conflict.pet_s <= max_pet]
    longest = max_pet + tolerance
    right = [row for row in counted if row in partner and partner[row].pet_s <= longest]
    detected = [
        row for row in counted_true if row in true_partner and true_partner[row].pet_s <= longest
    ]
    errors = [true_partner[row].pet_s - true[row].pet_s for row in detected]
    return ConflictMatches(
        len(counted), len(right), len(counted_true), len(detected), tuple(errors)
    )
