"""Entrants: sensor sets for a detector to judge, found by several searches with a fast fidelity.

No fast score is right everywhere, and a search exploits the errors of its score. So greedy and swap
use the objective, swap also perception entropy (Ma, Liu, Li) and the objective at other IoU
thresholds, CP-SAT coverage, greedy also the points on each object. Every set is scored if
candidates are few, and if prices differ a thrifty search looks for cheaper sets. If an AP is
required, cheap sets from the exact search and from swap join that reach it or some AP around it,
since the objective may be wrong; more AP than that gains nothing. Neighbours join these answers:
the best by the objective, and those that no other beats in the objective's reward, perception
entropy and coverage together.
"""

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from typing import Any

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
from placement_env.search.checkpoint import Checkpoint, KeptState
from placement_env.search.checkpoint_folder import NOWHERE
from placement_env.search.exact import cheapest, cpsat, exhaustive
from placement_env.search.progress import as_rows
from placement_env.search.result import Result
from placement_env.search.verification import neighbours
from placement_env.setting import Weights
from placement_env.subsets import Sets
from toolkit.arrays import Bool, Float64
from toolkit.runtime.cache import Cache, code_digest, make_key

DEFAULT_NEIGHBOURS = 9  # for each number of sensors, in addition to the searches' answers
SWAP_EVALUATIONS = 60_000  # sets that swap may score for each number of sensors
OTHER_IOUS: dict[str, tuple[float, ...]] = {  # thresholds in addition to the objective's
    "swap at IoU 0.7": (0.7,),
    "swap at IoU 0.9": (0.9,),
    "swap at mean IoU": IOUS,
}
OTHER_IOU_DIVISOR = 4  # at other thresholds swap may score a fourth of the sets
MAX_EXHAUSTIVE_SETS = 20_000  # up to this number every set is scored
FULL_EFFORT_SIZES = 4  # numbers of sensors with this effort each; more share it
CPSAT_EFFORT_S = 10.0  # CP-SAT's deterministic time for each number of sensors
THRIFT_AP = 0.02  # that the mean price of a candidate costs in the thrifty search
MAX_SCORED_NEIGHBOURS = 50_000  # per answer
AP_OFFSETS = (-0.05, 0.0, 0.05, 0.1)  # from a required AP to those that cheap sets are to reach
DEFAULT_SOLVING_S = 600.0  # time of a solver without a limit
CHEAPEST_EFFORT_S = 5.0  # CP-SAT's deterministic time for each programme
MAX_FRONT_NEIGHBOURS = 400  # best neighbours of an answer by reward, searched for the front
NamedSearch = tuple[str, Callable[[], Result]]


@dataclass(frozen=True, eq=False)
class Entrants:
    """Sets that enter a race, all feasible and different, small ones first.

    Attributes:
        sets: Sets of candidates, a row of booleans each.
        predicted: AP of each set by the fidelity of the searches.
        searches: Names of the searches that answered with each set, empty for a neighbour of an
            answer.
        considered: Number of sets that the searches scored in all.
    """

    sets: Sets
    predicted: Float64[np.ndarray, " n"]
    searches: tuple[tuple[str, ...], ...]
    considered: int


@dataclass(frozen=True)
class Effort:
    """Limits of the searches.

    Attributes:
        sizes: Largest number of sensors of each run.
        seconds: Time of each search at each size, None for its default.
        evaluations: Scored sets of each search at each size, None for its default.
        neighbours: Number of neighbours that join the answers of each size.
        min_ap: Required AP that cheap sets are to reach, None for no requirement.
    """

    sizes: tuple[int, ...]
    seconds: float | None = None
    evaluations: int | None = None
    neighbours: int = DEFAULT_NEIGHBOURS
    min_ap: float | None = None


class _EnoughAP:
    """Fidelity that scores sets by another one's AP, but by no more than `enough`.

    A search with a small weight on prices then looks for the cheapest set with enough AP.
    """

    def __init__(self, fidelity: Fidelity, enough: float) -> None:
        self.name = fidelity.name
        self._fidelity = fidelity
        self._enough = enough

    def __call__(self, subsets: Sets, /) -> Estimate:
        estimate = self._fidelity(subsets)
        return estimate._replace(ap=np.minimum(estimate.ap, self._enough))


def at_other_ious(
    objective: Objective, preparation: Preparation | None = None
) -> dict[str, Objective]:
    """Same objective at other IoU thresholds, by the name of its search; empty without a surrogate.

    The objectives are for intact sets in undivided traffic. Thresholds without a fitted surrogate
    are left out, and the objective's thresholds too.

    preparation: preparation of the objective if the objective does not know it, else None.
    """
    source = objective.preparation or preparation
    if source is None or source.setting.fidelity != "surrogate" or objective.visibility is None:
        return {}
    by_iou = dict[str, Objective]()
    cases = source.setting.cases
    for name, ious in OTHER_IOUS.items():
        if ious == cases.ious:
            continue
        with suppress(ValueError, FileNotFoundError):  # no surrogate at this IoU
            iou_preparation = source.at_cases(replace(cases, iou=ious, failing=0, levels=1))
            iou_objective = Objective.from_view(
                iou_preparation, objective.candidates, objective.visibility, objective.weights
            )
            by_iou[name] = iou_objective.with_weights(
                objective.weights, most_price=objective.most_price
            )
    return by_iou


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
    """Entrants of all sizes, from a cache if possible; otherwise searched and put there.

    Args:
        objective: Objective of the searches.
        effort: Limits of the searches.
        cache: Cache of the entrants, None for none. An objective made from a site has its cache
            and digest, which are used instead of these arguments.
        depends_on: Digest of the objective's traffic and other inputs.
        others: Objectives whose answers enter too, by the name of their search (`at_other_ious`).
        seed: Seed of the searches.
        checkpoint: Keeps answers of finished searches.
    """
    if (preparation := objective.preparation) is not None:
        cache = objective.run.memo
        depends_on = preparation.traffic.digest()
    conditions = (objective.provenance, objective.most_price, vars(effort), seed, [*others])
    key = make_key("entrants", code_digest(__name__), depends_on, *conditions)
    cached_arrays = None if cache is None else cache.get([key])[0]
    if cached_arrays is not None:  # as `cache.put` below takes them
        sets, predicted = cached_arrays[:2]
        names, considered = cached_arrays[2:]  # names of the searches of each set, as JSON
        return Entrants(
            sets=sets,
            predicted=predicted,
            searches=tuple(tuple(json.loads(str(set_names))) for set_names in names),
            considered=int(considered[0]),
        )
    entrants = find_entrants(objective, effort, others=others, seed=seed, checkpoint=checkpoint)
    if cache is not None:
        names = np.array([json.dumps(set_names) for set_names in entrants.searches], np.str_)
        considered = np.array([entrants.considered])
        cache.put({key: (entrants.sets, entrants.predicted, names, considered)})
    return entrants


def join_entrants(objectives: Sequence[Objective], groups: Sequence[Entrants]) -> Entrants:
    """Entrants of several groups of searches over the same candidates, each different set once.

    A set has the names of all searches that answered with it. objectives: their predictions are
    averaged; groups: entrants to join, which may be as many as the objectives or more. One group
    comes back unchanged.
    """
    if len(groups) == 1:
        return groups[0]
    # by the bytes of a set's row; dictionaries keep their order and hold each name once
    names_by_set: dict[bytes, dict[str, None]] = {}
    for group in groups:
        for row, names in zip(group.sets, group.searches, strict=True):
            names_by_set.setdefault(row.tobytes(), {}).update(dict.fromkeys(names))
    _, candidate_count = groups[0].sets.shape
    rows = [np.frombuffer(row_bytes, np.bool_) for row_bytes in names_by_set]
    sets = np.array(rows).reshape(-1, candidate_count)
    order = np.argsort(sets.sum(axis=1), kind="stable")  # small sets first
    searches = [tuple(names) for names in names_by_set.values()]
    return Entrants(
        sets=sets[order],
        predicted=np.mean([objective.scores(sets[order]).ap for objective in objectives], axis=0),
        searches=tuple(searches[i] for i in order),
        considered=sum(group.considered for group in groups),
    )


def find_entrants(
    objective: Objective,
    effort: Effort,
    *,
    others: Mapping[str, Objective] = {},
    seed: int = 0,
    checkpoint: Checkpoint = NOWHERE,
) -> Entrants:
    """Entrants of all sizes, empty if nothing may be built.

    Sizes end at the first number of sensors for which no search finds a feasible set. Neighbours of
    the answers, sets that differ in one sensor, enter after each size.

    others: objectives whose answers enter too, by the name of their search; checkpoint: keeps
    answers of finished searches.
    """
    # by the key of a finished search: members of its answer, and number of sets that it scored
    ended: KeptState = checkpoint.load() or {}
    # searches of each set in order, empty for a neighbour
    answers: dict[tuple[int, ...], dict[str, None]] = {}
    considered = 0
    candidate_count = len(objective.candidates)
    sizes = [size for size in effort.sizes if size >= len(objective.kept)]
    searches_done = 0
    for position, size in enumerate(sizes):
        size_answers: dict[tuple[int, ...], None] = {}
        runs = list(list_searches(objective, size, effort, seed, checkpoint, others))
        report = objective.run.stage(
            "searches", searches_done + (len(sizes) - position) * len(runs)
        )
        for name, run in runs:
            if report is not None:
                report(searches_done)
            run_key = f"{size} {name}"
            if run_key not in ended:
                result = run()
                ended[run_key] = [list(result.best.subset), result.evaluations]
                checkpoint.save(ended)
            answer, set_count = ended[run_key]
            members = tuple(answer)
            considered += set_count
            if members and objective.feasible(as_rows([members], candidate_count))[0]:
                size_answers[members] = None
                answers.setdefault(members, {})[name] = None
            searches_done += 1
        if not size_answers:
            break
        near_sets, set_count = choose_neighbours(
            objective, as_rows(list(size_answers), candidate_count), effort.neighbours
        )
        considered += set_count
        for row in near_sets:
            answers.setdefault(tuple(np.flatnonzero(row).tolist()), {})
        if report is not None:
            report(searches_done)
    by_size = sorted(answers, key=len)
    sets = as_rows(by_size, candidate_count)
    return Entrants(
        sets=sets,
        predicted=objective.scores(sets).ap,
        searches=tuple(tuple(answers[members]) for members in by_size),
        considered=considered,
    )


def list_searches(
    objective: Objective,
    size: int,
    effort: Effort,
    seed: int,
    checkpoint: Checkpoint,
    others: Mapping[str, Objective] = {},
) -> Iterator[NamedSearch]:
    """Yield the searches for sets of at most `size` sensors by name.

    Each is called without arguments. The list depends on what the objective knows (visibility,
    prices, a surrogate) and on installed solvers. With many sizes, each search has less effort.

    seed: for all searches; checkpoint: has a part for each swap search; others: objectives to
    search by swap, by name.
    """
    share = min(1.0, FULL_EFFORT_SIZES / len(effort.sizes))
    max_sets = _limit_sets(effort, share)
    swapping = partial(
        swap.search,
        seed=seed,
        starts=swap.DEFAULT_STARTS,
        seconds=effort.seconds,
        evaluations=max_sets,
    )
    yield from _exact_and_greedy(objective, size, effort)
    yield "swap", partial(swapping, objective, size, checkpoint=checkpoint.part(f"{size}.swap"))
    if (by_entropy := entropy_objective(objective)) is not None:
        entropy = partial(swapping, by_entropy, size, checkpoint=checkpoint.part(f"{size}.entropy"))
        yield "swap by perception entropy", entropy
    for name, iou_objective in others.items():
        few_sets = max(1, max_sets // OTHER_IOU_DIVISOR)
        iou_checkpoint = checkpoint.part(f"{size}.{name}")
        search = partial(swapping, iou_objective, size, evaluations=few_sets)
        yield name, partial(search, checkpoint=iou_checkpoint)
    if (by_points := points_objective(objective)) is not None:
        search = partial(greedy.search, by_points, size, seconds=effort.seconds)
        yield "greedy by points", partial(search, evaluations=effort.evaluations)
    solver_s = DEFAULT_SOLVING_S if effort.seconds is None else effort.seconds
    if objective.visibility is not None and find_spec("ortools"):
        solve = partial(cpsat.search, objective, size, seed=seed, seconds=solver_s)
        yield "cpsat", partial(solve, effort=CPSAT_EFFORT_S * share)
    prices = objective.candidates.prices
    thrift = Weights(price=THRIFT_AP / max(float(prices.mean()), 1e-300))  # no division by 0
    if np.ptp(prices) > 0:
        thrifty = objective.with_weights(thrift)
        yield (
            "thrifty swap",
            partial(swapping, thrifty, size, checkpoint=checkpoint.part(f"{size}.thrifty")),
        )
    # searches for cheap sets that reach the required AP, or some AP around it, at the last size
    if effort.min_ap is None or size < max(effort.sizes):
        return
    for aimed_ap in np.round(effort.min_ap + np.array(AP_OFFSETS), 6).tolist():
        if not 0 < aimed_ap < 1:
            continue
        setting = replace(objective.setting, candidates=objective.candidates, weights=thrift)
        setting = replace(setting, fidelity=_EnoughAP(objective.scored_by, aimed_ap))
        enough = Objective(setting, objective.run, visibility=objective.visibility)
        ap_checkpoint = checkpoint.part(f"{size}.{aimed_ap:g}")
        search = partial(swapping, enough, size, evaluations=max_sets // 3)
        yield f"swap for AP {aimed_ap:g}", partial(search, checkpoint=ap_checkpoint)
        if find_spec("ortools") and isinstance(objective.scored_by, Surrogate):
            demand = cheapest.Demand(aimed_ap)
            solve = partial(cheapest.search, seed=seed, seconds=solver_s, demand=demand)
            solve = partial(solve, effort=CHEAPEST_EFFORT_S * share)
            yield f"cheapest for AP {aimed_ap:g}", partial(solve, objective, size)


def _limit_sets(effort: Effort, share: float) -> int:
    """Largest number of sets that a swap search scores. share: of the usual effort for a size."""
    return int(SWAP_EVALUATIONS * share) if effort.evaluations is None else effort.evaluations


def _exact_and_greedy(objective: Objective, size: int, effort: Effort) -> Iterator[NamedSearch]:
    """Yield the exhaustive search, if all sets of at most `size` sensors are few, and greedy.

    Each is a name and a function without arguments. size: largest number of sensors; effort: limits
    of each search in seconds and scored sets, None for its default."""
    limits: dict[str, Any] = {"seconds": effort.seconds, "evaluations": effort.evaluations}
    candidate_count = len(objective.candidates)
    set_count = sum(math.comb(candidate_count, k) for k in range(1, size + 1))
    if candidate_count <= exhaustive.MAX_CANDIDATES and set_count <= MAX_EXHAUSTIVE_SETS:
        yield "exhaustive", partial(exhaustive.search, objective, size, **limits)
    yield "greedy", partial(greedy.search, objective, size, **limits)


def entropy_objective(objective: Objective) -> Objective | None:
    """Same objective scored by published perception entropy; None if visibility is unknown."""
    return _rescore(objective, PerceptionEntropy)


def points_objective(objective: Objective) -> Objective | None:
    """Same objective scored by the points on each object; None if visibility is unknown."""
    return _rescore(objective, PointCount)


def _rescore(
    objective: Objective, fidelity_class: type[PerceptionEntropy | PointCount]
) -> Objective | None:
    """Same objective scored by a fidelity that needs only the visibility of its classes.

    None if visibility is unknown."""
    visibility = objective.visibility
    if visibility is None:
        return None
    fidelity = fidelity_class(
        visibility.of_classes(objective.classes.labels), objective.scheme, codec=objective.codec
    )
    setting = replace(objective.setting, candidates=objective.candidates, fidelity=fidelity)
    return Objective(setting, objective.run, visibility=visibility)


def choose_neighbours(
    objective: Objective, answers: Sets, max_neighbours: int
) -> tuple[list[Bool[np.ndarray, " candidates"]], int]:
    """Best feasible neighbours of some answers, and the number of sets scored.

    A neighbour has one sensor replaced. There is at most one for each choice of mounts. If
    visibility is known, the first half has the highest rewards; then come sets that no other beats
    in reward, entropy and coverage together; rewards fill the rest.

    answers: sets of one size; max_neighbours: most neighbours to return."""
    rewards: list[float] = []
    rows: list[Bool[np.ndarray, " candidates"]] = []
    considered = 0
    for answer in answers:
        sets = neighbours(np.flatnonzero(answer), len(answer))[1:][:MAX_SCORED_NEIGHBOURS]
        sets = sets[objective.feasible(sets)]
        considered += len(sets)
        if len(sets):
            reward = objective.scores(sets).reward
            for row in np.argsort(-reward, kind="stable")[:MAX_FRONT_NEIGHBOURS]:
                rewards.append(float(reward[row]))
                rows.append(sets[row].copy())  # a view would hold all sets in memory
    order = sorted(range(len(rows)), key=lambda index: -rewards[index])
    ranked_sets = [rows[index] for index in order]
    by_mounts: dict[
        bytes, Bool[np.ndarray, " candidates"]
    ] = {}  # one set for each choice of mounts

    def keep(sets: Iterable[Bool[np.ndarray, " candidates"]], max_count: int) -> None:
        """Add sets to `by_mounts`, one for each choice of mounts, up to `max_count` in all."""
        for row in sets:
            if len(by_mounts) < max_count:
                is_used = objective.candidates.per_mount(row[None])[0] > 0  # for each mount
                by_mounts.setdefault(np.packbits(is_used).tobytes(), row)

    by_entropy = entropy_objective(objective)
    visibility = objective.visibility
    if by_entropy is not None and visibility is not None and ranked_sets:
        keep(ranked_sets, max_neighbours - max_neighbours // 2)  # half, rounded up
        sets = np.array(ranked_sets)
        coverage = Coverage(
            visibility, objective.scheme, codec=objective.codec, classes=objective.classes
        )
        figures = (objective.scores(sets).reward, by_entropy.scores(sets).ap, coverage(sets).ap)
        keep(sets[exhaustive.find_front(-np.stack(figures, axis=1))], max_neighbours)
    keep(ranked_sets, max_neighbours)
    return list(by_mounts.values()), considered
