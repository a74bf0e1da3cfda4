"""The solid-state lidar: a rectangle of angles, noise that grows. What any model can, it does in `test_sensor_seam`."""

import numpy as np
import pytest

from toolkit.bodies.fleet import catalogue
from toolkit.boxes import corners
from toolkit.geometry import invert, pose, transform
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.sensor import Sensor
from toolkit.sensors.solid_state_lidar import SolidStateLidar
from toolkit.sites.site import Site

LIDAR = SolidStateLidar(rows=25, columns=120)


def test_its_field_is_120_by_25_degrees():
    assert np.allclose(np.rad2deg([SolidStateLidar().horizontal_fov, SolidStateLidar().vertical_fov]), [120, 25])
    x, y, z = np.moveaxis(LIDAR.rays().astype(np.float64), -1, 0)
    azimuth, elevation = np.rad2deg(np.arctan2(y, x)), np.rad2deg(np.arcsin(z))
    assert np.allclose(elevation[[0, 12, 24]], [[12.5], [0.0], [-12.5]], atol=1e-4)
    assert np.allclose(azimuth[:, [0, -1]], [-59.5, 59.5], atol=1e-4)
    assert np.allclose(x**2 + y**2 + z**2, 1, atol=1e-6)


@pytest.mark.parametrize(
    ("azimuth", "elevation", "distance", "seen"),
    [(0, 0, 10, True), (59, 12, 10, True), (61, 0, 10, False), (0, -13, 10, False), (180, 0, 10, False),
     (0, 0, 149, True), (0, 0, 151, False)],
)  # fmt: skip
def test_what_is_in_view(azimuth, elevation, distance, seen):
    a, e = np.deg2rad([azimuth, elevation])
    point = distance * np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    assert LIDAR.in_view(point[None]).tolist() == [seen]


def test_noise_grows_with_the_range():
    model = SolidStateLidar(rows=100, columns=100, sigma=0.01, sigma_per_metre=0.001)
    near, far = (np.full(model.shape, metres, np.float32) for metres in (10.0, 90.0))
    assert (model.noisy(near, np.random.default_rng(0)) - near).std() == pytest.approx(0.02, rel=0.05)
    assert (model.noisy(far, np.random.default_rng(0)) - far).std() == pytest.approx(0.10, rel=0.05)
    assert not model.noisy(np.zeros(model.shape, np.float32), np.random.default_rng(0)).any()


def test_windows_are_small_and_leave_out_what_is_behind():
    sensor = Sensor("s", LIDAR, pose(0.0, 0.0, 1.0))
    boxes = np.array([[20.0, 0, 1, 2, 2, 2, 0], [-20, 0, 1, 2, 2, 2, 0], [-5, 40, 1, 2, 2, 2, 0]])
    found = LIDAR.windows(transform(invert(sensor.pose), corners(boxes)))
    assert found[:, 0].tolist() == [0]
    _, top, bottom, left, right = found[0]
    assert (bottom - top) * (right - left) < 250


def test_it_measures_the_ground_along_its_rays():
    sensor = Sensor("s", LIDAR, pose(0.0, 0.0, 4.0, yaw=1.0))
    found = Renderer(Site("flat", np.array([-30.0, -20, 30, 20])), catalogue(), (sensor,)).background[0]
    slope = LIDAR.rays()[..., 2]
    near = slope < -0.1
    assert np.allclose(found[near], -4.0 / slope[near], rtol=1e-3)
    assert not found[slope > 0].any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rows": 0}, "at least 1"),
        ({"columns": 1.5}, "columns must be a whole number, got 1.5"),
        ({"horizontal_fov": 120.0}, "deg2rad"),
        ({"vertical_fov": np.nan}, "vertical_fov must be a number, got nan"),
        ({"sigma": -1.0}, "sigma"),
        ({"sigma_per_metre": -0.1}, "sigma_per_metre"),
        ({"max_range": 0.0}, "max_range"),
    ],
)
def test_impossible_lidars_are_refused(change, message):
    # values of another type meet the shape checker first, where tests run with it
    with pytest.raises((ValueError, TypeError), match=f"{message}|Type-check error"):
        SolidStateLidar(**change)
