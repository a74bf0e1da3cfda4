"""Parking along the kerbs of an OpenStreetMap extract: strips beside the lanes of the roads, and bays on them.

Both tagging schemes are read, parking:SIDE with parking:SIDE:orientation and the older parking:lane:SIDE, and areas of
amenity=parking beside a road. netconvert knows no such strips: they are put into the plain network that it writes, and
it is run again. A strip lies between lanes and footway, also where vehicles stand half or all on the kerb.
https://wiki.openstreetmap.org/wiki/Street_parking
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.arrays import Float64
from toolkit.sites.network import list_lanes, list_users, parse_shape
from toolkit.sites.osm import Extract, Tags
from toolkit.sites.surroundings import ANGLES, bays_between

_ORIENTATIONS = {"parallel": 0, "diagonal": 45, "perpendicular": 90}
_BESIDE_ROAD = ("lane", "street_side", "on_kerb", "half_on_kerb", "shoulder", "layby")
_FORBIDDEN = ("no_parking", "no_stopping", "no_standing")
_NEAR = 8.0  # m from a lane to its road's line, and to an area of parking beside it
_ALIKE = 0.85  # least cosine between a lane and its road
_EVERY = 2.0  # m between the places where a lane's sides are looked at
_LEAST = 6  # least number of these places with parking; edges with fewer get no strip

Angle = int | None  # degrees between bay and kerb, of `ANGLES`; None: no parking


class Sides(NamedTuple):
    """Parking on both sides of a lane. The kerb is on the right where traffic keeps right."""

    kerb: Angle = None
    inner: Angle = None


@dataclass(frozen=True)
class Parking:
    """Parking: each road's line with the angles left and right of it, and areas beside roads with their angles."""

    roads: tuple[tuple[shapely.LineString, tuple[Angle, Angle]], ...]
    areas: tuple[tuple[shapely.Polygon, int], ...] = ()
    lefthand: bool = False  # traffic keeps left

    def __bool__(self) -> bool:
        return bool(self.areas) or any(angles != (None, None) for _, angles in self.roads)

    def beside(self, lane: shapely.LineString, at: float) -> Sides:
        """Parking on both sides of a lane, `at` m along it."""
        spot, ahead = lane.interpolate(at), _direction(lane, at)
        tagged: tuple[Angle, Angle] = (None, None)
        nearest = _NEAR
        for number in self._tree.query(spot, predicate="dwithin", distance=_NEAR).tolist():
            line, (left, right) = self.roads[number]
            cosine, distance = float(ahead @ _direction(line, line.project(spot))), float(line.distance(spot))
            if distance < nearest and abs(cosine) > _ALIKE:
                tagged, nearest = (left, right) if cosine > 0 else (right, left), distance
        found = list(tagged)
        for side, across in enumerate(_NEAR * np.array([[-ahead[1], ahead[0]], [ahead[1], -ahead[0]]])):
            if found[side] is None:  # the first area on this side
                ray = shapely.LineString([spot, shapely.Point(shapely.get_coordinates(spot)[0] + across)])
                hits = [(float(ray.intersection(shape).distance(spot)), angle) for shape, angle in self.areas]
                found[side] = min((hit for hit in hits if np.isfinite(hit[0])), default=(0.0, None))[1]
        return Sides(*found) if self.lefthand else Sides(*found[::-1])

    @cached_property
    def _tree(self) -> shapely.STRtree:
        return shapely.STRtree([line for line, _ in self.roads])


class _Street(NamedTuple):
    """Edge for motor vehicles; lanes from the kerb inwards."""

    name: str
    lanes: list[ElementTree.Element]
    inner: shapely.LineString  # the innermost lane for motor vehicles
    two_way: bool  # the road's other direction lies beyond it


def find_parking(extract: Extract, kinds: Collection[str], window: shapely.Geometry, *, lefthand: bool) -> Parking:
    """Parking along the roads of `kinds` (highway=...) within `window`."""
    lines = [(shapely.LineString(way.line), way.tags) for way in extract.ways if way.tags.get("highway") in kinds]
    roads = [(line, (_angle(tags, "left"), _angle(tags, "right"))) for line, tags in lines if line.intersects(window)]
    areas = [
        (shape, _ORIENTATIONS.get(tags.get("orientation", ""), 0))
        for shape, tags in extract.areas
        if tags.get("amenity") == "parking" and tags.get("parking") in _BESIDE_ROAD and shape.intersects(window)
    ]
    return Parking(tuple(roads), tuple(areas), lefthand)


def find_parking_strips(network: str, parking: Parking) -> dict[str, Sides]:
    """Angles on both sides of the edges that get strips; the commonest counts. network: in the extract's frame."""
    found = {}
    for street in _streets(network):
        seen = [parking.beside(street.inner, at) for at in np.arange(_EVERY / 2, street.inner.length, _EVERY)]
        kerb, inner = (Counter(sides[k] for sides in seen if sides[k] is not None) for k in (0, 1))
        usual = [angles.most_common(1)[0][0] if angles.total() >= _LEAST else None for angles in (kerb, inner)]
        sides = Sides(usual[0], None if street.two_way else usual[1])
        if sides != Sides():
            found[street.name] = sides
    return found


def widen_network(folder: Path, found: Mapping[str, Sides]) -> list[str]:
    """Options of netconvert for a network with strips."""
    edges, connections = (ElementTree.parse(folder / f"plain.{kind}.xml") for kind in ("edg", "con"))
    first = {str(edge.get("id")): _widen(edge, found.get(str(edge.get("id")), Sides())) for edge in edges.iter("edge")}
    for connection in connections.iter("connection"):
        for end, lane in (("from", "fromLane"), ("to", "toLane")):
            if lane in connection.attrib and int(connection.attrib[lane]) >= first[connection.attrib[end]]:
                connection.set(lane, str(int(connection.attrib[lane]) + 1))
    for crossing in connections.findall("crossing"):  # their outlines are those of the narrower roads
        connections.getroot().remove(crossing)
    edges.write(folder / "wide.edg.xml")
    connections.write(folder / "wide.con.xml")
    files = {"node": "plain.nod", "edge": "wide.edg", "connection": "wide.con", "type": "plain.typ"}
    return [*(f"--{kind}-files={folder / name}.xml" for kind, name in files.items()), "--crossings.guess"]


def find_strip_bays(network: str, parking: Parking) -> list[tuple[float, float, float]]:
    """Bays x, y, yaw on a network's parking strips."""
    found: list[tuple[float, float, float]] = []
    for street in _streets(network):
        inside = False
        for lane in street.lanes:
            inside |= "passenger" in list_users(lane)
            if not list_users(lane):
                angle = min(ANGLES, key=lambda each: abs(ANGLES[each] - float(lane.get("width", "0"))))
                strip, kerb_left = shapely.LineString(parse_shape(lane)), parking.lefthand != inside
                for x, y, yaw in bays_between(strip, angle, kerb_left=kerb_left).tolist():
                    if parking.beside(street.inner, street.inner.project(shapely.Point(x, y)))[inside] == angle:
                        found.append((x, y, yaw))
    return found


def _streets(network: str) -> Iterator[_Street]:
    edges: dict[str, list[ElementTree.Element]] = {}
    for edge, lane in list_lanes(network):
        edges.setdefault(str(edge.get("id")), []).append(lane)
    driven = {name: [lane for lane in lanes if "passenger" in list_users(lane)] for name, lanes in edges.items()}
    for name, lanes in edges.items():
        other = name[1:] if name.startswith("-") else f"-{name}"
        if driven[name] and len(line := parse_shape(driven[name][-1])) > 1:
            yield _Street(name, lanes, shapely.LineString(line), bool(driven.get(other)))


def _widen(edge: ElementTree.Element, sides: Sides) -> int:
    """Give an edge its strips; return the first lane number that moves."""
    lanes = edge.findall("lane") or [ElementTree.Element("lane") for _ in range(int(edge.get("numLanes", "1")))]
    first = next((i for i, lane in enumerate(lanes) if "passenger" in list_users(lane)), 0)
    kerb, inner = (
        [] if angle is None else [ElementTree.Element("lane", disallow="all", width=f"{ANGLES[angle]:.3f}")]
        for angle in sides
    )
    wide = [*lanes[:first], *kerb, *lanes[first:], *inner]
    for lane in edge.findall("lane"):
        edge.remove(lane)
    for index, lane in enumerate(wide):
        lane.set("index", str(index))
        edge.append(lane)
    edge.set("numLanes", str(len(wide)))
    return first if sides.kerb is not None else len(wide)


def _direction(line: shapely.LineString, at: float) -> Float64[np.ndarray, "2"]:
    """Unit vector along a line, `at` m from its start."""
    (ahead,) = np.diff(shapely.get_coordinates(line.interpolate([max(at - 0.5, 0.0), at + 0.5])), axis=0)
    return ahead / max(float(np.hypot(*ahead)), 1e-9)


def _angle(tags: Tags, side: str) -> Angle:
    """Parking angle on one side of a road."""

    def said(key: str, rest: str = "") -> str:
        return (tags.get(f"{key}:{side}{rest}") or tags.get(f"{key}:both{rest}") or "").strip().lower()

    if said("parking", ":restriction") in _FORBIDDEN:
        return None
    if not said("parking"):
        older = said("parking:lane")
        return 0 if older == "marked" else _ORIENTATIONS.get(older)
    parked = said("parking") in (*_BESIDE_ROAD, "yes")
    return _ORIENTATIONS.get(said("parking", ":orientation"), 0) if parked else None
