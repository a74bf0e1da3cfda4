"""Entrants: sensor sets worth a detector's judgement.

Several searches with a fast fidelity find them. No fast score is right everywhere, and a search exploits the errors of
its score. So different searches use different scores: greedy and swap the objective, swap perception entropy (Ma, Liu,
Li), CP-SAT coverage where OR-Tools is installed. Every set is tried where candidates are few, and where prices differ a
thrifty search looks for cheaper sets. Neighbours join their answers: the best by the objective, and those that no other
beats in the objective's reward, perception entropy and coverage at once.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np

from placement_env.fidelity.coverage import Coverage
from placement_env.fidelity.published_surrogates import PerceptionEntropy
from placement_env.objective import Objective
from placement_env.search import greedy, swap
from placement_env.search.checkpoint import NOWHERE, Checkpoint, KeptState
from placement_env.search.exact import cpsat, exhaustive
from placement_env.search.result import Result
from placement_env.search.verification import neighbours
from placement_env.setting import Weights
from toolkit.arrays import Bool, Float64
from toolkit.runtime.cache import Arrays, Cache, make_key
from toolkit.runtime.code_digest import code_digest

ENTRANTS = 9  # neighbours for each number of sensors, beside the searches' own answers
SWAP_EVALUATIONS = 60_000  # sets that swap may score for each number of sensors
EXHAUSTIVE_SETS = 20_000  # that are all scored, at most
SOLVING = 10.0  # s of CP-SAT's deterministic time for each number of sensors
THRIFT = 0.02  # AP that the mean price of a candidate costs in the thrifty search
NEIGHBOURS_AT_ONCE = 50_000
FRONT_OF = 400  # best neighbours of an answer by reward, searched for the front


@dataclass(frozen=True, eq=False)
class Entrants:
    """Sets that enter a race.

    sets: rows of booleans, all feasible and different, small ones first; predicted: AP by the fidelity of the searches;
    searches: those that answered with each; considered: number of sets scored in all.
    """

    sets: Bool[np.ndarray, "n C"]
    predicted: Float64[np.ndarray, " n"]
    searches: tuple[tuple[str, ...], ...]
    considered: int

    def arrays(self) -> Arrays:
        """Arrays for a cache."""
        names = np.array([json.dumps(each) for each in self.searches], np.str_)
        return self.sets, self.predicted, names, np.array([self.considered])

    @staticmethod
    def of(arrays: Arrays) -> Entrants:
        """Restore from what `arrays` gave."""
        sets, predicted, names, considered = arrays
        searches = tuple(tuple(json.loads(str(each))) for each in names)
        return Entrants(sets, predicted, searches, int(considered[0]))


@dataclass(frozen=True)
class Effort:
    """Limits of the searches.

    sizes: most sensors of each run of the searches, such as 1, 2, 3; seconds, evaluations: of each search at each size,
    None for its default; neighbours: number that join the answers of each size.
    """

    sizes: tuple[int, ...]
    seconds: float | None = None
    evaluations: int | None = None
    neighbours: int = ENTRANTS


def keep_entrants(
    objective: Objective,
    effort: Effort,
    cache: Cache | None,
    *,
    depends_on: str,
    seed: int = 0,
    checkpoint: Checkpoint = NOWHERE,
) -> Entrants:
    """Entrants, from the cache where possible.

    depends_on: digest of the objective's other inputs besides its candidates and setting, such as traffic.
    """
    asked = (objective.provenance, objective.most_price, vars(effort), seed)
    key = make_key("entrants", code_digest(__name__), depends_on, *asked)
    kept = None if cache is None else cache.get([key])[0]
    if kept is not None:
        return Entrants.of(kept)
    found = entrants(objective, effort, seed=seed, checkpoint=checkpoint)
    if cache is not None:
        cache.put({key: found.arrays()})
    return found


def entrants(objective: Objective, effort: Effort, *, seed: int = 0, checkpoint: Checkpoint = NOWHERE) -> Entrants:
    """Entrants of all sizes.

    Empty where nothing may be built. checkpoint: keeps the answer of each finished search, and the progress of the
    current one.
    """
    ended: KeptState = checkpoint.load() or {}
    answers: dict[bytes, list[str]] = {}
    rows: dict[bytes, Bool[np.ndarray, " C"]] = {}
    considered = 0
    report = objective.run.stage("searching", len(effort.sizes))
    for done, size in enumerate(effort.sizes, 1):
        own: list[bytes] = []
        swapped = _Swapped(size, effort, seed, checkpoint)
        for name, run in _searches(objective, swapped):
            part = f"{size} {name}"
            if part not in ended:
                result = run()
                ended[part] = [list(result.best.subset), result.evaluations]
                checkpoint.save(ended)
            members, scored = ended[part]
            considered += scored
            row = objective.row(members)
            if row.any() and objective.feasible(row[None])[0]:
                key = np.packbits(row).tobytes()
                rows[key] = row
                answers.setdefault(key, []).append(name)
                own.append(key)
        if not own:
            break
        different = np.array([rows[key] for key in dict.fromkeys(own)])
        near, count = _neighbours(objective, different, effort.neighbours)
        considered += count
        for row in near:
            rows.setdefault(np.packbits(row).tobytes(), row)
        if report is not None:
            report(done)
    if not rows:
        none = np.zeros((0, len(objective.candidates)), bool)
        return Entrants(none, np.zeros(0), (), considered)
    keys = list(rows)
    sets = np.array([rows[key] for key in keys])
    order = np.argsort(sets.sum(axis=1), kind="stable")
    searches = tuple(tuple(dict.fromkeys(answers.get(keys[i], ()))) for i in order)
    return Entrants(sets[order], objective.scores(sets[order]).ap, searches, considered)


@dataclass(frozen=True)
class _Swapped:
    """Swap search for at most `size` sensors. It starts from greedy's set and random ones."""

    size: int
    effort: Effort
    seed: int
    checkpoint: Checkpoint

    def __call__(self, objective: Objective, part: str) -> Result:
        """Search by an objective. part: name of its state."""
        effort = self.effort
        most = SWAP_EVALUATIONS if effort.evaluations is None else effort.evaluations
        return swap.search(
            objective, self.size, seed=self.seed, starts=swap.STARTS, seconds=effort.seconds,
            evaluations=most, checkpoint=self.checkpoint.part(f"{self.size}.{part}"),
        )  # fmt: skip


def _searches(objective: Objective, swapped: _Swapped) -> Iterator[tuple[str, Callable[[], Result]]]:
    """Searches with the same sensor limit as swap, by name."""
    size, effort, seed = swapped.size, swapped.effort, swapped.seed
    limits: dict[str, Any] = {"seconds": effort.seconds, "evaluations": effort.evaluations}
    count = len(objective.candidates)
    if count <= exhaustive.LARGEST and sum(math.comb(count, k) for k in range(1, size + 1)) <= EXHAUSTIVE_SETS:
        yield "exhaustive", partial(exhaustive.search, objective, size, **limits)
    yield "greedy", partial(greedy.search, objective, size, **limits)
    yield "swap", partial(swapped, objective, "swap")
    by_entropy = entropy_objective(objective)
    if by_entropy is not None:
        yield "swap by perception entropy", partial(swapped, by_entropy, "entropy")
    if objective.visibility is not None and find_spec("ortools"):
        solving = 600.0 if effort.seconds is None else effort.seconds
        yield "cpsat", partial(cpsat.search, objective, size, seed=seed, seconds=solving, effort=SOLVING)
    prices = objective.candidates.prices
    if np.ptp(prices) > 0:
        thrifty = objective.weighed(Weights(price=THRIFT / float(prices.mean())))
        yield "thrifty swap", partial(swapped, thrifty, "thrifty")


def entropy_objective(objective: Objective) -> Objective | None:
    """Same objective scored by published perception entropy.

    Candidates, weights and budget stay. None where the candidates' visibility is unknown.
    """
    seen = objective.visibility
    if seen is None:
        return None
    entropy = PerceptionEntropy(seen.of_classes(objective.classes.labels), objective.scheme, codec=objective.codec)
    setting = replace(objective.setting, candidates=objective.candidates, fidelity=entropy)
    return Objective(setting, objective.run, visibility=seen)


def _neighbours(
    objective: Objective, answers: Bool[np.ndarray, "n C"], count: int
) -> tuple[Bool[np.ndarray, "k C"], int]:
    """Best feasible neighbours of some answers.

    At most one is taken per change of mount. The number of sets scored comes too. Up to half of them are from the front
    of several scores, where the candidates' visibility is known.
    """
    best: list[tuple[float, Bool[np.ndarray, " C"]]] = []
    considered = 0
    for answer in answers:
        sets = neighbours(np.flatnonzero(answer), len(answer))[1:][:NEIGHBOURS_AT_ONCE]
        sets = sets[objective.feasible(sets)]
        considered += len(sets)
        if not len(sets):
            continue
        reward = objective.scores(sets).reward
        order = np.argsort(-reward, kind="stable")[:FRONT_OF]
        best += [(float(reward[i]), sets[i]) for i in order]
    best.sort(key=lambda pair: -pair[0])
    ranked = [row for _, row in best]
    kept = _one_a_mount(objective, ranked, {}, count)
    if objective.visibility is not None and ranked:
        kept = _one_a_mount(objective, ranked, {}, count - count // 2)
        kept = _one_a_mount(objective, _front(objective, np.array(ranked)), kept, count)
        kept = _one_a_mount(objective, ranked, kept, count)
    return np.array(list(kept.values()), np.bool_).reshape(len(kept), answers.shape[1]), considered


def _one_a_mount(
    objective: Objective,
    rows: Iterable[Bool[np.ndarray, " C"]],
    kept: dict[bytes, Bool[np.ndarray, " C"]],
    most: int,
) -> dict[bytes, Bool[np.ndarray, " C"]]:
    """Kept sets and the first rows on new mounts. Stops at `most` sets."""
    kept = dict(kept)
    for row in rows:
        if len(kept) >= most:
            break
        kept.setdefault(np.packbits(objective.candidates.per_mount(row[None])[0] > 0).tobytes(), row)
    return kept


def _front(objective: Objective, sets: Bool[np.ndarray, "n C"]) -> Bool[np.ndarray, "k C"]:
    """Sets that no other beats, by reward. A set is beaten in reward, perception entropy and coverage at once."""
    by_entropy, seen = entropy_objective(objective), objective.visibility
    if by_entropy is None or seen is None:
        return sets[:0]
    coverage = Coverage(seen, objective.scheme, codec=objective.codec, classes=objective.classes)
    figures = (objective.scores(sets).reward, by_entropy.scores(sets).ap, coverage(sets).ap)
    return sets[exhaustive.find_front(-np.stack(figures, axis=1))]
