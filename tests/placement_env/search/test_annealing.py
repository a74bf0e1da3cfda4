import pytest

from placement_env.search import annealing
from placement_env.search.progress import DEFAULT_EVALUATIONS


def test_without_a_limit_so_many_sets_are_scored(make):
    assert annealing.search(make(6, 2), 3).evaluations == DEFAULT_EVALUATIONS


def test_heat_leaves_local_optima_in_which_the_cold_stays(make):
    objective = make(12, 2, views=2, most=0.3, seed=3)
    limits = {"seed": 1, "evaluations": 3000, "chains": 1}
    cold = annealing.search(objective, 4, hot=1e-9, cold=1e-9, **limits)
    warm = annealing.search(objective, 4, hot=0.02, cold=1e-4, **limits)
    assert warm.best.reward >= cold.best.reward


def test_where_nothing_may_stand_the_answer_is_the_empty_set(make):
    assert annealing.search(make(3, 1, capacity=1e-9), 2).best.subset == ()


@pytest.mark.parametrize("wrong", [{"hot": 0.1, "cold": 0.2}, {"cold": 0.0}, {"chains": 0}])
def test_temperatures_are_checked(make, wrong):
    with pytest.raises(ValueError, match="hot >= cold > 0"):
        annealing.search(make(), 2, **wrong)
