"""Judgements of sets on a street where everything is known."""

import numpy as np
import pytest

from placement_env.analysis.tally import Tally
from placement_env.report.planning.judging import judgement


def test_a_set_is_judged_as_the_detector_scores_it(street):
    first, both, all_of_them, none = street.judge.judge(
        np.array([[1, 0, 0, 0], [1, 1, 0, 0], [1, 1, 1, 0], [0, 0, 0, 0]], bool)
    )
    assert (first.ap, first.recall, first.precision, first.vehicles, first.frames) == (0.5, 0.5, 1.0, 32, 8)
    assert (both.ap, both.low, both.high) == (0.75, 0.75, 0.75)  # all frames are alike
    assert all_of_them.precision == 0.8  # the ghost in every frame
    assert all_of_them.ap == pytest.approx(0.8)  # it is believed most
    assert (none.ap, none.recall, none.precision) == (0.0, 0.0, None)
    row = np.array([[1, 1, 1, 0]], bool)
    assert all_of_them.ap == pytest.approx(float(street.detected(row).ap[0]), abs=1e-12)


def test_at_another_iou(street):
    (at,) = street.judge.judge(np.array([[1, 0, 0, 0]], bool), iou=0.9)
    assert at.ap == 0.5
    assert street.judge.truths.tolist() == [4] * 8


def test_nothing_is_detected_twice(street):
    calls = []
    street.judge.judge(np.array([[1, 1, 0, 0]], bool), progress=calls.append)
    assert calls == list(range(1, 9))
    street.judge.judge(np.array([[1, 1, 0, 0]], bool), progress=calls.append)
    assert len(calls) == 8


def test_the_interval_holds_the_ap_and_depends_on_the_seed_alone():
    rng = np.random.default_rng(3)
    frame = np.repeat(np.arange(20), 3)
    tally = Tally(rng.random(60), rng.random(60) < frame / 20, frame, np.full(20, 4))
    first, again, other = judgement(tally, 1), judgement(tally, 1), judgement(tally, 2)
    assert first == again
    assert (first.low, first.high) != (other.low, other.high)
    assert 0 <= first.low <= first.ap <= first.high <= 1
    assert 0.05 < first.high - first.low < 0.6
