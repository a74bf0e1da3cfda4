"""A fit finds the model that made the hits, and refuses what it cannot be fitted to."""

import numpy as np
import pytest

from placement_env.fidelity.hit_fit import fit
from placement_env.fidelity.surrogate import Surrogate

SETS = np.random.default_rng(1).random((60, 12)) < 0.35


@pytest.fixture(scope="module")
def visibility(made_visibility):
    return made_visibility()


def test_fit_finds_the_model_that_made_the_hits(made_visibility, hit_model):
    sets = SETS[:30]
    seen = made_visibility(12, 250, seed=5)
    surrogate = Surrogate(seen, "early", hit_model)
    sums = np.stack([surrogate._parts[0]._sums(row[None])[0] for row in sets])
    hits = np.random.default_rng(6).random(sums.shape) < hit_model.probability(sums)
    found = fit(seen, sets, hits, surrogate(sets).ap, scheme="early", iou=0.7, source="test")
    estimate, truth = Surrogate(seen, "early", found)(sets), surrogate(sets)
    np.testing.assert_allclose(estimate.recall, truth.recall, atol=0.03)
    np.testing.assert_allclose(estimate.ap, truth.ap, atol=0.03)
    assert found.norm == pytest.approx(hit_model.norm, abs=0.4)
    assert found.density == pytest.approx(hit_model.density, rel=0.3)
    assert found.oblique == pytest.approx(hit_model.oblique, abs=0.3)


def test_fit_refuses_other_frames_and_certainty(visibility):
    with pytest.raises(ValueError, match="same frames"):
        fit(visibility, SETS, np.zeros((60, 5), bool), np.zeros(60), scheme="early", iou=0.7)
    with pytest.raises(ValueError, match="hits and misses"):
        fit(visibility, SETS, np.zeros((60, 300), bool), np.zeros(60), scheme="early", iou=0.7)
