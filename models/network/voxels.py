"""Voxelisation: points by voxel, at most T in each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from models.config import VoxelNetConfig
from toolkit.arrays import Bool, Float, Float32, Int64


class Voxels(NamedTuple):
    """Points of one or several clouds and their occupied voxels, sorted by batch item, z, x, y."""

    points: Float32[Tensor, "n 3"]  # x y z in the frame of the grid, m
    voxel: Int64[Tensor, " n"]  # the row in `cells` of each point's voxel
    cells: Int64[Tensor, "v 4"]  # batch item, and the voxel's indices along x, y and z
    items: int = 1  # clouds in the batch

    def to(self, device: str | torch.device) -> Voxels:
        """Move the voxels to another device."""
        return Voxels(self.points.to(device), self.voxel.to(device), self.cells.to(device), self.items)


def voxelise(
    points: Float[np.ndarray, "n 3"] | Float[Tensor, "n 3"],
    config: VoxelNetConfig,
    *,
    rng: np.random.Generator | int = 0,
) -> Voxels:
    """Group points (x y z, m) by voxel.

    Points outside the area or the height range, or on their borders, are ignored (the paper keeps 0 < height < 4 m). In
    a voxel with more than T points a random T stay, by default the same every time. Kept points stay in their order.

    Raises ValueError unless the points are (n, 3).

    >>> config = VoxelNetConfig.light((-40, -20, 40, 20))
    >>> voxelise(np.float32([[-39.9, -19.9, 0.1], [-39.85, -19.9, 0.1], [39.9, 19.9, 3.9], [41, 0, 1]]), config).cells
    tensor([[  0,   0,   0,   0], [  0, 399, 199,   9]])
    """
    cloud = torch.as_tensor(points, dtype=torch.float32)
    if cloud.ndim != 2 or cloud.shape[1] != 3:
        raise ValueError(f"points must have shape (n, 3), got {tuple(cloud.shape)}")
    cloud, cells = grid_cells(cloud, config)
    nx, ny, _ = config.grid_shape
    ix, iy, iz = cells.unbind(1)
    occupied, voxel = torch.unique((iz * nx + ix) * ny + iy, return_inverse=True)  # less work than a map of all voxels
    crowded = torch.bincount(voxel)[voxel] > config.max_points
    if crowded.any():
        keep = thin_voxels(voxel, crowded, config.max_points, rng)
        cloud, voxel = cloud[keep], voxel[keep]
    plane = occupied % (nx * ny)
    cells = torch.stack((torch.zeros_like(plane), plane // ny, plane % ny, occupied // (nx * ny)), 1)
    return Voxels(cloud, voxel, cells)


def collate(batch: Sequence[Voxels]) -> Voxels:
    """Join clouds into one batch, in their order."""
    voxel, cells, item, row = [], [], 0, 0
    for voxels in batch:
        voxel.append(voxels.voxel + row)
        cells.append(voxels.cells + torch.tensor([item, 0, 0, 0], device=voxels.cells.device))
        item += voxels.items
        row += len(voxels.cells)
    return Voxels(torch.cat([each.points for each in batch]), torch.cat(voxel), torch.cat(cells), item)


def grid_cells(
    cloud: Float32[Tensor, "n 3"], config: VoxelNetConfig
) -> tuple[Float32[Tensor, "m 3"], Int64[Tensor, "m 3"]]:
    """Points inside the grid, and their voxel indices (x, y, z)."""
    xmin, ymin, xmax, ymax = config.area
    bounds = ((xmin, xmax), (ymin, ymax), config.height)
    x, y, z = ((axis > low) & (axis < high) for axis, (low, high) in zip(cloud.unbind(1), bounds, strict=True))
    cloud, sizes = cloud[x & y & z], zip(config.voxel_size, config.grid_shape, strict=True)
    indices = [  # in float64: a float32 1.4 is below 7 voxels
        torch.floor(axis.double() / size - low / size).long().clamp_(0, cells - 1)
        for axis, (low, _), (size, cells) in zip(cloud.unbind(1), bounds, sizes, strict=True)
    ]
    return cloud, torch.stack(indices, 1)


def thin_voxels(
    voxel: Int64[Tensor, " n"], crowded: Bool[Tensor, " n"], limit: int, rng: np.random.Generator | int = 0
) -> Bool[Tensor, " n"]:
    """Mark the points that stay: in crowded voxels any `limit` of them, each subset as likely as any other."""
    rows = torch.nonzero(crowded)[:, 0]
    rows = rows[torch.from_numpy(np.random.default_rng(rng).permutation(len(rows))).to(rows.device)]
    rows = rows[torch.argsort(voxel[rows], stable=True)]
    sizes = torch.unique_consecutive(voxel[rows], return_counts=True)[1]
    rank = torch.arange(len(rows), device=rows.device) - torch.repeat_interleave(torch.cumsum(sizes, 0) - sizes, sizes)
    keep = torch.ones_like(crowded)
    keep[rows[rank >= limit]] = False
    return keep
