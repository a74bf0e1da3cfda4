"""A little recording made without renderer or simulator: three sensors over a flat square with a
few cars on it."""

import numpy as np
import pytest
import torch

from models.training.packed import PackedFrames
from models.training.packing import pack, recording
from toolkit.frame import Frame
from toolkit.geometry import look, pose
from toolkit.objects import HEAVY, VEHICLE, Objects
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor

AREA = (-12.8, -12.8, 12.8, 12.8)
GROUND = 0.02  # m, so that rounding does not decide on which side of z = 0 a point lies
SENSORS = (
    Sensor(
        "d0",
        DepthCamera(width=160, height=120, stride=1),
        look((-14.0, 0.0, 5.0), 0.0, np.deg2rad(25)),
    ),
    Sensor(
        "d1",
        DepthCamera(width=160, height=120, stride=1),
        look((14.0, 3.0, 6.0), np.pi, np.deg2rad(30)),
    ),
    Sensor(
        "l2",
        SpinningLidar(channels=32, azimuth_step=np.deg2rad(1.0)),
        pose(0.0, -14.0, 4.0, yaw=np.pi / 2),
    ),
)


def measure(sensor, boxes):
    """Distance along each ray to the ground, 2 cm up, or the nearest box, whichever comes first; 0
    for none."""
    rays = sensor.model.rays().reshape(-1, 3) @ sensor.pose[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        nearest = np.where(rays[:, 2] < 0, (GROUND - sensor.position[2]) / rays[:, 2], np.inf)
        for x, y, z, *size, yaw in boxes:
            turn = np.array(
                [[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]
            )
            start, ray = turn @ (sensor.position - [x, y, z]), rays @ turn.T
            near, far = np.sort(
                [(-np.array(size) / 2 - start) / ray, (np.array(size) / 2 - start) / ray], axis=0
            )
            entry, leaving = near.max(axis=1), far.min(axis=1)
            nearest = np.where((entry < leaving) & (entry > 0), np.minimum(nearest, entry), nearest)
    depth = np.where(nearest < sensor.model.max_range, nearest, 0).astype(np.float32)
    return depth.reshape(sensor.model.shape)


def cars(rng, count):
    """Boxes that stand apart on a circle of 8 m, the last one heavy and the first one outside the
    area."""
    angle = np.arange(count) * 2 * np.pi / count + rng.uniform(0, 1)
    size = rng.normal([4.4, 1.8, 1.5], [0.3, 0.1, 0.1], (count, 3))
    yaw = rng.uniform(-np.pi, np.pi, count)
    boxes = np.column_stack([8 * np.cos(angle), 8 * np.sin(angle), size[:, 2] / 2, size, yaw])
    boxes[0, :2] *= 14 / 8 / np.abs([np.cos(angle[0]), np.sin(angle[0])]).max()
    return Objects(boxes, np.array([VEHICLE] * (count - 1) + [HEAVY]))


@pytest.fixture(scope="session")
def frames():
    rng = np.random.default_rng(5)
    scenes = [cars(rng, 5) for _ in range(6)]
    return [
        Frame(SENSORS, tuple(measure(sensor, scene.boxes) for sensor in SENSORS), scene, 5.0 * k, k)
        for k, scene in enumerate(scenes)
    ]


@pytest.fixture(scope="session")
def packed_file(frames, tmp_path_factory):
    path = tmp_path_factory.mktemp("packed") / "little.packed"
    empty = [measure(sensor, []) for sensor in SENSORS]
    pack([recording(frames, AREA, 4.0, empty=empty)], path)
    return path


@pytest.fixture(scope="session")
def packed(packed_file):
    return PackedFrames(packed_file)


@pytest.fixture(scope="session")
def same_weights():
    def same(a, b):
        a, b = (each if isinstance(each, dict) else each.state_dict() for each in (a, b))
        return a.keys() == b.keys() and all(torch.equal(a[name], b[name]) for name in a)

    return same
