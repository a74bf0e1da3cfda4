"""Schemes, worth, failures and order of building of a set on a known street."""

import numpy as np
import pytest

from placement_env.report.planning.figures import ChosenSet, build_order, by_scheme, failure_cases, worths

CHOSEN = ChosenSet((0, 1), ("post0_eye", "post1_eye"))


def test_worth_is_exact_from_all_subsets(street):
    first, second = worths(street.judge, street.objective, CHOSEN)
    # alone each detects 2 of 4 cars, together 3: one is seen by both
    assert (first.sensor, first.shapley, second.shapley) == ("post0_eye", 0.375, 0.375)
    assert first.synergy == {"post1_eye": -0.25}


def test_many_sensors_are_sampled_by_the_fidelity_of_the_searches(street, monkeypatch):
    monkeypatch.setattr("placement_env.report.planning.figures.ALL_SUBSETS", 1)
    monkeypatch.setattr(street.detected, "outcomes", None)
    first, second = worths(street.judge, street.objective, CHOSEN)
    assert (first.shapley, second.shapley) == pytest.approx((0.375, 0.375))


def test_failures_worst_first(street):
    cases = failure_cases(street.judge, ChosenSet((0, 1, 3), ("a", "b", "c")))
    assert [(case.failed, case.judged.ap) for case in cases] == [
        (("b",), 0.5), (("a",), 0.75), (("c",), 0.75), (("a", "b"), 0.25), (("a", "c"), 0.5), (("b", "c"), 0.5)
    ]  # fmt: skip
    assert failure_cases(street.judge, ChosenSet((0,), ("a",))) == ()
    assert [case.failed for case in failure_cases(street.judge, CHOSEN)] == [("post0_eye",), ("post1_eye",)]


def test_the_sensor_that_adds_most_is_built_first(street):
    steps = build_order(street.judge, street.objective, ChosenSet((1, 2, 3), ("b", "c", "d")))
    assert [step.sensor for step in steps] == ["b", "d", "c"]
    assert [step.price for step in steps] == [11.0, 34.0, 44.5]
    assert [step.judged.ap for step in steps] == pytest.approx([0.5, 0.75, 0.8])


def test_every_scheme_at_every_iou(street):
    rows = by_scheme(street.judge, CHOSEN)
    assert [(row.scheme, row.iou) for row in rows] == [
        (scheme, iou) for scheme in ("early", "late", "hybrid") for iou in (0.7, 0.8, 0.9)
    ]
    assert {row.judged.ap for row in rows} == {0.75}
    sent = {row.scheme: row.kbit_per_sensor for row in rows}
    assert (sent["early"], sent["late"]) == (50 * 96 / 1000, 2 * 256 / 1000)


def test_rows_of_subsets():
    assert ChosenSet((1, 3), ("a", "b")).rows(np.array([[True, False], [True, True]]), 4).astype(int).tolist() == [
        [0, 1, 0, 0],
        [0, 1, 0, 1],
    ]
    assert ChosenSet((1, 3), ("a", "b")).without((0,), 4).tolist() == [False, False, False, True]
