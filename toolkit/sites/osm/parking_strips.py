"""Strips for parking on a network's edges.

netconvert knows no such strips: they are put into the plain network that it writes, and it is run
again. A strip is between lanes and footway, also if vehicles park half or all on the kerb."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.sites import network as nets
from toolkit.sites.osm.parking import Angle, Parking, Sides
from toolkit.sites.osm.road_rules import RoadRules, restrict_edges
from toolkit.sites.surroundings.parking_bays import BAY_DEPTHS_M, bays_between

SIDE_STEP_M = 2.0  # between the places at which a lane's sides are examined
MIN_PARKING_SAMPLES = 6  # places with parking; edges with fewer get no strip


class _Street(NamedTuple):
    """Edge for motor vehicles.

    Attributes:
        name: id of the edge.
        lanes: its lanes from the kerb inwards.
        inner: middle line of the innermost lane for motor vehicles, in the direction of traffic.
        two_way: True if the road's other direction is beyond it."""

    name: str
    lanes: list[ElementTree.Element]
    inner: shapely.LineString
    two_way: bool


def find_parking_strips(network: str, parking: Parking) -> dict[str, Sides]:
    """Find the edges that get strips, and the angle between bays and kerb on both of their sides.

    network: net.xml text in the extract's frame. The commonest angle along an edge counts. Strips
    on the inner side are for one-way streets only."""
    strips = {}
    for street in _list_streets(network):
        # distances (m) along the innermost lane
        stations = np.arange(SIDE_STEP_M / 2, street.inner.length, SIDE_STEP_M)
        samples = [parking.find_sides(street.inner, station) for station in stations]
        kerb_angle = _find_commonest([sample.kerb for sample in samples])
        inner_angle = _find_commonest([sample.inner for sample in samples])
        sides = Sides(kerb_angle, None if street.two_way else inner_angle)
        if sides != Sides():
            strips[street.name] = sides
    return strips


def _find_commonest(samples: Iterable[Angle]) -> Angle:
    """Return the commonest angle of samples along a lane.

    None if fewer than `MIN_PARKING_SAMPLES` have parking."""
    counts = Counter(angle for angle in samples if angle is not None)
    if counts.total() < MIN_PARKING_SAMPLES:
        return None
    ((commonest_angle, _),) = counts.most_common(1)
    return commonest_angle


def restrict_network(folder: Path, types: Mapping[RoadRules, str]) -> None:
    """Give the plain edges that netconvert wrote the users and limits of their direction.

    folder: with plain.edg.xml, which is changed; types: names of edge types by their rules."""
    edges = ElementTree.parse(folder / "plain.edg.xml")
    restrict_edges(edges.iter("edge"), types)
    edges.write(folder / "plain.edg.xml")


def widen_network(folder: Path, strips: Mapping[str, Sides]) -> list[str]:
    """Write plain files with strips; return the options of netconvert for that network.

    folder: with netconvert's plain files, next to which the wide ones are written; strips: angles
    on both sides of edges by id, those without parking left out."""
    edges = ElementTree.parse(folder / "plain.edg.xml")
    connections = ElementTree.parse(folder / "plain.con.xml")
    first_lanes = {}  # by edge: number of the first lane that moves
    for edge in edges.iter("edge"):
        name = str(edge.get("id"))
        first_lanes[name] = _add_strips(edge, strips.get(name, Sides()))
    for connection in connections.iter("connection"):
        _move_lane(connection, "from", first_lanes)
        _move_lane(connection, "to", first_lanes)
    # their outlines belong to the narrower roads
    for crossing in connections.findall("crossing"):
        connections.getroot().remove(crossing)
    edges.write(folder / "wide.edg.xml")
    connections.write(folder / "wide.con.xml")
    return [
        f"--node-files={folder / 'plain.nod'}.xml",
        f"--edge-files={folder / 'wide.edg'}.xml",
        f"--connection-files={folder / 'wide.con'}.xml",
        f"--type-files={folder / 'plain.typ'}.xml",
        "--crossings.guess",
    ]


def _move_lane(connection: ElementTree.Element, end: str, first_lanes: Mapping[str, int]) -> None:
    """Number the lane at an end of a connection one higher, if a strip at the kerb moves it.

    connection: changed in place; end: "from" or "to"; first_lanes: number of the first lane that
    moves, by edge."""
    lane = connection.get(f"{end}Lane")
    if lane is not None and int(lane) >= first_lanes[connection.attrib[end]]:
        connection.set(f"{end}Lane", str(int(lane) + 1))


def _add_strips(edge: ElementTree.Element, sides: Sides) -> int:
    """Give an edge its parking strips, in place; return the first index of a lane that changed.

    The kerb's strip comes between the footways and the first lane for cars, the inner one after the
    last lane. Without a kerb's strip no index changes, and the number of lanes is returned. sides:
    angles of parking on both sides."""
    lanes = edge.findall("lane")
    if not lanes:
        lanes = [ElementTree.Element("lane") for _ in range(int(edge.get("numLanes", "1")))]
    car_lanes = [i for i, lane in enumerate(lanes) if "passenger" in nets.list_users(lane)]
    first = car_lanes[0] if car_lanes else 0
    footways, driven_lanes = lanes[:first], lanes[first:]
    new_lanes = footways + _make_strip(sides.kerb) + driven_lanes + _make_strip(sides.inner)
    for lane in edge.findall("lane"):
        edge.remove(lane)
    for index, lane in enumerate(new_lanes):
        lane.set("index", str(index))
        edge.append(lane)
    edge.set("numLanes", str(len(new_lanes)))
    return first if sides.kerb is not None else len(new_lanes)


def _make_strip(angle: Angle) -> list[ElementTree.Element]:
    """Make the lane without traffic for bays at an angle to the kerb; none for None."""
    if angle is None:
        return []
    width = f"{BAY_DEPTHS_M[angle]:.3f}"
    return [ElementTree.Element("lane", disallow="all", width=width)]


def find_strip_bays(network: str, parking: Parking) -> list[tuple[float, float, float]]:
    """List bays x, y (m), yaw (rad) on a network's parking strips, if the map has parking there.

    network: net.xml text in the extract's frame, with strips."""
    strip_bays: list[tuple[float, float, float]] = []
    for street in _list_streets(network):
        is_inner = False  # True from the first lane for cars on
        for lane in street.lanes:
            users = nets.list_users(lane)
            is_inner |= "passenger" in users
            if users:
                continue
            # a lane without users is a strip, as wide as its bays are deep
            angle = _match_angle(float(lane.get("width", "0")))
            strip = shapely.LineString(nets.parse_shape(lane))
            # the kerb is on the side that traffic keeps to; an inner strip has its kerb opposite
            kerb_left = parking.lefthand != is_inner
            for x, y, yaw in bays_between(strip, angle, kerb_left=kerb_left).tolist():
                distance = street.inner.project(shapely.Point(x, y))
                sides = parking.find_sides(street.inner, distance)
                if (sides.inner if is_inner else sides.kerb) == angle:
                    strip_bays.append((x, y, yaw))
    return strip_bays


def _match_angle(width: float) -> int:
    """Angle (degrees) between kerb and bays on a strip of about `width` (m)."""
    return min(BAY_DEPTHS_M, key=lambda angle: abs(BAY_DEPTHS_M[angle] - width))


def _list_streets(network: str) -> Iterator[_Street]:
    """Yield the edges of a network (net.xml text) with a lane for motor vehicles."""
    # lanes by edge: all, and those for cars
    lanes_by_edge: dict[str, list[ElementTree.Element]] = {}
    car_lanes_by_edge: dict[str, list[ElementTree.Element]] = {}
    for edge, lane in nets.list_lanes(network):
        name = str(edge.get("id"))
        lanes_by_edge.setdefault(name, []).append(lane)
        if "passenger" in nets.list_users(lane):
            car_lanes_by_edge.setdefault(name, []).append(lane)
    for name, lanes in lanes_by_edge.items():
        if name not in car_lanes_by_edge:
            continue
        # SUMO marks one direction of a road by -
        opposite = name[1:] if name.startswith("-") else f"-{name}"
        # SUMO lists lanes from the kerb on
        innermost_lane = car_lanes_by_edge[name][-1]
        line = nets.parse_shape(innermost_lane)
        if len(line) > 1:
            yield _Street(
                name, lanes, inner=shapely.LineString(line), two_way=opposite in car_lanes_by_edge
            )
