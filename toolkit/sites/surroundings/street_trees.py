"""Trees along a road.

A tree's crown is several clumps of leaves with gaps between them. It keeps clear of walls and
places for sensors, and traffic passes below it: only the trunk takes ground."""

from collections.abc import Callable

import numpy as np
import shapely

from toolkit.arrays import Points, Rng
from toolkit.sites import furniture as f
from toolkit.sites.site import Solid
from toolkit.sites.surroundings.plot import Plot

UNDERSIDE_M = (2.5, 5.0)  # range of the underside of crowns over lanes or bays, above the ground
CROWN_WIDTH_M = (3.0, 9.0)  # range of the width of such crowns
_TRIMMED_UNDERSIDE_M = 4.2  # underside of crowns over tall vehicles
_MOUNT_AIR_M = 1.0  # between a crown and a mount's axis
_MIN_CROWN_RADIUS_M = 1.0  # of a crown that is planted
# draws one thing at x, y (m) for the direction of the road's edge there (rad)
Draw = Callable[[float, float, float], list[Solid]]


def avenues(plot: Plot, kerb: Points, rng: Rng) -> None:
    """Plant rows of trees with crowns over the road, at 60 % of all sites.

    kerb: rows x, y (m), direction (rad) every 0.5 m along the kerbs. The trees go to the plot; they
    are of one kind, with little difference in size."""
    if rng.random() > 0.6 or not len(kerb):
        return
    planted_share = rng.uniform(0.3, 0.9)
    spacing = rng.uniform(5.0, 13.0)
    wide = rng.uniform(*CROWN_WIDTH_M)
    tall = rng.uniform(2.5, 6.0)
    if rng.random() < 0.5:
        low = rng.uniform(_TRIMMED_UNDERSIDE_M, UNDERSIDE_M[1])
    else:
        low = rng.uniform(UNDERSIDE_M[0], _TRIMMED_UNDERSIDE_M)
    step = max(1, round(spacing / 0.5))  # rows of `kerb` from tree to tree
    for row in kerb[int(rng.integers(step)) :: step]:
        if rng.random() > planted_share:
            continue
        width = float(np.clip(wide * rng.uniform(0.8, 1.2), *CROWN_WIDTH_M))
        underside = float(np.clip(low + rng.normal(0.0, 0.3), *UNDERSIDE_M))
        plant(plot, row[:2], width / 2, (underside, underside + tall * rng.uniform(0.8, 1.2)), rng)


def plant(
    plot: Plot, foot: np.ndarray, radius: float, levels: f.Span, rng: Rng, *, footway: bool = True
) -> bool:
    """Plant a tree on the plot; return True if there was room for it.

    foot: x, y (m) of the trunk; radius: largest radius of the crown (m), made less near houses and
    mounts, and near lanes if the crown is lower than `UNDERSIDE_M`; levels: bottom and top of the
    crown (m above the ground); footway: the trunk may be on footways and islands. Only the trunk
    takes ground."""
    x = round(float(foot[0]), 3)
    y = round(float(foot[1]), 3)
    spot = shapely.Point(x, y)
    houses = [shapely.Polygon(solid.footprint) for solid in plot.solids if solid.kind == "building"]
    limits = [radius]
    limits += (np.hypot(*(plot.mounts - [x, y]).T) - _MOUNT_AIR_M).tolist()
    limits += shapely.distance(spot, np.array(houses, object)).tolist()
    if levels[0] < UNDERSIDE_M[0]:
        limits.append(shapely.distance(spot, plot.lanes))
    radius = float(min(limits))
    trunk = f.disc(x, y, round(float(rng.uniform(0.1, 0.16 + 0.04 * radius)), 2))
    if radius < _MIN_CROWN_RADIUS_M or not plot.claim(shapely.Polygon(trunk), footway=footway):
        return False
    low = round(levels[0], 2)
    high = round(levels[1], 2)
    plot.solids += [Solid(trunk, 0.0, round(low + 0.3 * (high - low), 2), "trunk")]
    plot.solids += clumps(x, y, radius, (low, high), rng)
    return True


def clumps(x: float, y: float, radius: float, levels: f.Span, rng: Rng) -> list[Solid]:
    """Draw a tree's crown of 3 to 8 overlapping clumps around (x, y).

    radius: the whole crown's (m); levels: its bottom and top (m)."""
    # the first clump begins at the bottom of the crown, the second ends at its top
    low, high = levels
    number = int(rng.integers(3, 9))
    around = (
        rng.uniform(0, 2 * np.pi)
        + np.arange(number) * 2 * np.pi / number
        + rng.normal(0.0, 0.3, number)
    )
    solids = []
    for k, angle in enumerate(around):
        size = radius * rng.uniform(0.4, 0.65)
        offset = (radius - size) * rng.uniform(0.7, 1.0)
        bottom = low if k == 0 else low + (high - low) * rng.uniform(0.0, 0.4)
        top = high if k == 1 else bottom + (high - bottom) * rng.uniform(0.5, 1.0)
        outline = f.disc(
            x + float(offset * np.cos(angle)), y + float(offset * np.sin(angle)), float(size), 7
        )
        solids.append(Solid(outline, round(float(bottom), 2), round(float(top), 2), "tree"))
    return solids
