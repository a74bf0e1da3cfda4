"""Islands enclosed by lanes: kerbed, and planted, built on and signed in many ways."""

from __future__ import annotations

import numpy as np
import shapely

from toolkit.sites import furniture as f
from toolkit.sites.site import Solid
from toolkit.sites.street.bulky import BUILT, PLANTED, put_at
from toolkit.sites.street.trees import plant
from toolkit.sites.surroundings import Plot

_SMALLEST = 30.0  # m², of an island on which anything stands


def plant_islands(plot: Plot, rng: np.random.Generator) -> None:
    """Solids on every island of the road that is large enough."""
    for ground in plot.road.islands:
        parts = shapely.get_parts(ground.buffer(-0.3).simplify(0.05).difference(plot.lanes))
        island = max(parts, key=shapely.area, default=shapely.Polygon())
        if island.geom_type != "Polygon" or island.area < _SMALLEST:
            continue
        plot.solids.append(Solid(shapely.get_coordinates(island.exterior)[:-1].round(3), 0.0, 0.15, "island"))
        x, y = (float(c) for c in shapely.get_coordinates(island.centroid)[0])
        _plant(plot, (x, y), float(np.sqrt(island.area / np.pi)), rng)


def _plant(plot: Plot, middle: tuple[float, float], radius: float, rng: np.random.Generator) -> None:
    """What stands on an island of about `radius` (m): something in the middle, rings of hedges, bushes and signs."""
    x, y = middle
    if rng.random() < 0.5:
        size, height = rng.uniform(0.15, 0.4) * radius, round(float(rng.uniform(0.5, 2.5)), 2)
        kind = ("hedge", "wall", "heap", "bush")[rng.integers(4)]
        plot.place([Solid(f.disc(x, y, float(size), 12), 0.0, height, kind)], footway=True)
    for out in np.sort(rng.uniform(0.35, 0.92, rng.integers(0, 4))) * radius:
        _ring(plot, middle, float(out), rng)
    makes = (*PLANTED, *PLANTED, *BUILT)
    for angle in rng.uniform(0, 2 * np.pi, rng.integers(0, 14)):
        at = _beside(middle, radius * rng.uniform(0.2, 0.95), angle)
        plot.place(put_at(makes[rng.integers(len(makes))](rng), *at, float(rng.uniform(0, np.pi))), footway=True)
    for angle in rng.uniform(0, 2 * np.pi, rng.integers(0, 8)):
        low = rng.uniform(1.5, 4.0)
        levels = low, low + rng.uniform(2.0, 5.0)
        plant(
            plot, np.array(_beside(middle, radius * rng.uniform(0.0, 0.9), angle)), rng.uniform(1.0, 3.5), levels, rng
        )
    for angle in rng.uniform(0, 2 * np.pi, rng.integers(0, 6)):
        plot.place(f.sign(*_beside(middle, 0.9 * radius, angle), float(angle)), footway=True)


def _ring(plot: Plot, middle: tuple[float, float], out: float, rng: np.random.Generator) -> None:
    """Pieces of hedge or bushes round the middle, `out` m from it, with gaps."""
    length, width, height = (float(rng.uniform(*between)) for between in ((1.0, 5.0), (0.6, 2.2), (0.5, 1.8)))
    step = (length + rng.uniform(0.1, 4.0)) / out
    turn, kept = rng.uniform(0, 2 * np.pi), rng.uniform(0.4, 1.0)
    is_round = rng.random() < 0.4
    for angle in np.arange(turn, turn + 2 * np.pi - step / 2, step)[:60]:
        at, tall = _beside(middle, out, angle), round(height * float(rng.uniform(0.8, 1.2)), 2)
        if rng.random() > kept:
            continue
        if is_round:
            solid = Solid(f.disc(*at, 0.35 * length, 9), 0.0, tall, ("hedge", "bush")[rng.integers(2)])
        else:
            ends = [_beside(at, k * length / 2, angle + np.pi / 2) for k in (-1, 1)]
            solid = Solid(f.bar(ends[0], ends[1], width), 0.0, tall, "hedge")
        plot.place([solid], footway=True)


def _beside(middle: tuple[float, float], out: float, angle: float) -> tuple[float, float]:
    return float(middle[0] + out * np.cos(angle)), float(middle[1] + out * np.sin(angle))
