from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from placement_env.fidelity.coverage import Coverage
from placement_env.fidelity.visibility import Visibility
from placement_env.objective import Objective
from placement_env.search import greedy
from placement_env.search.exact import cpsat, programme
from placement_env.setting import Setting

pytest.importorskip("ortools")


def single(mount):
    return programme.Poles(mount, np.ones_like(mount), np.zeros_like(mount))


def most(seen, mount, budget, views):
    best = 0
    for size in range(1, budget + 1):
        for chosen in combinations(range(len(seen)), size):
            if len(set(mount[list(chosen)])) == size:
                best = max(best, int((seen[list(chosen)].sum(axis=0) >= views).sum()))
    return best


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    mounts=st.integers(1, 5),
    poses=st.integers(1, 3),
    budget=st.integers(1, 4),
    views=st.integers(1, 3),
    density=st.sampled_from([0.0, 0.1, 0.5, 1.0]),
)
def test_equals_trying_all(seed, mounts, poses, budget, views, density):
    rng = np.random.default_rng(seed)
    mount = np.repeat(np.arange(mounts), poses)
    seen = rng.random((len(mount), 25)) < density
    cover = cpsat.cover_most(seen, single(mount), budget, views=views)
    assert cover.optimal
    assert cover.value == cover.bound == most(seen, mount, budget, views)
    assert len(set(mount[cover.members])) == len(cover.members) <= budget


def test_stopped_early_it_has_a_bound_and_merging_keeps_objects():
    seen, mount = np.random.default_rng(0).random((300, 400)) < 0.1, np.repeat(np.arange(30), 10)
    start = cpsat.greedy_cover(seen, np.ones(400, np.int64), mount, 5, 1)
    cover = cpsat.cover_most(seen, single(mount), 5, limits=programme.SolverLimits(seconds=1e-3))
    assert (
        (seen[cover.members].sum(axis=0) > 0).sum()
        == cover.value
        >= (seen[start].sum(axis=0) > 0).sum()
    )
    assert cover.value <= cover.bound <= 400
    assert not cover.optimal
    seen = np.array([[1, 1, 0, 0, 1], [0, 0, 1, 0, 1]], bool)
    ones = np.ones((1, 5), np.int64)
    objects, weight = cpsat.merge_objects(seen, np.arange(2), 1, ones)
    assert sorted(zip(objects.T.tolist(), weight[0].tolist(), strict=True)) == [
        *(([False, True], 1), ([True, False], 2), ([True, True], 1))
    ]
    assert cpsat.merge_objects(seen, np.zeros(2, np.int64), 2, ones)[1].size == 0


def test_stopped_early_it_pays_for_shared_poles():
    # two poles with two places each: a place costs 10 and a pole 100, so 120 buy one pole
    seen = np.eye(4, dtype=np.bool_)
    mount = np.array([0, 0, 1, 1])
    poles = programme.Poles(mount, np.full(4, 2), np.zeros(4, np.int64))
    prices = programme.Prices(np.full(4, 10), np.full(4, 100), mount, limit=120)
    no_time = programme.SolverLimits(effort=0.0)
    stopped = cpsat.cover_most(seen, poles, 2, prices=prices, limits=no_time)
    assert prices.total(stopped.members) <= 120
    assert stopped.value <= cpsat.cover_most(seen, poles, 2, prices=prices).value == 2


@pytest.mark.parametrize("views", [1, 2])
@pytest.mark.parametrize("seed", range(5))
def test_bound_holds_wherever_it_is_taken(seed, views):
    seen, mount = np.random.default_rng(seed).random((12, 30)) < 0.3, np.repeat(np.arange(4), 3)
    weight = np.ones(30, np.int64)
    for chosen in ([], [0], [0, 4], cpsat.greedy_cover(seen, weight, mount, 3, views)):
        assert cpsat.prove_bound(seen, weight, mount, 3, views=views, members=chosen) >= most(
            seen, mount, 3, views
        )


def visible(objective, seed=0, objects=80):
    rng = np.random.default_rng(seed)
    n = len(objective.candidates)
    points = np.where(
        rng.random((n, objects)) < 0.3, rng.integers(20, 400, (n, objects)), 5
    ).astype(np.float32)
    sent = np.full((n, 4), 500.0, np.float32)
    frame = np.repeat(np.arange(4), objects // 4)
    return Visibility(points, points * 0 + 20, frame, np.zeros((objects, 7)), sent, sent)


@pytest.mark.parametrize("views", [1, 2])
def test_search_beats_greedy_and_proves_it(make, views):
    parts = make(6, 2)
    seen = visible(parts)
    objective = Objective(
        Setting(candidates=parts.candidates, fidelity=Coverage(seen, views=views), scheme="early"),
        visibility=seen,
    )
    found = cpsat.search(objective, 3, views=views)
    assert found.certificate.kind == "optimal"
    assert found.certificate.measure == "coverage"
    assert found.certificate.gap == 0
    assert found.best.reward == found.certificate.value == found.history.reward[-1]
    assert found.best.reward >= greedy.search(objective, 3).best.reward


def test_other_objectives_and_seeds_have_their_answers(make):
    objective = make(6, 2)
    seen = visible(objective)
    found = cpsat.search(objective, 3, visibility=seen)
    assert found.best.reward == objective.score(found.best.subset).reward
    with pytest.raises(ValueError, match="pass visibility="):
        cpsat.search(objective, 3)
    objective = make(8, 3)
    seen = visible(objective)
    first, again = (
        cpsat.search(objective, 3, visibility=seen, seed=3).best.subset for _ in range(2)
    )
    assert first == again
    seen = np.array([[1, 1, 1], [1, 0, 0], [0, 1, 0]], bool)
    cover = cpsat.cover_most(
        seen, single(np.arange(3)), 1, is_buildable=np.array([False, True, True])
    )
    assert cover.value == 1
    assert cover.members is not None
    assert 0 not in cover.members
