"""Entrants: sensor sets worth a detector's judgement, found by several searches with a fast
fidelity.

No fast score is right everywhere, and a search exploits the errors of its score. So greedy and swap
use the objective, swap also perception entropy (Ma, Liu, Li) and the objective at other IoU
thresholds, CP-SAT coverage, greedy also the points on each object. Every set is tried where
candidates are few, and where prices differ a thrifty search looks for cheaper sets. Where an AP is
required, cheap sets join that reach it, or some AP around it, since the objective may be off: the
exact search's and swap's, in which more AP than that gains nothing. Neighbours join their answers:
the best by the objective, and those that no other beats in the objective's reward, perception
entropy and coverage at once."""

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec

import numpy as np

from placement_env.fidelity.coverage import Coverage
from placement_env.fidelity.detector import IOUS
from placement_env.fidelity.perception_entropy import PerceptionEntropy
from placement_env.fidelity.point_count import PointCount
from placement_env.fidelity.preparation import Preparation
from placement_env.fidelity.surrogate import Surrogate
from placement_env.objective import Objective
from placement_env.protocol import Estimate, Fidelity
from placement_env.search import greedy, swap
from placement_env.search.checkpoint import NOWHERE, Checkpoint, KeptState
from placement_env.search.exact import cheapest, cpsat, exhaustive
from placement_env.search.progress import as_rows
from placement_env.search.result import Result
from placement_env.search.verification import neighbours
from placement_env.setting import Weights
from placement_env.subsets import Sets
from toolkit.arrays import Bool, Float64
from toolkit.runtime.cache import Cache, code_digest, make_key

ENTRANTS = 9  # neighbours for each number of sensors, beside the searches' own answers
SWAP_EVALUATIONS = 60_000  # sets that swap may score for each number of sensors
OTHER_IOUS: dict[str, tuple[float, ...]] = {  # thresholds beside the objective's own
    "swap at IoU 0.7": (0.7,),
    "swap at IoU 0.9": (0.9,),
    "swap at mean IoU": IOUS,
}
OTHERS_SHARE = 4  # part of the sets that swap may score at other thresholds
EXHAUSTIVE_SETS = 20_000  # that are all scored, at most
USUAL_SIZES = 4  # numbers of sensors that have this effort each; more share it
SOLVING = 10.0  # s of CP-SAT's deterministic time for each number of sensors
THRIFT = 0.02  # AP that the mean price of a candidate costs in the thrifty search
NEIGHBOURS_AT_ONCE = 50_000
AROUND = (-0.05, 0.0, 0.05, 0.1)  # AP beside a required one that cheap sets are to reach
SOLVING_CHEAPEST = 5.0  # s of CP-SAT's deterministic time for each programme
FRONT_OF = 400  # best neighbours of an answer by reward, searched for the front


@dataclass(frozen=True, eq=False)
class Entrants:
    """Sets that enter a race, all feasible and different, small ones first, with the searches that
    answered with each. predicted: AP by the fidelity of the searches; considered: number of sets
    scored in all."""

    sets: Sets
    predicted: Float64[np.ndarray, " n"]
    searches: tuple[tuple[str, ...], ...]
    considered: int


@dataclass(frozen=True)
class Effort:
    """Limits of the searches. sizes: most sensors of each run; neighbours: number that join the
    answers of each size.

    min_ap: required AP that cheap sets are to reach, None for none; seconds, evaluations: of each
    search at each size, None for its default."""

    sizes: tuple[int, ...]
    seconds: float | None = None
    evaluations: int | None = None
    neighbours: int = ENTRANTS
    min_ap: float | None = None


class _EnoughAP:
    """Score sets by their AP, of which more than enough gains nothing."""

    def __init__(self, fidelity: Fidelity, enough: float) -> None:
        self.name = fidelity.name
        self._fidelity = fidelity
        self._enough = enough

    def __call__(self, subsets: Sets, /) -> Estimate:
        found = self._fidelity(subsets)
        return found._replace(ap=np.minimum(found.ap, self._enough))


def at_other_ious(
    objective: Objective, preparation: Preparation | None = None
) -> dict[str, Objective]:
    """Same objective at other IoU thresholds than its own, by name; none where no surrogate scores
    it.

    preparation: for an objective that does not know its own."""
    made = objective.preparation or preparation
    if made is None or made.setting.fidelity != "surrogate" or objective.visibility is None:
        return {}
    others = dict[str, Objective]()
    cases = made.setting.cases
    for name, ious in OTHER_IOUS.items():
        if ious == cases.ious:
            continue
        with suppress(ValueError, FileNotFoundError):  # no surrogate at this IoU
            there = made.at_cases(replace(cases, iou=ious, failing=0, levels=1))
            moved = Objective.of_moved(
                there, objective.candidates, objective.visibility, objective.weights
            )
            others[name] = moved.weighed(objective.weights, most_price=objective.most_price)
    return others


def keep_entrants(
    objective: Objective,
    effort: Effort,
    cache: Cache | None = None,
    *,
    depends_on: str = "",
    others: Mapping[str, Objective] = {},
    seed: int = 0,
    checkpoint: Checkpoint = NOWHERE,
) -> Entrants:
    """Entrants, from a cache where possible; an objective made from a site knows its own.
    depends_on: digest of the objective's traffic and other inputs; others: objectives whose answers
    enter too (`at_other_ious`)."""
    if (made := objective.preparation) is not None:
        cache = objective.run.memo
        depends_on = made.traffic.digest()
    asked = (objective.provenance, objective.most_price, vars(effort), seed, [*others])
    key = make_key("entrants", code_digest(__name__), depends_on, *asked)
    if cache is not None and (kept := cache.get([key])[0]) is not None:
        sets, predicted, names, considered = kept
        return Entrants(
            sets,
            predicted,
            tuple(tuple(json.loads(str(each))) for each in names),
            int(considered[0]),
        )
    found = entrants(objective, effort, others=others, seed=seed, checkpoint=checkpoint)
    if cache is not None:
        names = np.array([json.dumps(each) for each in found.searches], np.str_)
        cache.put({key: (found.sets, found.predicted, names, np.array([found.considered]))})
    return found


def join_entrants(objectives: Sequence[Objective], found: Sequence[Entrants]) -> Entrants:
    """Entrants of several searches over the same candidates as one; predictions are means over the
    objectives."""
    if len(found) == 1:
        return found[0]
    searches: dict[bytes, dict[str, None]] = {}
    for each in found:
        for row, names in zip(each.sets, each.searches, strict=True):
            searches.setdefault(row.tobytes(), {}).update(dict.fromkeys(names))
    sets = np.array([np.frombuffer(row, np.bool_) for row in searches]).reshape(
        -1, found[0].sets.shape[1]
    )
    order = np.argsort(sets.sum(axis=1), kind="stable")
    answers = [tuple(each) for each in searches.values()]
    predicted = np.mean([each.scores(sets[order]).ap for each in objectives], axis=0)
    return Entrants(
        sets[order],
        predicted,
        tuple(answers[i] for i in order),
        sum(each.considered for each in found),
    )


def entrants(
    objective: Objective,
    effort: Effort,
    *,
    others: Mapping[str, Objective] = {},
    seed: int = 0,
    checkpoint: Checkpoint = NOWHERE,
) -> Entrants:
    """Entrants of all sizes, empty where nothing may be built. others: objectives whose answers
    enter too; checkpoint: keeps answers of finished searches."""
    ended: KeptState = checkpoint.load() or {}
    # searches of each set in order, none of a neighbour
    answers: dict[tuple[int, ...], dict[str, None]] = {}
    considered = 0
    count = len(objective.candidates)
    sizes = [size for size in effort.sizes if size >= len(objective.kept)]
    searches_done = 0
    for place, size in enumerate(sizes):
        own: dict[tuple[int, ...], None] = {}
        runs = list(_searches(objective, size, effort, seed, checkpoint, others))
        report = objective.run.stage("searches", searches_done + (len(sizes) - place) * len(runs))
        for name, run in runs:
            if report is not None:
                report(searches_done)
            part = f"{size} {name}"
            if part not in ended:
                result = run()
                ended[part] = [list(result.best.subset), result.evaluations]
                checkpoint.save(ended)
            members = tuple(ended[part][0])
            scored = ended[part][1]
            considered += scored
            if members and objective.feasible(as_rows([members], count))[0]:
                own[members] = None
                answers.setdefault(members, {})[name] = None
            searches_done += 1
        if not own:
            break
        near, scored = _neighbours(objective, as_rows(list(own), count), effort.neighbours)
        considered += scored
        for row in near:
            answers.setdefault(tuple(np.flatnonzero(row).tolist()), {})
        if report is not None:
            report(searches_done)
    by_size = sorted(answers, key=len)
    sets = as_rows(by_size, count)
    searches = tuple(tuple(answers[members]) for members in by_size)
    return Entrants(sets, objective.scores(sets).ap, searches, considered)


def _searches(
    objective: Objective,
    size: int,
    effort: Effort,
    seed: int,
    checkpoint: Checkpoint,
    others: Mapping[str, Objective] = {},
) -> Iterator[tuple[str, Callable[[], Result]]]:
    seconds = effort.seconds
    evaluations = effort.evaluations
    share = min(1.0, USUAL_SIZES / len(effort.sizes))
    most = int(SWAP_EVALUATIONS * share) if evaluations is None else evaluations
    swapping = partial(
        swap.search, seed=seed, starts=swap.STARTS, seconds=seconds, evaluations=most
    )
    count = len(objective.candidates)
    if (
        count <= exhaustive.LARGEST
        and sum(math.comb(count, k) for k in range(1, size + 1)) <= EXHAUSTIVE_SETS
    ):
        yield (
            "exhaustive",
            partial(exhaustive.search, objective, size, seconds=seconds, evaluations=evaluations),
        )
    yield (
        "greedy",
        partial(greedy.search, objective, size, seconds=seconds, evaluations=evaluations),
    )
    yield "swap", partial(swapping, objective, size, checkpoint=checkpoint.part(f"{size}.swap"))
    if (by_entropy := entropy_objective(objective)) is not None:
        entropy = partial(swapping, by_entropy, size, checkpoint=checkpoint.part(f"{size}.entropy"))
        yield "swap by perception entropy", entropy
    for name, other in others.items():
        few = max(1, most // OTHERS_SHARE)
        yield (
            name,
            partial(
                swapping, other, size, evaluations=few, checkpoint=checkpoint.part(f"{size}.{name}")
            ),
        )
    if (by_points := points_objective(objective)) is not None:
        yield (
            "greedy by points",
            partial(greedy.search, by_points, size, seconds=seconds, evaluations=evaluations),
        )
    if objective.visibility is not None and find_spec("ortools"):
        solving = 600.0 if seconds is None else seconds
        yield (
            "cpsat",
            partial(
                cpsat.search, objective, size, seed=seed, seconds=solving, effort=SOLVING * share
            ),
        )
    prices = objective.candidates.prices
    thrift = Weights(price=THRIFT / max(float(prices.mean()), 1e-300))
    if np.ptp(prices) > 0:
        thrifty = objective.weighed(thrift)
        yield (
            "thrifty swap",
            partial(swapping, thrifty, size, checkpoint=checkpoint.part(f"{size}.thrifty")),
        )
    if effort.min_ap is None or size < max(effort.sizes):
        return
    for asked in (
        each for each in np.round(effort.min_ap + np.array(AROUND), 6).tolist() if 0 < each < 1
    ):
        enough = replace(objective.setting, candidates=objective.candidates, weights=thrift)
        enough = replace(enough, fidelity=_EnoughAP(objective.scored_by, asked))
        scored = Objective(enough, objective.run, visibility=objective.visibility)
        part = checkpoint.part(f"{size}.{asked:g}")
        yield (
            f"swap for AP {asked:g}",
            partial(swapping, scored, size, evaluations=most // 3, checkpoint=part),
        )
        if find_spec("ortools") and isinstance(objective.scored_by, Surrogate):
            demand = cheapest.Demand(asked)
            until = 600.0 if seconds is None else seconds
            solve = partial(
                cheapest.search,
                seed=seed,
                seconds=until,
                demand=demand,
                effort=SOLVING_CHEAPEST * share,
            )
            yield f"cheapest for AP {asked:g}", partial(solve, objective, size)


def entropy_objective(objective: Objective) -> Objective | None:
    """Same objective scored by published perception entropy. None where the candidates' visibility
    is unknown."""
    return _rescore(objective, PerceptionEntropy)


def points_objective(objective: Objective) -> Objective | None:
    """Same objective scored by the points on each object. None where the candidates' visibility is
    unknown."""
    return _rescore(objective, PointCount)


def _rescore(objective: Objective, kind: type[PerceptionEntropy | PointCount]) -> Objective | None:
    """Same objective scored by a fidelity that needs no more than the visibility of its classes."""
    seen = objective.visibility
    if seen is None:
        return None
    score = kind(seen.of_classes(objective.classes.labels), objective.scheme, codec=objective.codec)
    setting = replace(objective.setting, candidates=objective.candidates, fidelity=score)
    return Objective(setting, objective.run, visibility=seen)


def _neighbours(
    objective: Objective, answers: Sets, count: int
) -> tuple[list[Bool[np.ndarray, " C"]], int]:
    """Best feasible neighbours of some answers, at most one per change of mount, and the number of
    sets scored. Where visibility is known, up to half of them are sets that no other beats in
    reward, entropy and coverage at once."""
    best: list[tuple[float, Bool[np.ndarray, " C"]]] = []
    considered = 0
    for answer in answers:
        sets = neighbours(np.flatnonzero(answer), len(answer))[1:][:NEIGHBOURS_AT_ONCE]
        sets = sets[objective.feasible(sets)]
        considered += len(sets)
        if len(sets):
            reward = objective.scores(sets).reward
            ranked_rows = np.argsort(-reward, kind="stable")[:FRONT_OF]
            # a view would hold all sets in memory
            best += [(float(reward[i]), sets[i].copy()) for i in ranked_rows]
    best.sort(key=lambda pair: -pair[0])
    ranked = [row for _, row in best]
    kept: dict[bytes, Bool[np.ndarray, " C"]] = {}  # by the mounts that it uses

    def keep(rows: Iterable[Bool[np.ndarray, " C"]], most: int) -> None:
        for row in rows:
            if len(kept) < most:
                kept.setdefault(
                    np.packbits(objective.candidates.per_mount(row[None])[0] > 0).tobytes(), row
                )

    by_entropy = entropy_objective(objective)
    seen = objective.visibility
    if by_entropy is not None and seen is not None and ranked:
        keep(ranked, count - count // 2)
        sets = np.array(ranked)
        coverage = Coverage(
            seen, objective.scheme, codec=objective.codec, classes=objective.classes
        )
        figures = (objective.scores(sets).reward, by_entropy.scores(sets).ap, coverage(sets).ap)
        keep(sets[exhaustive.find_front(-np.stack(figures, axis=1))], count)
    keep(ranked, count)
    return list(kept.values()), considered
