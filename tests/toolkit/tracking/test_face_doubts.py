"""Doubts and sizes of tracked bodies, against closed formulas and SciPy's expectile."""

import numpy as np
import pytest
from scipy.stats import expectile

from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE
from toolkit.tracking.face_doubts import (
    HIDDEN_TOP_WEIGHTS,
    LARGER_WEIGHTS,
    MIN_HIDDEN_TOP_M,
    USUAL_MISFIT,
    calibrate_doubts,
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


def find_expectile(values, weights, larger_weight):
    return expectile(values, larger_weight / (1 + larger_weight), weights=weights)


def test_lengths_and_heights_of_long_bodies_are_expectiles_and_others_means(measured):
    sizes, weights = measured
    mean = np.average(sizes, axis=0, weights=weights)
    assert estimate_size(sizes, weights, CYCLIST) == pytest.approx(mean)
    larger = LARGER_WEIGHTS[HEAVY]
    length, width, height = estimate_size(sizes, weights, HEAVY)
    assert length == pytest.approx(find_expectile(sizes[:, 0], weights[:, 0], larger), abs=1e-3)
    assert width == pytest.approx(mean[1])
    assert height == pytest.approx(find_expectile(sizes[:, 2], weights[:, 2], larger), abs=1e-3)


def test_heights_of_cars_are_expectiles_if_their_tops_are_hidden(measured):
    sizes, weights = measured
    weights[:, 2] = 1 / 0.02**2
    mean = np.average(sizes, axis=0, weights=weights)
    assert estimate_size(sizes, weights, VEHICLE) == pytest.approx(mean)
    weights[:, 2] = 1 / (1.01 * MIN_HIDDEN_TOP_M) ** 2
    height = find_expectile(sizes[:, 2], weights[:, 2], HIDDEN_TOP_WEIGHTS[VEHICLE])
    size = estimate_size(sizes, weights, VEHICLE)
    assert size == pytest.approx([*mean[:2], height], abs=1e-3)


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
    assert combined[0, 1] == pytest.approx(0.0535, abs=1e-3)
    scattered = combine_doubts(doubts, size_doubts, np.array([VEHICLE]), misfit=4 * usual)
    assert scattered[0, :2] == pytest.approx(2 * combined[0, :2], rel=0.02)


def test_a_hidden_end_of_a_truck_is_doubted_more_than_one_of_a_car():
    doubts = np.array([[0.01, 0.12, 0.02, 0.02, 0.05]] * 3)
    labels = np.array([PEDESTRIAN, VEHICLE, HEAVY])
    person, car, truck = calibrate_doubts(doubts, labels)
    assert person.tolist() == doubts[0].tolist()
    assert car[1] == pytest.approx(0.21, abs=0.01)
    assert car[[0, 2, 3]] == pytest.approx(doubts[0, [0, 2, 3]], rel=0.03)
    assert truck[[0, 2, 3]] == pytest.approx(doubts[0, [0, 2, 3]], rel=0.1)
    assert truck[1] == pytest.approx(0.47, abs=0.01)
    usual = np.full((2, 3), USUAL_MISFIT)
    # hidden ends follow from lengths that are as unsure
    size_doubts = np.array([[0.12, 0.03, 0.05]] * 2)
    doubts = doubts[1:]
    car, truck = combine_doubts(doubts, size_doubts, labels[1:], misfit=usual)
    assert car[1] == pytest.approx(0.21, abs=0.01)
    assert truck[1] == pytest.approx(0.47, abs=0.01)
    # one size for all detections of one body
    of_one = combine_doubts(doubts, size_doubts[:1], np.array([HEAVY] * 2), misfit=usual[:1])
    assert of_one == pytest.approx(np.array([truck, truck]))


def test_ends_grow_by_the_length_sides_by_the_width_and_the_top_by_the_height():
    misfit = USUAL_MISFIT * np.array([[4.0, 9.0, 16.0]])
    assert inflate_doubts(np.ones((1, 5)), misfit) == pytest.approx(np.array([[2, 2, 3, 3, 4]]))
