"""What drawn cars carry: mirrors, roof signs, roof boxes, racks with ladders, loads on beds, trailers and caravans."""

from __future__ import annotations

import numpy as np

from toolkit.bodies.cars import wheel_at
from toolkit.bodies.drawn.cars import bed_of, plank
from toolkit.bodies.drawn.proportions import Proportions
from toolkit.mesh import Mesh, box, ellipsoid, loft, merge, mirrored, placed, shifted, tube

NOTHING = merge([])
CARRIED = ("taxi", "light_bar", "roof_box", "rack", "rails", "spare_wheel", "hard_top", "load")
TRAILERS = ("open_trailer", "box_trailer", "caravan")
_TAXIS, _RACKS = ("sedan", "estate", "minivan", "hatchback", "suv"), ("van", "minivan", "pickup")


def mirrors(shape: Proportions, rng: np.random.Generator) -> Mesh:
    """Wing mirrors that stick out 8 to 25 cm on either side, or none (3 cars of 10), or one (1 of 50)."""
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
        mirror = ellipsoid((x, y, z), (deep, reach, high), 3, 6)
    arm = tube([(x, 0.75 * shape.width / 2, z - 0.6 * high), (x, y, z - 0.6 * high)], 0.025, 4)
    mirror = merge([mirror, arm])
    return mirror if chance > 0.98 else merge([mirror, mirrored(mirror)])


def on_roof(shape: Proportions, rng: np.random.Generator) -> tuple[str, Mesh]:
    """What a car has on its roof or bed, and the word for it; mostly nothing."""
    flat = shape.profile[shape.profile[:, 1] > 0.965, 0]
    front, rear = (shape.length * (0.5 - float(s)) for s in flat[[0, -1]])
    middle, room, width = (front + rear) / 2, front - rear, shape.width * (1 - shape.lean)
    z, chance = shape.height, rng.random()
    if shape.kind == "pickup":
        return _bed_load(shape, rng)
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
        rail = tube([(rear + 0.1 * room, y, z - 0.03), (rear + 0.15 * room, y, z + 0.03),
                     (front - 0.15 * room, y, z + 0.03), (front - 0.1 * room, y, z - 0.03)], 0.02, 4)  # fmt: skip
        return "rails", merge([rail, mirrored(rail)])
    if shape.kind == "offroader" and chance < 0.6:
        x, breadth = -shape.length / 2 - 0.08, rng.uniform(0.16, 0.24)
        spare = wheel_at(0.0, 0.0, 0.92 * shape.wheel, breadth)
        turned = placed(spare, yaw=np.pi / 2)
        return "spare_wheel", shifted(turned, x, 0.0, 0.36 * shape.height)
    return "", NOTHING


def trailer(shape: Proportions, rng: np.random.Generator) -> tuple[str, Mesh]:
    """A trailer behind the car with its drawbar: open, boxed, or a caravan."""
    kind = TRAILERS[int(rng.integers(3))]
    length = float(rng.uniform(*{"open_trailer": (1.8, 3.4), "box_trailer": (2.0, 4.2), "caravan": (3.8, 6.6)}[kind]))
    width = float(rng.uniform(*{"open_trailer": (1.3, 2.0), "box_trailer": (1.4, 2.1), "caravan": (2.0, 2.4)}[kind]))
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
            heap = (0.45 * length, 0.44 * width, float(rng.uniform(0.3, 0.8)))
            parts.append(ellipsoid((middle, 0.0, floor + 0.1), heap, 5, 10))
    else:
        top = float(rng.uniform(1.3, 2.3) if kind == "box_trailer" else rng.uniform(2.3, 2.65))
        slope = 0.02 if kind == "box_trailer" else float(rng.uniform(0.06, 0.16))
        ring = np.array([[-0.5, floor], [0.5, floor], [0.5, top], [-0.5, top]]) * [width, 1.0]
        levels = [
            (front - length, 0.0),
            (front - length + slope * length, 1.0),
            (front - slope * length, 1.0),
            (front, 0),
        ]
        rings = [
            np.column_stack(
                [np.full(4, x), ring[:, 0] * (0.96 + 0.04 * t), ring[:, 1] - (1 - t) * slope * (ring[:, 1] - 0.4)]
            )
            for x, t in levels
        ]
        parts.append(loft(np.stack(rings)))
    wheels = [wheel_at(middle - 0.05 * length, width / 2 - (0.08 if kind == "caravan" else -0.1), radius, 0.18)]
    return kind, merge([*parts, *wheels, *(mirrored(wheel) for wheel in wheels)])


def _bed_load(shape: Proportions, rng: np.random.Generator) -> tuple[str, Mesh]:
    """An open load on a pick-up's bed, a hard top over it, or nothing."""
    front, rear = (shape.length * (0.5 - s) for s in bed_of(shape))
    middle, room, width = (front + rear) / 2, 0.9 * (front - rear), 0.78 * shape.width * (1 - shape.lean)
    floor, chance = shape.belt * shape.height - 0.43, rng.random()
    if chance < 0.15:
        z = shape.belt * shape.height - 0.05
        return "hard_top", plank(
            (front - rear, shape.width * (1 - shape.lean), shape.height - z - 0.02), middle, 0.0, z
        )
    if chance < 0.3:
        return "load", ellipsoid((middle, 0.0, floor + 0.1), (room / 2, width / 2, float(rng.uniform(0.4, 0.9))), 5, 10)
    if chance < 0.45:
        sizes = rng.uniform((0.3, 0.3, 0.4), (0.6, 0.9, 1.1), (2, 3)) * [room, width, 1.0]
        boxes = [
            plank((a, b, c), middle + side * (room - a) / 2, rng.uniform(-1, 1) * (width - b) / 2, floor)
            for (a, b, c), side in zip(sizes.tolist(), (-1, 1), strict=True)
        ]
        return "load", merge(boxes)
    return "", NOTHING


def _roof_box(x: float, width: float, z: float, rng: np.random.Generator) -> Mesh:
    length, wide, high = rng.uniform(1.3, 2.2), rng.uniform(0.5, 0.85), rng.uniform(0.26, 0.42)
    y = float(rng.uniform(-0.5, 0.5)) * max(width - wide - 0.2, 0.0)
    ring = np.array([[-0.5, 0.1], [0.5, 0.1], [0.5, 0.6], [0.4, 1.0], [-0.4, 1.0], [-0.5, 0.6]]) * [wide, high]
    along = ((-0.5, 0.75), (-0.42, 1.0), (0.3, 1.0), (0.5, 0.4))
    rings = [np.column_stack([np.full(6, x + length * t), y + ring[:, 0], z + ring[:, 1] * f]) for t, f in along]
    bars = [plank((0.06, 0.9 * width, 0.05 + 0.1 * high), x + side * 0.3 * length, 0.0, z - 0.03) for side in (-1, 1)]
    return merge([loft(np.stack(rings)), *bars])


def _rack(x: float, length: float, width: float, z: float, rng: np.random.Generator) -> Mesh:
    """Cross bars and, mostly, ladders or pipes on them."""
    high = float(rng.uniform(0.05, 0.14))
    parts = [plank((0.05, 0.9 * width, 0.04), x + t * length, 0.0, z + high - 0.02) for t in (-0.4, 0.0, 0.4)]
    parts += [plank((0.04, 0.04, high + 0.05), x + t * length, y, z - 0.05)
              for t in (-0.4, 0.0, 0.4) for y in (-0.42 * width, 0.42 * width)]  # fmt: skip
    if rng.random() < 0.7:
        y, reach = float(rng.uniform(-0.2, 0.2)) * width, 0.5 * length * float(rng.uniform(0.9, 1.1))
        rails = [tube([(x - reach, y + d, z + high + 0.05), (x + reach, y + d, z + high + 0.05)], 0.035, 5)
                 for d in (-0.2, 0.2)]  # fmt: skip
        rungs = [
            plank((0.04, 0.4, 0.04), x + t * reach, y, z + high + 0.03) for t in np.linspace(-0.9, 0.9, 7).tolist()
        ]
        parts += rails + rungs
    return merge(parts)
