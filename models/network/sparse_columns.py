"""`SparseColumns`: the light network's height fold and the first convolution after it, where there are columns at all.

A 3x3 convolution of stride 2 sends a column to one, two or four cells of its map, by whether its row and column are
even or odd; each of the nine taps serves the columns of one such kind and sends no two of them to the same cell. What
no column reaches is the bias.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.network.folding import scale_and_shift
from models.network.voxelnet import HeightFold, columns, folded_columns
from models.network.voxels import Voxels
from toolkit.arrays import Float32, Int64


class SparseColumns(nn.Module):
    """A trained `HeightFold`, the convolution `first` (3x3, stride 2, padding 1) after it, and its ReLU: inference."""

    def __init__(self, fold: HeightFold, first: nn.Conv2d) -> None:
        super().__init__()
        assert first.bias is not None
        scale, shift = scale_and_shift(fold.norm)
        self.shape = fold.shape
        self.levels = nn.Parameter(fold.weight.detach() * scale)
        self.shift = nn.Parameter(shift)
        self.taps = nn.Parameter(first.weight.detach().permute(2, 3, 1, 0).contiguous())  # 3, 3, inputs, outputs
        self.bias = nn.Parameter(first.bias.detach().clone())

    def forward(
        self, features: Float32[Tensor, "v C"], voxels: Voxels, shape: tuple[int, int, int] | None = None
    ) -> Float32[Tensor, "B K h w"]:
        """The map after the ReLU, channels last in memory. shape: of the grid, if not the network's own."""
        shape = shape or self.shape
        column, key = columns(voxels, shape)
        start = self.shift.expand(len(key), -1)
        x = torch.relu_(folded_columns(features, voxels.cells[:, 3], column, self.levels, start))
        return self._spread(x, key, voxels.items, shape[:2])

    def _spread(
        self, x: Float32[Tensor, "n I"], key: Int64[Tensor, " n"], items: int, shape: tuple[int, int]
    ) -> Float32[Tensor, "B K h w"]:
        """The convolution of columns at places `key` of the flat map."""
        nx, ny = shape
        rows, cells = nx // 2, ny // 2
        ix, iy = key // ny % nx, key % ny
        place = ((key // (nx * ny)) * rows + ix // 2) * cells + iy // 2
        out = self.bias.expand(items * rows * cells, -1).clone()
        for odd_x in (0, 1):
            for odd_y in (0, 1):
                some = torch.nonzero((ix % 2 == odd_x) & (iy % 2 == odd_y))[:, 0]
                columns_there, at, row, cell = x[some], place[some], ix[some] // 2, iy[some] // 2
                for kx, dx in _taps(odd_x):
                    for ky, dy in _taps(odd_y):
                        product, there = columns_there @ self.taps[kx, ky], at + dx * cells + dy
                        if dx or dy:
                            inside = (row + dx < rows) & (cell + dy < cells)
                            product, there = product[inside], there[inside]
                        out.index_add_(0, there, product)
        return F.relu_(out).view(items, rows, cells, -1).permute(0, 3, 1, 2)


def _taps(odd: int) -> tuple[tuple[int, int], ...]:
    """Along one axis, the kernel's taps that see an even or odd place, and how far from half its number they put it."""
    return ((0, 1), (2, 0)) if odd else ((1, 0),)
