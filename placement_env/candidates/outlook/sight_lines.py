"""From the places where sensors may hang to the cells where vehicles may be: what of a vehicle is hidden by solids, and
how much traffic is in between.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from placement_env.candidates.outlook.ground_plan import GroundPlan
from placement_env.candidates.outlook.height_map import HeightMap
from toolkit.arrays import Float32, Float64

LINE_STEPS = 80  # along a line
VEHICLE_TOP = 1.5  # m above the ground, of a vehicle
LOOKED_AT = (0.5, 1.2)  # m above the ground, of a vehicle behind what hangs
MIDDLE = 0.75  # m above the ground
OWN_LENGTH = 3.0  # m at the end of a line that are the vehicle's own


class SightLines(NamedTuple):
    """clear: share of a vehicle in each cell that solids leave to be seen; between: vehicles expected in between, a
    metre of their breadth each, that reach up to the line; both of V places and Q cells."""

    clear: Float32[np.ndarray, "V Q"]
    between: Float32[np.ndarray, "V Q"]


def sight_lines(plan: GroundPlan, heights: HeightMap, places: Float64[np.ndarray, "V 3"]) -> SightLines:
    """Of places to the used cells of a plan."""
    clear, between = np.ones((2, len(places), len(plan.used)), np.float32)
    spots, which = np.unique(places[:, :2], axis=0, return_inverse=True)
    for spot, xy in enumerate(spots):
        rows = np.flatnonzero(which.ravel() == spot)
        clear[rows], between[rows] = _from_spot(plan, heights, xy, places[rows, 2])
    return SightLines(clear, between)


def _from_spot(
    plan: GroundPlan, heights: HeightMap, xy: np.ndarray, above: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The same of places over one another."""
    targets, foot = plan.centres[plan.used], plan.ground[plan.used].astype(np.float32)
    share = ((np.arange(LINE_STEPS) + 0.5) / LINE_STEPS).astype(np.float32)
    x, y = (xy[axis] + share * (targets[:, axis, None] - xy[axis]) for axis in (0, 1))  # (Q, steps)
    met = heights.places(x, y)
    top, low, high = (each.ravel()[met] for each in (heights.top, heights.low, heights.high))
    cells = plan.cells_at(np.stack([x.ravel(), y.ravel()], axis=1)).reshape(x.shape)
    away = np.linalg.norm(targets - xy, axis=1).astype(np.float32)
    thick = np.where(cells >= 0, plan.traffic[cells], 0).astype(np.float32) / np.float32(plan.size.prod())
    thick *= (away[:, None] * (1 - share) > OWN_LENGTH) * (away[:, None] / LINE_STEPS)
    hangs = (high > low).any()
    clear, between = np.empty((2, len(above), len(targets)), np.float32)
    for row, z in enumerate(above.astype(np.float32)):
        lowest = z + ((top - z) / share).max(axis=1)  # height at the cell above which the line is free
        clear[row] = np.clip((foot + VEHICLE_TOP - lowest) / VEHICLE_TOP, 0, 1)
        if hangs:
            lines = [z + share * (foot[:, None] + up - z) for up in LOOKED_AT]
            clear[row] *= np.mean([~((low < line) & (line < high)).any(axis=1) for line in lines], axis=0)
        line = z + share * (foot[:, None] + np.float32(MIDDLE) - z)
        between[row] = (thick * (line < foot[:, None] + VEHICLE_TOP)).sum(axis=1)
    return clear, between
