"""Trees along a road.

A tree's crown is several draw_crown of leaves with gaps between them. It keeps clear of walls and
places for sensors, and traffic passes below it: only the trunk takes ground."""

from collections.abc import Callable

import numpy as np
import shapely

from toolkit.arrays import Points, Rng
from toolkit.sites import furniture
from toolkit.sites.site import Solid
from toolkit.sites.surroundings.plot import Plot

UNDERSIDE_M = (2.5, 5.0)  # range of the underside of crowns over lanes or bays, above the ground
CROWN_WIDTH_M = (3.0, 9.0)  # range of the width of such crowns
_TRIMMED_UNDERSIDE_M = 4.2  # underside of crowns over tall vehicles
_MOUNT_AIR_M = 1.0  # between a crown and a mount's axis
_MIN_CROWN_RADIUS_M = 1.0  # for a crown that is planted
# function that draws an object at x, y (m) for the direction of the road's edge there (rad)
Draw = Callable[[float, float, float], list[Solid]]


def plant_avenues(plot: Plot, kerb: Points, rng: Rng) -> None:
    """Plant rows of trees with crowns over the road, at 60 % of all sites.

    kerb: rows x, y (m), direction (rad) every 0.5 m along the kerbs. The trees go to the plot; they
    are of one kind, with little difference in size."""
    if rng.random() > 0.6 or not len(kerb):
        return
    planted_share = rng.uniform(0.3, 0.9)
    spacing = rng.uniform(5.0, 13.0)
    mean_width = rng.uniform(*CROWN_WIDTH_M)
    mean_height = rng.uniform(2.5, 6.0)  # height of the crowns, from underside to top
    min_underside, max_underside = UNDERSIDE_M
    if rng.random() < 0.5:
        mean_underside = rng.uniform(_TRIMMED_UNDERSIDE_M, max_underside)
    else:
        mean_underside = rng.uniform(min_underside, _TRIMMED_UNDERSIDE_M)
    step = max(1, round(spacing / 0.5))  # rows of `kerb` from tree to tree
    for row in kerb[int(rng.integers(step)) :: step]:
        if rng.random() > planted_share:
            continue
        width = float(np.clip(mean_width * rng.uniform(0.8, 1.2), *CROWN_WIDTH_M))
        underside = float(np.clip(mean_underside + rng.normal(0.0, 0.3), *UNDERSIDE_M))
        levels = (underside, underside + mean_height * rng.uniform(0.8, 1.2))
        plant_tree(plot, foot=row[:2], radius=width / 2, levels=levels, rng=rng)


def plant_tree(
    plot: Plot,
    foot: np.ndarray,
    radius: float,
    levels: furniture.Span,
    rng: Rng,
    *,
    on_footways: bool = True,
) -> bool:
    """Plant a tree on the plot; return True if there was room for it.

    Only the trunk takes ground. foot: x, y (m) of the trunk; radius: largest radius of the crown
    (m), made less near houses and mounts, and near lanes if the crown is lower than `UNDERSIDE_M`;
    levels: bottom and top of the crown (m above the ground); on_footways: the trunk may be on
    footways and islands."""
    x, y = (round(float(coordinate), 3) for coordinate in foot)
    crown_base, crown_top = levels
    spot = shapely.Point(x, y)
    houses = [shapely.Polygon(solid.footprint) for solid in plot.solids if solid.kind == "building"]
    max_radii = [radius]  # m; the least one counts
    max_radii += (np.hypot(*(plot.mount_places - [x, y]).T) - _MOUNT_AIR_M).tolist()
    max_radii += shapely.distance(spot, np.array(houses, object)).tolist()
    min_underside, _ = UNDERSIDE_M
    if crown_base < min_underside:
        max_radii.append(shapely.distance(spot, plot.lane_ground))
    crown_radius = float(min(max_radii))
    trunk_radius = round(float(rng.uniform(0.1, 0.16 + 0.04 * crown_radius)), 2)
    trunk = furniture.disc(x, y, trunk_radius)
    if crown_radius < _MIN_CROWN_RADIUS_M:
        return False
    if not plot.claim(shapely.Polygon(trunk), on_footways=on_footways):
        return False
    base = round(crown_base, 2)
    top = round(crown_top, 2)
    trunk_top = round(base + 0.3 * (top - base), 2)  # within the crown
    plot.solids += [Solid(trunk, base=0.0, top=trunk_top, kind="trunk")]
    plot.solids += draw_crown(x, y, radius=crown_radius, levels=(base, top), rng=rng)
    return True


def draw_crown(x: float, y: float, radius: float, levels: furniture.Span, rng: Rng) -> list[Solid]:
    """Draw a tree's crown of 3 to 8 overlapping clumps of leaves around (x, y).

    radius: the whole crown's (m); levels: bottom and top of the crown (m above the ground)."""
    crown_base, crown_top = levels
    number = int(rng.integers(3, 9))
    start = rng.uniform(0, 2 * np.pi)
    # directions from the trunk to the clumps (rad): spread evenly, then moved a little
    angles = start + np.arange(number) * 2 * np.pi / number + rng.normal(0.0, 0.3, number)
    solids = []
    for k, angle in enumerate(angles):
        clump_radius = radius * rng.uniform(0.4, 0.65)
        offset = (radius - clump_radius) * rng.uniform(0.7, 1.0)
        # the first clump begins at the bottom of the crown, the second ends at its top
        base = crown_base
        if k != 0:
            base = crown_base + (crown_top - crown_base) * rng.uniform(0.0, 0.4)
        top = crown_top
        if k != 1:
            top = base + (crown_top - base) * rng.uniform(0.5, 1.0)
        clump_x = x + float(offset * np.cos(angle))
        clump_y = y + float(offset * np.sin(angle))
        outline = furniture.disc(clump_x, clump_y, float(clump_radius), corners=7)
        base = round(float(base), 2)
        top = round(float(top), 2)
        solids.append(Solid(outline, base=base, top=top, kind="tree"))
    return solids
