"""Things about as big as a car that are none: hedges, bushes, planters, cabinets, containers, skips, shelters, heaps.

What a detector reports for a car where nobody drives or parks; a drawn street is to hold plenty of it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from toolkit.sites import furniture as f
from toolkit.sites.site import Solid

Make = Callable[[np.random.Generator], list[Solid]]  # about the origin, lengthwise along x


def put_at(solids: list[Solid], x: float, y: float, yaw: float) -> list[Solid]:
    """The solids turned by `yaw` (rad) about the origin, then put at (x, y); footprints on millimetres."""
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    return [Solid(np.round(s.footprint @ turn + [x, y], 3), s.base, s.top, s.kind) for s in solids]


def _size(rng: np.random.Generator, *ranges: tuple[float, float]) -> tuple[float, ...]:
    return tuple(round(float(rng.uniform(*between)), 2) for between in ranges)


def hedge_block(rng: np.random.Generator) -> list[Solid]:
    """A clipped hedge, up to the size of a van."""
    length, width, height = _size(rng, (1.5, 5.5), (0.6, 2.3), (0.6, 2.2))
    return [Solid(f.block((length, width)), 0.0, height, "hedge")]


def bushes(rng: np.random.Generator) -> list[Solid]:
    """One to five bushes in a row, grown together."""
    radius, number = float(rng.uniform(0.4, 1.2)), int(rng.integers(1, 6))
    made = []
    for k in range(number):
        size, height = _size(rng, (0.8 * radius, 1.2 * radius), (0.6, 2.0))
        middle = (k - (number - 1) / 2) * 1.3 * radius
        made.append(Solid(f.disc(middle, float(rng.normal(0.0, 0.15)), size, 9), 0.0, height, "bush"))
    return made


def planter(rng: np.random.Generator) -> list[Solid]:
    """A tub of stone with something green in it."""
    length, width, height, green = _size(rng, (0.8, 3.0), (0.6, 1.4), (0.4, 0.9), (0.2, 0.9))
    grown = Solid(f.block((0.8 * length, 0.8 * width)), height, round(height + green, 2), "bush")
    return [Solid(f.block((length, width)), 0.0, height, "planter"), grown]


def cabinet(rng: np.random.Generator) -> list[Solid]:
    """A power or telephone box."""
    length, width, height = _size(rng, (0.6, 2.4), (0.35, 1.2), (0.9, 2.3))
    return [Solid(f.block((length, width)), 0.0, height, "cabinet")]


def container(rng: np.random.Generator) -> list[Solid]:
    """A freight, site or recycling container."""
    length = float(rng.choice([1.8, 2.4, 3.0, 4.5, 6.06]))
    width, height = _size(rng, (1.5, 2.5), (1.4, 2.7))
    return [Solid(f.block((length, width)), 0.0, height, "container")]


def skip(rng: np.random.Generator) -> list[Solid]:
    """An open skip, narrower at its foot, more or less full."""
    length, width, height, full = _size(rng, (2.8, 4.8), (1.6, 2.1), (1.0, 1.7), (0.4, 1.15))
    middle = round(0.45 * height, 2)
    walls = [((0.0, side * (width - 0.12) / 2), (length, 0.12)) for side in (-1, 1)]
    walls += [((side * (length - 0.12) / 2, 0.0), (0.12, width - 0.24)) for side in (-1, 1)]
    return [
        Solid(f.block((0.65 * length, 0.9 * width)), 0.0, middle, "container"),
        *(Solid(f.block(size, at), middle, height, "container") for at, size in walls),
        Solid(f.block((0.8 * length, 0.7 * width)), middle, round(middle + full * (height - middle), 2), "container"),
    ]


def bus_shelter(rng: np.random.Generator) -> list[Solid]:
    """A bus shelter, open along one side."""
    length, width = _size(rng, (2.5, 6.0), (1.2, 2.0))
    return f.shelter(-length / 2, -width / 2, length / 2, width / 2)


def bins(rng: np.random.Generator) -> list[Solid]:
    """One to five large bins side by side."""
    number = int(rng.integers(1, 6))
    length, width, height = _size(rng, (0.6, 1.4), (0.7, 1.1), (1.0, 1.5))
    at = (np.arange(number) - (number - 1) / 2) * (length + 0.12)
    return [Solid(f.block((length, width), (float(x), 0.0)), 0.0, height, "bin") for x in at]


def heap(rng: np.random.Generator) -> list[Solid]:
    """Earth or gravel, steep and rough."""
    radius, height = _size(rng, (0.8, 2.0), (0.6, 1.8))
    rings = [(1.0, 0.0, 0.35), (0.75, 0.35, 0.6), (0.5, 0.6, 0.82), (0.25, 0.82, 1.0)]
    return [
        Solid(f.disc(0.0, 0.0, round(part * radius, 3), 9), round(low * height, 2), round(high * height, 2), "heap")
        for part, low, high in rings
    ]


def column(rng: np.random.Generator) -> list[Solid]:
    """An advertising column or a board on feet."""
    radius, height, length = _size(rng, (0.5, 0.8), (2.4, 3.6), (1.2, 3.6))
    if rng.random() < 0.5:
        return [Solid(f.disc(0.0, 0.0, radius, 12), 0.0, height, "sign")]
    feet = [f.post(side * 0.4 * length, 0.0, 0.7, 0.06) for side in (-1, 1)]
    return [*feet, Solid(f.block((length, 0.15)), 0.7, height - 0.4, "sign")]


def digger(rng: np.random.Generator) -> list[Solid]:
    """A digger: tracks, a house with a cab, and an arm in front."""
    length, width, height, swing = _size(rng, (2.0, 3.6), (1.4, 2.3), (2.2, 2.9), (-0.4, 0.4))
    track, deck = round(0.2 * height, 2), round(0.55 * height, 2)
    sides = [Solid(f.block((length, 0.22 * width), (0.0, k * 0.39 * width)), 0.0, track, "machine") for k in (-1, 1)]
    house = Solid(f.block((0.8 * length, 0.9 * width), (-0.1 * length, 0.0)), track, deck, "machine")
    cab = Solid(f.block((0.4 * length, 0.45 * width), (0.05 * length, 0.2 * width)), deck, height, "machine")
    boom = Solid(f.block((0.45 * length, 0.3), (0.5 * length, swing / 2)), round(0.6 * deck, 2), height, "machine")
    stick = Solid(f.block((0.3, 0.35), (0.8 * length, swing)), 0.0, round(0.9 * height, 2), "machine")
    return [*sides, house, cab, boom, stick]


PLANTED: tuple[Make, ...] = (hedge_block, hedge_block, bushes, bushes, planter)
BUILT: tuple[Make, ...] = (cabinet, container, skip, bus_shelter, bins, heap, column)
