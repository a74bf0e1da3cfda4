"""OpenStreetMap extracts in metres around a centre: roads for netconvert, and the solids beside them.

Extracts are untidy: ways refer to nodes that were cut off, relations to missing members, values are free text. What
cannot be used is left out; only a file that is no map is refused. https://wiki.openstreetmap.org/wiki/OSM_XML

Only well-formed tags reach netconvert. Streets get footways by their class where the map does not say.
Buildings are as high as height says, else building:levels × 3 m, else the default of their kind. Whatever would stand
on a lane is cut off. https://wiki.openstreetmap.org/wiki/Simple_3D_Buildings

Parking along the kerbs of an OpenStreetMap extract: strips beside the lanes of the roads, and bays on them.

Both tagging schemes are read, parking:SIDE with parking:SIDE:orientation and the older parking:lane:SIDE, and areas of
amenity=parking beside a road. netconvert knows no such strips: they are put into the plain network that it writes, and
it is run again. A strip lies between lanes and footway, also where vehicles stand half or all on the kerb.
https://wiki.openstreetmap.org/wiki/Street_parking"""

import gzip
import re
import zlib
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, cast
from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.arrays import Float64
from toolkit.geometry import plane_rotation
from toolkit.sites import furniture as f, network as nets
from toolkit.sites.georeference import inverse_project, project
from toolkit.sites.site import Solid
from toolkit.sites.surroundings import ANGLES, Bay, bays_between

Tags = Mapping[str, str]
Relation = tuple[list[tuple[str, str]], Tags]  # ways with their roles

LARGEST_MAP, MOST_TAGS = 1 << 26, 200_000  # bytes of a map that are read, and tags within one element
_PART, _SILENT = 1 << 20, 1 << 22  # bytes read at once, and at most without a tag
_LONGEST_LEAP = 1e4  # m from one node of a road or building to the next
AT_THE_EDGE = 5e-4  # degrees beyond the map's bounds where a centre still is in it


@dataclass(frozen=True)
class Way:
    """Line or outline of a map: (k, 2) metres, the k ids of its nodes, and its tags."""

    line: Float64[np.ndarray, "k 2"] = field(repr=False)
    nodes: tuple[str, ...]
    tags: Tags

    @property
    def is_closed(self) -> bool:
        """True if it ends where it begins."""
        return len(self.nodes) > 3 and self.nodes[0] == self.nodes[-1]


@dataclass(frozen=True)
class Extract:
    """Map in metres around its centre."""

    centre: tuple[float, float]  # longitude, latitude
    heading: float  # of x (rad counter-clockwise from east)
    ways: tuple[Way, ...]
    areas: tuple[tuple[shapely.Polygon, Tags], ...]  # holes and all
    places: tuple[tuple[Float64[np.ndarray, "2"], Tags], ...]  # tagged single points
    notes: tuple[str, ...] = ()  # what is odd about the map


def read_map(path: Path, centre: tuple[float, float], heading: float = 0.0) -> Extract:
    """Read a map (.osm, .osm.xml, or either with .gz) in metres around `centre` (longitude, latitude).

    heading: of x (rad counter-clockwise from east). Raises ValueError if the file is no OSM XML, is damaged or empty,
    or `centre` lies outside it."""
    points: dict[str, list[float]] = {}
    place_tags: dict[str, Tags] = {}
    bounds: list[list[float]] = []
    raw_ways: dict[str, tuple[list[str], Tags]] = {}
    relations: list[Relation] = []
    odd = Counter[str]()
    for element in _elements(path):
        tags = {tag.get("k", ""): tag.get("v", "") for tag in element.iter("tag")}
        name = element.get("id", "")
        if element.tag == "bounds":
            bounds.append([*_lon_lat(element, "minlon", "minlat"), *_lon_lat(element, "maxlon", "maxlat")])
        elif element.tag == "node":
            lon_lat = _lon_lat(element, "lon", "lat")
            odd["nodes that are no place on earth were left out"] += lon_lat[0] != lon_lat[0]
            odd[_TWICE] += points.get(name, lon_lat) != lon_lat
            if lon_lat[0] == lon_lat[0]:
                points[name] = lon_lat
                place_tags |= {name: tags} if tags else {}
        elif element.tag == "way":
            odd[_TWICE] += name in raw_ways
            raw_ways[name] = ([nd.get("ref", "") for nd in element.iter("nd")], tags)
        elif element.tag == "relation" and tags.get("type") == "multipolygon":
            members = [m for m in element.iter("member") if m.get("type") == "way"]
            relations.append(([(m.get("ref", ""), m.get("role", "")) for m in members], tags))
    if not points:
        raise ValueError(f"{path}: the map is empty: it has no node with a latitude and longitude")
    degrees = np.array(list(points.values()))
    edges = np.array(bounds) if bounds and np.isfinite(bounds).all() else np.tile(degrees, 2)
    low, high = edges[:, :2].min(axis=0), edges[:, 2:].max(axis=0)
    if not ((low - AT_THE_EDGE <= centre) & (centre <= high + AT_THE_EDGE)).all():
        spans = f"longitude {low[0]:.6g} to {high[0]:.6g} and latitude {low[1]:.6g} to {high[1]:.6g}"
        outside = f"{path}: centre {centre[0]:g} {centre[1]:g} lies outside the map, which spans {spans}"
        raise ValueError(f"{outside}: give --centre LONGITUDE LATITUDE inside it")
    position = dict(zip(points, project(degrees, centre) @ plane_rotation(-heading).T, strict=True))
    ways = {}
    for name, (references, way_tags) in raw_ways.items():
        known = [node for node in references if node in position]
        nodes = [node for i, node in enumerate(known) if i == 0 or node != known[i - 1]]
        if len(nodes) > 1:
            ways[name] = Way(np.array([position[node] for node in nodes]), tuple(nodes), way_tags)
            leaps = np.hypot(*np.diff(ways[name].line, axis=0).T).max() > _LONGEST_LEAP
            odd["roads or buildings leap more than 10 km from node to node"] += leaps and bool(_BUILT & way_tags.keys())
    places = tuple((position[name], tags) for name, tags in place_tags.items())
    notes = tuple(f"{count} {what}" for what, count in odd.items() if count)
    return Extract(centre, heading, tuple(ways.values()), tuple(_areas(ways, relations)), places, notes)


_TWICE = "nodes or ways of one id are there twice: the last one counts"
_BUILT = {"highway", "building"}


def metres(text: str | None) -> float | None:
    """Parse a length as mappers write it. Of several the greatest counts; None if it is not positive."""
    lengths = []
    for part in (text or "").lower().replace(",", ".").split(";"):
        feet = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(?:'|ft|feet)\s*(?:(\d+(?:\.\d+)?)\s*(?:\"|''|in)?)?", part.strip())
        plain = re.fullmatch(r"~?\s*(\d+(?:\.\d+)?)\s*(?:m|metres?|meters?)?", part.strip())
        if feet:
            lengths.append(round(0.3048 * (float(feet[1]) + float(feet[2] or 0) / 12), 4))
        elif plain:
            lengths.append(float(plain[1]))
    return max((length for length in lengths if 0 < length < 1000), default=None)


def _elements(path: Path) -> Iterator[ElementTree.Element]:
    """Yield the file's elements, each released before the next. Raises ValueError if the file is not OSM XML."""
    if path.name.lower().endswith((".pbf", ".o5m", ".bz2", ".zip")):
        raise ValueError(f"{path}: only .osm, .osm.xml and .osm.gz are read: convert it first (osmium cat -o map.osm)")
    with path.open("rb") as stream:
        compressed = stream.read(2) == b"\x1f\x8b"
    try:
        with gzip.open(path) if compressed else path.open("rb") as stream:
            head = stream.read(65536)
        start = re.search(rb"<(?!\?|!)", head)
        if start is None or not head[start.start() :].startswith(b"<osm") or b"<!DOCTYPE" in head[: start.start()]:
            raise ValueError(f"{path}: not OpenStreetMap XML (it does not begin with <osm>): export the map as .osm")
        parser: ElementTree.XMLPullParser[ElementTree.Element] = ElementTree.XMLPullParser(("start", "end"))
        root: ElementTree.Element | None = None
        read, silent, inside = 0, 0, 0  # bytes, bytes since the last tag, tags since the last element
        with gzip.open(path) if compressed else path.open("rb") as stream:
            while part := stream.read(_PART):
                parser.feed(part)
                read, silent = read + len(part), silent + len(part)
                for event, element in cast("Iterable[tuple[str, ElementTree.Element]]", parser.read_events()):
                    root = element if root is None else root
                    silent, inside = 0, inside + 1
                    if event == "end" and element.tag in ("node", "way", "relation", "bounds"):
                        if element.get("action") != "delete" and element.get("visible") != "false":
                            yield element
                        root.clear()
                        inside = 0
                if read > LARGEST_MAP or silent > _SILENT or inside > MOST_TAGS:
                    most = f"{LARGEST_MAP >> 20} MB, {_SILENT >> 20} MB without a tag or {MOST_TAGS} tags in an element"
                    raise ValueError(f"{path}: more than {most}: cut out the site first (osmium extract --bbox)")
        parser.close()
    except (ElementTree.ParseError, LookupError) as error:
        raise ValueError(f"{path}: damaged XML ({error}): download the map again") from None
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise ValueError(f"{path}: damaged gzip file ({error}): download the map again") from None


def _lon_lat(element: ElementTree.Element, lon: str, lat: str) -> list[float]:
    """Longitude and latitude in two attributes, NaN where they are no place on earth."""
    try:
        found = [float(element.get(lon, "nan")), float(element.get(lat, "nan"))]
    except ValueError:
        found = []
    return found if found and abs(found[0]) <= 180 and abs(found[1]) < 90 else [np.nan, np.nan]


def _areas(ways: Mapping[str, Way], relations: list[Relation]) -> Iterator[tuple[shapely.Polygon, Tags]]:
    for way in ways.values():
        if way.is_closed and (way.tags.get("highway") is None or way.tags.get("area") == "yes"):
            yield from ((polygon, way.tags) for polygon in _valid(shapely.Polygon(way.line)))
    for members, tags in relations:
        parts = [(ways[name], role) for name, role in members if name in ways]
        outer = _rings(way for way, role in parts if role != "inner")
        inner = _rings(way for way, role in parts if role == "inner")
        shared = {} if "building" in tags or "building:part" in tags else dict(parts[0][0].tags) if parts else {}
        yield from ((polygon, {**shared, **tags}) for polygon in _valid(outer.difference(inner)))


def _rings(ways: Iterable[Way]) -> shapely.Geometry:
    """Ground enclosed by rings, which may be made of several ways."""
    lines = [shapely.LineString(way.line) for way in ways]
    return shapely.union_all([shapely.Polygon(ring.exterior) for ring in shapely.get_parts(shapely.polygonize(lines))])


def _valid(shape: shapely.Geometry) -> list[shapely.Polygon]:
    return [piece for piece in nets.list_polygons(shapely.make_valid(shape)) if piece.area > 0.1]


# class of road: lanes each way, speed (m/s), priority, footways on both sides unless the map says otherwise
ROADS = {"motorway": (2, 36.1, 14, False), "trunk": (2, 27.8, 13, False), "primary": (1, 13.9, 12, True)}
ROADS |= {"secondary": (1, 13.9, 11, True), "tertiary": (1, 13.9, 10, True), "unclassified": (1, 13.9, 8, True)}
ROADS |= {"residential": (1, 8.3, 7, True), "living_street": (1, 2.8, 6, True), "busway": (1, 8.3, 5, False)}
ROADS |= {"service": (1, 5.6, 4, False), "cycleway": (1, 5.6, 2, False)}
ROADS |= {f"{kind}_link": ROADS[kind] for kind in ("motorway", "trunk", "primary", "secondary", "tertiary")}
_PATHS = ("footway", "path", "pedestrian", "steps", "corridor")
_SIDES = ("both", "left", "right", "no")
_RULES = {"oneway": "yes|no|true|false|1|0|-1", "junction": "roundabout|circular", "maxspeed": r"\d+( mph)?"}
_RULES |= dict.fromkeys(("lanes", "lanes:forward", "lanes:backward"), "[1-8]")  # tags passed on, as far as they fit


def roads(extract: Extract, window: shapely.Geometry, *, lefthand: bool = False) -> tuple[list[Way], list[str]]:
    """Roads for vehicles within `window`, cut at its edge, and notes. They have the tags meant for netconvert. Tunnels
    and bridges over another road are left out and noted."""
    drivable = [way for way in extract.ways if way.tags.get("highway") in ROADS and way.tags.get("area") != "yes"]
    drivable = [w for w in drivable if w.tags.get("service") not in ("driveway", "parking_aisle", "drive-through")]
    near = [way for way in drivable if shapely.LineString(way.line).intersects(window)]
    street = [way for way in near if not _below(way.tags)]
    ground = [way for way in street if not _above(way.tags)]
    kept = [way for way in street if not _above(way.tags) or not any(_crosses(way, other) for other in ground)]
    notes = [f"{len(near) - len(kept)} tunnels or bridges over a road were left out"] if len(near) > len(kept) else []
    return [piece for way in kept for piece in _cut(way, window, lefthand)], notes


def paths(extract: Extract, window: shapely.Geometry) -> list[shapely.Polygon]:
    """Footways and squares within `window` that belong to no road."""
    squares = {"pedestrian", "footway"}
    areas = [shape for shape, tags in extract.areas if {tags.get("highway"), tags.get("area:highway")} & squares]
    shapes: list[shapely.Geometry] = [*areas]
    for way in extract.ways:
        is_area = way.is_closed and way.tags.get("area") == "yes"
        if way.tags.get("highway") in _PATHS and not is_area and not _below(way.tags) and not _above(way.tags):
            width = np.clip(metres(way.tags.get("width")) or 2.0, 1.0, 10.0)
            shapes.append(shapely.LineString(way.line).buffer(width / 2, cap_style="flat", quad_segs=2))
    inside = (shape.intersection(window) for shape in shapes if shape.intersects(window))
    return [part for shape in inside for part in nets.list_polygons(shape)]


def write_osm(pieces: Iterable[Way], extract: Extract) -> str:
    """Format `pieces` as OSM XML."""
    pieces = list(pieces)
    position = {node: point for way in pieces for node, point in zip(way.nodes, way.line, strict=True)}
    points = np.array(list(position.values())).reshape(-1, 2)
    degrees = inverse_project(points @ plane_rotation(extract.heading).T, extract.centre)
    signals = {tuple(xy.round(3)) for xy, tags in extract.places if tags.get("highway") == "traffic_signals"}
    text = ['<osm version="0.6">']
    number = {node: i for i, node in enumerate(position, start=1)}
    for (node, xy), (longitude, latitude) in zip(position.items(), degrees, strict=True):
        tag = '<tag k="highway" v="traffic_signals"/>' if tuple(xy.round(3)) in signals else ""
        text.append(f'<node id="{number[node]}" lon="{longitude:.9f}" lat="{latitude:.9f}">{tag}</node>')
    for way_number, way in enumerate(pieces, start=1):
        inside = "".join(f'<nd ref="{number[node]}"/>' for node in way.nodes)
        inside += "".join(nets.format_element("tag", {"k": key, "v": value}) for key, value in way.tags.items())
        text.append(nets.format_element("way", {"id": way_number}, inside))
    return "\n".join([*text, "</osm>\n"])


def road_types() -> str:
    """SUMO's type file for the roads of `roads`."""
    rows = []
    for kind, (lanes, speed, priority, _) in ROADS.items():
        motorway = " ".join(user for user in nets.MOTOR.split() if user not in ("bicycle", "moped"))
        users = motorway if kind.startswith("motorway") else "bicycle" if kind == "cycleway" else nets.MOTOR
        row = {"id": f"highway.{kind}", "numLanes": lanes, "speed": speed, "priority": priority, "oneway": "false"}
        rows.append(nets.format_element("type", {**row, "width": 1.8 if kind == "cycleway" else 3.25, "allow": users}))
    return nets.format_xml("types", rows)


def _below(tags: Tags) -> bool:
    layer = re.fullmatch(r"\s*([+-]?\d{1,3})\s*", tags.get("layer", "0"))
    sunk = layer is not None and int(layer[1]) < 0 and "tunnel" in tags
    return sunk or tags.get("tunnel", "no") not in ("no", "building_passage")


def _above(tags: Tags) -> bool:
    return tags.get("bridge", "no") != "no"


def _crosses(bridge: Way, road: Way) -> bool:
    crossing = shapely.LineString(bridge.line).intersection(shapely.LineString(road.line))
    shared = [xy for node, xy in zip(bridge.nodes, bridge.line, strict=True) if node in road.nodes]
    return not crossing.difference(shapely.MultiPoint(shared).buffer(0.5) if shared else shapely.Polygon()).is_empty


def _cut(way: Way, window: shapely.Geometry, lefthand: bool) -> Iterator[Way]:
    tags = _road_tags(way.tags, lefthand)
    step = -1 if way.tags.get("oneway") in ("-1", "reverse") else 1
    line, nodes = way.line[::step], way.nodes[::step]
    pieces: list[list[tuple[str, np.ndarray]]] = [[]]  # nodes and points
    for (start, end), (first, last) in zip(pairwise(line), pairwise(nodes), strict=True):
        inside = shapely.LineString([start, end]).intersection(window)
        if inside.geom_type != "LineString" or inside.is_empty:
            continue
        ends = shapely.get_coordinates(inside)
        ends = ends[np.argsort(np.hypot(*(ends - start).T))]
        for xy, corner, name in ((ends[0], start, first), (ends[-1], end, last)):
            own = name if np.hypot(*(xy - corner)) < 1e-6 else f"{first}_{last}_{'in' if corner is start else 'out'}"
            if own != name and corner is start and pieces[-1]:
                pieces.append([])
            if not pieces[-1] or pieces[-1][-1][0] != own:
                pieces[-1].append((own, xy))
        if own != last:
            pieces.append([])
    for piece in pieces:
        if len(piece) > 1:
            yield Way(np.array([xy for _, xy in piece]), tuple(name for name, _ in piece), tags)


def _road_tags(tags: Tags, lefthand: bool) -> dict[str, str]:
    kind, ring = tags["highway"], tags.get("junction") in ("roundabout", "circular")
    given = {key: tags.get(key, "").strip().lower() for key in _RULES}
    passed = {key: value for key, value in given.items() if re.fullmatch(_RULES[key], value)}
    if passed.get("oneway") == "-1" or tags.get("oneway") == "reverse" or (ring and "oneway" not in passed):
        passed["oneway"] = "yes"
    usual = ("left" if lefthand else "right") if ring else "both"
    side = _sidewalk(tags) or (usual if ROADS[kind][3] else "no")
    street = {"name": " ".join(tags["name"].split())[:60]} if tags.get("name", "").strip() else {}
    return {"highway": kind, **passed, "sidewalk": side, **street}


def _sidewalk(tags: Tags) -> str | None:
    """Footways beside a road: both, left, right or no; None if unknown."""
    plain = tags.get("sidewalk", "")
    if plain in _SIDES or plain in ("none", "yes", "separate"):
        return {"none": "no", "yes": "both", "separate": "both"}.get(plain, plain)
    has = [side for side in ("both", "left", "right") if tags.get(f"sidewalk:{side}") in ("yes", "separate")]
    return ("both" if "both" in has or len(has) == 2 else has[0]) if has else None


DEFAULT_HEIGHT, STOREY = 6.0, 3.0  # m
FARTHEST_END = 60.0  # m beyond the window where a long building ends
_NO_BUILDING = ("", "no", "none", "demolished", "entrance")
_BARRIERS = {"wall": (f.wall, 1.8), "fence": (f.railing, 1.2), "hedge": (f.hedge, 1.4)}  # usual height (m)
_BARRIERS |= {"city_wall": (f.wall, 4.0), "retaining_wall": (f.wall, 1.0)}
_BARRIERS |= {"guard_rail": (f.railing, 0.8), "handrail": (f.railing, 1.0)}


def buildings(extract: Extract, window: shapely.Geometry, road: shapely.Geometry) -> tuple[list[Solid], list[str]]:
    """Buildings that reach into `window`, cut off at `road`, and notes. A building with parts (building:part) is made
    of them; its own outline stands where there are none."""
    near = [(shape, tags) for shape, tags in extract.areas if shape.intersects(window)]
    parts = [(shape, tags) for shape, tags in near if tags.get("building:part", "") not in _NO_BUILDING]
    covered = shapely.union_all([shape for shape, _ in parts])
    whole = [(shape, tags) for shape, tags in near if tags.get("building", "") not in _NO_BUILDING]
    whole = [(s, tags) for s, tags in whole if tags.get("location") != "underground"]
    whole = [(s.difference(covered), t) for s, t in whole if not t.get("layer", "0").strip().startswith("-")]
    solids, cut, reach = [], 0, window.buffer(FARTHEST_END)
    for shape, tags in [*parts, *whole]:
        storeys = metres(tags.get("building:levels"))
        top = metres(tags.get("height")) or metres(tags.get("building:height"))
        top = top or (storeys * STOREY if storeys else DEFAULT_HEIGHT)
        base = metres(tags.get("min_height")) or (metres(tags.get("building:min_level")) or 0.0) * STOREY
        if tags.get("building") == "roof" and not base:
            base = top - 0.5
        base = base if base < top - 0.1 else 0.0
        rest = shape.difference(road)
        cut += bool(shape.area - rest.area > 0.1)
        rings = [ring for ring in nets.cut_polygons([rest], reach) if shapely.Polygon(ring).area > 1.0]
        solids += [Solid(ring, base, top, "building") for ring in rings]
    return solids, [f"{cut} buildings reached over a road and were cut back to its edge"] if cut else []


def barriers(extract: Extract, window: shapely.Geometry, road: shapely.Geometry) -> list[Solid]:
    """Walls, fences and hedges within `window`, off `road`."""
    solids: list[Solid] = []
    for way in extract.ways:
        draw, usual = _BARRIERS.get(way.tags.get("barrier", ""), (None, 0.0))
        if draw is None:
            continue
        height = min(metres(way.tags.get("height")) or usual, 10.0)
        line = shapely.LineString(way.line).intersection(window).difference(road.buffer(0.5))
        for part in shapely.get_parts(shapely.line_merge(line) if line.geom_type == "MultiLineString" else line):
            piece = part.simplify(0.05)
            if piece.geom_type == "LineString" and piece.length > 0.5:
                solids += draw([(float(x), float(y)) for x, y in piece.coords], height)
    return solids


def trees(extract: Extract, window: shapely.Geometry, road: shapely.Geometry) -> list[Solid]:
    """Single trees and rows of trees within `window`. Crowns keep off `road`; trees too near it are left out."""
    found = [(xy, tags) for xy, tags in extract.places if tags.get("natural") == "tree"]
    for row in (way for way in extract.ways if way.tags.get("natural") == "tree_row"):
        line = shapely.LineString(row.line)
        found += [(xy, row.tags) for xy in shapely.get_coordinates(line.interpolate(np.arange(0.0, line.length, 8.0)))]
    solids: list[Solid] = []
    for (x, y), tags in found:
        room = road.distance(shapely.Point(x, y)) - 0.1
        crown = min((metres(tags.get("diameter_crown")) or 4.0) / 2, room, 6.0)
        if crown > 0.5 and window.contains(shapely.Point(x, y)):
            height = float(np.clip(metres(tags.get("height")) or 7.0, 2.0, 40.0))
            solids += f.tree(float(x), float(y), height, crown, min(2.3, 0.4 * height))
    return solids


def furniture(extract: Extract, window: shapely.Geometry, road: shapely.Geometry) -> tuple[list[Solid], np.ndarray]:
    """Posts, signs, bins and benches off `road`, and (n, 2) street lamps."""
    solids: list[Solid] = []
    lamps: list[np.ndarray] = []
    clear = road.buffer(0.4)
    for xy, tags in extract.places:
        spot, (x, y) = shapely.Point(xy), (float(xy[0]), float(xy[1]))
        if not window.contains(spot) or clear.intersects(spot):
            continue
        if tags.get("highway") == "street_lamp":
            lamps.append(xy)
            solids.append(f.post(x, y, min(metres(tags.get("height")) or 6.0, 15.0), 0.09))
        elif tags.get("power") == "pole" or tags.get("man_made") in ("utility_pole", "mast", "flagpole"):
            solids.append(f.post(x, y, 8.0, 0.12))
        elif "traffic_sign" in tags or tags.get("highway") in ("stop", "give_way"):
            solids += f.sign(x, y, 0.0)
        elif tags.get("barrier") == "bollard":
            solids.append(f.post(x, y, 0.9, 0.07))
        elif tags.get("amenity") in ("waste_basket", "recycling", "post_box"):
            solids.append(f.litter_bin(x, y))
        elif tags.get("amenity") == "bench":
            solids.append(f.bench(x, y))
    return solids, np.array(lamps).reshape(-1, 2)


def bays(extract: Extract, window: shapely.Geometry, road: shapely.Geometry) -> list[Bay]:
    """Parking spaces (x, y, yaw) within `window`, off `road`."""
    found = []
    for shape, tags in extract.areas:
        if tags.get("amenity") != "parking_space" or not window.contains(shape) or road.intersects(shape):
            continue
        corners = shapely.get_coordinates(shapely.minimum_rotated_rectangle(shape))
        sides = np.diff(corners[:3], axis=0)
        lengths = np.hypot(*sides.T)
        if lengths.max() < 8.0 and lengths.min() > 1.7:
            ahead = sides[lengths.argmax()]
            x, y = (float(c) for c in corners[:4].mean(axis=0))
            found.append((round(x, 3), round(y, 3), round(float(np.arctan2(ahead[1], ahead[0])), 4)))
    return found


_ORIENTATIONS = {"parallel": 0, "diagonal": 45, "perpendicular": 90}
_BESIDE_ROAD = ("lane", "street_side", "on_kerb", "half_on_kerb", "shoulder", "layby")
_FORBIDDEN = ("no_parking", "no_stopping", "no_standing")
_NEAR = 8.0  # m from a lane to its road's line, and to an area of parking beside it
_ALIKE = 0.85  # least cosine between a lane and its road
_EVERY = 2.0  # m between the places where a lane's sides are looked at
_LEAST = 6  # least number of these places with parking; edges with fewer get no strip

Angle = int | None  # degrees between bay and kerb, of `ANGLES`; None: no parking


class Sides(NamedTuple):
    """Parking on both sides of a lane. The kerb is on the right where traffic keeps right."""

    kerb: Angle = None
    inner: Angle = None


@dataclass(frozen=True)
class Parking:
    """Parking: each road's line with the angles left and right of it, and areas beside roads with their angles."""

    roads: tuple[tuple[shapely.LineString, tuple[Angle, Angle]], ...]
    areas: tuple[tuple[shapely.Polygon, int], ...] = ()
    lefthand: bool = False  # traffic keeps left

    def __bool__(self) -> bool:
        return bool(self.areas) or any(angles != (None, None) for _, angles in self.roads)

    def beside(self, lane: shapely.LineString, at: float) -> Sides:
        """Parking on both sides of a lane, `at` m along it."""
        spot, ahead = lane.interpolate(at), _direction(lane, at)
        tagged: tuple[Angle, Angle] = (None, None)
        nearest = _NEAR
        for number in self._tree.query(spot, predicate="dwithin", distance=_NEAR).tolist():
            line, (left, right) = self.roads[number]
            cosine, distance = float(ahead @ _direction(line, line.project(spot))), float(line.distance(spot))
            if distance < nearest and abs(cosine) > _ALIKE:
                tagged, nearest = (left, right) if cosine > 0 else (right, left), distance
        found = list(tagged)
        for side, across in enumerate(_NEAR * np.array([[-ahead[1], ahead[0]], [ahead[1], -ahead[0]]])):
            if found[side] is None:  # the first area on this side
                ray = shapely.LineString([spot, shapely.Point(shapely.get_coordinates(spot)[0] + across)])
                hits = [(float(ray.intersection(shape).distance(spot)), angle) for shape, angle in self.areas]
                found[side] = min((hit for hit in hits if np.isfinite(hit[0])), default=(0.0, None))[1]
        return Sides(*found) if self.lefthand else Sides(*found[::-1])

    @cached_property
    def _tree(self) -> shapely.STRtree:
        return shapely.STRtree([line for line, _ in self.roads])


class _Street(NamedTuple):
    """Edge for motor vehicles; lanes from the kerb inwards."""

    name: str
    lanes: list[ElementTree.Element]
    inner: shapely.LineString  # the innermost lane for motor vehicles
    two_way: bool  # the road's other direction lies beyond it


def find_parking(extract: Extract, kinds: Collection[str], window: shapely.Geometry, *, lefthand: bool) -> Parking:
    """Parking along the roads of `kinds` (highway=...) within `window`."""
    lines = [(shapely.LineString(way.line), way.tags) for way in extract.ways if way.tags.get("highway") in kinds]
    roads = [(line, (_angle(tags, "left"), _angle(tags, "right"))) for line, tags in lines if line.intersects(window)]
    areas = [
        (shape, _ORIENTATIONS.get(tags.get("orientation", ""), 0))
        for shape, tags in extract.areas
        if tags.get("amenity") == "parking" and tags.get("parking") in _BESIDE_ROAD and shape.intersects(window)
    ]
    return Parking(tuple(roads), tuple(areas), lefthand)


def find_parking_strips(network: str, parking: Parking) -> dict[str, Sides]:
    """Angles on both sides of the edges that get strips; the commonest counts. network: in the extract's frame."""
    found = {}
    for street in _streets(network):
        seen = [parking.beside(street.inner, at) for at in np.arange(_EVERY / 2, street.inner.length, _EVERY)]
        kerb, inner = (Counter(sides[k] for sides in seen if sides[k] is not None) for k in (0, 1))
        usual = [angles.most_common(1)[0][0] if angles.total() >= _LEAST else None for angles in (kerb, inner)]
        sides = Sides(usual[0], None if street.two_way else usual[1])
        if sides != Sides():
            found[street.name] = sides
    return found


def widen_network(folder: Path, found: Mapping[str, Sides]) -> list[str]:
    """Options of netconvert for a network with strips."""
    edges, connections = (ElementTree.parse(folder / f"plain.{kind}.xml") for kind in ("edg", "con"))
    first = {str(edge.get("id")): _widen(edge, found.get(str(edge.get("id")), Sides())) for edge in edges.iter("edge")}
    for connection in connections.iter("connection"):
        for end, lane in (("from", "fromLane"), ("to", "toLane")):
            if lane in connection.attrib and int(connection.attrib[lane]) >= first[connection.attrib[end]]:
                connection.set(lane, str(int(connection.attrib[lane]) + 1))
    for crossing in connections.findall("crossing"):  # their outlines are those of the narrower roads
        connections.getroot().remove(crossing)
    edges.write(folder / "wide.edg.xml")
    connections.write(folder / "wide.con.xml")
    files = {"node": "plain.nod", "edge": "wide.edg", "connection": "wide.con", "type": "plain.typ"}
    return [*(f"--{kind}-files={folder / name}.xml" for kind, name in files.items()), "--crossings.guess"]


def find_strip_bays(network: str, parking: Parking) -> list[tuple[float, float, float]]:
    """Bays x, y, yaw on a network's parking strips."""
    found: list[tuple[float, float, float]] = []
    for street in _streets(network):
        inside = False
        for lane in street.lanes:
            inside |= "passenger" in nets.list_users(lane)
            if not nets.list_users(lane):
                angle = min(ANGLES, key=lambda each: abs(ANGLES[each] - float(lane.get("width", "0"))))
                strip, kerb_left = shapely.LineString(nets.parse_shape(lane)), parking.lefthand != inside
                for x, y, yaw in bays_between(strip, angle, kerb_left=kerb_left).tolist():
                    if parking.beside(street.inner, street.inner.project(shapely.Point(x, y)))[inside] == angle:
                        found.append((x, y, yaw))
    return found


def _streets(network: str) -> Iterator[_Street]:
    edges: dict[str, list[ElementTree.Element]] = {}
    for edge, lane in nets.list_lanes(network):
        edges.setdefault(str(edge.get("id")), []).append(lane)
    driven = {name: [lane for lane in lanes if "passenger" in nets.list_users(lane)] for name, lanes in edges.items()}
    for name, lanes in edges.items():
        other = name[1:] if name.startswith("-") else f"-{name}"
        if driven[name] and len(line := nets.parse_shape(driven[name][-1])) > 1:
            yield _Street(name, lanes, shapely.LineString(line), bool(driven.get(other)))


def _widen(edge: ElementTree.Element, sides: Sides) -> int:
    """Give an edge its strips; return the first lane number that moves."""
    lanes = edge.findall("lane") or [ElementTree.Element("lane") for _ in range(int(edge.get("numLanes", "1")))]
    first = next((i for i, lane in enumerate(lanes) if "passenger" in nets.list_users(lane)), 0)
    kerb, inner = (
        [] if angle is None else [ElementTree.Element("lane", disallow="all", width=f"{ANGLES[angle]:.3f}")]
        for angle in sides
    )
    wide = [*lanes[:first], *kerb, *lanes[first:], *inner]
    for lane in edge.findall("lane"):
        edge.remove(lane)
    for index, lane in enumerate(wide):
        lane.set("index", str(index))
        edge.append(lane)
    edge.set("numLanes", str(len(wide)))
    return first if sides.kerb is not None else len(wide)


def _direction(line: shapely.LineString, at: float) -> Float64[np.ndarray, "2"]:
    """Unit vector along a line, `at` m from its start."""
    (ahead,) = np.diff(shapely.get_coordinates(line.interpolate([max(at - 0.5, 0.0), at + 0.5])), axis=0)
    return ahead / max(float(np.hypot(*ahead)), 1e-9)


def _angle(tags: Tags, side: str) -> Angle:
    """Parking angle on one side of a road."""

    def said(key: str, rest: str = "") -> str:
        return (tags.get(f"{key}:{side}{rest}") or tags.get(f"{key}:both{rest}") or "").strip().lower()

    if said("parking", ":restriction") in _FORBIDDEN:
        return None
    if not said("parking"):
        older = said("parking:lane")
        return 0 if older == "marked" else _ORIENTATIONS.get(older)
    parked = said("parking") in (*_BESIDE_ROAD, "yes")
    return _ORIENTATIONS.get(said("parking", ":orientation"), 0) if parked else None
