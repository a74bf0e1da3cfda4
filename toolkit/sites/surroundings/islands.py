"""Kerbed islands in a road, planted and signed."""

import numpy as np
import shapely

from toolkit.arrays import Rng
from toolkit.sites import furniture as f
from toolkit.sites.furniture import BUILT, PLANTED, move_solids
from toolkit.sites.site import Solid
from toolkit.sites.surroundings.plot import Plot
from toolkit.sites.surroundings.street_trees import plant

_MIN_ISLAND_M2 = 30.0  # of an island with solids on it


def plant_islands(plot: Plot, rng: Rng) -> None:
    """Put a centre piece, rings of hedges, things, trees and signs on every large enough island.

    The solids go to the plot, on the ground that the road encloses: a kerbed slab 0.15 m high, and
    the others if there is room for them."""
    for ground in plot.road.islands:
        parts = shapely.get_parts(ground.buffer(-0.3).simplify(0.05).difference(plot.lanes))
        island = max(parts, key=shapely.area, default=shapely.Polygon())
        if island.geom_type != "Polygon" or island.area < _MIN_ISLAND_M2:
            continue
        plot.solids.append(
            Solid(shapely.get_coordinates(island.exterior)[:-1].round(3), 0.0, 0.15, "island")
        )
        x, y = shapely.get_coordinates(island.centroid)[0].tolist()
        middle = (x, y)
        radius = float(np.sqrt(island.area / np.pi))  # m, of a disc as large as the island
        if rng.random() < 0.5:
            size = rng.uniform(0.15, 0.4) * radius
            height = round(float(rng.uniform(0.5, 2.5)), 2)
            kind = ("hedge", "wall", "heap", "bush")[rng.integers(4)]
            plot.place([Solid(f.disc(x, y, float(size), 12), 0.0, height, kind)], footway=True)
        for out in np.sort(rng.uniform(0.35, 0.92, rng.integers(0, 4))) * radius:
            _ring(plot, middle, float(out), rng)
        makes = PLANTED + PLANTED + BUILT
        for angle in rng.uniform(0, 2 * np.pi, rng.integers(0, 14)):
            at = _around(middle, radius * rng.uniform(0.2, 0.95), angle)
            thing = makes[rng.integers(len(makes))](rng)
            plot.place(move_solids(thing, *at, float(rng.uniform(0, np.pi))), footway=True)
        for angle in rng.uniform(0, 2 * np.pi, rng.integers(0, 8)):
            low = rng.uniform(1.5, 4.0)
            levels = low, low + rng.uniform(2.0, 5.0)
            foot = np.array(_around(middle, radius * rng.uniform(0.0, 0.9), angle))
            plant(plot, foot, rng.uniform(1.0, 3.5), levels, rng)
        for angle in rng.uniform(0, 2 * np.pi, rng.integers(0, 6)):
            plot.place(f.sign(*_around(middle, 0.9 * radius, angle), float(angle)), footway=True)


def _ring(plot: Plot, middle: tuple[float, float], ring_radius: float, rng: Rng) -> None:
    """Place hedges or bushes of about one size in a ring with gaps.

    middle: x, y of the ring; ring_radius: m."""
    length = float(rng.uniform(1.0, 5.0))
    width = float(rng.uniform(0.6, 2.2))
    height = float(rng.uniform(0.5, 1.8))
    # rad from one to the next
    step = (length + rng.uniform(0.1, 4.0)) / ring_radius
    turn = rng.uniform(0, 2 * np.pi)
    placed_share = rng.uniform(0.4, 1.0)
    is_round = rng.random() < 0.4
    # at most 60 hedges
    for angle in np.arange(turn, turn + 2 * np.pi - step / 2, step)[:60]:
        at = _around(middle, ring_radius, angle)
        tall = round(height * float(rng.uniform(0.8, 1.2)), 2)
        if rng.random() > placed_share:
            continue
        shape = f.block((length, width), at, angle + np.pi / 2)
        kind = "hedge"
        if is_round:
            shape = f.disc(*at, 0.35 * length, 9)
            kind = ("hedge", "bush")[rng.integers(2)]
        plot.place([Solid(shape, 0.0, tall, kind)], footway=True)


def _around(middle: tuple[float, float], out: float, angle: float) -> tuple[float, float]:
    """Point x, y that is `out` m from a middle in a direction (rad from +x)."""
    return float(middle[0] + out * np.cos(angle)), float(middle[1] + out * np.sin(angle))
