"""Bodies drawn at random for a class: cars, heavy vehicles, two-wheelers and people.

The ground truth box of a drawn vehicle is the body without its wing mirrors, which stick out of it
by 8 to 25 cm (`toolkit.bodies.body.include_mirrors` gives the other convention). Roof signs, roof
boxes, racks, loads and spare wheels belong to the box, and so does a trailer, which makes a car an
articulated heavy vehicle: straight, as a body is rigid.

Cars drawn at random: their proportions, their meshes, and what they carry.

Within a kind the length is drawn first; width and height follow it on average, each with a spread
of a decimetre and more, so that the length of a car does not tell its width. Block-built cars have
no arches, no rounding and few triangles, as many models of others do. Every mesh is stretched to
the length, width and height that were drawn."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from toolkit.arrays import Float64, Rng
from toolkit.bodies import people
from toolkit.bodies.body import Body, make_boxed_body
from toolkit.bodies.people import AT_AN_EAR, PUSHING, Figure, hold, pair, person, rider, striding
from toolkit.bodies.vehicles import (
    CAR_PROFILES,
    CAR_SHAPES,
    Profile,
    Proportions,
    loft_parts,
    loft_shell,
    make_axles,
    make_wheel,
)
from toolkit.mesh import (
    Mesh,
    Vector,
    box,
    ellipsoid,
    flip_sides,
    loft,
    merge,
    place,
    scale_mesh,
    stand,
    tube,
)
from toolkit.objects import CYCLIST, HEAVY, LABELS, PEDESTRIAN, VEHICLE, label_index

# and their shares
SUPERSTRUCTURES = {"box": 0.32, "curtain": 0.12, "flatbed": 0.16, "tipper": 0.13}
SUPERSTRUCTURES |= {"tank": 0.07, "refuse": 0.07, "container": 0.08, "mixer": 0.05}
BUSES = ("minibus", "bus", "bendy_bus")
NOTHING = merge([])

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
    front = length / 2 - deep - gap
    floor = float(rng.uniform(0.85, 1.2))
    kind, load = _superstructure(front, -length / 2, width, floor, cab_height, rng)
    return f"{kind}_truck", merge([cab, load, *_chassis(length, width, floor, rng)]), mirror


def _semi_trailer(rng: Rng) -> Built:
    length = float(rng.uniform(12.5, 17.0))
    width = float(rng.uniform(2.4, 2.58))
    cab_height = float(rng.uniform(2.9, 3.9))
    deep = float(rng.uniform(1.9, 2.5))
    cab, mirror = _cab(length / 2, width - float(rng.uniform(0, 0.1)), cab_height, deep, rng)
    front = length / 2 - deep - float(rng.uniform(0.5, 1.0))
    floor = float(rng.uniform(1.1, 1.3))
    kind, load = _superstructure(front, -length / 2, width, floor, cab_height, rng)
    radius = float(rng.uniform(0.46, 0.53))
    rows = [
        length / 2 - 1.4,
        front - 0.6,
        *(-length / 2 + float(rng.uniform(1.6, 2.6)) + 1.35 * k for k in range(3)),
    ]
    chassis = plank((length - 1.2, 0.9, 0.3), -0.3, 0.0, floor - 0.3)
    return (
        f"articulated_{kind}",
        merge([cab, load, chassis, *make_axles(rows, width - 0.04, radius, 12)]),
        mirror,
    )


def _cab(front: float, width: float, height: float, deep: float, rng: Rng) -> tuple[Mesh, Mesh]:
    low = float(rng.uniform(0.3, 0.6))
    rake = float(rng.uniform(0.04, 0.35))
    nose = float(rng.uniform(0.8, 1.3)) if rng.random() < 0.12 else 0.0  # a bonnet
    x = front - nose
    corner = float(rng.uniform(0.03, 0.15))
    sill = low + 0.45 * (height - low)
    rings = [(x - deep + nose, width, low, height), (x - 0.6 * rake - corner, width, low, height)]
    rings += [
        (x - 0.3 * rake, width - corner, low, height - 0.3 * (height - sill)),
        (x, width - 2 * corner, low, sill),
    ]
    parts = [loft_shell(rings, 0.06, 2)]
    if nose:
        parts.append(
            loft_shell(
                [(x - 0.3, 0.9 * width, low, sill), (front, 0.75 * width, low, sill - 0.25)],
                0.06,
                2,
            )
        )
    if rng.random() < 0.25:
        parts.append(
            plank(
                (0.5 * deep, 0.8 * width, float(rng.uniform(0.3, 0.6))),
                x - 0.6 * deep,
                0.0,
                height - 0.03,
            )
        )
    high = float(rng.uniform(0.25, 0.5))
    out = float(rng.uniform(0.1, 0.28))
    size = float(rng.uniform(0.06, 0.2)), out + 0.04, high
    mirror = box(size, (x - 0.2, width / 2 + out / 2 - 0.02, 0.68 * height))
    return merge(parts), merge([mirror, flip_sides(mirror)])


def _superstructure(
    front: float, rear: float, width: float, floor: float, cab: float, rng: Rng
) -> tuple[str, Mesh]:
    """Load of a truck between `front` and `rear` (m), and its kind."""
    kind = str(rng.choice(list(SUPERSTRUCTURES), p=list(SUPERSTRUCTURES.values())))
    length = front - rear
    middle = (front + rear) / 2
    deck = plank((length, width, 0.14), middle, 0.0, floor - 0.02)
    top = float(np.clip(cab + rng.uniform(-0.2, 1.0), floor + 1.0, 4.0))
    if kind in ("box", "curtain", "container"):
        sides = width if kind != "container" else min(width, 2.44)
        return kind, merge(
            [deck, loft_shell([(rear, sides, floor, top), (front, sides, floor, top)], 0.06, 2)]
        )
    if kind == "refuse":
        rings = [
            (rear, 0.9 * width, floor - 0.2, floor + 1.2),
            (rear + 0.2 * length, width, floor, top),
        ]
        return kind, merge([deck, loft_shell([*rings, (front, width, floor, top - 0.15)], 0.06, 2)])
    if kind == "tank":
        radius = min(width / 2, float(rng.uniform(0.75, 1.2)))
        line = [(x, 0.0, floor + radius) for x in (rear, rear + 0.15, front - 0.15, front)]
        radii = [0.7 * radius, radius, radius, 0.7 * radius]
        return kind, merge([deck, tube(line, radii, 14, flat=width / 2 / radius)])
    if kind == "mixer":
        line = [
            (rear, 0.0, floor + 1.5),
            (middle, 0.0, floor + 1.25),
            (front - 0.1, 0.0, floor + 1.0),
        ]
        return kind, merge([deck, tube(line, [0.45, min(1.15, width / 2), 0.6], 14)])
    wall = float(rng.uniform(0.3, 0.7) if kind == "flatbed" else rng.uniform(0.8, 1.5))
    parts = [
        deck,
        *(
            plank((length, 0.06, wall), middle, y, floor)
            for y in (-width / 2 + 0.03, width / 2 - 0.03)
        ),
    ]
    parts += [plank((0.06, width, wall), x, 0.0, floor) for x in (rear + 0.03, front - 0.03)]
    chance = rng.random()
    if kind == "tipper" or chance < 0.3:
        heap = 0.92 * length, 0.9 * width, wall * float(rng.uniform(0.6, 1.35))
        parts.append(mound(heap, middle, floor + 0.12))
    elif chance < 0.75:
        sizes = rng.uniform((0.15, 0.5, 0.4), (0.3, 0.95, 1.6), (3, 3)) * [
            length,
            width - 0.15,
            1.0,
        ]
        for k, (a, b, c) in enumerate(sizes.tolist()):
            parts.append(plank((a, b, c), rear + length * (0.2 + 0.3 * k), 0.0, floor))
    return kind, merge(parts)


def _chassis(length: float, width: float, floor: float, rng: Rng) -> list[Mesh]:
    radius = float(np.clip(0.36 + 0.03 * (length - 5.2) + rng.uniform(-0.03, 0.03), 0.34, 0.53))
    last = -length / 2 + float(rng.uniform(0.9, 0.28 * length))
    rows = [
        length / 2 - float(rng.uniform(1.0, 1.45)),
        last,
        *([last + 2.3 * radius + 0.2] if length > 8.5 else []),
    ]
    frame = plank((length - 0.8, 0.85, 0.28), -0.3, 0.0, floor - 0.3)
    guard = plank((0.12, 0.93 * width, 0.14), -length / 2 + 0.1, 0.0, float(rng.uniform(0.4, 0.55)))
    return [frame, guard, *make_axles(rows, width - 0.04, radius, 12)]


def _bus(rng: Rng) -> Built:
    """Minibus, city bus, coach, or bendy bus with its bellows."""
    bendy = rng.random() < 0.18
    length = float(
        rng.uniform(16.5, 18.5)
        if bendy
        else rng.choice([rng.uniform(6.2, 9.0), rng.uniform(9.0, 13.5)])
    )
    width = float(np.clip(2.05 + 0.085 * (length - 6.2) + rng.normal(0, 0.06), 2.0, 2.58))
    height = float(np.clip(2.65 + 0.1 * (length - 6.2) + rng.uniform(-0.15, 0.5), 2.55, 3.85))
    if rng.random() < 0.05:
        height = float(rng.uniform(4.0, 4.4))  # double-decker
    x = length / 2
    low = float(rng.uniform(0.25, 0.4))
    round_ = float(rng.uniform(0.04, 0.3))
    rake = float(rng.uniform(0.05, 0.5))
    rings = [
        (-x, 0.94 * width, low + 0.08, height - round_),
        (-x + 0.15, width, low, height - 0.03),
    ]
    rings += [(-x + 0.5, width, low, height), (x - rake - 0.3, width, low, height)]
    rings += [(x - 0.5 * rake, width * 0.99, low, height - 0.35)]
    rings += [(x, 0.92 * width, low + 0.05, low + 0.55 * (height - low))]
    if bendy:
        fold = -0.05 * length
        bellows = [
            (fold - 0.7, width),
            (fold - 0.65, 0.9 * width),
            (fold + 0.65, 0.9 * width),
            (fold + 0.7, width),
        ]
        folds = (
            (at, wide, 0.1 if wide < width else 0, 0.12 if wide < width else 0)
            for at, wide in bellows
        )
        rings[3:3] = [(at, wide, low + sill, height - lid) for at, wide, sill, lid in folds]
    parts = [loft_shell(rings, 0.06, 2)]
    for share in rng.uniform(-0.6, 0.7, int(rng.integers(0, 3))).tolist():
        size = (float(rng.uniform(1.2, 2.6)), 0.65 * width, float(rng.uniform(0.15, 0.35)))
        parts.append(plank(size, share * (x - 1.5), 0.0, height - 0.03))
    radius = float(np.clip(0.03 * length + 0.12, 0.34, 0.5))
    overhangs = [
        float(rng.uniform(*ends)) * min(length, 12.0) for ends in ((0.16, 0.24), (0.22, 0.3))
    ]
    rows = [x - overhangs[0], -x + overhangs[1], *([0.08 * length] if bendy else [])]
    high = float(rng.uniform(0.25, 0.45))
    out = float(rng.uniform(0.12, 0.28))
    at = x + float(rng.uniform(-0.3, -0.1))
    mirror = box((0.14, out + 0.06, high), (at, 0.48 * width + out / 2, low + 0.6 * (height - low)))
    kind = "bendy_bus" if bendy else "minibus" if length < 8 else "bus"
    return (
        kind,
        merge([*parts, *make_axles(rows, width - 0.04, radius, 12)]),
        merge([mirror, flip_sides(mirror)]),
    )


PEOPLE = ("adult", "child", "pram", "walker", "wheelchair")
# Shares below which a draw is a wheelchair, child, pram, walker or adult: evenly, and as in the
# street
_EVENLY = (0.0, 0.13, 0.35, 0.62, 0.7, 1.0)
_IN_THE_STREET = (0.0, 0.035, 0.2, 0.25, 0.27, 1.0)


def draw_person(rng: Rng, evenly: bool = False) -> tuple[str, Mesh]:
    """Draw a person on foot or in a wheelchair, and its kind. Facing +x, soles or wheels on z = 0.
    evenly: rare kinds hardly more seldom than adults, instead of as often as in the street."""
    chance = np.interp(rng.random(), _EVENLY, _IN_THE_STREET) if evenly else rng.random()
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
        return "pram", stand(
            merge([pushing, scale_mesh(people.pushchair(height), float(rng.uniform(0.85, 1.1)))])
        )
    if chance < 0.27:
        legs = [
            tube([(x, y, 0.05), (0.35, y, 0.52 * height)], 0.015, 5)
            for x in (0.3, 0.75)
            for y in (-0.25, 0.25)
        ]
        wheels = [make_wheel(x, y, 0.09, 0.04, 8) for x in (0.3, 0.75) for y in (-0.25, 0.25)]
        pushing = person(hold(_walking(rng, lean=0.06), *PUSHING), height)
        return "walker", stand(
            merge([pushing, *legs, *wheels, plank((0.25, 0.46, 0.05), 0.5, 0.0, 0.5)])
        )
    figure = _walking(rng, stout=float(np.clip(rng.normal(1.0, 0.13), 0.8, 1.4)))
    parts = [person(figure, height)]
    wears, carries = rng.random(2)
    if wears < 0.2:
        parts.append(people.skirt(height, float(rng.uniform(0.1, 0.34)), figure.stout))
    elif wears < 0.28:
        parts.append(people.hat(height))
    extras = {
        0.08: people.backpack,
        0.2: people.bag,
        0.25: people.umbrella,
        0.28: people.stick,
        0.32: people.trolley,
    }
    parts += [extra(height) for max_share, extra in extras.items() if carries < max_share][:1]
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
    height = float(rng.uniform(1.5, 1.85))
    radius = float(rng.uniform(0.27, 0.31))
    half = float(rng.uniform(0.26, 0.31))
    seat = float(rng.uniform(0.45, 0.52))
    hip = seat / height + 0.05
    legs = (pair(0.19, 0.06, hip + 0.02), pair(0.26, 0.05, 0.1))
    arms = pair(0.0, 0.16, hip + 0.13)
    hands = pair(0.14, 0.13, hip + 0.09)
    stout = float(rng.uniform(0.9, 1.2))
    figure = Figure((-0.05, 0.0, hip), (-0.07, 0.0, hip + 0.31), *legs, arms, hands, stout)
    wheels = [
        make_wheel(-0.08, half, radius, 0.04, 14),
        make_wheel(0.38, half - 0.05, 0.08, 0.04, 8),
    ]
    chair = [
        plank((0.42, 1.7 * half, 0.06), 0.0, 0.0, seat - 0.06),
        plank((0.05, 1.7 * half, 0.45), -0.24, 0.0, seat),
    ]
    parts = [person(figure, height), *wheels, *(flip_sides(wheel) for wheel in wheels), *chair]
    if rng.random() < 0.3:
        pushing = hold(_walking(rng), *PUSHING)
        parts.append(place(person(pushing, float(rng.uniform(1.55, 1.85))), -0.75))
    return merge(parts)


TWO_WHEELERS = ("bicycle", "cargo_bicycle", "e_scooter", "motorcycle", "scooter")
# shares of riders that are drawn apart
_APART = 0.1
_SCOOTERS_APART = 0.15


def _choose_stream(rng: Rng, share: float, size: float) -> Rng:
    """Generator of a rider: its own for shares that once had none, so that all other bodies of a
    seed stay."""
    return np.random.default_rng(round(size * 1e9)) if rng.random() < share else rng


def draw_two_wheeler(rng: Rng, evenly: bool = False) -> tuple[str, Mesh]:
    """Draw a two-wheeler, and its kind. x forward, wheels on z = 0. evenly: see `draw_person`."""
    kinds = (_bicycle, _e_scooter, _motorcycle, _scooter)
    kind, mesh = kinds[
        int(rng.choice(4, p=(0.4, 0.34, 0.14, 0.12) if evenly else (0.55, 0.15, 0.17, 0.13)))
    ](rng)
    return kind, stand(mesh)


def _bicycle(rng: Rng) -> tuple[str, Mesh]:
    if rng.random() < 0.12:
        scale = float(rng.uniform(0.55, 0.8))
        height = 0.0
        height = 1.75 * scale + float(rng.uniform(-0.06, 0.06))
    else:
        height = float(np.clip(rng.normal(1.73, 0.09), 1.5, 2.0))
        scale = float(np.clip(height / 1.74 + rng.uniform(-0.07, 0.07), 0.85, 1.12))
    sporty = float(rng.uniform(0, 1))  # 0 upright, 1 bent over a racing bar
    bike = scale_mesh(_bare_bicycle(int(rng.integers(31, 37)) / 100), scale)
    parts = [scale_mesh(bike, (float(rng.uniform(0.95, 1.08)), 1, 1))]
    kind = "bicycle"
    extra = rng.random()
    if scale > 0.84 and extra < 0.1:
        size = rng.uniform((0.45, 0.4, 0.3), (0.9, 0.65, 0.6))
        parts = [
            scale_mesh(bike, (1.3, 1, 1)),
            plank(tuple(size.tolist()), 0.5 + 0.2 * size[0], 0.0, 0.42),
        ]
        kind = "cargo_bicycle"
    elif extra < 0.3:
        parts.append(
            plank((0.36, float(rng.uniform(0.25, 0.42)), 0.32), -0.6 * scale, 0.0, 0.68 * scale)
        )
    rng = _choose_stream(rng, _APART, scale)
    grip: Vector = (
        (0.45 + 0.1 * sporty) * scale,
        (0.29 - 0.09 * sporty) * scale,
        (1.04 - 0.12 * sporty) * scale,
    )
    parts.append(
        rider(
            height,
            0.95 * scale,
            grip,
            upright=0.98 - 0.26 * sporty,
            stout=float(rng.uniform(0.85, 1.2)),
        )
    )
    return kind, merge(parts)


def _e_scooter(rng: Rng) -> tuple[str, Mesh]:
    half = float(rng.uniform(0.4, 0.52))
    radius = float(rng.uniform(0.1, 0.14))
    bar = float(rng.uniform(1.0, 1.2))
    parts = [make_wheel(-half, 0.0, radius, 0.05, 10), make_wheel(half, 0.0, radius, 0.05, 10)]
    parts += [plank((1.7 * half, 0.16, 0.06), -0.05, 0.0, radius)]
    parts += [tube([(half, 0.0, radius), (half - 0.14, 0.0, bar)], 0.03, 6)]
    parts += [
        tube(
            [(half - 0.14, -0.25, bar), (half - 0.13, 0.0, bar), (half - 0.14, 0.25, bar)], 0.02, 5
        )
    ]
    rng = _choose_stream(rng, _SCOOTERS_APART, half)
    height = float(np.clip(rng.normal(1.73, 0.09), 1.35, 2.0))
    hand = pair((half - 0.18 + 0.12) / height, 0.22 / height, (bar - radius - 0.06) / height)
    stout = draw_pose(rng, float(rng.uniform(0.85, 1.2))).stout
    ankles = (0.06, 0.025, 0.035), (-0.12, -0.025, 0.035)
    figure = Figure(ankles=ankles, elbows=pair(0.03, 0.15, 0.66), hands=hand, stout=stout)
    parts.append(place(stand(person(figure, height)), -0.12, 0.0, radius + 0.06))
    return "e_scooter", merge(parts)


def _motorcycle(rng: Rng) -> tuple[str, Mesh]:
    fairing = bool(rng.random() < 0.5)
    scale = float(rng.uniform(0.88, 1.12))
    bike = scale_mesh(
        scale_mesh(_bare_motorcycle(fairing), scale), (float(rng.uniform(0.94, 1.1)), 1, 1)
    )
    rng = _choose_stream(rng, _APART, scale)
    bent = float(rng.uniform(0, 1))
    height = float(np.clip(rng.normal(1.77, 0.07), 1.58, 1.98))
    grip: Vector = ((0.52 + 0.04 * bent) * scale, 0.3 - 0.06 * bent, (1.0 - 0.07 * bent) * scale)
    on = [
        rider(
            height, 0.85 * scale, grip, upright=0.92 - 0.24 * bent, rest=(-0.05, 0.36 + 0.06 * bent)
        )
    ]
    return "motorcycle", merge([bike, *on, *_second(on, 0.4 * scale, rng)])


def _scooter(rng: Rng) -> tuple[str, Mesh]:
    scale = float(rng.uniform(0.9, 1.12))
    bike = scale_mesh(scale_mesh(_bare_scooter(), scale), (float(rng.uniform(0.95, 1.08)), 1, 1))
    rng = _choose_stream(rng, _APART, scale)
    height = float(np.clip(rng.normal(1.71, 0.09), 1.5, 1.98))
    upright = float(rng.uniform(0.9, 0.98))
    stout = float(rng.uniform(0.9, 1.15))
    grip = (0.42 * scale, 0.27, 0.98 * scale)
    rest = (0.31 * scale, 0.32 * scale)
    on = [rider(height, 0.79 * scale, grip, upright=upright, stout=stout, rest=rest)]
    if rng.random() < 0.25:
        pack = people.backpack(height)  # a courier's
        on.append(
            Mesh(
                pack.vertices * [1.6, 1.4, 1.0] + [-0.2, 0.0, 0.79 * scale - 0.45 * height],
                pack.triangles,
            )
        )
    return "scooter", merge([bike, *on, *_second(on[:1], 0.35 * scale, rng)])


def _second(on: list[Mesh], behind: float, rng: Rng) -> list[Mesh]:
    """Passenger, sometimes: the rider again, farther back and higher."""
    if rng.random() > 0.12:
        return []
    return [
        Mesh(mesh.vertices * [0.8, 0.95, 0.97] + [-behind - 0.05, 0.0, 0.08], mesh.triangles)
        for mesh in on
    ]


_bare_bicycle = cache(people.bicycle)
_bare_motorcycle = cache(people.motorcycle)
_bare_scooter = cache(people.scooter)


BLOCKS = 0.25  # of the cars are built of plain blocks
TOWING = 0.1  # of the heavy vehicles are cars with a trailer


def draw_body(label: int | str, rng: Rng, evenly: bool = False) -> Body:
    """Draw a body of a class (`LABELS`). Its name says its kind. evenly: see `draw_person`."""
    label = label_index(label)
    kind, mesh, outside = _DRAW[label](rng, evenly)
    return make_boxed_body(f"{LABELS[label]}/{kind}", label, mesh, outside)


def possible_names() -> tuple[str, ...]:
    """Names that drawn bodies may have: class and kind."""
    cars = [kind.name for kind in CAR_KINDS]
    towing = [f"{car}_with_{behind}" for car in cars for behind in TRAILERS]
    trucks = [
        name
        for form in ("{}_truck", "articulated_{}")
        for name in map(form.format, SUPERSTRUCTURES)
    ]
    loaded = [f"{car}_{load}" for car in cars for load in CARRIED]
    vehicles = [*cars, *(f"block_{car}" for car in cars), *loaded]
    kinds = {
        VEHICLE: vehicles,
        CYCLIST: TWO_WHEELERS,
        PEDESTRIAN: PEOPLE,
        HEAVY: [*trucks, *BUSES, *towing],
    }
    return tuple(f"{LABELS[label]}/{name}" for label, names in kinds.items() for name in names)


def _car(rng: Rng) -> Built:
    shape = draw_proportions(rng)
    if rng.random() < BLOCKS:
        return f"block_{shape.kind}", build_block_car(shape, rng), mirrors(shape, rng)
    carried, load = draw_load(shape, rng)
    name = f"{shape.kind}_{carried}" if carried else shape.kind
    return name, merge([loft_car(shape), load]), mirrors(shape, rng)


def _heavy(rng: Rng) -> Built:
    if rng.random() >= TOWING:
        return draw_heavy(rng)
    shape = draw_proportions(rng)
    kind, behind = trailer(shape, rng)
    return f"{shape.kind}_with_{kind}", merge([loft_car(shape), behind]), mirrors(shape, rng)


_DRAW: dict[int, Callable[[Rng, bool], Built]] = {
    VEHICLE: lambda rng, _: _car(rng),
    CYCLIST: lambda rng, evenly: (*draw_two_wheeler(rng, evenly), NOTHING),
    PEDESTRIAN: lambda rng, evenly: (*draw_person(rng, evenly), NOTHING),
    HEAVY: lambda rng, _: _heavy(rng),
}


# m, of the body without mirrors and roof loads
LENGTHS = (3.0, 6.0)
WIDTHS = (1.45, 2.2)
HEIGHTS = (1.25, 2.6)
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


CAR_KINDS = tuple(
    Kind(name, profile=CAR_PROFILES[name], **row) for name, row in CAR_SHAPES["kinds"].items()
)
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
    rear = float(
        wheel
        + rng.uniform(0.22, 0.75 if kind.name not in ("van", "pickup") else 1.0) * length / 4.6
    )
    while (
        length - front - rear < 0.5 * length
    ):  # cars of any length stand on a wheelbase of half of it and more
        front = wheel + 0.8 * (front - wheel)
        rear = wheel + 0.8 * (rear - wheel)
    low = profile[(profile[:, 1] < 0.7) & (profile[:, 0] > 0.45), 0]
    bed = (float(low[0]) + 0.012, 0.982, 0.84) if kind.name == "pickup" else None
    figures = (
        kind.clearance,
        kind.belt,
        kind.lean,
        (0.03, 0.2),
        (0.02, 0.15),
        (0.5, 0.88),
        (0.6, 0.95),
        (0.0, 0.05),
    )
    drawn = (float(rng.uniform(*ends)) for ends in (*figures, (0.015, 0.06), (0.004, 0.03)))
    clearance, belt, lean, nose, boot, front_end, rear_end, bow, camber, soft = drawn
    size = length, float(np.clip(width, *WIDTHS)), float(np.clip(height, *HEIGHTS))
    axles = (front, length - rear)
    plan = ((nose, boot), (front_end, rear_end))
    car = partial(Proportions, kind.name, *size, profile, axles, wheel, clearance, belt, lean)
    return car(*plan, bow, camber, soft, bed=bed)


def _profile(kind: Kind, rng: Rng) -> Float64[np.ndarray, "k 2"]:
    """Draw a side profile of a kind, its top at 1, with a little of another kind's mixed in."""
    base = _jitter_corners(kind.profile, rng)
    mixed_in = _jitter_corners(CAR_KINDS[int(rng.integers(len(CAR_KINDS)))].profile, rng)
    share = float(np.clip(rng.exponential(0.06), 0, 0.2)) if kind.name != "pickup" else 0.0
    stations = np.unique(np.concatenate([base[:, 0], _GRID]))
    heights = (1 - share) * np.interp(stations, *base.T) + share * np.interp(stations, *mixed_in.T)
    return np.column_stack([stations, heights / heights.max()])


def _jitter_corners(profile: Profile, rng: Rng) -> Float64[np.ndarray, "k 2"]:
    corners = np.array(profile)
    corners[2:-2, 0] += rng.normal(0, 0.012) + rng.normal(0, 0.012, len(corners) - 4)
    corners[:, 1] += np.clip(rng.normal(0, 0.02, len(corners)), -0.04, 0.04) * (
        corners[:, 1] < 0.93
    )
    corners[1:-1, 0] = np.clip(corners[1:-1, 0], 0.004, 0.996)
    return corners[np.argsort(corners[:, 0], kind="stable")]


def loft_car(shape: Proportions) -> Mesh:
    """Loft a car without mirrors, x forward, wheels on z = 0."""
    return stretch(loft_parts(shape), (shape.length, shape.width, shape.height))


def build_block_car(shape: Proportions, rng: Rng) -> Mesh:
    """Build the same car of a lower body, a cabin with slanted screens, and wheels of few sides or
    none."""
    length = shape.length
    half = shape.width / 2
    belt = shape.belt * shape.height
    tops = shape.profile[:, 1]
    roof, cabin = (shape.profile[tops >= min_height, 0][[0, -1]] for min_height in (0.93, 0.7))
    floor = float(rng.choice([0.02, shape.clearance], p=[0.25, 0.75]))
    chamfer = float(rng.uniform(0.0, 0.06))
    edge = half * (1 - shape.lean)
    base = (0.5 - cabin[0] + 0.03, 0.5 - cabin[1] - 0.02)
    lower = [(floor, 0.5 - 0.01, -0.49, half - chamfer), (floor + chamfer + 0.01, 0.5, -0.5, half)]
    lower += [(belt - chamfer - 0.01, 0.5, -0.5, half), (belt, 0.5 - 0.02, -0.49, half - chamfer)]
    front = 0.5 - roof[0]
    rear = 0.5 - roof[1]
    upper = [
        (belt - 0.02, max(base[0], front), min(base[1], rear), half - chamfer),
        (shape.height, front, rear, edge),
    ]
    sides = int(rng.choice([4, 8, 12]))
    breadth = float(rng.uniform(0.15, 0.26))
    wheels = []
    for axle in shape.axles if floor > 0.05 or rng.random() < 0.5 else ():
        wheel = make_wheel(
            length / 2 - axle, half - breadth / 2 - 0.005, shape.wheel, breadth, sides
        )
        wheels += [wheel, flip_sides(wheel)]
    parts = merge([_blocks(lower, length), _blocks(upper, length), *wheels])
    return stretch(stand(parts), (length, shape.width, shape.height))


def stretch(mesh: Mesh, size: tuple[float, float, float]) -> Mesh:
    """Stretch a mesh to a length, width and height (m). It stands on z = 0 about x = y = 0."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    middle = np.array([*((low + high) / 2)[:2], low[2]])
    return Mesh((mesh.vertices - middle) * (np.array(size) / (high - low)), mesh.triangles)


def _blocks(levels: list[tuple[float, float, float, float]], length: float) -> Mesh:
    """Loft upwards through rectangles. levels: z, front and rear as parts of the length, half
    width."""
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


CARRIED = ("taxi", "light_bar", "roof_box", "rack", "rails", "spare_wheel", "hard_top", "load")
# lengths, widths (m)
TRAILERS = {"open_trailer": ((1.8, 3.4), (1.3, 2.0)), "box_trailer": ((2.0, 4.2), (1.4, 2.1))}
TRAILERS["caravan"] = (3.8, 6.6), (2.0, 2.4)
_TAXIS = ("sedan", "estate", "minivan", "hatchback", "suv")
_RACKS = ("van", "minivan", "pickup")


def mirrors(shape: Proportions, rng: Rng) -> Mesh:
    """Draw wing mirrors that stick out 8 to 25 cm. None on 3 cars of 10, one on 1 of 50."""
    chance = rng.random()
    if chance < 0.3:
        return NOTHING
    tall = 1.6 if shape.kind == "van" else 1.0
    high = rng.uniform(0.06, 0.09) * tall
    deep = rng.uniform(0.05, 0.11)
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
    middle = (front + rear) / 2
    room = front - rear
    width = shape.width * (1 - shape.lean)
    z = shape.height
    chance = rng.random()
    if shape.bed is not None:
        return _bed_load(shape, shape.bed, rng)
    if shape.kind in _TAXIS and chance < 0.06:
        deep = rng.uniform(0.1, 0.28)
        wide = rng.uniform(0.25, 0.7)
        high = rng.uniform(0.09, 0.18)
        return "taxi", plank(
            (deep, wide, high), middle + 0.2 * room * rng.uniform(-1, 1), 0.0, z - 0.02
        )
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
        x = -shape.length / 2 - 0.08
        breadth = rng.uniform(0.16, 0.24)
        spare = make_wheel(0.0, 0.0, 0.92 * shape.wheel, breadth)
        return "spare_wheel", place(spare, x, 0.0, 0.36 * shape.height, yaw=np.pi / 2)
    return "", NOTHING


def trailer(shape: Proportions, rng: Rng) -> tuple[str, Mesh]:
    """Draw a trailer with its drawbar: open, boxed, or a caravan."""
    kind = list(TRAILERS)[int(rng.integers(3))]
    length, width = (float(rng.uniform(*ends)) for ends in TRAILERS[kind])
    bar = float(rng.uniform(0.8, 1.4))
    floor = float(rng.uniform(0.4, 0.6))
    front = -shape.length / 2 - bar
    middle = front - length / 2
    radius = float(rng.uniform(0.24, 0.33))
    parts = [tube([(-shape.length / 2 + 0.1, 0.0, 0.42), (front - 0.2, 0.0, 0.46)], 0.05, 6)]
    if kind == "open_trailer":
        wall = float(rng.uniform(0.3, 0.6))
        parts += [plank((length, width, 0.06), middle, 0.0, floor)]
        parts += [
            plank((length, 0.05, wall), middle, y, floor)
            for y in (-width / 2 + 0.025, width / 2 - 0.025)
        ]
        parts += [
            plank((0.05, width, wall), x, 0.0, floor)
            for x in (front - 0.025, front - length + 0.025)
        ]
        if rng.random() < 0.5:
            parts.append(
                mound(
                    (0.9 * length, 0.88 * width, float(rng.uniform(0.3, 0.9))), middle, floor + 0.06
                )
            )
    else:
        top = float(rng.uniform(1.3, 2.3) if kind == "box_trailer" else rng.uniform(2.3, 2.65))
        slope = 0.02 if kind == "box_trailer" else float(rng.uniform(0.06, 0.16))
        ring = np.array([[-0.5, floor], [0.5, floor], [0.5, top], [-0.5, top]]) * [width, 1.0]
        levels = (
            (-length, 0.0),
            (slope * length - length, 1.0),
            (-slope * length, 1.0),
            (0.0, 0.0),
        )
        rings = []
        for x, t in levels:
            y, z = ring[:, 0] * (0.96 + 0.04 * t), ring[:, 1] - (1 - t) * slope * (ring[:, 1] - 0.4)
            rings.append(np.column_stack([np.full(4, front + x), y, z]))
        parts.append(loft(np.stack(rings)))
    wheels = [
        make_wheel(
            middle - 0.05 * length, width / 2 - (0.08 if kind == "caravan" else -0.1), radius, 0.18
        )
    ]
    return kind, merge([*parts, *wheels, *(flip_sides(wheel) for wheel in wheels)])


def _bed_load(shape: Proportions, bed: tuple[float, float, float], rng: Rng) -> tuple[str, Mesh]:
    """Load on a pick-up's bed, a hard top over it, or nothing."""
    front, rear = (shape.length * (0.5 - s) for s in bed[:2])
    middle = (front + rear) / 2
    room = 0.9 * (front - rear)
    width = 0.78 * shape.width * (1 - shape.lean)
    floor = shape.belt * shape.height - 0.43
    chance = rng.random()
    if chance < 0.15:
        z = shape.belt * shape.height - 0.05
        breadth = shape.width * (1 - shape.lean)
        return "hard_top", plank((front - rear, breadth, shape.height - z - 0.02), middle, 0.0, z)
    if chance < 0.3:
        return "load", mound((room, width, float(rng.uniform(0.4, 0.9))), middle, floor)
    if chance < 0.45:
        sizes = rng.uniform((0.3, 0.3, 0.4), (0.6, 0.9, 1.1), (2, 3)) * [room, width, 1.0]
        ends = zip(sizes.tolist(), (-1, 1), strict=True)
        places = [
            (size, middle + side * (room - size[0]) / 2, rng.uniform(-1, 1)) for size, side in ends
        ]
        return "load", merge(
            [plank(tuple(size), x, y * (width - size[1]) / 2, floor) for size, x, y in places]
        )
    return "", NOTHING


def _roof_box(x: float, width: float, z: float, rng: Rng) -> Mesh:
    length = rng.uniform(1.3, 2.2)
    wide = rng.uniform(0.5, 0.85)
    high = rng.uniform(0.26, 0.42)
    y = float(rng.uniform(-0.5, 0.5)) * max(width - wide - 0.2, 0.0)
    ring = np.array([[-0.5, 0.1], [0.5, 0.1], [0.5, 0.6], [0.4, 1.0], [-0.4, 1.0], [-0.5, 0.6]]) * [
        wide,
        high,
    ]
    along = ((-0.5, 0.75), (-0.42, 1.0), (0.3, 1.0), (0.5, 0.4))
    rings = [
        np.column_stack([np.full(6, x + length * t), y + ring[:, 0], z + ring[:, 1] * f])
        for t, f in along
    ]
    bars = [
        plank((0.06, 0.9 * width, 0.05 + 0.1 * high), x + side * 0.3 * length, 0.0, z - 0.03)
        for side in (-1, 1)
    ]
    return merge([loft(np.stack(rings)), *bars])


def _rack(x: float, length: float, width: float, z: float, rng: Rng) -> Mesh:
    """Cross bars and, mostly, ladders or pipes on them."""
    high = float(rng.uniform(0.05, 0.14))
    parts = [
        plank((0.05, 0.9 * width, 0.04), x + t * length, 0.0, z + high - 0.02)
        for t in (-0.4, 0.0, 0.4)
    ]
    feet = [(t, y) for t in (-0.4, 0.0, 0.4) for y in (-0.42 * width, 0.42 * width)]
    parts += [plank((0.04, 0.04, high + 0.05), x + t * length, y, z - 0.05) for t, y in feet]
    if rng.random() < 0.7:
        y = float(rng.uniform(-0.2, 0.2)) * width
        reach = 0.5 * length * float(rng.uniform(0.9, 1.1))
        for side in (y - 0.2, y + 0.2):
            parts.append(
                tube(
                    [(x - reach, side, z + high + 0.05), (x + reach, side, z + high + 0.05)],
                    0.035,
                    5,
                )
            )
        for t in np.linspace(-0.9, 0.9, 7).tolist():
            parts.append(plank((0.04, 0.4, 0.04), x + t * reach, y, z + high + 0.03))
    return merge(parts)
