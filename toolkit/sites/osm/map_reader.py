"""Reads an OpenStreetMap file in metres around a centre.

Roads are cut at nodes that the file lacks; only a file that is no map, or a centre outside it, is
refused."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np
import shapely

from toolkit.arrays import Float64
from toolkit.geometry import plane_rotation
from toolkit.sites import network as nets
from toolkit.sites.georeference import project
from toolkit.sites.osm.extract import Extract, Way
from toolkit.sites.osm.raw_map import Multipolygon, RawMap, RawWay
from toolkit.sites.osm.road_rules import Tags

EDGE_MARGIN_DEG = 5e-4  # a centre this far beyond the map's bounds still is in it
MAX_LEAP_M = 1e4  # from one node of a road or building to the next
MIN_MAP_AREA_M2 = 0.1
GAPS_NOTE = "roads lack nodes on their way, and are cut there"
LEAPS_NOTE = "roads or buildings leap more than 10 km from node to node"

_BUILT_KEYS = {"highway", "building"}


def read_map(path: Path, centre: tuple[float, float], heading: float = 0.0) -> Extract:
    """Read a map in metres around `centre` (longitude, latitude in degrees).

    path: a file .osm, also .gz or .bz2, or JSON of Overpass; heading: direction of x (rad,
    counter-clockwise from east).

    Raises ValueError if the file is of another kind, is damaged, incomplete or empty, or `centre`
    is outside it."""
    raw_map = RawMap.read(path)
    if not raw_map.node_lon_lats:
        raise ValueError(f"{path}: the map is empty: it has no node with a latitude and longitude")
    lon_lats = np.array(list(raw_map.node_lon_lats.values()))
    _check_centre(path, centre, raw_map.bounds, lon_lats)
    metres = project(lon_lats, centre) @ plane_rotation(-heading).T
    positions = dict(zip(raw_map.node_lon_lats, metres, strict=True))
    ways = _make_ways(raw_map, positions)
    areas = tuple(_list_areas(ways, raw_map.multipolygons))
    places = tuple((positions[name], tags) for name, tags in raw_map.node_tags.items())
    notes = tuple(f"{count} {note}" for note, count in raw_map.oddities.items() if count)
    return Extract(
        centre=centre,
        heading=heading,
        ways=tuple(ways.values()),
        areas=areas,
        places=places,
        notes=notes,
        node_tags=raw_map.node_tags,
        restrictions=tuple(raw_map.restrictions),
    )


def _check_centre(
    path: Path,
    centre: tuple[float, float],
    bounds: list[list[float]],
    lon_lats: Float64[np.ndarray, "n 2"],
) -> None:
    """Raise ValueError for a centre outside the map's bounds, or its nodes if it has no bounds.

    bounds: west, south, east, north (degrees), one or several; lon_lats: degrees of all nodes."""
    has_bounds = bool(bounds) and bool(np.isfinite(bounds).all())
    # rows west, south, east, north; a node is its whole bounds
    rows = np.array(bounds) if has_bounds else np.tile(lon_lats, 2)
    south_west = rows[:, :2].min(axis=0)
    north_east = rows[:, 2:].max(axis=0)
    if _is_between(centre, south_west, north_east):
        return
    west, south = south_west
    east, north = north_east
    span = f"longitude {west:.6g} to {east:.6g} and latitude {south:.6g} to {north:.6g}"
    longitude, latitude = centre
    raise ValueError(
        f"{path}: centre {longitude:g} {latitude:g} lies outside the map, which spans {span}: "
        f"{_correct_centre(centre, south_west, north_east)}"
    )


def _is_between(centre: tuple[float, ...], low: np.ndarray, high: np.ndarray) -> bool:
    """True for a place within bounds, or at most `EDGE_MARGIN_DEG` outside (all in degrees)."""
    is_inside = (low - EDGE_MARGIN_DEG <= centre) & (centre <= high + EDGE_MARGIN_DEG)
    return bool(is_inside.all())


def _correct_centre(centre: tuple[float, float], low: np.ndarray, high: np.ndarray) -> str:
    """Words of a remedy for a centre (longitude, latitude) outside a map.

    low, high: south-western and north-eastern corner of the map (degrees)."""
    longitude, latitude = centre
    if _is_between((latitude, longitude), low, high):
        return f"longitude comes first, give --centre {latitude:g} {longitude:g}"
    if abs(longitude) > 180 or abs(latitude) > 90:
        return (
            "these are no degrees, give --centre LONGITUDE LATITUDE inside it, not metres of a "
            "projection"
        )
    return "give --centre LONGITUDE LATITUDE inside it"


def _make_ways(raw_map: RawMap, positions: Mapping[str, np.ndarray]) -> dict[str, Way]:
    """Make the ways in metres, by id; later parts of a cut road are named ID~1, ID~2 and so on.

    positions: x, y (m) of nodes by id. Cuts and leaps are counted in the map's oddities."""
    ways: dict[str, Way] = {}
    oddities = raw_map.oddities
    for name, raw_way in raw_map.ways.items():
        runs = _list_runs(raw_way, positions)
        oddities[GAPS_NOTE] += len(runs) > 1  # a bool counts as 0 or 1
        long_runs = [run for run in runs if len(run) > 1]
        for number, run in enumerate(long_runs):
            nodes = _drop_repeats(run)
            if len(nodes) < 2:
                continue
            line = np.array([positions[node] for node in nodes])
            key = f"{name}~{number}" if number else name
            ways[key] = Way(line, nodes=tuple(nodes), tags=raw_way.tags, name=name)
            # a distance too long between nodes is a fault of the map, which is kept
            step_lengths = np.hypot(*np.diff(line, axis=0).T)
            has_leap = step_lengths.max() > MAX_LEAP_M
            oddities[LEAPS_NOTE] += has_leap and bool(_BUILT_KEYS & raw_way.tags.keys())
    return ways


def _list_runs(way: RawWay, positions: Collection[str]) -> list[list[str]]:
    """Ids of the known nodes of a way, in one run or, for a cut road, in several.

    A road is cut at nodes that the map lacks; other ways go straight past them. positions: known
    nodes."""
    if "highway" not in way.tags:
        return [[node for node in way.nodes if node in positions]]
    runs: list[list[str]] = [[]]
    for node in way.nodes:
        if node in positions:
            runs[-1].append(node)
        elif runs[-1]:
            runs.append([])
    return [run for run in runs if run]


def _drop_repeats(nodes: list[str]) -> list[str]:
    """Return nodes without those that are the same as the node before."""
    return [node for k, node in enumerate(nodes) if k == 0 or node != nodes[k - 1]]


def _list_areas(
    ways: Mapping[str, Way], multipolygons: Iterable[Multipolygon]
) -> Iterator[tuple[shapely.Polygon, Tags]]:
    """Yield the areas of closed ways and of multipolygons, with their tags.

    Closed roads are rings to drive on, unless tagged area=yes. Multipolygons other than buildings
    also have the tags of their first way, as older maps put them there."""
    for way in ways.values():
        is_road = way.tags.get("highway") is not None and way.tags.get("area") != "yes"
        if way.is_closed and not is_road:
            for polygon in _list_valid(shapely.Polygon(way.line)):
                yield polygon, way.tags
    for members, tags in multipolygons:
        known_members = [(ways[name], role) for name, role in members if name in ways]
        outer_ground = _enclose_rings(way for way, role in known_members if role != "inner")
        inner_ground = _enclose_rings(way for way, role in known_members if role == "inner")
        area_tags = dict(tags)
        if known_members and "building" not in tags and "building:part" not in tags:
            first_way, _ = known_members[0]
            area_tags = {**first_way.tags, **tags}
        for polygon in _list_valid(outer_ground.difference(inner_ground)):
            yield polygon, dict(area_tags)


def _enclose_rings(ways: Iterable[Way]) -> shapely.Geometry:
    """Union of the ground enclosed by rings, which may be made of several ways each."""
    lines = [shapely.LineString(way.line) for way in ways]
    rings = shapely.get_parts(shapely.polygonize(lines))
    return shapely.union_all([shapely.Polygon(ring.exterior) for ring in rings])


def _list_valid(shape: shapely.Geometry) -> list[shapely.Polygon]:
    """List the polygons in a shape that may cross itself, above `MIN_MAP_AREA_M2`."""
    polygons = nets.list_polygons(shapely.make_valid(shape))
    return [polygon for polygon in polygons if polygon.area > MIN_MAP_AREA_M2]
