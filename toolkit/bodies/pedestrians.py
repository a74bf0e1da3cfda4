"""People, built limb by limb from the joints of a posed figure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from toolkit.bodies.cars import wheel_at
from toolkit.mesh import Mesh, Vector, box, ellipsoid, loft, merge, placed, tube


@dataclass(frozen=True)
class Figure:
    """A person 1 unit tall facing +x: where the joints are, y left; a limb's two entries are left and right.

    stout: breadth of trunk and limbs relative to an average adult.
    """

    hip: Vector = (0.0, 0.0, 0.52)
    neck: Vector = (0.01, 0.0, 0.83)
    knees: tuple[Vector, Vector] = ((0.02, 0.055, 0.28), (0.02, -0.055, 0.28))
    ankles: tuple[Vector, Vector] = ((0.0, 0.06, 0.035), (0.0, -0.06, 0.035))
    elbows: tuple[Vector, Vector] = ((-0.02, 0.145, 0.64), (-0.02, -0.145, 0.64))
    hands: tuple[Vector, Vector] = ((0.03, 0.15, 0.47), (0.03, -0.15, 0.47))
    stout: float = 1.0


def striding(step: float, swing: float = 0.6, lean: float = 0.02, stout: float = 1.0) -> Figure:
    """A figure in mid-stride: `step` between the ankles and `swing` of the hands, as parts of the height."""
    return Figure(
        hip=(0.0, 0.0, 0.52 - 0.18 * step**2),
        neck=(lean, 0.0, 0.83 - 0.18 * step**2),
        knees=((0.45 * step + 0.02, 0.05, 0.28), (-0.15 * step, -0.05, 0.27)),
        ankles=((0.5 * step, 0.05, 0.035), (-0.5 * step, -0.05, 0.055)),
        elbows=((-0.25 * swing * step - 0.03, 0.14, 0.64), (0.2 * swing * step, -0.14, 0.64)),
        hands=((-0.5 * swing * step, 0.15, 0.48), (0.6 * swing * step + 0.03, -0.15, 0.50)),
        stout=stout,
    )


def person(figure: Figure, height: float) -> Mesh:
    """The mesh of a figure `height` metres tall, soles near z = 0."""
    stout = figure.stout
    head = _beyond(figure.neck, 0.012, 0.0, 0.105)
    parts = [ellipsoid(head, (0.055, 0.045, 0.066), 5, 8), tube([figure.neck, head], 0.032, 6)]
    parts.append(_trunk(figure))
    for side, y in ((0, 1), (1, -1)):
        hip = _beyond(figure.hip, 0.0, 0.045 * y, 0.0)
        shoulder = _beyond(figure.neck, -0.01, 0.105 * y * (0.6 + 0.4 * stout), -0.025)
        leg = [hip, figure.knees[side], figure.ankles[side]]
        arm = [shoulder, figure.elbows[side], figure.hands[side]]
        foot = _beyond(figure.ankles[side], 0.035, 0.0, -0.015)
        parts.append(tube(leg, [0.052 * stout, 0.036 * stout, 0.025], 6))
        parts.append(tube(arm, [0.032 * stout, 0.026 * stout, 0.020], 6))
        parts.append(ellipsoid(foot, (0.075, 0.028, 0.022), 3, 6))
        parts.append(ellipsoid(figure.hands[side], (0.024, 0.018, 0.03), 3, 5))
    return grown(merge(parts), height)


def _trunk(figure: Figure) -> Mesh:
    """Chest and belly: elliptical rings from the hip up to the shoulders."""
    angle = np.arange(10) * 2 * np.pi / 10
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    hip, neck = np.array(_beyond(figure.hip, 0.0, 0.0, -0.03)), np.array(figure.neck)
    rings = [(0.0, 0.075, 0.098), (0.25, 0.072, 0.092), (0.55, 0.076, 0.100), (0.85, 0.070, 0.118), (1.0, 0.035, 0.050)]
    return loft(
        np.stack([hip + t * (neck - hip) + circle * [a * figure.stout, b * figure.stout, 1] for t, a, b in rings])
    )


def skirt(height: float, hem: float, stout: float = 1.0) -> Mesh:
    """A skirt or coat from the waist down to the height `hem` (part of the body height)."""
    waist = [(0.0, 0.0, 0.58 * height), (0.0, 0.0, hem * height)]
    return tube(waist, [0.095 * stout * height, (0.10 + 0.06 * stout) * height], 10)


def umbrella(height: float) -> Mesh:
    """An open umbrella held in the right hand over the head."""
    x, y, top = 0.12 * height, -0.10 * height, 1.2 * height
    angle = np.arange(10) * 2 * np.pi / 10
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    dome = [
        ring * r + [x, y, top - drop] for r, drop in ((0.47, 0.26), (0.48, 0.24), (0.36, 0.1), (0.18, 0.02), (0.01, 0))
    ]
    return merge([loft(np.stack(dome)), tube([(x, y, 0.55 * height), (x, y, top)], 0.012, 5)])


def pushchair() -> Mesh:
    """A pushchair with a child, 0.75 m ahead of whoever pushes it."""
    wheels = [wheel_at(x, y, 0.11, 0.05, 10) for x in (0.62, 1.15) for y in (-0.24, 0.24)]
    seat = placed(ellipsoid((0.0, 0.0, 0.62), (0.30, 0.21, 0.24), 5, 8), 0.88)
    bars = [tube([(1.15, y, 0.12), (0.62, y, 0.72), (0.36, y, 1.0)], 0.015, 5) for y in (-0.22, 0.22)]
    return merge([*wheels, seat, *bars, tube([(0.36, -0.22, 1.0), (0.36, 0.22, 1.0)], 0.015, 5)])


def trolley() -> Mesh:
    """A suitcase on wheels, drawn behind."""
    return merge(
        [box((0.26, 0.42, 0.58), (-0.55, -0.30, 0.34)), tube([(-0.45, -0.30, 0.6), (-0.15, -0.28, 0.85)], 0.012, 5)]
    )


def bag(height: float) -> Mesh:
    """A carrier bag in the left hand."""
    return ellipsoid((0.03 * height, 0.17 * height, 0.31 * height), (0.16, 0.08, 0.20), 3, 8)


def backpack(height: float) -> Mesh:
    """A rucksack."""
    return ellipsoid((-0.105 * height, 0.0, 0.71 * height), (0.12, 0.16, 0.25), 5, 8)


def hat(height: float) -> Mesh:
    """A hat with a brim that ends level with the crown of the head."""
    x, z = 0.022 * height, 0.965 * height
    return tube([(x, 0, z), (x, 0, z + 0.02), (x, 0, z + 0.03), (x, 0, z + 0.10)], [0.17, 0.17, 0.10, 0.09], 10)


def stick(height: float) -> Mesh:
    """A walking stick in the right hand."""
    return tube([(0.20, -0.17 * height, 0.0), (0.10, -0.155 * height, 0.50 * height)], 0.015, 5)


def pedestrians() -> dict[str, Mesh]:
    """Fourteen people on foot, 1.1 to 1.95 m tall (umbrellas, hats and loads come on top)."""
    arms_up = replace(
        Figure(), elbows=((0.08, 0.13, 0.66), (0.10, -0.12, 0.68)), hands=((0.16, 0.05, 0.80), (0.08, -0.07, 0.80))
    )
    pushing = replace(
        striding(0.22),
        elbows=((0.02, 0.14, 0.65), (0.02, -0.14, 0.65)),
        hands=((0.20, 0.12, 0.58), (0.20, -0.12, 0.58)),
    )
    holding = replace(
        striding(0.2),
        elbows=((-0.03, 0.14, 0.64), (0.03, -0.13, 0.68)),
        hands=((0.02, 0.15, 0.48), (0.065, -0.06, 0.74)),
    )
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
        "woman_with_pushchair": (pushing, 1.69, lambda h: pushchair()),
        "old_man_with_stick": (striding(0.18, lean=0.09), 1.65, lambda h: merge([stick(h), hat(h)])),
        "traveller_with_suitcase": (striding(0.34), 1.73, lambda h: trolley()),
        "man_telephoning": (arms_up, 1.76, None),
    }  # fmt: skip
    return {
        name: merge([_exactly(person(figure, height), height), *([extra(height)] if extra else [])])
        for name, (figure, height, extra) in people.items()
    }


def _exactly(mesh: Mesh, height: float) -> Mesh:
    standing = Mesh(mesh.vertices - [0.0, 0.0, mesh.vertices[:, 2].min()], mesh.triangles)
    return grown(standing, height / standing.vertices[:, 2].max())


def grown(mesh: Mesh, factor: float) -> Mesh:
    """The mesh scaled about the origin."""
    return Mesh(mesh.vertices * factor, mesh.triangles)


def _beyond(point: Vector, x: float, y: float, z: float) -> Vector:
    return point[0] + x, point[1] + y, point[2] + z
