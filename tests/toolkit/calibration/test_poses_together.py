from functools import lru_cache

import numpy as np
import pytest

from toolkit.calibration.poses_together import find_poses_together
from toolkit.frame import Frame
from toolkit.geometry import look
from toolkit.objects import Objects
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.errors.pose_errors import rotation_about
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site, Solid

SOLIDS = tuple(
    Solid(np.array([[x, y], [x + 4.0, y], [x + 4.0, y + 3.0], [x, y + 3.0]]), 0.0, 4.0, "container")
    for x, y in ((-8, 4), (3, 5), (-2, -2), (6, -5))
)
PLACE = Site("place", np.array([-12.0, -12, 12, 12]), solids=SOLIDS)
MODEL = DepthCamera(width=160, height=120, stride=2)
TRUE = (
    Sensor("a", MODEL, look((-9.0, -9.0, 5.0), heading=0.8, tilt=0.35)),
    Sensor("b", MODEL, look((9.0, -9.0, 5.0), heading=2.3, tilt=0.35)),
    Sensor("away", MODEL, look((-60.0, -60.0, 5.0), heading=-2.3, tilt=0.35)),
)
ERROR = np.eye(4)
ERROR[:3, :3], ERROR[:3, 3] = rotation_about(np.deg2rad([0.5, 0.6, 0.0])), [0.05, 0.0, 0.05]


@lru_cache(maxsize=1)
def images():
    return Renderer(PLACE, [], TRUE, threads=1).background


def recording(sensors, count=6):
    return [Frame(tuple(sensors), images()[: len(sensors)], Objects.empty(), 0.1 * k, k) for k in range(count)]


def test_sensors_are_put_right_by_each_other():
    crooked = Sensor("b", MODEL, TRUE[1].pose @ ERROR)
    found = find_poses_together(recording([TRUE[0], crooked, TRUE[2]]), held=["a"])
    assert [each.sensor.name for each in found] == ["a", "b", "away"]
    assert found[0].pose.tobytes() == TRUE[0].pose.tobytes()
    assert np.linalg.norm(found[1].pose[:3, 3] - TRUE[1].position) < 0.02
    assert found[1].drifted
    assert not found[0].drifted
    assert "it shares 0 points with the other sensors, 50 are needed" in found[2].refusal


def test_without_a_held_one_both_move_half_way():
    crooked = Sensor("b", MODEL, TRUE[1].pose @ ERROR)
    a, b = find_poses_together(recording([TRUE[0], crooked]))
    assert a.distance == pytest.approx(b.distance, abs=0.03)
    assert 0.0 < a.distance < 0.06


def test_too_few_frames_and_unknown_sensors_are_refused():
    with pytest.raises(ValueError, match="3 frames are too few"):
        find_poses_together(recording(TRUE[:2]), frames=3)
    with pytest.raises(ValueError, match="no sensor 'c'"):
        find_poses_together(recording(TRUE[:2]), held=["c"])
    with pytest.raises(ValueError, match="got 1 surfaces"):
        find_poses_together(recording(TRUE[:1]))
