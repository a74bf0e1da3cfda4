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

# part of the points, and above the ground found
MIN_DOUBT_SHARE = 0.05
MIN_DOUBT_M = 0.8


@dataclass(frozen=True)
class GroundLevel:
    """Surface away from the main ground.

    Attributes:
        height_m: median height above the main ground.
        share: part of all points on it.
        followed: True for ground, False for a surface that may be a roof."""

    height_m: float
    share: float
    followed: bool


def add_levels(main: HeightMap, points: Points) -> tuple[HeightMap, tuple[GroundLevel, ...]]:
    """Add further levels of ground to a map.

    main: map of the main ground; points: (n, 3) m, level, as `fit_map` takes them. Return the map
    with the nearest level at each place, and the levels; the same map without any."""
    if main.heights.size == 1:
        return main, ()
    squares = CellPoints.from_points(main, points)
    cells = squares.low
    surface = LinkedCells.from_cells(cells)
    above = cells[:, 2] - main.at(cells[:, :2])
    numbers = surface.number_levels(above)
    count = numbers.max(initial=-1) + 1
    shares = squares.count_near(numbers, count) / max(1, len(points))
    covered = squares.least < main.at(cells[:, :2]) + ON_GROUND_M
    levels: list[GroundLevel] = []
    followed: list[Int64[np.ndarray, " k"]] = []
    for number, share in enumerate(shares.tolist()):
        rows = np.flatnonzero(numbers == number)
        is_ground = surface.is_ground(rows, above[rows], covered[rows])
        height = float(np.median(above[rows]))
        if is_ground:
            followed.append(rows)
        if is_ground or height > MIN_DOUBT_M:
            levels.append(GroundLevel(height, share, is_ground))
    return (draw_levels(main, cells, followed, surface) if followed else main), tuple(levels)


def describe_levels(levels: tuple[GroundLevel, ...]) -> str | None:
    """Return the largest doubt, else the largest further level, in one line; None for one ground
    without doubt."""
    for followed in (False, True):
        same_kind = [level for level in levels if level.followed == followed]
        share = sum(ground_level.share for ground_level in same_kind)
        if share >= MIN_DOUBT_SHARE:
            height = max(same_kind, key=lambda ground_level: ground_level.share).height_m
            side = "above" if height > 0 else "below"
            points = f"{share:.0%} of the points are {abs(height):.1f} m {side} the ground found"
            if followed:
                return f"{points}: they are levelled as further ground, such as a raised road"
            return f"{points}: give the road's own --area if they are a road; a roof needs nothing"
    return None
