"""Roads of an OpenDRIVE map: reference line, elevation and heights across.

A road is measured along its reference line, in plan view and elevation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
import shapely
import shapely.affinity

from toolkit.arrays import Float, Float64
from toolkit.sites.opendrive.cubics import Cubics, read_cubics, read_number
from toolkit.sites.opendrive.reference_line import Piece, step_aside

MAX_PIECE_M = 1e5  # a longer piece of a reference line is damage
MAX_CURVE_GAP_M = 50.0  # a curve may be this much longer than its geometry gives
MIN_TILT_RAD = 1e-4  # less tilt across the road is ignored: 1 mm over 10 m
SEARCH_MARGIN_M = 30.0  # around a window, for roads
SEARCH_STEP_M = 5.0  # between places along a road

_ADDITIONAL = ("userData", "include", "dataQuality")  # elements that any element may hold
_SIDES = (("left", 1), ("right", -1))
_SHAPES = ("line", "arc", "spiral", "poly3", "paramPoly3")


@dataclass(frozen=True, eq=False)
class LateralProfile:
    """Heights across a road (OpenDRIVE 1.8, 10.6 and 10.7; 1.4, 5.3.6).

    Attributes:
        superelevation: rad along s, about the reference line; positive if the left side is higher.
        crossfall: rad along s by side, 1 left and -1 right; positive if the road falls outwards.
        shapes: places along s (m), in order, and the height (m) along t there."""

    superelevation: Cubics
    crossfall: Mapping[int, Cubics]
    shapes: tuple[tuple[float, Cubics], ...]

    @property
    def is_flat(self) -> bool:
        """True if the road is as high on its sides as in the middle."""
        tilts = [self.superelevation, *self.crossfall.values()]
        tilts += [shape for _, shape in self.shapes]
        return not any(np.abs(tilt.rows).max(initial=0.0) > MIN_TILT_RAD for tilt in tilts)

    def at(
        self, s: Float[np.ndarray, " k"], t: Float[np.ndarray, " k"]
    ) -> Float64[np.ndarray, " k"]:
        """Height (m) above the reference line at places on the road.

        s: m along the road; t: m to the left of its reference line."""
        heights = t * np.sin(self.superelevation.at(s))
        # angles (rad) by which the ground falls away from the line; 1: left side, -1: right side
        for sign, crossfall in self.crossfall.items():
            is_on_side = t * sign > 0
            heights -= np.where(is_on_side, np.abs(t) * np.sin(crossfall.at(s)), 0.0)
        if self.shapes:
            stations = [station for station, _ in self.shapes]  # s of each shape
            # row i: heights of shape i at each t
            rows = np.array([shape.at(t) for _, shape in self.shapes])
            # between two shapes, heights at the same t are interpolated along s
            heights += np.array([np.interp(s[k], stations, rows[:, k]) for k in range(len(s))])
        return heights


@dataclass(frozen=True, eq=False)
class MapRoad:
    """One <road> of the map.

    Attributes:
        element: the <road>.
        pieces: pieces of its reference line, in order of s.
        length: length of the reference line (m), at which s ends.
        elevation: height of the reference line (m) along s.
        lateral: height across the road, above the reference line."""

    element: ElementTree.Element
    pieces: tuple[Piece, ...]
    length: float
    elevation: Cubics
    lateral: LateralProfile

    def at(self, s: Float[np.ndarray, " k"]) -> Float64[np.ndarray, "k 3"]:
        """Rows x, y (m, map frame), direction (rad from +x) of the reference line at `s` (m).

        Beyond its ends the first and last piece count."""
        starts = [piece.start for piece in self.pieces]
        # index of the piece to which each s belongs
        indices = np.clip(np.searchsorted(starts, s, side="right") - 1, 0, None)
        places = np.zeros((len(s), 3))
        for index in np.unique(indices):
            piece = self.pieces[index]
            is_on_piece = indices == index
            places[is_on_piece] = piece.at(s[is_on_piece] - piece.start)
        return places

    def step_aside(
        self, s: Float[np.ndarray, " k"], t: Float[np.ndarray, " k"]
    ) -> Float64[np.ndarray, "k 2"]:
        """Places x, y (map frame) `t` m to the left of the reference line at `s` (m)."""
        return step_aside(self.at(s), t)

    def may_reach(self, window: shapely.Geometry) -> bool:
        """True if a piece of the reference line begins so near a window that it may reach it."""
        xmin, ymin, xmax, ymax = window.bounds
        for piece in self.pieces:
            reach = piece.length + MAX_CURVE_GAP_M
            is_near_x = xmin - reach <= piece.x <= xmax + reach
            is_near_y = ymin - reach <= piece.y <= ymax + reach
            if is_near_x and is_near_y:
                return True
        return False

    def stations(
        self, window: shapely.Geometry, spacing: float
    ) -> tuple[np.ndarray, Float64[np.ndarray, "k 2"]]:
        """Places along the reference line that are within `window`: their s (m), and x, y (m).

        They are `spacing` m apart or less."""
        s = np.linspace(0.0, self.length, int(self.length / spacing) + 2)
        xy = self.at(s)[:, :2]
        is_inside = shapely.intersects_xy(window, xy)
        return s[is_inside], xy[is_inside]


def read_road(element: ElementTree.Element) -> MapRoad:
    """Read the reference line and heights of a <road>. Raises ValueError for a damaged one."""
    pieces = [_read_piece(geometry) for geometry in element.findall("planView/geometry")]
    if not pieces:
        raise ValueError(f"road {element.get('id')!r} has no <geometry>: export the map again")
    pieces.sort(key=lambda piece: piece.start)
    length = pieces[-1].start + pieces[-1].length
    elevation = read_cubics(element.findall("elevationProfile/elevation"))
    return MapRoad(
        element=element,
        pieces=tuple(pieces),
        length=length,
        elevation=elevation,
        lateral=_read_lateral(element),
    )


def _read_piece(geometry: ElementTree.Element) -> Piece:
    """Read the piece of a reference line that a <geometry> describes.

    A <geometry> without a shape is a line. Raises ValueError for an unknown shape or bad length."""
    start = read_number(geometry, "s")
    x = read_number(geometry, "x")
    y = read_number(geometry, "y")
    heading = read_number(geometry, "hdg")
    length = read_number(geometry, "length")
    shapes = [child for child in geometry if child.tag not in _ADDITIONAL]
    shape = shapes[0] if shapes else ElementTree.Element("line")
    if shape.tag not in _SHAPES:
        raise ValueError(
            f"<geometry> holds <{shape.tag}>, not one of {', '.join(_SHAPES)}: export the map again"
        )
    if not 0 <= length <= MAX_PIECE_M:
        raise ValueError(
            f"<geometry> needs a length of 0 to {MAX_PIECE_M:g} m, got {length:g}: export the map "
            "again"
        )
    return Piece(start=start, x=x, y=y, heading=heading, length=length, shape=shape)


def _read_lateral(road: ElementTree.Element) -> LateralProfile:
    """Read the heights across a <road>: superelevation, crossfall of both sides, and shapes."""
    crossfalls: dict[int, Cubics] = {}  # by side: 1 left, -1 right
    for side, sign in _SIDES:
        elements = road.findall("lateralProfile/crossfall")
        side_elements = [row for row in elements if row.get("side", "both") in (side, "both")]
        crossfalls[sign] = read_cubics(side_elements)
    # elements of the shape at each s, each for a range of t
    shape_elements: dict[float, list[ElementTree.Element]] = {}
    for element in road.findall("lateralProfile/shape"):
        shape_elements.setdefault(read_number(element, "s"), []).append(element)
    shapes = [(s, read_cubics(shape_elements[s], "t")) for s in sorted(shape_elements)]
    return LateralProfile(
        superelevation=read_cubics(road.findall("lateralProfile/superelevation")),
        crossfall=crossfalls,
        shapes=tuple(shapes),
    )


def find_near_roads(
    root: ElementTree.Element, window: shapely.Geometry, level: float, storey: float
) -> tuple[list[MapRoad], int]:
    """Find the roads in and near `window` at a height; return them and the number of the others.

    The others are in the window too, but on another storey. root: the map; window: in its frame;
    level: the height (m); storey: greatest distance of a road from that height (m)."""
    near_roads = []
    other_count = 0
    surroundings = window.buffer(SEARCH_MARGIN_M)
    for road in map(read_road, root.iter("road")):
        if not road.may_reach(surroundings):  # a quick test, before the places are computed
            continue
        near_stations, _ = road.stations(surroundings, SEARCH_STEP_M)
        if not len(near_stations):
            continue
        s = np.linspace(0.0, road.length, int(road.length / SEARCH_STEP_M) + 2)
        xy = road.at(s)[:, :2]
        line = shapely.LineString(np.column_stack([xy, road.elevation.at(s)]))
        if is_on_level([line], surroundings, level, storey):
            near_roads.append(road)
        else:
            other_count += 1
    return near_roads, other_count


def is_on_level(
    lines: Sequence[shapely.LineString], window: shapely.Geometry, level: float, storey: float
) -> bool:
    """True if lines (x, y, z) come near to a height in `window`.

    Within the inner half of the window, their mean height must be near too. level: the height (m);
    storey: greatest distance from it that is near (m)."""
    heights = _list_heights(lines, window)
    if not len(heights) or np.abs(heights - level).min() > storey:
        return False
    inner_window = shapely.affinity.scale(window, 0.5, 0.5, origin="centroid")
    inner_heights = _list_heights(lines, inner_window)
    return not len(inner_heights) or bool(np.abs(inner_heights.mean() - level) <= storey)


def _list_heights(
    lines: Sequence[shapely.LineString], window: shapely.Geometry
) -> Float64[np.ndarray, " n"]:
    """Heights (m) of the corners of lines within a window, and of the lines at its edge."""
    inside_lines = shapely.intersection(lines, window)
    return shapely.get_coordinates(inside_lines, include_z=True)[:, 2]
