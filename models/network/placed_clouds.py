"""`PlacedClouds`: several clouds in one grid, their points in voxels, so that unions of them need no voxels anew."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from models.config import VoxelNetConfig
from models.network.voxels import Voxels, grid_cells, thinned_voxels
from toolkit.arrays import Bool, Float32, Int64


class Crowded(NamedTuple):
    """Voxels that hold more points than the network takes. thinning: how they are thinned in each union, a number, 0
    where there are none; dropped: the points left out, ascending: the thinning's number · points + the point's row."""

    thinning: Int64[np.ndarray, " U"]
    dropped: Int64[Tensor, " k"]


class PlacedClouds(NamedTuple):
    """The points of all clouds within the grid, cloud after cloud: which cloud they are of, their voxels (indices along
    x, y and z), the voxels' numbers, and how many points of all clouds are in each one's."""

    points: Float32[Tensor, "n 3"]
    cloud: Int64[Tensor, " n"]
    cells: Int64[Tensor, "n 3"]
    voxel: Int64[Tensor, " n"]
    crowd: Int64[Tensor, " n"]
    clouds: int

    @staticmethod
    def of(clouds: Sequence[Float32[Tensor, "_ 3"]], config: VoxelNetConfig) -> PlacedClouds:
        """Of points in the frame of the grid, m."""
        kept, indices = zip(*(grid_cells(cloud, config) for cloud in clouds), strict=True)
        number = torch.arange(len(clouds), device=kept[0].device)
        counts = torch.tensor([len(cloud) for cloud in kept], device=kept[0].device)
        cells, (nx, ny, _) = torch.cat(indices), config.grid_shape
        ix, iy, iz = cells.unbind(1)
        _, voxel, count = torch.unique((iz * nx + ix) * ny + iy, return_inverse=True, return_counts=True)
        cloud = torch.repeat_interleave(number, counts)
        return PlacedClouds(torch.cat(kept), cloud, cells, voxel, count[voxel], len(clouds))

    def counts(self) -> Int64[Tensor, " C"]:
        """Points of each cloud."""
        return torch.bincount(self.cloud, minlength=self.clouds)

    def crowded(self, unions: Bool[np.ndarray, "U C"], most: int) -> Crowded:
        """Where voxels of unions hold more than so many points, those left out that `voxelise` leaves out of each."""
        rows = torch.nonzero(self.crowd > most)[:, 0]
        concerned = torch.bincount(self.cloud[rows], minlength=self.clouds).cpu().numpy() > 0
        alike, number = np.unique(unions & concerned, axis=0, return_inverse=True)
        thinning, dropped = np.zeros(len(alike), np.int64), [rows[:0]]
        for place, union in enumerate(alike):
            some = rows[torch.from_numpy(union).to(rows.device)[self.cloud[rows]]]
            _, voxel, count = torch.unique(self.voxel[some], return_inverse=True, return_counts=True)
            keep = thinned_voxels(voxel, (count > most)[voxel], most)
            if not keep.all():
                thinning[place] = len(dropped)
                dropped.append(some[~keep] + len(dropped) * len(self.points))
        return Crowded(thinning[number.ravel()], torch.cat(dropped))

    def by_tile(self, grid: tuple[int, int], size: int, before: int) -> PointsByTile:
        """The points in each tile of so many columns along x and y, and in those before it, less than a tile has."""
        (tx, ty), (from_x, from_y) = (self.cells[:, :2] // size).T, (self.cells[:, :2] % size).T
        rows, keys = [], []
        for dx in (0, 1):
            for dy in (0, 1):
                there = ((from_x >= size - before) | (dx == 0)) & ((from_y >= size - before) | (dy == 0))
                there &= (tx + dx < grid[0]) & (ty + dy < grid[1])
                some = torch.nonzero(there)[:, 0]
                rows.append(some)
                keys.append(((tx[some] + dx) * grid[1] + ty[some] + dy) * self.clouds + self.cloud[some])
        row, key = torch.cat(rows), torch.cat(keys)
        order = torch.argsort(key * max(len(self.points), 1) + row)
        count = torch.bincount(key, minlength=grid[0] * grid[1] * self.clouds).cpu().numpy()
        first = np.cumsum(count) - count
        return PointsByTile(row[order], *(each.reshape(-1, self.clouds) for each in (first, count)))

    def batch(self, rows: Int64[Tensor, " n"], item: Int64[Tensor, " n"], items: int, config: VoxelNetConfig) -> Voxels:
        """Points, each of an item of a batch, as its voxels."""
        nx, ny, nz = config.grid_shape
        ix, iy, iz = self.cells[rows].unbind(1)
        occupied, voxel = torch.unique(((item * nz + iz) * nx + ix) * ny + iy, return_inverse=True)
        plane = occupied % (nx * ny)
        level = occupied // (nx * ny)
        cells = torch.stack((level // nz, plane // ny, plane % ny, level % nz), 1)
        return Voxels(self.points[rows], voxel, cells, items)


class PointsByTile(NamedTuple):
    """Points in order of their tile and cloud: the rows of each, and where a tile's of a cloud begin and how many."""

    row: Int64[Tensor, " k"]
    begin: Int64[np.ndarray, "tiles clouds"]
    points: Int64[np.ndarray, "tiles clouds"]

    def rows(self, tiles: np.ndarray, union: np.ndarray) -> tuple[Int64[Tensor, " n"], Int64[Tensor, " n"]]:
        """The points of some tiles in unions, and to which of them each belongs."""
        clouds = self.begin.shape[1]
        count = np.where(union, self.points[tiles], 0).ravel()
        total = int(count.sum())
        place = np.arange(total) + np.repeat(self.begin[tiles].ravel() - np.cumsum(count) + count, count)
        item = np.repeat(np.repeat(np.arange(len(tiles)), clouds), count)
        return self.row[torch.from_numpy(place).to(self.row.device)], torch.from_numpy(item).to(self.row.device)
