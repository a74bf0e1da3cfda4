"""Barriers, cones and fences around road works."""

import numpy as np

from toolkit.arrays import Rng
from toolkit.sites import furniture
from toolkit.sites.site import Solid


def barrier(length: float, rng: Rng) -> list[Solid]:
    """Draw a barrier of two boards, one above the other, on feet about the origin.

    length: along x (m)."""
    top = float(rng.uniform(0.9, 1.2))
    foot_top = round(top - 0.62, 2)  # just below the lower board
    feet = [
        Solid(furniture.block((0.1, 0.4), middle=(x, 0.0)), base=0.0, top=foot_top, kind="barrier")
        for x in (-0.4 * length, 0.4 * length)
    ]
    planks = [
        Solid(furniture.block((length, 0.06)), base=base, top=round(base + 0.2, 2), kind="barrier")
        for base in (round(top - 0.2, 2), round(top - 0.6, 2))
    ]
    return feet + planks


def cone(rng: Rng) -> list[Solid]:
    """Draw a traffic cone at the origin: four discs, one upon the other, smaller upwards."""
    height = float(rng.choice([0.5, 0.75, 1.0]))
    layers = []
    base = 0.0
    # radius (m) of a disc, and share of the height at its top
    for radius, top_share in ((0.19, 0.05), (0.13, 0.4), (0.07, 0.8), (0.04, 1.0)):
        top = round(top_share * height, 3)
        outline = furniture.disc(0.0, 0.0, radius, corners=8)
        layers.append(Solid(outline, base=base, top=top, kind="cone"))
        base = top
    return layers


def beacon(rng: Rng) -> list[Solid]:
    """Draw a guide board on its foot at the origin, facing along x."""
    top = round(float(rng.uniform(1.0, 1.3)), 2)
    return [
        Solid(furniture.block((0.4, 0.3)), base=0.0, top=0.12, kind="cone"),
        Solid(furniture.block((0.06, 0.25)), base=0.12, top=top, kind="cone"),
    ]


def concrete(rng: Rng) -> list[Solid]:
    """Draw a piece of a concrete barrier about the origin, 2 m along x, with a wider foot."""
    top = round(float(rng.uniform(0.75, 0.95)), 2)
    return [
        Solid(furniture.block((2.0, 0.5)), base=0.0, top=0.3, kind="barrier"),
        Solid(furniture.block((2.0, 0.25)), base=0.3, top=top, kind="barrier"),
    ]


def fence(rng: Rng) -> list[Solid]:
    """Draw a panel of a site fence with gaps to see through, about the origin, 2.3 m along x."""
    height = round(float(rng.uniform(1.2, 2.0)), 2)
    bars = [
        Solid(furniture.disc(x, 0.0, 0.03, corners=6), base=0.0, top=height, kind="fence")
        for x in np.linspace(-1.15, 1.15, 9)
    ]
    feet = [
        Solid(furniture.block((0.2, 0.5), middle=(x, 0.0)), base=0.0, top=0.14, kind="fence")
        for x in (-1.15, 1.15)
    ]
    rails = [
        Solid(furniture.block((2.3, 0.05)), base=base, top=round(base + 0.05, 2), kind="fence")
        for base in (0.2, height - 0.05)
    ]
    return bars + feet + rails
