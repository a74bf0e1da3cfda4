"""Simulated annealing: many chains change one sensor at a time, and accept a loss the more seldom the colder it gets.

A change adds, drops or replaces a sensor; half of the replacements turn a sensor on its own mount. A chain accepts a
change of the reward by d < 0 with probability exp(d / temperature) (Metropolis), and the temperature falls
geometrically with the share of the limit that is used. Each step scores one proposal of every chain at once.
"""

from __future__ import annotations

import numpy as np

from placement_env.objective import Objective
from placement_env.search.checkpoint import NOWHERE, Checkpoint, KeptState
from placement_env.search.neighbourhood import Neighbourhood
from placement_env.search.progress import DEFAULT_EVALUATIONS, Progress, rows_of
from placement_env.search.result import Result


def search(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    chains: int = 32,
    hot: float = 0.05,
    cold: float = 0.0005,
    checkpoint: Checkpoint = NOWHERE,
) -> Result:
    """The best set that any of the chains met. Without a limit 20 000 sets are scored.

    hot, cold: temperature at the start and at the end, in units of the reward; checkpoint: where the state of the
    search is kept. The same seed and `evaluations` give
    the same answer; a limit in seconds makes the cooling follow the clock. Raises ValueError unless hot >= cold > 0 and
    there is a chain.
    """
    if not hot >= cold > 0 or chains < 1:
        raise ValueError(f"need hot >= cold > 0 and at least 1 chain, got {hot}, {cold} and {chains}")
    if seconds is None and evaluations is None:
        evaluations = DEFAULT_EVALUATIONS
    progress = Progress(objective, budget, seconds, evaluations)
    neighbourhood, rng = Neighbourhood(objective, budget), np.random.default_rng(seed)
    note = "simulated annealing proves nothing"
    if not neighbourhood.free.size:
        return progress.result("annealing", progress.unknown(note))
    kept = checkpoint.load()
    if kept is None:
        sets = [neighbourhood.sample(rng) for _ in range(chains)]
        rewards = progress.rewards(rows_of(sets, progress.size))
    else:
        progress.resume(kept["progress"])
        rng.bit_generator.state, sets, rewards = kept["rng"], kept["sets"], kept["rewards"]

    def state() -> KeptState:
        return {"progress": progress.state(), "rng": rng.bit_generator.state, "sets": sets, "rewards": rewards}

    while not progress.spent:
        temperature = hot * (cold / hot) ** progress.limits.share
        proposed = [neighbourhood.neighbour(chosen, rng) for chosen in sets]
        fresh = progress.rewards(rows_of(proposed, progress.size))
        accepted = fresh - rewards >= temperature * np.log(1 - rng.random(chains))
        sets = [new if yes else old for new, old, yes in zip(proposed, sets, accepted, strict=True)]
        rewards = np.where(accepted, fresh, rewards)
        checkpoint.offer(state)
    return progress.result("annealing", progress.unknown(note))
