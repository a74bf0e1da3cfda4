import numpy as np
import pytest

from placement_env.search import greedy
from placement_env.search.exact import exhaustive
from placement_env.search.progress import Progress
from placement_env.setting import Weights


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
        progress = Progress(objective, 3, None, None)
        assert optimum <= greedy.online_bound(progress, chosen) + 1e-12
