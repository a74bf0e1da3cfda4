"""Height maps: ground as one height for each cell of a grid, drawn through the lowest points of the
cells."""

from dataclasses import dataclass, replace

import numpy as np

from toolkit.arrays import Bool, Float, Float64, Points

_Cells = Float64[np.ndarray, "m 3"]

GROUND_CELL_M = 1.0
STEP_WINDOW_M = 12.0  # a cell is not ground if something within this distance is lower
_NEIGHBOUR_M = 8.0  # farther apart, cells do not support each other
MAX_MAP_CELLS = 4_000_000  # largest number of cells in a grid
_NO_HEIGHT_M = 1e6  # height of a cell without points, above anything
GROUND_REACH_M = 100.0  # from the middle of a map's points; farther out its edge holds
_BAND_M = 2.0  # largest distance above and below the plane in which ground is looked for
# rise of ground in addition to the plane's slope (m per m), and of a kerb (m)
_SLOPE = 0.08
_KERB_M = 0.10
_WINDOW_M = 8.0  # m: a cell is not ground if something within this distance is lower
_SCALES_M = (12.0, 6.0, 3.0, 1.5)  # m, of the Gaussian means
_PRIOR_CELLS = 1.0  # weight, in cells, of the mean at the wider scale before
# For each drawing: height (m) above the map that a cell of ground may have, and the height at which
# it counts half.
_DRAWINGS = (
    (0.25, np.inf),
    (0.25, np.inf),
    (0.20, np.inf),
    (0.20, 0.09),
    (0.20, 0.09),
    (0.20, 0.09),
    (0.12, 0.09),
)


def low_points(points: Points, cell: float, share: float = 0.1) -> _Cells:
    """Return a low point of each cell of a horizontal grid that has points.

    Args:
        points: points (m); those with NaN or infinity are left out.
        cell: edge of the square cells (m).
        share: share of the cell's points that are below its low point, 0 for the lowest.

    Returns the points (m, 3) in order of their cells, along x, then along y."""
    finite_points = points[np.isfinite(points).all(axis=1)].astype(np.float64)
    if not len(finite_points):
        return np.empty((0, 3))
    index = np.floor(finite_points[:, :2] / cell).astype(np.int64)
    row, column = (index - index.min(axis=0)).T
    cell_key = row * (int(column.max()) + 1) + column
    order = np.lexsort((finite_points[:, 2], cell_key))  # by cell, then by height
    first = np.flatnonzero(np.diff(cell_key[order], prepend=-1))  # each cell's lowest point
    count = np.diff(np.append(first, len(order)))
    rank = np.floor(share * (count - 1)).astype(np.int64)  # the low point's rank in its cell
    return finite_points[order[first + rank]]


def support_mask(
    cells: _Cells, step: float, slope: float, *, min_supporters: int
) -> Bool[np.ndarray, " m"]:
    """Mark cells that have enough of their twelve nearest cells at about the same height.

    Args:
        cells: low points (m) of a grid's cells.
        step: difference in height (m) that is still the same height, at any distance.
        slope: further difference for each metre of distance.
        min_supporters: least number of such neighbours within `_NEIGHBOUR_M`.

    All cells are marked if there are too few to decide."""
    from scipy.spatial import cKDTree

    count = min(13, len(cells))  # the cell itself and twelve others
    if count <= min_supporters:
        return np.ones(len(cells), bool)
    xy = cells[:, :2]
    z = cells[:, 2]
    distance, neighbours = cKDTree(xy).query(xy, count)
    rise = np.abs(z[neighbours] - z[:, None])
    is_supporter = (rise < step + slope * distance) & (distance < _NEIGHBOUR_M)
    # the first neighbour is the cell itself
    return is_supporter[:, 1:].sum(axis=1) >= min_supporters


def lowest_mask(
    cells: _Cells, slope: float, step: float, *, window: float = STEP_WINDOW_M
) -> Bool[np.ndarray, " m"]:
    """Mark cells that have no clearly lower cell nearby.

    Args:
        cells: low points (m) of a grid's cells.
        slope: rise of the ground (m per m, along x plus along y) that explains a lower cell.
        step: further difference in height (m) that is allowed.
        window: distance (m) along each axis in which lower cells are looked for.

    Raises ValueError if the cells reach too far for an image of their grid."""
    from scipy.ndimage import grey_erosion

    if not len(cells):
        return np.empty(0, bool)
    index = np.floor(cells[:, :2] / GROUND_CELL_M).astype(np.int64)
    index -= index.min(axis=0)
    row, column = index.T
    rows, columns = (index.max(axis=0) + 1).tolist()
    if rows * columns > MAX_MAP_CELLS:
        extent = f"{rows * GROUND_CELL_M:.0f} by {columns * GROUND_CELL_M:.0f} m"
        raise ValueError(f"the points cover {extent}: crop them to the place in question")
    image = np.full((rows, columns), _NO_HEIGHT_M)
    image[row, column] = cells[:, 2]
    reach = round(window / GROUND_CELL_M)
    # Erosion takes the smallest height less `rise`, that is, height plus slope times distance.
    # One pass along each axis gives the same as a square window.
    rise = -slope * GROUND_CELL_M * np.abs(np.arange(-reach, reach + 1))
    along = grey_erosion(image, structure=rise[:, None], mode="constant", cval=_NO_HEIGHT_M)
    allowed_height = grey_erosion(along, structure=rise[None], mode="constant", cval=_NO_HEIGHT_M)
    return cells[:, 2] <= allowed_height[row, column] + step


@dataclass(frozen=True)
class HeightMap:
    """Heights of the ground on a grid.

    Attributes:
        origin: x and y (m) of the first place.
        heights: height (m) at the places origin + cell · (i, j): rows along x, columns along y.
        cell: distance of the places (m)."""

    origin: Float64[np.ndarray, "2"]
    heights: Float64[np.ndarray, "rows columns"]
    cell: float = GROUND_CELL_M

    def at(self, xy: Float[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
        """Height (m) at each x and y, interpolated bilinearly; outside the grid the height of its
        edge."""
        from scipy.ndimage import map_coordinates

        index = (np.asarray(xy, np.float64) - self.origin) / self.cell
        return map_coordinates(self.heights, index.T, order=1, mode="nearest")


def fit_map(points: Points, *, reach: float = GROUND_REACH_M) -> HeightMap:
    """Fit a map of heights to points with ground near z = 0.

    Args:
        points: (n, 3) m, level.
        reach: distance (m) along x and y from the middle of the points that the map covers.

    Returns a map of one place at height 0 if no point is within `_BAND_M` of z = 0. Raises
    ValueError unless `reach` is above 0 and finite."""
    if not 0 < reach < np.inf:
        raise ValueError(f"reach must be above 0 m, got {reach}")
    band_points = points[np.abs(points[:, 2]) < _BAND_M]
    if not len(band_points):
        return HeightMap(np.zeros(2), np.zeros((1, 1)))
    middle = np.median(band_points[:, :2], axis=0).astype(np.float64)
    is_in_reach = np.abs(band_points[:, :2] - middle).max(axis=1) <= reach
    ground_points = band_points[is_in_reach]
    xy = ground_points[:, :2]
    # middle of the first cell; the grid has a place in the middle of every cell
    first_corner = np.floor(xy.min(axis=0).astype(np.float64) / GROUND_CELL_M) * GROUND_CELL_M
    origin = first_corner + GROUND_CELL_M / 2
    shape = np.floor((xy.max(axis=0) - origin) / GROUND_CELL_M).astype(np.int64) + 2
    cells = low_points(ground_points, GROUND_CELL_M)
    cells = cells[support_mask(cells, _KERB_M, _SLOPE, min_supporters=4)]
    cells = cells[lowest_mask(cells, _SLOPE, _KERB_M, window=_WINDOW_M)]
    cells = cells[support_mask(cells, _KERB_M, _SLOPE, min_supporters=6)]
    # drawn again and again through the cells near it, with ever stricter limits
    surface = HeightMap(origin, np.zeros(tuple(shape)))
    for max_above, kerb in _DRAWINGS:
        surface = redraw_map(surface, cells, max_above, kerb)
    # low points are biased downwards: the last drawing is through medians of points on the ground
    max_above, kerb = _DRAWINGS[-1]
    is_on_ground = np.abs(ground_points[:, 2] - surface.at(xy)) < max_above
    medians = low_points(ground_points[is_on_ground], GROUND_CELL_M, share=0.5)
    return redraw_map(surface, medians, max_above, kerb)


def redraw_map(surface: HeightMap, cells: _Cells, max_above: float, kerb: float) -> HeightMap:
    """Draw a map again through the cells near it.

    Args:
        surface: map so far, whose grid the new one has.
        cells: low points (m) of the grid's cells.
        max_above: height (m) above the map up to which cells count; below it, twice that.
        kerb: height (m) above the map at which a cell counts half, infinite for equal weights."""
    above = cells[:, 2] - surface.at(cells[:, :2])
    is_near = (above < max_above) & (above > -2 * max_above)
    weight = weigh_ground(above[is_near], kerb)
    near_cells = cells[is_near]
    # sums of weights, and of weights times heights, at the place nearest to each cell
    weights = np.zeros(surface.heights.shape)
    sums = np.zeros(surface.heights.shape)
    index = np.round((near_cells[:, :2] - surface.origin) / surface.cell).astype(np.int64)
    row, column = index.T
    np.add.at(weights, (row, column), weight)
    np.add.at(sums, (row, column), weight * near_cells[:, 2])
    heights = np.zeros(surface.heights.shape)
    # the finer mean takes over where cells are dense, the wider one stays between them
    for scale in _SCALES_M:
        weight_around = sum_around(weights, scale / surface.cell)
        sum_of_heights = sum_around(sums, scale / surface.cell)
        heights = (sum_of_heights + _PRIOR_CELLS * heights) / (weight_around + _PRIOR_CELLS)
    return replace(surface, heights=heights)


def weigh_ground(above: Float64[np.ndarray, " n"], kerb: float) -> Float64[np.ndarray, " n"]:
    """Weight of cells by their height above a surface: 1 on or below it, 0.5 at `kerb` (m)."""
    return np.asarray(1 / (1 + (np.clip(above, 0, None) / kerb) ** 4))


def sum_around(
    image: Float64[np.ndarray, "rows columns"], wide: float
) -> Float64[np.ndarray, "rows columns"]:
    """Sum an image about each of its cells, with Gaussian weights that begin at 1.

    wide: standard deviation (cells)."""
    from scipy.ndimage import gaussian_filter

    mean = gaussian_filter(image, wide, mode="constant", truncate=3.0)
    # the weights of the mean begin at 1 / (2 π wide²)
    return np.asarray(mean * (2 * np.pi * wide**2))
