"""OpenStreetMap extracts in metres around a centre: roads for netconvert, and solids next to them.

Extracts are untidy: ways refer to nodes that were cut off, relations to missing members, values are
free text. Unusable parts are left out; only a file that is no map is refused.
https://wiki.openstreetmap.org/wiki/OSM_XML

`toolkit.sites.osm_rules` reads who may drive where, and how fast; only well-formed tags reach
netconvert. Streets without tagged footways get them by their class. A building's height is its
height tag, else building:levels × 3 m, else the default of its kind. Anything that would be on a
lane is cut off. https://wiki.openstreetmap.org/wiki/Simple_3D_Buildings

Parking along the kerbs of an OpenStreetMap extract: strips next to the lanes of the roads, and bays
on them.

Both tagging schemes are read, parking:SIDE with parking:SIDE:orientation and the older
parking:lane:SIDE, and areas of amenity=parking next to a road. netconvert knows no such strips:
they are put into the plain network that it writes, and it is run again. A strip is between lanes
and footway, also if vehicles park half or all on the kerb.
https://wiki.openstreetmap.org/wiki/Street_parking"""

import bz2
import gzip
import re
import zlib
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, cast
from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.arrays import Float64
from toolkit.geometry import plane_rotation
from toolkit.runtime.text_values import parse_json
from toolkit.sites import furniture as f, network as nets
from toolkit.sites.driving_side import find_driving_side
from toolkit.sites.georeference import inverse_project, project
from toolkit.sites.osm_rules import (
    ACCESS_KEYS,
    ROADS,
    RoadReading,
    RoadRules,
    Tags,
    count_notes,
    describe_barrier,
    is_barred,
    name_types,
    number_lanes,
    number_one_way_lanes,
    number_pieces,
    read_rules,
    restrict_edges,
)
from toolkit.sites.site import Solid
from toolkit.sites.surroundings import BAY_DEPTHS_M, Bay, bays_between

Relation = tuple[list[tuple[str, str]], Tags]  # ways with their roles

MAX_MAP_BYTES = 1 << 26  # of a map that are read
MAX_ELEMENT_TAGS = 200_000
_CHUNK_BYTES = 1 << 20  # read in one go
_MAX_SILENT_BYTES = 1 << 22  # without a tag
_OTHER_KINDS = (".pbf", ".o5m", ".o5c", ".zip", ".7z", ".osc", ".osh", ".geojson", ".shp", ".gpkg")
_SIGNATURES = {
    "OSM PBF": b"OSMHeader",
    "o5m": b"o5m2",
    "a zip file": b"PK\x03\x04",
    "SQLite": b"SQLite format 3",
}
_MAX_LEAP_M = 1e4  # from one node of a road or building to the next
EDGE_MARGIN_DEG = 5e-4  # of a centre beyond the map's bounds that still is in it
_TURN_HOURS = (
    "rules of turning hold for some hours or vehicles only (restriction:conditional), and are "
    "not used"
)
_TURN_UNREAD = "rules of turning lead over ways or lack a part, and are not used"
_TURN_EXCEPT = "rules of turning except some vehicles, but hold for all here"
_GAPS = "roads lack nodes on their way, and are cut there"
_LEAPS = "roads or buildings leap more than 10 km from node to node"
_TWICE = "nodes or ways of one id are there twice: the last one counts"
_BUILT = {"highway", "building"}

_PATHS = ("footway", "path", "pedestrian", "steps", "corridor")
_SIDES = ("both", "left", "right", "no")
_OPPOSITE = {"left": "right", "right": "left"}
# values of highway other than paths that are no road to drive on, and need no note
_NO_ROADS = {
    "construction",
    "proposed",
    "planned",
    "abandoned",
    "razed",
    "disused",
    "platform",
    "elevator",
    "no",
    "dismantled",
    "bus_stop",
    "via_ferrata",
    "demolished",
    "historic",
}
_UNUSED_SERVICE = ("driveway", "parking_aisle", "drive-through")
MIN_RING_M2 = 10.0  # of the ground within a roundabout, or between its arc and the chord
GATE_GAP_M = 0.75  # of road left out on either side of a barrier
_BARRED = "barriers on roads that cars cannot pass, and no vehicle here"
_SIGNS = "stop and give-way signs, not used, as the classes of the roads say who goes first"
_MINI_RINGS = "mini-roundabouts, driven as plain junctions"
_UNUSED_PLACES = {"stop": _SIGNS, "give_way": _SIGNS, "mini_roundabout": _MINI_RINGS}
_RAILS = ("tram", "rail", "light_rail", "narrow_gauge", "subway")
_NO_TRAINS = "tracks of trams and trains, which do not run here"
_DRIVEN_WALKS = "pedestrian streets open to some vehicles, not driven on here"

DEFAULT_HEIGHT_M = 6.0  # of buildings
STOREY_M = 3.0
MAX_END_M = 60.0  # of a long building beyond the window
_NO_BUILDING = ("", "no", "none", "demolished", "entrance")
_BARRIERS = {  # barrier: how to draw it, usual height (m)
    "wall": (f.wall, 1.8),
    "fence": (f.railing, 1.2),
    "hedge": (f.hedge, 1.4),
    "city_wall": (f.wall, 4.0),
    "retaining_wall": (f.wall, 1.0),
    "guard_rail": (f.railing, 0.8),
    "handrail": (f.railing, 1.0),
}

_ORIENTATIONS = {"parallel": 0, "diagonal": 45, "perpendicular": 90}
_BESIDE_ROAD = ("lane", "street_side", "on_kerb", "half_on_kerb", "shoulder", "layby")
_FORBIDDEN = ("no_parking", "no_stopping", "no_standing")
_MAX_PARKING_GAP_M = 8.0  # from a lane to its road's line, and to an area of parking next to it
_MIN_ALIGNMENT = 0.85  # cosine between a lane and its road
_SIDE_STEP_M = 2.0  # between the places at which a lane's sides are examined
_MIN_PARKING_SAMPLES = 6  # of these places with parking; edges with fewer get no strip

Angle = int | None  # degrees between bay and kerb, of `BAY_DEPTHS_M`; None: no parking


@dataclass(frozen=True)
class Way:
    """Line or outline of a map.

    Attributes:
        line: (k, 2) metres.
        nodes: k ids of its nodes.
        tags: its tags.
        name: its id in the map.
        rules: rules of a piece of road."""

    line: Float64[np.ndarray, "k 2"] = field(repr=False)
    nodes: tuple[str, ...]
    tags: Tags
    name: str = ""
    rules: RoadRules | None = None

    @property
    def is_closed(self) -> bool:
        """True if it ends where it begins."""
        return len(self.nodes) > 3 and self.nodes[0] == self.nodes[-1]


class Restriction(NamedTuple):
    """Rule for those who turn at a node.

    Attributes:
        name: id in the map.
        kind: no_left_turn, only_straight_on and so on.
        origin: id of the way before the turn.
        via: id of the node.
        target: id of the way after the turn."""

    name: str
    kind: str
    origin: str
    via: str
    target: str


@dataclass(frozen=True)
class Extract:
    """Map in metres around its centre.

    Attributes:
        centre: longitude, latitude.
        heading: direction of x (rad counter-clockwise from east).
        ways: all ways with two or more known nodes.
        areas: areas with their holes, and their tags.
        places: tagged single points.
        notes: oddities of the map.
        node_tags: tags of nodes by id.
        restrictions: rules of turning."""

    centre: tuple[float, float]
    heading: float
    ways: tuple[Way, ...]
    areas: tuple[tuple[shapely.Polygon, Tags], ...]
    places: tuple[tuple[Float64[np.ndarray, "2"], Tags], ...]
    notes: tuple[str, ...] = ()
    node_tags: Mapping[str, Tags] = field(default_factory=dict, repr=False)
    restrictions: tuple[Restriction, ...] = ()


def read_map(path: Path, centre: tuple[float, float], heading: float = 0.0) -> Extract:
    """Read a map in metres around `centre` (longitude, latitude).

    It is .osm, also .gz or .bz2, or JSON of Overpass.

    heading: direction of x (rad counter-clockwise from east).

    Raises ValueError if the file is of another kind, is damaged, incomplete or empty, or `centre`
    is outside it."""
    points: dict[str, list[float]] = {}
    place_tags: dict[str, Tags] = {}
    bounds: list[list[float]] = []
    raw_ways: dict[str, tuple[list[str], Tags]] = {}
    relations: list[Relation] = []
    restrictions: list[Restriction] = []
    odd = Counter[str]()
    for element in _elements(path):
        tags = {tag.get("k", ""): tag.get("v", "") for tag in element.iter("tag")}
        name = element.get("id", "")
        if element.get("action") == "delete" or element.get("visible") == "false":
            points.pop(name, None) if element.tag == "node" else raw_ways.pop(name, None)
            if element.tag == "node":
                place_tags.pop(name, None)
        elif element.tag == "bounds":
            bounds.append(
                [*_lon_lat(element, "minlon", "minlat"), *_lon_lat(element, "maxlon", "maxlat")]
            )
        elif element.tag == "node":
            lon_lat = _lon_lat(element, "lon", "lat")
            odd["nodes that are no place on earth were left out"] += lon_lat[0] != lon_lat[0]
            odd[_TWICE] += points.get(name, lon_lat) != lon_lat
            if lon_lat[0] == lon_lat[0]:
                points[name] = lon_lat
                if tags:
                    place_tags[name] = tags
        elif element.tag == "way":
            odd[_TWICE] += name in raw_ways
            raw_ways[name] = ([nd.get("ref", "") for nd in element.iter("nd")], tags)
            for nd in element.iter("nd"):  # Overpass, "out geom"
                if nd.get("lat") is not None and nd.get("ref", "") not in points:
                    lon_lat = _lon_lat(nd, "lon", "lat")
                    if lon_lat[0] == lon_lat[0]:
                        points[nd.get("ref", "")] = lon_lat
        elif element.tag == "relation" and tags.get("type") == "multipolygon":
            members = [m for m in element.iter("member") if m.get("type") == "way"]
            relations.append(([(m.get("ref", ""), m.get("role", "")) for m in members], tags))
        elif element.tag == "relation" and tags.get("type", "").startswith("restriction"):
            rules_read, note = _read_restriction(element, tags)
            restrictions += rules_read
            odd[note] += bool(note)
    if not points:
        raise ValueError(f"{path}: the map is empty: it has no node with a latitude and longitude")
    lon_lats = np.array(list(points.values()))
    edges = np.array(bounds) if bounds and np.isfinite(bounds).all() else np.tile(lon_lats, 2)
    low = edges[:, :2].min(axis=0)
    high = edges[:, 2:].max(axis=0)
    if not ((low - EDGE_MARGIN_DEG <= centre) & (centre <= high + EDGE_MARGIN_DEG)).all():
        spans = (
            f"longitude {low[0]:.6g} to {high[0]:.6g} and latitude {low[1]:.6g} to {high[1]:.6g}"
        )
        outside = (
            f"{path}: centre {centre[0]:g} {centre[1]:g} lies outside the map, which spans {spans}"
        )
        raise ValueError(f"{outside}: {_correct_centre(centre, low, high)}")
    positions = project(lon_lats, centre) @ plane_rotation(-heading).T
    position = dict(zip(points, positions, strict=True))
    ways = {}
    for name, (references, way_tags) in raw_ways.items():
        node_runs = [[node for node in references if node in position]]
        if "highway" in way_tags:
            node_runs = _runs(references, position)
        odd[_GAPS] += len(node_runs) > 1
        for k, known_nodes in enumerate(run for run in node_runs if len(run) > 1):
            nodes = [
                node for i, node in enumerate(known_nodes) if i == 0 or node != known_nodes[i - 1]
            ]
            if len(nodes) > 1:
                key = f"{name}~{k}" if k else name
                ways[key] = Way(
                    np.array([position[node] for node in nodes]), tuple(nodes), way_tags, name
                )
                leaps = np.hypot(*np.diff(ways[key].line, axis=0).T).max() > _MAX_LEAP_M
                odd[_LEAPS] += leaps and bool(_BUILT & way_tags.keys())
    places = tuple((position[name], tags) for name, tags in place_tags.items())
    notes = tuple(f"{count} {what}" for what, count in odd.items() if count)
    areas = tuple(_areas(ways, relations))
    return Extract(
        centre, heading, tuple(ways.values()), areas, places, notes, place_tags, tuple(restrictions)
    )


def _correct_centre(centre: tuple[float, float], low: np.ndarray, high: np.ndarray) -> str:
    """Remedy for a centre outside a map that spans from `low` to `high`."""
    swapped = centre[::-1]
    if ((low - EDGE_MARGIN_DEG <= swapped) & (swapped <= high + EDGE_MARGIN_DEG)).all():
        return f"longitude comes first, give --centre {swapped[0]:g} {swapped[1]:g}"
    if abs(centre[0]) > 180 or abs(centre[1]) > 90:
        return (
            "these are no degrees, give --centre LONGITUDE LATITUDE inside it, not metres of a "
            "projection"
        )
    return "give --centre LONGITUDE LATITUDE inside it"


def _runs(references: list[str], positions: Collection[str]) -> list[list[str]]:
    """Parts of a way between nodes that the map lacks."""
    runs: list[list[str]] = [[]]
    for node in references:
        if node in positions:
            runs[-1].append(node)
        elif runs[-1]:
            runs.append([])
    return [run for run in runs if run]


def _read_restriction(element: ElementTree.Element, tags: Tags) -> tuple[list[Restriction], str]:
    """Turns that a relation forbids or prescribes, and a note of unused parts."""
    members: dict[str, list[str]] = {}
    for member in element.iter("member"):
        role = f"{member.get('role')} {member.get('type')}"
        members.setdefault(role, []).append(member.get("ref", ""))
    kind = tags.get("restriction", "").strip().lower()
    if not kind:
        is_timed = any(key.startswith("restriction:") for key in tags)
        return [], _TURN_HOURS if is_timed else _TURN_UNREAD
    via = members.get("via node", [])
    turns = [
        Restriction(element.get("id", ""), kind, origin, via[0], target)
        for origin in members.get("from way", [])
        for target in members.get("to way", [])
        if via
    ]
    if "no_u_turn" in kind or kind == "no_u_turns":
        return [], ""  # nobody turns back on these roads
    if not turns or len(via) > 1 or not kind.startswith(("no_", "only_")):
        return [], _TURN_UNREAD
    return turns, _TURN_EXCEPT if "except" in tags else ""


def metres(text: str | None) -> float | None:
    """Parse a length as mappers write it, the greatest of several.

    None if it is not positive."""
    lengths = []
    for length_text in (text or "").lower().replace(",", ".").split(";"):
        feet = re.fullmatch(
            r"(\d+(?:\.\d+)?)\s*(?:'|ft|feet)\s*(?:(\d+(?:\.\d+)?)\s*(?:\"|''|in)?)?",
            length_text.strip(),
        )
        metric = re.fullmatch(r"~?\s*(\d+(?:\.\d+)?)\s*(?:m|metres?|meters?)?", length_text.strip())
        if feet:
            lengths.append(round(0.3048 * (float(feet[1]) + float(feet[2] or 0) / 12), 4))
        elif metric:
            lengths.append(float(metric[1]))
    return max((length for length in lengths if 0 < length < 1000), default=None)


def _elements(path: Path) -> Iterator[ElementTree.Element]:
    """Yield the file's elements, each released before the next.

    Raises ValueError if the file is no map."""
    name = path.name.lower().removesuffix(".gz").removesuffix(".bz2")
    if name.endswith(_OTHER_KINDS):
        read = "only .osm, .osm.xml and .osm.gz are read, also as .bz2, and JSON of Overpass"
        raise ValueError(f"{path}: {read}: convert it first (osmium cat -o map.osm)")
    try:
        with _open(path) as stream:
            head = stream.read(65536)
        yield from (
            _json_elements(path)
            if head.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] == b"{"
            else _xml_elements(path, head)
        )
    except (ElementTree.ParseError, LookupError) as error:
        raise ValueError(f"{path}: damaged XML ({error}): download the map again") from None
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise ValueError(f"{path}: damaged gzip file ({error}): download the map again") from None


def _open(path: Path) -> BinaryIO:
    with path.open("rb") as stream:
        signature = stream.read(3)
    if signature[:2] == b"\x1f\x8b":
        return cast("BinaryIO", gzip.open(path))
    return cast("BinaryIO", bz2.open(path) if signature == b"BZh" else path.open("rb"))


def _xml_elements(path: Path, head: bytes) -> Iterator[ElementTree.Element]:
    start = re.search(rb"<(?!\?|!)", head)
    kind = next((kind for kind, sign in _SIGNATURES.items() if sign in head[:32]), None)
    if kind is not None:
        raise ValueError(f"{path}: the file is {kind}: convert it first (osmium cat -o map.osm)")
    if (
        start is None
        or not re.match(rb"<osm[\s>]", head[start.start() :])
        or b"<!DOCTYPE" in head[: start.start()]
    ):
        raise ValueError(
            f"{path}: not OpenStreetMap XML (it does not begin with <osm>): export the map as .osm"
        )
    parser: ElementTree.XMLPullParser[ElementTree.Element] = ElementTree.XMLPullParser(
        ("start", "end")
    )
    root: ElementTree.Element | None = None
    # bytes, bytes since the last tag, tags since the last element
    read_bytes = 0
    silent_bytes = 0
    open_tags = 0
    with _open(path) as stream:
        while chunk := stream.read(_CHUNK_BYTES):
            parser.feed(chunk)
            read_bytes = read_bytes + len(chunk)
            silent_bytes = silent_bytes + len(chunk)
            for event, element in cast(
                "Iterable[tuple[str, ElementTree.Element]]", parser.read_events()
            ):
                root = element if root is None else root
                silent_bytes = 0
                open_tags = open_tags + 1
                if event == "end" and element.tag == "remark":
                    _check_remark(path, element.text)
                if event == "end" and element.tag in ("node", "way", "relation", "bounds"):
                    yield element
                    root.clear()
                    open_tags = 0
            if (
                read_bytes > MAX_MAP_BYTES
                or silent_bytes > _MAX_SILENT_BYTES
                or open_tags > MAX_ELEMENT_TAGS
            ):
                limits = (
                    f"{MAX_MAP_BYTES >> 20} MB, {_MAX_SILENT_BYTES >> 20} MB without a tag or "
                    f"{MAX_ELEMENT_TAGS} tags in an element"
                )
                raise ValueError(
                    f"{path}: more than {limits}: cut out the site first (osmium extract --bbox)"
                )
    parser.close()


def _check_remark(path: Path, remark: object) -> None:
    """Raise ValueError if Overpass says that it could not finish."""
    if remark and "error" in str(remark).lower():
        quoted = " ".join(str(remark).split())[:90]
        raise ValueError(
            f"{path}: the map is incomplete ({quoted}): ask Overpass again, for a smaller piece"
        )


def _json_elements(path: Path) -> Iterator[ElementTree.Element]:
    """Elements of Overpass's JSON (https://wiki.openstreetmap.org/wiki/OSM_JSON), in the form of
    XML."""
    with _open(path) as stream:
        content = stream.read(MAX_MAP_BYTES + 1)
    if len(content) > MAX_MAP_BYTES:
        raise ValueError(
            f"{path}: more than {MAX_MAP_BYTES >> 20} MB: cut out the site first (osmium extract "
            "--bbox)"
        )
    try:
        values = parse_json(content.decode("utf-8-sig"))
    except ValueError as error:
        raise ValueError(f"{path}: damaged JSON ({error}): download the map again") from None
    elements = values.get("elements") if isinstance(values, dict) else None
    if not isinstance(elements, list):
        raise ValueError(
            f"{path}: not OpenStreetMap JSON (it has no list of elements): export the map as .osm"
        )
    _check_remark(path, values.get("remark"))
    for row in elements:
        if isinstance(row, dict) and row.get("type") in ("node", "way", "relation"):
            yield _json_element(row)


def _json_element(row: Mapping[str, Any]) -> ElementTree.Element:
    """Element as in XML of an entry of JSON."""
    attributes = {key: str(row[key]) for key in ("id", "lat", "lon", "visible") if key in row}
    if row.get("visible") is False:
        attributes["visible"] = "false"
    element = ElementTree.Element(str(row["type"]), attributes)
    tags = row.get("tags") or ()
    nodes = row.get("nodes") or ()
    positions = row.get("geometry") or ()
    members = row.get("members") or ()
    if isinstance(tags, dict):
        for key, value in tags.items():
            ElementTree.SubElement(element, "tag", {"k": str(key), "v": str(value)})
    for k in range(max(len(nodes), len(positions))):
        position = positions[k] if k < len(positions) and isinstance(positions[k], dict) else {}
        lat_lon = {key: str(position[key]) for key in ("lat", "lon") if key in position}
        ref = str(nodes[k]) if k < len(nodes) else " ".join(lat_lon.values())
        ElementTree.SubElement(element, "nd", {"ref": ref, **lat_lon})
    for member in members:
        if isinstance(member, dict):
            attributes_of_member = {
                key: str(member.get(key, "")) for key in ("type", "ref", "role")
            }
            ElementTree.SubElement(element, "member", attributes_of_member)
    return element


def _lon_lat(element: ElementTree.Element, lon: str, lat: str) -> list[float]:
    """Longitude and latitude in two attributes, NaN if they are no place on earth."""
    try:
        longitude = float(element.get(lon, "nan"))
        latitude = float(element.get(lat, "nan"))
    except ValueError:
        return [np.nan, np.nan]
    is_on_earth = abs(longitude) <= 180 and abs(latitude) < 90
    return [longitude, latitude] if is_on_earth else [np.nan, np.nan]


def _areas(
    ways: Mapping[str, Way], relations: list[Relation]
) -> Iterator[tuple[shapely.Polygon, Tags]]:
    """Areas of closed ways and of multipolygons, with their tags."""
    for way in ways.values():
        if way.is_closed and (way.tags.get("highway") is None or way.tags.get("area") == "yes"):
            for polygon in _valid(shapely.Polygon(way.line)):
                yield polygon, way.tags
    for members, tags in relations:
        parts = [(ways[name], role) for name, role in members if name in ways]
        outer = _rings(way for way, role in parts if role != "inner")
        inner = _rings(way for way, role in parts if role == "inner")
        area_tags = dict(tags)
        if parts and "building" not in tags and "building:part" not in tags:
            area_tags = {**parts[0][0].tags, **tags}
        for polygon in _valid(outer.difference(inner)):
            yield polygon, dict(area_tags)


def _rings(ways: Iterable[Way]) -> shapely.Geometry:
    """Ground enclosed by rings, which may be made of several ways."""
    lines = [shapely.LineString(way.line) for way in ways]
    rings = shapely.get_parts(shapely.polygonize(lines))
    return shapely.union_all([shapely.Polygon(ring.exterior) for ring in rings])


def _valid(shape: shapely.Geometry) -> list[shapely.Polygon]:
    """Polygons of more than 0.1 m² in a shape that may cross itself."""
    return [piece for piece in nets.list_polygons(shapely.make_valid(shape)) if piece.area > 0.1]


def roads(
    extract: Extract, window: shapely.Geometry, *, lefthand: bool = False
) -> tuple[list[Way], list[str]]:
    """Roads for vehicles within `window`, cut at its edge and at barriers, and notes.

    They have the tags meant for netconvert, and their rules. Tunnels and bridges over another road
    are left out and noted."""
    reaching = [way for way in extract.ways if "highway" in way.tags and _reaches(way, window)]
    near_roads = [way for way in reaching if _is_road(way.tags)]
    surface_roads = [way for way in near_roads if not _below(way.tags)]
    level_roads = [way for way in surface_roads if not _is_off_ground(way.tags)]
    road_ways = [way for way in surface_roads if not _crosses_over(way, level_roads)]
    notes = []
    if len(near_roads) > len(road_ways):
        crossing = len(near_roads) - len(road_ways)
        notes.append(f"{crossing} tunnels or bridges over a road were left out")
    single_roads = _drop_doubled(road_ways)
    if len(road_ways) > len(single_roads):
        doubled = len(road_ways) - len(single_roads)
        notes.append(f"{doubled} roads that are in the map twice were left out")
    road_ways = single_roads
    notes += _describe_crossings(road_ways)
    readings = [read_rules(way.tags) for way in road_ways]
    barred_nodes = _list_barred(road_ways, extract.node_tags)
    unused_rules = [note for reading in readings for note in reading.notes]
    unused_rules += [_BARRED for way in road_ways for node in way.nodes if node in barred_nodes]
    for node in _list_tagged(road_ways, extract.node_tags):
        unused_rules += describe_barrier(extract.node_tags[node])
    unused_rules += [_DRIVEN_WALKS for way in reaching if _is_driven_walk(way.tags)]
    unused_rules += _list_unused_places(extract, window)
    notes += count_notes(unused_rules)
    notes += _describe_unused(reaching)
    notes += _describe_rings(road_ways, lefthand=lefthand)
    pieces: list[Way] = []
    for way, reading in zip(road_ways, readings, strict=True):
        for stretch in _split_way(way, barred_nodes):
            pieces += _cut(stretch, window, reading, lefthand=lefthand)
    rules = number_pieces(cast("RoadRules", piece.rules) for piece in pieces)
    return [replace(piece, rules=rule) for piece, rule in zip(pieces, rules, strict=True)], notes


def _crosses_over(way: Way, level_roads: Iterable[Way]) -> bool:
    """True for a way off the ground that crosses a road on the ground."""
    return _is_off_ground(way.tags) and any(_crosses(way, road) for road in level_roads)


def _drop_doubled(ways: Iterable[Way]) -> list[Way]:
    """Roads without those that run along others from their first node to their last."""
    seen_steps: set[frozenset[str]] = set()
    single_roads: list[Way] = []
    for way in ways:
        steps = {frozenset(step) for step in pairwise(way.nodes)}
        if not steps <= seen_steps:
            single_roads.append(way)
        seen_steps |= steps
    return single_roads


def _describe_crossings(ways: Sequence[Way]) -> list[str]:
    """Note of roads that cross without a node in common, at which traffic does not give way."""
    if not ways:
        return []
    lines = [shapely.LineString(way.line) for way in ways]
    pairs = shapely.STRtree(lines).query(lines, predicate="crosses").T.tolist()
    crossing = [(a, b) for a, b in pairs if a < b and _crosses(ways[a], ways[b])]
    if not crossing:
        return []
    return [
        (
            "roads that cross without a junction in the map, and drive through each other: "
            f"{len(crossing)}"
        )
    ]


def _list_barred(ways: Iterable[Way], node_tags: Mapping[str, Tags]) -> set[str]:
    """Nodes of ways that no car can pass."""
    return {node for node in _list_tagged(ways, node_tags) if is_barred(node_tags[node])}


def _list_tagged(ways: Iterable[Way], node_tags: Mapping[str, Tags]) -> set[str]:
    """Nodes of ways that have tags."""
    return {node for way in ways for node in way.nodes if node in node_tags}


def _list_unused_places(extract: Extract, window: shapely.Geometry) -> list[str]:
    """Notes of signs, small roundabouts and rails within `window`, which traffic does not heed."""
    notes: list[str] = []
    for spot, tags in extract.places:
        note = _UNUSED_PLACES.get(tags.get("highway", ""))
        if note is not None and shapely.intersects_xy(window, *spot):
            notes.append(note)
    rails = [
        way for way in extract.ways if way.tags.get("railway") in _RAILS and not _below(way.tags)
    ]
    return notes + [_NO_TRAINS for way in rails if _reaches(way, window)]


def describe_roadless(extract: Extract, window: shapely.Geometry) -> str:
    """Describe a window without roads: the map's other ways there, and its nearest road."""
    ways = [way for way in extract.ways if "highway" in way.tags]
    kinds = Counter(way.tags["highway"][:30] for way in ways if _reaches(way, window))
    covered = sum(_is_road(way.tags) and _below(way.tags) for way in ways if _reaches(way, window))
    kind_counts = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common(4))
    facts = [f"there is {kind_counts}" if kind_counts else "nothing is tagged highway there"]
    facts += [f"{covered} in tunnels"] if covered else []
    lines = [
        shapely.LineString(way.line) for way in ways if _is_road(way.tags) and not _below(way.tags)
    ]
    outer_lines = [line for line in lines if not line.intersects(window)]
    if outer_lines:
        middle = shapely.Point(0.0, 0.0)
        nearest = min(outer_lines, key=middle.distance)
        nearest_point = shapely.get_coordinates(shapely.shortest_line(middle, nearest))[1:]
        ((longitude, latitude),) = inverse_project(
            nearest_point @ plane_rotation(extract.heading).T, extract.centre
        )
        facts.append(
            f"the nearest road is {middle.distance(nearest):.0f} m away, at {longitude:.5f} "
            f"{latitude:.5f}"
        )
    return "; ".join(facts)


def choose_side(
    extract: Extract, window: shapely.Geometry, lefthand: bool | None
) -> tuple[bool, list[str]]:
    """True if traffic keeps left, and notes. lefthand: as it is asked for; None for what the map's
    roads say (driving_side), or else the place on earth."""
    near = [
        way.tags
        for way in extract.ways
        if way.tags.get("highway") in ROADS and _reaches(way, window)
    ]
    tagged = Counter(
        tags["driving_side"] for tags in near if tags.get("driving_side") in ("left", "right")
    )
    if lefthand is not None:
        against = tagged["right" if lefthand else "left"]
        note = (
            f"traffic keeps {_name_side(lefthand)}, as asked; roads that say otherwise "
            f"(driving_side): {against}"
        )
        return lefthand, [note] if against else []
    if tagged:
        is_left = tagged["left"] > tagged["right"]
        against = min(tagged["left"], tagged["right"])
        note = f"traffic keeps {_name_side(is_left)}, as its roads say (driving_side)"
        more = f"; roads that say otherwise: {against}, give --lefthand or --righthand"
        return is_left, [note + more if against else note]
    is_left, is_near_border = find_driving_side(*extract.centre)
    remedy = f"give {'--righthand' if is_left else '--lefthand'} if it is wrong"
    if is_near_border:
        return is_left, [
            f"traffic keeps {_name_side(is_left)}, but a border to the other side is near: {remedy}"
        ]
    return is_left, [f"traffic keeps left, as in this country: {remedy}"] if is_left else []


def _name_side(is_left: bool) -> str:
    return "left" if is_left else "right"


def _reaches(way: Way, window: shapely.Geometry) -> bool:
    return bool(shapely.LineString(way.line).intersects(window))


def _is_road(tags: Tags) -> bool:
    return (
        tags.get("highway") in ROADS
        and tags.get("area") != "yes"
        and tags.get("service") not in _UNUSED_SERVICE
    )


def _is_driven_walk(tags: Tags) -> bool:
    opened = {"yes", "designated", "destination", "permissive", "delivery"}
    return tags.get("highway") == "pedestrian" and any(
        tags.get(key) in opened for key in ACCESS_KEYS - {"access", "bicycle"}
    )


def _describe_unused(ways: Iterable[Way]) -> list[str]:
    """Note of ways that are driven on by their name but are no roads here."""
    unused = Counter[str]()
    for way in ways:
        tags = way.tags
        kind = tags["highway"]
        if kind in ROADS and tags.get("area") == "yes":
            unused["paved area"] += 1
        elif kind in ROADS and tags.get("service") in _UNUSED_SERVICE:
            unused[tags["service"]] += 1
        elif kind not in ROADS and kind not in _PATHS and kind not in _NO_ROADS:
            unused[kind[:30]] += 1
    listed = ", ".join(f"{count} {kind}" for kind, count in unused.most_common(6))
    more = f" and {len(unused) - 6} kinds more" if len(unused) > 6 else ""
    return [f"no roads are made of: {listed}{more}"] if unused else []


def _describe_rings(ways: Iterable[Way], *, lefthand: bool) -> list[str]:
    """Note of roundabouts that run against the side that traffic keeps to."""
    arcs = [way for way in ways if way.tags.get("junction") in ("roundabout", "circular")]
    driven = []
    for way in arcs:
        is_reversed = way.tags.get("oneway") in ("-1", "reverse")
        driven.append(way.line[::-1] if is_reversed else way.line)
    # rings may be made of several ways
    chains = shapely.line_merge(shapely.MultiLineString(driven), directed=True)
    corners = (shapely.get_coordinates(chain) for chain in shapely.get_parts(chains))
    rings = [shapely.LinearRing(points) for points in corners if len(points) > 2]
    wide_rings = [ring for ring in rings if shapely.Polygon(ring).area > MIN_RING_M2]
    against = sum(ring.is_ccw == lefthand for ring in wide_rings)
    if not against:
        return []
    note = f"roundabouts that run against traffic that keeps {_name_side(lefthand)}: {against}"
    return [f"{note}; give {'--righthand' if lefthand else '--lefthand'} if it is wrong"]


def _split_way(way: Way, barred: Collection[str]) -> Iterator[Way]:
    """Parts of a way between barriers, which keep `GATE_GAP_M` off them."""
    nodes: list[str] = []
    line: list[np.ndarray] = []
    for k, node in enumerate(way.nodes):
        xy = way.line[k]
        if node not in barred:
            nodes.append(node)
            line.append(xy)
            continue
        if line:
            nodes.append(f"{node}_before")
            line.append(_step_back(xy, way.line[k - 1]))
            yield from _part(way, nodes, line)
        nodes = []
        line = []
        if k + 1 < len(way.nodes):
            nodes.append(f"{node}_after")
            line.append(_step_back(xy, way.line[k + 1]))
    yield from _part(way, nodes, line)


def _part(way: Way, nodes: list[str], line: list[np.ndarray]) -> Iterator[Way]:
    """Part of a way, if it has two nodes or more."""
    if len(nodes) > 1:
        yield replace(way, nodes=tuple(nodes), line=np.array(line))


def _step_back(barrier: np.ndarray, neighbour: np.ndarray) -> np.ndarray:
    """Place on the way to a neighbour, a little off a barrier."""
    distance = max(float(np.hypot(*(neighbour - barrier))), 1e-9)
    return barrier + (neighbour - barrier) * min(GATE_GAP_M / distance, 0.4)


def paths(extract: Extract, window: shapely.Geometry) -> list[shapely.Polygon]:
    """Footways and squares within `window` that belong to no road."""
    squares = {"pedestrian", "footway"}
    areas = [
        shape
        for shape, tags in extract.areas
        if {tags.get("highway"), tags.get("area:highway")} & squares
    ]
    shapes: list[shapely.Geometry] = [*areas]
    for way in extract.ways:
        is_area = way.is_closed and way.tags.get("area") == "yes"
        if (
            way.tags.get("highway") in _PATHS
            and not is_area
            and not _below(way.tags)
            and not _above(way.tags)
        ):
            width = np.clip(metres(way.tags.get("width")) or 2.0, 1.0, 10.0)
            shapes.append(
                shapely.LineString(way.line).buffer(width / 2, cap_style="flat", quad_segs=2)
            )
    inside = (shape.intersection(window) for shape in shapes if shape.intersects(window))
    return [polygon for shape in inside for polygon in nets.list_polygons(shape)]


def write_osm(pieces: Iterable[Way], extract: Extract) -> str:
    """Format `pieces` as OSM XML."""
    pieces = list(pieces)
    position: dict[str, np.ndarray] = {}
    for way in pieces:
        position.update(zip(way.nodes, way.line, strict=True))
    points = np.array(list(position.values())).reshape(-1, 2)
    degrees = inverse_project(points @ plane_rotation(extract.heading).T, extract.centre)
    types = name_types(cast("RoadRules", piece.rules) for piece in pieces)
    signals = {
        tuple(xy.round(3))
        for xy, tags in extract.places
        if tags.get("highway") == "traffic_signals"
    }
    text = ['<osm version="0.6">']
    number = {node: i for i, node in enumerate(position, start=1)}
    for (node, xy), (longitude, latitude) in zip(position.items(), degrees, strict=True):
        tag = '<tag k="highway" v="traffic_signals"/>' if tuple(xy.round(3)) in signals else ""
        text.append(
            f'<node id="{number[node]}" lon="{longitude:.9f}" lat="{latitude:.9f}">{tag}</node>'
        )
    for way_number, way in enumerate(pieces, start=1):
        inside = "".join(f'<nd ref="{number[node]}"/>' for node in way.nodes)
        tags = {**way.tags, "highway": types[cast("RoadRules", way.rules)]}
        inside += "".join(
            nets.format_element("tag", {"k": key, "v": value}) for key, value in tags.items()
        )
        text.append(nets.format_element("way", {"id": way_number}, inside))
    text += _format_restrictions(pieces, number, extract.restrictions)
    return "\n".join([*text, "</osm>\n"])


def _format_restrictions(
    pieces: list[Way], number: Mapping[str, int], restrictions: Iterable[Restriction]
) -> Iterator[str]:
    """OSM relations of the turns between pieces."""
    ends: dict[tuple[str, str], list[int]] = {}  # numbers of the pieces of a way at a node
    for k, piece in enumerate(pieces, start=1):
        for node in piece.nodes:
            ends.setdefault((piece.name, node), []).append(k)
    for r, turn in enumerate(restrictions, start=1):
        # named as in the map, for netconvert's warnings
        name = turn.name if re.fullmatch(r"\d{1,15}", turn.name, re.ASCII) else r
        for origin in ends.get((turn.origin, turn.via), ()):
            for target in ends.get((turn.target, turn.via), ()):
                rows: list[tuple[str, nets.XmlAttributes]] = [
                    ("member", {"type": "way", "ref": origin, "role": "from"}),
                    ("member", {"type": "node", "ref": number[turn.via], "role": "via"}),
                    ("member", {"type": "way", "ref": target, "role": "to"}),
                    ("tag", {"k": "type", "v": "restriction"}),
                    ("tag", {"k": "restriction", "v": turn.kind}),
                ]
                inside = "".join(nets.format_element(tag, row) for tag, row in rows)
                yield nets.format_element("relation", {"id": name}, inside)


def _below(tags: Tags) -> bool:
    layer = re.fullmatch(r"\s*([+-]?\d{1,3})\s*", tags.get("layer", "0"))
    sunk = layer is not None and int(layer[1]) < 0 and "tunnel" in tags
    if tags.get("location") in ("underground", "indoor") or tags.get("indoor", "no") not in (
        "no",
        "area",
    ):
        return True
    return sunk or tags.get("tunnel", "no") not in ("no", "building_passage")


def _above(tags: Tags) -> bool:
    return tags.get("bridge", "no") != "no"


def _is_off_ground(tags: Tags) -> bool:
    """True for a bridge, and for a road of another layer than the ground's."""
    layer = re.fullmatch(r"\s*([+-]?\d{1,3})\s*", tags.get("layer", "0"))
    return _above(tags) or (layer is not None and int(layer[1]) != 0)


def _crosses(bridge: Way, road: Way) -> bool:
    crossing = shapely.LineString(bridge.line).intersection(shapely.LineString(road.line))
    shared = [xy for node, xy in zip(bridge.nodes, bridge.line, strict=True) if node in road.nodes]
    return not crossing.difference(
        shapely.MultiPoint(shared).buffer(0.5) if shared else shapely.Polygon()
    ).is_empty


def _cut(
    way: Way, window: shapely.Geometry, reading: RoadReading, *, lefthand: bool
) -> Iterator[Way]:
    tags = _road_tags(way.tags, reading, lefthand=lefthand)
    step = -1 if reading.oneway == "-1" else 1
    line = way.line[::step]
    nodes = way.nodes[::step]
    pieces: list[list[tuple[str, np.ndarray]]] = [[]]  # nodes and points
    for (start, end), (first_node, last_node) in zip(pairwise(line), pairwise(nodes), strict=True):
        inside = shapely.LineString([start, end]).intersection(window)
        if inside.geom_type != "LineString" or inside.is_empty:
            continue
        end_points = shapely.get_coordinates(inside)
        end_points = end_points[np.argsort(np.hypot(*(end_points - start).T))]
        entry = end_points[0]
        if np.hypot(*(entry - start)) < 1e-6:
            entry_name = first_node
        else:
            entry_name = f"{first_node}_{last_node}_in"
            if pieces[-1]:
                pieces.append([])
        if not pieces[-1] or pieces[-1][-1][0] != entry_name:
            pieces[-1].append((entry_name, entry))
        leaves = np.hypot(*(end_points[-1] - end)) >= 1e-6
        exit_name = f"{first_node}_{last_node}_out" if leaves else last_node
        if pieces[-1][-1][0] != exit_name:
            pieces[-1].append((exit_name, end_points[-1]))
        if leaves:
            pieces.append([])
    for piece in pieces:
        if len(piece) > 1:
            points = np.array([xy for _, xy in piece])
            names = tuple(name for name, _ in piece)
            yield Way(points, names, tags, way.name, reading.rules)


def _road_tags(tags: Tags, reading: RoadReading, *, lefthand: bool) -> dict[str, str]:
    """Tags of a road meant for netconvert."""
    kind = tags["highway"]
    junction = tags.get("junction", "").strip().lower()
    if reading.oneway == "no":
        passed = {"oneway": "no", **number_lanes(tags)}
    else:
        passed = {"oneway": "yes", **number_one_way_lanes(tags, reading.oneway)}
    usual = "both"
    if junction in ("roundabout", "circular"):
        passed["junction"] = junction
        usual = "left" if lefthand else "right"
    walked = (
        ROADS[kind][3]
        and tags.get("foot") not in ("no", "use_sidepath")
        and tags.get("motorroad") != "yes"
    )
    tagged = _sidewalk(tags, usual if walked else "no")
    if reading.oneway == "-1" and tagged in _OPPOSITE:  # its line is turned round
        tagged = _OPPOSITE[tagged]
    side = tagged or (usual if walked else "no")
    street = {"name": " ".join(tags["name"].split())[:60]} if tags.get("name", "").strip() else {}
    return {"highway": kind, **passed, "sidewalk": side, **street}


def _sidewalk(tags: Tags, usual: str) -> str | None:
    """Footways along a road: both, left, right or no; None if unknown.

    usual: footways along roads of its class."""
    plain = tags.get("sidewalk", "")
    if plain in _SIDES or plain in ("none", "yes", "separate"):
        return {"none": "no", "yes": "both", "separate": "both"}.get(plain, plain)
    has = [
        side
        for side in ("both", "left", "right")
        if tags.get(f"sidewalk:{side}") in ("yes", "separate")
    ]
    if has:
        return "both" if "both" in has or len(has) == 2 else has[0]
    lacks = {
        side for side in ("both", "left", "right") if tags.get(f"sidewalk:{side}") in ("no", "none")
    }
    if "both" in lacks or {"left", "right"} <= lacks:
        return "no"
    return _OPPOSITE[lacks.pop()] if lacks and usual == "both" else None


def buildings(
    extract: Extract, window: shapely.Geometry, road: shapely.Geometry
) -> tuple[list[Solid], list[str]]:
    """Buildings that reach into `window`, cut off at `road`, and notes.

    A building with parts (building:part) is made of them, and of the rest of its outline."""
    near_areas = [(shape, tags) for shape, tags in extract.areas if shape.intersects(window)]
    parts = [
        (shape, tags)
        for shape, tags in near_areas
        if tags.get("building:part", "") not in _NO_BUILDING
    ]
    covered = shapely.union_all([shape for shape, _ in parts])
    undivided = [
        (shape.difference(covered), tags)
        for shape, tags in near_areas
        if tags.get("building", "") not in _NO_BUILDING
        and tags.get("location") != "underground"
        and not tags.get("layer", "0").strip().startswith("-")
    ]
    solids = []
    cut_count = 0
    reach = window.buffer(MAX_END_M)
    for shape, tags in parts + undivided:
        storeys = metres(tags.get("building:levels"))
        top = metres(tags.get("height")) or metres(tags.get("building:height"))
        top = top or (storeys * STOREY_M if storeys else DEFAULT_HEIGHT_M)
        base = metres(tags.get("min_height"))
        base = base or (metres(tags.get("building:min_level")) or 0.0) * STOREY_M
        if tags.get("building") == "roof" and not base:
            base = top - 0.5
        if not base < top - 0.1:
            base = 0.0
        off_road = shape.difference(road)
        cut_count += bool(shape.area - off_road.area > 0.1)
        rings = [
            ring
            for ring in nets.cut_polygons([off_road], reach)
            if shapely.Polygon(ring).area > 1.0
        ]
        solids += [Solid(ring, base, top, "building") for ring in rings]
    if not cut_count:
        return solids, []
    return solids, [f"{cut_count} buildings reached over a road and were cut back to its edge"]


def barriers(extract: Extract, window: shapely.Geometry, road: shapely.Geometry) -> list[Solid]:
    """Walls, fences and hedges within `window`, off `road`."""
    solids: list[Solid] = []
    for way in extract.ways:
        draw, default_height = _BARRIERS.get(way.tags.get("barrier", ""), (None, 0.0))
        if draw is None:
            continue
        height = min(metres(way.tags.get("height")) or default_height, 10.0)
        line = shapely.LineString(way.line).intersection(window).difference(road.buffer(0.5))
        if line.geom_type == "MultiLineString":
            line = shapely.line_merge(line)
        for line_part in shapely.get_parts(line):
            piece = line_part.simplify(0.05)
            if piece.geom_type == "LineString" and piece.length > 0.5:
                solids += draw([(float(x), float(y)) for x, y in piece.coords], height)
    return solids


def trees(extract: Extract, window: shapely.Geometry, road: shapely.Geometry) -> list[Solid]:
    """Single trees and rows of trees within `window`.

    Crowns keep off `road`; trees too near it are left out."""
    tree_places = [(xy, tags) for xy, tags in extract.places if tags.get("natural") == "tree"]
    for way in extract.ways:
        if way.tags.get("natural") == "tree_row":
            line = shapely.LineString(way.line)
            spots = line.interpolate(np.arange(0.0, line.length, 8.0))
            tree_places += [(xy, way.tags) for xy in shapely.get_coordinates(spots)]
    solids: list[Solid] = []
    for (x, y), tags in tree_places:
        road_gap = road.distance(shapely.Point(x, y)) - 0.1
        crown = min((metres(tags.get("diameter_crown")) or 4.0) / 2, road_gap, 6.0)
        if crown > 0.5 and window.contains(shapely.Point(x, y)):
            height = float(np.clip(metres(tags.get("height")) or 7.0, 2.0, 40.0))
            solids += f.tree(float(x), float(y), height, crown, min(2.3, 0.4 * height))
    return solids


def furniture(
    extract: Extract, window: shapely.Geometry, road: shapely.Geometry
) -> tuple[list[Solid], np.ndarray]:
    """Posts, signs, bins and benches off `road`, and (n, 2) street lamps."""
    solids: list[Solid] = []
    lamps: list[np.ndarray] = []
    clear = road.buffer(0.4)
    for xy, tags in extract.places:
        spot = shapely.Point(xy)
        x = float(xy[0])
        y = float(xy[1])
        if not window.contains(spot) or clear.intersects(spot):
            continue
        if tags.get("highway") == "street_lamp":
            lamps.append(xy)
            solids.append(f.post(x, y, min(metres(tags.get("height")) or 6.0, 15.0), 0.09))
        elif tags.get("power") == "pole" or tags.get("man_made") in (
            "utility_pole",
            "mast",
            "flagpole",
        ):
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
    parking_bays = []
    for shape, tags in extract.areas:
        if (
            tags.get("amenity") != "parking_space"
            or not window.contains(shape)
            or road.intersects(shape)
        ):
            continue
        corners = shapely.get_coordinates(shapely.minimum_rotated_rectangle(shape))
        sides = np.diff(corners[:3], axis=0)
        lengths = np.hypot(*sides.T)
        if lengths.max() < 8.0 and lengths.min() > 1.7:
            ahead = sides[lengths.argmax()]
            x, y = corners[:4].mean(axis=0).tolist()
            yaw = float(np.arctan2(ahead[1], ahead[0]))
            parking_bays.append((round(x, 3), round(y, 3), round(yaw, 4)))
    return parking_bays


class Sides(NamedTuple):
    """Parking on both sides of a lane. The kerb is on the right if traffic keeps right."""

    kerb: Angle = None
    inner: Angle = None


@dataclass(frozen=True)
class Parking:
    """Parking along roads.

    Attributes:
        roads: line of each road, and the angles left and right of it.
        areas: areas next to roads, and their angles.
        lefthand: True if traffic keeps left."""

    roads: tuple[tuple[shapely.LineString, tuple[Angle, Angle]], ...]
    areas: tuple[tuple[shapely.Polygon, int], ...] = ()
    lefthand: bool = False

    def __bool__(self) -> bool:
        return bool(self.areas) or any(angles != (None, None) for _, angles in self.roads)

    def beside(self, lane: shapely.LineString, at: float) -> Sides:
        """Parking on both sides of a lane, `at` m along it."""
        spot = lane.interpolate(at)
        ahead = _direction(lane, at)
        left: Angle = None
        right: Angle = None
        nearest = _MAX_PARKING_GAP_M
        near_roads = self._tree.query(spot, predicate="dwithin", distance=_MAX_PARKING_GAP_M)
        for number in near_roads.tolist():
            line, angles = self.roads[number]
            cosine = float(ahead @ _direction(line, line.project(spot)))
            distance = float(line.distance(spot))
            if distance < nearest and abs(cosine) > _MIN_ALIGNMENT:
                left, right = angles if cosine > 0 else angles[::-1]
                nearest = distance
        to_left = _MAX_PARKING_GAP_M * np.array([-ahead[1], ahead[0]])
        if left is None:
            left = self._find_area(spot, to_left)
        if right is None:
            right = self._find_area(spot, -to_left)
        return Sides(left, right) if self.lefthand else Sides(right, left)

    def _find_area(self, spot: shapely.Point, across: Float64[np.ndarray, "2"]) -> Angle:
        """Angle of the first area of parking from a spot along a vector."""
        ray = shapely.LineString([spot, shapely.Point(shapely.get_coordinates(spot)[0] + across)])
        hits = [
            (float(ray.intersection(shape).distance(spot)), angle) for shape, angle in self.areas
        ]
        return min((hit for hit in hits if np.isfinite(hit[0])), default=(0.0, None))[1]

    @cached_property
    def _tree(self) -> shapely.STRtree:
        return shapely.STRtree([line for line, _ in self.roads])


class _Street(NamedTuple):
    """Edge for motor vehicles.

    Attributes:
        name: id of the edge.
        lanes: its lanes from the kerb inwards.
        inner: innermost lane for motor vehicles.
        two_way: True if the road's other direction is beyond it."""

    name: str
    lanes: list[ElementTree.Element]
    inner: shapely.LineString
    two_way: bool


def find_parking(
    extract: Extract, kinds: Collection[str], window: shapely.Geometry, *, lefthand: bool
) -> Parking:
    """Parking along the roads of `kinds` (highway=...) within `window`."""
    lines = [
        (shapely.LineString(way.line), way.tags)
        for way in extract.ways
        if way.tags.get("highway") in kinds
    ]
    roads = [
        (line, (_angle(tags, "left"), _angle(tags, "right")))
        for line, tags in lines
        if line.intersects(window)
    ]
    areas = [
        (shape, _ORIENTATIONS.get(tags.get("orientation", ""), 0))
        for shape, tags in extract.areas
        if tags.get("amenity") == "parking"
        and tags.get("parking") in _BESIDE_ROAD
        and shape.intersects(window)
    ]
    return Parking(tuple(roads), tuple(areas), lefthand)


def find_parking_strips(network: str, parking: Parking) -> dict[str, Sides]:
    """Angles on both sides of the edges that get strips; the commonest counts.

    network: in the extract's frame."""
    strips = {}
    for street in _streets(network):
        stations = np.arange(_SIDE_STEP_M / 2, street.inner.length, _SIDE_STEP_M)
        samples = [parking.beside(street.inner, at) for at in stations]
        kerb = _find_commonest([sample.kerb for sample in samples])
        inner = _find_commonest([sample.inner for sample in samples])
        sides = Sides(kerb, None if street.two_way else inner)
        if sides != Sides():
            strips[street.name] = sides
    return strips


def _find_commonest(samples: Iterable[Angle]) -> Angle:
    """Commonest angle of samples along a lane; None if too few have parking."""
    angles = Counter(angle for angle in samples if angle is not None)
    if angles.total() < _MIN_PARKING_SAMPLES:
        return None
    return angles.most_common(1)[0][0]


def restrict_network(folder: Path, types: Mapping[RoadRules, str]) -> None:
    """Give the plain edges that netconvert wrote the rules of their direction."""
    edges = ElementTree.parse(folder / "plain.edg.xml")
    restrict_edges(edges.iter("edge"), types)
    edges.write(folder / "plain.edg.xml")


def widen_network(folder: Path, strips: Mapping[str, Sides]) -> list[str]:
    """Options of netconvert for a network with strips."""
    edges = ElementTree.parse(folder / "plain.edg.xml")
    connections = ElementTree.parse(folder / "plain.con.xml")
    first_lanes = {}
    for edge in edges.iter("edge"):
        name = str(edge.get("id"))
        first_lanes[name] = _widen(edge, strips.get(name, Sides()))
    for connection in connections.iter("connection"):
        for end, lane in (("from", "fromLane"), ("to", "toLane")):
            if (
                lane in connection.attrib
                and int(connection.attrib[lane]) >= first_lanes[connection.attrib[end]]
            ):
                connection.set(lane, str(int(connection.attrib[lane]) + 1))
    # their outlines belong to the narrower roads
    for crossing in connections.findall("crossing"):
        connections.getroot().remove(crossing)
    edges.write(folder / "wide.edg.xml")
    connections.write(folder / "wide.con.xml")
    return [
        f"--node-files={folder / 'plain.nod'}.xml",
        f"--edge-files={folder / 'wide.edg'}.xml",
        f"--connection-files={folder / 'wide.con'}.xml",
        f"--type-files={folder / 'plain.typ'}.xml",
        "--crossings.guess",
    ]


def find_strip_bays(network: str, parking: Parking) -> list[tuple[float, float, float]]:
    """Bays x, y, yaw on a network's parking strips."""
    strip_bays: list[tuple[float, float, float]] = []
    for street in _streets(network):
        inside = False
        for lane in street.lanes:
            inside |= "passenger" in nets.list_users(lane)
            if nets.list_users(lane):
                continue
            angle = _match_angle(float(lane.get("width", "0")))
            strip = shapely.LineString(nets.parse_shape(lane))
            kerb_left = parking.lefthand != inside
            for x, y, yaw in bays_between(strip, angle, kerb_left=kerb_left).tolist():
                sides = parking.beside(street.inner, street.inner.project(shapely.Point(x, y)))
                if (sides.inner if inside else sides.kerb) == angle:
                    strip_bays.append((x, y, yaw))
    return strip_bays


def _match_angle(width: float) -> int:
    """Angle of bays on a strip of about `width` (m)."""
    return min(BAY_DEPTHS_M, key=lambda angle: abs(BAY_DEPTHS_M[angle] - width))


def _streets(network: str) -> Iterator[_Street]:
    """Edges of a network with a lane for motor vehicles."""
    edges: dict[str, list[ElementTree.Element]] = {}
    driven: dict[str, list[ElementTree.Element]] = {}
    for edge, lane in nets.list_lanes(network):
        name = str(edge.get("id"))
        edges.setdefault(name, []).append(lane)
        if "passenger" in nets.list_users(lane):
            driven.setdefault(name, []).append(lane)
    for name, lanes in edges.items():
        if name not in driven:
            continue
        opposite = name[1:] if name.startswith("-") else f"-{name}"
        line = nets.parse_shape(driven[name][-1])
        if len(line) > 1:
            yield _Street(name, lanes, shapely.LineString(line), opposite in driven)


def _widen(edge: ElementTree.Element, sides: Sides) -> int:
    """Give an edge its strips; return the first lane number that moves."""
    lanes = edge.findall("lane") or [
        ElementTree.Element("lane") for _ in range(int(edge.get("numLanes", "1")))
    ]
    first = next((i for i, lane in enumerate(lanes) if "passenger" in nets.list_users(lane)), 0)
    wide = lanes[:first] + _make_strip(sides.kerb) + lanes[first:] + _make_strip(sides.inner)
    for lane in edge.findall("lane"):
        edge.remove(lane)
    for index, lane in enumerate(wide):
        lane.set("index", str(index))
        edge.append(lane)
    edge.set("numLanes", str(len(wide)))
    return first if sides.kerb is not None else len(wide)


def _make_strip(angle: Angle) -> list[ElementTree.Element]:
    """Lane without traffic for bays at an angle; empty without bays."""
    if angle is None:
        return []
    width = f"{BAY_DEPTHS_M[angle]:.3f}"
    return [ElementTree.Element("lane", disallow="all", width=width)]


def _direction(line: shapely.LineString, at: float) -> Float64[np.ndarray, "2"]:
    """Unit vector along a line, `at` m from its start."""
    ends = shapely.get_coordinates(line.interpolate([max(at - 0.5, 0.0), at + 0.5]))
    ahead = ends[1] - ends[0]
    return ahead / max(float(np.hypot(*ahead)), 1e-9)


def _angle(tags: Tags, side: str) -> Angle:
    """Parking angle on one side of a road."""

    def tag_value(key: str, suffix: str = "") -> str:
        text = tags.get(f"{key}:{side}{suffix}") or tags.get(f"{key}:both{suffix}") or ""
        return text.strip().lower()

    if tag_value("parking", ":restriction") in _FORBIDDEN:
        return None
    if not tag_value("parking"):
        older_value = tag_value("parking:lane")
        return 0 if older_value == "marked" else _ORIENTATIONS.get(older_value)
    parked = tag_value("parking") in (*_BESIDE_ROAD, "yes")
    return _ORIENTATIONS.get(tag_value("parking", ":orientation"), 0) if parked else None
