"""Money is a hard limit: no search answers with a set that costs more, whatever it would gain."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from placement_env.fidelity.visibility import Visibility
from placement_env.objective import Objective
from placement_env.search import greedy, swap
from placement_env.search.exact import cpsat, exhaustive
from placement_env.search.greedy import online_bound
from placement_env.search.progress import Progress
from placement_env.setting import Setting
from placement_env.subsets import all_subsets
from toolkit.sensors.models import DepthCamera

SEARCHES: dict[str, Any] = {
    "exhaustive": exhaustive.search,
    "greedy": greedy.search,
    "swap": swap.search,
}


@pytest.fixture
def priced(make):
    """An objective of six mounts with two poses each, and the same with models that cost and a
    limit."""

    def limited(most, seed=0, mounts=6):
        free = make(mounts=mounts, poses=2, seed=seed)
        plain = free.candidates
        factors = plain.factors.copy()
        factors[:, 4] = np.arange(len(plain)) % 2
        axes = replace(
            plain.axes, models=(DepthCamera(), DepthCamera(width=80)), prices=(0.25, 1.0)
        )
        sensors = tuple(
            replace(s, model=axes.models[f])
            for s, f in zip(plain.sensors, factors[:, 4], strict=True)
        )
        candidates = replace(plain, sensors=sensors, factors=factors, axes=axes)
        return Objective(
            Setting(candidates=candidates, fidelity=free.scored_by, scheme="early", most_price=most)
        )

    return limited


def test_prices_are_of_mounts_once_and_feasible_sets_within_the_money(priced):
    objective = priced(np.inf)
    mounts, candidates = objective.candidates.mount_prices, objective.candidates
    both = objective.row([0, 1])  # one mount, both models
    assert objective.price(both[None])[0] == pytest.approx(mounts[0] + 0.25 + 1.0)
    assert candidates.prices[2] == pytest.approx(mounts[1] + 0.25)
    assert objective.score([0, 3]).price == pytest.approx(mounts[0] + 0.25 + mounts[1] + 1.0)
    objective = priced(3.0)
    sets = all_subsets(len(objective.candidates))
    one_each = (objective.candidates.per_mount(sets) <= 1).all(axis=1)
    assert np.array_equal(objective.feasible(sets), one_each & (objective.price(sets) <= 3.0))
    chosen = [0]
    allowed = objective.allowed(chosen)
    for c in range(1, len(objective.candidates)):
        assert allowed[c] == objective.feasible(objective.row([0, c])[None])[0], c
    objective, rng = priced(3.0), np.random.default_rng(0)
    for _ in range(100):
        assert objective.feasible(objective.row(swap.draw_set(objective, 4, rng))[None])[0]
    objective = priced(3.0)
    progress = Progress(objective, 3, None, None)
    chosen = list(greedy.search(objective, 3).best.subset)
    assert online_bound(progress, chosen) >= exhaustive.search(objective, 3).best.ap - 1e-12


def test_sums_are_not_refused_for_rounding_and_none_is_none(make):
    free = make(mounts=3, poses=1)
    mounts = tuple(replace(mount, price=0.1) for mount in free.candidates.mounts)
    exact = Objective(
        Setting(
            candidates=replace(free.candidates, mounts=mounts),
            fidelity=free.scored_by,
            scheme="early",
            most_price=0.3,
        )
    )
    assert exact.feasible(np.ones((1, 3), bool))[
        0
    ]  # 0.1 + 0.1 + 0.1 is more than 0.3 in floating point
    objective = make()
    with pytest.raises(ValueError, match="most_price must be 0 or more, got -1"):
        Objective(
            Setting(candidates=objective.candidates, fidelity=objective.scored_by, most_price=-1.0)
        )
    broke = Objective(
        Setting(candidates=objective.candidates, fidelity=objective.scored_by, most_price=0.0)
    )
    assert not broke.allowed([]).any()
    assert greedy.search(broke, 3).best.subset == ()
    assert swap.draw_set(broke, 3, np.random.default_rng(0)) == []


@pytest.mark.parametrize("most", [0.5, 2.0, 3.5])
@pytest.mark.parametrize("name", SEARCHES)
def test_every_search_keeps_to_the_money(priced, name, most):
    limits = {"evaluations": 800} if name == "swap" else {}
    for seed in range(3):
        objective = priced(most, seed)
        result = SEARCHES[name](objective, 4, seed=seed, **limits)
        assert result.best.price <= most
        assert all(score.price <= most for score in (*result.front, *result.by_size))


@pytest.mark.parametrize("seed", range(4))
def test_cpsat_finds_the_best_cover_for_the_money(priced, make, seed):
    pytest.importorskip("ortools")
    for most in (1.5, 3.0, 4.5):
        objective = priced(most, seed)
        points = np.where(objective.scored_by.seen, 100.0, 0.0).astype(np.float32)
        sent = np.zeros((len(points), 1), np.float32)
        frame, boxes = np.zeros(points.shape[1], np.int64), np.ones((points.shape[1], 7))
        visibility = Visibility(points, np.zeros_like(points), frame, boxes, sent, sent)
        answer = cpsat.search(objective, 4, visibility=visibility, seed=seed, effort=5.0)
        best = exhaustive.search(objective, 4).best
        assert answer.best.price <= most
        assert answer.best.ap == pytest.approx(best.ap)
        assert answer.certificate.kind == "optimal"
