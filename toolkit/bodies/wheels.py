"""Wheels of vehicles."""

from collections.abc import Iterable

import numpy as np

from toolkit.mesh import Mesh, flip_sides, stand, tube

AXLE_WHEEL_WIDTH_M = 0.3

# places across a wheel, as parts of its breadth, and radii there, as parts of its radius
_ACROSS = (-0.5, -0.42, 0.42, 0.5)
_RADII = (0.86, 1.0, 1.0, 0.86)


def make_wheel(x: float, y: float, radius: float, breadth: float, sides: int = 12) -> Mesh:
    """Make a wheel on z = 0 with its axle along y.

    x, y: its middle (m); radius, breadth: m; sides: number of sides of its outline."""
    axis = np.column_stack([np.full(4, x), np.array(_ACROSS) * breadth + y, np.full(4, radius)])
    return stand(tube(axis, radii=np.array(_RADII) * radius, sides=sides))


def make_axles(axles: Iterable[float], width: float, radius: float, sides: int = 14) -> list[Mesh]:
    """Make the left and right wheels of a vehicle, each 0.3 m broad, all left ones first.

    axles: x of each axle (m); width: from the outer side of the left wheels to the right ones'
    (m); radius: m; sides: number of sides of a wheel's outline."""
    y = width / 2 - AXLE_WHEEL_WIDTH_M / 2
    wheels = [
        make_wheel(x, y, radius=radius, breadth=AXLE_WHEEL_WIDTH_M, sides=sides) for x in axles
    ]
    return wheels + [flip_sides(wheel) for wheel in wheels]
