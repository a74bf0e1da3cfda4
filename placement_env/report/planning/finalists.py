"""Finalists: the sensor sets that are worth a detector's judgement, found by several searches with a fast fidelity.

For every number of sensors up to the budget: greedy and swap by the objective's reward, the best coverage by CP-SAT
where OR-Tools is installed, every set where the candidates are few, and the best neighbours of these. Where prices
differ, a thrifty search goes for sets that cost less.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np

from placement_env.objective import Objective, Stages, Weights
from placement_env.search import greedy, swap
from placement_env.search.exact import cpsat, exhaustive
from placement_env.search.result import Result
from placement_env.search.verification import neighbours
from toolkit.arrays import Bool, Float64
from toolkit.runtime.cache import Arrays, Cache, key_of
from toolkit.runtime.code_digest import code_digest

ENTRANTS = 9  # of each number of sensors, beside the searches' own answers
SWAP_EVALUATIONS = 60_000  # sets that swap may score for each number of sensors
EXHAUSTIVE_SETS = 20_000  # that are all scored, at most
SOLVING = 10.0  # s of CP-SAT's deterministic time for each number of sensors
THRIFT = 0.02  # AP that the mean price of a candidate costs in the thrifty search
NEIGHBOURS_AT_ONCE = 50_000


@dataclass(frozen=True, eq=False)
class Finalists:
    """sets: rows of booleans, all feasible and different, small ones first; predicted: AP by the fidelity of the
    searches; searches: those that answered with each; considered: how many sets were scored in all."""

    sets: Bool[np.ndarray, "n C"]
    predicted: Float64[np.ndarray, " n"]
    searches: tuple[tuple[str, ...], ...]
    considered: int

    def arrays(self) -> Arrays:
        """What a cache keeps of them."""
        names = np.array([json.dumps(each) for each in self.searches], np.str_)
        return self.sets, self.predicted, names, np.array([self.considered])

    @staticmethod
    def of(arrays: Arrays) -> Finalists:
        """From what `arrays` gave."""
        sets, predicted, names, considered = arrays
        searches = tuple(tuple(json.loads(str(each))) for each in names)
        return Finalists(sets, predicted, searches, int(considered[0]))


def kept_finalists(
    objective: Objective,
    most: int,
    cache: Cache | None,
    *,
    depends_on: str,
    seed: int = 0,
    progress: Stages | None = None,
) -> Finalists:
    """`finalists`, from the cache where it keeps them. depends_on: digest of what the objective's figures depend on
    beside its candidates and settings, such as the traffic."""
    key = key_of("finalists", code_digest(__name__), depends_on, objective.provenance, objective.most_price, most, seed)
    kept = None if cache is None else cache.get([key])[0]
    if kept is not None:
        return Finalists.of(kept)
    found = finalists(objective, most, seed=seed, progress=progress)
    if cache is not None:
        cache.put({key: found.arrays()})
    return found


def finalists(
    objective: Objective, most: int, *, seed: int = 0, entrants: int = ENTRANTS, progress: Stages | None = None
) -> Finalists:
    """The finalists of 1 to `most` sensors; none where nothing may be built. entrants: neighbours of each size."""
    answers: dict[bytes, list[str]] = {}
    rows: dict[bytes, Bool[np.ndarray, " C"]] = {}
    considered = 0
    for size in range(1, most + 1):
        own: list[bytes] = []
        for name, result in _searches(objective, size, most, seed):
            considered += result.evaluations
            row = objective.row(list(result.best.subset))
            if row.any() and objective.feasible(row[None])[0]:
                key = np.packbits(row).tobytes()
                rows[key] = row
                answers.setdefault(key, []).append(name)
                own.append(key)
        if not own:
            break
        near, count = _neighbours(objective, np.array([rows[key] for key in dict.fromkeys(own)]), entrants)
        considered += count
        for row in near:
            rows.setdefault(np.packbits(row).tobytes(), row)
        if progress is not None:
            progress("searching", size, most)
    if not rows:
        return Finalists(np.zeros((0, len(objective.candidates)), bool), np.zeros(0), (), considered)
    keys = list(rows)
    sets = np.array([rows[key] for key in keys])
    order = np.argsort(sets.sum(axis=1), kind="stable")
    searches = tuple(tuple(dict.fromkeys(answers.get(keys[i], ()))) for i in order)
    return Finalists(sets[order], objective.scores(sets[order]).ap, searches, considered)


def _searches(objective: Objective, size: int, most: int, seed: int) -> Iterator[tuple[str, Result]]:
    """The answers of the searches for at most `size` sensors."""
    few = len(objective.candidates) <= exhaustive.LARGEST
    if few and sum(math.comb(len(objective.candidates), k) for k in range(1, most + 1)) <= EXHAUSTIVE_SETS:
        yield "exhaustive", exhaustive.search(objective, size)
    yield "greedy", greedy.search(objective, size)
    yield "swap", swap.search(objective, size, seed=seed, starts=swap.STARTS, evaluations=SWAP_EVALUATIONS)
    if objective.visibility is not None and find_spec("ortools"):
        yield "cpsat", cpsat.search(objective, size, seed=seed, seconds=600.0, effort=SOLVING)
    prices = objective.candidates.prices
    if np.ptp(prices) > 0:
        thrifty = objective.weighed(Weights(price=THRIFT / float(prices.mean())))
        yield "thrifty swap", swap.search(thrifty, size, seed=seed, starts=swap.STARTS, evaluations=SWAP_EVALUATIONS)


def _neighbours(
    objective: Objective, answers: Bool[np.ndarray, "n C"], entrants: int
) -> tuple[Bool[np.ndarray, "k C"], int]:
    """The best feasible neighbours of some answers, at most one for each change of mount, and how many were scored."""
    best: list[tuple[float, Bool[np.ndarray, " C"]]] = []
    considered = 0
    for answer in answers:
        sets = neighbours(np.flatnonzero(answer), len(answer))[1:][:NEIGHBOURS_AT_ONCE]
        sets = sets[objective.feasible(sets)]
        considered += len(sets)
        if not len(sets):
            continue
        reward = objective.scores(sets).reward
        order = np.argsort(-reward, kind="stable")[: 4 * entrants]
        best += [(float(reward[i]), sets[i]) for i in order]
    best.sort(key=lambda pair: -pair[0])
    kept: dict[bytes, Bool[np.ndarray, " C"]] = {}
    for _, row in best:
        kept.setdefault(np.packbits(objective.candidates.per_mount(row[None])[0] > 0).tobytes(), row)
        if len(kept) == entrants:
            break
    return np.array(list(kept.values()), np.bool_).reshape(len(kept), answers.shape[1]), considered
