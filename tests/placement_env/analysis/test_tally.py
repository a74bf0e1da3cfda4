"""Figures of tallies, and their intervals against the bootstrap of the frames themselves."""

import numpy as np
import pytest

from placement_env.analysis.intervals import ap_interval
from placement_env.analysis.tally import Tally
from placement_env.fidelity.detector import FALSE_ALARM, IGNORED, Outcome


def test_the_interval_is_that_of_its_frames():
    tally = Tally(
        np.array([0.9, 0.8, 0.7, 0.6]), np.array([True, False, True, True]), np.array([2, 0, 0, 2]), np.array([1, 0, 3])
    )
    frames = [[0.8, 0.7], [], [0.9, 0.6]], [[False, True], [], [True, True]], [1, 0, 3]
    assert tally.interval(seed=3) == ap_interval(*frames, seed=3)
    assert tally.interval(seed=3, confidence=0.5) == ap_interval(*frames, seed=3, confidence=0.5)
    assert tally.ap == pytest.approx(0.25 + 0.5 * 0.75)


def test_nothing_to_find():
    empty = Tally(np.array([0.5]), np.array([False]), np.array([1]), np.zeros(3, int))
    assert np.isnan([empty.ap, empty.recall, *empty.interval()]).all()
    assert empty.precision == 0.0
    silent = Tally(np.zeros(0), np.zeros(0, bool), np.zeros(0, int), np.array([2, 1]))
    assert (silent.ap, silent.recall, silent.interval()) == (0.0, 0.0, (0.0, 0.0))
    assert np.isnan(silent.precision)


def test_a_tally_of_outcomes_leaves_out_what_is_ignored():
    bits = np.array([96])
    outcomes = [
        Outcome(np.array([0.9, 0.8, 0.7]), np.array([[0, FALSE_ALARM, IGNORED], [FALSE_ALARM] * 3]), bits),
        Outcome(np.array([0.6]), np.array([[1], [IGNORED]]), bits),
    ]
    tally = Tally.of(outcomes, np.array([1, 2]), 0)
    assert tally.scores.tolist() == [0.9, 0.8, 0.6]
    assert (tally.hit.tolist(), tally.frame.tolist()) == ([True, False, True], [0, 0, 1])
    assert (tally.recall, tally.precision) == pytest.approx((2 / 3, 2 / 3))
    assert Tally.of(outcomes, np.array([1, 2]), 1).hit.tolist() == [False, False, False]
