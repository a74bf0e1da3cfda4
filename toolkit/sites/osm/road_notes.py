"""Notes of what an OpenStreetMap extract's roads cannot hold."""

from collections import Counter
from collections.abc import Iterable, Sequence

import shapely

from toolkit.geometry import plane_rotation
from toolkit.sites.georeference import inverse_project
from toolkit.sites.osm.extract import Extract, Way
from toolkit.sites.osm.road_rules import ROADS
from toolkit.sites.osm.tag_values import is_underground
from toolkit.sites.osm.traffic_side import name_side
from toolkit.sites.osm.way_kinds import (
    UNUSED_SERVICES,
    WALKS,
    crosses_road,
    is_road,
    reaches_window,
)

# values of highway other than walks that are no road to drive on, and need no note
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
MIN_RING_M2 = 10.0  # ground within a roundabout, or between its arc and the chord
_SIGNS = "stop and give-way signs, not used, as the classes of the roads say who goes first"
_MINI_RINGS = "mini-roundabouts, driven as plain junctions"
_UNUSED_PLACES = {"stop": _SIGNS, "give_way": _SIGNS, "mini_roundabout": _MINI_RINGS}
_RAILS = ("tram", "rail", "light_rail", "narrow_gauge", "subway")
_NO_TRAINS = "tracks of trams and trains, which do not run here"


def describe_crossings(ways: Sequence[Way]) -> list[str]:
    """Return a note that counts roads that cross without a node in common, none without such.

    Traffic does not give way there."""
    if not ways:
        return []
    lines = [shapely.LineString(way.line) for way in ways]
    # indices of two ways that cross; each pair comes twice, so only one order counts
    pairs = shapely.STRtree(lines).query(lines, predicate="crosses").T.tolist()
    count = sum(a < b and crosses_road(ways[a], ways[b]) for a, b in pairs)
    if not count:
        return []
    note = "roads that cross without a junction in the map, and drive through each other"
    return [f"{note}: {count}"]


def list_unused_places(extract: Extract, window: shapely.Geometry) -> list[str]:
    """List a note for each sign, small roundabout and rail in `window`, which are not heeded.

    The same note comes once for each of its places."""
    notes: list[str] = []
    for spot, tags in extract.places:
        note = _UNUSED_PLACES.get(tags.get("highway", ""))
        if note is not None and shapely.intersects_xy(window, *spot):
            notes.append(note)
    rails = [
        way
        for way in extract.ways
        if way.tags.get("railway") in _RAILS and not is_underground(way.tags)
    ]
    return notes + [_NO_TRAINS for way in rails if reaches_window(way, window)]


def describe_roadless(extract: Extract, window: shapely.Geometry) -> str:
    """Describe a window without roads: the map's other ways there, and its nearest road."""
    ways = [way for way in extract.ways if "highway" in way.tags]
    near_ways = [way for way in ways if reaches_window(way, window)]
    kinds = Counter(way.tags["highway"][:30] for way in near_ways)
    kind_counts = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common(4))
    facts = [f"there is {kind_counts}" if kind_counts else "nothing is tagged highway there"]
    tunnels = sum(is_road(way.tags) and is_underground(way.tags) for way in near_ways)
    if tunnels:
        facts.append(f"{tunnels} in tunnels")
    roads = [way for way in ways if is_road(way.tags) and not is_underground(way.tags)]
    lines = [shapely.LineString(road.line) for road in roads]
    outer_lines = [line for line in lines if not line.intersects(window)]
    if outer_lines:
        facts.append(_describe_nearest(outer_lines, extract))
    return "; ".join(facts)


def _describe_nearest(lines: Iterable[shapely.LineString], extract: Extract) -> str:
    """Describe the road nearest to the centre: its distance and place on earth.

    lines: roads' lines, in the extract's frame."""
    centre = shapely.Point(0.0, 0.0)  # origin of the extract's frame
    nearest_line = min(lines, key=centre.distance)
    # from the centre to the nearest point of the road
    link = shapely.get_coordinates(shapely.shortest_line(centre, nearest_line))
    map_point = link[1:] @ plane_rotation(extract.heading).T  # (1, 2): m along east and north
    ((longitude, latitude),) = inverse_project(map_point, extract.centre)
    return (
        f"the nearest road is {centre.distance(nearest_line):.0f} m away, at {longitude:.5f} "
        f"{latitude:.5f}"
    )


def describe_unused(ways: Iterable[Way]) -> list[str]:
    """Return a list with a note that counts ways that may be driven on but are no roads here.

    The list is empty without such ways. ways: with a tag highway, whose kinds are counted."""
    counts = Counter[str]()  # ways by kind
    for way in ways:
        tags = way.tags
        kind = tags["highway"]
        if kind in ROADS and tags.get("area") == "yes":
            counts["paved area"] += 1
        elif kind in ROADS and tags.get("service") in UNUSED_SERVICES:
            counts[tags["service"]] += 1
        elif kind not in ROADS and kind not in WALKS and kind not in _NO_ROADS:
            counts[kind[:30]] += 1
    if not counts:
        return []
    listed_kinds = ", ".join(f"{count} {kind}" for kind, count in counts.most_common(6))
    more_text = f" and {len(counts) - 6} kinds more" if len(counts) > 6 else ""
    return [f"no roads are made of: {listed_kinds}{more_text}"]


def describe_rings(ways: Iterable[Way], *, lefthand: bool) -> list[str]:
    """Return a list with a note that counts roundabouts that run against traffic, or an empty one.

    lefthand: traffic keeps left, and so drives clockwise; else it drives counter-clockwise."""
    lines = []  # in the direction of traffic
    for way in ways:
        if way.tags.get("junction") in ("roundabout", "circular"):
            is_reversed = way.tags.get("oneway") in ("-1", "reverse")
            lines.append(way.line[::-1] if is_reversed else way.line)
    # rings may be made of several ways
    chains = shapely.line_merge(shapely.MultiLineString(lines), directed=True)
    against_count = 0
    for chain in shapely.get_parts(chains):
        points = shapely.get_coordinates(chain)
        if len(points) > 2:
            ring = shapely.LinearRing(points)
            is_wide = shapely.Polygon(ring).area > MIN_RING_M2
            against_count += is_wide and ring.is_ccw == lefthand
    if not against_count:
        return []
    note = f"roundabouts that run against traffic that keeps {name_side(lefthand)}: {against_count}"
    return [f"{note}; give {'--righthand' if lefthand else '--lefthand'} if it is wrong"]
