"""Sparse inference: the same maps in less time.

Points are in a few percent of the voxels, and an empty grid's response is a constant of the
weights. So voxel features exist only for occupied voxels, 3D convolutions run on reached cells
(`SparseMiddle`), and the light network's first convolution on occupied columns (`SparseColumns`).
BatchNorm and the linear layers before the published head are folded.
"""

import copy
import time
from collections.abc import Sequence
from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.network import voxelnet
from models.network.grid import Voxels
from models.network.voxelnet import (
    Head,
    HeightFold,
    MiddleLayers,
    Prediction,
    RegionProposal,
    VoxelNet,
)
from toolkit.arrays import Bool, Float, Float32, Int64

BIAS_CHANNELS = 8  # that carry the biases; a multiple of the convolution kernels' width
BORDER_CELLS = 2  # in which an empty grid's response varies, after three convolutions
SMALL_GRID_CELLS = 2 * BORDER_CELLS + 1  # side of the small empty grid
# kernel taps along one axis that see an even or odd place, and their offsets
_TAPS = (((1, 0),), ((0, 1), (2, 0)))


class SparseVoxelNet(nn.Module):
    """Trained network for inference, with a folded copy of its weights: train the original."""

    def __init__(self, network: VoxelNet) -> None:
        super().__init__()
        self.config = network.config
        self.features = copy.deepcopy(network.features)
        layers: Any = network.features.layers
        self.features.layers = nn.ModuleList()
        for layer in layers:
            linear = nn.Linear(layer.linear.in_features, layer.linear.out_features)
            linear.weight.data, linear.bias.data = fold_norm(layer.linear, layer.norm)
            self.features.layers.append(nn.Sequential(linear, nn.ReLU(inplace=True)))
        self.middle: nn.Module
        if isinstance(network.middle, HeightFold):
            self.rpn = FoldedRegionProposal(network.rpn, network.head)
            self.middle = SparseColumns(network.middle, self.rpn.blocks[0][0])
            self.rpn.blocks[0][0] = nn.Identity()
        else:
            self.middle = SparseMiddle(network.middle)
            self.rpn = FoldedRegionProposal(network.rpn, network.head, self.middle.channel_order)
        self.eval().requires_grad_(False)

    @torch.inference_mode()
    def forward(self, voxels: Voxels) -> Prediction:
        """Same maps as `network.eval()(voxels)`."""
        return self.rpn(self.middle(self.features(voxels), voxels))

    def halve(self) -> "SparseVoxelNet":
        """Copy whose proposal part, which takes most of the time, computes in bfloat16."""
        halved = copy.deepcopy(self)
        halved.rpn.to(torch.bfloat16).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        return halved


@lru_cache
def is_quick_at_bfloat16(device: torch.device) -> bool:
    """True if a processor is much faster in bfloat16.

    It is timed once, since its instruction set does not show it."""
    checks = [
        getattr(torch.cpu, f"_is_{name}_supported", lambda: False)
        for name in ("avx512_bf16", "amx_tile")
    ]
    if device.type != "cpu" or not any(is_supported() for is_supported in checks):
        return False
    exact = []
    coarse = []
    for _ in range(5):
        exact.append(time_layer(torch.float32))
        coarse.append(time_layer(torch.bfloat16))
    return min(coarse) < 0.8 * min(exact)


@torch.inference_mode()
def time_layer(dtype: torch.dtype) -> float:
    """Time a layer as the networks have it (s)."""
    layer = nn.Conv2d(48, 48, 3, padding=1).to(dtype)
    x = torch.ones(1, 64, 96, 48, dtype=dtype).movedim(3, 1)
    layer(x)  # channels last, as in the network
    began = time.perf_counter()
    layer(x)
    return time.perf_counter() - began


def scale_and_shift(norm: nn.Module) -> tuple[Tensor, Tensor]:
    """Scale and shift per channel of a trained BatchNorm."""
    assert isinstance(norm, nn.BatchNorm1d | nn.BatchNorm2d | nn.BatchNorm3d)
    assert norm.running_mean is not None
    assert norm.running_var is not None
    scale = norm.weight.detach() / torch.sqrt(norm.running_var + norm.eps)
    return scale, norm.bias.detach() - norm.running_mean * scale


def fold_norm(layer: nn.Linear | nn.Conv2d | nn.Conv3d, norm: nn.Module) -> tuple[Tensor, Tensor]:
    """Weight and bias of a layer and its BatchNorm."""
    scale, shift = scale_and_shift(norm)
    bias = shift if layer.bias is None else layer.bias.detach() * scale + shift
    scale_by_output = scale.view(-1, *(1,) * (layer.weight.ndim - 1))
    return layer.weight.detach() * scale_by_output, bias


def _fold_layer(layer: Any) -> nn.Conv2d | nn.ConvTranspose2d:
    weight, bias = fold_norm(layer[0], layer[1])
    return make_conv(weight, bias, layer[0].stride[0], 1)


class FoldedRegionProposal(nn.Module):
    """`RegionProposal` and `Head`, folded; channels last in memory.

    input_order: original position of each input.
    """

    def __init__(self, rpn: RegionProposal, head: Head, input_order: Tensor | None = None) -> None:
        super().__init__()
        self.order = rpn.order
        originals: Any = rpn.blocks
        blocks = [list(map(_fold_layer, block)) for block in originals]
        if input_order is not None:
            blocks[0][0].weight.data = blocks[0][0].weight.data[:, input_order]
        self.blocks: Any = nn.ModuleList(nn.ModuleList(block) for block in blocks)
        self.join: PlainJoin | LinearHead
        if rpn.add or head.conv3x3 is None:
            self.join = PlainJoin(rpn, head)
        else:
            self.join = LinearHead(rpn, head)
        maps = [
            layer
            for layer in (head.classes, head.residuals, head.direction, head.quality)
            if layer is not None
        ]
        self.channels = [layer.out_channels for layer in maps]
        biases = torch.cat([_bias(layer) for layer in maps])
        self.outputs = make_conv(torch.cat([layer.weight for layer in maps]), biases)
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, x: Float[Tensor, "B C H W"]) -> Prediction:
        """Raw maps."""
        maps = []
        x = x.to(self.outputs.weight.dtype)
        for block, order in zip(self.blocks, self.order, strict=True):
            for layer in order:
                x = torch.relu_(block[layer](x))
            maps.append(x)
        outputs = cell_by_cell(self.outputs, self.join(maps)).float()
        return Prediction(*torch.split(outputs, self.channels, 1))


class PlainJoin(nn.Module):
    """Join of the three blocks' maps, as in training."""

    def __init__(self, rpn: RegionProposal, head: Head) -> None:
        super().__init__()
        self.add = rpn.add
        self.upsample = rpn.upsample
        self.conv3x3 = head.conv3x3
        if rpn.add:
            scale, shift = scale_and_shift(rpn.norm)
            layers: Any = rpn.upsample
            self.upsample = nn.ModuleList()
            for layer, bias in zip(layers, (shift, None, None), strict=True):
                weight = layer.weight * scale[:, None, None]
                conv = make_conv(weight, bias, layer.stride[0], layer.padding[0], transposed=True)
                self.upsample.append(conv)

    def forward(self, maps: Sequence[Tensor]) -> Float[Tensor, "B K H W"]:
        """Feature map of the head."""
        layers: Any = self.upsample
        fine = cell_by_cell(layers[0], maps[0]) if self.add else layers[0](maps[0])
        middle = layers[1](maps[1])
        coarse = layers[2](maps[2])
        if self.add:
            x = fine.add_(middle).add_(coarse).relu_()
        else:
            x = torch.cat((coarse, middle, fine), 1)
        return x if self.conv3x3 is None else torch.relu_(self.conv3x3(x))


class LinearHead(nn.Module):
    """Join of the three maps by a 3x3 convolution, folded.

    Everything before that convolution is linear, so a transposed one (kernel and stride k) and the
    3x3 one are together one transposed convolution of kernel k + 2, stride k and padding 1, on a
    map with a quarter or a sixteenth of the cells. Their biases, which the 3x3 convolution misses
    beyond the border, enter through channels of ones.
    """

    def __init__(self, rpn: RegionProposal, head: Head) -> None:
        super().__init__()
        assert head.conv3x3 is not None
        layers: Any = rpn.upsample
        self.fine, middle, coarse = layers
        # in the order of their concatenation
        at_coarse, at_middle, at_fine = head.conv3x3.weight.chunk(3, 1)
        self.conv3x3 = make_conv(at_fine, _bias(head.conv3x3), padding=1)
        self.middle = make_conv(_compose(middle.weight, at_middle), None, 2, 1, transposed=True)
        joined_bias = torch.cat((coarse.bias, middle.bias))
        biases = torch.cat((at_coarse, at_middle), 1) * joined_bias[:, None, None]
        ones = _compose(biases.new_ones(1, 1, 4, 4), biases.sum(1, keepdim=True))
        weight = torch.cat(
            (
                _compose(coarse.weight, at_coarse),
                ones,
                ones.new_zeros(BIAS_CHANNELS - 1, *ones.shape[1:]),
            )
        )
        self.coarse = make_conv(weight, None, 4, 1, transposed=True)

    def forward(self, maps: Sequence[Tensor]) -> Float[Tensor, "B K H W"]:
        """Feature map of the head."""
        fine, middle, coarse = maps
        coarse = torch.cat(
            (coarse, coarse.new_ones(len(coarse), BIAS_CHANNELS, *coarse.shape[2:])), 1
        )
        x: Tensor = self.conv3x3(self.fine(fine))
        return x.add_(self.middle(middle)).add_(self.coarse(coarse)).relu_()


def cell_by_cell(conv: nn.Module, x: Float[Tensor, "B C H W"]) -> Float[Tensor, "B K H W"]:
    """Compute a 1x1 convolution by the convolution library.

    On one CPU thread torch would choose a plain matrix product, which takes about twice as long.
    Compilers and exporters do not know the library's convolution, and it refuses bfloat16 on
    processors without AVX-512.
    """
    needs_plain = torch.compiler.is_compiling() or not torch.backends.mkldnn.is_available()  # type: ignore[no-untyped-call]
    needs_plain = needs_plain or (
        x.dtype == torch.bfloat16 and not torch.ops.mkldnn._is_mkldnn_bf16_supported()
    )
    if needs_plain or x.device.type != "cpu":
        return conv(x)  # type: ignore[no-any-return,unused-ignore]
    return torch.mkldnn_convolution(x, conv.weight, conv.bias, (0, 0), (1, 1), (1, 1), 1)  # type: ignore[arg-type]


def _bias(layer: nn.Conv2d) -> Tensor:
    assert layer.bias is not None
    return layer.bias


def _compose(transposed: Tensor, conv3x3: Tensor) -> Tensor:
    """Kernel (I, O, k + 2, k + 2) of a transposed convolution (I, M, k, k) and a 3x3 one (O, M, 3,
    3)."""
    return F.conv_transpose2d(transposed, conv3x3.flip(2, 3).transpose(0, 1))


def make_conv(
    weight: Tensor,
    bias: Tensor | None,
    stride: int = 1,
    padding: int = 0,
    *,
    transposed: bool = False,
) -> nn.Conv2d | nn.ConvTranspose2d:
    """Convolution with a copy of these weights; a transposed 1x1 one is a plain one."""
    if transposed and weight.shape[2] == stride == 1:
        weight = weight.transpose(0, 1)
        transposed = False
    inputs, outputs = weight.shape[:2] if transposed else (weight.shape[1], weight.shape[0])
    kind = nn.ConvTranspose2d if transposed else nn.Conv2d
    conv = kind(inputs, outputs, weight.shape[2], stride, padding, bias=bias is not None)
    conv.weight.data = weight.detach().clone()
    if conv.bias is not None and bias is not None:
        conv.bias.data = bias.detach().clone()
    return conv


class SparseColumns(nn.Module):
    """Height fold, first convolution and ReLU on occupied columns.

    The convolution `first` (3x3, stride 2, padding 1) sends a column to one, two or four cells of
    its map, depending on whether its row and column are even or odd. Each of the nine taps serves
    the columns of one such kind and sends no two columns to the same cell. Cells without a column
    hold the bias.
    """

    def __init__(self, fold: HeightFold, first: nn.Conv2d) -> None:
        super().__init__()
        scale, shift = scale_and_shift(fold.norm)
        self.shape = fold.shape
        self.levels = nn.Parameter(fold.weight.detach() * scale)
        self.shift = nn.Parameter(shift)
        # 3, 3, inputs, outputs
        self.taps = nn.Parameter(first.weight.detach().permute(2, 3, 1, 0).contiguous())
        self.bias = nn.Parameter(_bias(first).detach().clone())

    def forward(
        self,
        features: Float32[Tensor, "v C"],
        voxels: Voxels,
        shape: tuple[int, int, int] | None = None,
    ) -> Float[Tensor, "B K h w"]:
        """Map after the ReLU, channels last in memory. shape: the grid's, if not the network's."""
        shape = shape or self.shape
        nx, ny = shape[:2]
        column, key = voxelnet.columns(voxels, shape)
        start = self.shift.expand(len(key), -1)
        x = torch.relu_(
            voxelnet.fold_columns(features, voxels.cells[:, 3], column, self.levels, start)
        )
        rows = nx // 2
        cells = ny // 2
        ix = key // ny % nx
        iy = key % ny
        target = ((key // (nx * ny)) * rows + ix // 2) * cells + iy // 2
        out = self.bias.expand(voxels.items * rows * cells, -1).clone()
        for odd_x, odd_y in product((0, 1), (0, 1)):
            column_rows = torch.nonzero((ix % 2 == odd_x) & (iy % 2 == odd_y))[:, 0]
            column_values = x[column_rows]
            target_cells = target[column_rows]
            row = ix[column_rows] // 2
            cell = iy[column_rows] // 2
            for (kx, dx), (ky, dy) in product(_TAPS[odd_x], _TAPS[odd_y]):
                values = column_values @ self.taps[kx, ky]
                cells_reached = target_cells + dx * cells + dy
                if dx or dy:
                    is_inside = (row + dx < rows) & (cell + dy < cells)
                    values = values[is_inside]
                    cells_reached = cells_reached[is_inside]
                out.index_add_(0, cells_reached, values)
        return F.relu_(out).view(voxels.items, rows, cells, -1).permute(0, 3, 1, 2)


class Plane(NamedTuple):
    """Cells of B maps (H x W cells) in one plane.

    A margin of one cell around each map makes every neighbour a fixed step away; no cell beyond the
    border is reached.
    """

    items: int
    nx: int
    ny: int

    @property
    def size(self) -> int:
        """Cells of the plane, margins included."""
        return self.items * (self.nx + 2) * (self.ny + 2)

    def place(self, item: Tensor, ix: Tensor, iy: Tensor) -> Tensor:
        """Number of a cell of a map in the plane."""
        return (item * (self.nx + 2) + ix + 1) * (self.ny + 2) + iy + 1

    def cell(self, number: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Batch item and indices (x, y) of a cell number."""
        row = number // (self.ny + 2)
        return row // (self.nx + 2), row % (self.nx + 2) - 1, number % (self.ny + 2) - 1


class Reached(NamedTuple):
    """Cells reached by points, ordered by level and place.

    differences: their values minus the values of an empty grid.
    """

    mask: Bool[Tensor, "D P"]
    differences: Float32[Tensor, "n C"]


class SparseMiddle(nn.Module):
    """Three 3D convolutions on reached cells.

    A convolution is linear: its output is the output for an empty grid plus the output for the
    difference between its input and an empty grid's. The difference is zero wherever no point
    reaches, so only rows of reached cells are kept and multiplied. An empty grid's response varies
    only at its borders, so a small empty grid describes it. Channels are last in memory,
    level by level (`channel_order`).
    """

    def __init__(self, middle: MiddleLayers) -> None:
        super().__init__()
        self.shape = middle.shape
        layers: Any = middle.layers
        first = layers[0][0]
        empty = first.weight.new_zeros(
            1, first.in_channels, self.shape[2], SMALL_GRID_CELLS, SMALL_GRID_CELLS
        )
        self.layers: Any = nn.ModuleList()
        for conv, norm, _ in layers:
            weight, bias = fold_norm(conv, norm)
            empty = F.conv3d(empty, weight, bias, conv.stride, conv.padding)
            self.layers.append(SparseConvolution(weight, empty[0], conv.stride[0], conv.padding[0]))
            empty = torch.relu(empty)
        width, levels = empty.shape[1:3]
        self.channel_order = torch.arange(width * levels).view(width, levels).T.reshape(-1)

    def forward(self, features: Float32[Tensor, "v C"], voxels: Voxels) -> Float[Tensor, "B K H W"]:
        """Map seen from above."""
        plane = Plane(voxels.items, *self.shape[:2])
        item, ix, iy, iz = voxels.cells.unbind(1)
        position = plane.place(item, ix, iy)
        mask = torch.zeros(self.shape[2], plane.size, dtype=torch.bool, device=features.device)
        mask[iz, position] = True
        order = count_before(mask)[iz, position]
        reached = Reached(mask, torch.empty_like(features).index_copy_(0, order, features))
        for layer in self.layers:
            reached, values = layer(reached, plane)
        level, position = torch.nonzero(reached.mask, as_tuple=True)
        values_everywhere = self.layers[-1].everywhere(plane)
        values_everywhere[(*plane.cell(position), level)] = values
        return values_everywhere.flatten(3).permute(0, 3, 1, 2)


class SparseConvolution(nn.Module):
    """3x3x3 convolution and its ReLU on reached cells."""

    weight: Tensor  # level, input, 9 · output
    empty: Tensor  # before the ReLU

    def __init__(
        self, weight: Tensor, empty: Float32[Tensor, "C D S S"], stride: int, padding: int
    ) -> None:
        super().__init__()
        # lowest input level of each output level
        self.first = [level * stride - padding for level in range(empty.shape[1])]
        self.register_buffer("weight", weight.permute(2, 1, 3, 4, 0).flatten(2).contiguous())
        self.register_buffer("empty", empty.permute(1, 2, 3, 0).contiguous())

    def forward(self, reached: Reached, plane: Plane) -> tuple[Reached, Float32[Tensor, "m K"]]:
        """Cells reached afterwards, and their values."""
        levels = len(reached.mask)
        level_masks = [reached.mask[max(z, 0) : z + 3].any(0) for z in self.first]
        mask = dilate(torch.stack(level_masks), plane)
        level, position = torch.nonzero(mask, as_tuple=True)
        _, ix, iy = plane.cell(position)
        empty = self.empty[level, _kind(ix, plane.nx), _kind(iy, plane.ny)]
        sums = empty.clone()
        step = torch.arange(-1, 2, dtype=torch.int32, device=position.device)
        offsets = (step[:, None] * (plane.ny + 2) + step).view(-1)
        neighbours = position.int()[:, None] + offsets
        inputs = torch.split(reached.differences, reached.mask.sum(1).tolist())
        rows = mask.sum(1).tolist()
        level_sums = torch.split(sums, rows)
        level_neighbours = torch.split(neighbours, rows)
        taps = torch.arange(9, dtype=torch.int32, device=sums.device)
        for out_level, z_first in enumerate(self.first):
            for z in range(max(z_first, 0), min(z_first + 3, levels)):
                count = len(inputs[z])
                if not count:
                    continue
                weight = self.weight[z - z_first]
                products = sums.new_empty(count + 1, weight.shape[1])
                torch.mm(inputs[z], weight, out=products[:-1])
                products[-1] = 0  # for cells that are not reached
                is_reached = reached.mask[z]
                first_rows = torch.where(is_reached, 9 * count_before(is_reached), 9 * count)
                product_rows = first_rows.int()[level_neighbours[out_level]] + taps
                level_sums[out_level].add_(
                    F.embedding_bag(product_rows, products.view(9 * (count + 1), -1), mode="sum")
                )
        values = sums.relu_()
        return Reached(mask, values - empty.relu_()), values

    def everywhere(self, plane: Plane) -> Float32[Tensor, "B H W D K"]:
        """Response of an empty grid after the ReLU."""
        x = _kind(torch.arange(plane.nx, device=self.empty.device), plane.nx)
        y = _kind(torch.arange(plane.ny, device=self.empty.device), plane.ny)
        small = torch.relu(self.empty).permute(1, 2, 0, 3).contiguous()
        response = small[x[:, None], y]
        return response.expand(plane.items, -1, -1, -1, -1).contiguous()


def count_before(mask: Bool[Tensor, "*shape"]) -> Int64[Tensor, "*shape"]:
    """Number of set cells before each cell."""
    return (torch.cumsum(mask.view(-1), 0) - 1).view(mask.shape)


def dilate(mask: Bool[Tensor, "D P"], plane: Plane) -> Bool[Tensor, "D P"]:
    """Cells with a set cell among their 3x3 neighbours."""
    maps = mask.view(-1, plane.nx + 2, plane.ny + 2)
    wide = torch.zeros_like(maps)
    rows = maps[:, :-2] | maps[:, 1:-1] | maps[:, 2:]
    wide[:, 1:-1, 1:-1] = rows[..., :-2] | rows[..., 1:-1] | rows[..., 2:]
    return wide.view(mask.shape)


def _kind(index: Tensor, n: int) -> Tensor:
    """Place in the small empty grid: a cell's distance from a border, or the middle."""
    return torch.where(
        index < n - BORDER_CELLS, index.clamp(max=BORDER_CELLS), index - n + SMALL_GRID_CELLS
    )
