"""OpenVINO computes the maps that torch computes, and keeps no array of anybody else."""

import copy
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch

from models.config import VoxelNetConfig
from models.detector import VoxelNetDetector
from models.network.grid import collate, voxelise
from models.network.openvino_proposal import OpenVinoLayer, OpenVinoProposal
from models.network.sparse import SparseColumns, SparseVoxelNet

pytest.importorskip("openvino")

AREA = (-4.0, -4.0, 4.0, 4.0)
NARROW = {
    "voxel_width": 32,
    "middle_widths": (16, 16, 16),
    "upsample_width": 32,
    "rpn_widths": (32, 32, 48),
}
CONFIGS = {
    "light": VoxelNetConfig.light((-4, -4, 5, 4)),
    "a linear head": VoxelNetConfig.from_paper("tjunction", area=AREA, head3x3=48, **NARROW),
    "maps side by side": VoxelNetConfig.from_paper("tjunction", area=AREA, head3x3=0, **NARROW),
    "a 3x3 head": VoxelNetConfig.light(
        AREA, middle_widths=(16, 16, 16), column_width=0, head3x3=64
    ),
}


def by_openvino(network, precision="f32"):
    converted = copy.deepcopy(network)
    converted.rpn = OpenVinoProposal(converted.rpn, precision)
    if isinstance(converted.middle, SparseColumns):
        converted.middle.dense = OpenVinoLayer(converted.middle.first, precision)
    return converted


@pytest.fixture(params=CONFIGS)
def config(request):
    return CONFIGS[request.param]


def test_the_maps_are_those_of_torch(config, trained, cloud, assert_same):
    network = SparseVoxelNet(trained(config))
    voxels = collate([voxelise(cloud(config, n, seed=n), config) for n in (2000, 0, 300)])
    assert_same(by_openvino(network)(voxels), network(voxels))


def test_a_layer_is_that_of_torch_and_keeps_no_array():
    layer = torch.nn.Conv2d(3, 5, 3, stride=2, padding=1)
    compiled = OpenVinoLayer(layer, "f32")
    for items, rows in ((2, 8), (1, 8), (1, 4)):
        x = torch.randn(items, 3, rows, 6).to(memory_format=torch.channels_last)
        before = x.clone()
        expected = torch.relu(layer(x)).detach()
        found = compiled(x)
        compiled(-x)
        torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-5)
        torch.testing.assert_close(x, before, atol=0, rtol=0)
    assert copy.deepcopy(compiled)._compiled.requests == {}


def test_arrays_are_not_shared_with_the_caller(trained, cloud):
    config = CONFIGS["light"]
    network = by_openvino(SparseVoxelNet(trained(config)))
    first, second = (voxelise(cloud(config, 2000, seed=seed), config) for seed in (1, 2))
    x = network.middle(network.features(first), first)
    before = x.clone()
    maps = network.rpn(x)
    kept = maps.class_logits.clone(), maps.features.clone()
    network.rpn(network.middle(network.features(second), second))
    torch.testing.assert_close(x, before, atol=0, rtol=0)
    torch.testing.assert_close((maps.class_logits, maps.features), kept, atol=0, rtol=0)


def test_threads_get_the_maps_of_their_own_cloud(trained, cloud, assert_same):
    config = CONFIGS["light"]
    network = SparseVoxelNet(trained(config))
    shared = by_openvino(network)
    clouds = [voxelise(cloud(config, 500, seed=seed), config) for seed in range(12)]
    with ThreadPoolExecutor(4) as pool:
        for maps, voxels in zip(pool.map(shared, clouds), clouds, strict=True):
            assert_same(maps, network(voxels))


def test_a_detector_finds_the_same_boxes_in_float32(trained, cloud, bfloat16_library):
    config = CONFIGS["light"]
    exact = VoxelNetDetector(trained(config), score_threshold=0.01)
    bfloat16_library("openvino")
    quick = exact.quick()
    assert quick.name.endswith("+bfloat16")
    quick.network = by_openvino(exact.network)
    points = cloud(config, 3000)
    expected = exact(points)
    assert len(expected)
    found = quick(points)
    np.testing.assert_allclose(found.boxes, expected.boxes, atol=1e-4)
    np.testing.assert_allclose(found.scores, expected.scores, atol=1e-4)
    unions = np.array([[True, False], [True, True]])
    both = [points[::2], points[1::2]]
    for one, other in zip(quick.unions(both, unions), exact.unions(both, unions), strict=True):
        np.testing.assert_allclose(one.boxes, other.boxes, atol=1e-4)
