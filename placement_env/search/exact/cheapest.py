"""The cheapest set that reaches an AP, with a proven bound of what any such set costs (CP-SAT).

By coverage the programme is exact. By a surrogate AP is no sum over objects, but never more than the recall: a set that
reaches the AP also reaches it in expected hits, and in steps above their probability. So no set is cheaper than the
cheapest one of that relaxation, which is the bound; the answer comes from steps in the middle of the curve, asked for
more and more until the AP is reached, and then pruned. `failing` 1 asks for the coverage whichever sensor fails, and
`parts` for it in each of so many consecutive parts of the traffic.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from placement_env.checks import check_whole
from placement_env.fidelity.coverage import LEAST, Coverage
from placement_env.fidelity.surrogate import Surrogate
from placement_env.objective import Objective
from placement_env.search import swap
from placement_env.search.exact.cpsat import SECONDS
from placement_env.search.exact.poles import Poles, Prices
from placement_env.search.exact.programme import GAINS, Levels, Solved, levels_of_coverage, levels_of_hits, solve
from placement_env.search.progress import Progress
from placement_env.search.result import Certificate, Result
from toolkit.arrays import Bool, Int64

TRIES = 10  # with steps in the middle of the curve
ASKED_MORE = 0.5  # of the AP that is missing, by which the next try asks for more
PRICE_UNITS = 1 << 30  # whole units of the highest price
MET = 1e-9  # by which rounding may lower an AP


class UnitPrices(NamedTuple):
    """Prices in whole units, rounded down: what a unit is worth."""

    each: Prices
    unit: float


@dataclass(frozen=True)
class _Demand:
    """What is asked for. at_least: AP, or share covered; failing: sensors that may fail; parts: of the traffic."""

    at_least: float
    failing: int
    parts: int


def search(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    at_least: float = 0.9,
    failing: int = 0,
    parts: int = 1,
    workers: int = 1,
) -> Result:
    """The cheapest set of at most `budget` sensors whose AP by the objective is `at_least`; of equally cheap ones that
    of fewest sensors. The certificate is of the price; the empty set is the answer where none reaches it.

    failing: 1 asks for it whichever sensor of the set fails; parts: in how many parts of the traffic it is asked for,
    both by fidelity coverage alone; seconds: 60 if None; `evaluations` limits the search for an answer by a surrogate.
    Raises ValueError where these do not fit and for other fidelities than coverage and surrogate (early, late fusion),
    ImportError without OR-Tools.
    """
    check_whole("budget", budget, least=1)
    check_whole("parts", parts, least=1)
    if not 0 < at_least <= 1:
        raise ValueError(f"the AP to be reached must lie above 0 and up to 1, got {at_least}: 0.9 is 0.9")
    if failing not in (0, 1):
        raise ValueError(f"0 or 1 sensor may fail here, got failing={failing}")
    demand = _Demand(at_least, failing, parts)
    progress = Progress(objective, budget, SECONDS if seconds is None else seconds, evaluations)
    if isinstance(objective.scored_by, Coverage):
        return _by_coverage(objective, progress, demand, seed, workers)
    if failing or parts > 1:
        raise ValueError("failures and parts of the traffic are constraints of --fidelity coverage: say that")
    if not isinstance(objective.scored_by, Surrogate):
        raise ValueError(f"the cheapest set is known by --fidelity coverage or surrogate, got {objective.fidelity}")
    return _by_surrogate(objective, objective.scored_by, progress, demand, seed, workers)


def _by_coverage(objective: Objective, progress: Progress, demand: _Demand, seed: int, workers: int) -> Result:
    seen = objective.visibility
    if seen is None or objective.scored_by.views != 1 or len(objective.classes.names) > 1:  # type: ignore[attr-defined]
        raise ValueError("the cheapest coverage needs to know what each candidate sees, one view and one class")
    seen = seen.of_classes(objective.classes.labels)
    part = seen.frame * demand.parts // max(1, seen.frames)
    parties = part == np.arange(demand.parts)[:, None]
    parties = parties[parties.any(axis=1)]
    levels = levels_of_coverage(seen.points >= LEAST, parties)
    needs = np.ceil(demand.at_least * parties.sum(axis=1) - MET).astype(np.int64)
    levels, need = _same_need(levels, needs)
    found, unit = _solved(objective, progress, levels, need, seed, workers, failing=demand.failing)
    what = f"{demand.at_least:.0%} of the objects"
    if demand.parts > 1:
        what += f" in each of {len(parties)} parts of the traffic"
    if demand.failing:
        what += ", whichever sensor fails"
    return _result(objective, progress, found, unit.unit, f"covers {what}")


def _same_need(levels: Levels, needs: Int64[np.ndarray, " k"]) -> tuple[Levels, int]:
    """The same programme where every party needs the same: each has one object more, worth what it needs less."""
    need = int(needs.max())
    count = levels.known.shape[0]
    extra = len(needs)
    known = np.concatenate([levels.known, np.ones((count, extra), np.int64)], axis=1)
    threshold = np.concatenate([levels.threshold, np.zeros((1, extra), np.int64)], axis=1)
    gain = np.concatenate([levels.gain, (need - needs)[None]], axis=1)
    parties = np.concatenate([levels.parties, np.eye(extra, dtype=np.bool_)], axis=1)
    return Levels(known, threshold, gain, parties), need


def _by_surrogate(
    objective: Objective, surrogate: Surrogate, progress: Progress, demand: _Demand, seed: int, workers: int
) -> Result:
    need = math.floor(demand.at_least * GAINS)
    relaxed, unit = _solved(objective, progress, levels_of(surrogate, above=True), need, seed, workers)
    if relaxed.chosen is None and relaxed.optimal:
        return _result(objective, progress, relaxed, unit.unit, f"reaches AP {demand.at_least:g}")
    steps, asked = levels_of(surrogate, above=False), demand.at_least
    answer: list[int] | None = None
    for _ in range(TRIES):
        found, _ = _solved(objective, progress, steps, math.ceil(asked * GAINS), seed, workers)
        if found.chosen is None or progress.spent:
            break
        short = demand.at_least - objective.score(found.chosen).ap
        if short <= MET:
            answer = found.chosen
            break
        asked += max(0.002, ASKED_MORE * short)
    if answer is None:
        most = swap.search(objective, progress.budget, seed=seed, starts=2, evaluations=20_000)
        answer = list(most.best.subset) if most.best.ap >= demand.at_least - MET else None
    if answer is not None:
        answer = _pruned(objective, answer, demand.at_least)
    price = 0 if answer is None else unit.each.total(answer)
    solved = Solved(answer, price, min(relaxed.bound, price) if answer else relaxed.bound, False)
    solved = solved._replace(optimal=answer is not None and solved.bound >= price)
    return _result(objective, progress, solved, unit.unit, f"reaches AP {demand.at_least:g}")


def levels_of(surrogate: Surrogate, *, above: bool) -> Levels:
    """The steps of all classes: of their mean together, of the worst one party each."""
    parts = [(levels_of_hits(powers, model, above=above), share) for powers, model, share in surrogate.evidence()]
    worst = surrogate.classes.combine == "worst"
    objects = np.concatenate([np.full(each.known.shape[1], k) for k, (each, _) in enumerate(parts)])
    weights = [1.0 if worst else share for _, share in parts]
    known, threshold, gain = (
        np.concatenate([getattr(each, name) for each, _ in parts], axis=1) for name in ("known", "threshold", "gain")
    )
    scale = np.array(weights)[objects]
    weighed = (np.ceil if above else np.rint)(gain * scale).astype(np.int64)
    count = len(parts) if worst else 1
    parties = objects == np.arange(count)[:, None] if worst else np.ones((1, len(objects)), np.bool_)
    return Levels(known, threshold, weighed, parties)


def _solved(
    objective: Objective, progress: Progress, levels: Levels, need: int, seed: int, workers: int, *, failing: int = 0
) -> tuple[Solved, UnitPrices]:
    """The cheapest set that is worth the need, in what is left of the time."""
    prices = objective.candidates.prices
    unit = max(float(prices.max(initial=0.0)), 1e-300) / PRICE_UNITS
    each = Prices.in_units(objective, unit)
    left = max(0.1, progress.limits.seconds - progress.limits.elapsed)
    found = solve(
        levels, objective.candidates.mount, progress.budget, may_stand=objective.allowed([]), at_least=need,
        prices=each.alone, shared=each.shared, poles=Poles.of(objective), money=Prices.of(objective), seconds=left,
        workers=workers, seed=seed, failing=failing,
    )  # fmt: skip
    return found, UnitPrices(each, unit)


def _pruned(objective: Objective, chosen: list[int], at_least: float) -> list[int]:
    """The set without sensors that are not needed, or with cheaper ones in their place, as long as it gets cheaper."""
    prices = objective.candidates.prices
    while True:
        options: list[list[int]] = []
        for gone in chosen:
            rest = [c for c in chosen if c != gone]
            cheaper = objective.allowed(rest) & (prices < prices[gone] - MET)
            options += [rest, *([*rest, c] for c in np.flatnonzero(cheaper).tolist())]
        sets: Bool[np.ndarray, "n C"] = np.zeros((len(options), len(prices)), np.bool_)
        for row, members in zip(sets, options, strict=True):
            row[members] = True
        sets = sets[objective.scores(sets).ap >= at_least - MET]
        if not len(sets):
            return sorted(chosen)
        chosen = np.flatnonzero(sets[objective.price(sets).argmin()]).tolist()


def _result(objective: Objective, progress: Progress, found: Solved, unit: float, what: str) -> Result:
    """The result, and what is proven of its price."""
    bound = found.bound * unit
    if found.chosen is None:
        sure = "no set within the budget " if found.optimal else "no set was found in time that "
        return progress.result("cheapest", Certificate("none", 0.0, bound, note=f"{sure}{what}", measure="price"))
    progress.settle(sorted(found.chosen))
    price = float(objective.price(progress.best[None])[0])
    bound = price if found.optimal else min(bound, price)
    note = f"{what} for {price:g}, and no set that does costs less than {bound:g}"
    kind: Literal["optimal", "bound"] = "optimal" if found.optimal else "bound"
    return progress.result("cheapest", Certificate(kind, price, bound, 1.0 if found.optimal else 0.0, note, "price"))
