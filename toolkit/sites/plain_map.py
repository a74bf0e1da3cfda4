"""Roads of an OpenDRIVE map as netconvert reads them: plain lanes, links and junctions of OpenDRIVE
1.4.

netconvert reads half of the standard and stops at much of the rest. So it is handed what it reads
right, in the terms it knows: names of roads that SUMO can hold, lanes in order, limits per section,
users per lane, links that lead somewhere. What cannot be handed on is counted. Without its
<geoReference>, header offset, objects and signs, the map is in metres and nothing beside the road
stops it."""

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
# of a lane, below which it is noted; places along its section
MIN_WIDTH_M = -0.1
WIDTH_SAMPLES = 9
MAX_KERB_M = 0.25
MAX_LENGTH_GAP_M = 1.0
MAX_LENGTH_GAP_SHARE = 0.02
_STRAIGHT = 1e-10  # 1/m; less curvature is ignored
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
        problems: what could not be handed on, by id of the road or junction.
        carriageways: roads that netconvert is handed."""

    text: str
    types: Sequence[Mapping[str, object]]
    lefthand: bool
    problems: dict[str, Counter[str]]
    carriageways: "Sequence[Carriageway]" = ()


@dataclass(frozen=True, eq=False)
class Carriageway:
    """Lanes of a road that netconvert is handed as one road.

    Attributes:
        element: the <road>.
        name: of the plain road.
        length: m.
        sections: with lanes numbered as in the plain road.
        offset: m, of the middle of these lanes to the left of the reference line.
        ends: ids in the file and in the plain road, of the lanes at "start" and "end".
        junction: id of the junction it is part of, or -1.
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
    """Roads of a map by id, and what is found while they are written."""

    root: ElementTree.Element
    roads: dict[str, list[Carriageway]] = field(default_factory=dict)
    sign: int = 1  # of lanes: -1 in a map whose traffic keeps left, which netconvert mirrors
    uses: dict[tuple[str, lane_rules.LaneUse], str] = field(default_factory=dict)
    problems: dict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))

    def find_lane(self, road: str, contact: str, number_: int) -> tuple[Carriageway, int] | None:
        """Carriageway of a lane at an end of a road, and the lane's id there."""
        for carriageway in self.roads.get(road, ()):
            if number_ in carriageway.ends[contact]:
                return carriageway, carriageway.ends[contact][number_]
        return None


def write_plain(root: ElementTree.Element) -> PlainMap:
    """Write the roads of a map for netconvert. Raises ValueError for a damaged road, lane or
    geometry."""
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
        else:
            if junction.find("priority") is not None:
                writer.problems[f"junction {name}"][
                    "junctions have priorities, which are not read"
                ] += 1
            if junction.find("elevationGrid") is not None:
                writer.problems[f"junction {name}"][
                    "junctions have a grid of heights, which is not read"
                ] += 1
            elements.append(
                _write_junction(writer, name, junction, is_direct=kinds[name] == "direct")
            )
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
    return PlainMap(text, types, writer.sign < 0, dict(writer.problems), carriageways)


def describe_problems(plain: PlainMap, roads: Sequence[MapRoad]) -> list[str]:
    """Notes of what of `roads` and their junctions was not handed to netconvert as the map has
    it."""
    names = {road.element.get("id", "") for road in roads}
    junctions = {
        link.get("elementId", "") for road in roads for link in road.element.findall("link/*")
    }
    counted: Counter[str] = Counter()
    for name in sorted({"", *names, *(f"junction {junction}" for junction in junctions)}):
        counted.update(plain.problems.get(name, {}))
    for road in roads:
        counted.update(count_unread(road.element))
        gaps = (
            abs(piece.measure_curve() - piece.length) / max(piece.length, MAX_LENGTH_GAP_M)
            for piece in road.pieces
        )
        counted["curves are not as long as their geometry says"] += sum(
            gap > MAX_LENGTH_GAP_SHARE for gap in gaps
        )
    return [f"{count} {text}" for text, count in counted.items() if count]


def count_unread(road: ElementTree.Element) -> dict[str, int]:
    """Number of things of a road that bear on traffic or the ground and are not read, by the words
    of a note."""
    plates = [
        s
        for s in road.findall("signals/signal")
        if s.get("type") not in (*_TRAFFIC_LIGHTS, *_PRIORITY_SIGNS)
    ]
    heights = road.findall("lanes/laneSection/*/lane/height")
    high = [
        h
        for h in heights
        if max(abs(number(h, key, 0.0)) for key in ("inner", "outer")) > MAX_KERB_M
    ]
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


def _count_marks(road: ElementTree.Element) -> int:
    """Number of lanes from which road marks forbid a change to the driving lane outside them."""
    count = 0
    for side in road.findall("lanes/laneSection/*"):
        lanes = {
            lane.get("id", ""): lane
            for lane in side.findall("lane")
            if lane.get("type") == "driving"
        }
        for name, lane in lanes.items():
            is_inside = (
                _WHOLE.fullmatch(name)
                and str(int(name) + (1 if side.tag == "left" else -1)) in lanes
            )
            marks = lane.findall("roadMark")
            count += bool(is_inside) and any(
                mark.get("laneChange", "both") != "both" for mark in marks
            )
    return count


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
    known = {"-1", *(junction.get("id", "") for junction in writer.root.findall("junction"))}
    for i, road in enumerate(writer.root.findall("road")):
        name = road.get("id", "")
        if name in writer.roads:
            writer.problems[name]["roads have the id of another one and carry no traffic"] += 1
            continue
        length = max(_road_length(road), 2e-3)
        junction = road.get("junction") or "-1"
        if junction not in known:
            writer.problems[name]["roads are part of a junction that is not in the file"] += 1
            junction = "-1"
        is_inner = junction != "-1"
        sections = read_sections(road, length, keep_empty=is_inner)
        cuts = (
            set()
            if is_inner
            else lane_rules.find_cuts(road, sections) - {section.start for section in sections}
        )
        if cuts:
            sections = read_sections(road, length, cuts)
        if not any(section.lanes for section in sections):
            writer.problems[name]["roads have no lanes"] += 1
            continue
        _check_road(road, length, sections, writer.problems[name])
        rule = road.get("rule", "RHT")
        if rule not in ("RHT", "LHT"):
            writer.problems[name][f"roads with rule {rule[:20]!r} count as RHT"] += 1
        safe = name if _SAFE_NAME.fullmatch(name) else f"coview{i}"
        keeps_other_side = (rule == "LHT") != (writer.sign < 0)
        offset = cubics(road.findall("lanes/laneOffset"))
        whole = Carriageway(road, safe, length, sections, offset, _number_ends(sections), junction)
        writer.roads[name] = _part_directions(whole, keeps_other_side=keeps_other_side)


def _number_ends(sections: Sequence[LaneSection]) -> dict[str, dict[int, int]]:
    return {"start": _number_lanes(sections[0]), "end": _number_lanes(sections[-1])}


def _number_lanes(section: LaneSection) -> dict[int, int]:
    """Ids of a section's lanes, each by itself."""
    return {lane.number: lane.number for lane in section.lanes}


def _part_directions(road: Carriageway, *, keeps_other_side: bool) -> list[Carriageway]:
    """Carriageways of a road, first of the lanes that run against the usual direction of their
    side."""
    lanes = [lane for section in road.sections for lane in section.lanes]
    against = {
        lane for lane in lanes if _runs_against(lane) != keeps_other_side and _has_direction(lane)
    }
    if not against:
        return [road]
    kept: list[LaneSection] = []
    for section in road.sections:
        inside = [*_strip_outer(section.side(1), against), *_strip_outer(section.side(-1), against)]
        kept.append(replace(section, lanes=tuple(sorted(inside, key=lambda lane: -lane.number))))
    signs = {1 if lane.number > 0 else -1 for lane in against}
    parts = [_contraflow(road, against, sign) for sign in sorted(signs, reverse=True)]
    if any(section.lanes for section in kept):
        ends = _number_ends(kept)
        for contact, numbers in ends.items():
            for lane_number in (n for part in parts for n in part.ends[contact]):
                numbers.pop(lane_number, None)
        parts.append(replace(road, sections=kept, ends=ends, closed=frozenset(against)))
    return parts


def _runs_against(lane: SectionLane) -> bool:
    return lane.element.get("direction", "standard") == "reversed"


def _has_direction(lane: SectionLane) -> bool:
    is_both = lane.kind == "bidirectional" or lane.element.get("direction") == "both"
    return not is_both and not set(lane_rules.USERS.get(lane.kind, "").split()) <= {FOOT}


def _strip_outer(lanes: Sequence[SectionLane], against: set[SectionLane]) -> list[SectionLane]:
    """Lanes of one side from the middle outwards, without the outermost ones that run against
    it."""
    inside = list(lanes)
    while inside and inside[-1] in against:
        inside.pop()
    return inside


def _contraflow(road: Carriageway, against: set[SectionLane], sign: int) -> Carriageway:
    """Lanes of one side that run against it, as lanes of the other side of a line along their outer
    border."""
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
        turned = [
            replace(
                lane,
                number=numbers[lane.number],
                before=_renumber(lane.before, maps[-1] if maps else None),
            )
            for lane in group
        ]
        closed |= {new for new, lane in zip(turned, group, strict=True) if lane not in against}
        sections.append(
            LaneSection(
                section.start, section.end, tuple(sorted(turned, key=lambda lane: -lane.number))
            )
        )
        maps.append(numbers)
    for i, numbers in enumerate(maps[1:]):
        ahead = tuple(
            replace(lane, after=_renumber(lane.after, numbers)) for lane in sections[i].lanes
        )
        closed |= {
            new for new, lane in zip(ahead, sections[i].lanes, strict=True) if lane in closed
        }
        sections[i] = replace(sections[i], lanes=ahead)
    ends: dict[str, dict[int, int]] = {}
    for contact, place in (("start", 0), ("end", -1)):
        driven = {lane.number for lane in road.sections[place].side(sign) if lane in against}
        ends[contact] = {old: new for old, new in maps[place].items() if old in driven}
    name = f"{road.name}.{'left' if sign > 0 else 'right'}"
    offset = Cubics(np.array(starts), np.array(rows).reshape(-1, 4))
    return Carriageway(
        road.element, name, road.length, sections, offset, ends, road.junction, frozenset(closed)
    )


def _renumber(numbers: Sequence[int], known: Mapping[int, int] | None) -> tuple[int, ...]:
    """Ids of lanes as they are in a carriageway. known: None at the end of a road, whose links are
    found later."""
    return tuple(numbers) if known is None else tuple(known[n] for n in numbers if n in known)


def _check_road(
    road: ElementTree.Element,
    length: float,
    sections: Sequence[LaneSection],
    problems: Counter[str],
) -> None:
    """Count what contradicts itself in a road."""
    attribute = road.get("length", "")
    if _is_number(attribute) and abs(float(attribute) - length) > max(
        MAX_LENGTH_GAP_M, MAX_LENGTH_GAP_SHARE * length
    ):
        problems["roads are not as long as their geometry, which counts"] += 1
    for section in sections:
        numbers = Counter(lane.number for lane in section.lanes)
        problems["lanes have the id of another lane beside them"] += sum(
            n - 1 for n in numbers.values()
        )
        lowest = [_sample_width(section, lane).min() for lane in section.lanes]
        problems["lanes have a width below zero, which counts as zero"] += sum(
            w < MIN_WIDTH_M for w in lowest
        )
    gap = max(MAX_LENGTH_GAP_M, MAX_LENGTH_GAP_SHARE * length)
    starts = [number(section, "s") for section in road.findall("lanes/laneSection")]
    outside = sum(not -gap <= start <= length + gap for start in starts)
    problems["lane sections begin beyond the ends of their road and are left out"] += outside
    for side, sign in (("left", 1), ("right", -1)):
        ids = [number(lane, "id") for lane in road.findall(f"lanes/laneSection/{side}/lane")]
        problems["lanes have an id of the other side, where they are drawn"] += sum(
            sign * i <= 0 for i in ids
        )


def _sample_width(section: LaneSection, lane: SectionLane) -> Float64[np.ndarray, " k"]:
    """Widths (m) of a lane at places along its section."""
    return lane.width.at(np.linspace(0.0, section.end - section.start, WIDTH_SAMPLES))


def _road_length(road: ElementTree.Element) -> float:
    ends = [
        number(piece, "s") + number(piece, "length") for piece in road.findall("planView/geometry")
    ]
    return max(ends, default=0.0)


def _write_road(
    writer: _Writer, road: Carriageway, left_out: set[str], defaults: Mapping[str, float]
) -> str:
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
    """Road or junction that a road leads to, and of a road the end and the ids of lanes there, in
    the file and here."""

    kind: str
    name: str
    contact: str = ""
    numbers: Mapping[int, int] = field(default_factory=dict)


def _find_links(
    writer: _Writer, road: Carriageway, left_out: set[str], problems: Counter[str]
) -> Iterator[tuple[str, _Link]]:
    for where, usual in (("predecessor", "end"), ("successor", "start")):
        for link in road.element.findall(f"link/{where}"):
            name = link.get("elementId", "")
            kind = link.get("elementType", "")
            if link.get("elementS") is not None or (kind == "junction" and name in left_out):
                problems["roads that branch off within another road are not joined to it"] += 1
            elif kind == "junction":
                yield where, _Link(kind, _junction_name(name))
            elif kind == "road" and name in writer.roads:
                contact = link.get("contactPoint", usual)
                contact = contact if contact in ("start", "end") else usual
                other = _find_partner(writer, road, where, name, contact)
                if other.junction not in left_out:
                    yield where, _Link(kind, other.name, contact, other.ends[contact])
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
            place = writer.find_lane(name, contact, number_)
            if place is not None and lane not in road.closed:
                partners[place[0]] += 1
    return partners.most_common(1)[0][0] if partners else writer.roads[name][-1]


def _junction_name(name: str) -> str:
    return (
        name
        if _SAFE_NAME.fullmatch(name)
        else "junction" + "".join(f"_{ord(letter)}" for letter in name)
    )


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
        shape = next(
            (child for child in piece if child.tag in _SHAPE_KEYS), ElementTree.Element("line")
        )
        kind = shape.tag
        numbers = {key: number(shape, key, 0.0) for key in _SHAPE_KEYS[kind]}
        if kind == "spiral" and abs(numbers["curvEnd"] - numbers["curvStart"]) < _STRAIGHT:
            # netconvert makes no spiral of it
            kind = "arc"
            numbers = {"curvature": numbers["curvStart"]}
        if kind == "arc" and abs(numbers["curvature"]) < _STRAIGHT:
            kind = "line"
            numbers = {}
        is_length = shape.get("pRange") == "arcLength"
        parameter = (
            {"pRange": "arcLength" if is_length else "normalized"} if kind == "paramPoly3" else {}
        )
        yield format_element("geometry", row, format_element(kind, {**numbers, **parameter}))


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
    for where, ids, known in zip(
        ("predecessor", "successor"), (lane.before, lane.after), neighbours, strict=True
    ):
        joined += "".join(
            format_element(where, {"id": sign * known[i]}) for i in ids[:1] if i in known
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
    driven = [other for other in section.lanes if other is not lane and _is_driven(other)]
    if driven:
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
        if (
            kind not in (*_TRAFFIC_LIGHTS, *_PRIORITY_SIGNS)
            or not _SAFE_NAME.fullmatch(name)
            or not _is_number(s)
        ):
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
        other = connection.get("linkedRoad" if is_direct else "connectingRoad", "")
        contact = contact if contact in ("start", "end") else "start"
        if incoming not in writer.roads or other not in writer.roads:
            writer.problems[f"junction {name}"][
                "connections of junctions lead to roads that are not in the file"
            ] += 1
            continue
        meets = _find_contact(writer.roads[incoming][0], name)
        pairs = _read_pairs(connection, writer, (incoming, meets), (other, contact))
        if len(pairs) < len(connection.findall("laneLink")):
            writer.problems[f"junction {name}"][
                "connections of junctions lead to lanes that are not in the file"
            ] += 1
        ways: dict[tuple[Carriageway, Carriageway, str], list[tuple[int, int]]] = defaultdict(list)
        for (road, a), (to, b) in pairs:
            if is_direct and (a * writer.sign < 0) != (meets == "end"):
                ways[to, road, meets].append((b, a))
            else:
                ways[road, to, contact].append((a, b))
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
    other: tuple[str, str],
) -> list[tuple[_Place, _Place]]:
    """Lanes that a connection joins. Without links, lanes of the same id (1.4, 5.4.2).

    incoming, other: id of a road, and the end at which it meets the junction or the connection."""
    texts = [(link.get("from", ""), link.get("to", "")) for link in connection.findall("laneLink")]
    whole = [(int(a), int(b)) for a, b in texts if _WHOLE.fullmatch(a) and _WHOLE.fullmatch(b)]
    if not texts:
        known = {
            n for carriageway in writer.roads[incoming[0]] for n in carriageway.ends[incoming[1]]
        }
        whole = [(n, n) for n in sorted(known)]
    pairs = []
    for a, b in whole:
        # a road may meet it at both
        ends = (incoming[1], "end" if incoming[1] == "start" else "start")
        first = next(filter(None, (writer.find_lane(incoming[0], end, a) for end in ends)), None)
        last = writer.find_lane(*other, b)
        if first is not None and last is not None:
            pairs.append((first, last))
    return pairs


def _write_connection(
    number_: int,
    way: tuple[Carriageway, Carriageway, str],
    lanes: Sequence[tuple[int, int]],
    sign: int,
) -> str:
    incoming, other, contact = way
    row = {
        "id": number_,
        "incomingRoad": incoming.name,
        "connectingRoad": other.name,
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
