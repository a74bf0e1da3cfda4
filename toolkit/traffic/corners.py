"""Corners: pedestrians whose way leads through a house walk round it.

SUMO joins the pavements of two roads by straight lines, which may cut the corner of a house."""

from dataclasses import replace

import numpy as np

from toolkit.arrays import Bool, Float64
from toolkit.geometry import smooth_rows
from toolkit.traffic.body_motion import face_along
from toolkit.traffic.course import ASIDE_SPACING_M, Course, list_asides
from toolkit.traffic.occupancy import Occupancy

MAX_DETOUR_M = 3.0  # to the side of the course
HOUSE_MARGIN_M = 0.2  # to solids, beyond the nearest line without one
EARLY_STEPS = 25  # before and after a solid, within which the detour begins and ends
DETOUR_SMOOTHING_STEPS = 10.0  # standard deviation of the mean that rounds the detour


def walk_round(course: Course, occupancy: Occupancy, gap: float) -> Course | None:
    """Return a pedestrian's course that goes round solids and parked vehicles.

    It has the same steps. None if a solid is wider than `MAX_DETOUR_M` on both sides. gap: distance
    to keep to parked vehicles (m)."""
    line_count = round(MAX_DETOUR_M / ASIDE_SPACING_M)
    rows = np.arange(len(course.poses), dtype=np.float64)
    boxes = course.list_lines(rows, list_asides(line_count))
    is_free = ~occupancy.is_obstructed_in_view(boxes, gap)
    left = _find_asides(is_free[:, line_count:])
    right = _find_asides(is_free[:, line_count::-1])
    detour_m = np.zeros(len(rows))  # to the left
    obstructed_rows = np.flatnonzero(~is_free[:, line_count])
    # solids that are near each other are passed on the same side
    gaps = np.flatnonzero(np.diff(obstructed_rows) > 2 * EARLY_STEPS) + 1
    for group in np.split(obstructed_rows, gaps):
        if not len(group):
            continue
        stretch = slice(max(0, group[0] - EARLY_STEPS), group[-1] + EARLY_STEPS + 1)
        width_left = left[stretch].max()
        width_right = right[stretch].max()
        width = min(width_left, width_right)
        if not np.isfinite(width):
            return None
        detour_m[stretch] = (
            width + HOUSE_MARGIN_M if width_left <= width_right else -width - HOUSE_MARGIN_M
        )
    smoothed = smooth_rows(detour_m[:, None], DETOUR_SMOOTHING_STEPS)[:, 0]
    detour = replace(course, poses=face_along(course.poses, course.shift(rows, smoothed)))
    is_open = ~occupancy.is_obstructed_in_view(detour.list_lines(rows, list_asides(0)), gap)
    return detour if is_open.all() else None


def _find_asides(is_free: Bool[np.ndarray, "rows lines"]) -> Float64[np.ndarray, " rows"]:
    """Distance (m) from the course to the nearest free line on one side, infinite without one.

    is_free: mask of the lines at each row, the course first and then the lines farther off."""
    distances = ASIDE_SPACING_M * is_free.argmax(axis=1)
    return np.where(is_free.any(axis=1), distances, np.inf)
