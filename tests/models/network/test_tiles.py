"""`PlacedClouds`: the voxels of unions are those of their points, thinned where they are crowded,
tile by tile."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from models.config import VoxelNetConfig, road_users
from models.network import tiles
from models.network.grid import voxelise
from models.network.sparse import SparseVoxelNet
from models.network.tiles import PlacedClouds, TiledVoxelNet, tileable

CONFIG = VoxelNetConfig.light((0.0, 0.0, 38.4, 9.6), max_points=4)
UNIONS = np.array(list(np.ndindex(*(2,) * 6)), bool)


@pytest.fixture(scope="module")
def clouds():
    """Two heaps of some hundred points in few voxels, each of several clouds that overlap, and
    somebody far off."""
    rng = np.random.default_rng(2)
    heaps = [
        rng.normal(at, (0.2, 0.2, 0.4), (60, 3)) for at in [(5, 5, 1.5)] * 3 + [(21, 5, 1.5)] * 2
    ]
    return [
        torch.from_numpy(heap.astype(np.float32))
        for heap in (*heaps, rng.normal((35, 4, 1), 0.5, (9, 3)))
    ]


def together(clouds, union):
    return torch.cat(
        [torch.zeros(0, 3), *(cloud for cloud, among in zip(clouds, union, strict=True) if among)]
    )


def left(placed, union, thinning, dropped):
    rows, points = np.flatnonzero(union[placed.cloud]), len(placed.points)
    of_it = dropped[dropped // points == thinning] % points
    return torch.from_numpy(rows if thinning == 0 else rows[~np.isin(rows, of_it)])


def test_crowded_voxels_lose_the_same_points_in_tiles_and_batches(clouds):
    placed = PlacedClouds.from_clouds(clouds, CONFIG)
    thinning, dropped = placed.find_crowded(UNIONS, 4)
    assert placed.counts().tolist() == [60] * 5 + [9]
    for union, number in zip(UNIONS, thinning, strict=True):
        kept = voxelise(together(clouds, union), CONFIG).points
        torch.testing.assert_close(
            placed.points[left(placed, union, number, dropped)], kept, rtol=0, atol=0
        )
    assert len(np.unique(thinning)) > 20
    assert (thinning[~UNIONS[:, :5].any(axis=1)] == 0).all()
    np.testing.assert_array_equal(thinning[::2], thinning[1::2])  # with and without who is far off
    placed = PlacedClouds.from_clouds(clouds, CONFIG)
    thinning, dropped = placed.find_crowded(UNIONS, 4)
    some = [63, 1, 0, 40]
    rows = [left(placed, UNIONS[k], thinning[k], dropped) for k in some]
    item = torch.cat([torch.full((len(each),), number) for number, each in enumerate(rows)])
    batch = placed.batch(torch.cat(rows), item, len(some), CONFIG)
    for number, k in enumerate(some):
        alone, own = voxelise(together(clouds, UNIONS[k]), CONFIG), batch.cells[:, 0] == number
        torch.testing.assert_close(batch.cells[own, 1:], alone.cells[:, 1:])
        torch.testing.assert_close(batch.points[item == number], alone.points)
        torch.testing.assert_close(
            batch.cells[batch.voxel[item == number], 1:], alone.cells[alone.voxel, 1:]
        )


def test_a_tile_has_its_points_and_those_of_the_columns_before_it():
    rng = np.random.default_rng(0)
    clouds = [
        torch.from_numpy(rng.uniform((0, 0, 0.1), (38.4, 9.6, 3.9), (n, 3)).astype(np.float32))
        for n in (300, 0, 200)
    ]
    placed = PlacedClouds.from_clouds(clouds, CONFIG)
    by_tile = placed.by_tile((8, 2), 24, 2)
    tiles = np.arange(16)
    unions = np.array([[1, 0, 0], [0, 1, 1], [1, 1, 1], [0, 0, 0]], bool)[tiles % 4]
    rows, item = by_tile.rows(tiles, unions)
    column = placed.cells[:, :2]
    for tile, union in zip(tiles, unions, strict=True):
        low = torch.tensor([tile // 2, tile % 2]) * 24
        there = ((column >= low - 2) & (column < low + 24)).all(1) & torch.from_numpy(union)[
            placed.cloud
        ]
        assert rows[item == tile].tolist() == torch.nonzero(there)[:, 0].tolist()


NARROW = {"voxel_width": 8, "column_width": 8, "rpn_widths": (8, 16, 16), "upsample_width": 8}
AREAS = {
    "smaller than a tile": (-4.0, -3.2, 4.0, 4.8),
    "one tile": (0.0, 0.0, 9.6, 9.6),
    "whole tiles": (-9.6, 0.0, 19.2, 9.6),
    "a part of a tile at each end": (-20.0, -8.0, 6.4, 14.4),
}


def light(area, **more):
    return VoxelNetConfig.light(area, **(NARROW | more))


def drawn(config, count, seed=0, n=160):
    """Clouds that reach a part of the area each, some of which overlap; the last one has no
    point."""
    rng = np.random.default_rng(seed)
    xmin, ymin, xmax, ymax = config.area
    centres = rng.uniform((xmin, ymin), (xmax, ymax), (count - 1, 2))
    clouds = [
        np.column_stack([rng.normal(at, 2.0, (n, 2)), rng.uniform(-0.3, 4.3, n)]) for at in centres
    ]
    return [torch.from_numpy(cloud.astype(np.float32)) for cloud in (*clouds, np.zeros((0, 3)))]


def whole_maps(network, clouds, unions):
    config = network.config
    tiled = TiledVoxelNet(network)
    (rows, columns), size = config.map_shape, tiled.size
    grid = [-(-cells // size) for cells in config.map_shape]
    found, entries_there = {}, 0
    for some, entries, predictions in tiled(tiled.plan(clouds, unions)):
        parts = list(predictions)
        joined = [
            None if m[0] is None else torch.cat(m)
            for m in zip(*(part.maps.everywhere() for part in parts), strict=True)
        ]
        corner = torch.cat([each.corner for each in parts])
        assert [each.first for each in parts] == list(
            np.cumsum([0, *(len(each.corner) for each in parts[:-1])])
        )
        entries_there += len(entries.tile)
        for union, of in zip(np.arange(len(unions))[some], entries.entry.T, strict=True):
            for number, maps in enumerate(joined):
                if maps is None:
                    continue
                full = torch.full((maps.shape[1], grid[0] * size, grid[1] * size), torch.nan)
                for entry in of:
                    x, y = corner[entry]
                    full[:, x : x + size, y : y + size] = maps[entry]
                found[union, number] = full[:, :rows, :columns]
    return found, entries_there


def assert_maps_are_those_of_the_network(network, clouds, unions):
    found, entries = whole_maps(network, clouds, unions)
    for union, row in enumerate(unions):
        points = torch.cat(
            [torch.zeros(0, 3), *(cloud for cloud, among in zip(clouds, row, strict=True) if among)]
        )
        for number, maps in enumerate(network(voxelise(points, network.config))):
            if maps is not None:
                torch.testing.assert_close(found[union, number], maps[0], atol=1e-4, rtol=0)
    return entries


@pytest.mark.parametrize("name", AREAS)
def test_maps_of_every_union_are_those_of_its_points(name, trained):
    network = SparseVoxelNet(trained(light(AREAS[name])))
    clouds = drawn(network.config, 4)
    assert_maps_are_those_of_the_network(
        network, clouds, np.array(list(np.ndindex(2, 2, 2, 2)), bool)
    )


def test_several_classes_crowded_voxels_and_many_clouds(trained):
    config = light(
        (-10.0, -10.0, 12.0, 10.0), **road_users(), rpn_layers=((0, 1, 1), (0, 1, 2), (0, 1))
    )
    network = SparseVoxelNet(trained(config))
    clouds = drawn(config, 70, n=12)
    unions = np.random.default_rng(1).random((9, 70)) < 0.3
    unions[1] = unions[0]
    unions[1, [0, 35, 68]] ^= True  # they differ by clouds of each word of the number
    assert_maps_are_those_of_the_network(network, clouds, unions)
    # Two heaps of some hundred points in few voxels, each of several clouds that overlap, and
    # somebody far off.
    config = replace(light((0.0, 0.0, 4 * 9.6, 9.6)), max_points=4)
    rng = np.random.default_rng(2)
    heaps = [
        rng.normal(at, (0.2, 0.2, 0.4), (60, 3)) for at in [(5, 5, 1.5)] * 3 + [(21, 5, 1.5)] * 2
    ]
    clouds = [
        torch.from_numpy(heap.astype(np.float32))
        for heap in (*heaps, rng.normal((35, 4, 1), 0.5, (9, 3)))
    ]
    unions = rng.permutation(np.array(list(np.ndindex(*(2,) * 6)), bool))[:40]
    network = SparseVoxelNet(trained(config))
    assert len(TiledVoxelNet(network).plan(clouds, unions).dropped)
    assert_maps_are_those_of_the_network(network, clouds, unions)


def test_what_memory_does_not_hold_comes_in_parts(trained, limits):
    network = SparseVoxelNet(trained(light(AREAS["whole tiles"])))
    clouds = drawn(network.config, 6)
    unions = np.random.default_rng(3).permutation(np.array(list(np.ndindex(*(2,) * 6)), bool))
    at_once = assert_maps_are_those_of_the_network(network, clouds, unions)
    limits(tiles, MAX_ENTRIES=8)
    limits(tiles, MAX_BATCH_TILES=3)
    assert assert_maps_are_those_of_the_network(network, clouds, unions) > at_once


def test_what_unions_see_alike_is_computed_once(trained):
    """Eight clouds, each in the middle of a tile of its own that is far from the next: 255 unions,
    8 tiles with points and the 8 about each that its points reach, of which each has two values."""
    network = SparseVoxelNet(trained(light((0.0, 0.0, 3 * 9.6, 24 * 9.6))))
    middles = [(1.5 * 9.6, (3 * k + 1.5) * 9.6) for k in range(8)]
    clouds = [torch.tensor([[x, y, 1.0], [x, y + 0.3, 2.0]]) for x, y in middles]
    unions = np.array(list(np.ndindex(*(2,) * 8)), bool)
    tiled = TiledVoxelNet(network)
    plan = tiled.plan(clouds, unions)
    assert tiled.gains(plan)
    assert tiled.plan_gain(clouds, unions) is not None
    assert tiled.plan_gain(clouds, unions[:1]) is None
    # one value for each tile is the least, so four unions never gain
    assert tiled.plan_gain(clouds[:1], unions[:4, :1]) is None
    assert not tiled.gains(tiled.plan(clouds[:1], unions[:4, :1]))
    assert not tiled.gains(plan.part(slice(1)))
    ((some, entries, predictions),) = tiled(plan)
    computed = sum(len(each.corner) for each in predictions)
    assert (some.start, entries.entry.shape) == (0, (72, 256))
    assert computed == len(entries.tile) <= 2 * 72
    assert computed >= 72 + 8


@pytest.mark.parametrize(("rows", "columns", "stride"), [(7, 9, 1), (8, 6, 2), (7, 5, 2)])
def test_cells_spread_as_a_convolution_of_ones_does(rows, columns, stride):
    reach = np.random.default_rng(1).random((3, rows, columns)) < 0.1
    counts = torch.nn.functional.conv2d(
        torch.from_numpy(reach).float()[:, None], torch.ones(1, 1, 3, 3), None, stride, 1
    )
    assert (tiles.spread_reach(reach, stride) == (counts[:, 0] > 0).numpy()).all()


@pytest.mark.parametrize(
    ("config", "whether"),
    [
        *((light((0, 0, 8, 8)), True), (light((0, 0, 8, 8), head3x3=16), False)),
        (light((0, 0, 8, 8), upsample="concatenate"), False),
        (VoxelNetConfig.from_paper("tjunction", area=(-4.0, -4.0, 4.0, 4.0)), False),
    ],
)
def test_which_networks_it_computes(config, whether, trained):
    assert tileable(SparseVoxelNet(trained(config))) == whether
