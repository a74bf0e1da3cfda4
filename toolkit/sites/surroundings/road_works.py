"""Road works off the lanes that are driven, closed off by cones, barriers or a fence."""

from collections.abc import Mapping

import numpy as np
import shapely

from toolkit.arrays import Rng
from toolkit.sites import furniture as f
from toolkit.sites.furniture import Make, bushes, container, digger, heap, move_solids, skip
from toolkit.sites.site import Solid
from toolkit.sites.surroundings.places import along
from toolkit.sites.surroundings.plot import Plot, Strip
from toolkit.sites.surroundings.works_closings import barrier, beacon, concrete, cone, fence

CLOSED_LANE_M = (2.6, 3.6)  # range of the width of a lane closed for works
_BARRIER_EDGE_M = 0.45  # between the edge of the strip and its barrier
WORKS_THINGS: tuple[Make, ...] = (container, skip, digger, digger, heap, heap, bushes)
# what closes the works off on the side of traffic, and its spacing (m)
_CLOSINGS: tuple[tuple[Make, float], ...] = (
    (cone, 1.5),
    (beacon, 2.0),
    (concrete, 2.1),
    (fence, 2.5),
)


def lane_works(plot: Plot, strips: Mapping[str, Strip], rng: Rng) -> None:
    """Put road works on a stretch of each strip, near the junction.

    Traffic passes on the left. strips: shoulders by edge; the junction is at the end of strips
    of edges `in...`, and at the start of the others. The solids go to the plot."""
    for edge, (line, width) in strips.items():
        path = shapely.LineString(line)
        length = min(float(rng.uniform(10.0, 32.0)), path.length - 10.0)
        start = float(rng.uniform(4.0, 22.0))
        # start of the works along the strip (m)
        first = path.length - start - length if edge.startswith("in") else start
        if first > 0 and length > 6.0:
            _put_works(plot, path, (first, first + length), width, rng, shoulder=True)


def verge_works(plot: Plot, rng: Rng) -> None:
    """Put up to three small works next to the footways. The solids go to the plot."""
    edge = along(plot.road.surface.buffer(2.0).boundary.intersection(plot.window), 2.0)
    for x, y, direction in rng.permutation(edge)[: rng.integers(0, 4)]:
        ahead = 9.0 * np.array([np.cos(direction), np.sin(direction)])
        path = shapely.LineString([(x, y), (x + ahead[0], y + ahead[1])])
        span = (0.0, float(rng.uniform(4.0, 9.0)))
        width = float(rng.uniform(2.0, 3.0))
        _put_works(plot, path, span, width, rng, shoulder=False)


def _put_works(
    plot: Plot, path: shapely.LineString, span: f.Span, width: float, rng: Rng, *, shoulder: bool
) -> None:
    """Put barriers round a stretch of a strip, and machines and heaps inside.

    path: middle line of the strip, with traffic on its left; span: start and end of the stretch
    along `path` (m); width: width of the strip (m); shoulder: the strip is part of the road, so
    solids may be on any ground that is not driven. Solids without room are left out."""
    start, end = span

    def place_solids(solids: list[Solid], s: float, left: float, turn: float = 0.0) -> None:
        # s: m along the path; left: m to the left of it; turn: rad from the path's direction
        x, y = shapely.get_coordinates(path.interpolate(s))[0]
        ahead = shapely.get_coordinates(path.interpolate(s + 0.5))[0]
        yaw = float(np.arctan2(ahead[1] - y, ahead[0] - x))
        spot = float(x - left * np.sin(yaw)), float(y + left * np.cos(yaw))
        plot.place(move_solids(solids, *spot, yaw + turn), shoulder=shoulder)

    for s in (start, end):
        place_solids(barrier(width - 2 * _BARRIER_EDGE_M - 0.3, rng), s, 0.0, np.pi / 2)
    side = width / 2 - _BARRIER_EDGE_M
    closing, spacing = _CLOSINGS[rng.integers(len(_CLOSINGS))]
    for s in np.arange(start + 1.0, end - 0.5, spacing + rng.uniform(0.05, 1.5)):
        place_solids(closing(rng), float(s), side)
    s = start + rng.uniform(1.0, 3.0)
    while s < end - 1.5:
        thing = WORKS_THINGS[rng.integers(len(WORKS_THINGS))](rng)
        length, across = np.ptp(np.concatenate([solid.footprint for solid in thing]), axis=0)
        if across < width - _BARRIER_EDGE_M - 0.3 and s + length < end - 0.5:
            place_solids(thing, s + float(length) / 2, -0.2)
        s += length + rng.uniform(0.5, 5.0)
