"""Meshes of drawn cars: lofted from their proportions, or built of plain blocks.

As in `toolkit.bodies.cars` a lofted car is a row of cross-sections along x; here all of them are worked out at once, so
that a car takes about a millisecond. Block-built cars have no arches, no rounding and few triangles: other people's
models of cars are as often like them. Every mesh is stretched to be exactly as long, wide and high as it was drawn.
"""

from __future__ import annotations

import numpy as np

from toolkit.arrays import Float64
from toolkit.bodies.cars import wheel_at
from toolkit.bodies.drawn.proportions import Proportions
from toolkit.mesh import Mesh, box, loft, merge, mirrored, shifted

_STATIONS = 26
_ACROSS = (1.0, 0.9, 0.7, 0.38, 0.0)  # of the roof, 1 its edge


def lofted_car(shape: Proportions) -> Mesh:
    """The mesh of a car without mirrors, x forward from its middle, wheels standing on z = 0."""
    return stretched(merge([_hull(shape), *_wheels(shape)]), (shape.length, shape.width, shape.height))


def block_car(shape: Proportions, rng: np.random.Generator) -> Mesh:
    """The same car of a few plain blocks: a lower body, a cabin with slanted screens, wheels of few sides or none."""
    length, half, belt = shape.length, shape.width / 2, shape.belt * shape.height
    tops = shape.profile[:, 1]
    roof, cabin = (shape.profile[tops >= least, 0][[0, -1]] for least in (0.93, 0.7))
    floor = float(rng.choice([0.02, shape.clearance], p=[0.25, 0.75]))
    chamfer = float(rng.uniform(0.0, 0.06))
    lower = _blocks(
        [(floor, 0.5 - 0.01, -0.49, half - chamfer), (floor + chamfer + 0.01, 0.5, -0.5, half),
         (belt - chamfer - 0.01, 0.5, -0.5, half), (belt, 0.5 - 0.02, -0.49, half - chamfer)], length,
    )  # fmt: skip
    edge = half * (1 - shape.lean)
    base = (0.5 - cabin[0] + 0.03, 0.5 - cabin[1] - 0.02)
    upper = _blocks(
        [(belt - 0.02, max(base[0], 0.5 - roof[0]), min(base[1], 0.5 - roof[1]), half - chamfer),
         (shape.height, 0.5 - roof[0], 0.5 - roof[1], edge)], length,
    )  # fmt: skip
    sides, breadth = int(rng.choice([4, 8, 12])), float(rng.uniform(0.15, 0.26))
    wheels = []
    for axle in shape.axles if floor > 0.05 or rng.random() < 0.5 else ():
        wheel = wheel_at(length / 2 - axle, half - breadth / 2 - 0.005, shape.wheel, breadth, sides)
        wheels += [wheel, mirrored(wheel)]
    parts = merge([lower, upper, *wheels])
    standing = Mesh(parts.vertices - [0.0, 0.0, parts.vertices[:, 2].min()], parts.triangles)
    return stretched(standing, (length, shape.width, shape.height))


def stretched(mesh: Mesh, size: tuple[float, float, float]) -> Mesh:
    """The mesh stretched to a length, width and height (m), standing on z = 0 about x = y = 0."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    middle = np.array([*((low + high) / 2)[:2], low[2]])
    return Mesh((mesh.vertices - middle) * (np.array(size) / (high - low)), mesh.triangles)


def half_width(shape: Proportions, s: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """Half the width at stations s (0 front, 1 rear): nearly parallel flanks, superelliptic corners at both ends."""
    corners = []
    for distance, rounding, end in zip((s, 1 - s), shape.rounding, shape.ends, strict=True):
        beyond = np.maximum(0.0, 1 - distance / rounding)
        corners.append(end + (1 - end) * (1 - beyond**2.6) ** (1 / 2.6))
    return shape.width / 2 * (1 - 0.05 * (2 * s - 1.05) ** 2) * np.minimum(*corners)


def _blocks(levels: list[tuple[float, float, float, float]], length: float) -> Mesh:
    """A loft upwards through rectangles given as (z, front, rear as parts of the length, half width)."""
    rings = [
        [(length * rear, -y, z), (length * front, -y, z), (length * front, y, z), (length * rear, y, z)]
        for z, front, rear, y in levels
    ]
    return loft(np.array(rings))


def _hull(shape: Proportions) -> Mesh:
    """The painted body: half cross-sections, mirrored and lofted from the rear to the front."""
    half = _half_sections(shape, _stations(shape)[::-1])
    return loft(np.concatenate([half, half[:, -2:0:-1] * [1.0, -1.0, 1.0]], axis=1))


def _stations(shape: Proportions) -> Float64[np.ndarray, " s"]:
    """Where the cross-sections are (0 front to 1 rear): dense at both ends and at the rims of the wheel arches."""
    even = np.linspace(0, 1, _STATIONS // 2)
    ends = np.concatenate([even**1.6 / 2, 1 - even**1.6 / 2])
    reach = shape.wheel * 1.13 / shape.length
    arches = [
        axle / shape.length + reach * c for axle in shape.axles for c in (-1.001, -0.98, -0.55, 0.55, 0.98, 1.001)
    ]
    return np.unique(np.round(np.clip(np.concatenate([ends, arches]), 0, 1), 4))


def _half_sections(shape: Proportions, s: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 13 3"]:
    """Left halves of the sections at stations s: from the middle of the floor out and up to the middle of the roof."""
    w, roof = half_width(shape, s), _roof(shape, s)
    floor = shape.clearance + np.interp(s, [0, 0.1, 0.85, 1], [0.06, 0, 0, 0.12])
    nearest = np.abs(s[:, None] * shape.length - np.array(shape.axles)).min(axis=1)
    inside = 1.13 * shape.wheel > nearest
    arch = np.where(inside, shape.wheel + np.sqrt(np.maximum((1.13 * shape.wheel) ** 2 - nearest**2, 0)), 0.0)
    crown = roof[:, 0]
    shoulder = np.minimum(shape.belt * shape.height, crown - 0.035)
    low = np.maximum(np.minimum(arch, shoulder - 0.07), floor + 0.02)
    flank = np.maximum(low + 0.01, floor + 0.45 * (shoulder - floor))
    lean = shape.lean * np.clip((crown - shoulder) / (shape.height * (1 - shape.belt)), 0, 1)
    edge = w * (0.965 - lean)
    zero, bottom = np.zeros_like(s), np.where(arch > floor, low, floor)
    y = [
        zero, 0.74 * w, 0.74 * w, 0.965 * w, w, 0.995 * w, 0.965 * w, 0.4775 * w + 0.5 * edge + 0.012, edge,
        0.93 * edge, 0.72 * edge, 0.38 * edge, zero,
    ]  # fmt: skip
    z = [
        floor, floor, bottom, low, flank, flank + 0.6 * (shoulder - flank), shoulder,
        shoulder + 0.52 * (crown - shoulder), crown - 0.25 * np.minimum(0.16, crown - shoulder), *roof.T[1:],
    ]  # fmt: skip
    sections = np.stack(np.broadcast_arrays(shape.length * (0.5 - s)[:, None], np.stack(y, 1), np.stack(z, 1)), axis=-1)
    if shape.kind == "pickup":
        bed = bed_of(shape)
        open_ = (s > bed[0]) & (s < bed[1])
        sections[open_, -3:, 1] = edge[open_, None] * [0.84, 0.4, 0.0]
        sections[open_, -3:, 2] = np.maximum(shoulder - 0.42, low + 0.02)[open_, None]
    return sections


def bed_of(shape: Proportions) -> tuple[float, float]:
    """Where a pick-up's bed begins and ends, as parts of its length."""
    low = shape.profile[(shape.profile[:, 1] < 0.7) & (shape.profile[:, 0] > 0.45), 0]
    return float(low[0]) + 0.012, 0.982


def _roof(shape: Proportions, s: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 5"]:
    """Height of the body at stations s and across it: bowed in plan, cambered, rounded."""
    across = np.array(_ACROSS)
    bow = shape.bow * across**2 * np.clip((s[:, None] - 0.55) * 6, -1, 1)
    near = np.linspace(-1, 1, 5) * shape.soft
    heights = shape.top(np.clip((s[:, None] + bow)[..., None] + near, 0, 1)).mean(axis=-1)
    return heights - shape.camber * across**2 * np.clip(4 * np.minimum(s, 1 - s) + 0.3, 0, 1)[:, None]


def _wheels(shape: Proportions) -> list[Mesh]:
    breadth = 0.115 * shape.width
    one, wheels = wheel_at(0.0, 0.0, shape.wheel, breadth), []
    for axle in shape.axles:
        y = float(half_width(shape, np.array([axle / shape.length]))[0]) * 0.985
        wheel = shifted(one, shape.length / 2 - axle, y - breadth / 2)
        wheels += [wheel, mirrored(wheel)]
    return wheels


def plank(size: tuple[float, float, float], x: float, y: float, z: float) -> Mesh:
    """A cuboid standing on height z, about x and y."""
    return box(size, (x, y, z + size[2] / 2))
