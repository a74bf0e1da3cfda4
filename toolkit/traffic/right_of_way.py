"""Right of way: bodies that would overlap others wait for them, or step aside.

Road users are placed in turn, vehicles first and walkers last, each by those who were before it.
The course of a road user in space is given; when it goes along it is planned, and for people also
how far beside it (Kant and Zucker, Int. J. of Robotics Research 5(3), 1986). A plan is the cheapest
sequence of moments to go on, to wait or to step aside in which no body comes near another, found by
dynamic programming in a window of time around each conflict."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float64, Int64
from toolkit.geometry import smooth_rows
from toolkit.objects import CYCLIST, PEDESTRIAN
from toolkit.traffic.occupancy import Moments, Occupancy, size_boxes
from toolkit.traffic.sumo import FINE_STEP_S

STRIDE = 2  # steps of `FINE_STEP_S` between the moments of a plan
LOOK_BACK_STEPS = 80  # from a conflict to the begin of its window
HORIZONS_STEPS = (250, 800)  # from a conflict to the window's end; the second if need be
REACH_MOMENTS = 100  # part of the course, in moments, that a plan covers
ASIDE_SPACING_M = 0.15
MAX_PLANS = 12  # windows planned for one road user
WAIT_COST = 1.0
CROSSED_WAIT_COST = 3.0  # for waiting where another comes along within the window
EARLY_WAIT_COST = 0.002  # more for each moment before the end, so that late waits are preferred
ASIDE_COST = 0.5  # for a step aside by `ASIDE_SPACING_M`
OFFSET_COST = 0.02  # for each moment and place beside the course
RETURN_M = 0.04  # back to the course in a step after a plan
# rows ahead and places to the left; without places beside the course, the first two
MOVES = ((1, 0), (0, 0), (1, 1), (1, -1), (0, 1), (0, -1))
MIN_TURNING_M_S = 0.7  # speed with which a step aside is compared at least, for the heading


class Manner(NamedTuple):
    """Manner in which road users of a class give way.

    Attributes:
        places: places beside the course, on each side, that they may use.
        gaps: gaps to others that are tried one after the other (m).
        smoothing: standard deviation of the mean over time that smooths changes (steps)."""

    places: int
    gaps: tuple[float, ...]
    smoothing: float


WALKING = Manner(6, (0.4, 0.22, 0.14), 4.0)
CYCLING = Manner(3, (0.6, 0.3, 0.14), 6.0)
DRIVING = Manner(0, (1.5, 0.6, 0.14), 12.0)
MANNERS = {PEDESTRIAN: WALKING, CYCLIST: CYCLING}  # others are `DRIVING`


@dataclass(frozen=True)
class Course:
    """Course of a body.

    Attributes:
        first: step of the first pose.
        poses: x, y (m), yaw (rad), one for each step.
        size: length, width, height of the body (m).
        label: class of `toolkit.objects`."""

    first: int
    poses: Float64[np.ndarray, "steps 3"]
    size: Float64[np.ndarray, "3"]
    label: int


class _Plan(NamedTuple):
    """Progress on a course, for each step from the course's first on.

    Attributes:
        progress: row of the course's poses, which may lie between two.
        aside: distance to the left of the course (m)."""

    progress: Float64[np.ndarray, " steps"]
    aside: Float64[np.ndarray, " steps"]


class _Moves(NamedTuple):
    """Planned moments of a window.

    Attributes:
        progress: moments' worth of course since the window's begin.
        aside: place beside the course, 0 on it, positive to the left."""

    progress: Int64[np.ndarray, " moments"]
    aside: Int64[np.ndarray, " moments"]


def give_way(course: Course, occupancy: Occupancy) -> Float64[np.ndarray, "steps 3"] | None:
    """Poses of a body that waits and steps aside for others, which is added to them.

    Returns x, y (m) and yaw (rad) for each step from the course's first on, None if there is no
    way through."""
    manner = MANNERS.get(course.label, DRIVING)
    plan = _Plan(np.arange(len(course.poses), dtype=np.float64), np.zeros(len(course.poses)))
    poses = course.poses
    settings = [(horizon, gap) for horizon in HORIZONS_STEPS for gap in manner.gaps]
    setting = 0
    latest = -1
    for _ in range(MAX_PLANS):
        boxes = size_boxes(poses, course.size)
        conflict = occupancy.find_conflict(boxes, course.first)
        if conflict is None:
            occupancy.add(boxes, course.first)
            return poses
        # a plan that did not help is followed by another gap or a longer window
        setting = setting + 1 if conflict <= latest + STRIDE else 0
        latest = max(latest, conflict)
        changed = None
        while changed is None:
            if setting == len(settings):
                return None
            horizon, gap = settings[setting]
            window = _choose_window(course, conflict, horizon)
            changed = _plan_window(course, plan, window, gap, occupancy)
            setting += changed is None
        plan = changed
        poses = _follow(course, plan, occupancy.last)
    return None


def _choose_window(course: Course, conflict: int, horizon: int) -> Moments:
    """Moments around a conflict for which to plan. conflict: its step; horizon: steps after it."""
    begin = max(course.first, conflict - LOOK_BACK_STEPS)
    return Moments(begin, STRIDE, (conflict + horizon - begin) // STRIDE + 1)


def _plan_window(
    course: Course, plan: _Plan, window: Moments, gap: float, occupancy: Occupancy
) -> _Plan | None:
    """Plan anew from a window's begin on; None if there is no way through.

    Args:
        course: Course of the body.
        plan: Plan so far.
        window: Moments for which to plan.
        gap: Gap to keep to others (m).
        occupancy: The others."""
    places = MANNERS.get(course.label, DRIVING).places
    row = window.begin - course.first
    progress = float(plan.progress[row])
    start_place = int(np.clip(round(plan.aside[row] / ASIDE_SPACING_M), -places, places))
    rows = progress + STRIDE * np.arange(REACH_MOMENTS)
    rows = rows[rows <= len(course.poses) - 1]
    if not len(rows):
        return None
    asides = ASIDE_SPACING_M * np.arange(-places, places + 1)
    offsets = np.repeat(asides, len(rows))
    poses = _shift(_pick(course.poses, np.tile(rows, len(asides))), offsets)
    boxes = size_boxes(poses, course.size)
    shape = (window.count, len(asides), len(rows))
    taken = occupancy.is_taken(boxes, window, gap)
    is_crossed = taken.any(axis=0).reshape(shape[1:])
    taken |= occupancy.is_obstructed_in_view(boxes, gap)
    moves = _find_moves(taken.reshape(shape), is_crossed, start_place + places)
    if moves is None:
        return None
    # from moments to steps
    steps = np.arange(STRIDE * (window.count - 1) + 1)
    moments = STRIDE * np.arange(window.count)
    planned = _Plan(
        progress + STRIDE * np.interp(steps, moments, moves.progress),
        np.interp(steps, moments, ASIDE_SPACING_M * (moves.aside - places)),
    )
    return _join(_Plan(plan.progress[:row], plan.aside[:row]), planned, len(course.poses))


def _join(before: _Plan, planned: _Plan, count: int) -> _Plan:
    """Plan of all steps: before a window, in it, and on to the end of the course as usual.

    count: number of the course's poses."""
    rest = np.arange(planned.progress[-1] + 1, count)
    returned = np.maximum(0, np.abs(planned.aside[-1]) - RETURN_M * np.arange(1, len(rest) + 1))
    progress = np.concatenate([before.progress, planned.progress, rest])
    aside = np.concatenate([before.aside, planned.aside, np.sign(planned.aside[-1]) * returned])
    is_under_way = progress <= count - 1
    return _Plan(progress[is_under_way], aside[is_under_way])


def _find_moves(
    taken: Bool[np.ndarray, "moments places rows"],
    is_crossed: Bool[np.ndarray, "places rows"],
    start_place: int,
) -> _Moves | None:
    """Cheapest moves through a window; None if there are none.

    Args:
        taken: Mask of what is taken, by moment, place beside the course and row of it.
        is_crossed: Mask of places and rows that others take at some moment.
        start_place: Place at the first moment; the row is 0."""
    moments, places, rows = taken.shape
    # the last row stands for all of the course that is farther on, where waiting costs nothing
    costs = np.full((places, rows + 1), np.inf)
    costs[start_place, 0] = 0.0
    wait_costs = np.zeros((places, rows + 1))
    wait_costs[:, :-1] = np.where(is_crossed, CROSSED_WAIT_COST, WAIT_COST)
    offset_costs = OFFSET_COST * np.abs(np.arange(places) - places // 2)[:, None]
    # a move: rows ahead, places to the left
    moves = MOVES if places > 1 else MOVES[:2]
    choices = np.empty((moments, places, rows + 1), np.int8)
    options = np.empty((len(moves), places, rows + 1))
    for moment in range(1, moments):
        early = EARLY_WAIT_COST * (moments - moment)
        for number, (ahead, left) in enumerate(moves):
            reached = options[number]
            reached[:] = np.inf
            source = costs if ahead else costs + wait_costs * (1 + early)
            target = reached[max(left, 0) : places + min(left, 0)]
            source = source[max(-left, 0) : places + min(-left, 0)]
            target[:, ahead:] = source[:, : rows + 1 - ahead] + ASIDE_COST * abs(left)
        choices[moment] = options.argmin(axis=0)
        costs = options.min(axis=0) + offset_costs
        costs[:, :-1][taken[moment]] = np.inf
    end = int(costs.argmin())
    if not np.isfinite(costs.flat[end]):
        return None
    return _trace(choices, moves, end)


def _trace(
    choices: Int64[np.ndarray, "moments places rows"], moves: Sequence[tuple[int, int]], end: int
) -> _Moves:
    """Moves that lead to an end.

    Args:
        choices: Number of the move that led to each state; the last row is all that follows.
        moves: Rows ahead and places to the left of each move.
        end: Place and row at the last moment, as a flat index."""
    moments = len(choices)
    rows = choices.shape[2]
    place, row = divmod(end, rows)
    progress = np.empty(moments, np.int64)
    aside = np.empty(moments, np.int64)
    for moment in range(moments - 1, -1, -1):
        progress[moment] = row
        aside[moment] = place
        if moment:
            ahead, left = moves[int(choices[moment, place, row])]
            row -= ahead
            place -= left
    arrival = int(np.searchsorted(progress, rows - 1))
    progress[arrival:] = rows - 1 + np.arange(moments - arrival)
    return _Moves(progress, aside)


def _follow(course: Course, plan: _Plan, last: int) -> Float64[np.ndarray, "steps 3"]:
    """Poses of a body that follows a plan up to a last step, with smooth changes."""
    sigma = MANNERS.get(course.label, DRIVING).smoothing
    count = max(0, last - course.first + 1)
    columns = np.column_stack([plan.progress, plan.aside])
    smoothed = smooth_rows(columns, sigma)[:count]
    poses = _pick(course.poses, smoothed[:, 0])
    if not len(poses) or not smoothed[:, 1].any():
        return poses
    shifted = _shift(poses, smoothed[:, 1])
    # a heading turns with the course that the body takes
    ahead_m_s = np.hypot(*np.gradient(poses[:, :2], FINE_STEP_S, axis=0).T)
    aside_m_s = np.gradient(smoothed[:, 1], FINE_STEP_S)
    shifted[:, 2] += np.arctan2(aside_m_s, np.maximum(ahead_m_s, MIN_TURNING_M_S))
    return shifted


def _pick(
    poses: Float64[np.ndarray, "steps 3"], rows: Float64[np.ndarray, " k"]
) -> Float64[np.ndarray, "k 3"]:
    """Poses at rows that may lie between two; headings are continuous."""
    low = np.clip(rows.astype(np.int64), 0, len(poses) - 1)
    high = np.minimum(low + 1, len(poses) - 1)
    share = (rows - low)[:, None]
    turn = poses[high, 2] - poses[low, 2]
    step = poses[high] - poses[low]
    step[:, 2] = np.arctan2(np.sin(turn), np.cos(turn))
    return poses[low] + share * step


def _shift(
    poses: Float64[np.ndarray, "k 3"], left: Float64[np.ndarray, " k"]
) -> Float64[np.ndarray, "k 3"]:
    """Poses moved to their left by some distances (m)."""
    shifted = poses.copy()
    shifted[:, 0] -= left * np.sin(poses[:, 2])
    shifted[:, 1] += left * np.cos(poses[:, 2])
    return shifted
