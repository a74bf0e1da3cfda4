"""Delays, losses and bursts as often as they are said to be."""

import math

import numpy as np
import pytest

from toolkit.detection.link.channel import Line, LinkChannel


def arrivals(channel, n=4000, seed=0):
    line = Line(channel, seed)
    return np.array([line.arrival(0.1 * k) for k in range(n)]) - 0.1 * np.arange(n)


def test_a_perfect_channel_takes_no_time():
    np.testing.assert_allclose(arrivals(LinkChannel(), 50), 0, atol=1e-12)


def test_delay_and_jitter_which_never_makes_it_earlier():
    late = arrivals(LinkChannel(delay=0.2, jitter=0.05))
    assert late.min() == pytest.approx(0.2)
    assert np.median(late) == pytest.approx(0.2, abs=0.003)
    assert np.quantile(late, 0.975) == pytest.approx(0.2 + 1.96 * 0.05, abs=0.01)


@pytest.mark.parametrize("burst", [None, 5.0])
def test_losses_are_as_many_and_as_long_as_said(burst):
    channel = LinkChannel(loss=0.3, burst=burst)
    lost = np.isinf(arrivals(channel, 40_000))
    assert lost.mean() == pytest.approx(0.3, abs=0.02)
    ends = np.flatnonzero(np.diff(lost.astype(int)) == -1)
    begins = np.flatnonzero(np.diff(lost.astype(int)) == 1)
    runs = ends[1:] - begins[: len(ends) - 1] if ends[0] < begins[0] else ends - begins[: len(ends)]
    assert runs.mean() == pytest.approx(channel.mean_burst, rel=0.08)
    assert channel.mean_burst == (5.0 if burst else pytest.approx(1 / 0.7))


def test_a_lower_rate_sends_every_so_many():
    sent = np.isfinite(arrivals(LinkChannel(every=3), 9))
    assert sent.tolist() == [True, False, False] * 3


def test_equal_seeds_draw_the_same_and_a_longer_delay_the_same_losses():
    a, b = (arrivals(LinkChannel(delay=delay, loss=0.2), 300, seed=4) for delay in (0.0, 0.3))
    np.testing.assert_array_equal(np.isinf(a), np.isinf(b))
    assert not np.array_equal(np.isinf(a), np.isinf(arrivals(LinkChannel(loss=0.2), 300, seed=5)))


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"delay": -0.1}, "delay must be"),
        ({"jitter": math.nan}, "jitter must be"),
        ({"loss": 1.0}, "loss must be"),
        ({"loss": -0.1}, "loss must be"),
        ({"loss": 0.5, "burst": 1.5}, "burst must be at least 2"),
        ({"every": 0}, "every must be"),
    ],
)
def test_nonsense_is_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        LinkChannel(**wrong)
