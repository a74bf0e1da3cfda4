"""Notes of the parts of an OpenDRIVE map that netconvert does not get, or gets otherwise."""

from collections import Counter
from collections.abc import Sequence
from xml.etree import ElementTree

from toolkit.sites.opendrive.contradictions import MAX_LENGTH_GAP_M, MAX_LENGTH_GAP_SHARE
from toolkit.sites.opendrive.cubics import read_number
from toolkit.sites.opendrive.map_roads import MapRoad
from toolkit.sites.opendrive.plain_map import PlainMap
from toolkit.sites.opendrive.plain_names import WHOLE_NUMBER
from toolkit.sites.opendrive.plain_signals import PRIORITY_SIGNS, TRAFFIC_LIGHTS
from toolkit.sites.opendrive.reference_line import Piece

MAX_KERB_M = 0.25  # height of a lane above the road's surface up to which it counts as a kerb


def describe_problems(plain: PlainMap, roads: Sequence[MapRoad]) -> list[str]:
    """Return notes on roads and their junctions that were changed or left out for netconvert.

    plain: the map as netconvert got it, with its problems; roads: roads near the site."""
    # keys of `plain.problems`: the header, and the roads and junctions near the site
    names = {""}
    for road in roads:
        names.add(road.element.get("id", ""))
        links = road.element.findall("link/*")
        names.update(f"junction {link.get('elementId', '')}" for link in links)
    counts: Counter[str] = Counter()  # by the words of a note
    for name in sorted(names):
        counts.update(plain.problems.get(name, {}))
    for road in roads:
        counts.update(count_unread(road.element))
        gaps = [_measure_length_gap(piece) for piece in road.pieces]
        curve_count = sum(gap > MAX_LENGTH_GAP_SHARE for gap in gaps)
        counts["curves are not as long as their geometry says"] += curve_count
    return [f"{count} {text}" for text, count in counts.items() if count]


def _measure_length_gap(piece: Piece) -> float:
    """Difference between the length of a piece's curve and its stated length, as a share.

    A stated length below `MAX_LENGTH_GAP_M` counts as that long."""
    return abs(piece.measure_curve() - piece.length) / max(piece.length, MAX_LENGTH_GAP_M)


def count_unread(road: ElementTree.Element) -> dict[str, int]:
    """Count the unread elements of a <road> that bear on traffic or the ground, by their note."""
    read_types = TRAFFIC_LIGHTS + PRIORITY_SIGNS
    signals = road.findall("signals/signal")
    plates = [signal for signal in signals if signal.get("type") not in read_types]  # other signs
    heights = road.findall("lanes/laneSection/*/lane/height")
    steps = [height for height in heights if _measure_height(height) > MAX_KERB_M]
    strips = road.findall("lateralProfile/crossSectionSurface")
    lane_rules = road.findall("lanes/laneSection/*/lane/rule")
    return {
        "lanes may be left where road marks forbid it": _count_no_change_lanes(road),
        "signs are plates, which traffic does not obey": len(plates),
        "tunnels have no walls and roof in the site": len(road.findall("objects/tunnel")),
        "surfaces in OpenCRG files are not read": len(road.findall("surface/CRG")),
        "cross sections of strips are not read": len(strips),
        f"heights of lanes beyond a kerb's {MAX_KERB_M:g} m are not read": len(steps),
        "rules of lanes in words are not read": len(lane_rules),
    }


def _measure_height(element: ElementTree.Element) -> float:
    """Greatest distance (m) of a lane from its road's surface, up or down, by its <height>."""
    inner_height = read_number(element, "inner", 0.0)
    outer_height = read_number(element, "outer", 0.0)
    return max(abs(inner_height), abs(outer_height))


def _count_no_change_lanes(road: ElementTree.Element) -> int:
    """Count the lanes from which road marks forbid a change to the driving lane farther outside.

    The marks of a lane are on its outer edge. Ids grow to the left and are 0 in the middle."""
    count = 0
    for side in road.findall("lanes/laneSection/*"):
        driving_lanes = {
            lane.get("id", ""): lane
            for lane in side.findall("lane")
            if lane.get("type") == "driving"
        }
        outwards = 1 if side.tag == "left" else -1  # from a lane's id to its outer neighbour's
        for name, lane in driving_lanes.items():
            is_whole = WHOLE_NUMBER.fullmatch(name)
            if not is_whole or str(int(name) + outwards) not in driving_lanes:
                continue
            changes = [mark.get("laneChange", "both") for mark in lane.findall("roadMark")]
            if any(change != "both" for change in changes):
                count += 1
    return count
