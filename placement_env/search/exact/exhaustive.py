"""Every set of up to 16 candidates. Yields the optimum, the best set of each size and the exact AP-kbit-price front."""

from __future__ import annotations

import numpy as np

from placement_env.objective import Objective, Score
from placement_env.search.progress import Figures, Progress
from placement_env.search.result import Certificate, Result
from toolkit.arrays import Bool, Float, Float64

LARGEST = 16  # candidates, 65 536 sets


def search(
    objective: Objective,
    budget: int | None = None,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
) -> Result:
    """The best set of at most `budget` sensors, proven.

    All sets are scored; budget None means any number. Nothing is proven if a limit stops it early. Among equals the
    smaller set wins, then the one that comes first. `seed` is not used. Raises ValueError above 16 candidates.
    """
    size = len(objective.candidates)
    if size > LARGEST:
        raise ValueError(f"exhaustive search takes at most {LARGEST} candidates, got {size}: select some")
    progress = Progress(objective, size if budget is None else budget, seconds, evaluations)
    subsets = every_set(size, progress.budget)
    subsets = subsets[objective.feasible(subsets)]
    figures = progress.figures(subsets)
    complete = bool(np.isfinite(figures.reward).all())
    certificate = (
        Certificate("optimal", progress.reward, progress.reward, 1.0, f"all {len(subsets)} feasible sets were scored")
        if complete
        else progress.unknown(f"stopped after {progress.limits.count} of {len(subsets)} feasible sets")
    )
    scored = np.flatnonzero(np.isfinite(figures.reward))
    figures, subsets = Figures(*(column[scored] for column in figures)), subsets[scored]
    return progress.result(
        "exhaustive", certificate, front(objective, subsets, figures), _by_size(objective, subsets, figures)
    )


def every_set(size: int, budget: int) -> Bool[np.ndarray, "n C"]:
    """All sets of 1 to `budget` candidates.

    The sets are drawn from `size` candidates, small ones first.

    >>> every_set(2, 2).astype(int).tolist()
    [[1, 0], [0, 1], [1, 1]]
    """
    codes = np.arange(1, 1 << size)
    sets = (codes[:, None] >> np.arange(size)) & 1 == 1
    count = sets.sum(axis=1)
    order = np.argsort(count, kind="stable")
    return sets[order[count[order] <= budget]]


def front(objective: Objective, subsets: Bool[np.ndarray, "n C"], figures: Figures) -> tuple[Score, ...]:
    """Sets that no other beats.

    A set is beaten in AP, kbit and price at once. The sets are ordered by price, then kbit.
    """
    keep = find_front(costs(figures))
    keep = keep[np.lexsort((figures.kbit[keep], figures.price[keep]))]
    return tuple(objective.score(np.flatnonzero(subsets[row]).tolist()) for row in keep)


def costs(figures: Figures) -> Float64[np.ndarray, "n 3"]:
    """Costs of a front, lower is better. The costs are -AP, kbit of the whole set, and price."""
    return np.stack([-figures.ap, figures.kbit, figures.price], axis=1)


def find_front(points: Float[np.ndarray, "n m"]) -> np.ndarray:
    """Rows that no other row beats.

    A row beats another if it is no higher in any column and lower in one. Of equal rows the first is kept.

    >>> find_front(np.array([[1.0, 2.0], [2.0, 1.0], [2.0, 2.0], [1.0, 2.0]]))
    array([0, 1])
    """
    order = np.lexsort((np.arange(len(points)), *points.T[::-1]))  # what comes first is never beaten by what follows
    kept = []
    while order.size:
        kept.append(order[0])
        order = order[(points[order] < points[order[0]]).any(axis=1)]
    return np.sort(np.array(kept, np.int64))


def _by_size(objective: Objective, subsets: np.ndarray, figures: Figures) -> tuple[Score, ...]:
    count = subsets.sum(axis=1)
    best = [np.flatnonzero(count == size)[np.argmax(figures.reward[count == size])] for size in np.unique(count)]
    return tuple(objective.score(np.flatnonzero(subsets[row]).tolist()) for row in best)
