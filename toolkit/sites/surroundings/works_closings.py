"""Barriers, cones and fences around road works."""

import numpy as np

from toolkit.arrays import Rng
from toolkit.sites import furniture as f
from toolkit.sites.site import Solid


def barrier(length: float, rng: Rng) -> list[Solid]:
    """Barrier of two boards on feet about the origin. length: along x (m)."""
    top = float(rng.uniform(0.9, 1.2))
    foot_top = round(top - 0.62, 2)
    feet = [
        Solid(f.block((0.1, 0.4), (x, 0.0)), 0.0, foot_top, "barrier")
        for x in (-0.4 * length, 0.4 * length)
    ]
    planks = [
        Solid(f.block((length, 0.06)), low, round(low + 0.2, 2), "barrier")
        for low in (round(top - 0.2, 2), round(top - 0.6, 2))
    ]
    return feet + planks


def cone(rng: Rng) -> list[Solid]:
    """Traffic cone at the origin: four discs, one upon the other, smaller upwards."""
    height = float(rng.choice([0.5, 0.75, 1.0]))
    steps = []
    base = 0.0
    for radius, top_share in ((0.19, 0.05), (0.13, 0.4), (0.07, 0.8), (0.04, 1.0)):
        top = round(top_share * height, 3)
        steps.append(Solid(f.disc(0.0, 0.0, radius, 8), base, top, "cone"))
        base = top
    return steps


def beacon(rng: Rng) -> list[Solid]:
    """Guide board on its foot at the origin, facing along x."""
    top = round(float(rng.uniform(1.0, 1.3)), 2)
    return [
        Solid(f.block((0.4, 0.3)), 0.0, 0.12, "cone"),
        Solid(f.block((0.06, 0.25)), 0.12, top, "cone"),
    ]


def concrete(rng: Rng) -> list[Solid]:
    """Piece of a concrete barrier about the origin, 2 m along x, with a wider foot."""
    top = round(float(rng.uniform(0.75, 0.95)), 2)
    return [
        Solid(f.block((2.0, 0.5)), 0.0, 0.3, "barrier"),
        Solid(f.block((2.0, 0.25)), 0.3, top, "barrier"),
    ]


def fence(rng: Rng) -> list[Solid]:
    """Panel of a site fence that can be seen through, about the origin, 2.3 m along x."""
    height = round(float(rng.uniform(1.2, 2.0)), 2)
    bars = [
        Solid(f.disc(x, 0.0, 0.03, 6), 0.0, height, "fence") for x in np.linspace(-1.15, 1.15, 9)
    ]
    feet = [Solid(f.block((0.2, 0.5), (x, 0.0)), 0.0, 0.14, "fence") for x in (-1.15, 1.15)]
    rails = [
        Solid(f.block((2.3, 0.05)), low, round(low + 0.05, 2), "fence")
        for low in (0.2, height - 0.05)
    ]
    return bars + feet + rails
