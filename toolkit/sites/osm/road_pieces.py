"""Pieces of OpenStreetMap's roads between barriers and within a window."""

from collections.abc import Collection, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import shapely

from toolkit.arrays import Float64
from toolkit.sites.osm.extract import Way
from toolkit.sites.osm.netconvert_tags import make_road_tags
from toolkit.sites.osm.road_rules import RoadReading

GATE_GAP_M = 0.75  # length of road left out on either side of a barrier
SAME_PLACE_M = 1e-6  # distance below which two points are one


class _Corner(NamedTuple):
    """Point x, y (m) of a road, with the id of its node."""

    node: str
    xy: Float64[np.ndarray, "2"]


def split_way(way: Way, barred: Collection[str]) -> Iterator[Way]:
    """Yield the parts of a way between barriers, which keep `GATE_GAP_M` off them.

    barred: ids of nodes that no car can pass. The new ends at a barrier are nodes ID_before and
    ID_after, so that netconvert does not join the parts."""
    corners: list[_Corner] = []  # the part that is growing
    for k, node in enumerate(way.nodes):
        xy = way.line[k]
        if node not in barred:
            corners.append(_Corner(node, xy))
            continue
        # end the part before the barrier, and begin one after it
        if corners:
            corners.append(_Corner(f"{node}_before", _step_back(xy, way.line[k - 1])))
            yield from _make_part(way, corners)
        corners = []
        if k + 1 < len(way.nodes):
            corners.append(_Corner(f"{node}_after", _step_back(xy, way.line[k + 1])))
    yield from _make_part(way, corners)


def _make_part(way: Way, corners: list[_Corner]) -> Iterator[Way]:
    """Yield the part of a way with these corners, if they are two or more, else nothing."""
    if len(corners) > 1:
        nodes = tuple(corner.node for corner in corners)
        yield replace(way, nodes=nodes, line=np.array([corner.xy for corner in corners]))


def _step_back(barrier: np.ndarray, neighbour: np.ndarray) -> np.ndarray:
    """Place x, y on the way from a barrier to a neighbour, a little off the barrier.

    It is `GATE_GAP_M` off, but at most 0.4 of the way, so that both ends keep their order."""
    distance = max(float(np.hypot(*(neighbour - barrier))), 1e-9)
    return barrier + (neighbour - barrier) * min(GATE_GAP_M / distance, 0.4)


def cut_way(
    way: Way, window: shapely.Geometry, reading: RoadReading, *, lefthand: bool
) -> Iterator[Way]:
    """Yield the parts of a road within `window`, in the direction of its traffic.

    They have netconvert's tags and the rules of `reading`. A way that is one-way against its line
    (oneway -1) is turned round; lefthand: traffic keeps left."""
    tags = make_road_tags(way.tags, reading, lefthand=lefthand)
    corners = [_Corner(node, xy) for node, xy in zip(way.nodes, way.line, strict=True)]
    if reading.oneway == "-1":
        corners.reverse()
    pieces: list[list[_Corner]] = [[]]  # the last one is still growing
    for start, end in pairwise(corners):
        inside_line = shapely.LineString([start.xy, end.xy]).intersection(window)
        if inside_line.geom_type == "LineString" and not inside_line.is_empty:
            _add_stretch(pieces, start, end, shapely.get_coordinates(inside_line))
    for piece in pieces:
        if len(piece) > 1:
            points = np.array([corner.xy for corner in piece])
            nodes = tuple(corner.node for corner in piece)
            yield Way(line=points, nodes=nodes, tags=tags, name=way.name, rules=reading.rules)


def _add_stretch(
    pieces: list[list[_Corner]], start: _Corner, end: _Corner, inside: Float64[np.ndarray, "_ 2"]
) -> None:
    """Add the stretch of a road from one node to the next to the last piece, in place.

    A stretch that enters the window begins a piece, one that leaves it ends a piece; the new nodes
    at its edge are named by the nodes of the stretch.

    start, end: nodes of the stretch; inside: (2, 2) ends of its part within the window, in any
    order."""
    distances = np.hypot(*(inside - start.xy).T)
    in_order = inside[np.argsort(distances)]
    entry_xy = in_order[0]
    exit_xy = in_order[-1]
    enters = bool(np.hypot(*(entry_xy - start.xy)) >= SAME_PLACE_M)  # the window, after the start
    leaves = bool(np.hypot(*(exit_xy - end.xy)) >= SAME_PLACE_M)
    if enters and pieces[-1]:
        pieces.append([])
    entry_node = f"{start.node}_{end.node}_in" if enters else start.node
    exit_node = f"{start.node}_{end.node}_out" if leaves else end.node
    _add_corner(pieces[-1], _Corner(entry_node, entry_xy))
    _add_corner(pieces[-1], _Corner(exit_node, exit_xy))
    if leaves:
        pieces.append([])


def _add_corner(piece: list[_Corner], corner: _Corner) -> None:
    """Add a corner to a piece, in place, unless the piece ends at its node already."""
    if not piece or piece[-1].node != corner.node:
        piece.append(corner)
