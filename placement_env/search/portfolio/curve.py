"""Budget curve: the best AP on fresh traffic for every number of sensors or amount of money.

The searches of a portfolio run for each budget. Its entrants race each other, and the entrants of
an amount also race the winner of the amount before. All winners are judged together on the third
part of traffic, with the same resamples, so their AP is comparable. A checkpoint keeps the progress
of searches and the winners of finished races.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from placement_env.analysis.intervals import MIN_SURE_OBJECTS, is_comparable, share_beyond_reach
from placement_env.checks import check_whole
from placement_env.feasibility import PRICE_ROUNDING_SHARE
from placement_env.objective import Objective
from placement_env.racing import Contest
from placement_env.search.checkpoint import Checkpoint, KeptState
from placement_env.search.checkpoint_folder import NOWHERE
from placement_env.search.portfolio.entrants import Effort, Entrants, at_other_ious, keep_entrants
from placement_env.search.portfolio.evaluators import CasesEvaluator, race_order
from placement_env.search.portfolio.portfolio import SEARCH_COUNT, Judging, aps_at_profiles
from placement_env.search.portfolio.reward_race import MAX_SET_FRAMES, contest, weigh_costs
from placement_env.search.portfolio.schedule import Schedule
from placement_env.search.progress import Limits, as_rows
from placement_env.search.result import ProfileAP

MAX_AMOUNTS = 12  # amounts of money to search
MAX_SUMS = 4096  # sums of prices that are kept exactly; beyond it, cells on the way to the limit


@dataclass(frozen=True)
class CurvePoint:
    """Best set for one number of sensors, or amount of money (infinite for numbers).

    Attributes:
        sensors: Number of sensors.
        subset: Indices of the candidates.
        price: Price of the set.
        kbit: Data of the whole set per frame.
        searches: Searches that answered with it, empty for a neighbour.
        predicted: AP by the searched objective.
        ap: AP on traffic that neither searches nor race used.
        low: Lower end of the 95 % interval.
        high: Upper end of the 95 % interval.
        confidence: Confidence that no other entrant of this budget is better by more than 0.01, NaN
            from too few frames.
        pays: Whether no set of the curve costs as little or less and has as much AP.
        money: Amount of money.
        by_errors: AP at each of several error profiles.
        objects: Number of objects in the judged frames.
    """

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
    """Points of a budget curve, one for each number of sensors up to `most` with a feasible set.

    With `amounts` of money (`list_amounts`), there is one for each amount with a new best set of at
    most `most` sensors. Empty if no set may be built.

    Args:
        objective: Objective of the searches.
        most: Largest number of sensors.
        amounts: Amounts of money, empty for a curve over numbers of sensors.
        seed: Seed of searches, races and resamples.
        seconds: Time for everything, None for no limit.
        evaluations: Largest number of scored sets of each search, None for its default.
        judging: Races and assessment.
        checkpoint: Keeps the progress of searches and the winners of finished races.

    Raises ValueError if these do not fit."""
    check_whole("budget", most, least=1)
    objective.setting.check_budget(most)
    Limits(seconds, evaluations)  # checks both
    schedule = Schedule.from_processes(seconds, objective.run)
    race_evaluator, final_evaluator = judging.build_evaluators(objective, schedule, seed=seed)
    effort = Effort(
        sizes=(most,) if amounts else tuple(range(1, most + 1)),
        seconds=schedule.search_seconds(SEARCH_COUNT * (len(amounts) or most)),
        evaluations=evaluations,
        neighbours=judging.neighbours,
    )
    budgets = list(search_budgets(objective, effort, amounts, seed, checkpoint))
    races = checkpoint.part("races")
    saved: KeptState = races.load() or {"ended": 0, "winners": []}
    winners: list[KeptState] = saved["winners"]
    for number, (money, entrants) in enumerate(budgets[saved["ended"] :], saved["ended"]):
        # equal shares for the races to come and the final judgement
        share = 1 / (len(budgets) - number + 1)
        evaluator = schedule.limit(race_evaluator, share=share, min_frames=1)
        last_winner = winners[-1]["subset"] if amounts and winners else None
        last_row = as_rows([] if last_winner is None else [last_winner], entrants.sets.shape[1])
        sets = np.concatenate([entrants.sets, last_row])  # the earlier winner races last
        race = contest(
            objective,
            sets,
            evaluator,
            confidence=judging.confidence,
            seed=seed,
            max_set_frames=MAX_SET_FRAMES if seconds is None else math.inf,
        )
        row = int(race.ranking[0])
        members = np.flatnonzero(sets[row]).tolist()
        if members != last_winner:
            winners.append(_describe_winner(entrants, row, members, money=money, race=race))
        races.save({"ended": number + 1, "winners": winners})
    if not winners:
        return ()
    return _judge_winners(objective, winners, evaluator=final_evaluator, schedule=schedule)


def _describe_winner(
    entrants: Entrants, row: int, members: list[int], *, money: float, race: Contest
) -> KeptState:
    """JSON values of the winner of a race, for the checkpoint.

    Args:
        entrants: Sets that raced.
        row: Index of the winner among the entrants.
        members: Candidates (indices) of the winner.
        money: Amount of money of this race, infinite for a number of sensors.
        race: Finished race, the winner first. On too few frames its confidence is left out."""
    is_sure = is_comparable(int(race.frames[0]), MIN_SURE_OBJECTS)
    return {
        "subset": members,
        "searches": list(entrants.searches[row]),
        "money": float(money),
        "predicted": float(entrants.predicted[row]),
        "confidence": race.confidence if is_sure else None,
    }


def _judge_winners(
    objective: Objective, winners: list[KeptState], evaluator: CasesEvaluator, schedule: Schedule
) -> tuple[CurvePoint, ...]:
    """Judge all winners together on the same frames, and return a point for each.

    winners: sets with their predictions and races (`_describe_winner`); evaluator: on the third
    part of traffic. If time is short, there are fewer frames, the same for all."""
    rows = as_rows([winner["subset"] for winner in winners], len(objective.candidates))
    order = np.arange(evaluator.frames)
    if schedule.seconds is not None:
        order = race_order(evaluator.frames)
    judged = schedule.limit(evaluator).evaluate(
        rows, order, objective.run.stage("frames judged", evaluator.frames)
    )
    frames = order[: judged.used]  # None: time sufficed for all
    by_errors = aps_at_profiles(evaluator, rows, frames)
    price = objective.price(rows)
    object_count = evaluator.count_objects(frames)
    cost = weigh_costs(objective, rows, judged.kbit)  # in AP
    points = []
    for number, (winner, ap) in enumerate(zip(winners, judged.ap.tolist(), strict=True)):
        low, high = evaluator.interval(judged[number], frames)
        confidence = math.nan if winner["confidence"] is None else winner["confidence"]
        if not math.isnan(low):
            # a reward near its highest value cannot be beaten by much
            share = share_beyond_reach(judged.resamples[number] - cost[number])
            confidence = max(confidence, share)
        is_rival = (price <= price[number]) & (np.arange(len(rows)) != number)
        point = CurvePoint(
            sensors=len(winner["subset"]),
            subset=tuple(winner["subset"]),
            price=float(price[number]),
            kbit=float(judged.kbit[number]),
            searches=tuple(winner["searches"]),
            predicted=winner["predicted"],
            ap=ap,
            low=low,
            high=high,
            confidence=confidence,
            pays=not bool((judged.ap[is_rival] >= ap).any()),
            money=winner["money"],
            by_errors=by_errors[number],
            objects=object_count,
        )
        points.append(point)
    return tuple(points)


def search_budgets(
    objective: Objective,
    effort: Effort,
    amounts: tuple[float, ...],
    seed: int,
    checkpoint: Checkpoint,
) -> Iterator[tuple[float, Entrants]]:
    """Yield each amount of money with its entrants, or infinity for each number of sensors.

    Amounts without a feasible set are left out.

    Args:
        objective: Objective of the searches.
        effort: Limits of the searches of each amount, or of all numbers of sensors together.
        amounts: Amounts of money, empty for numbers of sensors.
        seed: Seed of the searches.
        checkpoint: Keeps their progress."""
    for money in sorted(amounts):
        limited_objective = objective.with_weights(
            objective.weights, most_price=min(money, objective.most_price)
        )
        entrants = keep_entrants(
            limited_objective,
            effort,
            others=at_other_ious(limited_objective),
            seed=seed,
            checkpoint=checkpoint.part(f"{money!r}"),
        )
        if len(entrants.sets):
            yield money, entrants
    if not amounts:
        others = at_other_ious(objective)
        entrants = keep_entrants(objective, effort, others=others, seed=seed, checkpoint=checkpoint)
        sizes = entrants.sets.sum(axis=1)
        for size in np.unique(sizes):
            rows = np.flatnonzero(sizes == size)
            size_entrants = Entrants(
                sets=entrants.sets[rows],
                predicted=entrants.predicted[rows],
                searches=tuple(entrants.searches[row] for row in rows),
                considered=entrants.considered,
            )
            yield np.inf, size_entrants


def list_amounts(
    objective: Objective, most: int, money: float, count: int = MAX_AMOUNTS
) -> tuple[float, ...]:
    """Amounts of money for a curve, ascending, each the price of some set of at most `most`
    sensors.

    They are all such prices up to `money`, or at most `count` of them, evenly spread: for each of
    `count` equal steps up to `money` the largest price within it. Prices are added without a look
    at mounts, so some may belong to no feasible set.
    """
    check_whole("budget", most, least=1)
    candidates = objective.candidates
    is_allowed = objective.allowed([])
    prices = np.unique(candidates.prices[is_allowed])
    if candidates.has_shared_mounts:  # a further sensor on a mount does not pay the mount again
        prices = np.union1d(prices, candidates.model_prices[is_allowed])
    sums = np.zeros(1)
    for _ in range(most):  # sums of the prices of up to as many sensors
        sums = np.unique(np.concatenate([sums, (sums[:, None] + prices).ravel()]))
        sums = sums[sums <= money * (1 + PRICE_ROUNDING_SHARE)]
        # exact up to rounding for few sums; for many, one sum stays in each of `MAX_SUMS` cells
        cell_count = 1 << 30 if len(sums) <= MAX_SUMS else MAX_SUMS
        cells = np.floor(sums / max(money, 1e-300) * cell_count)  # 1e-300: no division by 0
        sums = sums[np.append(np.diff(cells) > 0, True)]  # the largest sum of each cell
    sums = sums[sums > 0]
    if len(sums) > count:
        steps = np.linspace(0.0, money, count + 1)[1:]
        # index of the largest sum within each step, -1 for none
        sum_rows = np.searchsorted(sums, steps * (1 + PRICE_ROUNDING_SHARE)) - 1
        sums = sums[np.unique(sum_rows[sum_rows >= 0])]
    return tuple(sums.tolist())
