"""Legs of an imported site: the streets along which its surroundings are drawn."""

from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.arrays import Float64
from toolkit.sites import network as nets

SITE_RADIUS_M = 100.0  # distance from the site's origin up to which streets count
LEG_EXTENSION_M = 130.0  # beyond the end of an edge, since houses are drawn along 90 m
MIN_LEG_M = 10.0  # length of a street near the site that makes a leg


class Legs(NamedTuple):
    """Streets near a site, along which houses are drawn.

    Attributes:
        paths: lines of points x, y (m, site frame), one for each direction of a street, along the
            lane nearest to the middle of the street.
        half_widths: width (m) of the street to the left and right of each path."""

    paths: list[Float64[np.ndarray, "_ 2"]]
    half_widths: list[tuple[float, float]]


def find_legs(network: str) -> Legs:
    """Find the streets of a network that are near the site and open to cars.

    network: net.xml text in the site's frame. Each path runs with traffic and is extended beyond
    its end; both sides are as wide as the direction's lanes from the path outwards."""
    lanes_by_edge: dict[ElementTree.Element, list[ElementTree.Element]] = {}
    for edge, lane in nets.list_lanes(network):
        lanes_by_edge.setdefault(edge, []).append(lane)
    legs = Legs(paths=[], half_widths=[])
    surroundings = shapely.Point(0, 0).buffer(SITE_RADIUS_M)
    for lanes in lanes_by_edge.values():
        if not any("passenger" in nets.list_users(lane) for lane in lanes):
            continue
        inner_lane = lanes[-1]  # lanes are listed from the kerb inwards
        # from the middle of the inner lane to the outer edge (m)
        width = sum(map(nets.lane_width, lanes)) - nets.lane_width(inner_lane) / 2
        line = shapely.LineString(nets.parse_shape(inner_lane)).intersection(surroundings)
        for piece in shapely.get_parts(line):
            if piece.geom_type == "LineString" and piece.length > MIN_LEG_M:
                legs.paths.append(_extend_path(shapely.get_coordinates(piece)))
                legs.half_widths.append((round(width, 3), round(width, 3)))
    return legs


def _extend_path(path: Float64[np.ndarray, "k 2"]) -> Float64[np.ndarray, "_ 2"]:
    """Return a path that goes straight on for `LEG_EXTENSION_M` beyond its end."""
    step = path[-1] - path[-2]
    ahead = step / np.hypot(*step)
    return np.vstack([path, path[-1] + LEG_EXTENSION_M * ahead])
