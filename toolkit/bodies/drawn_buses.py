"""Buses drawn at random: minibuses, city buses, coaches and bendy buses."""

import numpy as np

from toolkit.arrays import Rng
from toolkit.bodies.mesh_parts import DrawnMesh, plank
from toolkit.bodies.shells import ShellSection, loft_shell
from toolkit.bodies.wheels import make_axles
from toolkit.mesh import Mesh, box, flip_sides, merge

BUSES = ("minibus", "bus", "bendy_bus")
BENDY_SHARE = 0.18
DOUBLE_DECKER_SHARE = 0.05
MAX_MINIBUS_LENGTH_M = 8.0


def draw_bus(rng: Rng) -> DrawnMesh:
    """Draw a minibus, city bus, coach, or bendy bus with its bellows.

    x forward from the middle, z = 0 on the ground; lengths in m. A few are double deckers."""
    is_bendy = rng.random() < BENDY_SHARE
    length = _draw_length(is_bendy, rng)
    # both grow with the length, from the shortest bus of 6.2 m on
    width = float(np.clip(2.05 + 0.085 * (length - 6.2) + rng.normal(0, 0.06), 2.0, 2.58))
    height = float(np.clip(2.65 + 0.1 * (length - 6.2) + rng.uniform(-0.15, 0.5), 2.55, 3.85))
    if rng.random() < DOUBLE_DECKER_SHARE:
        height = float(rng.uniform(4.0, 4.4))
    front = length / 2
    bottom = float(rng.uniform(0.25, 0.4))
    sections = _draw_sections(length, width, height, bottom, rng)
    if is_bendy:  # between the third section from the rear and the fourth
        sections[3:3] = _make_bellows(length, width, height, bottom)
    parts = [loft_shell(sections, corner=0.06, points=2)]  # corners rounded by 2 points each
    # up to two air conditioners on the roof, at shares of the way from the middle to an end
    for end_share in rng.uniform(-0.6, 0.7, int(rng.integers(0, 3))).tolist():
        cooler_size = (float(rng.uniform(1.2, 2.6)), 0.65 * width, float(rng.uniform(0.15, 0.35)))
        parts.append(plank(cooler_size, x=end_share * (front - 1.5), y=0.0, z=height - 0.03))
    wheel_radius = float(np.clip(0.03 * length + 0.12, 0.34, 0.5))
    front_overhang = float(rng.uniform(0.16, 0.24)) * min(length, 12.0)
    rear_overhang = float(rng.uniform(0.22, 0.3)) * min(length, 12.0)
    axles = [front - front_overhang, -front + rear_overhang]
    if is_bendy:
        # one more, a little ahead of the middle
        axles.append(0.08 * length)
    mirror = _draw_mirror(front, width, bottom + 0.6 * (height - bottom), rng)
    short_kind = "minibus" if length < MAX_MINIBUS_LENGTH_M else "bus"
    wheels = make_axles(axles, width=width - 0.04, radius=wheel_radius, sides=12)
    return DrawnMesh(
        "bendy_bus" if is_bendy else short_kind,
        merge([*parts, *wheels]),
        outside=merge([mirror, flip_sides(mirror)]),
    )


def _draw_length(is_bendy: bool, rng: Rng) -> float:
    """Draw the length (m) of a bus. is_bendy: True for a bendy bus."""
    if is_bendy:
        return float(rng.uniform(16.5, 18.5))
    short = rng.uniform(6.2, 9.0)
    long = rng.uniform(9.0, 13.5)
    return float(rng.choice([short, long]))


def _draw_sections(
    length: float, width: float, height: float, bottom: float, rng: Rng
) -> list[ShellSection]:
    """Draw the sections of a bus's body, from the rear to the front.

    bottom: height of its lower edge; all lengths in m."""
    front = length / 2
    rear = -front
    # how much lower the roof is at the rear, and how far the windscreen leans back
    roof_radius = float(rng.uniform(0.04, 0.3))
    rake = float(rng.uniform(0.05, 0.5))
    return [  # x, width, bottom and top of each (m)
        ShellSection(x=rear, width=0.94 * width, bottom=bottom + 0.08, top=height - roof_radius),
        ShellSection(x=rear + 0.15, width=width, bottom=bottom, top=height - 0.03),
        ShellSection(x=rear + 0.5, width=width, bottom=bottom, top=height),
        ShellSection(x=front - rake - 0.3, width=width, bottom=bottom, top=height),
        ShellSection(x=front - 0.5 * rake, width=width * 0.99, bottom=bottom, top=height - 0.35),
        ShellSection(
            x=front, width=0.92 * width, bottom=bottom + 0.05, top=bottom + 0.55 * (height - bottom)
        ),
    ]


def _make_bellows(length: float, width: float, height: float, bottom: float) -> list[ShellSection]:
    """Sections of the bellows of a bendy bus, narrower and lower than its body.

    bottom: height of the body's lower edge; all lengths in m."""
    joint = -0.05 * length  # x of the middle of the bellows
    return [  # x, width, bottom and top of each (m)
        ShellSection(x=joint - 0.7, width=width, bottom=bottom, top=height),
        ShellSection(x=joint - 0.65, width=0.9 * width, bottom=bottom + 0.1, top=height - 0.12),
        ShellSection(x=joint + 0.65, width=0.9 * width, bottom=bottom + 0.1, top=height - 0.12),
        ShellSection(x=joint + 0.7, width=width, bottom=bottom, top=height),
    ]


def _draw_mirror(front: float, width: float, z: float, rng: Rng) -> Mesh:
    """Draw the left wing mirror of a bus.

    front: x of the bus's front end; width: its width; z: height of the mirror's middle (all m)."""
    mirror_height = float(rng.uniform(0.25, 0.45))
    overhang = float(rng.uniform(0.12, 0.28))
    x = front + float(rng.uniform(-0.3, -0.1))
    # the body narrows towards its front, so its side is not at half its width there
    side_y = 0.48 * width
    # 3 cm more than the overhang at either end, so that the mirror reaches into the body
    size = (0.14, overhang + 0.06, mirror_height)
    return box(size, centre=(x, side_y + overhang / 2, z))
