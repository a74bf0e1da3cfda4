"""Trips: ways of road users through the detection area, from arm of entry to arm of exit."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float64
from toolkit.counting.arms import Arm, find_crossing, nearest_arm
from toolkit.counting.trajectories import MOVING_M_S, Trajectory

COURSE_S = 0.8  # at each end of a trajectory, over which its course is a mean


class Trip(NamedTuple):
    """Way of a road user through the area.

    Attributes:
        id: number of the road user.
        label: its class, as a number of `toolkit.objects.LABELS`.
        entry: name of the arm at which it came in; None if it was first seen inside.
        exit: name of the arm at which it left; None if it was last seen inside.
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

    Args:
        trajectories: Road users.
        arms: Arms of the junction, at least one.
        area: xmin, ymin, xmax, ymax (m)."""
    trips = []
    for trajectory in trajectories:
        rows = np.flatnonzero(mask_inside(trajectory, area))
        if len(rows):
            first = int(rows[0])
            last = int(rows[-1])
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
    # the row outside shows the arm; a road user first (last) seen inside went straight on
    before = None if first == 0 else trajectory.boxes[first - 1, :2]
    after = None if last + 1 == len(trajectory.times) else trajectory.boxes[last + 1, :2]
    begin_course = _mean_course(inside, from_begin=True)
    end_course = _mean_course(inside, from_begin=False)
    entry_point = before
    if entry_point is None:
        entry_point = find_crossing(inside.boxes[0, :2], -begin_course, area)
    exit_point = after
    if exit_point is None:
        exit_point = find_crossing(inside.boxes[-1, :2], end_course, area)
    return Trip(
        id=trajectory.id,
        label=trajectory.label,
        entry=None if entry_point is None else nearest_arm(entry_point, arms),
        exit=None if exit_point is None else nearest_arm(exit_point, arms),
        begin=float(inside.times[0]),
        end=float(inside.times[-1]),
        way_m=float((speeds * steps)[is_moving].sum()),
        moving_s=float(steps[is_moving].sum()),
        standing_s=float(steps[~is_moving].sum()),
    )


def _mean_course(inside: Trajectory, *, from_begin: bool) -> Float64[np.ndarray, "2"]:
    """Mean velocity (m/s) in the first `COURSE_S` of a trajectory, or (`from_begin` False) in the
    last."""
    times = inside.times
    is_near = times <= times[0] + COURSE_S if from_begin else times >= times[-1] - COURSE_S
    return inside.velocities[is_near].mean(axis=0)
