import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, strategies as st

from placement_env.racing import Contest, RaceRules, Resampled, Rung, race, race_until
from placement_env.subsets import all_subsets

SETS = all_subsets(8)[1:]


class Recorded:
    """AP of sets as means over frames of a figure that drifts, so that neighbours in time are
    alike."""

    def __init__(self, sets=SETS, frames=200, seed=0, noise=0.3):
        rng = np.random.default_rng(seed)
        drift = rng.standard_normal((sets.shape[1], frames)).cumsum(axis=1)
        drift -= drift.mean(axis=1, keepdims=True)
        gain = rng.uniform(0, 0.1, sets.shape[1])[:, None] * (1 + noise * drift / drift.std())
        self.per_frame = {row.tobytes(): row @ gain for row in sets}
        self.seen = {row.tobytes(): set() for row in sets}
        self.asked = []

    def __call__(self, sets, frames):
        self.asked.append((sets, frames))
        for row in sets:
            self.seen[row.tobytes()] |= set(frames.tolist())
        return np.array([self.per_frame[row.tobytes()][frames].mean() for row in sets])

    @property
    def rungs(self):
        return [(len(sets), len(frames)) for sets, frames in self.asked]

    def true(self, sets):
        return np.array([self.per_frame[row.tobytes()].mean() for row in sets])


@pytest.fixture(scope="module")
def run():
    recorded = Recorded()
    return recorded, race(recorded, SETS, 200)


def test_a_race_finds_the_best_for_what_its_rungs_cost(run):
    recorded, result = run
    assert recorded.true(SETS).argmax() == result.winners[0]
    assert result.full == 255 * 200
    assert result.spent < 0.15 * result.full
    assert recorded.rungs == [(255, 8), (85, 24), (29, 72), (10, 200)]
    for (sets, frames), (after, _) in pairwise(recorded.asked):
        scores = {row.tobytes(): recorded.per_frame[row.tobytes()][frames].mean() for row in sets}
        best = sorted(scores, key=scores.__getitem__, reverse=True)[: len(after)]
        assert {row.tobytes() for row in after} == set(best)


def test_rungs_go_on_with_the_frames_seen_before(run):
    recorded, result = run
    assert result.spent == sum(map(len, recorded.seen.values()))
    orders = [frames for _, frames in recorded.asked]
    for before, after in pairwise(orders):
        assert (after[: len(before)] == before).all()
    assert sorted(orders[-1]) == list(range(200))
    assert np.abs(np.diff(orders[0])).min() > 1
    assert result.scores == pytest.approx(recorded.true(SETS[result.winners]))


@given(
    st.integers(1, 60),
    st.integers(1, 40),
    st.integers(2, 4),
    st.integers(1, 50),
    st.integers(1, 5),
    st.integers(0, 10**6),
)
def test_the_last_rung_has_all_frames_and_the_cost_is_bounded(sets, frames, eta, first, keep, seed):
    ap = np.random.default_rng(seed).uniform(size=256).round(1)  # many ties
    chosen = all_subsets(8)[np.random.default_rng(seed).integers(0, 256, sets)]
    asked = []

    def scores(sets, frames):
        asked.append(len(frames))
        return ap[sets @ (1 << np.arange(8))]

    result = race(scores, chosen, frames, eta=eta, first=first, keep=keep, seed=seed)
    assert asked[-1] == frames
    assert result.spent <= result.full <= sets * frames
    # Without noise the race is exact, and every distinct set that ties with the last winner wins
    # too.
    distinct = np.sort(ap[np.unique(chosen, axis=0) @ (1 << np.arange(8))])[::-1]
    last = distinct[min(keep, len(distinct)) - 1]
    assert result.scores.tolist() == distinct[distinct >= last].tolist()
    assert len(np.unique(chosen[result.winners], axis=0)) == len(result.winners)


def test_seeds_draw_the_frames_at_random():
    one, again, other = (Recorded(noise=3.0) for _ in range(3))
    for recorded, seed in ((one, 1), (again, 1), (other, 2)):
        race(recorded, SETS, 200, seed=seed)
    for (sets, frames), (same, alike) in zip(one.asked, again.asked, strict=True):
        assert (sets.tolist(), frames.tolist()) == (same.tolist(), alike.tolist())
    assert one.asked[1][0].tolist() != other.asked[1][0].tolist()
    lost = {"random": [], "time": []}
    for seed in range(20):
        recorded = Recorded(seed=seed, noise=1.5)
        truth = recorded.true(SETS)
        in_time = race(lambda s, f: recorded(s, np.arange(len(f))), SETS, 200, seed=seed)  # noqa: B023
        for name, result in (("random", race(recorded, SETS, 200, seed=seed)), ("time", in_time)):
            lost[name].append(truth.max() - truth[result.winners[0]])
    assert np.mean(lost["random"]) < 0.5 * np.mean(lost["time"])


def test_equal_and_undefined_sets_in_a_race():
    recorded = Recorded()
    result = race(recorded, np.concatenate([SETS[:9], SETS[:9]])[::-1], 30)
    assert len(recorded.asked[0][0]) == 9
    assert result.full == 9 * 30
    assert result.winners.max() < 9
    ap = np.linspace(0, 1, 255)
    key = {row.tobytes(): score for row, score in zip(SETS, ap, strict=True)}

    asked = []

    def scores(sets, frames):
        asked.append(len(sets))
        return np.array([key[row.tobytes()] if len(frames) > 10 else np.nan for row in sets])

    result = race(scores, SETS, 100, first=4)
    assert asked == [255, 255, 85, 29]
    assert result.winners.tolist() == [254]
    result = race(lambda s, f: np.where(s[:, 0], np.nan, 0.0), np.eye(2, dtype=bool), 10)
    assert result.winners.tolist() == [1]
    recorded = Recorded()
    result = race(recorded, SETS[:4], 200, keep=4)
    assert recorded.rungs == [(4, 200)]
    assert len(result.winners) == 4


@pytest.mark.parametrize(
    "wrong", [{"eta": 1}, {"first": 0}, {"keep": 0}, {"frames": 0}, {"sets": SETS[:0]}]
)
def test_race_refuses(wrong):
    with pytest.raises(ValueError, match="a race needs"):
        race(Recorded(), **({"sets": SETS, "frames": 9} | wrong))


class Spread:
    """Scores of single-sensor sets whose spread falls with the frames; what was asked for is kept
    in `asked`."""

    def __init__(self, true, noise=0.1, draws=400):
        self.true, self.noise, self.draws, self.asked = true, noise, draws, []

    def __call__(self, sets, frames):
        rows = sets.argmax(axis=1)
        self.asked.append((rows.tolist(), frames.tolist()))
        drawn = np.random.default_rng(1).standard_normal((len(self.true), self.draws))
        return Resampled(
            sets @ self.true, (self.true[:, None] + self.noise / np.sqrt(len(frames)) * drawn)[rows]
        )


TRUE = np.array([0.2, 0.9, 0.5, 0.88, 0.895])
ALONE = np.eye(5, dtype=bool)  # each set is one sensor


@pytest.mark.parametrize(("frames", "least", "used"), [(96, 0, 12), (96, 24, 24), (16, 24, 16)])
def test_a_sure_race_ends_after_its_least_frames(frames, least, used):
    rules = RaceRules(first=12, least=least)
    ran = race_until(Spread(TRUE, noise=0.0), ALONE, np.arange(frames), rules)
    assert ran.frames.max() == used


def test_a_race_ends_when_it_is_sure():
    rules = RaceRules(tolerance=0.05, confidence=0.9)
    near = race_until(Spread(TRUE), ALONE, np.arange(400), rules)
    assert near.confidence >= 0.9
    assert near.frames.max() < 100
    exact = Spread(TRUE, noise=0.0)
    ran = race_until(exact, ALONE, np.arange(400))
    assert (len(exact.asked), ran.confidence, ran.spent) == (1, 1.0, 60)


@pytest.mark.parametrize(
    ("target", "used"), [(0.5, {384}), (0.92, {48, 96, 192}), (0.99, {12, 24}), (2.0, {12})]
)
def test_a_race_ends_when_no_set_may_have_the_figure_that_matters(target, used):
    """The best has 0.9; 0.99 is out of reach at once, 0.92 only after some frames."""
    rules = RaceRules(first=12, tolerance=0.001, confidence=0.99, least=24, target=target)
    ran = race_until(Spread(TRUE), ALONE, np.arange(384), rules)
    assert ran.frames.max() in used
    assert ran.ranking[0] == 1


def test_undefined_figures_end_no_race():
    asked = []

    def scores(sets, frames):
        asked.append(len(frames))
        return Resampled(np.full(len(sets), np.nan), np.full((len(sets), 9), np.nan))

    race_until(scores, ALONE, np.arange(24), RaceRules(first=12, least=24, target=0.5))
    assert asked == [12, 24]


def test_rungs_take_the_first_frames_of_the_order_and_drop_sets_that_trail():
    spread_out = Spread(TRUE)
    rules = RaceRules(first=12, tolerance=0.001, confidence=0.9)
    ran = race_until(spread_out, ALONE, np.arange(384)[::-1], rules)
    assert [len(frames) for _, frames in spread_out.asked] == [12, 24, 48, 96, 192, 384]
    assert all(frames == list(range(383, 383 - len(frames), -1)) for _, frames in spread_out.asked)
    assert [sorted(sets) for sets, _ in spread_out.asked][:2] == [[0, 1, 2, 3, 4], [1, 3, 4]]
    assert ran.ranking.tolist() == [1, 4, 3, 2, 0]
    assert ran.figures.tolist() == TRUE[ran.ranking].tolist()
    assert (ran.frames.tolist()[:2], ran.frames.tolist()[3:]) == ([384, 384], [12, 12])
    assert ran.spent == sum(ran.frames)


def test_a_budget_leaves_only_the_best_sets():
    tight = Spread(TRUE, noise=2.0)
    rules = RaceRules(most=60.0 + 12 * 3, tolerance=0.0)
    ran = race_until(tight, ALONE, np.arange(96), rules)
    assert [len(sets) for sets, _ in tight.asked] == [5, 3]
    assert set(tight.asked[1][0]) == {1, 3, 4}
    assert ran.confidence < 0.95


def test_half_of_the_sets_go_on_and_fewer_if_the_best_is_behind_a_rival():
    """Sets hardly differ from their noise, so none is dropped for being worse."""
    counts = {}
    for rival in (0.85, 0.95):
        noisy = Spread(TRUE, noise=20.0)
        rules = RaceRules(kept=0.5, most=60.0 + 36 + 48, rival=rival, most_behind=60.0 + 36)
        race_until(noisy, ALONE, np.arange(48), rules)
        counts[rival] = [len(sets) for sets, _ in noisy.asked]
    assert counts == {0.85: [5, 3, 2], 0.95: [5, 3]}
    with pytest.raises(ValueError, match=r"a kept share above 0 and at most 1, got .* kept 0"):
        RaceRules(kept=0.0)


@pytest.mark.parametrize(
    ("sets", "best", "spent", "count"),
    [
        (16, 0.9, 192, 8),  # half of them
        (5, 0.9, 60, 3),  # rounded up
        (40, 0.9, 480, 1),  # always one
        (40, 0.9, 360, 3),  # 40 set-frames are left
        (16, 0.7, 192, 4),  # behind the rival: 48 are left
        (16, math.nan, 192, 8),
    ],
)
def test_sets_that_go_on_fit_the_budget(sets, best, spent, count):
    rules = RaceRules(kept=0.5, most=400, rival=0.8, most_behind=240)
    assert rules.count_kept(sets, best, spent, next_frames=12) == count


def test_a_race_ends_with_the_frames_that_there_was_time_for():
    """Of the second rung's 24 frames there are 17."""

    def scores(sets, frames):
        asked.append((len(sets), len(frames)))
        return spread(sets, frames)._replace(frames=17 if len(frames) > 12 else None)

    asked, spread = [], Spread(TRUE, noise=0.2)
    ran = race_until(scores, ALONE, np.arange(96), RaceRules(tolerance=0.0))
    assert asked == [(5, 12), (asked[1][0], 24)]
    assert ran.frames.tolist()[: asked[1][0]] == [17] * asked[1][0]
    assert ran.spent == 60 + 5 * asked[1][0]
    assert ran.confidence < 0.95


def test_doubt_is_the_share_of_draws_also_of_what_was_dropped():
    draws = np.array(
        [[0.5] * 8, [0.4] * 4 + [0.505] * 2 + [0.7, 0.6], [0.4] * 5 + [0.6] + [0.4] * 2]
    )
    figures = np.array([0.5, 0.45, 0.42])
    ran = race_until(
        lambda sets, _: Resampled(sets @ figures, draws[sets.argmax(axis=1)]),
        np.eye(3, dtype=bool),
        np.arange(6),
    )
    assert (
        ran.confidence == 1 - 3 / 8
    )  # draws 5, 6, 7: the second is better by 0.2 and 0.1, the third by 0.1
    assert ran.frames.tolist() == [6, 6, 6]
    # The third is better in 1 of 200 draws of the first rung: dropped, and 0.005 of the doubt
    # stays.

    def scores(sets, frames):
        rows = np.full((3, 200), 0.5)
        rows[1, :60] += 0.02
        rows[2] -= 0.2
        rows[2, :1] += 0.3
        asked.append(sets.argmax(axis=1).tolist())
        return Resampled((sets @ np.array([0.5, 0.49, 0.3])), rows[sets.argmax(axis=1)])

    asked = []
    ran = race_until(scores, np.eye(3, dtype=bool), np.arange(24), RaceRules(confidence=0.95))
    assert asked == [[0, 1, 2], [0, 1]]
    assert ran.confidence == pytest.approx(1 - 0.3 - 0.005)
    assert ran.frames.tolist() == [24, 24, 12]


@pytest.mark.parametrize(("blocks", "confidence"), [(1, 0.5), (3, 1 - 1 / 8), (5, 1 - 1 / 32)])
def test_nobody_is_sure_by_the_few_blocks_there_was_time_for(blocks, confidence):
    """What is worse in all of three blocks may be so by chance."""

    def scores(sets, frames):
        return Spread(TRUE, noise=0.0)(sets, frames)._replace(frames=7, blocks=float(blocks))

    ran = race_until(scores, np.eye(5, dtype=bool), np.arange(48), RaceRules(confidence=0.95))
    assert (ran.ranking[0], ran.confidence, ran.spent) == (1, confidence, 35)
    assert race_until(scores, np.eye(5, dtype=bool)[:1], np.arange(48)).confidence == 1.0


def test_sets_go_by_figures_and_predictions_and_equal_rows_race_once():
    """The second leads by its figure, the fifth by what was predicted, within the noise."""
    predicted = TRUE + np.array([0.0, -0.04, 0.0, 0.0, 0.05]) - 0.2
    ran = race_until(
        Spread(TRUE, noise=0.3), np.eye(5, dtype=bool), np.arange(24), predicted=predicted
    )
    assert ran.ranking[0] == 4
    assert ran.figures[0] == TRUE[4]  # as measured
    assert ran.expected[0] > ran.expected[ran.ranking.tolist().index(1)]
    assert 0.895 < ran.expected[0] < 0.95
    alone = race_until(Spread(TRUE, noise=0.3), np.eye(5, dtype=bool), np.arange(24))
    assert alone.ranking[0] == 1
    assert alone.expected.tolist() == alone.figures.tolist()
    twice = np.eye(5, dtype=bool)[[1, 1, 2]]
    assert race_until(Spread(TRUE, noise=0.0), twice, np.arange(12)).ranking.tolist() == [0, 2]
    for wrong in ({"confidence": 1.0}, {"eta": 1}, {"first": 0}, {"tolerance": -0.1}):
        with pytest.raises(ValueError, match="a race until a confidence needs"):
            RaceRules(**wrong)
    with pytest.raises(ValueError, match="got 3 sets, 0 frames"):
        race_until(Spread(TRUE), twice, np.arange(0))


def test_doubt_of_a_set_counts_each_rival_on_the_last_frames_that_both_saw():
    first = Rung(np.array([0, 1, 2]), np.array([[0.5, 0.5], [0.6, 0.5], [0.6, 0.6]]))
    last = Rung(np.array([0, 1]), np.array([[0.5, 0.5, 0.5, 0.5], [0.6, 0.4, 0.4, 0.4]]))
    zeros = np.zeros(3)
    ran = Contest(np.arange(3), zeros, np.full(3, 8), 0.9, 24, zeros, (first, last), 0.01)
    assert (
        ran.doubt(0) == 0.25 + 1.0
    )  # set 1 in a quarter of the last rung, set 2 in the whole first
    assert ran.doubt(0, [2]) == 0.25
    assert ran.doubt(2) == 0.0  # it left after the first rung, where none beats it
    assert ran.sureness(2) == 1.0
    assert ran.sureness(0) == 0.0
    assert replace(ran, by_chance=0.125).sureness(2) == 0.875
    assert replace(ran, rungs=()).sureness(0) == 0.9
