"""What stands still in an OpenStreetMap extract, as solids on level ground: buildings, barriers, trees, furniture.

Heights: height, else building:levels × 3 m, else the default of the kind. What would stand on a lane is cut off.
https://wiki.openstreetmap.org/wiki/Simple_3D_Buildings
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import shapely

from toolkit.arrays import Float64
from toolkit.sites import furniture as f
from toolkit.sites.network import within_window
from toolkit.sites.osm.extract import Extract, Tags, Way, metres
from toolkit.sites.site import Solid

DEFAULT_HEIGHT, STOREY = 6.0, 3.0  # m
FARTHEST_END = 60.0  # m beyond the window where a long building ends
_NO_BUILDING = ("", "no", "none", "demolished", "entrance")
_BARRIERS = {
    "wall": (f.wall, 1.8),
    "city_wall": (f.wall, 4.0),
    "retaining_wall": (f.wall, 1.0),
    "fence": (f.railing, 1.2),
    "guard_rail": (f.railing, 0.8),
    "handrail": (f.railing, 1.0),
    "hedge": (f.hedge, 1.4),
}


def buildings(extract: Extract, window: shapely.Geometry, road: shapely.Geometry) -> tuple[list[Solid], list[str]]:
    """Buildings that reach into `window`, the parts over `road` cut off, and a note if there were such parts.

    A building with parts (building:part) is made of them; its own outline stands where none of them does.
    """
    parts = [(p, tags) for p, tags in extract.areas if tags.get("building:part", "") not in _NO_BUILDING]
    parts = [(p, tags) for p, tags in parts if p.intersects(window)]
    covered = shapely.union_all([p for p, _ in parts])
    whole = [(p, tags) for p, tags in extract.areas if tags.get("building", "") not in _NO_BUILDING]
    whole = [(p.difference(covered), tags) for p, tags in whole if p.intersects(window) and not _underground(tags)]
    solids, cut, reach = [], 0, window.buffer(FARTHEST_END)
    for shape, tags in [*parts, *whole]:
        base, top = _levels(tags)
        rest = shape.difference(road)
        cut += bool(shape.area - rest.area > 0.1)
        solids += [Solid(ring, base, top, "building") for ring in within_window([rest], reach) if _area(ring) > 1.0]
    notes = [f"{cut} buildings reached over a road and were cut back to its edge"] if cut else []
    return solids, notes


def barriers(extract: Extract, window: shapely.Geometry, road: shapely.Geometry) -> list[Solid]:
    """Walls, fences and hedges within `window`, off `road`."""
    solids: list[Solid] = []
    for way in extract.ways:
        draw, usual = _BARRIERS.get(way.tags.get("barrier", ""), (None, 0.0))
        if draw is None:
            continue
        height = min(metres(way.tags.get("height", "")) or usual, 10.0)
        line = shapely.LineString(way.line).intersection(window).difference(road.buffer(0.5))
        for part in shapely.get_parts(shapely.line_merge(line) if line.geom_type == "MultiLineString" else line):
            piece = part.simplify(0.05)
            if piece.geom_type == "LineString" and piece.length > 0.5:
                solids += draw([(float(x), float(y)) for x, y in piece.coords], height)
    return solids


def trees(extract: Extract, window: shapely.Geometry, road: shapely.Geometry) -> list[Solid]:
    """Single trees and rows of trees within `window`; crowns keep off `road`, trees too near it are left out."""
    rows = [way for way in extract.ways if way.tags.get("natural") == "tree_row"]
    found = [(xy, tags) for xy, tags in extract.places if tags.get("natural") == "tree"]
    found += [(xy, row.tags) for row in rows for xy in _every(row, 8.0)]
    solids: list[Solid] = []
    for (x, y), tags in found:
        room = road.distance(shapely.Point(x, y)) - 0.1
        crown = min((metres(tags.get("diameter_crown", "")) or 4.0) / 2, room, 6.0)
        if crown > 0.5 and window.contains(shapely.Point(x, y)):
            height = float(np.clip(metres(tags.get("height", "")) or 7.0, 2.0, 40.0))
            solids += f.tree(float(x), float(y), height, crown, min(2.3, 0.4 * height))
    return solids


def furniture(extract: Extract, window: shapely.Geometry, road: shapely.Geometry) -> tuple[list[Solid], np.ndarray]:
    """Posts, signs, bins and benches within `window`, off `road`; and where the street lamps are, (n, 2)."""
    solids: list[Solid] = []
    lamps: list[np.ndarray] = []
    clear = road.buffer(0.4)
    for xy, tags in extract.places:
        spot, (x, y) = shapely.Point(xy), (float(xy[0]), float(xy[1]))
        if not window.contains(spot) or clear.intersects(spot):
            continue
        if tags.get("highway") == "street_lamp":
            lamps.append(xy)
            solids.append(f.post(x, y, min(metres(tags.get("height", "")) or 6.0, 15.0), 0.09))
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


def bays(extract: Extract, window: shapely.Geometry, road: shapely.Geometry) -> list[tuple[float, float, float]]:
    """Parking bays x, y, yaw: the map's spaces (amenity=parking_space) of a car's size within `window`, off `road`."""
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


def _levels(tags: Tags) -> tuple[float, float]:
    """Base and top of a building (m)."""
    storeys = metres(tags.get("building:levels", ""))
    top = metres(tags.get("height", "")) or metres(tags.get("building:height", ""))
    top = top or (storeys * STOREY if storeys else DEFAULT_HEIGHT)
    lowest = metres(tags.get("building:min_level", "")) or 0.0
    base = metres(tags.get("min_height", "")) or lowest * STOREY
    if tags.get("building") == "roof" and not base:
        base = top - 0.5
    return (base, top) if base < top - 0.1 else (0.0, top)


def _underground(tags: Tags) -> bool:
    return tags.get("location") == "underground" or tags.get("layer", "0").strip().startswith("-")


def _every(row: Way, spacing: float) -> Iterator[Float64[np.ndarray, "2"]]:
    line = shapely.LineString(row.line)
    for at in np.arange(0.0, line.length, spacing):
        yield shapely.get_coordinates(line.interpolate(at))[0]


def _area(ring: Float64[np.ndarray, "_ 2"]) -> float:
    return float(shapely.Polygon(ring).area)
