"""Of sets that cover as much, the best by the objective."""

import numpy as np

from placement_env.search.progress import Progress
from placement_env.search.verification import best_of_equals


def test_changes_keep_the_count_and_raise_the_reward_of_what_may_be_built(make):
    objective = make(8, 1, seed=2)
    value = objective.scores(np.eye(8, dtype=bool)).reward
    even = np.arange(8) % 2 == 0  # what is counted: even candidates

    def count(sets):
        return (sets & even).sum(axis=1)

    worst = int(np.flatnonzero(even)[value[even].argmin()])
    assert best_of_equals(Progress(objective, 1, None, None), [worst], count) == [
        int(np.flatnonzero(even)[value[even].argmax()])
    ]
    assert best_of_equals(Progress(objective, 1, None, None), [], count) == []
    stopped = Progress(objective, 1, None, 1)
    assert best_of_equals(stopped, [worst], count) == [worst]
    objective = make(4, 2, seed=3)
    chosen = best_of_equals(Progress(objective, 2, None, None), [0, 2], lambda sets: sets.sum(axis=1))
    row = objective.row(chosen)
    assert objective.feasible(row[None])[0]
    assert objective.score(chosen).reward >= objective.score([0, 2]).reward
