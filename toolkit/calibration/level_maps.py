"""Height maps of several levels of ground, such as a road, an embankment next to it and a bridge.

A cell is the low point (x, y, z in m) of one square of the grid. In this module `number` holds the
surface of each cell: a level's index from 0, the number of levels for the main ground (before it is
assigned: for the rest), and -1 for no surface."""

import numpy as np

from toolkit.arrays import Bool, Float64, Int64
from toolkit.calibration.height_map import HeightMap, sum_around, weigh_ground
from toolkit.calibration.level_banks import KERB_M, fit_banks
from toolkit.calibration.linked_cells import MIN_LINKS, MIN_SUNKEN_CELLS, ON_GROUND_M, LinkedCells

# rounds in which levels gain cells, and the largest height (m) of such a cell off the level
EXTENSIONS = 4
EXTENSION_M = 0.2
MAX_GAP_M = 15.0  # horizontal distance from a level's cells to a cell that may be on it
MAX_CLEARANCE_M = 0.5  # largest height of a cell above the surface that it is assigned to
# standard deviations of the Gaussian means that draw a level, one pass each, coarse to fine
_SCALES_M = (12.0, 12.0, 12.0, 6.0, 6.0, 6.0, 3.0, 3.0, 1.5, 1.5)
MIN_FREE_SCALE_M = 4.0  # at this scale and above, cells high above the surface weigh as much
_TRUST = 0.2  # weight, in cells, of the surface drawn so far


def draw_levels(
    main: HeightMap,
    cells: Float64[np.ndarray, "n 3"],
    followed: list[Int64[np.ndarray, " _"]],
    links: LinkedCells,
) -> HeightMap:
    """Draw each level through its cells, the main ground through the others, and join them.

    Each place of the joined map has the height of the nearest cell's surface.

    Args:
        main: map of the main ground, which also gives the grid of the result.
        cells: low points of the grid's squares (m), in the frame of the map.
        followed: for each level, the rows of `cells` on it; a cell is on one level at most.
        links: neighbours of the same cells."""
    # surface of each cell: a level's index, len(followed) for the rest
    number = np.full(len(cells), len(followed))
    for k, rows in enumerate(followed):
        number[rows] = k
    above = cells[:, 2] - main.at(cells[:, :2])
    is_rest = number == len(followed)
    on_main = is_rest & links.is_flat & (np.abs(above) < ON_GROUND_M)
    surfaces = _extend_levels(main, cells, number, on_main, links=links, levels=len(followed))
    is_rest = number == len(followed)  # again, since _extend_levels has changed `number`
    if on_main.sum() >= MIN_SUNKEN_CELLS:
        main = _draw_surface(main, cells[on_main])
    surfaces = [*surfaces, main]  # so the number of the rest is the index of the main ground
    is_drawn = ~is_rest | on_main
    unnumbered_rows = np.flatnonzero(~is_drawn)
    drawn_number = np.where(is_drawn, number, -1)
    number[unnumbered_rows] = _number_rest(cells, unnumbered_rows, drawn_number, surfaces)
    slopes = fit_banks(cells, links, number, surfaces)
    return _join_levels(cells, number, slopes, surfaces)


def _extend_levels(
    main: HeightMap,
    cells: Float64[np.ndarray, "n 3"],
    number: Int64[np.ndarray, " n"],
    on_main: Bool[np.ndarray, " n"],
    *,
    links: LinkedCells,
    levels: int,
) -> list[HeightMap]:
    """Draw a map of each level and assign further cells to it, by writing into `number`.

    Args:
        main: map whose grid the levels share.
        cells: low points of the grid's squares (m).
        number: level of each cell, `levels` for the rest. Changed in place.
        on_main: mask of cells on the main ground, which no level takes over.
        links: neighbours of the cells.
        levels: number of levels.

    Returns the map of each level, in order of their numbers."""
    is_rest = number == levels  # cells without a level so far
    has_links = links.is_linked.sum(axis=1) >= MIN_LINKS
    surfaces = [_draw_surface(main, cells[number == k]) for k in range(levels)]
    for _ in range(EXTENSIONS):
        for k, surface in enumerate(surfaces):
            is_elsewhere = on_main | (~is_rest & (number != k))
            is_free = is_rest & has_links
            rows = _find_extension(
                surface, cells, members=number == k, elsewhere=is_elsewhere, free=is_free
            )
            if len(rows):
                number[rows] = k
                is_rest[rows] = False
                surfaces[k] = _draw_surface(main, cells[number == k])
    return surfaces


def _join_levels(
    cells: Float64[np.ndarray, "n 3"],
    number: Int64[np.ndarray, " n"],
    slopes: Float64[np.ndarray, "n 2"],
    surfaces: list[HeightMap],
) -> HeightMap:
    """Return one map that has, at each place, the height of the nearest cell's surface.

    A cell on a bank replaces it within one grid cell, by the bank's plane through it, if it is
    nearer than all cells on surfaces.

    Args:
        cells: low points of the grid's squares (m).
        number: index in `surfaces` of each cell's surface, -1 for cells that are not drawn.
        slopes: rise along x and y (m per m) of cells on a bank, NaN for others.
        surfaces: maps on one grid, the main ground last."""
    from scipy.spatial import cKDTree

    main = surfaces[-1]
    xy = cells[:, :2]
    drawn_rows = np.flatnonzero(number >= 0)
    # x and y of all places of the grid, row by row
    indices = np.meshgrid(*map(np.arange, main.heights.shape), indexing="ij")
    places = np.stack(indices, axis=-1).reshape(-1, 2) * main.cell + main.origin
    distance, nearest_cell = cKDTree(xy[drawn_rows]).query(places)
    nearest_number = number[drawn_rows[nearest_cell]]
    heights = np.stack([surface.heights.ravel() for surface in surfaces])  # (surfaces, places)
    joined_heights = np.take_along_axis(heights, nearest_number[None], axis=0)[0]
    bank_rows = np.flatnonzero(np.isfinite(slopes[:, 0]))
    if len(bank_rows):
        bank_distance, nearest_bank = cKDTree(xy[bank_rows]).query(places)
        is_on_bank = (bank_distance < distance) & (bank_distance < main.cell)
        rows = bank_rows[nearest_bank[is_on_bank]]
        rise = ((places[is_on_bank] - xy[rows]) * slopes[rows]).sum(axis=1)
        joined_heights[is_on_bank] = cells[rows, 2] + rise
    return HeightMap(main.origin, joined_heights.reshape(main.heights.shape), main.cell)


def _find_extension(
    surface: HeightMap,
    cells: Float64[np.ndarray, "n 3"],
    members: Bool[np.ndarray, " n"],
    elsewhere: Bool[np.ndarray, " n"],
    free: Bool[np.ndarray, " n"],
) -> Int64[np.ndarray, " m"]:
    """Rows of free cells that extend a level, such as cells on far rings of a lidar.

    They are within `EXTENSION_M` of its surface and within `MAX_GAP_M` of its cells, and less than
    twice as far from these as from cells of other surfaces.

    Args:
        surface: map of the level.
        cells: low points of the grid's squares (m).
        members: mask of the level's cells.
        elsewhere: mask of cells on other surfaces.
        free: mask of cells that may be added."""
    from scipy.spatial import cKDTree

    xy = cells[:, :2]
    free_rows = np.flatnonzero(free & ~elsewhere)
    height_gap = np.abs(cells[free_rows, 2] - surface.at(xy[free_rows]))
    level_rows = free_rows[height_gap < EXTENSION_M]
    # distances beyond MAX_GAP_M are infinite
    distance, _ = cKDTree(xy[members]).query(xy[level_rows], distance_upper_bound=MAX_GAP_M)
    is_near = np.isfinite(distance)
    near_rows = level_rows[is_near]
    if not elsewhere.any():
        return near_rows
    other_distance, _ = cKDTree(xy[elsewhere]).query(xy[near_rows])
    return near_rows[distance[is_near] < 2 * other_distance]


def _number_rest(
    cells: Float64[np.ndarray, "n 3"],
    unnumbered: Int64[np.ndarray, " m"],
    number: Int64[np.ndarray, " n"],
    surfaces: list[HeightMap],
) -> Int64[np.ndarray, " m"]:
    """Assign surfaces to cells that are below the surface of their nearest numbered cell.

    Such a cell cannot be on that surface, such as a road below the edge of a bridge. It gets the
    highest near surface below it.

    Args:
        cells: low points of the grid's squares (m).
        unnumbered: rows of the cells to assign.
        number: index in `surfaces` of each cell's surface, -1 for none.
        surfaces: maps of all surfaces.

    Returns an index in `surfaces` for each row of `unnumbered`, -1 for cells that stay without."""
    from scipy.spatial import cKDTree

    is_numbered = number >= 0
    xy = cells[unnumbered, :2]
    max_height = cells[unnumbered, 2] + KERB_M  # greatest height of a surface that a cell can be on
    nearest_number = number[is_numbered][cKDTree(cells[is_numbered, :2]).query(xy)[1]]
    heights = np.stack([surface.at(xy) for surface in surfaces])  # (surfaces, m)
    is_impossible = np.take_along_axis(heights, nearest_number[None], axis=0)[0] > max_height
    for k in range(len(surfaces)):
        distance = np.full(len(unnumbered), np.inf)
        if (number == k).any():
            distance = cKDTree(cells[number == k, :2]).query(xy)[0]
        # surfaces above a cell or too far from it cannot be the highest one
        heights[k, (heights[k] > max_height) | (distance > MAX_GAP_M)] = -np.inf
    is_below = is_impossible & (cells[unnumbered, 2] - heights.max(axis=0) < MAX_CLEARANCE_M)
    return np.where(is_below, heights.argmax(axis=0), -1)


def _draw_surface(grid: HeightMap, cells: Float64[np.ndarray, "n 3"]) -> HeightMap:
    """Draw one surface through cells: a plane, then ever finer means of what is left above it.

    Args:
        grid: map whose places the result has; its heights are not used.
        cells: low points (x, y, z in m) on the surface."""
    xy = cells[:, :2]
    # row and column of the place nearest to each cell
    nearest_place = np.round((xy - grid.origin) / grid.cell).astype(np.int64)
    row, column = np.clip(nearest_place, 0, np.array(grid.heights.shape) - 1).T
    heights = _draw_plane(grid, cells)
    for scale in _SCALES_M:
        above = cells[:, 2] - HeightMap(grid.origin, heights, grid.cell).at(xy)
        kerb = KERB_M if scale < MIN_FREE_SCALE_M else np.inf  # infinite: all weights are 1
        weight = weigh_ground(above, kerb)
        # sums of weights, and of weights times heights above the surface, at each place
        weights = np.zeros(heights.shape)
        sums = np.zeros(heights.shape)
        np.add.at(weights, (row, column), weight)
        np.add.at(sums, (row, column), weight * above)
        weight_around = sum_around(weights, scale / grid.cell)
        sum_of_heights = sum_around(sums, scale / grid.cell)
        heights = heights + sum_of_heights / (weight_around + _TRUST)
    return HeightMap(grid.origin, heights, grid.cell)


def _draw_plane(
    grid: HeightMap, cells: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "rows columns"]:
    """Heights (m) of the plane fitted to cells, at the places of a map (rows along x).

    grid: map whose places count; cells: low points (x, y, z in m)."""
    middle = cells[:, :2].mean(axis=0)
    # least squares of z = a x + b y + c, with x and y counted from the middle
    columns_of_cells = np.column_stack([cells[:, :2] - middle, np.ones(len(cells))])
    # pulls both slopes slightly to level, so that cells on one line have a solution
    prior = np.diag([1e-3, 1e-3, 0.0]) * len(cells)
    squares = columns_of_cells.T @ columns_of_cells + prior
    a, b, c = np.linalg.solve(squares, columns_of_cells.T @ cells[:, 2])
    rows, columns = grid.heights.shape
    x = grid.origin[0] + grid.cell * np.arange(rows) - middle[0]
    y = grid.origin[1] + grid.cell * np.arange(columns) - middle[1]
    return a * x[:, None] + b * y[None] + c
