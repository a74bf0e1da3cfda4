import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from placement_env.fidelity.coverage import Coverage
from placement_env.fidelity.perception_entropy import PerceptionEntropy
from placement_env.fidelity.visibility import Visibility
from placement_env.protocol import Fidelity
from toolkit.detection.codec import PAPER
from toolkit.detection.paper_schemes import Early
from toolkit.detection.scheme import estimate_bits


def visibility(points, sent=2.0, far=1.0, frames=2, distance=30.0):
    points = np.asarray(points, np.float32)
    candidates, objects = points.shape
    frame = np.arange(objects) * frames // max(1, objects)
    boxes = np.tile([0.0, 0, 0.7, 4, 2, 1.5, 0], (objects, 1))
    per_frame = (np.full((candidates, frames), each, np.float32) for each in (sent, far))
    return Visibility(points, np.full(points.shape, distance, np.float32), frame, boxes, *per_frame)


SEEN = visibility([[30, 30, 0, 5], [0, 30, 19, 20], [0, 0, 0, 0]])
SETS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 1], [0, 0, 1]], bool)


@pytest.mark.parametrize(
    ("views", "share"),
    [(1, [0, 0.5, 0.75, 0.75, 0]), (2, [0, 0, 0.25, 0.25, 0]), (3, [0, 0, 0, 0, 0])],
)
def test_share_of_objects_with_enough_views(views, share):
    estimate = Coverage(SEEN, views=views)(SETS)
    np.testing.assert_array_equal(estimate.ap, share)
    np.testing.assert_array_equal(estimate.recall, share)


@pytest.mark.parametrize(
    ("scheme", "kbit"), [("early", 2 * 96), ("late", 256 * 2 / 2), ("hybrid", 96 + 256 * 2 / 2)]
)
def test_what_one_sensor_sends(scheme, kbit):
    estimate = Coverage(SEEN, scheme)(SETS)
    assert estimate.kbit[1] == pytest.approx(kbit / 1000)
    assert estimate.kbit[0] == 0
    assert estimate.kbit[2] == pytest.approx(2 * kbit / 1000)


def test_coverage_of_nothing_in_whole_bits():
    assert isinstance(Coverage(SEEN), Fidelity)
    assert not Coverage(visibility(np.zeros((3, 0))))(SETS).ap.any()
    bits = estimate_bits(Early(), PAPER, visibility(np.ones((3, 4)), sent=1.3), np.zeros(3))
    np.testing.assert_array_equal(bits, np.rint(bits))


@pytest.mark.parametrize("arguments", [{"min_points": 0.0}, {"views": 0}])
def test_refuses_what_is_no_view(arguments):
    with pytest.raises(ValueError, match="got"):
        Coverage(SEEN, **arguments)


@pytest.mark.parametrize("sets", [SETS[0], SETS[:, :2], SETS.astype(int)])
def test_refuses_what_are_no_sets(sets):
    with pytest.raises((ValueError, TypeError)):
        Coverage(SEEN)(sets)


@given(st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_one_view_is_monotone_and_submodular(seed):
    rng = np.random.default_rng(seed)
    coverage = Coverage(visibility(rng.integers(0, 60, (6, 12))))
    small = rng.random(6) < 0.3
    large = small | (rng.random(6) < 0.5)
    new = np.arange(6) == rng.integers(6)
    before, after, wide, wider = coverage(np.stack([small, small | new, large, large | new])).ap
    assert before <= after
    assert before <= wide
    assert after - before >= wider - wide - 1e-12


def test_entropy_falls_with_the_points_on_a_vehicle(made_visibility):
    """More points on every vehicle are never worse, none at all are worth nothing."""
    seen = made_visibility(6, 40)
    sets = np.eye(6, dtype=bool)
    richer = Visibility(seen.points * 3, seen.distance, seen.frame, seen.boxes, seen.sent, seen.far)
    blind = Visibility(seen.points * 0, seen.distance, seen.frame, seen.boxes, seen.sent, seen.far)
    assert (PerceptionEntropy(richer)(sets).ap >= PerceptionEntropy(seen)(sets).ap).all()
    assert (PerceptionEntropy(richer)(sets).ap > PerceptionEntropy(seen)(sets).ap).any()
    assert not PerceptionEntropy(blind)(sets).ap.any()
