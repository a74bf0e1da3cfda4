"""Banks between two levels of ground."""

import numpy as np

from toolkit.arrays import Bool, Float64, Int64
from toolkit.calibration.height_map import HeightMap
from toolkit.calibration.linked_cells import LinkedCells

# from the cells of both levels, and m per m
MAX_BANK_M = 12.0
BANK_SLOPES = (0.25, 1.2)
MAX_BANK_BEND = 0.3  # part of its height, off the line from foot to edge
# cells that show one bank, and their height off its plane
BANK_CELLS_M = 4.0
MIN_BANK_CELLS = 5
BANK_STEP_M = 0.12
KERB_M = 0.09  # above the drawn surface a cell counts half


def fit_banks(
    cells: Float64[np.ndarray, "n 3"],
    links: LinkedCells,
    number: Int64[np.ndarray, " n"],
    surfaces: list[HeightMap],
) -> Float64[np.ndarray, "n 2"]:
    """Slopes along x and y of cells on a bank between two levels, NaN for other cells.

    Cells of no level are on a bank if those about them are on one plane, lower than one level
    and higher than another; vehicles are not."""
    slopes = np.full((len(cells), 2), np.nan)
    rows = np.flatnonzero(number < 0)
    if not len(rows):
        return slopes
    rows = rows[_mark_between(cells, rows, number, surfaces)]
    neighbours = links.other[rows]
    offset = cells[neighbours] - cells[rows, None]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    is_near = (number[neighbours] < 0) & (distance < BANK_CELLS_M)
    level_offset = np.where(is_near[..., None], offset[..., :2], 0.0)
    rise = np.where(is_near, offset[..., 2], 0.0)
    transposed = level_offset.transpose(0, 2, 1)
    squares = transposed @ level_offset + 0.1 * np.eye(2)
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
    """Mark cells that rise from a lower level near by to a higher one, about evenly."""
    from scipy.spatial import cKDTree

    xy = cells[rows, :2]
    heights = np.stack([surface.at(xy) for surface in surfaces])
    distance = np.full(heights.shape, np.inf)
    for k in range(len(surfaces)):
        if (number == k).any():
            distance[k] = cKDTree(cells[number == k, :2]).query(xy)[0]
    is_far = distance > MAX_BANK_M
    foot = np.where(is_far, np.inf, heights).argmin(axis=0)
    edge = np.where(is_far, -np.inf, heights).argmax(axis=0)
    column = np.arange(len(rows))
    foot_m = heights[foot, column]
    edge_m = heights[edge, column]
    to_foot = distance[foot, column]
    to_edge = distance[edge, column]
    risen_share = (cells[rows, 2] - foot_m) / np.maximum(edge_m - foot_m, KERB_M)
    way_share = to_foot / np.maximum(to_foot + to_edge, KERB_M)
    is_even = np.abs(risen_share - way_share) < MAX_BANK_BEND
    return (risen_share > 0) & (risen_share < 1) & (foot != edge) & is_even
