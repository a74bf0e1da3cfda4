"""Kinds of cars that are drawn at random."""

from dataclasses import dataclass

from toolkit.bodies.car_body import Profile
from toolkit.mesh import Span


@dataclass(frozen=True)
class CarKind:
    """Kind of car; ranges hold the lowest and the highest value.

    Attributes:
        name: such as `estate`.
        share: share of the kind among all cars, before the shares are made to add up to 1.
        length: range (m).
        width: mean width of the shortest and of the longest car (m).
        height: range (m).
        profile: distance from the front and height of the top, as parts of length and height.
        wheel: range of the radius (m).
        lean: range of the lean of the sides above the belt line, as a part of the half width.
        belt: range of the height of the belt line, as a part of the height.
        clearance: range of the height of the floor (m)."""

    name: str
    share: float
    length: Span
    width: Span
    height: Span
    profile: Profile
    wheel: Span
    lean: Span
    belt: Span = (0.56, 0.66)
    clearance: Span = (0.13, 0.2)
