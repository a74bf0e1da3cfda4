"""Choosing the answer among entrants, which race by the detector on traffic that no search saw.

Sets of one size race each other until the best of them is known well enough (`placement_env.racing.race_until`), so
that small and cheap sets stay in; the best few of each size are judged on all frames. Without a requirement the answer
is the set with the highest AP. With one it is the cheapest set, by price, number of sensors, then kbit, whose interval
lies above it; failing that, the cheapest whose AP reaches it; failing that, the set with the highest AP. Among sets of
equal AP the higher mean AP over the detector's IoU thresholds wins, then the cheaper set. AP is that over the cases of
the plan (`PlanOption.counted`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from placement_env.fidelity.detector import IOUS
from placement_env.objective import Objective
from placement_env.report.content import Judgement, PlanOption, overlap
from placement_env.report.planning.judging import Judge
from placement_env.search.exact.exhaustive import find_front
from placement_env.search.portfolio.entrants import Entrants
from placement_env.search.portfolio.portfolio import contest
from toolkit.arrays import Bool
from toolkit.runtime.run import Run

KEPT = 3  # sets of each number of sensors that are judged on all frames

Rule = Literal["best", "interval", "estimate", "none"]


@dataclass(frozen=True, eq=False)
class Choice:
    """The answer among options: all entrants in their order, judged or not. chosen: index of the answer."""

    options: tuple[PlanOption, ...]
    sets: Bool[np.ndarray, "n C"]
    chosen: int
    rule: Rule

    @property
    def option(self) -> PlanOption:
        """The answer."""
        return self.options[self.chosen]

    @property
    def members(self) -> tuple[int, ...]:
        """Indices of the candidates of the answer, ascending."""
        return tuple(np.flatnonzero(self.sets[self.chosen]).tolist())


def choose_set(
    objective: Objective,
    found: Entrants,
    judge: Judge,
    *,
    min_ap: float | None = None,
    confidence: float = 0.95,
    run: Run = Run(),
) -> Choice:
    """Choose among the entrants, at least one. confidence: at which a race of one size ends."""
    options = []
    for i, score in enumerate(map(objective.score, map(np.flatnonzero, found.sets))):
        names = tuple(objective.names[c].replace("/", "-") for c in score.subset)  # as files name sensors
        predicted = round(float(found.predicted[i]), 6)  # as found: scored beside other sets it may round differently
        figures = score.price, score.kbit_per_sensor, score.kbit, predicted
        options.append(PlanOption(names, *figures, judged=None, searches=found.searches[i]))
    sizes, evaluator = found.sets.sum(axis=1), judge.evaluator
    report = run.stage("judging", len(np.unique(sizes)))
    for done, size in enumerate(np.unique(sizes), 1):
        places = np.flatnonzero(sizes == size)
        ran = contest(objective, found.sets[places], evaluator, confidence=confidence, seed=run.seed)
        kept = places[ran.ranking[:KEPT]]
        estimates = judge.detected.estimates(found.sets[kept])
        mean_ap = np.mean([estimates[iou].ap for iou in IOUS], axis=0).tolist()
        for i, judged, mean in zip(kept.tolist(), judge.judge_cases(found.sets[kept]), mean_ap, strict=True):
            options[i] = replace(options[i], mean_ap=mean, **judged._asdict())
        if report is not None:
            report(done)
    return Choice(tuple(options), found.sets, *choose(tuple(options), min_ap))


def choose(options: tuple[PlanOption, ...], min_ap: float | None) -> tuple[int, Rule]:
    """Return the index of the answer among options, some of them judged, and the rule that chose it."""

    def thrift(entry: tuple[int, PlanOption, Judgement]) -> tuple[float, int, float, float]:
        _, option, judgement = entry
        return option.price, len(option.sensors), option.kbit_per_sensor, -judgement.ap

    judged = [(i, option, option.counted) for i, option in enumerate(options) if option.counted is not None]
    if min_ap is not None:
        sure = [entry for entry in judged if entry[2].low >= min_ap]
        reaching = [entry for entry in judged if entry[2].ap >= min_ap]
        if sure or reaching:
            return min(sure or reaching, key=thrift)[0], "interval" if sure else "estimate"
    best = min(judged, key=lambda entry: (-entry[2].ap, -(entry[1].mean_ap or 0.0), *thrift(entry)))[0]
    return best, "best" if min_ap is None else "none"


def near_optimal(options: tuple[PlanOption, ...], chosen: int) -> tuple[PlanOption, ...]:
    """Judged sets whose interval overlaps the chosen one's. The chosen set is left out; cheap sets come first."""
    best = options[chosen].counted
    others = [(option, option.counted) for i, option in enumerate(options) if i != chosen and option.counted]
    near = [(option, judged) for option, judged in others if best and overlap(judged, best)]
    return tuple(option for option, _ in sorted(near, key=lambda each: (each[0].price, -each[1].ap)))


def find_front_options(options: tuple[PlanOption, ...]) -> tuple[PlanOption, ...]:
    """Judged sets that no other beats in AP, kbit per sensor and price at once, by price, then AP."""
    judged = [(option, option.counted) for option in options if option.counted is not None]
    figures = np.array([(-j.ap, o.kbit_per_sensor, o.price) for o, j in judged]).reshape(-1, 3)
    kept = [judged[i] for i in find_front(figures)]
    return tuple(option for option, _ in sorted(kept, key=lambda pair: (pair[0].price, pair[1].ap)))
