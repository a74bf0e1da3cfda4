"""Weights files: the same bytes for the same network, whole or not there."""

import math
from typing import Any

import pytest
import torch

from models.config import VoxelNetConfig
from models.network.voxelnet import VoxelNet
from models.weight_files import WeightsHeader, load_tensors, load_weights, save_weights

AREA = (-8.0, -8.0, 8.0, 8.0)


def test_bytes_repeat_tensors_stay_aligned_and_links_are_followed(tmp_path):
    network, header = (
        VoxelNet(VoxelNetConfig.light(AREA)),
        WeightsHeader("a", 3, "c", {"b": 1.0, "a": 2.0}),
    )
    for k in range(5):
        save_weights(tmp_path / f"{k}", network, header)
    assert len({(tmp_path / f"{k}").read_bytes() for k in range(5)}) == 1
    found, found_header = load_weights(tmp_path / "0")
    assert found_header == header
    expected = network.state_dict()
    assert all(torch.equal(tensor, expected[name]) for name, tensor in found.state_dict().items())
    broken = VoxelNet(VoxelNetConfig.light(AREA))
    broken.head.classes.bias.data[0] = math.nan
    with pytest.raises(ValueError, match=r"finite, but head\.classes\.bias"):
        save_weights(tmp_path / "x.safetensors", broken, WeightsHeader())
    assert not (tmp_path / "x.safetensors").exists()
    folder = tmp_path / "links"
    folder.mkdir()
    (folder / "link").symlink_to(folder / "real")
    for length in range(9):
        save_weights(
            folder / "link", VoxelNet(VoxelNetConfig.light(AREA)), WeightsHeader("x" * length)
        )
        assert int.from_bytes((folder / "real").read_bytes()[:8], "little") % 8 == 0
        assert load_weights(folder / "real")[1].site == "x" * length
    assert sorted(path.name for path in folder.iterdir()) == ["link", "real"]


class Harmful:
    def __reduce__(self):
        return print, ("executed",)


def test_tensors_are_read_and_nothing_is_executed(tmp_path, capsys):
    torch.save({"a": torch.arange(3), "b": [1, "x"]}, tmp_path / "a.pt")
    read: Any = load_tensors(tmp_path / "a.pt")
    assert read["a"].tolist() == [0, 1, 2]
    assert read["b"] == [1, "x"]
    torch.save({"a": Harmful()}, tmp_path / "b.pt")
    with pytest.raises(ValueError, match=r"b\.pt is damaged or not a checkpoint of tensors"):
        load_tensors(tmp_path / "b.pt")
    assert "executed" not in capsys.readouterr().out


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9])
def test_a_file_that_is_cut_off_is_refused_in_one_line(tmp_path, share):
    torch.save({"a": torch.arange(3000)}, tmp_path / "a.pt")
    whole = (tmp_path / "a.pt").read_bytes()
    (tmp_path / "a.pt").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(ValueError, match=r"a\.pt is damaged") as error:
        load_tensors(tmp_path / "a.pt")
    assert "\n" not in str(error.value)
    with pytest.raises(FileNotFoundError):
        load_tensors(tmp_path / "b.pt")
