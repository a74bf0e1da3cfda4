"""Roads of an OpenDRIVE map for netconvert: plain lanes, links and junctions of OpenDRIVE 1.4.

netconvert reads half of the standard and stops at much of the rest. So it gets only the parts that
it reads right, in the terms it knows: names of roads that SUMO can hold, lanes in order, limits per
section, users per lane, links that lead somewhere. All other parts are counted. Without its
<geoReference>, header offset, objects and signs, the map is in metres, and nothing next to the road
stops netconvert."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from xml.etree import ElementTree

import numpy as np

from toolkit.arrays import Float64
from toolkit.sites import lane_rules
from toolkit.sites.cubics import Cubics, cubics, number
from toolkit.sites.lane_sections import LaneSection, SectionLane, read_sections
from toolkit.sites.network import FOOT, MOTOR, format_element, format_xml
from toolkit.sites.opendrive import MapRoad

_SAFE_NAME = re.compile(r"[A-Za-z0-9_][\w.]*")
_WHOLE = re.compile(r"[-+]?\d{1,9}")
_NO_LIMIT = (
    f"roads without a limit in the map are driven at {lane_rules.USUAL_SPEED_MPS * 3.6:.0f} km/h"
)
MIN_WIDTH_M = -0.1  # of a lane; a narrower one is noted
WIDTH_SAMPLES = 9  # of a lane along its section
MAX_KERB_M = 0.25
MAX_LENGTH_GAP_M = 1.0
MAX_LENGTH_GAP_SHARE = 0.02
_MIN_CURVATURE_PER_M = 1e-10  # less curvature is ignored
_TRAFFIC_LIGHTS = (  # for netconvert
    "1000001",
    "1000002",
    "1000003",
    "1000004",
    "1000005",
    "1000006",
    "1000007",
    "1000009",
    "1000010",
    "1000011",
    "1000012",
    "1000013",
    "1000020",
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
    """Part of a map for netconvert.

    Attributes:
        text: OpenDRIVE 1.4.
        types: rows of SUMO's types, one for every use of a lane.
        lefthand: True if traffic keeps left.
        problems: number of parts left out or changed, by id of the road or junction, and kind.
        carriageways: roads in the text."""

    text: str
    types: Sequence[Mapping[str, object]]
    lefthand: bool
    problems: dict[str, Counter[str]]
    carriageways: "Sequence[Carriageway]" = ()


@dataclass(frozen=True, eq=False)
class Carriageway:
    """Lanes of a road that are one road for netconvert.

    Attributes:
        element: the <road>.
        name: name of the plain road.
        length: m.
        sections: sections with lanes numbered as in the plain road.
        offset: m from the reference line to the middle of these lanes, positive to the left.
        ends: ids in the file and in the plain road, for the lanes at "start" and "end".
        junction: id of the junction that it belongs to, or -1.
        closed: lanes that keep others in their places, but are driven in another carriageway."""

    element: ElementTree.Element
    name: str
    length: float
    sections: Sequence[LaneSection]
    offset: Cubics
    ends: Mapping[str, Mapping[int, int]]
    junction: str
    closed: frozenset[SectionLane] = frozenset()


@dataclass(eq=False)
class _Writer:
    """Roads of a map by id, and all that is collected while they are written.

    Attributes:
        root: the map.
        roads: carriageways by id of their road.
        sign: sign of lanes: -1 if traffic keeps left, as netconvert mirrors such a map.
        uses: names of the uses of lanes.
        problems: as of `PlainMap`."""

    root: ElementTree.Element
    roads: dict[str, list[Carriageway]] = field(default_factory=dict)
    sign: int = 1
    uses: dict[tuple[str, lane_rules.LaneUse], str] = field(default_factory=dict)
    problems: dict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))

    def find_lane(self, road: str, contact: str, number_: int) -> tuple[Carriageway, int] | None:
        """Carriageway of a lane at an end of a road, and the lane's id there."""
        for carriageway in self.roads.get(road, ()):
            if number_ in carriageway.ends[contact]:
                return carriageway, carriageway.ends[contact][number_]
        return None


def write_plain(root: ElementTree.Element) -> PlainMap:
    """Write the roads of a map for netconvert.

    Raises ValueError for a damaged road, lane or geometry."""
    writer = _Writer(root)
    _read_roads(writer)
    defaults = lane_rules.read_defaults(root, writer.problems[""])
    junctions = {str(junction.get("id")): junction for junction in root.findall("junction")}
    kinds = {name: junction.get("type", "default") for name, junction in junctions.items()}
    left_out = {name for name, kind in kinds.items() if kind in ("virtual", "crossing")}
    carriageways = [carriageway for road in writer.roads.values() for carriageway in road]
    elements = [
        _write_road(writer, carriageway, left_out, defaults)
        for carriageway in carriageways
        if carriageway.junction not in left_out
    ]
    for name, junction in junctions.items():
        if name in left_out:
            _note_left_out(writer, name, junction)
            continue
        if junction.find("priority") is not None:
            problem = "junctions have priorities, which are not read"
            writer.problems[f"junction {name}"][problem] += 1
        if junction.find("elevationGrid") is not None:
            problem = "junctions have a grid of heights, which is not read"
            writer.problems[f"junction {name}"][problem] += 1
        is_direct = kinds[name] == "direct"
        elements.append(_write_junction(writer, name, junction, is_direct=is_direct))
    types = [_describe_type(name, key[1]) for key, name in writer.uses.items()]
    text = format_xml("OpenDRIVE", ['<header revMajor="1" revMinor="4"/>', *elements])
    return PlainMap(text, types, writer.sign < 0, dict(writer.problems), carriageways)


def _describe_type(name: str, use: lane_rules.LaneUse) -> dict[str, object]:
    """Row of SUMO's type for a use of a lane."""
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


def describe_problems(plain: PlainMap, roads: Sequence[MapRoad]) -> list[str]:
    """Notes of the parts of `roads` and their junctions that netconvert got otherwise, or not."""
    names = {""}
    for road in roads:
        names.add(road.element.get("id", ""))
        links = road.element.findall("link/*")
        names.update(f"junction {link.get('elementId', '')}" for link in links)
    counted: Counter[str] = Counter()
    for name in sorted(names):
        counted.update(plain.problems.get(name, {}))
    for road in roads:
        counted.update(count_unread(road.element))
        gaps = [
            abs(piece.measure_curve() - piece.length) / max(piece.length, MAX_LENGTH_GAP_M)
            for piece in road.pieces
        ]
        wrong_curves = sum(gap > MAX_LENGTH_GAP_SHARE for gap in gaps)
        counted["curves are not as long as their geometry says"] += wrong_curves
    return [f"{count} {text}" for text, count in counted.items() if count]


def count_unread(road: ElementTree.Element) -> dict[str, int]:
    """Number of unread things of a road by the words of a note.

    They bear on traffic or the ground."""
    read_types = _TRAFFIC_LIGHTS + _PRIORITY_SIGNS
    signals = road.findall("signals/signal")
    plates = [signal for signal in signals if signal.get("type") not in read_types]
    heights = road.findall("lanes/laneSection/*/lane/height")
    high = [height for height in heights if _measure_height(height) > MAX_KERB_M]
    return {
        "lanes may be left where road marks forbid it": _count_marks(road),
        "signs are plates, which traffic does not obey": len(plates),
        "tunnels have no walls and roof in the site": len(road.findall("objects/tunnel")),
        "surfaces in OpenCRG files are not read": len(road.findall("surface/CRG")),
        "cross sections of strips are not read": len(
            road.findall("lateralProfile/crossSectionSurface")
        ),
        f"heights of lanes beyond a kerb's {MAX_KERB_M:g} m are not read": len(high),
        "rules of lanes in words are not read": len(road.findall("lanes/laneSection/*/lane/rule")),
    }


def _measure_height(element: ElementTree.Element) -> float:
    """Greatest distance (m) of a lane from its road's surface, up or down."""
    return max(abs(number(element, "inner", 0.0)), abs(number(element, "outer", 0.0)))


def _count_marks(road: ElementTree.Element) -> int:
    """Number of lanes from which road marks forbid a change to the driving lane outside them."""
    count = 0
    for side in road.findall("lanes/laneSection/*"):
        lanes = {
            lane.get("id", ""): lane
            for lane in side.findall("lane")
            if lane.get("type") == "driving"
        }
        outwards = 1 if side.tag == "left" else -1
        for name, lane in lanes.items():
            is_inside = _WHOLE.fullmatch(name) and str(int(name) + outwards) in lanes
            changes = [mark.get("laneChange", "both") for mark in lane.findall("roadMark")]
            count += bool(is_inside) and any(change != "both" for change in changes)
    return count


def _always(element: ElementTree.Element) -> bool:
    return True


def _usual_speed(users: Sequence[str]) -> float:
    """Speed (m/s) of a lane without a limit, by its users."""
    if not users:
        return 1.0
    if set(users) == {FOOT}:
        return lane_rules.WALKING_SPEED_MPS
    return lane_rules.BICYCLE_SPEED_MPS if set(users) == {"bicycle"} else lane_rules.USUAL_SPEED_MPS


def _read_roads(writer: _Writer) -> None:
    """Add the carriageways of all roads that can be driven to a writer."""
    rules = Counter(road.get("rule", "RHT") for road in writer.root.findall("road"))
    writer.sign = -1 if rules["LHT"] > rules["RHT"] else 1
    junction_ids = {junction.get("id", "") for junction in writer.root.findall("junction")}
    junction_ids.add("-1")
    for i, road in enumerate(writer.root.findall("road")):
        name = road.get("id", "")
        if name in writer.roads:
            writer.problems[name]["roads have the id of another one and carry no traffic"] += 1
            continue
        length = max(_road_length(road), 2e-3)
        junction = road.get("junction") or "-1"
        if junction not in junction_ids:
            writer.problems[name]["roads are part of a junction that is not in the file"] += 1
            junction = "-1"
        is_inner = junction != "-1"
        sections = read_sections(road, length, keep_empty=is_inner)
        if not is_inner:
            cuts = lane_rules.find_cuts(road, sections)
            cuts -= {section.start for section in sections}
            if cuts:
                sections = read_sections(road, length, cuts)
        if not any(section.lanes for section in sections):
            writer.problems[name]["roads have no lanes"] += 1
            continue
        _check_road(road, length, sections, writer.problems[name])
        rule = road.get("rule", "RHT")
        if rule not in ("RHT", "LHT"):
            writer.problems[name][f"roads with rule {rule[:20]!r} count as RHT"] += 1
        safe_name = name if _SAFE_NAME.fullmatch(name) else f"coview{i}"
        keeps_other_side = (rule == "LHT") != (writer.sign < 0)
        offset = cubics(road.findall("lanes/laneOffset"))
        carriageway = Carriageway(
            road, safe_name, length, sections, offset, _number_ends(sections), junction
        )
        writer.roads[name] = _part_directions(carriageway, keeps_other_side=keeps_other_side)


def _number_ends(sections: Sequence[LaneSection]) -> dict[str, dict[int, int]]:
    """Ids of the lanes at "start" and "end" of a road, each mapped to itself."""
    return {"start": _number_lanes(sections[0]), "end": _number_lanes(sections[-1])}


def _number_lanes(section: LaneSection) -> dict[int, int]:
    """Ids of a section's lanes, each mapped to itself."""
    return {lane.number: lane.number for lane in section.lanes}


def _part_directions(road: Carriageway, *, keeps_other_side: bool) -> list[Carriageway]:
    """Carriageways of a road.

    First come those with lanes against the usual direction of their side."""
    lanes = [lane for section in road.sections for lane in section.lanes]
    against = {
        lane for lane in lanes if _runs_against(lane) != keeps_other_side and _has_direction(lane)
    }
    if not against:
        return [road]
    inner_sections: list[LaneSection] = []
    for section in road.sections:
        inner_lanes = _strip_outer(section.side(1), against)
        inner_lanes += _strip_outer(section.side(-1), against)
        inner_lanes.sort(key=lambda lane: -lane.number)
        inner_sections.append(replace(section, lanes=tuple(inner_lanes)))
    signs = {1 if lane.number > 0 else -1 for lane in against}
    carriageways = [_contraflow(road, against, sign) for sign in sorted(signs, reverse=True)]
    if any(section.lanes for section in inner_sections):
        ends = _number_ends(inner_sections)
        for contact, numbers in ends.items():
            for carriageway in carriageways:
                for lane_number in carriageway.ends[contact]:
                    numbers.pop(lane_number, None)
        carriageways.append(
            replace(road, sections=inner_sections, ends=ends, closed=frozenset(against))
        )
    return carriageways


def _runs_against(lane: SectionLane) -> bool:
    return lane.element.get("direction", "standard") == "reversed"


def _has_direction(lane: SectionLane) -> bool:
    is_both = lane.kind == "bidirectional" or lane.element.get("direction") == "both"
    return not is_both and not set(lane_rules.USERS.get(lane.kind, "").split()) <= {FOOT}


def _strip_outer(lanes: Sequence[SectionLane], against: set[SectionLane]) -> list[SectionLane]:
    """Lanes of one side from the middle outwards, without outer ones that run against it."""
    inside = list(lanes)
    while inside and inside[-1] in against:
        inside.pop()
    return inside


def _contraflow(road: Carriageway, against: set[SectionLane], sign: int) -> Carriageway:
    """Lanes of one side that run against it, as a carriageway.

    They become lanes of the other side of a line along their outer border."""
    starts: list[float] = []
    rows: list[list[float]] = []
    sections: list[LaneSection] = []
    maps: list[dict[int, int]] = []
    closed: set[SectionLane] = set()
    for section in road.sections:
        lanes = section.side(sign)
        places = [i for i, lane in enumerate(lanes) if lane in against]
        edge = road.offset.cut_start(section.start)
        for lane in lanes[: places[-1] + 1] if places else []:
            edge = edge.subtract(lane.width.negate() if sign > 0 else lane.width)
        within = edge.move(section.start)
        starts += within.starts.tolist()
        rows += within.rows.tolist()
        group = lanes[places[0] : places[-1] + 1] if places else []
        numbers = {lane.number: -sign * (len(group) - i) for i, lane in enumerate(group)}
        turned_lanes = [
            replace(
                lane,
                number=numbers[lane.number],
                before=_renumber(lane.before, maps[-1] if maps else None),
            )
            for lane in group
        ]
        closed |= {
            new for new, lane in zip(turned_lanes, group, strict=True) if lane not in against
        }
        turned_lanes.sort(key=lambda lane: -lane.number)
        sections.append(LaneSection(section.start, section.end, tuple(turned_lanes)))
        maps.append(numbers)
    for i, numbers in enumerate(maps[1:]):
        linked_lanes = []
        for lane in sections[i].lanes:
            linked_lane = replace(lane, after=_renumber(lane.after, numbers))
            linked_lanes.append(linked_lane)
            if lane in closed:
                closed.add(linked_lane)
        sections[i] = replace(sections[i], lanes=tuple(linked_lanes))
    ends: dict[str, dict[int, int]] = {}
    for contact, index in (("start", 0), ("end", -1)):
        driven = {lane.number for lane in road.sections[index].side(sign) if lane in against}
        ends[contact] = {old: new for old, new in maps[index].items() if old in driven}
    name = f"{road.name}.{'left' if sign > 0 else 'right'}"
    offset = Cubics(np.array(starts), np.array(rows).reshape(-1, 4))
    return Carriageway(
        road.element, name, road.length, sections, offset, ends, road.junction, frozenset(closed)
    )


def _renumber(numbers: Sequence[int], new_numbers: Mapping[int, int] | None) -> tuple[int, ...]:
    """Ids of lanes as they are in a carriageway.

    new_numbers: None at the end of a road, whose links are found later."""
    if new_numbers is None:
        return tuple(numbers)
    return tuple(new_numbers[n] for n in numbers if n in new_numbers)


def _check_road(
    road: ElementTree.Element,
    length: float,
    sections: Sequence[LaneSection],
    problems: Counter[str],
) -> None:
    """Count contradictions within a road."""
    gap = max(MAX_LENGTH_GAP_M, MAX_LENGTH_GAP_SHARE * length)
    attribute = road.get("length", "")
    if _is_number(attribute) and abs(float(attribute) - length) > gap:
        problems["roads are not as long as their geometry, which counts"] += 1
    for section in sections:
        numbers = {lane.number for lane in section.lanes}
        doubled = len(section.lanes) - len(numbers)
        problems["lanes have the id of another lane beside them"] += doubled
        lowest = [_sample_width(section, lane).min() for lane in section.lanes]
        negative = sum(width < MIN_WIDTH_M for width in lowest)
        problems["lanes have a width below zero, which counts as zero"] += negative
    starts = [number(section, "s") for section in road.findall("lanes/laneSection")]
    outside = sum(not -gap <= start <= length + gap for start in starts)
    problems["lane sections begin beyond the ends of their road and are left out"] += outside
    for side, sign in (("left", 1), ("right", -1)):
        ids = [number(lane, "id") for lane in road.findall(f"lanes/laneSection/{side}/lane")]
        misplaced = sum(sign * i <= 0 for i in ids)
        problems["lanes have an id of the other side, where they are drawn"] += misplaced


def _sample_width(section: LaneSection, lane: SectionLane) -> Float64[np.ndarray, " k"]:
    """Widths (m) of a lane at places along its section."""
    return lane.width.at(np.linspace(0.0, section.end - section.start, WIDTH_SAMPLES))


def _road_length(road: ElementTree.Element) -> float:
    """Length of a road by its geometry (m)."""
    pieces = road.findall("planView/geometry")
    return max((number(piece, "s") + number(piece, "length") for piece in pieces), default=0.0)


def _write_road(
    writer: _Writer, road: Carriageway, left_out: set[str], defaults: Mapping[str, float]
) -> str:
    """<road> of OpenDRIVE 1.4 for a carriageway."""
    problems = writer.problems[road.element.get("id", "")]
    is_first = writer.roads[road.element.get("id", "")][0] is road
    links = dict(_find_links(writer, road, left_out, problems if is_first else Counter()))
    attributes = {"id": road.name, "length": road.length, "name": road.element.get("name", "")}
    attributes["junction"] = "-1" if road.junction == "-1" else _junction_name(road.junction)
    inside = [format_element("link", {}, "".join(map(_write_link, links.items())))] if links else []
    inside.append(format_element("planView", {}, "".join(_write_geometry(road.element))))
    heights = cubics(road.element.findall("elevationProfile/elevation"))
    inside.append(format_element("elevationProfile", {}, _write_cubics("elevation", "s", heights)))
    lanes = _write_cubics("laneOffset", "s", road.offset)
    lanes += "".join(_write_sections(writer, road, links, defaults, problems))
    inside.append(format_element("lanes", {}, lanes))
    if is_first:
        inside.append(
            format_element("signals", {}, "".join(_write_signals(road.element, writer.sign)))
        )
    return format_element("road", attributes, "".join(inside))


@dataclass(frozen=True)
class _Link:
    """Road or junction that a road leads to.

    For a road, `contact` is the end, and `numbers` are the ids of lanes there, in the file and
    here."""

    kind: str
    name: str
    contact: str = ""
    numbers: Mapping[int, int] = field(default_factory=dict)


def _find_links(
    writer: _Writer, road: Carriageway, left_out: set[str], problems: Counter[str]
) -> Iterator[tuple[str, _Link]]:
    """Links of a carriageway that lead somewhere, with "predecessor" or "successor"."""
    for where, default_contact in (("predecessor", "end"), ("successor", "start")):
        for link in road.element.findall(f"link/{where}"):
            name = link.get("elementId", "")
            kind = link.get("elementType", "")
            if link.get("elementS") is not None or (kind == "junction" and name in left_out):
                problems["roads that branch off within another road are not joined to it"] += 1
            elif kind == "junction":
                yield where, _Link(kind, _junction_name(name))
            elif kind == "road" and name in writer.roads:
                contact = link.get("contactPoint", default_contact)
                contact = contact if contact in ("start", "end") else default_contact
                partner = _find_partner(writer, road, where, name, contact)
                if partner.junction not in left_out:
                    yield where, _Link(kind, partner.name, contact, partner.ends[contact])
            else:
                problems["roads are linked to what is not in the file"] += 1


def _find_partner(
    writer: _Writer, road: Carriageway, where: str, name: str, contact: str
) -> Carriageway:
    """Carriageway of the road `name` to which most lanes at an end of `road` are linked."""
    section = road.sections[0 if where == "predecessor" else -1]
    partners: Counter[Carriageway] = Counter()
    for lane in section.lanes:
        for number_ in lane.before if where == "predecessor" else lane.after:
            lane_position = writer.find_lane(name, contact, number_)
            if lane_position is not None and lane not in road.closed:
                partners[lane_position[0]] += 1
    return partners.most_common(1)[0][0] if partners else writer.roads[name][-1]


def _junction_name(name: str) -> str:
    """Name of a junction that SUMO can hold."""
    if _SAFE_NAME.fullmatch(name):
        return name
    return "junction" + "".join(f"_{ord(letter)}" for letter in name)


def _write_link(link: tuple[str, _Link]) -> str:
    where, to = link
    contact = {"contactPoint": to.contact} if to.contact else {}
    return format_element(where, {"elementType": to.kind, "elementId": to.name, **contact})


def _write_geometry(road: ElementTree.Element) -> Iterator[str]:
    pieces = sorted(road.findall("planView/geometry"), key=lambda piece: number(piece, "s"))
    long = [piece for piece in pieces if number(piece, "length") > 1e-6]
    for piece in long or pieces[:1]:
        row: dict[str, object] = {
            key: number(piece, key) for key in ("s", "x", "y", "hdg", "length")
        }
        line = ElementTree.Element("line")
        shape = next((child for child in piece if child.tag in _SHAPE_KEYS), line)
        kind = shape.tag
        numbers = {key: number(shape, key, 0.0) for key in _SHAPE_KEYS[kind]}
        if kind == "spiral":
            bend = abs(numbers["curvEnd"] - numbers["curvStart"])
            if bend < _MIN_CURVATURE_PER_M:  # netconvert makes no spiral of it
                kind = "arc"
                numbers = {"curvature": numbers["curvStart"]}
        if kind == "arc" and abs(numbers["curvature"]) < _MIN_CURVATURE_PER_M:
            kind = "line"
            numbers = {}
        attributes: dict[str, object] = {**numbers}
        if kind == "paramPoly3":
            is_length = shape.get("pRange") == "arcLength"
            attributes["pRange"] = "arcLength" if is_length else "normalized"
        yield format_element("geometry", row, format_element(kind, attributes))


def _write_cubics(tag: str, key: str, function: Cubics) -> str:
    elements = []
    for s, (a, b, c, d) in zip(function.starts.tolist(), function.rows.tolist(), strict=True):
        elements.append(f'<{tag} {key}="{s}" a="{a}" b="{b}" c="{c}" d="{d}"></{tag}>')
    return "".join(elements)


def _write_sections(
    writer: _Writer,
    road: Carriageway,
    links: Mapping[str, _Link],
    defaults: Mapping[str, float],
    problems: Counter[str],
) -> Iterator[str]:
    numbers = [_number_lanes(section) for section in road.sections]
    before = links["predecessor"].numbers if "predecessor" in links else {}
    after = links["successor"].numbers if "successor" in links else {}
    around = [before, *numbers, after]
    for i, section in enumerate(road.sections):
        kinds = {
            lane: _find_kind(writer, road, section, lane, defaults, problems)
            for lane in section.lanes
        }
        text = ""
        for side, sign in (("left", 1), ("center", 0), ("right", -1)):
            if not sign:
                text += '<center><lane id="0" type="none"/></center>'
                continue
            lanes = [lane for lane in section.lanes if lane.number * writer.sign * sign > 0]
            lanes.sort(key=lambda lane: -lane.number * writer.sign)
            written = [
                _write_lane(
                    _drop_negative(section, lane),
                    kinds[lane],
                    writer.sign,
                    (around[i], around[i + 2]),
                )
                for lane in lanes
            ]
            text += format_element(side, {}, "".join(written)) if written else ""
        yield format_element("laneSection", {"s": section.start}, text)


def _drop_negative(section: LaneSection, lane: SectionLane) -> SectionLane:
    """Lane of no width, if its width is below zero all along; netconvert takes it for a lane of
    usual width."""
    if _sample_width(section, lane).max() >= 0.0:
        return lane
    return replace(lane, width=Cubics(np.zeros(1), np.zeros((1, 4))))


def _write_lane(
    lane: SectionLane, kind: str, sign: int, neighbours: tuple[Mapping[int, int], Mapping[int, int]]
) -> str:
    joined = ""
    for where, ids, numbers in zip(
        ("predecessor", "successor"), (lane.before, lane.after), neighbours, strict=True
    ):
        joined += "".join(
            format_element(where, {"id": sign * numbers[i]}) for i in ids[:1] if i in numbers
        )
    inside = format_element("link", {}, joined) if joined else ""
    inside += _write_cubics("width", "sOffset", lane.width)
    return format_element("lane", {"id": sign * lane.number, "type": kind}, inside)


def _find_kind(
    writer: _Writer,
    road: Carriageway,
    section: LaneSection,
    lane: SectionLane,
    defaults: Mapping[str, float],
    problems: Counter[str],
) -> str:
    """Name of the type of a lane that netconvert is handed."""
    use = lane_rules.find_use(road.element, section, lane, dict(defaults), problems)
    if use.limit is None and "passenger" in use.users and road.junction == "-1":
        problems[_NO_LIMIT] = 1  # of one road, however many lanes it has
    if lane in road.closed:
        use = lane_rules.LaneUse((), None)
    use = _close_both(section, lane, use, problems)
    kind = lane.kind if lane.kind in lane_rules.USERS else "unknown"
    usual = lane_rules.LaneUse(tuple(lane_rules.USERS.get(kind, "").split()), None)
    name = kind if use == usual else f"{kind}.{len(writer.uses)}"
    return writer.uses.setdefault((kind, use), name)


def _close_both(
    section: LaneSection, lane: SectionLane, use: lane_rules.LaneUse, problems: Counter[str]
) -> lane_rules.LaneUse:
    """Use of a lane whose traffic does not run in the direction of its side."""
    direction = lane.element.get("direction", "standard")
    if not use.users or set(use.users) == {FOOT}:
        return use
    if direction != "both" and lane.kind != "bidirectional":
        return use
    driven_lanes = [
        other_lane
        for other_lane in section.lanes
        if other_lane is not lane and _is_driven(other_lane)
    ]
    if driven_lanes:
        problems["lanes for both directions (turning lanes) are closed to through traffic"] += 1
        return lane_rules.LaneUse((), None)
    problems["lanes for both directions are driven in the direction of their side only"] += 1
    return use


def _is_driven(lane: SectionLane) -> bool:
    is_standard = (
        lane.element.get("direction", "standard") == "standard" and lane.kind != "bidirectional"
    )
    return is_standard and lane_rules.USERS.get(lane.kind) == MOTOR


def _write_signals(road: ElementTree.Element, sign: int) -> Iterator[str]:
    """Traffic lights and signs of priority; netconvert ignores all other signs."""
    for signal in road.findall("signals/signal"):
        kind = signal.get("type", "")
        name = signal.get("id", "")
        s = signal.get("s", "")
        is_read = kind in _TRAFFIC_LIGHTS or kind in _PRIORITY_SIGNS
        if not is_read or not _SAFE_NAME.fullmatch(name) or not _is_number(s):
            continue
        facing = signal.get("orientation", "none")
        dynamic = "no" if signal.get("dynamic") == "no" else "yes"
        row = {"id": name, "s": s, "type": kind, "orientation": facing, "dynamic": dynamic}
        yield format_element("signal", row, "".join(_write_validity(signal, sign)))
    for reference in road.findall("signals/signalReference"):
        name = reference.get("id", "")
        s = reference.get("s", "")
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


def _write_junction(
    writer: _Writer, name: str, junction: ElementTree.Element, *, is_direct: bool
) -> str:
    connections: list[str] = []
    for connection in junction.findall("connection"):
        incoming = connection.get("incomingRoad", "")
        contact = connection.get("contactPoint", "start")
        connecting = connection.get("linkedRoad" if is_direct else "connectingRoad", "")
        contact = contact if contact in ("start", "end") else "start"
        if incoming not in writer.roads or connecting not in writer.roads:
            writer.problems[f"junction {name}"][
                "connections of junctions lead to roads that are not in the file"
            ] += 1
            continue
        incoming_end = _find_contact(writer.roads[incoming][0], name)
        pairs = _read_pairs(connection, writer, (incoming, incoming_end), (connecting, contact))
        if len(pairs) < len(connection.findall("laneLink")):
            writer.problems[f"junction {name}"][
                "connections of junctions lead to lanes that are not in the file"
            ] += 1
        ways: dict[tuple[Carriageway, Carriageway, str], list[tuple[int, int]]] = defaultdict(list)
        for (road, from_lane), (to, to_lane) in pairs:
            if is_direct and (from_lane * writer.sign < 0) != (incoming_end == "end"):
                ways[to, road, incoming_end].append((to_lane, from_lane))
            else:
                ways[road, to, contact].append((from_lane, to_lane))
        connections += [
            _write_connection(len(connections), way, lanes, writer.sign)
            for way, lanes in ways.items()
        ]
    return format_element(
        "junction", {"id": _junction_name(name), "name": ""}, "".join(connections)
    )


def _find_contact(road: Carriageway, junction: str) -> str:
    """End of a road at which it meets a junction."""
    starts = road.element.findall("link/predecessor")
    meets = any(
        link.get("elementType") == "junction" and link.get("elementId") == junction
        for link in starts
    )
    return "start" if meets else "end"


_Place = tuple[Carriageway, int]


def _read_pairs(
    connection: ElementTree.Element,
    writer: _Writer,
    incoming: tuple[str, str],
    connecting: tuple[str, str],
) -> list[tuple[_Place, _Place]]:
    """Lanes that a connection joins. Without links, lanes of the same id (1.4, 5.4.2).

    incoming, connecting: id of a road, and the end at which it meets the junction or the
    connection."""
    texts = [(link.get("from", ""), link.get("to", "")) for link in connection.findall("laneLink")]
    lane_ids = [(int(a), int(b)) for a, b in texts if _WHOLE.fullmatch(a) and _WHOLE.fullmatch(b)]
    if not texts:
        incoming_lanes = {
            n for carriageway in writer.roads[incoming[0]] for n in carriageway.ends[incoming[1]]
        }
        lane_ids = [(n, n) for n in sorted(incoming_lanes)]
    pairs = []
    for a, b in lane_ids:
        # a road may meet it at both
        ends = (incoming[1], "end" if incoming[1] == "start" else "start")
        first = next(filter(None, (writer.find_lane(incoming[0], end, a) for end in ends)), None)
        last = writer.find_lane(*connecting, b)
        if first is not None and last is not None:
            pairs.append((first, last))
    return pairs


def _write_connection(
    number_: int,
    way: tuple[Carriageway, Carriageway, str],
    lanes: Sequence[tuple[int, int]],
    sign: int,
) -> str:
    incoming, connecting, contact = way
    row = {
        "id": number_,
        "incomingRoad": incoming.name,
        "connectingRoad": connecting.name,
        "contactPoint": contact,
    }
    links = [format_element("laneLink", {"from": sign * a, "to": sign * b}) for a, b in lanes]
    return format_element("connection", row, "".join(links))


def _note_left_out(writer: _Writer, name: str, junction: ElementTree.Element) -> None:
    kind = junction.get("type", "")
    roads = [road[0] for road in writer.roads.values() if road[0].junction == name]
    if kind == "virtual":
        text = (
            "virtual junctions are left out: the main road goes on, and traffic does not turn there"
        )
        for road in roads:
            problems = writer.problems[road.element.get("id", "")]
            problems["connecting roads of virtual junctions carry no traffic"] += 1
        near = [junction.get("mainRoad", "")]
    else:
        text = "crossing junctions are left out: traffic there does not give way"
        near = [section.get("roadId", "") for section in junction.findall("roadSection")]
    for road_id in near[:1]:
        writer.problems[road_id][text] += 1
