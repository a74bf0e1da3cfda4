"""Furnishing of a street and its sides: things that are drawn first get their ground first."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely

from toolkit.arrays import Rng
from toolkit.sites import furniture as f
from toolkit.sites.furniture import move_solids
from toolkit.sites.network import unite
from toolkit.sites.site import Mount, Solid
from toolkit.sites.surroundings.houses import place_houses
from toolkit.sites.surroundings.islands import plant_islands
from toolkit.sites.surroundings.mount_places import Extent
from toolkit.sites.surroundings.parking_bays import forecourts, kerb_bays, outline
from toolkit.sites.surroundings.places import Bays, along
from toolkit.sites.surroundings.plot import Plot, Road
from toolkit.sites.surroundings.road_works import WORKS_THINGS, lane_works, verge_works
from toolkit.sites.surroundings.street_furniture import place_bulky, place_furniture, place_gardens
from toolkit.sites.surroundings.street_trees import UNDERSIDE_M, avenues

POST_AIR_M = 0.2  # from the top of a mount's post to the lowest sensor on it


def furnish(
    road: Road, area: Extent, mounts: Sequence[Mount], rng: Rng, *, light: bool = False
) -> tuple[list[Solid], Bays]:
    """Draw solids and parking bays in and up to 25 m around `area`, on level ground (z = 0).

    Mounts get posts and keep the ground around them clear. Strips of the road without bays have
    road works. Some bays are filled with things, and bays under low crowns are left out.

    area: xmin ymin xmax ymax (m); light: draw islands, trees along kerbs, street furniture and bays
    only. Returns the solids, and bays as rows x, y (m), yaw (rad)."""
    # a changed order of the draws changes all random sites
    plot = Plot(road, shapely.box(*area).buffer(25.0, join_style="mitre"), mounts)
    for mount in mounts:
        x, y, _ = mount.position.tolist()
        plot.solids.append(f.post(x, y, round(mount.min_height - POST_AIR_M, 2)))
    kerb = along(road.carriageway.buffer(0.8).boundary.intersection(plot.window), 0.5)
    bays = kerb_bays(plot, road.strips, road.angles, rng)
    if light:
        plant_islands(plot, rng)
        avenues(plot, kerb, rng)
        place_furniture(plot, rng)
        return plot.solids, bays
    strips = {edge: strip for edge, strip in road.strips.items() if edge not in road.angles}
    lane_works(plot, strips, rng)
    plant_islands(plot, rng)
    place_houses(plot, rng)
    bays = np.concatenate([bays, forecourts(plot, rng)])
    bays = _fill_bays(plot, bays, rng)
    verge_works(plot, rng)
    avenues(plot, kerb, rng)
    place_bulky(plot, rng)
    place_furniture(plot, rng)
    place_gardens(plot, rng)
    if rng.random() < 0.8:
        plot.solids += f.kerbs(road.lanes, road.footways, round(float(rng.uniform(0.06, 0.16)), 2))
    solids = _loosen_hedges(plot.solids, rng)
    low_crowns = [s for s in solids if s.kind == "tree" and s.base < UNDERSIDE_M[0]]
    return solids, _select_free(low_crowns, bays)


def _loosen_hedges(solids: Sequence[Solid], rng: Rng) -> list[Solid]:
    """Return the solids with a random share of the hedges made bushes, which rays go into."""
    bush_share = rng.random() if rng.random() < 0.75 else 0.0
    loosened = []
    for solid in solids:
        is_bush = solid.kind == "hedge" and rng.random() < bush_share
        loosened.append(replace(solid, kind="bush") if is_bush else solid)
    return loosened


def _fill_bays(plot: Plot, bays: Bays, rng: Rng) -> Bays:
    """Put skips, containers and the like in some bays, close to vehicles that park.

    The things go to the plot. Returns the bays (x, y, yaw) that are still free."""
    filled = rng.random(len(bays)) < rng.uniform(0.0, 0.3)
    things = list[Solid]()
    for x, y, yaw in bays[filled]:
        make = WORKS_THINGS[rng.integers(len(WORKS_THINGS))]
        thing = move_solids(make(rng), float(x), float(y), float(yaw))
        if unite(solid.footprint for solid in thing).disjoint(plot.driven):
            things += thing
    plot.solids += things
    return _select_free(things, bays[~filled])


def _select_free(solids: Sequence[Solid], bays: Bays) -> Bays:
    """Return the bays (x, y, yaw) whose ground, 0.1 m within its edge, no solid is on."""
    if not len(bays):
        return bays
    obstacles = unite(solid.footprint for solid in solids)
    return bays[[obstacles.disjoint(outline(bay).buffer(-0.1)) for bay in bays]]
