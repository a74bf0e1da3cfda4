"""Cells of ground, linked into surfaces that continue each other.

A cell is the low point (x, y, z in m) of one square of a grid. The main ground is one smooth map of
heights; a level is another linked surface above or below it."""

from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float64, Int, Int64, Points
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
RING_M = (2.3, 5.0)  # inner and outer radius of the ring
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
        rows, columns = grid.heights.shape  # rows along x, columns along y
        index = np.floor((points[:, :2] - grid.origin) / grid.cell + 0.5)
        in_grid = ((index >= 0) & (index < [rows, columns])).all(axis=1)
        is_kept = in_grid & (np.abs(points[:, 2]) < MAX_HEIGHT_M)
        kept_points = points[is_kept]
        row_index, column_index = index[is_kept].astype(np.int64).T
        square_key = row_index * columns + column_index
        # Heights are mm from 0 to 200,000 and a square's step is larger (300,000), so that one
        # number sorts by square, then by height.
        height_mm = np.round((kept_points[:, 2] + MAX_HEIGHT_M) * 1000).astype(np.int64)
        order = np.argsort(square_key * round(3000 * MAX_HEIGHT_M) + height_mm)  # 300,000
        first = np.flatnonzero(np.diff(square_key[order], prepend=-1))  # each square's lowest point
        count = np.diff(np.append(first, len(order)))
        return CellPoints(
            z=kept_points[order, 2],
            square=np.repeat(np.arange(len(first)), count),
            low=kept_points[order[first + count // 10]],  # a tenth of the points are lower
            least=kept_points[order[first], 2],
        )

    def count_near(self, numbers: Int[np.ndarray, " m"], count: int) -> Int64[np.ndarray, " count"]:
        """Count the points on each surface, within `ON_GROUND_M` of their square's low point.

        numbers: (m,) number of each square's surface, -1 for none; count: number of surfaces."""
        is_low = np.abs(self.z - self.low[self.square, 2]) < ON_GROUND_M
        point_numbers = numbers[self.square[is_low]]
        return np.bincount(point_numbers[point_numbers >= 0], minlength=count)


@dataclass(frozen=True, eq=False)
class LinkedCells:
    """Cells, and the neighbours that continue them at about their height.

    Attributes:
        cells: low points (m) of a grid's squares.
        neighbours: rows of the k nearest other cells of each cell, nearest first.
        is_linked: mask of the neighbours that are near and continue the cell's surface.
        is_flat: mask of cells with enough linked neighbours: at least 3, and `FLAT_SHARE` of the
            near ones."""

    cells: Float64[np.ndarray, "n 3"]
    neighbours: Int64[np.ndarray, "n k"]
    is_linked: Bool[np.ndarray, "n k"]
    is_flat: Bool[np.ndarray, " n"]

    @staticmethod
    def from_cells(cells: Float64[np.ndarray, "n 3"]) -> "LinkedCells":
        """Link each cell with the near ones at about its height.

        cells: low points (x, y, z in m) of a grid's squares. A step of height that still links
        grows with the distance."""
        from scipy.spatial import cKDTree

        xy = cells[:, :2]
        z = cells[:, 2]
        count = min(MAX_NEIGHBOURS + 1, len(cells))
        distance, neighbours = cKDTree(xy).query(xy, count)
        # the first neighbour is the cell itself; query drops the axis if count is 1
        distance = distance.reshape(len(cells), count)[:, 1:]
        neighbours = neighbours.reshape(len(cells), count)[:, 1:]
        rise = np.abs(z[neighbours] - z[:, None])
        is_near = distance < LINK_M
        is_linked = is_near & (rise < LINK_STEP_M + LINK_SLOPE * distance)
        link_count = is_linked.sum(axis=1)
        # a flat cell is linked with most of the cells near it, and with three at least
        is_flat = (link_count >= 3) & (link_count >= FLAT_SHARE * is_near.sum(axis=1))
        return LinkedCells(cells, neighbours=neighbours, is_linked=is_linked, is_flat=is_flat)

    def number_levels(self, above: Float64[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """Number the linked surfaces off the main ground.

        above: height (m) of each cell above the main ground. Returns the number of each cell's
        surface from 0, and -1 for cells on the main ground or on too small a surface."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        # 1 above the main ground, -1 below it, 0 on it
        side = np.where(np.abs(above) > EDGE_M, np.sign(above), 0.0)
        is_member = self.is_flat & (side != 0)
        are_members = is_member[:, None] & is_member[self.neighbours]
        is_same_side = side[self.neighbours] == side[:, None]
        cell, column = np.nonzero(self.is_linked & are_members & is_same_side)
        # sparse matrix of the links: values, then rows and columns
        links = (np.ones(len(cell), bool), (cell, self.neighbours[cell, column]))
        # group of each cell; a cell without links is a group of one
        _, group = connected_components(coo_array(links, (len(above), len(above))))
        # a group needs enough cells that are clearly off the main ground
        is_core = is_member & (np.abs(above) > OFF_M)
        core_counts = np.bincount(group[is_core], minlength=group.max(initial=0) + 1)
        is_large = core_counts >= MIN_SUNKEN_CELLS
        is_numbered = is_member & is_large[group]
        numbers = np.full(len(above), -1)
        # numbers of the groups left, from 0 without gaps
        _, numbers[is_numbered] = np.unique(group[is_numbered], return_inverse=True)
        return self._join_pieces(numbers, side)

    def _join_pieces(
        self, numbers: Int[np.ndarray, " n"], side: Float64[np.ndarray, " n"]
    ) -> Int[np.ndarray, " n"]:
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
        large_pieces = [number for number in range(count) if len(rows[number]) >= MIN_JOIN_CELLS]
        for first_piece, second_piece in combinations(large_pieces, 2):
            first_xy = self.cells[rows[first_piece], :2]
            distance, nearest_row = trees[second_piece].query(first_xy, distance_upper_bound=JOIN_M)
            near_index = np.flatnonzero(np.isfinite(distance))
            first_cells = rows[first_piece][near_index]
            second_cells = rows[second_piece][nearest_row[near_index]]
            rise = np.abs(self.cells[first_cells, 2] - self.cells[second_cells, 2])
            is_same_side = side[first_cells] == side[second_cells]
            is_joint = is_same_side & (rise < LINK_STEP_M + JOIN_SLOPE * distance[near_index])
            if is_joint.sum() >= MIN_LINKS:
                pairs.append((first_piece, second_piece))
        if not pairs:
            return numbers
        first_numbers, second_numbers = np.array(pairs).T
        edges = (np.ones(len(first_numbers), bool), (first_numbers, second_numbers))
        _, joined_number = connected_components(coo_array(edges, (count, count)))
        return np.where(numbers < 0, -1, joined_number[numbers])

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
        is_core = np.abs(above) > OFF_M  # cells clearly off the main ground
        xy = self.cells[rows[is_core], :2]
        is_sunken = np.median(above[is_core]) < 0
        min_cells = MIN_SUNKEN_CELLS if is_sunken else MIN_RAISED_CELLS
        min_length = MIN_SUNKEN_M if is_sunken else MIN_RAISED_M
        inside_count = _count_inside(xy)
        # the first right singular vector is the direction in which the cells extend farthest
        directions = np.linalg.svd(xy - xy.mean(axis=0), full_matrices=False).Vh
        length = float(np.ptp(xy @ directions[0]))
        is_roof = not is_sunken and covered[is_core].mean() > 0.5
        return inside_count >= min_cells and length >= min_length and not is_roof


def _count_inside(xy: Float64[np.ndarray, "n 2"]) -> int:
    """Count the cells with others on nearly all sides, about half a road's width away.

    xy: places of a surface's cells (m). A cell counts if `MIN_SECTORS` of the sectors around it
    have another one in the ring `RING_M`."""
    from scipy.spatial import cKDTree

    inner_radius, outer_radius = RING_M
    pairs = cKDTree(xy).query_pairs(outer_radius, output_type="ndarray")
    # each pair in both directions
    cell, other = np.concatenate([pairs, pairs[:, ::-1]]).T
    dx, dy = (xy[other] - xy[cell]).T
    is_in_ring = np.hypot(dx, dy) > inner_radius
    # direction from the cell to the other one, in turns from 0 to 1
    turn_share = np.arctan2(dy[is_in_ring], dx[is_in_ring]) / (2 * np.pi) + 0.5
    sector = np.floor(turn_share * SECTORS).astype(int) % SECTORS  # the end of a turn is its start
    is_filled = np.zeros((len(xy), SECTORS), bool)
    is_filled[cell[is_in_ring], sector] = True
    return int((is_filled.sum(axis=1) >= MIN_SECTORS).sum())
