"""Carriageways: lanes of an OpenDRIVE road that are one road for netconvert.

Lanes that run against the usual direction of their side become carriageways of their road."""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from xml.etree import ElementTree

import numpy as np

from toolkit.sites.network import FOOT
from toolkit.sites.opendrive import lane_rules
from toolkit.sites.opendrive.contradictions import count_contradictions
from toolkit.sites.opendrive.cubics import Cubics, read_cubics, read_number
from toolkit.sites.opendrive.lane_sections import LaneSection, SectionLane, read_sections
from toolkit.sites.opendrive.plain_names import SAFE_NAME

MIN_ROAD_LENGTH_M = 2e-3  # given to a road whose geometry is shorter


@dataclass(frozen=True, eq=False)
class Carriageway:
    """Lanes of a road that are one road for netconvert.

    Attributes:
        element: the <road>.
        name: name of the road that netconvert gets, its plain road.
        length: length of the road by its geometry (m).
        sections: sections with lanes numbered as in the plain road.
        offset: m from the reference line to the middle of the lanes along s, positive to the
            left.
        ends: for "start" and "end" of the road, ids of the driven lanes there: in the file, and in
            the plain road.
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
class PlainWriter:
    """Roads of a map by id, and all that is collected while they are written.

    Attributes:
        root: the map.
        roads: carriageways by id of their road, those against the usual direction first.
        sign: -1 if traffic keeps left, as netconvert mirrors such a map, so that ids of lanes are
            written with the opposite sign; else 1.
        uses: name of SUMO's type for each type of lane and its use.
        problems: number of parts left out or changed, by the words of their note, and by the id of
            the road or "junction ID"."""

    root: ElementTree.Element
    roads: dict[str, list[Carriageway]] = field(default_factory=dict)
    sign: int = 1
    uses: dict[tuple[str, lane_rules.LaneUse], str] = field(default_factory=dict)
    problems: dict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))

    def find_lane(self, road: str, contact: str, lane_id: int) -> tuple[Carriageway, int] | None:
        """Find the carriageway of a lane at an end of a road, and the lane's id in it.

        road: id of the road; contact: "start" or "end"; lane_id: id in the file. None if no
        carriageway has the lane."""
        for carriageway in self.roads.get(road, ()):
            lane_ids = carriageway.ends[contact]  # by id in the file
            if lane_id in lane_ids:
                return carriageway, lane_ids[lane_id]
        return None


def read_carriageways(writer: PlainWriter) -> None:
    """Add the carriageways of all roads with lanes to a writer, and set its sign.

    Raises ValueError for a road or lane with a damaged number."""
    roads = writer.root.findall("road")
    rules = Counter(road.get("rule", "RHT") for road in roads)
    writer.sign = -1 if rules["LHT"] > rules["RHT"] else 1
    junction_ids = {junction.get("id", "") for junction in writer.root.findall("junction")}
    junction_ids.add("-1")
    for number, road in enumerate(roads):
        name = road.get("id", "")
        problems = writer.problems[name]
        if name in writer.roads:
            problems["roads have the id of another one and carry no traffic"] += 1
            continue
        junction = road.get("junction") or "-1"
        if junction not in junction_ids:
            problems["roads are part of a junction that is not in the file"] += 1
            junction = "-1"
        length = _measure_length(road)
        sections = _read_sections(road, length, is_inner=junction != "-1")
        if not any(section.lanes for section in sections):
            problems["roads have no lanes"] += 1
            continue
        count_contradictions(road, length, sections, problems)
        rule = road.get("rule", "RHT")
        if rule not in ("RHT", "LHT"):
            problems[f"roads with rule {rule[:20]!r} count as RHT"] += 1
        safe_name = name if SAFE_NAME.fullmatch(name) else f"coview{number}"
        offset = read_cubics(road.findall("lanes/laneOffset"))
        ends = _number_ends(sections)
        carriageway = Carriageway(
            element=road,
            name=safe_name,
            length=length,
            sections=sections,
            offset=offset,
            ends=ends,
            junction=junction,
        )
        keeps_other_side = (rule == "LHT") != (writer.sign < 0)
        writer.roads[name] = _part_directions(carriageway, keeps_other_side=keeps_other_side)


def _measure_length(road: ElementTree.Element) -> float:
    """Length (m) of a road by its geometry, at least `MIN_ROAD_LENGTH_M`."""
    geometries = road.findall("planView/geometry")
    ends = (read_number(row, "s") + read_number(row, "length") for row in geometries)
    return max(max(ends, default=0.0), MIN_ROAD_LENGTH_M)


def _read_sections(
    road: ElementTree.Element, length: float, *, is_inner: bool
) -> Sequence[LaneSection]:
    """Read the sections of a road, cut at places at which a limit or a rule of access changes.

    is_inner: the road is part of a junction, and is not cut."""
    # in a junction, links may lead through sections of no length, which are kept
    sections = read_sections(road, length, keep_empty=is_inner)
    if is_inner:
        return sections
    cuts = lane_rules.find_cuts(road, sections)
    cuts -= {section.start for section in sections}
    return read_sections(road, length, cuts) if cuts else sections


def _number_ends(sections: Sequence[LaneSection]) -> dict[str, dict[int, int]]:
    """Ids of the lanes at "start" and "end" of a road, each mapped to itself."""
    return {"start": number_section_lanes(sections[0]), "end": number_section_lanes(sections[-1])}


def number_section_lanes(section: LaneSection) -> dict[int, int]:
    """Ids of a section's lanes, each mapped to itself."""
    return {lane.number: lane.number for lane in section.lanes}


def _part_directions(road: Carriageway, *, keeps_other_side: bool) -> list[Carriageway]:
    """Divide a road into carriageways: contraflow lanes of each side, then all other lanes.

    Contraflow lanes are driven against the usual direction of their side. A road without them comes
    back unchanged.

    road: all lanes of the road as one carriageway; keeps_other_side: traffic of the road keeps to
    the other side than the map's, so that lanes not marked as reversed are contraflow lanes."""
    lanes = [lane for section in road.sections for lane in section.lanes]
    contraflow = {
        lane for lane in lanes if _is_reversed(lane) != keeps_other_side and _has_direction(lane)
    }
    if not contraflow:
        return [road]
    signs = {1 if lane.number > 0 else -1 for lane in contraflow}  # 1 for the left side
    carriageways = [_make_contraflow(road, contraflow, sign) for sign in sorted(signs)[::-1]]
    inner_sections = [_strip_section(section, contraflow) for section in road.sections]
    if any(section.lanes for section in inner_sections):
        ends = _number_ends(inner_sections)
        # ends of contraflow lanes are in their carriageways only
        for contact, lane_ids in ends.items():
            for carriageway in carriageways:
                for lane_id in carriageway.ends[contact]:
                    lane_ids.pop(lane_id, None)
        closed_lanes = frozenset(contraflow)
        carriageways.append(replace(road, sections=inner_sections, ends=ends, closed=closed_lanes))
    return carriageways


def _is_reversed(lane: SectionLane) -> bool:
    """True for a lane that the map says is driven against the usual direction of its side."""
    return lane.element.get("direction", "standard") == "reversed"


def _has_direction(lane: SectionLane) -> bool:
    """True for a lane of vehicles that is driven one way, whichever."""
    is_both = lane.kind == "bidirectional" or lane.element.get("direction") == "both"
    users = set(lane_rules.USERS.get(lane.kind, "").split())
    return not is_both and not users <= {FOOT}


def _strip_section(section: LaneSection, contraflow: set[SectionLane]) -> LaneSection:
    """Return a section without the contraflow lanes at its outer edges."""
    lanes = _strip_side(section.side(1), contraflow) + _strip_side(section.side(-1), contraflow)
    lanes.sort(key=lambda lane: -lane.number)
    return replace(section, lanes=tuple(lanes))


def _strip_side(lanes: Sequence[SectionLane], contraflow: set[SectionLane]) -> list[SectionLane]:
    """Return lanes of one side, from the middle outwards, without outer contraflow lanes.

    Contraflow lanes that have others outside them stay, to keep these in their places."""
    inner_lanes = list(lanes)
    while inner_lanes and inner_lanes[-1] in contraflow:
        inner_lanes.pop()
    return inner_lanes


@dataclass(frozen=True)
class _TurnedSection:
    """Lanes of one side of a section that run against it, turned to the other side.

    Attributes:
        section: section with the turned lanes.
        edge: m from the road's reference line to the outer border of the lanes along s, positive
            to the left.
        lane_ids: ids of the lanes in the file, and after the turn.
        closed: turned lanes that are between others, but do not run against their side."""

    section: LaneSection
    edge: Cubics
    lane_ids: Mapping[int, int]
    closed: frozenset[SectionLane]


def _make_contraflow(road: Carriageway, contraflow: set[SectionLane], sign: int) -> Carriageway:
    """Make a carriageway of the contraflow lanes of one side.

    They become lanes of the other side of a line along their outer border. contraflow: lanes of
    both sides that run against theirs; sign: 1 for the left side, -1 for the right."""
    turned_sections: list[_TurnedSection] = []
    for section in road.sections:
        previous_ids = turned_sections[-1].lane_ids if turned_sections else None
        turned_sections.append(_turn_section(road, section, contraflow, sign, previous_ids))
    closed_lanes = {lane for row in turned_sections for lane in row.closed}
    sections = [row.section for row in turned_sections]
    for i, next_row in enumerate(turned_sections[1:]):
        # links to the section after, whose new ids are known only now
        lanes = []
        for lane in sections[i].lanes:
            linked_lane = replace(lane, after=_renumber(lane.after, next_row.lane_ids))
            lanes.append(linked_lane)
            if lane in closed_lanes:
                closed_lanes.add(linked_lane)
        sections[i] = replace(sections[i], lanes=tuple(lanes))
    ends: dict[str, dict[int, int]] = {}
    for contact, index in (("start", 0), ("end", -1)):
        side = road.sections[index].side(sign)
        driven_ids = {lane.number for lane in side if lane in contraflow}
        lane_ids = turned_sections[index].lane_ids
        ends[contact] = {
            old_id: new_id for old_id, new_id in lane_ids.items() if old_id in driven_ids
        }
    starts = np.concatenate([row.edge.starts for row in turned_sections])
    rows = np.concatenate([row.edge.rows for row in turned_sections])
    name = f"{road.name}.{'left' if sign > 0 else 'right'}"
    return replace(
        road,
        name=name,
        sections=sections,
        offset=Cubics(starts, rows),
        ends=ends,
        closed=frozenset(closed_lanes),
    )


def _turn_section(
    road: Carriageway,
    section: LaneSection,
    contraflow: set[SectionLane],
    sign: int,
    previous_ids: Mapping[int, int] | None,
) -> _TurnedSection:
    """Turn the contraflow lanes of one side of a section to the other side of their outer border.

    Lanes between them are turned too, but closed. sign: 1 for the left side, -1 for the right;
    previous_ids: ids of the turned lanes in the section before, by their id in the file; None for
    the first section."""
    lanes = section.side(sign)  # from the middle outwards
    indices = [i for i, lane in enumerate(lanes) if lane in contraflow]
    inner_lanes = lanes[: indices[-1] + 1] if indices else ()  # up to the outermost one
    edge = road.offset.cut_start(section.start)
    for lane in inner_lanes:
        # to the left by each width on the left side, to the right on the right side
        edge = edge.subtract(lane.width.negate() if sign > 0 else lane.width)
    group = inner_lanes[indices[0] :] if indices else ()
    # the outermost lane is next to the new line
    lane_ids = {lane.number: -sign * (len(group) - i) for i, lane in enumerate(group)}
    turned_lanes = []
    closed_lanes = set()
    for lane in group:
        before = _renumber(lane.before, previous_ids)
        turned_lane = replace(lane, number=lane_ids[lane.number], before=before)
        turned_lanes.append(turned_lane)
        if lane not in contraflow:
            closed_lanes.add(turned_lane)
    turned_lanes.sort(key=lambda lane: -lane.number)
    return _TurnedSection(
        section=replace(section, lanes=tuple(turned_lanes)),
        edge=edge.move(section.start),
        lane_ids=lane_ids,
        closed=frozenset(closed_lanes),
    )


def _renumber(lane_ids: Sequence[int], new_ids: Mapping[int, int] | None) -> tuple[int, ...]:
    """Return ids of lanes as they are in a carriageway; lanes that it lacks are left out.

    lane_ids: ids in the file; new_ids: ids in the carriageway by id in the file, None at the end of
    a road, whose links are found later."""
    if new_ids is None:
        return tuple(lane_ids)
    return tuple(new_ids[lane_id] for lane_id in lane_ids if lane_id in new_ids)
