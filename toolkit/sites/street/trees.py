"""Trees beside a road whose crowns may hang over it: one by one, and in avenues along a kerb.

A crown is several clumps of leaves with gaps between them. It keeps clear of walls and of where sensors may hang, and
what drives passes below it: only the trunk takes ground.
"""

from __future__ import annotations

import numpy as np
import shapely

from toolkit.arrays import Float
from toolkit.sites import furniture as f
from toolkit.sites.site import Solid
from toolkit.sites.surroundings import Plot

UNDERSIDE = (2.5, 5.0)  # m above the ground, of a crown over lanes or bays, from .. to
OVER_ROAD = (3.0, 9.0)  # m, how wide such a crown is, from .. to
_TRIMMED = 4.2  # m, underside where tall vehicles are expected
_MOUNT_AIR = 1.0  # m between a crown and a mount's axis
_SLIMMEST = 1.0  # m, radius of the smallest crown that is planted


def avenues(plot: Plot, kerb: Float[np.ndarray, "n 3"], rng: np.random.Generator) -> None:
    """Rows of trees along `kerb` (x, y, direction every 0.5 m), whose crowns stand over the road.

    Most sites have some; on one with avenues 30 to 90 % of the kerb in the window is planted.
    """
    if rng.random() > 0.6 or not len(kerb):
        return
    planted, every = rng.uniform(0.3, 0.9), rng.uniform(5.0, 13.0)
    wide, tall = rng.uniform(*OVER_ROAD), rng.uniform(2.5, 6.0)
    low = rng.uniform(_TRIMMED, UNDERSIDE[1]) if rng.random() < 0.5 else rng.uniform(UNDERSIDE[0], _TRIMMED)
    step = max(1, round(every / 0.5))
    for row in kerb[int(rng.integers(step)) :: step]:
        if rng.random() > planted:
            continue
        width = float(np.clip(wide * rng.uniform(0.8, 1.2), *OVER_ROAD))
        underside = float(np.clip(low + rng.normal(0.0, 0.3), *UNDERSIDE))
        plant(plot, row[:2], width / 2, (underside, underside + tall * rng.uniform(0.8, 1.2)), rng)


def plant(
    plot: Plot,
    foot: Float[np.ndarray, "2"],
    radius: float,
    levels: tuple[float, float],
    rng: np.random.Generator,
    *,
    footway: bool = True,
) -> bool:
    """A tree at `foot` with a crown of `radius` from the lower to the upper of `levels` (m), narrower where a wall or a
    mount is near, and off the road where it hangs too low; False where there is no room for it."""
    x, y = (round(float(c), 3) for c in foot)
    radius = min(radius, _room(plot, shapely.Point(x, y), over_road=levels[0] >= UNDERSIDE[0]))
    trunk = f.disc(x, y, round(float(rng.uniform(0.1, 0.16 + 0.04 * radius)), 2))
    if radius < _SLIMMEST or not plot.claim(shapely.Polygon(trunk), footway=footway):
        return False
    low, high = (round(level, 2) for level in levels)
    plot.solids += [Solid(trunk, 0.0, round(low + 0.3 * (high - low), 2), "trunk")]
    plot.solids += clumps(x, y, radius, (low, high), rng)
    return True


def clumps(x: float, y: float, radius: float, levels: tuple[float, float], rng: np.random.Generator) -> list[Solid]:
    """A crown of 3 to 8 overlapping clumps within `radius` (m) of (x, y) and between `levels` (m)."""
    low, high = levels
    number = int(rng.integers(3, 9))
    around = rng.uniform(0, 2 * np.pi) + np.arange(number) * 2 * np.pi / number + rng.normal(0.0, 0.3, number)
    made = []
    for k, angle in enumerate(around):
        size = radius * rng.uniform(0.4, 0.65)
        out = (radius - size) * rng.uniform(0.7, 1.0)
        bottom = low if k == 0 else low + (high - low) * rng.uniform(0.0, 0.4)
        top = high if k == 1 else bottom + (high - bottom) * rng.uniform(0.5, 1.0)
        outline = f.disc(x + float(out * np.cos(angle)), y + float(out * np.sin(angle)), float(size), 7)
        made.append(Solid(outline, round(float(bottom), 2), round(float(top), 2), "tree"))
    return made


def _room(plot: Plot, foot: shapely.Point, *, over_road: bool) -> float:
    """How wide a crown may be at `foot` (m, radius): up to houses' walls, short of mounts, and off lanes unless it may
    hang `over_road`."""
    gaps = np.hypot(*(plot.mounts - shapely.get_coordinates(foot)).T) - _MOUNT_AIR
    houses = [shapely.Polygon(solid.footprint) for solid in plot.solids if solid.kind == "building"]
    road = np.inf if over_road else shapely.distance(foot, plot.lanes)
    return float(min([*gaps, *shapely.distance(foot, np.array(houses, object)), road]))
