"""Arms of a junction: where roads leave the detection area, named by their compass direction."""

from collections.abc import Sequence
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


class Arm(NamedTuple):
    """Road that leaves the area.

    Attributes:
        name: compass direction in which it is from the middle of the area.
        point: x, y (m) of its middle on the border.
        direction: unit vector out of the area along x and y."""

    name: str
    point: Float64[np.ndarray, "2"]
    direction: Float64[np.ndarray, "2"]


def find_arms(site: Site) -> list[Arm]:
    """Arms of a site, clockwise from north; without roads at its border, one for each side."""
    border = shapely.box(*site.area).exterior
    pieces: list[shapely.Geometry] = []
    if site.lanes:
        roads = shapely.union_all([shapely.Polygon(lane) for lane in site.lanes])
        # a thin strip along the border, since the roads end there
        touched = shapely.intersection(shapely.buffer(border, 0.05), roads)
        pieces = list(shapely.get_parts(shapely.buffer(touched, SAME_ARM_M / 2)))
        merged = shapely.union_all(pieces)
        points = [
            shapely.get_coordinates(shapely.centroid(shapely.intersection(touched, arm)))[0]
            for arm in shapely.get_parts(merged)
        ]
    xmin, ymin, xmax, ymax = site.area.tolist()
    middle = np.array([xmin + xmax, ymin + ymax]) / 2
    if not pieces:
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
        arms.append(Arm(names[row], points[row], direction))
    return arms


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
    speed = float(np.hypot(*velocity))
    if speed <= 0:
        return None
    borders = np.where(velocity > 0, area[2:], area[:2])
    with np.errstate(divide="ignore", invalid="ignore"):
        seconds = (borders - point) / velocity
    first_s = float(np.nanmin(np.where(velocity == 0, np.inf, seconds)))
    if first_s > MAX_APPROACH_S or first_s * speed > MAX_APPROACH_M:
        return None
    return point + max(0.0, first_s) * velocity


def nearest_arm(point: Float64[np.ndarray, "2"], arms: Sequence[Arm]) -> str:
    """Name of the arm that is nearest to a place on the border. point: x, y (m)."""
    distances = [float(np.hypot(*(arm.point - point))) for arm in arms]
    return arms[int(np.argmin(distances))].name
