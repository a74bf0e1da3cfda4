"""Parking bays along kerbs, in line, at an angle or at right angles, and on forecourts."""

from collections.abc import Iterable, Mapping

import numpy as np
import shapely

from toolkit.arrays import Rng
from toolkit.sites import furniture as f
from toolkit.sites.surroundings.places import Bays, along, place_along
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

    strips: shoulders by edge; angles: degrees between bay and kerb by edge, 0 in line with the
    kerb. The junction is at the end of a strip of an edge `in...`, and at the start of the others.
    Returns rows x, y, yaw of a random share of the bays with room, `_EDGE_CLEARANCE_M` or more
    within the plot's window."""
    rows = [np.zeros((0, 3))]
    seen = plot.window.buffer(-_EDGE_CLEARANCE_M, join_style="mitre")
    size = BAY_SIZE_M[0] - 0.2, BAY_SIZE_M[1] - 0.2
    for edge, angle in angles.items():
        if edge in strips:
            bays = stations(strips[edge], angle, at_end=edge.startswith("in"))
            bays = bays[rng.random(len(bays)) < rng.uniform(0.35, 1.0)]
            # parts that reach into the lane or to neighbours do not count
            ground = [outline(bay, size).difference(plot.driven).buffer(-0.02) for bay in bays]
            is_free = [bool(seen.contains(g) and plot.claim(g, shoulder=True)) for g in ground]
            rows.append(bays[is_free].reshape(-1, 3))
    return np.concatenate(rows)


def stations(strip: Strip, angle: int, *, at_end: bool) -> Bays:
    """Rows x, y, yaw of all bays that fit on a strip, from the junction on.

    angle: degrees between bay and kerb; at_end: the junction is at the end of the strip's line."""
    line = shapely.LineString(strip[0])
    at = np.arange(
        _JUNCTION_CLEARANCE_M + BAY_SIZE_M[0] / 2,
        min(line.length - BAY_SIZE_M[0] / 2, _BAY_REACH_M),
        _spacing(angle),
    )
    if at_end:
        at = line.length - at
    # the kerb is to the right, so vehicles turn clockwise into their bays
    return (place_along(line, at, 0.25) - [0.0, 0.0, np.deg2rad(angle)]).round(4)


def bays_between(line: shapely.LineString, angle: int, *, kerb_left: bool = False) -> Bays:
    """Rows x, y, yaw of all bays that fit on a strip between two junctions.

    line: middle of the strip in the direction of traffic; angle: degrees between bay and kerb;
    kerb_left: the kerb is to the left of the line, not to the right."""
    at = np.arange(
        _JUNCTION_CLEARANCE_M + BAY_SIZE_M[0] / 2,
        line.length - _JUNCTION_CLEARANCE_M - BAY_SIZE_M[0] / 2,
        _spacing(angle),
    )
    slant = np.deg2rad(-angle if kerb_left else angle)
    return (place_along(line, at, 0.25) - [0.0, 0.0, slant]).round(4)


def _spacing(angle: int) -> float:
    """Distance (m) from bay to bay along the kerb. angle: degrees between bay and kerb."""
    return BAY_SIZE_M[0] + 0.4 if angle == 0 else BAY_SIZE_M[1] / float(np.sin(np.deg2rad(angle)))


def forecourts(plot: Plot, rng: Rng) -> Bays:
    """Draw up to 13 parking bays behind the footways, all along the road or all across.

    Returns rows x, y, yaw; their ground is claimed on the plot."""
    bays: list[Bay] = []
    across = rng.random() < 0.5
    # half the length of a bay (index 0) from the footway if it is across, else half its width (1)
    edge = plot.road.surface.buffer(0.7 + BAY_SIZE_M[not across] / 2).boundary
    line = along(edge.intersection(plot.window), 1.0)
    for x, y, direction in rng.permutation(line)[: rng.integers(0, 14)]:
        yaw = direction + (np.pi / 2 if across else 0.0) + np.pi * rng.integers(2)
        if plot.claim(outline((x, y, yaw))):
            bays.append((round(float(x), 3), round(float(y), 3), round(float(yaw), 4)))
    return np.array(bays, np.float64).reshape(-1, 3)


def outline(bay: Iterable[float], size: tuple[float, float] = BAY_SIZE_M) -> shapely.Polygon:
    """Ground of a bay x, y (m), yaw (rad). size: its length and width (m)."""
    x, y, yaw = bay
    return shapely.Polygon(f.block(size, (x, y), yaw))
