"""Contradictions within an OpenDRIVE road."""

from collections import Counter
from collections.abc import Sequence
from xml.etree import ElementTree

import numpy as np

from toolkit.arrays import Float64
from toolkit.sites.opendrive.cubics import read_number
from toolkit.sites.opendrive.lane_sections import LaneSection, SectionLane
from toolkit.sites.opendrive.plain_names import is_number

MIN_WIDTH_M = -0.1  # a narrower lane is noted
WIDTH_SAMPLES = 9  # places along a section at which the width of a lane is taken
MAX_LENGTH_GAP_M = 1.0  # between two lengths of a road that agree
MAX_LENGTH_GAP_SHARE = 0.02  # the same, as a share of the length


def count_contradictions(
    road: ElementTree.Element,
    length: float,
    sections: Sequence[LaneSection],
    problems: Counter[str],
) -> None:
    """Count the contradictions within a <road> in `problems`, by the words of their note.

    length: length of the road by its geometry (m); sections: as read from the road."""
    max_gap = max(MAX_LENGTH_GAP_M, MAX_LENGTH_GAP_SHARE * length)
    stated_length = road.get("length", "")
    if is_number(stated_length) and abs(float(stated_length) - length) > max_gap:
        problems["roads are not as long as their geometry, which counts"] += 1
    for section in sections:
        lane_ids = {lane.number for lane in section.lanes}
        duplicate_count = len(section.lanes) - len(lane_ids)
        problems["lanes have the id of another lane beside them"] += duplicate_count
        min_widths = [sample_width(section, lane).min() for lane in section.lanes]  # m
        negative_count = sum(width < MIN_WIDTH_M for width in min_widths)
        problems["lanes have a width below zero, which counts as zero"] += negative_count
    # m along the road; `sections` lacks the ones that are left out
    starts = [read_number(section, "s") for section in road.findall("lanes/laneSection")]
    outside_count = sum(not -max_gap <= start <= length + max_gap for start in starts)
    problems["lane sections begin beyond the ends of their road and are left out"] += outside_count
    for side, sign in (("left", 1), ("right", -1)):  # ids are positive on the left
        lanes = road.findall(f"lanes/laneSection/{side}/lane")
        wrong_count = sum(sign * read_number(lane, "id") <= 0 for lane in lanes)
        problems["lanes have an id of the other side, where they are drawn"] += wrong_count


def sample_width(section: LaneSection, lane: SectionLane) -> Float64[np.ndarray, " k"]:
    """Widths (m) of a lane at `WIDTH_SAMPLES` places along its section, which may be negative."""
    return lane.width.at(np.linspace(0.0, section.end - section.start, WIDTH_SAMPLES))
