"""Drawn two-wheelers: bicycles of every size, cargo bicycles, e-scooters, motorcycles, scooters; most are ridden."""

from __future__ import annotations

from functools import cache

import numpy as np

from toolkit.bodies.cars import wheel_at
from toolkit.bodies.cyclists import bicycle, motorcycle, rider, scooter
from toolkit.bodies.drawn.cars import plank
from toolkit.bodies.drawn.people import drawn_pose, standing
from toolkit.bodies.pedestrians import backpack, grown, person
from toolkit.mesh import Mesh, Vector, merge, shifted, tube

TWO_WHEELERS = ("bicycle", "cargo_bicycle", "e_scooter", "motorcycle", "scooter")  # each also "_alone"
RIDERLESS = 0.1  # of all but e-scooters


def drawn_two_wheeler(rng: np.random.Generator) -> tuple[str, Mesh]:
    """A two-wheeler and the word for it, x forward, wheels on z = 0."""
    kinds = (_bicycle, _e_scooter, _motorcycle, _scooter)
    kind, mesh = kinds[int(rng.choice(4, p=(0.55, 0.15, 0.17, 0.13)))](rng)
    return kind, standing(mesh)


def _bicycle(rng: np.random.Generator) -> tuple[str, Mesh]:
    if rng.random() < 0.12:
        scale, height = float(rng.uniform(0.55, 0.8)), 0.0
        height = 1.75 * scale + float(rng.uniform(-0.06, 0.06))
    else:
        height = float(np.clip(rng.normal(1.73, 0.09), 1.5, 2.0))
        scale = float(np.clip(height / 1.74 + rng.uniform(-0.07, 0.07), 0.85, 1.12))
    sporty = float(rng.uniform(0, 1))  # 0 upright, 1 bent over a racing bar
    bike = grown(_bare_bicycle(int(rng.integers(31, 37))), scale)
    parts, kind = [_longer(bike, float(rng.uniform(0.95, 1.08)))], "bicycle"
    extra = rng.random()
    if scale > 0.84 and extra < 0.1:
        size = rng.uniform((0.45, 0.4, 0.3), (0.9, 0.65, 0.6))
        parts = [_longer(bike, 1.3), plank(tuple(size.tolist()), 0.5 + 0.2 * size[0], 0.0, 0.42)]
        kind = "cargo_bicycle"
    elif extra < 0.3:
        parts.append(plank((0.36, float(rng.uniform(0.25, 0.42)), 0.32), -0.6 * scale, 0.0, 0.68 * scale))
    if rng.random() < RIDERLESS:
        return f"{kind}_alone", merge(parts)
    grip: Vector = ((0.45 + 0.1 * sporty) * scale, (0.29 - 0.09 * sporty) * scale, (1.04 - 0.12 * sporty) * scale)
    parts.append(rider(height, 0.95 * scale, grip, upright=0.98 - 0.26 * sporty, stout=float(rng.uniform(0.85, 1.2))))
    return kind, merge(parts)


def _e_scooter(rng: np.random.Generator) -> tuple[str, Mesh]:
    """A board on two small wheels; whoever rides it stands."""
    half, radius, bar = float(rng.uniform(0.4, 0.52)), float(rng.uniform(0.1, 0.14)), float(rng.uniform(1.0, 1.2))
    parts = [wheel_at(-half, 0.0, radius, 0.05, 10), wheel_at(half, 0.0, radius, 0.05, 10)]
    parts += [plank((1.7 * half, 0.16, 0.06), -0.05, 0.0, radius)]
    parts += [tube([(half, 0.0, radius), (half - 0.14, 0.0, bar)], 0.03, 6)]
    parts += [tube([(half - 0.14, -0.25, bar), (half - 0.13, 0.0, bar), (half - 0.14, 0.25, bar)], 0.02, 5)]
    if rng.random() < 0.15:
        return "e_scooter_alone", merge(parts)
    height = float(np.clip(rng.normal(1.73, 0.09), 1.35, 2.0))
    hand = ((half - 0.18 + 0.12) / height, 0.22 / height, (bar - radius - 0.06) / height)
    pose = drawn_pose(rng, float(rng.uniform(0.85, 1.2)))
    figure = type(pose)(
        ankles=((0.06, 0.025, 0.035), (-0.12, -0.025, 0.035)),
        elbows=((0.03, 0.15, 0.66), (0.03, -0.15, 0.66)),
        hands=(hand, (hand[0], -hand[1], hand[2])),
        stout=pose.stout,
    )
    body = person(figure, height)
    parts.append(shifted(standing(body), -0.12, 0.0, radius + 0.06))
    return "e_scooter", merge(parts)


def _motorcycle(rng: np.random.Generator) -> tuple[str, Mesh]:
    fairing, scale = bool(rng.random() < 0.5), float(rng.uniform(0.88, 1.12))
    bike = _longer(grown(_bare_motorcycle(fairing), scale), float(rng.uniform(0.94, 1.1)))
    if rng.random() < RIDERLESS:
        return "motorcycle_alone", bike
    bent, height = float(rng.uniform(0, 1)), float(np.clip(rng.normal(1.77, 0.07), 1.58, 1.98))
    grip: Vector = ((0.52 + 0.04 * bent) * scale, 0.3 - 0.06 * bent, (1.0 - 0.07 * bent) * scale)
    on = [rider(height, 0.85 * scale, grip, upright=0.92 - 0.24 * bent, rest=(-0.05, 0.36 + 0.06 * bent))]
    return "motorcycle", merge([bike, *on, *_second(on, 0.4 * scale, rng)])


def _scooter(rng: np.random.Generator) -> tuple[str, Mesh]:
    scale = float(rng.uniform(0.9, 1.12))
    bike = _longer(grown(_bare_scooter(), scale), float(rng.uniform(0.95, 1.08)))
    if rng.random() < RIDERLESS:
        return "scooter_alone", bike
    height = float(np.clip(rng.normal(1.71, 0.09), 1.5, 1.98))
    on = [rider(height, 0.79 * scale, (0.42 * scale, 0.27, 0.98 * scale), upright=float(rng.uniform(0.9, 0.98)),
                stout=float(rng.uniform(0.9, 1.15)), rest=(0.31 * scale, 0.32 * scale))]  # fmt: skip
    if rng.random() < 0.25:
        pack = backpack(height)  # a courier's
        on.append(Mesh(pack.vertices * [1.6, 1.4, 1.0] + [-0.2, 0.0, 0.79 * scale - 0.45 * height], pack.triangles))
    return "scooter", merge([bike, *on, *_second(on[:1], 0.35 * scale, rng)])


def _second(on: list[Mesh], behind: float, rng: np.random.Generator) -> list[Mesh]:
    """A passenger, sometimes: the rider once more, farther back and a little higher."""
    if rng.random() > 0.12:
        return []
    return [Mesh(mesh.vertices * [0.8, 0.95, 0.97] + [-behind - 0.05, 0.0, 0.08], mesh.triangles) for mesh in on]


@cache
def _bare_bicycle(wheel_cm: int) -> Mesh:
    return bicycle(wheel_cm / 100)


_bare_motorcycle, _bare_scooter = cache(motorcycle), cache(scooter)


def _longer(mesh: Mesh, factor: float) -> Mesh:
    return Mesh(mesh.vertices * [factor, 1.0, 1.0], mesh.triangles)
