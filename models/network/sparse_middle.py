"""The three 3D convolutions where the points reach, and a constant of the weights everywhere else.

A convolution is linear: what it gives is what it gives for an empty grid, plus what it gives for the difference of its
input from that of an empty grid. The difference is zero wherever no point reaches, so only rows of reached cells are
kept and multiplied. An empty grid's response varies at its borders only, so a small empty grid tells all of it.

The cells of a level lie in a plane with a margin of one around each map of the batch, so that a neighbour is a fixed
step away, and a neighbour beyond the border is just a cell never reached.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.network.folding import folded
from models.network.voxelnet import MiddleLayers
from models.network.voxels import Voxels
from toolkit.arrays import Bool, Float32, Int32, Int64

BORDER = 2  # cells from a border within which an empty grid's response varies, after three convolutions
SMALL = 2 * BORDER + 1  # cells along x and y of the small empty grid


class Plane(NamedTuple):
    """Where the cells of B maps of H x W cells are in a plane with margins."""

    items: int
    nx: int
    ny: int

    @property
    def size(self) -> int:
        """Cells of the plane, margins included."""
        return self.items * (self.nx + 2) * (self.ny + 2)

    def place(self, item: Tensor, ix: Tensor, iy: Tensor) -> Tensor:
        """The place of a cell of a map."""
        return (item * (self.nx + 2) + ix + 1) * (self.ny + 2) + iy + 1

    def cell(self, place: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Batch item, and indices along x and y, of a place."""
        row = place // (self.ny + 2)
        return row // (self.nx + 2), row % (self.nx + 2) - 1, place % (self.ny + 2) - 1

    def neighbours(self, device: torch.device) -> Int32[Tensor, " 9"]:
        """Steps to the 3x3 cells around a place."""
        step = torch.arange(-1, 2, dtype=torch.int32, device=device)
        return (step[:, None] * (self.ny + 2) + step).view(-1)


class Reached(NamedTuple):
    """The cells that points reach, ordered by level and place: their values, less what an empty grid holds there."""

    mask: Bool[Tensor, "D P"]
    differences: Float32[Tensor, "n C"]


class SparseMiddle(nn.Module):
    """`MiddleLayers` of a trained network, for inference. Channels last in memory, ordered level by level."""

    def __init__(self, middle: MiddleLayers) -> None:
        super().__init__()
        self.shape = middle.shape
        layers: Any = middle.layers
        first = layers[0][0]
        empty = first.weight.new_zeros(1, first.in_channels, self.shape[2], SMALL, SMALL)
        self.layers: Any = nn.ModuleList()
        for conv, norm, _ in layers:
            weight, bias = folded(conv, norm)
            empty = F.conv3d(empty, weight, bias, conv.stride, conv.padding)
            self.layers.append(SparseConvolution(weight, empty[0], conv.stride[0], conv.padding[0]))
            empty = torch.relu(empty)
        width, levels = empty.shape[1:3]
        self.channel_order = torch.arange(width * levels).view(width, levels).T.reshape(-1)

    def forward(self, features: Float32[Tensor, "v C"], voxels: Voxels) -> Float32[Tensor, "B K H W"]:
        """The map seen from above, its channels in `channel_order`."""
        plane = Plane(voxels.items, *self.shape[:2])
        item, ix, iy, iz = voxels.cells.unbind(1)
        place = plane.place(item, ix, iy)
        mask = torch.zeros(self.shape[2], plane.size, dtype=torch.bool, device=features.device)
        mask[iz, place] = True
        reached = Reached(mask, torch.empty_like(features).index_copy_(0, numbers(mask)[iz, place], features))
        for layer in self.layers:
            reached, values = layer(reached, plane)
        level, place = torch.nonzero(reached.mask, as_tuple=True)
        item, ix, iy = plane.cell(place)
        everywhere = self.layers[-1].everywhere(plane)
        everywhere[item, ix, iy, level] = values
        return everywhere.flatten(3).permute(0, 3, 1, 2)


class SparseConvolution(nn.Module):
    """One 3x3x3 convolution and its ReLU on the reached cells."""

    def __init__(self, weight: Tensor, empty: Float32[Tensor, "C D S S"], stride: int, padding: int) -> None:
        super().__init__()
        self.first = [level * stride - padding for level in range(empty.shape[1])]  # the lowest input level of each
        self.weight: Tensor
        self.empty: Tensor
        self.register_buffer(
            "weight", weight.permute(2, 1, 3, 4, 0).flatten(2).contiguous()
        )  # level, input, 9 · output
        self.register_buffer("empty", empty.permute(1, 2, 3, 0).contiguous())  # before the ReLU

    def forward(self, reached: Reached, plane: Plane) -> tuple[Reached, Float32[Tensor, "m K"]]:
        """The cells reached after it, and their values."""
        levels = len(reached.mask)
        mask = grown(torch.stack([reached.mask[max(z, 0) : z + 3].any(0) for z in self.first]), plane)
        level, place = torch.nonzero(mask, as_tuple=True)
        _, ix, iy = plane.cell(place)
        empty = self.empty[level, _kind(ix, plane.nx), _kind(iy, plane.ny)]
        sums = empty.clone()
        neighbours = place.int()[:, None] + plane.neighbours(place.device)
        inputs = torch.split(reached.differences, reached.mask.sum(1).tolist())
        rows = mask.sum(1).tolist()
        for z_first, here, around in zip(
            self.first, torch.split(sums, rows), torch.split(neighbours, rows), strict=True
        ):
            for z in range(max(z_first, 0), min(z_first + 3, levels)):
                if len(inputs[z]):
                    here += _summed(inputs[z], self.weight[z - z_first], reached.mask[z], around)
        values = sums.relu_()
        return Reached(mask, values - empty.relu_()), values

    def everywhere(self, plane: Plane) -> Float32[Tensor, "B H W D K"]:
        """What an empty grid holds after the ReLU."""
        x, y = (_kind(torch.arange(n, device=self.empty.device), n) for n in (plane.nx, plane.ny))
        small = torch.relu(self.empty).permute(1, 2, 0, 3).contiguous()
        return small[x[:, None], y].expand(plane.items, -1, -1, -1, -1).contiguous()


def numbers(mask: Bool[Tensor, "*shape"]) -> Int64[Tensor, "*shape"]:
    """For each cell that is set, how many are set before it."""
    return (torch.cumsum(mask.view(-1), 0) - 1).view(mask.shape)


def grown(mask: Bool[Tensor, "D P"], plane: Plane) -> Bool[Tensor, "D P"]:
    """The cells with a set cell among their 3x3 neighbours."""
    maps = mask.view(-1, plane.nx + 2, plane.ny + 2)
    wide = torch.zeros_like(maps)
    rows = maps[:, :-2] | maps[:, 1:-1] | maps[:, 2:]
    wide[:, 1:-1, 1:-1] = rows[..., :-2] | rows[..., 1:-1] | rows[..., 2:]
    return wide.view(mask.shape)


def _summed(
    rows: Float32[Tensor, "n C"],
    weight: Float32[Tensor, "C K9"],
    mask: Bool[Tensor, " P"],
    around: Int32[Tensor, "m 9"],
) -> Float32[Tensor, "m K"]:
    """For each output cell, the sum over its neighbours that are set of row times weight of that neighbour."""
    products = rows.new_empty(len(rows) + 1, weight.shape[1])
    torch.mm(rows, weight, out=products[:-1])
    products[-1] = 0
    taps = torch.arange(9, dtype=torch.int32, device=rows.device)
    first = torch.where(mask, 9 * numbers(mask), 9 * len(rows)).int()
    chosen = first[around.view(-1)].view(-1, 9) + taps
    return F.embedding_bag(chosen, products.view(9 * len(products), -1), mode="sum")


def _kind(index: Tensor, n: int) -> Tensor:
    """Where a cell finds itself in the small empty grid: at a border as far from it, in the middle otherwise."""
    return torch.where(index < n - BORDER, index.clamp(max=BORDER), index - n + SMALL)
