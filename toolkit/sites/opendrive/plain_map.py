"""Roads of an OpenDRIVE map for netconvert: plain lanes, links and junctions of OpenDRIVE 1.4.

netconvert reads half of the standard and stops at much of the rest. So it gets only the parts that
it reads right, in the terms it knows: names of roads that SUMO can hold, lanes in order, limits per
section, users per lane, links that lead somewhere. All other parts are counted. Without its
<geoReference>, header offset, objects and signs, the map is in metres, and nothing next to the road
stops netconvert."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

from toolkit.sites.network import FOOT, format_xml
from toolkit.sites.opendrive import lane_rules
from toolkit.sites.opendrive.carriageways import Carriageway, PlainWriter, read_carriageways
from toolkit.sites.opendrive.plain_junctions import write_plain_junction
from toolkit.sites.opendrive.plain_roads import write_plain_road

UNREAD_JUNCTIONS = ("virtual", "crossing")


@dataclass(frozen=True, eq=False)
class PlainMap:
    """Part of a map for netconvert.

    Attributes:
        text: text of an OpenDRIVE 1.4 file.
        types: attributes of SUMO's types, a row for every use of a lane.
        lefthand: True if traffic keeps left.
        problems: number of parts left out or changed, by the words of their note, for each id of a
            road, "junction ID", or "" for the header.
        carriageways: roads in the text, and roads of junctions that are left out."""

    text: str
    types: Sequence[Mapping[str, object]]
    lefthand: bool
    problems: dict[str, Counter[str]]
    carriageways: "Sequence[Carriageway]" = ()


def write_plain(root: ElementTree.Element) -> PlainMap:
    """Write the roads of a map for netconvert, as a file of OpenDRIVE 1.4.

    root: the map's <OpenDRIVE>. Raises ValueError for a damaged road, lane or geometry."""
    writer = PlainWriter(root)
    read_carriageways(writer)  # fills `writer.roads`
    defaults = lane_rules.read_defaults(root, writer.problems[""])
    junctions = {str(junction.get("id")): junction for junction in root.findall("junction")}
    left_out = {
        name for name, junction in junctions.items() if _read_kind(junction) in UNREAD_JUNCTIONS
    }
    carriageways = [carriageway for road in writer.roads.values() for carriageway in road]
    elements = [
        write_plain_road(writer, carriageway, left_out, defaults)
        for carriageway in carriageways
        if carriageway.junction not in left_out
    ]
    for name, junction in junctions.items():
        if name in left_out:
            _note_left_out(writer, name, junction)
        else:
            _note_unread(writer, name, junction)
            is_direct = _read_kind(junction) == "direct"
            elements.append(write_plain_junction(writer, name, junction, is_direct=is_direct))
    types = [_describe_type(name, use) for (_, use), name in writer.uses.items()]
    text = format_xml("OpenDRIVE", ['<header revMajor="1" revMinor="4"/>', *elements])
    return PlainMap(
        text=text,
        types=types,
        lefthand=writer.sign < 0,
        problems=dict(writer.problems),
        carriageways=carriageways,
    )


def _read_kind(junction: ElementTree.Element) -> str:
    """Type of a <junction>, "default" without one."""
    return junction.get("type", "default")


def _describe_type(name: str, use: lane_rules.LaneUse) -> dict[str, object]:
    """Attributes of SUMO's type for a use of a lane. name: id of the type."""
    row: dict[str, object] = {
        "id": name,
        "speed": use.limit or _usual_speed(use.users),
        "priority": 5 if "passenger" in use.users else 0,
    }
    if use.users:
        row["allow"] = " ".join(use.users)
    else:
        row["disallow"] = "all"
    return row


def _usual_speed(users: Sequence[str]) -> float:
    """Speed (m/s) of a lane without a limit, by its users."""
    if not users:
        return 1.0
    if set(users) == {FOOT}:
        return lane_rules.WALKING_SPEED_MPS
    if set(users) == {"bicycle"}:
        return lane_rules.BICYCLE_SPEED_MPS
    return lane_rules.USUAL_SPEED_MPS


def _note_unread(writer: PlainWriter, name: str, junction: ElementTree.Element) -> None:
    """Count the unread parts of a junction that netconvert gets in the writer's problems."""
    problems = writer.problems[f"junction {name}"]
    if junction.find("priority") is not None:
        problems["junctions have priorities, which are not read"] += 1
    if junction.find("elevationGrid") is not None:
        problems["junctions have a grid of heights, which is not read"] += 1


def _note_left_out(writer: PlainWriter, name: str, junction: ElementTree.Element) -> None:
    """Count, among the problems of one of its roads, a junction that is kept from netconvert.

    name: id of the junction. Connecting roads of a virtual junction are counted too, each in its
    problems."""
    if _read_kind(junction) == "virtual":
        text = (
            "virtual junctions are left out: the main road goes on, and traffic does not turn there"
        )
        for first_carriageway, *_ in writer.roads.values():
            if first_carriageway.junction == name:
                problems = writer.problems[first_carriageway.element.get("id", "")]
                problems["connecting roads of virtual junctions carry no traffic"] += 1
        main_roads = [junction.get("mainRoad", "")]
    else:
        text = "crossing junctions are left out: traffic there does not give way"
        main_roads = [section.get("roadId", "") for section in junction.findall("roadSection")]
    for road_id in main_roads[:1]:  # none or one
        writer.problems[road_id][text] += 1
