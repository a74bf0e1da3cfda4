import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from toolkit.geometry import look, pose, transform
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.model import returned
from toolkit.sensors.sensor import Sensor
from toolkit.sensors.spinning_lidar import SpinningLidar

CAMERA = DepthCamera()
LIDAR = SpinningLidar(channels=16)


def test_default_camera_is_the_papers():
    assert CAMERA.shape == (150, 200)
    np.testing.assert_allclose(CAMERA.intrinsic, [[200, 0, 200], [0, 200, 150], [0, 0, 1]])
    assert CAMERA.sigma == 0.015


def test_camera_ray_is_equation_2():
    """X = (u - cu) d / f, Y = (v - cv) d / f, Z = d, on every second pixel of the full image."""
    depth = 7.5
    points = CAMERA.rays() * np.float32(depth)
    for row, column in ((0, 0), (149, 199), (75, 100), (31, 180)):
        u, v = 2 * column, 2 * row
        np.testing.assert_allclose(points[row, column], [(u - 200) / 200 * depth, (v - 150) / 200 * depth, depth])


def test_points_project_back_onto_their_pixels():
    camera = DepthCamera(width=64, height=41, stride=3, fov=1.2, centre=(30.0, 22.5))
    pixels = camera.rays() @ camera.intrinsic.T
    rows, columns = camera.shape
    u, v = np.meshgrid(np.arange(columns) * 3, np.arange(rows) * 3)
    np.testing.assert_allclose(pixels[..., 0], u, atol=1e-4)
    np.testing.assert_allclose(pixels[..., 1], v, atol=1e-4)


def test_world_rays_are_equation_1():
    sensor = Sensor("s", CAMERA, look((3.0, -2.0, 5.2), heading=2.0, tilt=0.3))
    depth = np.random.default_rng(0).uniform(1, 80, CAMERA.shape)
    in_sensor = depth[..., None] * CAMERA.rays().astype(np.float64)
    expected = transform(sensor.pose, in_sensor.reshape(-1, 3))
    np.testing.assert_allclose((sensor.world_rays * depth.ravel()).T + sensor.position, expected, atol=1e-4)


def test_level_camera_looks_along_its_heading_with_the_ground_below():
    sensor = Sensor("s", CAMERA, look((0.0, 0.0, 5.0), heading=np.pi / 2))
    rays = sensor.world_rays.reshape(3, *CAMERA.shape)
    np.testing.assert_allclose(rays[:, 75, 100], [0, 1, 0], atol=1e-6)
    assert rays[2, -1, 100] < 0 < rays[2, 0, 100]
    assert rays[0, 75, 0] < 0 < rays[0, 75, -1]  # looking north, the image's left is west


def test_lidar_rays_are_unit_vectors_top_row_first():
    lidar = SpinningLidar(channels=3, fov_up=0.2, fov_down=-0.4, azimuth_step=np.pi / 2)
    rays = lidar.rays()
    assert rays.shape == (3, 4, 3) == (*lidar.shape, 3)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1, rtol=1e-6)
    np.testing.assert_allclose(rays[:, 0, 2], np.sin([0.2, -0.1, -0.4]), rtol=1e-6)
    azimuth = np.arctan2(rays[0, :, 1], rays[0, :, 0])
    np.testing.assert_allclose(np.diff(azimuth), np.pi / 2, rtol=1e-6)


def test_lidar_of_a_sector_looks_forward_evenly():
    rays = SpinningLidar(channels=1, fov_up=0.0, fov_down=0.0, azimuth_step=0.1, azimuth_fov=1.0).rays()
    assert rays.shape == (1, 10, 3)
    np.testing.assert_allclose(rays[0, :, 1], -rays[0, ::-1, 1], atol=1e-6)
    assert (rays[..., 0] > np.cos(0.5)).all()


@pytest.mark.parametrize("model", [CAMERA, LIDAR])
def test_what_returned_nothing_stays_nothing_under_noise(model):
    nothing = np.zeros(model.shape, np.float32)
    nothing[0, :5] = [np.nan, np.inf, -np.inf, -3.0, model.max_range]
    assert not returned(nothing, model.max_range).any()
    assert not model.noisy(nothing, np.random.default_rng(0)).any()


@pytest.mark.parametrize("model", [CAMERA, LIDAR])
def test_noise_has_the_models_deviation_and_is_reproducible(model):
    clean = np.full(model.shape, 20.0, np.float32)
    noisy = model.noisy(clean, np.random.default_rng(3))
    assert noisy.dtype == np.float32
    assert abs((noisy - clean).std() / model.sigma - 1) < 0.05
    assert abs((noisy - clean).mean()) < model.sigma / 20
    np.testing.assert_array_equal(noisy, model.noisy(clean, np.random.default_rng(3)))


def test_models_and_sensors_compare_and_hash_by_value():
    one, other = (Sensor("s", DepthCamera(), pose(1.0, 2.0, 3.0)) for _ in range(2))
    assert one == other
    assert hash(one) == hash(other)
    assert one != Sensor("s", DepthCamera(), pose(1.0, 2.0, 4.0)) != "s"


def test_sensor_keeps_its_own_pose():
    mine = pose(1.0, 2.0, 3.0)
    sensor = Sensor("s", CAMERA, mine)
    mine[0, 3] = 99
    assert sensor.position[0] == 1
    with pytest.raises(ValueError, match="read-only"):
        sensor.pose[0, 3] = 5


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: DepthCamera(fov=90.0), "deg2rad"),
        (lambda: DepthCamera(stride=0), "at least 1"),
        (lambda: DepthCamera(sigma=-1.0), "sigma"),
        (lambda: DepthCamera(centre=(np.nan, 5.0)), "centre"),
        (lambda: DepthCamera(sigma=np.nan), "sigma"),
        (lambda: DepthCamera(sigma=np.inf), "sigma"),
        (lambda: DepthCamera(max_range=np.nan), "max_range must be a number, got nan"),
        (lambda: DepthCamera(fov=np.nan), "fov must be a number, got nan"),
        (lambda: DepthCamera(width=400.5), "width must be a whole number, got 400.5"),
        (lambda: DepthCamera(height=300.0), "height must be a whole number"),
        (lambda: DepthCamera(stride=True), "stride must be a whole number, got True"),
        (lambda: DepthCamera(centre=("a", "b")), "centre"),
        (lambda: DepthCamera(centre=5.0), "centre"),
        (lambda: SpinningLidar(channels=0), "channels"),
        (lambda: SpinningLidar(channels=1.5), "channels must be a whole number, got 1.5"),
        (lambda: SpinningLidar(azimuth_fov=np.nan), "azimuth_fov must be a number, got nan"),
        (lambda: SpinningLidar(fov_up="10"), "fov_up must be a number, got '10'"),
        (lambda: SpinningLidar(fov_up=-0.5, fov_down=0.5), "fov_down <= fov_up"),
        (lambda: SpinningLidar(azimuth_step=0.0), "azimuth_step"),
        (lambda: Sensor("s", CAMERA, np.diag([1.0, -1, 1, 1])), "mirrors"),
        (lambda: Sensor("s", CAMERA, np.zeros((4, 4))), "'s'"),
        (lambda: Sensor("s", CAMERA, np.full((4, 4), np.nan)), "NaN"),
    ],
)
def test_impossible_sensors_are_refused(make, message):
    # values of another type meet the shape checker first, where tests run with it
    with pytest.raises((ValueError, TypeError), match=f"{message}|Type-check error"):
        make()


@given(st.floats(width=32, allow_nan=True, allow_infinity=True))
def test_returned_means_finite_and_positive(value):
    assert returned(np.array([value], np.float32))[0] == (np.isfinite(value) and value > 0 and value < 3.4028234e38)


def test_the_digest_is_that_of_model_and_pose_alone():
    lidar, place = SpinningLidar(), pose(1.0, 2.0, 3.0)
    sensor = Sensor("a", lidar, place)
    assert sensor.digest == Sensor("b", SpinningLidar(), place.copy()).digest
    others = [
        Sensor("a", CAMERA, place),
        Sensor("a", SpinningLidar(sigma=0.5), place),
        Sensor("a", lidar, pose(1.0, 2.0, 3.0 + 1e-9)),
        Sensor("a", lidar, pose(1.0, 2.0, 3.0, yaw=1e-9)),
    ]
    assert len({sensor.digest, *(other.digest for other in others)}) == 5
