"""Streets of a site as maps show them: a name along each, and an arrow on each lane in the
direction of its traffic."""

from collections import defaultdict
from dataclasses import dataclass
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.arrays import Float64
from toolkit.sites.network import list_users, parse_shape
from toolkit.sites.site import Site

MIN_ARROW_LANE_M = 8.0  # length of a lane within the map from which it gets an arrow
MIN_NAMED_M = 10.0  # length of a street's line within the map from which it gets its name
ARROW_SHARE = 0.5  # share of the lane's length at which its arrow is


@dataclass(frozen=True)
class StreetName:
    """Name of a street and its place on a map.

    x, y: middle of the text (m, site frame); angle: direction of the text (rad, counter-clockwise
    from +x), within a quarter turn so that it is never upside down."""

    name: str
    x: float
    y: float
    angle: float


class _LinePlace(NamedTuple):
    """Point x, y (m) on a line, and the line's direction there (rad from +x)."""

    x: float
    y: float
    angle: float


def find_street_names(
    site: Site, low: Float64[np.ndarray, "2"], high: Float64[np.ndarray, "2"]
) -> list[StreetName]:
    """Find places for the names of streets on a map, in order of name.

    low, high: corners (xmin, ymin) and (xmax, ymax) of the map (m, site frame). Each name is there
    once, in the middle of its longest line; names with less than `MIN_NAMED_M` of line are left
    out."""
    window = shapely.box(*low, *high)
    lines_by_name = defaultdict[str, list[shapely.Geometry]](list)
    for edge in _list_streets(site):
        lanes = edge.findall("lane") if edge.get("name") else []
        driven_lanes = [lane for lane in lanes if "passenger" in list_users(lane)]
        for lane in driven_lanes or lanes:  # a street without cars is named along all its lanes
            points = parse_shape(lane)
            if len(points) > 1:
                name = edge.get("name", "").strip()
                lines_by_name[name].append(shapely.LineString(points))
    street_names = []
    for name, lines in sorted(lines_by_name.items()):
        lines_on_map = shapely.intersection(shapely.union_all(lines), window)
        longest_line = max(shapely.get_parts(lines_on_map), key=shapely.length, default=None)
        if name and longest_line is not None and longest_line.length >= MIN_NAMED_M:
            place = _find_middle(longest_line)
            # turned by a half turn if upside down
            upright_angle = (place.angle + np.pi / 2) % np.pi - np.pi / 2
            street_names.append(StreetName(name, x=place.x, y=place.y, angle=upright_angle))
    return street_names


def find_lane_arrows(
    site: Site, low: Float64[np.ndarray, "2"], high: Float64[np.ndarray, "2"]
) -> Float64[np.ndarray, "n 3"]:
    """Find places of arrows on the lanes of motor vehicles on a map.

    low, high: corners (xmin, ymin) and (xmax, ymax) of the map (m, site frame). Returns a row for
    each lane that has at least `MIN_ARROW_LANE_M` on it: x, y (m) and direction of traffic (rad
    from +x)."""
    window = shapely.box(*low, *high)
    rows = []
    for edge in _list_streets(site):
        for lane in edge.findall("lane"):
            points = parse_shape(lane)
            if len(points) < 2 or "passenger" not in list_users(lane):
                continue
            parts = shapely.get_parts(shapely.intersection(shapely.LineString(points), window))
            longest_part = max(parts, key=shapely.length, default=None)
            if longest_part is not None and longest_part.length >= MIN_ARROW_LANE_M:
                rows.append(_find_middle(longest_part))
    return np.array(rows, np.float64).reshape(-1, 3)


def _list_streets(site: Site) -> list[ElementTree.Element]:
    """Edges of the site's network that are streets: edges within junctions have a function."""
    edges = ElementTree.fromstring(site.network or "<net/>").findall("edge")
    return [edge for edge in edges if not edge.get("function")]


def _find_middle(line: shapely.Geometry) -> _LinePlace:
    """Find the place at the share `ARROW_SHARE` of a line, and the direction of the line there.

    The angle is in rad from +x."""
    distance = ARROW_SHARE * line.length
    # the direction is measured between the points 1 m before and after it
    before = line.interpolate(max(distance - 1.0, 0.0))
    after = line.interpolate(min(distance + 1.0, line.length))
    place = line.interpolate(distance)
    angle = float(np.arctan2(after.y - before.y, after.x - before.x))
    return _LinePlace(x=place.x, y=place.y, angle=angle)
