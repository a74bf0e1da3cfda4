"""Ties: of sets that are equal in what a programme counts, the one that the objective finds best.

Coverage has many optima (a set of coverage 1.000 may have AP 0.918 while its neighbour has 0.98), and a solver answers
with any of them. From its answer on, one sensor after another is changed where the count stays and the reward grows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from placement_env.search.progress import Progress, as_rows
from placement_env.search.verification import neighbours
from toolkit.arrays import Bool, Shaped

Count = Callable[[Bool[np.ndarray, "n C"]], Shaped[np.ndarray, " n"]]  # what a programme counts of sets


def best_of_equals(progress: Progress, chosen: Sequence[int], count: Count) -> list[int]:
    """The best set by the objective that is reached from one by changes of one sensor that keep the count, as far as
    the limits go."""
    objective = progress.objective
    best = sorted(int(c) for c in chosen)
    if not best:
        return best
    row = as_rows([best], progress.size)
    least, reward = count(row)[0], float(progress.rewards(row)[0])
    while not progress.spent:
        sets = neighbours(np.array(best), progress.size)[1:]
        sets = sets[objective.feasible(sets)]
        sets = sets[count(sets) >= least]
        rewards = progress.rewards(sets)
        if not len(sets) or not rewards.max() > reward:
            break
        best, reward = np.flatnonzero(sets[rewards.argmax()]).tolist(), float(rewards.max())
    return best
