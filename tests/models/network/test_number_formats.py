"""The library of the fastest numbers is chosen by timing, and only where it is much faster."""

import pytest
import torch

from models.config import VoxelNetConfig
from models.network import number_formats
from models.network.number_formats import (
    NUMBERS_VARIABLE,
    convert_to_bfloat16,
    find_bfloat16_library,
    time_layer,
)
from models.network.openvino_proposal import OpenVinoLayer, OpenVinoProposal
from models.network.sparse import SparseVoxelNet

CPU = torch.device("cpu")


@pytest.fixture
def processor(monkeypatch, environment):
    """A processor whose times and instructions are given: float32, torch and OpenVINO."""

    def describe(float32=2.0, by_torch=1.0, by_openvino=1.0, *, sets=("avx512_bf16",), has=True):
        seconds = {
            ("torch", torch.float32): float32,
            ("torch", torch.bfloat16): by_torch,
            ("openvino", torch.bfloat16): by_openvino,
        }
        monkeypatch.setattr(number_formats, "time_layer", lambda *key: seconds[key])
        monkeypatch.setattr(number_formats, "find_spec", lambda name: name if has else None)
        for name in ("avx512_bf16", "amx_tile"):
            monkeypatch.setattr(
                f"torch.cpu._is_{name}_supported", lambda name=name: name in sets, raising=False
            )
        number_formats._time_libraries.cache_clear()

    environment(**{NUMBERS_VARIABLE: "auto"})
    yield describe
    number_formats._time_libraries.cache_clear()


@pytest.mark.parametrize(
    ("times", "library"),
    [
        ((2.0, 1.3, 1.5), "torch"),
        ((2.0, 1.3, 1.0), "openvino"),
        ((2.0, 1.1, 0.5), "torch"),  # so quick that OpenVINO is not loaded
        ((2.0, 2.5, 1.0), "openvino"),
        ((2.0, 1.7, 1.9), None),  # so near may be chance
        ((2.0, 4.0, 4.0), None),
    ],
)
def test_the_fastest_library_is_taken_if_it_is_much_faster(processor, times, library):
    processor(*times)
    assert find_bfloat16_library(CPU) == library


def test_only_what_is_installed_counts(processor):
    processor(2.0, 2.5, 1.0, has=False)
    assert find_bfloat16_library(CPU) is None


def test_only_processors_with_the_instructions_count(processor):
    processor(sets=())
    assert find_bfloat16_library(CPU) is None
    processor(sets=("amx_tile",))
    assert find_bfloat16_library(CPU) == "torch"
    assert find_bfloat16_library(torch.device("cuda")) is None


def test_float32_can_be_demanded(processor, environment):
    processor()
    environment(**{NUMBERS_VARIABLE: "float32"})
    assert find_bfloat16_library(CPU) is None


def test_an_unknown_format_is_refused_by_its_name(processor, environment):
    environment(**{NUMBERS_VARIABLE: "int8"})
    with pytest.raises(ValueError, match="must be auto or float32, got 'int8'"):
        find_bfloat16_library(CPU)


@pytest.mark.parametrize("library", ["torch", "openvino"])
def test_a_layer_is_timed(library):
    if library == "openvino":
        pytest.importorskip("openvino")
    assert 0 < time_layer(library, torch.float32) < 1


def test_a_network_is_converted_for_either_library(trained):
    sparse = SparseVoxelNet(trained(VoxelNetConfig.light((-4, -4, 4, 4))))
    by_torch = convert_to_bfloat16(sparse, "torch")
    assert by_torch.rpn.classes.weight.dtype == torch.bfloat16
    assert by_torch.middle.dense.weight.dtype == by_torch.middle.dense_numbers == torch.bfloat16
    by_openvino = convert_to_bfloat16(sparse, "openvino")
    assert isinstance(by_openvino.rpn, OpenVinoProposal)
    assert isinstance(by_openvino.middle.dense, OpenVinoLayer)
    assert by_openvino.rpn.precision == by_openvino.middle.dense.precision == "bf16"
    assert sparse.rpn.classes.weight.dtype == sparse.middle.first.weight.dtype == torch.float32
    assert sparse.middle.dense is None
