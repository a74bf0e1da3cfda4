"""Folded proposal part and first convolution of a network, computed by OpenVINO.

OpenVINO multiplies in bfloat16 on processors with `avx512_bf16`, on which torch is slower in
bfloat16 than in float32. Every call copies its input into an array of OpenVINO's and copies the
results out of it: OpenVINO 2026.4 may otherwise write into an array of the caller.
"""

import threading
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from models.network.sparse import ClassifiedCells, FoldedRegionProposal, LinearHead, PlainJoin
from toolkit.arrays import Float, Float32

if TYPE_CHECKING:
    import openvino

NumberFormat = Literal["f32", "bf16"]  # names of OpenVINO
_Node = Any  # node of a graph of OpenVINO; (B, C, H, W)


class MapShape(NamedTuple):
    """Shape of the input map."""

    channels: int
    height: int
    width: int


class OpenVinoProposal(nn.Module):
    """`FoldedRegionProposal` with the same inputs and outputs.

    proposal: network part with its weights, which are copied. precision: format of the products.
    Raises ImportError without OpenVINO.
    """

    def __init__(self, proposal: FoldedRegionProposal, precision: NumberFormat = "bf16") -> None:
        super().__init__()
        self.proposal = proposal
        self.precision: NumberFormat = precision
        self._compiled = CompiledMaps(partial(_graph_proposal, proposal), precision)

    def forward(self, x: Float[Tensor, "B C H W"]) -> ClassifiedCells:
        """Class maps of the head, and what its other maps are computed from."""
        class_logits, features = self._compiled(x)
        return ClassifiedCells(
            class_logits=class_logits,
            features=features,
            details=self.proposal.details,
            channels=self.proposal.detail_channels,
        )

    def __deepcopy__(self, memo: object) -> "OpenVinoProposal":
        """Same weights, compiled again when needed."""
        return OpenVinoProposal(self.proposal, self.precision)


class OpenVinoLayer(nn.Module):
    """Convolution and ReLU.

    layer: the convolution, whose weights are copied. precision: format of the products. Raises
    ImportError without OpenVINO.
    """

    def __init__(self, layer: nn.Conv2d, precision: NumberFormat = "bf16") -> None:
        super().__init__()
        self.layer = layer
        self.precision: NumberFormat = precision
        self._compiled = CompiledMaps(partial(graph_layer, layer), precision)

    def forward(self, x: Float[Tensor, "B C H W"]) -> Float[Tensor, "B outputs h w"]:
        """Output after the ReLU."""
        (output,) = self._compiled(x)
        return output

    def __deepcopy__(self, memo: object) -> "OpenVinoLayer":
        """Same weights, compiled again when needed."""
        return OpenVinoLayer(self.layer, self.precision)


class CompiledMaps:
    """Graph compiled for each size of maps; it may be called from several threads.

    Attributes:
        requests: The compiled graphs by the shape of their input.
    """

    def __init__(
        self, build: Callable[[MapShape], "openvino.Model"], precision: NumberFormat
    ) -> None:
        """Begin without a compiled graph.

        build: makes the graph for a shape of the input; precision: format of the products."""
        self._build = build
        self._precision: NumberFormat = precision
        self._lock = threading.Lock()  # a request computes one map at a time
        self.requests: dict[MapShape, openvino.InferRequest] = {}

    def __call__(self, x: Float[Tensor, "B C H W"]) -> list[Float[Tensor, "B outputs h w"]]:
        """Output maps of the graph, channels last in memory."""
        shape = MapShape(*x.shape[1:])
        with self._lock:
            if shape not in self.requests:
                self.requests[shape] = compile_graph(self._build(shape), self._precision)
            request = self.requests[shape]
            item_maps = []
            for item in x.permute(0, 2, 3, 1).float().cpu().numpy():
                request.get_input_tensor().data[0] = item
                request.infer()
                item_maps.append([tensor.data[0].copy() for tensor in request.output_tensors])
        return [
            torch.from_numpy(np.stack(maps)).permute(0, 3, 1, 2)
            for maps in zip(*item_maps, strict=True)
        ]


def compile_graph(graph: "openvino.Model", precision: NumberFormat) -> "openvino.InferRequest":
    """Compile a graph for the processor, with as many threads as torch has.

    Arrays of the request have their channels last: (1, height, width, channels).
    """
    import openvino as ov
    from openvino.preprocess import PrePostProcessor

    outer = ov.Layout("NHWC")
    inner = ov.Layout("NCHW")
    layouts = PrePostProcessor(graph)
    layouts.input().tensor().set_layout(outer)
    layouts.input().model().set_layout(inner)
    for number in range(len(graph.outputs)):
        layouts.output(number).tensor().set_layout(outer)
        layouts.output(number).model().set_layout(inner)
    options = {
        "INFERENCE_PRECISION_HINT": precision,
        "INFERENCE_NUM_THREADS": torch.get_num_threads(),
        "NUM_STREAMS": 1,
        "PERFORMANCE_HINT": "LATENCY",
    }
    compiled = ov.Core().compile_model(layouts.build(), "CPU", options)
    return compiled.create_infer_request()


def graph_layer(layer: nn.Module, shape: MapShape) -> "openvino.Model":
    """Graph of one convolution and its ReLU."""
    import openvino as ov

    x = _input_node(shape)
    return ov.Model([_relu(_convolve(x, layer))], [x])


def _graph_proposal(proposal: FoldedRegionProposal, shape: MapShape) -> "openvino.Model":
    """Graph of a region proposal network, with class logits and features as outputs."""
    import openvino as ov

    x = _input_node(shape)
    node = x
    # output of each block, the finest first
    block_maps = []
    for block, order in zip(proposal.blocks, proposal.order, strict=True):
        for number in order:
            # an identity replaces a layer that is computed before the graph
            if not isinstance(block[number], nn.Identity):
                node = _relu(_convolve(node, block[number]))
        block_maps.append(node)
    if isinstance(proposal.join, LinearHead):
        features = _join_linear(proposal.join, block_maps)
    else:
        features = _join_plain(proposal.join, block_maps)
    class_logits = _convolve(features, proposal.classes)
    return ov.Model([class_logits, features], [x])


def _join_plain(join: PlainJoin, block_maps: list[_Node]) -> _Node:
    """Graph of a plain join of the three blocks' maps into one map of features.

    It computes what `PlainJoin.forward` does. block_maps: the finest first."""
    from openvino import opset13 as ops

    layers: Any = join.upsample
    finest, *coarser = map(_convolve, block_maps, layers)
    if join.add:
        total = finest
        for block_map in coarser:
            total = ops.add(total, block_map)
        features = _relu(total)
    else:
        features = ops.concat([*reversed(coarser), finest], axis=1)
    return features if join.conv3x3 is None else _relu(_convolve(features, join.conv3x3))


def _join_linear(join: LinearHead, block_maps: list[_Node]) -> _Node:
    """Graph of a folded join of the three blocks' maps into one map of features.

    It computes what `LinearHead.forward` does. block_maps: the finest first."""
    from openvino import opset13 as ops

    finest, *coarser = block_maps
    features = _convolve(_convolve(finest, join.fine), join.conv3x3)
    features = ops.add(features, _convolve(coarser[0], join.middle))
    coarsest = coarser[1]
    ones_shape = [int(side) for side in coarsest.shape]
    ones_shape[1] = join.coarse.in_channels - ones_shape[1]  # channels of ones
    ones = np.ones(ones_shape, np.float32)
    coarsest_with_ones = ops.concat([coarsest, ops.constant(ones)], axis=1)
    return _relu(ops.add(features, _convolve(coarsest_with_ones, join.coarse)))


def _input_node(shape: MapShape) -> _Node:
    """Input of a graph for one map."""
    import openvino as ov
    from openvino import opset13 as ops

    return ops.parameter([1, *shape], ov.Type.f32)


def _convolve(x: _Node, layer: Any) -> _Node:
    """Output node of a convolution or a transposed one, without ReLU.

    x: node of the input; layer: convolution of PyTorch with its weights."""
    from openvino import opset13 as ops

    weight = ops.constant(_to_float32(layer.weight))
    strides = list(layer.stride)
    padding = list(layer.padding)
    if isinstance(layer, nn.ConvTranspose2d):
        convolved = ops.convolution_backprop_data(
            x, weight, strides, pads_begin=padding, pads_end=padding, dilations=[1, 1]
        )
    else:
        convolved = ops.convolution(
            x, weight, strides, pads_begin=padding, pads_end=padding, dilations=[1, 1]
        )
    if layer.bias is None:
        return convolved
    return ops.add(convolved, ops.constant(_to_float32(layer.bias)[:, None, None]))


def _relu(x: _Node) -> _Node:
    """ReLU of a map."""
    from openvino import opset13 as ops

    return ops.relu(x)


def _to_float32(tensor: Tensor) -> Float32[np.ndarray, "..."]:
    """Weights as an array of their own."""
    return np.ascontiguousarray(tensor.detach().float().cpu().numpy())
