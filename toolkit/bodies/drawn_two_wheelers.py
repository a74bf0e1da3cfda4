"""Two-wheelers drawn at random, with their riders."""

from functools import cache

import numpy as np

from toolkit.arrays import Rng
from toolkit.bodies import people, two_wheelers
from toolkit.bodies.drawn_people import draw_pose
from toolkit.bodies.figures import Figure, pair, person
from toolkit.bodies.mesh_parts import DrawnMesh, plank
from toolkit.bodies.two_wheelers import rider
from toolkit.bodies.wheels import make_wheel
from toolkit.mesh import Mesh, Vector, merge, place, scale_mesh, stand, tube

TWO_WHEELERS = ("bicycle", "cargo_bicycle", "e_scooter", "motorcycle", "scooter")
# shares of bicycles, e-scooters, motorcycles and scooters: in the street, and evenly
STREET_SHARES = (0.55, 0.15, 0.17, 0.13)
EVEN_SHARES = (0.4, 0.34, 0.14, 0.12)
CHILD_SHARE = 0.12  # share of the bicycles
PASSENGER_SHARE = 0.12
COURIER_SHARE = 0.25  # share of the scooters
# shares of riders that are drawn from another stream, see `_choose_stream`
OTHER_STREAM_SHARE = 0.1
OTHER_STREAM_SCOOTER_SHARE = 0.15


def draw_two_wheeler(rng: Rng, evenly: bool = False) -> DrawnMesh:
    """Draw a two-wheeler, x forward, wheels on z = 0.

    evenly: rare kinds are drawn nearly as often as bicycles, instead of as often as in the
    street."""
    draw_functions = (draw_bicycle, draw_e_scooter, draw_motorcycle, draw_scooter)
    shares = EVEN_SHARES if evenly else STREET_SHARES
    draw = draw_functions[int(rng.choice(4, p=shares))]
    two_wheeler = draw(rng)
    return DrawnMesh(two_wheeler.kind, stand(two_wheeler.mesh))


def draw_bicycle(rng: Rng) -> DrawnMesh:
    """Draw a bicycle with its rider, a child or an adult, with or without a load.

    x forward, wheels on z = 0, lengths in m."""
    # `height` is the rider's, `scale` the size of the bicycle, 1 for the usual one
    if rng.random() < CHILD_SHARE:
        scale = float(rng.uniform(0.55, 0.8))
        height = 1.75 * scale + float(rng.uniform(-0.06, 0.06))
    else:
        height = float(np.clip(rng.normal(1.73, 0.09), 1.5, 2.0))
        scale = float(np.clip(height / 1.74 + rng.uniform(-0.07, 0.07), 0.85, 1.12))
    sporty = float(rng.uniform(0, 1))  # 0 upright, 1 bent over a racing bar
    wheel_radius = int(rng.integers(31, 37)) / 100  # whole cm
    bike = scale_mesh(_make_bicycle(wheel_radius), scale)
    # frames differ in length
    parts = [scale_mesh(bike, (float(rng.uniform(0.95, 1.08)), 1, 1))]
    kind = "bicycle"
    load_chance = rng.random()
    if scale > 0.84 and load_chance < 0.1:
        # longer, with a box ahead of the rider
        kind = "cargo_bicycle"
        length, width, depth = rng.uniform((0.45, 0.4, 0.3), (0.9, 0.65, 0.6)).tolist()
        cargo_box = plank((length, width, depth), x=0.5 + 0.2 * length, y=0.0, z=0.42)
        parts = [scale_mesh(bike, (1.3, 1, 1)), cargo_box]
    elif load_chance < 0.3:
        # length, width, height
        bag = (0.36, float(rng.uniform(0.25, 0.42)), 0.32)
        parts.append(plank(bag, x=-0.6 * scale, y=0.0, z=0.68 * scale))
    rider_rng = _choose_stream(rng, OTHER_STREAM_SHARE, scale)
    # x, y, z of the left hand
    grip: Vector = (
        (0.45 + 0.1 * sporty) * scale,
        (0.29 - 0.09 * sporty) * scale,
        (1.04 - 0.12 * sporty) * scale,
    )
    # 1 for an upright back, less if it leans forward
    upright = 0.98 - 0.26 * sporty
    stout = float(rider_rng.uniform(0.85, 1.2))
    parts.append(rider(height, saddle=0.95 * scale, grip=grip, upright=upright, stout=stout))
    return DrawnMesh(kind, merge(parts))


def draw_e_scooter(rng: Rng) -> DrawnMesh:
    """Draw an e-scooter with its standing rider. x forward, wheels on z = 0, lengths in m."""
    half_length = float(rng.uniform(0.4, 0.52))
    wheel_radius = float(rng.uniform(0.1, 0.14))
    bar_height = float(rng.uniform(1.0, 1.2))
    bar_x = half_length - 0.14
    # right end, middle and left end, each x, y, z
    handlebar = [
        (bar_x, -0.25, bar_height),
        (half_length - 0.13, 0.0, bar_height),
        (bar_x, 0.25, bar_height),
    ]
    # two wheels at x, y; the board; the column of the bar; the bar
    parts = [
        make_wheel(-half_length, 0.0, radius=wheel_radius, breadth=0.05, sides=10),
        make_wheel(half_length, 0.0, radius=wheel_radius, breadth=0.05, sides=10),
        plank((1.7 * half_length, 0.16, 0.06), x=-0.05, y=0.0, z=wheel_radius),
        tube([(half_length, 0.0, wheel_radius), (bar_x, 0.0, bar_height)], radii=0.03, sides=6),
        tube(handlebar, radii=0.02, sides=5),
    ]
    rider_rng = _choose_stream(rng, OTHER_STREAM_SCOOTER_SHARE, half_length)
    height = float(np.clip(rider_rng.normal(1.73, 0.09), 1.35, 2.0))
    # joints of a figure are in parts of its height; it stands on the board, 0.12 m behind x = 0
    hand_x = (half_length - 0.18 + 0.12) / height
    hand_z = (bar_height - wheel_radius - 0.06) / height
    pose = draw_pose(rider_rng, float(rider_rng.uniform(0.85, 1.2)))
    figure = Figure(
        # the left foot ahead
        ankles=((0.06, 0.025, 0.035), (-0.12, -0.025, 0.035)),
        elbows=pair(0.03, 0.15, 0.66),
        hands=pair(hand_x, 0.22 / height, hand_z),
        stout=pose.stout,
    )
    parts.append(place(stand(person(figure, height)), x=-0.12, y=0.0, z=wheel_radius + 0.06))
    return DrawnMesh("e_scooter", merge(parts))


def draw_motorcycle(rng: Rng) -> DrawnMesh:
    """Draw a motorcycle with its rider, and sometimes a passenger.

    x forward, wheels on z = 0, lengths in m."""
    has_fairing = bool(rng.random() < 0.5)
    scale = float(rng.uniform(0.88, 1.12))
    # frames differ in length
    stretch = (float(rng.uniform(0.94, 1.1)), 1, 1)
    bike = scale_mesh(scale_mesh(_make_motorcycle(has_fairing), scale), stretch)
    rider_rng = _choose_stream(rng, OTHER_STREAM_SHARE, scale)
    bent = float(rider_rng.uniform(0, 1))  # 0 upright, 1 bent over the tank
    height = float(np.clip(rider_rng.normal(1.77, 0.07), 1.58, 1.98))
    # x, y, z of the left hand; how upright the back is, 1 if it does not lean forward
    grip: Vector = ((0.52 + 0.04 * bent) * scale, 0.3 - 0.06 * bent, (1.0 - 0.07 * bent) * scale)
    upright = 0.92 - 0.24 * bent
    foot_rest = (-0.05, 0.36 + 0.06 * bent)  # x and z (m)
    driver = rider(height, saddle=0.85 * scale, grip=grip, upright=upright, foot_rest=foot_rest)
    passenger = _draw_passenger(driver, 0.4 * scale, rider_rng)
    return DrawnMesh("motorcycle", merge([bike, driver, *passenger]))


def draw_scooter(rng: Rng) -> DrawnMesh:
    """Draw a motor scooter with its rider, and sometimes a passenger or a courier's bag.

    x forward, wheels on z = 0, lengths in m."""
    scale = float(rng.uniform(0.9, 1.12))
    stretch = (float(rng.uniform(0.95, 1.08)), 1, 1)
    bike = scale_mesh(scale_mesh(_make_scooter(), scale), stretch)
    rider_rng = _choose_stream(rng, OTHER_STREAM_SHARE, scale)
    height = float(np.clip(rider_rng.normal(1.71, 0.09), 1.5, 1.98))
    upright = float(rider_rng.uniform(0.9, 0.98))
    stout = float(rider_rng.uniform(0.9, 1.15))
    # x, y, z of the left hand
    grip = (0.42 * scale, 0.27, 0.98 * scale)
    foot_rest = (0.31 * scale, 0.32 * scale)  # x and z
    saddle = 0.79 * scale  # height
    driver = rider(height, saddle, grip, upright=upright, stout=stout, foot_rest=foot_rest)
    parts = [bike, driver]
    if rider_rng.random() < COURIER_SHARE:
        # the rucksack of a standing person, made larger and put on the back of a seated one
        rucksack = people.backpack(height)
        offset = [-0.2, 0.0, saddle - 0.45 * height]
        parts.append(Mesh(rucksack.vertices * [1.6, 1.4, 1.0] + offset, rucksack.triangles))
    parts += _draw_passenger(driver, 0.35 * scale, rider_rng)
    return DrawnMesh("scooter", merge(parts))


def _choose_stream(rng: Rng, share: float, size: float) -> Rng:
    """Choose the generator of a rider's random numbers.

    A share of the riders has another generator, seeded by `size`, a number of the two-wheeler, so
    that all other bodies of a seed stay as they were before riders varied."""
    return np.random.default_rng(round(size * 1e9)) if rng.random() < share else rng


def _draw_passenger(driver: Mesh, distance: float, rng: Rng) -> list[Mesh]:
    """Draw a passenger or, mostly, none: an empty list.

    A passenger is the driver's mesh again, smaller and higher. distance: m farther back."""
    if rng.random() > PASSENGER_SHARE:
        return []
    offset = [-distance - 0.05, 0.0, 0.08]  # x, y, z (m)
    factors = [0.8, 0.95, 0.97]
    return [Mesh(driver.vertices * factors + offset, driver.triangles)]


@cache
def _make_bicycle(wheel_radius: float) -> Mesh:
    """Bicycle without a rider."""
    return two_wheelers.bicycle(wheel_radius)


@cache
def _make_motorcycle(has_fairing: bool) -> Mesh:
    """Motorcycle without a rider."""
    return two_wheelers.motorcycle(has_fairing)


@cache
def _make_scooter() -> Mesh:
    """Motor scooter without a rider."""
    return two_wheelers.scooter()
