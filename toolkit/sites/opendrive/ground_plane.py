"""Plane through the roads of an OpenDRIVE map near a site."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import shapely

from toolkit.arrays import Float, Float64, Pose
from toolkit.geometry import LEVEL, Slope
from toolkit.sites.opendrive.cubics import read_cubics
from toolkit.sites.opendrive.lane_sections import LaneSection, read_sections
from toolkit.sites.opendrive.lane_surfaces import MAX_LANE_WIDTH_M, STATION_STEP_M, UNPAVED
from toolkit.sites.opendrive.map_roads import MapRoad

# standard deviation of road middles along a direction; with less, the plane has no slope in it
MIN_SPREAD_M = 3.0
MIN_TILTED_SPREAD_M = 1.0  # the same for tilted roads, whose edges count too


class GroundPlane(NamedTuple):
    """Plane through roads.

    Attributes:
        slope: rise over run along x and y of the site.
        deviation: greatest distance of a road from the plane (m).
        steepest: steepest slope of a road (rise over run)."""

    slope: Slope
    deviation: float
    steepest: float


def find_plane(
    roads: Sequence[MapRoad], window: shapely.Geometry, map_SE3_site: Pose
) -> GroundPlane:
    """Fit a plane to roads by least squares.

    It is fitted to the middle lines within `window` (map frame), and to the edges of tilted roads.
    It is level in a direction along which the roads do not spread enough.

    map_SE3_site: pose of the site in the map, in whose x and y the slope comes back."""
    # rows x, y, z (m, map frame) of middle lines and of edges
    middles = [np.zeros((0, 3))]
    edges = []
    steepest = 0.0
    min_spread = MIN_SPREAD_M  # m, that the rows need along a direction
    for road in roads:
        s, road_xy = road.stations(window, STATION_STEP_M)
        middles.append(np.column_stack([road_xy, road.elevation.at(s)]))
        steepest = max(steepest, float(abs(road.elevation.slope(s)).max(initial=0.0)))
        if len(s) and not road.lateral.is_flat:
            road_edges, gradient = _find_edges(road, s)
            edges.append(road_edges)
            steepest = max(steepest, gradient)
            min_spread = MIN_TILTED_SPREAD_M
    places = np.concatenate(middles + edges)
    if len(places) < 3:
        return GroundPlane(slope=LEVEL, deviation=0.0, steepest=steepest)
    map_xy = places[:, :2]
    z = places[:, 2]
    site_xy = (map_xy - map_SE3_site[:2, 3]) @ map_SE3_site[:2, :2]
    slope, deviation = _fit_slope(site_xy, z, min_spread)
    return GroundPlane(slope=slope, deviation=deviation, steepest=steepest)


def _fit_slope(
    xy: Float64[np.ndarray, "n 2"], z: Float64[np.ndarray, " n"], min_spread: float
) -> tuple[Slope, float]:
    """Fit the slope of points by least squares; return it and their greatest distance from it (m).

    The slope is rise over run along x and y. xy, z: places and heights (m); min_spread: standard
    deviation (m) that the points need along a direction, else the slope there is 0."""
    centred_xy = xy - xy.mean(axis=0)
    centred_z = z - z.mean()
    min_square_sum = (min_spread * np.sqrt(len(xy))) ** 2
    # columns of `axes` are the main directions of the points
    square_sums, axes = np.linalg.eigh(centred_xy.T @ centred_xy)
    wide_axes = axes[:, square_sums > min_square_sum]
    slope = np.zeros(2)
    if wide_axes.size:
        # slopes along the wide axes, turned back to x and y
        axis_slopes, *_ = np.linalg.lstsq(centred_xy @ wide_axes, centred_z, rcond=None)
        slope = wide_axes @ axis_slopes
    slope_x, slope_y = slope.tolist()
    return (slope_x, slope_y), float(abs(centred_z - centred_xy @ slope).max())


def _find_edges(
    road: MapRoad, s: Float[np.ndarray, " k"]
) -> tuple[Float64[np.ndarray, "n 3"], float]:
    """Places on both edges of a carriageway, and its steepest gradient there.

    s: places along the road (m). Rows are x, y, z (m, map frame). The gradient (rise over run) is
    along the road and across it together."""
    # distance from the reference line to the carriageway's middle (m), positive to the left
    offset = read_cubics(road.element.findall("lanes/laneOffset"))
    edges = [np.zeros((0, 3))]
    steepest = 0.0
    for section in read_sections(road.element, road.length):
        section_s = s[(s >= section.start) & (s <= section.end)]
        middle_t = offset.at(section_s)
        # left edge, right edge
        for sign in (1, -1):
            # t: m to the left of the reference line
            edge_t = _find_edge(section, sign, section_s, middle_t)
            height = road.lateral.at(section_s, edge_t)  # above the reference line
            elevation = road.elevation.at(section_s)
            edge_xy = road.step_aside(section_s, edge_t)
            edges.append(np.column_stack([edge_xy, elevation + height]))
            rise = height - road.lateral.at(section_s, middle_t)
            # at least 0.5 m: a narrow lane would make any rise steep
            slope_across = rise / np.maximum(np.abs(edge_t - middle_t), 0.5)
            slope_along = road.elevation.slope(section_s)
            gradient = np.hypot(slope_across, slope_along)
            steepest = max(steepest, float(gradient.max(initial=0.0)))
    return np.concatenate(edges), steepest


def _find_edge(
    section: LaneSection, sign: int, s: Float[np.ndarray, " k"], middle_t: Float64[np.ndarray, " k"]
) -> Float64[np.ndarray, " k"]:
    """Edge of the carriageway on one side of a road at `s`, as t: m to the left of the line.

    It ends at the first lane that is no carriageway, or is marked level. sign: 1 for the left side,
    -1 for the right; middle_t: middle of the lanes at `s` (m along t)."""
    edge_t = middle_t
    for lane in section.side(sign):
        if lane.kind in UNPAVED or lane.element.get("level") in ("true", "1"):
            break
        width = np.clip(lane.width.at(s - section.start), 0.0, MAX_LANE_WIDTH_M)
        edge_t = edge_t + sign * width
    return edge_t
