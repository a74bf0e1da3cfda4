"""Voxelisation: every point in its voxel, at most T of them, each as likely to stay as any
other."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings, strategies as st

from models.config import VoxelNetConfig
from models.network.grid import Groups, collate, voxelise

CONFIG = VoxelNetConfig.light((-4, -2, 4, 2))


def cloud(seed, n=3000):
    return np.random.default_rng(seed).uniform((-5, -3, -1), (5, 3, 5), (n, 3)).astype(np.float32)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 1000), st.integers(0, 4000))
def test_every_point_inside_is_in_the_voxel_it_lies_in(seed, n):
    points = cloud(seed, n)
    voxels = voxelise(points, CONFIG)
    inside = (
        (np.abs(points[:, 0]) < 4)
        & (np.abs(points[:, 1]) < 2)
        & (points[:, 2] > 0)
        & (points[:, 2] < 4)
    )
    np.testing.assert_array_equal(voxels.points, points[inside])
    lower = np.array([-4, -2, 0]) + voxels.cells[voxels.voxel, 1:].numpy() * np.array(
        CONFIG.voxel_size
    )
    within = voxels.points.numpy() - lower
    assert np.all((within > -1e-5) & (within < np.array(CONFIG.voxel_size) + 1e-5))
    assert len(np.unique(voxels.cells, axis=0)) == len(voxels.cells)
    assert set(voxels.voxel.tolist()) == set(range(len(voxels.cells)))


def test_borders_voxels_and_batches_are_the_published_ones():
    cells = voxelise(cloud(1), CONFIG).cells[:, [3, 1, 2]].tolist()
    assert cells == sorted(cells)
    assert (
        len(
            voxelise(
                np.float32([[4, 0, 1], [0, -2, 1], [0, 0, 0], [0, 0, 4], [0.1, 0, 1e-6]]), CONFIG
            ).points
        )
        == 1
    )
    config = VoxelNetConfig.from_paper("tjunction", area=(0.0, 0.0, 40.0, 80.0))
    x = (np.arange(1, 200) * 0.2).astype(np.float32)
    voxels = voxelise(np.stack((x, np.full_like(x, 0.1), np.full_like(x, 0.1)), 1), config)
    np.testing.assert_array_equal(voxels.cells[voxels.voxel, 1], np.floor(x / np.float64(0.2)))
    with pytest.raises((ValueError, TypeError)):
        voxelise(np.zeros((3, 5), np.float32), CONFIG)
    items = [voxelise(cloud(seed, n), CONFIG) for seed, n in ((1, 900), (2, 0), (3, 500))]
    batch = collate(items)
    assert batch.items == 3
    for number, item in enumerate(items):
        rows = batch.cells[:, 0] == number
        torch.testing.assert_close(batch.cells[rows][:, 1:], item.cells[:, 1:])
        own = rows[batch.voxel]
        torch.testing.assert_close(batch.points[own], item.points)
        torch.testing.assert_close(batch.cells[batch.voxel[own], 1:], item.cells[item.voxel, 1:])


@pytest.mark.parametrize(
    "points", [np.zeros((0, 3), np.float32), np.float32([[9, 0, 1], [0, 0, -1], [np.nan, 0, 1]])]
)
def test_nothing_inside_makes_no_voxels(points):
    voxels = voxelise(points, CONFIG)
    assert voxels.points.shape == (0, 3)
    assert voxels.cells.shape == (0, 4)


def test_crowded_voxels_keep_35_points_without_bias_by_the_seed():
    crowd = np.full((100, 3), 0.1, np.float32)
    crowd[:, 2] = np.linspace(0.01, 0.39, 100)
    sparse = np.float32([[2.1, 1.1, 1], [2.1, 1.1, 1.1]])
    kept = np.zeros(100)
    for seed in range(600):
        voxels = voxelise(np.concatenate((crowd[:50], sparse, crowd[50:])), CONFIG, rng=seed)
        assert len(voxels.points) == 37
        kept += np.isin(crowd[:, 2], voxels.points[:, 2])
    expected, spread = 600 * 0.35, np.sqrt(600 * 0.35 * 0.65)
    assert np.all(np.abs(kept - expected) < 4.5 * spread)
    assert abs(kept[:50].sum() - kept[50:].sum()) < 4 * spread * 10
    crowd = (
        np.random.default_rng(0)
        .uniform((0.01, 0.01, 0.01), (0.19, 0.19, 0.39), (200, 3))
        .astype(np.float32)
    )
    once, again, other = (
        voxelise(crowd, CONFIG),
        voxelise(crowd, CONFIG),
        voxelise(crowd, CONFIG, rng=1),
    )
    torch.testing.assert_close(once.points, again.points)
    assert not torch.equal(once.points, other.points)
    crowd = (
        np.random.default_rng(0)
        .uniform((0.01, 0.01, 0.01), (0.19, 0.19, 0.39), (35, 3))
        .astype(np.float32)
    )
    assert len(voxelise(crowd, CONFIG).points) == 35


@settings(deadline=None, max_examples=50)
@given(st.lists(st.one_of(st.integers(0, 5), st.integers(0, 2**40)), max_size=40))
def test_groups_are_those_of_sorting(numbers):
    rows = torch.tensor(numbers, dtype=torch.int64)
    groups = Groups.from_numbers(rows)
    distinct, inverse, counts = torch.unique(rows, return_inverse=True, return_counts=True)
    assert groups.number.tolist() == distinct.tolist()
    assert groups.of_rows().tolist() == inverse.tolist()
    assert groups.counts().tolist() == counts.tolist()
    assert groups.order.tolist() == torch.argsort(rows, stable=True).tolist()
    assert groups.begin.tolist() == (torch.cumsum(counts, 0) - counts).tolist()
