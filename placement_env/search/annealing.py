"""Simulated annealing: many chains change one sensor at a time, and accept a loss the more seldom the colder it gets.

A change adds, drops or replaces a sensor; half of the replacements turn a sensor on its own mount. A chain accepts a
change of the reward by d < 0 with probability exp(d / temperature) (Metropolis), and the temperature falls
geometrically with the share of the limit that is used. Each step scores one proposal of every chain at once.
"""

from __future__ import annotations

import numpy as np

from placement_env.objective import Objective
from placement_env.search.found import Found
from placement_env.search.progress import Progress, random_set, rows_of

DROP = 0.05  # share of proposals that drop a sensor
SETS = 20_000  # scored where no limit is given


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
) -> Found:
    """The best set that any of the chains met. Without a limit 20 000 sets are scored.

    hot, cold: temperature at the start and at the end, in units of the reward. The same seed and `evaluations` give
    the same answer; a limit in seconds makes the cooling follow the clock. Raises ValueError unless hot >= cold > 0 and
    there is a chain.
    """
    if not hot >= cold > 0 or chains < 1:
        raise ValueError(f"need hot >= cold > 0 and at least 1 chain, got {hot}, {cold} and {chains}")
    if seconds is None and evaluations is None:
        evaluations = SETS
    progress = Progress(objective, budget, seconds, evaluations)
    rng = np.random.default_rng(seed)
    note = "simulated annealing proves nothing"
    movable = np.flatnonzero(objective.allowed([]))
    if not movable.size:
        return progress.found("annealing", progress.unknown(note))
    mount = objective.candidates.mount
    neighbours = {int(m): movable[mount[movable] == m] for m in np.unique(mount[movable])}
    sets = [random_set(objective, budget, rng) for _ in range(chains)]
    rewards = progress.rewards(rows_of(sets, progress.size))
    while not progress.spent:
        temperature = hot * (cold / hot) ** progress.limits.share
        proposed = [_change(chosen, budget, mount, movable, neighbours, rng) for chosen in sets]
        fresh = progress.rewards(rows_of(proposed, progress.size))
        accepted = fresh - rewards >= temperature * np.log(1 - rng.random(chains))
        sets = [new if yes else old for new, old, yes in zip(proposed, sets, accepted, strict=True)]
        rewards = np.where(accepted, fresh, rewards)
    return progress.found("annealing", progress.unknown(note))


def _change(
    chosen: list[int],
    budget: int,
    mount: np.ndarray,
    movable: np.ndarray,
    neighbours: dict[int, np.ndarray],
    rng: np.random.Generator,
) -> list[int]:
    """A feasible set that differs in one sensor, or the same set where the draw was of what is there already."""
    if chosen and rng.random() < DROP:
        gone = int(rng.integers(len(chosen)))
        return chosen[:gone] + chosen[gone + 1 :]
    if chosen and rng.random() < 0.5:
        new = int(rng.choice(neighbours[int(mount[chosen[int(rng.integers(len(chosen)))]])]))
    else:
        new = int(movable[int(rng.integers(len(movable)))])
    kept = [c for c in chosen if mount[c] != mount[new]]
    if len(kept) == budget:
        kept.pop(int(rng.integers(budget)))
    return [*kept, new]
