"""Greedy search: add the most useful sensor each time. Candidates are scored in full, or they race.

A search goes on to `budget` sensors even if one lowers the score, since a pair may gain what one
sensor does not. It answers with the best set on the way. If the price is limited and prices differ,
it also runs by gain per price. The better of both, with the best single sensor among its first
steps, cannot be fooled by one expensive sensor that uses up the money (Khuller, Moss, Naor 1999;
Leskovec et al. 2007).

A monotone submodular objective (coverage, not AP, and no cost weights) guarantees a share of the
optimum: 1 - 1/e if every candidate has a separate mount (Nemhauser, Wolsey, Fisher 1978), 1/2 if
poses share mounts, a matroid (Fisher, Nemhauser, Wolsey 1978), and nothing if links are shared.
A bound from the data is usually far tighter ("online bound", Leskovec et al., KDD 2007): for the
answer S and any feasible T of at most k sensors f(T) <= f(S) + sum over t in T of
[f(S + t) - f(S)]. So no T has more than f(S) and the k largest gains; each mount contributes as
many as it carries.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from placement_env.objective import Objective
from placement_env.search.progress import Progress, add_each, as_rows
from placement_env.search.result import Certificate, Result
from toolkit.arrays import Float64

GAIN_TOLERANCE = 1e-6  # a gain that rises by no more is rounding: figures are sums of float32


class Growth(NamedTuple):
    """Greedy's way from a set to larger ones.

    Attributes:
        members: Candidates (indices) of the last set, in the order in which they were added.
        rise: Largest observed rise of a gain in reward, 0 if no gain rose.
    """

    members: list[int]
    rise: float


def search(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    submodular: bool | None = None,
) -> Result:
    """Best set on greedy's way; the first of equal candidates is taken, `seed` is not used.

    A submodular objective gives the answer a bound as certificate, unless a gain grew during the
    search. The bound takes as many more scored sets as there are candidates.

    Args:
        objective: Objective to maximise.
        budget: Largest number of sensors.
        seed: Not used; all searches have it.
        seconds: Time limit, None for none.
        evaluations: Most sets to score, None for no limit.
        submodular: True if a custom fidelity is known to be monotone submodular, None to check for
            coverage by one view."""
    progress = Progress(objective, budget, seconds, evaluations)
    members, rise = grow(progress)
    prices = objective.candidates.prices
    if math.isfinite(objective.most_price) and np.ptp(prices) > 0:
        grow(progress, prices)  # `progress` keeps the best set of both
    if submodular is None:
        submodular = is_submodular(objective)
    if submodular:
        ratio = guarantee(objective) if len(members) == budget else 0.0
        certificate = certify(progress, members, ratio, rise)
    elif rise > GAIN_TOLERANCE:
        growth = f"gains grew by up to {rise:.2g} as sensors joined"
        certificate = progress.unknown(f"{growth}: not submodular, nothing is promised")
    else:
        certificate = progress.unknown(
            "greedy promises nothing unless the objective is submodular, and AP is not"
        )
    return progress.result("greedy", certificate)


def grow(
    progress: Progress,
    prices: Float64[np.ndarray, " candidates"] | None = None,
    *,
    start: Sequence[int] = (),
) -> Growth:
    """Add the candidate with the greatest gain again and again, as far as the limits allow.

    A gain is the reward that a candidate adds to the set so far. It rises if the candidate adds
    more to a larger set than to a smaller one, which no submodular objective allows.

    Args:
        progress: Scores sets and keeps the best one, which may be smaller than the last.
        prices: Price of each candidate, to take the greatest gain per price; None for the greatest
            gain.
        start: Candidates (indices) that are in the set from the start.
    """
    members = list(start)
    reward = 0.0  # reward of the set so far
    rise = 0.0
    last_gains = np.full(progress.size, np.inf)  # gain of each candidate when last scored
    while len(members) < progress.budget:
        options = np.flatnonzero(progress.objective.next_allowed(members))  # may join the set
        rewards = progress.rewards(add_each(members, options, progress.size))  # with each option
        is_scored = np.isfinite(rewards)  # False beyond the limits
        if not is_scored.any():
            break
        scored_options = options[is_scored]
        rise = max(rise, float((rewards[is_scored] - reward - last_gains[scored_options]).max()))
        last_gains[scored_options] = rewards[is_scored] - reward
        priorities = rewards
        if prices is not None:  # 1e-300: no division by 0 for a candidate that costs nothing
            priorities = (rewards - reward) / np.maximum(prices[options], 1e-300)
        best = int(priorities.argmax())
        members.append(int(options[best]))
        reward = float(rewards[best])
    return Growth(members, rise)


def search_by_races(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
) -> Result:
    """Set that grows by one sensor at a time, the winner of a race, for the slow detector.

    In each step the possible next sets are scored on more and more frames, and bad ones drop out
    (`Objective.race`). budget: greatest number of sensors; seconds, evaluations: limits, None
    without, which are checked between races; evaluations count sets on all frames, rounded up.
    Raises ValueError for a fidelity that cannot score some of the frames.
    """
    progress = Progress(objective, budget, seconds, evaluations)
    members: list[int] = []
    while len(members) < budget and not progress.spent:
        options = np.flatnonzero(objective.next_allowed(members))  # candidates that may join
        if not len(options):
            break
        sets = add_each(members, options, progress.size)
        race = objective.race(sets, seed=seed)
        winner = int(race.winners[0])
        # sets that could be scored on all frames with the effort of the race, less the winner,
        # which the next line scores on all frames and counts
        progress.limits.count += math.ceil(len(sets) * race.spent / race.full) - 1
        progress.rewards(sets[winner][None])  # `progress` keeps it if it is the best so far
        members.append(int(options[winner]))
    return progress.result(
        "raced greedy", progress.unknown("greedy promises nothing for AP, and a race may miss")
    )


def is_submodular(objective: Objective) -> bool:
    """True if AP is known to be monotone submodular: coverage by one view, of the mean of
    classes."""
    is_sum = len(objective.classes.names) == 1 or objective.classes.combine == "mean"
    return (
        is_sum
        and objective.fidelity == "coverage"
        and getattr(objective.scored_by, "views", None) == 1
    )


def guarantee(objective: Objective) -> float:
    """Share of the optimum that greedy reaches for monotone submodular objectives without costs.

    1 - 1/e if every allowed candidate has a separate mount, 1/2 if candidates share mounts, 0 if
    they share links or if poles must carry a sensor."""
    if len(objective.kept):
        return 0.0
    mount = objective.candidates.mount[objective.allowed([])]
    if not objective.candidates.has_shared_mounts and len(np.unique(mount)) == len(mount):
        return 1 - 1 / np.e
    return 0.0 if objective.shared_links is not None else 0.5


def online_bound(progress: Progress, members: list[int]) -> float:
    """Upper bound on the AP and reward of any feasible set, if AP is monotone submodular.

    It is the AP of `members` plus the largest gains of `budget` further candidates; each mount
    gives as many as it carries (Leskovec et al. 2007). Infinite if the limits stop it.

    members: greedy's set; any set gives a bound."""
    candidates = progress.objective.candidates
    options = np.flatnonzero(progress.objective.allowed([]))
    members_row = as_rows([members], progress.size)
    subsets = np.vstack([members_row, add_each(members, options, progress.size)])
    ap = progress.figures(subsets).ap
    if np.isnan(ap).any():
        return np.inf
    members_ap = ap[0]
    gains = np.maximum(ap[1:] - members_ap, 0.0)
    mount = candidates.mount[options]  # index of the mount of each option
    largest_gains = [np.zeros(1)]  # as many as each mount carries; 0 without options
    for mount_number in np.unique(mount):
        descending = np.sort(gains[mount == mount_number])[::-1]
        largest_gains.append(descending[: candidates.places[mount_number]])
    best_gains = np.sort(np.concatenate(largest_gains))[::-1][: progress.budget]
    return float(members_ap + best_gains.sum())


def certify(progress: Progress, members: list[int], ratio: float, rise: float) -> Certificate:
    """Greedy's certificate for a monotone submodular objective.

    members: greedy's set, from which the bound is computed; ratio: guaranteed share of the optimum,
    void under cost weights; rise: largest observed rise of a gain, which disproves submodularity.
    """
    weights = progress.objective.weights
    has_costs = weights.comm > 0 or weights.price > 0
    # With costs a gain in reward may rise even if AP is submodular, such as for a second sensor on
    # a mount that is paid already. Then no share is promised, but the bound, which is on AP, holds.
    if rise > GAIN_TOLERANCE and not has_costs:
        return progress.unknown(
            f"said to be submodular, but a gain grew by {rise:.2g} as other sensors joined"
        )
    sure_ratio = 0.0 if has_costs else ratio
    promise = f", and at least {sure_ratio:.3f} of the optimum" if sure_ratio else ""
    note = (
        "if AP is monotone submodular here, as coverage is: the online bound of Leskovec et al. "
        f"2007{promise}"
    )
    return Certificate(
        kind="bound",
        value=progress.reward,
        bound=online_bound(progress, members),
        ratio=sure_ratio,
        note=note,
    )
