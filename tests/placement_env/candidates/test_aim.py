"""Where sensors look, and the pose that looks there, are each other's inverse for every model."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from placement_env.candidates.aim import aimed, aims
from toolkit.geometry import look, pose
from toolkit.sensors.models import DepthCamera, SolidStateLidar, SpinningLidar
from toolkit.sensors.sensor import Sensor

MODELS = [DepthCamera(), SpinningLidar(channels=4), SolidStateLidar()]


@pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)
@given(heading=st.floats(-3.1, 3.1), tilt=st.floats(-1.4, 1.4))
def test_a_sensor_looks_where_it_is_aimed(model, heading, tilt):
    sensor = aimed(Sensor("s", model, np.eye(4)), np.array([1.0, -2.0, 6.0]), heading, tilt)
    assert np.allclose(aims([sensor]), [[heading], [tilt]], atol=1e-9)
    assert sensor.position.tolist() == [1.0, -2.0, 6.0]
    assert (sensor.name, sensor.model) == ("s", model)


def test_a_camera_looks_along_its_axis_and_a_lidar_along_x():
    camera = Sensor("c", DepthCamera(), look((0.0, 0.0, 5.0), 1.0, 0.5))
    lidar = Sensor("l", SpinningLidar(channels=4), pose(0.0, 0.0, 5.0, yaw=-2.0, pitch=0.1))
    headings, tilts = aims([camera, lidar])
    assert np.allclose(headings, [1.0, -2.0])
    assert np.allclose(tilts, [0.5, 0.1])


def test_of_no_sensors_there_are_no_aims():
    assert [len(each) for each in aims([])] == [0, 0]
