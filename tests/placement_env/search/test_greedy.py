import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from placement_env.search import greedy
from placement_env.search.exact import exhaustive
from placement_env.setting import Weights

WAYS = [greedy.search, greedy.lazy, greedy.stochastic]


@pytest.mark.parametrize("way", WAYS)
@settings(max_examples=10, deadline=None)
@given(
    seed=st.integers(0, 1000), budget=st.integers(1, 7), poses=st.integers(1, 3), views=st.integers(1, 2),
    comm=st.sampled_from([0.0, 1e-4]), capacity=st.sampled_from([50.0, 500.0, 2000.0]),
)  # fmt: skip
def test_answers_are_feasible_and_never_beat_the_optimum(make, way, seed, budget, poses, views, comm, capacity):
    objective = make(5, poses, views=views, seed=seed, weights=Weights(comm=comm, price=comm), capacity=capacity)
    found = way(objective, budget, seed=seed)
    row = objective.row(found.best.subset)
    optimum = exhaustive.search(objective, budget).best.reward
    assert objective.feasible(row[None])[0]
    assert row.sum() <= budget
    assert found.best.reward <= optimum
    assert found.best.reward == found.history.reward[-1] == found.certificate.value
    assert (np.diff(found.history.reward) >= 0).all()
    assert (np.diff(found.history.evaluations) >= 0).all()


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("poses", [1, 3])
@pytest.mark.parametrize("seed", range(5))
def test_bounds_of_coverage_hold(make, way, poses, seed):
    objective = make(5, poses, seed=seed)
    found, optimum = way(objective, 3, submodular=True), exhaustive.search(objective, 3).best.reward
    assert found.certificate.kind == "bound"
    assert found.best.reward <= optimum <= found.certificate.bound + 1e-12
    assert found.certificate.bound <= optimum + 0.4
    if way is not greedy.stochastic:
        assert found.certificate.ratio == pytest.approx(1 - 1 / np.e if poses == 1 else 0.5)
        assert found.best.reward >= found.certificate.ratio * optimum


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("batch", [1, 4])
def test_lazy_is_greedy_on_coverage_for_fewer_sets(make, seed, batch):
    objective = make(40, 3, objects=300, seed=seed, most=0.1)
    plain, lazy = greedy.search(objective, 6), greedy.lazy(objective, 6, batch=batch)
    assert lazy.best.reward == plain.best.reward
    assert lazy.evaluations < 0.7 * plain.evaluations


def test_lazy_says_where_gains_grow(make):
    found = greedy.lazy(make(8, 2, views=2, seed=1), 4, submodular=True)
    assert found.certificate.kind == "none"
    assert "grew" in found.certificate.note


def test_greedy_says_where_gains_grow(make):
    assert "grew" in greedy.search(make(8, 2, views=2, seed=1), 4, submodular=True).certificate.note


@pytest.mark.parametrize("way", WAYS)
def test_evaluations_are_kept_to(make, way):
    objective = make(20, 2)
    found = way(objective, 5, evaluations=50, submodular=True)
    assert found.evaluations == 50
    assert found.certificate.bound == np.inf
    assert found.best.reward > 0


def test_seconds_are_kept_to(make):
    assert greedy.search(make(20, 2), 5, seconds=1e-9).best.subset == ()


def test_stochastic_is_decided_by_its_seed(make):
    objective = make(30, 3)
    first, again = (greedy.stochastic(objective, 4, seed=7) for _ in range(2))
    assert first.best.subset == again.best.subset
    assert len({greedy.stochastic(objective, 4, seed=s, epsilon=0.5).best.subset for s in range(8)}) > 1


@pytest.mark.parametrize("budget", [0, -1])
def test_budget_must_be_positive(make, budget):
    with pytest.raises(ValueError, match="budget must be a whole number of at least 1"):
        greedy.search(make(), budget)
