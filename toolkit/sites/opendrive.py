"""OpenDRIVE maps about a place (OpenDRIVE 1.7).

They give reference lines, surfaces of lanes, objects and signals. A road is measured along its reference line, in plan
view and elevation (chapters 7, 8). An object's place is s, t on its road, turned by hdg against it; its shape is an
outline, a radius or a length and width (chapters 11, 12). Flat objects (crosswalks, markings) are no solids.
"""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.arrays import Float, Float64
from toolkit.geometry import LEVEL, Slope
from toolkit.sites import furniture as f
from toolkit.sites.site import Solid

LONGEST = 1e5  # m, of one piece of a road
_STEP = 0.25  # m between the points at which a spiral is summed up


@dataclass(frozen=True, eq=False)
class Cubics:
    """Piecewise cubic function of s. Row i is a + b ds + c ds² + d ds³ from s = starts[i] on; 0 without rows."""

    starts: Float64[np.ndarray, " n"]
    rows: Float64[np.ndarray, "n 4"]

    def at(self, s: Float[np.ndarray, " k"]) -> Float64[np.ndarray, " k"]:
        """Values at `s`; the first piece extends to the left."""
        if not len(self.starts):
            return np.zeros(len(s))
        which = np.clip(np.searchsorted(self.starts, s, side="right") - 1, 0, None)
        ds = np.maximum(s - self.starts[which], 0.0)
        return np.sum(self.rows[which] * ds[:, None] ** np.arange(4), axis=1)

    def slope(self, s: Float[np.ndarray, " k"]) -> Float64[np.ndarray, " k"]:
        """Derivatives at `s`."""
        return Cubics(self.starts, np.column_stack([self.rows[:, 1:] * [1, 2, 3], np.zeros(len(self.rows))])).at(s)


@dataclass(frozen=True, eq=False)
class Piece:
    """One <geometry>, from `start` on along s. x, y, heading: of its start; shape: the element inside."""

    start: float
    x: float
    y: float
    heading: float
    length: float
    shape: ElementTree.Element

    def at(self, ds: Float[np.ndarray, " k"]) -> Float64[np.ndarray, "k 3"]:
        """x, y and direction `ds` m from its start."""
        u, v, turn = _local(self, ds)
        c, s = np.cos(self.heading), np.sin(self.heading)
        return np.column_stack([self.x + c * u - s * v, self.y + s * u + c * v, self.heading + turn])


@dataclass(frozen=True, eq=False)
class ReferenceLine:
    """Reference line of a road. It has pieces in order of s, a length and an elevation."""

    pieces: tuple[Piece, ...]
    length: float
    elevation: Cubics

    def at(self, s: Float[np.ndarray, " k"]) -> Float64[np.ndarray, "k 3"]:
        """x, y and direction at `s`."""
        which = np.clip(np.searchsorted([p.start for p in self.pieces], s, side="right") - 1, 0, None)
        rows = np.zeros((len(s), 3))
        for i in np.unique(which):
            rows[which == i] = self.pieces[i].at(s[which == i] - self.pieces[i].start)
        return rows

    def beside(self, s: Float[np.ndarray, " k"], t: Float[np.ndarray, " k"]) -> Float64[np.ndarray, "k 2"]:
        """Places `t` m to the left of the line at `s`."""
        x, y, heading = self.at(s).T
        return np.column_stack([x - t * np.sin(heading), y + t * np.cos(heading)])


def number(element: ElementTree.Element, key: str, default: float | None = None) -> float:
    """Attribute as a finite number below a million. default: if the attribute is missing, unless None."""
    text = element.get(key)
    if text is None and default is not None:
        return default
    try:
        value = float(text or "")
    except ValueError:
        value = np.nan
    if not abs(value) < 1e6:
        raise ValueError(f"<{element.tag}> needs a finite number as {key}, got {str(text)[:30]!r}: export it again")
    return value


def cubics(elements: list[ElementTree.Element], key: str = "s") -> Cubics:
    """Pieces described by elements with a, b, c, d. They are in order of `key`."""
    rows = np.array([[number(e, k, 0.0) for k in (key, *"abcd")] for e in elements]).reshape(-1, 5)
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    return Cubics(rows[:, 0], rows[:, 1:])


def reference_line(road: ElementTree.Element) -> ReferenceLine:
    """Reference line of a <road>. Raises ValueError for a damaged one."""
    pieces = []
    for element in road.findall("planView/geometry"):
        start, x, y, heading, length = (number(element, key) for key in ("s", "x", "y", "hdg", "length"))
        shape = next(iter(element), ElementTree.Element("line"))
        if shape.tag not in _SHAPES:
            raise ValueError(f"<geometry> holds <{shape.tag}>, not one of {', '.join(_SHAPES)}: export the map again")
        if not 0 <= length <= LONGEST:
            raise ValueError(f"<geometry> needs a length of 0 to {LONGEST:g} m, got {length:g}: export the map again")
        pieces.append(Piece(start, x, y, heading, length, shape))
    if not pieces:
        raise ValueError(f"road {road.get('id')!r} has no <geometry>: export the map again")
    pieces.sort(key=lambda piece: piece.start)
    length = pieces[-1].start + pieces[-1].length
    return ReferenceLine(tuple(pieces), length, cubics(road.findall("elevationProfile/elevation")))


def _local(piece: Piece, ds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Place and direction in the piece's own frame. They are u, v, turn."""
    shape = piece.shape
    if shape.tag == "arc":
        return _bent(number(shape, "curvature"), ds)
    if shape.tag == "spiral":
        return _spiral(number(shape, "curvStart"), number(shape, "curvEnd"), piece.length, ds)
    if shape.tag == "poly3":
        row = np.array([[number(shape, key, 0.0) for key in "abcd"]])
        v = Cubics(np.zeros(1), row)
        return ds, v.at(ds), np.arctan(v.slope(ds))
    if shape.tag == "paramPoly3":
        p = ds if shape.get("pRange") == "arcLength" else ds / max(piece.length, 1e-9)
        u, v = (Cubics(np.zeros(1), np.array([[number(shape, k + axis, 0.0) for k in "abcd"]])) for axis in "UV")
        return u.at(p), v.at(p), np.arctan2(v.slope(p), u.slope(p))
    return ds, np.zeros(len(ds)), np.zeros(len(ds))


def _bent(curvature: float, ds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    turn = curvature * ds
    along = ds * np.sinc(turn / np.pi)
    aside = ds * np.sin(turn / 2) * np.sinc(turn / 2 / np.pi)
    return along, aside, turn


def _spiral(first: float, last: float, length: float, ds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Clothoid, summed by the midpoint rule."""
    rate = (last - first) / max(length, 1e-9)
    grid = np.linspace(0.0, length, int(length / _STEP) + 2)
    middle = (grid[1:] + grid[:-1]) / 2
    turn = first * middle + rate * middle**2 / 2
    u, v = (np.concatenate([[0.0], np.cumsum(np.diff(grid) * part)]) for part in (np.cos(turn), np.sin(turn)))
    return np.interp(ds, grid, u), np.interp(ds, grid, v), first * ds + rate * ds**2 / 2


_SHAPES = ("line", "arc", "spiral", "poly3", "paramPoly3")


FOOTWAY = ("sidewalk", "walking")
UNPAVED = ("none", "border", "curb", "median", "rail", "tram", *FOOTWAY)  # all other types are carriageway
STATIONS_EVERY = 1.0  # m between the corners of a lane
SPREAD = 3.0  # m, deviation of road middles along a direction; where they spread less, it has no slope
THINNEST_LANE = 0.05  # m, of a lane that is kept


@dataclass(frozen=True, eq=False)
class MapRoad:
    """One <road> of the map: reference line and element."""

    line: ReferenceLine
    element: ElementTree.Element


@dataclass(frozen=True, eq=False)
class MapLane:
    """One lane of one section. outline, middle: in the map frame (m); width: mean (m)."""

    kind: str
    outline: shapely.Geometry
    middle: Float64[np.ndarray, "k 2"]
    width: float


def roads_near(path: Path, window: shapely.Geometry, level: float, storey: float) -> list[MapRoad]:
    """Roads that reach into `window` near the height `level`.

    storey: largest difference of heights (m). Raises ValueError in one line for a damaged number.
    """
    root = ElementTree.parse(path).getroot()
    found = []
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    for element in root.iter("road"):
        try:
            line = reference_line(element)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
        s = np.linspace(0.0, line.length, int(line.length / 5.0) + 2)
        near = shapely.intersects_xy(window.buffer(30.0), line.at(s)[:, :2])
        if near.any() and abs(line.elevation.at(s[near]) - level).min() <= storey:
            found.append(MapRoad(line, element))
    return found


def surfaces(path: Path, roads_there: Sequence[MapRoad]) -> list[MapLane]:
    """Lanes of all roads. Raises ValueError, which names the file, for a damaged one."""
    try:
        return [lane for road in roads_there for lane in lanes(road)]
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def lanes(road: MapRoad) -> Iterator[MapLane]:
    """Lanes of a road that have any width."""
    sections = road.element.findall("lanes/laneSection")
    starts = [number(section, "s") for section in sections]
    offset = cubics(road.element.findall("lanes/laneOffset"))
    for section, start, end in zip(sections, starts, [*starts[1:], road.line.length], strict=True):
        if not 0 <= start < end - 1e-3:
            continue
        s = np.linspace(start, end, int((end - start) / STATIONS_EVERY) + 2)
        for side, sign in (("left", 1.0), ("right", -1.0)):
            inner = offset.at(s)
            for lane in sorted(section.findall(f"{side}/lane"), key=lambda each: abs(number(each, "id"))):
                width = np.clip(cubics(lane.findall("width"), "sOffset").at(s - start), 0.0, 50.0)
                outer = inner + sign * width
                if width.max() > THINNEST_LANE:
                    corners = np.concatenate([road.line.beside(s, inner), road.line.beside(s, outer)[::-1]])
                    outline = shapely.make_valid(shapely.Polygon(corners))
                    middle = road.line.beside(s, (inner + outer) / 2)
                    yield MapLane(lane.get("type", "none"), outline, middle, float(width.mean()))
                inner = outer


def steepest(roads_there: Sequence[MapRoad], window: shapely.Geometry) -> float:
    """Steepest slope (rise over run) of the roads within `window`."""
    slopes = [0.0]
    for road in roads_there:
        s = np.linspace(0.0, road.line.length, int(road.line.length / STATIONS_EVERY) + 2)
        inside = shapely.intersects_xy(window, road.line.at(s)[:, :2])
        slopes += list(abs(road.line.elevation.slope(s[inside])))
    return float(max(slopes))


def plane(
    roads_there: Sequence[MapRoad], window: shapely.Geometry, map_SE3_site: Float[np.ndarray, "4 4"]
) -> tuple[Slope, float]:
    """Slope of the roads, and their deviation (m).

    The slope is along x and y of the site. It is fitted by least squares to the middle lines within `window` (map
    frame). It is level if the roads give no slope in one direction.
    """
    rows = [np.zeros((0, 3))]
    for road in roads_there:
        s = np.linspace(0.0, road.line.length, int(road.line.length / STATIONS_EVERY) + 2)
        xy = road.line.at(s)[:, :2]
        inside = shapely.intersects_xy(window, xy)
        rows.append(np.column_stack([xy, road.line.elevation.at(s)])[inside])
    places = np.concatenate(rows)
    if len(places) < 3:
        return LEVEL, 0.0
    xy = (places[:, :2] - map_SE3_site[:2, 3]) @ map_SE3_site[:2, :2]
    xy, z = xy - xy.mean(axis=0), places[:, 2] - places[:, 2].mean()
    shortest = (SPREAD * np.sqrt(len(xy))) ** 2  # squared, of the sum over stations
    values, axes = np.linalg.eigh(xy.T @ xy)
    known = axes[:, values > shortest]
    along = xy @ known
    slope = known @ np.linalg.lstsq(along, z, rcond=None)[0] if known.size else np.zeros(2)
    return (float(slope[0]), float(slope[1])), float(abs(z - xy @ slope).max())


def in_site(shape: shapely.Geometry, map_SE3_site: Float[np.ndarray, "4 4"]) -> shapely.Geometry:
    """Shape of the map in the site's frame."""
    turn, origin = map_SE3_site[:2, :2], map_SE3_site[:2, 3]
    return shapely.transform(shape, lambda xy: (xy - origin) @ turn)


def in_map(shape: shapely.Geometry, map_SE3_site: Float[np.ndarray, "4 4"]) -> shapely.Geometry:
    """Shape of the site in the map's frame."""
    turn, origin = map_SE3_site[:2, :2], map_SE3_site[:2, 3]
    return shapely.transform(shape, lambda xy: xy @ turn.T + origin)


NAMES_PROJECTION = r"\+proj=(?!lat|lon)|EPSG:|PROJ(CS|CRS|ECTEDCRS)\b"  # in degrees there is no map in metres


def opendrive_header(path: Path, centre: tuple[float, float]) -> str | None:
    """Projection named by an OpenDRIVE file, if any.

    Raises ValueError if the file is not a map or `centre` is outside it.
    """
    starts, lengths, reference = [], [], None
    try:
        parser = ElementTree.iterparse(path, events=("start", "end"))
        for i, (event, element) in enumerate(parser):
            if i == 0 and element.tag.rpartition("}")[2] != "OpenDRIVE":
                raise ValueError(f"{path}: not an OpenDRIVE map (it begins with <{element.tag}>): give an .xodr file")
            tag = element.tag.rpartition("}")[2]
            if event == "end" and tag == "geoReference":
                reference = (element.text or "").strip() or None
            elif event == "end" and tag == "geometry":
                starts.append([float(element.get(key, "nan")) for key in "xy"])
                lengths.append(float(element.get("length", "nan")))
            elif event == "end" and tag == "road":
                element.clear()
    except ElementTree.ParseError as error:
        raise ValueError(f"{path}: not an OpenDRIVE map or a damaged one ({error}): give an .xodr file") from None
    if not starts or not np.isfinite(starts).all() or not np.isfinite(lengths).all():
        raise ValueError(f"{path}: the map has no road, or one without x, y and length: export it again")
    low, high = np.min(starts, axis=0) - max(lengths), np.max(starts, axis=0) + max(lengths)
    if not ((low <= centre) & (centre <= high)).all():
        low, high = np.min(starts, axis=0), np.max(starts, axis=0)
        raise ValueError(
            f"{path}: centre {centre[0]:g} {centre[1]:g} lies outside the map, whose roads start at x {low[0]:.6g} to "
            f"{high[0]:.6g} and y {low[1]:.6g} to {high[1]:.6g}: give --centre X Y inside it"
        )
    return reference


def check_projection(geo_reference: str | None, path: Path) -> str | None:
    """Return a projection; None, with a warning, for other text."""
    if geo_reference is None or re.search(NAMES_PROJECTION, geo_reference, re.IGNORECASE):
        return geo_reference
    said = f"its geoReference names no projection ({geo_reference[:90]!r})"
    warnings.warn(f"{path.name}: {said}, so the site does not say where on earth it is", stacklevel=3)
    return None


# type of object: kind of solid, height where the map gives none (m)
SOLIDS = {
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
UNSAID = ("-1", "")  # types without meaning, as in CARLA's maps
MOST = 2000  # repeats of one object
HEAD_BELOW = 2.1  # m, lowest place for the lower edge of a sign or a signal head
_FLATTEST = 0.02  # m


@dataclass
class Standing:
    """Objects beside the roads, in the map's frame.

    groups: solids that stand or fall together; bays: x, y, yaw; lamps: street lamps; understood, unknown: number of
    objects by type.
    """

    groups: list[list[Solid]] = field(default_factory=list)
    bays: list[tuple[float, float, float]] = field(default_factory=list)
    lamps: list[tuple[float, float]] = field(default_factory=list)
    understood: Counter[str] = field(default_factory=Counter)
    unknown: Counter[str] = field(default_factory=Counter)


def standing_beside(roads: Sequence[MapRoad]) -> Standing:
    """Objects and signals of `roads`. Raises ValueError for a damaged number."""
    found = Standing()
    for road in roads:
        for element in road.element.findall("objects/object"):
            _add_object(found, road, element)
        for element in road.element.findall("signals/signal"):
            found.groups.append(signal(road, element))
            found.understood["signal"] += 1
    return found


def signal(road: MapRoad, element: ElementTree.Element) -> list[Solid]:
    """Post of a signal. It has a sign, or a signal head if the signal is dynamic."""
    x, y, heading = _place(road, number(element, "s"), number(element, "t"), number(element, "hOffset", 0.0))
    facing = heading + (np.pi if element.get("orientation", "+") == "+" else 0.0)
    is_head = element.get("dynamic") == "yes"
    height = float(np.clip(number(element, "height", 0.0) or (0.9 if is_head else 0.6), 0.2, 4.0))
    width = float(np.clip(number(element, "width", 0.0) or (0.3 if is_head else 0.6), 0.2, 4.0))
    low = min(max(number(element, "zOffset", 0.0), HEAD_BELOW), 12.0)
    half = width / 2 * np.array([-np.sin(facing), np.cos(facing)])
    start, end = (float(x - half[0]), float(y - half[1])), (float(x + half[0]), float(y + half[1]))
    plate = Solid(f.bar(start, end, 0.3 if is_head else 0.06), round(low, 3), round(low + height, 3), "sign")
    return [f.post(x, y, round(low, 3), 0.06), plate]


def _add_object(found: Standing, road: MapRoad, element: ElementTree.Element) -> None:
    kind = element.get("type", "") or "none"
    if kind == "parkingSpace":
        for x, y, heading, _ in _places(road, element):
            length, width = number(element, "length", 0.0), number(element, "width", 0.0)
            found.bays.append((x, y, heading if length >= width else heading + np.pi / 2))
    elif kind in FLAT:
        pass
    elif kind in SOLIDS:
        found.groups += _solids(road, element, *SOLIDS[kind])
        if kind in LAMPS:
            found.lamps += [(x, y) for x, y, *_ in _places(road, element)]
    else:
        name = element.get("name", "") if kind in UNSAID else ""
        found.unknown[f"{kind} {name}".strip()] += 1
        return
    found.understood[kind] += 1


def _solids(road: MapRoad, element: ElementTree.Element, kind: str, usual: float) -> Iterator[list[Solid]]:
    height = min(number(element, "height", 0.0) or usual, 200.0)
    radius, length, width = (number(element, key, 0.0) for key in ("radius", "length", "width"))
    repeats = element.findall("repeat")
    outlines = [] if repeats else [*element.findall("outline"), *element.findall("outlines/outline")]
    if any(number(repeat, "distance", 0.0) == 0 for repeat in repeats):
        yield from ([bar] for repeat in repeats for bar in _continuous(road, repeat, kind, height, max(width, 0.2)))
        return
    for x, y, heading, base in _places(road, element):
        rings = [_ring(road, outline, (x, y, heading)) for outline in outlines]
        if kind == "tree" and not outlines:
            crown = radius or max(length, width) / 2 or 1.6
            yield f.tree(x, y, max(height, 2.0), min(max(crown, 0.3), 8.0), min(2.3, 0.4 * height))
        elif outlines:
            yield [Solid(r, base, base + height, kind) for r in rings if shapely.Polygon(r).area > 1e-3]
        elif kind == "post" or radius > 0:
            yield [Solid(f.disc(x, y, min(radius or max(length, width) / 2 or 0.1, 20.0)), base, base + height, kind)]
        else:
            ahead = max(length, 0.3) / 2 * np.array([np.cos(heading), np.sin(heading)])
            start, end = (float(x - ahead[0]), float(y - ahead[1])), (float(x + ahead[0]), float(y + ahead[1]))
            yield [Solid(f.bar(start, end, max(width, 0.2)), base, base + height, kind)]


def _places(road: MapRoad, element: ElementTree.Element) -> Iterator[tuple[float, float, float, float]]:
    """Places of an object and its repeats. They are x, y, direction and height over the road."""
    turn = number(element, "hdg", 0.0) + (np.pi if element.get("orientation") == "-" else 0.0)
    repeats = element.findall("repeat")
    if not repeats:
        s, t = number(element, "s"), number(element, "t")
        yield *_place(road, s, t, turn), max(number(element, "zOffset", 0.0), 0.0)
    for repeat in repeats:
        start, length, every = number(repeat, "s"), number(repeat, "length", 0.0), number(repeat, "distance", 0.0)
        count = 1 + (int(length / every) if every > 0 else 0)
        if not 0 < count <= MOST:
            raise ValueError(f"<repeat> makes {count} objects: it must be 1 to {MOST}, mend its length or distance")
        first = number(repeat, "tStart", number(element, "t"))
        last = number(repeat, "tEnd", first)
        base = max(number(repeat, "zOffsetStart", 0.0), 0.0)
        for share in np.arange(count) * every / length if length > 0 else [0.0]:
            yield *_place(road, start + share * length, first + share * (last - first), turn), base


def _continuous(road: MapRoad, repeat: ElementTree.Element, kind: str, height: float, width: float) -> Iterator[Solid]:
    """Barrier along the road, in pieces of 4 m."""
    start, length = number(repeat, "s"), min(max(number(repeat, "length", 0.0), 0.0), road.line.length)
    first = number(repeat, "tStart", 0.0)
    s = np.linspace(start, start + length, int(length / 4.0) + 2)
    line = road.line.beside(s, np.linspace(first, number(repeat, "tEnd", first), len(s)))
    top = min(number(repeat, "heightStart", 0.0) or height, 200.0)
    wide = number(repeat, "widthStart", 0.0) or width
    for start_xy, end_xy in pairwise(line):
        if np.hypot(*(end_xy - start_xy)) > 0.05:
            ends = [(float(p[0]), float(p[1])) for p in (start_xy, end_xy)]
            yield Solid(f.bar(ends[0], ends[1], min(wide, 20.0)), 0.0, top, kind)


def _place(road: MapRoad, s: float, t: float, turn: float) -> tuple[float, float, float]:
    ((x, y, heading),) = road.line.at(np.array([s]))
    return round(float(x - t * np.sin(heading)), 3), round(float(y + t * np.cos(heading)), 3), float(heading + turn)


def _ring(road: MapRoad, outline: ElementTree.Element, place: tuple[float, float, float]) -> Float64[np.ndarray, "k 2"]:
    """Corners of an outline. It is given on the road or about the object. They are all zeros if it makes no polygon."""
    x, y, heading = place
    turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    corners = []
    for corner in outline:
        if corner.tag == "cornerRoad":
            corners.append(_place(road, number(corner, "s"), number(corner, "t"), 0.0)[:2])
        elif corner.tag == "cornerLocal":
            corners.append(tuple(turn @ [number(corner, "u"), number(corner, "v")] + [x, y]))
    if len(corners) < 3:
        return np.zeros((3, 2))
    valid = shapely.make_valid(shapely.Polygon(corners))
    parts = [p for part in shapely.get_parts(valid) for p in shapely.get_parts(part) if p.geom_type == "Polygon"]
    largest = max(parts, key=shapely.area, default=shapely.Polygon(np.zeros((4, 2))))
    return shapely.get_coordinates(largest.exterior)[:-1].round(3)


def read_standing(path: Path, roads: Sequence[MapRoad]) -> Standing:
    """Objects beside the roads; ValueError that names a damaged file."""
    try:
        return standing_beside(roads)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def move_to_site(there: Standing, map_SE3_site: Float64[np.ndarray, "4 4"]) -> Standing:
    """Move objects into the site's frame."""
    turn, origin = map_SE3_site[:2, :2], map_SE3_site[:2, 3]
    yaw = float(np.arctan2(map_SE3_site[1, 0], map_SE3_site[0, 0]))
    groups = [[replace(s, footprint=((s.footprint - origin) @ turn).round(3)) for s in g] for g in there.groups]
    bays = [(*(np.array(bay[:2]) - origin) @ turn, bay[2] - yaw) for bay in there.bays]
    lamps = [tuple((np.array(lamp) - origin) @ turn) for lamp in there.lamps]
    return replace(there, groups=groups, bays=[(float(x), float(y), float(a)) for x, y, a in bays], lamps=lamps)


def off_the_road(
    there: Standing, window: shapely.Geometry, lanes: Sequence[np.ndarray], tracks: shapely.Geometry
) -> tuple[list[Solid], list[str]]:
    """Solids within `window` that stand on no lane, and notes."""
    road = shapely.union_all([shapely.Polygon(p) for p in lanes]).union(tracks).buffer(-1e-3)
    shapely.prepare(road)
    shapes = [shapely.union_all([shapely.Polygon(s.footprint) for s in g]) for g in there.groups]
    near = [(g, shape) for g, shape in zip(there.groups, shapes, strict=True) if g and shape.intersects(window)]
    kept = [solid for g, shape in near if not road.intersects(shape) for solid in g]
    stopped = sum(bool(road.intersects(shape)) for _, shape in near)
    notes = [f"{stopped} objects or signals stand on the carriageway and were left out"] if stopped else []
    if there.unknown:
        listed = ", ".join(f"{count} {kind[:30]!r}" for kind, count in sorted(there.unknown.items())[:12])
        notes.append(f"objects of types that are not known were left out: {listed}")
    return kept, notes
