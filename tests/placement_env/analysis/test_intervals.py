"""AP of tallies and of samples of frames, against the evaluation of the toolkit on the frames themselves."""

import numpy as np
import pytest

from placement_env.analysis.intervals import Tally, interval, weighted_ap
from placement_env.fidelity.detector import FALSE_ALARM, IGNORED, Outcome
from toolkit.detection.metrics import average_precision, precision_recall


def random_tally(seed, frames=13, ties=False):
    rng = np.random.default_rng(seed)
    truths = rng.integers(0, 5, frames)
    hit, frame = [], []
    for k in range(frames):
        hits = rng.integers(0, truths[k] + 1)
        alarms = rng.integers(0, 3)
        hit += [True] * hits + [False] * alarms
        frame += [k] * (hits + alarms)
    believed = rng.random(len(hit))
    return Tally(np.round(believed, 1) if ties else believed, np.array(hit), np.array(frame), truths)


def repeated(tally, times):
    """The AP of a sample made by hand: each frame as often as it says."""
    rows = np.concatenate([np.repeat(np.flatnonzero(tally.frame == k), n) for k, n in enumerate(times)])
    curve = precision_recall(tally.scores[rows], tally.hit[rows], int(times @ tally.truths))
    return average_precision(curve)


@pytest.mark.parametrize("ties", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_a_sample_scores_what_its_frames_score(seed, ties):
    tally = random_tally(seed, ties=ties)
    times = np.random.default_rng(seed).integers(0, 4, (50, 13))
    times[0] = 1
    aps = weighted_ap(tally, times)
    assert aps == pytest.approx([repeated(tally, row) for row in times], abs=1e-12)
    assert aps[0] == pytest.approx(tally.ap, abs=1e-12)


def test_the_interval_is_of_blocks_drawn_with_replacement():
    tally = random_tally(7)
    low, high = interval(tally, block=4, draws=300, seed=5)
    starts, rng = [0, 4, 8, 12], np.random.default_rng(5)
    aps = []
    for chosen in rng.integers(4, size=(300, 4)):
        times = np.zeros(13, int)
        for b in chosen:
            times[starts[b] : starts[b] + 4] += 1
        if times @ tally.truths:
            aps.append(repeated(tally, times))
    assert (low, high) == pytest.approx(tuple(np.quantile(aps, [0.025, 0.975])), abs=1e-12)


def test_longer_blocks_of_frames_that_are_alike_make_wider_intervals():
    rng = np.random.default_rng(0)
    good = np.repeat(rng.random(30) < 0.5, 4)  # four frames alike
    frame = np.arange(120)
    tally = Tally(rng.random(120), good, frame, np.ones(120, int))
    width = {block: np.subtract(*interval(tally, block=block, seed=1)[::-1]) for block in (1, 4)}
    assert width[4] > 1.5 * width[1]


def test_nothing_to_find():
    empty = Tally(np.array([0.5]), np.array([False]), np.array([1]), np.zeros(3, int))
    assert np.isnan([empty.ap, empty.recall, *interval(empty)]).all()
    assert empty.precision == 0.0
    silent = Tally(np.zeros(0), np.zeros(0, bool), np.zeros(0, int), np.array([2, 1]))
    assert (silent.ap, silent.recall, interval(silent)) == (0.0, 0.0, (0.0, 0.0))
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
