"""`SparseVoxelNet` gives what the dense network gives, borders, batches, padding and empty clouds included."""

import numpy as np
import pytest
import torch
from torch import nn

from models.config import VoxelNetConfig
from models.network.sparse import SparseVoxelNet
from models.network.voxels import collate, voxelise

NARROW = {"voxel_width": 32, "middle_widths": (16, 16, 16), "upsample_width": 32, "rpn_widths": (32, 32, 48)}
SMALL = {
    "published": VoxelNetConfig.published("tjunction", area=(-4.0, -4.0, 5.0, 4.0), head3x3=48, **NARROW),
    "published 0.4 m": VoxelNetConfig.published("roundabout", area=(-8.0, -8.0, 8.0, 8.0), head3x3=48, **NARROW),
    "published widths": VoxelNetConfig.published("tjunction", area=(-2.0, -2.0, 2.0, 2.0)),
    "light": VoxelNetConfig.light((-4, -4, 5, 4)),
    "published without its 3x3 head": VoxelNetConfig.published(
        "tjunction", area=(-4.0, -4.0, 4.0, 4.0), head3x3=0, **NARROW
    ),
    "light with 3D convolutions and a 3x3 head": VoxelNetConfig.light(
        (-4, -4, 4, 4), middle_widths=(16, 16, 16), column_width=0, head3x3=64, labels=("vehicle", "cyclist")
    ),
    "low": VoxelNetConfig.published("tjunction", area=(-4.0, -4.0, 4.0, 4.0), height=(0.0, 2.0), **NARROW),
}


@pytest.mark.parametrize("name", SMALL)
@pytest.mark.parametrize("n", [0, 1, 3000])
def test_sparse_is_dense(name, n, trained, cloud, assert_same):
    config = SMALL[name]
    network, voxels = trained(config), voxelise(cloud(config, n), config)
    with torch.inference_mode():
        dense = network(voxels)
    assert dense.residuals.std() > 0.01
    assert_same(SparseVoxelNet(network)(voxels), dense)


@pytest.mark.parametrize("name", ["published", "light"])
def test_points_in_the_corners_feel_the_border(name, trained, assert_same):
    config = SMALL[name]
    corners = [(x, y, z) for x in (-3.99, 4.99) for y in (-3.99, 3.99) for z in (0.01, 3.99)]
    network, voxels = trained(config), voxelise(np.float32(corners), config)
    with torch.inference_mode():
        assert_same(SparseVoxelNet(network)(voxels), network(voxels))


@pytest.mark.parametrize("name", ["published", "light"])
def test_a_batch_is_its_items(name, trained, cloud, assert_same):
    config = SMALL[name]
    sparse = SparseVoxelNet(trained(config))
    items = [voxelise(cloud(config, n, seed), config) for seed, n in ((1, 900), (2, 0), (3, 50))]
    together = sparse(collate(items))
    for number, item in enumerate(items):
        assert_same([None if each is None else each[number : number + 1] for each in together], sparse(item))


def test_the_copy_is_folded_and_the_original_untouched(trained):
    network = trained(SMALL["light"])
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    sparse = SparseVoxelNet(network)
    assert not any(isinstance(module, nn.BatchNorm2d | nn.BatchNorm3d) for module in sparse.modules())
    for name, tensor in network.state_dict().items():
        torch.testing.assert_close(tensor, before[name])


def test_order_of_points_does_not_matter(trained, cloud, assert_same):
    config = SMALL["published"]
    points = cloud(config, 300)
    sparse = SparseVoxelNet(trained(config))
    shuffled = np.random.default_rng(5).permutation(points)
    assert_same(sparse(voxelise(points, config)), sparse(voxelise(shuffled, config)))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
@pytest.mark.parametrize("name", ["published", "light"])
def test_cuda_gives_the_same(name, trained, cloud, assert_same):
    torch.backends.cudnn.allow_tf32 = torch.backends.cuda.matmul.allow_tf32 = False
    config = SMALL[name]
    sparse, voxels = SparseVoxelNet(trained(config)), voxelise(cloud(config, 900), config)
    expected = sparse(voxels)
    there = sparse.cuda()(voxels.to("cuda"))
    assert_same([None if each is None else each.cpu() for each in there], expected)
