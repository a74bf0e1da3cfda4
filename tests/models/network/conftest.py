"""Networks as if trained, clouds for them, and maps held against each other."""

import numpy as np
import pytest
import torch
from torch import nn

from models.network.voxelnet import VoxelNet

trained = pytest.fixture(scope="session")(lambda: _trained)
cloud = pytest.fixture(scope="session")(lambda: _cloud)
assert_same = pytest.fixture(scope="session")(lambda: _assert_same)


def _trained(config, seed=0):
    """Random weights that keep the scale, and running statistics and affine maps that are not the
    identity."""
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


def _cloud(config, n, seed=1):
    rng = np.random.default_rng(seed)
    xmin, ymin, xmax, ymax = config.area
    points = rng.uniform((xmin, ymin, -0.5), (xmax, ymax, 4.5), (n, 3))
    points[: n // 2] = points[: n // 2] * [0.1, 0.1, 0.2]  # a crowd, so that voxels are full
    return points.astype(np.float32)


def _assert_same(a, b):
    for ours, theirs in zip(a, b, strict=True):
        assert (ours is None) == (theirs is None)
        if ours is not None:
            torch.testing.assert_close(ours, theirs, atol=1e-4, rtol=0)
