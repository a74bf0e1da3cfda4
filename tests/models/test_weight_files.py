"""Weights files: the same bytes for the same network, whole or not there."""

import math

import pytest
import torch

from models.config import VoxelNetConfig
from models.network.voxelnet import VoxelNet
from models.weight_files import Header, load_weights, save_weights

AREA = (-8.0, -8.0, 8.0, 8.0)


def test_the_bytes_are_the_same_every_time(tmp_path):
    network, header = VoxelNet(VoxelNetConfig.light(AREA)), Header("a", 3, "c", {"b": 1.0, "a": 2.0})
    for k in range(5):
        save_weights(tmp_path / f"{k}", network, header)
    assert len({(tmp_path / f"{k}").read_bytes() for k in range(5)}) == 1
    found, found_header = load_weights(tmp_path / "0")
    assert found_header == header
    expected = network.state_dict()
    assert all(torch.equal(tensor, expected[name]) for name, tensor in found.state_dict().items())


def test_the_tensors_stay_aligned_and_links_are_followed(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "real")
    for length in range(9):
        save_weights(tmp_path / "link", VoxelNet(VoxelNetConfig.light(AREA)), Header("x" * length))
        content = (tmp_path / "real").read_bytes()
        assert int.from_bytes(content[:8], "little") % 8 == 0
        assert load_weights(tmp_path / "real")[1].site == "x" * length
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "real"]


def test_weights_that_are_not_numbers_are_not_saved(tmp_path):
    broken = VoxelNet(VoxelNetConfig.light(AREA))
    broken.head.classes.bias.data[0] = math.nan
    with pytest.raises(ValueError, match=r"finite, but head\.classes\.bias"):
        save_weights(tmp_path / "x.safetensors", broken, Header())
    assert not list(tmp_path.iterdir())
