"""Poles that must carry a sensor: every search answers with them, as good as trying all sets, or
nothing can."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.fidelity.coverage import Coverage
from placement_env.fidelity.hit_model import HitModel
from placement_env.fidelity.surrogate import Surrogate
from placement_env.fidelity.visibility import Visibility
from placement_env.objective import Objective
from placement_env.search import greedy, swap
from placement_env.search.exact import cheapest, cpsat, exhaustive, hits
from placement_env.search.exact.cheapest import Demand
from placement_env.search.exclusions import explain_kept
from placement_env.search.portfolio.entrants import Effort, find_entrants
from placement_env.search.progress import Progress
from placement_env.setting import Setting, Weights
from placement_env.subsets import all_subsets

MODEL = HitModel("early", 0.7, -4.0, 1.8, 0.98, 0.7, 0.3, "made up", floor=5.0)
KEPT = ("post1", "post4")


@pytest.fixture
def junction(make):
    """Ten candidates on five mounts of random prices; those on post4 see little, and one of them
    nothing."""

    def junction(fidelity="coverage", seed=0, keep=KEPT, **more):
        candidates = make(5, 2, seed=seed).candidates
        rng = np.random.default_rng(seed)
        points = np.where(rng.random((10, 64)) < 0.35, rng.lognormal(4, 1.0, (10, 64)), 0).astype(
            np.float32
        )
        points[8, 5:], points[9] = 0, 0
        sent, near = np.full((10, 8), 100.0, np.float32), np.full((10, 64), 20.0, np.float32)
        seen = Visibility(points, near, np.repeat(np.arange(8), 8), np.zeros((64, 7)), sent, sent)
        scored_by = Coverage(seen) if fidelity == "coverage" else Surrogate(seen, "early", MODEL)
        return Objective(
            Setting(candidates=candidates, fidelity=scored_by, keep=keep, **more), visibility=seen
        )

    return junction


def every_kept_set(objective, budget):
    """Every set that may be built, by the words of the question alone."""
    sets = all_subsets(10)[1:]
    mounts = np.arange(10) // 2
    own = [objective.candidates.mounts[m].name in objective.setting.keep for m in range(5)]
    on = np.stack([sets[:, mounts == m].sum(axis=1) for m in range(5)], axis=1)
    price = (on > 0) @ objective.candidates.mount_prices
    fits = (on <= 1).all(axis=1) & (on[:, own] == 1).all(axis=1) & (sets.sum(axis=1) <= budget)
    return sets[fits & (price <= objective.most_price)]


@pytest.mark.parametrize("fidelity", ["coverage", "surrogate"])
@pytest.mark.parametrize("most", [np.inf, 4.0])
@pytest.mark.parametrize("seed", range(3))
def test_searches_agree_with_trying_all(junction, fidelity, most, seed):
    objective = junction(fidelity, seed, most_price=most)
    sets = every_kept_set(objective, 3)
    every = all_subsets(10)[1:]
    assert np.array_equal(sets, every[(every.sum(axis=1) <= 3) & objective.feasible(every)])
    if not len(sets):
        assert explain_kept(objective, objective.allowed([]))
        assert swap.search(objective, 3, evaluations=500).best.subset == ()
        return
    best = objective.scores(sets).reward.max()
    assert exhaustive.search(objective, 3).best.reward == best
    assert swap.search(objective, 3, starts=3).best.reward == pytest.approx(best)
    grown = greedy.search(objective, 3).best
    assert objective.feasible(objective.row(grown.subset)[None])[0]
    assert best - 0.15 < grown.reward <= best
    found = find_entrants(objective, Effort((1, 2, 3)))
    assert objective.keeps(found.sets).all()
    assert found.predicted.max() == pytest.approx(objective.scores(sets).ap.max())


@pytest.mark.parametrize("most", [np.inf, 4.0])
@pytest.mark.parametrize("seed", range(3))
def test_exact_programmes_agree_with_trying_all(junction, most, seed):
    pytest.importorskip("ortools")
    objective = junction("coverage", seed, most_price=most)
    sets = every_kept_set(objective, 3)
    covered = cpsat.search(objective, 3)
    least = cheapest.search(objective, 3, demand=Demand(0.5))
    likely = junction("surrogate", seed, most_price=most)
    hit, levels = hits.search(likely, 3), cheapest.build_levels(likely.scored_by, above=False)
    if not len(sets):
        assert covered.best.subset == least.best.subset == hit.best.subset == ()
        return
    ap = objective.scores(sets).ap
    assert covered.best.ap == covered.certificate.bound == pytest.approx(ap.max())
    assert least.best.price == pytest.approx(objective.price(sets[ap >= 0.5]).min())
    worth = [levels.worth(np.flatnonzero(row).tolist()) for row in sets]
    assert levels.worth(list(hit.best.subset)) == max(worth)
    asked = float(np.quantile(likely.scores(sets).ap, 0.6))
    reached = cheapest.search(likely, 3, demand=Demand(asked))
    assert reached.best.price == pytest.approx(
        likely.price(sets[likely.scores(sets).ap >= asked]).min()
    )


def test_places_and_money_are_left_for_them(junction):
    objective = junction(seed=1)
    assert objective.allowed([]).all()
    assert np.flatnonzero(objective.next_allowed([])).tolist() == [2, 3, 8, 9]
    assert np.flatnonzero(objective.next_allowed([0, 2])).tolist() == [8, 9]
    assert np.array_equal(objective.next_allowed([2, 8]), objective.allowed([2, 8]))
    cheap = objective.price(every_kept_set(objective, 2)).min()
    objective = junction(seed=1, most_price=cheap)
    rng = np.random.default_rng(0)
    for _ in range(20):
        assert objective.feasible(objective.row(swap.draw_set(objective, 4, rng))[None])[0]
    assert greedy.search(objective, 4).best.price == pytest.approx(cheap)
    assert greedy.guarantee(objective) == 0
    start = swap.search(junction(seed=1), 3, starts=1, start=[0, 4]).best.subset
    assert {1, 4} <= {c // 2 for c in start}


def test_what_must_be_built_is_built_though_it_does_not_pay(junction):
    objective = junction(weights=Weights(price=5.0))
    for search in (greedy.search, swap.search, exhaustive.search):
        best = search(objective, 3).best
        assert best.reward < 0
        assert len(best.subset) == 2
    assert Progress(objective, 2, None, None).reward == -np.inf


def test_refusals_name_the_pole_and_the_reason(junction, make):
    with pytest.raises(
        ValueError, match=r"no sensor may stand on a pole 'post9', which is unknown, in a keep-out"
    ):
        _ = Setting(candidates=make(5, 2).candidates, keep=("post9",)).pool
    with pytest.raises(ValueError, match="keep must be names of poles, got 'post1'"):
        Setting(keep="post1")
    with pytest.raises(
        ValueError, match="2 poles must carry a sensor and a budget of 1 is allowed"
    ):
        greedy.search(junction(), 1)

    def reasons(**more):
        objective = junction(**more)
        return explain_kept(objective, objective.allowed([]))

    assert reasons() == ()
    (why,) = reasons(most_price=2.0)
    assert why.startswith("Sensors on post1 and post4, as asked, cost together the price of 2.")
    assert why.endswith("ordinary poles or more, and the price of 2 ordinary poles may be spent.")
    assert reasons(most_price=0.1)[0].startswith(
        "Pole post1 must carry a sensor, but cannot: a sensor there costs "
    )
    objective = junction()
    alone = objective.allowed([])
    assert "no pose" in explain_kept(objective, alone & (np.arange(10) < 8))[0]
    assert (
        "each pose sends 9.6 kbit per frame or more; 5 are allowed"
        in explain_kept(objective, alone, 5.0)[0]
    )
    far = replace(objective.candidates.mounts[0], name="far")
    more = replace(objective.candidates, mounts=(*objective.candidates.mounts, far))
    without = Objective(Setting(candidates=more, fidelity=objective.scored_by, keep=("far",)))
    assert "no pose on it sees the detection area" in explain_kept(without, without.allowed([]))[0]
