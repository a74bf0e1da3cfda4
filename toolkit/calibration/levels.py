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
        followed: True for ground, which the map of heights follows; False for a surface that may be
            a roof."""

    height_m: float
    share: float
    followed: bool


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
    """Describe the doubtful surfaces in one line, else the further levels of ground.

    Returns None if neither have `MIN_DOUBT_SHARE` of the points."""
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
