"""Side of the road that traffic keeps to at a place on earth.

`left_hand.toml` has the outlines of the countries that keep left: within 3 km at land borders, wide
of the coasts at sea."""

from functools import cache
from typing import NamedTuple

import numpy as np
import shapely

from toolkit.runtime.text_values import read_own_table

NEAR_BORDER_DEG = 0.05  # some 5 km, within which the outlines may be wrong


class DrivingSide(NamedTuple):
    """Side of the road that traffic keeps to at a place on earth.

    is_left: traffic keeps left; is_near_border: a border to the other side is nearer than
    `NEAR_BORDER_DEG`."""

    is_left: bool
    is_near_border: bool


def find_driving_side(longitude: float, latitude: float) -> DrivingSide:
    """Find the side of the road that traffic keeps to at a place (degrees, WGS84)."""
    spot = shapely.Point((longitude + 180.0) % 360.0 - 180.0, latitude)
    is_left = bool(_left_hand_ground().intersects(spot))
    is_near_border = bool(_left_hand_borders().distance(spot) < NEAR_BORDER_DEG)
    return DrivingSide(is_left=is_left, is_near_border=is_near_border)


@cache
def _left_hand_borders() -> shapely.Geometry:
    """Borders of the countries that keep left, in degrees of longitude and latitude, made once.

    The meridian of 180 degrees, at which the outlines are cut, is no border."""
    # narrow strips about the meridian at both ends of the map
    west = shapely.box(-180.0 - 1e-6, -90.0, -180.0 + 1e-6, 90.0)
    east = shapely.box(180.0 - 1e-6, -90.0, 180.0 + 1e-6, 90.0)
    return _left_hand_ground().boundary.difference(shapely.union_all([west, east]))


@cache
def _left_hand_ground() -> shapely.Geometry:
    """Ground of all countries that keep left, in degrees of longitude and latitude, read once."""
    table = read_own_table(__file__, "left_hand.toml")
    outlines = _unite_rings(table["outlines"])
    holes = _unite_rings(table["holes"])
    ground = outlines.difference(holes)
    shapely.prepare(ground)  # makes later tests against it faster
    return ground


def _unite_rings(rows: list[list[float]]) -> shapely.Geometry:
    """Union of the ground within rings, each a list of longitude, latitude, longitude, ..."""
    rings = (shapely.Polygon(np.reshape(row, (-1, 2))) for row in rows)
    return shapely.union_all([shapely.make_valid(ring) for ring in rings])
