"""Trips: ways of road users through the detection area, from arm of entry to arm of exit."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float64
from toolkit.counting.arms import Arm, find_arm, find_crossing, measure_border_way
from toolkit.counting.fragments import MAX_MOVING_GAP_S
from toolkit.counting.trajectories import MOVING_M_S, Trajectory

COURSE_S = 0.8  # at each end of a trajectory, over which its course is a mean


class Trip(NamedTuple):
    """Way of a road user through the area.

    Attributes:
        id: number of the road user.
        label: its class, as a number of `toolkit.objects.LABELS`.
        entry: name of the arm at which it came in; None if it was first seen inside, or if the
            place at which it came in does not show the arm.
        exit: name of the arm at which it left; None if it was last seen inside, or if the place at
            which it left does not show the arm.
        begin: time at which it is first in the area (s).
        end: time at which it is last in the area (s).
        way_m: length of its way in the area, as far as it moves.
        moving_s: seconds in which it moves.
        standing_s: seconds in which it does not move."""

    id: int
    label: int
    entry: str | None
    exit: str | None
    begin: float
    end: float
    way_m: float
    moving_s: float
    standing_s: float

    @property
    def is_whole(self) -> bool:
        """True if entry and exit are known."""
        return self.entry is not None and self.exit is not None

    @property
    def speed_km_h(self) -> float:
        """Mean speed while it moves (km/h), NaN if it does not."""
        return 3.6 * self.way_m / self.moving_s if self.moving_s > 0 else float("nan")

    @property
    def dwell_s(self) -> float:
        """Seconds in the area."""
        return self.end - self.begin


def find_trips(
    trajectories: Sequence[Trajectory], arms: Sequence[Arm], area: Float64[np.ndarray, "4"]
) -> list[Trip]:
    """Trips of the road users whose middle is in the area at some time, in their order.

    Whoever is outside for longer than `MAX_MOVING_GAP_S` makes another trip on coming back, since
    a track that ends at the border would not be joined with the next one either.

    Args:
        trajectories: Road users.
        arms: Arms of the junction, at least one.
        area: xmin, ymin, xmax, ymax (m)."""
    trips = []
    for trajectory in trajectories:
        rows = np.flatnonzero(mask_inside(trajectory, area))
        gaps = np.diff(trajectory.times[rows])
        # a gap between successive rows is inside, and may last
        is_away = (np.diff(rows) > 1) & (gaps > MAX_MOVING_GAP_S)
        for visit in np.split(rows, np.flatnonzero(is_away) + 1):
            if len(visit):
                first = int(visit[0])
                last = int(visit[-1])
                trips.append(_find_trip(trajectory, first, last, arms=arms, area=area))
    return trips


def mask_inside(trajectory: Trajectory, area: Float64[np.ndarray, "4"]) -> Bool[np.ndarray, " n"]:
    """Mask of the times at which a road user's middle is in an area (xmin, ymin, xmax, ymax; m)."""
    points = trajectory.boxes[:, :2]
    return np.all((points >= area[:2]) & (points <= area[2:]), axis=1)


def _find_trip(
    trajectory: Trajectory,
    first: int,
    last: int,
    *,
    arms: Sequence[Arm],
    area: Float64[np.ndarray, "4"],
) -> Trip:
    """Trip of a road user.

    Args:
        trajectory: The road user.
        first: First row in the area.
        last: Last row in the area.
        arms: Arms of the junction.
        area: xmin, ymin, xmax, ymax (m)."""
    inside = trajectory.select(slice(first, last + 1))
    steps = np.diff(inside.times)
    speeds = (inside.speeds[1:] + inside.speeds[:-1]) / 2  # in each step
    is_moving = speeds > MOVING_M_S
    begin_course = _mean_course(inside, from_begin=True)
    end_course = _mean_course(inside, from_begin=False)
    return Trip(
        id=trajectory.id,
        label=trajectory.label,
        entry=_find_gate(trajectory, first, first - 1, -begin_course, arms=arms, area=area),
        exit=_find_gate(trajectory, last, last + 1, end_course, arms=arms, area=area),
        begin=float(inside.times[0]),
        end=float(inside.times[-1]),
        way_m=float((speeds * steps)[is_moving].sum()),
        moving_s=float(steps[is_moving].sum()),
        standing_s=float(steps[~is_moving].sum()),
    )


def _find_gate(
    trajectory: Trajectory,
    row: int,
    row_outside: int,
    velocity: Float64[np.ndarray, "2"],
    *,
    arms: Sequence[Arm],
    area: Float64[np.ndarray, "4"],
) -> str | None:
    """Name of the arm at which a road user crosses the border, None if it is unknown.

    A road user that was first or last seen inside goes straight on.

    Args:
        trajectory: The road user.
        row: First or last row in the area.
        row_outside: Row next to it outside, which may not exist.
        velocity: Velocity out of the area (m/s).
        arms: Arms of the junction.
        area: xmin, ymin, xmax, ymax (m)."""
    point = trajectory.boxes[row, :2]
    if 0 <= row_outside < len(trajectory.times):
        step = trajectory.boxes[row_outside, :2] - point
        crossing = point + measure_border_way(point, step, area) * step
    else:
        crossing = find_crossing(point, velocity, area)
        if crossing is None:
            return None
    return find_arm(crossing, velocity, arms, area)


def _mean_course(inside: Trajectory, *, from_begin: bool) -> Float64[np.ndarray, "2"]:
    """Mean velocity (m/s) in the first `COURSE_S` of a trajectory, or (`from_begin` False) in the
    last."""
    times = inside.times
    is_near = times <= times[0] + COURSE_S if from_begin else times >= times[-1] - COURSE_S
    return inside.velocities[is_near].mean(axis=0)
