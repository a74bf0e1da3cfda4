"""A healthy recording, and what the doctor says once it is spoilt."""

import h5py
import numpy as np
import pytest

from toolkit.datasets.recording_file import Header, Scene, encode
from toolkit.doctor.findings import Finding
from toolkit.doctor.stored_file import diagnose_file
from toolkit.frame import Frame
from toolkit.geometry import look, pose
from toolkit.objects import Objects
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

SITE = Site("crossing", np.array([-25.0, -20, 25, 20]), map_SE3_site=pose(60.0, -90.0, yaw=0.6))
CAMERA = DepthCamera(width=160, height=120)
SENSORS = (
    Sensor("north", CAMERA, look((2.0, 24.0, 7.0), -np.pi / 2, 0.35)),
    Sensor("west", CAMERA, look((-28.0, -3.0, 6.0), 0.1, 0.25)),
    Sensor("lidar", SpinningLidar(channels=24, azimuth_step=0.02), pose(0.0, -22.0, 6.0)),
)
FRAMES = 14


def measured(sensor: Sensor, boxes: np.ndarray) -> np.ndarray:
    """Upright boxes on the ground z = 0, by the slab method."""
    direction = sensor.model.rays().reshape(-1, 3).astype(np.float64) @ sensor.pose[:3, :3].T
    origin = sensor.position
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
    return np.where(nearest < 80, nearest, 0).astype(np.float32).reshape(sensor.model.shape)


def healthy_file() -> bytes:
    rng = np.random.default_rng(1)
    scenes = []
    for k in range(FRAMES):
        x, y = np.meshgrid([-18.0, -6, 6, 18], [-10.0, 0, 10])
        place = np.stack([x.ravel(), y.ravel()], axis=1) + rng.uniform(-2.5, 2.5, (12, 2))
        place, yaw = place[rng.random(12) < 0.6], rng.uniform(-np.pi, np.pi, 12)
        n = len(place)
        size = rng.uniform([3.8, 1.6, 1.4], [5.0, 2.0, 1.8], (n, 3))
        boxes = np.column_stack([place, size[:, 2] / 2, size, yaw[:n]])
        frame = Frame(
            SENSORS, tuple(measured(s, boxes) for s in SENSORS), Objects(boxes), 5.0 * k, k
        )
        scenes.append(Scene(frame, np.zeros(n, np.int64)))
    return encode(Header(SITE, SENSORS), scenes)


@pytest.fixture(scope="session")
def healthy():
    return healthy_file()


@pytest.fixture
def spoil(tmp_path, healthy):
    """Write the healthy recording, change it, and say what the doctor says."""

    def spoiled(change, published: bool = False) -> list[Finding]:
        path = tmp_path / "recording.hdf5"
        path.write_bytes(healthy)
        with h5py.File(path, "r+") as file:
            change(file)
            if published:
                del file["coview"]
                for camera in file["cameras"].values():
                    camera.attrs.clear()
        return diagnose_file(path)

    return spoiled
