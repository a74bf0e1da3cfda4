"""Ties: choose among sets that a programme finds equal.

The objective decides. Coverage has many optima (a set of coverage 1.000 may have AP 0.918 while its neighbour has
0.98), and a solver may answer with any of them. Starting from its answer, one sensor after another is changed where the
count stays and the reward grows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from placement_env.search.progress import Progress, as_rows
from placement_env.search.verification import neighbours
from toolkit.arrays import Bool, Shaped

Count = Callable[[Bool[np.ndarray, "n C"]], Shaped[np.ndarray, " n"]]  # count of a programme, for sets


def best_of_equals(progress: Progress, chosen: Sequence[int], count: Count) -> list[int]:
    """Best set reachable by changes that keep the count.

    Each change replaces one sensor; the objective decides which set is best, as far as the limits go.
    """
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
