"""Banks between two levels of ground, such as the slopes of an embankment.

A cell is the low point (x, y, z in m) of one square of a grid."""

import numpy as np

from toolkit.arrays import Bool, Float64, Int64
from toolkit.calibration.height_map import HeightMap
from toolkit.calibration.linked_cells import LinkedCells

MAX_BANK_M = 12.0  # largest distance of a bank's cell from the cells of both levels
BANK_SLOPES = (0.25, 1.2)  # least and largest slope of a bank, m per m
MAX_BANK_BEND = 0.3  # part of a bank's height by which it may leave the line from foot to edge
BANK_CELLS_M = 4.0  # distance within which other cells show the plane of a bank
MIN_BANK_CELLS = 5  # least number of such cells
BANK_STEP_M = 0.12  # largest deviation (root mean square) of their heights from the plane
KERB_M = 0.09  # height above a drawn surface at which a cell counts half


def fit_banks(
    cells: Float64[np.ndarray, "n 3"],
    links: LinkedCells,
    number: Int64[np.ndarray, " n"],
    surfaces: list[HeightMap],
) -> Float64[np.ndarray, "n 2"]:
    """Find the slopes along x and y (m per m) of cells on banks, NaN for other cells.

    A cell without a level is on a bank if it is higher than one level and lower than another, and
    the cells around it are on one steep plane, as vehicles are not.

    Args:
        cells: low points of the grid's squares.
        links: nearest neighbours of the same cells.
        number: index in `surfaces` of each cell's surface, -1 for none.
        surfaces: maps of all levels and of the main ground."""
    slopes = np.full((len(cells), 2), np.nan)
    rows = np.flatnonzero(number < 0)
    if not len(rows):
        return slopes
    rows = rows[_mark_between(cells, rows, number, surfaces)]
    neighbours = links.neighbours[rows]
    offset = cells[neighbours] - cells[rows, None]  # cell, neighbour, axis
    distance = np.hypot(offset[..., 0], offset[..., 1])
    is_near = (number[neighbours] < 0) & (distance < BANK_CELLS_M)
    level_offset = np.where(is_near[..., None], offset[..., :2], 0.0)
    rise = np.where(is_near, offset[..., 2], 0.0)
    # least squares of the plane through each cell; 0.1 m² keeps it solvable
    transposed = level_offset.transpose(0, 2, 1)
    squares = transposed @ level_offset + 0.1 * np.eye(2)
    # along x and y for each row, (rows, 2, 1)
    slope = np.linalg.solve(squares, transposed @ rise[..., None])
    off_plane = np.where(is_near, offset[..., 2] - (level_offset @ slope)[..., 0], 0.0)
    count = is_near.sum(axis=1)
    residual = np.sqrt((off_plane**2).sum(axis=1) / np.maximum(count, 1))
    steepness = np.hypot(*slope[..., 0].T)
    is_steep = (steepness > BANK_SLOPES[0]) & (steepness < BANK_SLOPES[1])
    is_bank = (count >= MIN_BANK_CELLS) & (residual < BANK_STEP_M) & is_steep
    slopes[rows[is_bank]] = slope[is_bank, :, 0]
    return slopes


def _mark_between(
    cells: Float64[np.ndarray, "n 3"],
    rows: Int64[np.ndarray, " m"],
    number: Int64[np.ndarray, " n"],
    surfaces: list[HeightMap],
) -> Bool[np.ndarray, " m"]:
    """Mark cells about evenly on the way up from a lower surface to a higher one.

    Args:
        cells: low points of the grid's squares.
        rows: rows of the cells to check.
        number: index in `surfaces` of each cell's surface, -1 for none.
        surfaces: maps of all levels and of the main ground.

    Returns a mask of `rows`."""
    from scipy.spatial import cKDTree

    xy = cells[rows, :2]
    heights = np.stack([surface.at(xy) for surface in surfaces])  # (surfaces, m)
    distance = np.full(heights.shape, np.inf)
    for k in range(len(surfaces)):
        if (number == k).any():
            distance[k] = cKDTree(cells[number == k, :2]).query(xy)[0]
    is_far = distance > MAX_BANK_M
    # index of the lowest and of the highest surface near each cell
    foot = np.where(is_far, np.inf, heights).argmin(axis=0)
    edge = np.where(is_far, -np.inf, heights).argmax(axis=0)
    column = np.arange(len(rows))
    foot_m = heights[foot, column]
    edge_m = heights[edge, column]
    to_foot = distance[foot, column]
    to_edge = distance[edge, column]
    # height and distance of the cell on the way from foot to edge, 0 to 1
    risen_share = (cells[rows, 2] - foot_m) / np.maximum(edge_m - foot_m, KERB_M)
    way_share = to_foot / np.maximum(to_foot + to_edge, KERB_M)
    is_even = np.abs(risen_share - way_share) < MAX_BANK_BEND
    return (risen_share > 0) & (risen_share < 1) & (foot != edge) & is_even
