"""The spinning lidar: rows, sweep, and boxes across the seam of its turn. What any model can: `test_model`."""

import numpy as np
import pytest

from toolkit.boxes import corners
from toolkit.sensors.spinning_lidar import SpinningLidar

LIDAR = SpinningLidar(channels=16, azimuth_step=0.05)


@pytest.mark.parametrize(
    ("step", "sweep", "columns"), [(np.deg2rad(0.4), 2 * np.pi, 900), (0.1, 1.0, 10), (1.0, 1.0, 1), (0.4, 1.0, 2)]
)
def test_columns_are_the_sweep_in_steps(step, sweep, columns):
    assert SpinningLidar(azimuth_step=step, azimuth_fov=sweep).shape == (64, columns)


def test_its_field_is_what_its_rows_and_its_sweep_span():
    lidar = SpinningLidar(fov_up=0.2, fov_down=-0.3, azimuth_fov=1.5)
    assert (lidar.horizontal_fov, lidar.vertical_fov) == (1.5, 0.5)


@pytest.mark.parametrize(
    ("point", "seen"),
    [((10, 0, 0), True), ((-10, 0, 0), True), ((0, 10, 0), True), ((0, 0, 10), False), ((10, 0, 3), False),
     ((119, 0, 0), True), ((121, 0, 0), False)],
)  # fmt: skip
def test_it_looks_all_around_between_its_rows(point, seen):
    assert LIDAR.in_view(np.array([point], float)).tolist() == [seen]


def test_a_box_behind_it_lies_on_both_sides_of_the_seam():
    windows = LIDAR.windows(corners(np.array([[-10.0, 0, 0, 4, 2, 1.5, 0], [10, 0, 0, 4, 2, 1.5, 0]])))
    assert windows[:, 0].tolist().count(0) == 2
    assert windows[:, 0].tolist().count(1) == 1
    assert {0} <= set(windows[windows[:, 0] == 0, 3].tolist())
    assert LIDAR.shape[1] in windows[windows[:, 0] == 0, 4].tolist()


def test_its_noise_is_the_same_at_every_range():
    assert LIDAR.deviation(np.zeros(LIDAR.shape, np.float32)) == np.float32(LIDAR.sigma)
