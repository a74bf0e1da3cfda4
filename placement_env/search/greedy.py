"""Greedy search: add the most useful sensor each time. Candidates are scored in full, or they race.

With a monotone submodular objective (coverage, no cost weights) the answer
has a guaranteed share of the optimum, see `placement_env.search.submodular`; AP is not submodular. A search goes on to
`budget` sensors even where one loses, since a pair may gain where a single sensor does not. It answers with the best
set on the way.
"""

from __future__ import annotations

import math

import numpy as np

from placement_env.objective import Objective
from placement_env.search import submodular as theory
from placement_env.search.progress import Progress, add_each
from placement_env.search.result import Result


def search(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    submodular: bool | None = None,
) -> Result:
    """Best set on greedy's way.

    It scores about budget × C sets, thousands at once. submodular: True for a custom fidelity that is known to be
    monotone submodular, None to check for coverage by one view. The answer then has a certificate, for C more sets,
    unless a gain was seen to grow. `seed` is not used: of equal candidates the first is taken.
    """
    progress = Progress(objective, budget, seconds, evaluations)
    chosen, rise = grow(progress)
    if theory.is_submodular(objective) if submodular is None else submodular:
        ratio = theory.guarantee(objective) if len(chosen) == budget else 0.0
        known = theory.certificate(progress, chosen, ratio, rise)
    elif rise > theory.TOLERANCE:
        known = progress.unknown(
            f"gains grew by up to {rise:.2g} as sensors joined: not submodular, nothing is promised"
        )
    else:
        known = progress.unknown("greedy promises nothing unless the objective is submodular, and AP is not")
    return progress.result("greedy", known)


def grow(progress: Progress) -> tuple[list[int], float]:
    """Greedy's candidates in order, and the largest growth of any gain as others joined.

    There are `progress.budget` candidates, fewer where no more fit or a limit came first.
    """
    chosen: list[int] = []
    reward, rise = 0.0, 0.0
    gains = np.full(progress.size, np.inf)
    while len(chosen) < progress.budget:
        options = np.flatnonzero(progress.objective.allowed(chosen))
        rewards = progress.rewards(add_each(chosen, options, progress.size))
        if not (scored := np.isfinite(rewards)).any():
            break
        rise = max(rise, float((rewards[scored] - reward - gains[options[scored]]).max()))
        gains[options[scored]] = rewards[scored] - reward
        best = int(rewards.argmax())
        chosen.append(int(options[best]))
        reward = float(rewards[best])
    return chosen, rise


def raced(
    objective: Objective, budget: int, *, seed: int = 0, seconds: float | None = None, evaluations: int | None = None
) -> Result:
    """Greedy set whose candidates race for each place (`Objective.race`), for the detector, where a frame is slow.

    Evaluations are counted in sets on all frames, rounded up in each race; limits are checked between races. Raises
    ValueError for a fidelity that cannot score a subset of the frames.
    """
    progress = Progress(objective, budget, seconds, evaluations)
    chosen: list[int] = []
    while len(chosen) < budget and not progress.spent:
        options = np.flatnonzero(objective.allowed(chosen))
        if not len(options):
            break
        sets = add_each(chosen, options, progress.size)
        ran = objective.race(sets, seed=seed)
        winner = int(ran.winners[0])
        progress.limits.count += math.ceil(len(sets) * ran.spent / ran.full) - 1
        progress.rewards(sets[winner][None])
        chosen.append(int(options[winner]))
    return progress.result("raced greedy", progress.unknown("greedy promises nothing for AP, and a race may miss"))
