"""Clouds as range images: every point comes back or is counted."""

import numpy as np
import pytest

from toolkit.datasets.imaging.cloud_image import OUTSIDE_GRID, SHARED_CELL, image_of
from toolkit.datasets.imaging.lidar_grid import LidarGrid
from toolkit.datasets.sample import SensorCloud
from toolkit.geometry import pose, transform
from toolkit.sensors.row_lidar import RowLidar

MODEL = RowLidar((0.2, 0.1, 0.0, -0.3), columns=36)
SECTOR = RowLidar((0.1, 0.0), columns=10, azimuth_fov=1.0, heading=3.0)


def ray(row, column, model=MODEL):
    return model.rays()[row, column].astype(np.float64)


def along(*cells, model=MODEL):
    return np.array([distance * ray(row, column, model) for row, column, distance in cells]).astype(np.float32)


def test_an_image_and_back():
    rng = np.random.default_rng(0)
    image = np.where(rng.random(MODEL.shape) < 0.7, rng.uniform(2, 90, MODEL.shape), 0).astype(np.float32)
    points = (MODEL.rays() * image[..., None])[image > 0]
    order = rng.permutation(len(points))
    place = pose(5.0, 6.0, 7.0, yaw=1.0)
    world = SensorCloud("l", transform(place, points[order].astype(np.float64)).astype(np.float32), place, "world")
    for cloud in (SensorCloud("l", points[order], np.eye(4)), world):
        made = image_of(cloud, LidarGrid(MODEL))
        np.testing.assert_allclose(made.measurement, image, atol=1e-5)
        assert made.shown.all()
        assert made.left_out == {}
        np.testing.assert_array_equal(made.cells, np.flatnonzero(image > 0)[order])
        np.testing.assert_allclose(made.points, points[order], atol=2e-5)


def test_the_range_is_exact_and_the_direction_within_half_a_cell():
    rng = np.random.default_rng(1)
    azimuth = rng.uniform(-np.pi, np.pi, 30)
    points = np.stack([20 * np.cos(azimuth), 20 * np.sin(azimuth), np.zeros(30)], axis=1).astype(np.float32)
    made = image_of(SensorCloud("l", points, np.eye(4)), LidarGrid(MODEL))
    np.testing.assert_allclose(np.linalg.norm(made.points, axis=1), 20, rtol=1e-6)
    assert np.linalg.norm(points[made.shown] - made.points, axis=1).max() <= 20 * np.pi / 36
    assert made.shown.sum() + sum(made.left_out.values()) == 30


def test_of_points_in_a_cell_the_nearest_is_shown_and_the_others_are_counted():
    cloud = SensorCloud("l", along((1, 5, 30.0), (1, 5, 12.0), (1, 5, 20.0), (2, 5, 9.0)), np.eye(4))
    made = image_of(cloud, LidarGrid(MODEL))
    assert made.shown.tolist() == [False, True, False, True]
    assert made.left_out == {SHARED_CELL: 2}
    assert made.measurement[1, 5] == pytest.approx(12.0)
    assert made.measurement[2, 5] == pytest.approx(9.0)
    assert (made.measurement > 0).sum() == 2


def test_points_outside_are_counted():
    far = along((0, 0, 500.0), (3, 1, 10.0))
    high = np.array([[10 * np.cos(0.31), 0, 10 * np.sin(0.31)]], np.float32)  # 0.11 above the row, 0.1 to the next
    low = np.array([[10 * np.cos(0.5), 0, -10 * np.sin(0.5)]], np.float32)  # 0.2 below the row, 0.3 to the next
    made = image_of(SensorCloud("l", np.concatenate([far, high, low]), np.eye(4)), LidarGrid(MODEL))
    assert made.inside.tolist() == [False, True, False, True]
    assert made.left_out == {OUTSIDE_GRID: 2}
    assert made.cells.max() < 4 * 36


def test_a_sector_ends():
    azimuth = 3.0 + np.array([-0.52, -0.48, 0.0, 0.48, 0.52])  # on across the seam
    points = 10 * np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(5)], axis=1)
    made = image_of(SensorCloud("l", points.astype(np.float32), np.eye(4)), LidarGrid(SECTOR))
    assert made.inside.tolist() == [False, True, True, True, False]
    assert made.cells[1:4].tolist() == [10, 15, 19]


def test_rings_say_the_row_whatever_the_elevation():
    grid = LidarGrid(MODEL, rings=(7, 3, 9, 1))
    points = along((0, 4, 10.0), (0, 5, 10.0), (0, 6, 10.0))
    made = image_of(SensorCloud("l", points, np.eye(4), ring=np.array([9, 1, 8])), grid)
    assert made.inside.tolist() == [True, True, False]
    assert made.cells[:2].tolist() == [2 * 36 + 4, 3 * 36 + 5]
    assert image_of(SensorCloud("l", points, np.eye(4)), grid).cells.tolist() == [4, 5, 6]


def test_a_cloud_without_points_is_an_empty_image():
    made = image_of(SensorCloud("l", np.zeros((0, 3), np.float32), np.eye(4)), LidarGrid(MODEL))
    assert not made.measurement.any()
    assert made.points.shape == (0, 3)
    one = LidarGrid(RowLidar((0.0,), columns=4))
    assert image_of(SensorCloud("l", np.array([[5.0, 0, 3]], np.float32), np.eye(4)), one).inside.tolist() == [True]
