"""Trees, lamp posts, signs, bins, benches and bollards along a road."""

import numpy as np
import shapely
from shapely.ops import substring

from toolkit.arrays import Rng
from toolkit.sites import furniture as f
from toolkit.sites.furniture import BUILT, PLANTED, move_solids
from toolkit.sites.surroundings.places import along
from toolkit.sites.surroundings.plot import Plot
from toolkit.sites.surroundings.street_trees import Draw, plant


def place_bulky(plot: Plot, rng: Rng) -> None:
    """Place up to 29 things about as big as a car: behind the footways, and a few at the kerb.

    The solids go to the plot; things without room are left out."""
    outer_edge = plot.road.surface.buffer(rng.uniform(1.2, 3.5)).boundary
    behind = along(outer_edge.intersection(plot.window), 0.5)
    kerb_edge = plot.road.carriageway.buffer(rng.uniform(0.9, 1.6)).boundary
    kerb = along(kerb_edge.intersection(plot.window), 0.5)
    green = rng.uniform(0.2, 0.8)  # share of planted things
    for at_kerb, rows in ((False, rng.permutation(behind)), (True, rng.permutation(kerb))):
        for x, y, direction in rows[: rng.integers(0, 5 if at_kerb else 26)]:
            makes = PLANTED if rng.random() < green else BUILT
            turn = rng.choice(
                [0.0, np.pi, np.pi / 2, rng.uniform(0.0, np.pi)], p=[0.4, 0.3, 0.15, 0.15]
            )
            thing = makes[rng.integers(len(makes))](rng)
            plot.place(
                move_solids(thing, float(x), float(y), float(direction + turn)), footway=at_kerb
            )


def place_furniture(plot: Plot, rng: Rng) -> None:
    """Place trees, lamp posts, signs, bins, benches and bollards along the road.

    The solids go to the plot; things without room are left out."""
    # x, y, direction every 0.5 m at the kerb, behind the footway, and farther behind it; a row is
    # taken with a chance of 0.5 / spacing, so that things are `spacing` m apart on average
    kerb = along(plot.road.carriageway.buffer(0.5).boundary.intersection(plot.window), 0.5)
    behind = along(plot.road.surface.buffer(0.9).boundary.intersection(plot.window), 0.5)
    deep = along(plot.road.surface.buffer(2.4).boundary.intersection(plot.window), 0.5)
    lamp = rng.uniform(4.5, 9.0)
    crown = rng.uniform(0.9, 2.2)
    tall = rng.uniform(4.0, 10.0)
    for row in deep[rng.random(len(deep)) < 0.5 / rng.uniform(6, 40)]:
        levels = rng.uniform(1.8, 2.8), tall * rng.uniform(0.8, 1.2)
        plant(plot, row[:2], crown * rng.uniform(0.8, 1.2), levels, rng, footway=False)
    # places, whether they may be on a footway, the thing, and its spacing (m)
    lines: tuple[tuple[np.ndarray, bool, Draw, float], ...] = (
        (
            kerb if rng.random() < 0.6 else behind,
            True,
            lambda x, y, _: [f.post(x, y, lamp, 0.09)],
            rng.uniform(14, 30),
        ),
        (kerb, True, lambda x, y, a: f.sign(x, y, a), rng.uniform(20, 60)),
        (kerb, True, lambda x, y, _: [f.post(x, y, 0.9, 0.07)], rng.uniform(10, 80)),
        (behind, False, lambda x, y, _: [f.litter_bin(x, y)], rng.uniform(20, 60)),
        (behind, False, lambda x, y, a: [f.bench(x, y, a)], rng.uniform(30, 90)),
    )
    for rows, footway, draw, spacing in lines:
        for x, y, direction in rows[rng.random(len(rows)) < 0.5 / spacing]:
            plot.place(draw(float(x), float(y), float(direction)), footway=footway)


def place_gardens(plot: Plot, rng: Rng) -> None:
    """Place hedges, walls and fences behind footways, and trees all over the plot.

    The solids go to the plot; those without room are left out."""
    boundary = plot.road.surface.buffer(rng.uniform(0.8, 2.0)).boundary
    edge = boundary.simplify(0.1).intersection(plot.window)
    # one to three of hedge, wall and railing, by their index below
    kinds = rng.permutation(3)[: rng.integers(1, 4)]
    height = rng.uniform(0.9, 2.2)
    for edge_line in shapely.get_parts(shapely.line_merge(edge)):
        at = rng.uniform(0.0, 15.0)
        while at < edge_line.length - 2.0:
            length = rng.uniform(5.0, 18.0)
            stretch = substring(edge_line, at, min(at + length, edge_line.length)).simplify(0.1)
            points = [(float(x), float(y)) for x, y in shapely.get_coordinates(stretch)]
            draw = (f.hedge, f.wall, f.railing)[rng.choice(kinds)]
            for solid in draw(points, round(height, 2)) if len(points) > 1 else ():
                plot.place([solid])
            at += length + rng.uniform(1.0, 25.0)
    xmin, ymin, xmax, ymax = plot.window.bounds
    for x, y in rng.uniform((xmin, ymin), (xmax, ymax), (rng.integers(5, 60), 2)):
        low = rng.uniform(1.2, 3.0)
        radius = rng.uniform(1.2, 2.8)
        levels = low, low + rng.uniform(2.5, 8.0)
        plant(plot, np.array([x, y]), radius, levels, rng, footway=False)
