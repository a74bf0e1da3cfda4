"""Lane sections of an OpenDRIVE road, each whole: both sides, and the width of every lane.

A section that describes one side only (`singleSide`) leaves the other side as the section before
has it. A lane is as wide as its <width>; without one it reaches from the lane inside to its
<border>, which is counted from the reference line (ASAM OpenDRIVE 1.8, 11.3 to 11.6)."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np

from toolkit.sites.opendrive.cubics import Cubics, read_cubics, read_number

MIN_SECTION_M = 1e-3  # a shorter section has no length
MIN_PIECE_M = 0.5  # between cuts within a section
_SIDES = ("left", "right")


@dataclass(frozen=True, eq=False)
class SectionLane:
    """Lane of one section.

    Attributes:
        number: id of the lane, positive to the left of the reference line, growing outwards.
        kind: type of the lane in the map's words.
        width: width (m) along s, counted from the section's start.
        before: ids of the lanes that lead into it, in the section or road before.
        after: ids of the lanes it leads into.
        element: the <lane>.
        offset: m, from the start of the <laneSection> that describes it to this section's start."""

    number: int
    kind: str
    width: Cubics
    before: tuple[int, ...]
    after: tuple[int, ...]
    element: ElementTree.Element
    offset: float


@dataclass(frozen=True, eq=False)
class LaneSection:
    """Lanes from `start` to `end` along s (m), from the leftmost to the rightmost, without the
    centre lane."""

    start: float
    end: float
    lanes: tuple[SectionLane, ...]

    def side(self, sign: int) -> list[SectionLane]:
        """Lanes of one side from the middle outwards. sign: 1 for the left, -1 for the right."""
        return sorted(
            (lane for lane in self.lanes if lane.number * sign > 0),
            key=lambda lane: abs(lane.number),
        )


def read_sections(
    road: ElementTree.Element,
    length: float,
    cuts: Iterable[float] = (),
    *,
    keep_empty: bool = False,
) -> list[LaneSection]:
    """Read the sections of a <road> in order of s.

    length: length of the road (m), at which the last section ends; cuts: places along s (m) at
    which sections are cut too, unless nearer than `MIN_PIECE_M` to another cut or start;
    keep_empty: keep sections of no length, whose links may lead from the road before to the section
    after.

    Raises ValueError for a lane or section with a damaged number."""
    elements = road.findall("lanes/laneSection")
    elements.sort(key=lambda element: read_number(element, "s"))
    offset = read_cubics(road.findall("lanes/laneOffset"))
    sections: list[LaneSection] = []
    sources: dict[str, list[ElementTree.Element]] = {}
    for side in _SIDES:
        sources[side] = [element for element in elements if _describes(element, side)]
    starts = [read_number(element, "s") for element in elements]
    for cut in sorted(cuts):
        # `starts` grows: a cut keeps off earlier cuts too
        if min((abs(cut - start) for start in (*starts, length)), default=0.0) > MIN_PIECE_M:
            starts.append(cut)
    min_section = 0.0 if keep_empty else MIN_SECTION_M
    for start, end in pairwise([*sorted(set(starts)), length]):
        if keep_empty:
            sections += _read_empty(elements, start, offset)
        if 0 <= start < end - min_section:
            lanes: list[SectionLane] = []
            for side in _SIDES:
                described = _find_description(sources[side], start, length)
                lanes += _read_side(described, side, (start, end), offset) if described else []
            lanes.sort(key=lambda lane: -lane.number)
            sections.append(LaneSection(start, end, tuple(lanes)))
    return sections


def _read_empty(
    elements: Iterable[ElementTree.Element], start: float, lane_offset: Cubics
) -> list[LaneSection]:
    """Read the sections of no length at `start` (m along s), which describe both sides.

    They are all <laneSection> there but the last, which has a length.

    elements: all <laneSection> of the road, in order of s; lane_offset: m from the reference line
    to the middle of the lanes, along s."""
    elements_here = [
        element
        for element in elements
        if _describes(element, "left")
        and _describes(element, "right")
        and read_number(element, "s") == start
    ]
    sections = []
    for element in elements_here[:-1]:
        description = _Description(element, start=start, end=start)
        lanes: list[SectionLane] = []
        for side in _SIDES:
            lanes += _read_side(description, side, (start, start), lane_offset)
        lanes.sort(key=lambda lane: -lane.number)
        sections.append(LaneSection(start=start, end=start, lanes=tuple(lanes)))
    return sections


def _describes(section: ElementTree.Element, side: str) -> bool:
    """True if a <laneSection> describes the lanes of one side."""
    return (
        section.get("singleSide", "") not in ("true", "1")
        or section.find(f"{side}/lane") is not None
    )


@dataclass(frozen=True)
class _Description:
    """<laneSection> that describes a side, and its start and end along s (m)."""

    element: ElementTree.Element
    start: float
    end: float


def _find_description(
    elements: Sequence[ElementTree.Element], place: float, length: float
) -> _Description | None:
    """Find the <laneSection> that is valid at a place for one side; None before the first.

    elements: all that describe the side, in order of s; place: m along s; length: length of the
    road (m)."""
    starts = [read_number(element, "s") for element in elements]
    index = int(np.searchsorted(starts, place, side="right")) - 1  # last start up to the place
    if index < 0:
        return None
    end = starts[index + 1] if index + 1 < len(starts) else length
    return _Description(elements[index], start=starts[index], end=end)


def _read_side(
    described: _Description, side: str, span: tuple[float, float], lane_offset: Cubics
) -> list[SectionLane]:
    """Read the lanes of one side over a span of s, from the middle outwards.

    described: the <laneSection>, which may begin before the span and end after it; side: "left" or
    "right"; span: start and end (m); lane_offset: m from the reference line to the middle of the
    lanes, along s."""
    elements = described.element.findall(f"{side}/lane")
    elements.sort(key=lambda lane: abs(read_number(lane, "id")))
    widths = {lane: read_cubics(lane.findall("width"), "sOffset") for lane in elements}
    if any(lane.find("border") is not None for lane in elements):
        widths = _complete_widths(
            widths, lane_offset.cut_start(described.start), is_left=side == "left"
        )
    offset = span[0] - described.start
    is_first = offset < MIN_SECTION_M
    is_last = described.end < span[1] + MIN_SECTION_M
    lanes = []
    for lane in elements:
        # within its <laneSection> a lane goes on as itself
        itself = (int(read_number(lane, "id")),)
        lanes.append(
            SectionLane(
                number=itself[0],
                kind=lane.get("type") or "none",
                width=widths[lane].cut_start(offset)
                if offset > 0 and len(widths[lane].starts)
                else widths[lane],
                before=_links(lane, "predecessor") if is_first else itself,
                after=_links(lane, "successor") if is_last else itself,
                element=lane,
                offset=offset,
            )
        )
    return lanes


def _complete_widths(
    widths: dict[ElementTree.Element, Cubics], middle: Cubics, *, is_left: bool
) -> dict[ElementTree.Element, Cubics]:
    """Return widths (m) of one side's lanes, taken from <border> for lanes without a <width>.

    widths: by <lane>, from the middle outwards; middle: m from the reference line to the inner edge
    of the first lane, positive to the left. All functions are along s from the start of the
    <laneSection>; is_left: the side's lanes are to the left of the middle."""
    complete_widths = {}
    inner_border = middle
    for lane, width in widths.items():
        borders = lane.findall("border")
        if borders and not len(width.starts):
            outer_border = read_cubics(borders, "sOffset")
            lane_width = (
                outer_border.subtract(inner_border)
                if is_left
                else inner_border.subtract(outer_border)
            )
        else:
            outer_border = inner_border.subtract(width.negate() if is_left else width)
            lane_width = width
        complete_widths[lane] = lane_width
        inner_border = outer_border
    return complete_widths


def _links(lane: ElementTree.Element, which: str) -> tuple[int, ...]:
    """Ids of the lanes that a <lane> is linked to; links without a whole number lead nowhere.

    which: "predecessor" or "successor"."""
    names = (link.get("id", "").strip() for link in lane.findall(f"link/{which}"))
    return tuple(int(name) for name in names if re.fullmatch(r"[-+]?\d{1,9}", name))
