"""Bicycles, motorcycles and a scooter, each with somebody riding it."""

from __future__ import annotations

import math

import numpy as np

from toolkit.bodies.cars import wheel_at
from toolkit.bodies.pedestrians import Figure, grown, person
from toolkit.mesh import Mesh, Vector, box, ellipsoid, loft, merge, mirrored, tube


def two_wheelers() -> dict[str, Mesh]:
    """Bicycles, motorcycles and a scooter, each with its rider; x forward, wheels on z = 0."""
    crate = box((0.42, 0.42, 0.36), (-0.62, 0, 0.95))
    people = {
        "city_bicycle": (bicycle(0.34), rider(1.74, 0.93, (0.47, 0.28, 1.04), upright=0.97)),
        "racing_bicycle": (bicycle(0.335), rider(1.80, 0.97, (0.55, 0.20, 0.92), upright=0.72, stout=0.9)),
        "child_bicycle": (grown(bicycle(0.34), 0.72), rider(1.30, 0.67, (0.33, 0.20, 0.76), upright=0.98)),
        "cargo_bicycle": (bicycle(0.33), crate, rider(1.70, 0.93, (0.47, 0.27, 1.02), upright=0.95, stout=1.1)),
        "motorcycle": (motorcycle(), rider(1.79, 0.84, (0.52, 0.30, 1.0), upright=0.86, rest=(-0.05, 0.36))),
        "sport_motorcycle": (
            motorcycle(fairing=True), rider(1.76, 0.86, (0.56, 0.24, 0.93), upright=0.68, rest=(-0.05, 0.42)),
        ),
        "scooter": (scooter(), rider(1.68, 0.79, (0.42, 0.27, 0.98), upright=0.97, rest=(0.31, 0.32))),
    }  # fmt: skip
    return {name: merge(parts) for name, parts in people.items()}


def rider(
    height: float,
    saddle: float,
    grip: Vector,
    *,
    upright: float,
    stout: float = 1.0,
    rest: tuple[float, float] | None = None,
) -> Mesh:
    """Somebody `height` m tall on a saddle `saddle` m high at x = -0.2, hands at `grip` and at its mirror image.

    upright: sine of the back's slope; rest: x and z of the foot rests (m), None for pedals, one up and one down.
    """
    back, x0 = 0.31, -0.2 / height
    hip = (x0, 0.0, saddle / height + 0.045)
    neck = (x0 + back * math.sqrt(1 - upright**2) + 0.03, 0.0, hip[2] + back * upright)
    hands = tuple((grip[0] / height, y * grip[1] / height, grip[2] / height) for y in (1, -1))
    elbows = tuple(
        ((neck[0] + hand[0]) / 2 - 0.02, math.copysign(0.155, hand[1]), (neck[2] + hand[2]) / 2 - 0.05)
        for hand in hands
    )
    pedals = ((0.14, 0.13), (-0.10, 0.36)) if rest is None else (rest, rest)
    ankles = tuple(
        ((x - 0.02) / height, y * 0.11 / height, z / height + 0.035) for (x, z), y in zip(pedals, (1, -1), strict=True)
    )
    knees = tuple(_knee(hip, ankle) for ankle in ankles)
    figure = Figure(hip, neck, knees, ankles, elbows, hands, stout)  # type: ignore[arg-type]  # pairs by construction
    return person(figure, height)


def _knee(hip: Vector, ankle: Vector) -> Vector:
    """Where thigh and shin, each a quarter of the height, meet in front of the line from hip to ankle."""
    a, b = np.array(hip), np.array(ankle)
    along = b - a
    bend = math.sqrt(max(0.245**2 - float(along @ along) / 4, 0.0004))
    forward = np.cross([0.0, 1.0, 0.0], along)
    knee = (a + b) / 2 - bend * forward / np.linalg.norm(forward)
    return float(knee[0]), math.copysign(0.06, ankle[1]), float(knee[2])


def bicycle(radius: float) -> Mesh:
    """A bicycle whose wheels have this radius (m)."""
    rear, front, crank = (-0.52, 0.0, radius), (0.52, 0.0, radius), (-0.08, 0.0, 0.29)
    seat, head, bar = (-0.2, 0.0, 0.88), (0.36, 0.0, 0.82), (0.40, 0.0, 1.0)
    frame = [(crank, seat), (crank, head), (seat, head), (crank, rear), ((-0.18, 0.0, 0.78), rear), (bar, front)]
    bars = [tube(list(ends), 0.018, 5) for ends in frame]
    grips = tube([(0.45, -0.28, 1.02), (0.40, 0.0, 1.0), (0.45, 0.28, 1.02)], 0.015, 5)
    saddle = ellipsoid((-0.21, 0.0, 0.92), (0.14, 0.08, 0.04), 3, 6)
    return merge([*bars, grips, saddle, _tyre(-0.52, radius, 0.025), _tyre(0.52, radius, 0.025)])


def _tyre(x: float, radius: float, thickness: float) -> Mesh:
    """A ring of a wheel, open between the spokes, standing on z = 0."""
    around, across = np.arange(21) * 2 * np.pi / 20, np.arange(5) * 2 * np.pi / 5
    distance = radius - thickness * (1 - np.cos(across))
    rings = np.stack(
        [
            x + np.sin(around)[:, None] * distance, np.sin(across)[None] * thickness + 0 * around[:, None],
            radius - np.cos(around)[:, None] * distance,
        ],
        axis=-1,
    )  # fmt: skip
    return loft(rings)


def motorcycle(fairing: bool = False) -> Mesh:
    """A motorcycle, bare or with a fairing and a top case."""
    parts = [wheel_at(-0.70, 0.0, 0.31, 0.16), wheel_at(0.74, 0.0, 0.30, 0.12)]
    parts += [ellipsoid((0.02, 0.0, 0.45), (0.32, 0.17, 0.22)), ellipsoid((0.16, 0.0, 0.80), (0.30, 0.15, 0.16))]
    parts += [tube([(-0.95, 0.0, 0.80), (-0.55, 0.0, 0.78), (0.0, 0.0, 0.74)], [0.06, 0.13, 0.12], 8)]
    parts += [tube([(0.74, y, 0.30), (0.46, y, 0.92)], 0.03, 5) for y in (-0.1, 0.1)]
    parts += [tube([(0.48, -0.33, 1.0), (0.50, 0.0, 0.96), (0.48, 0.33, 1.0)], 0.02, 5)]
    parts += [
        ellipsoid((0.60, 0.0, 0.86), (0.10, 0.10, 0.11)),
        tube([(-0.75, -0.17, 0.38), (0.0, -0.17, 0.28)], 0.06, 6),
    ]
    if fairing:
        parts += [ellipsoid((0.52, 0.0, 0.72), (0.36, 0.22, 0.34)), ellipsoid((-0.78, 0.0, 0.92), (0.26, 0.10, 0.09))]
    return merge(parts)


def scooter() -> Mesh:
    """A motor scooter with mirrors on its handlebar."""
    parts = [wheel_at(-0.58, 0.0, 0.24, 0.13), wheel_at(0.60, 0.0, 0.24, 0.11)]
    parts += [ellipsoid((-0.50, 0.0, 0.58), (0.46, 0.18, 0.19)), box((0.5, 0.34, 0.08), (0.05, 0, 0.30))]
    parts += [tube([(0.36, 0.0, 0.28), (0.40, 0.0, 0.60), (0.36, 0.0, 0.92)], [0.10, 0.12, 0.06], 8, flat=1.9)]
    parts += [tube([(0.60, 0.0, 0.24), (0.38, 0.0, 0.92)], 0.04, 6)]
    grips = tube([(0.36, -0.30, 0.98), (0.38, 0.0, 0.95), (0.36, 0.30, 0.98)], 0.02, 5)
    mirror = merge(
        [
            ellipsoid((0.40, 0.27, 1.12), (0.02, 0.06, 0.05), 3, 6),
            tube([(0.37, 0.24, 0.98), (0.40, 0.27, 1.12)], 0.01, 4),
        ]
    )
    return merge([*parts, grips, mirror, mirrored(mirror)])
