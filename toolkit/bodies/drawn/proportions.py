"""Proportions of cars: length, width, height and side profile, drawn for a kind of car.

Within a kind the length is drawn first; width and height follow it on average with a spread of their own of a
decimetre and more, so that the length of a car does not tell its width. Over all kinds lengths are 3.0 to 6.0 m, widths
1.45 to 2.2 m and heights 1.25 to 2.6 m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Float64

LENGTHS, WIDTHS, HEIGHTS = (3.0, 6.0), (1.45, 2.2), (1.25, 2.6)  # m, of the body without mirrors and roof loads
_GRID = np.linspace(0, 1, 61)  # of profiles, 0 front to 1 rear

Point = tuple[float | int, float | int]


@dataclass(frozen=True)
class Kind:
    """A kind of car. share: of all cars; length, height: m, from .. to; width: m, at the shortest and the longest;
    profile: distance from the front and height of the body's top, as parts of length and height; wheel: radius (m),
    from .. to; lean: of the sides above the belt, from .. to, as parts of the half width."""

    name: str
    share: float
    length: tuple[float, float]
    width: tuple[float, float]
    height: tuple[float, float]
    profile: tuple[Point, ...]
    wheel: tuple[float, float]
    lean: tuple[float, float]
    belt: tuple[float, float] = (0.56, 0.66)
    clearance: tuple[float, float] = (0.13, 0.2)


KINDS = (
    Kind(
        "kei", 0.07, (3.0, 3.5), (1.45, 1.56), (1.45, 1.95),
        ((0, 0.34), (0.02, 0.44), (0.15, 0.53), (0.3, 0.96), (0.42, 1), (0.93, 0.985), (0.985, 0.66), (1, 0.42)),
        (0.25, 0.3), (0.05, 0.14), (0.5, 0.6),
    ),
    Kind(
        "city", 0.09, (3.1, 3.8), (1.5, 1.72), (1.4, 1.62),
        ((0, 0.36), (0.02, 0.46), (0.22, 0.61), (0.41, 0.965), (0.55, 1), (0.87, 0.955), (0.97, 0.62), (1, 0.48)),
        (0.27, 0.31), (0.14, 0.24),
    ),
    Kind(
        "hatchback", 0.16, (3.75, 4.5), (1.66, 1.86), (1.4, 1.6),
        ((0, 0.38), (0.02, 0.47), (0.24, 0.62), (0.43, 0.965), (0.56, 1), (0.85, 0.955), (0.965, 0.62), (1, 0.5)),
        (0.29, 0.34), (0.16, 0.27),
    ),
    Kind(
        "sedan", 0.14, (4.1, 5.3), (1.66, 1.94), (1.36, 1.55),
        ((0, 0.38), (0.02, 0.48), (0.27, 0.63), (0.42, 0.965), (0.53, 1), (0.68, 0.955), (0.85, 0.7), (0.98, 0.66),
         (1, 0.5)),
        (0.3, 0.36), (0.17, 0.28),
    ),
    Kind(
        "estate", 0.09, (4.2, 5.05), (1.68, 1.92), (1.4, 1.58),
        ((0, 0.38), (0.02, 0.48), (0.26, 0.63), (0.4, 0.965), (0.52, 1), (0.9, 0.95), (0.985, 0.63), (1, 0.48)),
        (0.3, 0.35), (0.14, 0.24),
    ),
    Kind(
        "suv", 0.16, (3.9, 5.2), (1.72, 2.03), (1.5, 1.95),
        ((0, 0.42), (0.015, 0.54), (0.24, 0.64), (0.37, 0.965), (0.48, 1), (0.89, 0.96), (0.975, 0.62), (1, 0.5)),
        (0.33, 0.41), (0.13, 0.25), (0.57, 0.67), (0.17, 0.25),
    ),
    Kind(
        "offroader", 0.04, (3.4, 5.0), (1.62, 2.0), (1.65, 2.1),
        ((0, 0.44), (0.01, 0.58), (0.27, 0.63), (0.335, 0.97), (0.4, 1), (0.96, 0.985), (0.985, 0.8), (1, 0.4)),
        (0.35, 0.44), (0.03, 0.12), (0.56, 0.63), (0.2, 0.3),
    ),
    Kind(
        "minivan", 0.07, (4.0, 5.3), (1.7, 2.0), (1.58, 1.95),
        ((0, 0.36), (0.02, 0.45), (0.16, 0.57), (0.35, 0.96), (0.48, 1), (0.91, 0.965), (0.98, 0.6), (1, 0.46)),
        (0.3, 0.35), (0.1, 0.2), (0.52, 0.6),
    ),
    Kind(
        "van", 0.08, (4.3, 6.0), (1.75, 2.14), (1.78, 2.6),
        ((0, 0.3), (0.015, 0.42), (0.1, 0.53), (0.24, 0.955), (0.33, 1), (0.975, 0.985), (0.99, 0.7), (1, 0.4)),
        (0.31, 0.37), (0.03, 0.13), (0.46, 0.58),
    ),
    Kind(
        "pickup", 0.05, (4.6, 6.0), (1.7, 2.12), (1.6, 2.02),
        ((0, 0.46), (0.015, 0.58), (0.23, 0.655), (0.34, 0.97), (0.44, 1), (0.555, 0.97), (0.61, 0.62), (0.985, 0.61),
         (1, 0.5)),
        (0.34, 0.43), (0.1, 0.2), (0.58, 0.65), (0.2, 0.3),
    ),
    Kind(
        "coupe", 0.05, (3.6, 4.9), (1.64, 2.0), (1.25, 1.42),
        ((0, 0.36), (0.03, 0.48), (0.34, 0.7), (0.5, 0.975), (0.56, 1), (0.66, 0.965), (0.9, 0.74), (0.985, 0.71),
         (1, 0.52)),
        (0.3, 0.36), (0.22, 0.34), (0.6, 0.68), (0.1, 0.15),
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Proportions:
    """One car; lengths in metres, belt, lean, rounding and ends as parts of height, half width, length and width.

    profile: (k, 2) as in `Kind`; axles: distances from the front; rounding: depth of the plan's corners, front, rear;
    ends: width of the very front and rear; bow: how far screens bulge forward in plan; camber: of the roof (m).
    """

    kind: str
    length: float
    width: float
    height: float
    profile: Float64[np.ndarray, "k 2"]
    axles: tuple[float, float]
    wheel: float
    clearance: float
    belt: float
    lean: float
    rounding: tuple[float, float]
    ends: tuple[float, float]
    bow: float
    camber: float
    soft: float  # half the length over which the profile is smoothed, as a part of the length

    def top(self, s: float | Float64[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n"]:
        """Height of the profile (m) at station s, 0 front to 1 rear."""
        return self.height * np.interp(s, self.profile[:, 0], self.profile[:, 1])


def drawn_proportions(rng: np.random.Generator) -> Proportions:
    """The proportions of a car of any kind."""
    kind = KINDS[int(rng.choice(len(KINDS), p=np.array([each.share for each in KINDS]) / _TOTAL))]
    along = rng.uniform()
    length = float(np.interp(along, (0, 1), kind.length))
    width = np.interp(0.6 * along + 0.4 * rng.uniform(), (0, 1), kind.width) + 0.085 * np.clip(
        rng.standard_normal(), -2, 2
    )
    height = np.interp(0.75 * rng.uniform() + 0.25 * along, (0, 1), kind.height)
    profile = _profile(kind, rng)
    wheel = float(rng.uniform(*kind.wheel))
    front = float(wheel + rng.uniform(0.32, 0.6) * min(1.0, length / 4.3))
    rear = float(wheel + rng.uniform(0.22, 0.75 if kind.name not in ("van", "pickup") else 1.0) * length / 4.6)
    while length - front - rear < 0.5 * length:  # cars of any length stand on a wheelbase of half of it and more
        front, rear = wheel + 0.8 * (front - wheel), wheel + 0.8 * (rear - wheel)
    return Proportions(
        kind.name, length, float(np.clip(width, *WIDTHS)), float(np.clip(height, *HEIGHTS)), profile,
        (front, length - rear), wheel, float(rng.uniform(*kind.clearance)), float(rng.uniform(*kind.belt)),
        float(rng.uniform(*kind.lean)),
        (float(rng.uniform(0.03, 0.2)), float(rng.uniform(0.02, 0.15))),
        (float(rng.uniform(0.5, 0.88)), float(rng.uniform(0.6, 0.95))),
        float(rng.uniform(0.0, 0.05)), float(rng.uniform(0.015, 0.06)), float(rng.uniform(0.004, 0.03)),
    )  # fmt: skip


def _profile(kind: Kind, rng: np.random.Generator) -> Float64[np.ndarray, "k 2"]:
    """The kind's side profile with its corners moved, and a little of another kind's mixed in; its top is 1."""
    own, other = _moved(kind.profile, rng), _moved(KINDS[int(rng.integers(len(KINDS)))].profile, rng)
    share = float(np.clip(rng.exponential(0.06), 0, 0.2)) if kind.name != "pickup" else 0.0
    stations = np.unique(np.concatenate([own[:, 0], _GRID]))
    heights = (1 - share) * np.interp(stations, *own.T) + share * np.interp(stations, *other.T)
    return np.column_stack([stations, heights / heights.max()])


def _moved(profile: tuple[Point, ...], rng: np.random.Generator) -> Float64[np.ndarray, "k 2"]:
    corners = np.array(profile)
    corners[2:-2, 0] += rng.normal(0, 0.012) + rng.normal(0, 0.012, len(corners) - 4)
    corners[:, 1] += np.clip(rng.normal(0, 0.02, len(corners)), -0.04, 0.04) * (corners[:, 1] < 0.93)
    corners[1:-1, 0] = np.clip(corners[1:-1, 0], 0.004, 0.996)
    return corners[np.argsort(corners[:, 0], kind="stable")]


_TOTAL = sum(each.share for each in KINDS)
