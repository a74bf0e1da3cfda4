"""Text of a junction for netconvert."""

from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple
from xml.etree import ElementTree

from toolkit.sites.network import format_element
from toolkit.sites.opendrive.carriageways import Carriageway, PlainWriter
from toolkit.sites.opendrive.plain_names import WHOLE_NUMBER, name_junction


class _RoadEnd(NamedTuple):
    """End of a road at a junction or connection: the road's id, and "start" or "end"."""

    road: str
    contact: str


class _Joint(NamedTuple):
    """Lane before and after a connection: the carriageway of each, and the lane's id there."""

    incoming: tuple[Carriageway, int]
    connecting: tuple[Carriageway, int]


class _Connection(NamedTuple):
    """Two carriageways that a junction connects.

    contact: end of the connecting one at which they meet."""

    incoming: Carriageway
    connecting: Carriageway
    contact: str


def write_plain_junction(
    writer: PlainWriter, name: str, junction: ElementTree.Element, *, is_direct: bool
) -> str:
    """Text of the <junction> of OpenDRIVE 1.4 for a junction of the map.

    writer: has the roads, and collects problems; name: id of the junction; is_direct: it joins
    roads to each other, without connecting roads between them."""
    problems = writer.problems[f"junction {name}"]
    texts: list[str] = []
    for element in junction.findall("connection"):
        incoming_road = element.get("incomingRoad", "")
        connecting_road = element.get("linkedRoad" if is_direct else "connectingRoad", "")
        if incoming_road not in writer.roads or connecting_road not in writer.roads:
            problems["connections of junctions lead to roads that are not in the file"] += 1
            continue
        contact = element.get("contactPoint", "start")
        connecting = _RoadEnd(connecting_road, contact if contact == "end" else "start")
        incoming_contact = _find_contact(writer.roads[incoming_road][0], name)
        incoming = _RoadEnd(incoming_road, incoming_contact)
        joints = _read_joints(element, writer, incoming, connecting)
        if len(joints) < len(element.findall("laneLink")):
            problems["connections of junctions lead to lanes that are not in the file"] += 1
        # ids of the lanes before and after each connection of two carriageways
        lanes: dict[_Connection, list[tuple[int, int]]] = defaultdict(list)
        for joint in joints:
            road, from_lane = joint.incoming
            next_road, to_lane = joint.connecting
            # a lane that leads away from the junction at this end of its road
            is_reversed = (from_lane * writer.sign < 0) != (incoming.contact == "end")
            if is_direct and is_reversed:
                connection = _Connection(next_road, road, incoming.contact)
                lanes[connection].append((to_lane, from_lane))
            else:
                connection = _Connection(road, next_road, connecting.contact)
                lanes[connection].append((from_lane, to_lane))
        number = len(texts)
        for connection, lane_pairs in lanes.items():
            texts.append(_write_connection(number, connection, lane_pairs, writer.sign))
    return format_element("junction", {"id": name_junction(name), "name": ""}, "".join(texts))


def _find_contact(road: Carriageway, junction: str) -> str:
    """End of a road, "start" or "end", at which it meets a junction. junction: its id."""
    for link in road.element.findall("link/predecessor"):
        if link.get("elementType") == "junction" and link.get("elementId") == junction:
            return "start"
    return "end"


def _read_joints(
    connection: ElementTree.Element, writer: PlainWriter, incoming: _RoadEnd, connecting: _RoadEnd
) -> list[_Joint]:
    """List the pairs of lanes that a <connection> joins, if both are in carriageways.

    A connection without links joins lanes of the same id (1.4, 5.4.2). writer: has the carriageways
    of all roads; incoming, connecting: ends of the roads before and after the connection."""
    joints = []
    other_contact = "end" if incoming.contact == "start" else "start"
    for from_id, to_id in _read_lane_ids(connection, writer, incoming):
        # carriageway of a lane, and the lane's id in it
        incoming_lane = writer.find_lane(incoming.road, incoming.contact, from_id)
        if incoming_lane is None:  # a road may meet the junction at both ends
            incoming_lane = writer.find_lane(incoming.road, other_contact, from_id)
        connecting_lane = writer.find_lane(connecting.road, connecting.contact, to_id)
        if incoming_lane is not None and connecting_lane is not None:
            joints.append(_Joint(incoming=incoming_lane, connecting=connecting_lane))
    return joints


def _read_lane_ids(
    connection: ElementTree.Element, writer: PlainWriter, incoming: _RoadEnd
) -> list[tuple[int, int]]:
    """Pairs of ids of the lanes that a <connection> joins, before and after it.

    The ids are as in the file; links without whole numbers are left out. writer: has the
    carriageways of all roads; incoming: end of the road before the connection, whose lanes keep
    their ids if there are no links."""
    links = connection.findall("laneLink")
    if not links:
        roads = writer.roads[incoming.road]
        lane_ids = {lane_id for road in roads for lane_id in road.ends[incoming.contact]}
        return [(lane_id, lane_id) for lane_id in sorted(lane_ids)]
    texts = [(link.get("from", ""), link.get("to", "")) for link in links]
    return [
        (int(from_text), int(to_text))
        for from_text, to_text in texts
        if WHOLE_NUMBER.fullmatch(from_text) and WHOLE_NUMBER.fullmatch(to_text)
    ]


def _write_connection(
    number: int, connection: _Connection, lanes: Sequence[tuple[int, int]], sign: int
) -> str:
    """Text of a <connection> of OpenDRIVE 1.4.

    number: its id, which need not be unique; lanes: pairs of ids of a lane before and after it, in
    their carriageways; sign: -1 if netconvert mirrors the map, so that ids get the opposite sign,
    else 1."""
    attributes = {
        "id": number,
        "incomingRoad": connection.incoming.name,
        "connectingRoad": connection.connecting.name,
        "contactPoint": connection.contact,
    }
    links = [
        format_element("laneLink", {"from": sign * from_id, "to": sign * to_id})
        for from_id, to_id in lanes
    ]
    return format_element("connection", attributes, "".join(links))
