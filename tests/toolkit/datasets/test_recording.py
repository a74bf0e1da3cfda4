"""The bytes of a recording: the same each time, and the same of joined parts as of one whole."""

import h5py
import numpy as np
import pytest

from toolkit.datasets.recording_file import RECORDING_SCHEMA, Header, Scene, encode, join
from toolkit.datasets.stored_channels import OWN_IMAGES
from toolkit.frame import Frame
from toolkit.geometry import look, pose
from toolkit.objects import Objects
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

SITE = Site("corner", np.array([-30.0, -20, 30, 20]))
CAMERA = Sensor("north", DepthCamera(width=40, height=30), look((0.0, 25.0, 6.0), -np.pi / 2, 0.2))
TWIN = Sensor("south", DepthCamera(width=40, height=30), look((0.0, -25.0, 6.0), np.pi / 2, 0.2))
SMALL = Sensor("small", DepthCamera(width=20, height=15, stride=1), look((0.0, -25.0, 6.0), 1.0))
LIDAR = Sensor("lidar", SpinningLidar(channels=4, azimuth_step=0.2), pose(1.0, 2.0, 5.0))


def scenes(sensors, frames):
    rng = np.random.default_rng(2)
    made = []
    for k in range(frames):
        boxes = np.column_stack(
            [rng.uniform(-9, 9, (k, 3)), np.tile([4.0, 2.0, 1.5], (k, 1)), rng.uniform(-3, 3, k)]
        )
        images = tuple(
            rng.uniform(1, 50, sensor.model.shape).astype(np.float32) for sensor in sensors
        )
        made.append(Scene(Frame(sensors, images, Objects(boxes), 0.5 * k, k), np.arange(k)))
    return made


def content(source):
    found = {}

    def visit(name, node):
        found.update(
            {f"{name}@{key}": np.asarray(value).tolist() for key, value in node.attrs.items()}
        )
        if isinstance(node, h5py.Dataset):
            found[name] = node[()].tolist() if node.shape else node[()]

    with h5py.File(source) as file:
        file.visititems(visit)
    return found


@pytest.mark.parametrize(
    ("sensors", "images"),
    [
        *(
            ((CAMERA, TWIN), ("dslices", "dslices")),
            ((LIDAR, CAMERA), ("coview/ranges/lidar", "dslices")),
        ),
        *(
            ((CAMERA, SMALL), ("coview/depth/north", "coview/depth/small")),
            ((LIDAR,), ("coview/ranges/lidar",)),
        ),
    ],
)
def test_cameras_of_one_size_share_their_images(sensors, images):
    header = Header(SITE, sensors)
    assert header.images == images
    assert header.pinholes.keys() == {
        sensor.name for sensor in sensors if sensor.model.measures == "depth"
    }
    assert OWN_IMAGES.keys() == {"depth", "range"}


def test_equal_scenes_are_equal_bytes(tmp_path):
    header = Header(SITE, (CAMERA, LIDAR), ("a",), '{"seed": 1}')
    one = encode(header, scenes(header.sensors, 3))
    assert one == encode(header, scenes(header.sensors, 3))
    (tmp_path / "a.hdf5").write_bytes(one)
    found = content(tmp_path / "a.hdf5")
    assert (found["coview@schema"], found["coview@plan"]) == (RECORDING_SCHEMA, '{"seed": 1}')
    assert found["coview/object_start"] == [0, 0, 1, 3]
    assert found["coview/time"] == [0.0, 0.5, 1.0]


@pytest.mark.parametrize("cut", [1, 3])
def test_joined_parts_hold_what_one_file_holds(tmp_path, cut):
    header = Header(SITE, (CAMERA, TWIN, LIDAR))
    made = scenes(header.sensors, 4)
    parts = [tmp_path / "1.hdf5", tmp_path / "2.hdf5"]
    for path, some in zip(parts, (made[:cut], made[cut:]), strict=True):
        path.write_bytes(encode(header, some))
    (tmp_path / "whole.hdf5").write_bytes(encode(header, made))
    join(header, parts, tmp_path / "joined.hdf5")
    assert content(tmp_path / "joined.hdf5") == content(tmp_path / "whole.hdf5")
