"""What stands in a street, as solids on level ground, and `settle` to set them down on uneven ground."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import shapely

from toolkit.arrays import Float, Float64
from toolkit.sites.site import Relief, Site, Solid

Point = tuple[float, float]
Outlines = Iterable[Float[np.ndarray, "_ 2"]]


def rectangle(xmin: float, ymin: float, xmax: float, ymax: float) -> Float64[np.ndarray, "4 2"]:
    """A rectangle along x and y, counter-clockwise."""
    return np.array([[xmin, ymin], [xmax, ymin], [xmax, ymax], [xmin, ymax]], np.float64)


def disc(x: float, y: float, radius: float, corners: int = 8) -> Float64[np.ndarray, "k 2"]:
    """A regular polygon round (x, y), on millimetres."""
    angles = np.arange(corners) * 2 * np.pi / corners
    return np.round(np.stack([x + radius * np.cos(angles), y + radius * np.sin(angles)], axis=1), 3)


def bar(start: Point, end: Point, width: float) -> Float64[np.ndarray, "4 2"]:
    """A strip of `width` from start to end, on millimetres."""
    along = np.subtract(end, start)
    across = np.array([-along[1], along[0]]) / np.hypot(*along) * width / 2
    return np.round(np.array([start - across, end - across, end + across, start + across]), 3)


def block(
    size: tuple[float, float], middle: tuple[float, float] = (0.0, 0.0), yaw: float = 0.0
) -> Float64[np.ndarray, "4 2"]:
    """A rectangle of length and width (m) about `middle`, its length along `yaw`."""
    ahead = size[0] / 2 * np.array([np.cos(yaw), np.sin(yaw)])
    start, end = ((float(middle[0] + k * ahead[0]), float(middle[1] + k * ahead[1])) for k in (-1, 1))
    return bar(start, end, size[1])


def post(x: float, y: float, height: float, radius: float = 0.08) -> Solid:
    """A lamp, sensor or sign post."""
    return Solid(disc(x, y, radius), 0.0, height, "post")


def sign(x: float, y: float, facing: float) -> list[Solid]:
    """A traffic sign on its post, its face towards `facing` (rad)."""
    half = 0.35 * np.array([-np.sin(facing), np.cos(facing)])
    plate = bar((x - half[0], y - half[1]), (x + half[0], y + half[1]), 0.06)
    return [post(x, y, 2.2, 0.04), Solid(plate, 2.2, 2.9, "sign")]


def tree(x: float, y: float, height: float = 7.0, crown: float = 1.6, clear: float = 2.3) -> list[Solid]:
    """A trunk, and a crown of radius `crown` from `clear` m up to `height`, narrower below and above."""
    middle, upper = clear + 0.25 * (height - clear), clear + 0.7 * (height - clear)
    return [
        Solid(disc(x, y, 0.16), 0.0, clear, "trunk"),
        Solid(disc(x, y, 0.75 * crown), clear, middle, "tree"),
        Solid(disc(x, y, crown), middle, upper, "tree"),
        Solid(disc(x, y, 0.6 * crown), upper, height, "tree"),
    ]


def litter_bin(x: float, y: float) -> Solid:
    """A litter bin."""
    return Solid(disc(x, y, 0.28), 0.0, 1.0, "bin")


def bench(x: float, y: float, along_x: bool = True) -> Solid:
    """A bench 1.8 m long."""
    half = (0.9, 0.25) if along_x else (0.25, 0.9)
    return Solid(rectangle(x - half[0], y - half[1], x + half[0], y + half[1]), 0.0, 0.5, "bench")


def hedge(line: Sequence[Point], height: float = 1.4, width: float = 0.7) -> list[Solid]:
    """A hedge along `line`."""
    return [Solid(bar(*piece, width), 0.0, height, "hedge") for piece in _pieces(line, 6.0)]


def wall(line: Sequence[Point], height: float = 1.8, width: float = 0.25) -> list[Solid]:
    """A wall along `line`."""
    return [Solid(bar(*piece, width), 0.0, height, "wall") for piece in _pieces(line, 8.0)]


def railing(line: Sequence[Point], height: float = 1.1) -> list[Solid]:
    """A fence one can see through: posts every 2.5 m and two rails."""
    pieces = _pieces(line, 2.5)
    uprights = [Solid(disc(*start, 0.05), 0.0, height, "fence") for start, _ in pieces]
    levels = ((0.5 * height - 0.05, 0.5 * height + 0.05), (height - 0.1, height))
    return uprights + [Solid(bar(*piece, 0.06), *level, "fence") for piece in pieces for level in levels]


def shelter(xmin: float, ymin: float, xmax: float, ymax: float) -> list[Solid]:
    """A bus shelter open towards -y: back wall, sides and roof."""
    return [
        Solid(rectangle(xmin, ymax - 0.1, xmax, ymax), 0.0, 2.3, "shelter"),
        Solid(rectangle(xmin, ymin, xmin + 0.1, ymax - 0.1), 0.0, 2.3, "shelter"),
        Solid(rectangle(xmin, ymin, xmax, ymax), 2.3, 2.45, "shelter"),
    ]


def kerbs(lanes: Outlines, footways: Outlines, height: float = 0.12, width: float = 0.15) -> list[Solid]:
    """Kerbstones on the footway's side of every edge between road and footway, in pieces of at most 4 m."""
    road = shapely.union_all([shapely.Polygon(p) for p in lanes]).buffer(0.01)
    walk = shapely.union_all([shapely.Polygon(p) for p in footways])
    solids: list[Solid] = []
    if walk.is_empty:
        return solids
    edge = shapely.line_merge(shapely.intersection(walk.boundary, road)).simplify(0.02)
    for part in shapely.get_parts(shapely.segmentize(edge, 4.0)):
        for piece in pairwise(shapely.get_coordinates(part)):
            stone = shapely.LineString(piece).buffer(width, cap_style="flat").difference(road)
            stone = shapely.set_precision(stone, 1e-3)
            if stone.geom_type == "Polygon" and stone.area > 0.02 and not stone.interiors:
                solids.append(Solid(shapely.get_coordinates(stone.exterior)[:-1], 0.0, height, "kerb"))
    return solids


def settle(solids: Iterable[Solid], relief: Relief) -> tuple[Solid, ...]:
    """Solids made for level ground, lifted by the ground under the middle of each; what stands on the ground (base 0)
    reaches 0.3 m into it, so that no gap shows."""
    solids, settled = list(solids), []
    lifts = _ground(relief, np.array([solid.footprint.mean(axis=0) for solid in solids]).reshape(-1, 2))
    for solid, lift in zip(solids, lifts.tolist(), strict=True):
        base = -0.3 if solid.base == 0 else solid.base
        settled.append(replace(solid, base=round(base + lift, 3), top=round(solid.top + lift, 3)))
    return tuple(settled)


def _ground(relief: Relief, places: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
    return Site("", np.array([0.0, 0, 1, 1]), relief=relief).ground(places).round(3)


def _pieces(line: Sequence[Point], length: float) -> list[tuple[Point, Point]]:
    points = shapely.get_coordinates(shapely.segmentize(shapely.LineString(line), length)).round(3)
    corners = [(float(x), float(y)) for x, y in points]
    return list(pairwise(corners))
