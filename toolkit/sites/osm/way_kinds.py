"""Kinds of ways of an OpenStreetMap extract: roads, walks, and what they reach and cross."""

import shapely

from toolkit.sites.osm.extract import Way
from toolkit.sites.osm.road_rules import ACCESS_KEYS, ROADS, Tags

# values of highway that are walks
WALKS = ("footway", "path", "pedestrian", "steps", "corridor")
# values of service of roads that are not driven on here
UNUSED_SERVICES = ("driveway", "parking_aisle", "drive-through")

_OPEN_VALUES = {"yes", "designated", "destination", "permissive", "delivery"}
_VEHICLE_KEYS = ACCESS_KEYS - {"access", "bicycle"}


def reaches_window(way: Way, window: shapely.Geometry) -> bool:
    """True if a way has a point in `window`, given in the extract's frame."""
    return bool(shapely.LineString(way.line).intersects(window))


def is_road(tags: Tags) -> bool:
    """True for the tags of a road that vehicles drive on here."""
    return (
        tags.get("highway") in ROADS
        and tags.get("area") != "yes"
        and tags.get("service") not in UNUSED_SERVICES
    )


def is_driven_walk(tags: Tags) -> bool:
    """True for a pedestrian street that is open to some vehicles."""
    is_open = any(tags.get(key) in _OPEN_VALUES for key in _VEHICLE_KEYS)
    return tags.get("highway") == "pedestrian" and is_open


def crosses_road(bridge: Way, road: Way) -> bool:
    """True if two ways meet at a place that is no node of both.

    Such ways cross at different heights, or lack their junction in the map."""
    crossing = shapely.LineString(bridge.line).intersection(shapely.LineString(road.line))
    nodes = zip(bridge.nodes, bridge.line, strict=True)
    shared_points = [xy for node, xy in nodes if node in road.nodes]
    junctions: shapely.Geometry = shapely.Polygon()  # empty
    if shared_points:
        junctions = shapely.MultiPoint(shared_points).buffer(0.5)  # within 0.5 m of a node of both
    return not crossing.difference(junctions).is_empty
