from dataclasses import replace

import numpy as np
import pytest

from toolkit.geometry import check_pose
from toolkit.sensors.errors.pose_errors import Calibration, PoleSway, rotation_about


def angle_between(a, b):
    return np.arccos(np.clip((np.trace(a[:3, :3].T @ b[:3, :3]) - 1) / 2, -1, 1))


def test_rotation_about_is_a_rotation_by_its_length():
    rng = np.random.default_rng(0)
    for _ in range(50):
        vector = rng.normal(size=3)
        turned = rotation_about(vector)
        assert np.allclose(turned @ turned.T, np.eye(3))
        assert np.linalg.det(turned) == pytest.approx(1)
        assert np.allclose(turned @ vector, vector)
        assert np.trace(turned) == pytest.approx(1 + 2 * np.cos(np.linalg.norm(vector)))
        assert np.allclose(turned @ rotation_about(-vector), np.eye(3))
    assert np.array_equal(rotation_about(np.zeros(3)), np.eye(3))


def test_calibration_has_its_root_mean_square_and_no_axis_is_preferred(read, street):
    term, true = Calibration(0.01, 0.05), np.linalg.inv(street.sensor.pose)
    errors = np.array([true @ read(term, street, number=n).pose for n in range(800)])
    moves = errors[:, :3, 3]
    turns = np.stack([errors[:, 2, 1], errors[:, 0, 2], errors[:, 1, 0]], axis=1)  # to first order
    assert np.allclose(moves.std(axis=0), 0.05 / 3**0.5, rtol=0.08)
    assert np.allclose(turns.std(axis=0), 0.01 / 3**0.5, rtol=0.08)
    angles = np.array([angle_between(each, np.eye(4)) for each in errors])
    assert np.sqrt((angles**2).mean()) == pytest.approx(0.01, rel=0.04)
    assert np.sqrt((moves**2).sum(axis=1).mean()) == pytest.approx(0.05, rel=0.04)
    assert np.abs(moves.mean(axis=0)).max() < 0.007
    assert np.abs(turns.mean(axis=0)).max() < 0.0014


def test_calibration_is_constant_over_frames_and_scales(read, street):
    said = [read(Calibration(0.01, 0.05), street, frame=frame) for frame in (0, 1, 900)]
    assert all(np.array_equal(each.pose, said[0].pose) for each in said)
    assert all(each.measurement is street.measurement for each in said)
    check_pose(said[0].pose)
    doubled = read(Calibration(0.02, 0.1), street).pose
    single = said[0].pose
    assert angle_between(doubled, street.sensor.pose) == pytest.approx(2 * angle_between(single, street.sensor.pose))
    assert np.allclose(doubled[:3, 3] - street.sensor.position, 2 * (single[:3, 3] - street.sensor.position))
    assert not np.array_equal(read(Calibration(0.01, 0.05), street, number=6).pose, single)


def test_a_pole_sways_with_time_about_a_level_axis(read, street):
    term = PoleSway(0.004, 3.0)
    height, rest = street.sensor.position[2], street.sensor.pose
    angles, moves = [], []
    for time in np.linspace(0, 60, 400):
        pose = read(term, replace(street, time=float(time))).pose
        check_pose(pose)
        angles.append(angle_between(pose, rest))
        moves.append(pose[:3, 3] - rest[:3, 3])
        assert np.linalg.norm(moves[-1]) == pytest.approx(2 / 3 * height * angles[-1], abs=1e-6)
    tips = np.array(moves)
    assert max(angles) == pytest.approx(0.004, rel=0.01)
    assert min(angles) < 4e-4
    assert not tips[:, 2].any()
    assert np.linalg.matrix_rank(tips, tol=1e-9) == 1
    crossings = int((np.diff(np.sign(tips @ tips[np.abs(tips).sum(axis=1).argmax()])) != 0).sum())
    assert 60 / 4.0 * 2 - 1 <= crossings <= 60 / 2.0 * 2 + 1  # two a period of 2 to 4 s


def test_sensors_of_a_pole_sway_together(read, street):
    other = replace(street.sensor, name="other")
    said = [
        read(PoleSway(0.004), replace(street, sensor=s), number=n).pose for n, s in ((1, street.sensor), (2, other))
    ]
    assert np.array_equal(*said)


def test_no_strength_no_change(harmless, street):
    harmless(Calibration(), street)
    harmless(PoleSway(), street)


def test_wrong_numbers():
    for wrong in (lambda: Calibration(-0.1), lambda: Calibration(0.0, float("inf")), lambda: PoleSway(0.1, 0.0)):
        with pytest.raises(ValueError, match="must be a number from"):
            wrong()
