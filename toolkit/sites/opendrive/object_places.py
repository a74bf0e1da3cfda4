"""Places of OpenDRIVE objects and of their repeats.

An object's place is s, t on its road, turned by hdg against it."""

from collections.abc import Iterator
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from toolkit.sites.opendrive.cubics import read_number
from toolkit.sites.opendrive.map_roads import MapRoad

MAX_BEYOND_M = 5.0  # an object may be this far beyond the ends of its road
MAX_REPEATS = 2000  # objects in a row


class RoadPlace(NamedTuple):
    """Place on a road in the map's frame: x, y (m), heading (rad, counter-clockwise from +x)."""

    x: float
    y: float
    heading: float


class ObjectPlace(NamedTuple):
    """Place of an object in the map's frame (m, rad).

    Attributes:
        x: to the east.
        y: to the north.
        heading: direction of its length.
        base: height above the road."""

    x: float
    y: float
    heading: float
    base: float


class ObjectRow(NamedTuple):
    """Row of repeated objects.

    Attributes:
        length: length of the row (m).
        spacing: from object to object (m), 0 for one continuous object.
        objects: their number."""

    length: float
    spacing: float
    objects: int


def check_place(road: MapRoad, element: ElementTree.Element) -> None:
    """Raise ValueError for an object or signal off its road, or with a negative height."""
    placed_elements = element.findall("repeat") or [element]
    for s in [read_number(placed, "s", 0.0) for placed in placed_elements]:
        if not -MAX_BEYOND_M <= s <= road.length + MAX_BEYOND_M:
            raise ValueError(
                f"<{element.tag}> needs an s of 0 to {road.length:g}, got {s:g}: export it again"
            )
    height = read_number(element, "height", 0.0)
    if height < 0:
        raise ValueError(
            f"<{element.tag}> needs a height from 0 up, got {height:g}: export it again"
        )


def place_on_road(road: MapRoad, s: float, t: float, turn: float) -> RoadPlace:
    """Place at s along a road and t to its left (m), on millimetres.

    turn: heading of the place from the road's direction there (rad, counter-clockwise)."""
    ((x, y, road_heading),) = road.at(np.array([s]))  # on the reference line
    return RoadPlace(
        x=round(float(x - t * np.sin(road_heading)), 3),
        y=round(float(y + t * np.cos(road_heading)), 3),
        heading=float(road_heading + turn),
    )


def list_places(road: MapRoad, element: ElementTree.Element) -> Iterator[ObjectPlace]:
    """Yield the place of an <object>, or the places of its repeats if it has any.

    Bases below the road are raised to it. Repeats beyond the end of the road are left out."""
    is_reversed = element.get("orientation") == "-"
    turn = read_number(element, "hdg", 0.0) + (np.pi if is_reversed else 0.0)
    repeats = element.findall("repeat")
    if not repeats:
        s = read_number(element, "s")
        t = read_number(element, "t")
        # x, y and heading in the map
        place = place_on_road(road, s, t, turn)
        yield ObjectPlace(*place, base=max(read_number(element, "zOffset", 0.0), 0.0))
    for repeat in repeats:
        start = read_number(repeat, "s")  # m along the road
        row = read_row(repeat)
        # m to the left of the road's reference line
        first_t = read_number(repeat, "tStart", read_number(element, "t"))
        last_t = read_number(repeat, "tEnd", first_t)
        base = max(read_number(repeat, "zOffsetStart", 0.0), 0.0)
        shares = [0.0]  # places of objects, as shares of the row's length
        if row.length > 0:
            shares = (np.arange(row.objects) * row.spacing / row.length).tolist()
        for share in shares:
            s = start + share * row.length
            t = first_t + share * (last_t - first_t)
            if s > road.length + MAX_BEYOND_M:
                break
            place = place_on_road(road, s, t, turn)
            yield ObjectPlace(*place, base=base)


def read_row(repeat: ElementTree.Element) -> ObjectRow:
    """Read the row of objects that a <repeat> describes.

    Raises ValueError for a negative number or too many objects."""
    length = read_number(repeat, "length", 0.0)
    distance = read_number(repeat, "distance", 0.0)  # 0 for one continuous object
    # 1e-6: 2.4 / 0.8 is below 3
    count = 1 + (int(length / distance + 1e-6) if distance > 0 else 0)
    if min(length, distance) < 0 or count > MAX_REPEATS:
        row = f"a length of {length:g} m and a distance of {distance:g} m make {count}"
        raise ValueError(
            f"<repeat> needs both from 0 up and at most {MAX_REPEATS} objects, but {row}: "
            "export it again"
        )
    return ObjectRow(length=length, spacing=distance, objects=count)
