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


def test_swaps_stop_and_start_where_told(make):
    assert swap.search(make(20, 2), 4, evaluations=30).certificate.kind == "none"
    with pytest.raises(ValueError, match="starts must be a whole number of at least 1"):
        swap.search(make(), 2, starts=0)
    objective = make(15, 2, views=2, most=0.3, seed=1)
    optimum = swap.search(objective, 4, starts=1)
    again = swap.search(make(15, 2, views=2, most=0.3, seed=1), 4, starts=1, start=optimum.best.subset)
    assert again.best == optimum.best
    assert again.evaluations < optimum.evaluations
    assert again.certificate.kind == "local optimum"
    same_mount = np.flatnonzero(objective.candidates.mount == objective.candidates.mount[0]).tolist()
    assert len(same_mount) == 2
    misfit = swap.search(objective, 2, starts=1, start=[*same_mount, 4, 6, 8])
    assert objective.feasible(objective.row(misfit.best.subset)[None])[0]
    assert len(misfit.best.subset) <= 2
    with pytest.raises(ValueError, match="nowhere"):
        swap.search(objective, 2, start=["nowhere"])
