"""Figures of variants, against sums by hand over the surrogate's chances of a hit."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from placement_env import LivePlanner
from placement_env.analysis.intervals import BLOCK_FRAMES, Interval
from placement_env.cases import LEVEL_NAMES
from placement_env.live import figures
from placement_env.live.figures import LEVELS, LiveAnswer

FRAMES = 6


@pytest.fixture(scope="module")
def planner():
    return LivePlanner("tjunction", frames=FRAMES, seed=3)


@pytest.fixture(scope="module")
def answer(planner):
    return planner.finish()


def test_shares_are_means_of_chances(planner, answer):
    seen = planner.unseen
    assert answer.recall == pytest.approx(answer.probability.mean(), abs=1e-6)
    assert (answer.objects, answer.frames) == (len(seen.boxes), FRAMES)


def test_levels_of_traffic_have_shares_of_their_own(planner, answer):
    seen = planner.unseen
    parts = planner.preparation.split(LEVELS)
    assert sorted(np.concatenate(parts).tolist()) == list(range(FRAMES))
    assert [level.name for level in answer.levels] == list(LEVEL_NAMES[LEVELS])
    for level, part in zip(answer.levels, parts, strict=True):
        here = np.isin(seen.frame, part)
        assert level.objects == here.sum()
        assert level.recall == pytest.approx(answer.probability[here].mean(), abs=1e-6)
        assert level.ap is None


def test_approaches_and_classes_add_up(answer):
    assert sum(row.objects for row in answer.approaches) == answer.objects
    (vehicles,) = answer.classes
    assert (vehicles.name, vehicles.objects) == ("vehicle", answer.objects)
    assert vehicles.ap == pytest.approx(answer.ap, abs=1e-6)


def test_who_is_hidden_is_seen_by_no_sensor_that_works(planner, answer):
    variant = planner.variant
    candidates = planner.yard.candidates(variant)
    points = planner.look(candidates)[0].points
    assert answer.hidden.tolist() == (points.sum(axis=0) == 0).tolist()
    assert answer.unseen == answer.hidden.sum()
    failed = tuple(replace(sensor, failed=sensor.name != "d0") for sensor in variant.sensors)
    silent = planner.estimate(replace(variant, sensors=failed))
    assert silent.hidden.tolist() == (points[0] == 0).tolist()
    assert silent.worst == 0.0
    assert silent.worst_sensor == "d0"
    assert silent.price == answer.price


def test_the_worst_failure_is_the_least_of_all(planner, answer):
    left = {}
    for sensor in planner.sensors:
        rest = tuple(each for each in planner.sensors if each is not sensor)
        left[sensor.name] = planner.estimate(replace(planner.variant, sensors=rest)).ap
    name = min(left, key=lambda each: left[each])
    assert answer.worst_sensor == name
    assert answer.worst == pytest.approx(left[name], abs=1e-6)
    assert answer.ap > answer.worst


def make_answer(**values):
    numbers = dict.fromkeys(
        (
            "ap",
            "low",
            "high",
            "recall",
            "kbit",
            "price",
            "worst",
            "worst_low",
            "worst_high",
            "spread",
        ),
        0.5,
    )
    changes = dict.fromkeys(("change", "change_low", "change_high"), 7.0)
    rows = dict.fromkeys(("classes", "approaches", "levels", "links"), ())
    plain = {"what": "", "sensors": 1, "worst_sensor": "", "objects": 9, "unseen": 0}
    return LiveAnswer(
        **{**numbers, **changes, **rows, **plain, "frames": 8 * BLOCK_FRAMES, **values}
    )


def test_a_change_is_since_the_answer_before_and_within_its_interval():
    rng = np.random.default_rng(0)
    drawn = rng.normal(0.6, 0.01, 400)
    before = make_answer(ap=0.6, resamples=drawn)
    after = make_answer(ap=0.7, resamples=drawn + 0.1 + rng.normal(0, 0.001, 400))
    found = after.since(before, "moved")
    assert (found.what, found.change) == ("moved", pytest.approx(0.1))
    assert found.change_low < 0.1 < found.change_high
    assert found.change_high - found.change_low < 0.02  # paired: far less than that of each
    first = after.since(None, "start")
    assert (first.what, first.change, first.change_low, first.change_high) == (
        "start",
        0.0,
        0.0,
        0.0,
    )
    outside = make_answer(ap=0.9, resamples=drawn).since(before, "")
    assert (outside.change_low, outside.change_high) == (pytest.approx(0.0), pytest.approx(0.3))
    few = make_answer(ap=0.7, resamples=drawn, frames=BLOCK_FRAMES).since(before, "")
    assert np.isnan(few.change_low) or few.change_low <= few.change


def test_what_goes_to_json_leaves_arrays_and_no_budget_out():
    assert set(make_answer().as_dict()) == set(make_answer(budget=5.0).as_dict()) - {"budget"}
    assert {"resamples", "probability", "hidden"}.isdisjoint(make_answer(budget=5.0).as_dict())
    assert make_answer(budget=5.0).as_dict()["budget"] == 5.0


@pytest.mark.parametrize(
    ("figure", "ends", "spread", "widened"),
    [
        (0.6, (0.57, 0.64), 0.0, (0.57, 0.64)),
        (0.6, (0.57, 0.64), math.nan, (0.57, 0.64)),
        (0.6, (0.6, 0.6), 0.01, (0.6 - 0.0196, 0.6 + 0.0196)),
        (0.6, (0.57, 0.64), 0.02, (0.6 - math.hypot(0.03, 0.0392), 0.6 + math.hypot(0.04, 0.0392))),
        (0.95, (0.05, 1.0), 0.5, (0.0, 1.0)),
        (0.6, (math.nan, math.nan), 0.02, (math.nan, math.nan)),
    ],
)
def test_an_interval_takes_in_the_standard_error_of_the_prediction(figure, ends, spread, widened):
    found = figures.widen_interval(figure, Interval(*ends), spread)
    assert tuple(found) == pytest.approx(widened, nan_ok=True)


def test_an_answer_prints_without_its_arrays():
    assert "array" not in repr(make_answer())


def make_objective(**values):
    mounts = [SimpleNamespace(name="north", max_sensors=1, capacity=100.0)]
    mounts.append(SimpleNamespace(name="south", max_sensors=2, capacity=100.0))
    candidates = SimpleNamespace(mounts=mounts, counts=[1, 2], loads=[10.0, 10.0])

    class Sensors:
        def __len__(self):
            return 3

        mounts = candidates.mounts

        def per_mount(self, sets, each=None):
            assert sets.shape == (1, 3)
            assert sets.all()
            return np.array(
                [values.get("counts", [1, 2])]
                if each is None
                else [values.get("sums", [10.0, 10.0])]
            )

    return SimpleNamespace(
        candidates=Sensors(),
        names=["a", "b", "c"],
        linked=np.array(values.get("linked", [True, True, True])),
        shared_links=values.get("shared_links"),
        most_price=values.get("most_price", 9.0),
        price=lambda sets: np.array([values.get("price", 9.0)]),
        affordable=lambda prices: prices <= values.get("most_price", 9.0),
    )


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({}, ()),
        ({"linked": [True, False, True]}, ("b sends more than its link carries",)),
        ({"counts": [2, 2]}, ("north carries more sensors than it may",)),
        ({"counts": [1, 3]}, ("south carries more sensors than it may",)),
        ({"price": 9.5}, ("it costs 9.5, more than 9",)),
        ({"shared_links": np.ones(3), "sums": [10.0, 100.0]}, ()),
        (
            {"shared_links": np.ones(3), "sums": [500.0, 101.0]},
            ("the sensors on south together send more than its link carries",),
        ),
    ],
)
def test_what_keeps_a_set_from_being_built_is_said(values, said):
    assert figures.list_problems(make_objective(**values)) == said
