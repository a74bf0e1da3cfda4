"""People of the catalogue, on foot and riding, built limb by limb from the joints of a posed
figure."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from toolkit.bodies.vehicles import make_wheel
from toolkit.mesh import (
    Mesh,
    Span,
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

Pair = tuple[Vector, Vector]  # left and right


def pair(x: float, y: float, z: float) -> Pair:
    """Return a point on the left and its mirror image."""
    return (x, y, z), (x, -y, z)


PUSHING = pair(0.02, 0.14, 0.65), pair(0.20, 0.12, 0.58)  # elbows, hands
AT_AN_EAR = ((0.08, 0.13, 0.66), (0.10, -0.12, 0.68)), ((0.16, 0.05, 0.80), (0.08, -0.07, 0.80))


@dataclass(frozen=True)
class Figure:
    """Joints of a person 1 unit tall facing +x, y left. stout: breadth of trunk and limbs relative
    to an average adult."""

    hip: Vector = (0.0, 0.0, 0.52)
    neck: Vector = (0.01, 0.0, 0.83)
    knees: Pair = ((0.02, 0.055, 0.28), (0.02, -0.055, 0.28))
    ankles: Pair = ((0.0, 0.06, 0.035), (0.0, -0.06, 0.035))
    elbows: Pair = ((-0.02, 0.145, 0.64), (-0.02, -0.145, 0.64))
    hands: Pair = ((0.03, 0.15, 0.47), (0.03, -0.15, 0.47))
    stout: float = 1.0


def hold(figure: Figure, elbows: Pair, hands: Pair) -> Figure:
    """Move the arms of a figure."""
    return replace(figure, elbows=elbows, hands=hands)


def striding(step: float, swing: float = 0.6, lean: float = 0.02, stout: float = 1.0) -> Figure:
    """Figure in mid-stride. step: between the ankles; swing: of the hands; both parts of the
    height."""
    hip = (0.0, 0.0, 0.52 - 0.18 * step**2)
    neck = (lean, 0.0, 0.83 - 0.18 * step**2)
    knees = (0.45 * step + 0.02, 0.05, 0.28), (-0.15 * step, -0.05, 0.27)
    ankles = (0.5 * step, 0.05, 0.035), (-0.5 * step, -0.05, 0.055)
    elbows = (-0.25 * swing * step - 0.03, 0.14, 0.64), (0.2 * swing * step, -0.14, 0.64)
    hands = (-0.5 * swing * step, 0.15, 0.48), (0.6 * swing * step + 0.03, -0.15, 0.50)
    return Figure(hip, neck, knees, ankles, elbows, hands, stout)


def person(figure: Figure, height: float) -> Mesh:
    """Mesh of a figure `height` metres tall, soles near z = 0."""
    stout = figure.stout
    head = _beyond(figure.neck, 0.012, 0.0, 0.105)
    parts = [ellipsoid(head, (0.055, 0.045, 0.066), 5, 8), tube([figure.neck, head], 0.032, 6)]
    hip = np.array(_beyond(figure.hip, 0.0, 0.0, -0.03))
    neck = np.array(figure.neck)
    rings = [
        (0.0, 0.075, 0.098),
        (0.25, 0.072, 0.092),
        (0.55, 0.076, 0.100),
        (0.85, 0.070, 0.118),
        (1.0, 0.035, 0.050),
    ]
    trunk = [hip + t * (neck - hip) + _circle() * [a * stout, b * stout, 1] for t, a, b in rings]
    parts.append(loft(np.stack(trunk)))  # chest and belly
    for side, y in ((0, 1), (1, -1)):
        hip_joint = _beyond(figure.hip, 0.0, 0.045 * y, 0.0)
        shoulder = _beyond(figure.neck, -0.01, 0.105 * y * (0.6 + 0.4 * stout), -0.025)
        leg = [hip_joint, figure.knees[side], figure.ankles[side]]
        arm = [shoulder, figure.elbows[side], figure.hands[side]]
        foot = _beyond(figure.ankles[side], 0.035, 0.0, -0.015)
        parts.append(tube(leg, [0.052 * stout, 0.036 * stout, 0.025], 6))
        parts.append(tube(arm, [0.032 * stout, 0.026 * stout, 0.020], 6))
        parts.append(ellipsoid(foot, (0.075, 0.028, 0.022), 3, 6))
        parts.append(ellipsoid(figure.hands[side], (0.024, 0.018, 0.03), 3, 5))
    return scale_mesh(merge(parts), height)


def _circle() -> np.ndarray:
    angle = np.arange(10) * 2 * np.pi / 10
    return np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)


def skirt(height: float, hem: float, stout: float = 1.0) -> Mesh:
    """Skirt or coat from the waist down to `hem` (part of the height)."""
    waist = [(0.0, 0.0, 0.58 * height), (0.0, 0.0, hem * height)]
    return tube(waist, [0.095 * stout * height, (0.10 + 0.06 * stout) * height], 10)


def umbrella(height: float) -> Mesh:
    """Open umbrella held in the right hand over the head."""
    x = 0.12 * height
    y = -0.10 * height
    top = 1.2 * height
    bows = ((0.47, 0.26), (0.48, 0.24), (0.36, 0.1), (0.18, 0.02), (0.01, 0))
    dome = [_circle() * r + [x, y, top - drop] for r, drop in bows]
    return merge([loft(np.stack(dome)), tube([(x, y, 0.55 * height), (x, y, top)], 0.012, 5)])


def pushchair(height: float) -> Mesh:
    """Pushchair with a child, 0.75 m ahead of the person pushing."""
    wheels = [make_wheel(x, y, 0.11, 0.05, 10) for x in (0.62, 1.15) for y in (-0.24, 0.24)]
    seat = place(ellipsoid((0.0, 0.0, 0.62), (0.30, 0.21, 0.24), 5, 8), 0.88)
    bars = [
        tube([(1.15, y, 0.12), (0.62, y, 0.72), (0.36, y, 1.0)], 0.015, 5) for y in (-0.22, 0.22)
    ]
    return merge([*wheels, seat, *bars, tube([(0.36, -0.22, 1.0), (0.36, 0.22, 1.0)], 0.015, 5)])


def trolley(height: float) -> Mesh:
    """Suitcase on wheels, drawn behind."""
    handle = tube([(-0.45, -0.30, 0.6), (-0.15, -0.28, 0.85)], 0.012, 5)
    return merge([box((0.26, 0.42, 0.58), (-0.55, -0.30, 0.34)), handle])


def bag(height: float) -> Mesh:
    """Carrier bag in the left hand."""
    return ellipsoid((0.03 * height, 0.17 * height, 0.31 * height), (0.16, 0.08, 0.20), 3, 8)


def backpack(height: float) -> Mesh:
    """Rucksack."""
    return ellipsoid((-0.105 * height, 0.0, 0.71 * height), (0.12, 0.16, 0.25), 5, 8)


def hat(height: float) -> Mesh:
    """Hat with a brim, level with the crown of the head."""
    x, z = 0.022 * height, 0.965 * height
    return tube(
        [(x, 0, z), (x, 0, z + 0.02), (x, 0, z + 0.03), (x, 0, z + 0.10)],
        [0.17, 0.17, 0.10, 0.09],
        10,
    )


def stick(height: float) -> Mesh:
    """Walking stick in the right hand."""
    return tube([(0.20, -0.17 * height, 0.0), (0.10, -0.155 * height, 0.50 * height)], 0.015, 5)


def pedestrians() -> dict[str, Mesh]:
    """Fourteen people on foot, 1.1 to 1.95 m tall. Umbrellas, hats and loads come on top."""
    arms_up = hold(Figure(), *AT_AN_EAR)
    pushing = hold(striding(0.22), *PUSHING)
    elbows = ((-0.03, 0.14, 0.64), (0.03, -0.13, 0.68))
    hands = ((0.02, 0.15, 0.48), (0.065, -0.06, 0.74))
    holding = hold(striding(0.2), elbows, hands)
    people: dict[str, tuple[Figure, float, Callable[[float], Mesh] | None]] = {
        "man_standing": (Figure(), 1.80, None),
        "woman_standing_bag": (replace(Figure(), stout=0.88), 1.66, bag),
        "man_striding": (striding(0.42), 1.84, None),
        "woman_striding": (striding(0.36, stout=0.87), 1.70, None),
        "tall_man_walking": (striding(0.30, stout=0.95), 1.95, None),
        "stout_man_walking": (striding(0.24, stout=1.28), 1.74, None),
        "child_walking": (striding(0.30, stout=0.98), 1.12, None),
        "schoolchild_with_rucksack": (striding(0.28, stout=0.95), 1.36, backpack),
        "woman_in_a_coat": (striding(0.16, stout=0.95), 1.62, lambda h: skirt(h, 0.20)),
        "man_with_umbrella": (holding, 1.77, umbrella),
        "woman_with_pushchair": (pushing, 1.69, pushchair),
        "old_man_with_stick": (
            striding(0.18, lean=0.09),
            1.65,
            lambda h: merge([stick(h), hat(h)]),
        ),
        "traveller_with_suitcase": (striding(0.34), 1.73, trolley),
        "man_telephoning": (arms_up, 1.76, None),
    }
    meshes = {}
    for name, (figure, height, extra) in people.items():
        body = stand(person(figure, height))
        body = scale_mesh(body, height / body.vertices[:, 2].max())
        meshes[name] = merge([body, *([extra(height)] if extra else [])])
    return meshes


def _beyond(point: Vector, x: float, y: float, z: float) -> Vector:
    return point[0] + x, point[1] + y, point[2] + z


def two_wheelers() -> dict[str, Mesh]:
    """Bicycles, motorcycles and a scooter, each with its rider. x forward, wheels on z = 0."""
    crate = box((0.42, 0.42, 0.36), (-0.62, 0, 0.95))
    people = {
        "city_bicycle": (bicycle(0.34), rider(1.74, 0.93, (0.47, 0.28, 1.04), upright=0.97)),
        "racing_bicycle": (
            bicycle(0.335),
            rider(1.80, 0.97, (0.55, 0.20, 0.92), upright=0.72, stout=0.9),
        ),
        "child_bicycle": (
            scale_mesh(bicycle(0.34), 0.72),
            rider(1.30, 0.67, (0.33, 0.20, 0.76), upright=0.98),
        ),
        "cargo_bicycle": (
            bicycle(0.33),
            crate,
            rider(1.70, 0.93, (0.47, 0.27, 1.02), upright=0.95, stout=1.1),
        ),
        "motorcycle": (
            motorcycle(),
            rider(1.79, 0.84, (0.52, 0.30, 1.0), upright=0.86, rest=(-0.05, 0.36)),
        ),
        "sport_motorcycle": (
            motorcycle(True),
            rider(1.76, 0.86, (0.56, 0.24, 0.93), upright=0.68, rest=(-0.05, 0.42)),
        ),
        "scooter": (
            scooter(),
            rider(1.68, 0.79, (0.42, 0.27, 0.98), upright=0.97, rest=(0.31, 0.32)),
        ),
    }
    return {name: merge(parts) for name, parts in people.items()}


def rider(
    height: float,
    saddle: float,
    grip: Vector,
    *,
    upright: float,
    stout: float = 1.0,
    rest: Span | None = None,
) -> Mesh:
    """Person on a saddle, hands at `grip` and its mirror image.

    height: of the person; saddle: height of the saddle at x = -0.2 (m); upright: sine of the back's
    slope; rest: x and z of the foot rests (m), None for pedals, one up and one down."""
    back = 0.31
    x0 = -0.2 / height
    hip = (x0, 0.0, saddle / height + 0.045)
    neck = (x0 + back * math.sqrt(1 - upright**2) + 0.03, 0.0, hip[2] + back * upright)
    hands = pair(grip[0] / height, grip[1] / height, grip[2] / height)
    elbows = pair((neck[0] + hands[0][0]) / 2 - 0.02, 0.155, (neck[2] + hands[0][2]) / 2 - 0.05)
    left, right = ((0.14, 0.13), (-0.10, 0.36)) if rest is None else (rest, rest)
    ankle = (left[0] - 0.02) / height, 0.11 / height, left[1] / height + 0.035
    other_ankle = (right[0] - 0.02) / height, -0.11 / height, right[1] / height + 0.035
    knees = _knee(hip, ankle), _knee(hip, other_ankle)
    return person(Figure(hip, neck, knees, (ankle, other_ankle), elbows, hands, stout), height)


def _knee(hip: Vector, ankle: Vector) -> Vector:
    """Knee in front of the line from hip to ankle. Thigh and shin are each a quarter of the
    height."""
    a = np.array(hip)
    b = np.array(ankle)
    along = b - a
    bend = math.sqrt(max(0.245**2 - float(along @ along) / 4, 0.0004))
    forward = np.cross([0.0, 1.0, 0.0], along)
    knee = (a + b) / 2 - bend * forward / np.linalg.norm(forward)
    return float(knee[0]), math.copysign(0.06, ankle[1]), float(knee[2])


def bicycle(radius: float) -> Mesh:
    """Bicycle whose wheels have this radius (m)."""
    rear = (-0.52, 0.0, radius)
    front = (0.52, 0.0, radius)
    crank = (-0.08, 0.0, 0.29)
    seat = (-0.2, 0.0, 0.88)
    head = (0.36, 0.0, 0.82)
    bar = (0.40, 0.0, 1.0)
    frame = [
        (crank, seat),
        (crank, head),
        (seat, head),
        (crank, rear),
        ((-0.18, 0.0, 0.78), rear),
        (bar, front),
    ]
    bars = [tube(list(ends), 0.018, 5) for ends in frame]
    grips = tube([(0.45, -0.28, 1.02), (0.40, 0.0, 1.0), (0.45, 0.28, 1.02)], 0.015, 5)
    saddle = ellipsoid((-0.21, 0.0, 0.92), (0.14, 0.08, 0.04), 3, 6)
    return merge([*bars, grips, saddle, _tyre(-0.52, radius, 0.025), _tyre(0.52, radius, 0.025)])


def _tyre(x: float, radius: float, thickness: float) -> Mesh:
    """Ring of a wheel, open between the spokes, standing on z = 0."""
    around = np.arange(21) * 2 * np.pi / 20
    across = np.arange(5) * 2 * np.pi / 5
    distance = radius - thickness * (1 - np.cos(across))
    y = np.sin(across)[None] * thickness + 0 * around[:, None]
    x_and_z = x + np.sin(around)[:, None] * distance, radius - np.cos(around)[:, None] * distance
    return loft(np.stack([x_and_z[0], y, x_and_z[1]], axis=-1))


def motorcycle(fairing: bool = False) -> Mesh:
    """Motorcycle, bare or with a fairing and a top case."""
    parts = [make_wheel(-0.70, 0.0, 0.31, 0.16), make_wheel(0.74, 0.0, 0.30, 0.12)]
    parts += [
        ellipsoid((0.02, 0.0, 0.45), (0.32, 0.17, 0.22)),
        ellipsoid((0.16, 0.0, 0.80), (0.30, 0.15, 0.16)),
    ]
    parts += [
        tube([(-0.95, 0.0, 0.80), (-0.55, 0.0, 0.78), (0.0, 0.0, 0.74)], [0.06, 0.13, 0.12], 8)
    ]
    parts += [tube([(0.74, y, 0.30), (0.46, y, 0.92)], 0.03, 5) for y in (-0.1, 0.1)]
    parts += [tube([(0.48, -0.33, 1.0), (0.50, 0.0, 0.96), (0.48, 0.33, 1.0)], 0.02, 5)]
    parts += [ellipsoid((0.60, 0.0, 0.86), (0.10, 0.10, 0.11))]
    parts += [tube([(-0.75, -0.17, 0.38), (0.0, -0.17, 0.28)], 0.06, 6)]
    if fairing:
        parts += [
            ellipsoid((0.52, 0.0, 0.72), (0.36, 0.22, 0.34)),
            ellipsoid((-0.78, 0.0, 0.92), (0.26, 0.10, 0.09)),
        ]
    return merge(parts)


def scooter() -> Mesh:
    """Motor scooter with mirrors on its handlebar."""
    parts = [make_wheel(-0.58, 0.0, 0.24, 0.13), make_wheel(0.60, 0.0, 0.24, 0.11)]
    parts += [
        ellipsoid((-0.50, 0.0, 0.58), (0.46, 0.18, 0.19)),
        box((0.5, 0.34, 0.08), (0.05, 0, 0.30)),
    ]
    parts += [
        tube(
            [(0.36, 0.0, 0.28), (0.40, 0.0, 0.60), (0.36, 0.0, 0.92)],
            [0.10, 0.12, 0.06],
            8,
            flat=1.9,
        )
    ]
    parts += [tube([(0.60, 0.0, 0.24), (0.38, 0.0, 0.92)], 0.04, 6)]
    grips = tube([(0.36, -0.30, 0.98), (0.38, 0.0, 0.95), (0.36, 0.30, 0.98)], 0.02, 5)
    arm = tube([(0.37, 0.24, 0.98), (0.40, 0.27, 1.12)], 0.01, 4)
    mirror = merge([ellipsoid((0.40, 0.27, 1.12), (0.02, 0.06, 0.05), 3, 6), arm])
    return merge([*parts, grips, mirror, flip_sides(mirror)])
