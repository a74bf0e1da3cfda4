from functools import partial

import numpy as np
import pytest

from toolkit.calibration.joint import align, towards_sensor
from toolkit.calibration.joint_objects import SeenBoxes, object_pairs, seen_objects
from toolkit.calibration.registration import LEVER, Surface, after_motion
from toolkit.frame import Frame
from toolkit.geometry import invert, look, transform
from toolkit.objects import Detections, Objects
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Relief, Site

TRUE = (look((-8.0, -8.0, 6.0), heading=0.7, tilt=0.4), look((8.0, -8.0, 6.0), heading=2.4, tilt=0.4))


def cars(rng, count=6):
    """Boxes more than a gate apart."""
    x = np.linspace(-9, 9, count) + rng.uniform(-0.3, 0.3, count)
    return np.column_stack([x, rng.uniform(-6, 6, count), np.full(count, 0.8), np.tile([4.2, 1.8, 1.5], (count, 1)),
                            rng.uniform(-3.1, 3.1, count)])  # fmt: skip


def seen_frames(rng, frames=30, noise=0.05):
    """What sensors at the true poses say of the same cars, each with noise of its own."""
    seen = []
    for _ in range(frames):
        truth = cars(rng)
        seen.append([SeenBoxes.of(truth + noise * rng.standard_normal(truth.shape) * [1, 1, 1, 0, 0, 0, 0.2], at)
                     for at in TRUE])  # fmt: skip
    return seen


def bare_plane(at, rng):
    points = np.column_stack([rng.uniform(-10, 10, (3000, 2)), 0.005 * rng.standard_normal(3000)])
    normals = np.tile([0.0, 0.0, 1.0], (3000, 1)) @ at[:3, :3]
    return towards_sensor(Surface(transform(invert(at), points), normals, np.full(3000, 0.005)))


def test_road_users_say_what_a_bare_plane_does_not():
    rng = np.random.default_rng(0)
    surfaces = [bare_plane(at, rng) for at in TRUE]
    motion = np.array([0.0, 0.0, LEVER * np.deg2rad(1.0), 0.2, -0.15, 0.0])
    believed = [TRUE[0], after_motion(TRUE[1], motion)]
    alone = align(surfaces, believed, held=[0])
    assert len(alone.unobserved_of(1)) == 3
    found = align(surfaces, believed, held=[0], more=partial(object_pairs, seen_frames(rng)))
    assert len(found.unobserved) == 0
    assert np.abs(found.poses[1][:2, 3] - TRUE[1][:2, 3]).max() < 0.03
    heading = [np.arctan2(at[1, 2], at[0, 2]) for at in (found.poses[1], TRUE[1])]
    assert np.rad2deg(abs(heading[0] - heading[1])) < 0.2
    assert found.shared[0, 1] > alone.shared[0, 1]


def test_rows_are_the_derivatives_of_the_residuals():
    rng = np.random.default_rng(1)
    seen = seen_frames(rng, frames=2)
    for sensor in (0, 1):
        for number in range(6):
            motion = np.zeros(6)
            motion[number] = 1e-6
            poses = list(TRUE)
            before = object_pairs(seen, poses, 1.5)[0]
            poses[sensor] = after_motion(poses[sensor], motion)
            after = object_pairs(seen, poses, 1.5)[0]
            rows = (before.one_row, before.other_row)[sensor][:, number]
            centres = np.arange(len(rows)) < 36  # 12 cars, three numbers each
            np.testing.assert_allclose((after.residual - before.residual)[centres] / 1e-6, rows[centres], atol=0.05)


def test_only_each_others_nearest_that_head_alike_are_one_road_user():
    boxes = np.array([[0.0, 0, 1, 4, 2, 1.5, 0.0], [5.0, 0, 1, 4, 2, 1.5, 0.0], [9.0, 0, 1, 4, 2, 1.5, 0.0]])
    others = boxes.copy()
    others[0, :2] += [0.5, 0.2]  # a road user seen by both
    others[1, 6] = 1.2  # heads elsewhere
    others[2, 0] += 3.0  # too far away
    others = np.concatenate([others, [[0.9, 0, 1, 4, 2, 1.5, 0.0]]])  # near the first, but not the nearest
    here = np.eye(4)
    pairs = object_pairs([[SeenBoxes.of(boxes, here), SeenBoxes.of(others, here)]], [here, here], 1.5)
    assert len(pairs) == 1
    assert pairs[0].residual.tolist() == pytest.approx([-0.5, -0.2, 0.0, 0.0])
    assert (pairs[0].one, pairs[0].other) == (0, 1)


def test_a_box_that_heads_backwards_is_the_same_road_user():
    box = np.array([[0.0, 0, 1, 4, 2, 1.5, 0.1]])
    round_about = box + np.array([[0, 0, 0, 0, 0, 0, np.pi - 0.05]])
    pairs = object_pairs([[SeenBoxes.of(box, np.eye(4)), SeenBoxes.of(round_about, np.eye(4))]], [np.eye(4)] * 2, 1.5)
    assert pairs[0].residual[3] == pytest.approx(0.05)


def test_sensors_that_see_no_road_user_together_have_no_rows():
    nothing = SeenBoxes(np.zeros((0, 3)), np.zeros((0, 3)))
    one = SeenBoxes.of(np.array([[0.0, 0, 1, 4, 2, 1.5, 0.1]]), np.eye(4))
    assert object_pairs([[one, nothing]], [np.eye(4)] * 2, 1.5) == []
    assert object_pairs([], [np.eye(4)] * 2, 1.5) == []


def test_a_detector_sees_level_ground_and_its_boxes_go_into_each_sensors_axes():
    sensor = Sensor("c", DepthCamera(width=40, height=30), look((0.0, 0.0, 6.0), heading=0.0, tilt=np.pi / 2))
    site = Site("slope", np.array([-20.0, -20, 20, 20]), relief=Relief(slope=(0.05, 0.0)))
    frame = Frame((sensor,), (np.full(sensor.model.shape, 5.0, np.float32),), Objects.empty())

    class Recorded(list):
        @property
        def site(self):
            return site

    box = np.array([[2.0, 1.0, 1.0, 4.0, 2.0, 1.5, 0.3]])

    def detector(points):
        assert np.allclose(points[:, 2], 1.0 - 0.05 * points[:, 0], atol=1e-5)
        return Detections(box, np.ones(1))

    seen = seen_objects(Recorded([frame]), [frame], detector)[0][0]
    world = transform(sensor.pose, seen.centres)
    np.testing.assert_allclose(world, [[2.0, 1.0, 1.1]], atol=1e-9)
    np.testing.assert_allclose(seen.ahead @ sensor.pose[:3, :3].T, [[np.cos(0.3), np.sin(0.3), 0.0]], atol=1e-9)
