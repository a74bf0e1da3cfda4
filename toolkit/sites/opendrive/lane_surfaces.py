"""Surfaces of OpenDRIVE lanes."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from toolkit.arrays import Float64
from toolkit.sites.opendrive.cubics import read_cubics
from toolkit.sites.opendrive.lane_sections import LaneSection, read_sections
from toolkit.sites.opendrive.map_roads import MapRoad
from toolkit.sites.opendrive.reference_line import step_aside

MAX_USUAL_WIDTH_M = 50.0  # a wider lane is noted
MAX_LANE_WIDTH_M = 1000.0  # to which wider lanes are cut
MIN_LANE_WIDTH_M = 0.05  # narrower lanes are left out
STATION_STEP_M = 1.0  # between the corners of a lane
FOOTWAY = ("sidewalk", "walking")  # types of lanes
# types of lanes that are no carriageway, as all others are
UNPAVED = ("none", "border", "curb", "median", "rail", "tram", "sidewalk", "walking")


@dataclass(frozen=True, eq=False)
class MapLane:
    """One lane of one section, in the map frame.

    Attributes:
        kind: its type in the map's words.
        outline: its ground.
        middle: points x, y (m) of its middle line along s.
        width: mean width (m)."""

    kind: str
    outline: shapely.Geometry
    middle: Float64[np.ndarray, "k 2"]
    width: float


def outline_lanes(road: MapRoad) -> Iterator[MapLane]:
    """Yield the lanes of a road that are wider than `MIN_LANE_WIDTH_M` anywhere."""
    offset = read_cubics(road.element.findall("lanes/laneOffset"))
    for section in read_sections(road.element, road.length):
        steps = int((section.end - section.start) / STATION_STEP_M) + 2
        s = np.linspace(section.start, section.end, steps)
        places = road.at(s)  # x, y, heading of the reference line at each s
        # m to the left of that line: where left and right lanes meet
        middle_t = offset.at(s)
        for sign in (1, -1):
            yield from _outline_side(section, sign, s, places, middle_t)


def _outline_side(
    section: LaneSection,
    sign: int,
    s: Float64[np.ndarray, " k"],
    places: Float64[np.ndarray, "k 3"],
    middle_t: Float64[np.ndarray, " k"],
) -> Iterator[MapLane]:
    """Yield the lanes of one side of a section, from the middle outwards.

    sign: 1 for the left side, -1 for the right; s: places along the road (m); places: x, y (m) and
    direction (rad) of the reference line at `s`; middle_t: m from there to the middle of the lanes,
    positive to the left."""
    inner_t = middle_t
    for lane in section.side(sign):
        width = np.clip(lane.width.at(s - section.start), 0.0, MAX_LANE_WIDTH_M)
        outer_t = inner_t + sign * width
        if width.max() > MIN_LANE_WIDTH_M:
            inner_edge = step_aside(places, inner_t)
            outer_edge = step_aside(places, outer_t)
            corners = np.concatenate([inner_edge, outer_edge[::-1]])  # round the lane
            yield MapLane(
                kind=lane.kind,
                outline=shapely.make_valid(shapely.Polygon(corners)),
                middle=step_aside(places, (inner_t + outer_t) / 2),
                width=float(width.mean()),
            )
        inner_t = outer_t


def describe_widths(lanes: Sequence[MapLane]) -> list[str]:
    """Return a note that counts lanes wider than `MAX_USUAL_WIDTH_M`, none without such.

    They are driven along their middle all the same."""
    wide_count = sum(lane.width > MAX_USUAL_WIDTH_M for lane in lanes)
    if not wide_count:
        return []
    usual_width = f"{MAX_USUAL_WIDTH_M:g} m"
    return [f"lanes wider than {usual_width}, whose traffic keeps to their middle: {wide_count}"]
