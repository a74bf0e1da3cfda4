"""Further levels of ground next to the main one: embankments, bridges, ramps and dips.

A height map follows one smooth ground within two metres of a plane. A road on an embankment leaves
it, and so does a deck or an underpass. The lowest points of the cells that leave it are linked
if they continue each other. A linked surface is ground if it is below the main one, or if it is
above with nothing of the main ground below it and is as wide and long as a road. Roofs, hedges and
rows of lorries are too narrow or too short; they are counted, not followed."""

from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Int64, Points
from toolkit.calibration.height_map import HeightMap
from toolkit.calibration.level_maps import draw_levels
from toolkit.calibration.linked_cells import ON_GROUND_M, CellPoints, LinkedCells

MIN_DOUBT_SHARE = 0.05  # part of all points on further levels from which they are reported
MIN_DOUBT_M = 0.8  # height above the ground found from which a surface may be a missed road


@dataclass(frozen=True)
class GroundLevel:
    """Surface away from the main ground, such as a raised road or a roof.

    Attributes:
        height_m: median height above the main ground, negative below it.
        share: part of all points that are on the surface, 0 to 1.
        is_ground: True for ground, which the map of heights follows; False for a surface that may
            be a roof."""

    height_m: float
    share: float
    is_ground: bool


def add_levels(main: HeightMap, points: Points) -> tuple[HeightMap, tuple[GroundLevel, ...]]:
    """Find further levels of ground and add them to a map.

    Args:
        main: map of the main ground.
        points: (n, 3) m, in the frame of the map, with the ground near z = 0.

    Returns the map with the nearest level at each place, or `main` itself if no level is ground,
    and all levels found, doubtful ones too."""
    if main.heights.size == 1:  # `fit_map` found no point near the ground
        return main, ()
    squares = CellPoints.from_points(main, points)
    cells = squares.low
    linked_cells = LinkedCells.from_cells(cells)
    main_height = main.at(cells[:, :2])
    above = cells[:, 2] - main_height
    numbers = linked_cells.number_levels(above)  # level of each cell, -1 for none
    count = numbers.max(initial=-1) + 1
    shares = squares.count_near(numbers, count) / max(1, len(points))
    has_ground_below = squares.least < main_height + ON_GROUND_M
    levels: list[GroundLevel] = []
    followed_rows: list[Int64[np.ndarray, " _"]] = []
    for number, share in enumerate(shares.tolist()):
        rows = np.flatnonzero(numbers == number)
        is_ground = linked_cells.is_ground(rows, above[rows], has_ground_below[rows])
        height = float(np.median(above[rows]))
        if is_ground:
            followed_rows.append(rows)
        if is_ground or height > MIN_DOUBT_M:
            levels.append(GroundLevel(height, share, is_ground=is_ground))
    if followed_rows:
        main = draw_levels(main, cells, followed_rows, linked_cells)
    return main, tuple(levels)


def describe_levels(levels: tuple[GroundLevel, ...]) -> str | None:
    """Describe the doubtful surfaces in one line, else the further levels of ground.

    Doubtful are surfaces that the map of heights does not follow (`is_ground` is False). Returns
    None if neither kind has `MIN_DOUBT_SHARE` of the points."""
    for is_ground in (False, True):  # doubtful surfaces first
        kind_levels = [level for level in levels if level.is_ground == is_ground]
        share = sum(level.share for level in kind_levels)
        if share >= MIN_DOUBT_SHARE:
            largest_level = max(kind_levels, key=lambda level: level.share)
            height = largest_level.height_m
            side = "above" if height > 0 else "below"
            points = f"{share:.0%} of the points are {abs(height):.1f} m {side} the ground found"
            if is_ground:
                return f"{points}: they are levelled as further ground, such as a raised road"
            return f"{points}: give the road's own --area if they are a road; a roof needs nothing"
    return None
