"""Figures from memory are the fidelity's, whatever sets are asked for together."""

import numpy as np
import pytest

from placement_env.protocol import Estimate
from placement_env.score_memory import MIN_LISTED_TOGETHER, ScoreMemory

CANDIDATES = 300


class Summing:
    """Figures that differ for all sets, and the sets that were scored."""

    name = "summing"

    def __init__(self):
        self.scored = []

    def __call__(self, subsets):
        self.scored += [tuple(np.flatnonzero(row).tolist()) for row in subsets]
        ap = subsets @ (0.1 + np.arange(CANDIDATES) / 7)
        return Estimate(ap=ap, recall=-ap, kbit=subsets.sum(axis=1) / 3)


def draw_sets(rng, count):
    sets = np.zeros((count, CANDIDATES), bool)
    for row in sets:
        row[rng.choice(CANDIDATES, rng.integers(0, 4), replace=False)] = True
    return sets


@pytest.mark.parametrize("batch", [1, MIN_LISTED_TOGETHER - 1, MIN_LISTED_TOGETHER, 50])
def test_figures_are_the_fidelitys_and_no_set_is_scored_twice(batch):
    rng = np.random.default_rng(batch)
    fidelity = Summing()
    memory = ScoreMemory(fidelity)
    pool = draw_sets(rng, 40)
    seen = {()}  # the empty set is known from the start
    for _ in range(12):
        sets = pool[rng.integers(0, len(pool), batch)]
        members = [tuple(np.flatnonzero(row).tolist()) for row in sets]
        figures = memory.figures(sets)
        expected = Summing()(sets)
        np.testing.assert_allclose(figures.ap, expected.ap)
        np.testing.assert_array_equal(figures.recall, -figures.ap)
        np.testing.assert_array_equal(figures.kbit, expected.kbit)
        np.testing.assert_array_equal(figures.class_ap[:, 0], figures.ap)
        assert figures.cache_hit.tolist() == [key in seen for key in members]
        assert figures.scored == len(set(members) - seen)
        seen |= set(members)
        figures.ap[:] = 0.0  # a caller's copy
    assert len(fidelity.scored) == len(set(fidelity.scored))
    assert () not in fidelity.scored


def test_sets_of_small_and_large_batches_are_the_same():
    sets = draw_sets(np.random.default_rng(0), MIN_LISTED_TOGETHER)
    memory = ScoreMemory(Summing())
    memory.figures(sets)
    assert memory.figures(sets[:1]).cache_hit.all()
    assert memory.fork().figures(sets).cache_hit.all()
    memory.forget()
    assert memory.figures(sets).cache_hit.tolist() == [not row.any() for row in sets]
