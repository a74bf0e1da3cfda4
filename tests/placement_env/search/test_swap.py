import numpy as np
import pytest

from placement_env.search import greedy, swap


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


def test_swap_proves_nothing_when_stopped(make):
    assert swap.search(make(20, 2), 4, evaluations=30).certificate.kind == "none"


def test_starts_are_checked(make):
    with pytest.raises(ValueError, match="starts must be a whole number of at least 1"):
        swap.search(make(), 2, starts=0)
