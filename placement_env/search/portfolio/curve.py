"""Budget curve: the best AP for every number of sensors up to a most, and what it costs, on fresh traffic.

The searches of a portfolio run for each number; the entrants of each number race among each other, and the winners are
judged together on the third part of traffic, with the same resamples, so that their AP compare.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from placement_env.analysis.intervals import interval_about
from placement_env.checks import check_whole
from placement_env.fidelity.preparation import Preparation
from placement_env.objective import Objective, Stages
from placement_env.search.portfolio.entrants import ENTRANTS, Effort
from placement_env.search.portfolio.evaluators import Evaluator, race_order
from placement_env.search.portfolio.portfolio import (
    INTERVAL_SHARE,
    JUDGED_FRAMES,
    RACE_FRAMES,
    SEARCHES,
    SET_FRAMES,
    contest,
    evaluators_of,
    found_entrants,
)
from placement_env.search.portfolio.schedule import Schedule
from placement_env.search.progress import Limits


@dataclass(frozen=True)
class CurvePoint:
    """The best set of a number of sensors. searches: that answered with it, none where it is a neighbour; predicted: AP
    by the objective that was searched; ap, low, high: on traffic that neither searches nor race saw; confidence: that
    no other entrant of as many sensors is better by more than 0.01; pays: whether no set of the curve that costs as
    little or less has as much AP."""

    sensors: int
    subset: tuple[int, ...]
    price: float
    kbit: float
    searches: tuple[str, ...]
    predicted: float
    ap: float
    low: float
    high: float
    confidence: float
    pays: bool


def budget_curve(
    objective: Objective,
    most: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    confidence: float = 0.95,
    judge: str = "detector",
    race_frames: int = RACE_FRAMES,
    final_frames: int = JUDGED_FRAMES,
    neighbours: int = ENTRANTS,
    preparation: Preparation | None = None,
    evaluators: tuple[Evaluator, Evaluator] | None = None,
    progress: Stages | None = None,
) -> tuple[CurvePoint, ...]:
    """A point for each number of sensors from 1 to `most` of which a set may be built, by number.

    Arguments as of `placement_env.search.portfolio.portfolio.search`; seconds: of all searches, races and the judgement
    together. Raises ValueError as that does.
    """
    check_whole("budget", most, least=1)
    Limits(seconds, evaluations)
    schedule = Schedule.of(seconds, objective.preparation if preparation is None else preparation)
    parts = schedule.frames(race_frames), schedule.frames(final_frames)
    racing, final = evaluators or evaluators_of(objective, preparation, judge, parts, seed=seed)
    effort = Effort(tuple(range(1, most + 1)), schedule.searching(SEARCHES * most), evaluations, neighbours)
    found = found_entrants(objective, effort, seed, progress)
    sizes = found.sets.sum(axis=1)
    winners: list[tuple[int, float]] = []
    for size in (different := np.unique(sizes)):
        places = np.flatnonzero(sizes == size)
        timed = schedule.racing(racing, len(different) - len(winners))
        ran = contest(
            objective, found.sets[places], timed, confidence=confidence, seed=seed, progress=progress,
            most=SET_FRAMES if seconds is None else math.inf,
        )  # fmt: skip
        winners.append((int(places[ran.ranking[0]]), ran.confidence))
    if not winners:
        return ()
    rows = np.array([row for row, _ in winners])
    report: Callable[[int], None] | None = None
    if progress is not None:
        report = partial(_done, progress, final.frames)
    order = np.arange(final.frames) if seconds is None else race_order(final.frames)
    judged = schedule.judging(final).evaluate(found.sets[rows], order, report)
    price = objective.price(found.sets[rows])
    points = []
    for place, (row, sure) in enumerate(winners):
        ap = float(judged.ap[place])
        low, high = interval_about(ap, judged.resamples[place], confidence=INTERVAL_SHARE)
        rivals = (price <= price[place]) & (np.arange(len(rows)) != place)
        points.append(
            CurvePoint(
                sensors=int(sizes[row]),
                subset=tuple(np.flatnonzero(found.sets[row]).tolist()),
                price=float(price[place]),
                kbit=float(judged.kbit[place]),
                searches=found.searches[row],
                predicted=float(found.predicted[row]),
                ap=ap,
                low=low,
                high=high,
                confidence=sure,
                pays=not bool((judged.ap[rivals] >= ap).any()),
            )
        )
    return tuple(points)


def _done(progress: Stages, total: int, done: int) -> None:
    progress("judging", done, total)
