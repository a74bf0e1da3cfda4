"""Arms of a junction: where roads leave the detection area, named by their compass direction."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import shapely

from toolkit.arrays import Float64
from toolkit.sites.gate_names import name_gates
from toolkit.sites.georeference import bearing_deg
from toolkit.sites.site import Site

SAME_ARM_M = 12.0  # between pieces of roads at the border that are one arm
MAX_APPROACH_M = 15.0  # from the border to the first place of a road user that came in
MAX_APPROACH_S = 3.0  # from the border till then
MAX_VERGE_M = 10.0  # along the border from an arm's roads to the outside of its pavements
# farther off, share of a speed along the border that shows to which side a road user turns; more is
# a way along the border, which may lead back into the area
TURNING_SHARES = (0.17, 0.87)  # angles to the border from 80° to 30°


class Arm(NamedTuple):
    """Road that leaves the area.

    Attributes:
        name: compass direction in which it is from the middle of the area.
        mouth: ground (m) of its roads on the border.
        point: x, y (m) of its middle on the border.
        direction: unit vector out of the area along x and y."""

    name: str
    mouth: shapely.Geometry
    point: Float64[np.ndarray, "2"]
    direction: Float64[np.ndarray, "2"]


def find_arms(site: Site) -> list[Arm]:
    """Arms of a site, clockwise from north; without roads at its border, one for each side."""
    xmin, ymin, xmax, ymax = site.area.tolist()
    middle = np.array([xmin + xmax, ymin + ymax]) / 2
    mouths = _find_mouths(site)
    points = [shapely.get_coordinates(shapely.centroid(mouth))[0] for mouth in mouths]
    if not mouths:
        corners = [(xmin, ymax), (xmax, ymax), (xmax, ymin), (xmin, ymin)]
        mouths = [shapely.LineString(side) for side in pairwise([*corners, corners[0]])]
        points = [
            np.array([middle[0], ymax]),
            np.array([xmax, middle[1]]),
            np.array([middle[0], ymin]),
            np.array([xmin, middle[1]]),
        ]
    offsets = [point - middle for point in points]
    bearings = [bearing_deg(site, float(np.arctan2(dy, dx))) for dx, dy in offsets]  # from north
    names = name_gates(bearings, [float(np.hypot(*offset)) for offset in offsets])
    arms = []
    for row in np.argsort(bearings).tolist():
        direction = offsets[row] / np.hypot(*offsets[row])
        arms.append(Arm(names[row], mouths[row], points[row], direction))
    return arms


def _find_mouths(site: Site) -> list[shapely.Geometry]:
    """Ground of a site's roads on the border of its area, arm for arm; empty without roads."""
    if not site.lanes:
        return []
    roads = shapely.union_all([shapely.Polygon(lane) for lane in site.lanes])
    # a thin strip along the border, since the roads end there
    strip = shapely.buffer(shapely.box(*site.area).exterior, 0.05)
    touched = shapely.intersection(strip, roads)
    pieces = shapely.get_parts(shapely.buffer(touched, SAME_ARM_M / 2))
    arms = shapely.get_parts(shapely.union_all(pieces))
    return [shapely.intersection(touched, arm) for arm in arms]


def find_crossing(
    point: Float64[np.ndarray, "2"],
    velocity: Float64[np.ndarray, "2"],
    area: Float64[np.ndarray, "4"],
) -> Float64[np.ndarray, "2"] | None:
    """Place at which a road user crosses the border of an area soon; None if it does not.

    Soon is within `MAX_APPROACH_M` and `MAX_APPROACH_S`, straight on.

    Args:
        point: x, y (m) of the road user, inside.
        velocity: along x and y (m/s); reversed, to find where a road user came in.
        area: xmin, ymin, xmax, ymax (m)."""
    seconds = measure_border_way(point, velocity, area)
    speed = float(np.hypot(*velocity))
    if seconds > MAX_APPROACH_S or seconds * speed > MAX_APPROACH_M:
        return None
    return point + seconds * velocity


def measure_border_way(
    point: Float64[np.ndarray, "2"], step: Float64[np.ndarray, "2"], area: Float64[np.ndarray, "4"]
) -> float:
    """Number of steps from a point inside an area to its border, infinite for a step of 0.

    Args:
        point: x, y (m).
        step: length of a step along x and y (m), or velocity (m/s) for an answer in seconds.
        area: xmin, ymin, xmax, ymax (m)."""
    borders = np.where(step > 0, area[2:], area[:2])
    steps = np.full(2, np.inf)
    np.divide(borders - point, step, out=steps, where=step != 0)
    return max(0.0, float(steps.min()))


def find_arm(
    point: Float64[np.ndarray, "2"],
    velocity: Float64[np.ndarray, "2"],
    arms: Sequence[Arm],
    area: Float64[np.ndarray, "4"],
) -> str | None:
    """Name of the arm to which a road user leaves the area; None if its way does not show it.

    The arm whose roads are nearest, if they are at most `MAX_VERGE_M` away. Farther off it is the
    next arm along the border, on the side to which the road user turns.

    Args:
        point: x, y (m) of the place on the border.
        velocity: along x and y (m/s), out of the area.
        arms: Arms of the junction, at least one.
        area: xmin, ymin, xmax, ymax (m)."""
    distances = shapely.distance([arm.mouth for arm in arms], shapely.Point(point))
    row = int(np.argmin(distances))
    if distances[row] <= MAX_VERGE_M:
        return arms[row].name
    # the side of the area at this place is parallel to x (0) or y (1)
    gaps = np.abs(area.reshape(2, 2) - point).min(axis=0)
    axis = 1 - int(np.argmin(gaps))
    share = abs(velocity[axis]) / max(float(np.hypot(*velocity)), 1e-9)
    low, high = TURNING_SHARES
    if not low <= share <= high:
        return None
    border = shapely.box(*area).exterior  # anticlockwise
    place = shapely.line_locate_point(border, shapely.Point(point))
    places = shapely.line_locate_point(border, [shapely.Point(arm.point) for arm in arms])
    # the sense of rotation about the middle, in which the road user goes along the border
    offset = point - (area[:2] + area[2:]) / 2
    turn = np.sign(offset[0] * velocity[1] if axis else -offset[1] * velocity[0])
    return arms[int(np.argmin(turn * (places - place) % border.length))].name
