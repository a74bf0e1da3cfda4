import numpy as np
import pytest

from placement_env.search.progress import Limits, Progress, add_each, as_rows


def test_the_incumbent_is_the_best_feasible_or_settled_set_within_limits(make):
    progress = Progress(make(4, 2), 2, None, None)
    # 0 and 1 share a mount; three are beyond the budget
    sets = as_rows([[0], [0, 1], [0, 2, 4], [2, 4]], 8)
    rewards = progress.rewards(sets)
    assert progress.reward == max(rewards[0], rewards[3])
    assert progress.result("some", progress.unknown("why")).best.reward == progress.reward
    assert progress.limits.count == 4
    progress = Progress(make(4, 2), 3, None, 5)
    figures = progress.figures(np.eye(8, dtype=bool))
    assert np.isfinite(figures.reward).sum() == np.isfinite(figures.ap).sum() == 5
    assert (figures.reward[5:] == -np.inf).all()
    assert progress.spent
    progress = Progress(make(4, 2), 3, None, None)
    progress.rewards(np.eye(8, dtype=bool))
    progress.settle([])
    assert progress.result("some", progress.unknown("why")).best.subset == ()


@pytest.mark.parametrize(
    "wrong", [{"seconds": 0.0, "evaluations": None}, {"seconds": None, "evaluations": -1}]
)
def test_limits_are_above_0(wrong):
    with pytest.raises(ValueError, match="must be above 0"):
        Limits(**wrong)


def test_histories_end_with_the_search_and_options_stand_alone():
    limits = Limits(None, None)
    for count, reward in ((3, 0.25), (7, 0.5)):
        limits.count = count
        limits.record(reward)
    limits.count = 20
    history = limits.history(0.5)
    assert history.evaluations.tolist() == [3, 7, 20]
    assert history.reward.tolist() == [0.25, 0.5, 0.5]
    assert add_each([0], np.zeros(0, np.int64), 3).shape == (0, 3)
    assert add_each([], np.arange(3), 3).tolist() == np.eye(3, dtype=bool).tolist()
