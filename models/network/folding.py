"""BatchNorm folded into the layer before it, and linear layers that follow each other folded into one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.network.voxelnet import Head, PointLayer, Prediction, RegionProposal
from toolkit.arrays import Float32

ONES = 8  # channels that carry the biases; a multiple of what the convolution kernels take at once


def folded(layer: nn.Module, norm: nn.Module) -> tuple[Tensor, Tensor]:
    """Weight and bias of a layer and the trained BatchNorm after it, as one layer."""
    assert isinstance(layer, nn.Linear | nn.Conv2d | nn.Conv3d)
    scale, shift = scale_and_shift(norm)
    bias = shift if layer.bias is None else layer.bias.detach() * scale + shift
    return layer.weight.detach() * scale.view(-1, *(1,) * (layer.weight.ndim - 1)), bias


def scale_and_shift(norm: nn.Module) -> tuple[Tensor, Tensor]:
    """What a trained BatchNorm does to each channel: x · scale + shift."""
    assert isinstance(norm, nn.BatchNorm1d | nn.BatchNorm2d | nn.BatchNorm3d)
    assert norm.running_mean is not None
    assert norm.running_var is not None
    scale = norm.weight.detach() / torch.sqrt(norm.running_var + norm.eps)
    return scale, norm.bias.detach() - norm.running_mean * scale


def folded_points(layer: PointLayer) -> nn.Sequential:
    """A `PointLayer` without BatchNorm."""
    weight, bias = folded(layer.linear, layer.norm)
    linear = nn.Linear(weight.shape[1], weight.shape[0])
    linear.weight.data, linear.bias.data = weight, bias
    return nn.Sequential(linear, nn.ReLU(inplace=True))


class FoldedRegionProposal(nn.Module):
    """`RegionProposal` and `Head` of a trained network, for inference, in channels-last memory.

    input_order: where each input channel is among those of the original.
    """

    def __init__(self, rpn: RegionProposal, head: Head, input_order: Tensor | None = None) -> None:
        super().__init__()
        self.order = rpn.order
        originals: Any = rpn.blocks
        blocks = [[_folded_conv(*layer[:2]) for layer in block] for block in originals]
        if input_order is not None:
            blocks[0][0].weight.data = blocks[0][0].weight.data[:, input_order]
        self.blocks: Any = nn.ModuleList(nn.ModuleList(block) for block in blocks)
        linear = not rpn.add and head.conv3x3 is not None
        self.join = LinearHead(rpn, head) if linear else PlainJoin(rpn, head)
        maps = [layer for layer in (head.classes, head.residuals, head.direction, head.quality) if layer is not None]
        self.channels = [layer.out_channels for layer in maps]
        self.outputs = _conv(torch.cat([layer.weight for layer in maps]), torch.cat([_bias(layer) for layer in maps]))
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, x: Float32[Tensor, "B C H W"]) -> Prediction:
        """Raw maps."""
        maps = []
        for block, order in zip(self.blocks, self.order, strict=True):
            for layer in order:
                x = torch.relu_(block[layer](x))
            maps.append(x)
        return Prediction(*torch.split(cell_by_cell(self.outputs, self.join(maps)), self.channels, 1))


class PlainJoin(nn.Module):
    """The three blocks' maps joined as the network does it."""

    def __init__(self, rpn: RegionProposal, head: Head) -> None:
        super().__init__()
        self.add, self.upsample, self.conv3x3 = rpn.add, rpn.upsample, head.conv3x3
        if rpn.add:
            scale, shift = scale_and_shift(rpn.norm)
            layers: Any = rpn.upsample
            self.upsample = nn.ModuleList(
                _transposed(layer.weight * scale[:, None, None], bias, layer.stride[0], layer.padding[0])
                for layer, bias in zip(layers, (shift, None, None), strict=True)
            )

    def forward(self, maps: Sequence[Tensor]) -> Float32[Tensor, "B K H W"]:
        """The feature map of the head."""
        layers: Any = self.upsample
        first, *others = layers
        fine = cell_by_cell(first, maps[0]) if self.add else first(maps[0])
        middle, coarse = (layer(x) for layer, x in zip(others, maps[1:], strict=True))
        x = fine.add_(middle).add_(coarse).relu_() if self.add else torch.cat((coarse, middle, fine), 1)
        return x if self.conv3x3 is None else torch.relu_(self.conv3x3(x))


class LinearHead(nn.Module):
    """The three blocks' maps joined by a 3x3 convolution, which takes most of the published network's time.

    What comes before it is linear, so a transposed convolution (kernel and stride k) and the 3x3 convolution are
    together one transposed convolution of kernel k + 2, stride k and padding 1, on a map of a quarter or a sixteenth of
    the cells. Their biases, which the 3x3 convolution misses beyond the border, enter through channels of ones.
    """

    def __init__(self, rpn: RegionProposal, head: Head) -> None:
        super().__init__()
        assert head.conv3x3 is not None
        layers: Any = rpn.upsample
        self.fine, middle, coarse = layers
        at_coarse, at_middle, at_fine = head.conv3x3.weight.chunk(3, 1)  # in the order of their concatenation
        self.conv3x3 = _conv(at_fine, _bias(head.conv3x3), padding=1)
        self.middle = _transposed(_composed(middle.weight, at_middle), None, 2, 1)
        biases = torch.cat((at_coarse, at_middle), 1) * torch.cat((coarse.bias, middle.bias))[:, None, None]
        ones = _composed(biases.new_ones(1, 1, 4, 4), biases.sum(1, keepdim=True))
        weight = torch.cat((_composed(coarse.weight, at_coarse), ones, ones.new_zeros(ONES - 1, *ones.shape[1:])))
        self.coarse = _transposed(weight, None, 4, 1)

    def forward(self, maps: Sequence[Tensor]) -> Float32[Tensor, "B K H W"]:
        """The feature map of the head."""
        fine, middle, coarse = maps
        coarse = torch.cat((coarse, coarse.new_ones(len(coarse), ONES, *coarse.shape[2:])), 1)
        x: Tensor = self.conv3x3(self.fine(fine))
        return x.add_(self.middle(middle)).add_(self.coarse(coarse)).relu_()


def cell_by_cell(conv: nn.Conv2d, x: Float32[Tensor, "B C H W"]) -> Float32[Tensor, "B K H W"]:
    """A 1x1 convolution, for inference. One thread on a CPU gets it from torch as a plain product of matrices, in about
    twice the time that the convolution library takes, so that one is asked for by its name."""
    if x.device.type != "cpu" or not torch.backends.mkldnn.is_available():  # type: ignore[no-untyped-call]
        return conv(x)  # type: ignore[no-any-return,unused-ignore]
    return torch.mkldnn_convolution(x, conv.weight, conv.bias, (0, 0), (1, 1), (1, 1), 1)


def _folded_conv(conv: nn.Conv2d, norm: nn.BatchNorm2d) -> nn.Conv2d:
    return _conv(*folded(conv, norm), stride=conv.stride[0], padding=1)


def _bias(layer: nn.Conv2d) -> Tensor:
    assert layer.bias is not None
    return layer.bias


def _composed(transposed: Tensor, conv3x3: Tensor) -> Tensor:
    """The kernel (I, O, k + 2, k + 2) of a transposed convolution (I, M, k, k) and a 3x3 one (O, M, 3, 3) after it."""
    return F.conv_transpose2d(transposed, conv3x3.flip(2, 3).transpose(0, 1))


def _conv(weight: Tensor, bias: Tensor | None, *, stride: int = 1, padding: int = 0) -> nn.Conv2d:
    outputs, inputs, kernel, _ = weight.shape
    conv = nn.Conv2d(inputs, outputs, kernel, stride, padding, bias=bias is not None)
    _fill(conv, weight, bias)
    return conv


def _transposed(weight: Tensor, bias: Tensor | None, stride: int, padding: int) -> nn.Module:
    inputs, outputs, kernel, _ = weight.shape
    if kernel == stride == 1:
        return _conv(weight.transpose(0, 1), bias)
    conv = nn.ConvTranspose2d(inputs, outputs, kernel, stride, padding, bias=bias is not None)
    _fill(conv, weight, bias)
    return conv


def _fill(layer: nn.Conv2d | nn.ConvTranspose2d, weight: Tensor, bias: Tensor | None) -> None:
    layer.weight.data = weight.detach().clone()
    if layer.bias is not None and bias is not None:
        layer.bias.data = bias.detach().clone()
