"""`TiledVoxelNet`: the light network on many unions of the same clouds.

Every set of a site's sensors is such a union. A cell of a map depends on the points within some
metres of it, and few sensors see anything there. So the maps are cut into tiles, and values that
several unions share are computed once: for a tile that three of eight sensors see, there are 8
values, not 255. Layer by layer:

    seen      clouds with a point within reach of a tile; the reach grows with each convolution
    entries   values of a tile: unions with the same seen clouds share one, and so do all that see
              nothing there
    patch     a tile of the layer before, with a border of one cell from the tiles around it

A convolution of all patches gives the entries of the next layer. The maps equal the maps of one
union after the other, to the rounding of float32.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.config import VoxelNetConfig
from models.network.grid import Groups, Voxels, grid_cells, thin_voxels
from models.network.sparse import (
    ClassifiedCells,
    PlainJoin,
    SparseColumns,
    SparseVoxelNet,
    cell_by_cell,
    make_conv,
)
from toolkit.arrays import Bool, Float, Float32, Int64

TILE_SIZES = (20, 24, 28)  # cells of the head's map, multiples of the product of later strides
MAX_BATCH_TILES = 64  # that a layer processes together
MAX_ENTRIES = 2000  # in memory for a layer, some 200 kB each with the layer before
MAX_UNSHARED_SHARE = 0.9  # tiles; above it one union after another is quicker
PLAN_COST_UNIONS = 3  # unions that could be computed one by one while the tiles are planned


class _Thinning(NamedTuple):
    """Points that `voxelise` leaves out of each union.

    Unions with the same crowded clouds lose the same points: they share a group.

    Attributes:
        group: Group of each union, 0 for the unions that lose no point.
        dropped: Points left out, ascending, as group · points + row of the point.
    """

    group: Int64[np.ndarray, " unions"]
    dropped: Int64[Tensor, " k"]


class PlacedClouds(NamedTuple):
    """Points of all clouds in one grid, cloud after cloud, so that unions need no new voxels.

    Attributes:
        points: x y z in the frame of the grid, m.
        cloud: Number of each point's cloud.
        cells: Indices of each point's voxel along x, y and z.
        voxel: Number of each point's voxel among the occupied ones.
        crowd: Number of points of all clouds in each point's voxel.
        clouds: Number of clouds.
    """

    points: Float32[Tensor, "n 3"]
    cloud: Int64[Tensor, " n"]
    cells: Int64[Tensor, "n 3"]
    voxel: Int64[Tensor, " n"]
    crowd: Int64[Tensor, " n"]
    clouds: int

    @staticmethod
    def from_clouds(
        clouds: Sequence[Float32[Tensor, "_ 3"]], config: VoxelNetConfig
    ) -> "PlacedClouds":
        """Points of clouds (x y z in the frame of the grid, m) that are inside the grid."""
        points_and_cells = [grid_cells(cloud, config) for cloud in clouds]
        inside_points = [points for points, _ in points_and_cells]
        device = inside_points[0].device
        cloud_numbers = torch.arange(len(clouds), device=device)
        counts = torch.tensor([len(points) for points in inside_points], device=device)
        cells = torch.cat([indices for _, indices in points_and_cells])
        nx, ny = config.grid_shape[:2]
        ix, iy, iz = cells.unbind(1)
        groups = Groups.from_numbers((iz * nx + ix) * ny + iy)
        voxel = groups.of_rows()
        return PlacedClouds(
            points=torch.cat(inside_points),
            cloud=torch.repeat_interleave(cloud_numbers, counts),
            cells=cells,
            voxel=voxel,
            crowd=groups.counts().index_select(0, voxel),
            clouds=len(clouds),
        )

    def counts(self) -> Int64[Tensor, " clouds"]:
        """Number of points of each cloud."""
        return torch.bincount(self.cloud, minlength=self.clouds)

    def find_crowded(self, unions: Bool[np.ndarray, "unions clouds"], max_points: int) -> _Thinning:
        """Points left out of each union, in voxels with more than `max_points` of its points.

        unions: True for the clouds of each union.
        """
        # unions that differ only in clouds without a point in such voxels lose the same points
        rows = torch.nonzero(self.crowd > max_points)[:, 0]  # points in crowded voxels
        has_crowded = torch.bincount(self.cloud[rows], minlength=self.clouds).cpu().numpy() > 0
        # `distinct_row`: row in `distinct_unions` of each union
        distinct_unions, distinct_row = np.unique(unions & has_crowded, axis=0, return_inverse=True)
        group_of_distinct = np.zeros(len(distinct_unions), np.int64)
        # keys of the points lost by each group, group · points + row; group 0 loses no point
        dropped = [rows[:0]]
        for index, union in enumerate(distinct_unions):
            union_rows = rows[torch.from_numpy(union).to(rows.device)[self.cloud[rows]]]
            _, voxel, count = torch.unique(
                self.voxel[union_rows], return_inverse=True, return_counts=True
            )
            is_kept = thin_voxels(voxel, (count > max_points)[voxel], max_points)
            if not is_kept.all():
                # groups are numbered in the order of `dropped`
                group_of_distinct[index] = len(dropped)
                dropped.append(union_rows[~is_kept] + len(dropped) * len(self.points))
        return _Thinning(group_of_distinct[distinct_row.ravel()], torch.cat(dropped))

    def by_tile(self, grid: tuple[int, int], size: int, before: int) -> "PointsByTile":
        """Rows of points sorted by tile, then cloud.

        A tile has `size` columns of voxels along x and y, and the last `before` columns of the
        tiles before it, so that a point may belong to up to four tiles. grid: tiles along x and y.
        """
        tile_x, tile_y = (self.cells[:, :2] // size).T
        column_x, column_y = (self.cells[:, :2] % size).T  # within the tile
        row_parts = []
        # tile * clouds + cloud
        key_parts = []
        # 0: the tile that holds the point; 1: the next one, if the point is in its margin
        for dx, dy in product((0, 1), (0, 1)):
            is_reached_x = (column_x >= size - before) | (dx == 0)
            is_reached_y = (column_y >= size - before) | (dy == 0)
            exists = (tile_x + dx < grid[0]) & (tile_y + dy < grid[1])
            tile_rows = torch.nonzero(is_reached_x & is_reached_y & exists)[:, 0]
            tile = (tile_x[tile_rows] + dx) * grid[1] + tile_y[tile_rows] + dy
            row_parts.append(tile_rows)
            key_parts.append(tile * self.clouds + self.cloud[tile_rows])
        row = torch.cat(row_parts)
        key = torch.cat(key_parts)
        order = torch.argsort(key * max(len(self.points), 1) + row)  # by key, then row
        count = torch.bincount(key, minlength=grid[0] * grid[1] * self.clouds).cpu().numpy()
        first = np.cumsum(count) - count
        return PointsByTile(
            row=row[order],
            begin=first.reshape(-1, self.clouds),
            points=count.reshape(-1, self.clouds),
        )

    def batch(
        self,
        rows: Int64[Tensor, " n"],
        item: Int64[Tensor, " n"],
        items: int,
        config: VoxelNetConfig,
    ) -> Voxels:
        """Voxels of a batch of `items` items.

        rows: points of all items. item: index of each in the batch.
        """
        nx, ny, nz = config.grid_shape
        ix, iy, iz = self.cells[rows].unbind(1)
        groups = Groups.from_numbers(((item * nz + iz) * nx + ix) * ny + iy)
        first_points = groups.order.index_select(0, groups.begin)
        cells = torch.stack((item, ix, iy, iz), 1).index_select(0, first_points)
        return Voxels(points=self.points[rows], voxel=groups.of_rows(), cells=cells, items=items)


class PointsByTile(NamedTuple):
    """Rows of points in order of tile and cloud; a point near a border is in several tiles.

    Attributes:
        row: Rows of points.
        begin: First position in `row` for each tile and cloud.
        points: Number of rows for each tile and cloud.
    """

    row: Int64[Tensor, " k"]
    begin: Int64[np.ndarray, "tiles clouds"]
    points: Int64[np.ndarray, "tiles clouds"]

    def rows(
        self, tiles: np.ndarray, union: np.ndarray
    ) -> tuple[Int64[Tensor, " n"], Int64[Tensor, " n"]]:
        """Rows of the points in m tiles, and for each point the index of its tile in `tiles`.

        union: True for the clouds that count in each tile (m, clouds).
        """
        # points of one tile and cloud are consecutive in `row`: their ranges are joined
        device = self.row.device
        counts = np.where(union, self.points[tiles], 0)
        flat_counts = counts.ravel()
        # from a position in the answer to a position in `row`, for each tile and cloud
        offset = self.begin[tiles].ravel() - np.cumsum(flat_counts) + flat_counts
        positions = np.arange(flat_counts.sum()) + np.repeat(offset, flat_counts)
        item = torch.from_numpy(np.repeat(np.arange(len(tiles)), counts.sum(1))).to(device)
        return self.row[torch.from_numpy(positions).to(device)], item


_Bank = Float[Tensor, "n t t channels"]  # values of n entries: tiles of t x t cells each


class Entries(NamedTuple):
    """Distinct values of a layer's tiles over all unions.

    Attributes:
        tile: Number of a tile that has the value of each entry.
        union: Row of a union in which that tile has it.
        entry: Entry of each tile in each union.
    """

    tile: Int64[np.ndarray, " n"]
    union: Int64[np.ndarray, " n"]
    entry: Int64[np.ndarray, "tiles unions"]

    def parts(self) -> Iterator[tuple[int, Int64[np.ndarray, " m"], Int64[np.ndarray, " m"]]]:
        """Yield entries in batches: number of the first one, and `tile` and `union` of each."""
        for first in range(0, len(self.tile), MAX_BATCH_TILES):
            rows = slice(first, first + MAX_BATCH_TILES)
            yield first, self.tile[rows], self.union[rows]

    def bank(self, values: Callable[[np.ndarray, np.ndarray], Tensor]) -> _Bank:
        """Values of all entries, then a last row of zeros for tiles beyond the map.

        values: from tiles and unions of a batch of entries to their values (m, t, t, channels).
        """
        bank = torch.empty(0)
        for first, tiles, union in self.parts():
            batch_values = values(tiles, union)
            if not first:
                bank = batch_values.new_zeros(len(self.tile) + 1, *batch_values.shape[1:])
            bank[first : first + len(batch_values)] = batch_values
        return bank


class TilePredictions(NamedTuple):
    """Raw head maps of a batch of entries.

    Attributes:
        first: Number of the first entry.
        corner: Row and column of each entry's first cell in the whole map.
        maps: Class maps and what the others are computed from, one item for each entry.
    """

    first: int
    corner: Int64[Tensor, "m 2"]
    maps: ClassifiedCells


# True for the clouds, and in the last column for crowded voxels, within reach of each tile
_Seen = Bool[np.ndarray, "tiles clouds+1"]


class UnionPlan(NamedTuple):
    """Unions of clouds, and the points left out of each.

    Attributes:
        placed: Points of all clouds.
        seen: Clouds and crowded voxels within reach of each tile, layer by layer.
        unions: True for the clouds of each union.
        thinning: Group of unions that lose the same points; 0: no points.
        dropped: Points left out, as group · points + row of the point.
    """

    placed: PlacedClouds
    seen: list[_Seen]
    unions: Bool[np.ndarray, "unions clouds"]
    thinning: Int64[np.ndarray, " unions"]
    dropped: Int64[Tensor, " k"]

    def part(self, rows: slice) -> "UnionPlan":
        """Plan for some of the unions."""
        return self._replace(unions=self.unions[rows], thinning=self.thinning[rows])

    def entries(self, layer: int) -> Entries:
        """Entries of a layer: a tile has the same value in two unions if the same clouds of both
        reach it and, near crowded voxels, both lose the same points."""
        seen = self.seen[layer]
        unions = self.unions
        tile_count = len(seen)
        union_count = len(unions)
        # numbers for each tile and union, which together decide its value. First the group of lost
        # points, 0 for tiles out of reach of crowded voxels (the last column of `seen`); then the
        # clouds of the union that reach the tile, as bits
        code_parts = [seen[:, -1:] * self.thinning]
        for first in range(0, unions.shape[1], 31):  # 31 clouds are the bits of one part
            union_columns = unions[:, first : first + 31]
            bits = 1 << np.arange(union_columns.shape[1])
            code_parts.append((seen[:, None, first : first + len(bits)] & union_columns) @ bits)
        # for each tile and union; equal: same value
        code = np.repeat(np.arange(tile_count), union_count)
        for code_part in code_parts:
            # numbered again after each part, so that the shifted code fits 64 bits
            code = np.unique(code << 31 | code_part.ravel(), return_inverse=True)[1]
        _, example, entry_of = np.unique(code, return_index=True, return_inverse=True)
        return Entries(
            tile=example // union_count,
            union=example % union_count,
            entry=entry_of.reshape(tile_count, union_count),
        )


def tileable(network: SparseVoxelNet) -> bool:
    """True if this module can compute a network: columns folded, blocks added, a head of single
    cells."""
    join = network.rpn.join
    adds_blocks = isinstance(join, PlainJoin) and join.add and join.conv3x3 is None
    return (
        adds_blocks
        and isinstance(network.middle, SparseColumns)
        and network.rpn.order[0].count(0) == 1
    )


def choose_size(rows: int, columns: int) -> int:
    """Side of the tiles (cells of the head's map) that compute the fewest cells, borders included.

    rows, columns: cells of the map.
    """

    def count_cells(size: int) -> int:
        tiles = math.ceil(rows / size) * math.ceil(columns / size)
        return tiles * (size + 2) ** 2

    return min(TILE_SIZES, key=count_cells)


class TiledVoxelNet:
    """Network for inference on unions of clouds. See `tileable`."""

    def __init__(self, network: SparseVoxelNet) -> None:
        """Choose tiles for the network's map, and take over its layers."""
        self._network = network
        self.config = network.config
        # cells along x and y
        self._map = rows, columns = self.config.map_shape
        self.size = choose_size(rows, columns)  # cells of the head's map along a tile's side
        self._grid = -(-rows // self.size), -(-columns // self.size)  # tiles along x and y
        # the first convolution is in `SparseColumns`, so the first block has one less
        first_order, *further_orders = network.rpn.order
        orders = (first_order[1:], *further_orders)
        self._blocks: list[list[nn.Conv2d]] = []
        for block, order in zip(network.rpn.blocks, orders, strict=True):
            self._blocks.append([block[number] for number in order])
        self._strides = [2]  # layer by layer, the first convolution included
        for block in self._blocks:
            self._strides += [conv.stride[0] for conv in block]
        join: Any = network.rpn.join
        self._finest, *coarse_layers = join.upsample
        # A transposed convolution of kernel and stride k is a 1x1 one with outputs for k x k cells.
        # axes of its weight: input, output, row, column
        weights = (
            layer.weight.permute(2, 3, 1, 0).reshape(-1, layer.in_channels, 1, 1)
            for layer in coarse_layers
        )
        self._raised = [make_conv(weight, bias=None).requires_grad_(False) for weight in weights]

    def plan(
        self, clouds: Sequence[Float32[Tensor, "_ 3"]], unions: Bool[np.ndarray, "unions clouds"]
    ) -> UnionPlan:
        """Plan the work for unions of clouds.

        clouds: x y z in the frame of the grid, m. unions: True for the clouds of each union.
        """
        return self._add_thinning(self._plan_without_thinning(clouds, unions))

    def plan_gain(
        self, clouds: Sequence[Float32[Tensor, "_ 3"]], unions: Bool[np.ndarray, "unions clouds"]
    ) -> UnionPlan | None:
        """Plan the work if that is quicker than one union after another, else None.

        clouds: x y z in the frame of the grid, m. unions: True for the clouds of each union.
        """
        if MAX_UNSHARED_SHARE * (len(unions) - PLAN_COST_UNIONS) < 1:
            return None  # each tile has one value at least
        plan = self._plan_without_thinning(clouds, unions)
        if not self.gains(plan):  # thinning only makes values of tiles differ
            return None
        plan = self._add_thinning(plan)
        return plan if self.gains(plan) else None

    def _add_thinning(self, plan: UnionPlan) -> UnionPlan:
        """Return a plan with the points that are left out of crowded voxels."""
        thinning = plan.placed.find_crowded(plan.unions, self.config.max_points)
        return plan._replace(thinning=thinning.group, dropped=thinning.dropped)

    def _plan_without_thinning(
        self, clouds: Sequence[Float32[Tensor, "_ 3"]], unions: Bool[np.ndarray, "unions clouds"]
    ) -> UnionPlan:
        """Plan as if no point was left out of crowded voxels.

        `seen` of the plan has for each layer, by tile and cloud, whether a point of the cloud can
        change the tile; the last column is of voxels with more points than the network takes.

        clouds: x y z in the frame of the grid, m. unions: True for the clouds of each union."""
        placed = PlacedClouds.from_clouds(clouds, self.config)
        nx, ny, _ = self.config.grid_shape
        # cells of the map that each cloud, and in the last row any crowded voxel, has points in
        is_reached = np.zeros((placed.clouds + 1, nx * ny), np.bool_)
        column = (placed.cells[:, 0] * ny + placed.cells[:, 1]).cpu().numpy()
        is_crowded = (placed.crowd > self.config.max_points).cpu().numpy()
        is_reached[placed.cloud.cpu().numpy(), column] = True
        is_reached[-1, column[is_crowded]] = True
        reach = is_reached.reshape(-1, nx, ny)
        size = 2 * self.size  # cells along a tile's side, in the grid and then in each layer
        seen = []
        for stride in self._strides:
            reach = spread_reach(reach, stride)
            size = size // stride
            by_tile = reach
            for axis in (1, 2):
                first_cells = np.arange(0, reach.shape[axis], size)  # one for each tile
                by_tile = np.logical_or.reduceat(by_tile, first_cells, axis=axis)
            seen.append(by_tile.reshape(len(reach), -1).T)
        return UnionPlan(
            placed=placed,
            seen=seen,
            unions=unions,
            thinning=np.zeros(len(unions), np.int64),
            dropped=placed.cloud[:0],
        )

    def gains(self, plan: UnionPlan) -> bool:
        """True if shared work is quicker than one union after another."""
        unions = len(plan.unions) - PLAN_COST_UNIONS
        tiles = len(plan.seen[-1])
        return len(plan.entries(-1).tile) <= MAX_UNSHARED_SHARE * tiles * unions

    def __call__(
        self, plan: UnionPlan
    ) -> Iterator[tuple[slice, Entries, Iterator[TilePredictions]]]:
        """Yield batches of unions, as large as memory allows.

        Each is a slice of the unions, the entries of the head's tiles, and an iterator over the
        head's maps of the entries.
        """
        count = len(plan.unions)  # in a batch, halved until its entries fit in memory
        while count > 1 and len(plan.part(slice(count)).entries(-1).tile) > MAX_ENTRIES:
            count = (count + 1) // 2
        for first in range(0, len(plan.unions), count):
            union_rows = slice(first, first + count)
            maps = self._maps(plan.part(union_rows))
            yield union_rows, maps[-1][1], self._heads(maps)

    @torch.inference_mode()
    def _maps(self, plan: UnionPlan) -> list[tuple[Tensor, Entries]]:
        """Values and entries of each block's last layer, the finest first.

        Values are (n + 1, t, t, channels): n entries, tiles of t x t cells, then a tile of zeros.
        """
        entries = plan.entries(0)
        size = self.size  # cells of the layer along a tile's side
        layer = 0
        maps = []
        bank = self._first(plan, entries)
        for block in self._blocks:
            for conv in block:
                layer += 1
                next_entries = plan.entries(layer)
                bank = self._convolve(conv, bank, entries, next_entries, size)
                size = size // self._strides[layer]
                entries = next_entries
            maps.append((bank, entries))
        return maps

    def _first(self, plan: UnionPlan, entries: Entries) -> _Bank:
        """Values of entries after the first convolution, from the columns of each tile and those
        next to it."""
        # columns; the convolution of stride 2 looks one back, two keep it in step
        side = 2 * self.size + 2
        placed = plan.placed
        middle = self._network.middle
        by_tile = placed.by_tile(self._grid, size=2 * self.size, before=2)

        def convolve(tiles: np.ndarray, union: np.ndarray) -> _Bank:
            """Values of tiles (m, t, t, channels), each in one union.

            tiles: their numbers (m,); union: row of `plan.unions` for each (m,)."""
            # rows: points of all tiles; item: index in `tiles` of each point's tile
            rows, item = by_tile.rows(tiles, plan.unions[union])
            if len(plan.dropped):
                # leave out the points whose key is among the sorted keys in `plan.dropped`
                thinning = torch.from_numpy(plan.thinning[union]).to(rows.device)[item]
                point_keys = thinning * len(placed.points) + rows
                position = torch.searchsorted(plan.dropped, point_keys)
                position.clamp_(max=len(plan.dropped) - 1)
                is_kept = plan.dropped[position] != point_keys
                rows = rows[is_kept]
                item = item[is_kept]
            voxels = placed.batch(rows, item, len(tiles), self.config)
            # a cell of the map has 2 x 2 columns of voxels, and the margin is one such cell
            corner = 2 * self.size * torch.from_numpy(self._corners(tiles)).to(rows.device) - 2
            # cells are (item, ix, iy, iz): only ix and iy are counted from the tile's corner
            voxel_corner = F.pad(corner[voxels.cells[:, 0]], (1, 1))
            local_voxels = voxels._replace(cells=voxels.cells - voxel_corner)
            shape = (side, side, self.config.grid_shape[2])
            x: Tensor = middle(self._network.features(voxels), local_voxels, shape)
            x = x.permute(0, 2, 3, 1)[:, 1:, 1:]  # without the cells of the tiles before
            return self._within(x.to(self._finest.weight.dtype), tiles)

        return entries.bank(convolve)

    def _convolve(
        self, conv: nn.Conv2d, bank: Tensor, before: Entries, after: Entries, size: int
    ) -> _Bank:
        """Values of the entries `after` a layer, a 3x3 convolution and ReLU.

        bank: values of the entries `before` the layer, and a last row of zeros. size: cells along a
        side of a tile before the layer.
        """
        # for each of three adjacent tiles along an axis: step (0: the tile before, 1: the tile
        # itself), cells of the patch that it fills, and which of its cells are copied there
        sides = (
            (0, slice(0, 1), slice(-1, None)),
            (1, slice(1, -1), slice(None)),
            (2, slice(-1, None), slice(0, 1)),
        )
        # entry of each tile and union (tiles along x, along y, unions), with tiles of zeros (the
        # bank's last row) about the map
        entry_of = before.entry.reshape(*self._grid, -1)
        entry_of = np.pad(entry_of, ((1, 1), (1, 1), (0, 0)), constant_values=len(before.tile))

        def convolve(tiles: np.ndarray, union: np.ndarray) -> _Bank:
            """Values of tiles, each in one union."""
            # each tile with a margin of one cell from the eight tiles around it
            patches = bank.new_empty(len(tiles), size + 2, size + 2, bank.shape[3])
            # indices of the tiles in the grid; in `entry_of`, with its margin, indices of the tiles
            # before them along both axes
            x, y = self._corners(tiles).T
            for (dx, to_x, from_x), (dy, to_y, from_y) in product(sides, sides):
                rows = torch.from_numpy(entry_of[x + dx, y + dy, union]).to(bank.device)
                patches[:, to_x, to_y] = bank[:, from_x, from_y][rows]
            values = torch.relu_(
                F.conv2d(patches.permute(0, 3, 1, 2), conv.weight, conv.bias, conv.stride)
            )
            return self._within(values.permute(0, 2, 3, 1), tiles)

        return after.bank(convolve)

    @torch.inference_mode()
    def _heads(self, maps: list[tuple[Tensor, Entries]]) -> Iterator[TilePredictions]:
        """Yield the head's maps of the last layer's entries, batch by batch.

        maps: values (n + 1, t, t, channels) and entries of each block's last layer, the finest
        first.
        """
        rpn = self._network.rpn
        _, head_entries = maps[-1]
        for first, tiles, union in head_entries.parts():
            blocks = []  # values of the batch after each block
            for bank, bank_entries in maps:
                rows = torch.from_numpy(bank_entries.entry[tiles, union]).to(bank.device)
                blocks.append(bank[rows])
            x = _cells(self._finest, blocks[0])
            for conv, y in zip(self._raised, blocks[1:], strict=True):
                side = y.shape[1]
                k = self.size // side  # cells of the head's map along a side of one coarse cell
                width = x.shape[3]
                # both as (tile, coarse row, row in it, coarse column, column in it, channel)
                fine_y = _cells(conv, y).view(-1, side, side, k, k, width).transpose(2, 3)
                x.view(-1, side, k, side, k, width).add_(fine_y)
            corner = torch.from_numpy(self.size * self._corners(tiles)).to(x.device)
            classified = rpn.classify(torch.relu_(x).permute(0, 3, 1, 2))
            yield TilePredictions(first=first, corner=corner, maps=classified)

    def _corners(self, tiles: Int64[np.ndarray, " m"]) -> Int64[np.ndarray, "m 2"]:
        """Row and column of tiles in the grid of tiles."""
        return np.stack([tiles // self._grid[1], tiles % self._grid[1]], axis=1)

    def _within(self, x: _Bank, tiles: np.ndarray) -> _Bank:
        """Values of tiles with zeros in cells beyond the map, as convolutions expect.

        x: values (m, t, t, channels); tiles: their numbers (m,)."""
        size = x.shape[1]  # cells along a tile's side in this layer
        corners = torch.from_numpy(self._corners(tiles)).to(x.device)
        for axis, (side, cells) in enumerate(zip(self._grid, self._map, strict=True)):
            if side * self.size != cells:  # the last tiles along this axis go beyond the map
                cell = corners[:, axis, None] * size + torch.arange(size, device=x.device)
                # `cells` is counted in the head's map, this layer has size / self.size as many
                is_on_map = (cell < cells * size // self.size).to(x.dtype)
                x = x * (is_on_map[:, :, None, None] if axis == 0 else is_on_map[:, None, :, None])
        return x


def spread_reach(reach: Bool[np.ndarray, "n H W"], stride: int) -> Bool[np.ndarray, "n h w"]:
    """Cells of a 3x3 convolution with padding 1 that depend on any of some cells."""
    rows = np.pad(reach, ((0, 0), (1, 1), (0, 0)))
    reach = rows[:, :-2:stride] | rows[:, 1:-1:stride] | rows[:, 2::stride]
    columns = np.pad(reach, ((0, 0), (0, 0), (1, 1)))
    return columns[..., :-2:stride] | columns[..., 1:-1:stride] | columns[..., 2::stride]


def _cells(conv: nn.Module, x: _Bank) -> Float[Tensor, "n t t outputs"]:
    """Output of a 1x1 convolution for tiles, which are stacked as one map for it."""
    tile_map = x.flatten(0, 1)[None].permute(0, 3, 1, 2)
    y = cell_by_cell(conv, tile_map).permute(0, 2, 3, 1)
    return y.reshape(*x.shape[:3], -1)
