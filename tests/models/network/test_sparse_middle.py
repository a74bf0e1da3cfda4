"""`SparseMiddle` gives what the dense 3D convolutions give."""

import pytest
import torch

from models.config import VoxelNetConfig
from models.network.sparse_middle import Plane, SparseMiddle, grown, numbers
from models.network.voxels import collate, voxelise

NARROW = {"voxel_width": 32, "middle_widths": (16, 16, 16), "upsample_width": 32, "rpn_widths": (32, 32, 48)}
CONFIG = VoxelNetConfig.published("tjunction", area=(-4.0, -4.0, 5.0, 4.0), head3x3=48, **NARROW)
PLANE = Plane(items=2, nx=4, ny=3)


@pytest.mark.parametrize("counts", [(0,), (1,), (900,), (400, 0, 30)])
@torch.no_grad()
def test_reached_cells_and_a_constant_give_the_dense_map(trained, cloud, counts):
    network = trained(CONFIG)
    voxels = collate([voxelise(cloud(CONFIG, n, seed), CONFIG) for seed, n in enumerate(counts)])
    features = network.features(voxels)
    middle = SparseMiddle(network.middle)
    expected = network.middle(features, voxels)[:, middle.channel_order]
    torch.testing.assert_close(middle(features, voxels), expected, atol=1e-5, rtol=1e-4)


def test_a_place_is_that_of_one_cell():
    item, ix, iy = (each.flatten() for each in torch.meshgrid(*map(torch.arange, (2, 4, 3)), indexing="ij"))
    place = PLANE.place(item, ix, iy)
    assert len(place.unique()) == len(place)
    assert place.max() < PLANE.size
    assert all(torch.equal(a, b) for a, b in zip(PLANE.cell(place), (item, ix, iy), strict=True))


def test_cells_grow_to_their_neighbours_and_not_across_a_border():
    def mask_of(*cells):
        mask = torch.zeros(1, PLANE.size, dtype=torch.bool)
        mask[0, [int(PLANE.place(*map(torch.tensor, cell))) for cell in cells]] = True
        return mask

    corner = grown(mask_of((0, 0, 0)), PLANE)
    assert torch.equal(corner, mask_of((0, 0, 0), (0, 0, 1), (0, 1, 0), (0, 1, 1)))
    middle = grown(mask_of((1, 1, 1)), PLANE)
    assert torch.equal(middle, mask_of(*((1, x, y) for x in range(3) for y in range(3))))
    place = PLANE.place(*map(torch.tensor, (1, 1, 1))) + PLANE.neighbours(torch.device("cpu"))
    assert torch.equal(torch.nonzero(middle[0])[:, 0], place.long())


def test_set_cells_are_numbered_in_order():
    mask = torch.tensor([[True, False, True], [False, True, True]])
    assert numbers(mask)[mask].tolist() == [0, 1, 2, 3]
