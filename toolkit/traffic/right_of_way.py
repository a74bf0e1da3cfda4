"""Right of way: bodies that would overlap others wait for them, or step aside.

Road users are placed in turn, vehicles first and pedestrians last, each by those who were before
it. The course of a road user in space is given; when it goes along it is planned, and how far from
it to the side (Kant and Zucker, Int. J. of Robotics Research 5(3), 1986). A plan is the cheapest
sequence of moments to go on, to wait or to step aside in which no body comes near another, found by
dynamic programming in a window of time around each conflict."""

from math import ceil
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float64, Int64
from toolkit.geometry import smooth_rows
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE
from toolkit.traffic.body_motion import face_along
from toolkit.traffic.corners import walk_round
from toolkit.traffic.course import ASIDE_SPACING_M, Course, list_asides
from toolkit.traffic.occupancy import Moments, Occupancy, size_boxes
from toolkit.traffic.sumo import FINE_STEP_S

STRIDE = 3  # steps of `FINE_STEP_S` between the moments of a plan
# steps from the begin of a window to its conflict and on to its end, tried one after the other
WINDOWS_STEPS = ((50, 120), (400, 400))
REACH_STEPS = 80  # part of the course after a conflict that a plan covers
SMOOTHED_STEPS = 50  # before a window, whose poses smoothing may change
MAX_PLANS = 40  # windows planned for one road user
WAIT_COST = 1.0
CROSSED_WAIT_COST = 3.0  # for waiting where another comes along within the window
EARLY_WAIT_COST = 0.002  # more for each moment before the end, so that late waits are preferred
ASIDE_COST = 0.5  # for a step aside by `ASIDE_SPACING_M`
OFFSET_COST = 0.02  # for each moment and line away from the course
CHECK_MOMENTS = 16  # between looks at whether a window has a way at all
# rows ahead and lines to the left; with one line only the first two
MOVES = ((1, 0), (0, 0), (1, 1), (1, -1), (0, 1), (0, -1))
# by class: lines next to the course, on each side, that they may take
SIDE_LINES = {VEHICLE: 2, HEAVY: 1, CYCLIST: 3, PEDESTRIAN: 6}
# by class: gaps to others that are tried one after the other (m)
GAPS_M = {
    VEHICLE: (1.5, 0.6, 0.14),
    HEAVY: (1.5, 0.6, 0.14),
    CYCLIST: (0.6, 0.3, 0.14),
    PEDESTRIAN: (0.4, 0.22, 0.14),
}
HEADWAYS_STEPS = (12, 0, 0)  # time kept to others, with each of these gaps
# by class: standard deviation of the mean over time that smooths changes
SMOOTHING_STEPS = {VEHICLE: 12.0, HEAVY: 12.0, CYCLIST: 6.0, PEDESTRIAN: 4.0}
MIN_TURNING_M_S = 0.7  # speed with which a step aside is compared at least, for the heading


class _Plan(NamedTuple):
    """Progress on a course and distance from it, for each step from the course's first on.

    Attributes:
        progress: row of the course's poses, which may be between two.
        aside: distance to the left of the course (m)."""

    progress: Float64[np.ndarray, " steps"]
    aside: Float64[np.ndarray, " steps"]


class _Limits(NamedTuple):
    """Limits of the plan of a window.

    Attributes:
        gap: distance to keep to others (m).
        headway: time to keep to others (steps).
        reach: length of the course that the plan covers (steps)."""

    gap: float
    headway: int
    reach: int


class _Moves(NamedTuple):
    """Planned moments of a window, up to its end or to where nothing is in the way any more.

    Attributes:
        progress: row of the window's course at each moment.
        line: number of the line next to the course at each moment, 0 for the one farthest right."""

    progress: Int64[np.ndarray, " moments"]
    line: Int64[np.ndarray, " moments"]


def give_way(course: Course, occupancy: Occupancy) -> Float64[np.ndarray, "steps 3"] | None:
    """Poses of a body that waits and steps aside for others, None if there is no way through.

    They are x, y (m) and yaw (rad) for each step from the course's first on. course: the body's, as
    if nobody else were there; occupancy: the others, to which the body is added."""
    plan = _Plan(np.arange(len(course.poses), dtype=np.float64), np.zeros(len(course.poses)))
    poses = course.poses
    distances = list(zip(GAPS_M[course.label], HEADWAYS_STEPS, strict=True))
    settings = [(span, distance) for span in WINDOWS_STEPS for distance in distances]
    setting = 0
    since = course.first  # earlier steps have no conflict
    latest = -1
    for _ in range(MAX_PLANS):
        boxes = size_boxes(poses, course.size)
        conflict = occupancy.find_conflict(boxes, course.first, since=since)
        if conflict is None:
            occupancy.add(boxes, course.first)
            return poses
        row = conflict - course.first
        is_static = occupancy.is_obstructed(boxes[[row]]).any()
        if is_static and _is_blocked_near(course, plan.progress[row], occupancy):
            if course.label != PEDESTRIAN:
                return None
            detour = walk_round(course, occupancy, gap=GAPS_M[PEDESTRIAN][-1])
            return None if detour is None else give_way(detour, occupancy)
        # a plan that did not help is followed by another gap or a longer window
        setting = setting + 1 if conflict <= latest + STRIDE else 0
        latest = max(latest, conflict)
        changed = None
        while changed is None:
            if setting == len(settings):
                return None
            (before, after), distance = settings[setting]
            begin = max(course.first, conflict - before)
            window = Moments(begin, STRIDE, (conflict + after - begin) // STRIDE + 1)
            reach = conflict - begin + REACH_STEPS
            since = begin - SMOOTHED_STEPS
            gap, headway = distance
            limits = _Limits(gap=gap, headway=headway, reach=reach)
            changed = _plan_window(course, plan, window, limits=limits, occupancy=occupancy)
            setting += changed is None
        plan = changed
        poses = _follow(course, plan, occupancy.last)
    return None


def is_impassable(course: Course, occupancy: Occupancy) -> bool:
    """Return True if solids or parked vehicles leave a body no way along its course.

    It would wait for ever, and all who wait for it."""
    return _has_closed_row(course, np.arange(len(course.poses)), occupancy)


def _is_blocked_near(course: Course, progress: float, occupancy: Occupancy) -> bool:
    """Return True if a course is impassable near one place.

    progress: row of its poses at which it is obstructed, which may be between two."""
    nearest = round(progress)
    last = min(len(course.poses), nearest + REACH_STEPS)
    rows = np.arange(max(0, nearest - REACH_STEPS), last)
    return _has_closed_row(course, rows, occupancy)


def _has_closed_row(course: Course, rows: Int64[np.ndarray, " n"], occupancy: Occupancy) -> bool:
    """Return True if all lines next to one of the rows are obstructed, so that none leads past."""
    boxes = course.list_lines(rows, list_asides(SIDE_LINES[course.label]))
    is_obstructed = occupancy.is_obstructed_in_view(boxes, GAPS_M[course.label][-1])
    return bool(is_obstructed.all(axis=1).any())


def _plan_window(
    course: Course, plan: _Plan, window: Moments, limits: _Limits, occupancy: Occupancy
) -> _Plan | None:
    """Plan again from a window's begin on; None if there is no way through.

    Args:
        course: Course of the body.
        plan: Plan so far.
        window: Moments for which to plan.
        limits: Distances to keep, and the part of the course that the plan covers.
        occupancy: The others."""
    side_lines = SIDE_LINES[course.label]
    row = window.begin - course.first
    progress = float(plan.progress[row])
    start_line = round(plan.aside[row] / ASIDE_SPACING_M)
    start_line = int(np.clip(start_line, -side_lines, side_lines))
    rows = progress + STRIDE * np.arange(limits.reach // STRIDE)
    rows = rows[rows <= len(course.poses) - 1]
    if not len(rows):
        return None
    boxes = course.list_lines(rows, list_asides(side_lines))
    margin = ceil(SMOOTHING_STEPS[course.label] / STRIDE)
    # by moment, line and row
    blocked = occupancy.find_blocked(boxes, window, limits.gap)
    blocked = _widen(blocked, margin + ceil(limits.headway / STRIDE))
    is_crossed = np.any(blocked, axis=0)
    is_obstructed = occupancy.is_obstructed_in_view(boxes, limits.gap).T
    blocked |= _widen(is_obstructed.T, margin).T
    moves = _find_moves(blocked, is_crossed, start_line + side_lines)
    if moves is None:
        return None
    # from moments to steps
    count = len(moves.progress)
    steps = np.arange(STRIDE * (count - 1) + 1)
    moments = STRIDE * np.arange(count)
    planned = _Plan(
        progress + STRIDE * np.interp(steps, moments, moves.progress),
        np.interp(steps, moments, ASIDE_SPACING_M * (moves.line - side_lines)),
    )
    return _join(_Plan(plan.progress[:row], plan.aside[:row]), planned, len(course.poses))


def _widen(mask: Bool[np.ndarray, "n *k"], margin: int) -> Bool[np.ndarray, "n *k"]:
    """Mask of rows that are marked, or at most `margin` rows from such a row.

    The reach about doubles with each round."""
    widened = mask
    reach = 0
    while reach < margin:
        shift = min(reach + 1, margin - reach)  # no farther, so that no row is left out
        doubled = widened.copy()
        doubled[shift:] |= widened[:-shift]
        doubled[:-shift] |= widened[shift:]
        widened = doubled
        reach += shift
    return widened


def _join(before: _Plan, planned: _Plan, count: int) -> _Plan:
    """Plan of all steps: before a window, in it, and from there on to the end of the course.

    before, planned: plans of the first two parts; count: number of the course's poses."""
    onward = np.arange(planned.progress[-1] + 1, count)
    progress = np.concatenate([before.progress, planned.progress, onward])
    aside = np.concatenate([before.aside, planned.aside, np.full(len(onward), planned.aside[-1])])
    is_under_way = progress <= count - 1
    return _Plan(progress[is_under_way], aside[is_under_way])


class _Costs(NamedTuple):
    """Costs of a window with m moments, l lines and r rows of the course.

    A line is parallel to the course, 0 the one farthest right; a row is a place along it, a row
    farther for each moment without a wait. Lines have a border on both sides and rows one before
    the first, all infinite, so line i and row k have the indices i + 1 and k + 1. The last row is
    all of the course that is farther on, in which nothing costs anything.

    Attributes:
        totals: least cost of being there at each moment.
        waits: cost of a wait there, but for the factor of its moment."""

    totals: Float64[np.ndarray, "m l+2 r+2"]
    waits: Float64[np.ndarray, "l+2 r+2"]

    def weigh_waits(self, moment: int) -> float:
        """Factor of the cost of a wait that ends at a moment; early ones cost a little more."""
        return 1 + EARLY_WAIT_COST * (len(self.totals) - moment)


def _find_moves(
    blocked: Bool[np.ndarray, "moments lines rows"],
    is_crossed: Bool[np.ndarray, "lines rows"],
    start_line: int,
) -> _Moves | None:
    """Cheapest moves through a window; None if it has no way through.

    Args:
        blocked: Mask of what is blocked, by moment, line and row of the course.
        is_crossed: Mask of lines and rows that others take at some moment.
        start_line: Line at the first moment; the row is 0."""
    moments = len(blocked)
    lines, rows = blocked.shape[1:]
    costs = _Costs(np.full((moments, lines + 2, rows + 2), np.inf), np.zeros((lines + 2, rows + 2)))
    costs.totals[0, start_line + 1, 1] = 0.0
    costs.waits[1:-1, 1:-1] = np.where(is_crossed, CROSSED_WAIT_COST, WAIT_COST)
    # what being there costs; the last row is all that is farther on
    place_costs = np.zeros((moments, lines, rows + 1))
    place_costs[:, :, :-1] = OFFSET_COST * np.abs(np.arange(lines) - lines // 2)[:, None]
    place_costs[:, :, :-1][blocked] = np.inf
    for moment in range(1, moments):
        before = costs.totals[moment - 1]
        onward = costs.waits[:, 1:] * costs.weigh_waits(moment)
        onward += before[:, 1:]
        np.minimum(before[:, :-1], onward, out=onward)
        now = costs.totals[moment, 1:-1, 1:]
        np.add(onward[:-2], ASIDE_COST, out=now)
        np.minimum(onward[1:-1], now, out=now)
        onward[2:] += ASIDE_COST
        np.minimum(onward[2:], now, out=now)
        now += place_costs[moment]
        # before the last row is reached, this only finds that there is no way
        is_checked = moment >= rows or moment % CHECK_MOMENTS == 0
        if is_checked and now[:, -1].min() <= now[:, :-1].min():  # nothing better, or no way at all
            break
    end = int(now.argmin())
    return _trace(costs, moment, end) if np.isfinite(now.flat[end]) else None


def _trace(costs: _Costs, last: int, end: int) -> _Moves:
    """Cheapest moves that lead to an end, traced back from there by the costs.

    A move goes on by a row or waits, on its line or to the next line.

    Args:
        costs: Costs of the window.
        last: Last moment.
        end: Line and row at that moment, as a flat index into `totals` without its borders."""
    rows = costs.waits.shape[1] - 1  # with the last row, which is all that is farther on
    moves = MOVES if len(costs.waits) > 3 else MOVES[:2]
    line, row = divmod(end, rows)
    progress = np.empty(last + 1, np.int64)
    lines = np.empty(last + 1, np.int64)
    for moment in range(last, -1, -1):
        progress[moment] = row
        lines[moment] = line
        if moment:
            weight = costs.weigh_waits(moment)
            # indices are counted with the borders
            area = slice(line, line + 3), slice(row, row + 2)
            totals = costs.totals[moment - 1][area].tolist()
            waits = costs.waits[area].tolist()
            options = []
            for ahead, left in moves:
                option = totals[1 - left][1 - ahead]
                if not ahead:  # a wait
                    option += waits[1 - left][1] * weight
                options.append(option + ASIDE_COST if left else option)
            ahead, left = moves[options.index(min(options))]
            row -= ahead
            line -= left
    # moments in the last row go on ahead, a row each
    arrival = int(np.searchsorted(progress, rows - 1))
    progress[arrival:] = rows - 1 + np.arange(last + 1 - arrival)
    return _Moves(progress, lines)


def _follow(course: Course, plan: _Plan, last: int) -> Float64[np.ndarray, "steps 3"]:
    """Poses (x, y in m, yaw in rad) of a body that follows a plan with smooth changes.

    One for each step of the simulation, from the course's first to the last one.

    plan: row of the course's poses and distance aside for each step; last: number of the last
    step, later ones are left out."""
    sigma = SMOOTHING_STEPS[course.label]
    count = max(0, last - course.first + 1)
    columns = np.column_stack([plan.progress, plan.aside])
    smoothed = smooth_rows(columns, sigma)[:count]
    poses = course.pick(smoothed[:, 0])
    if len(poses) < 2 or not smoothed[:, 1].any():
        return poses
    # beside the course, still with the headings on it; they turn with the path beside it
    shifted = course.shift(smoothed[:, 0], smoothed[:, 1])
    if course.label == PEDESTRIAN:
        return face_along(poses, shifted)
    ahead_m_s = np.hypot(*np.gradient(poses[:, :2], FINE_STEP_S, axis=0).T)
    aside_m_s = np.gradient(smoothed[:, 1], FINE_STEP_S)
    shifted[:, 2] += np.arctan2(aside_m_s, np.maximum(ahead_m_s, MIN_TURNING_M_S))
    return shifted
