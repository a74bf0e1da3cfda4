"""What all searches have in common, and local searches in particular."""

from inspect import signature

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from placement_env.search import cmaes, greedy, swap
from placement_env.search.exact import cpsat, exhaustive
from placement_env.setting import Weights


@pytest.mark.parametrize("module", [cmaes, cpsat, exhaustive, greedy, swap])
def test_every_search_takes_the_same_arguments(module):
    positional, keywords = ["objective", "budget"], {"seed": 0, "seconds": None, "evaluations": None}
    parameters = signature(module.search).parameters
    assert list(parameters)[:2] == positional
    assert {name: parameters[name].default for name in keywords} == keywords
    assert all(p.default is not p.empty and p.kind is p.KEYWORD_ONLY for p in list(parameters.values())[2:])


@settings(max_examples=10, deadline=None)
@given(
    seed=st.integers(0, 1000), budget=st.integers(1, 6), poses=st.integers(1, 3), views=st.integers(1, 2),
    comm=st.sampled_from([0.0, 1e-4]), capacity=st.sampled_from([50.0, 500.0, 2000.0]),
)  # fmt: skip
def test_answers_are_feasible_and_never_beat_the_optimum(make, seed, budget, poses, views, comm, capacity):
    objective = make(4, poses, views=views, seed=seed, weights=Weights(comm=comm, price=comm), capacity=capacity)
    found = swap.search(objective, budget, seed=seed, evaluations=300)
    row = objective.row(found.best.subset)
    assert objective.feasible(row[None])[0]
    assert row.sum() <= budget
    assert found.best.reward <= exhaustive.search(objective, budget).best.reward
    assert found.best.reward == found.history.reward[-1]
    assert found.evaluations <= 300
    assert (np.diff(found.history.reward) >= 0).all()


@pytest.mark.parametrize("views", [1, 2])
@pytest.mark.parametrize("seed", range(3))
def test_small_ones_are_solved(make, views, seed):
    objective = make(5, 3, views=views, seed=seed, weights=Weights(price=0.02))
    assert swap.search(objective, 3, evaluations=4000).best.reward == exhaustive.search(objective, 3).best.reward


def test_seeds_seconds_and_settings_of_searches(make):
    objective = make(20, 3, views=2, most=0.2)
    first, again = (swap.search(objective, 4, seed=5, evaluations=1000) for _ in range(2))
    assert first.best.subset == again.best.subset
    assert np.array_equal(first.history.reward, again.history.reward)
    found = swap.search(make(20, 2), 4, seconds=0.2)
    assert len(found.best.subset) <= 4
    with pytest.raises(ValueError, match="starts must be a whole number of at least 1"):
        swap.search(make(), 2, starts=0)
