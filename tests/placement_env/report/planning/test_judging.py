"""Judgements of sets on a street where everything is known."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.analysis.intervals import Tally, percentiles
from placement_env.cases import Cases
from placement_env.classes import Classes
from placement_env.defaults import VEHICLES
from placement_env.fidelity.detector import Detected
from placement_env.report.content import PlanOption
from placement_env.report.planning.choice import Choice
from placement_env.report.planning.choosing import choose_at_drawings
from placement_env.report.planning.judging import Judge, judge_tallies
from toolkit.objects import Detections


def test_a_set_is_judged_as_the_detector_scores_it(street):
    first, both, all_of_them, none = street.judge.judge(
        np.array([[1, 0, 0, 0], [1, 1, 0, 0], [1, 1, 1, 0], [0, 0, 0, 0]], bool)
    )
    assert (first.ap, first.recall, first.precision, first.vehicles, first.frames) == (
        0.5,
        0.5,
        1.0,
        32,
        8,
    )
    assert both.ap == 0.75
    assert np.isnan([both.low, both.high]).all()  # two blocks
    assert all_of_them.precision == 0.8  # the ghost in every frame
    assert all_of_them.ap == pytest.approx(0.8)  # it is believed most
    assert (none.ap, none.recall, none.precision) == (0.0, 0.0, None)
    row = np.array([[1, 1, 1, 0]], bool)
    assert all_of_them.ap == pytest.approx(float(street.detected(row).ap[0]), abs=1e-12)


def test_cars_that_are_exact_are_found_at_any_iou(street):
    (at,) = street.judge.judge(np.array([[1, 0, 0, 0]], bool), Cases(iou=0.9))
    assert at.ap == 0.5
    assert street.detected.count_to_find(range(8), 0).tolist() == [4] * 8


def test_frames_are_detected_once_and_told(street):
    calls = []
    for _ in range(2):  # nothing is detected twice
        street.judge.judge(np.array([[0, 1, 1, 0]], bool), progress=calls.append)
    assert calls == list(range(1, 9))


def test_plain_cases_have_no_other_figures(street):
    ((judged,), draws) = street.judge.judge_cases(np.array([[1, 0, 0, 1]], bool))
    assert judged[1:] == (None, None, None)
    assert (draws == judged.judged.ap).all()  # all frames are alike
    assert street.judge.by_errors((0, 1)) == {}


def test_the_interval_holds_the_ap_and_depends_on_the_seed_alone():
    rng = np.random.default_rng(3)
    frame = np.repeat(np.arange(80), 3)
    tally = Tally(rng.random(240), rng.random(240) < frame / 80, frame, np.full(80, 4))
    first, again, other = (judge_tallies([[tally]], VEHICLES, seed) for seed in (1, 1, 2))
    assert first == again
    assert (first.low, first.high) != (other.low, other.high)
    assert 0 <= first.low <= first.ap <= first.high <= 1
    assert 0.05 < first.high - first.low < 0.6


LEVELS = (np.arange(4), np.arange(4, 8))


class Walkers:
    """What the street's reader finds, and the walker in the first three frames."""

    digest = "walkers"

    def __init__(self, reader):
        self.reader, self.calls = reader, 0

    def __call__(self, points, /):
        self.calls += 1
        walker = Detections(
            np.array([[5.0, -5.0, 0.9, 0.6, 0.6, 1.8, 0.0]]), np.array([0.4]), np.array([2])
        )
        return Detections.merge([self.reader(points), *([walker] if self.calls <= 3 else [])])


@pytest.fixture
def walked(street):
    def make(classes):
        old = street.detected
        return Judge((Detected(old.renders, Walkers(old.detector), "early", classes=classes),))

    return make


@pytest.mark.parametrize("combine", ["mean", "worst"])
def test_several_classes_are_judged_together_and_each_by_itself(walked, combine):
    judge = walked(Classes(("vehicle", "pedestrian"), combine=combine))
    (both,) = judge.judge(np.array([[1, 1, 0, 0]], bool))
    vehicle, walker = judge.by_class((0, 1))
    assert (vehicle.label, vehicle.iou, vehicle.weight) == ("vehicle", 0.7, 0.5)
    assert (walker.label, walker.iou, walker.weight) == ("pedestrian", 0.5, 0.5)
    assert vehicle.judged.ap == 0.75
    assert (walker.judged.ap, walker.judged.vehicles, walker.judged.kind) == (
        0.375,
        8,
        "pedestrian",
    )
    assert both.ap == {"mean": 0.5625, "worst": 0.375}[combine]
    assert (both.vehicles, both.kind, both.precision) == (40, "object", 1.0)
    assert both.ap == pytest.approx(
        float(judge.detected(np.array([[1, 1, 0, 0]], bool)).ap[0]), abs=1e-12
    )
    _, (draws,) = judge.judge_drawn(np.array([[1, 1, 0, 0]], bool), judge.cases)
    (walker,) = judge.of_classes(Classes(("pedestrian",))).judge_drawn(
        np.array([[1, 1, 0, 0]], bool), judge.cases
    )[1]
    assert sorted(set(walker.round(6))) == [
        0.0,
        0.375,
        0.75,
    ]  # found in three frames of the first of two blocks
    if (
        combine == "mean"
    ):  # vehicles are found alike in every frame, so all that varies is the walker
        assert draws == pytest.approx((0.75 + walker) / 2)


def test_vehicles_alone_and_classes_without_objects(walked, street):
    (mine,), (plain,) = (
        j.judge(np.array([[1, 1, 0, 0]], bool)) for j in (walked(VEHICLES), street.judge)
    )
    assert mine == plain
    assert mine.kind == "vehicle"
    assert [row.label for row in street.judge.by_class((0,))] == ["vehicle"]
    assert walked(Classes(("vehicle", "heavy", "cyclist"))).absent_labels == ("cyclist", "heavy")
    none = Tally(np.zeros(0), np.zeros(0, bool), np.zeros(0, np.int64), np.zeros(4, np.int64))
    some = Tally(np.array([0.9]), np.array([True]), np.array([1]), np.ones(4, np.int64))
    found = judge_tallies([[some, none]], Classes(("vehicle", "heavy")), 0)
    assert (found.ap, found.recall) == (0.25, 0.25)


def test_several_thresholds_give_means_of_ap_and_resamples(street):
    """Found at both thresholds as at one: the reader's boxes are exact, so the mean is the AP of
    each."""
    cases = Cases(iou=(0.7, 0.9))
    judge = Judge((street.detected.at(0.7, cases.ious),), cases)
    (both,) = judge.judge(np.array([[1, 1, 0, 0]], bool))
    assert (both.ap, both.vehicles) == (0.75, 32)
    assert judge.by_class((0, 1))[0].iou == (0.7, 0.9)
    rng = np.random.default_rng(5)
    frame = np.repeat(np.arange(60), 3)
    scores, hit = rng.random(180), rng.random(180) < frame / 60
    loose, strict = (
        Tally(scores, hit, frame, np.full(60, 4)),
        Tally(scores, hit & (scores > 0.5), frame, np.full(60, 4)),
    )
    found = judge_tallies([[loose], [strict]], VEHICLES, 1)
    one, other = (judge_tallies([[each]], VEHICLES, 1) for each in (loose, strict))
    assert found.ap == pytest.approx((one.ap + other.ap) / 2)
    assert found.recall == pytest.approx((one.recall + other.recall) / 2)
    assert found.precision == pytest.approx(np.mean([loose.precision, strict.precision]))
    draws = (loose.resamples(seed=1) + strict.resamples(seed=1)) / 2
    assert (found.low, found.high) == pytest.approx(percentiles(draws, 15))
    assert found.vehicles == 240


@pytest.mark.parametrize(("combine", "ap"), [("worst", 0.25), ("mean", 0.375)])
def test_what_is_left_when_one_fails(street, combine, ap):
    """Post 0 finds two of four cars, post 3 one of these two; a set of one has nothing left."""
    judge = Judge((street.detected,), Cases(failing=1, failures=combine))
    found, draws = judge.judge_cases(np.array([[1, 0, 0, 1], [1, 0, 0, 0]], bool))
    pair, alone = (each.left for each in found)
    assert (pair.ap, pair.recall) == (ap, ap)
    assert (draws == np.array([[ap], [0.0]])).all()
    assert (alone.ap, alone.recall, alone.precision, alone.vehicles) == (0.0, 0.0, None, 32)
    (intact,) = judge.judge(np.array([[1, 0, 0, 1]], bool))
    assert intact.ap == 0.5
    raced = judge.evaluator.evaluate(np.array([[1, 0, 0, 1]], bool), np.arange(8))
    assert raced.ap == pytest.approx([ap], abs=1e-5)


@pytest.fixture
def rush(street):
    """Sensor 0 sees nothing in the last four frames, which are the dense ones."""

    class Rush(type(street.detected.renders)):  # type: ignore[misc]
        def clouds(self, k, c):
            return super().clouds(k, c)[: 0 if c == 0 and k >= 4 else None]

    renders = Rush(street.site, street.detected.renders.sensors)

    def judge(cases, levels=LEVELS):
        return Judge((Detected(renders, street.detected.detector, "early"),), cases, levels=levels)

    return judge


@pytest.mark.parametrize(
    ("failing", "levels", "over", "left"),
    [
        (0, "worst", 0.5, None),
        (0, "mean", 0.625, None),
        (1, "worst", 0.5, 0.0),
        (1, "mean", 0.625, 0.25),
    ],
)
def test_levels_of_traffic_are_judged_by_themselves(rush, failing, levels, over, left):
    """Of four cars 0 and 1 find three, and two where 0 is blind; without 1 it is two and none,
    without 0 two."""
    judge = rush(Cases(failing=failing, levels=2, levels_by=levels))
    sets = np.array([[1, 1, 0, 0], [0, 1, 0, 0]], bool)
    both, alone = judge.judge(sets)
    assert (both.ap, alone.ap) == (0.625, 0.5)
    drawn = judge.judge_drawn(sets, judge.intact)[1]
    assert [sorted(set(each.round(6))) for each in drawn] == [
        [0.5, 0.625, 0.75],
        [0.5],
    ]  # of two blocks
    found, draws = judge.judge_cases(sets)
    both, alone = (each.over_levels for each in found)
    assert (both.ap, both.recall) == (over, over)
    assert (draws == [[over], [0.5]] if left is None else draws == [[left], [0.0]]).all()
    assert alone.ap == 0.5
    assert (both.vehicles, both.frames) == ((16, 4) if levels == "worst" else (32, 8))
    thin, dense = judge.by_level((0, 1))
    assert (thin.ap, dense.ap, dense.vehicles, dense.frames) == (0.75, 0.5, 16, 4)
    assert [each.left and each.left.ap for each in found] == (
        [None] * 2 if left is None else [left, 0.0]
    )
    raced = judge.evaluator.evaluate(sets[:1], np.arange(8))
    assert raced.ap == pytest.approx([over if left is None else left], abs=1e-5)
    assert np.quantile(raced.resamples, [0.025, 0.975]) == pytest.approx([raced.ap[0]] * 2)


def test_the_interval_over_levels_is_of_the_worst_in_each_resample(rush, street):
    mixed = rush(Cases(levels=2), (np.array([0, 1, 4, 5]), np.array([2, 3, 6, 7])))
    (both,), (draws,) = mixed.judge_drawn(np.array([[1, 1, 0, 0]], bool), mixed.cases)
    first, second = mixed.by_level((0, 1))
    assert (first.ap, second.ap, both.ap) == (0.625, 0.625, 0.625)
    assert sorted(set(draws.round(6))) == [0.5, 0.625, 0.75]


def test_a_level_with_nothing_to_find_says_nothing(street):
    class Late(type(street.detected.renders)):  # type: ignore[misc]
        """There is a walker alone in the first four frames, and nobody sees anything."""

        def clouds(self, k, c):
            return super().clouds(k, c)[: 0 if k < 4 else None]

        def objects(self, k):
            there = super().objects(k)
            return there[4:] if k < 4 else there

    detected = Detected(
        Late(street.site, street.detected.renders.sensors), street.detected.detector, "early"
    )
    judge = Judge((detected,), Cases(levels=2), levels=LEVELS)
    first, second = judge.by_level((1,))
    assert first is None
    (over,) = judge.judge(np.array([[0, 1, 0, 0]], bool), judge.cases)
    assert over.ap == second.ap == 0.5


@pytest.fixture
def hazy(street):
    """A judge with exact sensors, and in a haze, where sensor 1 sees nothing in the last four
    frames and sensor 3 nothing at all."""

    class Hazy(type(street.detected.renders)):  # type: ignore[misc]
        def clouds(self, k, c):
            return super().clouds(k, c)[: 0 if (c == 1 and k >= 4) or c == 3 else None]

    renders = Hazy(street.site, street.detected.renders.sensors)
    renders.digest = "hazy"

    rough = Detected(renders, street.detected.detector, "early")

    def judge(parts=(), **cases):
        return Judge(
            (street.detected, rough), Cases(errors=("paper", "poor"), **cases), levels=parts
        )

    return judge


SETS = np.array([[1, 1, 0, 0], [0, 0, 0, 1]], bool)


def test_figures_over_drawings_of_a_site_are_means(street, rush):
    """Where a hedge is drawn before sensor 0, it sees nothing in half of the frames."""
    other = rush(Cases(), ())
    both = replace(street.judge, drawings=(other,))
    (judged,), (draws,) = both.judge_drawn(SETS[:1], both.cases)
    alone = [each.judge_drawn(SETS[:1], each.cases) for each in both.drawing_judges]
    assert judged.ap == pytest.approx((0.75 + 0.625) / 2)
    assert draws == pytest.approx(np.mean([drawn[0] for _, drawn in alone], axis=0))
    assert (judged.vehicles, judged.frames) == (32, 8)
    raced = both.evaluator.evaluate(SETS, np.arange(8))
    assert raced.ap == pytest.approx(
        [judged.ap, np.mean([each.judge(SETS)[1].ap for each in both.drawing_judges])], abs=1e-6
    )
    each_kbit = [each.evaluator.evaluate(SETS, np.arange(8)).kbit for each in both.drawing_judges]
    assert raced.kbit == pytest.approx(np.mean(each_kbit, axis=0))
    each_raced = [
        each.evaluator.evaluate(SETS, np.arange(8)).resamples for each in both.drawing_judges
    ]
    assert raced.resamples == pytest.approx(np.mean(each_raced, axis=0))
    assert both.evaluator.mean_ap(SETS[:1], np.arange(8)) == pytest.approx([judged.ap])


def test_the_best_set_is_judged_at_each_drawing(street, rush):
    both = replace(street.judge, drawings=(rush(Cases(), ()),))
    (judged,), _ = both.judge_drawn(SETS[:1], both.cases)
    options = tuple(PlanOption((name,), 1.0, 1.0, 1.0, 0.5, judged, poles=(name,)) for name in "ab")
    first, second = choose_at_drawings(both, Choice(options, SETS, 0, 0, (), "best"), None)
    assert (first.judged.ap, second.judged.ap, first.poles) == (0.75, 0.625, ("a",))
    cheap = (options[0], replace(options[1], price=0.5))
    results = choose_at_drawings(both, Choice(cheap, SETS, 0, 0, (), "cheapest"), 0.2)
    assert [each.poles for each in results] == [("b",), ("b",)]
    assert choose_at_drawings(street.judge, Choice(options, SETS, 0, 0, (), "best"), None) == ()


@pytest.mark.parametrize(
    ("failing", "levels", "combine", "paper", "poor", "over"),
    [
        *(
            (0, 1, "worst", 0.75, 0.625, 0.625),
            (0, 1, "mean", 0.75, 0.625, 0.6875),
            (0, 2, "worst", 0.75, 0.5, 0.5),
        ),
        *((1, 1, "worst", 0.5, 0.25, 0.25), (1, 2, "mean", 0.5, 0.0, 0.25)),
    ],
)
def test_error_profiles_are_judged_by_themselves(hazy, failing, levels, combine, paper, poor, over):
    """Of four cars 0 and 1 find three; in the haze two in the last four frames, and without 0 none
    there."""
    judge = hazy(LEVELS if levels == 2 else (), failing=failing, levels=levels, errors_by=combine)
    assert [each.ap for each in judge.judge(SETS)] == [0.75, 0.25]  # at the first profile
    both, alone = (each.over_errors for each in judge.judge_cases(SETS)[0])
    assert both.ap == pytest.approx(over)
    assert alone.ap == (0.0 if failing or combine == "worst" else 0.125)
    each = judge.by_errors((0, 1))
    assert {name: judged.ap for name, judged in each.items()} == pytest.approx(
        {"paper": paper, "poor": poor}
    )
    assert both.recall == pytest.approx(over)
    assert judge.evaluator.evaluate(SETS, np.arange(8)).ap == pytest.approx(
        [both.ap, alone.ap], abs=1e-5
    )


def test_the_interval_over_profiles_is_of_the_worst_in_each_resample(hazy):
    judge = hazy()
    (both,), (draws,) = judge.judge_drawn(SETS[:1], judge.cases)
    exact, rough = judge.by_errors((0, 1)).values()
    assert (exact.ap, rough.ap, both.ap) == (0.75, 0.625, 0.625)
    assert sorted(set(draws.round(6))) == [0.5, 0.625, 0.75]
    average = hazy(errors_by="mean")
    (mean,), (drawn,) = average.judge_drawn(SETS[:1], average.cases)
    assert mean.ap == 0.6875
    assert drawn == pytest.approx((0.75 + draws) / 2)
    assert (mean.precision, mean.vehicles, mean.frames) == (1.0, 32, 8)
