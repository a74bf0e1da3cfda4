"""Cars, lofted from their proportions, and the cars, trucks and buses of the catalogue.

A car is a row of cross-sections along x, all worked out at once. The side profile gives each its top, the plan outline
its width; above the belt line the sides lean in (tumblehome), windscreen and tail bow in plan, and the wheel arches cut
into the flanks."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from toolkit.arrays import Float64
from toolkit.mesh import Mesh, box, ellipsoid, flip_sides, loft, merge, place, stand, tube

Profile = tuple[tuple[float, float], ...]  # distance from the front and height of the top, as parts of both


def _spread(count: int, step: int = 1) -> Float64[np.ndarray, " n"]:
    """Stations from 0 to 1, dense at both ends."""
    even = np.linspace(0, 1, count)
    return np.concatenate([even**1.6 / 2, 1 - even**1.6 / 2])[::step]


_ACROSS = (1.0, 0.9, 0.7, 0.38, 0.0)  # of the roof, 1 its edge


@dataclass(frozen=True, eq=False)
class Proportions:
    """Proportions of one car; lengths in metres, stations from 0 (front) to 1. belt, lean, rounding and ends are parts
    of height, half width, length and width."""

    kind: str
    length: float
    width: float
    height: float
    profile: Float64[np.ndarray, "k 2"]  # station and height of the body's top, as a part of the height
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
    bed: tuple[float, float, float] | None = None  # begin and end of a pick-up's, its width as a part of the roof's
    spread: Float64[np.ndarray, " n"] = field(default_factory=lambda: _spread(13))

    def half_width(self, s: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """Half the width at stations s. Nearly parallel flanks, superelliptic corners at both ends."""
        corners = []
        for distance, rounding, end in zip((s, 1 - s), self.rounding, self.ends, strict=True):
            beyond = np.maximum(0.0, 1 - distance / rounding)
            corners.append(end + (1 - end) * (1 - beyond**2.6) ** (1 / 2.6))
        return self.width / 2 * (1 - self.barrel * (2 * s - 1.05) ** 2) * np.minimum(*corners)


def loft_parts(shape: Proportions) -> Mesh:
    """Body and wheels of a car, x forward, wheels on z = 0."""
    reach = shape.wheel * 1.13 / shape.length
    rims = (-1.001, -0.98, -0.55, 0.55, 0.98, 1.001)  # of the wheel arches, where sections are dense too
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


def _half_sections(shape: Proportions, s: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 13 3"]:
    """Left halves of the sections at stations s, from floor to roof."""
    across, width = np.array(_ACROSS), shape.half_width(s)
    bow = shape.bow * across**2 * np.clip((s[:, None] - 0.55) * 6, -1, 1)
    near = np.linspace(-1, 1, shape.samples) * shape.soft
    tops = np.interp(np.clip((s[:, None] + bow)[..., None] + near, 0, 1), *shape.profile.T)
    roof = shape.height * tops.mean(axis=-1)
    roof -= shape.camber * across**2 * np.clip(4 * np.minimum(s, 1 - s) + 0.3, 0, 1)[:, None]
    floor = shape.clearance + np.interp(s, [0, 0.1, 0.85, 1], [0.06, 0, 0, shape.tail])
    nearest = np.abs(s[:, None] * shape.length - np.array(shape.axles)).min(axis=1)
    inside = 1.13 * shape.wheel > nearest
    arch = np.where(inside, shape.wheel + np.sqrt(np.maximum((1.13 * shape.wheel) ** 2 - nearest**2, 0)), 0.0)
    crown = roof[:, 0]
    shoulder = np.minimum(shape.belt * shape.height, crown - 0.035)
    low = np.maximum(np.minimum(arch, shoulder - 0.07), floor + 0.02)
    flank = np.maximum(low + 0.01, floor + 0.45 * (shoulder - floor))
    lean = shape.lean * np.clip((crown - shoulder) / (shape.height * (1 - shape.belt)), 0, 1)
    edge = width * (0.965 - lean)
    glass = 0.4775 * width + 0.5 * edge + 0.012, shoulder + 0.52 * (crown - shoulder)
    eaves = crown - 0.25 * np.minimum(0.16, crown - shoulder)
    middle, bottom = np.zeros_like(s), np.where(arch > floor, low, floor)
    y = [middle, *(part * width for part in (0.74, 0.74, 0.965, 1.0, 0.995, 0.965)), glass[0]]
    y += [edge, 0.93 * edge, 0.72 * edge, 0.38 * edge, middle]
    z = [floor, floor, bottom, low, flank, flank + 0.6 * (shoulder - flank), shoulder, glass[1], eaves, *roof.T[1:]]
    sections = np.stack(np.broadcast_arrays(shape.length * (0.5 - s)[:, None], np.stack(y, 1), np.stack(z, 1)), axis=-1)
    if shape.bed is not None:
        begin, end, wide = shape.bed
        open_ = (s > begin) & (s < end)
        sections[open_, -3:, 1] = edge[open_, None] * [wide, 0.4, 0.0]
        sections[open_, -3:, 2] = np.maximum(shoulder - 0.42, low + 0.02)[open_, None]
    return sections


def make_wheel(x: float, y: float, radius: float, breadth: float, sides: int = 12) -> Mesh:
    """Make a wheel with its axle along y, standing on z = 0."""
    line = np.column_stack([np.full(4, x), np.array([-0.5, -0.42, 0.42, 0.5]) * breadth + y, np.full(4, radius)])
    return stand(tube(line, np.array([0.86, 1, 1, 0.86]) * radius, sides))


_PROFILES = """
kei        0 0.34, 0.02 0.44, 0.15 0.53, 0.3 0.96, 0.42 1, 0.93 0.985, 0.985 0.66, 1 0.42
city       0 0.36, 0.02 0.46, 0.22 0.61, 0.41 0.965, 0.55 1, 0.87 0.955, 0.97 0.62, 1 0.48
hatchback  0 0.38, 0.02 0.47, 0.24 0.62, 0.43 0.965, 0.56 1, 0.85 0.955, 0.965 0.62, 1 0.5
sedan      0 0.38, 0.02 0.48, 0.27 0.63, 0.42 0.965, 0.53 1, 0.68 0.955, 0.85 0.7, 0.98 0.66, 1 0.5
estate     0 0.38, 0.02 0.48, 0.26 0.63, 0.4 0.965, 0.52 1, 0.9 0.95, 0.985 0.63, 1 0.48
suv        0 0.42, 0.015 0.54, 0.24 0.64, 0.37 0.965, 0.48 1, 0.89 0.96, 0.975 0.62, 1 0.5
offroader  0 0.44, 0.01 0.58, 0.27 0.63, 0.335 0.97, 0.4 1, 0.96 0.985, 0.985 0.8, 1 0.4
minivan    0 0.36, 0.02 0.45, 0.16 0.57, 0.35 0.96, 0.48 1, 0.91 0.965, 0.98 0.6, 1 0.46
van        0 0.3, 0.015 0.42, 0.1 0.53, 0.24 0.955, 0.33 1, 0.975 0.985, 0.99 0.7, 1 0.4
blunt_van  0 0.32, 0.015 0.42, 0.1 0.53, 0.24 0.955, 0.33 1, 0.975 0.985, 0.99 0.7, 1 0.4
pickup     0 0.46, 0.015 0.58, 0.23 0.655, 0.34 0.97, 0.44 1, 0.555 0.97, 0.61 0.62, 0.985 0.61, 1 0.5
coupe      0 0.36, 0.03 0.48, 0.34 0.7, 0.5 0.975, 0.56 1, 0.66 0.965, 0.9 0.74, 0.985 0.71, 1 0.52
sports     0 0.38, 0.03 0.48, 0.34 0.7, 0.5 0.975, 0.56 1, 0.66 0.965, 0.9 0.74, 0.985 0.71, 1 0.52
"""
CAR_PROFILES: dict[str, Profile] = {
    style: tuple((float(x), float(z)) for x, z in map(str.split, points.split(",")))
    for style, points in (row.split(maxsplit=1) for row in _PROFILES.strip().splitlines())
}


# Mirrors come on top of the width (m, as all lengths); the rest are parts. tumblehome: how far the roof edge leans in;
# rake: how far the roof is shifted back; rails: on the roof. The last five are held out of training (see `fleet`).
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
delivery_van       blunt_van  5.1   1.92  1.98  3.1   0.34  0.2   0.55  0.12  0.1   0
high_roof_van      blunt_van  5.55  1.91  2.28  3.3   0.35  0.21  0.52  0.1   0.09  -0.02
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


_CATALOGUE_SPREAD = _spread(20, 2)


def _parse_car(row: str) -> tuple[str, tuple[Mesh, Mesh]]:
    """Name of a car, and the meshes of it and of its wing mirrors, wheels on z = 0."""
    name, style, *cells = row.split()
    length, width, height, wheelbase, wheel, clearance, belt, lean, rounding, rake = map(float, cells[:10])
    pickup, profile = style == "pickup", np.array(CAR_PROFILES[style])
    profile[2:-2, 0] += rake
    overhang = (length - wheelbase) * (0.40 if pickup else 0.44)  # the front one is shorter, a pickup's rear is long
    axles, bed = (overhang, overhang + wheelbase), (0.625 + rake, 0.985, 0.8) if pickup else None
    figures = (0.62, 0.62), 0.035, 0.055, 0.018, 7, 0.06, 0.14, 0.12, bed, _CATALOGUE_SPREAD  # from `ends` on
    measures = (length, width, height, profile, axles, wheel, clearance, belt, lean, (rounding, rounding))
    shape = Proportions(style, *measures, *figures)
    glass = length * (0.5 - CAR_PROFILES[style][2][0] - max(rake, 0.0) - 0.035)
    mirror = ellipsoid((glass, width / 2 + 0.005, belt * height + 0.04), (0.09, 0.10, 0.075), 3, 6)
    parts = [loft_parts(shape)]
    if cells[10:] == ["rails"]:
        z, y, x = height - 0.08, width * (0.5 - 0.48 * lean), length
        rail = tube([(0.08 * x, y, z), (0.02 * x, y, z + 0.05), (-0.3 * x, y, z + 0.05), (-0.36 * x, y, z)], 0.02, 4)
        parts += [rail, flip_sides(rail)]
    return name, (merge(parts), merge([mirror, flip_sides(mirror)]))


CAR_NAMES = tuple(row.split()[0] for row in _ROWS.strip().splitlines())


def cars() -> dict[str, tuple[Mesh, Mesh]]:
    """Cars, each with its wing mirrors beside it, x forward, wheels on z = 0."""
    return dict(map(_parse_car, _ROWS.strip().splitlines()))


def trucks() -> dict[str, tuple[Mesh, Mesh]]:
    """Trucks and buses, each with its wing mirrors beside it. x forward, wheels on z = 0."""
    large, small, tipper = (7.6, 2.35, 2.5), (6.3, 2.05, 2.25), (7.9, 2.4, 2.75)
    city, midi = (12.0, 2.55, 3.0), (8.9, 2.35, 2.85)
    built = {
        "box_truck": [_cab(*large), _cargo(7.6, 5.6, 2.45, 3.35), *make_axles((2.5, -1.8), 2.4, 0.45)],
        "small_box_truck": [_cab(*small, 1.7), _cargo(6.3, 4.35, 2.15, 2.95), *make_axles((2.05, -1.55), 2.1, 0.37)],
        "tipper": [_cab(*tipper), _skip(7.9, 5.5), *make_axles((2.6, -1.35, -2.65), 2.45, 0.50)],
        "city_bus": [_bus(*city), *make_axles((3.3, -2.6), 2.5, 0.48)],
        "midibus": [_bus(*midi), *make_axles((2.25, -2.15), 2.3, 0.42)],
    }
    places = [(x / 2 - 0.15, width / 2 + 0.12, height * 0.72) for x, width, height in (large, small, tipper)]
    mirrors = [*(box((0.12, 0.16, 0.42), place) for place in places), _bus_mirror(*city), _bus_mirror(*midi)]
    pairs = zip(built.items(), mirrors, strict=True)
    return {name: (merge(parts), merge([mirror, flip_sides(mirror)])) for (name, parts), mirror in pairs}


def loft_shell(stations: list[tuple[float, float, float, float]], corner: float, points: int = 3) -> Mesh:
    """Loft through rounded rectangles (x, width, floor, roof), rear to front, with some points to a corner (m)."""
    quarter, rings = np.linspace(0, np.pi / 2, points), []
    for x, width, z0, z1 in stations:
        y, r = width / 2, corner
        middles = ((y - r, z1 - r), (r - y, z1 - r), (r - y, z0 + r), (y - r, z0 + r))
        corners = zip(middles, (k * np.pi / 2 + quarter for k in range(4)), strict=True)
        arcs = [(0 * turn + x, cy + r * np.cos(turn), cz + r * np.sin(turn)) for (cy, cz), turn in corners]
        rings.append(np.concatenate([np.column_stack(arc) for arc in arcs]))
    return loft(np.stack(rings))


def _cab(length: float, width: float, height: float, deep: float = 2.0) -> Mesh:
    """Forward-control cab whose front is at length / 2."""
    front = length / 2
    stations = [(front - deep, width, 0.55, height), (front - 0.55, width, 0.45, height)]
    stations += [(front - 0.25, width, 0.40, height - 0.12), (front - 0.07, width * 0.96, 0.40, height - 0.75)]
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
    x, belt = length / 2, 1.05
    ends = [(-x, width * 0.9, 0.4, height - 0.25), (-x + 0.12, width, 0.32, height - 0.06)]
    ends += [(-x + 0.4, width, 0.30, height), (x - 0.5, width, 0.30, height)]
    ends += [(x - 0.12, width * 0.98, 0.30, height - 0.10), (x, width * 0.90, 0.35, height - 0.45)]
    body, wide = loft_shell(ends, 0.13), width + 0.04
    pillar = box((0.14, wide, height - belt - 0.45), (0, 0, (belt + height - 0.25) / 2))
    pillars = [place(pillar, p) for p in np.arange(-x + 0.8, x - 0.7, 1.45)]
    skirt = box((length - 0.9, wide, belt - 0.4), (0, 0, (belt + 0.4) / 2 + 0.02))
    units = [box((1.8, 1.5, 0.22), (p, 0, height + 0.08)) for p in (-x * 0.5, x * 0.35)]
    return merge([body, *pillars, skirt, *units])


def _bus_mirror(length: float, width: float, height: float) -> Mesh:
    x, y = length / 2, width / 2
    path = [(x - 0.15, y, height - 0.35), (x + 0.12, y + 0.14, height - 0.5), (x + 0.12, y + 0.14, height - 0.95)]
    return tube(path, [0.03, 0.05, 0.09], 6)


def make_axles(places: Iterable[float], width: float, radius: float, sides: int = 14) -> list[Mesh]:
    """Wheels 0.3 m broad on both sides of a vehicle of a width, at every x."""
    wheels = [make_wheel(x, width / 2 - 0.15, radius, 0.3, sides) for x in places]
    return wheels + [flip_sides(wheel) for wheel in wheels]
