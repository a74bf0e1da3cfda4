"""Conflicts: road users whose ways cross shortly after each other.

    PET  post-encroachment time (Allen, Shin and Cooper, TRR 667, 1978): the shortest time between
         the moments at which two bodies, as polygons on the ground, take up a common place; 0 if
         they ever do so together
    TTC  time to collision (Hayward, HRR 384, 1972): the shortest time, before the conflict, after
         which the bodies would touch if both kept their velocities

A conflict is a pair with a PET of at most `MAX_PET_S` whose courses differ by more than
`MIN_CROSSING_DEG`, both at the common place and at one and the same moment: not one who follows,
and not two side by side in a bend. Two people on foot are no pair."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, BoxRows, Float64, Int64
from toolkit.boxes import are_close
from toolkit.counting.resampling import refine_trajectories
from toolkit.counting.trajectories import MOVING_M_S, Trajectory
from toolkit.objects import LABELS, PEDESTRIAN

MAX_PET_S = 5.0
MIN_CROSSING_DEG = 20.0
MIN_KNOWN_S = 1.0  # most road users that are seen for less are false
TTC_SPAN_S = 4.0  # before a conflict, in which the time to collision is looked for
MAX_PLACE_OFFSET_M = 4.0  # between a conflict and its true one
MAX_TIME_OFFSET_S = 1.5
CHANGED_SIZE_M = 0.5  # more than bodies that touch are apart, as their sizes may change
SWEPT_PERIOD_S = 1.0  # duration of the pieces of trajectories that are compared first
PIECE_ROUNDING_M = 1e-6
PET_ROUNDING_S = 1e-6


class Conflict(NamedTuple):
    """Conflict of two road users.

    Attributes:
        first: number of the road user who takes up the common place first.
        second: number of the second road user.
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

    Between frames that are lost or far apart, road users go straight on.

    area: xmin, ymin, xmax, ymax (m) in which their places are, None for anywhere."""
    moving = [
        trajectory
        for trajectory in trajectories
        if (trajectory.speeds > MOVING_M_S).any() and trajectory.known_s >= MIN_KNOWN_S
    ]
    moving = refine_trajectories(moving)
    conflicts = []
    for user, partner in _list_pairs(moving, max_pet):
        conflict = _find_conflict(user, partner, max_pet)
        if conflict is None:
            continue
        point = np.array([conflict.x, conflict.y])
        if area is None or ((point >= area[:2]) & (point <= area[2:])).all():
            conflicts.append(conflict)
    return sorted(conflicts, key=lambda conflict: (conflict.time, conflict.first, conflict.second))


def _list_pairs(
    trajectories: Sequence[Trajectory], max_pet: float
) -> Iterator[tuple[Trajectory, Trajectory]]:
    """Yield pairs that may be near one place within `max_pet` seconds of each other.

    Two pedestrians are no pair. Each pair comes once, in the order of the trajectories."""
    if not trajectories:
        return
    pairs = _Pieces.cut(trajectories).find_pairs(max_pet)
    spans = np.array([[trajectory.times[0], trajectory.times[-1]] for trajectory in trajectories])
    radii = np.array([np.hypot(*trajectory.boxes[0, 3:5]) / 2 for trajectory in trajectories])
    lows = np.array([trajectory.boxes[:, :2].min(axis=0) for trajectory in trajectories])
    highs = np.array([trajectory.boxes[:, :2].max(axis=0) for trajectory in trajectories])
    lows -= radii[:, None]
    highs += radii[:, None]
    on_foot = np.array([trajectory.label == PEDESTRIAN for trajectory in trajectories])
    user, partner = pairs.T
    is_near = (spans[partner, 0] <= spans[user, 1] + max_pet) & (
        spans[partner, 1] >= spans[user, 0] - max_pet
    )
    is_near &= (lows[partner] <= highs[user]).all(axis=1)
    is_near &= (highs[partner] >= lows[user]).all(axis=1)
    is_near &= ~(on_foot[partner] & on_foot[user])
    for row, number in pairs[is_near].tolist():
        yield trajectories[row], trajectories[number]


class _Pieces(NamedTuple):
    """Pieces of trajectories, of at most `SWEPT_PERIOD_S`, in the order of time.

    Attributes:
        user: row of the trajectory of each.
        period: number of its period of `SWEPT_PERIOD_S`, ascending.
        low: lowest x, y (m) that its bodies reach while they move.
        high: highest x, y (m)."""

    user: Int64[np.ndarray, " pieces"]
    period: Int64[np.ndarray, " pieces"]
    low: Float64[np.ndarray, "pieces 2"]
    high: Float64[np.ndarray, "pieces 2"]

    @staticmethod
    def cut(trajectories: Sequence[Trajectory]) -> "_Pieces":
        """Cut trajectories into pieces, without rows at which they do not move."""
        pieces = []
        for row, trajectory in enumerate(trajectories):
            is_moving = trajectory.speeds > MOVING_M_S
            periods = np.floor(trajectory.times[is_moving] / SWEPT_PERIOD_S).astype(np.int64)
            points = trajectory.boxes[is_moving, :2]
            period, begins = np.unique(periods, return_index=True)
            margin = np.hypot(*trajectory.boxes[0, 3:5]) / 2 + CHANGED_SIZE_M / 2 + PIECE_ROUNDING_M
            low = np.minimum.reduceat(points, begins) - margin
            high = np.maximum.reduceat(points, begins) + margin
            pieces.append(_Pieces(np.full(len(period), row), period, low, high))
        joined = _Pieces(*(np.concatenate(columns) for columns in zip(*pieces, strict=True)))
        order = np.argsort(joined.period, kind="stable")
        return _Pieces(*(column[order] for column in joined))

    def find_pairs(self, max_pet: float) -> Int64[np.ndarray, "pairs 2"]:
        """Pairs of trajectories with pieces near each other within `max_pet` seconds, ascending.

        Periods are swept in the order of time, each with those that follow soon."""
        pairs: set[tuple[int, int]] = set()
        soon = int(max_pet / SWEPT_PERIOD_S) + 1  # periods
        for period in np.unique(self.period).tolist():
            begin = np.searchsorted(self.period, period)
            pieces = slice(begin, np.searchsorted(self.period, period, side="right"))
            later = slice(begin, np.searchsorted(self.period, period + soon, side="right"))
            is_near = (self.low[pieces, None] <= self.high[later]).all(axis=2)
            is_near &= (self.high[pieces, None] >= self.low[later]).all(axis=2)
            piece, later_piece = np.nonzero(is_near)
            users = np.stack([self.user[pieces][piece], self.user[later][later_piece]])
            users.sort(axis=0)
            pairs.update(zip(*users[:, users[0] < users[1]].tolist(), strict=True))
        return np.array(sorted(pairs), np.int64).reshape(-1, 2)


class _CommonPlaces(NamedTuple):
    """Rows of two trajectories at which they take up a common place, and move.

    Attributes:
        rows: rows of the first trajectory.
        partner_rows: rows of the second one, the partner's.
        gaps: time of the partner less time of the first user (s), below 0 if the partner is there
            before."""

    rows: Int64[np.ndarray, " k"]
    partner_rows: Int64[np.ndarray, " k"]
    gaps: Float64[np.ndarray, " k"]


def _find_conflict(user: Trajectory, partner: Trajectory, max_pet: float) -> Conflict | None:
    """Conflict of two road users, None without one.

    The time between their visits, the post-encroachment time, is shortest there.
    Road users who go the same way have none. max_pet: largest such time of a conflict (s)."""
    # `places.gaps`: time of the partner less time of the user at each common place (s)
    places = _find_common_places(user, partner, max_pet)
    if not len(places.gaps):
        return None
    shortest = np.abs(places.gaps).min()
    # places with the shortest time but for rounding; the middle one is taken
    nearest = np.flatnonzero(np.abs(places.gaps) <= shortest + 1e-6)
    middle = int(nearest[len(nearest) // 2])
    row = int(places.rows[middle])
    partner_row = int(places.partner_rows[middle])
    angle = _angle_deg(user.velocities[row], partner.velocities[partner_row])
    # The angle also at one moment for both, between their visits: directions of two side by side in
    # a bend may differ at the place, but not at that moment.
    moment = (user.times[row] + partner.times[partner_row]) / 2
    together_angle = _angle_deg(_find_velocity(user, moment), _find_velocity(partner, moment))
    if min(angle, together_angle) <= MIN_CROSSING_DEG:
        return None
    first, second = (user, partner) if places.gaps[middle] >= 0 else (partner, user)
    point = (user.boxes[row, :2] + partner.boxes[partner_row, :2]) / 2
    arrival = float(max(user.times[row], partner.times[partner_row]))
    return Conflict(
        first=first.id,
        second=second.id,
        labels=(LABELS[first.label], LABELS[second.label]),
        time=arrival,
        x=float(point[0]),
        y=float(point[1]),
        pet_s=float(shortest),
        ttc_s=_find_shortest_ttc(user, partner, arrival),
        angle_deg=angle,
    )


def _find_common_places(user: Trajectory, partner: Trajectory, max_pet: float) -> _CommonPlaces:
    """Pairs of rows, one of each user, whose bodies overlap, at most `max_pet` seconds apart."""
    rows = np.flatnonzero(_mask_near(user, partner))
    partner_rows = np.flatnonzero(_mask_near(partner, user))
    # the partner's rows soon before and after each row of the user; a little more, for rounding
    span = max_pet + PET_ROUNDING_S
    partner_times = partner.times[partner_rows]
    begins = np.searchsorted(partner_times, user.times[rows] - span)
    counts = np.searchsorted(partner_times, user.times[rows] + span) - begins
    pair_rows = np.repeat(rows, counts)
    # number of each pair among all with its row of the user
    order = np.arange(len(pair_rows)) - np.repeat(np.cumsum(counts) - counts, counts)
    pair_others = partner_rows[np.repeat(begins, counts) + order]
    gaps = partner.times[pair_others] - user.times[pair_rows]
    offsets = partner.boxes[pair_others, :2] - user.boxes[pair_rows, :2]
    reach = _measure_margin(user, partner)
    is_near = (np.square(offsets).sum(axis=1) < reach**2) & (np.abs(gaps) <= max_pet)
    pair_rows = pair_rows[is_near]
    pair_others = pair_others[is_near]
    is_common = are_close(user.boxes[pair_rows], partner.boxes[pair_others], 0.0)
    return _CommonPlaces(pair_rows[is_common], pair_others[is_common], gaps[is_near][is_common])


def _mask_near(trajectory: Trajectory, partner: Trajectory) -> Bool[np.ndarray, " n"]:
    """Mask of the rows of a trajectory at which it moves where its partner may be at any time."""
    margin = _measure_margin(trajectory, partner)
    points = trajectory.boxes[:, :2]
    low = partner.boxes[:, :2].min(axis=0) - margin
    high = partner.boxes[:, :2].max(axis=0) + margin
    is_near = ((points >= low) & (points <= high)).all(axis=1)
    return is_near & (trajectory.speeds > MOVING_M_S)


def _measure_margin(user: Trajectory, partner: Trajectory) -> float:
    """Distance (m) of two bodies' middles below which they may overlap.

    Half the diagonals of both footprints, and `CHANGED_SIZE_M`."""
    diagonals_m = np.hypot(*user.boxes[0, 3:5]) + np.hypot(*partner.boxes[0, 3:5])
    return float(diagonals_m / 2 + CHANGED_SIZE_M)


def _find_velocity(trajectory: Trajectory, time: float) -> Float64[np.ndarray, "2"]:
    """Velocity (m/s) along x and y in the first row from a time (s) on, or in the last row."""
    row = int(np.clip(np.searchsorted(trajectory.times, time), 0, len(trajectory.times) - 1))
    return trajectory.velocities[row]


def _angle_deg(user: Float64[np.ndarray, "2"], partner: Float64[np.ndarray, "2"]) -> float:
    """Angle between two directions (degrees, 0 to 180)."""
    cross = float(user[0] * partner[1] - user[1] * partner[0])
    return float(np.rad2deg(np.arctan2(abs(cross), float(user @ partner))))


def _find_shortest_ttc(user: Trajectory, partner: Trajectory, time: float) -> float:
    """Shortest time to collision (s) in the `TTC_SPAN_S` before a time (s), infinite without one.

    Only times at which both road users have rows are looked at."""
    is_before = (user.times <= time) & (user.times >= time - TTC_SPAN_S)
    rows = np.flatnonzero(is_before & np.isin(user.times, partner.times))
    partner_rows = np.searchsorted(partner.times, user.times[rows])
    seconds = time_to_collision(
        user.boxes[rows],
        partner.boxes[partner_rows],
        partner.velocities[partner_rows] - user.velocities[rows],
    )
    return float(seconds.min(initial=np.inf))


def time_to_collision(
    boxes: BoxRows, partner_boxes: BoxRows, velocities: Float64[np.ndarray, "n 2"]
) -> Float64[np.ndarray, " n"]:
    """Seconds after which two bodies touch, row by row, if both keep their velocities.

    0 for bodies that touch now, infinite for those that never do. Along the normal of each edge the
    bodies overlap during an interval of time; they touch while all intervals last.

    Args:
        boxes: Boxes of the first body.
        partner_boxes: Boxes of the second body.
        velocities: Velocity of the second body as seen from the first (m/s)."""
    offsets = partner_boxes[:, :2] - boxes[:, :2]
    begin = np.zeros(len(boxes))
    end = np.full(len(boxes), np.inf)
    for yaw in (
        boxes[:, 6],
        boxes[:, 6] + np.pi / 2,
        partner_boxes[:, 6],
        partner_boxes[:, 6] + np.pi / 2,
    ):
        normal = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
        reach = _half_extent(boxes, yaw) + _half_extent(partner_boxes, yaw)
        distance = (offsets * normal).sum(axis=1)
        speed = (velocities * normal).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            bounds = np.sort([(-reach - distance) / speed, (reach - distance) / speed], axis=0)
        is_still = speed == 0
        is_apart = np.abs(distance) > reach
        begin = np.where(is_still, begin, np.maximum(begin, bounds[0]))
        # -1, before any beginning, if they never overlap along this normal
        still_end = np.where(is_apart, -1.0, end)
        end = np.where(is_still, still_end, np.minimum(end, bounds[1]))
    return np.where(begin <= end, begin, np.inf)


def _half_extent(boxes: BoxRows, yaw: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """Half of the extent (m) of each box along a direction (rad)."""
    turn = boxes[:, 6] - yaw
    return (boxes[:, 3] * np.abs(np.cos(turn)) + boxes[:, 4] * np.abs(np.sin(turn))) / 2


class ConflictMatches(NamedTuple):
    """Conflicts found up to a PET, next to the true ones.

    Attributes:
        found: number of conflicts found.
        right: number of found ones that are true, whose PET may be longer by the tolerance.
        true: number of true conflicts.
        detected: number of true ones that were found, with a PET up to the tolerance longer.
        pet_errors_s: errors of the PET of the true conflicts that were found (s)."""

    found: int
    right: int
    true: int
    detected: int
    pet_errors_s: tuple[float, ...]


def match_conflicts(
    detected: Sequence[Conflict], true: Sequence[Conflict], *, max_pet: float, tolerance: float
) -> ConflictMatches:
    """Match conflicts with the true ones at the same place and time.

    Args:
        detected: Conflicts found, also some with a longer PET than `max_pet` + `tolerance`.
        true: True conflicts, likewise.
        max_pet: PET up to which conflicts count (s).
        tolerance: Excess over `max_pet` that a partner may have (s)."""
    from scipy.optimize import linear_sum_assignment

    places = np.array([[conflict.x, conflict.y] for conflict in detected]).reshape(-1, 2)
    true_places = np.array([[conflict.x, conflict.y] for conflict in true]).reshape(-1, 2)
    times = np.array([conflict.time for conflict in detected])
    true_times = np.array([conflict.time for conflict in true])
    distances = np.hypot(*np.moveaxis(places[:, None] - true_places, 2, 0)) / MAX_PLACE_OFFSET_M
    delays = np.abs(times[:, None] - true_times) / MAX_TIME_OFFSET_S
    is_pair = (distances <= 1) & (delays <= 1)
    rows, columns = linear_sum_assignment(np.where(is_pair, distances + delays - 10, 0.0))
    partners = {}
    true_partners = {}
    for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
        if is_pair[row, column]:
            partners[row] = true[column]
            true_partners[column] = detected[row]
    counted = [row for row, conflict in enumerate(detected) if conflict.pet_s <= max_pet]
    counted_true = [row for row, conflict in enumerate(true) if conflict.pet_s <= max_pet]
    longest = max_pet + tolerance
    right = [row for row in counted if row in partners and partners[row].pet_s <= longest]
    recalled = [
        row for row in counted_true if row in true_partners and true_partners[row].pet_s <= longest
    ]
    errors = [true_partners[row].pet_s - true[row].pet_s for row in recalled]
    return ConflictMatches(
        found=len(counted),
        right=len(right),
        true=len(counted_true),
        detected=len(recalled),
        pet_errors_s=tuple(errors),
    )
