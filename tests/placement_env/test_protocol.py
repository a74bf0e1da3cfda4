"""What every fidelity keeps to, and their names."""

from typing import Any

import numpy as np
import pytest

from placement_env.fidelity.coverage import Coverage
from placement_env.fidelity.perception_entropy import PerceptionEntropy
from placement_env.fidelity.surrogate import Surrogate
from placement_env.protocol import Fidelity
from placement_env.setting import Setting

SETS = np.random.default_rng(1).random((60, 12)) < 0.35
MADE: dict[str, Any] = {
    **{
        f"surrogate, {s}": lambda seen, models, s=s: Surrogate(seen, s, models[s])
        for s in ("early", "late", "hybrid")
    },
    **{
        f"entropy, {s}": lambda seen, _, s=s: PerceptionEntropy(seen, s)
        for s in ("early", "late", "hybrid")
    },
    "coverage": lambda seen, _: Coverage(seen),
}


@pytest.mark.parametrize("name", MADE)
def test_every_one_is_a_monotone_fidelity_that_ignores_what_is_beside_a_set(
    made_visibility, hit_models, name
):
    fidelity = MADE[name](made_visibility(), hit_models)
    assert isinstance(fidelity, Fidelity)
    estimate = fidelity(SETS)
    for column in estimate:
        assert column.dtype == np.float64
        assert column.shape == (len(SETS),)
    assert ((estimate.ap >= 0) & (estimate.ap <= 1) & (estimate.recall <= 1)).all()
    shuffled = np.random.default_rng(2).permutation(len(SETS))
    for column, again in zip(estimate, fidelity(SETS[shuffled]), strict=True):
        np.testing.assert_array_equal(column[shuffled], again)
    empty = fidelity(np.zeros((1, 12), bool))
    assert [column[0] for column in empty] == [0, 0, 0]
    assert (fidelity(SETS | (np.arange(12) == 5)).recall >= estimate.recall - 1e-6).all()


def test_there_are_four_fidelities_by_name():
    with pytest.raises(
        ValueError,
        match="fidelity must be one of coverage, surrogate, detector, table, got 'guess'",
    ):
        Setting("tjunction", fidelity="guess")
