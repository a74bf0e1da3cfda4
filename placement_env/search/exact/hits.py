"""Most expected hits, with a proven bound: the surrogate's probabilities in steps, solved by
CP-SAT.

Steps cut the curve in the middle (`placement_env.search.exact.programme`). The objective decides
among equal sets.
"""

import numpy as np

from placement_env.fidelity.surrogate import Surrogate
from placement_env.objective import Objective
from placement_env.search import greedy
from placement_env.search.exact.cheapest import build_levels
from placement_env.search.exact.programme import (
    DEFAULT_SOLVER_S,
    GAIN_UNITS,
    Programme,
    SolverLimits,
    solve,
)
from placement_env.search.progress import Progress
from placement_env.search.result import Certificate, Result
from placement_env.search.verification import improve_among_equals
from placement_env.subsets import Sets
from toolkit.arrays import Int64


def search(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
) -> Result:
    """Set with the most expected hits, with a certificate of the share of objects that it hits.

    The share is counted in steps of the hit probability. The search starts at the set of a greedy
    search.

    Args:
        objective: Candidates, and the surrogate that predicts hits.
        budget: Largest number of sensors.
        seed: Seed of the solver.
        seconds: Limit of the search; the solver gets at most 60.
        evaluations: Limit on scored sets, in the greedy search and the choice among equal sets;
            None for none.

    Raises ValueError for fidelities other than the surrogate, or hybrid fusion; ImportError
    without OR-Tools.
    """
    surrogate = objective.scored_by
    if not isinstance(surrogate, Surrogate):
        raise ValueError(
            f"hits are what a surrogate predicts, got {objective.fidelity}: say --fidelity "
            "surrogate"
        )
    levels = build_levels(surrogate, above=False)
    progress = Progress(objective, budget, seconds, evaluations)
    start = greedy.grow(progress).members
    remaining_s = max(0.1, min(DEFAULT_SOLVER_S, progress.limits.seconds - progress.limits.elapsed))
    programme = Programme.from_objective(objective, budget, levels)
    solution = solve(programme, SolverLimits(seconds=remaining_s, seed=seed), start=start)
    answers = [
        subset
        for subset in (solution.members, start)
        if subset and objective.feasible(objective.row(subset)[None])[0]
    ]
    members = max(answers, key=levels.worth, default=[])
    value = levels.worth(members)
    # without an answer of the solver only the worth of all levels is certain
    bound = max(value, solution.bound) if solution.members is not None else levels.max_worth

    def worth(sets: Sets) -> Int64[np.ndarray, " n"]:
        """Worth of the levels that each set (row of booleans) reaches."""
        return np.array([levels.worth(np.flatnonzero(row).tolist()) for row in sets], np.int64)

    progress.settle(improve_among_equals(progress, members, worth))
    share = value / GAIN_UNITS
    max_share = bound / GAIN_UNITS
    note = (
        f"{share:.4f} of the objects are expected to be hit, in steps, and no set has more than "
        f"{max_share:.4f}"
    )
    return progress.result(
        "hits", Certificate.from_bound(share, bound=max_share, note=note, measure="hits")
    )
