"""`SparseVoxelNet` gives what the dense network gives, borders, batches, padding and empty clouds included."""

import numpy as np
import pytest
import torch
from torch import nn

from models.config import VoxelNetConfig
from models.sparse import SparseVoxelNet
from models.voxelnet import VoxelNet, point_features
from models.voxels import collate, voxelise

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


def trained(config, seed=0):
    """Random weights that keep the scale, and running statistics and affine maps that are not the identity."""
    torch.manual_seed(seed)
    network = VoxelNet(config)
    for module in network.modules():
        if isinstance(module, nn.BatchNorm1d | nn.BatchNorm2d | nn.BatchNorm3d):
            nn.init.uniform_(module.running_mean, -0.3, 0.3)
            nn.init.uniform_(module.running_var, 0.5, 2)
            nn.init.uniform_(module.weight, 0.6, 1.2)
            nn.init.uniform_(module.bias, -0.2, 0.2)
        elif isinstance(module, nn.Conv2d | nn.Conv3d | nn.ConvTranspose2d):
            nn.init.kaiming_normal_(module.weight)
            if module.bias is not None:
                nn.init.uniform_(module.bias, -0.2, 0.2)
    return network.eval()


def cloud(config, n, seed=1):
    rng = np.random.default_rng(seed)
    xmin, ymin, xmax, ymax = config.area
    points = rng.uniform((xmin, ymin, -0.5), (xmax, ymax, 4.5), (n, 3))
    points[: n // 2] = points[: n // 2] * [0.1, 0.1, 0.2]  # a crowd, so that voxels are full
    return points.astype(np.float32)


def assert_same(a, b):
    for ours, theirs in zip(a, b, strict=True):
        assert (ours is None) == (theirs is None)
        if ours is not None:
            torch.testing.assert_close(ours, theirs, atol=1e-4, rtol=0)


@pytest.mark.parametrize("name", SMALL)
@pytest.mark.parametrize("n", [0, 1, 3000])
def test_sparse_is_dense(name, n):
    config = SMALL[name]
    network, voxels = trained(config), voxelise(cloud(config, n), config)
    with torch.inference_mode():
        dense = network(voxels)
    assert dense.residuals.std() > 0.01
    assert_same(SparseVoxelNet(network)(voxels), dense)


@pytest.mark.parametrize("name", ["published", "light"])
def test_points_in_the_corners_feel_the_border(name):
    config = SMALL[name]
    corners = [(x, y, z) for x in (-3.99, 4.99) for y in (-3.99, 3.99) for z in (0.01, 3.99)]
    network, voxels = trained(config), voxelise(np.float32(corners), config)
    with torch.inference_mode():
        assert_same(SparseVoxelNet(network)(voxels), network(voxels))


@pytest.mark.parametrize("name", ["published", "light"])
def test_a_batch_is_its_items(name):
    config = SMALL[name]
    sparse = SparseVoxelNet(trained(config))
    items = [voxelise(cloud(config, n, seed), config) for seed, n in ((1, 900), (2, 0), (3, 50))]
    together = sparse(collate(items))
    for number, item in enumerate(items):
        assert_same([None if each is None else each[number : number + 1] for each in together], sparse(item))


@pytest.mark.parametrize("name", ["published", "light"])
def test_the_network_itself_takes_batches_too(name):
    config = SMALL[name]
    network = trained(config)
    items = [voxelise(cloud(config, n, seed), config) for seed, n in ((1, 900), (3, 50))]
    with torch.inference_mode():
        together = network(collate(items))
        for number, item in enumerate(items):
            assert_same([None if each is None else each[number : number + 1] for each in together], network(item))


def test_the_copy_is_folded_and_the_original_untouched():
    network = trained(SMALL["light"])
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    sparse = SparseVoxelNet(network)
    assert not any(isinstance(module, nn.BatchNorm2d | nn.BatchNorm3d) for module in sparse.modules())
    for name, tensor in network.state_dict().items():
        torch.testing.assert_close(tensor, before[name])


def test_order_of_points_does_not_matter():
    config = SMALL["published"]
    points = cloud(config, 300)
    sparse = SparseVoxelNet(trained(config))
    shuffled = np.random.default_rng(5).permutation(points)
    assert_same(sparse(voxelise(points, config)), sparse(voxelise(shuffled, config)))


def test_every_weight_learns():
    config = SMALL["light"]
    network = VoxelNet(config).train()
    prediction = network(collate([voxelise(cloud(config, n, n), config) for n in (900, 50)]))
    sum(each.square().sum() for each in prediction).backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().max() > 0, name


def test_local_features_do_not_know_where_the_area_is():
    here, there = VoxelNetConfig.light((-4, -4, 4, 4)), VoxelNetConfig.light((96, 60, 104, 68))
    points = cloud(here, 500)
    moved = points + np.float32([100, 64, 0])
    features = [point_features(voxelise(each, config), config) for each, config in ((points, here), (moved, there))]
    torch.testing.assert_close(*features, atol=3e-5, rtol=0)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
@pytest.mark.parametrize("name", ["published", "light"])
def test_cuda_gives_the_same(name):
    torch.backends.cudnn.allow_tf32 = torch.backends.cuda.matmul.allow_tf32 = False
    config = SMALL[name]
    sparse, voxels = SparseVoxelNet(trained(config)), voxelise(cloud(config, 900), config)
    expected = sparse(voxels)
    there = sparse.cuda()(voxels.to("cuda"))
    assert_same([None if each is None else each.cpu() for each in there], expected)


def test_the_light_network_trains_in_half_precision():
    network = VoxelNet(VoxelNetConfig.light((-8, -8, 8, 8)))
    points = torch.rand(500, 3) * 8
    with torch.autocast("cpu", torch.bfloat16):
        prediction = network(voxelise(points, network.config))
    prediction.residuals.float().sum().backward()
    assert all(torch.isfinite(p.grad).all() for p in network.middle.parameters())
