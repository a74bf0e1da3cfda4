"""The picture of a recording shows its fullest frame."""

import numpy as np
import pytest

from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.recording_file import Header, Scene, encode
from toolkit.detection.evaluation_files import draw_example
from toolkit.frame import Frame
from toolkit.geometry import look
from toolkit.objects import Detections, Objects
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

SITE = Site("corner", np.array([-30.0, -20, 30, 20]))
CAMERA = Sensor(
    "d0", DepthCamera(width=40, height=30, sigma=0.0), look((0.0, 25.0, 6.0), -np.pi / 2, 0.2)
)
# of a wall in front of the camera, so that the points say which frame it is
DEPTHS = (5.0, 20.0, 10.0)
OBJECTS = (1, 3, 2)


@pytest.fixture
def recording(tmp_path):
    scenes = []
    for k, (depth, count) in enumerate(zip(DEPTHS, OBJECTS, strict=True)):
        boxes = np.tile([0.0, 0, 0.75, 4, 2, 1.5, 0], (count, 1))
        boxes[:, 0] += 6 * np.arange(count)
        image = np.full(CAMERA.model.shape, depth, np.float32)
        scenes.append(
            Scene(Frame((CAMERA,), (image,), Objects(boxes), 1.0 * k, k), np.zeros(count, np.int64))
        )
    (tmp_path / "r.hdf5").write_bytes(encode(Header(SITE, (CAMERA,), ("car",)), scenes))
    with CoopDataset(tmp_path / "r.hdf5") as dataset:
        yield dataset


def test_the_frame_with_the_most_objects_is_drawn(recording, tmp_path):
    seen = []

    def detector(points):
        seen.append(points)
        return Detections.empty()

    draw_example(recording, detector, tmp_path / "example.png")
    assert (tmp_path / "example.png").read_bytes().startswith(b"\x89PNG")
    (points,) = seen
    assert len(points) > 10
    np.testing.assert_allclose(
        (points - CAMERA.position) @ CAMERA.pose[:3, 2], DEPTHS[1], atol=0.01
    )
