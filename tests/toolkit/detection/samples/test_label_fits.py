import numpy as np
import pytest

from toolkit.datasets.sample import Sample, SensorCloud
from toolkit.detection.samples.label_fits import LEAST_ON_BOX, Seen, better, fits, fits_in
from toolkit.objects import Objects

BOX = np.array([[10.0, 0, 1.0, 4, 2, 2, 0.0]])


def face(x, count=40, z=(0.5, 1.5)):
    """Points on a wall across x."""
    return np.column_stack([np.full(count, x), np.linspace(-0.9, 0.9, count), np.linspace(*z, count)])


def test_points_on_a_face_fit_and_those_within_or_around_do_not():
    assert fits_in(face(8.0), BOX).tolist() == [1.0]
    assert fits_in(face(10.0)[np.abs(face(10.0)[:, 1]) < 0.5], BOX).tolist() == [0.0]  # in the hollow of the vehicle
    assert fits_in(face(7.6), BOX).tolist() == [0.0]  # in the shell, beside the box
    assert fits_in(np.concatenate([face(8.0), face(7.6)]), BOX).tolist() == [0.5]
    assert fits_in(np.concatenate([face(8.0), face(7.0)]), BOX).tolist() == [1.0]  # beyond the shell


def test_a_face_may_stand_out_by_the_slack():
    assert fits_in(face(7.91), BOX).tolist() == [1.0]
    assert fits_in(face(7.89), BOX).tolist() == [0.0]


def test_a_box_of_few_points_says_nothing():
    assert fits_in(face(8.0, LEAST_ON_BOX), BOX).tolist() == [1.0]
    assert fits_in(face(8.0, LEAST_ON_BOX - 1), BOX).tolist() == [0.0]


def test_a_box_is_turned():
    turned = BOX.copy()
    turned[0, 6] = np.pi / 2  # 1 m ahead and behind, 2 m aside
    wall = face(9.0)
    assert fits_in(wall, turned).tolist() == [1.0]
    assert fits_in(wall[np.abs(wall[:, 1]) < 0.5], BOX).tolist() == [0.0]


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        (np.zeros(5), np.ones(5), True),
        (np.zeros(4), np.ones(4), False),  # too few
        (np.zeros(20), np.r_[np.ones(4), np.zeros(16)], False),  # four alone have any fit
        (np.full(9, 0.5), np.full(9, 0.515), False),  # hardly any gain
        (np.full(9, 0.5), np.full(9, 0.53), True),
        (np.full(10, 0.5), 0.5 + np.array([0.5, -0.4] * 5), False),  # chance
    ],
)
def test_better_by_more_than_chance(before, after, said):
    assert better(before, after) is said


def test_a_gain_may_be_asked_for():
    assert not better(np.full(9, 0.5), np.full(9, 0.6), 0.15)


def test_what_is_seen_of_a_sample():
    rng = np.random.default_rng(0)
    ground = np.column_stack([rng.uniform(-20, 20, (3000, 2)), np.full(3000, 2.0)])
    points = np.concatenate([ground, face(8.0, z=(2.5, 3.5))]).astype(np.float32)
    cloud = SensorCloud("s", points, np.eye(4))
    seen = Seen.of(Sample("0", (cloud,), Objects(BOX + np.array([0, 0, 2.0, 0, 0, 0, 0]))))
    assert len(seen.points) == 40
    np.testing.assert_allclose(seen.heights(BOX + np.array([0, 0, 2.5, 0, 0, 0, 0])), [1.5], atol=0.02)
    assert fits([seen, seen], [BOX + np.array([0, 0, 2.0, 0, 0, 0, 0]), np.zeros((0, 7))]).tolist() == [1.0]
    nothing = Seen.of(Sample("0", (SensorCloud("s", points[:2], np.eye(4)),), Objects(BOX)))
    assert (len(nothing.points), len(nothing.heights(BOX))) == (2, 0)
