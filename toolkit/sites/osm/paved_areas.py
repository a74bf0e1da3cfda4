"""Footways, squares and parking spaces of an OpenStreetMap extract."""

import numpy as np
import shapely

from toolkit.sites import network as nets
from toolkit.sites.osm.extract import Extract, Way
from toolkit.sites.osm.tag_values import is_bridge, is_underground, metres
from toolkit.sites.osm.way_kinds import WALKS
from toolkit.sites.surroundings.parking_bays import Bay

MAX_BAY_LENGTH_M = 8.0
MIN_BAY_WIDTH_M = 1.7

_SQUARES = {"pedestrian", "footway"}


def find_walks(extract: Extract, window: shapely.Geometry) -> list[shapely.Polygon]:
    """List the ground of footways and squares within `window` that the map has apart from roads."""
    shapes: list[shapely.Geometry] = [
        shape
        for shape, tags in extract.areas
        if {tags.get("highway"), tags.get("area:highway")} & _SQUARES
    ]
    for way in extract.ways:
        if _is_walk(way):
            width = np.clip(metres(way.tags.get("width")) or 2.0, 1.0, 10.0)  # m, 2 without a tag
            line = shapely.LineString(way.line)
            shapes.append(line.buffer(width / 2, cap_style="flat", quad_segs=2))
    polygons: list[shapely.Polygon] = []
    for shape in shapes:
        if shape.intersects(window):
            polygons += nets.list_polygons(shape.intersection(window))
    return polygons


def _is_walk(way: Way) -> bool:
    """True for the line of a footway on the ground."""
    is_area = way.is_closed and way.tags.get("area") == "yes"
    return (
        way.tags.get("highway") in WALKS
        and not is_area
        and not is_underground(way.tags)
        and not is_bridge(way.tags)
    )


def find_parking_spaces(
    extract: Extract, window: shapely.Geometry, road: shapely.Geometry
) -> list[Bay]:
    """List the parking spaces that the map outlines, within `window` and off `road`.

    Each is x, y (m) of its middle and yaw (rad) of its longer side; spaces too long or too narrow
    for a car are left out."""
    spaces = []
    for shape, tags in extract.areas:
        is_space = tags.get("amenity") == "parking_space"
        if not is_space or not window.contains(shape) or road.intersects(shape):
            continue
        # corners of the rectangle around it; the fifth is the first again
        corners = shapely.get_coordinates(shapely.minimum_rotated_rectangle(shape))
        sides = np.diff(corners[:3], axis=0)  # two neighbouring ones, x and y (m)
        lengths = np.hypot(*sides.T)
        if lengths.max() < MAX_BAY_LENGTH_M and lengths.min() > MIN_BAY_WIDTH_M:
            long_x, long_y = sides[lengths.argmax()]
            x, y = corners[:4].mean(axis=0).tolist()
            yaw = float(np.arctan2(long_y, long_x))
            spaces.append((round(x, 3), round(y, 3), round(yaw, 4)))
    return spaces
