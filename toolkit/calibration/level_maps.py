"""Height maps of several levels of ground."""

import numpy as np

from toolkit.arrays import Bool, Float64, Int64
from toolkit.calibration.height_map import HeightMap, sum_around, weigh_ground
from toolkit.calibration.level_banks import KERB_M, fit_banks
from toolkit.calibration.linked_cells import MIN_LINKS, MIN_SUNKEN_CELLS, ON_GROUND_M, LinkedCells

# rounds, and height off the level
EXTENSIONS = 4
EXTENSION_M = 0.2
MAX_GAP_M = 15.0  # from a level's cells to what may be on it
MAX_CLEARANCE_M = 0.5  # above a road user
_SCALES_M = (12.0, 12.0, 12.0, 6.0, 6.0, 6.0, 3.0, 3.0, 1.5, 1.5)  # for the means that draw a level
MIN_FREE_SCALE_M = 4.0  # from which kerbs and road users do not count less
_TRUST = 0.2  # cells: weight of the wider mean


def draw_levels(
    main: HeightMap,
    cells: Float64[np.ndarray, "n 3"],
    followed: list[Int64[np.ndarray, " k"]],
    links: LinkedCells,
) -> HeightMap:
    """Draw each level through its cells, the main ground through the others.

    Each place has the height of the nearest cell's level. followed: rows of each level's cells."""
    number = np.full(len(cells), len(followed))
    for k, rows in enumerate(followed):
        number[rows] = k
    above = cells[:, 2] - main.at(cells[:, :2])
    is_rest = number == len(followed)
    on_main = is_rest & links.flat & (np.abs(above) < ON_GROUND_M)
    surfaces = _extend_levels(main, cells, number, on_main, links=links, levels=len(followed))
    is_rest = number == len(followed)
    if on_main.sum() >= MIN_SUNKEN_CELLS:
        main = _draw_surface(main, cells[on_main])
    surfaces = [*surfaces, main]
    is_drawn = ~is_rest | on_main
    unnumbered = np.flatnonzero(~is_drawn)
    drawn_number = np.where(is_drawn, number, -1)
    number[unnumbered] = _number_rest(cells, unnumbered, drawn_number, surfaces)
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
    """Draw the levels and give them further cells on their surface, by writing into `number`.

    number: level of each cell, `levels` for the rest."""
    is_rest = number == levels
    is_supported = links.linked.sum(axis=1) >= MIN_LINKS
    surfaces = [_draw_surface(main, cells[number == k]) for k in range(levels)]
    for _ in range(EXTENSIONS):
        for k, surface in enumerate(surfaces):
            elsewhere = on_main | (~is_rest & (number != k))
            free = is_rest & is_supported
            rows = _find_extension(surface, cells, number == k, elsewhere, free)
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
    """Map with the surface of the nearest cell at each place; a bank's cells give its slope."""
    from scipy.spatial import cKDTree

    main = surfaces[-1]
    drawn_rows = np.flatnonzero(number >= 0)
    grid = np.stack(np.meshgrid(*map(np.arange, main.heights.shape), indexing="ij"), axis=-1)
    places = grid.reshape(-1, 2) * main.cell + main.origin
    distance, nearest = cKDTree(cells[drawn_rows, :2]).query(places)
    heights = np.stack([surface.heights.ravel() for surface in surfaces])
    nearest_number = number[drawn_rows[nearest]]
    joined = np.take_along_axis(heights, nearest_number[None], axis=0)[0]
    banks = np.flatnonzero(np.isfinite(slopes[:, 0]))
    if len(banks):
        bank_distance, nearest_bank = cKDTree(cells[banks, :2]).query(places)
        on_bank = (bank_distance < distance) & (bank_distance < main.cell)
        rows = banks[nearest_bank[on_bank]]
        offsets = places[on_bank] - cells[rows, :2]
        joined[on_bank] = cells[rows, 2] + (offsets * slopes[rows]).sum(axis=1)
    return HeightMap(main.origin, joined.reshape(main.heights.shape), main.cell)


def _find_extension(
    surface: HeightMap,
    cells: Float64[np.ndarray, "n 3"],
    members: Bool[np.ndarray, " n"],
    elsewhere: Bool[np.ndarray, " n"],
    free: Bool[np.ndarray, " n"],
) -> Int64[np.ndarray, " m"]:
    """Rows of free cells that extend a level, such as those on far rings of a lidar.

    They are on its surface, and nearer to its cells than to half the distance of others."""
    from scipy.spatial import cKDTree

    rows = np.flatnonzero(free & ~elsewhere)
    on = np.abs(cells[rows, 2] - surface.at(cells[rows, :2])) < EXTENSION_M
    rows = rows[on]
    distance = cKDTree(cells[members, :2]).query(cells[rows, :2], distance_upper_bound=MAX_GAP_M)[0]
    rows = rows[np.isfinite(distance)]
    distance = distance[np.isfinite(distance)]
    if not elsewhere.any():
        return rows
    return rows[distance < 2 * cKDTree(cells[elsewhere, :2]).query(cells[rows, :2])[0]]


def _number_rest(
    cells: Float64[np.ndarray, "n 3"],
    unnumbered: Int64[np.ndarray, " m"],
    number: Int64[np.ndarray, " n"],
    surfaces: list[HeightMap],
) -> Int64[np.ndarray, " m"]:
    """Surface of cells below the nearest surface: the highest one below them, -1 for others."""
    from scipy.spatial import cKDTree

    is_numbered = number >= 0
    xy = cells[unnumbered, :2]
    top = cells[unnumbered, 2] + KERB_M
    nearest = number[is_numbered][cKDTree(cells[is_numbered, :2]).query(xy)[1]]
    heights = np.stack([surface.at(xy) for surface in surfaces])
    impossible = np.take_along_axis(heights, nearest[None], axis=0)[0] > top
    for k in range(len(surfaces)):
        distance = np.full(len(unnumbered), np.inf)
        if (number == k).any():
            distance = cKDTree(cells[number == k, :2]).query(xy)[0]
        heights[k, (heights[k] > top) | (distance > MAX_GAP_M)] = -np.inf
    is_below = impossible & (cells[unnumbered, 2] - heights.max(axis=0) < MAX_CLEARANCE_M)
    return np.where(is_below, heights.argmax(axis=0), -1)


def _draw_surface(grid: HeightMap, cells: Float64[np.ndarray, "n 3"]) -> HeightMap:
    """Draw one surface on the places of a grid: a plane, then ever finer means of the rest."""
    last = np.array(grid.heights.shape) - 1
    i, j = np.clip(np.round((cells[:, :2] - grid.origin) / grid.cell).astype(np.int64), 0, last).T
    middle = cells[:, :2].mean(axis=0)
    flat = np.column_stack([cells[:, :2] - middle, np.ones(len(cells))])
    prior = np.diag([1e-3, 1e-3, 0.0]) * len(cells)
    a, b, c = np.linalg.solve(flat.T @ flat + prior, flat.T @ cells[:, 2])
    rows, columns = grid.heights.shape
    x = grid.origin[0] + grid.cell * np.arange(rows) - middle[0]
    y = grid.origin[1] + grid.cell * np.arange(columns) - middle[1]
    heights = a * x[:, None] + b * y[None] + c
    for scale in _SCALES_M:
        above = cells[:, 2] - HeightMap(grid.origin, heights, grid.cell).at(cells[:, :2])
        weights = np.zeros(heights.shape)
        sums = np.zeros(heights.shape)
        kerb = KERB_M if scale < MIN_FREE_SCALE_M else np.inf
        weight = weigh_ground(above, kerb)
        np.add.at(weights, (i, j), weight)
        np.add.at(sums, (i, j), weight * above)
        weight_around = sum_around(weights, scale / grid.cell)
        sum_of_heights = sum_around(sums, scale / grid.cell)
        heights = heights + sum_of_heights / (weight_around + _TRUST)
    return HeightMap(grid.origin, heights, grid.cell)
