"""Rows of houses along the legs of a road."""

import numpy as np
import shapely

from toolkit.arrays import Float64, Rng
from toolkit.sites.site import Solid
from toolkit.sites.surroundings.plot import Plot

HOUSES_REACH_M = 90.0  # along a leg
HEIGHT_M = (4.0, 25.0)  # range of the height of houses
ROW_GAP_M = 0.05  # between houses that form a row
RETRY_STEP_M = 1.5  # after a place without room


def place_houses(plot: Plot, rng: Rng) -> None:
    """Place a row of houses along each side of every leg of the plot's road.

    The houses go to the plot; those without room are left out."""
    density = rng.uniform(0.3, 0.95)
    usual_height = rng.uniform(4.5, 16.0)
    for path, widths in zip(plot.road.paths, plot.road.half_widths, strict=True):
        line = shapely.LineString(path)
        for side, half_width in zip((1, -1), widths, strict=True):  # left, right
            offset = side * (half_width + rng.uniform(0.5, 8.0))
            _place_row(
                plot, line, offset=offset, density=density, usual_height=usual_height, rng=rng
            )


def _place_row(
    plot: Plot,
    line: shapely.LineString,
    offset: float,
    density: float,
    usual_height: float,
    rng: Rng,
) -> None:
    """Place a row of houses along a line, up to `HOUSES_REACH_M` from its start.

    The houses go to the plot; houses without room are left out. offset: m from the line to their
    fronts, positive to the left; density: share of the line with houses, from 0 to 1; usual_height:
    median height (m)."""
    distance = rng.uniform(4.0, 16.0)  # m along the line to the next house
    while distance < HOUSES_REACH_M:
        # lengths (m) along the line and away from it
        front = rng.uniform(7.0, 22.0)
        depth = rng.uniform(7.0, 14.0)
        if rng.random() > density:  # a gap instead of the house
            distance += front
            continue
        outline = _outline_house(line, distance, front=front, depth=depth, offset=offset)
        height = np.clip(usual_height * rng.lognormal(0.0, 0.3), *HEIGHT_M)
        house = Solid(outline, base=0.0, top=round(float(height), 2), kind="building")
        if not plot.place([house]):
            distance += RETRY_STEP_M
            continue
        gap = ROW_GAP_M if rng.random() < 0.4 else rng.uniform(1.0, 9.0)
        distance += front + gap


def _outline_house(
    line: shapely.LineString, distance: float, front: float, depth: float, offset: float
) -> Float64[np.ndarray, "4 2"]:
    """Corners x, y of a house that begins at a distance (m) along a line, on millimetres.

    front: its length along the line (m); depth: its length away from the line (m); offset: m from
    the line to its front, positive to the left."""
    (start,) = shapely.get_coordinates(line.interpolate(distance))
    (end,) = shapely.get_coordinates(line.interpolate(distance + front))
    # unit vectors along the line and to its left; + 1e-9: at the line's end, start and end are one
    ahead = (end - start) / (np.hypot(*(end - start)) + 1e-9)
    left = np.array([-ahead[1], ahead[0]])
    to_front = offset * left
    to_back = (offset + np.copysign(depth, offset)) * left
    wall = front * ahead
    corners = [start + to_front, start + wall + to_front, start + wall + to_back, start + to_back]
    return np.round(corners, 3)
