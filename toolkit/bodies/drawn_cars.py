"""Cars drawn at random: their proportions, their meshes, and what they carry.

Within a kind the length is drawn first; width and height follow it on average, each with a spread of a decimetre and
more, so that the length of a car does not tell its width. Block-built cars have no arches, no rounding and few
triangles, as many models of others do. Every mesh is stretched to the length, width and height that were drawn.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from toolkit.arrays import Float64, Rng
from toolkit.bodies.vehicles import CAR_PROFILES, Profile, Proportions, loft_parts, make_wheel
from toolkit.mesh import Mesh, box, ellipsoid, flip_sides, loft, merge, place, stand, tube

LENGTHS, WIDTHS, HEIGHTS = (3.0, 6.0), (1.45, 2.2), (1.25, 2.6)  # m, of the body without mirrors and roof loads
_GRID = np.linspace(0, 1, 61)  # of profiles, 0 front to 1 rear


@dataclass(frozen=True)
class Kind:
    """Kind of car; ranges are from .. to."""

    name: str
    share: float  # of all cars
    length: tuple[float, float]  # m
    width: tuple[float, float]  # m, at the shortest and the longest
    height: tuple[float, float]  # m
    profile: Profile  # distance from the front and height of the top, as parts of length and height
    wheel: tuple[float, float]  # radius (m)
    lean: tuple[float, float]  # of the sides above the belt, as parts of the half width
    belt: tuple[float, float] = (0.56, 0.66)
    clearance: tuple[float, float] = (0.13, 0.2)


# name, share, then from .. to: length, width, height, wheel, lean, belt, clearance
_KINDS = """
kei       0.07 3    3.5  1.45 1.56 1.45 1.95 0.25 0.3  0.05 0.14 0.5  0.6  0.13 0.2
city      0.09 3.1  3.8  1.5  1.72 1.4  1.62 0.27 0.31 0.14 0.24 0.56 0.66 0.13 0.2
hatchback 0.16 3.75 4.5  1.66 1.86 1.4  1.6  0.29 0.34 0.16 0.27 0.56 0.66 0.13 0.2
sedan     0.14 4.1  5.3  1.66 1.94 1.36 1.55 0.3  0.36 0.17 0.28 0.56 0.66 0.13 0.2
estate    0.09 4.2  5.05 1.68 1.92 1.4  1.58 0.3  0.35 0.14 0.24 0.56 0.66 0.13 0.2
suv       0.16 3.9  5.2  1.72 2.03 1.5  1.95 0.33 0.41 0.13 0.25 0.57 0.67 0.17 0.25
offroader 0.04 3.4  5    1.62 2    1.65 2.1  0.35 0.44 0.03 0.12 0.56 0.63 0.2  0.3
minivan   0.07 4    5.3  1.7  2    1.58 1.95 0.3  0.35 0.1  0.2  0.52 0.6  0.13 0.2
van       0.08 4.3  6    1.75 2.14 1.78 2.6  0.31 0.37 0.03 0.13 0.46 0.58 0.13 0.2
pickup    0.05 4.6  6    1.7  2.12 1.6  2.02 0.34 0.43 0.1  0.2  0.58 0.65 0.2  0.3
coupe     0.05 3.6  4.9  1.64 2    1.25 1.42 0.3  0.36 0.22 0.34 0.6  0.68 0.1  0.15
"""


def _parse_kind(figures: str) -> Kind:
    name, share, *cells = figures.split()
    length, width, height, *rest = zip(map(float, cells[::2]), map(float, cells[1::2]), strict=True)
    return Kind(name, float(share), length, width, height, CAR_PROFILES[name], *rest)


CAR_KINDS = tuple(map(_parse_kind, _KINDS.strip().splitlines()))
_SHARES = np.array([kind.share for kind in CAR_KINDS]) / sum(kind.share for kind in CAR_KINDS)


def draw_proportions(rng: Rng) -> Proportions:
    """Draw the proportions of a car of any kind."""
    kind = CAR_KINDS[int(rng.choice(len(CAR_KINDS), p=_SHARES))]
    along = rng.uniform()
    length = float(np.interp(along, (0, 1), kind.length))
    width = np.interp(0.6 * along + 0.4 * rng.uniform(), (0, 1), kind.width)
    width += 0.085 * np.clip(rng.standard_normal(), -2, 2)
    height = np.interp(0.75 * rng.uniform() + 0.25 * along, (0, 1), kind.height)
    profile = _profile(kind, rng)
    wheel = float(rng.uniform(*kind.wheel))
    front = float(wheel + rng.uniform(0.32, 0.6) * min(1.0, length / 4.3))
    rear = float(wheel + rng.uniform(0.22, 0.75 if kind.name not in ("van", "pickup") else 1.0) * length / 4.6)
    while length - front - rear < 0.5 * length:  # cars of any length stand on a wheelbase of half of it and more
        front, rear = wheel + 0.8 * (front - wheel), wheel + 0.8 * (rear - wheel)
    low = profile[(profile[:, 1] < 0.7) & (profile[:, 0] > 0.45), 0]
    bed = (float(low[0]) + 0.012, 0.982, 0.84) if kind.name == "pickup" else None
    figures = (kind.clearance, kind.belt, kind.lean, (0.03, 0.2), (0.02, 0.15), (0.5, 0.88), (0.6, 0.95), (0.0, 0.05))
    drawn = (float(rng.uniform(*ends)) for ends in (*figures, (0.015, 0.06), (0.004, 0.03)))
    clearance, belt, lean, nose, boot, front_end, rear_end, bow, camber, soft = drawn
    size = length, float(np.clip(width, *WIDTHS)), float(np.clip(height, *HEIGHTS))
    axles, plan = (front, length - rear), ((nose, boot), (front_end, rear_end))
    car = partial(Proportions, kind.name, *size, profile, axles, wheel, clearance, belt, lean)
    return car(*plan, bow, camber, soft, bed=bed)


def _profile(kind: Kind, rng: Rng) -> Float64[np.ndarray, "k 2"]:
    """Draw a side profile of a kind, its top at 1, with a little of another kind's mixed in."""
    own = _jitter_corners(kind.profile, rng)
    other = _jitter_corners(CAR_KINDS[int(rng.integers(len(CAR_KINDS)))].profile, rng)
    share = float(np.clip(rng.exponential(0.06), 0, 0.2)) if kind.name != "pickup" else 0.0
    stations = np.unique(np.concatenate([own[:, 0], _GRID]))
    heights = (1 - share) * np.interp(stations, *own.T) + share * np.interp(stations, *other.T)
    return np.column_stack([stations, heights / heights.max()])


def _jitter_corners(profile: Profile, rng: Rng) -> Float64[np.ndarray, "k 2"]:
    corners = np.array(profile)
    corners[2:-2, 0] += rng.normal(0, 0.012) + rng.normal(0, 0.012, len(corners) - 4)
    corners[:, 1] += np.clip(rng.normal(0, 0.02, len(corners)), -0.04, 0.04) * (corners[:, 1] < 0.93)
    corners[1:-1, 0] = np.clip(corners[1:-1, 0], 0.004, 0.996)
    return corners[np.argsort(corners[:, 0], kind="stable")]


def loft_car(shape: Proportions) -> Mesh:
    """Loft a car without mirrors, x forward, wheels on z = 0."""
    return stretch(loft_parts(shape), (shape.length, shape.width, shape.height))


def build_block_car(shape: Proportions, rng: Rng) -> Mesh:
    """Build the same car of a lower body, a cabin with slanted screens, and wheels of few sides or none."""
    length, half, belt = shape.length, shape.width / 2, shape.belt * shape.height
    tops = shape.profile[:, 1]
    roof, cabin = (shape.profile[tops >= least, 0][[0, -1]] for least in (0.93, 0.7))
    floor = float(rng.choice([0.02, shape.clearance], p=[0.25, 0.75]))
    chamfer = float(rng.uniform(0.0, 0.06))
    edge, base = half * (1 - shape.lean), (0.5 - cabin[0] + 0.03, 0.5 - cabin[1] - 0.02)
    lower = [(floor, 0.5 - 0.01, -0.49, half - chamfer), (floor + chamfer + 0.01, 0.5, -0.5, half)]
    lower += [(belt - chamfer - 0.01, 0.5, -0.5, half), (belt, 0.5 - 0.02, -0.49, half - chamfer)]
    front, rear = 0.5 - roof[0], 0.5 - roof[1]
    upper = [(belt - 0.02, max(base[0], front), min(base[1], rear), half - chamfer), (shape.height, front, rear, edge)]
    sides, breadth = int(rng.choice([4, 8, 12])), float(rng.uniform(0.15, 0.26))
    wheels = []
    for axle in shape.axles if floor > 0.05 or rng.random() < 0.5 else ():
        wheel = make_wheel(length / 2 - axle, half - breadth / 2 - 0.005, shape.wheel, breadth, sides)
        wheels += [wheel, flip_sides(wheel)]
    parts = merge([_blocks(lower, length), _blocks(upper, length), *wheels])
    return stretch(stand(parts), (length, shape.width, shape.height))


def stretch(mesh: Mesh, size: tuple[float, float, float]) -> Mesh:
    """Stretch a mesh to a length, width and height (m). It stands on z = 0 about x = y = 0."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    middle = np.array([*((low + high) / 2)[:2], low[2]])
    return Mesh((mesh.vertices - middle) * (np.array(size) / (high - low)), mesh.triangles)


def _blocks(levels: list[tuple[float, float, float, float]], length: float) -> Mesh:
    """Loft upwards through rectangles. levels: z, front and rear as parts of the length, half width."""
    ends = [(length * rear, length * front, y, z) for z, front, rear, y in levels]
    return loft(np.array([[(a, -y, z), (b, -y, z), (b, y, z), (a, y, z)] for a, b, y, z in ends]))


def plank(size: tuple[float, float, float], x: float, y: float, z: float) -> Mesh:
    """Cuboid standing on height z, about x and y."""
    return box(size, (x, y, z + size[2] / 2))


def mound(size: tuple[float, float, float], x: float, z: float) -> Mesh:
    """Heap of a size on height z, about x and y = 0."""
    length, width, height = size
    round_ = ellipsoid((x, 0.0, z), (length / 2, width / 2, height), 7, 12)
    return Mesh(np.maximum(round_.vertices, [-np.inf, -np.inf, z]), round_.triangles)


NOTHING = merge([])
CARRIED = ("taxi", "light_bar", "roof_box", "rack", "rails", "spare_wheel", "hard_top", "load")
TRAILERS = {"open_trailer": ((1.8, 3.4), (1.3, 2.0)), "box_trailer": ((2.0, 4.2), (1.4, 2.1))}  # lengths, widths (m)
TRAILERS["caravan"] = (3.8, 6.6), (2.0, 2.4)
_TAXIS, _RACKS = ("sedan", "estate", "minivan", "hatchback", "suv"), ("van", "minivan", "pickup")


def mirrors(shape: Proportions, rng: Rng) -> Mesh:
    """Draw wing mirrors that stick out 8 to 25 cm. None on 3 cars of 10, one on 1 of 50."""
    chance = rng.random()
    if chance < 0.3:
        return NOTHING
    tall = 1.6 if shape.kind == "van" else 1.0
    high, deep = rng.uniform(0.06, 0.09) * tall, rng.uniform(0.05, 0.11)
    out = rng.uniform(0.08, 0.19 + 0.04 * tall)
    steep = shape.profile[(shape.profile[:, 1] > 0.75) & (shape.profile[:, 0] < 0.6), 0]
    x = shape.length * (0.5 - float(steep[0]) + 0.03)
    z = shape.belt * shape.height + high + rng.uniform(-0.03, 0.06)
    y = shape.width / 2 + out / 2 - 0.02
    reach = out / 2 + 0.02
    if rng.random() < 0.4:
        mirror = box((deep, 2 * reach, 2 * high), (x, y, z))
    else:
        mirror = ellipsoid((x, y, z), (deep, reach, high), 3, 8)
    arm = tube([(x, 0.75 * shape.width / 2, z - 0.6 * high), (x, y, z - 0.6 * high)], 0.025, 4)
    mirror = merge([mirror, arm])
    return mirror if chance > 0.98 else merge([mirror, flip_sides(mirror)])


def draw_load(shape: Proportions, rng: Rng) -> tuple[str, Mesh]:
    """Draw a load on a car's roof or bed, mostly none, and its kind."""
    flat = shape.profile[shape.profile[:, 1] > 0.965, 0]
    front, rear = (shape.length * (0.5 - float(s)) for s in flat[[0, -1]])
    middle, room, width = (front + rear) / 2, front - rear, shape.width * (1 - shape.lean)
    z, chance = shape.height, rng.random()
    if shape.bed is not None:
        return _bed_load(shape, shape.bed, rng)
    if shape.kind in _TAXIS and chance < 0.06:
        deep, wide, high = rng.uniform(0.1, 0.28), rng.uniform(0.25, 0.7), rng.uniform(0.09, 0.18)
        return "taxi", plank((deep, wide, high), middle + 0.2 * room * rng.uniform(-1, 1), 0.0, z - 0.02)
    if chance < 0.075 and shape.kind != "coupe":
        return "light_bar", plank((0.3, 0.62 * width, 0.13), middle + 0.2 * room, 0.0, z - 0.02)
    if shape.kind in _TAXIS and chance < 0.135:
        return "roof_box", _roof_box(middle, width, z, rng)
    if shape.kind in _RACKS and chance < 0.2:
        return "rack", _rack(middle, 0.8 * room, width, z, rng)
    if shape.kind in ("estate", "suv", "minivan") and chance < 0.5:
        y = 0.42 * width
        ends = [(rear + 0.1 * room, y, z - 0.03), (rear + 0.15 * room, y, z + 0.03)]
        ends += [(front - 0.15 * room, y, z + 0.03), (front - 0.1 * room, y, z - 0.03)]
        rail = tube(ends, 0.02, 4)
        return "rails", merge([rail, flip_sides(rail)])
    if shape.kind == "offroader" and chance < 0.6:
        x, breadth = -shape.length / 2 - 0.08, rng.uniform(0.16, 0.24)
        spare = make_wheel(0.0, 0.0, 0.92 * shape.wheel, breadth)
        return "spare_wheel", place(spare, x, 0.0, 0.36 * shape.height, yaw=np.pi / 2)
    return "", NOTHING


def trailer(shape: Proportions, rng: Rng) -> tuple[str, Mesh]:
    """Draw a trailer with its drawbar: open, boxed, or a caravan."""
    kind = list(TRAILERS)[int(rng.integers(3))]
    length, width = (float(rng.uniform(*ends)) for ends in TRAILERS[kind])
    bar, floor = float(rng.uniform(0.8, 1.4)), float(rng.uniform(0.4, 0.6))
    front = -shape.length / 2 - bar
    middle, radius = front - length / 2, float(rng.uniform(0.24, 0.33))
    parts = [tube([(-shape.length / 2 + 0.1, 0.0, 0.42), (front - 0.2, 0.0, 0.46)], 0.05, 6)]
    if kind == "open_trailer":
        wall = float(rng.uniform(0.3, 0.6))
        parts += [plank((length, width, 0.06), middle, 0.0, floor)]
        parts += [plank((length, 0.05, wall), middle, y, floor) for y in (-width / 2 + 0.025, width / 2 - 0.025)]
        parts += [plank((0.05, width, wall), x, 0.0, floor) for x in (front - 0.025, front - length + 0.025)]
        if rng.random() < 0.5:
            parts.append(mound((0.9 * length, 0.88 * width, float(rng.uniform(0.3, 0.9))), middle, floor + 0.06))
    else:
        top = float(rng.uniform(1.3, 2.3) if kind == "box_trailer" else rng.uniform(2.3, 2.65))
        slope = 0.02 if kind == "box_trailer" else float(rng.uniform(0.06, 0.16))
        ring = np.array([[-0.5, floor], [0.5, floor], [0.5, top], [-0.5, top]]) * [width, 1.0]
        levels = ((-length, 0.0), (slope * length - length, 1.0), (-slope * length, 1.0), (0.0, 0.0))
        rings = []
        for x, t in levels:
            y, z = ring[:, 0] * (0.96 + 0.04 * t), ring[:, 1] - (1 - t) * slope * (ring[:, 1] - 0.4)
            rings.append(np.column_stack([np.full(4, front + x), y, z]))
        parts.append(loft(np.stack(rings)))
    wheels = [make_wheel(middle - 0.05 * length, width / 2 - (0.08 if kind == "caravan" else -0.1), radius, 0.18)]
    return kind, merge([*parts, *wheels, *(flip_sides(wheel) for wheel in wheels)])


def _bed_load(shape: Proportions, bed: tuple[float, float, float], rng: Rng) -> tuple[str, Mesh]:
    """Load on a pick-up's bed, a hard top over it, or nothing."""
    front, rear = (shape.length * (0.5 - s) for s in bed[:2])
    middle, room, width = (front + rear) / 2, 0.9 * (front - rear), 0.78 * shape.width * (1 - shape.lean)
    floor, chance = shape.belt * shape.height - 0.43, rng.random()
    if chance < 0.15:
        z, breadth = shape.belt * shape.height - 0.05, shape.width * (1 - shape.lean)
        return "hard_top", plank((front - rear, breadth, shape.height - z - 0.02), middle, 0.0, z)
    if chance < 0.3:
        return "load", mound((room, width, float(rng.uniform(0.4, 0.9))), middle, floor)
    if chance < 0.45:
        sizes = rng.uniform((0.3, 0.3, 0.4), (0.6, 0.9, 1.1), (2, 3)) * [room, width, 1.0]
        ends = zip(sizes.tolist(), (-1, 1), strict=True)
        places = [(size, middle + side * (room - size[0]) / 2, rng.uniform(-1, 1)) for size, side in ends]
        return "load", merge([plank(tuple(size), x, y * (width - size[1]) / 2, floor) for size, x, y in places])
    return "", NOTHING


def _roof_box(x: float, width: float, z: float, rng: Rng) -> Mesh:
    length, wide, high = rng.uniform(1.3, 2.2), rng.uniform(0.5, 0.85), rng.uniform(0.26, 0.42)
    y = float(rng.uniform(-0.5, 0.5)) * max(width - wide - 0.2, 0.0)
    ring = np.array([[-0.5, 0.1], [0.5, 0.1], [0.5, 0.6], [0.4, 1.0], [-0.4, 1.0], [-0.5, 0.6]]) * [wide, high]
    along = ((-0.5, 0.75), (-0.42, 1.0), (0.3, 1.0), (0.5, 0.4))
    rings = [np.column_stack([np.full(6, x + length * t), y + ring[:, 0], z + ring[:, 1] * f]) for t, f in along]
    bars = [plank((0.06, 0.9 * width, 0.05 + 0.1 * high), x + side * 0.3 * length, 0.0, z - 0.03) for side in (-1, 1)]
    return merge([loft(np.stack(rings)), *bars])


def _rack(x: float, length: float, width: float, z: float, rng: Rng) -> Mesh:
    """Cross bars and, mostly, ladders or pipes on them."""
    high = float(rng.uniform(0.05, 0.14))
    parts = [plank((0.05, 0.9 * width, 0.04), x + t * length, 0.0, z + high - 0.02) for t in (-0.4, 0.0, 0.4)]
    feet = [(t, y) for t in (-0.4, 0.0, 0.4) for y in (-0.42 * width, 0.42 * width)]
    parts += [plank((0.04, 0.04, high + 0.05), x + t * length, y, z - 0.05) for t, y in feet]
    if rng.random() < 0.7:
        y, reach = float(rng.uniform(-0.2, 0.2)) * width, 0.5 * length * float(rng.uniform(0.9, 1.1))
        for side in (y - 0.2, y + 0.2):
            parts.append(tube([(x - reach, side, z + high + 0.05), (x + reach, side, z + high + 0.05)], 0.035, 5))
        for t in np.linspace(-0.9, 0.9, 7).tolist():
            parts.append(plank((0.04, 0.4, 0.04), x + t * reach, y, z + high + 0.03))
    return merge(parts)
