"""Parking bays along kerbs, in line, at an angle or at right angles, and on forecourts."""

from collections.abc import Iterable, Mapping

import numpy as np
import shapely

from toolkit.arrays import Rng
from toolkit.sites import furniture
from toolkit.sites.surroundings.places import Bays, place_along, points_along
from toolkit.sites.surroundings.plot import Plot, Strip

BAY_SIZE_M = (5.8, 2.6)  # length and width of a parking bay
# angle between bay and kerb (degrees): width of a strip of such bays
BAY_DEPTHS_M = {0: 2.3, 45: 4.8, 60: 5.1, 90: 5.2}
_JUNCTION_CLEARANCE_M = 6.0  # between a junction and the first bay
_BAY_REACH_M = 75.0  # from a junction; bays are drawn up to it
_EDGE_CLEARANCE_M = 15.0  # from the edge of the furnished ground; without bays on the road
Bay = tuple[float, float, float]  # x, y (m) of the middle, yaw (rad) of a vehicle in the bay


def kerb_bays(plot: Plot, strips: Mapping[str, Strip], angles: Mapping[str, int], rng: Rng) -> Bays:
    """Draw parking bays on the strips that have an angle, and claim their ground on the plot.

    strips: middle line and width (m) of the shoulder on each edge; angles: degrees between bay and
    kerb by edge, 0 in line with the kerb. The junction is at the end of a strip of an edge `in...`,
    and at the start of the others. Returns rows x, y (m), yaw (rad) of a random share of the bays
    with room, `_EDGE_CLEARANCE_M` or more within the plot's window."""
    free_bays = [np.zeros((0, 3))]
    window = plot.window.buffer(-_EDGE_CLEARANCE_M, join_style="mitre")
    bay_length, bay_width = BAY_SIZE_M
    ground_size = bay_length - 0.2, bay_width - 0.2
    for edge, angle in angles.items():
        if edge not in strips:
            continue
        bays = bays_from_junction(strips[edge], angle, at_end=edge.startswith("in"))
        bays = bays[rng.random(len(bays)) < rng.uniform(0.35, 1.0)]
        is_free = []
        for bay in bays:
            # The ground that a bay must have to itself: parts in a driven lane do not count, and it
            # is smaller by 2 cm all round, so that bays side by side do not overlap.
            ground = bay_outline(bay, ground_size).difference(plot.driven_ground).buffer(-0.02)
            is_free.append(bool(window.contains(ground) and plot.claim(ground, on_shoulders=True)))
        free_bays.append(bays[is_free].reshape(-1, 3))
    return np.concatenate(free_bays)


def bays_from_junction(strip: Strip, angle: int, *, at_end: bool) -> Bays:
    """Rows x, y (m), yaw (rad) of all bays that fit on a strip, from the junction on.

    strip: middle line as traffic goes, with the kerb to its right, and width (m); angle: degrees
    between bay and kerb; at_end: the junction is at the end of the strip's line."""
    middle, _ = strip
    line = shapely.LineString(middle)
    bay_length, _ = BAY_SIZE_M
    first = _JUNCTION_CLEARANCE_M + bay_length / 2
    end = min(line.length - bay_length / 2, _BAY_REACH_M)
    # m along the line from the junction to the middle of each bay
    distances = np.arange(first, end, _bay_spacing(angle))
    if at_end:
        distances = line.length - distances  # from the start of the line
    # rows x, y, direction of the line, measured over 0.5 m
    rows = place_along(line, distances, half=0.25)
    # vehicles turn clockwise into their bays, to the kerb
    return (rows - [0.0, 0.0, np.deg2rad(angle)]).round(4)


def bays_between(line: shapely.LineString, angle: int, *, kerb_left: bool = False) -> Bays:
    """Rows x, y (m), yaw (rad) of all bays that fit on a strip between two junctions.

    line: middle of the strip in the direction of traffic; angle: degrees between bay and kerb;
    kerb_left: the kerb is to the left of the line, not to the right."""
    bay_length, _ = BAY_SIZE_M
    first = _JUNCTION_CLEARANCE_M + bay_length / 2
    end = line.length - _JUNCTION_CLEARANCE_M - bay_length / 2
    # m along the line to the middle of a bay
    distances = np.arange(first, end, _bay_spacing(angle))
    # rows x, y, direction of the line, measured over 0.5 m
    rows = place_along(line, distances, half=0.25)
    # vehicles turn towards the kerb: clockwise if it is to the right
    clockwise_turn = np.deg2rad(-angle if kerb_left else angle)
    return (rows - [0.0, 0.0, clockwise_turn]).round(4)


def _bay_spacing(angle: int) -> float:
    """Distance (m) from bay to bay along the kerb. angle: degrees between bay and kerb."""
    bay_length, bay_width = BAY_SIZE_M
    return bay_length + 0.4 if angle == 0 else bay_width / float(np.sin(np.deg2rad(angle)))


def forecourts(plot: Plot, rng: Rng) -> Bays:
    """Draw up to 13 parking bays behind the footways, all along the road or all across it.

    Returns rows x, y (m), yaw (rad); their ground is claimed on the plot."""
    bays: list[Bay] = []
    is_across = rng.random() < 0.5
    bay_length, bay_width = BAY_SIZE_M
    depth = bay_length if is_across else bay_width  # length of a bay away from the road
    edge = plot.road.surface.buffer(0.7 + depth / 2).boundary
    places = rng.permutation(points_along(edge.intersection(plot.window), 1.0))
    for x, y, direction in places[: rng.integers(0, 14)]:
        # ahead or backwards into the bay
        yaw = direction + (np.pi / 2 if is_across else 0.0) + np.pi * rng.integers(2)
        if plot.claim(bay_outline((x, y, yaw))):
            bays.append((round(float(x), 3), round(float(y), 3), round(float(yaw), 4)))
    return np.array(bays, np.float64).reshape(-1, 3)


def bay_outline(bay: Iterable[float], size: tuple[float, float] = BAY_SIZE_M) -> shapely.Polygon:
    """Ground of a bay x, y (m), yaw (rad). size: its length and width (m)."""
    x, y, yaw = bay
    return shapely.Polygon(furniture.block(size, middle=(x, y), yaw=yaw))
