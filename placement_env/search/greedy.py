"""Greedy search: one sensor after another, each the one that adds most; plain, lazy, stochastic and raced.

With a monotone submodular objective (coverage, no cost weights) the answer has a guaranteed share of the optimum, see
`placement_env.search.exact.submodular`; AP is not submodular. `submodular` None asks whether the fidelity is coverage
by one view; say True of a fidelity of your own that you know to be monotone submodular. They go on to `budget` sensors
even where one loses, since two may gain what one does not, and answer with the best set on the way.
"""

from __future__ import annotations

import heapq
import math

import numpy as np

from placement_env.objective import Objective
from placement_env.search.exact import submodular as theory
from placement_env.search.progress import Progress, rows_of, with_each
from placement_env.search.result import Certificate, Result

DECIMALS = 12  # of gains that are compared with each other: what lies behind is rounding


def search(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    submodular: bool | None = None,
) -> Result:
    """Plain greedy: about budget × C sets, scored thousands at once.

    A submodular objective gets a certificate, for C more sets, unless a gain was seen to grow. `seed` is not used: of
    equal candidates the first is taken.
    """
    progress = Progress(objective, budget, seconds, evaluations)
    chosen, rise = grow(progress)
    return progress.result("greedy", _certificate(progress, chosen, submodular, theory.guarantee(objective), rise))


def grow(progress: Progress) -> tuple[list[int], float]:
    """Greedy's set of `progress.budget` sensors, fewer where no more fit or a limit came first, in the order they were
    taken; and by how much the gain of any candidate was seen to grow as others joined."""
    chosen: list[int] = []
    reward, rise = 0.0, 0.0
    gains = np.full(progress.size, np.inf)
    while len(chosen) < progress.budget:
        options = np.flatnonzero(progress.objective.allowed(chosen))
        rewards = progress.rewards(with_each(chosen, options, progress.size))
        if not np.isfinite(rewards).any():
            break
        scored = np.isfinite(rewards)
        rise = max(rise, float((rewards[scored] - reward - gains[options[scored]]).max()))
        gains[options[scored]] = rewards[scored] - reward
        best = int(rewards.argmax())
        chosen.append(int(options[best]))
        reward = float(rewards[best])
    return chosen, rise


def lazy(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    submodular: bool | None = None,
    batch: int = 1,
) -> Result:
    """Greedy that takes a candidate's last known gain for an upper bound of its gain now and scores only the leaders
    (Minoux 1978; CELF). An answer as good as that of `search` for far fewer sets where the objective is submodular;
    else an answer without promise, and the certificate says so where a gain was seen to grow.

    batch: how many of the leaders are scored at once. At the end all candidates are scored on top of the answer, as
    far as the limits go, and compared with the bounds that were believed.
    """
    progress = Progress(objective, budget, seconds, evaluations)
    bound = np.full(progress.size, -np.inf)
    options = np.flatnonzero(objective.allowed([]))
    bound[options] = np.round(progress.rewards(np.eye(progress.size, dtype=bool)[options]), DECIMALS)
    complete = bool(np.isfinite(bound[options]).all())
    queue = [(-float(bound[c]), int(c)) for c in options if np.isfinite(bound[c])]
    heapq.heapify(queue)
    chosen: list[int] = []
    reward, rise = 0.0, 0.0
    while len(chosen) < budget and queue:
        free = objective.allowed(chosen)
        queue = [entry for entry in queue if free[entry[1]]]
        heapq.heapify(queue)
        best, seen = _leader(progress, chosen, reward, queue, bound, batch=batch)
        rise = max(rise, seen)
        if best < 0:
            complete = False
            break
        chosen.append(best)
        reward += float(bound[best])
    if complete:
        rise = max(rise, _rise_at_end(progress, chosen, bound))
    return progress.result("lazy greedy", _certificate(progress, chosen, submodular, theory.guarantee(objective), rise))


def stochastic(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    submodular: bool | None = None,
    epsilon: float = 0.1,
) -> Result:
    """Greedy over a fresh random sample of C/budget · ln(1/epsilon) candidates for each sensor, so C · ln(1/epsilon)
    sets in all (Mirzasoleiman et al., AAAI 2015).

    On a monotone submodular objective with every candidate on its own mount it has, in expectation over seeds,
    (1 - 1/e - epsilon) of the optimum. Raises ValueError unless 0 < epsilon < 1.
    """
    if not 0 < epsilon < 1:
        raise ValueError(f"epsilon must lie between 0 and 1, got {epsilon}")
    progress = Progress(objective, budget, seconds, evaluations)
    rng = np.random.default_rng(seed)
    sample = math.ceil(progress.size / budget * math.log(1 / epsilon))
    chosen: list[int] = []
    while len(chosen) < budget:
        options = np.flatnonzero(objective.allowed(chosen))
        options = np.sort(rng.choice(options, min(sample, len(options)), replace=False))
        rewards = progress.rewards(with_each(chosen, options, progress.size))
        if not np.isfinite(rewards).any():
            break
        chosen.append(int(options[rewards.argmax()]))
    alone = theory.guarantee(objective) > 0.5
    ratio = max(0.0, 1 - 1 / math.e - epsilon) if alone else 0.0
    return progress.result("stochastic greedy", _certificate(progress, chosen, submodular, ratio, 0.0))


def raced(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
) -> Result:
    """Greedy whose candidates race for each place (`Objective.race`): the weak ones are dropped after few frames.

    For the fidelity of the detector, where a frame takes long. Evaluations are counted in sets on all frames, rounded
    up in each race; the limits are looked at between two races. Raises ValueError for a fidelity that cannot score some
    frames alone.
    """
    progress = Progress(objective, budget, seconds, evaluations)
    chosen: list[int] = []
    while len(chosen) < budget and not progress.spent:
        options = np.flatnonzero(objective.allowed(chosen))
        if not len(options):
            break
        sets = with_each(chosen, options, progress.size)
        ran = objective.race(sets, seed=seed)
        winner = int(ran.winners[0])
        progress.limits.count += math.ceil(len(sets) * ran.spent / ran.full) - 1
        progress.rewards(sets[winner][None])
        chosen.append(int(options[winner]))
    return progress.result("raced greedy", progress.unknown("greedy promises nothing for AP, and a race may miss"))


def _certificate(
    progress: Progress, chosen: list[int], submodular: bool | None, ratio: float, rise: float
) -> Certificate:
    if theory.is_submodular(progress.objective) if submodular is None else submodular:
        return theory.certificate(progress, chosen, ratio if len(chosen) == progress.budget else 0.0, rise)
    if rise > theory.TOLERANCE:
        return progress.unknown(
            f"gains grew by up to {rise:.2g} as sensors joined: not submodular, nothing is promised"
        )
    return progress.unknown("greedy promises nothing unless the objective is submodular, and AP is not")


def _leader(
    progress: Progress,
    chosen: list[int],
    reward: float,
    queue: list[tuple[float, int]],
    bound: np.ndarray,
    *,
    batch: int,
) -> tuple[int, float]:
    """The candidate that adds most to `chosen`, removed from the queue, or -1 where the limits end it; and how far a
    fresh gain was above what was known before. `bound` gets the fresh gains."""
    fresh: set[int] = set() if chosen else {candidate for _, candidate in queue}
    rise = 0.0
    while queue:
        if queue[0][1] in fresh:
            return heapq.heappop(queue)[1], rise
        stale: list[int] = []
        while queue and len(stale) < batch and queue[0][1] not in fresh:
            stale.append(heapq.heappop(queue)[1])
        rewards = progress.rewards(with_each(chosen, np.array(stale), progress.size))
        if not np.isfinite(rewards).all():
            break
        gains = np.round(rewards - reward, DECIMALS)
        rise = max(rise, float((gains - bound[stale]).max()))
        bound[stale] = gains
        fresh.update(stale)
        for candidate, gain in zip(stale, gains.tolist(), strict=True):
            heapq.heappush(queue, (-gain, candidate))
    return -1, rise


def _rise_at_end(progress: Progress, chosen: list[int], bound: np.ndarray) -> float:
    """How far the gain of any free candidate on top of the answer is above the bound that was believed."""
    options = np.flatnonzero(progress.objective.allowed(chosen))
    rewards = progress.rewards(np.vstack([rows_of([chosen], progress.size), with_each(chosen, options, progress.size)]))
    rises = rewards[1:] - rewards[0] - bound[options]
    return float(rises[np.isfinite(rises)].max(initial=0.0))
