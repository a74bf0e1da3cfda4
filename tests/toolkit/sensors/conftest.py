"""Images whose every pixel is known in closed form: a wall, the open sky, and cars on even
ground."""

import numpy as np
import pytest

from toolkit.geometry import look, pose
from toolkit.objects import CYCLIST, HEAVY, VEHICLE, Objects
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.readings import Draws, Reading, TrueImage
from toolkit.sensors.sensor import Sensor

CAMERA = Sensor(
    "camera", DepthCamera(width=320, height=240, stride=1), look((0.0, 0.0, 5.0), 0.0, 0.25)
)
LIDAR = Sensor("lidar", SpinningLidar(channels=48, azimuth_step=0.01), pose(0.0, 0.0, 5.0))
BOXES = np.array(
    [
        *([12.0, 0, 0.75, 4.5, 1.8, 1.5, 0.3], [18.0, 6, 0.75, 4.5, 1.8, 1.5, 1.2]),
        *([16.0, -6, 1.5, 8.0, 2.5, 3.0, 0.1], [10.0, 4.5, 0.9, 1.8, 0.6, 1.8, 0.0]),
    ]
)
LABELS = np.array([VEHICLE, VEHICLE, HEAVY, CYCLIST])
NOTHING = Objects.empty()


def measured_by_slabs(sensor, boxes):
    """Measurement of every ray against upright boxes and the ground, by the slab method; 0 for
    none."""
    rays = sensor.model.rays().reshape(-1, 3).astype(np.float64)
    direction, origin = rays @ sensor.pose[:3, :3].T, sensor.position
    with np.errstate(divide="ignore"):
        nearest = np.where(direction[:, 2] < 0, -origin[2] / direction[:, 2], np.inf)
        for x, y, z, *size, yaw in boxes:
            turn = np.array(
                [[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]
            )
            o, d = turn @ (origin - [x, y, z]), direction @ turn.T
            low, high = np.sort(
                [(-np.array(size) / 2 - o) / d, (np.array(size) / 2 - o) / d], axis=0
            )
            enter, leave = low.max(axis=1), high.min(axis=1)
            nearest = np.where((enter < leave) & (enter > 0), np.minimum(nearest, enter), nearest)
    return np.where(nearest < 100, nearest, 0).astype(np.float32).reshape(sensor.model.shape)


@pytest.fixture(scope="session")
def street():
    """Two cars, a truck and a cyclist with track ids, as a camera measures them."""
    return TrueImage(
        CAMERA,
        measured_by_slabs(CAMERA, BOXES),
        Objects(BOXES, LABELS, np.array([7, 8, 9, 10])),
        2.0,
    )


@pytest.fixture(params=[CAMERA, LIDAR], ids=["camera", "lidar"])
def sensor(request):
    return request.param


@pytest.fixture
def wall():
    def image(sensor, metres):
        return TrueImage(sensor, np.full(sensor.model.shape, metres, np.float32), NOTHING)

    return image


@pytest.fixture
def read():
    def reading(term, truth, frame=3, seed=0, number=5):
        return term.apply(Reading.from_truth(truth), Draws(seed, number, frame, 1))

    return reading


def check_harmless(term, truth):
    before = Reading.from_truth(truth)
    assert term.apply(before, Draws(0, 1, 2, 3)) is before


@pytest.fixture
def harmless():
    return check_harmless


@pytest.fixture
def cast():
    return measured_by_slabs
