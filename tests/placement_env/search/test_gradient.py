"""Gradient ascent on a smooth coverage: against derivatives known in closed form, and at a junction."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.classes import Classes
from placement_env.fidelity.visibility import Visibility
from placement_env.objective import Objective
from placement_env.search import gradient, greedy
from placement_env.search.cmaes import Coding, angles, look_of
from placement_env.setting import Weights

TARGETS = np.array([[5.0, 0.4, 0.3], [5.0, 1.2, 0.1], [6.5, 0.4, 0.6]])  # height, heading, tilt that see an object best


def look(sensors):
    """Points on three objects, by how near a sensor is to what sees each best."""
    off = np.array([[np.abs(np.subtract(angles(s), t)).sum() for t in TARGETS] for s in sensors])
    shape = (len(sensors), 1)
    points = (30.0 * np.exp(-(off**2))).astype(np.float32)
    sent = np.zeros(shape, np.float32)
    frame, boxes, labels = np.zeros(3, np.int64), np.zeros((3, 7)), np.array([0, 0, 2])
    return Visibility(points, np.ones_like(points), frame, boxes, sent, sent, labels)


@pytest.fixture
def start(make):
    return make(4, 1).candidates.select([0, 2])


def scorer(make):
    any_score = make(3, 1).score([0])

    def place(sets):
        points = [look(chosen).points.astype(np.float64).sum(axis=0) for chosen in sets]
        values = gradient.smooth_coverage(np.array(points), np.zeros(3, int), Classes())
        return [replace(any_score, ap=float(v), reward=float(v)) for v in values]

    return place


def test_smooth_coverage_saturates_and_combines_classes():
    points, labels = np.array([[0.0, 20.0, 1e6], [20.0, 20.0, 20.0]]), np.array([0, 0, 2])
    once = 1 - np.exp(-1)
    both = Classes(("vehicle", "pedestrian"))
    assert gradient.smooth_coverage(points, labels, both) == pytest.approx([(once / 2 + 1) / 2, once])
    worst = replace(both, combine="worst")
    assert gradient.smooth_coverage(points, labels, worst) == pytest.approx([once / 2, once])
    assert gradient.smooth_coverage(np.zeros((1, 0)), np.zeros(0, int), Classes()).tolist() == [0.0]


@pytest.mark.parametrize("classes", [Classes(), Classes(("vehicle", "pedestrian"))])
def test_the_gradient_is_that_of_moving_one_entry_at_a_time(start, classes):
    """Points of the sensors that stay are not looked at again, and still count."""
    coding = Coding(start, roam=False)
    vector = gradient.bounded(coding.encode() + 0.1)
    calls = []

    def counted(sensors):
        calls.append(len(sensors))
        return look(sensors)

    found = gradient.gradient(counted, coding, vector, classes)
    assert calls == [2 + 2 * 6]

    def value(at):
        seen = look(coding.decode(at))
        return gradient.smooth_coverage(seen.points.astype(float).sum(axis=0)[None], seen.labels, classes)[0]

    for d, reach in enumerate(np.tile(gradient.APART, 2)):
        up, down = vector.copy(), vector.copy()
        up[d] += reach
        down[d] -= reach
        assert found[d] == pytest.approx((value(up) - value(down)) / (2 * reach), rel=1e-4)


def test_differences_at_a_bound_are_taken_within_it(start):
    coding = Coding(start, roam=False)
    vector = coding.encode()
    vector[0], vector[2] = 1.0, 0.0
    seen = []

    def noted(sensors):
        seen.extend(sensors)
        return look(sensors)

    gradient.gradient(noted, coding, vector, Classes())
    heights = [sensor.position[2] for sensor in seen]
    assert max(heights) <= 8.0
    assert min(angles(sensor)[2] for sensor in seen) >= np.deg2rad(-5.0) - 1e-9


def test_it_climbs_within_its_limits_and_is_repeatable(make, start):
    place = scorer(make)
    first, again = (gradient.ascend(place, look, start, classes=Classes(), seed=3, evaluations=520) for _ in range(2))
    before = place([start.sensors])[0].reward
    assert first.best.reward > before + 0.15
    assert first.sensors == again.sensors
    assert 520 <= first.evaluations < 520 + 13  # a step of 6 differences to either side, and its score
    assert (np.diff(first.history.reward) >= 0).all()
    assert place([first.sensors])[0].reward == first.best.reward


def test_what_may_not_be_built_is_never_the_answer(make, start):
    place = scorer(make)

    def low_ones(sets):
        fits = [all(sensor.position[2] <= 5.2 for sensor in sensors) for sensors in sets]
        return [score if fit else None for score, fit in zip(place(sets), fits, strict=True)]

    found = gradient.ascend(low_ones, look, start, classes=Classes(), evaluations=200)
    assert all(sensor.position[2] <= 5.2 for sensor in found.sensors)
    with pytest.raises(ValueError, match="may not be built"):
        gradient.ascend(lambda sets: [None] * len(sets), look, start, classes=Classes())


def test_at_a_junction_it_begins_at_greedys_set_and_is_no_worse():
    objective = Objective("tjunction", 1, fidelity="coverage")
    found, first = gradient.search(objective, 1, evaluations=5), greedy.search(objective, 1)
    assert (found.method, found.evaluations) == ("gradient", 1 + 6 + 1)
    assert found.best.subset == first.best.subset
    assert found.best.reward >= first.best.reward > 0
    assert len(found.sensors) == 1
    assert found.certificate.kind == "none"
    one = objective.candidates.sensors[:1]
    assert np.array_equal(look_of(objective.preparation)(one).points, objective.visibility.points[:1])


def test_where_no_sensor_pays_there_is_none_to_move():
    objective = Objective("tjunction", 1, fidelity="coverage", weights=Weights(price=5.0))
    assert gradient.search(objective, 2, evaluations=8).best.subset == ()


def test_what_it_does_not_know_is_refused(make):
    with pytest.raises(ValueError, match="gradient ascent moves sensors, so it needs an objective made from a site"):
        gradient.search(make(4, 1), 2)
    several = Objective("tjunction", 1, fidelity="surrogate", iou=(0.7, 0.8))
    with pytest.raises(ValueError, match="gradient ascent knows one IoU threshold"):
        gradient.search(several, 2)
