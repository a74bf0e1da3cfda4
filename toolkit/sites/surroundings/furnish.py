"""Furnishing of a street and its sides: things that are drawn first get their ground first."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely

from toolkit.arrays import Rng
from toolkit.sites import furniture
from toolkit.sites.furniture import move_solids
from toolkit.sites.network import unite
from toolkit.sites.site import Mount, Solid
from toolkit.sites.surroundings.houses import place_houses
from toolkit.sites.surroundings.islands import plant_islands
from toolkit.sites.surroundings.mount_places import Extent
from toolkit.sites.surroundings.parking_bays import bay_outline, forecourts, kerb_bays
from toolkit.sites.surroundings.places import Bays, FreeBays, points_along
from toolkit.sites.surroundings.plot import Plot, Road
from toolkit.sites.surroundings.road_works import WORKS_OBJECTS, lane_works, verge_works
from toolkit.sites.surroundings.street_furniture import (
    place_bulky_objects,
    place_furniture,
    place_gardens,
)
from toolkit.sites.surroundings.street_trees import UNDERSIDE_M, plant_avenues

POST_AIR_M = 0.2  # from the top of a mount's post to the lowest sensor on it


def furnish(
    road: Road, area: Extent, mounts: Sequence[Mount], rng: Rng, *, light: bool = False
) -> tuple[list[Solid], FreeBays]:
    """Draw solids and parking bays in and up to 25 m around an area, on level ground (z = 0).

    Mounts get posts and keep the ground around them clear. Strips of the road without bays have
    road works. Some bays are filled with things, and bays under low crowns are left out.

    area: xmin ymin xmax ymax (m); light: draw islands, trees along kerbs, street furniture and bays
    only. Returns the solids, and bays as rows x, y (m), yaw (rad)."""
    # a changed order of the draws changes all random sites
    plot = Plot(road, shapely.box(*area).buffer(25.0, join_style="mitre"), mounts)
    for mount in mounts:
        x, y, _ = mount.position.tolist()
        plot.solids.append(furniture.post(x, y, height=round(mount.min_height - POST_AIR_M, 2)))
    kerb = points_along(road.carriageway.buffer(0.8).boundary.intersection(plot.window), 0.5)
    bays = kerb_bays(plot, road.strips, road.angles, rng)
    if light:
        plant_islands(plot, rng)
        plant_avenues(plot, kerb, rng)
        place_furniture(plot, rng)
        return plot.solids, bays
    strips = {edge: strip for edge, strip in road.strips.items() if edge not in road.angles}
    lane_works(plot, strips, rng)
    plant_islands(plot, rng)
    place_houses(plot, rng)
    bays = np.concatenate([bays, forecourts(plot, rng)])
    bays = _fill_bays(plot, bays, rng)
    verge_works(plot, rng)
    plant_avenues(plot, kerb, rng)
    place_bulky_objects(plot, rng)
    place_furniture(plot, rng)
    place_gardens(plot, rng)
    if rng.random() < 0.8:
        plot.solids += furniture.kerbs(
            road.lanes, road.footways, height=round(float(rng.uniform(0.06, 0.16)), 2)
        )
    solids = _loosen_hedges(plot.solids, rng)
    low_crowns = [s for s in solids if s.kind == "tree" and s.base < UNDERSIDE_M[0]]
    return solids, _select_free(low_crowns, bays)


def _loosen_hedges(solids: Sequence[Solid], rng: Rng) -> list[Solid]:
    """Return the solids with a random share of the hedges made bushes, which rays go into."""
    bush_share = rng.random() if rng.random() < 0.75 else 0.0
    loosened_solids = []
    for solid in solids:
        is_bush = solid.kind == "hedge" and rng.random() < bush_share  # a draw for hedges only
        loosened_solids.append(replace(solid, kind="bush") if is_bush else solid)
    return loosened_solids


def _fill_bays(plot: Plot, bays: Bays, rng: Rng) -> FreeBays:
    """Put skips, containers and the like in some bays, close to vehicles that park.

    The solids go to the plot, except objects that reach onto driven ground. bays: rows x, y (m),
    yaw (rad). Returns the rows that are still free."""
    is_filled = rng.random(len(bays)) < rng.uniform(0.0, 0.3)
    bay_solids = list[Solid]()
    for x, y, yaw in bays[is_filled]:
        make = WORKS_OBJECTS[rng.integers(len(WORKS_OBJECTS))]
        solids = move_solids(make(rng), x=float(x), y=float(y), yaw=float(yaw))
        if unite(solid.footprint for solid in solids).disjoint(plot.driven_ground):
            bay_solids += solids
    plot.solids += bay_solids
    return _select_free(bay_solids, bays[~is_filled])  # objects may reach into other bays


def _select_free(solids: Sequence[Solid], bays: Bays) -> FreeBays:
    """Return the bays (x, y, yaw) whose ground, 0.1 m within its edge, no solid is on."""
    if not len(bays):
        return bays
    obstacles = unite(solid.footprint for solid in solids)
    return bays[[obstacles.disjoint(bay_outline(bay).buffer(-0.1)) for bay in bays]]
