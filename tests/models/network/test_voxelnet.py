"""The network as it is trained: every weight learns, batches are their items, local features know
no place."""

import numpy as np
import pytest
import torch

from models.config import VoxelNetConfig
from models.network.grid import collate, voxelise
from models.network.voxelnet import VoxelNet, point_features

NARROW = {
    "voxel_width": 32,
    "middle_widths": (16, 16, 16),
    "upsample_width": 32,
    "rpn_widths": (32, 32, 48),
}
SMALL = {
    "published": VoxelNetConfig.from_paper(
        "tjunction", area=(-4.0, -4.0, 5.0, 4.0), head3x3=48, **NARROW
    ),
    "light": VoxelNetConfig.light((-4, -4, 5, 4)),
}


@pytest.mark.parametrize("name", ["published", "light"])
def test_the_network_itself_takes_batches_too(name, trained, cloud, assert_same):
    config = SMALL[name]
    network = trained(config)
    items = [voxelise(cloud(config, n, seed), config) for seed, n in ((1, 900), (3, 50))]
    with torch.inference_mode():
        together = network(collate(items))
        for number, item in enumerate(items):
            assert_same(
                [None if each is None else each[number : number + 1] for each in together],
                network(item),
            )


def test_every_weight_learns_and_features_are_local(cloud):
    config = SMALL["light"]
    network = VoxelNet(config).train()
    prediction = network(collate([voxelise(cloud(config, n, n), config) for n in (900, 50)]))
    sum(each.square().sum() for each in prediction).backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().max() > 0, name
    here, there = VoxelNetConfig.light((-4, -4, 4, 4)), VoxelNetConfig.light((96, 60, 104, 68))
    points = cloud(here, 500)
    moved = points + np.float32([100, 64, 0])
    features = [
        point_features(voxelise(each, config), config)
        for each, config in ((points, here), (moved, there))
    ]
    torch.testing.assert_close(*features, atol=3e-5, rtol=0)


def test_light_networks_train_in_half_precision_and_need_height():
    network = VoxelNet(VoxelNetConfig.light((-8, -8, 8, 8)))
    points = torch.rand(500, 3) * 8
    with torch.autocast("cpu", torch.bfloat16):
        prediction = network(voxelise(points, network.config))
    prediction.residuals.float().sum().backward()
    assert all(torch.isfinite(p.grad).all() for p in network.middle.parameters())
    with pytest.raises(ValueError, match="at least 5 voxels of height"):
        VoxelNet(
            VoxelNetConfig.from_paper(
                "tjunction", area=(-4.0, -4.0, 4.0, 4.0), height=(0.0, 1.2), **NARROW
            )
        )
