"""Side of the road that traffic of an OpenStreetMap extract keeps to."""

from collections import Counter

import shapely

from toolkit.sites.driving_side import find_driving_side
from toolkit.sites.osm.extract import Extract
from toolkit.sites.osm.road_rules import ROADS
from toolkit.sites.osm.way_kinds import reaches_window


def choose_side(
    extract: Extract, window: shapely.Geometry, lefthand: bool | None
) -> tuple[bool, list[str]]:
    """Choose the side that traffic keeps to: True for left, and notes on the choice.

    lefthand: True or False for a side that was asked for; None for the side in the tags of the
    roads within `window` (driving_side), or else the country's."""
    tagged_sides = _count_sides(extract, window)
    if lefthand is not None:
        against_count = tagged_sides["right" if lefthand else "left"]
        note = (
            f"traffic keeps {name_side(lefthand)}, as asked; roads that say otherwise "
            f"(driving_side): {against_count}"
        )
        return lefthand, [note] if against_count else []
    if tagged_sides:
        is_left = tagged_sides["left"] > tagged_sides["right"]
        against_count = min(tagged_sides["left"], tagged_sides["right"])
        note = f"traffic keeps {name_side(is_left)}, as its roads say (driving_side)"
        if against_count:
            note += f"; roads that say otherwise: {against_count}, give --lefthand or --righthand"
        return is_left, [note]
    return _choose_by_country(extract.centre)


def _count_sides(extract: Extract, window: shapely.Geometry) -> Counter[str]:
    """Count the roads within a window that are tagged driving_side=left and =right."""
    near_ways = [
        way
        for way in extract.ways
        if way.tags.get("highway") in ROADS and reaches_window(way, window)
    ]
    sides = [way.tags.get("driving_side", "") for way in near_ways]
    return Counter(side for side in sides if side in ("left", "right"))


def _choose_by_country(centre: tuple[float, float]) -> tuple[bool, list[str]]:
    """Choose the side by the country: True for left, and notes of doubts.

    centre: longitude, latitude (degrees)."""
    is_left, is_near_border = find_driving_side(*centre)
    remedy = f"give {'--righthand' if is_left else '--lefthand'} if it is wrong"
    side = name_side(is_left)
    if is_near_border:
        return is_left, [f"traffic keeps {side}, but a border to the other side is near: {remedy}"]
    if is_left:
        return is_left, [f"traffic keeps left, as in this country: {remedy}"]
    return is_left, []


def name_side(is_left: bool) -> str:
    """Name of a side of the road, "left" or "right"."""
    return "left" if is_left else "right"
