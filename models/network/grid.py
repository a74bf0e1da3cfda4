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
_Random = Rng | int  # a generator or a seed


class Voxels(NamedTuple):
    """Points of one or several clouds and their occupied voxels, sorted by batch item, z, x, y.

    Attributes:
        points: x y z in the frame of the grid, m.
        voxel: Row in `cells` of each point's voxel.
        cells: Batch item and indices along x, y and z of each occupied voxel.
        items: Clouds in the batch.
    """

    points: Float32[Tensor, "n 3"]
    voxel: Int64[Tensor, " n"]
    cells: Int64[Tensor, "voxels 4"]
    items: int = 1

    def to(self, device: str | torch.device) -> "Voxels":
        """Copy of the voxels on a device."""
        return Voxels(
            points=self.points.to(device),
            voxel=self.voxel.to(device),
            cells=self.cells.to(device),
            items=self.items,
        )


class Groups(NamedTuple):
    """Rows of n numbers, sorted into groups of equal numbers.

    Attributes:
        order: Rows by number, and by row within a group.
        number: Number of each of g groups, ascending.
        begin: Position in `order` at which each group begins.
    """

    order: Int64[Tensor, " n"]
    number: Int64[Tensor, " groups"]
    begin: Int64[Tensor, " groups"]

    @staticmethod
    def from_numbers(numbers: Int64[Tensor, " n"]) -> "Groups":
        """Group rows by their number, 0 or more; rows of a group stay in order."""
        count = len(numbers)
        if numbers.device.type == "cpu" and count:
            # numbers with their rows as low bits: sorted faster than numbers with an index; both
            # must fit 63 bits
            row_bits = count.bit_length()
            keys = np.sort(numbers.numpy() << row_bits | np.arange(count))
            order = torch.from_numpy(keys & (1 << row_bits) - 1)
            sorted_numbers = torch.from_numpy(keys >> row_bits)
        else:
            sorted_numbers, order = torch.sort(numbers, stable=True)
        is_first = torch.ones(count, dtype=torch.bool, device=numbers.device)
        torch.ne(sorted_numbers[1:], sorted_numbers[:-1], out=is_first[1:])
        begin = torch.nonzero(is_first)[:, 0]
        return Groups(order, sorted_numbers.index_select(0, begin), begin)

    def counts(self) -> Int64[Tensor, " groups"]:
        """Number of rows in each group."""
        end = self.begin.new_tensor([len(self.order)])
        return torch.diff(self.begin, append=end)

    def of_rows(self) -> Int64[Tensor, " n"]:
        """Group of each row, as an index in `number`."""
        groups = torch.arange(len(self.number), device=self.order.device)
        sorted_groups = torch.repeat_interleave(groups, self.counts(), output_size=len(self.order))
        return torch.empty_like(self.order).index_copy_(0, self.order, sorted_groups)


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
    cloud, point_cells = grid_cells(cloud, config)
    nx, ny, _ = config.grid_shape
    ix, iy, iz = point_cells.unbind(1)
    # groups of the occupied voxels: less work than a map of all voxels
    groups = Groups.from_numbers((iz * nx + ix) * ny + iy)
    voxel = groups.of_rows()
    counts = groups.counts()
    if bool((counts > config.max_points).any()):
        is_crowded = (counts > config.max_points).index_select(0, voxel)
        is_kept = thin_voxels(voxel, is_crowded, config.max_points, rng)
        cloud = cloud[is_kept]
        voxel = voxel[is_kept]
    first_points = groups.order.index_select(0, groups.begin)
    first_cells = point_cells.index_select(0, first_points)
    item = torch.zeros_like(first_points)[:, None]
    return Voxels(points=cloud, voxel=voxel, cells=torch.cat((item, first_cells), 1))


def collate(batch: Sequence[Voxels]) -> Voxels:
    """One batch of several clouds (or batches), in their order."""
    # voxel of each point, counted over the batch
    voxel_parts = []
    # item, ix, iy and iz of each occupied voxel
    cell_parts = []
    items = 0  # so far
    rows = 0  # occupied voxels so far
    for voxels in batch:
        voxel_parts.append(voxels.voxel + rows)
        cell_parts.append(voxels.cells + torch.tensor([items, 0, 0, 0], device=voxels.cells.device))
        items += voxels.items
        rows += len(voxels.cells)
    return Voxels(
        points=torch.cat([voxels.points for voxels in batch]),
        voxel=torch.cat(voxel_parts),
        cells=torch.cat(cell_parts),
        items=items,
    )


def grid_cells(
    cloud: Float32[Tensor, "n 3"], config: VoxelNetConfig
) -> tuple[Float32[Tensor, "m 3"], Int64[Tensor, "m 3"]]:
    """Points of a cloud inside the grid, in their order, and voxel indices along x, y, z of each.

    cloud: x y z in the frame of the grid (m); points on its border are outside."""
    xmin, ymin, xmax, ymax = config.area
    bounds = ((xmin, xmax), (ymin, ymax), config.height)
    is_inside = torch.ones(len(cloud), dtype=torch.bool, device=cloud.device)
    for axis, (low, high) in enumerate(bounds):
        is_inside &= (cloud[:, axis] > low) & (cloud[:, axis] < high)
    if not bool(is_inside.all()):
        cloud = cloud.index_select(0, torch.nonzero(is_inside)[:, 0])
    indices = []
    for axis, (low, _) in enumerate(bounds):
        size = config.voxel_size[axis]
        # in float64: in float32, 1.4 m would be just below 7 voxels of 0.2 m
        index = torch.floor(cloud[:, axis].double() / size - low / size).long()
        indices.append(index.clamp_(0, config.grid_shape[axis] - 1))
    return cloud, torch.stack(indices, 1)


def thin_voxels(
    voxel: Int64[Tensor, " n"], is_crowded: Bool[Tensor, " n"], limit: int, rng: _Random = 0
) -> Bool[Tensor, " n"]:
    """Mask of the points that stay: a random `limit` of each crowded voxel's, and all others.

    voxel: number of each point's voxel. is_crowded: True for all points of the voxels to thin.
    """
    rows = torch.nonzero(is_crowded)[:, 0]
    shuffle = torch.from_numpy(np.random.default_rng(rng).permutation(len(rows)))
    rows = rows[shuffle.to(rows.device)]
    rows = rows[torch.argsort(voxel[rows], stable=True)]  # by voxel; shuffled within each
    sizes = torch.unique_consecutive(voxel[rows], return_counts=True)[1]
    first_row = torch.repeat_interleave(torch.cumsum(sizes, 0) - sizes, sizes)
    rank = torch.arange(len(rows), device=rows.device) - first_row  # within the voxel
    is_kept = torch.ones_like(is_crowded)
    is_kept[rows[rank >= limit]] = False
    return is_kept


def anchors(config: VoxelNetConfig) -> Float[Tensor, "H W A 7"]:
    """Boxes in the frame of the grid, one for each cell of the map, kind of anchor and yaw.

    H is along x, W along y, A counts kinds and yaws; a box has x, y, z, length, width, height, yaw.

    A cell's anchors are sorted by kind, then yaw, as in `config.anchor_labels`.
    """
    rows, columns = config.map_shape
    dx, dy = config.stride  # sides of a cell, m
    xmin, ymin = config.area[:2]
    x = xmin + (torch.arange(rows, dtype=torch.float64) + 0.5) * dx
    y = ymin + (torch.arange(columns, dtype=torch.float64) + 0.5) * dy
    # z, length, width, height and yaw
    anchor_values = [(kind.z, *kind.size, yaw) for kind in config.anchor_kinds for yaw in kind.yaws]
    boxes = torch.empty(rows, columns, len(anchor_values), 7)
    boxes[..., 0] = x[:, None, None]
    boxes[..., 1] = y[None, :, None]
    boxes[..., 2:] = torch.tensor(anchor_values)
    return boxes


def encode_residuals(
    boxes: _Boxes, anchors: _Boxes, *, doubled: bool = True
) -> Float[Tensor, "*n residuals"]:
    """Residuals of boxes to anchors: three for the centre, three for the size, then for the yaw.

    boxes, anchors: x, y, z, length, width, height, yaw. doubled: True for eight residuals with
    sin 2δ and cos 2δ of the yaw difference δ, False for seven with δ.
    """
    diagonal = torch.linalg.vector_norm(anchors[..., 3:5], dim=-1, keepdim=True)
    size = anchors[..., 3:6]
    delta = boxes - anchors
    centre = delta[..., :3] / torch.cat((diagonal, diagonal, size[..., 2:]), -1)
    turn = delta[..., 6:]
    angle = (torch.sin(2 * turn), torch.cos(2 * turn)) if doubled else (turn,)
    return torch.cat((centre, torch.log(boxes[..., 3:6] / size), *angle), -1)


def decode(
    residuals: Float[Tensor, "*n residuals"],
    anchors: _Boxes,
    direction: Bool[Tensor, "*n"] | None = None,
) -> _Boxes:
    """Boxes of residuals to anchors: the inverse of `encode_residuals`.

    residuals: three for the centre, three for the size, then δ of the yaw, or sin 2δ and cos 2δ,
    which leave the yaw open by 180°. anchors, and the boxes: x, y, z, length, width, height, yaw.
    direction: True for a box that faces the other way, None if no box does.
    """
    diagonal = torch.linalg.vector_norm(anchors[..., 3:5], dim=-1, keepdim=True)
    size = anchors[..., 3:6]
    scale = torch.cat((diagonal, diagonal, size[..., 2:]), -1)  # units of the centre's residuals
    centre = anchors[..., :3] + residuals[..., :3] * scale
    angle = residuals[..., 6:]
    turn = angle if angle.shape[-1] == 1 else torch.atan2(angle[..., :1], angle[..., 1:]) / 2
    if direction is not None:
        turn = turn + math.pi * direction[..., None]
    yaw = anchors[..., 6:] + turn
    return torch.cat((centre, size * torch.exp(residuals[..., 3:6]), yaw), -1)


def faces_back(boxes: _Boxes, anchors: _Boxes) -> Bool[Tensor, "*n"]:
    """Mask of boxes headed more than 90° off their anchor."""
    return torch.cos(boxes[..., 6] - anchors[..., 6]) < 0


def per_anchor(channels: Float[Tensor, "B Ak H W"], anchors: int) -> Float[Tensor, "B H W A k"]:
    """View of a map of the head with its channels split into A anchors and k values of each.

    anchors: number A of anchors in a cell; the channels hold all values of one, then the next.
    """
    items, _, rows, columns = channels.shape
    return channels.view(items, anchors, -1, rows, columns).permute(0, 3, 4, 1, 2)
