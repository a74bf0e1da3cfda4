"""Cars, trucks and buses of the catalogue, one row of figures per model.

A car is a row of cross-sections along x. The side profile gives each its top, the plan outline its width; above the
belt line the sides lean in (tumblehome), windscreen and tail bow in plan, and the wheel arches cut into the flanks.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import numpy as np

from toolkit.arrays import Float64
from toolkit.mesh import Mesh, box, ellipsoid, flip_sides, loft, merge, tube


def parse_profile(text: str) -> tuple[tuple[float, float], ...]:
    """Parse pairs of distance from the front and height, as parts of length and height.

    >>> parse_profile("0 0.38, 1 0.5")
    ((0.0, 0.38), (1.0, 0.5))
    """
    return tuple((float(x), float(z)) for x, z in (pair.split() for pair in text.split(",")))


_PROFILES = {
    style: parse_profile(text)
    for style, text in {
        "hatchback": "0 0.38, 0.02 0.47, 0.24 0.62, 0.43 0.965, 0.56 1, 0.85 0.955, 0.965 0.62, 1 0.5",
        "sedan": "0 0.38, 0.02 0.48, 0.27 0.63, 0.42 0.965, 0.53 1, 0.68 0.955, 0.85 0.7, 0.98 0.66, 1 0.5",
        "estate": "0 0.38, 0.02 0.48, 0.26 0.63, 0.4 0.965, 0.52 1, 0.9 0.95, 0.985 0.63, 1 0.48",
        "suv": "0 0.42, 0.015 0.54, 0.24 0.64, 0.37 0.965, 0.48 1, 0.89 0.96, 0.975 0.62, 1 0.5",
        "van": "0 0.32, 0.015 0.42, 0.1 0.53, 0.24 0.955, 0.33 1, 0.975 0.985, 0.99 0.7, 1 0.4",
        "minivan": "0 0.36, 0.02 0.45, 0.16 0.57, 0.35 0.96, 0.48 1, 0.91 0.965, 0.98 0.6, 1 0.46",
        "pickup": "0 0.46, 0.015 0.58, 0.23 0.655, 0.34 0.97, 0.44 1, 0.555 0.97, 0.61 0.62, 0.985 0.61, 1 0.5",
        "sports": "0 0.38, 0.03 0.48, 0.34 0.7, 0.5 0.975, 0.56 1, 0.66 0.965, 0.9 0.74, 0.985 0.71, 1 0.52",
    }.items()
}


@dataclass(frozen=True)
class CarShape:
    """Figures of one model of car.

    Lengths in metres, the rest as parts of its length, height or width. width: without mirrors; wheel: radius; belt:
    height of the window line; tumblehome: how far the roof edge leans in; rounding: depth of the plan rounding at front
    and rear; rake: how far the roof is shifted back; rails: on the roof.
    """

    name: str
    style: str
    length: float
    width: float
    height: float
    wheelbase: float
    wheel: float
    clearance: float
    belt: float
    tumblehome: float
    rounding: float
    rake: float
    rails: bool = field(default=False, kw_only=True)


# Mirrors come on top of the width. The last five rows are held out of training (see `toolkit.bodies.fleet.catalogue`).
# name, style, length, width, height, wheelbase, wheel, clearance, belt, tumblehome, rounding, rake[, rails]
_ROWS = """
city_hatchback     hatchback  3.55  1.62  1.48  2.42  0.28  0.17  0.64  0.22  0.2   0
supermini          hatchback  3.98  1.7   1.46  2.52  0.3   0.17  0.62  0.22  0.16  0.01
compact_hatchback  hatchback  4.28  1.78  1.45  2.63  0.32  0.17  0.62  0.24  0.16  0.02
tall_hatchback     hatchback  3.72  1.61  1.66  2.46  0.28  0.17  0.58  0.14  0.13  -0.05
small_sedan        sedan      4.35  1.72  1.47  2.6   0.3   0.17  0.62  0.22  0.16  0
family_sedan       sedan      4.72  1.82  1.45  2.8   0.33  0.17  0.62  0.24  0.16  0.01
executive_sedan    sedan      5.05  1.87  1.48  2.98  0.35  0.17  0.62  0.22  0.18  0.03
classic_sedan      sedan      4.55  1.69  1.42  2.66  0.31  0.17  0.6   0.18  0.08  0.02
compact_estate     estate     4.45  1.76  1.5   2.66  0.31  0.17  0.62  0.22  0.16  0       rails
long_estate        estate     4.92  1.85  1.49  2.9   0.34  0.17  0.62  0.2   0.16  0.01
boxy_estate        estate     4.7   1.74  1.46  2.75  0.32  0.17  0.6   0.15  0.09  0.03
compact_suv        suv        4.18  1.79  1.6   2.6   0.34  0.2   0.62  0.22  0.16  0
family_suv         suv        4.55  1.86  1.67  2.7   0.36  0.21  0.62  0.22  0.16  0       rails
large_suv          suv        5.02  1.91  1.8   2.98  0.39  0.23  0.62  0.19  0.16  0
offroader          suv        4.3   1.84  1.9   2.58  0.41  0.26  0.6   0.09  0.07  -0.01
delivery_van       van        5.1   1.92  1.98  3.1   0.34  0.2   0.55  0.12  0.1   0
high_roof_van      van        5.55  1.91  2.28  3.3   0.35  0.21  0.52  0.1   0.09  -0.02
people_carrier     minivan    4.75  1.84  1.74  2.88  0.33  0.17  0.56  0.17  0.16  0       rails
double_cab_pickup  pickup     5.32  1.87  1.79  3.15  0.39  0.25  0.62  0.18  0.09  0
coupe              sports     4.4   1.82  1.32  2.55  0.33  0.14  0.62  0.3   0.2   0
mid_engine_sports  sports     4.52  1.91  1.17  2.65  0.34  0.12  0.66  0.34  0.18  -0.11
roomy_hatchback    hatchback  4.12  1.75  1.54  2.58  0.31  0.17  0.6   0.19  0.14  -0.02
fastback_sedan     sedan      4.86  1.86  1.43  2.88  0.34  0.17  0.62  0.27  0.21  0.045
crossover          suv        4.42  1.83  1.56  2.68  0.35  0.2   0.62  0.25  0.18  0.03
compact_van        minivan    4.4   1.8   1.84  2.75  0.31  0.18  0.56  0.13  0.11  -0.03
single_cab_pickup  pickup     5.02  1.8   1.7   3.02  0.36  0.23  0.62  0.16  0.1   -0.035
"""


def _parse_row(row: str) -> CarShape:
    name, style, *cells = row.split()
    return CarShape(name, style, *map(float, cells[:10]), rails=cells[10:] == ["rails"])


CARS = tuple(map(_parse_row, _ROWS.strip().splitlines()))

_STATIONS = 20
_ENDS = 0.62  # width of the very front and rear, as a part of the greatest width


def car(shape: CarShape) -> tuple[Mesh, Mesh]:
    """Meshes of a car and of its wing mirrors, wheels on z = 0."""
    parts = [_hull(shape), *_wheels(shape)]
    glass = shape.length * (0.5 - _PROFILES[shape.style][2][0] - max(shape.rake, 0.0) - 0.035)
    mirror = ellipsoid((glass, shape.width / 2 + 0.005, shape.belt * shape.height + 0.04), (0.09, 0.10, 0.075), 3, 6)
    if shape.rails:
        z, y, x = shape.height - 0.08, shape.width * (0.5 - 0.48 * shape.tumblehome), shape.length
        rail = tube([(0.08 * x, y, z), (0.02 * x, y, z + 0.05), (-0.3 * x, y, z + 0.05), (-0.36 * x, y, z)], 0.02, 4)
        parts += [rail, flip_sides(rail)]
    return merge(parts), merge([mirror, flip_sides(mirror)])


def _hull(shape: CarShape) -> Mesh:
    """Painted body: half cross-sections, mirrored and lofted to the front."""
    s = _stations(shape)
    half = np.stack([_half_section(shape, x) for x in s[::-1].tolist()])
    other = half[:, -2:0:-1] * [1.0, -1.0, 1.0]
    return loft(np.concatenate([half, other], axis=1))


def _stations(shape: CarShape) -> Float64[np.ndarray, " s"]:
    """Stations of cross-sections (0 front to 1 rear). Dense at both ends and at the rims of the wheel arches."""
    even = np.linspace(0, 1, _STATIONS)
    ends = np.concatenate([even**1.6 / 2, 1 - even**1.6 / 2])[::2]
    reach = shape.wheel * 1.13 / shape.length
    arches = [axle + reach * c for axle in _axles(shape) for c in (-1.001, -0.98, -0.55, 0.55, 0.98, 1.001)]
    return np.unique(np.round(np.concatenate([ends, arches]), 4))


def _axles(shape: CarShape) -> tuple[float, float]:
    """Front and rear axle (0 front to 1 rear). The front overhang is a little shorter, a pickup's rear is long."""
    overhang = (shape.length - shape.wheelbase) * (0.44 if shape.style != "pickup" else 0.40)
    return overhang / shape.length, (overhang + shape.wheelbase) / shape.length


def _half_section(shape: CarShape, s: float) -> Float64[np.ndarray, "p 3"]:
    """Left half of the section at station s, from floor to roof."""
    top = partial(_top, shape)
    w, floor, arch = _half_width(shape, s), _floor(shape, s), _arch(shape, s)
    crown = top(s, 1.0)
    shoulder = min(shape.belt * shape.height, crown - 0.035)
    low = max(min(arch, shoulder - 0.07), floor + 0.02)
    flank = max(low + 0.01, floor + 0.45 * (shoulder - floor))
    lean = shape.tumblehome * max(crown - shoulder, 0.0) / (shape.height * (1 - shape.belt))
    edge = w * (0.965 - min(lean, shape.tumblehome))
    inner = 0.74 * w
    points = [
        (0.0, floor),
        (inner, floor),
        (inner, low if arch > floor else floor),
        (0.965 * w, low),
        (w, flank),
        (0.995 * w, flank + 0.6 * (shoulder - flank)),
        (0.965 * w, shoulder),
        (0.5 * (0.955 * w + edge) + 0.012, shoulder + 0.52 * (crown - shoulder)),
        (edge, crown - 0.25 * min(0.16, crown - shoulder)),
        (0.93 * edge, top(s, 0.9)),
        (0.72 * edge, top(s, 0.7)),
        (0.38 * edge, top(s, 0.38)),
        (0.0, top(s, 0.0)),
    ]
    if shape.style == "pickup" and _bed(shape, s):
        bed = max(shoulder - 0.42, low + 0.02)
        points[-3:] = [(0.8 * edge, bed), (0.4 * edge, bed), (0.0, bed)]
    return np.array([(shape.length * (0.5 - s), y, z) for y, z in points])


def _bed(shape: CarShape, s: float) -> bool:
    return 0.625 + shape.rake < s < 0.985


def _top(shape: CarShape, s: float, across: float) -> float:
    """Height at station s and `across` (0 middle, 1 roof edge)."""
    bow = 0.035 * across**2 * np.clip((s - 0.55) * 6, -1, 1)
    near = np.linspace(-1, 1, 7) * 0.018
    profile = np.array(_PROFILES[shape.style])
    profile[2:-2, 0] += shape.rake
    heights = np.interp(np.clip(s + bow + near, 0, 1), profile[:, 0], profile[:, 1])
    camber = 0.055 * across**2 * np.clip(4 * min(s, 1 - s) + 0.3, 0, 1)
    return float(shape.height * heights.mean() - camber)


def _half_width(shape: CarShape, s: float) -> float:
    """Half the width at station s. Nearly parallel flanks, superelliptic corners at both ends."""
    depth = min(s, 1 - s) / shape.rounding
    corner = (1 - max(0.0, 1 - depth) ** 2.6) ** (1 / 2.6)
    barrel = 1 - 0.06 * (2 * s - 1.05) ** 2
    return shape.width / 2 * barrel * (_ENDS + (1 - _ENDS) * corner)


def _floor(shape: CarShape, s: float) -> float:
    """Height of the underside, rising to both ends."""
    return shape.clearance + float(np.interp(s, [0, 0.1, 0.85, 1], [0.06, 0, 0, 0.14]))


def _arch(shape: CarShape, s: float) -> float:
    """Height of the wheel arch at station s, 0 outside of it."""
    radius = 1.13 * shape.wheel
    nearest = min(abs(s - axle) for axle in _axles(shape)) * shape.length
    return shape.wheel + float(np.sqrt(radius**2 - nearest**2)) if nearest < radius else 0.0


def _wheels(shape: CarShape) -> list[Mesh]:
    breadth = 0.12 * shape.width
    wheels = []
    for axle in _axles(shape):
        x, y = shape.length * (0.5 - axle), _half_width(shape, axle) * 0.985
        wheel = make_wheel(x, y - breadth / 2, shape.wheel, breadth)
        wheels += [wheel, flip_sides(wheel)]
    return wheels


def make_wheel(x: float, y: float, radius: float, breadth: float, sides: int = 12) -> Mesh:
    """Make a wheel with its axle along y, standing on z = 0."""
    across = np.array([-0.5, -0.42, 0.42, 0.5]) * breadth + y
    wheel = tube(
        np.column_stack([np.full(4, x), across, np.full(4, radius)]), np.array([0.86, 1, 1, 0.86]) * radius, sides
    )
    return Mesh(wheel.vertices - [0.0, 0.0, wheel.vertices[:, 2].min()], wheel.triangles)


def trucks() -> dict[str, tuple[Mesh, Mesh]]:
    """Trucks and buses, each with its wing mirrors beside it. x forward, wheels on z = 0."""
    return {
        "box_truck": (
            merge([_cab(7.6, 2.35, 2.5), _cargo(7.6, 5.6, 2.45, 3.35), *_truck_axles(7.6, 2.4, 0.45, (1.3, 5.6))]),
            _cab_mirrors(7.6, 2.35, 2.5),
        ),
        "small_box_truck": (
            merge(
                [_cab(6.3, 2.05, 2.25, 1.7), _cargo(6.3, 4.35, 2.15, 2.95), *_truck_axles(6.3, 2.1, 0.37, (1.1, 4.7))]
            ),
            _cab_mirrors(6.3, 2.05, 2.25),
        ),
        "tipper": (
            merge([_cab(7.9, 2.4, 2.75), _skip(7.9, 5.5), *_truck_axles(7.9, 2.45, 0.50, (1.35, 5.3, 6.6))]),
            _cab_mirrors(7.9, 2.4, 2.75),
        ),
        "city_bus": (
            merge([_bus(12.0, 2.55, 3.0), *_truck_axles(12.0, 2.5, 0.48, (2.7, 8.6))]),
            _bus_mirrors(12.0, 2.55, 3.0),
        ),
        "midibus": (
            merge([_bus(8.9, 2.35, 2.85), *_truck_axles(8.9, 2.3, 0.42, (2.2, 6.6))]),
            _bus_mirrors(8.9, 2.35, 2.85),
        ),
    }


def _outline(width: float, z0: float, z1: float, corner: float) -> np.ndarray:
    """Rounded rectangle in (y, z), counter-clockwise seen from the front."""
    y, r = width / 2, corner
    quarter = np.linspace(0, np.pi / 2, 3)
    arcs = [
        np.stack([cy + r * np.cos(start + quarter), cz + r * np.sin(start + quarter)], axis=1)
        for cy, cz, start in (
            (y - r, z1 - r, 0.0),
            (r - y, z1 - r, np.pi / 2),
            (r - y, z0 + r, np.pi),
            (y - r, z0 + r, 1.5 * np.pi),
        )
    ]
    return np.concatenate(arcs)


def _shell(stations: list[tuple[float, float, float, float]], corner: float) -> Mesh:
    """Loft through rounded rectangles (x, width, floor, roof)."""
    rings = [_outline(width, z0, z1, corner) for _, width, z0, z1 in stations]
    return loft(np.stack([np.column_stack([np.full(len(r), s[0]), r]) for s, r in zip(stations, rings, strict=True)]))


def _cab(length: float, width: float, height: float, deep: float = 2.0) -> Mesh:
    """Forward-control cab whose front is at length / 2."""
    front = length / 2
    return _shell(
        [
            (front - deep, width, 0.55, height),
            (front - 0.55, width, 0.45, height),
            (front - 0.25, width, 0.40, height - 0.12),
            (front - 0.07, width * 0.96, 0.40, height - 0.75),
            (front, width * 0.88, 0.45, height - 1.25),
        ],
        0.09,
    )


def _cab_mirrors(length: float, width: float, height: float) -> Mesh:
    mirror = box((0.12, 0.16, 0.42), (length / 2 - 0.15, width / 2 + 0.12, height * 0.72))
    return merge([mirror, flip_sides(mirror)])


def _cargo(length: float, deep: float, width: float, top: float) -> Mesh:
    rear = -length / 2
    load = _shell([(rear, width, 0.95, top), (rear + deep, width, 0.95, top)], 0.04)
    return merge(
        [load, box((length - 0.9, 0.85, 0.28), (-0.35, 0, 0.80)), box((0.12, width * 0.95, 0.14), (rear + 0.1, 0, 0.5))]
    )


def _skip(length: float, deep: float) -> Mesh:
    """Open tipper body with a heap in it."""
    rear = -length / 2
    middle = rear + deep / 2
    walls = [box((deep, 0.08, 1.35), (middle, y, 1.75)) for y in (-1.2, 1.2)]
    walls += [box((0.08, 2.45, 1.35), (x, 0, 1.75)) for x in (rear + 0.04, rear + deep)]
    heap = ellipsoid((middle, 0, 1.6), (deep * 0.46, 1.12, 0.85), 5, 12)
    return merge(
        [*walls, heap, box((deep, 2.4, 0.12), (middle, 0, 1.1)), box((length - 0.9, 0.85, 0.3), (-0.35, 0, 0.85))]
    )


def _bus(length: float, width: float, height: float) -> Mesh:
    """City bus: window band set 4 cm in, roof units, rounded ends."""
    x, belt = length / 2, 1.05
    body = _shell(
        [
            (-x, width * 0.9, 0.4, height - 0.25),
            (-x + 0.12, width, 0.32, height - 0.06),
            (-x + 0.4, width, 0.30, height),
            (x - 0.5, width, 0.30, height),
            (x - 0.12, width * 0.98, 0.30, height - 0.10),
            (x, width * 0.90, 0.35, height - 0.45),
        ],
        0.13,
    )
    pillars = [
        box((0.14, width + 0.04, height - belt - 0.45), (p, 0, (belt + height - 0.25) / 2))
        for p in np.arange(-x + 0.8, x - 0.7, 1.45)
    ]
    skirt = box((length - 0.9, width + 0.04, belt - 0.4), (0, 0, (belt + 0.4) / 2 + 0.02))
    units = [box((1.8, 1.5, 0.22), (p, 0, height + 0.08)) for p in (-x * 0.5, x * 0.35)]
    return merge([body, *pillars, skirt, *units])


def _bus_mirrors(length: float, width: float, height: float) -> Mesh:
    x = length / 2
    mirror = tube(
        [
            (x - 0.15, width / 2, height - 0.35),
            (x + 0.12, width / 2 + 0.14, height - 0.5),
            (x + 0.12, width / 2 + 0.14, height - 0.95),
        ],
        [0.03, 0.05, 0.09],
        6,
    )
    return merge([mirror, flip_sides(mirror)])


def _truck_axles(length: float, width: float, radius: float, behind_front: tuple[float, ...]) -> list[Mesh]:
    breadth = 0.3
    wheels = [make_wheel(length / 2 - d, width / 2 - breadth / 2, radius, breadth, 14) for d in behind_front]
    return wheels + [flip_sides(wheel) for wheel in wheels]
