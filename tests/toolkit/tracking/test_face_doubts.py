"""Doubts and sizes of tracked bodies, against closed formulas and SciPy's expectile."""

import numpy as np
import pytest
from scipy.stats import expectile

from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE
from toolkit.tracking.face_doubts import (
    LONGER_WEIGHTS,
    USUAL_MISFIT,
    combine_doubts,
    doubt_sizes,
    estimate_size,
    find_inflation,
    find_misfit,
    inflate_doubts,
    weigh_sizes,
)


@pytest.fixture
def measured():
    rng = np.random.default_rng(2)
    sizes = rng.normal([16.0, 2.5, 3.5], [1.5, 0.1, 0.1], (40, 3))
    return sizes, weigh_sizes(rng.uniform(0.02, 0.4, (40, 5)))


def test_lengths_of_long_bodies_are_an_expectile_and_others_means(measured):
    sizes, weights = measured
    mean = np.average(sizes, axis=0, weights=weights)
    assert estimate_size(sizes, weights, VEHICLE) == pytest.approx(mean)
    longer = LONGER_WEIGHTS[HEAVY]
    length = expectile(sizes[:, 0], longer / (1 + longer), weights=weights[:, 0])
    assert estimate_size(sizes, weights, HEAVY) == pytest.approx([length, *mean[1:]], abs=1e-3)


def test_no_number_of_like_detections_makes_a_size_surer(measured):
    _, weights = measured
    doubts = doubt_sizes(weights.sum(axis=0), np.sqrt(weights).sum(axis=0))
    of_each = 1 / np.sqrt(weights)
    assert doubts == pytest.approx(np.average(of_each, axis=0, weights=weights))
    once = weights[:1]
    many = doubt_sizes(30 * once, 30 * np.sqrt(once))
    assert many == pytest.approx(doubt_sizes(once, np.sqrt(once)))


@pytest.mark.parametrize("scatter", [0.5, 1.0, 3.0])
def test_doubts_grow_to_what_explains_the_scatter_and_never_shrink(scatter):
    doubts = np.tile([0.3, 0.4, 0.06, 0.08, 0.1], (5000, 1))
    # a doubt is a mean absolute error, so errors spread by sqrt(pi / 2) times as much
    spread = scatter * np.sqrt(np.pi / 2) / np.sqrt(weigh_sizes(doubts))
    errors = np.random.default_rng(0).normal(0, spread)
    misfit = find_misfit(errors, weigh_sizes(doubts), VEHICLE)[None]
    factor = max(1.0, scatter)
    assert find_inflation(misfit)[0] == pytest.approx([factor] * 3, rel=0.05)
    for label in (PEDESTRIAN, CYCLIST):  # whose sizes may scatter
        of_person = find_misfit(errors, weigh_sizes(doubts), label)
        assert find_inflation(of_person[None])[0] == pytest.approx([1.0] * 3)
    assert inflate_doubts(doubts[:1], misfit) == pytest.approx(factor * doubts[:1], rel=0.05)


def test_a_hidden_face_follows_from_the_opposite_one_and_the_size():
    doubts = np.array([[0.03, 2.0, 0.02, 0.02, 0.05]])
    usual = np.full((1, 3), USUAL_MISFIT)
    size_doubts = np.array([[0.04, 0.02, 0.05]])
    combined = combine_doubts(doubts, size_doubts, np.array([VEHICLE]), misfit=usual)
    assert combined[0, 1] == pytest.approx(0.05, abs=1e-3)
    scattered = combine_doubts(doubts, size_doubts, np.array([VEHICLE]), misfit=4 * usual)
    assert scattered[0, :2] == pytest.approx(2 * combined[0, :2], rel=0.02)


def test_ends_grow_by_the_length_sides_by_the_width_and_the_top_by_the_height():
    misfit = USUAL_MISFIT * np.array([[4.0, 9.0, 16.0]])
    assert inflate_doubts(np.ones((1, 5)), misfit) == pytest.approx(np.array([[2, 2, 3, 3, 4]]))
