"""Text of lanes for netconvert: sections, widths, links and types in OpenDRIVE 1.4."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from toolkit.sites.network import format_element
from toolkit.sites.opendrive.carriageways import Carriageway, PlainWriter, number_section_lanes
from toolkit.sites.opendrive.contradictions import sample_width
from toolkit.sites.opendrive.cubics import Cubics
from toolkit.sites.opendrive.lane_sections import LaneSection, SectionLane
from toolkit.sites.opendrive.plain_lane_types import find_lane_type
from toolkit.sites.opendrive.plain_links import Direction, PlainLink

CENTRE_LANE = '<center><lane id="0" type="none"/></center>'


class _LaneIds(NamedTuple):
    """Ids of the lanes before and after a section: in the file, and those that netconvert gets."""

    before: Mapping[int, int]
    after: Mapping[int, int]


def write_sections(
    writer: PlainWriter,
    road: Carriageway,
    links: Mapping[Direction, PlainLink],
    defaults: Mapping[str, float],
    problems: Counter[str],
) -> Iterator[str]:
    """Yield the texts of the <laneSection> elements of a carriageway.

    writer: collects the uses of lanes; links: other roads at the carriageway's ends, by
    "predecessor" and "successor"; defaults: limits (m/s) by type of road; problems: differences
    from the map are counted there."""
    section_ids = [number_section_lanes(section) for section in road.sections]
    first_ids = links["predecessor"].lane_ids if "predecessor" in links else {}
    last_ids = links["successor"].lane_ids if "successor" in links else {}
    # ids before the first section, of each section, and after the last: i is before section i
    lane_ids = [first_ids, *section_ids, last_ids]
    for i, section in enumerate(road.sections):
        kinds = {  # names of SUMO's types
            lane: find_lane_type(writer, road, section, lane, defaults, problems)
            for lane in section.lanes
        }
        neighbours = _LaneIds(before=lane_ids[i], after=lane_ids[i + 2])
        left = _write_side(section, kinds, neighbours, map_sign=writer.sign, side_sign=1)
        right = _write_side(section, kinds, neighbours, map_sign=writer.sign, side_sign=-1)
        yield format_element("laneSection", {"s": section.start}, left + CENTRE_LANE + right)


def _write_side(
    section: LaneSection,
    kinds: Mapping[SectionLane, str],
    neighbours: _LaneIds,
    *,
    map_sign: int,
    side_sign: int,
) -> str:
    """Text of the <left> or <right> of a section; empty if it has no lanes there.

    kinds: names of SUMO's types of the lanes; neighbours: ids of the lanes before and after the
    section; map_sign: -1 if netconvert mirrors the map, so that ids get the opposite sign, else 1;
    side_sign: 1 for <left>, -1 for <right>."""
    lanes = [lane for lane in section.lanes if lane.number * map_sign * side_sign > 0]
    lanes.sort(key=lambda lane: -lane.number * map_sign)
    if not lanes:
        return ""
    texts = []
    for lane in lanes:
        written_lane = _raise_negative_width(section, lane)
        texts.append(_write_lane(written_lane, kinds[lane], map_sign, neighbours))
    return format_element("left" if side_sign > 0 else "right", {}, "".join(texts))


def _raise_negative_width(section: LaneSection, lane: SectionLane) -> SectionLane:
    """Return a lane, with width 0 if its width is below zero all along.

    netconvert would take such a lane for one of usual width."""
    if sample_width(section, lane).max() >= 0.0:
        return lane
    return replace(lane, width=Cubics(starts=np.zeros(1), rows=np.zeros((1, 4))))


def _write_lane(lane: SectionLane, kind: str, map_sign: int, neighbours: _LaneIds) -> str:
    """Text of the <lane> of OpenDRIVE 1.4; only the first link at each end is written.

    kind: name of SUMO's type of the lane; map_sign: -1 if ids get the opposite sign, else 1;
    neighbours: ids of the lanes before and after its section, in the file and as netconvert gets
    them."""
    links = ""
    for before_id in lane.before[:1]:  # none or one
        if before_id in neighbours.before:
            new_id = map_sign * neighbours.before[before_id]
            links += format_element("predecessor", {"id": new_id})
    for after_id in lane.after[:1]:
        if after_id in neighbours.after:
            new_id = map_sign * neighbours.after[after_id]
            links += format_element("successor", {"id": new_id})
    content = format_element("link", {}, links) if links else ""
    content += write_cubics("width", "sOffset", lane.width)
    return format_element("lane", {"id": map_sign * lane.number, "type": kind}, content)


def write_cubics(tag: str, key: str, function: Cubics) -> str:
    """Text of elements with a, b, c, d, one for each piece of a function.

    tag: the elements' tag; key: attribute of a piece's start."""
    elements = []
    for start, row in zip(function.starts.tolist(), function.rows.tolist(), strict=True):
        a, b, c, d = row
        elements.append(f'<{tag} {key}="{start}" a="{a}" b="{b}" c="{c}" d="{d}"></{tag}>')
    return "".join(elements)
