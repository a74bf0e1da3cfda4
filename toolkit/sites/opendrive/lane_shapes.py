"""Middle lines of OpenDRIVE lanes of changing width or offset, for netconvert's network.

netconvert draws every lane of a section as wide as it is at its widest, and joins the places where
a lane offset begins by straight lines. If a lane opens next to the middle, the lanes outside it
would run along the kerb. When netconvert reads its network again, it would redraw the joints of
such roads, up to 60 m long, so that traffic drives a piece twice; they keep their outline
(eclipse-sumo/sumo#6184)."""

from collections.abc import Iterable
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.arrays import Float, Float64
from toolkit.sites.opendrive.carriageways import Carriageway
from toolkit.sites.opendrive.cubics import Cubics, read_number
from toolkit.sites.opendrive.lane_sections import LaneSection, SectionLane
from toolkit.sites.opendrive.map_roads import MapRoad, read_road
from toolkit.sites.opendrive.plain_map import PlainMap

MAX_DEVIATION_M = 0.1  # up to which a lane off its middle line in the map is left as it is
MAX_PLACE_GAP_M = 5.0  # between the lengths of a lane and of its piece of road, as on a ring
MAX_PLACE_GAP_SHARE = 0.2  # share of the lane's length, in addition
SHAPE_TOLERANCE_M = 0.01  # by which a simplified middle line may be off
MIN_DRIVEN_WIDTH_M = 1.8  # width from which a lane is driven on
SAMPLES_EVERY_M = 1.0  # between places along a line
_NARROW_USERS = {"authority", "emergency"}  # all that netconvert lets use narrow lanes


@dataclass(frozen=True, eq=False)
class _Line:
    """Reference line of a road, sampled: places `s` along it (m), and a line of their points."""

    road: MapRoad
    places: Float64[np.ndarray, " k"]
    line: shapely.LineString

    @classmethod
    def from_road(cls, road: MapRoad) -> "_Line":
        """Sample the reference line of a road."""
        places = np.linspace(0.0, road.length, int(road.length / SAMPLES_EVERY_M) + 2)
        return cls(road, places, shapely.LineString(road.at(places)[:, :2]))

    def find_places(self, points: Float[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
        """Places `s` along the reference line (m) nearest to points x, y of the map."""
        # m along the sampled line, which is a little shorter than the reference line
        sample_distances = _measure_distances(shapely.get_coordinates(self.line))
        point_distances = shapely.line_locate_point(self.line, shapely.points(points))
        return np.interp(point_distances, sample_distances, self.places)


def align_lanes(network: str, plain: PlainMap, window: shapely.Geometry) -> str:
    """Return a network whose lanes have the middle lines that the map describes.

    Only roads that reach `window` and whose lanes change their width or offset are touched.

    network: net.xml text of the whole map, in its coordinates; plain: roads from which netconvert
    made it; window: ground in the map's coordinates."""
    varying_roads = {
        road.name: road for road in plain.carriageways if _varies(road) and _may_reach(road, window)
    }
    if not varying_roads:
        return network
    root = ElementTree.fromstring(network)
    lines: dict[str, _Line] = {}  # reference lines by name of the road
    is_changed = False
    for edge in root.iter("edge"):
        # netconvert names edges ROAD#PIECE, with - for one direction
        name = edge.get("id", "").removeprefix("-").partition("#")[0]
        if edge.get("function") is None and name in varying_roads:
            road = varying_roads[name]
            if name not in lines:
                lines[name] = _Line.from_road(read_road(road.element))
            is_forward = edge.get("id", "").startswith("-")  # its traffic follows the road's s
            sign = 1 if is_forward == plain.lefthand else -1  # 1 for lanes on the left in the map
            is_changed |= _align_edge(edge, road, lines[name], sign)
    for junction in root.iter("junction"):
        name, _, piece_number = junction.get("id", "").partition("#")
        if name in varying_roads and piece_number:  # between two pieces of a road
            junction.set("customShape", "1")
    return ElementTree.tostring(root, encoding="unicode") + "\n" if is_changed else network


def _may_reach(road: Carriageway, window: shapely.Geometry) -> bool:
    """True if a piece of a road begins so near a window (map frame) that it may reach it."""
    xmin, ymin, xmax, ymax = window.bounds
    for piece in road.element.findall("planView/geometry"):
        x = read_number(piece, "x")
        y = read_number(piece, "y")
        reach = read_number(piece, "length")
        if xmin - reach <= x <= xmax + reach and ymin - reach <= y <= ymax + reach:
            return True
    return False


def _varies(road: Carriageway) -> bool:
    """True if the offset or the width of a lane changes along the road."""
    widths = [lane.width for section in road.sections for lane in section.lanes]
    return any(map(_is_bent, [road.offset, *widths]))


def _is_bent(function: Cubics) -> bool:
    """Return True if a function has a slope, or steps from one piece to the next."""
    values = function.rows[:, 0]  # at the starts of the pieces
    slopes = function.rows[:, 1:]  # and higher derivatives
    return bool(slopes.any()) or bool((values[1:] != values[:-1]).any())


def _align_edge(edge: ElementTree.Element, road: Carriageway, line: _Line, sign: int) -> bool:
    """Move the lanes of one edge, in place; return True if any was changed.

    line: reference line of the road; sign: 1 if the lanes are on the left in the map, with
    positive ids, -1 if to the right."""
    elements = edge.findall("lane")
    shapes = [_parse_points(element) for element in elements]
    ends = line.find_places(np.array([shapes[0][0, :2], shapes[0][-1, :2]]))
    section = _find_section(road.sections, float(ends.mean()))
    lanes = [] if section is None else section.side(sign)
    if section is None or len(lanes) != len(elements) or any(len(shape) < 2 for shape in shapes):
        return False
    is_changed = False
    # SUMO lists lanes from the kerb inwards, the section from the middle outwards; count: lanes
    # between this one and the middle
    for element, shape, count in zip(elements, shapes, range(len(lanes))[::-1], strict=True):
        first, last = line.find_places(shape[[0, -1], :2])
        drawn_line = shapely.LineString(shape[:, :2])
        if (
            abs(abs(last - first) - drawn_line.length)
            > MAX_PLACE_GAP_M + MAX_PLACE_GAP_SHARE * drawn_line.length
        ):
            continue
        s = np.linspace(first, last, int(abs(last - first) / SAMPLES_EVERY_M) + 2)
        within = np.clip(s, section.start, section.end) - section.start
        inner_t = road.offset.at(s) + sign * sum(_width(lane, within) for lane in lanes[:count])
        width = _width(lanes[count], within)
        middle = line.road.step_aside(s, inner_t + sign * width / 2)
        if (
            set(element.get("allow", "").split()) == _NARROW_USERS
            and width.min() < MIN_DRIVEN_WIDTH_M
        ):
            element.attrib.pop("allow")
            element.set("disallow", "all")
            is_changed = True
        exact_line = shapely.LineString(middle)
        if shapely.hausdorff_distance(drawn_line, exact_line) > MAX_DEVIATION_M:
            simple = shapely.get_coordinates(exact_line.simplify(SHAPE_TOLERANCE_M))
            element.set("shape", _format_points(simple, shape))
            element.set("customShape", "1")
            is_changed = True
    return is_changed


def _measure_distances(points: Float[np.ndarray, "k 2"]) -> Float64[np.ndarray, " k"]:
    """Distance (m) of each point of a line from the first one, along the line."""
    dx, dy = np.diff(points, axis=0).T
    return np.concatenate([[0.0], np.cumsum(np.hypot(dx, dy))])


def _width(lane: SectionLane, s: Float[np.ndarray, " k"]) -> Float64[np.ndarray, " k"]:
    # Width (m) of a lane at places `s` from its section's start; one below zero counts as zero.
    return np.maximum(lane.width.at(s), 0.0)


def _find_section(sections: Iterable[LaneSection], s: float) -> LaneSection | None:
    # Section at a place along the road (m), None beyond its ends.
    return next((section for section in sections if section.start <= s < section.end), None)


def _parse_points(element: ElementTree.Element) -> Float64[np.ndarray, "k _"]:
    # Points of a lane's shape: x, y and, in a network with heights, z.
    return np.array([point.split(",") for point in element.get("shape", "").split()], np.float64)


def _format_points(middle: Float[np.ndarray, "k 2"], shape: Float[np.ndarray, "n _"]) -> str:
    """Text of a SUMO shape for the points of a line, as high as the shape that it replaces.

    middle: x, y of the new line; shape: x, y and, in a network with heights, z of the old line.
    Heights are taken at the same share of the length."""
    points = middle
    if shape.shape[1] == 3:
        old_xy = shape[:, :2]
        old_line = shapely.LineString(old_xy)
        shares = shapely.line_locate_point(old_line, shapely.points(middle), normalized=True)
        old_distances = _measure_distances(old_xy)
        old_shares = old_distances / max(old_distances[-1], 1e-9)
        heights = np.interp(shares, old_shares, shape[:, 2])
        points = np.column_stack([middle, heights])
    return " ".join(map(_format_point, points))


def _format_point(point: Float[np.ndarray, " n"]) -> str:
    # Text of one point of a SUMO shape, on millimetres.
    return ",".join(f"{value:.3f}" for value in point)
