"""Guarantees of greedy for monotone submodular objectives.

Coverage is one; AP is not. With every candidate on its own mount greedy reaches 1 - 1/e of the optimum (Nemhauser,
Wolsey, Fisher 1978). Where poses share mounts, "as many as a mount carries and at most k" is a matroid and greedy is
only sure of 1/2 (Fisher, Nemhauser, Wolsey 1978). A bound from the data is usually far tighter (Leskovec et al., KDD
2007, "online bound"): for the answer S and any feasible T of at most k sensors f(T) <= f(S) + sum over t in T of [f(S +
t) - f(S)]. So no T has more than f(S) and the k largest gains, of which each mount gives as many as it carries. Shared
links do not form a matroid: greedy then has no guarantee, but the bound holds.
"""

from __future__ import annotations

import numpy as np

from placement_env.objective import Objective
from placement_env.search.progress import Progress, add_each, as_rows
from placement_env.search.result import Certificate

TOLERANCE = 1e-6  # a gain that rises by no more is rounding: figures are sums of float32


def is_submodular(objective: Objective) -> bool:
    """True where AP is known to be monotone submodular: coverage by at least one view, of the mean of classes."""
    additive = len(objective.classes.names) == 1 or objective.classes.combine == "mean"
    return additive and objective.fidelity == "coverage" and getattr(objective.scored_by, "views", None) == 1


def guarantee(objective: Objective) -> float:
    """Share of the optimum that greedy reaches for monotone submodular objectives without cost weights."""
    mount = objective.candidates.mount[objective.allowed([])]
    alone = not objective.candidates.several and len(np.unique(mount)) == len(mount)
    return 1 - 1 / np.e if alone else 0.0 if objective.shared_links is not None else 0.5


def online_bound(progress: Progress, chosen: list[int]) -> float:
    """Upper bound on AP and reward of any feasible set, if AP is monotone submodular here.

    It is inf where the limits leave it unknown. Scores every candidate that may stand.
    """
    candidates = progress.objective.candidates
    options = np.flatnonzero(progress.objective.allowed([]))
    subsets = np.vstack([as_rows([chosen], progress.size), add_each(chosen, options, progress.size)])
    ap = progress.figures(subsets).ap
    if np.isnan(ap).any():
        return np.inf
    gains, mount = np.maximum(ap[1:] - ap[0], 0.0), candidates.mount[options]
    each = [np.sort(gains[mount == m])[::-1][: candidates.places[m]] for m in np.unique(mount)]
    return float(ap[0] + np.sort(np.concatenate([*each, np.zeros(1)]))[::-1][: progress.budget].sum())


def certificate(progress: Progress, chosen: list[int], ratio: float, rise: float) -> Certificate:
    """Greedy's certificate for a monotone submodular objective.

    ratio: the guaranteed share of the optimum, which cost weights void; rise: largest observed growth of a gain.
    """
    costs = progress.objective.weights.comm > 0 or progress.objective.weights.price > 0
    if rise > TOLERANCE and not costs:
        return progress.unknown(f"said to be submodular, but a gain grew by {rise:.2g} as other sensors joined")
    ratio = 0.0 if costs else ratio
    promise = f", and at least {ratio:.3f} of the optimum" if ratio else ""
    note = f"if AP is monotone submodular here, as coverage is: the online bound of Leskovec et al. 2007{promise}"
    return Certificate("bound", progress.reward, online_bound(progress, chosen), ratio, note)
