"""People on foot of the catalogue, their clothes and burdens."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from toolkit.bodies.figures import Figure, hold, person, phone, push, striding, unit_circle
from toolkit.bodies.wheels import make_wheel
from toolkit.mesh import Mesh, box, ellipsoid, loft, merge, place, scale_mesh, stand, tube


def skirt(height: float, hem: float, stout: float = 1.0) -> Mesh:
    """Mesh of a skirt or coat from the waist down to a hem.

    height: height of the person (m); hem: height of the hem, as a part of it; stout: see
    `Figure`."""
    waist = [(0.0, 0.0, 0.58 * height), (0.0, 0.0, hem * height)]
    return tube(waist, radii=[0.095 * stout * height, (0.10 + 0.06 * stout) * height], sides=10)


def umbrella(height: float) -> Mesh:
    """Mesh of an open umbrella held over the head in the right hand. height: the person's (m)."""
    x = 0.12 * height
    y = -0.10 * height
    top = 1.2 * height
    # radius, and distance below the top (m)
    rings = ((0.47, 0.26), (0.48, 0.24), (0.36, 0.1), (0.18, 0.02), (0.01, 0))
    dome = [unit_circle() * radius + [x, y, top - drop] for radius, drop in rings]
    handle = tube([(x, y, 0.55 * height), (x, y, top)], radii=0.012, sides=5)
    return merge([loft(np.stack(dome)), handle])


def pushchair(height: float) -> Mesh:
    """Mesh of a pushchair with a child, about 0.9 m ahead of the person pushing.

    height: height of the person (m), not used; every function for what people carry or push takes
    it."""
    wheels = [
        make_wheel(x, y, radius=0.11, breadth=0.05, sides=10)
        for x in (0.62, 1.15)
        for y in (-0.24, 0.24)
    ]
    seat = place(ellipsoid((0.0, 0.0, 0.62), radii=(0.30, 0.21, 0.24), rings=5, sides=8), x=0.88)
    bars = [
        tube([(1.15, y, 0.12), (0.62, y, 0.72), (0.36, y, 1.0)], radii=0.015, sides=5)
        for y in (-0.22, 0.22)
    ]
    handle = tube([(0.36, -0.22, 1.0), (0.36, 0.22, 1.0)], radii=0.015, sides=5)
    return merge([*wheels, seat, *bars, handle])


def trolley(height: float) -> Mesh:
    """Mesh of a suitcase on wheels, pulled behind; it does not depend on the height."""
    handle = tube([(-0.45, -0.30, 0.6), (-0.15, -0.28, 0.85)], radii=0.012, sides=5)
    return merge([box((0.26, 0.42, 0.58), centre=(-0.55, -0.30, 0.34)), handle])


def bag(height: float) -> Mesh:
    """Mesh of a carrier bag in the left hand. height: height of the person (m)."""
    return ellipsoid(
        (0.03 * height, 0.17 * height, 0.31 * height), radii=(0.16, 0.08, 0.20), rings=3, sides=8
    )


def backpack(height: float) -> Mesh:
    """Mesh of a rucksack on the back. height: height of the person (m)."""
    return ellipsoid(
        (-0.105 * height, 0.0, 0.71 * height), radii=(0.12, 0.16, 0.25), rings=5, sides=8
    )


def hat(height: float) -> Mesh:
    """Mesh of a hat with a brim, level with the crown of the head. height: the person's (m)."""
    x = 0.022 * height
    z = 0.965 * height
    axis = [(x, 0, z), (x, 0, z + 0.02), (x, 0, z + 0.03), (x, 0, z + 0.10)]
    return tube(axis, radii=[0.17, 0.17, 0.10, 0.09], sides=10)


def stick(height: float) -> Mesh:
    """Mesh of a walking stick in the right hand. height: height of the person (m)."""
    return tube(
        [(0.20, -0.17 * height, 0.0), (0.10, -0.155 * height, 0.50 * height)], radii=0.015, sides=5
    )


class _Pedestrian(NamedTuple):
    """Person on foot.

    Attributes:
        figure: its joints.
        height: from the soles to the crown of the head (m).
        make_extra: mesh of clothes or a burden by height, None for none."""

    figure: Figure
    height: float
    make_extra: Callable[[float], Mesh] | None = None


def pedestrians() -> dict[str, Mesh]:
    """Fourteen people on foot, 1.1 to 1.95 m tall; umbrellas, hats and loads come on top."""
    meshes = {}
    for name, (figure, height, make_extra) in _list_pedestrians().items():
        standing_mesh = stand(person(figure, height))
        top = standing_mesh.vertices[:, 2].max()
        body = scale_mesh(standing_mesh, height / top)  # exactly as tall as stated
        extras = [make_extra(height)] if make_extra else []
        meshes[name] = merge([body, *extras])
    return meshes


def _list_pedestrians() -> dict[str, _Pedestrian]:
    """Describe the people of the catalogue by name.

    Each has a figure, a height (m) and, if any, a function of the height that makes the mesh of
    clothes or a burden."""
    # joints are x, y, z in parts of the height, left and right; `striding` takes the distance
    # between the ankles, in parts of the height too
    telephoning = phone(Figure())
    pushing = push(striding(0.22))
    elbows = ((-0.03, 0.14, 0.64), (0.03, -0.13, 0.68))
    hands = ((0.02, 0.15, 0.48), (0.065, -0.06, 0.74))
    holding = hold(striding(0.2), elbows=elbows, hands=hands)
    return {
        "man_standing": _Pedestrian(Figure(), 1.80),
        "woman_standing_bag": _Pedestrian(replace(Figure(), stout=0.88), 1.66, bag),
        "man_striding": _Pedestrian(striding(0.42), 1.84),
        "woman_striding": _Pedestrian(striding(0.36, stout=0.87), 1.70),
        "tall_man_walking": _Pedestrian(striding(0.30, stout=0.95), 1.95),
        "stout_man_walking": _Pedestrian(striding(0.24, stout=1.28), 1.74),
        "child_walking": _Pedestrian(striding(0.30, stout=0.98), 1.12),
        "schoolchild_with_rucksack": _Pedestrian(striding(0.28, stout=0.95), 1.36, backpack),
        "woman_in_a_coat": _Pedestrian(striding(0.16, stout=0.95), 1.62, lambda h: skirt(h, 0.20)),
        "man_with_umbrella": _Pedestrian(holding, 1.77, umbrella),
        "woman_with_pushchair": _Pedestrian(pushing, 1.69, pushchair),
        "old_man_with_stick": _Pedestrian(
            striding(0.18, lean=0.09), 1.65, lambda h: merge([stick(h), hat(h)])
        ),
        "traveller_with_suitcase": _Pedestrian(striding(0.34), 1.73, trolley),
        "man_telephoning": _Pedestrian(telephoning, 1.76),
    }
