"""The shape of a mesh, measured on points of its surface: what road user it can be, and whether it stands right.

A class is told from the shape alone only where the shape is clear: a car and a bus fill their boxes and are close to
the ground between wheels on both sides, a two-wheeler stands on a line, a person stands upright and fills little.
Vehicles have a left that mirrors their right. Animals, furniture and trees have some of these, not all.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float64, Int64
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE

_POINTS, _CELLS = 30_000, 32
_COARSE = 16  # cells along an axis in which symmetry is judged
SYMMETRIC, ASKEW = 0.06, 0.12  # share of the surface without a counterpart: up to, from


BACKWARDS = -0.18  # `Shape.ahead` of no car: a pick-up has -0.14


class Shape(NamedTuple):
    """size: of the bounds (m); fills: share of the box's outline that is covered, seen along x, y, z; asymmetry: share
    of the surface without a counterpart when mirrored along x, y, z; stance: length and width (m) of where it touches
    the ground; clearance: height (m) of what is lowest over the middle; ahead: how much lower the front is than the
    rear, as a part of the height."""

    size: Float64[np.ndarray, "3"]
    fills: Float64[np.ndarray, "3"]
    asymmetry: Float64[np.ndarray, "3"]
    stance: tuple[float, float]
    clearance: float
    ahead: float


def measured(vertices: Float64[np.ndarray, "k 3"], triangles: Int64[np.ndarray, "m 3"]) -> Shape:
    """The shape of a mesh that stands on its lowest point with z up and x forward. Raises ValueError for flat ones."""
    low, size = vertices.min(axis=0), np.ptp(vertices, axis=0)
    if not (size > 0).all():
        raise ValueError("has no volume")
    points = surface_points(vertices, triangles)
    unit = np.clip((points - low) / size, 0, 1 - 1e-9)
    cells = (unit * _CELLS).astype(np.int64)
    fills = np.array([_filled(np.delete(cells, axis, axis=1)).mean() for axis in range(3)])
    ground = points[unit[:, 2] < 0.04]
    length, width = np.ptp(ground[:, :2], axis=0).tolist()
    middle = unit[(np.abs(unit[:, 0] - 0.5) < 0.1) & (np.abs(unit[:, 1] - 0.5) < 0.25), 2]
    clearance = float(middle.min() * size[2]) if len(middle) else float(size[2])
    return Shape(size, fills, _asymmetry(unit), (length, width), clearance, _ahead(unit))


def clear_class(shape: Shape, label: int) -> bool:
    """Whether the shape is clearly one of a class, with nothing else known about it."""
    (length, width, height), fills = shape.size.tolist(), shape.fills
    if shape.asymmetry[1] > ASKEW and label != PEDESTRIAN:  # somebody who walks is not symmetric
        return False
    if label in (VEHICLE, HEAVY):
        filled = fills[0] > 0.72 and fills[1] > 0.55 and fills[2] > 0.76
        stands = shape.stance[0] > 0.4 * length and shape.stance[1] > 0.45 * width
        if label == VEHICLE:
            sized = length < 6.1 and width < 2.4 and height < 2.1 and length > 1.25 * height
            return bool(filled and stands and sized and length > 1.5 * width and shape.clearance < 0.55)
        return bool(filled and stands and length > max(6.1, 1.9 * width) and height > 2.2 and shape.clearance < 1.3)
    if label == CYCLIST:
        thin = width < 0.6 * length and fills[1] < 0.75 and fills[2] < 0.75
        on_a_line = shape.stance[1] < 0.22 and shape.stance[0] > 0.35 * length
        return bool(thin and on_a_line and length < 2.8)
    upright = height > 1.3 * max(length, width) and 1.35 < height < 2.15
    return bool(label == PEDESTRIAN and upright and 0.22 < fills[0] < 0.75 and fills[1] < 0.8 and fills[2] < 0.85)


def wrong_stand(shape: Shape, label: int) -> str | None:
    """What is wrong with how a mesh of this class stands, None where nothing is seen to be."""
    asymmetry = shape.asymmetry
    if label == PEDESTRIAN:
        return "lies on the ground" if shape.size[2] < 0.7 * shape.size[:2].max() else None
    if asymmetry[2] < SYMMETRIC and asymmetry[1] > ASKEW:
        return "lies on its side: y or -y seems to be up"
    if asymmetry[0] < SYMMETRIC and asymmetry[1] > ASKEW:
        return "stands across: y or -y seems to be forward"
    if label == VEHICLE and shape.ahead < BACKWARDS:
        return "seems to face backwards: -x forward"
    return None


def surface_points(
    vertices: Float64[np.ndarray, "k 3"], triangles: Int64[np.ndarray, "m 3"], count: int = _POINTS
) -> Float64[np.ndarray, "n 3"]:
    """Points spread evenly over the triangles, the same ones each time, and the corners."""
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    if not areas.sum() > 0:
        raise ValueError("has no surface")
    rng = np.random.default_rng(0)
    chosen = np.searchsorted(np.cumsum(areas), (np.arange(count) + 0.5) / count * areas.sum()).clip(max=len(a) - 1)
    u, v = rng.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return np.concatenate([a[chosen] + u * (b - a)[chosen] + v * (c - a)[chosen], vertices])


def mirror_span(
    vertices: Float64[np.ndarray, "k 3"], triangles: Int64[np.ndarray, "m 3"]
) -> tuple[float, float] | None:
    """Between which y (m) a vehicle's body lies where wing mirrors stick out of it by 3 cm or more, None where none do.

    A mirror is what sticks out within 30 cm of the outermost point, above the wheels, in the front six tenths.
    """
    points = surface_points(vertices, triangles)
    low, size = vertices.min(axis=0), np.ptp(vertices, axis=0)
    x, z = points[:, 0], points[:, 2] - low[2]
    sides = []
    for side in (-1.0, 1.0):
        outward = side * points[:, 1]
        tip = points[outward > outward.max() - 0.02]
        ahead = tip[:, 0].min() > low[0] + 0.4 * size[0] and np.ptp(tip[:, 0]) < 0.4
        near = (np.abs(x - tip[:, 0].mean()) < 0.3) & (z > 0.35 * size[2])
        body = float(outward[~near].max())
        sides.append(body if ahead and 0.03 < outward.max() - body < 0.45 else float(outward.max()))
    right, left = -sides[0], sides[1]
    return None if left - right > size[1] - 0.03 else (right, left)


def _filled(cells: Int64[np.ndarray, "n 2"]) -> Bool[np.ndarray, "a b"]:
    """The outline that occupied cells have, with what they enclose along both axes."""
    grid = np.zeros((_CELLS, _CELLS), bool)
    grid[tuple(cells.T)] = True
    enclosed = [
        np.logical_or.accumulate(grid, axis) & np.flip(np.logical_or.accumulate(np.flip(grid, axis), axis), axis)
        for axis in (0, 1)
    ]
    return enclosed[0] & enclosed[1]


def _asymmetry(unit: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "3"]:
    grid = np.zeros((_COARSE + 2,) * 3, bool)
    cells = (unit * _COARSE).astype(np.int64)
    grid[tuple(cells.T + 1)] = True
    near = np.zeros_like(grid)
    inner = slice(1, -1)
    for shift in np.ndindex(3, 3, 3):
        near[inner, inner, inner] |= grid[tuple(slice(s, s + _COARSE) for s in shift)]
    lonely = []
    for axis in range(3):
        mirrored = unit.copy()
        mirrored[:, axis] = 1 - 1e-9 - mirrored[:, axis]
        lonely.append(1 - near[tuple((mirrored * _COARSE).astype(np.int64).T + 1)].mean())
    return np.array(lonely)


def _ahead(unit: Float64[np.ndarray, "n 3"]) -> float:
    """How much lower the top of the front third is than that of the rear third, on average."""
    along = (unit[:, 0] * 24).astype(np.int64)
    tops = np.array([unit[along == k, 2].max(initial=0.0) for k in range(24)])
    return float(tops[:8].mean() - tops[-8:].mean())
