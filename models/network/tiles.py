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

from collections.abc import Callable, Iterator, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.config import VoxelNetConfig
from models.network.grid import Voxels, grid_cells, thin_voxels
from models.network.sparse import PlainJoin, SparseColumns, SparseVoxelNet, cell_by_cell, make_conv
from models.network.voxelnet import Prediction
from toolkit.arrays import Bool, Float, Float32, Int64

TILE_SIZES = (20, 24, 28)  # cells of the head's map, multiples of the product of later strides
MAX_BATCH_TILES = 64  # that a layer processes together
MAX_ENTRIES = 2000  # in memory for a layer, some 200 kB each with the layer before
MAX_UNSHARED_SHARE = 0.9  # tiles; above it one union after another is quicker
PLAN_COST_UNIONS = 3  # unions that could be computed one by one while the tiles are planned


class PlacedClouds(NamedTuple):
    """Points of all clouds in one grid, cloud after cloud, so that unions need no new voxels."""

    points: Float32[Tensor, "n 3"]
    cloud: Int64[Tensor, " n"]
    cells: Int64[Tensor, "n 3"]  # voxel indices along x, y and z
    voxel: Int64[Tensor, " n"]  # number of the voxel
    crowd: Int64[Tensor, " n"]  # points of all clouds in the voxel
    clouds: int

    @staticmethod
    def of(clouds: Sequence[Float32[Tensor, "_ 3"]], config: VoxelNetConfig) -> "PlacedClouds":
        """Place points given in the frame of the grid, m."""
        placed = [grid_cells(cloud, config) for cloud in clouds]
        inside = [cloud for cloud, _ in placed]
        number = torch.arange(len(clouds), device=inside[0].device)
        counts = torch.tensor([len(cloud) for cloud in inside], device=inside[0].device)
        cells = torch.cat([indices for _, indices in placed])
        nx, ny = config.grid_shape[:2]
        ix, iy, iz = cells.unbind(1)
        _, voxel, count = torch.unique(
            (iz * nx + ix) * ny + iy, return_inverse=True, return_counts=True
        )
        cloud = torch.repeat_interleave(number, counts)
        return PlacedClouds(torch.cat(inside), cloud, cells, voxel, count[voxel], len(clouds))

    def counts(self) -> Int64[Tensor, " C"]:
        """Number of points of each cloud."""
        return torch.bincount(self.cloud, minlength=self.clouds)

    def find_crowded(
        self, unions: Bool[np.ndarray, "U C"], max_points: int
    ) -> tuple[Int64[np.ndarray, " U"], Int64[Tensor, " k"]]:
        """Points that `voxelise` leaves out of unions, in voxels with more than `max_points`
        points.

        Returns the number of the way each union is thinned, 0 for none, and the points left out,
        ascending, as that number · points + row of the point.
        """
        rows = torch.nonzero(self.crowd > max_points)[:, 0]
        has_crowded = torch.bincount(self.cloud[rows], minlength=self.clouds).cpu().numpy() > 0
        distinct_unions, number = np.unique(unions & has_crowded, axis=0, return_inverse=True)
        thinning = np.zeros(len(distinct_unions), np.int64)
        dropped = [rows[:0]]
        for index, union in enumerate(distinct_unions):
            union_rows = rows[torch.from_numpy(union).to(rows.device)[self.cloud[rows]]]
            _, voxel, count = torch.unique(
                self.voxel[union_rows], return_inverse=True, return_counts=True
            )
            is_kept = thin_voxels(voxel, (count > max_points)[voxel], max_points)
            if not is_kept.all():
                thinning[index] = len(dropped)
                dropped.append(union_rows[~is_kept] + len(dropped) * len(self.points))
        return thinning[number.ravel()], torch.cat(dropped)

    def by_tile(self, grid: tuple[int, int], size: int, before: int) -> "PointsByTile":
        """Sort points by tile.

        A tile has `size` columns along x and y, and `before` columns of the tiles before it.
        """
        tx, ty = (self.cells[:, :2] // size).T
        from_x, from_y = (self.cells[:, :2] % size).T
        rows = []
        keys = []
        for dx, dy in product((0, 1), (0, 1)):
            is_reached_x = (from_x >= size - before) | (dx == 0)
            is_reached_y = (from_y >= size - before) | (dy == 0)
            is_reached = is_reached_x & is_reached_y
            is_on_grid = (tx + dx < grid[0]) & (ty + dy < grid[1])
            tile_rows = torch.nonzero(is_reached & is_on_grid)[:, 0]
            rows.append(tile_rows)
            tile = (tx[tile_rows] + dx) * grid[1] + ty[tile_rows] + dy
            keys.append(tile * self.clouds + self.cloud[tile_rows])
        row = torch.cat(rows)
        key = torch.cat(keys)
        order = torch.argsort(key * max(len(self.points), 1) + row)
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
        """Voxels of a batch of points and their items."""
        nx, ny, nz = config.grid_shape
        ix, iy, iz = self.cells[rows].unbind(1)
        occupied, voxel = torch.unique(((item * nz + iz) * nx + ix) * ny + iy, return_inverse=True)
        plane = occupied % (nx * ny)
        level = occupied // (nx * ny)
        cells = torch.stack((level // nz, plane // ny, plane % ny, level % nz), 1)
        return Voxels(self.points[rows], voxel, cells, items)


class PointsByTile(NamedTuple):
    """Rows of points in order of tile and cloud.

    Attributes:
        row: Rows of points.
        begin: First place for each tile and cloud.
        points: Number for each tile and cloud.
    """

    row: Int64[Tensor, " k"]
    begin: Int64[np.ndarray, "tiles clouds"]
    points: Int64[np.ndarray, "tiles clouds"]

    def rows(
        self, tiles: np.ndarray, union: np.ndarray
    ) -> tuple[Int64[Tensor, " n"], Int64[Tensor, " n"]]:
        """Points of some tiles in unions, and for each the place of its tile in `tiles`."""
        count = np.where(union, self.points[tiles], 0)
        flat = count.ravel()
        offset = self.begin[tiles].ravel() - np.cumsum(flat) + flat
        positions = np.arange(flat.sum()) + np.repeat(offset, flat)
        item = torch.from_numpy(np.repeat(np.arange(len(tiles)), count.sum(1))).to(self.row.device)
        return self.row[torch.from_numpy(positions).to(self.row.device)], item


_Bank = Float[Tensor, "n t t K"]  # values of n tiles, of t x t cells each


class Entries(NamedTuple):
    """Distinct values of a layer's tiles.

    Attributes:
        tile: Tile of one example of each.
        union: Union of one example of each.
        of: Entry of each tile in a union.
    """

    tile: Int64[np.ndarray, " n"]
    union: Int64[np.ndarray, " n"]
    of: Int64[np.ndarray, "tiles unions"]

    def parts(self) -> Iterator[tuple[int, Int64[np.ndarray, " m"], Int64[np.ndarray, " m"]]]:
        """Yield groups: number of the first entry, tiles and unions."""
        for first in range(0, len(self.tile), MAX_BATCH_TILES):
            rows = slice(first, first + MAX_BATCH_TILES)
            yield first, self.tile[rows], self.union[rows]

    def bank(self, values: Callable[[np.ndarray, np.ndarray], Tensor]) -> _Bank:
        """All entries' values by a function of tiles and unions, and a last one of zeros."""
        bank = torch.empty(0)
        for first, tiles, union in self.parts():
            block = values(tiles, union)
            bank = bank if first else block.new_zeros(len(self.tile) + 1, *block.shape[1:])
            bank[first : first + len(block)] = block
        return bank


class TilePredictions(NamedTuple):
    """Raw head maps of some entries.

    Attributes:
        first: Number of the first entry.
        corner: First cell of each in the map.
        maps: Raw maps.
    """

    first: int
    corner: Int64[Tensor, "m 2"]
    maps: Prediction


_Seen = Bool[np.ndarray, "tiles C+1"]


class UnionPlan(NamedTuple):
    """Unions of clouds, and the points left out of each (see `find_crowded`)."""

    placed: PlacedClouds
    seen: list[_Seen]  # layer by layer the clouds, and crowded voxels, within reach of each tile
    unions: Bool[np.ndarray, "U C"]
    thinning: Int64[np.ndarray, " U"]
    dropped: Int64[Tensor, " k"]

    def part(self, rows: slice) -> "UnionPlan":
        """Plan for some of the unions."""
        return self._replace(unions=self.unions[rows], thinning=self.thinning[rows])

    def entries(self, layer: int) -> Entries:
        """Values that unions share in a layer's tiles."""
        seen = self.seen[layer]
        unions = self.unions
        tiles = len(seen)
        count = len(unions)
        code = np.repeat(np.arange(tiles), count)
        parts = [seen[:, -1:] * self.thinning]
        for first in range(0, unions.shape[1], 31):
            union_columns = unions[:, first : first + 31]
            bits = 1 << np.arange(union_columns.shape[1])
            parts.append((seen[:, None, first : first + len(bits)] & union_columns) @ bits)
        for code_part in parts:
            code = np.unique(code << 31 | code_part.ravel(), return_inverse=True)[1]
        _, example, entry_of = np.unique(code, return_index=True, return_inverse=True)
        return Entries(example // count, example % count, entry_of.reshape(tiles, count))


def tileable(network: SparseVoxelNet) -> bool:
    """True if this module can compute a network: columns folded, blocks added, a head of single
    cells."""
    join = network.rpn.join
    is_plain = isinstance(join, PlainJoin) and join.add and join.conv3x3 is None
    return (
        is_plain
        and isinstance(network.middle, SparseColumns)
        and network.rpn.order[0].count(0) == 1
    )


def choose_size(rows: int, columns: int) -> int:
    """Side of the tiles that compute the fewest cells of a map, including their borders."""

    def count_cells(size: int) -> int:
        tiles = -(-rows // size) * -(-columns // size)
        return tiles * (size + 2) ** 2

    return min(TILE_SIZES, key=count_cells)


class TiledVoxelNet:
    """Network for inference on unions of clouds. See `tileable`."""

    def __init__(self, network: SparseVoxelNet) -> None:
        self._network = network
        self.config = network.config
        self._map = rows, columns = self.config.map_shape
        self.size = choose_size(rows, columns)
        self._grid = -(-rows // self.size), -(-columns // self.size)
        first, *further_orders = network.rpn.order
        order = (first[1:], *further_orders)
        self._blocks: list[list[nn.Conv2d]] = []
        for block, numbers in zip(network.rpn.blocks, order, strict=True):
            self._blocks.append([block[k] for k in numbers])
        self._strides = [2]
        for block in self._blocks:
            self._strides += [conv.stride[0] for conv in block]
        join: Any = network.rpn.join
        self._finest, *raised = join.upsample
        # A transposed convolution of kernel and stride k is a 1x1 one with outputs for k x k cells.
        weights = (
            layer.weight.permute(2, 3, 1, 0).reshape(-1, layer.in_channels, 1, 1)
            for layer in raised
        )
        self._raised = [make_conv(weight, None).requires_grad_(False) for weight in weights]

    def plan(
        self, clouds: Sequence[Float32[Tensor, "_ 3"]], unions: Bool[np.ndarray, "U C"]
    ) -> UnionPlan:
        """Plan the work for unions of clouds (m)."""
        placed = PlacedClouds.of(clouds, self.config)
        max_points = self.config.max_points
        nx, ny, _ = self.config.grid_shape
        reach = torch.zeros(placed.clouds + 1, nx * ny, device=placed.points.device)
        column = placed.cells[:, 0] * ny + placed.cells[:, 1]
        reach[placed.cloud, column] = 1
        reach[-1, column[placed.crowd > max_points]] = 1
        reach = reach.view(-1, 1, nx, ny)
        size = 2 * self.size
        seen = []
        for stride in self._strides:
            reach = F.max_pool2d(reach, 3, stride, 1)
            size = size // stride
            by_tile = F.max_pool2d(reach, size, ceil_mode=True) > 0
            seen.append(by_tile.flatten(1).T.cpu().numpy())
        return UnionPlan(placed, seen, unions, *placed.find_crowded(unions, max_points))

    def gains(self, plan: UnionPlan) -> bool:
        """True if shared work is quicker than one union after another."""
        unions = len(plan.unions) - PLAN_COST_UNIONS
        return len(plan.entries(-1).tile) <= MAX_UNSHARED_SHARE * len(plan.seen[-1]) * unions

    def __call__(
        self, plan: UnionPlan
    ) -> Iterator[tuple[slice, Entries, Iterator[TilePredictions]]]:
        """Yield groups of unions, as large as memory allows.

        Each is a slice of the unions, the entries of the head's tiles, and the head's maps for all
        of them.
        """
        count = len(plan.unions)
        while count > 1 and len(plan.part(slice(count)).entries(-1).tile) > MAX_ENTRIES:
            count = (count + 1) // 2
        for first in range(0, len(plan.unions), count):
            union_rows = slice(first, first + count)
            maps = self._maps(plan.part(union_rows))
            yield union_rows, maps[-1][1], self._heads(maps)

    @torch.inference_mode()
    def _maps(self, plan: UnionPlan) -> list[tuple[Tensor, Entries]]:
        """Values and entries of each block's last layer."""
        entries = plan.entries(0)
        size = self.size
        layer = 0
        maps = []
        bank = self._first(plan, entries)
        for block in self._blocks:
            for conv in block:
                layer += 1
                after = plan.entries(layer)
                bank = self._convolve(conv, bank, entries, after, size)
                size = size // self._strides[layer]
                entries = after
            maps.append((bank, entries))
        return maps

    def _first(self, plan: UnionPlan, entries: Entries) -> _Bank:
        """Run the first convolution on each entry's columns, those in and about its tile."""
        # columns; the convolution of stride 2 looks one back, two keep it in step
        wide = 2 * self.size + 2
        placed = plan.placed
        middle = self._network.middle
        by_tile = placed.by_tile(self._grid, 2 * self.size, 2)

        def convolve(tiles: np.ndarray, union: np.ndarray) -> _Bank:
            rows, item = by_tile.rows(tiles, plan.unions[union])
            if len(plan.dropped):
                thinning = torch.from_numpy(plan.thinning[union]).to(rows.device)[item]
                dropped_key = thinning * len(placed.points) + rows
                is_kept = (
                    plan.dropped[
                        torch.searchsorted(plan.dropped, dropped_key).clamp_(
                            max=len(plan.dropped) - 1
                        )
                    ]
                    != dropped_key
                )
                rows = rows[is_kept]
                item = item[is_kept]
            corner = 2 * self.size * torch.from_numpy(self._corners(tiles)).to(rows.device) - 2
            voxels = placed.batch(rows, item, len(tiles), self.config)
            local = voxels._replace(cells=voxels.cells - F.pad(corner[voxels.cells[:, 0]], (1, 1)))
            x: Tensor = middle(
                self._network.features(voxels), local, (wide, wide, self.config.grid_shape[2])
            )
            cells = x.permute(0, 2, 3, 1)[:, 1:, 1:]
            return self._within(cells.to(self._finest.weight.dtype), tiles)

        return entries.bank(convolve)

    def _convolve(
        self, conv: nn.Conv2d, bank: Tensor, before: Entries, after: Entries, size: int
    ) -> _Bank:
        sides = (
            (0, slice(0, 1), slice(-1, None)),
            (1, slice(1, -1), slice(None)),
            (2, slice(-1, None), slice(0, 1)),
        )
        entry_of = before.of.reshape(*self._grid, -1)
        # zeros beyond the map
        entry_of = np.pad(entry_of, ((1, 1), (1, 1), (0, 0)), constant_values=len(before.tile))

        def convolve(tiles: np.ndarray, union: np.ndarray) -> _Bank:
            patches = bank.new_empty(len(tiles), size + 2, size + 2, bank.shape[3])
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
        rpn = self._network.rpn
        for first, tiles, union in maps[-1][1].parts():
            blocks = []
            for bank, bank_entries in maps:
                rows = torch.from_numpy(bank_entries.of[tiles, union]).to(bank.device)
                blocks.append(bank[rows])
            x = _cells(self._finest, blocks[0])
            for conv, y in zip(self._raised, blocks[1:], strict=True):
                side = y.shape[1]
                k = self.size // y.shape[1]
                width = x.shape[3]
                raised = _cells(conv, y).view(-1, side, side, k, k, width).transpose(2, 3)
                x.view(-1, side, k, side, k, width).add_(raised)
            x = _cells(rpn.outputs, torch.relu_(x)).float().permute(0, 3, 1, 2)
            corner = torch.from_numpy(self.size * self._corners(tiles)).to(x.device)
            yield TilePredictions(first, corner, Prediction(*torch.split(x, rpn.channels, 1)))

    def _corners(self, tiles: Int64[np.ndarray, " m"]) -> Int64[np.ndarray, "m 2"]:
        return np.stack([tiles // self._grid[1], tiles % self._grid[1]], axis=1)

    def _within(self, x: _Bank, tiles: np.ndarray) -> _Bank:
        """Set cells beyond the map to zero, as convolutions expect."""
        size = x.shape[1]
        corners = torch.from_numpy(self._corners(tiles)).to(x.device)
        for axis, (side, cells) in enumerate(zip(self._grid, self._map, strict=True)):
            if side * self.size != cells:
                cell = corners[:, axis, None] * size + torch.arange(size, device=x.device)
                is_inside = (cell < cells * size // self.size).to(x.dtype)
                x = x * (is_inside[:, :, None, None] if axis == 0 else is_inside[:, None, :, None])
        return x


def _cells(conv: nn.Module, x: _Bank) -> Float[Tensor, "n t t L"]:
    """Convolve tiles with a 1x1 kernel, stacked as one map."""
    y = cell_by_cell(conv, x.flatten(0, 1)[None].permute(0, 3, 1, 2)).permute(0, 2, 3, 1)
    return y.reshape(*x.shape[:3], -1)
