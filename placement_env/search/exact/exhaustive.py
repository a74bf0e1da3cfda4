"""Every set of up to 16 candidates: the optimum, the best set of each size and the exact
AP-kbit-price front.
"""

import numpy as np

from placement_env.objective import Objective, Score, Scores
from placement_env.search.progress import Progress
from placement_env.search.result import Certificate, Result
from placement_env.subsets import Sets, all_subsets
from toolkit.arrays import Float

MAX_CANDIDATES = 16  # candidates, 65 536 sets


def search(
    objective: Objective,
    budget: int | None = None,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
) -> Result:
    """Best set of at most `budget` sensors, proven by scoring all; of equals the smallest, first.

    The result also holds the sets that no other one beats in AP, kbit and price together, and the
    best set of each size. Nothing is proven if a limit stops the search.

    Args:
        objective: At most 16 candidates, and their scores.
        budget: Largest number of sensors, None for any number.
        seed: Not used; other searches have it.
        seconds: Limit of the search, None for none.
        evaluations: Limit on scored sets, None for none.

    Raises ValueError above 16 candidates.
    """
    size = len(objective.candidates)
    if size > MAX_CANDIDATES:
        raise ValueError(
            f"exhaustive search takes at most {MAX_CANDIDATES} candidates, got {size}: select some"
        )
    progress = Progress(
        objective,
        budget=size if budget is None else budget,
        seconds=seconds,
        evaluations=evaluations,
    )
    subsets = list_sets(size, progress.budget)
    subsets = subsets[objective.feasible(subsets)]
    figures = progress.figures(subsets)
    scored = np.flatnonzero(np.isfinite(figures.reward))
    if len(scored) == len(subsets):
        note = f"all {len(subsets)} feasible sets were scored"
        certificate = Certificate.from_bound(progress.reward, progress.reward, note)
    else:
        certificate = progress.unknown(
            f"stopped after {progress.limits.count} of {len(subsets)} feasible sets"
        )
    figures = Scores(*(column[scored] for column in figures))
    subsets = subsets[scored]
    front = find_front(np.stack([-figures.ap, figures.kbit, figures.price], axis=1))
    front = front[np.lexsort((figures.kbit[front], figures.price[front]))]  # by price, then kbit
    set_sizes = subsets.sum(axis=1)
    rows_by_size = [np.flatnonzero(set_sizes == set_size) for set_size in np.unique(set_sizes)]
    best = [rows[figures.reward[rows].argmax()] for rows in rows_by_size]

    def scores(rows: np.ndarray | list[np.intp]) -> tuple[Score, ...]:
        """Scores of some rows of `subsets`."""
        return tuple(objective.score(np.flatnonzero(subsets[row]).tolist()) for row in rows)

    return progress.result("exhaustive", certificate, front=scores(front), by_size=scores(best))


def list_sets(size: int, budget: int) -> Sets:
    """All sets of 1 to `budget` of `size` candidates as rows of booleans, small ones first."""
    sets = all_subsets(size)[1:]  # without the empty set
    set_sizes = sets.sum(axis=1)
    order = np.argsort(set_sizes, kind="stable")
    return sets[order[set_sizes[order] <= budget]]


def find_front(points: Float[np.ndarray, "n m"]) -> np.ndarray:
    """Indices of the rows that no other row beats, ascending.

    A row beats another if it is no higher in any column and lower in one. Of equal rows the first
    stays.

    points: n rows of m figures, each the better the lower.
    """
    # by the first column, then the second and so on, equal rows by index: in this order no row is
    # beaten by a later one
    order = np.lexsort((np.arange(len(points)), *points.T[::-1]))
    front = []
    while order.size:
        best = order[0]
        front.append(best)
        # drops the best row too, and all rows that it beats or equals
        order = order[(points[order] < points[best]).any(axis=1)]
    return np.sort(np.array(front, np.int64))
