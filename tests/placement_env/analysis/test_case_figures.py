"""Figures over cases, against loops over everything, and races and plans against each other."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from placement_env.analysis.case_figures import (
    CaseFigures,
    reduce_cases,
    reduce_failures,
    reduce_levels,
)
from placement_env.analysis.intervals import figure_interval, share_interval
from placement_env.cases import Cases
from placement_env.fidelity.detector import Detected
from placement_env.report.planning.judging import Judge

EVERY = np.arange(8)
LEVELS = (np.arange(4), np.arange(4, 8))
PAIR = np.array([[1, 1, 0, 0]], bool)


def random_values(*shape):
    """Six figures and three resamples; the objects and frames are those of the first axis."""
    values = np.random.default_rng(4).random((*shape, 9)).round(1)
    for number, case in enumerate(values):
        case[..., 3:5] = 10 * (number + 1), number + 1
    return values


@pytest.mark.parametrize("by", ["worst", "mean"])
def test_cases_are_reduced_as_by_loops(by):
    values = random_values(3, 5)
    values[1, 2] = np.nan  # a case in which nothing is to be found
    values[:, 4, 0] = 0.5  # the first of equal cases is the worst
    found = reduce_cases(values, by)
    for n in range(5):
        rows = [row for row in values[:, n] if not np.isnan(row[0])]
        if by == "worst":
            expected = min(rows, key=lambda row: row[0]).copy()
            expected[6:] = np.min([row[6:] for row in rows], axis=0)
        else:
            expected = np.mean(rows, axis=0)
            expected[3:5] = values[0, n, 3:5]
        assert found[n] == pytest.approx(expected)
    assert np.isnan(reduce_cases(np.full((2, 1, 9), np.nan), by)[0, [0, 1, 2, 5, 6]]).all()


def test_levels_count_what_is_behind_their_ap_and_send_in_all_frames():
    values = random_values(2, 3)
    kbit = (values[0, :, 5] + 2 * values[1, :, 5]) / 3
    worst, mean = (reduce_levels(values, by) for by in ("worst", "mean"))
    is_second = values[1, :, 0] < values[0, :, 0]
    assert worst[:, 4].tolist() == np.where(is_second, 2, 1).tolist()
    assert mean[:, 3:5].tolist() == [[30, 3]] * 3
    for found in (worst, mean):
        assert found[:, 5] == pytest.approx(kbit)
    values[0, ..., 0] = np.nan
    assert reduce_levels(values, "mean")[:, 3:5].tolist() == [[20, 2]] * 3


@pytest.mark.parametrize(("failures", "tie"), product(("worst", "mean"), (0.0, 1e-6)))
def test_failures_leave_ap_and_kbit_of_the_intact_set(failures, tie):
    values, owners = random_values(6), np.array([0, 1, 0, 0, 1, 1])
    found = reduce_failures(values, owners, Cases(failing=1, failures=failures), tie=tie)
    for n, rows in enumerate(([2, 3], [4, 5])):
        reduced = reduce_cases(values[rows], failures)
        assert found[n, 1:5].tolist() == reduced[1:5].tolist()
        assert found[n, 5] == values[n, 5]
        for column in (0, 6, 7, 8):
            expected = reduced[column] + tie * values[n, column]
            assert found[n, column] == pytest.approx(expected, abs=1e-15)
    assert reduce_failures(values, owners, Cases()) is values


def test_an_interval_knows_the_blocks_and_objects_behind_its_ap(blocks_of_four):
    """Of eighty frames in twenty blocks, the worst of two levels has ten; their mean has all."""
    draws, frames = np.random.default_rng(0).normal(0.6, 0.1, 1000), np.arange(80)

    def interval(count, objects=0, drawn=draws, ap=0.6):
        figures = CaseFigures.from_ap(np.array(ap), 0.0, drawn, objects=objects, frames=count)
        return figures.interval(frames)

    assert interval(80) == figure_interval(0.6, draws, blocks=20)
    assert interval(40) == figure_interval(0.6, draws, blocks=10)
    assert np.isnan(interval(36)).all()
    assert interval(38) == interval(40)
    few = CaseFigures.from_ap(np.array(0.6), 0.0, draws, frames=20)
    assert few.interval(frames[::4]) == figure_interval(0.6, draws, blocks=20)  # of a block each
    always = np.ones(1000)
    found = interval(40, objects=60, drawn=always, ap=1.0)
    assert found == pytest.approx(share_interval(1.0, 60 / 4, 0.95))


@pytest.fixture
def rush(street):
    """Sensor 0 sees nothing in the last four frames."""

    class Rush(type(street.detected.renders)):  # type: ignore[misc]
        digest = "rush"

        def clouds(self, k, c):
            return super().clouds(k, c)[: 0 if c == 0 and k >= 4 else None]

    renders = Rush(street.site, street.detected.renders.sensors)
    renders.digest = "rush"
    return Detected(renders, street.detected.detector, "early")


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    ("failing", "levels", "combine"), product((0, 1, 2), (1, 2), ("worst", "mean"))
)
def test_a_search_states_the_figures_that_a_plan_states(street, rush, failing, levels, combine):
    """Without the share of intact AP by which races tell equal sets apart."""
    cases = Cases(
        failing=failing,
        failures=combine,
        levels=levels,
        levels_by=combine,
        errors=("paper", "poor"),
        errors_by=combine,
    )
    parts = LEVELS if levels == 2 else ()
    judge = Judge((street.detected, rush), cases, levels=parts, seed=3)
    sets = np.array([[1, 1, 0, 0], [1, 1, 1, 1], [0, 0, 1, 0]], bool)
    judged, draws = judge.judge_drawn(sets, cases)
    stated = replace(judge.evaluator, tie=0.0).evaluate(sets, EVERY)
    assert stated.ap.tolist() == [judgement.ap for judgement in judged]
    assert stated.objects.tolist() == [judgement.vehicles for judgement in judged]
    assert np.array_equal(stated.resamples, draws)
    raced = judge.evaluator.evaluate(sets, EVERY)
    assert raced.ap == pytest.approx(stated.ap, abs=2e-6)
    assert (raced.ap > stated.ap).tolist() == [failing > 0] * 3


def test_an_ap_that_is_stated_is_never_above_1(street):
    """Two sensors see the one car each; a race adds a millionth for what both see."""

    class Alike(type(street.detected.renders)):  # type: ignore[misc]
        def clouds(self, k, c):
            return super().clouds(k, 0)

        def objects(self, k):
            return super().objects(k)[:2]

    renders = Alike(street.site, street.detected.renders.sensors)
    renders.digest = "alike"
    judge = Judge((Detected(renders, street.detected.detector, "early"),), Cases(failing=1))
    ((judged,), _) = judge.judge_drawn(PAIR, judge.cases)
    assert judged.ap == 1.0
    assert judge.evaluator.evaluate(PAIR, EVERY).ap.tolist() == [1.000001]
    assert replace(judge.evaluator, tie=0.0).evaluate(PAIR, EVERY).ap.tolist() == [1.0]


def test_a_drawing_without_an_object_is_left_out_of_races_too(street):
    class Deserted(type(street.detected.renders)):  # type: ignore[misc]
        def objects(self, k):
            return super().objects(k)[4:]

    renders = Deserted(street.site, street.detected.renders.sensors)
    renders.digest = "deserted"
    other = Judge((Detected(renders, street.detected.detector, "early"),))
    both = replace(street.judge, drawings=(other,))
    raced = both.evaluator.evaluate(PAIR, EVERY)
    assert raced.ap.tolist() == [0.75]
    assert [judgement.ap for judgement in both.judge(PAIR)] == [0.75]
    assert np.isnan(other.evaluator.evaluate(PAIR, EVERY).ap).all()
