"""Roads of an OpenDRIVE map as netconvert reads them: plain lanes, links and junctions of OpenDRIVE 1.4.

netconvert reads half of the standard and stops at much of the rest. So it is handed what it reads right, in the terms
it knows: names of roads that SUMO can hold, lanes in order, limits per section, users per lane, links that lead
somewhere. What cannot be handed on is counted. Without its <geoReference>, header offset, objects and signs, the map
is in metres and nothing beside the road stops it."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from xml.etree import ElementTree

import numpy as np

from toolkit.sites import lane_rules
from toolkit.sites.cubics import Cubics, cubics, number
from toolkit.sites.lane_sections import Section, SectionLane, read_sections
from toolkit.sites.network import FOOT, MOTOR, format_element, format_xml
from toolkit.sites.opendrive import MapRoad

_SAFE_NAME = re.compile(r"[A-Za-z0-9_][\w.]*")
_WHOLE = re.compile(r"[-+]?\d{1,9}")
_NO_LIMIT = f"roads without a limit in the map are driven at {lane_rules.USUAL_SPEED_MPS * 3.6:.0f} km/h"
MAX_KERB_M = 0.25
_STRAIGHT = 1e-10  # 1/m; less curvature is none
_TRAFFIC_LIGHTS = (  # those that netconvert takes for traffic lights
    *("1000001", "1000002", "1000003", "1000004", "1000005", "1000006", "1000007", "1000009"),
    *("1000010", "1000011", "1000012", "1000013", "1000020"),
)
_SHAPE_KEYS: dict[str, tuple[str, ...]] = {
    "line": (),
    "arc": ("curvature",),
    "spiral": ("curvStart", "curvEnd"),
    "poly3": ("a", "b", "c", "d"),
    "paramPoly3": ("aU", "bU", "cU", "dU", "aV", "bV", "cV", "dV"),
}
_PRIORITY_SIGNS = ("205", "301", "306")  # German signs that netconvert reads


@dataclass(frozen=True, eq=False)
class PlainMap:
    """Part of a map that netconvert is handed.

    Attributes:
        text: OpenDRIVE 1.4.
        types: rows of SUMO's types, one for every use of a lane.
        lefthand: True if traffic keeps left.
        problems: what could not be handed on, by id of the road or junction."""

    text: str
    types: Sequence[Mapping[str, object]]
    lefthand: bool
    problems: dict[str, Counter[str]]


@dataclass(frozen=True, eq=False)
class _Road:
    element: ElementTree.Element
    name: str
    length: float
    sections: list[Section]
    is_odd: bool  # keeps to the other side than the map does

    def numbers(self, contact: str) -> set[int]:
        """Ids of the lanes at the road's start or end."""
        section = self.sections[0 if contact == "start" else -1]
        return {lane.number for lane in section.lanes}


@dataclass(eq=False)
class _Writer:
    """Roads of a map by id, and what is found while they are written."""

    root: ElementTree.Element
    roads: dict[str, _Road] = field(default_factory=dict)
    sign: int = 1  # of lanes: -1 in a map whose traffic keeps left, which netconvert mirrors
    uses: dict[tuple[str, lane_rules.LaneUse], str] = field(default_factory=dict)
    problems: dict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))


def write_plain(root: ElementTree.Element) -> PlainMap:
    """Write the roads of a map for netconvert. Raises ValueError for a damaged road, lane or geometry."""
    writer = _Writer(root)
    _read_roads(writer)
    defaults = lane_rules.read_defaults(root, writer.problems[""])
    junctions = {str(junction.get("id")): junction for junction in root.findall("junction")}
    kinds = {name: junction.get("type", "default") for name, junction in junctions.items()}
    left_out = {name for name, kind in kinds.items() if kind in ("virtual", "crossing")}
    elements = []
    for road in writer.roads.values():
        if road.element.get("junction", "-1") in left_out:
            continue
        elements.append(_write_road(writer, road, left_out, defaults))
    for name, junction in junctions.items():
        if name in left_out:
            _note_left_out(writer, name, junction)
        else:
            if junction.find("priority") is not None:
                writer.problems[f"junction {name}"]["junctions have priorities, which are not read"] += 1
            elements.append(_write_junction(writer, name, junction, is_direct=kinds[name] == "direct"))
    types = [
        {
            "id": kind,
            "speed": use.limit or _usual_speed(use.users),
            "priority": 5 if "passenger" in use.users else 0,
            **({"allow": " ".join(use.users)} if use.users else {"disallow": "all"}),
        }
        for (_, use), kind in writer.uses.items()
    ]
    text = format_xml("OpenDRIVE", ['<header revMajor="1" revMinor="4"/>', *elements])
    return PlainMap(text, types, writer.sign < 0, dict(writer.problems))


def describe_problems(plain: PlainMap, roads: Sequence[MapRoad]) -> list[str]:
    """Notes of what of `roads` and their junctions was not handed to netconvert as the map has it."""
    names = {road.element.get("id", "") for road in roads}
    junctions = {link.get("elementId", "") for road in roads for link in road.element.findall("link/*")}
    counted: Counter[str] = Counter()
    for name in sorted({"", *names, *(f"junction {junction}" for junction in junctions)}):
        counted.update(plain.problems.get(name, {}))
    for road in roads:
        counted.update(count_unread(road.element))
    return [f"{count} {text}" for text, count in counted.items() if count]


def count_unread(road: ElementTree.Element) -> dict[str, int]:
    """Number of things of a road that bear on traffic or the ground and are not read, by what a note says."""
    plates = [s for s in road.findall("signals/signal") if s.get("type") not in (*_TRAFFIC_LIGHTS, *_PRIORITY_SIGNS)]
    heights = road.findall("lanes/laneSection/*/lane/height")
    high = [h for h in heights if max(abs(number(h, key, 0.0)) for key in ("inner", "outer")) > MAX_KERB_M]
    return {
        "lanes may be left where road marks forbid it": _count_marks(road),
        "signs are plates, which traffic does not obey": len(plates),
        "tunnels have no walls and roof in the site": len(road.findall("objects/tunnel")),
        "surfaces in OpenCRG files are not read": len(road.findall("surface/CRG")),
        "cross sections of strips are not read": len(road.findall("lateralProfile/crossSectionSurface")),
        f"heights of lanes beyond a kerb's {MAX_KERB_M:g} m are not read": len(high),
        "rules of lanes in words are not read": len(road.findall("lanes/laneSection/*/lane/rule")),
    }


def _count_marks(road: ElementTree.Element) -> int:
    """Number of lanes from which road marks forbid a change to the driving lane outside them."""
    count = 0
    for side in road.findall("lanes/laneSection/*"):
        lanes = {lane.get("id", ""): lane for lane in side.findall("lane") if lane.get("type") == "driving"}
        for name, lane in lanes.items():
            is_inside = _WHOLE.fullmatch(name) and str(int(name) + (1 if side.tag == "left" else -1)) in lanes
            marks = lane.findall("roadMark")
            count += bool(is_inside) and any(mark.get("laneChange", "both") != "both" for mark in marks)
    return count


def _is_plate(signal: ElementTree.Element) -> bool:
    return signal.get("type", "") not in (*_TRAFFIC_LIGHTS, *_PRIORITY_SIGNS)


def _always(element: ElementTree.Element) -> bool:
    return True


def _usual_speed(users: Sequence[str]) -> float:
    if not users:
        return 1.0
    if set(users) == {FOOT}:
        return lane_rules.WALKING_SPEED_MPS
    return lane_rules.BICYCLE_SPEED_MPS if set(users) == {"bicycle"} else lane_rules.USUAL_SPEED_MPS


def _read_roads(writer: _Writer) -> None:
    rules = Counter(road.get("rule", "RHT") for road in writer.root.findall("road"))
    writer.sign = -1 if rules["LHT"] > rules["RHT"] else 1
    for i, road in enumerate(writer.root.findall("road")):
        name = road.get("id", "")
        if name in writer.roads:
            writer.problems[name]["roads have the id of another one and carry no traffic"] += 1
            continue
        length = max(_road_length(road), 2e-3)
        is_inner = road.get("junction", "-1") != "-1"
        sections = read_sections(road, length, keep_empty=is_inner)
        if not is_inner:
            sections = read_sections(road, length, lane_rules.find_cuts(road, sections))
        if not any(section.lanes for section in sections):
            writer.problems[name]["roads have no lanes"] += 1
            continue
        rule = road.get("rule", "RHT")
        if rule not in ("RHT", "LHT"):
            writer.problems[name][f"roads with rule {rule[:20]!r} count as RHT"] += 1
        safe = name if _SAFE_NAME.fullmatch(name) else f"coview{i}"
        is_odd = (rule == "LHT") != (writer.sign < 0)
        writer.roads[name] = _Road(road, safe, length, sections, is_odd)


def _road_length(road: ElementTree.Element) -> float:
    ends = [number(piece, "s") + number(piece, "length") for piece in road.findall("planView/geometry")]
    return max(ends, default=0.0)


def _write_road(writer: _Writer, road: _Road, left_out: set[str], defaults: Mapping[str, float]) -> str:
    problems = writer.problems[road.element.get("id", "")]
    links = dict(_find_links(writer, road, left_out, problems))
    attributes = {"id": road.name, "length": road.length, "name": road.element.get("name", "")}
    junction = road.element.get("junction", "-1")
    attributes["junction"] = "-1" if junction in ("-1", "") else _junction_name(junction)
    inside = [format_element("link", {}, "".join(map(_write_link, links.items())))] if links else []
    inside.append(format_element("planView", {}, "".join(_write_geometry(road.element))))
    heights = cubics(road.element.findall("elevationProfile/elevation"))
    inside.append(format_element("elevationProfile", {}, _write_cubics("elevation", "s", heights)))
    offset = cubics(road.element.findall("lanes/laneOffset"))
    lanes = _write_cubics("laneOffset", "s", offset)
    lanes += "".join(_write_sections(writer, road, links, defaults, problems))
    inside.append(format_element("lanes", {}, lanes))
    inside.append(format_element("signals", {}, "".join(_write_signals(road.element, writer.sign))))
    return format_element("road", attributes, "".join(inside))


@dataclass(frozen=True)
class _Link:
    """Road or junction that a road leads to, and of a road the end and the ids of the lanes there."""

    kind: str
    name: str
    contact: str = ""
    numbers: frozenset[int] = frozenset()


def _find_links(
    writer: _Writer, road: _Road, left_out: set[str], problems: Counter[str]
) -> Iterator[tuple[str, _Link]]:
    for where, usual in (("predecessor", "end"), ("successor", "start")):
        for link in road.element.findall(f"link/{where}"):
            name, kind = link.get("elementId", ""), link.get("elementType", "")
            if link.get("elementS") is not None or (kind == "junction" and name in left_out):
                problems["roads that branch off within another road are not joined to it"] += 1
            elif kind == "junction":
                yield where, _Link(kind, _junction_name(name))
            elif kind == "road" and name in writer.roads:
                contact = link.get("contactPoint", usual)
                other = writer.roads[name]
                if other.element.get("junction", "-1") not in left_out:
                    yield where, _Link(kind, other.name, contact, frozenset(other.numbers(contact)))
            else:
                problems["roads are linked to what is not in the file"] += 1


def _junction_name(name: str) -> str:
    return name if _SAFE_NAME.fullmatch(name) else "junction" + "".join(f"_{ord(letter)}" for letter in name)


def _write_link(link: tuple[str, _Link]) -> str:
    where, to = link
    contact = {"contactPoint": to.contact} if to.contact else {}
    return format_element(where, {"elementType": to.kind, "elementId": to.name, **contact})


def _write_geometry(road: ElementTree.Element) -> Iterator[str]:
    pieces = sorted(road.findall("planView/geometry"), key=lambda piece: number(piece, "s"))
    long = [piece for piece in pieces if number(piece, "length") > 1e-6]
    for piece in long or pieces[:1]:
        row: dict[str, object] = {key: number(piece, key) for key in ("s", "x", "y", "hdg", "length")}
        shape = next((child for child in piece if child.tag in _SHAPE_KEYS), ElementTree.Element("line"))
        kind = shape.tag
        numbers = {key: number(shape, key, 0.0) for key in _SHAPE_KEYS[kind]}
        if kind == "spiral" and abs(numbers["curvEnd"] - numbers["curvStart"]) < _STRAIGHT:
            kind, numbers = "arc", {"curvature": numbers["curvStart"]}  # netconvert makes no spiral of it
        if kind == "arc" and abs(numbers["curvature"]) < _STRAIGHT:
            kind, numbers = "line", {}
        is_length = shape.get("pRange") == "arcLength"
        parameter = {"pRange": "arcLength" if is_length else "normalized"} if kind == "paramPoly3" else {}
        yield format_element("geometry", row, format_element(kind, {**numbers, **parameter}))


def _write_cubics(tag: str, key: str, function: Cubics) -> str:
    rows = zip(function.starts.tolist(), function.rows.tolist(), strict=True)
    return "".join(format_element(tag, {key: s, **dict(zip("abcd", row, strict=True))}) for s, row in rows)


def _write_sections(
    writer: _Writer, road: _Road, links: Mapping[str, _Link], defaults: Mapping[str, float], problems: Counter[str]
) -> Iterator[str]:
    numbers = [frozenset(lane.number for lane in section.lanes) for section in road.sections]
    before = links["predecessor"].numbers if "predecessor" in links else frozenset()
    after = links["successor"].numbers if "successor" in links else frozenset()
    around = [before, *numbers, after]
    for i, section in enumerate(road.sections):
        kinds = {lane: _find_kind(writer, road, section, lane, defaults, problems) for lane in section.lanes}
        text = ""
        for side, sign in (("left", 1), ("center", 0), ("right", -1)):
            if not sign:
                text += '<center><lane id="0" type="none"/></center>'
                continue
            lanes = [lane for lane in section.lanes if lane.number * writer.sign * sign > 0]
            lanes.sort(key=lambda lane: -lane.number * writer.sign)
            written = [_write_lane(lane, kinds[lane], writer.sign, (around[i], around[i + 2])) for lane in lanes]
            text += format_element(side, {}, "".join(written)) if written else ""
        yield format_element("laneSection", {"s": section.start}, text)


def _write_lane(lane: SectionLane, kind: str, sign: int, neighbours: tuple[frozenset[int], frozenset[int]]) -> str:
    joined = ""
    for where, ids, known in zip(("predecessor", "successor"), (lane.before, lane.after), neighbours, strict=True):
        joined += "".join(format_element(where, {"id": sign * i}) for i in ids[:1] if i in known)
    inside = format_element("link", {}, joined) if joined else ""
    inside += _write_cubics("width", "sOffset", lane.width)
    return format_element("lane", {"id": sign * lane.number, "type": kind}, inside)


def _find_kind(
    writer: _Writer,
    road: _Road,
    section: Section,
    lane: SectionLane,
    defaults: Mapping[str, float],
    problems: Counter[str],
) -> str:
    """Name of the type of a lane that netconvert is handed."""
    use = lane_rules.find_use(road.element, section, lane, dict(defaults), problems)
    if use.limit is None and "passenger" in use.users and road.element.get("junction", "-1") == "-1":
        problems[_NO_LIMIT] = 1  # of one road, however many lanes it has
    if road.is_odd and use.users:
        problems["lanes of roads that keep to the other side than most are closed"] += 1
        use = lane_rules.LaneUse((), None)
    use = _close_both(section, lane, use, problems)
    kind = lane.kind if lane.kind in lane_rules.USERS else "unknown"
    usual = lane_rules.LaneUse(tuple(lane_rules.USERS.get(kind, "").split()), None)
    name = kind if use == usual else f"{kind}.{len(writer.uses)}"
    return writer.uses.setdefault((kind, use), name)


def _close_both(
    section: Section, lane: SectionLane, use: lane_rules.LaneUse, problems: Counter[str]
) -> lane_rules.LaneUse:
    """Use of a lane whose traffic does not run as its side says."""
    direction = lane.element.get("direction", "standard")
    if not use.users or set(use.users) == {FOOT}:
        return use
    if direction == "reversed":
        problems["lanes against the direction of their side (direction=reversed) are closed"] += 1
        return lane_rules.LaneUse((), None)
    if direction != "both" and lane.kind != "bidirectional":
        return use
    driven = [other for other in section.lanes if other is not lane and _is_driven(other)]
    if driven:
        problems["lanes for both directions (turning lanes) are closed to through traffic"] += 1
        return lane_rules.LaneUse((), None)
    problems["lanes for both directions are driven in the direction of their side only"] += 1
    return use


def _is_driven(lane: SectionLane) -> bool:
    is_standard = lane.element.get("direction", "standard") == "standard" and lane.kind != "bidirectional"
    return is_standard and lane_rules.USERS.get(lane.kind) == MOTOR


def _write_signals(road: ElementTree.Element, sign: int) -> Iterator[str]:
    """Traffic lights and signs of priority; all other signs say nothing to netconvert."""
    for signal in road.findall("signals/signal"):
        kind, name, s = signal.get("type", ""), signal.get("id", ""), signal.get("s", "")
        if kind not in (*_TRAFFIC_LIGHTS, *_PRIORITY_SIGNS) or not _SAFE_NAME.fullmatch(name) or not _is_number(s):
            continue
        facing = signal.get("orientation", "none")
        dynamic = "no" if signal.get("dynamic") == "no" else "yes"
        row = {"id": name, "s": s, "type": kind, "orientation": facing, "dynamic": dynamic}
        yield format_element("signal", row, "".join(_write_validity(signal, sign)))
    for reference in road.findall("signals/signalReference"):
        name, s = reference.get("id", ""), reference.get("s", "")
        if _SAFE_NAME.fullmatch(name) and _is_number(s):
            row = {"id": name, "s": s, "orientation": reference.get("orientation", "none")}
            yield format_element("signalReference", row, "".join(_write_validity(reference, sign)))


def _write_validity(signal: ElementTree.Element, sign: int) -> Iterator[str]:
    for validity in signal.findall("validity"):
        ends = [validity.get("fromLane", ""), validity.get("toLane", "")]
        if all(_WHOLE.fullmatch(end) for end in ends):
            first, last = sorted(sign * int(end) for end in ends)
            yield format_element("validity", {"fromLane": first, "toLane": last})


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False


def _write_junction(writer: _Writer, name: str, junction: ElementTree.Element, *, is_direct: bool) -> str:
    connections: list[str] = []
    for connection in junction.findall("connection"):
        incoming = writer.roads.get(connection.get("incomingRoad", ""))
        other = writer.roads.get(connection.get("linkedRoad" if is_direct else "connectingRoad", ""))
        contact = connection.get("contactPoint", "start")
        if incoming is None or other is None:
            writer.problems[f"junction {name}"]["connections of junctions lead to roads that are not in the file"] += 1
            continue
        meets = _find_contact(incoming, name)
        near = incoming.numbers(meets) if is_direct else incoming.numbers("start") | incoming.numbers("end")
        pairs = _read_pairs(connection, near, other.numbers(contact))
        if len(pairs) < len(connection.findall("laneLink")):
            writer.problems[f"junction {name}"]["connections of junctions lead to lanes that are not in the file"] += 1
        ways = [(incoming, other, contact, pairs)]
        if is_direct:
            into = [(a, b) for a, b in pairs if (a * writer.sign < 0) == (meets == "end")]
            out = [(b, a) for a, b in pairs if (a * writer.sign < 0) != (meets == "end")]
            ways = [(incoming, other, contact, into), (other, incoming, meets, out)]
        connections += [_write_connection(len(connections), way, writer.sign) for way in ways if way[3]]
    return format_element("junction", {"id": _junction_name(name), "name": ""}, "".join(connections))


def _find_contact(road: _Road, junction: str) -> str:
    """End of a road at which it meets a junction."""
    starts = road.element.findall("link/predecessor")
    meets = any(link.get("elementType") == "junction" and link.get("elementId") == junction for link in starts)
    return "start" if meets else "end"


def _read_pairs(connection: ElementTree.Element, incoming: set[int], other: set[int]) -> list[tuple[int, int]]:
    """Lanes that a connection joins. Without links, those of the same id (1.4, 5.4.2)."""
    links = connection.findall("laneLink")
    if not links:
        return [(i, i) for i in sorted(incoming & other)]
    texts = [(link.get("from", ""), link.get("to", "")) for link in links]
    whole = [(int(a), int(b)) for a, b in texts if _WHOLE.fullmatch(a) and _WHOLE.fullmatch(b)]
    return [(a, b) for a, b in whole if a in incoming and b in other]


def _write_connection(number_: int, way: tuple[_Road, _Road, str, list[tuple[int, int]]], sign: int) -> str:
    incoming, other, contact, pairs = way
    row = {"id": number_, "incomingRoad": incoming.name, "connectingRoad": other.name, "contactPoint": contact}
    links = [format_element("laneLink", {"from": sign * a, "to": sign * b}) for a, b in pairs]
    return format_element("connection", row, "".join(links))


def _note_left_out(writer: _Writer, name: str, junction: ElementTree.Element) -> None:
    kind = junction.get("type", "")
    roads = [road for road in writer.roads.values() if road.element.get("junction") == name]
    if kind == "virtual":
        text = "virtual junctions are left out: the main road goes on, and traffic does not turn there"
        for road in roads:
            problems = writer.problems[road.element.get("id", "")]
            problems["connecting roads of virtual junctions carry no traffic"] += 1
        near = [junction.get("mainRoad", "")]
    else:
        text = "crossing junctions are left out: traffic there does not give way"
        near = [section.get("roadId", "") for section in junction.findall("roadSection")]
    for road_id in near[:1]:
        writer.problems[road_id][text] += 1
