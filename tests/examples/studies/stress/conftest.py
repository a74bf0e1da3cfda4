"""Ground with a block that drives, two cameras over it, and a detector that knows the block: for
tests of this room."""

from functools import lru_cache

import numpy as np
import pytest

from toolkit.frame import Frame
from toolkit.geometry import look
from toolkit.objects import Detections, Objects
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

AREA = np.array([-20.0, -20.0, 20.0, 20.0])
SENSORS = tuple(
    Sensor(name, DepthCamera(width=45, height=30, stride=1), look((-8.0, y, 6.0), 0.0, 0.5))
    for name, y in (("a", -3.0), ("b", 3.0))
)
SPEED = 10.0  # m/s


class Driving:
    """A block that drives along x on flat ground, 0.3 m a side seen from above: a column of points
    for its detector."""

    site = Site("plain", AREA)
    sensors = SENSORS

    def __init__(self, frames=30, apart=0.1):
        self.frames, self.apart = frames, apart

    def __len__(self):
        return self.frames

    def box(self, k):
        return np.array([[-4.0 + SPEED * self.apart * k % 16, 0.0, 1.0, 4.0, 2.0, 2.0, 0.0]])

    def __getitem__(self, k):
        return scene(self.box(k).tobytes(), self.apart * k, k, self.sensors)


@lru_cache(maxsize=100)
def scene(box, time, index, sensors):
    box, images = np.frombuffer(box).reshape(1, 7), []
    for sensor in sensors:
        rays = sensor.world_rays.reshape(3, *sensor.model.shape)
        down = np.minimum(rays[2], -0.05)
        ground = (0.05 - sensor.position[2]) / down
        top = (2.0 - sensor.position[2]) / down
        x, y = sensor.position[0] + rays[0] * top, sensor.position[1] + rays[1] * top
        cx, cy = box[0, :2]
        on = (np.abs(x - cx) < 2) & (np.abs(y - cy) < 1) & (rays[2] < -0.05)
        images.append(
            np.where(on, top, np.where((rays[2] < -0.05) & (ground < 60), ground, 0)).astype(
                np.float32
            )
        )
    objects = Objects(box.copy(), np.array([0]), np.array([1]))
    return Frame(sensors, tuple(images), objects, time, index)


class Tops:
    """A car about the middle of what is higher than a metre and a half."""

    digest = "tops"

    def __call__(self, points):
        high = points[points[:, 2] > 1.5]
        if len(high) < 5:
            return Detections.empty()
        x, y = (high[:, :2].min(axis=0) + high[:, :2].max(axis=0)) / 2
        return Detections(np.array([[x, y, 1.0, 4.0, 2.0, 2.0, 0.0]]), np.array([0.9]))


@pytest.fixture(scope="session")
def driving():
    return Driving


@pytest.fixture(scope="session")
def tops():
    return Tops
