"""What all searches have in common, and local searches in particular."""

from importlib.util import find_spec
from inspect import signature

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from placement_env.candidates.candidates import paper_candidates
from placement_env.fidelity.preparation import check_scorable
from placement_env.search import cmaes, greedy, methods, swap
from placement_env.search.exact import cpsat, exhaustive
from placement_env.search.progress import Progress
from placement_env.setting import Setting, Weights
from toolkit.sites.files import load_site


@pytest.mark.parametrize("module", [cmaes, cpsat, exhaustive, greedy, swap])
def test_every_search_takes_the_same_arguments(module):
    positional, keywords = (
        ["objective", "budget"],
        {"seed": 0, "seconds": None, "evaluations": None},
    )
    parameters = signature(module.search).parameters
    assert list(parameters)[:2] == positional
    assert {name: parameters[name].default for name in keywords} == keywords
    assert all(
        p.default is not p.empty and p.kind is p.KEYWORD_ONLY for p in list(parameters.values())[2:]
    )


@settings(max_examples=10, deadline=None)
@given(
    seed=st.integers(0, 1000),
    budget=st.integers(1, 6),
    poses=st.integers(1, 3),
    views=st.integers(1, 2),
    comm=st.sampled_from([0.0, 1e-4]),
    capacity=st.sampled_from([50.0, 500.0, 2000.0]),
)
def test_answers_are_feasible_and_never_beat_the_optimum(
    make, seed, budget, poses, views, comm, capacity
):
    objective = make(
        4, poses, views=views, seed=seed, weights=Weights(comm=comm, price=comm), capacity=capacity
    )
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
    assert (
        swap.search(objective, 3, evaluations=4000).best.reward
        == exhaustive.search(objective, 3).best.reward
    )


def test_seeds_seconds_and_settings_of_searches(make):
    objective = make(20, 3, views=2, most=0.2)
    first, again = (swap.search(objective, 4, seed=5, evaluations=1000) for _ in range(2))
    assert first.best.subset == again.best.subset
    assert np.array_equal(first.history.reward, again.history.reward)
    assert len(swap.search(make(20, 2), 4, seconds=0.2).best.subset) <= 4
    with pytest.raises(ValueError, match="starts must be a whole number of at least 1"):
        swap.search(make(), 2, starts=0)


SITE = load_site("tjunction")


@pytest.mark.parametrize("name", methods.METHODS)
def test_every_name_is_a_search(name):
    if methods.METHODS[name].needs and not find_spec(methods.METHODS[name].needs):
        pytest.skip("its package is missing")
    assert callable(methods.load_search(name))
    methods.check_search(name, "detector", paper_candidates(SITE))


def test_unknown_and_usual_methods():
    with pytest.raises(ValueError, match="method must be one of portfolio, exhaustive, greedy"):
        methods.check_search("luck", "coverage", paper_candidates(SITE))
    assert [
        methods.usual_method(each) for each in ("coverage", "surrogate", "detector", "table")
    ] == [*("portfolio", "portfolio", "greedy", "exhaustive")]
    assert methods.usual_method("surrogate", verify=True) == "greedy"
    assert methods.usual_method("table", at_least=True) == "cheapest"


@pytest.mark.parametrize("fidelity", ["coverage", "surrogate", "detector", "table"])
def test_what_can_be_scored_is_not_refused(fidelity):
    check_scorable(Setting(SITE, fidelity=fidelity))


def test_coverage_by_one_view_is_submodular_and_halved_by_shared_mounts(make):
    assert greedy.is_submodular(make(4, 1))
    assert not greedy.is_submodular(make(4, 1, views=2))
    assert greedy.guarantee(make(4, 1)) == pytest.approx(1 - 1 / np.e)
    assert greedy.guarantee(make(4, 2)) == 0.5
    objective = make(6, 2, weights=Weights(price=0.05))
    found = greedy.search(objective, 3, submodular=True)
    assert found.certificate.ratio == 0
    assert exhaustive.search(objective, 3).best.reward <= found.certificate.bound
    objective = make(6, 1)
    progress = Progress(objective, 2, None, None)
    assert greedy.certify(progress, [0], 0.5, 4.2e-08).kind == "bound"
    grown = greedy.certify(progress, [0], 0.5, 4.2e-03)
    assert (grown.kind, grown.note) == (
        "none",
        "said to be submodular, but a gain grew by 0.0042 as other sensors joined",
    )


@pytest.mark.parametrize("seed", range(5))
def test_no_set_beats_the_online_bound_of_any_set(make, seed):
    objective = make(5, 2, seed=seed)
    optimum = exhaustive.search(objective, 3).best.ap
    for chosen in ([], [0], [0, 4]):
        assert optimum <= greedy.online_bound(Progress(objective, 3, None, None), chosen) + 1e-12


@pytest.mark.parametrize("seed", range(3))
def test_swap_starts_from_greedy_and_ends_where_no_change_improves(make, seed):
    objective = make(15, 2, views=2, most=0.3, seed=seed)
    found = swap.search(objective, 4, starts=2)
    assert found.certificate.kind == "local optimum"
    assert found.best.reward >= greedy.search(objective, 4).best.reward
    for gone in found.best.subset:
        rest = [c for c in found.best.subset if c != gone]
        for new in np.flatnonzero(objective.allowed(rest)).tolist():
            assert objective.score([*rest, new]).reward <= found.best.reward


def test_swaps_stop_and_start_where_told(make):
    assert swap.search(make(20, 2), 4, evaluations=30).certificate.kind == "none"
    with pytest.raises(ValueError, match="starts must be a whole number of at least 1"):
        swap.search(make(), 2, starts=0)
    objective = make(15, 2, views=2, most=0.3, seed=1)
    optimum = swap.search(objective, 4, starts=1)
    again = swap.search(
        make(15, 2, views=2, most=0.3, seed=1), 4, starts=1, start=optimum.best.subset
    )
    assert again.best == optimum.best
    assert again.evaluations < optimum.evaluations
    assert again.certificate.kind == "local optimum"
    same_mount = np.flatnonzero(
        objective.candidates.mount == objective.candidates.mount[0]
    ).tolist()
    assert len(same_mount) == 2
    misfit = swap.search(objective, 2, starts=1, start=[*same_mount, 4, 6, 8])
    assert objective.feasible(objective.row(misfit.best.subset)[None])[0]
    assert len(misfit.best.subset) <= 2
    with pytest.raises(ValueError, match="nowhere"):
        swap.search(objective, 2, start=["nowhere"])
