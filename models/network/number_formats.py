"""Number formats of a network's proposal part, and the library that computes them fastest.

The proposal part takes most of a detection's time. In bfloat16 it takes about half of it on some
processors, by torch on some of them and by OpenVINO on others.
"""

import copy
import os
import time
from collections.abc import Callable
from functools import lru_cache, partial
from importlib.util import find_spec
from typing import Literal

import torch
from torch import nn

from models.network.openvino_proposal import (
    MapShape,
    NumberFormat,
    OpenVinoLayer,
    OpenVinoProposal,
    compile_graph,
    graph_layer,
)
from models.network.sparse import SparseColumns, SparseVoxelNet

NUMBERS_VARIABLE = "COVIEW_NUMBERS"  # environment; "float32" forbids every other format
MAX_TIME_SHARE = 0.8  # share of the time in float32; nearer ones may be so by chance
# share of torch with which OpenVINO is not timed: loading it takes 50 MB
SUFFICIENT_TIME_SHARE = 0.6
Library = Literal["torch", "openvino"]
_LAYER_SHAPE = MapShape(channels=48, height=64, width=96)  # like a map of the network


def convert_to_bfloat16(network: SparseVoxelNet, library: Library) -> SparseVoxelNet:
    """Copy of a network whose 2D convolutions are computed in bfloat16 by a library.

    In bfloat16 a first convolution of the whole map takes less time than the products of occupied
    columns."""
    converted = copy.deepcopy(network)
    columns = converted.middle
    if library == "openvino":
        converted.rpn = OpenVinoProposal(converted.rpn, "bf16")  # type: ignore[assignment]
        if isinstance(columns, SparseColumns):
            columns.dense = OpenVinoLayer(columns.first, "bf16")
    else:
        proposal = converted.rpn.to(torch.bfloat16)
        converted.rpn = proposal.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        if isinstance(columns, SparseColumns):
            first = copy.deepcopy(columns.first).to(torch.bfloat16)
            columns.dense = first.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
            columns.dense_numbers = torch.bfloat16
    return converted


def find_bfloat16_library(device: torch.device) -> Library | None:
    """Library that is much faster in bfloat16 than torch in float32; None if there is none.

    It is timed once for a device, since the instruction set of a processor does not show it. The
    environment variable `NUMBERS_VARIABLE` set to "float32" gives None. Raises ValueError for any
    other value of it but "auto".
    """
    requested = os.environ.get(NUMBERS_VARIABLE, "auto")
    if requested not in ("auto", "float32"):
        raise ValueError(f"{NUMBERS_VARIABLE} must be auto or float32, got {requested!r}")
    return None if requested == "float32" else _time_libraries(device)


@lru_cache
def _time_libraries(device: torch.device) -> Library | None:
    """Fastest library in bfloat16, None if none takes less than `MAX_TIME_SHARE` of float32's time.

    The answer is None too for a device that is not a CPU with instructions for bfloat16."""
    # a version of torch without such a check counts as a CPU without the instructions
    checks = [
        getattr(torch.cpu, f"_is_{name}_supported", lambda: False)
        for name in ("avx512_bf16", "amx_tile")
    ]
    if device.type != "cpu" or not any(is_supported() for is_supported in checks):
        return None
    shares: dict[Library, float] = {"torch": _time_share("torch")}
    if shares["torch"] > SUFFICIENT_TIME_SHARE and find_spec("openvino") is not None:
        shares["openvino"] = _time_share("openvino")
    fastest = min(shares, key=lambda library: shares[library])
    return fastest if shares[fastest] < MAX_TIME_SHARE else None


def _time_share(library: Library) -> float:
    """Time of a convolution in bfloat16 as a share of its time by torch in float32."""
    float32_times = []
    bfloat16_times = []
    for _ in range(5):  # in turns, so that other work on the machine delays both
        float32_times.append(time_layer("torch", torch.float32))
        bfloat16_times.append(time_layer(library, torch.bfloat16))
    # the least of several times is the one that other work delayed least
    return min(bfloat16_times) / min(float32_times)


@torch.inference_mode()
def time_layer(library: Library, dtype: torch.dtype) -> float:
    """Seconds that a convolution of the network's size takes in a library."""
    run = _prepare_layer(library, dtype)
    began = time.perf_counter()
    run()
    return time.perf_counter() - began


@lru_cache
def _prepare_layer(library: Library, dtype: torch.dtype) -> Callable[[], object]:
    """Function that computes a convolution of the network's size, and did so once.

    library: "torch" or "openvino", by which it is computed; dtype: type of its numbers."""
    channels = _LAYER_SHAPE.channels
    layer = nn.Conv2d(channels, channels, 3, padding=1)
    run: Callable[[], object]
    if library == "openvino":
        precision: NumberFormat = "bf16" if dtype == torch.bfloat16 else "f32"
        run = compile_graph(graph_layer(layer, _LAYER_SHAPE), precision).infer
    else:
        # channels last in memory, as in the network
        x = torch.ones(1, *_LAYER_SHAPE[1:], channels, dtype=dtype).movedim(3, 1)
        run = partial(layer.to(dtype), x)
    run()  # the first run prepares the convolution
    return run
