"""Cells of ground, linked into surfaces that continue each other.

A cell is the low point (x, y, z in m) of one square of a grid. The main ground is one smooth map of
heights; a level is another linked surface above or below it."""

from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float64, Int64, Points
from toolkit.calibration.height_map import HeightMap

LINK_M = 5.0  # distance of the farthest neighbour that continues a surface
# largest rise to such a neighbour: m, and m per m of distance
LINK_STEP_M = 0.08
LINK_SLOPE = 0.11
# largest gap between pieces of one surface (m), and its rise (m per m)
JOIN_M = 8.0
JOIN_SLOPE = 0.07
MIN_JOIN_CELLS = 12  # least number of cells in a piece that is joined
MAX_NEIGHBOURS = 12  # around a cell, nearest first
FLAT_SHARE = 0.45  # least part of a flat cell's neighbours that continue it
# least distance (m) from the main ground of the cells in a level's core, and at its edges
OFF_M = 0.3
EDGE_M = 0.1
SECTORS = 8  # equal sectors around a cell
MIN_SECTORS = 6  # least number of sectors with a neighbour in the ring, for a cell inside a road
RING_M = (2.3, 5.0)  # inner and outer radius of that ring
# least number of cells inside a raised road, and its least length (m)
MIN_RAISED_CELLS = 20
MIN_RAISED_M = 28.0
# the same for a road below the main ground
MIN_SUNKEN_CELLS = 5
MIN_SUNKEN_M = 10.0
MIN_LINKS = 2  # least number of links of a cell that extends a level, and of links between pieces
ON_GROUND_M = 0.3  # largest difference in height of a point on a surface
MAX_HEIGHT_M = 100.0  # height above or below the main plane from which points are left out


class CellPoints(NamedTuple):
    """Points sorted by square of a grid, then by height.

    Attributes:
        z: (n,) m, heights in that order.
        square: (n,) row in `low` of each point's square.
        low: (m, 3) m, the point of each square with a tenth of its points below it.
        least: (m,) m, height of each square's lowest point."""

    z: Float64[np.ndarray, " n"]
    square: Int64[np.ndarray, " n"]
    low: Float64[np.ndarray, "m 3"]
    least: Float64[np.ndarray, " m"]

    @staticmethod
    def from_points(grid: HeightMap, points: Points) -> "CellPoints":
        """Sort the points inside a grid by square and height.

        grid: map whose places are the middles of the squares; its heights are not used. points:
        (n, 3) m, in the frame of the map."""
        rows, columns = grid.heights.shape
        index = np.floor((points[:, :2] - grid.origin) / grid.cell + 0.5)
        in_grid = ((index >= 0) & (index < [rows, columns])).all(axis=1)
        inside = in_grid & (np.abs(points[:, 2]) < MAX_HEIGHT_M)
        points = points[inside]
        index = index[inside].astype(np.int64)
        key = index[:, 0] * columns + index[:, 1]
        # mm from 0 to 200,000, so that one number sorts by square, then by height
        height = np.round((points[:, 2] + MAX_HEIGHT_M) * 1000).astype(np.int64)
        order = np.argsort(key * round(3000 * MAX_HEIGHT_M) + height)
        sorted_key = key[order]
        first = np.flatnonzero(np.diff(sorted_key, prepend=-1))
        count = np.diff(np.append(first, len(order)))
        square = np.repeat(np.arange(len(first)), count)
        low = points[order[first + count // 10]]
        return CellPoints(points[order, 2], square, low, points[order[first], 2])

    def count_near(
        self, numbers: Int64[np.ndarray, " m"], count: int
    ) -> Int64[np.ndarray, " count"]:
        """Count the points on each surface, within `ON_GROUND_M` of their square's low point.

        numbers: (m,) number of each square's surface, -1 for none; count: number of surfaces."""
        on = np.abs(self.z - self.low[self.square, 2]) < ON_GROUND_M
        number = numbers[self.square[on]]
        return np.bincount(number[number >= 0], minlength=count)


@dataclass(frozen=True, eq=False)
class LinkedCells:
    """Cells, and the neighbours that continue them at about their height.

    Attributes:
        cells: low points (m) of a grid's squares.
        other: rows of the k nearest other cells of each cell, nearest first.
        linked: mask of the neighbours that are near and continue the cell's surface.
        flat: mask of cells with enough linked neighbours: at least 3, and `FLAT_SHARE` of the near
            ones."""

    cells: Float64[np.ndarray, "n 3"]
    other: Int64[np.ndarray, "n k"]
    linked: Bool[np.ndarray, "n k"]
    flat: Bool[np.ndarray, " n"]

    @staticmethod
    def from_cells(cells: Float64[np.ndarray, "n 3"]) -> "LinkedCells":
        """Link each cell with the near ones at about its height."""
        from scipy.spatial import cKDTree

        count = min(MAX_NEIGHBOURS + 1, len(cells))
        distance, neighbours = cKDTree(cells[:, :2]).query(cells[:, :2], count)
        distance = distance.reshape(len(cells), count)[:, 1:]
        neighbours = neighbours.reshape(len(cells), count)[:, 1:]
        rise = np.abs(cells[neighbours, 2] - cells[:, None, 2])
        near = distance < LINK_M
        linked = near & (rise < LINK_STEP_M + LINK_SLOPE * distance)
        flat = (linked.sum(axis=1) >= 3) & (linked.sum(axis=1) >= FLAT_SHARE * near.sum(axis=1))
        return LinkedCells(cells, neighbours, linked, flat)

    def number_levels(self, above: Float64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
        """Number the linked surfaces off the main ground.

        above: height (m) of each cell above the main ground. Returns the number of each cell's
        surface from 0, and -1 for cells on the main ground or on too small a surface."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        # 1 above the main ground, -1 below it, 0 on it
        side = np.where(np.abs(above) > EDGE_M, np.sign(above), 0.0)
        member = self.flat & (side != 0)
        both_members = member[:, None] & member[self.other]
        same_side = side[self.other] == side[:, None]
        cell, column = np.nonzero(self.linked & both_members & same_side)
        edges = (np.ones(len(cell), bool), (cell, self.other[cell, column]))
        _, group = connected_components(coo_array(edges, (len(above), len(above))))
        core = member & (np.abs(above) > OFF_M)
        enough = np.bincount(group[core], minlength=group.max(initial=0) + 1) >= MIN_SUNKEN_CELLS
        is_numbered = member & enough[group]
        numbers = np.full(len(above), -1)
        numbers[is_numbered] = np.unique(group[is_numbered], return_inverse=True)[1]
        return self._join(numbers, side)

    def _join(
        self, numbers: Int64[np.ndarray, " n"], side: Float64[np.ndarray, " n"]
    ) -> Int64[np.ndarray, " n"]:
        """Give pieces of one road the same number if road users and their shadows separate them.

        Args:
            numbers: surface of each cell from 0, -1 for none.
            side: 1 for cells above the main ground, -1 below it, 0 on it.

        Returns new numbers, still from 0 without gaps."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components
        from scipy.spatial import cKDTree

        count = numbers.max(initial=-1) + 1
        rows = [np.flatnonzero(numbers == number) for number in range(count)]
        trees = [cKDTree(self.cells[members, :2]) for members in rows]
        pairs: list[tuple[int, int]] = []
        large = [number for number in range(count) if len(rows[number]) >= MIN_JOIN_CELLS]
        for first_piece, second_piece in combinations(large, 2):
            first_xy = self.cells[rows[first_piece], :2]
            distance, nearest_row = trees[second_piece].query(first_xy, distance_upper_bound=JOIN_M)
            near = np.flatnonzero(np.isfinite(distance))
            first_cells = rows[first_piece][near]
            second_cells = rows[second_piece][nearest_row[near]]
            rise = np.abs(self.cells[first_cells, 2] - self.cells[second_cells, 2])
            same_side = side[first_cells] == side[second_cells]
            is_joint = same_side & (rise < LINK_STEP_M + JOIN_SLOPE * distance[near])
            if is_joint.sum() >= MIN_LINKS:
                pairs.append((first_piece, second_piece))
        if not pairs:
            return numbers
        first_numbers, second_numbers = np.array(pairs).T
        edges = (np.ones(len(first_numbers), bool), (first_numbers, second_numbers))
        _, joined = connected_components(coo_array(edges, (count, count)))
        return np.where(numbers < 0, -1, joined[numbers])

    def is_ground(
        self,
        rows: Int64[np.ndarray, " k"],
        above: Float64[np.ndarray, " k"],
        covered: Bool[np.ndarray, " k"],
    ) -> bool:
        """Return True for a surface that is wide and long enough, with no ground below it.

        Args:
            rows: rows of the surface's cells.
            above: height (m) of each such cell above the main ground.
            covered: mask of the same cells; True if points of the main ground are below it, as
                under a roof."""
        core = np.abs(above) > OFF_M
        xy = self.cells[rows[core], :2]
        sunken = np.median(above[core]) < 0
        min_cells = MIN_SUNKEN_CELLS if sunken else MIN_RAISED_CELLS
        min_length = MIN_SUNKEN_M if sunken else MIN_RAISED_M
        inside = _count_inside(xy)
        # direction in which the cells extend farthest
        along = np.linalg.svd(xy - xy.mean(axis=0), full_matrices=False)[2][0]
        extent = float(np.ptp(xy @ along))
        hides = not sunken and covered[core].mean() > 0.5
        return inside >= min_cells and extent >= min_length and not hides


def _count_inside(xy: Float64[np.ndarray, "n 2"]) -> int:
    """Count the cells with others on nearly all sides, about half a road's width away.

    xy: places of a surface's cells (m). A cell counts if `MIN_SECTORS` of the sectors around it
    have another one in the ring `RING_M`."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(xy).query_pairs(RING_M[1], output_type="ndarray")
    pairs = np.concatenate([pairs, pairs[:, ::-1]])  # each pair in both directions
    offset = xy[pairs[:, 1]] - xy[pairs[:, 0]]
    is_far = np.hypot(*offset.T) > RING_M[0]
    turn_share = np.arctan2(offset[is_far, 1], offset[is_far, 0]) / (2 * np.pi) + 0.5
    sector = np.floor(turn_share * SECTORS).astype(int) % SECTORS
    is_filled = np.zeros((len(xy), SECTORS), bool)
    is_filled[pairs[is_far, 0], sector] = True
    return int((is_filled.sum(axis=1) >= MIN_SECTORS).sum())
