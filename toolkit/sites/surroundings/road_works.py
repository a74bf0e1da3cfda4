"""Road works off the lanes that are driven, closed off by cones, barriers or a fence."""

from collections.abc import Mapping

import numpy as np
import shapely

from toolkit.arrays import Rng
from toolkit.sites import furniture
from toolkit.sites.furniture import Make, bushes, container, digger, heap, move_solids, skip
from toolkit.sites.site import Solid
from toolkit.sites.surroundings.places import points_along
from toolkit.sites.surroundings.plot import Plot, Strip
from toolkit.sites.surroundings.works_closings import barrier, beacon, concrete, cone, fence

CLOSED_LANE_M = (2.6, 3.6)  # range of the width of a lane closed for works
_BARRIER_EDGE_M = 0.45  # between the edge of the strip and its barrier
_MAX_VERGE_WORKS_M = 9.0  # length of works next to the footways
# functions that draw objects of road works; one that is there twice is chosen twice as often
WORKS_OBJECTS: tuple[Make, ...] = (container, skip, digger, digger, heap, heap, bushes)
# function that draws an object to close the works off from traffic, and its spacing (m)
_CLOSINGS: tuple[tuple[Make, float], ...] = (
    (cone, 1.5),
    (beacon, 2.0),
    (concrete, 2.1),
    (fence, 2.5),
)


def lane_works(plot: Plot, strips: Mapping[str, Strip], rng: Rng) -> None:
    """Put road works on a stretch of each strip, near the junction.

    Traffic passes on the left. strips: middle lines and widths (m) of shoulders by edge; the
    junction is at the end of strips of edges `in...`, and at the start of the others. The solids go
    to the plot."""
    for edge, (line, width) in strips.items():
        path = shapely.LineString(line)
        length = min(float(rng.uniform(10.0, 32.0)), path.length - 10.0)
        junction_gap = float(rng.uniform(4.0, 22.0))  # m between the junction and the works
        start = junction_gap  # start of the works along the strip (m)
        if edge.startswith("in"):
            start = path.length - junction_gap - length
        if start > 0 and length > 6.0:
            span = (start, start + length)
            _put_works(plot, path, span=span, width=width, rng=rng, on_shoulders=True)


def verge_works(plot: Plot, rng: Rng) -> None:
    """Put up to three small road works next to the footways. The solids go to the plot."""
    # the outer edge of footways of 2 m
    edge = plot.road.surface.buffer(2.0).boundary.intersection(plot.window)
    # rows of x, y and the direction of the edge, every 2 m, in a random order
    places = rng.permutation(points_along(edge, 2.0))
    for x, y, direction in places[: rng.integers(0, 4)]:
        ahead_x, ahead_y = _MAX_VERGE_WORKS_M * np.array([np.cos(direction), np.sin(direction)])
        path = shapely.LineString([(x, y), (x + ahead_x, y + ahead_y)])
        # start and end of the works along the path (m)
        span = (0.0, float(rng.uniform(4.0, _MAX_VERGE_WORKS_M)))
        width = float(rng.uniform(2.0, 3.0))
        _put_works(plot, path, span=span, width=width, rng=rng, on_shoulders=False)


def _put_works(
    plot: Plot,
    path: shapely.LineString,
    span: furniture.Span,
    width: float,
    rng: Rng,
    *,
    on_shoulders: bool,
) -> None:
    """Put barriers round a stretch of a strip, and machines and heaps inside.

    path: middle line of the strip, with traffic on its left; span: start and end of the stretch
    along `path` (m); width: width of the strip (m); on_shoulders: the strip is part of the road, so
    solids may be on any ground that is not driven. Solids without room are left out."""
    start, end = span

    def place_solids(solids: list[Solid], s: float, left: float, turn: float = 0.0) -> None:
        """Place solids made about the origin next to the path, if there is room for them.

        s: m along the path; left: m to its left; turn: rad from the path's direction."""
        here = path.interpolate(s)
        ahead = path.interpolate(s + 0.5)
        yaw = float(np.arctan2(ahead.y - here.y, ahead.x - here.x))
        x = float(here.x - left * np.sin(yaw))
        y = float(here.y + left * np.cos(yaw))
        plot.place(move_solids(solids, x=x, y=y, yaw=yaw + turn), on_shoulders=on_shoulders)

    for s in (start, end):
        solids = barrier(width - 2 * _BARRIER_EDGE_M - 0.3, rng)
        place_solids(solids, s=s, left=0.0, turn=np.pi / 2)
    closing_left = width / 2 - _BARRIER_EDGE_M
    make_closing, spacing = _CLOSINGS[rng.integers(len(_CLOSINGS))]
    for s in np.arange(start + 1.0, end - 0.5, spacing + rng.uniform(0.05, 1.5)):
        place_solids(make_closing(rng), s=float(s), left=closing_left)
    s = start + rng.uniform(1.0, 3.0)
    while s < end - 1.5:
        solids = WORKS_OBJECTS[rng.integers(len(WORKS_OBJECTS))](rng)
        length, across = np.ptp(np.concatenate([solid.footprint for solid in solids]), axis=0)
        if across < width - _BARRIER_EDGE_M - 0.3 and s + length < end - 0.5:
            place_solids(solids, s=s + float(length) / 2, left=-0.2)
        s += length + rng.uniform(0.5, 5.0)
