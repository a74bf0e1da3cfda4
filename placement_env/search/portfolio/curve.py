"""Budget curve: the best AP on fresh traffic for every number of sensors or amount of money.

The searches of a portfolio run for each budget. Its entrants race each other, and those of an
amount also the winner of the amount before. All winners are judged together on the third part of
traffic, with the same resamples, so their AP is comparable. A checkpoint keeps the progress of
searches and the winners of finished races."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from placement_env.analysis.intervals import FEWEST_SURE_OBJECTS, is_comparable, share_beyond_reach
from placement_env.checks import check_whole
from placement_env.objective import Objective
from placement_env.search.checkpoint import NOWHERE, Checkpoint, KeptState
from placement_env.search.portfolio.entrants import Effort, Entrants, at_other_ious, keep_entrants
from placement_env.search.portfolio.evaluators import Schedule, race_order
from placement_env.search.portfolio.portfolio import (
    SEARCHES,
    SET_FRAMES,
    Judging,
    aps_at_profiles,
    contest,
    weigh_costs,
)
from placement_env.search.progress import Limits, as_rows
from placement_env.search.result import ProfileAP

AMOUNTS = 12  # largest number of amounts of money to search
SUMS = 4096  # resolution of prices


@dataclass(frozen=True)
class CurvePoint:
    """The best set for one number of sensors, or amount of money (infinite for numbers).

    searches: that answered with it, empty for a neighbour; predicted: AP by the searched objective;
    ap, low, high: on traffic that neither searches nor race saw, where there are so many objects;
    confidence: that no other entrant of this budget is better by more than 0.01, NaN from too few
    frames; pays: whether no set of the curve costs as little or less and has as much AP; by_errors:
    AP at each of several error profiles."""

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
    money: float = np.inf
    by_errors: tuple[ProfileAP, ...] = ()
    objects: int = 0


def budget_curve(
    objective: Objective,
    most: int,
    *,
    amounts: tuple[float, ...] = (),
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    judging: Judging = Judging(),
    checkpoint: Checkpoint = NOWHERE,
) -> tuple[CurvePoint, ...]:
    """Points of a budget curve, one for each number of sensors from 1 to `most` with a feasible
    set.

    Where `amounts` of money are given (`list_amounts`), there is one for each amount with a new
    best set of at most `most` sensors. Other arguments, and errors, as in
    `placement_env.search.portfolio.portfolio.search`."""
    check_whole("budget", most, least=1)
    objective.setting.check_budget(most)
    Limits(seconds, evaluations)
    schedule = Schedule.of(seconds, objective.run)
    count = len(objective.candidates)
    racing, final = judging.build_evaluators(objective, schedule, seed=seed)
    each = schedule.searching(SEARCHES * (len(amounts) or most))
    sizes = (most,) if amounts else tuple(range(1, most + 1))
    groups = list(
        _groups(
            objective,
            Effort(sizes, each, evaluations, judging.neighbours),
            amounts,
            seed,
            checkpoint,
        )
    )
    races = checkpoint.part("races")
    kept: KeptState = races.load() or {"ended": 0, "winners": []}
    winners: list[KeptState] = kept["winners"]
    for n, (money, found) in enumerate(groups[kept["ended"] :], kept["ended"]):
        timed = schedule.limit(racing, 1 / (len(groups) - n + 1), 1)
        before = as_rows([winners[-1]["subset"]] if amounts and winners else [], count)
        sets = np.concatenate([found.sets, before])
        enough = SET_FRAMES if seconds is None else math.inf
        ran = contest(objective, sets, timed, confidence=judging.confidence, seed=seed, most=enough)
        first = int(ran.ranking[0])
        members = np.flatnonzero(sets[first]).tolist()
        if not (len(before) and members == winners[-1]["subset"]):
            sure = (
                ran.confidence if is_comparable(int(ran.frames[0]), FEWEST_SURE_OBJECTS) else None
            )
            own = {"predicted": float(found.predicted[first]), "confidence": sure}
            winners.append(
                {
                    "subset": members,
                    "searches": list(found.searches[first]),
                    "money": float(money),
                    **own,
                }
            )
        races.save({"ended": n + 1, "winners": winners})
    if not winners:
        return ()
    rows = as_rows([won["subset"] for won in winners], count)
    order = np.arange(final.frames) if seconds is None else race_order(final.frames)
    judged = schedule.limit(final).evaluate(
        rows, order, objective.run.stage("frames judged", final.frames)
    )
    by_errors = aps_at_profiles(final, rows, order[: judged.frames])
    price = objective.price(rows)
    objects = final.count_objects(order[: judged.frames])
    cost = weigh_costs(objective, rows, judged.kbit)
    points = []
    for place, (won, ap) in enumerate(zip(winners, judged.ap.tolist(), strict=True)):
        low, high = final.interval(ap, judged.resamples[place], order[: judged.frames])
        sure = math.nan if won["confidence"] is None else won["confidence"]
        if not math.isnan(low):
            sure = max(sure, share_beyond_reach(judged.resamples[place] - cost[place]))
        rivals = (price <= price[place]) & (np.arange(len(rows)) != place)
        point = CurvePoint(
            sensors=len(won["subset"]),
            price=float(price[place]),
            kbit=float(judged.kbit[place]),
            ap=ap,
            low=low,
            high=high,
            pays=not bool((judged.ap[rivals] >= ap).any()),
            by_errors=by_errors[place],
            objects=objects,
            **won
            | {"confidence": sure}
            | {name: tuple(won[name]) for name in ("subset", "searches")},
        )
        points.append(point)
    return tuple(points)


def _groups(
    objective: Objective,
    effort: Effort,
    amounts: tuple[float, ...],
    seed: int,
    checkpoint: Checkpoint,
) -> Iterator[tuple[float, Entrants]]:
    """Entrants of each amount of money with a set, or of each number of sensors."""
    for money in sorted(amounts):
        limited = objective.weighed(objective.weights, most_price=min(money, objective.most_price))
        others = at_other_ious(limited)
        part = checkpoint.part(f"{money!r}")
        found = keep_entrants(limited, effort, others=others, seed=seed, checkpoint=part)
        if len(found.sets):
            yield money, found
    if not amounts:
        others = at_other_ious(objective)
        found = keep_entrants(objective, effort, others=others, seed=seed, checkpoint=checkpoint)
        sizes = found.sets.sum(axis=1)
        for rows in (np.flatnonzero(sizes == size) for size in np.unique(sizes)):
            searches = tuple(found.searches[row] for row in rows)
            yield (
                np.inf,
                Entrants(found.sets[rows], found.predicted[rows], searches, found.considered),
            )


def list_amounts(
    objective: Objective, most: int, money: float, count: int = AMOUNTS
) -> tuple[float, ...]:
    """Amounts of money for a curve, ascending, each the price of some set of at most `most`
    sensors. These are all up to `money`, or else `count` of them, evenly spread and as large as
    possible."""
    check_whole("budget", most, least=1)
    candidates = objective.candidates
    alone = objective.allowed([])
    prices = np.unique(candidates.prices[alone])
    if candidates.several:
        prices = np.union1d(prices, candidates.model_prices[alone])
    sums = np.zeros(1)
    for _ in range(most):
        sums = np.unique(np.concatenate([sums, (sums[:, None] + prices).ravel()]))
        sums = sums[sums <= money * (1 + 1e-9)]
        cells = np.floor(sums / max(money, 1e-300) * (1 << 30 if len(sums) <= SUMS else SUMS))
        sums = sums[np.append(np.diff(cells) > 0, True)]  # those that differ
    sums = sums[sums > 0]
    if len(sums) > count:
        steps = np.linspace(0.0, money, count + 1)[1:]
        place = np.searchsorted(sums, steps * (1 + 1e-9)) - 1
        sums = sums[np.unique(place[place >= 0])]
    return tuple(sums.tolist())
