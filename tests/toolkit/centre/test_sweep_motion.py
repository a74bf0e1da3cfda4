"""Points of a sweep at one time: a car that drives while it is measured, and a wall that does not."""

from dataclasses import replace

import numpy as np
import pytest

from toolkit.centre.sweep_motion import move_to_frame
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import look, pose, transform
from toolkit.objects import Objects
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.tracking.tracks import Tracks

BOX = np.array([[12.0, 4.0, 0.8, 4.5, 1.8, 1.6, 0.3]])
VELOCITY = 15.0 * np.array([[np.cos(0.3), np.sin(0.3), 0.0]])
TRACKS = Tracks(BOX, np.array([0.9]), velocities=VELOCITY)
FRAME_S = 5.0
SWEEP_S = 0.1


def points_of_car(count=400, seed=1):
    """Points on the sides of the box at `FRAME_S`, above its underside."""
    rng = np.random.default_rng(seed)
    unit = rng.uniform(-0.5, 0.5, (count, 3))
    unit[np.arange(count), rng.integers(0, 2, count)] = 0.5
    unit[:, 2] = rng.uniform(-0.3, 0.5, count)
    return transform(pose(*BOX[0, :3], yaw=BOX[0, 6]), unit * BOX[0, 3:6])


def swept(frame_kind):
    """A cloud of a car and a wall, each point where it was at its time, and their true points."""
    rng = np.random.default_rng(2)
    car = points_of_car()
    wall = rng.uniform([5, 15, 0], [20, 15.1, 3], (300, 3))
    still = np.concatenate([car, wall])
    times = rng.uniform(0, SWEEP_S, len(still))
    times[0] = SWEEP_S
    moves = np.zeros_like(still)
    moves[: len(car)] = (times[: len(car), None] - SWEEP_S) * VELOCITY
    world_SE3_sensor = pose(1.0, -2.0, 5.0, yaw=0.7)
    measured = still + moves
    if frame_kind == "sensor":
        measured = transform(np.linalg.inv(world_SE3_sensor), measured)
    cloud = SensorCloud(
        "north", measured.astype(np.float32), world_SE3_sensor, frame_kind, time=times
    )
    return cloud, still


@pytest.mark.parametrize("frame_kind", ["sensor", "world"])
def test_points_come_to_where_they_are_at_the_time_of_the_frame(frame_kind):
    cloud, still = swept(frame_kind)
    frame = Frame.of_clouds("0", [cloud], Objects.empty(), time=FRAME_S)
    assert np.abs(frame.points() - still).max() > 1.0
    moved = move_to_frame(frame, np.array([FRAME_S]), TRACKS)
    assert moved.points() == pytest.approx(still, abs=1e-4)


def test_a_sensor_that_measured_earlier_is_moved_too():
    cloud, still = swept("world")
    cloud = replace(cloud, time=cloud.time)
    frame = Frame.of_clouds("0", [cloud], Objects.empty(), time=FRAME_S + 0.04)
    later = Tracks(BOX + np.pad(0.04 * VELOCITY[0], (0, 4)), np.array([0.9]), velocities=VELOCITY)
    moved = move_to_frame(frame, np.array([FRAME_S]), later)
    car = slice(0, 400)
    assert moved.points()[car] == pytest.approx(still[car] + 0.04 * VELOCITY, abs=1e-4)
    assert moved.points()[400:] == pytest.approx(still[400:], abs=1e-4)


def test_an_image_that_is_older_than_its_frame_is_shifted():
    sensor = Sensor("a", DepthCamera(width=80, height=60, stride=1), look((0, 4, 1.5), 0.0))
    image = np.zeros(sensor.model.shape, np.float32)
    image[20:50, 30:50] = 10.0
    frame = Frame((sensor,), (image,), Objects.empty(), time=FRAME_S)
    car = np.array([[11.0, 4.0, 1.5, 4.5, 5.0, 4.0, 0.0]])
    tracks = Tracks(car, np.array([0.9]), velocities=np.array([[10.0, 0.0, 0.0]]))
    moved = move_to_frame(frame, np.array([FRAME_S - 0.08]), tracks)
    moves = moved.points() - frame.points()
    assert moves[:, 0].max() == pytest.approx(0.8, abs=1e-5)
    assert np.abs(moves[:, 1:]).max() < 1e-5


def test_ground_and_standing_road_users_stay():
    cloud, _ = swept("world")
    ground = cloud.points.copy()
    ground[:, 2] = 0.02
    frame = Frame.of_clouds("0", [replace(cloud, points=ground)], Objects.empty(), time=FRAME_S)
    moved = move_to_frame(frame, np.array([FRAME_S]), TRACKS)
    assert np.array_equal(moved.points(), frame.points())
    standing = replace(TRACKS, velocities=np.zeros((1, 3)))
    frame = Frame.of_clouds("0", [cloud], Objects.empty(), time=FRAME_S)
    assert move_to_frame(frame, np.array([FRAME_S]), standing) is frame
