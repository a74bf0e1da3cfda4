"""Two-wheelers of the catalogue, and their riders."""

import math

import numpy as np

from toolkit.bodies.figures import Figure, pair, person
from toolkit.bodies.wheels import make_wheel
from toolkit.mesh import (
    Mesh,
    Span,
    Vector,
    box,
    ellipsoid,
    flip_sides,
    loft,
    merge,
    scale_mesh,
    tube,
)

BACK_LENGTH = 0.31  # from hip to neck, as a part of the height
PEDALS = ((0.14, 0.13), (-0.10, 0.36))  # x and z of the left and right pedal (m)


def two_wheelers() -> dict[str, Mesh]:
    """Bicycles, motorcycles and a scooter with their riders, x forward, wheels on z = 0."""
    # riders: height when standing, height of the saddle, then x, y, z of the left hand (m)
    crate = box((0.42, 0.42, 0.36), centre=(-0.62, 0, 0.95))
    vehicles = {
        "city_bicycle": (
            bicycle(0.34),
            rider(height=1.74, saddle=0.93, grip=(0.47, 0.28, 1.04), upright=0.97),
        ),
        "racing_bicycle": (
            bicycle(0.335),
            rider(height=1.80, saddle=0.97, grip=(0.55, 0.20, 0.92), upright=0.72, stout=0.9),
        ),
        "child_bicycle": (
            scale_mesh(bicycle(0.34), 0.72),
            rider(height=1.30, saddle=0.67, grip=(0.33, 0.20, 0.76), upright=0.98),
        ),
        "cargo_bicycle": (
            bicycle(0.33),
            crate,
            rider(height=1.70, saddle=0.93, grip=(0.47, 0.27, 1.02), upright=0.95, stout=1.1),
        ),
        "motorcycle": (
            motorcycle(),
            rider(
                height=1.79,
                saddle=0.84,
                grip=(0.52, 0.30, 1.0),
                upright=0.86,
                foot_rest=(-0.05, 0.36),
            ),
        ),
        "sport_motorcycle": (
            motorcycle(True),  # with a fairing
            rider(
                height=1.76,
                saddle=0.86,
                grip=(0.56, 0.24, 0.93),
                upright=0.68,
                foot_rest=(-0.05, 0.42),
            ),
        ),
        "scooter": (
            scooter(),
            rider(
                height=1.68,
                saddle=0.79,
                grip=(0.42, 0.27, 0.98),
                upright=0.97,
                foot_rest=(0.31, 0.32),
            ),
        ),
    }
    return {name: merge(parts) for name, parts in vehicles.items()}


def rider(
    height: float,
    saddle: float,
    grip: Vector,
    *,
    upright: float,
    stout: float = 1.0,
    foot_rest: Span | None = None,
) -> Mesh:
    """Mesh of a person on a saddle, hands at `grip` and its mirror image.

    Args:
        height: height of the person when standing (m).
        saddle: height of the saddle at x = -0.2 (m).
        grip: x, y, z of the left hand (m).
        upright: sine of the back's slope, 1 for an upright back.
        stout: breadth of trunk and limbs relative to an average adult.
        foot_rest: x and z of the foot rests (m), None for pedals, one up and one down."""
    # a figure's joints are x, y, z in parts of its height
    hip_x, hip_z = -0.2 / height, saddle / height + 0.045
    hip = (hip_x, 0.0, hip_z)
    neck_x = hip_x + BACK_LENGTH * math.sqrt(1 - upright**2) + 0.03
    neck_z = hip_z + BACK_LENGTH * upright
    hand_x, hand_z = grip[0] / height, grip[2] / height
    # an elbow is near the middle between neck and hand
    elbows = pair((neck_x + hand_x) / 2 - 0.02, 0.155, (neck_z + hand_z) / 2 - 0.05)
    left_rest, right_rest = PEDALS if foot_rest is None else (foot_rest, foot_rest)
    left_ankle = _find_ankle(left_rest, 0.11, height)
    right_ankle = _find_ankle(right_rest, -0.11, height)
    figure = Figure(
        hip=hip,
        neck=(neck_x, 0.0, neck_z),
        knees=(_find_knee(hip, left_ankle), _find_knee(hip, right_ankle)),
        ankles=(left_ankle, right_ankle),
        elbows=elbows,
        hands=pair(hand_x, grip[1] / height, hand_z),
        stout=stout,
    )
    return person(figure, height)


def _find_ankle(foot_rest: Span, y: float, height: float) -> Vector:
    """Ankle of a figure whose foot is on a rest, as parts of the figure's height.

    foot_rest: x and z of the rest (m); y: m to the left; height: height of the figure (m)."""
    return (foot_rest[0] - 0.02) / height, y / height, foot_rest[1] / height + 0.035


def _find_knee(hip: Vector, ankle: Vector) -> Vector:
    """Knee in front of the line from hip to ankle, all as parts of the figure's height.

    Thigh and shin are each 0.245 of the height."""
    # half the leg's length and `bend` are the sides of a right triangle on thigh or shin
    hip_point = np.array(hip)
    ankle_point = np.array(ankle)
    leg = ankle_point - hip_point
    bend = math.sqrt(max(0.245**2 - float(leg @ leg) / 4, 0.0004))  # at least 0.02
    backward = np.cross([0.0, 1.0, 0.0], leg)  # at a right angle to the leg
    knee = (hip_point + ankle_point) / 2 - bend * backward / np.linalg.norm(backward)
    y = math.copysign(0.06, ankle[1])  # on the side of the ankle
    return float(knee[0]), y, float(knee[2])


def bicycle(radius: float) -> Mesh:
    """Mesh of a bicycle whose wheels have this radius (m), x forward, wheels on z = 0."""
    # ends of the frame's tubes: x, y, z (m)
    rear_hub = (-0.52, 0.0, radius)
    front_hub = (0.52, 0.0, radius)
    crank = (-0.08, 0.0, 0.29)
    seat = (-0.2, 0.0, 0.88)
    head = (0.36, 0.0, 0.82)
    stem = (0.40, 0.0, 1.0)
    # both ends of each tube; the fifth ends below the seat
    frame = [
        (crank, seat),
        (crank, head),
        (seat, head),
        (crank, rear_hub),
        ((-0.18, 0.0, 0.78), rear_hub),
        (stem, front_hub),
    ]
    tubes = [tube(list(ends), radii=0.018, sides=5) for ends in frame]
    handlebar = tube(
        [(0.45, -0.28, 1.02), (0.40, 0.0, 1.0), (0.45, 0.28, 1.02)], radii=0.015, sides=5
    )
    saddle = ellipsoid((-0.21, 0.0, 0.92), radii=(0.14, 0.08, 0.04), rings=3, sides=6)
    tyres = [_make_tyre(-0.52, radius, thickness=0.025), _make_tyre(0.52, radius, thickness=0.025)]
    return merge([*tubes, handlebar, saddle, *tyres])


def _make_tyre(x: float, radius: float, thickness: float) -> Mesh:
    """Mesh of a tyre on z = 0, with nothing inside the ring.

    x: place of its middle; radius: its outer radius; thickness: radius of its cross-section
    (all m)."""
    turn = np.arange(21) * 2 * np.pi / 20  # around the axle
    roll = np.arange(5) * 2 * np.pi / 5  # around the tyre
    distance = radius - thickness * (1 - np.cos(roll))
    ring_x = x + np.sin(turn)[:, None] * distance
    # + 0 * turn gives it the shape (around the axle, around the tyre) of the others
    ring_y = np.sin(roll)[None] * thickness + 0 * turn[:, None]
    ring_z = radius - np.cos(turn)[:, None] * distance
    return loft(np.stack([ring_x, ring_y, ring_z], axis=-1))


def motorcycle(fairing: bool = False) -> Mesh:
    """Mesh of a motorcycle, x forward, wheels on z = 0.

    fairing: True for one with a fairing and a top case. Points are x, y, z, all lengths in m."""
    rear_wheel = make_wheel(-0.70, 0.0, radius=0.31, breadth=0.16)
    front_wheel = make_wheel(0.74, 0.0, radius=0.30, breadth=0.12)
    engine = ellipsoid((0.02, 0.0, 0.45), radii=(0.32, 0.17, 0.22))
    tank = ellipsoid((0.16, 0.0, 0.80), radii=(0.30, 0.15, 0.16))
    seat_line = [(-0.95, 0.0, 0.80), (-0.55, 0.0, 0.78), (0.0, 0.0, 0.74)]
    seat = tube(seat_line, radii=[0.06, 0.13, 0.12], sides=8)
    fork = [tube([(0.74, y, 0.30), (0.46, y, 0.92)], radii=0.03, sides=5) for y in (-0.1, 0.1)]
    handlebar = tube(
        [(0.48, -0.33, 1.0), (0.50, 0.0, 0.96), (0.48, 0.33, 1.0)], radii=0.02, sides=5
    )
    lamp = ellipsoid((0.60, 0.0, 0.86), radii=(0.10, 0.10, 0.11))
    exhaust = tube([(-0.75, -0.17, 0.38), (0.0, -0.17, 0.28)], radii=0.06, sides=6)
    parts = [rear_wheel, front_wheel, engine, tank, seat, *fork, handlebar, lamp, exhaust]
    if fairing:
        parts.append(ellipsoid((0.52, 0.0, 0.72), radii=(0.36, 0.22, 0.34)))
        parts.append(ellipsoid((-0.78, 0.0, 0.92), radii=(0.26, 0.10, 0.09)))  # top case
    return merge(parts)


def scooter() -> Mesh:
    """Mesh of a motor scooter with mirrors on its handlebar, x forward, wheels on z = 0.

    Points are x, y, z, all lengths in m."""
    rear_wheel = make_wheel(-0.58, 0.0, radius=0.24, breadth=0.13)
    front_wheel = make_wheel(0.60, 0.0, radius=0.24, breadth=0.11)
    seat = ellipsoid((-0.50, 0.0, 0.58), radii=(0.46, 0.18, 0.19))
    footboard = box((0.5, 0.34, 0.08), centre=(0.05, 0, 0.30))
    shield_line = [(0.36, 0.0, 0.28), (0.40, 0.0, 0.60), (0.36, 0.0, 0.92)]
    shield = tube(shield_line, radii=[0.10, 0.12, 0.06], sides=8, flat=1.9)
    fork = tube([(0.60, 0.0, 0.24), (0.38, 0.0, 0.92)], radii=0.04, sides=6)
    handlebar = tube(
        [(0.36, -0.30, 0.98), (0.38, 0.0, 0.95), (0.36, 0.30, 0.98)], radii=0.02, sides=5
    )
    mirror_arm = tube([(0.37, 0.24, 0.98), (0.40, 0.27, 1.12)], radii=0.01, sides=4)
    mirror = merge(
        [ellipsoid((0.40, 0.27, 1.12), radii=(0.02, 0.06, 0.05), rings=3, sides=6), mirror_arm]
    )
    body = [rear_wheel, front_wheel, seat, footboard, shield, fork]
    return merge([*body, handlebar, mirror, flip_sides(mirror)])
