"""Rows and columns of lidars, found in clouds whose rows and columns are known."""

import numpy as np
import pytest

from toolkit.calibration import lidar_grid
from toolkit.calibration.cloud_image import OUTSIDE_GRID, SHARED_CELL, rasterize_cloud
from toolkit.calibration.lidar_grid import LidarGrid, compute_angles, find_grid, nearest_row
from toolkit.frame import SensorCloud
from toolkit.geometry import pose, transform
from toolkit.sensors.models import RowLidar

ROWS = np.deg2rad([8.0, 3.0, 1.0, 0.0, -1.0, -4.0, -12.0])
PLACE = pose(30.0, -4.0, 5.0, yaw=2.0, pitch=0.1)


def cloud(elevation, azimuth, *, ring=None, seed=0, frame="sensor", name="l"):
    ranges = np.random.default_rng(seed).uniform(5, 60, len(elevation))
    flat = np.cos(elevation)
    rays = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=1)
    points = rays * ranges[:, None]
    points = points if frame == "sensor" else transform(PLACE, points)
    return SensorCloud(name, points.astype(np.float32), PLACE, frame, ring=ring)


def turning(columns=360, noise=0.0, seed=0, lost=0.3, phase=0.5, **given):
    """A turn of seven rows, from which some returns are lost; the rings are numbered in another
    order; phase: of the azimuths, in columns."""
    rng = np.random.default_rng(seed)
    row, column = (each.ravel() for each in np.meshgrid(np.arange(7), np.arange(columns)))
    there = rng.random(len(row)) > lost
    row, column = row[there], column[there]
    azimuth = (column + phase) * 2 * np.pi / columns - np.pi
    elevation = ROWS[row] + rng.normal(0, noise, len(row))
    rings = {"ring": (10 + (3 * row) % 7).astype(np.int64)} if given.pop("rings", False) else {}
    return cloud(elevation, azimuth, seed=seed, **rings, **given)


def test_rows_are_nearest_angles_found_in_scattered_elevations():
    elevation, azimuth, distance = compute_angles(np.array([[0.0, 3.0, 4.0], [-2.0, 0.0, 0.0]]))
    np.testing.assert_allclose(elevation, [np.arctan2(4, 3), 0])
    np.testing.assert_allclose(azimuth, [np.pi / 2, np.pi])
    np.testing.assert_allclose(distance, [5, 2])
    rows = np.array([0.2, 0.0, -0.4])
    assert nearest_row(np.array([0.9, 0.11, 0.09, -0.19, -0.21, -2.0]), rows).tolist() == [
        0,
        0,
        1,
        1,
        2,
        2,
    ]
    assert find_grid([turning(phase=k / 18, seed=k) for k in range(18)]).model.heading == 0
    grid = find_grid([turning(noise=0.001, seed=k) for k in range(3)])
    np.testing.assert_allclose(grid.model.elevations, ROWS, atol=3e-4)
    every = turning(rings=True)
    ring = np.where(np.arange(len(every.points)) % 2, every.ring, every.ring + 100)
    grid = find_grid([SensorCloud("l", every.points, np.eye(4), ring=ring)])
    assert len(grid.model.elevations) == 14
    assert set(grid.rings) == {*range(10, 17), *range(110, 117)}
    far = turning()
    stretched = SensorCloud("l", far.points * 10, np.eye(4))
    farthest = np.linalg.norm(stretched.points, axis=1).max()
    assert find_grid([stretched]).model.max_range == np.ceil(1.25 * farthest)


@pytest.mark.parametrize("frame", ["sensor", "world"])
@pytest.mark.parametrize("rings", [True, False])
def test_a_spinning_lidar(rings, frame):
    grid = find_grid([turning(rings=rings, seed=k, frame=frame) for k in range(3)])
    np.testing.assert_allclose(grid.model.elevations, ROWS, atol=2e-5)
    assert grid.model.columns == 360
    assert grid.model.azimuth_fov == pytest.approx(2 * np.pi)
    assert grid.rings == (tuple((10 + (3 * np.arange(7)) % 7).tolist()) if rings else ())
    assert grid.model.max_range == 200.0


@pytest.mark.parametrize("columns", [360, 361])
@pytest.mark.parametrize("phase", [0.0, 0.3, 0.5, 0.9])
def test_azimuths_are_in_the_middle_of_their_columns(phase, columns):
    model = find_grid([turning(columns, phase=phase, seed=k) for k in range(2)]).model
    assert model.columns == columns
    own = (
        np.arctan2(model.rays()[0, :, 1], model.rays()[0, :, 0]) * columns / (2 * np.pi)
        - phase
        - columns / 2
    )
    np.testing.assert_allclose(own - np.round(own), 0, atol=2e-3)
    assert abs(model.heading) <= np.pi / columns + 1e-9


def test_a_grid_across_the_seam_is_found():
    row, column = (each.ravel() for each in np.meshgrid(np.arange(20), np.arange(50)))
    elevation, azimuth = np.deg2rad(5 - 0.8 * row), np.deg2rad(160.0 + 0.8 * column)  # on to -160.8
    grid = find_grid([cloud(elevation, azimuth, seed=k) for k in range(2)])
    np.testing.assert_allclose(
        grid.model.elevations, np.deg2rad(5 - 0.8 * np.arange(20)), atol=1e-5
    )
    assert grid.model.columns == 50
    assert np.rad2deg(grid.model.azimuth_fov) == pytest.approx(40.0, abs=1e-3)
    assert np.rad2deg(grid.model.heading) == pytest.approx(179.6, abs=1e-3)


def test_points_without_a_pattern_get_even_steps():
    rng = np.random.default_rng(0)
    clouds = [
        cloud(rng.uniform(-0.3, 0.2, 6000), rng.uniform(-0.5, 0.5, 6000), seed=k) for k in range(2)
    ]
    grid = find_grid(clouds)
    steps = -np.diff(grid.model.elevations)
    np.testing.assert_allclose(steps, steps[0])
    assert steps[0] == pytest.approx(grid.model.azimuth_fov / grid.model.columns)
    assert 0.4 < 6000 / (grid.model.shape[0] * grid.model.shape[1]) < 1.6
    assert grid.model.elevations[0] >= 0.2 - 1e-3
    assert grid.model.elevations[-1] <= -0.3 + 1e-3


def test_rings_choose_the_rows_of_points():
    grid = LidarGrid(MODEL, rings=(7, 3, 9, 1))
    points = along((0, 4, 10.0), (0, 5, 10.0), (0, 6, 10.0))
    made = rasterize_cloud(SensorCloud("l", points, np.eye(4), ring=np.array([9, 1, 8])), grid)
    assert made.inside.tolist() == [True, True, False]
    assert made.cells[:2].tolist() == [2 * 36 + 4, 3 * 36 + 5]
    assert rasterize_cloud(SensorCloud("l", points, np.eye(4)), grid).cells.tolist() == [4, 5, 6]


def test_the_nearest_point_of_a_cell_is_shown():
    points_cloud = SensorCloud(
        "l", along((1, 5, 30.0), (1, 5, 12.0), (1, 5, 20.0), (2, 5, 9.0)), np.eye(4)
    )
    made = rasterize_cloud(points_cloud, LidarGrid(MODEL))
    assert made.shown.tolist() == [False, True, False, True]
    assert made.left_out == {SHARED_CELL: 2}
    assert made.measurement[1, 5] == pytest.approx(12.0)
    assert made.measurement[2, 5] == pytest.approx(9.0)
    assert (made.measurement > 0).sum() == 2


def test_points_beyond_range_and_rows_are_left_out():
    far = along((0, 0, 500.0), (3, 1, 10.0))
    # 0.11 above the row, 0.1 to the next
    high = np.array([[10 * np.cos(0.31), 0, 10 * np.sin(0.31)]], np.float32)
    # 0.2 below the row, 0.3 to the next
    low = np.array([[10 * np.cos(0.5), 0, -10 * np.sin(0.5)]], np.float32)
    made = rasterize_cloud(
        SensorCloud("l", np.concatenate([far, high, low]), np.eye(4)), LidarGrid(MODEL)
    )
    assert made.inside.tolist() == [False, True, False, True]
    assert made.left_out == {OUTSIDE_GRID: 2}
    assert made.cells.max() < 4 * 36


def test_points_beside_the_sector_are_outside():
    azimuth = 3.0 + np.array([-0.52, -0.48, 0.0, 0.48, 0.52])  # on across the seam
    points = 10 * np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(5)], axis=1)
    made = rasterize_cloud(
        SensorCloud("l", points.astype(np.float32), np.eye(4)), LidarGrid(SECTOR)
    )
    assert made.inside.tolist() == [False, True, True, True, False]
    assert made.cells[1:4].tolist() == [10, 15, 19]


def test_what_is_no_image_is_refused(limits):
    with pytest.raises(
        ValueError, match="0 points of the sensor say nothing of its rows, 100 are needed"
    ):
        find_grid([])
    with pytest.raises(ValueError, match="3 points of l say nothing"):
        find_grid([SensorCloud("l", np.full((3, 3), 9.0, np.float32), np.eye(4))])
    limits(lidar_grid, MAX_GRID_PX=2519)
    with pytest.raises(
        ValueError, match="would have 7 x 360 pixels: are its points in its own frame"
    ):
        find_grid([turning()])


MODEL = RowLidar((0.2, 0.1, 0.0, -0.3), columns=36)
SECTOR = RowLidar((0.1, 0.0), columns=10, azimuth_fov=1.0, heading=3.0)


def along(*cells, model=MODEL):
    rays = model.rays().astype(np.float64)
    return np.array([distance * rays[row, column] for row, column, distance in cells]).astype(
        np.float32
    )


def test_images_there_and_back_are_exact_in_range():
    rng = np.random.default_rng(0)
    image = np.where(rng.random(MODEL.shape) < 0.7, rng.uniform(2, 90, MODEL.shape), 0).astype(
        np.float32
    )
    points = (MODEL.rays() * image[..., None])[image > 0]
    order = rng.permutation(len(points))
    place = pose(5.0, 6.0, 7.0, yaw=1.0)
    world = SensorCloud(
        "l", transform(place, points[order].astype(np.float64)).astype(np.float32), place, "world"
    )
    for cloud in (SensorCloud("l", points[order], np.eye(4)), world):
        made = rasterize_cloud(cloud, LidarGrid(MODEL))
        np.testing.assert_allclose(made.measurement, image, atol=1e-5)
        assert made.shown.all()
        assert made.left_out == {}
        np.testing.assert_array_equal(made.cells, np.flatnonzero(image > 0)[order])
        np.testing.assert_allclose(made.points, points[order], atol=2e-5)
    rng = np.random.default_rng(1)
    azimuth = rng.uniform(-np.pi, np.pi, 30)
    points = np.stack([20 * np.cos(azimuth), 20 * np.sin(azimuth), np.zeros(30)], axis=1).astype(
        np.float32
    )
    made = rasterize_cloud(SensorCloud("l", points, np.eye(4)), LidarGrid(MODEL))
    np.testing.assert_allclose(np.linalg.norm(made.points, axis=1), 20, rtol=1e-6)
    assert np.linalg.norm(points[made.shown] - made.points, axis=1).max() <= 20 * np.pi / 36
    assert made.shown.sum() + sum(made.left_out.values()) == 30
    made = rasterize_cloud(
        SensorCloud("l", np.zeros((0, 3), np.float32), np.eye(4)), LidarGrid(MODEL)
    )
    assert not made.measurement.any()
    assert made.points.shape == (0, 3)
    one = LidarGrid(RowLidar((0.0,), columns=4))
    assert rasterize_cloud(
        SensorCloud("l", np.array([[5.0, 0, 3]], np.float32), np.eye(4)), one
    ).inside.tolist() == [True]
