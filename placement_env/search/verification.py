"""What a search found on a cheap fidelity, scored again with a dear one beside the sets that differ in one sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from placement_env.fidelity.protocol import ByFrames
from placement_env.objective import Objective, Score
from placement_env.racing import Verified, verify
from placement_env.search.result import Found
from toolkit.arrays import Bool, Int64


def verified(
    cheap: Objective, dear: Objective, subset: Int64[np.ndarray, " k"], *, best: int = 5, entrants: int = 27
) -> Verified:
    """The `best` of a set and its feasible neighbours, ranked by the dear reward.

    The cheap fidelity errs by more than what one sensor's pose changes, so that a neighbour may be the better set: as
    many as `entrants`, the best by the cheap reward, race by the dear one where that can score some frames alone, which
    takes little longer than scoring `best` sets on all of them.
    Raises ValueError where the two objectives choose from different candidates.
    """
    if cheap.candidates.digest() != dear.candidates.digest():
        raise ValueError("both objectives must choose from the same candidates: make the second from the first's")
    sets = neighbours(subset, len(cheap.candidates))
    sets = sets[cheap.feasible(sets)] if cheap.feasible(sets[:1])[0] else sets[:1]
    if isinstance(dear.scored_by, ByFrames):
        sets = sets[np.argsort(-cheap.scores(sets).reward, kind="stable")[:entrants]]
        sets = sets[dear.race(sets, keep=best).winners]
    return verify(lambda s: cheap.scores(s).reward, lambda s: dear.scores(s).reward, sets, best=best)


def rescored(dear: Objective, found: Found) -> Score:
    """What was found, by another objective of the same candidates; moved sensors (`Found.sensors`) where they stand.

    Raises ValueError where they were moved and the objective was made from parts, or they may not be built there.
    """
    if not found.sensors:
        return dear.score(found.best.subset)
    from placement_env.search.cmaes import placing

    if dear.preparation is None:
        raise ValueError("moved sensors need an objective made from a site: Objective(site, ...)")
    (score,) = placing(dear.preparation, dear.fidelity, dear.weights)([found.sensors])
    if score is None:
        raise ValueError("the moved sensors may not be built: one sends more than its link carries here")
    return replace(score, subset=found.best.subset)


def neighbours(subset: Int64[np.ndarray, " k"], candidates: int) -> Bool[np.ndarray, "n C"]:
    """A set, and those that have another candidate in the place of one of its members.

    >>> neighbours(np.array([0]), 3).astype(int).tolist()
    [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    """
    row = np.zeros(candidates, np.bool_)
    row[subset] = True
    others = np.flatnonzero(~row)
    sets = np.repeat(row[None], 1 + len(subset) * len(others), axis=0)
    for place, member in enumerate(subset):
        swaps = 1 + place * len(others) + np.arange(len(others))
        sets[swaps, member] = False
        sets[swaps, others] = True
    return sets


def verified_best(cheap: Objective, exact: Objective, found: Found) -> tuple[Score, int]:
    """The best by an exact objective of what a search on a cheap one found and its neighbours, and of how many sets.

    Sensors that were moved have no neighbours: they are scored where they stand, as one set.
    """
    if found.sensors:
        return rescored(exact, found), 1
    ranking = verified(cheap, exact, np.array(found.best.subset))
    return exact.score(np.flatnonzero(ranking.sets[0])), len(ranking.sets)
