"""Folded layers give what layer and BatchNorm give."""

import pytest
import torch
from torch import nn

from models.config import VoxelNetConfig
from models.network.folding import FoldedRegionProposal, LinearHead, PlainJoin, folded, folded_points
from models.network.voxelnet import PointLayer

NARROW = {"voxel_width": 32, "middle_widths": (16, 16, 16), "upsample_width": 32, "rpn_widths": (32, 32, 48)}
PUBLISHED = VoxelNetConfig.published("tjunction", area=(-4.0, -4.0, 4.0, 4.0), head3x3=48, **NARROW)


def used(norm):
    """A BatchNorm with statistics and an affine map that are not the identity."""
    for values, low, high in ((norm.running_mean, -1, 1), (norm.running_var, 0.5, 2), (norm.weight.data, 0.5, 2)):
        nn.init.uniform_(values, low, high)
    nn.init.uniform_(norm.bias.data, -1, 1)
    return norm.eval()


@pytest.mark.parametrize(
    ("layer", "norm", "shape"),
    [
        (nn.Linear(6, 5), nn.BatchNorm1d(5), (7, 6)),
        (nn.Conv2d(3, 5, 3, bias=False), nn.BatchNorm2d(5), (2, 3, 6, 6)),
        (nn.Conv3d(3, 5, 3), nn.BatchNorm3d(5), (2, 3, 4, 5, 6)),
    ],
)
@torch.no_grad()
def test_a_layer_and_its_norm_are_one_layer(layer, norm, shape):
    x, expected_of = torch.randn(shape), used(norm)
    expected = expected_of(layer(x))
    weight, bias = folded(layer, norm)
    layer.weight.data, layer.bias = weight, nn.Parameter(bias)
    torch.testing.assert_close(layer(x), expected, atol=1e-5, rtol=1e-5)


@torch.no_grad()
def test_a_point_layer_without_its_norm_gives_the_same():
    layer, x = PointLayer(6, 8), torch.randn(20, 6)
    used(layer.norm)
    torch.testing.assert_close(folded_points(layer)(x), layer.eval()(x), atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize(
    ("config", "join"), [(PUBLISHED, LinearHead), (VoxelNetConfig.light((-4, -4, 4, 4)), PlainJoin)]
)
@torch.no_grad()
def test_region_proposal_and_head_give_the_same_maps(trained, assert_same, config, join):
    network = trained(config)
    x = torch.rand(2, network.middle.width, *config.grid_shape[:2])
    shuffled = torch.randperm(network.middle.width)
    expected = network.head(network.rpn(x))
    rpn = FoldedRegionProposal(network.rpn, network.head)
    assert isinstance(rpn.join, join)
    assert_same(rpn(x), expected)
    assert_same(FoldedRegionProposal(network.rpn, network.head, shuffled)(x[:, shuffled]), expected)
