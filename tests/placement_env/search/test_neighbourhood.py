import numpy as np
import pytest

from placement_env.search.neighbourhood import Neighbourhood


@pytest.mark.parametrize("poses", [1, 3])
def test_samples_and_neighbours_are_feasible_and_differ_in_one_sensor(make, poses):
    objective, rng = make(6, poses), np.random.default_rng(0)
    neighbourhood = Neighbourhood(objective, 3)
    chosen, sizes = neighbourhood.sample(rng), set()
    assert len(chosen) == 3
    for _ in range(300):
        changed = neighbourhood.neighbour(chosen, rng)
        assert len(set(changed) - set(chosen)) <= 1
        assert len(set(chosen) - set(changed)) <= 1
        assert len(set(changed)) == len(changed) <= 3
        assert objective.feasible(objective.row(changed)[None])[0]
        chosen = changed
        sizes.add(len(chosen))
    assert sizes >= {2, 3}, "sensors are dropped and added"


def test_a_repaired_set_is_a_feasible_subset(make):
    objective, rng = make(5, 3), np.random.default_rng(1)
    neighbourhood = Neighbourhood(objective, 2)
    for _ in range(50):
        chosen = np.flatnonzero(rng.random(15) < 0.6).tolist()
        kept = neighbourhood.repair(chosen, rng)
        assert set(kept) <= set(chosen)
        assert objective.feasible(objective.row(kept)[None])[0]
        assert len(kept) == min(2, len({int(objective.candidates.mount[c]) for c in chosen}))


def test_where_nothing_may_stand_there_are_no_sets(make):
    neighbourhood, rng = Neighbourhood(make(3, 1, capacity=1e-9), 2), np.random.default_rng(0)
    assert neighbourhood.sample(rng) == neighbourhood.neighbour([], rng) == neighbourhood.repair([0, 1], rng) == []
