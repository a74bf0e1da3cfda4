"""Bodies drawn at random for a class: cars, heavy vehicles, two-wheelers and people.

The ground truth box of a drawn vehicle is the body without its wing mirrors, which stick out of it by 8 to 25 cm
(`toolkit.bodies.body.include_mirrors` gives the other convention). Roof signs, roof boxes, racks, loads and spare
wheels belong to the box, and so does a trailer, which makes a car an articulated heavy vehicle: straight, as a body is
rigid.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from toolkit.arrays import Rng
from toolkit.bodies import drawn_cars, people
from toolkit.bodies.body import Body, make_boxed_body
from toolkit.bodies.drawn_cars import mound, plank
from toolkit.bodies.people import AT_AN_EAR, PUSHING, Figure, hold, pair, person, rider, striding
from toolkit.bodies.vehicles import loft_shell, make_axles, make_wheel
from toolkit.mesh import Mesh, Vector, box, flip_sides, merge, place, scale_mesh, stand, tube
from toolkit.objects import CYCLIST, HEAVY, LABELS, PEDESTRIAN, VEHICLE, label_index

SUPERSTRUCTURES = {"box": 0.32, "curtain": 0.12, "flatbed": 0.16, "tipper": 0.13}  # and their shares
SUPERSTRUCTURES |= {"tank": 0.07, "refuse": 0.07, "container": 0.08, "mixer": 0.05}
BUSES = ("minibus", "bus", "bendy_bus")

Built = tuple[str, Mesh, Mesh]  # kind, the body in its box, mirrors outside it


def draw_heavy(rng: Rng) -> Built:
    """Draw a truck, an articulated truck or a bus. x forward, wheels on z = 0."""
    kinds = (_truck, _semi_trailer, _bus)
    return kinds[int(rng.choice(3, p=(0.55, 0.17, 0.28)))](rng)


def _truck(rng: Rng) -> Built:
    length = float(rng.uniform(5.2, 11.5))
    width = float(np.clip(1.95 + 0.075 * (length - 5.2) + rng.normal(0, 0.1), 1.85, 2.55))
    cab_height = float(np.clip(2.1 + 0.16 * (length - 5.2) + rng.normal(0, 0.2), 2.0, 3.3))
    deep = float(rng.uniform(1.5, 2.3))
    cab, mirror = _cab(length / 2, width, cab_height, deep, rng)
    gap = float(rng.uniform(0.05, 0.3))
    front, floor = length / 2 - deep - gap, float(rng.uniform(0.85, 1.2))
    kind, load = _superstructure(front, -length / 2, width, floor, cab_height, rng)
    return f"{kind}_truck", merge([cab, load, *_chassis(length, width, floor, rng)]), mirror


def _semi_trailer(rng: Rng) -> Built:
    length, width = float(rng.uniform(12.5, 17.0)), float(rng.uniform(2.4, 2.58))
    cab_height, deep = float(rng.uniform(2.9, 3.9)), float(rng.uniform(1.9, 2.5))
    cab, mirror = _cab(length / 2, width - float(rng.uniform(0, 0.1)), cab_height, deep, rng)
    front, floor = length / 2 - deep - float(rng.uniform(0.5, 1.0)), float(rng.uniform(1.1, 1.3))
    kind, load = _superstructure(front, -length / 2, width, floor, cab_height, rng)
    radius = float(rng.uniform(0.46, 0.53))
    rows = [length / 2 - 1.4, front - 0.6, *(-length / 2 + float(rng.uniform(1.6, 2.6)) + 1.35 * k for k in range(3))]
    chassis = plank((length - 1.2, 0.9, 0.3), -0.3, 0.0, floor - 0.3)
    return f"articulated_{kind}", merge([cab, load, chassis, *make_axles(rows, width - 0.04, radius, 12)]), mirror


def _cab(front: float, width: float, height: float, deep: float, rng: Rng) -> tuple[Mesh, Mesh]:
    low, rake = float(rng.uniform(0.3, 0.6)), float(rng.uniform(0.04, 0.35))
    nose = float(rng.uniform(0.8, 1.3)) if rng.random() < 0.12 else 0.0  # a bonnet
    x, corner = front - nose, float(rng.uniform(0.03, 0.15))
    sill = low + 0.45 * (height - low)
    rings = [(x - deep + nose, width, low, height), (x - 0.6 * rake - corner, width, low, height)]
    rings += [(x - 0.3 * rake, width - corner, low, height - 0.3 * (height - sill)), (x, width - 2 * corner, low, sill)]
    parts = [loft_shell(rings, 0.06, 2)]
    if nose:
        parts.append(loft_shell([(x - 0.3, 0.9 * width, low, sill), (front, 0.75 * width, low, sill - 0.25)], 0.06, 2))
    if rng.random() < 0.25:
        parts.append(plank((0.5 * deep, 0.8 * width, float(rng.uniform(0.3, 0.6))), x - 0.6 * deep, 0.0, height - 0.03))
    high, out = float(rng.uniform(0.25, 0.5)), float(rng.uniform(0.1, 0.28))
    size = float(rng.uniform(0.06, 0.2)), out + 0.04, high
    mirror = box(size, (x - 0.2, width / 2 + out / 2 - 0.02, 0.68 * height))
    return merge(parts), merge([mirror, flip_sides(mirror)])


def _superstructure(front: float, rear: float, width: float, floor: float, cab: float, rng: Rng) -> tuple[str, Mesh]:
    """Load of a truck between `front` and `rear` (m), and its kind."""
    kind = str(rng.choice(list(SUPERSTRUCTURES), p=list(SUPERSTRUCTURES.values())))
    length, middle = front - rear, (front + rear) / 2
    deck = plank((length, width, 0.14), middle, 0.0, floor - 0.02)
    top = float(np.clip(cab + rng.uniform(-0.2, 1.0), floor + 1.0, 4.0))
    if kind in ("box", "curtain", "container"):
        sides = width if kind != "container" else min(width, 2.44)
        return kind, merge([deck, loft_shell([(rear, sides, floor, top), (front, sides, floor, top)], 0.06, 2)])
    if kind == "refuse":
        rings = [(rear, 0.9 * width, floor - 0.2, floor + 1.2), (rear + 0.2 * length, width, floor, top)]
        return kind, merge([deck, loft_shell([*rings, (front, width, floor, top - 0.15)], 0.06, 2)])
    if kind == "tank":
        radius = min(width / 2, float(rng.uniform(0.75, 1.2)))
        line = [(x, 0.0, floor + radius) for x in (rear, rear + 0.15, front - 0.15, front)]
        radii = [0.7 * radius, radius, radius, 0.7 * radius]
        return kind, merge([deck, tube(line, radii, 14, flat=width / 2 / radius)])
    if kind == "mixer":
        line = [(rear, 0.0, floor + 1.5), (middle, 0.0, floor + 1.25), (front - 0.1, 0.0, floor + 1.0)]
        return kind, merge([deck, tube(line, [0.45, min(1.15, width / 2), 0.6], 14)])
    wall = float(rng.uniform(0.3, 0.7) if kind == "flatbed" else rng.uniform(0.8, 1.5))
    parts = [deck, *(plank((length, 0.06, wall), middle, y, floor) for y in (-width / 2 + 0.03, width / 2 - 0.03))]
    parts += [plank((0.06, width, wall), x, 0.0, floor) for x in (rear + 0.03, front - 0.03)]
    chance = rng.random()
    if kind == "tipper" or chance < 0.3:
        heap = 0.92 * length, 0.9 * width, wall * float(rng.uniform(0.6, 1.35))
        parts.append(mound(heap, middle, floor + 0.12))
    elif chance < 0.75:
        sizes = rng.uniform((0.15, 0.5, 0.4), (0.3, 0.95, 1.6), (3, 3)) * [length, width - 0.15, 1.0]
        for k, (a, b, c) in enumerate(sizes.tolist()):
            parts.append(plank((a, b, c), rear + length * (0.2 + 0.3 * k), 0.0, floor))
    return kind, merge(parts)


def _chassis(length: float, width: float, floor: float, rng: Rng) -> list[Mesh]:
    radius = float(np.clip(0.36 + 0.03 * (length - 5.2) + rng.uniform(-0.03, 0.03), 0.34, 0.53))
    last = -length / 2 + float(rng.uniform(0.9, 0.28 * length))
    rows = [length / 2 - float(rng.uniform(1.0, 1.45)), last, *([last + 2.3 * radius + 0.2] if length > 8.5 else [])]
    frame = plank((length - 0.8, 0.85, 0.28), -0.3, 0.0, floor - 0.3)
    guard = plank((0.12, 0.93 * width, 0.14), -length / 2 + 0.1, 0.0, float(rng.uniform(0.4, 0.55)))
    return [frame, guard, *make_axles(rows, width - 0.04, radius, 12)]


def _bus(rng: Rng) -> Built:
    """Minibus, city bus, coach, or bendy bus with its bellows."""
    bendy = rng.random() < 0.18
    length = float(rng.uniform(16.5, 18.5) if bendy else rng.choice([rng.uniform(6.2, 9.0), rng.uniform(9.0, 13.5)]))
    width = float(np.clip(2.05 + 0.085 * (length - 6.2) + rng.normal(0, 0.06), 2.0, 2.58))
    height = float(np.clip(2.65 + 0.1 * (length - 6.2) + rng.uniform(-0.15, 0.5), 2.55, 3.85))
    if rng.random() < 0.05:
        height = float(rng.uniform(4.0, 4.4))  # double-decker
    x, low, round_ = length / 2, float(rng.uniform(0.25, 0.4)), float(rng.uniform(0.04, 0.3))
    rake = float(rng.uniform(0.05, 0.5))
    rings = [(-x, 0.94 * width, low + 0.08, height - round_), (-x + 0.15, width, low, height - 0.03)]
    rings += [(-x + 0.5, width, low, height), (x - rake - 0.3, width, low, height)]
    rings += [(x - 0.5 * rake, width * 0.99, low, height - 0.35)]
    rings += [(x, 0.92 * width, low + 0.05, low + 0.55 * (height - low))]
    if bendy:
        fold = -0.05 * length
        bellows = [(fold - 0.7, width), (fold - 0.65, 0.9 * width), (fold + 0.65, 0.9 * width), (fold + 0.7, width)]
        folds = ((at, wide, 0.1 if wide < width else 0, 0.12 if wide < width else 0) for at, wide in bellows)
        rings[3:3] = [(at, wide, low + sill, height - lid) for at, wide, sill, lid in folds]
    parts = [loft_shell(rings, 0.06, 2)]
    for share in rng.uniform(-0.6, 0.7, int(rng.integers(0, 3))).tolist():
        size = (float(rng.uniform(1.2, 2.6)), 0.65 * width, float(rng.uniform(0.15, 0.35)))
        parts.append(plank(size, share * (x - 1.5), 0.0, height - 0.03))
    radius = float(np.clip(0.03 * length + 0.12, 0.34, 0.5))
    overhangs = [float(rng.uniform(*ends)) * min(length, 12.0) for ends in ((0.16, 0.24), (0.22, 0.3))]
    rows = [x - overhangs[0], -x + overhangs[1], *([0.08 * length] if bendy else [])]
    high, out = float(rng.uniform(0.25, 0.45)), float(rng.uniform(0.12, 0.28))
    at = x + float(rng.uniform(-0.3, -0.1))
    mirror = box((0.14, out + 0.06, high), (at, 0.48 * width + out / 2, low + 0.6 * (height - low)))
    kind = "bendy_bus" if bendy else "minibus" if length < 8 else "bus"
    return kind, merge([*parts, *make_axles(rows, width - 0.04, radius, 12)]), merge([mirror, flip_sides(mirror)])


PEOPLE = ("adult", "child", "pram", "walker", "wheelchair")


def draw_person(rng: Rng) -> tuple[str, Mesh]:
    """Draw a person on foot or in a wheelchair, and its kind. Facing +x, soles or wheels on z = 0."""
    chance = rng.random()
    if chance < 0.035:
        return "wheelchair", stand(_wheelchair(rng))
    if chance < 0.2:
        height = float(rng.uniform(0.95, 1.55))
        parts = [person(_walking(rng, stout=rng.uniform(0.92, 1.12)), height)]
        parts += [people.backpack(height)] if rng.random() < 0.3 else []
        return "child", stand(merge(parts))
    height = float(np.clip(rng.normal(1.71, 0.09), 1.48, 2.02))
    if chance < 0.25:
        pushing = person(hold(_walking(rng), *PUSHING), height)
        return "pram", stand(merge([pushing, scale_mesh(people.pushchair(height), float(rng.uniform(0.85, 1.1)))]))
    if chance < 0.27:
        legs = [tube([(x, y, 0.05), (0.35, y, 0.52 * height)], 0.015, 5) for x in (0.3, 0.75) for y in (-0.25, 0.25)]
        wheels = [make_wheel(x, y, 0.09, 0.04, 8) for x in (0.3, 0.75) for y in (-0.25, 0.25)]
        pushing = person(hold(_walking(rng, lean=0.06), *PUSHING), height)
        return "walker", stand(merge([pushing, *legs, *wheels, plank((0.25, 0.46, 0.05), 0.5, 0.0, 0.5)]))
    figure = _walking(rng, stout=float(np.clip(rng.normal(1.0, 0.13), 0.8, 1.4)))
    parts = [person(figure, height)]
    wears, carries = rng.random(2)
    if wears < 0.2:
        parts.append(people.skirt(height, float(rng.uniform(0.1, 0.34)), figure.stout))
    elif wears < 0.28:
        parts.append(people.hat(height))
    extras = {0.08: people.backpack, 0.2: people.bag, 0.25: people.umbrella, 0.28: people.stick, 0.32: people.trolley}
    parts += [extra(height) for least, extra in extras.items() if carries < least][:1]
    return "adult", stand(merge(parts))


def draw_pose(rng: Rng, stout: float) -> Figure:
    """Draw a standing pose: arms hanging or at an ear."""
    figure = Figure(stout=stout)
    return hold(figure, *AT_AN_EAR) if rng.random() < 0.25 else figure


def _walking(rng: Rng, stout: float | None = None, lean: float | None = None) -> Figure:
    stout = float(rng.uniform(0.85, 1.2)) if stout is None else float(stout)
    if rng.random() < 0.2:
        return draw_pose(rng, stout)
    lean = float(rng.uniform(0.0, 0.05)) if lean is None else lean
    figure = striding(float(rng.uniform(0.08, 0.45)), float(rng.uniform(0.2, 1.0)), lean, stout)
    if rng.random() < 0.5:
        return figure
    joints = (figure.knees, figure.ankles, figure.elbows, figure.hands)
    flipped = [((c, -d, e), (x, -y, z)) for (x, y, z), (c, d, e) in joints]
    knees, ankles, elbows, hands = flipped
    return replace(figure, knees=knees, ankles=ankles, elbows=elbows, hands=hands)


def _wheelchair(rng: Rng) -> Mesh:
    """Person seated between two large wheels, sometimes pushed."""
    height, radius = float(rng.uniform(1.5, 1.85)), float(rng.uniform(0.27, 0.31))
    half, seat = float(rng.uniform(0.26, 0.31)), float(rng.uniform(0.45, 0.52))
    hip = seat / height + 0.05
    legs, arms = (pair(0.19, 0.06, hip + 0.02), pair(0.26, 0.05, 0.1)), pair(0.0, 0.16, hip + 0.13)
    hands, stout = pair(0.14, 0.13, hip + 0.09), float(rng.uniform(0.9, 1.2))
    figure = Figure((-0.05, 0.0, hip), (-0.07, 0.0, hip + 0.31), *legs, arms, hands, stout)
    wheels = [make_wheel(-0.08, half, radius, 0.04, 14), make_wheel(0.38, half - 0.05, 0.08, 0.04, 8)]
    chair = [plank((0.42, 1.7 * half, 0.06), 0.0, 0.0, seat - 0.06), plank((0.05, 1.7 * half, 0.45), -0.24, 0.0, seat)]
    parts = [person(figure, height), *wheels, *(flip_sides(wheel) for wheel in wheels), *chair]
    if rng.random() < 0.3:
        pushing = hold(_walking(rng), *PUSHING)
        parts.append(place(person(pushing, float(rng.uniform(1.55, 1.85))), -0.75))
    return merge(parts)


TWO_WHEELERS = ("bicycle", "cargo_bicycle", "e_scooter", "motorcycle", "scooter")
_APART, _SCOOTERS_APART = 0.1, 0.15  # shares of riders that are drawn apart


def _choose_stream(rng: Rng, share: float, size: float) -> Rng:
    """Choose the generator of a rider. A share once had none, being things now: these have one of their own, so that
    all other bodies of a seed stay as they were."""
    return np.random.default_rng(round(size * 1e9)) if rng.random() < share else rng


def draw_two_wheeler(rng: Rng) -> tuple[str, Mesh]:
    """Draw a two-wheeler, and its kind. x forward, wheels on z = 0."""
    kinds = (_bicycle, _e_scooter, _motorcycle, _scooter)
    kind, mesh = kinds[int(rng.choice(4, p=(0.55, 0.15, 0.17, 0.13)))](rng)
    return kind, stand(mesh)


def _bicycle(rng: Rng) -> tuple[str, Mesh]:
    if rng.random() < 0.12:
        scale, height = float(rng.uniform(0.55, 0.8)), 0.0
        height = 1.75 * scale + float(rng.uniform(-0.06, 0.06))
    else:
        height = float(np.clip(rng.normal(1.73, 0.09), 1.5, 2.0))
        scale = float(np.clip(height / 1.74 + rng.uniform(-0.07, 0.07), 0.85, 1.12))
    sporty = float(rng.uniform(0, 1))  # 0 upright, 1 bent over a racing bar
    bike = scale_mesh(_bare_bicycle(int(rng.integers(31, 37)) / 100), scale)
    parts, kind = [scale_mesh(bike, (float(rng.uniform(0.95, 1.08)), 1, 1))], "bicycle"
    extra = rng.random()
    if scale > 0.84 and extra < 0.1:
        size = rng.uniform((0.45, 0.4, 0.3), (0.9, 0.65, 0.6))
        parts = [scale_mesh(bike, (1.3, 1, 1)), plank(tuple(size.tolist()), 0.5 + 0.2 * size[0], 0.0, 0.42)]
        kind = "cargo_bicycle"
    elif extra < 0.3:
        parts.append(plank((0.36, float(rng.uniform(0.25, 0.42)), 0.32), -0.6 * scale, 0.0, 0.68 * scale))
    rng = _choose_stream(rng, _APART, scale)
    grip: Vector = ((0.45 + 0.1 * sporty) * scale, (0.29 - 0.09 * sporty) * scale, (1.04 - 0.12 * sporty) * scale)
    parts.append(rider(height, 0.95 * scale, grip, upright=0.98 - 0.26 * sporty, stout=float(rng.uniform(0.85, 1.2))))
    return kind, merge(parts)


def _e_scooter(rng: Rng) -> tuple[str, Mesh]:
    half, radius, bar = float(rng.uniform(0.4, 0.52)), float(rng.uniform(0.1, 0.14)), float(rng.uniform(1.0, 1.2))
    parts = [make_wheel(-half, 0.0, radius, 0.05, 10), make_wheel(half, 0.0, radius, 0.05, 10)]
    parts += [plank((1.7 * half, 0.16, 0.06), -0.05, 0.0, radius)]
    parts += [tube([(half, 0.0, radius), (half - 0.14, 0.0, bar)], 0.03, 6)]
    parts += [tube([(half - 0.14, -0.25, bar), (half - 0.13, 0.0, bar), (half - 0.14, 0.25, bar)], 0.02, 5)]
    rng = _choose_stream(rng, _SCOOTERS_APART, half)
    height = float(np.clip(rng.normal(1.73, 0.09), 1.35, 2.0))
    hand = pair((half - 0.18 + 0.12) / height, 0.22 / height, (bar - radius - 0.06) / height)
    stout = draw_pose(rng, float(rng.uniform(0.85, 1.2))).stout
    ankles = (0.06, 0.025, 0.035), (-0.12, -0.025, 0.035)
    figure = Figure(ankles=ankles, elbows=pair(0.03, 0.15, 0.66), hands=hand, stout=stout)
    parts.append(place(stand(person(figure, height)), -0.12, 0.0, radius + 0.06))
    return "e_scooter", merge(parts)


def _motorcycle(rng: Rng) -> tuple[str, Mesh]:
    fairing, scale = bool(rng.random() < 0.5), float(rng.uniform(0.88, 1.12))
    bike = scale_mesh(scale_mesh(_bare_motorcycle(fairing), scale), (float(rng.uniform(0.94, 1.1)), 1, 1))
    rng = _choose_stream(rng, _APART, scale)
    bent, height = float(rng.uniform(0, 1)), float(np.clip(rng.normal(1.77, 0.07), 1.58, 1.98))
    grip: Vector = ((0.52 + 0.04 * bent) * scale, 0.3 - 0.06 * bent, (1.0 - 0.07 * bent) * scale)
    on = [rider(height, 0.85 * scale, grip, upright=0.92 - 0.24 * bent, rest=(-0.05, 0.36 + 0.06 * bent))]
    return "motorcycle", merge([bike, *on, *_second(on, 0.4 * scale, rng)])


def _scooter(rng: Rng) -> tuple[str, Mesh]:
    scale = float(rng.uniform(0.9, 1.12))
    bike = scale_mesh(scale_mesh(_bare_scooter(), scale), (float(rng.uniform(0.95, 1.08)), 1, 1))
    rng = _choose_stream(rng, _APART, scale)
    height = float(np.clip(rng.normal(1.71, 0.09), 1.5, 1.98))
    upright, stout = float(rng.uniform(0.9, 0.98)), float(rng.uniform(0.9, 1.15))
    grip, rest = (0.42 * scale, 0.27, 0.98 * scale), (0.31 * scale, 0.32 * scale)
    on = [rider(height, 0.79 * scale, grip, upright=upright, stout=stout, rest=rest)]
    if rng.random() < 0.25:
        pack = people.backpack(height)  # a courier's
        on.append(Mesh(pack.vertices * [1.6, 1.4, 1.0] + [-0.2, 0.0, 0.79 * scale - 0.45 * height], pack.triangles))
    return "scooter", merge([bike, *on, *_second(on[:1], 0.35 * scale, rng)])


def _second(on: list[Mesh], behind: float, rng: Rng) -> list[Mesh]:
    """Passenger, sometimes: the rider again, farther back and higher."""
    if rng.random() > 0.12:
        return []
    return [Mesh(mesh.vertices * [0.8, 0.95, 0.97] + [-behind - 0.05, 0.0, 0.08], mesh.triangles) for mesh in on]


_bare_bicycle, _bare_motorcycle, _bare_scooter = cache(people.bicycle), cache(people.motorcycle), cache(people.scooter)


BLOCKS = 0.25  # of the cars are built of plain blocks
TOWING = 0.1  # of the heavy vehicles are cars with a trailer


def draw_body(label: int | str, rng: Rng) -> Body:
    """Draw a body of a class: vehicle, cyclist, pedestrian or heavy. Its name says its kind.

    >>> body = draw_body("vehicle", np.random.default_rng(0))
    >>> body.label, len(body.size)
    (0, 3)
    """
    label = label_index(label)
    kind, mesh, outside = _DRAW[label](rng)
    return make_boxed_body(f"{LABELS[label]}/{kind}", label, mesh, outside)


def possible_names() -> tuple[str, ...]:
    """Names that drawn bodies may have: class and kind."""
    cars = [kind.name for kind in drawn_cars.CAR_KINDS]
    towing = [f"{car}_with_{behind}" for car in cars for behind in drawn_cars.TRAILERS]
    trucks = [name for form in ("{}_truck", "articulated_{}") for name in map(form.format, SUPERSTRUCTURES)]
    loaded = [f"{car}_{load}" for car in cars for load in drawn_cars.CARRIED]
    vehicles = [*cars, *(f"block_{car}" for car in cars), *loaded]
    kinds = {VEHICLE: vehicles, CYCLIST: TWO_WHEELERS, PEDESTRIAN: PEOPLE, HEAVY: [*trucks, *BUSES, *towing]}
    return tuple(f"{LABELS[label]}/{name}" for label, names in kinds.items() for name in names)


def _car(rng: Rng) -> Built:
    shape = drawn_cars.draw_proportions(rng)
    if rng.random() < BLOCKS:
        return f"block_{shape.kind}", drawn_cars.build_block_car(shape, rng), drawn_cars.mirrors(shape, rng)
    carried, load = drawn_cars.draw_load(shape, rng)
    name = f"{shape.kind}_{carried}" if carried else shape.kind
    return name, merge([drawn_cars.loft_car(shape), load]), drawn_cars.mirrors(shape, rng)


def _heavy(rng: Rng) -> Built:
    if rng.random() >= TOWING:
        return draw_heavy(rng)
    shape = drawn_cars.draw_proportions(rng)
    kind, behind = drawn_cars.trailer(shape, rng)
    return f"{shape.kind}_with_{kind}", merge([drawn_cars.loft_car(shape), behind]), drawn_cars.mirrors(shape, rng)


_DRAW = {
    VEHICLE: _car,
    CYCLIST: lambda rng: (*draw_two_wheeler(rng), drawn_cars.NOTHING),
    PEDESTRIAN: lambda rng: (*draw_person(rng), drawn_cars.NOTHING),
    HEAVY: _heavy,
}
