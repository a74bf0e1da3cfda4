"""The space an empty site fills."""

import numpy as np
import pytest

from toolkit.detection.background import MIN_NEW_SHARE, Background, KnownBackground
from toolkit.detection.provenance import detector_origin
from toolkit.objects import HEAVY, LABELS, VEHICLE, Detections, known_labels
from toolkit.points import join_clouds


def slab(step=0.1):
    """A street at 0 with a wall along x = 5 from 0 to 3 m."""
    x, y = np.meshgrid(np.arange(-5, 5, step), np.arange(-5, 5, step))
    ground = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    y, z = np.meshgrid(np.arange(-5, 5, step), np.arange(0, 3, step))
    return np.concatenate([ground, np.column_stack([np.full(y.size, 5.0), y.ravel(), z.ravel()])])


def test_a_background_holds_what_lies_in_or_beside_its_voxels():
    background = Background.learn(slab())
    own = slab() + np.random.default_rng(0).normal(0, 0.03, slab().shape)
    assert background.holds(own).all()
    above = np.array([[0.0, 0, 0.5], [0, 0, 3.0], [4.5, 0, 1.0], [-40, 0, 0], [0, 0, -5]])
    assert not background.holds(above).any()
    assert background.holds(np.array([[0.0, 0, 0.14], [4.87, 0, 1.0]])).all()
    background = Background.learn(slab())
    assert background.digest == Background.learn(slab()).digest
    others = [
        Background.learn(slab()[:-600]),
        Background.learn(slab(), voxel=0.2),
        Background.learn(slab(), cell=2.0),
    ]
    moved = slab()
    moved[:, 0] += 0.01
    others.append(Background.learn(moved))
    assert len({background.digest, *(each.digest for each in others)}) == 5


@pytest.mark.parametrize(
    "points", [np.zeros((0, 3)), np.full((3, 3), np.nan), np.array([[0.0, 0, 0], [1e5, 1e5, 1e5]])]
)
def test_a_background_that_is_none_is_refused(points):
    with pytest.raises(ValueError, match="background"):
        Background.learn(points)


WALL = np.array([6.0, 0, 1.0, 4, 0.6, 1.8, 0])
CAR = np.array([0.0, 0, 0.8, 4, 1.8, 1.5, 0])
BEHIND = np.array([0.0, 8, 0.8, 4, 1.8, 1.5, 0])


def ground():
    x, y = np.meshgrid(np.arange(-10, 10, 0.1), np.arange(-10, 10, 0.1))
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.02)])


def on(box, count, seed=0):
    """Points on the upper part of a box."""
    offsets = np.random.default_rng(seed).uniform([-0.5, -0.5, 0.2], 0.5, (count, 3)) * 0.98
    return box[:3] + offsets * box[3:6]


EMPTY = np.concatenate([ground(), on(WALL, 20000)])


class Fixed:
    digest, labels = "fixed", ("vehicle", "heavy")

    def __call__(self, points):
        return Detections(
            np.array([WALL, CAR, BEHIND]),
            np.array([0.9, 0.8, 0.7]),
            np.array([HEAVY, VEHICLE, VEHICLE]),
        )


@pytest.fixture(scope="module")
def background():
    return Background.learn(EMPTY)


def seen(new, old=200):
    """The empty site, so many of its points in the car's box, and new ones there."""
    inside = np.tile([[0.5, 0.2, 0.1]], (old, 1))
    return np.concatenate([on(WALL, 500, 1), inside, on(CAR, new, 2)]).astype(np.float32)


def test_newcomers_stay(background):
    assert detector_origin(KnownBackground(Fixed(), background))["detector"] == "Fixed+background"
    found = KnownBackground(Fixed(), background)(seen(100))
    assert found.labels.tolist() == [VEHICLE]
    np.testing.assert_array_equal(found.boxes, [CAR])
    assert found.scores.tolist() == [0.8]


def test_clouds_without_finite_points_have_no_detections(background):
    known = KnownBackground(Fixed(), background)
    np.testing.assert_array_equal(known(np.array([[0.0, 0, 1.0]])).boxes, [CAR])
    assert len(known(np.zeros((0, 3)))) == 0
    lost = np.concatenate([seen(60), np.full((10, 3), np.nan, np.float32), [[np.inf, 0, 1]]])
    np.testing.assert_array_equal(KnownBackground(Fixed(), background)(lost).boxes, [CAR])

    def nobody(points):
        return Detections.empty()

    assert len(KnownBackground(nobody, background)(seen(10))) == 0


def test_known_background_has_the_detectors_labels_and_a_digest(background):
    known = KnownBackground(Fixed(), background)
    assert known_labels(known) == tuple(label for label in LABELS if label in Fixed.labels)
    other = Background.learn(ground())
    digests = {Fixed.digest, known.digest, KnownBackground(Fixed(), other).digest}
    digests.add(KnownBackground(Fixed(), background, 0.3).digest)
    assert len(digests) == 4
    assert KnownBackground(Fixed(), Background.learn(EMPTY)).digest == known.digest
    bare = KnownBackground(lambda points: Detections.empty(), background)
    assert not hasattr(bare, "digest")
    assert known_labels(bare) is None


@pytest.mark.parametrize(("new", "stays"), [(0, False), (49, False), (50, True), (51, True)])
def test_from_a_fifth_of_new_points_on_somebody_is_there(background, new, stays):
    assert MIN_NEW_SHARE == 0.2
    assert len(KnownBackground(Fixed(), background)(seen(new))) == stays


@pytest.mark.parametrize("least", [0.0, -0.1, 1.1, float("nan")])
def test_a_share_that_is_none_is_refused(background, least):
    with pytest.raises(ValueError, match="least must be a share"):
        KnownBackground(Fixed(), background, least)


class FixedAtOnce(Fixed):
    """It is asked for unions alone."""

    def __call__(self, points):
        raise AssertionError

    def unions(self, clouds, unions):
        return [Fixed()(None)] * len(unions)


@pytest.mark.parametrize("detector", [Fixed(), FixedAtOnce()])
def test_of_many_unions_it_says_what_it_says_of_each(background, detector):
    lost = np.full((10, 3), np.nan, np.float32)
    clouds = [
        seen(0),
        seen(49),
        seen(60, old=0),
        np.concatenate([on(BEHIND, 9).astype(np.float32), lost]),
        lost[:0],
    ]
    unions = np.array(list(np.ndindex(*(2,) * 5)), bool)
    found = KnownBackground(detector, background).unions(clouds, unions)
    for row, each in zip(unions, found, strict=True):
        alone = KnownBackground(Fixed(), background)(join_clouds(clouds, row))
        np.testing.assert_array_equal(each.boxes, alone.boxes)
    assert {len(each) for each in found} == {0, 1, 2}
