"""Shells of trucks and buses, lofted through rounded rectangles."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64
from toolkit.mesh import Mesh, loft


class VehicleSize(NamedTuple):
    """Length, width and height of a vehicle or its cab (m); a cab's length is the whole truck's."""

    length: float
    width: float
    height: float


class ShellSection(NamedTuple):
    """Cross-section of a shell (m).

    Attributes:
        x: its place along the vehicle.
        width: its breadth.
        bottom: height of its lower edge.
        top: height of its upper edge."""

    x: float
    width: float
    bottom: float
    top: float


def loft_shell(sections: Sequence[ShellSection], corner: float, points: int = 3) -> Mesh:
    """Loft a closed mesh through sections in order from the rear to the front.

    corner: radius of the sections' round corners (m); points: number of points on each corner."""
    return loft(np.stack([_round_section(section, corner, points) for section in sections]))


def _round_section(section: ShellSection, radius: float, points: int) -> Float64[np.ndarray, "p 3"]:
    """Ring of a section's points (x, y, z), counter-clockwise seen from the front.

    radius: radius of its round corners (m); points: number of points on each corner."""
    # y, low and high are of the middles of the four corners' circles
    y = section.width / 2 - radius
    low = section.bottom + radius
    high = section.top - radius
    # in the order of the angle: upper left, upper right, lower right, lower left
    middles = ((y, high), (-y, high), (-y, low), (y, low))
    quarter = np.linspace(0, np.pi / 2, points)
    arcs = []
    for k, (middle_y, middle_z) in enumerate(middles):
        turn = k * np.pi / 2 + quarter  # angle from +y towards +z
        arc_y = middle_y + radius * np.cos(turn)
        arc_z = middle_z + radius * np.sin(turn)
        # 0 * turn + x repeats x for every point of the arc
        arcs.append(np.column_stack([0 * turn + section.x, arc_y, arc_z]))
    return np.concatenate(arcs)
