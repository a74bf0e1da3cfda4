import numpy as np
import pytest

from toolkit.calibration.joint import Pairs, align, towards_sensor
from toolkit.calibration.registration import LEVER, Surface
from toolkit.geometry import invert, look, transform
from toolkit.sensors.errors.pose_errors import rotation_about

TRUE = (
    look((-8.0, -8.0, 6.0), heading=0.7, tilt=0.4),
    look((8.0, -8.0, 6.0), heading=2.4, tilt=0.4),
    look((0.0, -9.0, 6.0), heading=1.6, tilt=0.4),
)


def plane(rng, origin, one, two, count, noise=0.005):
    one, two = np.array(one, float), np.array(two, float)
    normal = np.cross(one, two) / np.linalg.norm(np.cross(one, two))
    points = np.array(origin) + rng.random((count, 1)) * one + rng.random((count, 1)) * two
    return points + noise * rng.standard_normal((count, 1)) * normal, np.tile(normal, (count, 1))


def world(rng, walls=True):
    """Ground and two walls, drawn anew for each sensor."""
    planes = [plane(rng, [-10, -10, 0], [20, 0, 0], [0, 20, 0], 3000)]
    if walls:
        planes += [plane(rng, [-10, 10, 0], [20, 0, 0], [0, 0, 5], 1200)]
        planes += [plane(rng, [10, -10, 0], [0, 20, 0], [0, 0, 5], 1200)]
    return (np.concatenate(parts) for parts in zip(*planes, strict=True))


def seen_by(pose, rng, walls=True):
    points, normals = world(rng, walls)
    local = Surface(transform(invert(pose), points), normals @ pose[:3, :3], np.full(len(points), 0.005))
    return towards_sensor(local)


def off(pose, rng, deg=1.0, metres=0.1):
    axis, way = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 3)))
    error = np.eye(4)
    error[:3, :3], error[:3, 3] = rotation_about(np.deg2rad(deg) * axis), metres * way
    return pose @ error


def apart(found, true):
    between = invert(true) @ found
    return np.rad2deg(np.linalg.norm(between[:3, :3] - np.eye(3)) / np.sqrt(2)), np.linalg.norm(between[:3, 3])


def test_sensors_are_fitted_to_the_one_that_is_held():
    rng = np.random.default_rng(0)
    surfaces = [seen_by(pose, rng) for pose in TRUE]
    believed = [TRUE[0], off(TRUE[1], rng), off(TRUE[2], rng)]
    found = align(surfaces, believed, held=[0])
    assert found.poses[0].tobytes() == TRUE[0].tobytes()
    for pose, true in zip(found.poses[1:], TRUE[1:], strict=True):
        turned, moved = apart(pose, true)
        assert turned < 0.05
        assert moved < 0.02
    assert len(found.unobserved) == 0
    assert np.all(np.diag(found.covariance)[:6] == 0.0)
    assert (np.diag(found.covariance)[6:] > 0.0).all()
    assert found.shared[0, 1] > 100
    assert (found.shared == found.shared.T).all()
    assert (found.scatter < 0.03).all()


def test_without_a_held_one_they_fit_each_other_and_keep_their_common_pose():
    rng = np.random.default_rng(1)
    surfaces = [seen_by(pose, rng) for pose in TRUE]
    believed = [off(pose, rng) for pose in TRUE]
    found = align(surfaces, believed)
    for k in (1, 2):
        relative = invert(found.poses[0]) @ found.poses[k]
        turned, moved = apart(relative, invert(TRUE[0]) @ TRUE[k])
        assert turned < 0.05
        assert moved < 0.02
    moved_by = np.mean([pose[:3, 3] - wrong[:3, 3] for pose, wrong in zip(found.poses, believed, strict=True)], axis=0)
    assert np.linalg.norm(moved_by) < 0.05
    assert len(found.unobserved) == 0


def test_on_a_bare_plane_each_sensor_keeps_two_moves_and_a_turn():
    rng = np.random.default_rng(2)
    surfaces = [seen_by(pose, rng, walls=False) for pose in TRUE]
    found = align(surfaces, [TRUE[0], off(TRUE[1], rng, 0.3, 0.03), TRUE[2]], held=[0])
    assert len(found.unobserved) == 6
    hidden = found.unobserved_of(1)
    assert len(hidden) == 3
    assert np.abs(hidden[:, [0, 1, 5]]).max() < 0.1
    assert len(found.unobserved_of(0)) == 0


def test_a_sensor_that_sees_nothing_in_common_is_not_observed_at_all():
    rng = np.random.default_rng(3)
    far = TRUE[2].copy()
    far[0, 3] += 500.0
    found = align([seen_by(TRUE[0], rng), seen_by(TRUE[1], rng), seen_by(TRUE[2], rng)], [*TRUE[:2], far], held=[0])
    assert len(found.unobserved_of(2)) == 6
    assert found.poses[2].tobytes() == far.tobytes()
    assert found.shared[2].sum() == 0


def test_the_two_sides_of_a_thin_wall_are_not_taken_for_one():
    rng = np.random.default_rng(4)
    planes = [plane(rng, [-10, -10, 0], [20, 0, 0], [0, 20, 0], 3000)]
    front = [*planes, plane(rng, [-10, 0.0, 0], [20, 0, 0], [0, 0, 4], 2000)]
    back = [*planes, plane(rng, [-10, 0.3, 0], [20, 0, 0], [0, 0, 4], 2000)]
    poses = [look((0.0, -8.0, 6.0), heading=1.57, tilt=0.4), look((0.0, 8.0, 6.0), heading=-1.57, tilt=0.4)]
    surfaces = []
    for pose, side in zip(poses, (front, back), strict=True):
        points, normals = (np.concatenate(parts) for parts in zip(*side, strict=True))
        local = Surface(transform(invert(pose), points), normals @ pose[:3, :3], np.full(len(points), 0.005))
        surfaces.append(towards_sensor(local))
    found = align(surfaces, poses, held=[0])
    assert np.abs(found.poses[1][:2, 3] - poses[1][:2, 3]).max() < 0.02


def test_more_pairs_say_what_the_scene_does_not():
    """Points that both sensors see at once fix the moves along a bare plane."""
    rng = np.random.default_rng(5)
    surfaces = [seen_by(pose, rng, walls=False) for pose in TRUE[:2]]
    marks = rng.uniform(-8, 8, (80, 3)) * [1, 1, 0.1]
    local = [transform(invert(pose), marks) for pose in TRUE[:2]]

    def more(poses, radius):
        here, there = (transform(pose, points) for pose, points in zip(poses, local, strict=True))
        rows = []
        for axis in np.eye(3):
            normals = np.tile(axis, (80, 1))
            turn = [np.cross(at - pose[:3, 3], normals) / LEVER for at, pose in zip((here, there), poses, strict=True)]
            rows.append((np.hstack([turn[0], normals]), -np.hstack([turn[1], normals]), (here - there) @ axis))
        one, other, residual = (np.concatenate(parts) for parts in zip(*rows, strict=True))
        return [Pairs(0, 1, one, other, residual, np.full(240, 0.01), np.full(240, 1.0))]

    found = align(surfaces, [TRUE[0], off(TRUE[1], rng, 0.5, 0.05)], held=[0], more=more)
    assert len(found.unobserved) == 0
    turned, moved = apart(found.poses[1], TRUE[1])
    assert turned < 0.05
    assert moved < 0.02


def test_normals_look_at_the_sensor():
    ahead = Surface(np.array([[0.0, 0, 5], [0, 0, 5]]), np.array([[0.0, 0, 1], [0, 0, -1]]), np.zeros(2))
    assert towards_sensor(ahead).normals[:, 2].tolist() == [-1.0, -1.0]


def test_one_sensor_and_held_ones_that_are_not_there_are_refused():
    surface = seen_by(TRUE[0], np.random.default_rng(6))
    with pytest.raises(ValueError, match="got 1 surfaces and 1 poses"):
        align([surface], [TRUE[0]])
    with pytest.raises(ValueError, match=r"held must be numbers of sensors, 0 to 1, got \[2\]"):
        align([surface] * 2, TRUE[:2], held=[2])
