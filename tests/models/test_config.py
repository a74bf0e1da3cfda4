"""`VoxelNetConfig`: the grid follows the area, and the numbers are checked."""

import json

import numpy as np
import pytest

from models.config import VoxelNetConfig
from models.network.voxelnet import VoxelNet


@pytest.mark.parametrize(
    ("area", "grid", "maps"),
    [
        ((-40, -20, 40, 20), (400, 200, 10), (200, 100)),
        ((-48, -48, 48, 48), (480, 480, 10), (240, 240)),
        ((0, 0, 50, 30), (256, 152, 10), (128, 76)),
        ((-0.3, 0.1, 1.4, 0.3), (16, 8, 10), (8, 4)),
    ],
)
def test_the_grid_follows_the_area_in_multiples_of_eight(area, grid, maps):
    config = VoxelNetConfig.light(area)
    assert (config.grid_shape, config.map_shape) == (grid, maps)


def test_published_sizes():
    assert VoxelNetConfig.published("tjunction").map_shape == (200, 100)
    assert VoxelNetConfig.published("roundabout").grid_shape == (240, 240, 10)
    parameters = sum(each.numel() for each in VoxelNet(VoxelNetConfig.published("tjunction")).parameters())
    assert parameters == 9_460_194


@pytest.mark.parametrize("config", [VoxelNetConfig.published("roundabout"), VoxelNetConfig.light(np.arange(4))])
def test_a_configuration_survives_json(config):
    assert VoxelNetConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"area": (0.0, 0.0, 0.0, 9.0)}, "room inside"),
        ({"height": (4.0, 0.0)}, "room inside"),
        ({"voxel_size": (0.2, 0.0, 0.4)}, "need a size"),
        ({"max_points": 0}, "need a size"),
        ({"column_width": 32}, "either"),
        ({"middle_widths": (64, 64)}, "threes"),
    ],
)
def test_what_makes_no_network_is_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        VoxelNetConfig.published("tjunction", **changes)


def test_unknown_sites_and_entries_are_refused():
    with pytest.raises(ValueError, match="'crossing'"):
        VoxelNetConfig.published("crossing")
    with pytest.raises(ValueError, match="depth"):
        VoxelNetConfig.from_dict({"area": [0, 0, 1, 1], "depth": 3})
