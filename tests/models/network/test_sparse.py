"""`SparseVoxelNet` gives what the dense network gives, borders, batches, padding and empty clouds
included."""

import numpy as np
import pytest
import torch
from torch import nn

from models.config import VoxelNetConfig
from models.network.grid import collate, voxelise
from models.network.sparse import (
    FoldedRegionProposal,
    LinearHead,
    PlainJoin,
    Plane,
    SparseColumns,
    SparseMiddle,
    SparseVoxelNet,
    count_before,
    dilate,
    fold_norm,
)
from models.network.voxelnet import AnchorPlaces

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
    "published 0.4 m": VoxelNetConfig.from_paper(
        "roundabout", area=(-8.0, -8.0, 8.0, 8.0), head3x3=48, **NARROW
    ),
    "published widths": VoxelNetConfig.from_paper("tjunction", area=(-2.0, -2.0, 2.0, 2.0)),
    "light": VoxelNetConfig.light((-4, -4, 5, 4)),
    "published without its 3x3 head": VoxelNetConfig.from_paper(
        "tjunction", area=(-4.0, -4.0, 4.0, 4.0), head3x3=0, **NARROW
    ),
    "light with 3D convolutions and a 3x3 head": VoxelNetConfig.light(
        (-4, -4, 4, 4),
        middle_widths=(16, 16, 16),
        column_width=0,
        head3x3=64,
        labels=("vehicle", "cyclist"),
    ),
    "low": VoxelNetConfig.from_paper(
        "tjunction", area=(-4.0, -4.0, 4.0, 4.0), height=(0.0, 2.0), **NARROW
    ),
}


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", SMALL)
@pytest.mark.parametrize("n", [0, 1, 3000])
def test_sparse_is_dense(name, n, trained, cloud, assert_same):
    config = SMALL[name]
    network, voxels = trained(config), voxelise(cloud(config, n), config)
    with torch.inference_mode():
        dense = network(voxels)
    assert dense.residuals.std() > 0.01
    assert_same(SparseVoxelNet(network)(voxels), dense)


@pytest.mark.parametrize("name", SMALL)
def test_outputs_of_some_anchors_are_those_of_the_whole_maps(name, trained, cloud, assert_same):
    config = SMALL[name]
    sparse = SparseVoxelNet(trained(config))
    voxels = collate([voxelise(cloud(config, n, n), config) for n in (900, 40)])
    anchors = len(config.anchor_labels)
    rows, columns = config.map_shape
    places = AnchorPlaces(
        item=torch.tensor([0, 1, 1, 0]),
        row=torch.tensor([0, rows - 1, 2, 0]),
        column=torch.tensor([columns - 1, 3, 3, columns - 1]),
        anchor=torch.tensor([0, anchors - 1, 0, anchors - 1]),
    )
    with torch.inference_mode():
        outputs = sparse.classify(voxels).at(places, anchors)
        assert_same(outputs, sparse(voxels).at(places, anchors))
        nowhere = sparse.classify(voxels).at(places.select(torch.tensor([], dtype=int)), anchors)
    assert nowhere.residuals.shape == (0, outputs.residuals.shape[1])


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
        assert_same(
            [None if each is None else each[number : number + 1] for each in together], sparse(item)
        )


def test_the_copy_is_folded_and_the_original_untouched(trained):
    network = trained(SMALL["light"])
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    sparse = SparseVoxelNet(network)
    assert not any(
        isinstance(module, nn.BatchNorm2d | nn.BatchNorm3d) for module in sparse.modules()
    )
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


PUBLISHED = VoxelNetConfig.from_paper(
    "tjunction", area=(-4.0, -4.0, 4.0, 4.0), head3x3=48, **NARROW
)


def used(norm):
    """A BatchNorm with statistics and an affine map that are not the identity."""
    for values, low, high in (
        (norm.running_mean, -1, 1),
        (norm.running_var, 0.5, 2),
        (norm.weight.data, 0.5, 2),
    ):
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
    weight, bias = fold_norm(layer, norm)
    layer.weight.data, layer.bias = weight, nn.Parameter(bias)
    torch.testing.assert_close(layer(x), expected, atol=1e-5, rtol=1e-5)


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
    assert_same(rpn(x).everywhere(), expected)
    shuffled_rpn = FoldedRegionProposal(network.rpn, network.head, shuffled)
    assert_same(shuffled_rpn(x[:, shuffled]).everywhere(), expected)


CONFIG = VoxelNetConfig.light((-4, -4, 5, 4))


@pytest.mark.parametrize("counts", [(0,), (1,), (900,), (400, 0, 30)])
@torch.no_grad()
def test_columns_and_reached_cells_give_the_dense_map(trained, cloud, counts):
    network = trained(CONFIG)
    first = nn.Conv2d(network.middle.width, 12, 3, stride=2, padding=1)
    voxels = collate([voxelise(cloud(CONFIG, n, seed), CONFIG) for seed, n in enumerate(counts)])
    features = network.features(voxels)
    expected = torch.relu(first(network.middle(features, voxels)))
    columns = SparseColumns(network.middle, first)
    torch.testing.assert_close(columns(features, voxels), expected, atol=1e-5, rtol=1e-5)
    columns.dense = first
    torch.testing.assert_close(columns(features, voxels), expected, atol=1e-5, rtol=1e-5)
    network = trained(DEEP)
    voxels = collate([voxelise(cloud(DEEP, n, seed), DEEP) for seed, n in enumerate(counts)])
    features = network.features(voxels)
    middle = SparseMiddle(network.middle)
    expected = network.middle(features, voxels)[:, middle.channel_order]
    torch.testing.assert_close(middle(features, voxels), expected, atol=1e-5, rtol=1e-4)


@torch.no_grad()
def test_what_no_column_reaches_is_the_bias(trained, cloud):
    network = trained(CONFIG)
    first = nn.Conv2d(network.middle.width, 12, 3, stride=2, padding=1)
    voxels = voxelise(cloud(CONFIG, 0), CONFIG)
    got = SparseColumns(network.middle, first)(network.features(voxels), voxels)
    torch.testing.assert_close(got, first.bias.relu()[:, None, None].expand_as(got[0])[None])


@pytest.mark.parametrize("cells", [1, 63, 64, 65, 200])
def test_products_of_any_number_of_cells_are_those_of_the_whole_map(trained, cloud, cells):
    """In bfloat16 rows are added, so that few numbers of rows are multiplied."""
    network = SparseVoxelNet(trained(CONFIG))
    network.rpn.to(torch.bfloat16)
    classified = network.classify(voxelise(cloud(CONFIG, 900), CONFIG))
    rows, columns = classified.features.shape[2:]
    cell = torch.arange(cells) % (rows * columns)
    places = AnchorPlaces(
        item=torch.zeros_like(cell), row=cell // columns, column=cell % columns, anchor=cell % 2
    )
    got = classified.at(places, 2).residuals
    whole = classified.everywhere().residuals[0].view(2, -1, rows, columns)
    expected = whole[places.anchor, :, places.row, places.column]
    torch.testing.assert_close(got, expected, atol=0.02, rtol=0.02)


DEEP = VoxelNetConfig.from_paper("tjunction", area=(-4.0, -4.0, 5.0, 4.0), head3x3=48, **NARROW)
PLANE = Plane(items=2, nx=4, ny=3)


def test_cells_have_one_place_and_grow_within_the_border():
    item, ix, iy = (
        each.flatten() for each in torch.meshgrid(*map(torch.arange, (2, 4, 3)), indexing="ij")
    )
    place = PLANE.place(item, ix, iy)
    assert len(place.unique()) == len(place)
    assert place.max() < PLANE.size
    assert all(torch.equal(a, b) for a, b in zip(PLANE.cell(place), (item, ix, iy), strict=True))

    def mask_of(*cells):
        mask = torch.zeros(1, PLANE.size, dtype=torch.bool)
        mask[0, [int(PLANE.place(*map(torch.tensor, cell))) for cell in cells]] = True
        return mask

    assert torch.equal(
        dilate(mask_of((0, 0, 0)), PLANE), mask_of((0, 0, 0), (0, 0, 1), (0, 1, 0), (0, 1, 1))
    )
    middle = dilate(mask_of((1, 1, 1)), PLANE)
    assert torch.equal(middle, mask_of(*((1, x, y) for x in range(3) for y in range(3))))
    mask = torch.tensor([[True, False, True], [False, True, True]])
    assert count_before(mask)[mask].tolist() == [0, 1, 2, 3]
