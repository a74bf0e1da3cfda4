"""Grid of a network: points by voxel, at most T in each, and anchors by cell.

Boxes are residuals to anchors (paper, section III-D; Zhou and Tuzel 2018), of a box (x y z l w h ψ)
to an anchor (a):

    Δx, Δy over √(l_a² + w_a²)    Δz over h_a    ln(l/l_a), ln(w/w_a), ln(h/h_a)

then the yaw, δ = ψ - ψ_a:

    published head:  δ                (a box and its half turn have very different residuals)
    quality head:    sin 2δ, cos 2δ and a direction bit
                     (they have the same residuals; the bit distinguishes them)
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from models.config import VoxelNetConfig
from toolkit.arrays import Bool, Float, Float32, Int64, Points, Rng

_Boxes = Float[Tensor, "*n 7"]
_Random = Rng | int


class Voxels(NamedTuple):
    """Points of one or several clouds and their occupied voxels, sorted by batch item, z, x, y."""

    points: Float32[Tensor, "n 3"]  # x y z in the frame of the grid, m
    voxel: Int64[Tensor, " n"]  # the row in `cells` of each point's voxel
    cells: Int64[Tensor, "v 4"]  # batch item, and the voxel's indices along x, y and z
    items: int = 1  # clouds in the batch

    def to(self, device: str | torch.device) -> "Voxels":
        """Move the voxels to another device."""
        return Voxels(
            self.points.to(device), self.voxel.to(device), self.cells.to(device), self.items
        )


def voxelise(
    points: Points | Float[Tensor, "n 3"], config: VoxelNetConfig, *, rng: _Random = 0
) -> Voxels:
    """Group points (x y z, m) by voxel.

    Points outside the area or the height range, or on their borders, are ignored (the paper keeps 0
    < height < 4 m). In a voxel with more than T points a random T stay, by default the same every
    time. Kept points stay in their order.

    Raises ValueError unless the points are (n, 3).
    """
    cloud = torch.as_tensor(points, dtype=torch.float32)
    if cloud.ndim != 2 or cloud.shape[1] != 3:
        raise ValueError(f"points must have shape (n, 3), got {tuple(cloud.shape)}")
    cloud, cells = grid_cells(cloud, config)
    nx, ny, _ = config.grid_shape
    ix, iy, iz = cells.unbind(1)
    # less work than a map of all voxels
    occupied, voxel = torch.unique((iz * nx + ix) * ny + iy, return_inverse=True)
    is_crowded = torch.bincount(voxel)[voxel] > config.max_points
    if is_crowded.any():
        is_kept = thin_voxels(voxel, is_crowded, config.max_points, rng)
        cloud = cloud[is_kept]
        voxel = voxel[is_kept]
    plane = occupied % (nx * ny)
    cells = torch.stack(
        (torch.zeros_like(plane), plane // ny, plane % ny, occupied // (nx * ny)), 1
    )
    return Voxels(cloud, voxel, cells)


def collate(batch: Sequence[Voxels]) -> Voxels:
    """Join clouds into one batch, in their order."""
    voxel = []
    cells = []
    item = 0
    row = 0
    for voxels in batch:
        voxel.append(voxels.voxel + row)
        cells.append(voxels.cells + torch.tensor([item, 0, 0, 0], device=voxels.cells.device))
        item += voxels.items
        row += len(voxels.cells)
    return Voxels(
        torch.cat([item_voxels.points for item_voxels in batch]),
        torch.cat(voxel),
        torch.cat(cells),
        item,
    )


def grid_cells(
    cloud: Float32[Tensor, "n 3"], config: VoxelNetConfig
) -> tuple[Float32[Tensor, "m 3"], Int64[Tensor, "m 3"]]:
    """Points inside the grid, and their voxel indices (x, y, z)."""
    xmin, ymin, xmax, ymax = config.area
    bounds = ((xmin, xmax), (ymin, ymax), config.height)
    is_inside = torch.ones(len(cloud), dtype=torch.bool, device=cloud.device)
    for axis, (low, high) in enumerate(bounds):
        is_inside &= (cloud[:, axis] > low) & (cloud[:, axis] < high)
    cloud = cloud[is_inside]
    indices = []
    for axis, (low, _) in enumerate(bounds):
        size = config.voxel_size[axis]
        # in float64: a float32 1.4 is below 7 voxels
        index = torch.floor(cloud[:, axis].double() / size - low / size).long()
        indices.append(index.clamp_(0, config.grid_shape[axis] - 1))
    return cloud, torch.stack(indices, 1)


def thin_voxels(
    voxel: Int64[Tensor, " n"], is_crowded: Bool[Tensor, " n"], limit: int, rng: _Random = 0
) -> Bool[Tensor, " n"]:
    """Mask of the points that stay: in crowded voxels any `limit` of them, each subset equally
    likely."""
    rows = torch.nonzero(is_crowded)[:, 0]
    rows = rows[torch.from_numpy(np.random.default_rng(rng).permutation(len(rows))).to(rows.device)]
    rows = rows[torch.argsort(voxel[rows], stable=True)]
    sizes = torch.unique_consecutive(voxel[rows], return_counts=True)[1]
    rank = torch.arange(len(rows), device=rows.device) - torch.repeat_interleave(
        torch.cumsum(sizes, 0) - sizes, sizes
    )
    is_kept = torch.ones_like(is_crowded)
    is_kept[rows[rank >= limit]] = False
    return is_kept


def anchors(config: VoxelNetConfig) -> Float[Tensor, "H W A 7"]:
    """Box per cell, class and yaw in the frame of the grid, H along x, W along y."""
    rows, columns = config.map_shape
    dx, dy = config.stride
    x = config.area[0] + (torch.arange(rows, dtype=torch.float64) + 0.5) * dx
    y = config.area[1] + (torch.arange(columns, dtype=torch.float64) + 0.5) * dy
    anchor_values = [(kind.z, *kind.size, yaw) for kind in config.anchor_kinds for yaw in kind.yaws]
    boxes = torch.empty(rows, columns, len(anchor_values), 7)
    boxes[..., 0] = x[:, None, None]
    boxes[..., 1] = y[None, :, None]
    boxes[..., 2:] = torch.tensor(anchor_values)
    return boxes


def encode_residuals(
    boxes: _Boxes, anchors: _Boxes, *, doubled: bool = True
) -> Float[Tensor, "*n R"]:
    """Residuals of boxes to anchors: eight with the doubled yaw difference, or seven with the plain
    one."""
    diagonal = torch.linalg.vector_norm(anchors[..., 3:5], dim=-1, keepdim=True)
    size = anchors[..., 3:6]
    delta = boxes - anchors
    centre = delta[..., :3] / torch.cat((diagonal, diagonal, size[..., 2:]), -1)
    yaw = delta[..., 6:]
    angle = (torch.sin(2 * yaw), torch.cos(2 * yaw)) if doubled else (yaw,)
    return torch.cat((centre, torch.log(boxes[..., 3:6] / size), *angle), -1)


def decode(
    residuals: Float[Tensor, "*n R"], anchors: _Boxes, direction: Bool[Tensor, "*n"] | None = None
) -> _Boxes:
    """Boxes of residuals. Eight residuals leave the yaw open by 180°, which `direction` settles."""
    diagonal = torch.linalg.vector_norm(anchors[..., 3:5], dim=-1, keepdim=True)
    size = anchors[..., 3:6]
    scale = torch.cat((diagonal, diagonal, size[..., 2:]), -1)
    centre = anchors[..., :3] + residuals[..., :3] * scale
    angle = residuals[..., 6:]
    delta = angle
    if angle.shape[-1] != 1:
        delta = torch.atan2(angle[..., :1], angle[..., 1:]) / 2
    if direction is not None:
        delta = delta + math.pi * direction[..., None]
    yaw = anchors[..., 6:] + delta
    return torch.cat((centre, size * torch.exp(residuals[..., 3:6]), yaw), -1)


def faces_back(boxes: _Boxes, anchors: _Boxes) -> Bool[Tensor, "*n"]:
    """Mask of boxes headed more than 90° off their anchor."""
    return torch.cos(boxes[..., 6] - anchors[..., 6]) < 0


def per_anchor(channels: Float[Tensor, "B Ak H W"], anchors: int) -> Float[Tensor, "B H W A k"]:
    """Map of the head, reshaped by cell and anchor."""
    items, _, rows, columns = channels.shape
    return channels.view(items, anchors, -1, rows, columns).permute(0, 3, 4, 1, 2)
