"""Parking bays of maps that are free of solids and traffic."""

from collections.abc import Sequence

import numpy as np
import shapely

from toolkit.arrays import Float, Float64
from toolkit.sites import network as nets
from toolkit.sites.site import Solid
from toolkit.sites.surroundings.parking_bays import Bay, bay_outline
from toolkit.sites.surroundings.places import place_along

MAP_BAY_SIZE_M = (5.8, 2.3)  # length and width of a bay without a size in the map
BAY_SPACING_M = 6.4  # from bay to bay along a lane


def find_free_bays(
    bays: Sequence[Bay], window: shapely.Geometry, solids: Sequence[Solid], tracks: shapely.Geometry
) -> Float64[np.ndarray, "n 3"]:
    """Return the bays in `window` that have no solids and no traffic on them.

    bays: x, y (m), yaw (rad) of bays that the map has; tracks: ground that vehicles drive on.
    Returns their rows in the same order, rounded to 0.1 mm and 0.1 mrad."""
    obstacles = nets.unite(s.footprint for s in solids if s.kind not in ("island", "kerb"))
    driven_ground = tracks.buffer(-0.3)
    free_bays = []
    for bay in bays:
        ground = bay_outline(bay, MAP_BAY_SIZE_M)
        if not window.contains(ground) or obstacles.intersects(ground):
            continue
        # shrunk, as corners of slanted bays may reach into the tracks
        if not driven_ground.intersects(ground.buffer(-0.25)):
            free_bays.append(bay)
    return np.array(free_bays, np.float64).reshape(-1, 3).round(4)


def lay_bays(middle: Float[np.ndarray, "k 2"]) -> list[Bay]:
    """List bays x, y (m), yaw (rad) along a parking lane, every `BAY_SPACING_M`.

    middle: points x, y of the lane's middle line, in the direction in which vehicles park."""
    line = shapely.LineString(middle)
    margin = BAY_SPACING_M / 2
    distances = np.arange(margin, line.length - margin, BAY_SPACING_M)  # m along the line
    rows = place_along(line, distances, half=0.5)
    return list(map(tuple, rows.tolist()))
