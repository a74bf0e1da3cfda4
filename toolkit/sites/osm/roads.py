"""The roads of an OpenStreetMap extract, cleaned and cut to a window, written for netconvert.

Of the map's tags netconvert sees only those that are well formed. Where the map does not say whether a street has
footways, it gets them by its class. https://wiki.openstreetmap.org/wiki/Key:highway
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import pairwise
from xml.sax.saxutils import quoteattr

import numpy as np
import shapely

from toolkit.sites.network import MOTOR, polygons_in
from toolkit.sites.osm.extract import Extract, Tags, Way, degrees_of, metres

# class of road: lanes each way, speed (m/s), priority, footways on both sides unless the map says otherwise
ROADS = {
    "motorway": (2, 36.1, 14, False),
    "trunk": (2, 27.8, 13, False),
    "primary": (1, 13.9, 12, True),
    "secondary": (1, 13.9, 11, True),
    "tertiary": (1, 13.9, 10, True),
    "unclassified": (1, 13.9, 8, True),
    "residential": (1, 8.3, 7, True),
    "living_street": (1, 2.8, 6, True),
    "busway": (1, 8.3, 5, False),
    "service": (1, 5.6, 4, False),
    "cycleway": (1, 5.6, 2, False),
}
ROADS |= {f"{kind}_link": ROADS[kind] for kind in ("motorway", "trunk", "primary", "secondary", "tertiary")}
_PATHS = ("footway", "path", "pedestrian", "steps", "corridor")
_PASSED_ON = ("oneway", "junction", "lanes", "lanes:forward", "lanes:backward", "maxspeed")
_SIDES = ("both", "left", "right", "no")


def roads(extract: Extract, window: shapely.Geometry, *, lefthand: bool = False) -> tuple[list[Way], list[str]]:
    """The roads for vehicles within `window`, cut at its edge, with the tags netconvert is to see; and notes on what
    was left out: tunnels, and bridges over another road."""
    drivable = [way for way in extract.ways if way.tags.get("highway") in ROADS and not _skipped(way.tags)]
    near = [way for way in drivable if shapely.LineString(way.line).intersects(window)]
    street = [way for way in near if not _below(way.tags)]
    ground = [way for way in street if not _above(way.tags)]
    kept = [way for way in street if not _above(way.tags) or not any(_passes_over(way, other) for other in ground)]
    notes = [f"{len(near) - len(kept)} tunnels or bridges over a road were left out"] if len(near) > len(kept) else []
    return [piece for way in kept for piece in _cut(way, window, lefthand)], notes


def paths(extract: Extract, window: shapely.Geometry) -> list[shapely.Polygon]:
    """Footways and squares of the map that are not part of a road, within `window`."""
    shapes: list[shapely.Geometry] = [
        polygon
        for polygon, tags in extract.areas
        if tags.get("highway") in ("pedestrian", "footway") or tags.get("area:highway") in ("pedestrian", "footway")
    ]
    for way in extract.ways:
        is_area = way.closed and way.tags.get("area") == "yes"
        if way.tags.get("highway") in _PATHS and not is_area and not _below(way.tags) and not _above(way.tags):
            width = np.clip(metres(way.tags.get("width", "")) or 2.0, 1.0, 10.0)
            shapes.append(shapely.LineString(way.line).buffer(width / 2, cap_style="flat", quad_segs=2))
    clipped = [shape.intersection(window) for shape in shapes if shape.intersects(window)]
    return [part for shape in clipped for part in polygons_in(shape)]


def written(pieces: Iterable[Way], extract: Extract) -> str:
    """`pieces` as OSM XML."""
    pieces = list(pieces)
    position = {node: point for way in pieces for node, point in zip(way.nodes, way.line, strict=True)}
    degrees = degrees_of(extract, np.array(list(position.values())).reshape(-1, 2))
    signals = {tuple(xy.round(3)) for xy, tags in extract.places if tags.get("highway") == "traffic_signals"}
    text = ['<osm version="0.6">']
    number = {node: i for i, node in enumerate(position, start=1)}
    for (node, xy), (longitude, latitude) in zip(position.items(), degrees, strict=True):
        tag = '<tag k="highway" v="traffic_signals"/>' if tuple(xy.round(3)) in signals else ""
        text.append(f'<node id="{number[node]}" lon="{longitude:.9f}" lat="{latitude:.9f}">{tag}</node>')
    for way_number, way in enumerate(pieces, start=1):
        inside = "".join(f'<nd ref="{number[node]}"/>' for node in way.nodes)
        inside += "".join(f"<tag k={quoteattr(key)} v={quoteattr(value)}/>" for key, value in way.tags.items())
        text.append(f'<way id="{way_number}">{inside}</way>')
    return "\n".join([*text, "</osm>\n"])


def road_types() -> str:
    """SUMO's type file for the roads of `roads`."""
    rows = [
        f'<type id="highway.{kind}" numLanes="{lanes}" speed="{speed}" priority="{priority}" oneway="false" '
        f'width="{1.8 if kind == "cycleway" else 3.25}" allow="{_users(kind)}"/>'
        for kind, (lanes, speed, priority, _) in ROADS.items()
    ]
    return "\n".join(["<types>", *rows, "</types>\n"])


def _users(kind: str) -> str:
    if kind.startswith("motorway"):
        return " ".join(user for user in MOTOR.split() if user not in ("bicycle", "moped"))
    return "bicycle" if kind == "cycleway" else MOTOR


def _skipped(tags: Tags) -> bool:
    return tags.get("service") in ("driveway", "parking_aisle", "drive-through") or tags.get("area") == "yes"


def _layer(tags: Tags) -> int:
    found = re.fullmatch(r"\s*([+-]?\d+)\s*", tags.get("layer", "0"))
    return int(found[1]) if found else 0


def _below(tags: Tags) -> bool:
    return tags.get("tunnel", "no") not in ("no", "building_passage") or (_layer(tags) < 0 and "tunnel" in tags)


def _above(tags: Tags) -> bool:
    return tags.get("bridge", "no") != "no"


def _passes_over(bridge: Way, road: Way) -> bool:
    """Whether they cross other than at a node of both."""
    crossing = shapely.LineString(bridge.line).intersection(shapely.LineString(road.line))
    shared = [xy for node, xy in zip(bridge.nodes, bridge.line, strict=True) if node in road.nodes]
    return not crossing.difference(shapely.MultiPoint(shared).buffer(0.5) if shared else shapely.Polygon()).is_empty


def _cut(way: Way, window: shapely.Geometry, lefthand: bool) -> Iterator[Way]:
    """The pieces of `way` within `window`, each with new nodes where the window's edge cuts it."""
    tags = _road_tags(way.tags, lefthand)
    step = -1 if way.tags.get("oneway") in ("-1", "reverse") else 1
    line, nodes = way.line[::step], way.nodes[::step]
    points: list[np.ndarray] = []
    names: list[str] = []
    for (start, end), (first, last) in zip(pairwise(line), pairwise(nodes), strict=True):
        inside = shapely.LineString([start, end]).intersection(window)
        if inside.geom_type != "LineString" or inside.is_empty:
            continue
        ends = shapely.get_coordinates(inside)
        ends = ends[np.argsort(np.hypot(*(ends - start).T))]
        for xy, corner, name in ((ends[0], start, first), (ends[-1], end, last)):
            own = name if np.hypot(*(xy - corner)) < 1e-6 else f"{first}_{last}_{'in' if corner is start else 'out'}"
            if own != name and corner is start and points:
                yield Way(np.array(points), tuple(names), tags)
                points, names = [], []
            if not names or names[-1] != own:
                points.append(xy)
                names.append(own)
        if names[-1] != last:
            yield Way(np.array(points), tuple(names), tags)
            points, names = [], []
    if len(points) > 1:
        yield Way(np.array(points), tuple(names), tags)


def _road_tags(tags: Tags, lefthand: bool) -> dict[str, str]:
    """The tags netconvert is to see, cleaned."""
    kind = tags["highway"]
    ring = tags.get("junction") in ("roundabout", "circular")
    passed = {key: tags[key].strip().lower() for key in _PASSED_ON if key in tags}
    rules = {"oneway": "yes|no|true|false|1|0|-1", "junction": "roundabout|circular", "maxspeed": r"\d+( mph)?"}
    passed = {key: value for key, value in passed.items() if re.fullmatch(rules.get(key, "[1-8]"), value)}
    if passed.get("oneway") == "-1" or tags.get("oneway") == "reverse" or (ring and "oneway" not in passed):
        passed["oneway"] = "yes"
    usual = ("left" if lefthand else "right") if ring else "both"
    side = _sidewalk(tags) or (usual if ROADS[kind][3] else "no")
    return {"highway": kind, **passed, "sidewalk": side}


def _sidewalk(tags: Tags) -> str | None:
    """Where the map has footways beside a road: both, left, right or no; None where it does not say."""
    plain = tags.get("sidewalk", "")
    if plain in _SIDES or plain in ("none", "yes", "separate"):
        return {"none": "no", "yes": "both", "separate": "both"}.get(plain, plain)
    sides = {side: tags.get(f"sidewalk:{side}") for side in ("both", "left", "right")}
    has = [side for side, value in sides.items() if value in ("yes", "separate")]
    return ("both" if "both" in has or len(has) == 2 else has[0]) if has else None
