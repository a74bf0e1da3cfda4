"""Programmes against trying all sets: of most worth, the cheapest of enough, whichever sensor
fails."""

from functools import partial
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from placement_env.fidelity.hit_model import HitModel
from placement_env.search.exact.programme import (
    GAIN_UNITS,
    LINK_UNITS,
    Levels,
    Poles,
    Prices,
    Programme,
    SolverLimits,
    levels_of_hits,
    load_cp_model,
    solve,
)
from placement_env.search.progress import Progress
from placement_env.search.verification import improve_among_equals

pytest.importorskip("ortools")


def every(mount, budget):
    for size in range(1, budget + 1):
        for chosen in combinations(range(len(mount)), size):
            if len(set(mount[list(chosen)])) == size:
                yield list(chosen)


def levels_of_coverage(seen):
    ones = np.ones((1, seen.shape[1]), np.int64)
    return Levels(seen.astype(np.int64), ones, ones, ones > 0)


def surviving(levels, chosen):
    """Worth that the worst failure of one sensor leaves."""
    return min((levels.worth([c for c in chosen if c != gone]) for gone in chosen), default=0)


def single(mount):
    return Poles(mount, np.ones_like(mount), np.zeros_like(mount))


def priced(prices, mount):
    return Prices(prices, np.zeros_like(prices), mount, -1)


def some(seed, *, objects=12, levels=2, parties=2):
    rng = np.random.default_rng(seed)
    known = rng.integers(0, 6, (6, objects)) * (rng.random((6, objects)) < 0.6)
    threshold = np.sort(rng.integers(1, 9, (levels, objects)), axis=0)
    own = rng.random((parties, objects)) < 0.7
    return (
        Levels(known, threshold, rng.integers(1, 5, (levels, objects)), own),
        np.array([0, 0, 1, 1, 2, 3]),
        rng,
    )


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000), budget=st.integers(1, 3), failing=st.integers(0, 1))
def test_equals_trying_all(seed, budget, failing):
    levels, mount, rng = some(seed, levels=1 if failing else 2)
    if failing:
        levels = levels._replace(threshold=np.ones_like(levels.threshold))
    worth = partial(surviving, levels) if failing else levels.worth
    stands = rng.random(6) < 0.8
    sets = [chosen for chosen in every(mount, budget) if stands[chosen].all()]
    best = max((worth(chosen) for chosen in sets), default=0)
    programme = Programme(levels, budget, single(mount), stands, failing=failing)
    found = solve(programme)
    assert (found.value, found.bound, found.optimal) == (best, best, True)
    assert not found.members or worth(found.members) == best
    prices, need = rng.integers(1, 9, 6), max(1, best // 2)
    able = [chosen for chosen in sets if worth(chosen) >= need]
    cheapest = solve(programme, at_least=need, cost=priced(prices, mount))
    if not able:
        assert (cheapest.members, cheapest.optimal) == (None, True)
        return
    least = min(prices[chosen].sum() for chosen in able)
    assert (cheapest.value, cheapest.bound, cheapest.optimal) == (least, least, True)
    assert worth(cheapest.members) >= need
    fewest = min(len(chosen) for chosen in able if prices[chosen].sum() == least)
    assert len(cheapest.members) == fewest


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_what_is_left_without_some_equals_trying_all(seed):
    levels, mount, rng = some(seed)
    lost = [mount == 0, mount == 1]
    prices = rng.integers(1, 9, 6)

    def left(chosen):
        return min(levels.worth([c for c in chosen if not gone[c]]) for gone in lost)

    sets = list(every(mount, 3))
    need = max(1, max(map(left, sets)) // 2)
    programme = Programme(levels, 3, single(mount), np.ones(6, bool), lost_cases=lost)
    found = solve(programme, at_least=need, cost=priced(prices, mount))
    able = [int(prices[chosen].sum()) for chosen in sets if left(chosen) >= need]
    if not able:
        assert (found.members, found.optimal) == (None, True)
        return
    assert left(found.members) >= need
    assert (found.value, found.bound, found.optimal) == (min(able), min(able), True)
    most = solve(programme)
    assert (most.value, most.optimal) == (max(map(left, sets)), True)


def test_steps_are_worth_no_less_and_survive_failures_or_stay_unproven():
    """A millionth has no whole number of parts for each of 7 objects: the parts are rounded up."""
    model = HitModel("early", 0.7, -6.0, 1.8, 1.0, 0.8, 0.3, "made up")
    assert levels_of_hits(np.full((1, 7), 1e5), model, above=True).worth([0]) >= GAIN_UNITS
    levels = levels_of_coverage(np.array([[1, 1, 0, 0], [0, 1, 1, 0], [0, 0, 1, 1]], bool))
    assert levels.worth([0, 1]) == 3
    assert surviving(levels, [0, 1]) == 2
    assert (
        surviving(levels, [0, 1, 2]) == 3
    )  # without the first the first object is lost, and so on
    assert (surviving(levels, [0]), levels.max_worth) == (0, 4)
    levels = levels_of_coverage(np.random.default_rng(0).random((200, 300)) < 0.05)
    mount = np.arange(200)
    programme = Programme(levels, 20, single(mount), np.ones(200, bool))
    found = solve(
        programme,
        SolverLimits(seconds=0.01),
        at_least=290,
        cost=priced(np.ones(200, np.int64), mount),
    )
    assert (found.members, found.optimal) == (None, False)


@pytest.mark.parametrize("floor", [0.0, 30.0])
def test_steps_of_hits_lie_above_the_curve_or_cut_it(floor):
    model = HitModel("early", 0.7, -6.0, 1.8, 0.95, 0.8, 0.3, "made up", floor=floor)
    points = np.random.default_rng(1).lognormal(3, 1.5, (5, 40)) * (
        np.random.default_rng(2).random((5, 40)) < 0.6
    )
    powers = points**model.norm
    above, middle = (levels_of_hits(powers, model, above=each) for each in (True, False))
    for chosen in ([0], [1, 3], [0, 1, 2, 3, 4]):
        p = model.probability(powers[chosen].sum(axis=0), powers[chosen].sum(axis=0))
        assert above.worth(chosen) >= p.mean() * GAIN_UNITS
        reached = above.evidence[chosen].sum(axis=0) >= above.threshold
        assert ((above.gain * reached).sum(axis=0) * 40 / GAIN_UNITS >= p - 1e-6).all()
        if not floor:
            steps = (
                (middle.gain * (middle.evidence[chosen].sum(axis=0) >= middle.threshold)).sum(
                    axis=0
                )
                * 40
                / GAIN_UNITS
            )
            assert np.abs(steps - p).max() <= 0.25
            assert np.abs(steps - p).mean() < 0.12
    assert levels_of_hits(np.zeros((2, 3)), model, above=True).worth([0, 1]) == 0


def test_changes_keep_the_count_and_raise_the_reward_of_what_may_be_built(make):
    objective = make(8, 1, seed=2)
    value = objective.scores(np.eye(8, dtype=bool)).reward
    even = np.arange(8) % 2 == 0  # what is counted: even candidates

    def count(sets):
        return (sets & even).sum(axis=1)

    worst = int(np.flatnonzero(even)[value[even].argmin()])
    assert improve_among_equals(Progress(objective, 1, None, None), [worst], count) == [
        int(np.flatnonzero(even)[value[even].argmax()])
    ]
    assert improve_among_equals(Progress(objective, 1, None, None), [], count) == []
    assert improve_among_equals(Progress(objective, 1, None, 1), [worst], count) == [worst]
    objective = make(4, 2, seed=3)
    chosen = improve_among_equals(
        Progress(objective, 2, None, None), [0, 2], lambda sets: sets.sum(axis=1)
    )
    assert objective.feasible(objective.row(chosen)[None])[0]
    assert objective.score(chosen).reward >= objective.score([0, 2]).reward


def test_limits_and_seed_are_those_asked_for():
    parameters = SolverLimits(2.5, 7, 0.5).build_solver().parameters
    assert (parameters.max_time_in_seconds, parameters.num_workers, parameters.random_seed) == (
        2.5,
        1,
        7,
    )
    assert parameters.max_deterministic_time == 0.5
    assert SolverLimits(1.0).build_solver().parameters.max_deterministic_time > 1e6


def test_a_missing_package_is_named(without_packages):
    without_packages("ortools.sat.python")
    with pytest.raises(ImportError, match="pip install coview"):
        load_cp_model()


PRICES = Prices(np.array([5, 7, 20]), np.array([10, 10, 0]), np.array([0, 0, 1]), 40)
POLES = Poles(
    np.array([0, 0, 0, 1]),
    np.array([2, 2, 2, 1]),
    np.array([LINK_UNITS // 2, LINK_UNITS // 2, LINK_UNITS // 2 + 1, 0]),
)


def test_shared_poles_are_paid_once(make):
    assert PRICES.total([0, 1, 2]) == 42
    assert PRICES.total([1]) == 17
    assert PRICES.total([]) == 0
    some = PRICES.select(np.array([1, 2]))
    assert (some.total([0]), some.limit, some.total([0, 1])) == (17, 40, 37)
    objective = make(3, 2)
    assert Prices.from_objective(objective) is None
    price = objective.candidates.prices
    prices = Prices.from_objective(
        objective.with_weights(objective.weights, most_price=float(price[0] + price[2]))
    )
    assert prices is not None
    assert prices.total([0, 2]) <= prices.limit < prices.total([0, 2]) + 2**20
    assert prices.per_mount.tolist() == [0] * 6


def test_places_of_a_pole_are_apart_for_bounds():
    assert POLES.exclusive_mount.tolist() == [2, 3, 4, 1]
