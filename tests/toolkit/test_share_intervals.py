"""Intervals of shares."""

import pytest
from scipy.stats import binomtest

from toolkit.share_intervals import wilson_interval


@pytest.mark.parametrize(("successes", "trials"), [(0, 5), (9, 10), (40, 41), (7, 7)])
def test_wilson_s_interval_is_scipy_s(successes, trials):
    expected = binomtest(successes, trials).proportion_ci(method="wilson")
    found = wilson_interval(successes / trials, trials)
    assert found == pytest.approx(tuple(expected), abs=1e-6)


def test_a_share_of_nothing_may_be_anything():
    assert wilson_interval(float("nan"), 0) == (0.0, 1.0)
