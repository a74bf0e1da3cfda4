"""Intervals of shares and quantiles."""

from math import comb, inf, isfinite

import pytest
from scipy.stats import binomtest

from toolkit.share_intervals import quantile_interval, wilson_interval


@pytest.mark.parametrize(("successes", "trials"), [(0, 5), (9, 10), (40, 41), (7, 7)])
def test_wilson_s_interval_is_scipy_s(successes, trials):
    expected = binomtest(successes, trials).proportion_ci(method="wilson")
    found = wilson_interval(successes / trials, trials)
    assert found == pytest.approx(tuple(expected), abs=1e-6)


def test_a_share_of_nothing_may_be_anything():
    assert wilson_interval(float("nan"), 0) == (0.0, 1.0)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
@pytest.mark.parametrize("count", [5, 8, 40, 120])
def test_a_quantile_lies_in_its_interval_as_often_as_stated(share, count):
    """By the binomial sum of each end, and one order statistic farther in would be too few."""
    low, high = quantile_interval(range(1, count + 1), share)

    def chance(first, last):  # that the quantile is between two order statistics
        below = [comb(count, k) * share**k * (1 - share) ** (count - k) for k in range(count + 1)]
        return sum(below[int(first) : int(min(last, count + 1))])

    assert chance(low, high) >= 0.95
    if low >= 1:
        assert sum(chance(k, k + 1) for k in range(int(low) + 1)) > 0.025
    if isfinite(high):
        assert chance(high - 1, count + 1) > 0.025


def test_values_without_end_leave_the_interval_open():
    assert quantile_interval([], 0.5) == (0.0, inf)
    assert quantile_interval([0.1] * 30 + [inf], 0.95) == (0.1, inf)
    assert quantile_interval([inf] * 9, 0.5) == (inf, inf)
