"""Grids of angles: evenly spread unit rays, what lies between them, and windows that leave no ray out."""

import numpy as np
import pytest

from toolkit.boxes import corners
from toolkit.sensors.angle_grid import AngleGrid, grid_windows, in_grid, unit_rays

TURN = AngleGrid(rows=16, columns=90, up=0.2, down=-0.5, width=2 * np.pi, max_range=60.0)
SECTOR = AngleGrid(rows=24, columns=60, up=0.25, down=-0.25, width=2.0, max_range=60.0)
ROW = AngleGrid(rows=1, columns=36, up=0.0, down=0.0, width=2 * np.pi, max_range=60.0)
grids = pytest.mark.parametrize("grid", [TURN, SECTOR, ROW], ids=["turn", "sector", "row"])


@grids
def test_rays_are_unit_vectors_from_the_top_right_sideways(grid):
    rays = unit_rays(grid).astype(np.float64)
    assert rays.shape == (grid.rows, grid.columns, 3)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1, atol=1e-6)
    elevation, azimuth = np.arcsin(rays[..., 2]), np.unwrap(np.arctan2(rays[..., 1], rays[..., 0]), axis=1)
    np.testing.assert_allclose(elevation[[0, -1]].T, np.tile([grid.up, grid.down], (grid.columns, 1)), atol=1e-6)
    np.testing.assert_allclose(np.diff(azimuth, axis=1), grid.width / grid.columns, atol=1e-5)
    np.testing.assert_allclose(azimuth.mean(axis=1), 0, atol=1e-5)


def test_rays_are_made_once_and_nobody_may_write_to_them():
    assert unit_rays(TURN) is unit_rays(TURN._replace())
    with pytest.raises(ValueError, match="read-only"):
        unit_rays(TURN)[0, 0] = 1


@pytest.mark.parametrize(
    ("azimuth", "elevation", "distance", "inside"),
    [(0, 0, 10, True), (0.99, 0, 10, True), (1.01, 0, 10, False), (0, 0.26, 10, False), (0, -0.24, 10, True),
     (3.1, 0, 10, False), (0, 0, 59.9, True), (0, 0, 60.1, False)],
)  # fmt: skip
def test_what_lies_in_a_sector(azimuth, elevation, distance, inside):
    point = distance * np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    assert in_grid(SECTOR, point[None]).tolist() == [inside]


@grids
def test_every_ray_that_meets_a_box_lies_in_one_of_its_windows(grid):
    rng = np.random.default_rng(3)
    places = np.column_stack([rng.uniform(-15, 15, (60, 2)), rng.uniform(-4, 4, 60)])
    boxes = np.column_stack([places, rng.uniform(1, 6, (60, 3)), rng.uniform(-3, 3, 60)])
    windows = grid_windows(grid, corners(boxes))
    assert (windows[:, 1] < windows[:, 2]).all()
    assert (windows[:, 3] < windows[:, 4]).all()
    rays = unit_rays(grid).astype(np.float64)
    met = 0
    for number, (x, y, z, *size, yaw) in enumerate(boxes):
        turn = np.array([[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        origin, direction = -(turn @ [x, y, z]), rays @ turn.T
        half = np.array(size) / 2
        with np.errstate(divide="ignore"):
            low, high = np.sort([(-half - origin) / direction, (half - origin) / direction], axis=0)
        meets = (low.max(axis=-1) < high.min(axis=-1)) & (high.min(axis=-1) > 0)
        covered = np.zeros(meets.shape, bool)
        for _, top, bottom, left, right in windows[windows[:, 0] == number]:
            covered[top:bottom, left:right] = True
        assert covered[meets].all()
        met += meets.sum()
    assert met > 50


def test_what_is_out_of_range_has_no_window():
    assert len(grid_windows(TURN, corners(np.array([[99.0, 0, 0, 4, 2, 1.5, 0]])))) == 0
