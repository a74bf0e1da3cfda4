"""The most expected hits, against trying all sets."""

import numpy as np
import pytest

from placement_env.fidelity.hit_model import HitModel
from placement_env.fidelity.surrogate import Surrogate
from placement_env.fidelity.visibility import Visibility
from placement_env.objective import Objective
from placement_env.search.exact import cheapest, hits
from placement_env.setting import Setting
from placement_env.subsets import all_subsets

pytest.importorskip("ortools")


@pytest.fixture
def objective(make):
    candidates = make(5, 2, seed=4).candidates
    rng = np.random.default_rng(4)
    points = np.where(rng.random((10, 50)) < 0.35, rng.lognormal(4, 1.0, (10, 50)), 0).astype(
        np.float32
    )
    sent, near = np.full((10, 5), 100.0, np.float32), np.full((10, 50), 20.0, np.float32)
    seen = Visibility(points, near, np.repeat(np.arange(5), 10), np.zeros((50, 7)), sent, sent)
    model = HitModel("early", 0.7, -4.0, 1.8, 0.98, 0.7, 0.3, "made up", floor=5.0)
    return Objective(
        Setting(candidates=candidates, fidelity=Surrogate(seen, "early", model)), visibility=seen
    )


def test_no_set_has_more(objective):
    found = hits.search(objective, 2)
    levels = cheapest.build_levels(objective.scored_by, above=False)
    sets = all_subsets(10)[1:]
    sets = sets[(sets.sum(axis=1) <= 2) & objective.feasible(sets)]
    worth = np.array([levels.worth(np.flatnonzero(row).tolist()) for row in sets])
    known = found.certificate
    assert (known.kind, known.measure) == ("optimal", "hits")
    assert known.value == known.bound == worth.max() / 1e6
    assert levels.worth(list(found.best.subset)) == worth.max()
    equal = sets[worth == worth.max()]
    assert found.best.reward == pytest.approx(objective.scores(equal).reward.max())
    recall = objective.scores(sets).recall
    assert found.best.recall >= recall.max() - 0.05


def test_it_needs_a_surrogate(make):
    with pytest.raises(ValueError, match="say --fidelity surrogate"):
        hits.search(make(), 2)
