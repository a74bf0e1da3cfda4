import numpy as np
import pytest

from placement_env.candidates.outlook.ray_density import AZIMUTH_BINS, BIN, bins, ray_angles, ray_density
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.solid_state_lidar import SolidStateLidar
from toolkit.sensors.spinning_lidar import SpinningLidar


def solid_angles() -> np.ndarray:
    edges = np.sin(np.arange(91) * BIN - np.pi / 2)
    return np.tile(BIN * np.diff(edges), (AZIMUTH_BINS, 1))


@pytest.mark.parametrize("model", [DepthCamera(), SpinningLidar(), SolidStateLidar(), DepthCamera(stride=1, width=90)])
def test_all_rays_are_counted_once(model):
    assert (ray_density(model) * solid_angles()).sum() == pytest.approx(np.prod(model.shape), rel=1e-3)
    assert ray_density(model) is ray_density(model)


def test_a_camera_looks_ahead_and_a_lidar_round():
    camera, lidar = (ray_density(model) for model in (DepthCamera(), SpinningLidar()))
    ahead, level = AZIMUTH_BINS // 2, 45
    assert camera[ahead, level] > 1000
    assert not camera[0].any()
    assert camera[ahead + 22].any()  # 44 degrees to the left
    assert not camera[ahead + 23].any()
    assert lidar.any(axis=1).all()
    assert not lidar[:, 60:].any()  # 30 degrees up and more
    assert lidar[:, 30].all()  # 29 degrees down


def test_angles_and_bins():
    azimuth, elevation = ray_angles(np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [1, 0, -1]]))
    assert azimuth.tolist() == pytest.approx([0, np.pi / 2, np.pi, 0])
    assert elevation.tolist() == pytest.approx([0, 0, 0, -np.pi / 4])
    column, row = bins(azimuth, elevation)
    assert column.tolist() == [90, 135, 0, 90]
    assert row.tolist() == [45, 45, 45, 22]
