"""Ties: choose among sets that a programme finds equal, by the objective.

Coverage has many optima (a set of coverage 1.000 may have AP 0.918 while its neighbour has 0.98), and a solver may
answer with any of them. Starting from its answer, one sensor after another is changed where the count stays and the
reward grows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from placement_env.search.progress import Progress, as_rows
from placement_env.search.verification import neighbours
from toolkit.arrays import Bool, Shaped


def best_of_equals(
    progress: Progress,
    chosen: Sequence[int],
    count: Callable[[Bool[np.ndarray, "n C"]], Shaped[np.ndarray, " n"]],
) -> list[int]:
    """Best set by the objective that changes of one sensor reach within the limits while they keep the count."""
    best = sorted(int(c) for c in chosen)
    if not best:
        return best
    row = as_rows([best], progress.size)
    least, reward = count(row)[0], float(progress.rewards(row)[0])
    while not progress.spent:
        sets = neighbours(np.array(best), progress.size)[1:]
        sets = sets[progress.objective.feasible(sets)]
        sets = sets[count(sets) >= least]
        rewards = progress.rewards(sets)
        if not len(sets) or not rewards.max() > reward:
            break
        best, reward = np.flatnonzero(sets[rewards.argmax()]).tolist(), float(rewards.max())
    return best
