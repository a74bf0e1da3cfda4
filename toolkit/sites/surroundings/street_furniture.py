"""Trees, lamp posts, signs, bins, benches and bollards along a road."""

import numpy as np
import shapely
from shapely.ops import substring

from toolkit.arrays import Rng
from toolkit.sites import furniture
from toolkit.sites.furniture import (
    Make,
    advertisement,
    bicycles,
    bin_row,
    bus_shelter,
    bushes,
    container,
    heap,
    hedge_block,
    move_solids,
    planter,
    power_box,
    skip,
)
from toolkit.sites.surroundings.places import points_along
from toolkit.sites.surroundings.plot import Plot
from toolkit.sites.surroundings.street_trees import Draw, plant_tree

# functions that draw bulky objects; one that is there twice is chosen twice as often
PLANTED: tuple[Make, ...] = (hedge_block, hedge_block, bushes, bushes, planter)
BUILT: tuple[Make, ...] = (
    power_box,
    container,
    skip,
    bus_shelter,
    bin_row,
    heap,
    advertisement,
    bicycles,
)


def place_bulky_objects(plot: Plot, rng: Rng) -> None:
    """Place objects about as big as a car: up to 25 behind the footways, and 4 at the kerb.

    The solids go to the plot; objects without room are left out."""
    # the order of the draws fixes the random sites; rows: x, y, direction of the edge there
    outer_edge = plot.road.surface.buffer(rng.uniform(1.2, 3.5)).boundary
    outer_rows = points_along(outer_edge.intersection(plot.window), 0.5)
    kerb_edge = plot.road.carriageway.buffer(rng.uniform(0.9, 1.6)).boundary
    kerb_rows = points_along(kerb_edge.intersection(plot.window), 0.5)
    planted_share = rng.uniform(0.2, 0.8)
    outer_rows = rng.permutation(outer_rows)
    kerb_rows = rng.permutation(kerb_rows)
    for rows, at_kerb, max_count in ((outer_rows, False, 25), (kerb_rows, True, 4)):
        for x, y, direction in rows[: rng.integers(0, max_count + 1)]:
            draw_functions = PLANTED if rng.random() < planted_share else BUILT
            # from the edge's direction: along it, backwards, across it, or any turn
            any_turn = rng.uniform(0.0, np.pi)
            turn = rng.choice([0.0, np.pi, np.pi / 2, any_turn], p=[0.4, 0.3, 0.15, 0.15])
            draw_object = draw_functions[rng.integers(len(draw_functions))]
            yaw = float(direction + turn)
            solids = move_solids(draw_object(rng), x=float(x), y=float(y), yaw=yaw)
            plot.place(solids, on_footways=at_kerb)


def place_furniture(plot: Plot, rng: Rng) -> None:
    """Place trees, lamp posts, signs, bins, benches and bollards along the road.

    The solids go to the plot; objects without room are left out."""
    # x, y, direction every 0.5 m at the kerb, behind the footway, and farther behind it; a row is
    # taken with a chance of 0.5 / spacing, so that objects are `spacing` m apart on average
    kerb = points_along(plot.road.carriageway.buffer(0.5).boundary.intersection(plot.window), 0.5)
    behind = points_along(plot.road.surface.buffer(0.9).boundary.intersection(plot.window), 0.5)
    deep = points_along(plot.road.surface.buffer(2.4).boundary.intersection(plot.window), 0.5)
    lamp_height = rng.uniform(4.5, 9.0)
    mean_radius = rng.uniform(0.9, 2.2)  # radius of the crowns of trees
    mean_height = rng.uniform(4.0, 10.0)  # height of trees
    for row in deep[rng.random(len(deep)) < 0.5 / rng.uniform(6, 40)]:
        levels = rng.uniform(1.8, 2.8), mean_height * rng.uniform(0.8, 1.2)
        radius = mean_radius * rng.uniform(0.8, 1.2)
        plant_tree(plot, foot=row[:2], radius=radius, levels=levels, rng=rng, on_footways=False)
    # places, whether they may be on a footway, the object, and its spacing (m)
    lines: tuple[tuple[np.ndarray, bool, Draw, float], ...] = (
        (
            kerb if rng.random() < 0.6 else behind,
            True,
            lambda x, y, _: [furniture.post(x, y, height=lamp_height, radius=0.09)],
            rng.uniform(14, 30),
        ),
        (kerb, True, lambda x, y, a: furniture.sign(x, y, facing=a), rng.uniform(20, 60)),
        (
            kerb,
            True,
            lambda x, y, _: [furniture.post(x, y, height=0.9, radius=0.07)],
            rng.uniform(10, 80),
        ),
        (behind, False, lambda x, y, _: [furniture.litter_bin(x, y)], rng.uniform(20, 60)),
        (behind, False, lambda x, y, a: [furniture.bench(x, y, along=a)], rng.uniform(30, 90)),
    )
    for rows, on_footways, draw, spacing in lines:
        for x, y, direction in rows[rng.random(len(rows)) < 0.5 / spacing]:
            plot.place(draw(float(x), float(y), float(direction)), on_footways=on_footways)


def place_gardens(plot: Plot, rng: Rng) -> None:
    """Place hedges, walls and fences behind footways, and trees all over the plot.

    The solids go to the plot; solids without room are left out."""
    boundary = plot.road.surface.buffer(rng.uniform(0.8, 2.0)).boundary
    edge = boundary.simplify(0.1).intersection(plot.window)
    # one to three of hedge, wall and railing, by their index in `enclosures`
    kinds = rng.permutation(3)[: rng.integers(1, 4)]
    enclosures = (furniture.hedge, furniture.wall, furniture.railing)
    height = rng.uniform(0.9, 2.2)
    for edge_line in shapely.get_parts(shapely.line_merge(edge)):
        start = rng.uniform(0.0, 15.0)  # start of a hedge, wall or railing (m along the line)
        while start < edge_line.length - 2.0:
            length = rng.uniform(5.0, 18.0)
            end = min(start + length, edge_line.length)
            stretch = substring(edge_line, start, end).simplify(0.1)
            points = [(float(x), float(y)) for x, y in shapely.get_coordinates(stretch)]
            enclose = enclosures[rng.choice(kinds)]
            solids = enclose(points, round(height, 2)) if len(points) > 1 else []
            # one by one, so that a solid without room does not keep away the others
            for solid in solids:
                plot.place([solid])
            start += length + rng.uniform(1.0, 25.0)
    _scatter_trees(plot, rng)


def _scatter_trees(plot: Plot, rng: Rng) -> None:
    """Plant up to 59 trees anywhere on the plot off the road, those with room for their trunk."""
    xmin, ymin, xmax, ymax = plot.window.bounds
    feet = rng.uniform((xmin, ymin), (xmax, ymax), (rng.integers(5, 60), 2))  # rows x, y
    for foot in feet:
        crown_base = rng.uniform(1.2, 3.0)
        crown_radius = rng.uniform(1.2, 2.8)
        levels = (crown_base, crown_base + rng.uniform(2.5, 8.0))  # bottom and top of the crown
        plant_tree(plot, foot=foot, radius=crown_radius, levels=levels, rng=rng, on_footways=False)
