"""Figures of people: their joints, and meshes built limb by limb from them."""

from dataclasses import dataclass, replace

import numpy as np

from toolkit.mesh import Mesh, Vector, ellipsoid, loft, merge, scale_mesh, tube

Pair = tuple[Vector, Vector]  # left and right


# elbows and hands of people who push something, or hold one hand at an ear; units of a `Figure`
PUSHING_ELBOWS: Pair = ((0.02, 0.14, 0.65), (0.02, -0.14, 0.65))
PUSHING_HANDS: Pair = ((0.20, 0.12, 0.58), (0.20, -0.12, 0.58))
PHONING_ELBOWS: Pair = ((0.08, 0.13, 0.66), (0.10, -0.12, 0.68))
PHONING_HANDS: Pair = ((0.16, 0.05, 0.80), (0.08, -0.07, 0.80))
# sections of the trunk: place from hip (0) to neck (1), radii along x and y
_TRUNK_SECTIONS = (
    (0.0, 0.075, 0.098),
    (0.25, 0.072, 0.092),
    (0.55, 0.076, 0.100),
    (0.85, 0.070, 0.118),
    (1.0, 0.035, 0.050),
)


@dataclass(frozen=True)
class Figure:
    """Joints (x, y, z) of a person 1 unit tall, facing +x, y left, soles near z = 0.

    Attributes:
        hip: middle of the hips.
        neck: foot of the neck.
        knees: left and right.
        ankles: left and right.
        elbows: left and right.
        hands: left and right.
        stout: breadth of trunk and limbs relative to an average adult."""

    hip: Vector = (0.0, 0.0, 0.52)
    neck: Vector = (0.01, 0.0, 0.83)
    knees: Pair = ((0.02, 0.055, 0.28), (0.02, -0.055, 0.28))
    ankles: Pair = ((0.0, 0.06, 0.035), (0.0, -0.06, 0.035))
    elbows: Pair = ((-0.02, 0.145, 0.64), (-0.02, -0.145, 0.64))
    hands: Pair = ((0.03, 0.15, 0.47), (0.03, -0.15, 0.47))
    stout: float = 1.0


def pair(x: float, y: float, z: float) -> Pair:
    """Return a point on the left and its mirror image on the right (y negative)."""
    return (x, y, z), (x, -y, z)


def hold(figure: Figure, elbows: Pair, hands: Pair) -> Figure:
    """Return the figure with other elbows and hands, left and right."""
    return replace(figure, elbows=elbows, hands=hands)


def push(figure: Figure) -> Figure:
    """Return the figure with the arms of a person who pushes something."""
    return hold(figure, elbows=PUSHING_ELBOWS, hands=PUSHING_HANDS)


def phone(figure: Figure) -> Figure:
    """Return the figure with one hand at an ear."""
    return hold(figure, elbows=PHONING_ELBOWS, hands=PHONING_HANDS)


def striding(step: float, swing: float = 0.6, lean: float = 0.02, stout: float = 1.0) -> Figure:
    """Figure in mid-stride.

    step: distance between the ankles, as a part of the height; swing: how far the hands move, as
    a part of the step; lean: x of the neck in front of the hips; stout: breadth of trunk and limbs
    relative to an average adult."""
    sink = 0.18 * step**2
    return Figure(
        hip=(0.0, 0.0, 0.52 - sink),
        neck=(lean, 0.0, 0.83 - sink),
        knees=((0.45 * step + 0.02, 0.05, 0.28), (-0.15 * step, -0.05, 0.27)),
        ankles=((0.5 * step, 0.05, 0.035), (-0.5 * step, -0.05, 0.055)),
        elbows=((-0.25 * swing * step - 0.03, 0.14, 0.64), (0.2 * swing * step, -0.14, 0.64)),
        hands=((-0.5 * swing * step, 0.15, 0.48), (0.6 * swing * step + 0.03, -0.15, 0.50)),
        stout=stout,
    )


def person(figure: Figure, height: float) -> Mesh:
    """Mesh of a figure that is `height` metres tall when standing, soles near z = 0."""
    head = offset_point(figure.neck, 0.012, 0.0, 0.105)
    parts = [
        ellipsoid(head, radii=(0.055, 0.045, 0.066), rings=5, sides=8),
        tube([figure.neck, head], radii=0.032, sides=6),
    ]
    parts.append(_make_trunk(figure))
    parts += _make_limbs(figure, side=0, sign=1)
    parts += _make_limbs(figure, side=1, sign=-1)
    return scale_mesh(merge(parts), height)


def _make_trunk(figure: Figure) -> Mesh:
    """Mesh of chest and belly, between hip and neck, in parts of the person's height."""
    hip = np.array(offset_point(figure.hip, 0.0, 0.0, -0.03))
    spine = np.array(figure.neck) - hip
    rings = []
    # station: 0 at the hip, 1 at the neck; depth, breadth: half axes along x and y
    for station, depth, breadth in _TRUNK_SECTIONS:
        ring = unit_circle() * [depth * figure.stout, breadth * figure.stout, 1]
        rings.append(hip + station * spine + ring)
    return loft(np.stack(rings))


def _make_limbs(figure: Figure, side: int, sign: int) -> list[Mesh]:
    """Meshes of leg, arm, foot and hand of one side.

    All lengths are in parts of the figure's height. side: index of the side in pairs, 0 for left
    and 1 for right; sign: 1 for left, -1 for right."""
    stout = figure.stout
    ankle = figure.ankles[side]
    hand = figure.hands[side]
    hip_joint = offset_point(figure.hip, 0.0, 0.045 * sign, 0.0)
    shoulder = offset_point(figure.neck, -0.01, 0.105 * sign * (0.6 + 0.4 * stout), -0.025)
    leg = [hip_joint, figure.knees[side], ankle]
    arm = [shoulder, figure.elbows[side], hand]
    foot = offset_point(ankle, 0.035, 0.0, -0.015)
    return [
        tube(leg, radii=[0.052 * stout, 0.036 * stout, 0.025], sides=6),
        tube(arm, radii=[0.032 * stout, 0.026 * stout, 0.020], sides=6),
        ellipsoid(foot, radii=(0.075, 0.028, 0.022), rings=3, sides=6),
        ellipsoid(hand, radii=(0.024, 0.018, 0.03), rings=3, sides=5),
    ]


def unit_circle() -> np.ndarray:
    """Ten points on a level circle of radius 1."""
    angle = np.arange(10) * 2 * np.pi / 10
    return np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)


def offset_point(point: Vector, x: float, y: float, z: float) -> Vector:
    """Return the point moved by x, y and z."""
    return point[0] + x, point[1] + y, point[2] + z
