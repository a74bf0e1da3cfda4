"""Several sensors on a pole: what may stand together, in every search, mask and programme, against
enumeration."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.candidates.candidates import extra_prices, fit_together, room_beside
from placement_env.envs.scenario import Scenario
from placement_env.envs.select import SensorSelectEnv
from placement_env.envs.state import find_room
from placement_env.objective import Objective
from placement_env.search import greedy, swap
from placement_env.search.exact import cpsat, exhaustive
from placement_env.search.exact.programme import Levels, Poles, Prices, Programme, solve
from placement_env.setting import Setting


def carrying(objective, places, capacity=2000.0):
    """The objective on mounts that carry so many sensors, whose models cost something too."""
    candidates = objective.candidates
    mounts = tuple(
        replace(m, max_sensors=n, capacity=capacity)
        for m, n in zip(candidates.mounts, places, strict=True)
    )
    axes = replace(candidates.axes, prices=(0.25,))
    there = replace(candidates, mounts=mounts, axes=axes)
    return Objective(
        Setting(
            candidates=there,
            fidelity=objective.scored_by,
            scheme="early",
            weights=objective.weights,
            most_price=objective.most_price,
        )
    )


@pytest.fixture
def three(make):
    """Three mounts with four poses each, that carry two, one and three."""
    return carrying(make(3, 4, objects=40, seed=3, most=0.4), (2, 1, 3))


def by_hand(objective, row):
    """Whether a set may be built, one sensor after another."""
    candidates = objective.candidates
    for m, mount in enumerate(candidates.mounts):
        here = [c for c in np.flatnonzero(row) if candidates.mount[c] == m]
        if len(here) > mount.max_sensors or sum(objective.sent[c] for c in here) > mount.capacity:
            return False
    return price_by_hand(candidates, row) <= objective.most_price


def price_by_hand(candidates, row):
    mounts = {int(m) for m in candidates.mount[row]}
    return sum(candidates.mounts[m].price for m in mounts) + 0.25 * row.sum()


@pytest.mark.parametrize("capacity", [2000.0, 1000.0])
@pytest.mark.parametrize("most", [np.inf, 2.5])
def test_all_sets_against_the_rule_in_words(make, capacity, most):
    objective = carrying(make(3, 4, seed=3), (2, 1, 3), capacity)
    objective = objective.with_weights(objective.weights, most_price=most)
    sets = exhaustive.list_sets(12, 4)
    expected = [by_hand(objective, row) for row in sets]
    assert objective.feasible(sets).tolist() == expected
    assert 0 < sum(expected) < len(sets)
    assert objective.price(sets) == pytest.approx(
        [price_by_hand(objective.candidates, row) for row in sets]
    )
    for row in sets[objective.feasible(sets)][::37]:
        grown = np.repeat(row[None], 12, axis=0) | np.eye(12, dtype=bool)
        assert objective.allowed(row).tolist() == (objective.feasible(grown) & ~row).tolist()


def test_a_second_sensor_costs_no_second_mount(three):
    row = np.isin(np.arange(12), [0])
    added = extra_prices(three.candidates, row)
    assert added[:4].tolist() == [0.25] * 4
    assert added[4] == three.candidates.prices[4] == three.candidates.mounts[1].price + 0.25
    assert three.price(row[None])[0] == three.candidates.prices[0]


def test_drawn_sets_share_mounts_and_may_be_built(three):
    rng = np.random.default_rng(0)
    drawn = [swap.draw_set(three, 5, rng) for _ in range(60)]
    assert max(map(len, drawn)) > 3
    for chosen in drawn:
        assert len(set(chosen)) == len(chosen) <= 5
        assert three.feasible(three.row(chosen)[None])[0]


def test_environments_mask_full_mounts_and_price_a_second_sensor(three):
    env = SensorSelectEnv(objective=three, budget=4)
    env.reset(seed=0)
    for slot in (0, 1):
        assert env.action_masks()[slot]
        info = env.step(slot)[4]
        assert not info["illegal"]
    assert not env.action_masks()[:4].any()
    assert env.action_masks()[4:8].all()
    assert info["price"] == pytest.approx(three.candidates.mounts[0].price + 0.5)


def test_places_of_one_are_as_ever(make):
    candidates = make(3, 4).candidates
    assert not candidates.has_shared_mounts
    row = np.isin(np.arange(12), [0])
    assert room_beside(candidates, row[None]).tolist() == [[False] * 4 + [True] * 8]
    assert fit_together(candidates, np.array([row, np.isin(np.arange(12), [0, 1])])).tolist() == [
        True,
        False,
    ]
    mounts = (replace(candidates.mounts[0], max_sensors=2), *candidates.mounts[1:])
    assert replace(candidates, mounts=mounts).digest() != candidates.digest()


@pytest.mark.one_in(2)
@pytest.mark.parametrize("capacity", [2000.0, 1200.0])
@pytest.mark.parametrize("most", [np.inf, 2.2])
def test_searches_reach_the_best_of_all_sets(make, capacity, most):
    objective = carrying(make(3, 4, objects=40, seed=3, most=0.4), (2, 1, 3), capacity)
    objective = objective.with_weights(objective.weights, most_price=most)
    best = exhaustive.search(objective, 4).best
    assert np.bincount(objective.candidates.mount[list(best.subset)]).max() > 1 or (
        capacity,
        most,
    ) != (2000.0, np.inf)
    found = swap.search(objective, 4, seed=1, evaluations=6000).best
    assert objective.feasible(objective.row(found.subset)[None])[0]
    assert found.reward == pytest.approx(best.reward, abs=0.03)
    assert objective.feasible(objective.row(greedy.search(objective, 4).best.subset)[None])[0]


@pytest.mark.parametrize("views", [1, 2])
@pytest.mark.parametrize("capacity", [2000.0, 1200.0])
@pytest.mark.parametrize("most", [np.inf, 2.2])
def test_programmes_cover_as_much_as_any_set(make, views, capacity, most):
    pytest.importorskip("ortools")

    objective = carrying(make(3, 4, objects=40, seed=5, most=0.4), (2, 1, 3), capacity)
    objective = objective.with_weights(objective.weights, most_price=most)
    seen, sets = objective.scored_by.seen, exhaustive.list_sets(12, 4)
    sets = sets[objective.feasible(sets)]
    covered = [int((seen[row].sum(axis=0) >= views).sum()) for row in sets]
    found = cpsat.cover_most(
        seen,
        Poles.from_objective(objective),
        4,
        views=views,
        is_buildable=objective.allowed([]),
        prices=Prices.from_objective(objective),
    )
    assert (found.value, found.bound, found.optimal) == (max(covered), max(covered), True)
    assert objective.feasible(objective.row(found.members)[None])[0]


@pytest.mark.parametrize("capacity", [2000.0, 1200.0])
def test_the_cheapest_set_pays_a_shared_mount_once(make, capacity):
    pytest.importorskip("ortools")

    objective = carrying(make(3, 4, objects=40, seed=5, most=0.4), (2, 1, 3), capacity)
    seen, sets = objective.scored_by.seen, exhaustive.list_sets(12, 4)
    sets = sets[objective.feasible(sets)]
    need = 24
    able = sets[np.array([seen[row].any(axis=0).sum() >= need for row in sets])]
    ones = np.ones((1, seen.shape[1]), np.int64)
    programme = Programme.from_objective(
        objective, 4, Levels(seen.astype(np.int64), ones, ones, ones > 0)
    )
    found = solve(programme, at_least=need, cost=Prices.in_units(objective, 1e-6))
    least = objective.price(able).min()
    assert found.optimal
    assert objective.price(objective.row(found.members)[None])[0] == pytest.approx(least)
    assert found.value == found.bound == pytest.approx(least * 1e6, abs=8)


@pytest.mark.parametrize("capacity", [2000.0, 1000.0])
def test_masks_of_environments_are_what_the_objective_allows(make, capacity):
    objective = carrying(make(3, 4, seed=3), (2, 1, 3), capacity)
    scenario = Scenario(objective, 14)
    sets = exhaustive.list_sets(12, 4)
    sets = sets[objective.feasible(sets)][::41]
    masks = find_room(scenario, np.pad(sets, ((0, 0), (0, 2)))) & scenario.usable
    for row, mask in zip(sets, masks, strict=True):
        assert mask[:12].tolist() == objective.allowed(row).tolist()
        assert not mask[12:].any()
