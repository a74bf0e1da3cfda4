from functools import lru_cache

import numpy as np
import pytest

from toolkit.calibration.empty_scene import SceneLearner
from toolkit.calibration.reference import site_surface
from toolkit.calibration.registration import Registration, Surface
from toolkit.calibration.sensor_poses import FoundPose, find_pose, find_poses, spoken
from toolkit.frame import Frame
from toolkit.geometry import look
from toolkit.objects import Objects
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.errors.pose_errors import rotation_about
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site, Solid

AREA = np.array([-12.0, -12, 12, 12])
SOLIDS = tuple(
    Solid(np.array([[x, y], [x + 4.0, y], [x + 4.0, y + 3.0], [x, y + 3.0]]), 0.0, 4.0, "container")
    for x, y in ((-8, 4), (3, 5), (-2, -9), (6, -5))
)
PLACE = Site("place", AREA, solids=SOLIDS)
MODEL = DepthCamera(width=160, height=120, stride=2)
TRUE = (
    Sensor("a", MODEL, look((-9.0, -9.0, 5.0), heading=0.8, tilt=0.35)),
    Sensor("b", MODEL, look((9.0, 9.0, 5.0), heading=-2.3, tilt=0.35)),
)


@lru_cache(maxsize=1)
def surface():
    return site_surface(PLACE)


def crooked(sensor, deg=1.0, metres=0.1, seed=0):
    rng = np.random.default_rng(seed)
    axis, way = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 3)))
    error = np.eye(4)
    error[:3, :3], error[:3, 3] = rotation_about(np.deg2rad(deg) * axis), metres * way
    return Sensor(sensor.name, sensor.model, sensor.pose @ error)


@lru_cache(maxsize=1)
def images():
    return Renderer(PLACE, [], TRUE, threads=1).background


def recording(sensors, count=6):
    """Noise-free frames of the empty place by sensors that are believed to be there."""
    return [Frame(tuple(sensors), images(), Objects.empty(), 0.1 * k, k) for k in range(count)]


def test_every_sensor_of_a_recording_is_put_right():
    believed = [crooked(sensor, seed=k) for k, sensor in enumerate(TRUE)]
    done = []
    found = find_poses(recording(believed), surface(), progress=done.append)
    assert done == [1, 2]
    for each, true, wrong in zip(found, TRUE, believed, strict=True):
        assert each.sensor is wrong
        assert np.linalg.norm(each.pose[:3, 3] - true.pose[:3, 3]) < 0.01
        assert each.distance == pytest.approx(0.1, abs=0.01)
        assert np.rad2deg(each.turn) == pytest.approx(1.0, abs=0.03)
        assert each.drifted
        assert each.refusal == ""


def test_sensors_that_are_where_they_should_be_have_not_drifted():
    for each in find_poses(recording(TRUE), surface()):
        assert not each.drifted
        assert each.distance < 0.01


def test_errors_of_a_profile_turn_the_believed_poses_too():
    found = find_poses(recording(TRUE), surface(), errors="typical", noise_seed=3)
    for each, true in zip(found, TRUE, strict=True):
        assert np.linalg.norm(each.sensor.pose[:3, 3] - true.pose[:3, 3]) > 0.005
        assert np.linalg.norm(each.pose[:3, 3] - true.pose[:3, 3]) < 0.02


def test_too_few_frames_and_the_wrong_place_are_refused():
    with pytest.raises(ValueError, match="4 frames are too few"):
        find_poses(recording(TRUE), surface(), frames=4)
    elsewhere = Surface(surface().points + 500.0, surface().normals, surface().roughness)
    refused = find_poses(recording(TRUE[:1] + TRUE[1:]), elsewhere)[0]
    assert refused.registration is None
    assert "points lie within 3 m of the reference" in refused.refusal
    assert refused.pose is TRUE[0].pose
    assert (refused.turn, refused.distance, refused.drifted) == (0.0, 0.0, False)
    assert refused.described()["found"] is False


def test_a_reference_that_shows_little_of_what_a_sensor_sees_is_refused():
    learner = SceneLearner(TRUE[0])
    for _ in range(5):
        learner.add(images()[0])
    near = np.hypot(*(surface().points[:, :2] - TRUE[0].position[:2]).T) < 6.0
    patch = Surface(surface().points[near], surface().normals[near], surface().roughness[near])
    assert "% are needed: is it of the same place" in find_pose(learner.scene(), TRUE[0], patch).refusal


def found_at(pose, deviation=1e-4, unobserved=()):
    sensor = Sensor("c", MODEL, np.eye(4))
    rows = np.array(unobserved, float).reshape(-1, 6)
    return FoundPose(sensor, Registration(pose, np.eye(6) * deviation**2, rows, 0.8, 0.01))


def test_a_drift_is_clear_or_none():
    little, much = np.eye(4), np.eye(4)
    little[0, 3], much[0, 3] = 0.015, 0.05
    assert not found_at(little).drifted
    assert found_at(much).drifted
    assert not found_at(much, deviation=0.05).drifted
    turned = np.eye(4)
    turned[:3, :3] = rotation_about(np.array([0.0, 0.0, np.deg2rad(0.2)]))
    assert found_at(turned).drifted
    assert np.rad2deg(found_at(turned).turn) == pytest.approx(0.2)


def test_what_files_say_is_in_degrees_and_names_what_is_not_observed():
    pose = np.eye(4)
    pose[:3, 3] = [0.0, 0.3, 0.4]
    said = found_at(pose, 0.01, [[0, 0, 0, -1.0, 0, 0]]).described()
    assert said["moved_m"] == pytest.approx(0.5)
    assert said["unobserved"] == ["move along x 1.00"]
    assert said["standard_deviation"]["move_m"] == [np.inf, 0.01, 0.01]
    assert said["standard_deviation"]["turn_deg"] == [pytest.approx(0.573, abs=1e-3)] * 3
    assert spoken(np.array([0.05, 0, 0.7, 0, -0.7, 0])) == "turn about z 0.70, move along y -0.70"
