"""Intervals and tallies, against an oracle that takes one resample after the other."""

import numpy as np
import pytest
from scipy.stats import binomtest, norm, t

from placement_env.analysis.intervals import (
    BLOCK_FRAMES,
    MAX_HELD_NUMBERS,
    Interval,
    Tally,
    block_draws,
    describe_interval,
    draws_of_blocks,
    figure_interval,
    frames_for_width,
    is_as_good,
    mean_interval,
    percentiles,
    ratio_interval,
)
from placement_env.fidelity.detector import FALSE_ALARM, IGNORED, Outcome
from toolkit.detection.metrics import average_precision, precision_recall

pytestmark = pytest.mark.usefixtures("blocks_of_four")


def measured(frames, seed, levels=20):
    """Random detections: many equal scores, frames without truths, without detections and with
    false alarms only."""
    rng = np.random.default_rng(seed)
    to_find = rng.integers(0, 6, frames).tolist()
    scores, hits = [], []
    for truths in to_find:
        found, alarms = rng.integers(0, truths + 1), rng.integers(0, 4)
        scores.append(rng.integers(1, levels, found + alarms) / levels)
        hits.append(rng.permutation(np.arange(found + alarms) < found))
    return scores, hits, to_find


def ap_interval(scores, hits, to_find, *, confidence=0.95, **drawing):
    tally = Tally.of_frames(
        [np.array(each) for each in scores], [np.array(each, bool) for each in hits], to_find
    )
    return percentiles(tally.resamples(**drawing), confidence=confidence)


def slow_ap_resamples(scores, hits, to_find, draws):
    """One resample after the other: the frames that were drawn, put together as often as they were,
    and scored."""
    figures = []
    for row in draws:
        drawn = [k for k, times in enumerate(row) for _ in range(times)]
        truths = sum(to_find[k] for k in drawn)
        pooled_scores = np.concatenate([np.zeros(0), *(scores[k] for k in drawn)])
        pooled_hits = np.concatenate([np.zeros(0, bool), *(hits[k] for k in drawn)])
        curve = precision_recall(pooled_scores, pooled_hits, truths)
        figures.append(average_precision(curve) if truths else np.nan)
    return np.array(figures)


@pytest.mark.parametrize(
    ("frames", "block", "seed"), [(1, 4, 0), (3, 1, 1), (6, 4, 2), (23, 4, 3), (40, 5, 4)]
)
def test_resamples_are_those_of_an_oracle_that_takes_one_after_the_other(frames, block, seed):
    scores, hits, to_find = measured(frames, seed)
    draws = block_draws(frames, block=block, resamples=50, seed=seed)
    ours = Tally.of_frames(scores, hits, to_find).resamples(draws=draws)
    assert ours == pytest.approx(slow_ap_resamples(scores, hits, to_find, draws), nan_ok=True)


def test_resamples_taken_in_pieces_are_the_same(limits):
    tally = Tally.of_frames(*measured(30, 7))
    whole = tally.resamples(seed=1)
    for held in (300, 1):
        limits("placement_env.analysis.intervals", MAX_HELD_NUMBERS=held)
        assert tally.resamples(seed=1).tolist() == whole.tolist()
    taken, draws = [], block_draws(30, seed=1)

    class Draws(np.ndarray):
        def __getitem__(self, some):
            taken.append(len(draws[some]) * len(tally.scores))
            return draws[some]

    given = draws.view(Draws)
    limits("placement_env.analysis.intervals", MAX_HELD_NUMBERS=MAX_HELD_NUMBERS)
    tally.resamples(draws=given)
    assert sum(taken) == 1000 * len(tally.scores)
    assert max(taken) <= MAX_HELD_NUMBERS < 2 * max(taken)  # in few steps, usually
    taken.clear()
    limits("placement_env.analysis.intervals", MAX_HELD_NUMBERS=1000)
    assert tally.resamples(draws=given).tolist() == whole.tolist()
    assert 500 < max(taken) <= 1000


def test_frames_are_drawn_in_blocks_by_the_seed():
    draws = block_draws(10, block=4, resamples=200, seed=5)
    assert draws.shape == (200, 10)
    assert (draws[:, 0:4] == draws[:, :1]).all()
    assert (draws[:, 4:8] == draws[:, 4:5]).all()
    assert (draws[:, 8] == draws[:, 9]).all()
    assert (draws[:, [0, 4, 8]].sum(axis=1) == 3).all()
    assert draws[:, [0, 4, 8]].mean(axis=0) == pytest.approx([1, 1, 1], abs=0.15)
    assert (block_draws(40, seed=1) == block_draws(40, seed=1)).all()
    assert (block_draws(40, seed=1) != block_draws(40, seed=2)).any()


def test_intervals_of_ap_are_of_what_is_defined():
    scores, hits = [[0.9, 0.8]] * 8, [[True, True]] * 8
    assert ap_interval(scores, hits, [2] * 8) == Interval(1.0, 1.0)
    low, high = ap_interval([[0.5]] * 4, [[False]] * 4, [0] * 4)
    assert np.isnan([low, high]).all()
    low, high = ap_interval([[0.5], []], [[True], []], [1, 0], draws=block_draws(2, block=1))
    assert (low, high) == (1.0, 1.0)


def test_ratios_need_ten_blocks_with_something_to_find():
    found, there = np.tile([1, 0, 2, 3, 1.0], 10), np.tile([1, 2, 2, 3, 4.0], 10)
    figures = np.array([row @ found / (row @ there) for row in block_draws(50, seed=3)])
    assert ratio_interval(found, there, seed=3) == pytest.approx(percentiles(figures, 13))
    assert np.isnan(ratio_interval([0, 0], [0, 0])).all()
    assert np.isnan(ratio_interval(found[:36], there[:36])).all()  # nine blocks


def test_intervals_hold_the_figure_and_leave_out_nan():
    assert figure_interval(0.1, np.full(9, 0.5), blocks=12) == Interval(0.1, 0.5)
    assert figure_interval(0.9, np.full(9, 0.5), blocks=12) == Interval(0.5, 0.9)
    assert percentiles(np.array([np.nan, 0.0, 1.0, 2.0, 3.0, 4.0]), confidence=0.5) == Interval(
        1.0, 3.0
    )


def test_unequal_frames_and_empty_blocks_are_refused():
    with pytest.raises(ValueError, match="one part and one whole per frame"):
        ratio_interval([1.0, 2.0], [1.0])
    for settings in ({"block": 0}, {"resamples": 0}):
        with pytest.raises(ValueError, match="must be a whole number of at least 1"):
            block_draws(1, **settings)


@pytest.mark.parametrize("confidence", [0.0, 1.0, 95.0])
def test_refuses_confidence(confidence):
    with pytest.raises(ValueError, match="confidence must lie between 0 and 1"):
        ratio_interval([1.0], [1.0], confidence=confidence)


def test_tallies_of_one_block_of_nothing_and_of_silence():
    tally = Tally(
        np.array([0.9, 0.8, 0.7, 0.6]),
        np.array([True, False, True, True]),
        np.array([2, 0, 0, 2]),
        np.array([1, 0, 3]),
    )
    assert np.isnan(tally.interval(seed=3)).all()  # one block
    assert tally.ap == pytest.approx(0.25 + 0.5 * 0.75)
    empty = Tally(np.array([0.5]), np.array([False]), np.array([1]), np.zeros(3, int))
    assert np.isnan([empty.ap, empty.recall, *empty.interval()]).all()
    assert empty.precision == 0.0
    silent = Tally(np.zeros(0), np.zeros(0, bool), np.zeros(0, int), np.array([2, 1]))
    assert (silent.ap, silent.recall) == (0.0, 0.0)
    assert np.isnan(silent.precision)


def test_tallies_are_made_of_outcomes_at_one_threshold():
    bits = np.array([96])
    outcomes = [
        Outcome(
            np.array([0.9, 0.8, 0.7]),
            np.array([[0, FALSE_ALARM, IGNORED], [FALSE_ALARM] * 3]),
            bits,
            np.zeros(3),
        ),
        Outcome(np.array([0.6]), np.array([[1], [IGNORED]]), bits, np.zeros(1)),
    ]
    tally = Tally.from_outcomes(outcomes, np.array([1, 2]), 0)
    assert tally.scores.tolist() == [0.9, 0.8, 0.6]
    assert (tally.hit.tolist(), tally.frame.tolist()) == ([True, False, True], [0, 0, 1])
    assert (tally.recall, tally.precision) == pytest.approx((2 / 3, 2 / 3))
    assert Tally.from_outcomes(outcomes, np.array([1, 2]), 1).hit.tolist() == [False, False, False]


def test_intervals_of_equal_blocks_are_wilsons():
    # Wilson's interval where all blocks agree, for a quarter of the vehicles: they live four frames
    perfect = Tally(
        np.full(80, 0.9), np.ones(80, bool), np.repeat(np.arange(40), 2), np.full(40, 2)
    )
    low, high = perfect.interval()
    assert [low, high] == pytest.approx([20 / (20 + norm.ppf(0.975) ** 2), 1.0])
    none = Tally(np.zeros(0), np.zeros(0, bool), np.zeros(0, int), np.full(40, 2))
    assert none.interval() == pytest.approx((0.0, 1 - low))


def test_intervals_cover_the_truth_as_often_as_they_say():
    # 200 recordings of independent blocks, of which the vehicles of one are found or missed
    # together.
    rng, covered = np.random.default_rng(0), 0
    for seed in range(200):
        found = np.repeat(rng.random(50) < 0.7, 4)
        draws = block_draws(200, resamples=200, seed=seed)
        low, high = ap_interval(
            [[0.9] * int(f) for f in found],
            [[True] * int(f) for f in found],
            [1] * 200,
            draws=draws,
        )
        covered += low <= 0.7 <= high
    assert 0.9 <= covered / 200 <= 0.99


def test_blocks_make_intervals_wider_than_single_frames():
    found = np.repeat(np.random.default_rng(0).random(25) < 0.7, 4)
    values = [[0.9] * int(f) for f in found], [[True] * int(f) for f in found], [1] * 100
    (low, high), (low_of_1, high_of_1) = (
        ap_interval(*values, draws=block_draws(100, block=n)) for n in (4, 1)
    )
    assert high - low > 1.5 * (high_of_1 - low_of_1)


@pytest.mark.parametrize("blocks", [10, 15, 30])
def test_few_blocks_are_covered_as_often_as_many(blocks):
    """Means of normal blocks, whose interval by Student's t is known: coverage is 95 % but for
    chance."""
    rng, covered, trials = np.random.default_rng(blocks), 0, 1000
    draws = draws_of_blocks(np.arange(blocks), resamples=2000) / blocks
    for _ in range(trials):
        own = rng.normal(size=blocks)
        low, high = percentiles(draws @ own, blocks)
        covered += low <= 0.0 <= high
    assert 0.93 <= covered / trials <= 0.975


def test_a_figure_is_as_good_by_its_paired_loss_alone():
    rng = np.random.default_rng(2)
    best = rng.normal(0.9, 0.1, 1000)
    assert is_as_good(best - 0.009, best, 30)
    assert not is_as_good(best - 0.011, best, 30)
    assert is_as_good(best + 0.5, best, 30)  # better
    assert not is_as_good(best - rng.normal(0.0, 0.01, 1000), best, 30)  # may be worse by more
    assert not is_as_good(best, best, 9)


@pytest.mark.parametrize(("width", "frames"), [(0.02, 40), (0.04, 160), (0.03, 92)])
def test_frames_grow_with_the_square_of_the_width(width, frames):
    assert frames_for_width(40, width, 0.02) == frames


def test_seeds_and_confidences_are_handed_on_and_are_0_unless_given():
    tally = Tally.of_frames(*measured(60, 7))
    assert (
        tally.resamples().tolist()
        == tally.resamples(seed=0).tolist()
        != tally.resamples(seed=1).tolist()
    )
    assert block_draws(60).tolist() == block_draws(60, seed=0).tolist()
    blocks = np.arange(60) // 4
    assert (
        draws_of_blocks(blocks).tolist()
        == draws_of_blocks(blocks, seed=0).tolist()
        == block_draws(60).tolist()
    )
    assert (
        draws_of_blocks(blocks, seed=2).tolist()
        == block_draws(60, seed=2).tolist()
        != block_draws(60).tolist()
    )
    parts, wholes = np.arange(60.0) % 7, np.arange(60.0) % 11 + 1.0
    assert ratio_interval(parts, wholes) == ratio_interval(parts, wholes, seed=0)
    assert ratio_interval(parts, wholes) != ratio_interval(parts, wholes, seed=1)
    for own in ({}, {"confidence": 0.8}, {"seed": 3}):
        drawn = tally.resamples(seed=own.get("seed", 0))
        wanted = figure_interval(tally.ap, drawn, blocks=15, confidence=own.get("confidence", 0.95))
        assert tally.interval(**own) == wanted
    low, high = ratio_interval(parts, wholes, confidence=0.5)
    wide = ratio_interval(parts, wholes)
    assert wide.low < low < high < wide.high


def test_draws_without_anything_count_for_nothing():
    """All objects are in the first of eleven blocks, so that a third of the draws have none."""
    parts, wholes = np.zeros(44), np.zeros(44)
    parts[:4], wholes[:4] = 1.0, 2.0
    assert ratio_interval(parts, wholes) == Interval(0.5, 0.5)
    one = Tally(np.array([0.5]), np.array([True]), np.array([0]), np.array([1, 0]))
    assert one.resamples(draws=np.array([[1, 0], [0, 2]])) == pytest.approx(
        [1.0, np.nan], nan_ok=True
    )


@pytest.mark.parametrize(("found", "confidence"), [(45, 0.95), (10, 0.95), (45, 0.8)])
def test_ends_where_all_draws_agree_are_wilsons(found, confidence):
    """Of 200 objects that live four frames, 50 are independent."""
    wanted = binomtest(found, 50).proportion_ci(confidence, method="wilson")
    given = {"blocks": 12, "objects": 200, "confidence": confidence}
    assert figure_interval(found / 50, np.full(9, found / 50), **given) == pytest.approx(
        (wanted.low, wanted.high)
    )
    # where they do not agree, or nothing is known of objects, it is the share of the draws that
    # counts
    spread = np.linspace(0.2, 0.3, 1001)
    assert figure_interval(0.25, spread, **given) == percentiles(spread, 12, confidence=confidence)
    assert figure_interval(0.5, np.full(9, 0.5), blocks=12) == Interval(0.5, 0.5)


def test_blocks_are_two_lives_and_words_say_how_many_are_needed():
    assert BLOCK_FRAMES == 8
    assert describe_interval(0.91, 0.954) == "0.910 to 0.954"
    assert describe_interval(0.91, 0.954, 1) == "0.9 to 1.0"
    for ends in ((np.nan, 0.9), (0.9, np.nan)):
        assert describe_interval(*ends) == "no interval from fewer than 40 frames"


def test_a_loss_of_the_tolerance_itself_is_as_good():
    assert is_as_good(np.zeros(1000), np.full(1000, 0.01), 15)
    assert not is_as_good(np.zeros(1000), np.full(1000, 0.0101), 15)


def test_the_interval_of_a_mean_is_nearly_student_s():
    values = np.random.default_rng(4).normal(3.0, 1.0, 40)
    half = t.ppf(0.975, 39) * values.std(ddof=1) / np.sqrt(40)
    low, high = mean_interval(values.tolist(), seed=2)
    assert (low, high) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.06)
    assert mean_interval([1.0] * 10) == (1.0, 1.0)
    assert np.isnan(mean_interval([1.0] * 9)).all()
