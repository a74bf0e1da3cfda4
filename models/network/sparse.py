"""Sparse inference: the same maps in less time.

Points are in a few percent of the voxels, and an empty grid's response is a constant of the
weights. So voxel features exist only for occupied voxels, 3D convolutions run on reached cells
(`SparseMiddle`), and the light network's first convolution on occupied columns (`SparseColumns`).
BatchNorm and the linear layers before the published head are folded.
"""

import copy
from collections.abc import Sequence
from itertools import product
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.network import voxelnet
from models.network.grid import Groups, Voxels
from models.network.voxelnet import (
    AnchorOutputs,
    AnchorPlaces,
    Head,
    HeightFold,
    MiddleLayers,
    Prediction,
    RegionProposal,
    VoxelFeatures,
    VoxelNet,
)
from toolkit.arrays import Bool, Float, Float32, Int64

BIAS_CHANNELS = 8  # that carry the biases; a multiple of the convolution kernels' width
ROW_STEP = 64  # rows to which a product in bfloat16 is filled up
BORDER_CELLS = 2  # in which an empty grid's response varies, after three convolutions
SMALL_GRID_CELLS = 2 * BORDER_CELLS + 1  # side of the small empty grid
# for an even, then an odd index along one axis: the kernel taps that meet it, each with the
# offset of the output cell from half the index
_TAPS = (((1, 0),), ((0, 1), (2, 0)))
_PARITIES = ((0, 0), (0, 1), (1, 0), (1, 1))  # parities of a column's indices along x and y


class SparseVoxelNet(nn.Module):
    """Trained network for inference, with a folded copy of its weights: train the original."""

    def __init__(self, network: VoxelNet) -> None:
        """Fold a trained network: normalisations go into the weights of their layers."""
        super().__init__()
        self.config = network.config
        self.features: nn.Module
        if len(network.features.layers) == 1 and self.config.point_features == "local":
            self.features = LinearFeatures(network.features)
        else:
            self.features = _fold_features(network.features)
        self.middle: nn.Module
        if isinstance(network.middle, HeightFold):
            self.rpn = FoldedRegionProposal(network.rpn, network.head)
            self.middle = SparseColumns(network.middle, self.rpn.blocks[0][0])
            self.rpn.blocks[0][0] = nn.Identity()  # `SparseColumns` computes it
        else:
            self.middle = SparseMiddle(network.middle)
            self.rpn = FoldedRegionProposal(network.rpn, network.head, self.middle.channel_order)
        self.eval().requires_grad_(False)

    @torch.inference_mode()
    def forward(self, voxels: Voxels) -> Prediction:
        """Same maps as `network.eval()(voxels)`."""
        return self.classify(voxels).everywhere()

    @torch.inference_mode()
    def classify(self, voxels: Voxels) -> "ClassifiedCells":
        """Class maps of `forward`; the other maps are computed where they are needed."""
        return self.rpn(self.middle(self.features(voxels), voxels))


class LinearFeatures(nn.Module):
    """`VoxelFeatures` of one layer and local points, folded.

    A point's features are its offset from the voxel's reference and from the mean of the voxel's
    points. The layer is linear before its ReLU, so all that is equal for the points of a voxel is
    added after their maximum, to one row for each voxel. Offsets are counted from the middle of the
    voxel, so that rounding errors stay small.
    """

    def __init__(self, features: VoxelFeatures) -> None:
        """Fold layer and normalisation into a part of each point and a part of each voxel."""
        super().__init__()
        self.config = features.config
        layers: Any = features.layers
        weight, bias = fold_norm(layers[0].linear, layers[0].norm)
        from_reference, from_mean = torch.split(weight.T, 3)  # inputs x y z, outputs
        self.point_weight = nn.Parameter((from_reference + from_mean).contiguous())
        # inputs: mean offset x y z, height of the voxel's middle
        self.voxel_weight = nn.Parameter(torch.cat((-from_mean, from_reference[2:])))
        self.bias = nn.Parameter(bias)

    def forward(self, voxels: Voxels) -> Float[Tensor, "voxels C"]:
        """Features of the occupied voxels, one row for each.

        The part of a linear layer that all points of a voxel share is added after the maximum over
        them, which gives the same."""
        count = len(voxels.cells)
        middles = voxelnet.voxel_references(voxels.cells, self.config)
        heights = (voxels.cells[:, 3:] + 0.5) * self.config.voxel_size[2]  # above the reference
        middles[:, 2:] += heights
        offsets = voxels.points - middles.index_select(0, voxels.voxel)
        means = voxelnet.voxel_means(offsets, voxels.voxel, count)
        point_values = offsets @ self.point_weight
        rows = voxels.voxel[:, None].expand_as(point_values)
        lowest = point_values.new_full((count, point_values.shape[1]), -torch.inf)
        greatest = lowest.scatter_reduce_(0, rows, point_values, "amax")
        voxel_inputs = torch.cat((means, heights.to(means.dtype)), 1)
        voxel_values = torch.addmm(self.bias, voxel_inputs, self.voxel_weight)
        return torch.relu_(voxel_values.add_(greatest))


def _fold_features(features: VoxelFeatures) -> VoxelFeatures:
    """Copy of voxel features with the BatchNorm of each layer folded."""
    folded = copy.deepcopy(features)
    layers: Any = features.layers
    folded.layers = nn.ModuleList()
    for layer in layers:
        linear = nn.Linear(layer.linear.in_features, layer.linear.out_features)
        linear.weight.data, linear.bias.data = fold_norm(layer.linear, layer.norm)
        folded.layers.append(nn.Sequential(linear, nn.ReLU(inplace=True)))
    return folded


def scale_and_shift(norm: nn.Module) -> tuple[Tensor, Tensor]:
    """Scale and shift (C,) of a trained BatchNorm, which computes x · scale + shift."""
    assert isinstance(norm, nn.BatchNorm1d | nn.BatchNorm2d | nn.BatchNorm3d)
    assert norm.running_mean is not None
    assert norm.running_var is not None
    scale = norm.weight.detach() / torch.sqrt(norm.running_var + norm.eps)
    return scale, norm.bias.detach() - norm.running_mean * scale


def fold_norm(layer: nn.Linear | nn.Conv2d | nn.Conv3d, norm: nn.Module) -> tuple[Tensor, Tensor]:
    """Weight and bias of one layer equal to a layer and the BatchNorm after it."""
    scale, shift = scale_and_shift(norm)
    bias = shift if layer.bias is None else layer.bias.detach() * scale + shift
    output_scale = scale.view(-1, *(1,) * (layer.weight.ndim - 1))
    return layer.weight.detach() * output_scale, bias


def _fold_layer(layer: Any) -> nn.Conv2d | nn.ConvTranspose2d:
    """3x3 convolution equal to a convolution and BatchNorm (the first two of `layer`)."""
    conv, norm = layer[:2]
    weight, bias = fold_norm(conv, norm)
    return make_conv(weight, bias, conv.stride[0], padding=1)


class FoldedRegionProposal(nn.Module):
    """`RegionProposal` and `Head`, folded; channels last in memory.

    input_order: for each channel of the input, its number in the input of `rpn`.
    """

    def __init__(self, rpn: RegionProposal, head: Head, input_order: Tensor | None = None) -> None:
        """Fold the normalisation of the blocks into their convolutions, and take over the head.

        rpn: region proposal network; input_order: order of the first block's input channels, None
        for the order in training."""
        super().__init__()
        self.order = rpn.order  # for each block the indices of its layers as they run
        rpn_blocks: Any = rpn.blocks
        blocks = [list(map(_fold_layer, block)) for block in rpn_blocks]
        if input_order is not None:
            # axes: output channel, input channel, row, column
            blocks[0][0].weight.data = blocks[0][0].weight.data[:, input_order]
        self.blocks: Any = nn.ModuleList(nn.ModuleList(block) for block in blocks)
        # all from the blocks' maps to the 3x3 convolution of the head is linear and can be folded,
        # if the maps are concatenated; maps that are added, or a head without it, are joined as in
        # training
        self.join: PlainJoin | LinearHead
        if rpn.add or head.conv3x3 is None:
            self.join = PlainJoin(rpn, head)
        else:
            self.join = LinearHead(rpn, head)
        self.classes = make_conv(head.classes.weight, _bias(head.classes))
        # one convolution for the other maps of the head, in the order of fields of `Prediction`
        detail_layers = [
            layer for layer in (head.residuals, head.direction, head.quality) if layer is not None
        ]
        self.detail_channels = [layer.out_channels for layer in detail_layers]
        biases = torch.cat([_bias(layer) for layer in detail_layers])
        self.details = make_conv(torch.cat([layer.weight for layer in detail_layers]), biases)
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, x: Float[Tensor, "B C H W"]) -> "ClassifiedCells":
        """Class maps of the head, and what its other maps are computed from.

        A block's layers run in its `order` of indices, in which one may come twice."""
        block_maps = []
        x = x.to(self.classes.weight.dtype)
        for block, order in zip(self.blocks, self.order, strict=True):
            for layer in order:
                x = torch.relu_(block[layer](x))
            block_maps.append(x)
        return self.classify(self.join(block_maps))

    def classify(self, features: Float[Tensor, "B outputs H W"]) -> "ClassifiedCells":
        """Class maps of the head from the feature map of the joined blocks."""
        class_logits = cell_by_cell(self.classes, features).float()
        return ClassifiedCells(class_logits, features, self.details, channels=self.detail_channels)


class ClassifiedCells(NamedTuple):
    """Class maps of the head. Its other maps are computed where they are needed.

    Few anchors are candidates, and the other maps have ten times as many channels.

    Attributes:
        class_logits: As in `Prediction`.
        features: Feature map for the head, channels last in memory.
        details: 1x1 convolution from features to the other maps, joined.
        channels: Channels of each such map, in the order of the fields of `Prediction`.
    """

    class_logits: Float[Tensor, "B AC H W"]
    features: Float[Tensor, "B outputs H W"]
    details: nn.Module
    channels: list[int]

    def at(self, places: AnchorPlaces, anchors: int) -> AnchorOutputs:
        """Outputs of some anchors, one row for each place.

        places: item, row, column and anchor of each; anchors: number of anchors in a cell."""
        items, _, rows, columns = self.features.shape
        # over the batch
        cell = (places.item * rows + places.row) * columns + places.column
        # cells with a place, each once, and the index in them of each place's cell
        groups = Groups.from_numbers(cell)
        cells = groups.number
        cell_of_place = groups.of_rows()
        cell_features = self.features.permute(0, 2, 3, 1).reshape(items * rows * columns, -1)[cells]
        weight: Any = self.details.weight
        bias: Any = self.details.bias
        outputs = _multiply_rows(cell_features, weight[:, :, 0, 0], bias).float()
        maps = []  # (places, channels) for each field of `AnchorOutputs`
        for cell_values in torch.split(outputs, self.channels, 1):
            channels = cell_values.shape[1] // anchors
            by_anchor = cell_values.view(len(cells), anchors, channels)
            maps.append(by_anchor[cell_of_place, places.anchor])
        residuals, *others = maps  # the others have one channel
        return AnchorOutputs(residuals, *(values[:, 0] for values in others))

    def everywhere(self) -> Prediction:
        """All maps of the head."""
        details = cell_by_cell(self.details, self.features).float()
        return Prediction(self.class_logits, *torch.split(details, self.channels, 1))


def _multiply_rows(
    x: Float[Tensor, "n inputs"],
    weight: Float[Tensor, "outputs inputs"],
    bias: Float[Tensor, " outputs"],
) -> Float[Tensor, "n outputs"]:
    """Linear layer over rows, whose number differs from cloud to cloud.

    In bfloat16 torch keeps a compiled product for each number of rows, some 200 kB each, so rows of
    zeros are added up to the next multiple of `ROW_STEP`."""
    missing = -len(x) % ROW_STEP if x.dtype == torch.bfloat16 else 0
    return F.linear(F.pad(x, (0, 0, 0, missing)), weight, bias)[: len(x)]


class PlainJoin(nn.Module):
    """Join of the three blocks' maps, as in training."""

    def __init__(self, rpn: RegionProposal, head: Head) -> None:
        """Fold the normalisation into the transposed convolutions, if there is one."""
        super().__init__()
        self.add = rpn.add
        self.upsample = rpn.upsample
        self.conv3x3 = head.conv3x3
        if rpn.add:
            scale, shift = scale_and_shift(rpn.norm)
            layers: Any = rpn.upsample
            # the finest map first; the maps are added, so only one carries the shift
            biases = (shift, None, None)
            self.upsample = nn.ModuleList(
                make_conv(
                    layer.weight * scale[:, None, None],
                    bias,
                    stride=layer.stride[0],
                    padding=layer.padding[0],
                    transposed=True,
                )
                for layer, bias in zip(layers, biases, strict=True)
            )

    def forward(self, maps: Sequence[Tensor]) -> Float[Tensor, "B outputs H W"]:
        """Feature map for the head. maps: one of each block, the finest first."""
        layers: Any = self.upsample
        # maps that are added have a 1x1 layer for the finest one
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
        """Compose the coarse maps' transposed convolutions with the 3x3 one."""
        super().__init__()
        assert head.conv3x3 is not None
        layers: Any = rpn.upsample
        self.fine, middle, coarse = layers
        # weights of the 3x3 convolution for each map, in the order of their concatenation
        coarse_weight, middle_weight, fine_weight = head.conv3x3.weight.chunk(3, 1)
        self.conv3x3 = make_conv(fine_weight, _bias(head.conv3x3), padding=1)
        self.middle = make_conv(
            _compose(middle.weight, middle_weight), bias=None, stride=2, padding=1, transposed=True
        )
        # what the biases of both maps add through the 3x3 convolution
        # axes: output channel, input channel, row, column
        biases = torch.cat((coarse.bias, middle.bias))
        bias_weight = torch.cat((coarse_weight, middle_weight), 1) * biases[:, None, None]
        # a bias is the same in all 4 x 4 cells of a coarse one: a transposed kernel of ones
        bias_kernel = _compose(bias_weight.new_ones(1, 1, 4, 4), bias_weight.sum(1, keepdim=True))
        # the first channel of ones carries the biases, the others only fill up the width
        weight = torch.cat(
            (
                _compose(coarse.weight, coarse_weight),
                bias_kernel,
                bias_kernel.new_zeros(BIAS_CHANNELS - 1, *bias_kernel.shape[1:]),
            )
        )
        self.coarse = make_conv(weight, bias=None, stride=4, padding=1, transposed=True)

    def forward(self, maps: Sequence[Tensor]) -> Float[Tensor, "B outputs H W"]:
        """Feature map for the head. maps: one of each block, the finest first."""
        fine, middle, coarse = maps
        ones = coarse.new_ones(len(coarse), BIAS_CHANNELS, *coarse.shape[2:])
        coarse = torch.cat((coarse, ones), 1)
        x: Tensor = self.conv3x3(self.fine(fine))
        return x.add_(self.middle(middle)).add_(self.coarse(coarse)).relu_()


def cell_by_cell(conv: nn.Module, x: Float[Tensor, "B C H W"]) -> Float[Tensor, "B outputs H W"]:
    """Output of a 1x1 convolution, computed by the convolution library.

    On one CPU thread torch would choose a plain matrix product, which takes about twice as long.
    Compilers and exporters do not know the library's convolution, and it refuses bfloat16 on
    processors without AVX-512.
    """
    needs_torch = torch.compiler.is_compiling() or not torch.backends.mkldnn.is_available()  # type: ignore[no-untyped-call]
    needs_torch = needs_torch or (
        x.dtype == torch.bfloat16 and not torch.ops.mkldnn._is_mkldnn_bf16_supported()
    )
    if needs_torch or x.device.type != "cpu":
        return conv(x)  # type: ignore[no-any-return,unused-ignore]
    return torch.mkldnn_convolution(
        x,
        conv.weight,  # type: ignore[arg-type]
        conv.bias,  # type: ignore[arg-type]
        padding=(0, 0),
        stride=(1, 1),
        dilation=(1, 1),
        groups=1,
    )


def _bias(layer: nn.Conv2d) -> Tensor:
    """Bias of a convolution that has one."""
    assert layer.bias is not None
    return layer.bias


def _compose(transposed: Tensor, conv3x3: Tensor) -> Tensor:
    """Kernel (I, O, k + 2, k + 2) equal to a transposed convolution and the 3x3 one after it.

    transposed, conv3x3: their kernels, (I, M, k, k) and (O, M, 3, 3), with I inputs, M maps between
    them and O outputs.
    """
    return F.conv_transpose2d(transposed, conv3x3.flip(2, 3).transpose(0, 1))


def make_conv(
    weight: Tensor,
    bias: Tensor | None,
    stride: int = 1,
    padding: int = 0,
    *,
    transposed: bool = False,
) -> nn.Conv2d | nn.ConvTranspose2d:
    """Convolution with a copy of some weights.

    weight: (outputs, inputs, k, k), or (inputs, outputs, k, k) for a transposed convolution; bias:
    (outputs), None without; padding: cells of 0 around the input. A transposed 1x1 convolution of
    stride 1 is returned as the equal one that is not transposed.
    """
    if transposed and weight.shape[2] == stride == 1:
        weight = weight.transpose(0, 1)
        transposed = False
    inputs, outputs = weight.shape[:2] if transposed else (weight.shape[1], weight.shape[0])
    conv_class = nn.ConvTranspose2d if transposed else nn.Conv2d
    conv = conv_class(inputs, outputs, weight.shape[2], stride, padding, bias=bias is not None)
    conv.weight.data = weight.detach().clone()
    if conv.bias is not None and bias is not None:
        conv.bias.data = bias.detach().clone()
    return conv


class SparseColumns(nn.Module):
    """Height fold, first convolution and ReLU on occupied columns.

    The convolution `first` (3x3, stride 2, padding 1) sends a column to one, two or four cells of
    its map, depending on whether its row and column are even or odd. Each of the nine taps serves
    the columns of one such kind. Cells that no column reaches hold the ReLU of the bias.

    Attributes:
        first: The convolution.
        dense: Same convolution for a whole map, in numbers in which that takes less time; None to
            compute products of occupied columns only.
        dense_numbers: Type of the numbers of the map for `dense`.
    """

    def __init__(self, fold: HeightFold, first: nn.Conv2d) -> None:
        """Fold the normalisation, and sort the taps of the first convolution by parity."""
        super().__init__()
        self.first = first
        self.dense: nn.Module | None = None
        self.dense_numbers = torch.float32
        scale, shift = scale_and_shift(fold.norm)
        self.shape = fold.shape
        self.levels = nn.Parameter(fold.weight.detach() * scale)  # level, input, output
        self.shift = nn.Parameter(shift)
        taps = first.weight.detach().permute(2, 3, 1, 0)  # along x, along y, input, output
        # by parity of the column's indices: the taps that it meets, concatenated as outputs
        self.kernels = nn.ParameterList()
        for parity in _PARITIES:
            # kx, ky: indices of a tap in the kernel
            kernels = [taps[kx, ky] for kx, ky, _, _ in _meet_taps(*parity)]
            self.kernels.append(nn.Parameter(torch.cat(kernels, 1)))
        self.bias = nn.Parameter(_bias(first).detach().clone())

    def forward(
        self,
        features: Float32[Tensor, "voxels C"],
        voxels: Voxels,
        shape: tuple[int, int, int] | None = None,
    ) -> Float[Tensor, "B outputs h w"]:
        """Map after the ReLU, channels last in memory.

        features: a row for each occupied voxel. shape: voxels of the grid along x, y and z, if they
        are not the network's.
        """
        shape = shape or self.shape
        nx, ny = shape[:2]
        column, cell = voxelnet.columns(voxels, shape)  # `cell` of the map before the convolution
        column_values = voxelnet.fold_columns(
            features,
            level=voxels.cells[:, 3],
            column=column,
            weight=self.levels,
            start=self.shift.expand(len(cell), -1),
        )
        column_values = torch.relu_(column_values)
        if self.dense is not None:
            column_values = column_values.to(self.dense_numbers)
            columns_map = column_values.new_zeros(voxels.items * nx * ny, column_values.shape[1])
            columns_map.index_copy_(0, cell, column_values)
            columns_map = columns_map.view(voxels.items, nx, ny, -1).permute(0, 3, 1, 2)
            return torch.relu_(self.dense(columns_map))
        # cells of the map after the convolution, with a margin in which outputs beyond it end
        height = nx // 2
        width = ny // 2
        row_number = cell // ny  # item · nx + ix
        item = row_number // nx
        ix = row_number - item * nx
        iy = cell - row_number * ny
        first_cell = (item * (height + 1) + ix // 2) * (width + 1) + iy // 2
        parity_of_column = ix % 2 * 2 + iy % 2
        channels = len(self.bias)
        # each column's products with all taps that it meets, and the output cell of each product
        products = []
        product_cells = []
        for number, (parity, kernel) in enumerate(zip(_PARITIES, self.kernels, strict=True)):
            rows = torch.nonzero(parity_of_column == number)[:, 0]
            steps = [dx * (width + 1) + dy for _, _, dx, dy in _meet_taps(*parity)]
            products.append((column_values.index_select(0, rows) @ kernel).view(-1, channels))
            cells = first_cell.index_select(0, rows)[:, None] + first_cell.new_tensor(steps)
            product_cells.append(cells.view(-1))
        groups = Groups.from_numbers(torch.cat(product_cells))
        sums = F.embedding_bag(groups.order, torch.cat(products), groups.begin, mode="sum")
        row_number = groups.number // (width + 1)
        item = row_number // (height + 1)
        row = row_number - item * (height + 1)
        column = groups.number - row_number * (width + 1)
        is_on_map = torch.nonzero((row < height) & (column < width))[:, 0]
        reached = ((item * height + row) * width + column).index_select(0, is_on_map)
        values = torch.relu_(sums.add_(self.bias)).index_select(0, is_on_map)
        out = torch.relu(self.bias).repeat(voxels.items * height * width, 1)
        out.index_copy_(0, reached, values)
        return out.view(voxels.items, height, width, -1).permute(0, 3, 1, 2)


def _meet_taps(odd_x: int, odd_y: int) -> list[tuple[int, int, int, int]]:
    """Taps of the first convolution that a column meets.

    odd_x, odd_y: 1 if the column's index along the axis is odd, 0 if even. Returns for each tap its
    indices in the kernel along x and y, and the offsets of its output cell from half the column's
    indices."""
    return [(kx, ky, dx, dy) for (kx, dx), (ky, dy) in product(_TAPS[odd_x], _TAPS[odd_y])]


class Plane(NamedTuple):
    """Numbers of the cells of several equal maps, joined in one plane.

    A margin of one cell around each map makes every neighbour a fixed step away; no cell beyond the
    border is reached.

    Attributes:
        items: Number of maps.
        nx: Cells of a map along x, without the margin.
        ny: Cells of a map along y, without the margin.
    """

    items: int
    nx: int
    ny: int

    @property
    def size(self) -> int:
        """Cells of the plane, margins included."""
        return self.items * (self.nx + 2) * (self.ny + 2)

    def place(self, item: Tensor, ix: Tensor, iy: Tensor) -> Tensor:
        """Numbers in the plane of cells (ix, iy) of the map `item`."""
        return (item * (self.nx + 2) + ix + 1) * (self.ny + 2) + iy + 1

    def cell(self, number: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Batch item, ix and iy of cells by their numbers in the plane; the inverse of `place`."""
        row = number // (self.ny + 2)
        return row // (self.nx + 2), row % (self.nx + 2) - 1, number % (self.ny + 2) - 1


class Reached(NamedTuple):
    """Cells reached by points, ordered by level and place in the plane.

    Attributes:
        mask: True for the n cells reached, by level and place.
        differences: Their values minus the values of an empty grid.
    """

    mask: Bool[Tensor, "levels positions"]
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
        """Fold each layer, with its response to a grid without points before the ReLU."""
        super().__init__()
        self.shape = middle.shape
        layers: Any = middle.layers
        first = layers[0][0]
        # input of the next layer for a small grid without points; axes: item, channel, z, x, y
        empty = first.weight.new_zeros(
            1, first.in_channels, self.shape[2], SMALL_GRID_CELLS, SMALL_GRID_CELLS
        )
        self.layers: Any = nn.ModuleList()
        for conv, norm, _ in layers:
            weight, bias = fold_norm(conv, norm)
            empty = F.conv3d(empty, weight, bias, conv.stride, conv.padding)
            self.layers.append(
                SparseConvolution(
                    weight, empty=empty[0], stride=conv.stride[0], padding=conv.padding[0]
                )
            )
            empty = torch.relu(empty)
        # outputs go level by level: index of each among channels that go channel by channel
        width, levels = empty.shape[1:3]
        self.channel_order = torch.arange(width * levels).view(width, levels).T.reshape(-1)

    def forward(
        self, features: Float32[Tensor, "voxels C"], voxels: Voxels
    ) -> Float[Tensor, "B outputs H W"]:
        """Map seen from above, its channels in the order of `channel_order`.

        features: a row for each occupied voxel.
        """
        nx, ny, nz = self.shape
        plane = Plane(items=voxels.items, nx=nx, ny=ny)
        item, ix, iy, iz = voxels.cells.unbind(1)
        position = plane.place(item, ix, iy)
        mask = torch.zeros(nz, plane.size, dtype=torch.bool, device=features.device)
        mask[iz, position] = True
        # row of each voxel if they are sorted by level, then position
        rows = count_before(mask)[iz, position]
        # an empty grid's values are zero before the first layer
        differences = torch.empty_like(features).index_copy_(0, rows, features)
        reached = Reached(mask, differences)
        for layer in self.layers:
            reached, values = layer(reached, plane)
        level, position = torch.nonzero(reached.mask, as_tuple=True)
        # values of an empty grid, replaced in the cells that a point has reached
        grid = self.layers[-1].everywhere(plane)
        grid[(*plane.cell(position), level)] = values
        return grid.flatten(3).permute(0, 3, 1, 2)


class SparseConvolution(nn.Module):
    """3x3x3 convolution and its ReLU on reached cells.

    weight: with its BatchNorm folded in. empty: response to the small empty grid before the ReLU,
    side = `SMALL_GRID_CELLS`. stride, padding: along z.
    """

    weight: Tensor  # level, input, 9 · output
    empty: Tensor  # level, x, y, output

    def __init__(
        self,
        weight: Tensor,
        empty: Float32[Tensor, "C levels side side"],
        stride: int,
        padding: int,
    ) -> None:
        """Keep the weights in the order in which they are used.

        empty: output without points; stride, padding: along z."""
        super().__init__()
        # lowest input level of each output level, below 0 in the padding
        self.first = [level * stride - padding for level in range(empty.shape[1])]
        # from (output, input, z taps, x taps, y taps) to (z taps, input, x taps · y taps · output)
        self.register_buffer("weight", weight.permute(2, 1, 3, 4, 0).flatten(2).contiguous())
        self.register_buffer("empty", empty.permute(1, 2, 3, 0).contiguous())

    def forward(
        self, reached: Reached, plane: Plane
    ) -> tuple[Reached, Float32[Tensor, "m outputs"]]:
        """Cells reached after the ReLU, and their values.

        Each input row is multiplied by all nine taps of a level's kernel; each output adds up the
        products of its neighbours.
        """
        levels = len(reached.mask)
        level_masks = [reached.mask[max(z, 0) : z + 3].any(0) for z in self.first]
        mask = dilate(torch.stack(level_masks), plane)
        level, position = torch.nonzero(mask, as_tuple=True)
        _, ix, iy = plane.cell(position)
        empty = self.empty[level, _kind(ix, plane.nx), _kind(iy, plane.ny)]
        sums = empty.clone()
        step = torch.arange(-1, 2, dtype=torch.int32, device=position.device)
        # places of the 3x3 neighbours of each output cell, in the order of the taps
        neighbours = position.int()[:, None] + (step[:, None] * (plane.ny + 2) + step).view(-1)
        inputs = torch.split(reached.differences, reached.mask.sum(1).tolist())  # by level
        counts = mask.sum(1).tolist()
        level_sums = torch.split(sums, counts)  # views, filled in place
        level_neighbours = torch.split(neighbours, counts)
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
                # row of each cell's first tap among the products, seen as 9 · (count + 1) rows
                first_rows = torch.where(is_reached, 9 * count_before(is_reached), 9 * count)
                product_rows = first_rows.int()[level_neighbours[out_level]] + taps
                level_sums[out_level].add_(
                    F.embedding_bag(product_rows, products.view(9 * (count + 1), -1), mode="sum")
                )
        values = sums.relu_()
        return Reached(mask, values - empty.relu_()), values

    def everywhere(self, plane: Plane) -> Float32[Tensor, "B H W levels outputs"]:
        """Response of an empty grid after the ReLU."""
        small_x = _kind(torch.arange(plane.nx, device=self.empty.device), plane.nx)
        small_y = _kind(torch.arange(plane.ny, device=self.empty.device), plane.ny)
        small = torch.relu(self.empty).permute(1, 2, 0, 3).contiguous()
        return small[small_x[:, None], small_y].expand(plane.items, -1, -1, -1, -1).contiguous()


def count_before(mask: Bool[Tensor, "*shape"]) -> Int64[Tensor, "*shape"]:
    """Number of set cells before each set cell; meaningless for the others."""
    return (torch.cumsum(mask.view(-1), 0) - 1).view(mask.shape)


def dilate(
    mask: Bool[Tensor, "levels positions"], plane: Plane
) -> Bool[Tensor, "levels positions"]:
    """Mask of the cells that are set or have a set cell among their eight neighbours of a level.

    Margins of the plane stay unset.
    """
    maps = mask.view(-1, plane.nx + 2, plane.ny + 2)  # with the margin of one cell all around
    dilated_maps = torch.zeros_like(maps)
    along_x = maps[:, :-2] | maps[:, 1:-1] | maps[:, 2:]
    dilated_maps[:, 1:-1, 1:-1] = along_x[..., :-2] | along_x[..., 1:-1] | along_x[..., 2:]
    return dilated_maps.view(mask.shape)


def _kind(index: Tensor, cells: int) -> Tensor:
    """Index in the small empty grid that has the response of a cell of a large one.

    Near a border it is as far from that border, elsewhere it is the middle. cells: number in
    the large grid along the axis.
    """
    return torch.where(
        index < cells - BORDER_CELLS,
        index.clamp(max=BORDER_CELLS),
        index - cells + SMALL_GRID_CELLS,
    )
