"""Voxelisation: the points of a cloud, grouped by the voxel they lie in, at most T of them kept per voxel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from models.config import VoxelNetConfig
from toolkit.arrays import Float32, Int64


class Voxels(NamedTuple):
    """The occupied voxels of one or several clouds, and the points in them.

    Plain lists of points instead of a (voxels, T, 3) block that is mostly padding. The rows of `cells` are
    sorted by batch item, z, x, y; no voxel is empty.
    """

    points: Float32[Tensor, "n 3"]  # x y z in the frame of the grid, m
    voxel: Int64[Tensor, " n"]  # the row in `cells` of each point's voxel
    cells: Int64[Tensor, "v 4"]  # batch item, and the voxel's indices along x, y and z
    items: int = 1  # clouds in the batch

    def to(self, device: str | torch.device) -> Voxels:
        """The same voxels on another device."""
        return Voxels(self.points.to(device), self.voxel.to(device), self.cells.to(device), self.items)


def voxelise(
    points: Float32[np.ndarray, "n 3"] | Float32[Tensor, "n 3"],
    config: VoxelNetConfig,
    *,
    rng: np.random.Generator | int = 0,
) -> Voxels:
    """Group points (x y z, m) by voxel.

    Points outside the area or the height range, or on their borders, are ignored (the paper keeps 0 < height < 4 m).
    Where a voxel holds more than T points, a random T of them stay, each subset as likely as any other; the choice
    follows `rng` and is the same every time by default. The kept points stay in their order.

    Raises ValueError where the points are not (n, 3).

    >>> config = VoxelNetConfig.light((-40, -20, 40, 20))
    >>> voxelise(np.float32([[-39.9, -19.9, 0.1], [-39.85, -19.9, 0.1], [39.9, 19.9, 3.9], [41, 0, 1]]), config).cells
    tensor([[  0,   0,   0,   0], [  0, 399, 199,   9]])
    """
    cloud = torch.as_tensor(points, dtype=torch.float32)
    if cloud.ndim != 2 or cloud.shape[1] != 3:
        raise ValueError(f"points must have shape (n, 3), got {tuple(cloud.shape)}")
    cloud = cloud[_inside(cloud, config)]
    key = _keys(cloud, config)
    nx, ny, nz = config.grid_shape
    counts = torch.bincount(key, minlength=nx * ny * nz)
    keep = _at_most(config.max_points, key, counts, rng)
    if keep is not None:
        cloud, key = cloud[keep], key[keep]
    occupied = counts > 0
    row_of_key = torch.cumsum(occupied, 0, dtype=torch.int32) - 1
    return Voxels(cloud, row_of_key[key].long(), _cells(torch.nonzero(occupied)[:, 0], config))


def collate(batch: Sequence[Voxels]) -> Voxels:
    """Several clouds as one batch: item i of the result is batch[i]."""
    points, voxel, cells, item, row = [], [], [], 0, 0
    for voxels in batch:
        points.append(voxels.points)
        voxel.append(voxels.voxel + row)
        cells.append(voxels.cells + torch.tensor([item, 0, 0, 0], device=voxels.cells.device))
        item += voxels.items
        row += len(voxels.cells)
    return Voxels(torch.cat(points), torch.cat(voxel), torch.cat(cells), item)


def _inside(cloud: Tensor, config: VoxelNetConfig) -> Tensor:
    xmin, ymin, xmax, ymax = config.area
    lower = cloud.new_tensor([xmin, ymin, config.height[0]])
    upper = cloud.new_tensor([xmax, ymax, config.height[1]])
    return ((cloud > lower) & (cloud < upper)).all(1)


def _keys(cloud: Tensor, config: VoxelNetConfig) -> Tensor:
    """The number of each point's voxel, counted z by z, then x by x (float64: a float32 1.4 is below 7 voxels)."""
    size = torch.tensor(config.voxel_size, dtype=torch.float64, device=cloud.device)
    origin = size.new_tensor([config.area[0], config.area[1], config.height[0]])
    shape = torch.tensor(config.grid_shape, device=cloud.device)
    index = torch.floor(cloud.double() / size - origin / size).long()
    ix, iy, iz = torch.minimum(index.clamp_min_(0), shape - 1).unbind(1)
    return (iz * shape[0] + ix) * shape[1] + iy


def _cells(key: Tensor, config: VoxelNetConfig) -> Tensor:
    nx, ny, _ = config.grid_shape
    plane = key % (nx * ny)
    return torch.stack((torch.zeros_like(key), plane // ny, plane % ny, key // (nx * ny)), 1)


def _at_most(limit: int, key: Tensor, counts: Tensor, rng: np.random.Generator | int) -> Tensor | None:
    """Which points stay, (n,) bool: a random subset where a voxel is beyond the limit. None: all of them."""
    crowded = torch.nonzero(counts[key] > limit)[:, 0]
    if not len(crowded):
        return None
    drawn = torch.from_numpy(np.random.default_rng(rng).permutation(len(crowded))).to(key.device)
    shuffled = crowded[drawn]
    shuffled = shuffled[torch.argsort(key[shuffled], stable=True)]
    sizes = torch.unique_consecutive(key[shuffled], return_counts=True)[1]
    rank = torch.arange(len(shuffled), device=key.device) - torch.repeat_interleave(
        torch.cumsum(sizes, 0) - sizes, sizes
    )
    keep = torch.ones(len(key), dtype=torch.bool, device=key.device)
    keep[shuffled[rank >= limit]] = False
    return keep
