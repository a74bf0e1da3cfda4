"""Buildings of an OpenStreetMap extract as solids.

A building's height is its height tag, else building:levels × 3 m, else a default. Anything that
would be on a lane is cut off. https://wiki.openstreetmap.org/wiki/Simple_3D_Buildings"""

import shapely

from toolkit.sites import network as nets
from toolkit.sites.osm.extract import Extract
from toolkit.sites.osm.road_rules import Tags
from toolkit.sites.osm.tag_values import metres
from toolkit.sites.site import Solid

DEFAULT_HEIGHT_M = 6.0
STOREY_M = 3.0
ROOF_THICKNESS_M = 0.5
MIN_THICKNESS_M = 0.1
MAX_OVERHANG_M = 60.0  # part of a long building beyond the window

_NO_BUILDING = ("", "no", "none", "demolished", "entrance")


def make_buildings(
    extract: Extract, window: shapely.Geometry, road: shapely.Geometry
) -> tuple[list[Solid], list[str]]:
    """Make the solids of buildings that reach into `window`, cut off at `road`, and notes.

    A building with parts (building:part) is made from its parts and the rest of its outline.
    window, road: ground in the extract's frame."""
    solids = []
    cut_count = 0
    reach = window.buffer(MAX_OVERHANG_M)
    for shape, tags in _list_parts(extract, window):
        base, top = _read_heights(tags)
        shape_off_road = shape.difference(road)
        cut_count += bool(shape.area - shape_off_road.area > 0.1)  # m²
        for ring in nets.cut_polygons([shape_off_road], reach):
            if shapely.Polygon(ring).area > 1.0:
                solids.append(Solid(footprint=ring, base=base, top=top, kind="building"))
    if not cut_count:
        return solids, []
    return solids, [f"{cut_count} buildings reached over a road and were cut back to its edge"]


def _list_parts(extract: Extract, window: shapely.Geometry) -> list[tuple[shapely.Geometry, Tags]]:
    """List the ground and tags of parts of buildings, then of whole buildings.

    Whole buildings leave out the ground of all parts. Only areas that meet `window` are listed."""
    near_areas = [(shape, tags) for shape, tags in extract.areas if shape.intersects(window)]
    parts = [
        (shape, tags)
        for shape, tags in near_areas
        if tags.get("building:part", "") not in _NO_BUILDING
    ]
    parts_ground = shapely.union_all([shape for shape, _ in parts])
    buildings = [
        (shape.difference(parts_ground), tags) for shape, tags in near_areas if _is_building(tags)
    ]
    return parts + buildings


def _is_building(tags: Tags) -> bool:
    """True for the tags of a building above the ground."""
    return (
        tags.get("building", "") not in _NO_BUILDING
        and tags.get("location") != "underground"
        and not tags.get("layer", "0").strip().startswith("-")
    )


def _read_heights(tags: Tags) -> tuple[float, float]:
    """Base and top (m above the ground) of a building or a part of one, by its tags."""
    storeys = metres(tags.get("building:levels"))
    top = metres(tags.get("height")) or metres(tags.get("building:height"))
    if not top:
        top = storeys * STOREY_M if storeys else DEFAULT_HEIGHT_M
    base = metres(tags.get("min_height"))
    if not base:
        storeys_below = metres(tags.get("building:min_level")) or 0.0
        base = storeys_below * STOREY_M
    if tags.get("building") == "roof" and not base:
        base = top - ROOF_THICKNESS_M
    if base >= top - MIN_THICKNESS_M:
        base = 0.0
    return base, top
