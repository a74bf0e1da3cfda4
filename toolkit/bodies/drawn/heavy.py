"""Drawn heavy vehicles: rigid trucks of many superstructures, tractors with semi-trailers, buses, bendy buses.

Forward-control cabs mostly, some with a bonnet. Articulated ones are straight: a body is rigid.
"""

from __future__ import annotations

import numpy as np

from toolkit.bodies.cars import wheel_at
from toolkit.bodies.drawn.cars import plank
from toolkit.mesh import Mesh, box, ellipsoid, loft, merge, mirrored, shifted, tube

SUPERSTRUCTURES = {
    "box": 0.32, "curtain": 0.12, "flatbed": 0.16, "tipper": 0.13, "tank": 0.07, "refuse": 0.07, "container": 0.08,
    "mixer": 0.05,
}  # fmt: skip
BUSES = ("minibus", "bus", "bendy_bus")

Built = tuple[str, Mesh, Mesh]  # kind, the body in its box, mirrors outside it


def drawn_heavy(rng: np.random.Generator) -> Built:
    """A truck, an articulated truck or a bus, x forward, wheels on z = 0."""
    kinds = (_truck, _articulated, _bus)
    return kinds[int(rng.choice(3, p=(0.55, 0.17, 0.28)))](rng)


def _truck(rng: np.random.Generator) -> Built:
    length = float(rng.uniform(5.2, 11.5))
    width = float(np.clip(1.95 + 0.075 * (length - 5.2) + rng.normal(0, 0.1), 1.85, 2.55))
    cab_height = float(np.clip(2.1 + 0.16 * (length - 5.2) + rng.normal(0, 0.2), 2.0, 3.3))
    deep = float(rng.uniform(1.5, 2.3))
    cab, mirror = _cab(length / 2, width, cab_height, deep, rng)
    gap = float(rng.uniform(0.05, 0.3))
    front, floor = length / 2 - deep - gap, float(rng.uniform(0.85, 1.2))
    kind, load = _superstructure(front, -length / 2, width, floor, cab_height, rng)
    return f"{kind}_truck", merge([cab, load, *_chassis(length, width, floor, deep, rng)]), mirror


def _articulated(rng: np.random.Generator) -> Built:
    length, width = float(rng.uniform(12.5, 17.0)), float(rng.uniform(2.4, 2.58))
    cab_height, deep = float(rng.uniform(2.9, 3.9)), float(rng.uniform(1.9, 2.5))
    cab, mirror = _cab(length / 2, width - float(rng.uniform(0, 0.1)), cab_height, deep, rng)
    front, floor = length / 2 - deep - float(rng.uniform(0.5, 1.0)), float(rng.uniform(1.1, 1.3))
    kind, load = _superstructure(front, -length / 2, width, floor, cab_height, rng)
    radius = float(rng.uniform(0.46, 0.53))
    rows = [length / 2 - 1.4, front - 0.6, *(-length / 2 + float(rng.uniform(1.6, 2.6)) + 1.35 * k for k in range(3))]
    chassis = plank((length - 1.2, 0.9, 0.3), -0.3, 0.0, floor - 0.3)
    return f"articulated_{kind}", merge([cab, load, chassis, *_wheels(rows, width, radius)]), mirror


def _cab(front: float, width: float, height: float, deep: float, rng: np.random.Generator) -> tuple[Mesh, Mesh]:
    """A cab whose front is at `front`, and its mirrors."""
    low, rake = float(rng.uniform(0.3, 0.6)), float(rng.uniform(0.04, 0.35))
    nose = float(rng.uniform(0.8, 1.3)) if rng.random() < 0.12 else 0.0  # a bonnet
    x, corner = front - nose, float(rng.uniform(0.03, 0.15))
    sill = low + 0.45 * (height - low)
    rings = [
        (x - deep + nose, width, low, height),
        (x - 0.6 * rake - corner, width, low, height),
        (x - 0.3 * rake, width - corner, low, height - 0.3 * (height - sill)),
        (x, width - 2 * corner, low, sill),
    ]
    parts = [_lofted(rings)]
    if nose:
        parts.append(_lofted([(x - 0.3, 0.9 * width, low, sill), (front, 0.75 * width, low, sill - 0.25)]))
    if rng.random() < 0.25:
        parts.append(plank((0.5 * deep, 0.8 * width, float(rng.uniform(0.3, 0.6))), x - 0.6 * deep, 0.0, height - 0.03))
    high, out = float(rng.uniform(0.25, 0.5)), float(rng.uniform(0.1, 0.28))
    mirror = box(
        (float(rng.uniform(0.06, 0.2)), out + 0.04, high), (x - 0.2, width / 2 + out / 2 - 0.02, 0.68 * height)
    )
    return merge(parts), merge([mirror, mirrored(mirror)])


def _lofted(stations: list[tuple[float, float, float, float]]) -> Mesh:
    """A loft through chamfered rectangles given as (x, width, floor, roof), from the rear to the front."""
    rings = []
    for x, width, low, top in stations:
        y, c = width / 2, 0.06
        ring = [
            (-y + c, low),
            (y - c, low),
            (y, low + c),
            (y, top - c),
            (y - c, top),
            (c - y, top),
            (-y, top - c),
            (-y, low + c),
        ]
        rings.append([(x, *point) for point in ring])
    return loft(np.array(rings))


def _superstructure(
    front: float, rear: float, width: float, floor: float, cab: float, rng: np.random.Generator
) -> tuple[str, Mesh]:
    """What a truck carries between `front` and `rear` (m), and the word for it."""
    kind = str(rng.choice(list(SUPERSTRUCTURES), p=list(SUPERSTRUCTURES.values())))
    length, middle = front - rear, (front + rear) / 2
    deck = plank((length, width, 0.14), middle, 0.0, floor - 0.02)
    top = float(np.clip(cab + rng.uniform(-0.2, 1.0), floor + 1.0, 4.0))
    if kind in ("box", "curtain", "container"):
        sides = width if kind != "container" else min(width, 2.44)
        return kind, merge([deck, _lofted([(rear, sides, floor, top), (front, sides, floor, top)])])
    if kind == "refuse":
        rings = [(rear, 0.9 * width, floor - 0.2, floor + 1.2), (rear + 0.2 * length, width, floor, top),
                 (front, width, floor, top - 0.15)]  # fmt: skip
        return kind, merge([deck, _lofted(rings)])
    if kind == "tank":
        radius = min(width / 2, float(rng.uniform(0.75, 1.2)))
        line = [(rear, 0.0, floor + radius), (rear + 0.15, 0.0, floor + radius), (front - 0.15, 0.0, floor + radius),
                (front, 0.0, floor + radius)]  # fmt: skip
        return kind, merge(
            [deck, tube(line, [0.7 * radius, radius, radius, 0.7 * radius], 14, flat=width / 2 / radius)]
        )
    if kind == "mixer":
        line = [(rear, 0.0, floor + 1.5), (middle, 0.0, floor + 1.25), (front - 0.1, 0.0, floor + 1.0)]
        return kind, merge([deck, tube(line, [0.45, min(1.15, width / 2), 0.6], 14)])
    wall = float(rng.uniform(0.3, 0.7) if kind == "flatbed" else rng.uniform(0.8, 1.5))
    parts = [deck, *(plank((length, 0.06, wall), middle, y, floor) for y in (-width / 2 + 0.03, width / 2 - 0.03))]
    parts += [plank((0.06, width, wall), x, 0.0, floor) for x in (rear + 0.03, front - 0.03)]
    chance = rng.random()
    if kind == "tipper" or chance < 0.3:
        heap = (0.46 * length, 0.45 * width, wall * float(rng.uniform(0.5, 1.25)))
        parts.append(ellipsoid((middle, 0.0, floor + 0.15), heap, 5, 12))
    elif chance < 0.75:
        sizes = rng.uniform((0.15, 0.5, 0.4), (0.3, 0.95, 1.6), (3, 3)) * [length, width - 0.15, 1.0]
        parts += [
            plank((a, b, c), rear + length * (0.2 + 0.3 * k), 0.0, floor) for k, (a, b, c) in enumerate(sizes.tolist())
        ]
    return kind, merge(parts)


def _chassis(length: float, width: float, floor: float, deep: float, rng: np.random.Generator) -> list[Mesh]:
    radius = float(np.clip(0.36 + 0.03 * (length - 5.2) + rng.uniform(-0.03, 0.03), 0.34, 0.53))
    last = -length / 2 + float(rng.uniform(0.9, 0.28 * length))
    rows = [length / 2 - float(rng.uniform(1.0, 1.45)), last, *([last + 2.3 * radius + 0.2] if length > 8.5 else [])]
    frame = plank((length - 0.8, 0.85, 0.28), -0.3, 0.0, floor - 0.3)
    guard = plank((0.12, 0.93 * width, 0.14), -length / 2 + 0.1, 0.0, float(rng.uniform(0.4, 0.55)))
    return [frame, guard, *_wheels(rows, width, radius)]


def _wheels(rows: list[float], width: float, radius: float) -> list[Mesh]:
    """A pair of wheels at every x."""
    breadth = 0.3
    one = wheel_at(0.0, width / 2 - breadth / 2 - 0.02, radius, breadth, 12)
    wheels = [shifted(one, x) for x in rows]
    return wheels + [mirrored(wheel) for wheel in wheels]


def _bus(rng: np.random.Generator) -> Built:
    """A minibus, city bus, coach, or bendy bus with its bellows."""
    bendy = rng.random() < 0.18
    length = float(rng.uniform(16.5, 18.5) if bendy else rng.choice([rng.uniform(6.2, 9.0), rng.uniform(9.0, 13.5)]))
    width = float(np.clip(2.05 + 0.085 * (length - 6.2) + rng.normal(0, 0.06), 2.0, 2.58))
    height = float(np.clip(2.65 + 0.1 * (length - 6.2) + rng.uniform(-0.15, 0.5), 2.55, 3.85))
    if rng.random() < 0.05:
        height = float(rng.uniform(4.0, 4.4))  # double-decker
    x, low, round_ = length / 2, float(rng.uniform(0.25, 0.4)), float(rng.uniform(0.04, 0.3))
    rake = float(rng.uniform(0.05, 0.5))
    rings = [
        (-x, 0.94 * width, low + 0.08, height - round_),
        (-x + 0.15, width, low, height - 0.03),
        (-x + 0.5, width, low, height),
        (x - rake - 0.3, width, low, height),
        (x - 0.5 * rake, width * 0.99, low, height - 0.35),
        (x, 0.92 * width, low + 0.05, low + 0.55 * (height - low)),
    ]
    if bendy:
        fold = -0.05 * length
        bellows = [(fold - 0.7, width), (fold - 0.65, 0.9 * width), (fold + 0.65, 0.9 * width), (fold + 0.7, width)]
        rings[3:3] = [
            (at, wide, low + (0.1 if wide < width else 0), height - (0.12 if wide < width else 0))
            for at, wide in bellows
        ]
    parts = [_lofted(rings)]
    for share in rng.uniform(-0.6, 0.7, int(rng.integers(0, 3))).tolist():
        size = (float(rng.uniform(1.2, 2.6)), 0.65 * width, float(rng.uniform(0.15, 0.35)))
        parts.append(plank(size, share * (x - 1.5), 0.0, height - 0.03))
    radius = float(np.clip(0.03 * length + 0.12, 0.34, 0.5))
    rows = [
        x - float(rng.uniform(0.16, 0.24)) * min(length, 12.0),
        -x + float(rng.uniform(0.22, 0.3)) * min(length, 12.0),
    ]
    rows += [0.08 * length] if bendy else []
    high, out = float(rng.uniform(0.25, 0.45)), float(rng.uniform(0.12, 0.28))
    at = x + float(rng.uniform(-0.3, -0.1))
    mirror = box((0.14, out + 0.06, high), (at, 0.48 * width + out / 2, low + 0.6 * (height - low)))
    kind = "bendy_bus" if bendy else "minibus" if length < 8 else "bus"
    return kind, merge([*parts, *_wheels(rows, width, radius)]), merge([mirror, mirrored(mirror)])
