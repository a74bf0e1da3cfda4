import numpy as np
import pytest

pytest.importorskip("rosbags")
from toolkit.datasets.layouts.rosbag import rosbag
from toolkit.datasets.layouts.rosbag_writer import write_rosbag
from toolkit.datasets.sample import Sample, SensorCloud
from toolkit.geometry import pose
from toolkit.objects import Objects


def test_clouds_in_the_world_are_written_in_their_sensors_frame(tmp_path):
    placed = pose(5.0, 1.0, 2.0, yaw=0.5, pitch=0.2)
    cloud = SensorCloud("lidar", np.array([[7.0, 1, 0]], np.float32), placed, "world")
    write_rosbag([Sample("0", (cloud,), Objects.empty(), time=3.5)], tmp_path)
    (back,) = rosbag(tmp_path / "bag")
    np.testing.assert_allclose(back.clouds[0].world_SE3_sensor, placed, atol=1e-12)
    np.testing.assert_allclose(back.points(), [[7, 1, 0]], atol=1e-6)
    assert back.time == 3.5


def test_labels_have_no_place_in_a_bag(tmp_path):
    cloud = SensorCloud("lidar", np.ones((1, 3), np.float32), np.eye(4))
    with pytest.warns(UserWarning, match="no place for labels, 1 are not in it"):
        write_rosbag([Sample("0", (cloud,), Objects(np.array([[0, 0, 0, 1, 1, 1, 0.0]])))], tmp_path)
