"""Selection: which entrant is the answer, by a race of the detector on traffic that no search saw.

Sets of one size race each other until it is sure enough which is the best (`placement_env.racing.race_until`), so that
small and cheap ones stay in; the best few of each size are judged on all frames. Without a requirement the answer is
the set of the greatest AP. With one it is the cheapest set, by price, number of sensors, then kbit, whose interval lies
above it; where none does, the cheapest whose AP reaches it; where none does either, the set of the greatest AP. Of sets
with equal AP the one of the greater mean AP over the detector's IoU thresholds is taken, and of equal ones again the
cheaper. Where the plan asks for sensors that fail, the AP is what is left of a set then; where it asks for levels of
traffic, the AP is that of the worst level, or their mean; where it asks for several error profiles, that at the worst
of these, or their mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from placement_env.fidelity.detector import IOUS
from placement_env.objective import Objective
from placement_env.report.content import Judgement, PlanOption, overlap
from placement_env.report.planning.judging import Judge
from placement_env.search.exact.exhaustive import undominated
from placement_env.search.portfolio.entrants import Entrants
from placement_env.search.portfolio.portfolio import contest
from toolkit.arrays import Bool
from toolkit.runtime.run import Stages

KEPT = 3  # sets of each number of sensors that are judged on all frames

Rule = Literal["best", "interval", "estimate", "none"]


@dataclass(frozen=True, eq=False)
class Selection:
    """options: all entrants in their order, judged or not; sets: their rows; chosen: which is the answer; rule: by
    which it was chosen."""

    options: tuple[PlanOption, ...]
    sets: Bool[np.ndarray, "n C"]
    chosen: int
    rule: Rule


class _Said(NamedTuple):
    """What the detector says of a set: intact, the mean AP over its IoU thresholds, what is left of it when sensors
    fail, over levels of traffic, and over error profiles; None where it says nothing."""

    judged: Judgement | None = None
    mean_ap: float | None = None
    left: Judgement | None = None
    over_levels: Judgement | None = None
    over_errors: Judgement | None = None


def select(
    objective: Objective,
    found: Entrants,
    judge: Judge,
    *,
    min_ap: float | None = None,
    confidence: float = 0.95,
    seed: int = 0,
    progress: Stages | None = None,
) -> Selection:
    """The answer among the entrants, of which there is at least one. confidence: at which a race of one size ends."""
    judged = _judged(objective, found, judge, confidence=confidence, seed=seed, progress=progress)
    options = [_option(objective, found, i, judged.get(i, _Said())) for i in range(len(found.sets))]
    chosen, rule = choose(tuple(options), min_ap)
    return Selection(tuple(options), found.sets, chosen, rule)


def choose(options: tuple[PlanOption, ...], min_ap: float | None) -> tuple[int, Rule]:
    """The answer among options of which some are judged, and by which rule."""
    judged = [(i, option, option.counted) for i, option in enumerate(options) if option.counted is not None]

    def thrifty(entry: tuple[int, PlanOption, Judgement]) -> tuple[float, int, float, float]:
        _, option, judgement = entry
        return option.price, len(option.sensors), option.kbit_per_sensor, -judgement.ap

    if min_ap is not None:
        sure = [entry for entry in judged if entry[2].low >= min_ap]
        reaching = [entry for entry in judged if entry[2].ap >= min_ap]
        if sure or reaching:
            return min(sure or reaching, key=thrifty)[0], "interval" if sure else "estimate"
    best = min(judged, key=lambda entry: (-entry[2].ap, -(entry[1].mean_ap or 0.0), *thrifty(entry)))[0]
    return best, "best" if min_ap is None else "none"


def near_optimal(options: tuple[PlanOption, ...], chosen: int) -> tuple[PlanOption, ...]:
    """Judged sets other than the chosen one whose interval overlaps with its interval, cheap ones first."""
    of_chosen = options[chosen].counted
    if of_chosen is None:
        return ()
    near = [
        option
        for i, option in enumerate(options)
        if i != chosen and option.counted and overlap(option.counted, of_chosen)
    ]
    return tuple(sorted(near, key=lambda option: (option.price, -option.counted.ap if option.counted else 0.0)))


def judged_front(options: tuple[PlanOption, ...]) -> tuple[PlanOption, ...]:
    """Judged sets that no other one beats in AP, kbit per sensor and price at once, by price, then AP."""
    judged = [(option, option.counted) for option in options if option.counted is not None]
    figures = np.array([(-j.ap, o.kbit_per_sensor, o.price) for o, j in judged]).reshape(-1, 3)
    kept = [judged[i] for i in undominated(figures)]
    return tuple(option for option, _ in sorted(kept, key=lambda pair: (pair[0].price, pair[1].ap)))


def _judged(
    objective: Objective, found: Entrants, judge: Judge, *, confidence: float, seed: int, progress: Stages | None
) -> dict[int, _Said]:
    """What is said of the best of each size, by their place among the entrants."""
    sizes = found.sets.sum(axis=1)
    judged: dict[int, _Said] = {}
    evaluator = judge.evaluator()
    different = np.unique(sizes)
    for done, size in enumerate(different, 1):
        places = np.flatnonzero(sizes == size)
        ran = contest(objective, found.sets[places], evaluator, confidence=confidence, seed=seed)
        kept = places[ran.ranking[:KEPT]]
        estimates = judge.detected.estimates(found.sets[kept])
        mean_ap = np.mean([estimates[iou].ap for iou in IOUS], axis=0)
        intact, nothing = judge.judge(found.sets[kept]), [None] * len(kept)
        left: Sequence[Judgement | None] = judge.left(found.sets[kept]) or nothing
        levelled: Sequence[Judgement | None] = judge.over_levels(found.sets[kept]) or nothing
        over_errors: Sequence[Judgement | None] = judge.over_errors(found.sets[kept]) or nothing
        said = map(_Said, intact, mean_ap.tolist(), left, levelled, over_errors)
        judged |= dict(zip(kept.tolist(), said, strict=True))
        if progress is not None:
            progress("judging", done, len(different))
    return judged


def _option(
    objective: Objective,
    found: Entrants,
    i: int,
    said: _Said,
) -> PlanOption:
    score = objective.score(np.flatnonzero(found.sets[i]))
    names = tuple(objective.names[c].replace("/", "-") for c in score.subset)  # as files name sensors
    predicted = round(float(found.predicted[i]), 6)  # as found: scored again beside other sets it may round otherwise
    return PlanOption(
        names, score.price, score.kbit_per_sensor, score.kbit, predicted, said.judged, found.searches[i],
        said.mean_ap, said.left, said.over_levels, said.over_errors,
    )  # fmt: skip
