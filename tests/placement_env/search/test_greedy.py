from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from placement_env.objective import Objective
from placement_env.protocol import Estimate
from placement_env.search import greedy
from placement_env.search.exact import exhaustive
from placement_env.setting import Setting, Weights


@settings(max_examples=10, deadline=None)
@given(
    seed=st.integers(0, 1000),
    budget=st.integers(1, 7),
    poses=st.integers(1, 3),
    views=st.integers(1, 2),
    comm=st.sampled_from([0.0, 1e-4]),
    capacity=st.sampled_from([50.0, 500.0, 2000.0]),
)
def test_answers_are_feasible_and_never_beat_the_optimum(
    make, seed, budget, poses, views, comm, capacity
):
    objective = make(
        5, poses, views=views, seed=seed, weights=Weights(comm=comm, price=comm), capacity=capacity
    )
    found = greedy.search(objective, budget, seed=seed)
    row = objective.row(found.best.subset)
    optimum = exhaustive.search(objective, budget).best.reward
    assert objective.feasible(row[None])[0]
    assert row.sum() <= budget
    assert found.best.reward <= optimum
    assert found.best.reward == found.history.reward[-1] == found.certificate.value
    assert (np.diff(found.history.reward) >= 0).all()
    assert (np.diff(found.history.evaluations) >= 0).all()


@pytest.mark.parametrize("poses", [1, 3])
@pytest.mark.parametrize("seed", range(5))
def test_bounds_of_coverage_hold(make, poses, seed):
    objective = make(5, poses, seed=seed)
    found, optimum = (
        greedy.search(objective, 3, submodular=True),
        exhaustive.search(objective, 3).best.reward,
    )
    assert found.certificate.kind == "bound"
    assert found.best.reward <= optimum <= found.certificate.bound + 1e-12
    assert found.certificate.bound <= optimum + 0.4
    assert found.certificate.ratio == pytest.approx(1 - 1 / np.e if poses == 1 else 0.5)
    assert found.best.reward >= found.certificate.ratio * optimum


def test_greedy_keeps_to_evaluations_and_seconds(make):
    assert "grew" in greedy.search(make(8, 2, views=2, seed=1), 4, submodular=True).certificate.note
    found = greedy.search(make(20, 2), 5, evaluations=50, submodular=True)
    assert found.evaluations == 50
    assert found.certificate.bound == np.inf
    assert found.best.reward > 0
    assert greedy.search(make(20, 2), 5, seconds=1e-9).best.subset == ()


class Worth:
    """AP is the sum of what each candidate is worth."""

    name = "worth"

    def __init__(self, *worth):
        self.worth = np.array(worth)

    def __call__(self, subsets):
        ap = subsets @ self.worth
        return Estimate(ap, ap.copy(), np.ones(len(subsets)))


def spend(make, worth, prices, money):
    candidates = make(len(worth), 1).candidates
    mounts = tuple(
        replace(mount, price=price) for mount, price in zip(candidates.mounts, prices, strict=True)
    )
    candidates = replace(candidates, mounts=mounts)
    setting = Setting(
        candidates=candidates, fidelity=Worth(*worth), scheme="late", most_price=money
    )
    return greedy.search(Objective(setting), len(worth)).best.subset


def test_money_is_not_used_up_by_one_dear_sensor(make):
    """The lidar alone adds most, but two cameras for about as much add more; and one sensor that is
    worth all."""
    assert spend(make, (0.65, 0.4, 0.39), (10.0, 5.5, 5.5), 11.0) == (1, 2)
    assert spend(make, (0.9, 0.1, 0.0), (10.0, 1.0, 9.0), 10.0) == (0,)


@pytest.mark.parametrize("budget", [0, -1])
def test_budget_must_be_positive(make, budget):
    with pytest.raises(ValueError, match="budget must be a whole number of at least 1"):
        greedy.search(make(), budget)
