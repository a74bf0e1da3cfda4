"""Sets worth a judgement: feasible, of every size, within the money, the same again."""

import numpy as np
import pytest

from placement_env.objective import Objective
from placement_env.search import swap
from placement_env.search.portfolio.entrants import (
    SWAP_EVALUATIONS,
    THRIFT,
    Effort,
    Entrants,
    entrants,
    join_entrants,
    keep_entrants,
)
from placement_env.setting import Setting
from toolkit.runtime.cache import Cache
from toolkit.runtime.run import Run

TWO = Effort((1, 2))


def test_every_size_has_the_best_set_for_the_money(street):
    found = entrants(street.objective, Effort((1, 2, 3)))
    assert street.objective.feasible(found.sets).all()
    sizes = found.sets.sum(axis=1)
    assert (np.diff(sizes) >= 0).all()
    assert {size: found.predicted[sizes == size].max() for size in (1, 2, 3)} == {1: 0.5, 2: 0.75, 3: 1.0}
    assert len(np.unique(found.sets, axis=0)) == len(found.sets)
    three = int(np.flatnonzero(sizes == 3)[found.predicted[sizes == 3].argmax()])
    assert {"exhaustive", "greedy"} <= set(found.searches[three])
    assert found.considered > 14
    assert np.array_equal(found.predicted, street.objective.scores(found.sets).ap)
    # the sets cost 11, 11, 10.5 and 23
    tight = Objective(
        Setting(candidates=street.candidates, fidelity=street.objective.scored_by, scheme="late", most_price=22.0)
    )
    found = entrants(tight, Effort((1, 2, 3, 4)))
    assert tight.price(found.sets).max() == 22.0
    assert found.sets.sum(axis=1).max() == 2
    first, again = (
        entrants(street.objective, Effort((1, 2)), seed=3),
        entrants(street.objective, Effort((1, 2)), seed=3),
    )
    assert np.array_equal(first.sets, again.sets)
    assert (first.searches, first.considered) == (again.searches, again.considered)
    poor = Objective(
        Setting(candidates=street.candidates, fidelity=street.objective.scored_by, scheme="late", most_price=1.0)
    )
    found = entrants(poor, Effort((1, 2)))
    assert (found.sets.shape, found.predicted.shape, found.searches) == ((0, 4), (0,), ())


def test_large_pools(make):
    stages = []
    objective = Objective(make(mounts=6, poses=4).setting, Run(progress=lambda *stage: stages.append(stage)))
    found = entrants(objective, Effort((1, 2), neighbours=3))
    assert [stage for stage in stages if stage[0] == "searching"] == [("searching", 1, 2), ("searching", 2, 2)]
    assert not any("exhaustive" in names for names in found.searches)
    assert 4 <= len(found.sets) <= 14


def test_a_required_ap_brings_the_cheapest_sets_around_it(street):
    """Sensors 0 and 1 cost 11, 2 costs 10.5; one finds half, two find three quarters, three find all."""
    usual, asked = (entrants(street.objective, Effort((1, 2, 3), min_ap=each)) for each in (None, 0.5))
    names = {name for each in asked.searches for name in each}
    assert {"swap for AP 0.45", "swap for AP 0.5", "swap for AP 0.55", "swap for AP 0.6"} <= names
    assert not any("for AP" in name for each in usual.searches for name in each)
    reach = asked.predicted >= 0.5
    assert street.objective.price(asked.sets[reach]).min() == 11.0


def test_entrants_of_several_searches_are_joined(street):
    one, two = np.eye(4, dtype=bool)[[0, 1]], np.array([[0, 1, 0, 0], [1, 1, 0, 0]], bool)
    found = [Entrants(one, np.zeros(2), (("greedy",), ()), 5), Entrants(two, np.zeros(2), (("swap",), ("greedy",)), 6)]
    joined = join_entrants([street.objective, street.objective], found)
    assert joined.sets.astype(int).tolist() == [[1, 0, 0, 0], [0, 1, 0, 0], [1, 1, 0, 0]]
    assert joined.searches == (("greedy",), ("swap",), ("greedy",))
    assert joined.predicted.tolist() == street.objective.scores(joined.sets).ap.tolist()
    assert joined.considered == 11
    assert join_entrants([street.objective], found[:1]) is found[0]


def test_they_are_kept_under_all_that_they_depend_on(street, monkeypatch):
    cache = Cache()
    first = keep_entrants(street.objective, TWO, cache, depends_on="a", seed=1)
    assert first.searches == entrants(street.objective, TWO, seed=1).searches
    rich = Objective(
        Setting(candidates=street.candidates, fidelity=street.objective.scored_by, scheme="late", most_price=900.0)
    )
    monkeypatch.setattr("placement_env.search.portfolio.entrants.entrants", lambda *_, **__: pytest.fail("searched"))
    again = keep_entrants(street.objective, TWO, cache, depends_on="a", seed=1)
    assert np.array_equal(first.sets, again.sets)
    assert np.array_equal(first.predicted, again.predicted)
    assert (first.searches, first.considered) == (again.searches, again.considered)
    for objective, effort, changes in (
        *((street.objective, Effort((1, 2, 3)), {}), (street.objective, Effort((1, 2), evaluations=9), {})),
        *((street.objective, TWO, {"depends_on": "b"}), (street.objective, TWO, {"seed": 2}), (rich, TWO, {})),
    ):
        with pytest.raises(pytest.fail.Exception, match="searched"):
            keep_entrants(objective, effort, cache, **{"depends_on": "a", "seed": 1, **changes})


def test_none_are_kept_too(street):
    poor = Objective(
        Setting(candidates=street.candidates, fidelity=street.objective.scored_by, scheme="late", most_price=1.0)
    )
    cache = Cache()
    for _ in range(2):
        none = keep_entrants(poor, TWO, cache)
        assert (none.searches, none.sets.shape) == ((), (0, 4))


def test_searches_get_the_seed_the_effort_and_the_price_that_are_asked(street, monkeypatch):
    """Prices of the candidates are 11, 11, 10.5 and 23 units: 13.875 in the mean."""
    asked, search = [], swap.search

    def noted(objective, size, **given):
        asked.append((objective.weights.price, given["seed"], given["starts"], given["evaluations"], given["seconds"]))
        return search(objective, size, **given)

    monkeypatch.setattr(swap, "search", noted)
    entrants(street.objective, Effort((2,), seconds=50.0, evaluations=40, neighbours=0), seed=7)
    assert [each[1:] for each in asked] == [(7, swap.STARTS, 40, 50.0)] * len(asked)
    assert [price for price, *_ in asked if price] == [pytest.approx(THRIFT / 13.875)]
    entrants(street.objective, Effort((2,)), seed=7)
    assert {most for *_, most, _ in asked[len(asked) // 2 :]} == {SWAP_EVALUATIONS}


@pytest.mark.parametrize(("most", "searched"), [(10, True), (9, False)])
def test_all_sets_are_scored_up_to_a_number_of_them(street, monkeypatch, most, searched):
    """Of four sensors there are 4 + 6 sets of one or two."""
    monkeypatch.setattr("placement_env.search.portfolio.entrants.EXHAUSTIVE_SETS", most)
    found = entrants(street.objective, Effort((2,)))
    assert any("exhaustive" in names for names in found.searches) == searched
