"""`PlacedClouds`: the voxels of unions are those of their points, thinned where they are crowded, tile by tile."""

import numpy as np
import pytest
import torch

from models.config import VoxelNetConfig
from models.network.placed_clouds import PlacedClouds
from models.network.voxels import voxelise

CONFIG = VoxelNetConfig.light((0.0, 0.0, 38.4, 9.6), max_points=4)
UNIONS = np.array(list(np.ndindex(*(2,) * 6)), bool)


@pytest.fixture(scope="module")
def clouds():
    """Two heaps of some hundred points in few voxels, each of several clouds that overlap, and somebody far off."""
    rng = np.random.default_rng(2)
    heaps = [rng.normal(at, (0.2, 0.2, 0.4), (60, 3)) for at in [(5, 5, 1.5)] * 3 + [(21, 5, 1.5)] * 2]
    return [torch.from_numpy(heap.astype(np.float32)) for heap in (*heaps, rng.normal((35, 4, 1), 0.5, (9, 3)))]


def together(clouds, union):
    return torch.cat([torch.zeros(0, 3), *(cloud for cloud, among in zip(clouds, union, strict=True) if among)])


def left(placed, union, thinning, dropped):
    """Rows of the points that stay in a union."""
    rows, points = np.flatnonzero(union[placed.cloud]), len(placed.points)
    of_it = dropped[dropped // points == thinning] % points
    return torch.from_numpy(rows if thinning == 0 else rows[~np.isin(rows, of_it)])


def test_crowded_voxels_lose_the_points_that_they_lose_in_each_union(clouds):
    placed = PlacedClouds.of(clouds, CONFIG)
    thinning, dropped = placed.crowded(UNIONS, 4)
    assert placed.counts().tolist() == [60] * 5 + [9]
    for union, number in zip(UNIONS, thinning, strict=True):
        kept = voxelise(together(clouds, union), CONFIG).points
        torch.testing.assert_close(placed.points[left(placed, union, number, dropped)], kept, rtol=0, atol=0)
    assert len(np.unique(thinning)) > 20
    assert (thinning[~UNIONS[:, :5].any(axis=1)] == 0).all()
    np.testing.assert_array_equal(thinning[::2], thinning[1::2])  # with and without who is far off


def test_a_batch_has_the_voxels_of_its_items(clouds):
    placed = PlacedClouds.of(clouds, CONFIG)
    thinning, dropped = placed.crowded(UNIONS, 4)
    some = [63, 1, 0, 40]
    rows = [left(placed, UNIONS[k], thinning[k], dropped) for k in some]
    item = torch.cat([torch.full((len(each),), number) for number, each in enumerate(rows)])
    batch = placed.batch(torch.cat(rows), item, len(some), CONFIG)
    for number, k in enumerate(some):
        alone, own = voxelise(together(clouds, UNIONS[k]), CONFIG), batch.cells[:, 0] == number
        torch.testing.assert_close(batch.cells[own, 1:], alone.cells[:, 1:])
        torch.testing.assert_close(batch.points[item == number], alone.points)
        torch.testing.assert_close(batch.cells[batch.voxel[item == number], 1:], alone.cells[alone.voxel, 1:])


def test_a_tile_has_its_points_and_those_of_the_columns_before_it():
    rng = np.random.default_rng(0)
    clouds = [
        torch.from_numpy(rng.uniform((0, 0, 0.1), (38.4, 9.6, 3.9), (n, 3)).astype(np.float32)) for n in (300, 0, 200)
    ]
    placed = PlacedClouds.of(clouds, CONFIG)
    by_tile = placed.by_tile((8, 2), 24, 2)
    tiles = np.arange(16)
    unions = np.array([[1, 0, 0], [0, 1, 1], [1, 1, 1], [0, 0, 0]], bool)[tiles % 4]
    rows, item = by_tile.rows(tiles, unions)
    column = placed.cells[:, :2]
    for tile, union in zip(tiles, unions, strict=True):
        low = torch.tensor([tile // 2, tile % 2]) * 24
        there = ((column >= low - 2) & (column < low + 24)).all(1) & torch.from_numpy(union)[placed.cloud]
        assert rows[item == tile].tolist() == torch.nonzero(there)[:, 0].tolist()
