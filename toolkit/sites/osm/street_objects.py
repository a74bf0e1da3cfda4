"""Barriers, trees and street furniture of an OpenStreetMap extract as solids."""

import numpy as np
import shapely

from toolkit.sites import furniture as f
from toolkit.sites.osm.extract import Extract
from toolkit.sites.osm.road_rules import Tags
from toolkit.sites.osm.tag_values import metres
from toolkit.sites.site import Solid

MAX_BARRIER_M = 10.0  # height
MAX_LAMP_M = 15.0  # height
MAX_CROWN_RADIUS_M = 6.0
MIN_CROWN_RADIUS_M = 0.5
TREE_SPACING_M = 8.0  # in a row of trees

_BARRIERS = {  # barrier: how to draw it, usual height (m)
    "wall": (f.wall, 1.8),
    "fence": (f.railing, 1.2),
    "hedge": (f.hedge, 1.4),
    "city_wall": (f.wall, 4.0),
    "retaining_wall": (f.wall, 1.0),
    "guard_rail": (f.railing, 0.8),
    "handrail": (f.railing, 1.0),
}
_POLES = ("utility_pole", "mast", "flagpole")
_BINS = ("waste_basket", "recycling", "post_box")


def make_barriers(
    extract: Extract, window: shapely.Geometry, road: shapely.Geometry
) -> list[Solid]:
    """Make the map's walls, fences and hedges within `window`, 0.5 m or more off `road`.

    Stretches of 0.5 m or less are left out."""
    solids: list[Solid] = []
    for way in extract.ways:
        # function that makes the solids along a line, and height (m) without a tag
        make_solids, usual_height = _BARRIERS.get(way.tags.get("barrier", ""), (None, 0.0))
        if make_solids is None:
            continue
        height = min(metres(way.tags.get("height")) or usual_height, MAX_BARRIER_M)
        line = shapely.LineString(way.line).intersection(window).difference(road.buffer(0.5))
        if line.geom_type == "MultiLineString":
            line = shapely.line_merge(line)
        for stretch in shapely.get_parts(line):
            piece = stretch.simplify(0.05)
            if piece.geom_type == "LineString" and piece.length > 0.5:
                corners = [(float(x), float(y)) for x, y in piece.coords]
                solids += make_solids(corners, height)
    return solids


def make_trees(extract: Extract, window: shapely.Geometry, road: shapely.Geometry) -> list[Solid]:
    """Make the map's single trees and rows of trees within `window`.

    Crowns keep off `road`; trees too near it are left out."""
    solids: list[Solid] = []
    for (x, y), tags in _list_trees(extract):
        foot = shapely.Point(x, y)
        max_radius = road.distance(foot) - 0.1  # 0.1 m between crown and road
        # m; a crown of unknown width is 4 m wide
        mapped_radius = (metres(tags.get("diameter_crown")) or 4.0) / 2
        radius = min(mapped_radius, max_radius, MAX_CROWN_RADIUS_M)
        if radius > MIN_CROWN_RADIUS_M and window.contains(foot):
            # m; a tree of unknown height is 7 m high
            height = float(np.clip(metres(tags.get("height")) or 7.0, 2.0, 40.0))
            underside = min(2.3, 0.4 * height)  # the crown's height above the ground
            solids += f.tree(float(x), float(y), height, radius, underside)
    return solids


def _list_trees(extract: Extract) -> list[tuple[np.ndarray, Tags]]:
    """List place x, y (m) and tags of each tree, those in rows every `TREE_SPACING_M`."""
    trees = [(xy, tags) for xy, tags in extract.places if tags.get("natural") == "tree"]
    for way in extract.ways:
        if way.tags.get("natural") == "tree_row":
            line = shapely.LineString(way.line)
            spots = line.interpolate(np.arange(0.0, line.length, TREE_SPACING_M))
            trees += [(xy, way.tags) for xy in shapely.get_coordinates(spots)]
    return trees


def make_furniture(
    extract: Extract, window: shapely.Geometry, road: shapely.Geometry
) -> tuple[list[Solid], np.ndarray]:
    """Make the map's posts, signs, bins and benches within `window`, 0.4 m or more off `road`.

    Returns their solids, street lamps included, and the (n, 2) places x, y of the street lamps."""
    solids: list[Solid] = []
    lamps: list[np.ndarray] = []
    road_margin = road.buffer(0.4)
    for xy, tags in extract.places:
        spot = shapely.Point(xy)
        if not window.contains(spot) or road_margin.intersects(spot):
            continue
        if tags.get("highway") == "street_lamp":
            lamps.append(xy)
        solids += _make_street_object(tags, float(xy[0]), float(xy[1]))
    return solids, np.array(lamps).reshape(-1, 2)


def _make_street_object(tags: Tags, x: float, y: float) -> list[Solid]:
    """Make the solids of a lamp, pole, sign, bollard, bin or bench at (x, y) by its tags.

    The list is empty for other places. Heights and radii are usual ones (m)."""
    if tags.get("highway") == "street_lamp":
        height = min(metres(tags.get("height")) or 6.0, MAX_LAMP_M)
        return [f.post(x, y, height, radius=0.09)]
    if tags.get("power") == "pole" or tags.get("man_made") in _POLES:
        return [f.post(x, y, height=8.0, radius=0.12)]
    if "traffic_sign" in tags or tags.get("highway") in ("stop", "give_way"):
        return list(f.sign(x, y, facing=0.0))
    if tags.get("barrier") == "bollard":
        return [f.post(x, y, height=0.9, radius=0.07)]
    if tags.get("amenity") in _BINS:
        return [f.litter_bin(x, y)]
    if tags.get("amenity") == "bench":
        return [f.bench(x, y)]
    return []
