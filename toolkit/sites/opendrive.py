"""OpenDRIVE 1.8 maps about a place: reference lines, surfaces of lanes, objects and signals.

A road is measured along its reference line, in plan view and elevation (chapters 7, 8). An object's
place is s, t on its road, turned by hdg against it; its shape is an outline, a radius or a length
and width (chapters 11, 12). Flat objects (crosswalks, markings) are no solids. Errors of damaged
numbers do not name the file: their caller does."""

import re
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import shapely
import shapely.affinity

from toolkit.arrays import Float, Float64, Pose
from toolkit.geometry import LEVEL, Slope, invert, plane_rotation, pose, transform
from toolkit.sites import furniture as f
from toolkit.sites.cubics import Cubics, cubics, number
from toolkit.sites.georeference import project_to_map
from toolkit.sites.lane_sections import read_sections
from toolkit.sites.network import list_polygons, unite
from toolkit.sites.site import Solid
from toolkit.sites.surroundings import Bay

MAX_PIECE_M = 1e5  # of one piece of a road
MAX_TURN_RAD = 2 * np.pi
MAX_USUAL_WIDTH_M = 50.0
MAX_LANE_WIDTH_M = 1000.0
MAX_CURVE_GAP_M = 50.0  # by which a curve may be longer than its geometry says
_SPIRAL_STEP_M = 0.25  # between the points at which a spiral is summed up
_ADDITIONAL = ("userData", "include", "dataQuality")  # elements that any element may hold
_U_KEYS = ("aU", "bU", "cU", "dU")
_V_KEYS = ("aV", "bV", "cV", "dV")
MIN_TILT_RAD = 1e-4  # less tilt across the road is ignored: 1 mm over 10 m
_SIDES = (("left", 1), ("right", -1))
_SHAPES = ("line", "arc", "spiral", "poly3", "paramPoly3")
FOOTWAY = ("sidewalk", "walking")
# all other types are carriageway
UNPAVED = ("none", "border", "curb", "median", "rail", "tram", "sidewalk", "walking")
STATION_STEP_M = 1.0  # between the corners of a lane
MIN_SPREAD_M = 3.0  # of road middles along a direction; with less, it has no slope
MIN_TILTED_SPREAD_M = 1.0  # the same for tilted roads, whose edges count too
MIN_LANE_M = 0.05  # width of a lane that is kept
# no others are a map in metres
NAMES_PROJECTION = r"\bproj=(?!lat|lon)|EPSG:|^\w+:\w+$|PROJ(CS|CRS|ECTEDCRS)\b"
SOLIDS = {  # type of object: kind of solid, height without one in the map (m)
    "building": ("building", 6.0),
    "tree": ("tree", 7.0),
    "vegetation": ("hedge", 1.2),
    "bush": ("hedge", 1.2),
    "pole": ("post", 4.0),
    "streetLamp": ("post", 6.0),
    "streetlamp": ("post", 6.0),
    "barrier": ("wall", 0.9),
    "wall": ("wall", 1.8),
    "soundBarrier": ("wall", 3.0),
    "railing": ("fence", 1.0),
    "fence": ("fence", 1.2),
    "gantry": ("post", 6.0),
    "trafficIsland": ("island", 0.15),
    "obstacle": ("bin", 1.0),
}
FLAT = ("crosswalk", "roadMark", "roadSurface", "patch", "crack", "none", "signalReference")
LAMPS = ("streetLamp", "streetlamp")
UNNAMED_TYPES = ("-1", "")  # types without meaning, as in CARLA's maps
MAX_BEYOND_M = 5.0  # of an object beyond the ends of its road
MAX_REPEATS = 2000  # of one object
MIN_SIGN_BASE_M = 2.1  # height of the lower edge of a sign or a signal head


@dataclass(frozen=True, eq=False)
class Piece:
    """One <geometry> of a road.

    Attributes:
        start: m along s.
        x: x of its start.
        y: y of its start.
        heading: direction at its start.
        length: m.
        shape: element inside."""

    start: float
    x: float
    y: float
    heading: float
    length: float
    shape: ElementTree.Element

    def at(self, ds: Float[np.ndarray, " k"]) -> Float64[np.ndarray, "k 3"]:
        """x, y and direction `ds` m from its start."""
        u, v, turn = self._local(ds)
        c = np.cos(self.heading)
        s = np.sin(self.heading)
        return np.column_stack(
            [self.x + c * u - s * v, self.y + s * u + c * v, self.heading + turn]
        )

    def measure_curve(self) -> float:
        """Length (m) of its curve.

        It should equal `length`; only a paramPoly3 may have another."""
        if self.shape.tag != "paramPoly3":
            return self.length
        u = _cubic(self.shape, _U_KEYS)
        v = _cubic(self.shape, _V_KEYS)
        last = self.length if self.shape.get("pRange") == "arcLength" else 1.0
        grid = np.linspace(0.0, last, max(int(self.length / _SPIRAL_STEP_M), 16) + 1)
        middle = (grid[1:] + grid[:-1]) / 2
        return float(np.sum(np.hypot(u.slope(middle), v.slope(middle)) * np.diff(grid)))

    def _local(self, ds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Places along and aside of the start, and turns against it, `ds` m from it."""
        shape = self.shape
        match shape.tag:
            case "arc":
                turn = number(shape, "curvature") * ds
                return (
                    ds * np.sinc(turn / np.pi),
                    ds * np.sin(turn / 2) * np.sinc(turn / 2 / np.pi),
                    turn,
                )
            case "spiral":  # summed by the midpoint rule
                first = number(shape, "curvStart")
                rate = (number(shape, "curvEnd") - first) / max(self.length, 1e-9)
                grid = np.linspace(0.0, self.length, int(self.length / _SPIRAL_STEP_M) + 2)
                middle = (grid[1:] + grid[:-1]) / 2
                turn = first * middle + rate * middle**2 / 2
                along = np.cumsum([0.0, *(np.diff(grid) * np.cos(turn))])
                aside = np.cumsum([0.0, *(np.diff(grid) * np.sin(turn))])
                return (
                    np.interp(ds, grid, along),
                    np.interp(ds, grid, aside),
                    first * ds + rate * ds**2 / 2,
                )
            case "poly3":
                height = _cubic(shape, "abcd")
                p = _find_parameter(ds, lambda grid: np.hypot(1.0, height.slope(grid)), self.length)
                return p, height.at(p), np.arctan(height.slope(p))
            case "paramPoly3":
                u = _cubic(shape, _U_KEYS)
                v = _cubic(shape, _V_KEYS)
                p = ds
                if shape.get("pRange") != "arcLength":
                    p = _find_parameter(
                        ds,
                        lambda grid: np.hypot(u.slope(grid), v.slope(grid)),
                        1.0,
                        length=self.length,
                    )
                return u.at(p), v.at(p), np.arctan2(v.slope(p), u.slope(p))
        return ds, np.zeros(len(ds)), np.zeros(len(ds))


@dataclass(frozen=True, eq=False)
class LateralProfile:
    """Heights across a road (OpenDRIVE 1.8, 10.6 and 10.7; 1.4, 5.3.6).

    Attributes:
        superelevation: rad along s, about the reference line; positive if the left side is higher.
        crossfall: rad along s by side, 1 left and -1 right; positive if the road falls outwards.
        shapes: places along s (m) and the height (m) along t there."""

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
        """Height (m) at s, t above the reference line."""
        height = t * np.sin(self.superelevation.at(s))
        for sign, fall in self.crossfall.items():
            height -= np.where(t * sign > 0, np.abs(t) * np.sin(fall.at(s)), 0.0)
        if self.shapes:
            rows = np.array([shape.at(t) for _, shape in self.shapes])
            places = [station for station, _ in self.shapes]
            height += np.array([np.interp(s[i], places, rows[:, i]) for i in range(len(s))])
        return height


@dataclass(frozen=True, eq=False)
class MapRoad:
    """One <road> of the map.

    Attributes:
        element: the <road>.
        pieces: pieces of its reference line, in order of s.
        length: m.
        elevation: height of the reference line (m) along s.
        lateral: height across the road, above the reference line."""

    element: ElementTree.Element
    pieces: tuple[Piece, ...]
    length: float
    elevation: Cubics
    lateral: LateralProfile

    def at(self, s: Float[np.ndarray, " k"]) -> Float64[np.ndarray, "k 3"]:
        """x, y and direction of the reference line at `s`."""
        starts = [piece.start for piece in self.pieces]
        which = np.clip(np.searchsorted(starts, s, side="right") - 1, 0, None)
        rows = np.zeros((len(s), 3))
        for i in np.unique(which):
            rows[which == i] = self.pieces[i].at(s[which == i] - self.pieces[i].start)
        return rows

    def beside(
        self, s: Float[np.ndarray, " k"], t: Float[np.ndarray, " k"]
    ) -> Float64[np.ndarray, "k 2"]:
        """Places `t` m to the left of the line at `s`."""
        return step_aside(self.at(s), t)

    def may_reach(self, window: shapely.Geometry) -> bool:
        """True if a piece of the reference line begins so near a window that it may reach it."""
        xmin, ymin, xmax, ymax = window.bounds
        for piece in self.pieces:
            reach = piece.length + MAX_CURVE_GAP_M
            if xmin - reach <= piece.x <= xmax + reach and ymin - reach <= piece.y <= ymax + reach:
                return True
        return False

    def stations(
        self, window: shapely.Geometry, spacing: float
    ) -> tuple[np.ndarray, Float64[np.ndarray, "k 2"]]:
        """s and place of stations within `window`, `spacing` m apart or less."""
        s = np.linspace(0.0, self.length, int(self.length / spacing) + 2)
        xy = self.at(s)[:, :2]
        inside = shapely.intersects_xy(window, xy)
        return s[inside], xy[inside]


def step_aside(
    places: Float[np.ndarray, "k 3"], t: Float[np.ndarray, " k"]
) -> Float64[np.ndarray, "k 2"]:
    """Places `t` m to the left of x, y and direction."""
    x, y, heading = places.T
    return np.column_stack([x - t * np.sin(heading), y + t * np.cos(heading)])


def _find_parameter(
    ds: np.ndarray,
    speed: Callable[[np.ndarray], np.ndarray],
    last: float,
    *,
    length: float | None = None,
) -> np.ndarray:
    """Parameter of a curve `ds` m along it.

    speed: m per unit of the parameter, which runs from 0 to `last`; length: m from 0 to `last` as
    in the file, which need not agree with the speed to the last digit."""
    grid = np.linspace(0.0, last, max(int((length or last) / _SPIRAL_STEP_M), 16) + 1)
    middle = (grid[1:] + grid[:-1]) / 2
    along = np.concatenate([[0.0], np.cumsum(speed(middle) * np.diff(grid))])
    scale = 1.0 if length is None else max(length, 1e-9) / max(along[-1], 1e-9)
    beyond = np.maximum(ds - along[-1] * scale, 0.0) / max(float(speed(grid[-1:])[0]) * scale, 1e-9)
    return np.interp(ds, along * scale, grid) + beyond


def _cubic(shape: ElementTree.Element, keys: Sequence[str]) -> Cubics:
    return Cubics(np.zeros(1), np.array([[number(shape, key, 0.0) for key in keys]]))


def read_road(element: ElementTree.Element) -> MapRoad:
    """Road of a <road>. Raises ValueError for a damaged one."""
    pieces = []
    for geometry in element.findall("planView/geometry"):
        start = number(geometry, "s")
        x = number(geometry, "x")
        y = number(geometry, "y")
        heading = number(geometry, "hdg")
        length = number(geometry, "length")
        shapes = [child for child in geometry if child.tag not in _ADDITIONAL]
        shape = shapes[0] if shapes else ElementTree.Element("line")
        if shape.tag not in _SHAPES:
            raise ValueError(
                f"<geometry> holds <{shape.tag}>, not one of {', '.join(_SHAPES)}: export the map "
                "again"
            )
        if not 0 <= length <= MAX_PIECE_M:
            raise ValueError(
                f"<geometry> needs a length of 0 to {MAX_PIECE_M:g} m, got {length:g}: export the "
                "map again"
            )
        pieces.append(Piece(start, x, y, heading, length, shape))
    if not pieces:
        raise ValueError(f"road {element.get('id')!r} has no <geometry>: export the map again")
    pieces.sort(key=lambda piece: piece.start)
    length = pieces[-1].start + pieces[-1].length
    heights = cubics(element.findall("elevationProfile/elevation"))
    return MapRoad(element, tuple(pieces), length, heights, _read_lateral(element))


def _read_lateral(road: ElementTree.Element) -> LateralProfile:
    """Heights across a <road>."""
    falls: dict[int, Cubics] = {}
    for side, sign in _SIDES:
        rows = road.findall("lateralProfile/crossfall")
        falls[sign] = cubics([fall for fall in rows if fall.get("side", "both") in (side, "both")])
    shapes: dict[float, list[ElementTree.Element]] = {}
    for shape in road.findall("lateralProfile/shape"):
        shapes.setdefault(number(shape, "s"), []).append(shape)
    return LateralProfile(
        superelevation=cubics(road.findall("lateralProfile/superelevation")),
        crossfall=falls,
        shapes=tuple((s, cubics(shapes[s], "t")) for s in sorted(shapes)),
    )


@dataclass(frozen=True, eq=False)
class MapLane:
    """One lane of one section. outline, middle: in the map frame (m); width: mean (m)."""

    kind: str
    outline: shapely.Geometry
    middle: Float64[np.ndarray, "k 2"]
    width: float


def roads_near(
    root: ElementTree.Element, window: shapely.Geometry, level: float, storey: float
) -> tuple[list[MapRoad], int]:
    """Roads in `window` near a height, and the number of roads on another storey.

    level: the height (m)."""
    near_roads = []
    other_storeys = 0
    around = window.buffer(30.0)
    for road in map(read_road, root.iter("road")):
        if not road.may_reach(around) or not len(road.stations(around, 5.0)[0]):
            continue
        s = np.linspace(0.0, road.length, int(road.length / 5.0) + 2)
        line = shapely.LineString(np.column_stack([road.at(s)[:, :2], road.elevation.at(s)]))
        if is_on_level([line], around, level, storey):
            near_roads.append(road)
        else:
            other_storeys += 1
    return near_roads, other_storeys


def is_on_level(
    lines: Sequence[shapely.LineString], window: shapely.Geometry, level: float, storey: float
) -> bool:
    """True if lines (x, y, z) come within `storey` (m) of a height in `window`.

    In its inner half, they must do so on the mean."""
    heights = shapely.get_coordinates(shapely.intersection(lines, window), include_z=True)[:, 2]
    if not len(heights) or np.abs(heights - level).min() > storey:
        return False
    inner = shapely.affinity.scale(window, 0.5, 0.5, origin="centroid")
    heights = shapely.get_coordinates(shapely.intersection(lines, inner), include_z=True)[:, 2]
    return not len(heights) or bool(np.abs(heights.mean() - level) <= storey)


def lanes(road: MapRoad) -> Iterator[MapLane]:
    """Lanes of a road that have any width."""
    offset = cubics(road.element.findall("lanes/laneOffset"))
    for section in read_sections(road.element, road.length):
        s = np.linspace(
            section.start, section.end, int((section.end - section.start) / STATION_STEP_M) + 2
        )
        places = road.at(s)
        middles = offset.at(s)
        for sign in (1, -1):
            inner = middles
            for lane in section.side(sign):
                width = np.clip(lane.width.at(s - section.start), 0.0, MAX_LANE_WIDTH_M)
                outer = inner + sign * width
                if width.max() > MIN_LANE_M:
                    corners = np.concatenate(
                        [step_aside(places, inner), step_aside(places, outer)[::-1]]
                    )
                    outline = shapely.make_valid(shapely.Polygon(corners))
                    middle = step_aside(places, (inner + outer) / 2)
                    yield MapLane(lane.kind, outline, middle, float(width.mean()))
                inner = outer


def describe_widths(lanes: Sequence[MapLane]) -> list[str]:
    """Note of lanes too wide for one vehicle after another.

    They are driven along their middle all the same."""
    wide_count = sum(lane.width > MAX_USUAL_WIDTH_M for lane in lanes)
    if not wide_count:
        return []
    usual = f"{MAX_USUAL_WIDTH_M:g} m"
    return [f"lanes wider than {usual}, whose traffic keeps to their middle: {wide_count}"]


def find_plane(
    roads: Sequence[MapRoad], window: shapely.Geometry, map_SE3_site: Pose
) -> tuple[Slope, float, float]:
    """Slope of the roads, their deviation from it (m), and the steepest slope (rise over run).

    The slope is along x and y of the site, fitted by least squares to the middle lines within
    `window` (map frame). It is level if the roads give no slope in one direction."""
    middles = [np.zeros((0, 3))]
    edges = []
    steepest = 0.0
    spread = MIN_SPREAD_M
    for road in roads:
        s, road_xy = road.stations(window, STATION_STEP_M)
        middles.append(np.column_stack([road_xy, road.elevation.at(s)]))
        steepest = max(steepest, float(abs(road.elevation.slope(s)).max(initial=0.0)))
        if len(s) and not road.lateral.is_flat:
            road_edges, tilt = _find_edges(road, s)
            edges.append(road_edges)
            steepest = max(steepest, tilt)
            spread = MIN_TILTED_SPREAD_M
    places = np.concatenate(middles + edges)
    if len(places) < 3:
        return LEVEL, 0.0, steepest
    xy = (places[:, :2] - map_SE3_site[:2, 3]) @ map_SE3_site[:2, :2]
    z = places[:, 2]
    xy = xy - xy.mean(axis=0)
    z = z - z.mean()
    shortest = (spread * np.sqrt(len(xy))) ** 2  # squared, of the sum over stations
    values, axes = np.linalg.eigh(xy.T @ xy)
    used_axes = axes[:, values > shortest]
    slope = (
        used_axes @ np.linalg.lstsq(xy @ used_axes, z, rcond=None)[0]
        if used_axes.size
        else np.zeros(2)
    )
    return (float(slope[0]), float(slope[1])), float(abs(z - xy @ slope).max()), steepest


def _find_edges(
    road: MapRoad, s: Float[np.ndarray, " k"]
) -> tuple[Float64[np.ndarray, "n 3"], float]:
    """Places on both edges of a carriageway at `s`, and the steepest gradient there, along and
    across."""
    offset = cubics(road.element.findall("lanes/laneOffset"))
    rows = [np.zeros((0, 3))]
    tilt = 0.0
    for section in read_sections(road.element, road.length):
        here = s[(s >= section.start) & (s <= section.end)]
        for sign in (1, -1):
            t = offset.at(here)
            for lane in section.side(sign):
                if lane.kind in UNPAVED or lane.element.get("level") in ("true", "1"):
                    break
                t = t + sign * np.clip(lane.width.at(here - section.start), 0.0, MAX_LANE_WIDTH_M)
            above = road.lateral.at(here, t)
            rows.append(np.column_stack([road.beside(here, t), road.elevation.at(here) + above]))
            across = (above - road.lateral.at(here, offset.at(here))) / np.maximum(
                np.abs(t - offset.at(here)), 0.5
            )
            tilt = max(tilt, float(np.hypot(across, road.elevation.slope(here)).max(initial=0.0)))
    return np.concatenate(rows), tilt


def in_site(shape: shapely.Geometry, map_SE3_site: Pose) -> shapely.Geometry:
    """Shape of the map in the site's frame."""
    return shapely.transform(shape, lambda xy: (xy - map_SE3_site[:2, 3]) @ map_SE3_site[:2, :2])


def in_map(shape: shapely.Geometry, map_SE3_site: Pose) -> shapely.Geometry:
    """Shape of the site in the map's frame."""
    return shapely.transform(shape, lambda xy: xy @ map_SE3_site[:2, :2].T + map_SE3_site[:2, 3])


def read_opendrive(path: Path, centre: tuple[float, float]) -> ElementTree.Element:
    """Read the elements of an OpenDRIVE file.

    Raises ValueError for damage, no map, and a `centre` outside it."""
    try:
        root = ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise ValueError(
            f"not an OpenDRIVE map or a damaged one ({error}): give an .xodr file"
        ) from None
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    if root.tag != "OpenDRIVE":
        raise ValueError(f"not an OpenDRIVE map (it begins with <{root.tag}>): give an .xodr file")
    rows = _list_pieces(root)
    if not len(rows):
        raise ValueError("the map has no road: export it again")
    if not _reaches(rows, np.array(centre)):
        raise ValueError(_describe_outside(root, centre, rows))
    return root


def _list_pieces(root: ElementTree.Element) -> Float64[np.ndarray, "n 4"]:
    """x, y, heading and length of all pieces of roads."""
    pieces = root.findall("road/planView/geometry")
    keys = ("x", "y", "hdg", "length")
    numbers = [number(piece, key) for piece in pieces for key in keys]
    return np.array(numbers, np.float64).reshape(-1, 4)


def _reaches(rows: Float64[np.ndarray, "n 4"], point: Float64[np.ndarray, "2"]) -> bool:
    """True if a place is within the map. rows: x, y, heading and length of all pieces of roads."""
    low = rows[:, :2].min(axis=0)
    high = rows[:, :2].max(axis=0)
    longest = rows[:, 3].max()
    return bool(((low - longest <= point) & (point <= high + longest)).all())


def _describe_outside(
    root: ElementTree.Element, centre: tuple[float, float], rows: Float64[np.ndarray, "n 4"]
) -> str:
    """Message for a centre outside the map, with one on a road."""
    low = rows[:, :2].min(axis=0)
    high = rows[:, :2].max(axis=0)
    spans = f"x {low[0]:.10g} to {high[0]:.10g} and y {low[1]:.10g} to {high[1]:.10g}"
    outside = (
        f"centre {centre[0]:.10g} {centre[1]:.10g} lies outside the map, whose roads start at "
        f"{spans}"
    )
    for kind, metres in (
        ("coordinates of its projection", centre),
        ("degrees", _project(root, centre)),
    ):
        if metres is not None:
            inside = _move_to_file(root, metres)
            if _reaches(rows, inside):
                return (
                    f"{outside}: these are {kind}, in the file it is --centre {inside[0]:.10g} "
                    f"{inside[1]:.10g}"
                )
    along = np.column_stack([np.cos(rows[:, 2]), np.sin(rows[:, 2])])
    middles = (rows[:, :2] + rows[:, 3:] / 2 * along).round(1)
    inside = middles[np.hypot(*(middles - np.median(middles, axis=0)).T).argmin()]
    return f"{outside}: give --centre X Y inside it, as --centre {inside[0]:.10g} {inside[1]:.10g}"


def _move_to_file(
    root: ElementTree.Element, metres: tuple[float, float]
) -> Float64[np.ndarray, "2"]:
    """Place in the file of a place in the map's projection, to 1 cm."""
    place = np.array([[metres[0], metres[1], 0.0]])
    return transform(invert(find_placement(root)), place)[0, :2].round(2) + 0.0


def _project(root: ElementTree.Element, lon_lat: tuple[float, float]) -> tuple[float, float] | None:
    """Longitude and latitude in metres of a map's projection.

    None if the map has none, the place is not on earth, or PROJ is missing."""
    reference = _read_reference(root)
    if not reference or not (abs(lon_lat[0]) <= 180 and abs(lon_lat[1]) <= 90):
        return None
    try:
        x, y = project_to_map(reference, lon_lat)
    except (ImportError, ValueError):
        return None
    return (x, y) if np.isfinite([x, y]).all() else None


def locate_degrees(
    root: ElementTree.Element, lon_lat: tuple[float, float]
) -> tuple[float, float] | None:
    """Place in the file (m) of longitude and latitude; None if they lead nowhere on the map."""
    metres = _project(root, lon_lat)
    if metres is None:
        return None
    x, y = _move_to_file(root, metres).tolist()
    return (x, y) if _reaches(_list_pieces(root), np.array([x, y])) else None


def find_placement(root: ElementTree.Element) -> Pose:
    """Pose of the file's frame in its projection's: the <offset> of its header (1.8, 8.5).

    A point of the file is turned by `hdg`, then moved by x, y and z. Raises ValueError for a
    damaged number."""
    offset = root.find("header/offset")
    if offset is None:
        return np.eye(4)
    x = number(offset, "x", 0.0)
    y = number(offset, "y", 0.0)
    z = number(offset, "z", 0.0)
    return pose(x, y, z, yaw=number(offset, "hdg", 0.0))


def _list_references(root: ElementTree.Element) -> list[str]:
    """Different texts of <geoReference>, in the header or, against the standard, next to it."""
    elements = [*root.findall("header/geoReference"), *root.findall("geoReference")]
    texts = ((element.text or "").strip() for element in elements)
    return list(dict.fromkeys(filter(None, texts)))


def _read_reference(root: ElementTree.Element) -> str:
    """First text of <geoReference>, or ""."""
    return next(iter(_list_references(root)), "")


def find_projection(root: ElementTree.Element, name: str) -> str | None:
    """Projection of a map.

    None, with a warning, if its geoReference names no projection, or one that PROJ cannot use, as
    if it needs a grid of shifts that is not installed. The map is in metres all the same.

    name: name of the file."""
    reference = _read_reference(root)
    if not reference:
        return None
    count = len(_list_references(root))
    if count > 1:
        warnings.warn(
            f"{name}: it has {count} geoReferences that differ, and the first one counts",
            stacklevel=3,
        )
    fault = _find_fault(reference)
    if fault:
        warnings.warn(
            f"{name}: {fault}, so the site does not say where on earth it is", stacklevel=3
        )
    return None if fault else reference


def describe_turn(root: ElementTree.Element) -> list[str]:
    """Note of a header whose offset turns by more than a full turn, as degrees would."""
    offset = root.find("header/offset")
    turn = 0.0 if offset is None else number(offset, "hdg", 0.0)
    if abs(turn) <= MAX_TURN_RAD:
        return []
    turned = f"its header turns the map by hdg = {turn:g} rad, more than a full turn"
    return [f"{turned}: check that these are no degrees"]


def _find_fault(reference: str) -> str:
    """Reason why PROJ cannot lead from a projection to the earth.

    Empty if it can, or is not installed."""
    if not re.search(NAMES_PROJECTION, reference, re.IGNORECASE):
        return f"its geoReference names no projection ({reference[:90]!r})"
    try:
        from pyproj import CRS, Transformer
        from pyproj.exceptions import ProjError
    except ImportError:
        return ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)  # of +init=
            projection = CRS.from_user_input(reference)
        if not projection.is_projected:
            kind = "in degrees" if projection.is_geographic else f"a {projection.type_name}"
            return f"its geoReference is {kind} ({reference[:90]!r}), not a map in metres"
        Transformer.from_crs(projection, "EPSG:4326", always_xy=True)
    except ProjError:
        grids = re.search(r"\+nadgrids=(\S+)", reference)
        if grids:
            return (
                f"its geoReference needs the grid {grids[1][:60]!r}: install it for PROJ and "
                "import again"
            )
        return f"its geoReference is no projection that PROJ knows ({reference[:90]!r})"
    return ""


@dataclass
class Standing:
    """Objects next to the roads, in the map's frame.

    Attributes:
        groups: solids that are kept or left out together.
        bays: x, y, yaw of parking bays.
        lamps: x, y of street lamps.
        understood: number of known objects by type.
        unknown: number of unknown objects by type and name.
        damaged: fault of each object or signal that was left out."""

    groups: list[list[Solid]] = field(default_factory=list)
    bays: list[Bay] = field(default_factory=list)
    lamps: list[tuple[float, float]] = field(default_factory=list)
    understood: Counter[str] = field(default_factory=Counter)
    unknown: Counter[str] = field(default_factory=Counter)
    damaged: list[str] = field(default_factory=list)


def read_standing(roads: Sequence[MapRoad]) -> Standing:
    """Objects and signals of `roads`. Of damaged ones, only the fault is kept."""
    standing = Standing()
    for road in roads:
        for element in road.element.findall("objects/object"):
            try:
                _check_place(road, element)
                _add_object(standing, road, element)
            except ValueError as error:
                standing.damaged.append(str(error))
        for element in road.element.findall("signals/signal"):
            try:
                _check_place(road, element)
                standing.groups.append(_signal(road, element))
                standing.understood["signal"] += 1
            except ValueError as error:
                standing.damaged.append(str(error))
    return standing


def _check_place(road: MapRoad, element: ElementTree.Element) -> None:
    """Raise ValueError for an object or signal off its road, or with a negative height."""
    repeats = element.findall("repeat")
    for s in [number(entry, "s", 0.0) for entry in repeats or [element]]:
        if not -MAX_BEYOND_M <= s <= road.length + MAX_BEYOND_M:
            raise ValueError(
                f"<{element.tag}> needs an s of 0 to {road.length:g}, got {s:g}: export it again"
            )
    if number(element, "height", 0.0) < 0:
        height = number(element, "height")
        raise ValueError(
            f"<{element.tag}> needs a height from 0 up, got {height:g}: export it again"
        )


def _signal(road: MapRoad, element: ElementTree.Element) -> list[Solid]:
    """Post and plate of a signal."""
    x, y, heading = _place(
        road, number(element, "s"), number(element, "t"), number(element, "hOffset", 0.0)
    )
    facing = heading + (np.pi if element.get("orientation", "+") == "+" else 0.0)
    is_head = element.get("dynamic") == "yes"
    height = float(np.clip(number(element, "height", 0.0) or (0.9 if is_head else 0.6), 0.2, 4.0))
    width = float(np.clip(number(element, "width", 0.0) or (0.3 if is_head else 0.6), 0.2, 4.0))
    low = min(max(number(element, "zOffset", 0.0), MIN_SIGN_BASE_M), 12.0)
    plate = f.block((width, 0.3 if is_head else 0.06), (x, y), facing + np.pi / 2)
    return [
        f.post(x, y, round(low, 3), 0.06),
        Solid(plate, round(low, 3), round(low + height, 3), "sign"),
    ]


def _add_object(standing: Standing, road: MapRoad, element: ElementTree.Element) -> None:
    """Add one object and its repeats to all objects."""
    kind = element.get("type", "") or "none"
    if kind == "parkingSpace":
        turn = 0.0 if number(element, "length", 0.0) >= number(element, "width", 0.0) else np.pi / 2
        places = list(_places(road, element))
        standing.bays += [(place.x, place.y, place.heading + turn) for place in places]
    elif kind in SOLIDS:
        standing.groups += list(_solids(road, element, *SOLIDS[kind]))
        if kind in LAMPS:
            standing.lamps += [(place.x, place.y) for place in _places(road, element)]
    elif kind not in FLAT:
        name = element.get("name", "") if kind in UNNAMED_TYPES else ""
        standing.unknown[f"{kind} {name}".strip()] += 1
        return
    standing.understood[kind] += 1


def _solids(
    road: MapRoad, element: ElementTree.Element, kind: str, usual: float
) -> Iterator[list[Solid]]:
    """Solids of an object and its repeats, a group for each.

    usual: height (m) of an object without one."""
    height = min(number(element, "height", 0.0) or usual, 200.0)
    radius = number(element, "radius", 0.0)
    length = number(element, "length", 0.0)
    width = number(element, "width", 0.0)
    repeats = element.findall("repeat")
    if any(number(repeat, "distance", 0.0) == 0 for repeat in repeats):
        for repeat in repeats:
            for bar in _continuous(road, repeat, kind, height, max(width, 0.2)):
                yield [bar]
        return
    outlines = []
    if not repeats:
        outlines = element.findall("outline") + element.findall("outlines/outline")
    for place in _places(road, element):
        xy = place.x, place.y
        base = place.base
        top = base + height
        if kind == "tree" and not outlines:
            crown = radius or max(length, width) / 2 or 1.6
            crown = min(max(crown, 0.3), 8.0)
            yield f.tree(*xy, max(height, 2.0), crown, min(2.3, 0.4 * height))
        elif outlines:
            rings = [_ring(road, outline, (*xy, place.heading)) for outline in outlines]
            rings = [ring for ring in rings if shapely.Polygon(ring).area > 1e-3]
            if not rings:
                raise ValueError(
                    "<outline> needs three corners that are not in one line: export it again"
                )
            yield [Solid(ring, base, top, kind) for ring in rings]
        elif kind == "post" or radius > 0:
            disc = f.disc(*xy, min(radius or max(length, width) / 2 or 0.1, 20.0))
            yield [Solid(disc, base, top, kind)]
        else:
            block = f.block((max(length, 0.3), max(width, 0.2)), xy, place.heading)
            yield [Solid(block, base, top, kind)]


class _Place(NamedTuple):
    """Place of an object in the map's frame (m, rad). base: height above the road (m)."""

    x: float
    y: float
    heading: float
    base: float


def _places(road: MapRoad, element: ElementTree.Element) -> Iterator[_Place]:
    """Places of an object and its repeats."""
    turn = number(element, "hdg", 0.0) + (np.pi if element.get("orientation") == "-" else 0.0)
    repeats = element.findall("repeat")
    if not repeats:
        s = number(element, "s")
        t = number(element, "t")
        yield _Place(*_place(road, s, t, turn), base=max(number(element, "zOffset", 0.0), 0.0))
    for repeat in repeats:
        start = number(repeat, "s")
        row = _count(repeat)
        first = number(repeat, "tStart", number(element, "t"))
        last = number(repeat, "tEnd", first)
        base = max(number(repeat, "zOffsetStart", 0.0), 0.0)
        shares = [0.0]
        if row.length > 0:
            shares = (np.arange(row.objects) * row.spacing / row.length).tolist()
        for share in shares:
            s = start + share * row.length
            if s > road.length + MAX_BEYOND_M:
                break
            yield _Place(*_place(road, s, first + share * (last - first), turn), base=base)


class _Repeats(NamedTuple):
    """Row of repeated objects: its length (m), their spacing (m), their number."""

    length: float
    spacing: float
    objects: int


def _count(repeat: ElementTree.Element) -> _Repeats:
    """Row that a <repeat> describes.

    Raises ValueError for a negative number or too many objects."""
    length = number(repeat, "length", 0.0)
    distance = number(repeat, "distance", 0.0)
    count = 1 + (int(length / distance) if distance > 0 else 0)
    if min(length, distance) < 0 or count > MAX_REPEATS:
        repeated = f"a length of {length:g} m and a distance of {distance:g} m make {count}"
        raise ValueError(
            f"<repeat> needs both from 0 up and at most {MAX_REPEATS} objects, but {repeated}: "
            "export it again"
        )
    return _Repeats(length, distance, count)


def _continuous(
    road: MapRoad, repeat: ElementTree.Element, kind: str, height: float, width: float
) -> Iterator[Solid]:
    """Barrier along the road, in pieces of 4 m."""
    start = number(repeat, "s")
    length = min(_count(repeat).length, road.length)
    first = number(repeat, "tStart", 0.0)
    s = np.linspace(start, start + length, int(length / 4.0) + 2)
    line = road.beside(s, np.linspace(first, number(repeat, "tEnd", first), len(s)))
    line = line[s <= road.length + MAX_BEYOND_M]
    top = min(number(repeat, "heightStart", 0.0) or height, 200.0)
    wide = min(number(repeat, "widthStart", 0.0) or width, 20.0)
    pieces = (ends for ends in pairwise(line) if np.hypot(*(ends[1] - ends[0])) > 0.05)
    return (Solid(f.bar(*ends, wide), 0.0, top, kind) for ends in pieces)


def _place(road: MapRoad, s: float, t: float, turn: float) -> tuple[float, float, float]:
    """x, y and direction of a place on a road."""
    x, y, heading = road.at(np.array([s]))[0]
    return (
        round(float(x - t * np.sin(heading)), 3),
        round(float(y + t * np.cos(heading)), 3),
        float(heading + turn),
    )


def _ring(
    road: MapRoad, outline: ElementTree.Element, origin: tuple[float, float, float]
) -> Float64[np.ndarray, "k 2"]:
    """Corners of an outline, described on the road or about the object.

    All are zero if they make no polygon."""
    x, y, heading = origin
    turn = plane_rotation(heading)
    corners = [
        _place(road, number(corner, "s"), number(corner, "t"), 0.0)[:2]
        for corner in outline.iter("cornerRoad")
    ]
    corners += [
        tuple(turn @ [number(corner, "u"), number(corner, "v")] + [x, y])
        for corner in outline.iter("cornerLocal")
    ]
    if len(corners) < 3:
        return np.zeros((3, 2))
    valid = shapely.make_valid(shapely.Polygon(corners))
    largest = max(list_polygons(valid), key=shapely.area, default=shapely.Polygon(np.zeros((4, 2))))
    return shapely.get_coordinates(largest.exterior)[:-1].round(3)


def move_to_site(standing: Standing, map_SE3_site: Pose) -> Standing:
    """Move objects into the site's frame."""
    turn = map_SE3_site[:2, :2]
    origin = map_SE3_site[:2, 3]
    yaw = float(np.arctan2(map_SE3_site[1, 0], map_SE3_site[0, 0]))

    def move_solid(solid: Solid) -> Solid:
        return replace(solid, footprint=((solid.footprint - origin) @ turn).round(3))

    def move_bay(bay: Bay) -> Bay:
        x, y = ((np.array(bay[:2]) - origin) @ turn).tolist()
        return x, y, float(bay[2] - yaw)

    return replace(
        standing,
        groups=[list(map(move_solid, group)) for group in standing.groups],
        bays=list(map(move_bay, standing.bays)),
        lamps=[tuple((np.array(lamp) - origin) @ turn) for lamp in standing.lamps],
    )


def off_the_road(
    standing: Standing,
    window: shapely.Geometry,
    lanes: Sequence[np.ndarray],
    tracks: shapely.Geometry,
) -> tuple[list[Solid], list[str]]:
    """Solids within `window` and off the lanes, and notes."""
    road = unite(lanes).union(tracks).buffer(-1e-3)
    shapely.prepare(road)
    solids: list[Solid] = []
    on_road = 0
    for group in standing.groups:
        shape = unite(solid.footprint for solid in group)
        if not group or not shape.intersects(window):
            continue
        if road.intersects(shape):
            on_road += 1
        else:
            solids += group
    notes = []
    if on_road:
        notes.append(f"{on_road} objects or signals stand on the carriageway and were left out")
    if standing.unknown:
        unknown_types = ", ".join(
            f"{count} {kind[:30]!r}" for kind, count in sorted(standing.unknown.items())[:12]
        )
        notes.append(f"objects of types that are not known were left out: {unknown_types}")
    if standing.damaged:
        reason = standing.damaged[0].removesuffix(": export it again")
        notes.append(f"{len(standing.damaged)} damaged objects or signals were left out: {reason}")
    return solids, notes
