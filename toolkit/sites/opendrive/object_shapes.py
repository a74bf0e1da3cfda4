"""Solids of OpenDRIVE objects: an outline, a radius, or a length and width."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Self
from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.arrays import Float64
from toolkit.geometry import plane_rotation
from toolkit.sites import furniture
from toolkit.sites.network import list_polygons
from toolkit.sites.opendrive.cubics import read_number
from toolkit.sites.opendrive.map_roads import MapRoad
from toolkit.sites.opendrive.object_places import (
    MAX_BEYOND_M,
    ObjectPlace,
    list_places,
    place_on_road,
    read_row,
)
from toolkit.sites.site import Solid

# limits to which sizes in the map are cut, or raised
MAX_OBJECT_HEIGHT_M = 200.0
MAX_RADIUS_M = 20.0
MAX_BARRIER_WIDTH_M = 20.0
BARRIER_PIECE_M = 4.0  # length of a barrier's pieces at most
MIN_OBJECT_WIDTH_M = 0.2
MIN_OBJECT_LENGTH_M = 0.3
MIN_OUTLINE_M2 = 1e-3  # smaller outlines are left out


@dataclass(frozen=True)
class _Size:
    """Size of an object (m); a number that the map lacks is 0.

    Attributes:
        height: above its base.
        radius: radius of a round object.
        length: along its heading.
        width: across its heading."""

    height: float
    radius: float
    length: float
    width: float

    @classmethod
    def read(cls, element: ElementTree.Element, usual_height: float) -> Self:
        """Read the size of an <object>. usual_height: height (m) of one without a height."""
        return cls(
            height=min(read_number(element, "height", 0.0) or usual_height, MAX_OBJECT_HEIGHT_M),
            radius=read_number(element, "radius", 0.0),
            length=read_number(element, "length", 0.0),
            width=read_number(element, "width", 0.0),
        )

    @property
    def any_radius(self) -> float:
        """Radius (m) of the object, or half the greater of its length and width without one."""
        return self.radius or max(self.length, self.width) / 2


def make_object_solids(
    road: MapRoad, element: ElementTree.Element, kind: str, usual_height: float
) -> Iterator[list[Solid]]:
    """Yield the solids of an <object> and its repeats in the map's frame, a group for each.

    A repeat without a distance is one long barrier, and each of its pieces is a group.

    road: the object's; kind: kind of solid; usual_height: height (m) of an object without one.
    Raises ValueError for a damaged object."""
    size = _Size.read(element, usual_height)
    repeats = element.findall("repeat")
    if any(read_number(repeat, "distance", 0.0) == 0 for repeat in repeats):
        for repeat in repeats:
            for piece in _make_barrier(road, repeat, kind, size):
                yield [piece]
        return
    outlines = []
    if not repeats:  # repeated objects are simple shapes
        outlines = element.findall("outline") + element.findall("outlines/outline")
    for place in list_places(road, element):
        if outlines:
            yield _make_prisms(road, place, outlines, kind, size)
        else:
            yield _make_simple(place, kind, size)


def _make_prisms(
    road: MapRoad,
    place: ObjectPlace,
    outlines: Sequence[ElementTree.Element],
    kind: str,
    size: _Size,
) -> list[Solid]:
    """Make a prism on each outline of an object. Raises ValueError if no outline has an area."""
    rings = [_read_ring(road, outline, place) for outline in outlines]
    rings = [ring for ring in rings if shapely.Polygon(ring).area > MIN_OUTLINE_M2]
    if not rings:
        raise ValueError("<outline> needs three corners that are not in one line: export it again")
    return [Solid(ring, base=place.base, top=place.base + size.height, kind=kind) for ring in rings]


def _make_simple(place: ObjectPlace, kind: str, size: _Size) -> list[Solid]:
    """Make the tree, disc or block of an object without an outline.

    kind: kind of solid; size: sizes (m) that the map states, 0 for none."""
    # usual and extreme sizes are in m
    if kind == "tree":
        crown_radius = min(max(size.any_radius or 1.6, 0.3), 8.0)
        return furniture.tree(
            place.x,
            place.y,
            height=max(size.height, 2.0),
            crown=crown_radius,
            clear=min(2.3, 0.4 * size.height),
        )
    if kind == "post" or size.radius > 0:
        radius = min(size.any_radius or 0.1, MAX_RADIUS_M)
        outline = furniture.disc(place.x, place.y, radius)
    else:
        extent = (max(size.length, MIN_OBJECT_LENGTH_M), max(size.width, MIN_OBJECT_WIDTH_M))
        outline = furniture.block(extent, middle=(place.x, place.y), yaw=place.heading)
    return [Solid(outline, base=place.base, top=place.base + size.height, kind=kind)]


def _make_barrier(
    road: MapRoad, repeat: ElementTree.Element, kind: str, size: _Size
) -> Iterator[Solid]:
    """Yield the pieces of a barrier along the road, each at most `BARRIER_PIECE_M` long.

    repeat: the <repeat> with its place, height and width; size: its object's, for numbers that the
    repeat lacks."""
    start_s = read_number(repeat, "s")
    length = min(read_row(repeat).length, road.length)
    start_t = read_number(repeat, "tStart", 0.0)
    end_t = read_number(repeat, "tEnd", start_t)
    s = np.linspace(start_s, start_s + length, int(length / BARRIER_PIECE_M) + 2)
    t = np.linspace(start_t, end_t, len(s))
    points = road.step_aside(s, t)[s <= road.length + MAX_BEYOND_M]
    top = min(read_number(repeat, "heightStart", 0.0) or size.height, MAX_OBJECT_HEIGHT_M)
    usual_width = max(size.width, MIN_OBJECT_WIDTH_M)
    width = min(read_number(repeat, "widthStart", 0.0) or usual_width, MAX_BARRIER_WIDTH_M)
    for start, end in pairwise(points):
        if np.hypot(*(end - start)) > 0.05:  # m
            yield Solid(furniture.bar(start, end, width=width), base=0.0, top=top, kind=kind)


def _read_ring(
    road: MapRoad, outline: ElementTree.Element, place: ObjectPlace
) -> Float64[np.ndarray, "k 2"]:
    """Corners x, y (m, map frame) of an outline, described on the road or about the object.

    If an outline crosses itself, its largest part counts. All corners are zero if they make no
    polygon. outline: the <outline>; place: the object's."""
    corners: list[tuple[float, float]] = []
    for corner in outline.iter("cornerRoad"):
        s = read_number(corner, "s")
        t = read_number(corner, "t")
        corner_place = place_on_road(road, s, t, turn=0.0)
        corners.append((corner_place.x, corner_place.y))
    rotation = plane_rotation(place.heading)
    for corner in outline.iter("cornerLocal"):
        uv = [read_number(corner, "u"), read_number(corner, "v")]  # m ahead and to the left
        x, y = rotation @ uv + [place.x, place.y]
        corners.append((x, y))
    if len(corners) < 3:
        return np.zeros((3, 2))
    polygons = list_polygons(shapely.make_valid(shapely.Polygon(corners)))
    no_polygon = shapely.Polygon(np.zeros((4, 2)))
    largest_polygon = max(polygons, key=shapely.area, default=no_polygon)
    return shapely.get_coordinates(largest_polygon.exterior)[:-1].round(3)  # the last is the first
