"""Crooked lidars of a recording of clouds are put right, by each other and by what stands there."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from toolkit.calibration.reference import site_surface
from toolkit.calibration.samples import sample_poses
from toolkit.calibration.samples.sample_poses import corrections, find_sample_poses, with_corrections
from toolkit.datasets.sample import Sample, SensorCloud
from toolkit.geometry import invert, pose, transform
from toolkit.objects import Objects
from toolkit.points import unproject
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.errors.pose_errors import rotation_about
from toolkit.sensors.row_lidar import RowLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site, Solid

SOLIDS = tuple(
    Solid(np.array([[x, y], [x + 4.0, y], [x + 4.0, y + 3.0], [x, y + 3.0]]), 0.0, 4.0, "container")
    for x, y in ((-8, 4), (3, 5), (-2, -2), (6, -5))
)
PLACE = Site("place", np.array([-12.0, -12, 12, 12]), solids=SOLIDS)
MODEL = RowLidar(tuple(np.deg2rad(np.linspace(0, -50, 48))), columns=360)
TRUE = (Sensor("a", MODEL, pose(-9.0, -9.0, 5.0, yaw=0.8)), Sensor("b", MODEL, pose(-9.0, -2.0, 4.0, yaw=0.2)))
ERROR = np.eye(4)
ERROR[:3, :3], ERROR[:3, 3] = rotation_about(np.deg2rad([0.5, 0.6, 0.0])), [0.05, 0.0, 0.05]


@lru_cache(maxsize=1)
def clouds():
    """What both see, each in its own frame."""
    images = Renderer(PLACE, [], TRUE, threads=1).background
    made = []
    for sensor, image in zip(TRUE, images, strict=True):
        points, valid = unproject(sensor, image)
        made.append(transform(invert(sensor.pose), points.T[valid].astype(np.float64)).astype(np.float32))
    return made


def recording(count, *, driving=0.0, frame="sensor"):
    """b is believed to be elsewhere; the rig drives so far between samples."""
    believed = (TRUE[0].pose, ERROR @ TRUE[1].pose)
    samples = []
    for k in range(count):
        own = [SensorCloud(s.name, p, pose_) for s, p, pose_ in zip(TRUE, clouds(), believed, strict=True)]
        if frame == "world":
            own = [replace(c, points=c.in_world().astype(np.float32), frame="world") for c in own]
        samples.append(Sample(str(k), tuple(own), Objects.empty(), map_SE3_world=pose(driving * k)))
    return samples


def apart(one, other):
    turn = one[:3, :3] @ other[:3, :3].T
    return np.rad2deg(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))), np.linalg.norm(one[:3, 3] - other[:3, 3])


@pytest.mark.parametrize(("count", "driving"), [(5, 0.0), (2, 0.0), (6, 3.0)])
def test_by_each_other(count, driving):
    samples = recording(count, driving=driving)
    found = find_sample_poses(lambda: iter(samples), held=["a"])
    assert [each.sensor.name for each in found] == ["a", "b"]
    np.testing.assert_array_equal(found[0].pose, TRUE[0].pose)
    assert apart(ERROR @ TRUE[1].pose, TRUE[1].pose)[0] == pytest.approx(0.78, abs=0.01)
    turn, move = apart(found[1].pose, TRUE[1].pose)
    assert turn < 0.1
    assert move < 0.04


@pytest.mark.parametrize(("count", "driving", "learns"), [(5, 0.0, 1), (5, 0.1, 1), (4, 0.0, 0), (5, 0.6, 0)])
def test_scenes_are_learnt_of_lidars_that_stand_still_in_enough_samples(monkeypatch, count, driving, learns):
    learnt, fitted = [], []

    def learn(samples):
        learnt.append(len(list(samples)))
        return {}

    def together(points, sensors, *, held):
        fitted.append((points, sensors))
        return ()

    monkeypatch.setattr(sample_poses, "learn_sample_scenes", learn)
    monkeypatch.setattr(sample_poses, "clouds_together", together)
    samples = recording(count, driving=driving)
    moved = tuple(replace(cloud, world_SE3_sensor=pose(0.1) @ cloud.world_SE3_sensor) for cloud in samples[1].clouds)
    samples[1] = replace(samples[1], clouds=moved)
    assert find_sample_poses(lambda: iter(samples)) == ()
    ((points, sensors),) = fitted
    assert learnt == [count] * learns
    assert [sensor.name for sensor in sensors] == ([] if learns else ["a", "b"])
    if not learns:
        np.testing.assert_array_equal(points[1], clouds()[1].astype(np.float64))
        np.testing.assert_array_equal(sensors[1].pose, ERROR @ TRUE[1].pose)


def test_the_pose_found_is_that_of_the_first_sample():
    samples = recording(2)
    own = samples[1].clouds[1]
    samples[1] = replace(samples[1], clouds=(replace(own, world_SE3_sensor=pose(0.1) @ own.world_SE3_sensor),))
    found = find_sample_poses(lambda: iter(samples), held=["a"])
    np.testing.assert_array_equal(found[1].sensor.pose, ERROR @ TRUE[1].pose)


def test_by_a_reference():
    samples = recording(5)
    found = find_sample_poses(lambda: iter(samples), site_surface(PLACE))
    for each, true in zip(found, TRUE, strict=True):
        turn, move = apart(each.pose, true.pose)
        assert turn < 0.05
        assert move < 0.02


@pytest.mark.parametrize("frame", ["sensor", "world"])
def test_samples_are_put_where_their_sensors_are(frame):
    samples = recording(1, frame=frame)
    corrected = {"b": invert(ERROR @ TRUE[1].pose) @ TRUE[1].pose}
    (after,) = with_corrections(samples, corrected)
    assert after.clouds[0] is samples[0].clouds[0]
    np.testing.assert_allclose(after.clouds[1].world_SE3_sensor, TRUE[1].pose, atol=1e-9)
    np.testing.assert_allclose(after.clouds[1].in_world(), transform(TRUE[1].pose, clouds()[1]), atol=1e-4)


def test_corrections_are_in_the_sensors_own_frame():
    samples = recording(5)
    found = find_sample_poses(lambda: iter(samples), held=["a"])
    made = corrections(found)
    np.testing.assert_allclose(made["a"], np.eye(4), atol=1e-12)
    np.testing.assert_allclose(ERROR @ TRUE[1].pose @ made["b"], found[1].pose, atol=1e-9)


def test_what_is_refused():
    nobody = Sample("0", (SensorCloud("a", np.zeros((0, 3), np.float32), np.eye(4)),), Objects.empty())
    with pytest.raises(ValueError, match="no sample has a point"):
        find_sample_poses(lambda: iter([nobody]))
    samples = recording(1)
    with pytest.raises(ValueError, match="no sensor 'c'"):
        find_sample_poses(lambda: iter(samples), held=["c"])
    with pytest.raises(ValueError, match="1 surfaces"):
        find_sample_poses(lambda: (each.seen_by(["a"]) for each in samples))
