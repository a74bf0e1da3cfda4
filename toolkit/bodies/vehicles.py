"""Cars, lofted from their proportions, and the cars, trucks and buses of the catalogue.

A car is a row of cross-sections along x, all worked out at once. The side profile gives each its
top, the plan outline its width; above the belt line the sides lean in (tumblehome), windscreen and
tail bow in plan, and the wheel arches cut into the flanks."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from toolkit.arrays import Float64
from toolkit.mesh import Mesh, box, ellipsoid, flip_sides, loft, merge, place, stand, tube
from toolkit.runtime.text_values import read_own_table

# distance from the front and height of the top, as parts of both
Profile = tuple[tuple[float, float], ...]


def _spread(count: int, step: int = 1) -> Float64[np.ndarray, " n"]:
    """Stations from 0 to 1, dense at both ends."""
    even = np.linspace(0, 1, count)
    return np.concatenate([even**1.6 / 2, 1 - even**1.6 / 2])[::step]


_ACROSS = (1.0, 0.9, 0.7, 0.38, 0.0)  # of the roof, 1 its edge


@dataclass(frozen=True, eq=False)
class Proportions:
    """Proportions of one car; lengths in metres, stations from 0 (front) to 1. belt, lean, rounding
    and ends are parts of height, half width, length and width."""

    kind: str
    length: float
    width: float
    height: float
    # station and height of the body's top, as a part of the height
    profile: Float64[np.ndarray, "k 2"]
    axles: tuple[float, float]  # distances from the front
    wheel: float  # radius
    clearance: float
    belt: float
    lean: float
    rounding: tuple[float, float]  # depth of the plan's corners, front, rear
    ends: tuple[float, float]  # width of the very front and rear
    bow: float  # how far screens bulge forward in plan
    camber: float  # of the roof (m)
    soft: float  # half the length over which the profile is smoothed
    samples: int = 5  # places at which it is
    barrel: float = 0.05  # how much narrower both ends are
    tail: float = 0.12  # rise of the floor at the rear (m)
    tyre: float = 0.115  # width of a wheel, as a part of the car's
    bed: tuple[float, float, float] | None = (
        None  # begin and end of a pick-up's, its width as a part of the roof's
    )
    spread: Float64[np.ndarray, " n"] = field(default_factory=lambda: _spread(13))

    def half_width(self, s: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """Half the width at stations s. Nearly parallel flanks, superelliptic corners at both
        ends."""
        corners = []
        for distance, rounding, end in zip((s, 1 - s), self.rounding, self.ends, strict=True):
            beyond = np.maximum(0.0, 1 - distance / rounding)
            corners.append(end + (1 - end) * (1 - beyond**2.6) ** (1 / 2.6))
        return self.width / 2 * (1 - self.barrel * (2 * s - 1.05) ** 2) * np.minimum(*corners)


def loft_parts(shape: Proportions) -> Mesh:
    """Body and wheels of a car, x forward, wheels on z = 0."""
    reach = shape.wheel * 1.13 / shape.length
    # of the wheel arches, where sections are dense too
    rims = (-1.001, -0.98, -0.55, 0.55, 0.98, 1.001)
    arches = [axle / shape.length + reach * c for axle in shape.axles for c in rims]
    stations = np.unique(np.round(np.clip(np.concatenate([shape.spread, arches]), 0, 1), 4))
    half = _half_sections(shape, stations[::-1])
    parts = [loft(np.concatenate([half, half[:, -2:0:-1] * [1.0, -1.0, 1.0]], axis=1))]
    breadth = shape.tyre * shape.width
    one = make_wheel(0.0, 0.0, shape.wheel, breadth)
    for axle in shape.axles:
        y = float(shape.half_width(np.array([axle / shape.length]))[0]) * 0.985
        wheel = place(one, shape.length / 2 - axle, y - breadth / 2)
        parts += [wheel, flip_sides(wheel)]
    return merge(parts)


def _half_sections(
    shape: Proportions, s: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 13 3"]:
    """Left halves of the sections at stations s, from floor to roof."""
    across = np.array(_ACROSS)
    width = shape.half_width(s)
    bow = shape.bow * across**2 * np.clip((s[:, None] - 0.55) * 6, -1, 1)
    near = np.linspace(-1, 1, shape.samples) * shape.soft
    tops = np.interp(np.clip((s[:, None] + bow)[..., None] + near, 0, 1), *shape.profile.T)
    roof = shape.height * tops.mean(axis=-1)
    roof -= shape.camber * across**2 * np.clip(4 * np.minimum(s, 1 - s) + 0.3, 0, 1)[:, None]
    floor = shape.clearance + np.interp(s, [0, 0.1, 0.85, 1], [0.06, 0, 0, shape.tail])
    nearest = np.abs(s[:, None] * shape.length - np.array(shape.axles)).min(axis=1)
    inside = 1.13 * shape.wheel > nearest
    arch = np.where(
        inside, shape.wheel + np.sqrt(np.maximum((1.13 * shape.wheel) ** 2 - nearest**2, 0)), 0.0
    )
    crown = roof[:, 0]
    shoulder = np.minimum(shape.belt * shape.height, crown - 0.035)
    low = np.maximum(np.minimum(arch, shoulder - 0.07), floor + 0.02)
    flank = np.maximum(low + 0.01, floor + 0.45 * (shoulder - floor))
    lean = shape.lean * np.clip((crown - shoulder) / (shape.height * (1 - shape.belt)), 0, 1)
    edge = width * (0.965 - lean)
    glass = 0.4775 * width + 0.5 * edge + 0.012, shoulder + 0.52 * (crown - shoulder)
    eaves = crown - 0.25 * np.minimum(0.16, crown - shoulder)
    middle = np.zeros_like(s)
    bottom = np.where(arch > floor, low, floor)
    y = [middle, *(part * width for part in (0.74, 0.74, 0.965, 1.0, 0.995, 0.965)), glass[0]]
    y += [edge, 0.93 * edge, 0.72 * edge, 0.38 * edge, middle]
    z = [
        floor,
        floor,
        bottom,
        low,
        flank,
        flank + 0.6 * (shoulder - flank),
        shoulder,
        glass[1],
        eaves,
        *roof.T[1:],
    ]
    sections = np.stack(
        np.broadcast_arrays(shape.length * (0.5 - s)[:, None], np.stack(y, 1), np.stack(z, 1)),
        axis=-1,
    )
    if shape.bed is not None:
        begin, end, wide = shape.bed
        open_ = (s > begin) & (s < end)
        sections[open_, -3:, 1] = edge[open_, None] * [wide, 0.4, 0.0]
        sections[open_, -3:, 2] = np.maximum(shoulder - 0.42, low + 0.02)[open_, None]
    return sections


def make_wheel(x: float, y: float, radius: float, breadth: float, sides: int = 12) -> Mesh:
    """Make a wheel with its axle along y, standing on z = 0."""
    line = np.column_stack(
        [np.full(4, x), np.array([-0.5, -0.42, 0.42, 0.5]) * breadth + y, np.full(4, radius)]
    )
    return stand(tube(line, np.array([0.86, 1, 1, 0.86]) * radius, sides))


CAR_SHAPES = read_own_table(__file__, "cars.toml")
CAR_PROFILES: dict[str, Profile] = {
    style: tuple(map(tuple, each)) for style, each in CAR_SHAPES["profiles"].items()
}
_CATALOGUE_SPREAD = _spread(20, 2)


def _loft_catalogue_car(row: Sequence[Any]) -> tuple[Mesh, Mesh]:
    """Meshes of a car and of its wing mirrors, wheels on z = 0."""
    (
        style,
        length,
        width,
        height,
        wheelbase,
        wheel,
        clearance,
        belt,
        lean,
        rounding,
        rake,
        *rails,
    ) = row
    pickup = style == "pickup"
    profile = np.array(CAR_PROFILES[style])
    profile[2:-2, 0] += rake
    # the front one is shorter, a pickup's rear is long
    overhang = (length - wheelbase) * (0.40 if pickup else 0.44)
    axles = (overhang, overhang + wheelbase)
    bed = (0.625 + rake, 0.985, 0.8) if pickup else None
    # from `ends` on
    figures = ((0.62, 0.62), 0.035, 0.055, 0.018, 7, 0.06, 0.14, 0.12, bed, _CATALOGUE_SPREAD)
    measures = (
        length,
        width,
        height,
        profile,
        axles,
        wheel,
        clearance,
        belt,
        lean,
        (rounding, rounding),
    )
    shape = Proportions(style, *measures, *figures)
    glass = length * (0.5 - CAR_PROFILES[style][2][0] - max(rake, 0.0) - 0.035)
    mirror = ellipsoid((glass, width / 2 + 0.005, belt * height + 0.04), (0.09, 0.10, 0.075), 3, 6)
    parts = [loft_parts(shape)]
    if rails:
        z, y, x = height - 0.08, width * (0.5 - 0.48 * lean), length
        rail = tube(
            [(0.08 * x, y, z), (0.02 * x, y, z + 0.05), (-0.3 * x, y, z + 0.05), (-0.36 * x, y, z)],
            0.02,
            4,
        )
        parts += [rail, flip_sides(rail)]
    return merge(parts), merge([mirror, flip_sides(mirror)])


CAR_NAMES = tuple(CAR_SHAPES["catalogue"])


def cars() -> dict[str, tuple[Mesh, Mesh]]:
    """Cars, each with its wing mirrors beside it, x forward, wheels on z = 0."""
    return {name: _loft_catalogue_car(row) for name, row in CAR_SHAPES["catalogue"].items()}


def trucks() -> dict[str, tuple[Mesh, Mesh]]:
    """Trucks and buses, each with its wing mirrors beside it. x forward, wheels on z = 0."""
    large = (7.6, 2.35, 2.5)
    small = (6.3, 2.05, 2.25)
    tipper = (7.9, 2.4, 2.75)
    city = (12.0, 2.55, 3.0)
    midi = (8.9, 2.35, 2.85)
    built = {
        "box_truck": [
            _cab(*large),
            _cargo(7.6, 5.6, 2.45, 3.35),
            *make_axles((2.5, -1.8), 2.4, 0.45),
        ],
        "small_box_truck": [
            _cab(*small, 1.7),
            _cargo(6.3, 4.35, 2.15, 2.95),
            *make_axles((2.05, -1.55), 2.1, 0.37),
        ],
        "tipper": [_cab(*tipper), _skip(7.9, 5.5), *make_axles((2.6, -1.35, -2.65), 2.45, 0.50)],
        "city_bus": [_bus(*city), *make_axles((3.3, -2.6), 2.5, 0.48)],
        "midibus": [_bus(*midi), *make_axles((2.25, -2.15), 2.3, 0.42)],
    }
    places = [
        (x / 2 - 0.15, width / 2 + 0.12, height * 0.72)
        for x, width, height in (large, small, tipper)
    ]
    mirrors = [
        *(box((0.12, 0.16, 0.42), place) for place in places),
        _bus_mirror(*city),
        _bus_mirror(*midi),
    ]
    pairs = zip(built.items(), mirrors, strict=True)
    return {
        name: (merge(parts), merge([mirror, flip_sides(mirror)])) for (name, parts), mirror in pairs
    }


def loft_shell(
    stations: list[tuple[float, float, float, float]], corner: float, points: int = 3
) -> Mesh:
    """Loft through rounded rectangles (x, width, floor, roof), rear to front, with some points to a
    corner (m)."""
    quarter = np.linspace(0, np.pi / 2, points)
    rings = []
    for x, width, z0, z1 in stations:
        y = width / 2
        r = corner
        middles = ((y - r, z1 - r), (r - y, z1 - r), (r - y, z0 + r), (y - r, z0 + r))
        corners = zip(middles, (k * np.pi / 2 + quarter for k in range(4)), strict=True)
        arcs = [
            (0 * turn + x, cy + r * np.cos(turn), cz + r * np.sin(turn))
            for (cy, cz), turn in corners
        ]
        rings.append(np.concatenate([np.column_stack(arc) for arc in arcs]))
    return loft(np.stack(rings))


def _cab(length: float, width: float, height: float, deep: float = 2.0) -> Mesh:
    """Forward-control cab whose front is at length / 2."""
    front = length / 2
    stations = [(front - deep, width, 0.55, height), (front - 0.55, width, 0.45, height)]
    stations += [
        (front - 0.25, width, 0.40, height - 0.12),
        (front - 0.07, width * 0.96, 0.40, height - 0.75),
    ]
    return loft_shell([*stations, (front, width * 0.88, 0.45, height - 1.25)], 0.09)


def _cargo(length: float, deep: float, width: float, top: float) -> Mesh:
    rear = -length / 2
    load = loft_shell([(rear, width, 0.95, top), (rear + deep, width, 0.95, top)], 0.04)
    guard = box((0.12, width * 0.95, 0.14), (rear + 0.1, 0, 0.5))
    return merge([load, box((length - 0.9, 0.85, 0.28), (-0.35, 0, 0.80)), guard])


def _skip(length: float, deep: float) -> Mesh:
    """Open tipper body with a heap in it."""
    rear = -length / 2
    middle = rear + deep / 2
    walls = [box((deep, 0.08, 1.35), (middle, y, 1.75)) for y in (-1.2, 1.2)]
    walls += [box((0.08, 2.45, 1.35), (x, 0, 1.75)) for x in (rear + 0.04, rear + deep)]
    heap = ellipsoid((middle, 0, 1.6), (deep * 0.46, 1.12, 0.85), 5, 12)
    floor = box((deep, 2.4, 0.12), (middle, 0, 1.1))
    return merge([*walls, heap, floor, box((length - 0.9, 0.85, 0.3), (-0.35, 0, 0.85))])


def _bus(length: float, width: float, height: float) -> Mesh:
    """City bus: window band set 4 cm in, roof units, rounded ends."""
    x = length / 2
    belt = 1.05
    ends = [(-x, width * 0.9, 0.4, height - 0.25), (-x + 0.12, width, 0.32, height - 0.06)]
    ends += [(-x + 0.4, width, 0.30, height), (x - 0.5, width, 0.30, height)]
    ends += [(x - 0.12, width * 0.98, 0.30, height - 0.10), (x, width * 0.90, 0.35, height - 0.45)]
    body = loft_shell(ends, 0.13)
    wide = width + 0.04
    pillar = box((0.14, wide, height - belt - 0.45), (0, 0, (belt + height - 0.25) / 2))
    pillars = [place(pillar, p) for p in np.arange(-x + 0.8, x - 0.7, 1.45)]
    skirt = box((length - 0.9, wide, belt - 0.4), (0, 0, (belt + 0.4) / 2 + 0.02))
    units = [box((1.8, 1.5, 0.22), (p, 0, height + 0.08)) for p in (-x * 0.5, x * 0.35)]
    return merge([body, *pillars, skirt, *units])


def _bus_mirror(length: float, width: float, height: float) -> Mesh:
    x, y = length / 2, width / 2
    path = [
        (x - 0.15, y, height - 0.35),
        (x + 0.12, y + 0.14, height - 0.5),
        (x + 0.12, y + 0.14, height - 0.95),
    ]
    return tube(path, [0.03, 0.05, 0.09], 6)


def make_axles(places: Iterable[float], width: float, radius: float, sides: int = 14) -> list[Mesh]:
    """Wheels 0.3 m broad on both sides of a vehicle of a width, at every x."""
    wheels = [make_wheel(x, width / 2 - 0.15, radius, 0.3, sides) for x in places]
    return wheels + [flip_sides(wheel) for wheel in wheels]
