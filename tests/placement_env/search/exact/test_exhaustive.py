from itertools import combinations

import numpy as np
import pytest

from placement_env.search.exact import exhaustive
from placement_env.setting import Weights


@pytest.mark.parametrize(
    ("mounts", "poses", "budget"), [(6, 1, 6), (3, 3, 3), (1, 1, 1), (4, 2, 2)]
)
def test_equals_trying_one_by_one(make, mounts, poses, budget):
    objective = make(mounts, poses, weights=Weights(1e-4, 0.01), seed=3)
    found = exhaustive.search(objective, budget)
    sets = [
        s for k in range(1, budget + 1) for s in combinations(range(len(objective.candidates)), k)
    ]
    scores = [objective.score(s) for s in sets if objective.feasible(objective.row(s)[None])[0]]
    assert found.best.reward == max(s.reward for s in scores)
    assert found.certificate.kind == "optimal"
    assert found.certificate.gap == 0
    for best in found.by_size:
        assert best.reward == max(s.reward for s in scores if len(s.subset) == len(best.subset))
    costs = np.array([(-s.ap, s.kbit, s.price) for s in scores])
    beaten = [((costs <= row).all(axis=1) & (costs < row).any(axis=1)).any() for row in costs]
    assert {s.subset for s in found.front} == {
        s.subset for s, b in zip(scores, beaten, strict=True) if not b
    }


def test_nothing_pays_or_fits_and_numbers_have_limits(make):
    found = exhaustive.search(make(3, 1, weights=Weights(price=100.0)))
    assert found.best.subset == ()
    assert found.best.reward == 0
    found = exhaustive.search(make(3, 1, capacity=1.0))
    assert not found.best.subset
    assert not found.front
    assert not found.by_size
    found = exhaustive.search(make(6, 1), evaluations=10)
    assert found.certificate.kind == "none"
    assert found.evaluations == 10
    assert exhaustive.search(make(16, 1)).evaluations == 2**16 - 1
    with pytest.raises(ValueError, match="at most 16 candidates, got 17"):
        exhaustive.search(make(17, 1))
    assert len(exhaustive.search(make(3, 1)).by_size) == 3
    with pytest.raises(ValueError, match="budget must be a whole number of at least 1"):
        exhaustive.search(make(3, 1), 0)
