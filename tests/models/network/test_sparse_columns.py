"""`SparseColumns` gives what the height fold, the convolution after it and its ReLU give."""

import pytest
import torch
from torch import nn

from models.config import VoxelNetConfig
from models.network.sparse_columns import SparseColumns
from models.network.voxels import collate, voxelise

CONFIG = VoxelNetConfig.light((-4, -4, 5, 4))


@pytest.mark.parametrize("counts", [(0,), (1,), (900,), (400, 0, 30)])
@torch.no_grad()
def test_columns_give_the_map_of_fold_and_convolution(trained, cloud, counts):
    network = trained(CONFIG)
    first = nn.Conv2d(network.middle.width, 12, 3, stride=2, padding=1)
    voxels = collate([voxelise(cloud(CONFIG, n, seed), CONFIG) for seed, n in enumerate(counts)])
    features = network.features(voxels)
    expected = torch.relu(first(network.middle(features, voxels)))
    got = SparseColumns(network.middle, first)(features, voxels)
    torch.testing.assert_close(got, expected, atol=1e-5, rtol=1e-5)


@torch.no_grad()
def test_what_no_column_reaches_is_the_bias(trained, cloud):
    network = trained(CONFIG)
    first = nn.Conv2d(network.middle.width, 12, 3, stride=2, padding=1)
    voxels = voxelise(cloud(CONFIG, 0), CONFIG)
    got = SparseColumns(network.middle, first)(network.features(voxels), voxels)
    torch.testing.assert_close(got, first.bias.relu()[:, None, None].expand_as(got[0])[None])
