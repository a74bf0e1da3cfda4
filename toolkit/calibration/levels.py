"""Further levels of ground next to the main one: embankments, bridges, ramps and dips.

A height map follows one smooth ground within two metres of a plane. A road on an embankment leaves
it, and so does a deck or an underpass. The lowest points of the cells that leave it are linked
where they continue each other. A linked surface is ground if it is below the main one, or if it is
above with nothing of the main ground below it and is as wide and long as a road. Roofs, hedges and
rows of lorries are too narrow or too short; they are counted, not followed."""

from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float64, Int64, Points
from toolkit.calibration.height_map import HeightMap, sum_around, weigh_ground

LINK_M = 5.0  # farthest neighbour that continues a surface
# rise that continues it
LINK_STEP_M = 0.08
LINK_SLOPE = 0.11
# gap between pieces of one surface, and its rise
JOIN_M = 8.0
JOIN_SLOPE = 0.07
MIN_JOIN_CELLS = 12  # in a piece
MAX_NEIGHBOURS = 12  # around a cell, nearest first
FLAT_SHARE = 0.45  # part of a cell's neighbours that continue it
# from the main ground to a level's core and its edges
OFF_M = 0.3
EDGE_M = 0.1
# about a cell inside a road, and those with a neighbour in the ring
SECTORS = 8
MIN_SECTORS = 6
RING_M = (2.3, 5.0)
# cells inside a raised road, and its length
MIN_RAISED_CELLS = 20
MIN_RAISED_M = 28.0
MIN_SUNKEN_CELLS = 5
MIN_SUNKEN_M = 10.0
MIN_LINKS = 2  # from a cell that extends a level
# rounds, and height off the level
EXTENSIONS = 4
EXTENSION_M = 0.2
# from the cells of both levels, and m per m
MAX_BANK_M = 12.0
BANK_SLOPES = (0.25, 1.2)
MAX_BANK_BEND = 0.3  # part of its height, off the line from foot to edge
# cells that show one bank, and their height off its plane
BANK_CELLS_M = 4.0
MIN_BANK_CELLS = 5
BANK_STEP_M = 0.12
MAX_GAP_M = 15.0  # from a level's cells to what may be on it
MAX_CLEARANCE_M = 0.5  # above a road user
# part of the points, and above the ground found
MIN_DOUBT_SHARE = 0.05
MIN_DOUBT_M = 0.8
ON_GROUND_M = 0.3
MAX_HEIGHT_M = 100.0  # from points above or below the main plane
_SCALES_M = (12.0, 12.0, 12.0, 6.0, 6.0, 6.0, 3.0, 3.0, 1.5, 1.5)  # for the means that draw a level
MIN_FREE_SCALE_M = 4.0  # from which kerbs and road users do not count less
_TRUST = 0.2  # cells: weight of the wider mean
KERB_M = 0.09  # above the drawn surface a cell counts half


@dataclass(frozen=True)
class GroundLevel:
    """Surface away from the main ground.

    Attributes:
        height_m: median height above the main ground.
        share: part of all points on it.
        followed: True for ground, False for a surface that may be a roof."""

    height_m: float
    share: float
    followed: bool


def add_levels(main: HeightMap, points: Points) -> tuple[HeightMap, tuple[GroundLevel, ...]]:
    """Add further levels of ground to a map.

    main: map of the main ground; points: (n, 3) m, level, as `fit_map` takes them. Return the map
    with every level where it is nearest, and the levels; the same map where there is none."""
    if main.heights.size == 1:
        return main, ()
    squares = _Squares.sort(main, points)
    cells = squares.low
    surface = _Surface.link(cells)
    above = cells[:, 2] - main.at(cells[:, :2])
    numbers = surface.number_levels(above)
    count = numbers.max(initial=-1) + 1
    shares = squares.count_near(numbers, count) / max(1, len(points))
    covered = squares.least < main.at(cells[:, :2]) + ON_GROUND_M
    levels: list[GroundLevel] = []
    followed: list[Int64[np.ndarray, " k"]] = []
    for number, share in enumerate(shares.tolist()):
        rows = np.flatnonzero(numbers == number)
        is_ground = surface.is_ground(rows, above[rows], covered[rows])
        height = float(np.median(above[rows]))
        if is_ground:
            followed.append(rows)
        if is_ground or height > MIN_DOUBT_M:
            levels.append(GroundLevel(height, share, is_ground))
    return (_draw_levels(main, cells, followed, surface) if followed else main), tuple(levels)


def describe_levels(levels: tuple[GroundLevel, ...]) -> str | None:
    """Return the largest doubt, else the largest further level, in one line; None for one ground
    without doubt."""
    for followed in (False, True):
        same_kind = [level for level in levels if level.followed == followed]
        share = sum(ground_level.share for ground_level in same_kind)
        if share >= MIN_DOUBT_SHARE:
            height = max(same_kind, key=lambda ground_level: ground_level.share).height_m
            side = "above" if height > 0 else "below"
            points = f"{share:.0%} of the points are {abs(height):.1f} m {side} the ground found"
            if followed:
                return f"{points}: they are levelled as further ground, such as a raised road"
            return f"{points}: give the road's own --area if they are a road; a roof needs nothing"
    return None


class _Squares(NamedTuple):
    """Points sorted by square of a grid, then by height.

    Attributes:
        z: (n,) m, heights in that order.
        square: (n,) row in `low` of each.
        low: (m, 3) m, the point of each square with a tenth of its points below it.
        least: (m,) m, height of each square's lowest point."""

    z: Float64[np.ndarray, " n"]
    square: Int64[np.ndarray, " n"]
    low: Float64[np.ndarray, "m 3"]
    least: Float64[np.ndarray, " m"]

    @staticmethod
    def sort(grid: HeightMap, points: Points) -> "_Squares":
        rows, columns = grid.heights.shape
        index = np.floor((points[:, :2] - grid.origin) / grid.cell + 0.5)
        inside = ((index >= 0) & (index < [rows, columns])).all(axis=1) & (
            np.abs(points[:, 2]) < MAX_HEIGHT_M
        )
        points = points[inside]
        index = index[inside].astype(np.int64)
        key = index[:, 0] * columns + index[:, 1]
        # mm, so that one key sorts both
        height = np.round((points[:, 2] + MAX_HEIGHT_M) * 1000).astype(np.int64)
        order = np.argsort(key * round(3000 * MAX_HEIGHT_M) + height)
        sorted_key = key[order]
        first = np.flatnonzero(np.diff(sorted_key, prepend=-1))
        count = np.diff(np.append(first, len(order)))
        square = np.repeat(np.arange(len(first)), count)
        low = points[order[first + count // 10]]
        return _Squares(points[order, 2], square, low, points[order[first], 2])

    def count_near(
        self, numbers: Int64[np.ndarray, " m"], count: int
    ) -> Int64[np.ndarray, " count"]:
        """Number of points a step from the low points of the squares of each number."""
        on = np.abs(self.z - self.low[self.square, 2]) < ON_GROUND_M
        number = numbers[self.square[on]]
        return np.bincount(number[number >= 0], minlength=count)


@dataclass(frozen=True, eq=False)
class _Surface:
    """Cells, their neighbours (n, k) with a mask of what continues the cell, and a mask of flat
    cells."""

    cells: Float64[np.ndarray, "n 3"]
    other: Int64[np.ndarray, "n k"]
    linked: Bool[np.ndarray, "n k"]
    flat: Bool[np.ndarray, " n"]

    @staticmethod
    def link(cells: Float64[np.ndarray, "n 3"]) -> "_Surface":
        from scipy.spatial import cKDTree

        count = min(MAX_NEIGHBOURS + 1, len(cells))
        distance, neighbours = cKDTree(cells[:, :2]).query(cells[:, :2], count)
        distance = distance.reshape(len(cells), count)[:, 1:]
        neighbours = neighbours.reshape(len(cells), count)[:, 1:]
        rise = np.abs(cells[neighbours, 2] - cells[:, None, 2])
        near = distance < LINK_M
        linked = near & (rise < LINK_STEP_M + LINK_SLOPE * distance)
        flat = (linked.sum(axis=1) >= 3) & (linked.sum(axis=1) >= FLAT_SHARE * near.sum(axis=1))
        return _Surface(cells, neighbours, linked, flat)

    def number_levels(self, above: Float64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
        """Return the number of each cell's linked surface off the main ground, -1 for other
        cells."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        side = np.where(np.abs(above) > EDGE_M, np.sign(above), 0.0)
        member = self.flat & (side != 0)
        same = (
            self.linked & member[:, None] & member[self.other] & (side[self.other] == side[:, None])
        )
        cell, column = np.nonzero(same)
        size = (len(above), len(above))
        _, group = connected_components(
            coo_array((np.ones(len(cell), bool), (cell, self.other[cell, column])), size)
        )
        core = member & (np.abs(above) > OFF_M)
        enough = np.bincount(group[core], minlength=group.max(initial=0) + 1) >= MIN_SUNKEN_CELLS
        is_numbered = member & enough[group]
        numbers = np.full(len(above), -1)
        numbers[is_numbered] = np.unique(group[is_numbered], return_inverse=True)[1]
        return self._join(numbers, side)

    def _join(
        self, numbers: Int64[np.ndarray, " n"], side: Float64[np.ndarray, " n"]
    ) -> Int64[np.ndarray, " n"]:
        """Give pieces of a road one number that road users and their shadows part."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components
        from scipy.spatial import cKDTree

        count = numbers.max(initial=-1) + 1
        rows = [np.flatnonzero(numbers == number) for number in range(count)]
        trees = [cKDTree(self.cells[members, :2]) for members in rows]
        pairs: list[tuple[int, int]] = []
        large = [number for number in range(count) if len(rows[number]) >= MIN_JOIN_CELLS]
        for first_piece, second_piece in combinations(large, 2):
            distance, nearest_row = trees[second_piece].query(
                self.cells[rows[first_piece], :2], distance_upper_bound=JOIN_M
            )
            near = np.flatnonzero(np.isfinite(distance))
            first_cells = rows[first_piece][near]
            second_cells = rows[second_piece][nearest_row[near]]
            rise = np.abs(self.cells[first_cells, 2] - self.cells[second_cells, 2])
            fits = (rise < LINK_STEP_M + JOIN_SLOPE * distance[near]) & (
                side[first_cells] == side[second_cells]
            )
            if fits.sum() >= MIN_LINKS:
                pairs.append((first_piece, second_piece))
        if not pairs:
            return numbers
        first_numbers, second_numbers = np.array(pairs).T
        _, joined = connected_components(
            coo_array(
                (np.ones(len(first_numbers), bool), (first_numbers, second_numbers)), (count, count)
            )
        )
        return np.where(numbers < 0, -1, joined[numbers])

    def is_ground(
        self,
        rows: Int64[np.ndarray, " k"],
        above: Float64[np.ndarray, " k"],
        covered: Bool[np.ndarray, " k"],
    ) -> bool:
        """Return True for a surface that is wide and long enough, with no ground below it."""
        core = np.abs(above) > OFF_M
        xy = self.cells[rows[core], :2]
        sunken = np.median(above[core]) < 0
        count, length = (
            (MIN_SUNKEN_CELLS, MIN_SUNKEN_M) if sunken else (MIN_RAISED_CELLS, MIN_RAISED_M)
        )
        inside = _count_inside(xy)
        along = np.linalg.svd(xy - xy.mean(axis=0), full_matrices=False)[2][0]
        extent = float(np.ptp(xy @ along))
        hides = not sunken and covered[core].mean() > 0.5
        return inside >= count and extent >= length and not hides


def _count_inside(xy: Float64[np.ndarray, "n 2"]) -> int:
    """Count the cells with others on nearly all sides, as far off as the half of a road's width."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(xy).query_pairs(RING_M[1], output_type="ndarray")
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    way = xy[pairs[:, 1]] - xy[pairs[:, 0]]
    far = np.hypot(*way.T) > RING_M[0]
    sector = (
        np.floor((np.arctan2(way[far, 1], way[far, 0]) / (2 * np.pi) + 0.5) * SECTORS).astype(int)
        % SECTORS
    )
    met = np.zeros((len(xy), SECTORS), bool)
    met[pairs[far, 0], sector] = True
    return int((met.sum(axis=1) >= MIN_SECTORS).sum())


def _draw_levels(
    main: HeightMap,
    cells: Float64[np.ndarray, "n 3"],
    followed: list[Int64[np.ndarray, " k"]],
    links: "_Surface",
) -> HeightMap:
    """Draw each level through its cells, the main ground through the others, and take the nearest
    at each place."""
    from scipy.spatial import cKDTree

    number = np.full(len(cells), len(followed))
    for k, rows in enumerate(followed):
        number[rows] = k
    above = cells[:, 2] - main.at(cells[:, :2])
    is_rest = number == len(followed)
    supported = links.linked.sum(axis=1) >= MIN_LINKS
    on_main = is_rest & links.flat & (np.abs(above) < ON_GROUND_M)
    surfaces = [_draw_surface(main, cells[rows]) for rows in followed]
    for _ in range(EXTENSIONS):
        for k, level_surface in enumerate(surfaces):
            rows = _extension(
                level_surface,
                cells,
                number == k,
                on_main | (~is_rest & (number != k)),
                is_rest & supported,
            )
            if len(rows):
                number[rows] = k
                is_rest[rows] = False
                surfaces[k] = _draw_surface(main, cells[number == k])
    if on_main.sum() >= MIN_SUNKEN_CELLS:
        main = _draw_surface(main, cells[on_main])
    is_drawn = ~is_rest | on_main
    unnumbered = np.flatnonzero(~is_drawn)
    number[unnumbered] = _number_rest(
        cells, unnumbered, np.where(is_drawn, number, -1), [*surfaces, main]
    )
    slopes = _fit_banks(cells, links, number, [*surfaces, main])
    is_bank = np.isfinite(slopes[:, 0])
    is_drawn = np.flatnonzero(number >= 0)
    grid = np.stack(np.meshgrid(*map(np.arange, main.heights.shape), indexing="ij"), axis=-1)
    places = grid.reshape(-1, 2) * main.cell + main.origin
    distance, nearest = cKDTree(cells[is_drawn, :2]).query(places)
    heights = np.stack([surface.heights.ravel() for surface in (*surfaces, main)])
    drawn = np.take_along_axis(heights, number[is_drawn[nearest]][None], axis=0)[0]
    banks = np.flatnonzero(is_bank)
    if len(banks):
        bank_apart, nearest_bank = cKDTree(cells[banks, :2]).query(places)
        on_bank = (bank_apart < distance) & (bank_apart < main.cell)
        rows = banks[nearest_bank[on_bank]]
        drawn[on_bank] = cells[rows, 2] + ((places[on_bank] - cells[rows, :2]) * slopes[rows]).sum(
            axis=1
        )
    return HeightMap(main.origin, drawn.reshape(main.heights.shape), main.cell)


def _fit_banks(
    cells: Float64[np.ndarray, "n 3"],
    links: "_Surface",
    number: Int64[np.ndarray, " n"],
    surfaces: list[HeightMap],
) -> Float64[np.ndarray, "n 2"]:
    """Return the slopes along x and y of cells on a bank between two levels, NaN for other cells.

    Cells of no level are on a bank where those about them are on one plane, lower than one level
    and higher than another; vehicles are not."""
    from scipy.spatial import cKDTree

    slopes = np.full((len(cells), 2), np.nan)
    rows = np.flatnonzero(number < 0)
    if not len(rows):
        return slopes
    xy = cells[rows, :2]
    z = cells[rows, 2]
    heights = np.stack([surface.at(xy) for surface in surfaces])
    distance = np.full(heights.shape, np.inf)
    for k in range(len(surfaces)):
        if (number == k).any():
            distance[k] = cKDTree(cells[number == k, :2]).query(xy)[0]
    is_far = distance > MAX_BANK_M
    foot = np.where(is_far, np.inf, heights).argmin(axis=0)[None]
    edge = np.where(is_far, -np.inf, heights).argmax(axis=0)[None]
    foot_m, edge_m = (np.take_along_axis(heights, level, axis=0)[0] for level in (foot, edge))
    to_foot, to_edge = (np.take_along_axis(distance, level, axis=0)[0] for level in (foot, edge))
    risen = (z - foot_m) / np.maximum(edge_m - foot_m, KERB_M)
    along = to_foot / np.maximum(to_foot + to_edge, KERB_M)
    between = (
        (risen > 0) & (risen < 1) & (foot[0] != edge[0]) & (np.abs(risen - along) < MAX_BANK_BEND)
    )
    rows = rows[between]
    neighbours = links.other[rows]
    offset = cells[neighbours] - cells[rows, None]
    near = (number[neighbours] < 0) & (np.hypot(offset[..., 0], offset[..., 1]) < BANK_CELLS_M)
    flat = np.where(near[..., None], offset[..., :2], 0.0)
    squares = flat.transpose(0, 2, 1) @ flat + 0.1 * np.eye(2)
    fitted = np.linalg.solve(
        squares, flat.transpose(0, 2, 1) @ np.where(near, offset[..., 2], 0.0)[..., None]
    )
    off = np.where(near, offset[..., 2] - (flat @ fitted)[..., 0], 0.0)
    count = near.sum(axis=1)
    residual = np.sqrt((off**2).sum(axis=1) / np.maximum(count, 1))
    steep = np.hypot(*fitted[..., 0].T)
    is_steep = (steep > BANK_SLOPES[0]) & (steep < BANK_SLOPES[1])
    is_bank = (count >= MIN_BANK_CELLS) & (residual < BANK_STEP_M) & is_steep
    slopes[rows[is_bank]] = fitted[is_bank, :, 0]
    return slopes


def _extension(
    surface: HeightMap,
    cells: Float64[np.ndarray, "n 3"],
    members: Bool[np.ndarray, " n"],
    elsewhere: Bool[np.ndarray, " n"],
    free: Bool[np.ndarray, " n"],
) -> Int64[np.ndarray, " m"]:
    """Return the rows of free cells on a level's surface and nearer to its cells than to others, as
    far rings are."""
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
    """Return the surface of cells that have none and are below the nearest one: the highest below
    them, else -1."""
    from scipy.spatial import cKDTree

    is_numbered = number >= 0
    xy = cells[unnumbered, :2]
    top = cells[unnumbered, 2] + KERB_M
    nearest = number[is_numbered][cKDTree(cells[is_numbered, :2]).query(xy)[1]]
    heights = np.stack([surface.at(xy) for surface in surfaces])
    impossible = np.take_along_axis(heights, nearest[None], axis=0)[0] > top
    for k in range(len(surfaces)):
        distance = (
            cKDTree(cells[number == k, :2]).query(xy)[0]
            if (number == k).any()
            else np.full(len(unnumbered), np.inf)
        )
        heights[k, (heights[k] > top) | (distance > MAX_GAP_M)] = -np.inf
    is_below = impossible & (cells[unnumbered, 2] - heights.max(axis=0) < MAX_CLEARANCE_M)
    return np.where(is_below, heights.argmax(axis=0), -1)


def _draw_surface(grid: HeightMap, cells: Float64[np.ndarray, "n 3"]) -> HeightMap:
    """Draw one surface on the places of a grid: a plane, then ever finer means of what it
    leaves."""
    last = np.array(grid.heights.shape) - 1
    i, j = np.clip(np.round((cells[:, :2] - grid.origin) / grid.cell).astype(np.int64), 0, last).T
    middle = cells[:, :2].mean(axis=0)
    flat = np.column_stack([cells[:, :2] - middle, np.ones(len(cells))])
    prior = np.diag([1e-3, 1e-3, 0.0]) * len(cells)
    a, b, c = np.linalg.solve(flat.T @ flat + prior, flat.T @ cells[:, 2])
    x, y = (
        grid.origin[k] + grid.cell * np.arange(grid.heights.shape[k]) - middle[k] for k in (0, 1)
    )
    heights = a * x[:, None] + b * y[None] + c
    for scale in _SCALES_M:
        above = cells[:, 2] - HeightMap(grid.origin, heights, grid.cell).at(cells[:, :2])
        weights = np.zeros(heights.shape)
        sums = np.zeros(heights.shape)
        kerb = KERB_M if scale < MIN_FREE_SCALE_M else np.inf
        weight = weigh_ground(above, kerb)
        np.add.at(weights, (i, j), weight)
        np.add.at(sums, (i, j), weight * above)
        count, summed = (sum_around(image, scale / grid.cell) for image in (weights, sums))
        heights = heights + summed / (count + _TRUST)
    return HeightMap(grid.origin, heights, grid.cell)
