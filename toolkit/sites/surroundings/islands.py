"""Kerbed islands in a road, planted and signed."""

import numpy as np
import shapely

from toolkit.arrays import Rng
from toolkit.sites import furniture
from toolkit.sites.furniture import move_solids
from toolkit.sites.site import Solid
from toolkit.sites.surroundings.plot import Plot
from toolkit.sites.surroundings.street_furniture import BUILT, PLANTED
from toolkit.sites.surroundings.street_trees import plant_tree

_MIN_ISLAND_M2 = 30.0  # for an island with solids on it
_MAX_RING_HEDGES = 60


def plant_islands(plot: Plot, rng: Rng) -> None:
    """Put a centre piece, rings of hedges, objects, trees and signs on every large enough island.

    The solids go to the plot, on the ground that the road encloses: a kerbed slab 0.15 m high, and
    the others if there is room for them."""
    for ground in plot.road.islands:
        shrunk_ground = ground.buffer(-0.3).simplify(0.05)  # a gap remains to the road
        parts = shapely.get_parts(shrunk_ground.difference(plot.lane_ground))
        island = max(parts, key=shapely.area, default=shapely.Polygon())
        if island.geom_type != "Polygon" or island.area < _MIN_ISLAND_M2:
            continue
        corners = shapely.get_coordinates(island.exterior)[:-1].round(3)  # the last is the first
        plot.solids.append(Solid(corners, base=0.0, top=0.15, kind="island"))
        middle = (island.centroid.x, island.centroid.y)
        radius = float(np.sqrt(island.area / np.pi))  # m, of a disc as large as the island
        _fill_island(plot, middle=middle, radius=radius, rng=rng)


def _fill_island(plot: Plot, middle: furniture.Point, radius: float, rng: Rng) -> None:
    """Place solids on an island: a centre piece, rings of hedges, objects, trees and signs.

    The solids go to the plot if there is room for them. middle, radius: x, y and radius (m) of a
    disc as large as the island."""
    # the order of the draws fixes the random sites; angles are in rad from +x
    if rng.random() < 0.5:
        _place_centre_piece(plot, middle, radius, rng)
    for ring_radius in np.sort(rng.uniform(0.35, 0.92, rng.integers(0, 4))) * radius:
        _place_ring(plot, middle, float(ring_radius), rng)
    # functions that draw objects; twice: planted objects are the likelier choice
    draw_functions = PLANTED + PLANTED + BUILT
    for angle in rng.uniform(0, 2 * np.pi, rng.integers(0, 14)):
        x, y = _point_around(middle, radius * rng.uniform(0.2, 0.95), angle)
        draw_object = draw_functions[rng.integers(len(draw_functions))]
        solids = draw_object(rng)
        yaw = float(rng.uniform(0, np.pi))
        plot.place(move_solids(solids, x=x, y=y, yaw=yaw), on_footways=True)
    for angle in rng.uniform(0, 2 * np.pi, rng.integers(0, 8)):
        crown_base = rng.uniform(1.5, 4.0)
        crown_top = crown_base + rng.uniform(2.0, 5.0)
        foot = np.array(_point_around(middle, radius * rng.uniform(0.0, 0.9), angle))
        crown_radius = rng.uniform(1.0, 3.5)
        levels = (crown_base, crown_top)
        plant_tree(plot, foot=foot, radius=crown_radius, levels=levels, rng=rng)
    for angle in rng.uniform(0, 2 * np.pi, rng.integers(0, 6)):
        x, y = _point_around(middle, 0.9 * radius, angle)
        plot.place(furniture.sign(x, y, facing=float(angle)), on_footways=True)


def _place_centre_piece(plot: Plot, middle: furniture.Point, radius: float, rng: Rng) -> None:
    """Place one round solid in the middle x, y of an island, if there is room for it.

    radius: the island's (m)."""
    x, y = middle
    size = float(rng.uniform(0.15, 0.4) * radius)
    height = round(float(rng.uniform(0.5, 2.5)), 2)
    kind = ("hedge", "wall", "heap", "bush")[rng.integers(4)]
    outline = furniture.disc(x, y, radius=size, corners=12)
    plot.place([Solid(outline, base=0.0, top=height, kind=kind)], on_footways=True)


def _place_ring(plot: Plot, middle: furniture.Point, ring_radius: float, rng: Rng) -> None:
    """Place hedges or bushes of about one size in a ring with gaps.

    They are blocks along the ring, all hedges, or discs of either kind. middle: x, y of the
    ring; ring_radius: m."""
    # size of a block, along and across the ring (m)
    length = float(rng.uniform(1.0, 5.0))
    width = float(rng.uniform(0.6, 2.2))
    mean_height = float(rng.uniform(0.5, 1.8))
    step = (length + rng.uniform(0.1, 4.0)) / ring_radius  # rad from one to the next
    start = rng.uniform(0, 2 * np.pi)
    placed_share = rng.uniform(0.4, 1.0)
    is_round = rng.random() < 0.4
    angles = np.arange(start, start + 2 * np.pi - step / 2, step)
    for angle in angles[:_MAX_RING_HEDGES]:
        x, y = _point_around(middle, ring_radius, angle)
        height = round(mean_height * float(rng.uniform(0.8, 1.2)), 2)
        if rng.random() > placed_share:  # a gap
            continue
        if is_round:
            outline = furniture.disc(x, y, radius=0.35 * length, corners=9)
            kind = ("hedge", "bush")[rng.integers(2)]
        else:
            outline = furniture.block((length, width), middle=(x, y), yaw=angle + np.pi / 2)
            kind = "hedge"
        plot.place([Solid(outline, base=0.0, top=height, kind=kind)], on_footways=True)


def _point_around(middle: furniture.Point, distance: float, angle: float) -> furniture.Point:
    """Point x, y at a distance (m) from a middle in a direction (rad from +x)."""
    x, y = middle
    return float(x + distance * np.cos(angle)), float(y + distance * np.sin(angle))
