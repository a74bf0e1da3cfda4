"""Rivals: boxes of other classes at one place, by hand."""

from dataclasses import replace

import numpy as np
import pytest

from models.config import VoxelNetConfig, road_users
from models.network.rivals import LEAST_RIVAL, contested, strongest_rivals
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE, Detections

CONFIG = VoxelNetConfig.light((-20, -20, 20, 20), **road_users())  # vehicle, heavy, cyclist, pedestrian
ROWS = (
    (1.0, 0.0, 9.0, 2.0, 0.0, 0.0),
    (1.0, 0.0, 0.0, 9.0, 0.0, 0.0),
    (2.0, -0.5, 0.0, 0.0, 0.0, 3.0),
    (1.0,) + (0.0,) * 5,
)


def street():
    """A cyclist that is a pedestrian as well, a truck whose cab is a vehicle, and a pedestrian beside the truck."""
    boxes = [
        [0, 0, 0.8, 1.8, 0.6, 1.6, 0],
        [0.4, 0, 0.8, 0.6, 0.6, 1.6, 1.0],
        [10, 0, 1.6, 9, 2.5, 3.2, 0],
        [13, 0.1, 0.9, 4, 1.9, 1.8, 0],
        [10, 1.45, 0.8, 0.6, 0.6, 1.7, 0],
    ]
    labels = np.array([CYCLIST, PEDESTRIAN, HEAVY, VEHICLE, PEDESTRIAN])
    return Detections(np.array(boxes), np.array([0.6, 0.7, 0.9, 0.5, 0.8]), labels)


def test_rivals_are_of_other_classes_at_the_same_place():
    expected = np.zeros((5, 4))
    expected[0, 3], expected[1, 2] = 0.7, 0.6
    expected[2, 0], expected[3, 1] = 0.5, 0.9
    np.testing.assert_array_equal(strongest_rivals(street(), CONFIG), expected)
    assert strongest_rivals(Detections.empty(), CONFIG).shape == (0, 4)


def test_nobody_of_a_low_score_is_a_rival():
    found = street()
    weak = Detections(found.boxes, np.array([0.6, 0.9 * LEAST_RIVAL, 0.9, LEAST_RIVAL, 0.8]), found.labels)
    rivals = strongest_rivals(weak, CONFIG)
    assert rivals[0, 3] == 0
    assert rivals[2, 0] == LEAST_RIVAL


def test_the_strongest_counts_once():
    found = street()
    beside = found.boxes[1:2].copy()
    beside[:, 0] += 0.1
    more = Detections.merge([found, Detections(beside, np.array([0.75]), np.array([PEDESTRIAN]))])
    assert strongest_rivals(more, CONFIG)[0].tolist() == [0, 0, 0, 0.75]


def test_scores_are_what_the_rivals_leave():
    after = contested(street(), replace(CONFIG, rivalry=ROWS))

    def sigmoid(x):
        return 1 / (1 + np.exp(-x))

    def logit(p):
        return np.log(p / (1 - p))

    expected = [sigmoid(2 * logit(0.6) - 0.5 - 3 * 0.7), 0.7, 0.9, sigmoid(logit(0.5) - 2 * 0.9), 0.8]
    np.testing.assert_allclose(after.scores, expected, atol=1e-12)
    np.testing.assert_array_equal(after.boxes, street().boxes)
    np.testing.assert_array_equal(after.labels, street().labels)


@pytest.mark.parametrize("found", [street(), Detections.empty()])
def test_without_rivalry_nothing_changes(found):
    assert contested(found, CONFIG) is found


def test_certain_scores_stay_finite():
    sure = Detections(street().boxes, np.array([1.0, 0.0, 1.0, 0.0, 1.0]), street().labels)
    assert np.isfinite(contested(sure, replace(CONFIG, rivalry=ROWS)).scores).all()
