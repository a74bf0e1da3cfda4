"""The cheapest set that reaches an AP.

A proven bound on the price of any such set comes with it (CP-SAT).

By coverage the programme is exact. By a surrogate, AP is no sum over objects but never exceeds the recall: a set that
reaches the AP also reaches it in expected hits, and in steps above their probability. So no set is cheaper than the
cheapest one of that relaxation, which is the bound. The answer comes from steps in the middle of the curve, with a
demand that rises until the AP is reached, and is then pruned. `failing` 1 requires the AP whichever sensor fails,
`parts` in each of several consecutive parts of the traffic, and `levels` at each of several traffic levels.

A pole whose sensor fails is a separate case, in which the steps must be reached without it. Few cases bind, so they
join one after another. The answer of a programme with some of them may leave too little without another pole, which
then joins. When none is violated it answers all cases, and every bound until then is valid. Steps are never the claim:
the answer is the surrogate's own in every case of failure and share of the traffic.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from placement_env.checks import check_whole
from placement_env.fidelity.coverage import LEAST, Coverage
from placement_env.fidelity.surrogate import Surrogate
from placement_env.objective import Objective
from placement_env.search import swap
from placement_env.search.exact.cpsat import SECONDS
from placement_env.search.exact.demand import Demand, DemandFidelity
from placement_env.search.exact.poles import Poles, Prices
from placement_env.search.exact.programme import GAINS, Levels, Solved, levels_of_coverage, levels_of_hits, solve
from placement_env.search.progress import Progress
from placement_env.search.result import Certificate, Result
from toolkit.arrays import Bool, Float64, Int64

TRIES = 10  # tries with steps in the middle of the curve
ASKED_MORE = 0.5  # share of the missing AP that the next try adds to its demand
PRICE_UNITS = 1 << 30  # whole units of the highest price
BOUNDING = 0.5  # share of the time that a bound under conditions may take
MET = 1e-9  # largest effect of rounding on an AP

Reached = Callable[[Bool[np.ndarray, "n C"]], Float64[np.ndarray, " n"]]  # AP of sets under a demand


class UnitPrices(NamedTuple):
    """Prices in whole units, rounded down. It gives the value of a unit."""

    each: Prices
    unit: float


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
    levels: int = 1,
    workers: int = 1,
) -> Result:
    """The cheapest set whose AP reaches `at_least`.

    It has at most `budget` sensors; equally cheap sets are decided by fewest sensors. The certificate is of the price.
    The answer is the empty set where none reaches the AP.

    failing: 1 requires it whichever sensor of the set fails; parts, levels: number of consecutive parts of the traffic,
    or of traffic levels by the number of road users present, that must each reach it; seconds: 60 if None, of which the
    bound may take `BOUNDING` under such conditions; `evaluations` limits the search for an answer by a surrogate.
    Raises ValueError where these do not fit and for fidelities other than coverage and surrogate (early, late fusion),
    ImportError without OR-Tools.
    """
    check_whole("budget", budget, least=1)
    demand = Demand(at_least, failing, parts, levels)
    progress = Progress(objective, budget, SECONDS if seconds is None else seconds, evaluations)
    if isinstance(objective.scored_by, Coverage):
        return _by_coverage(objective, progress, demand, seed, workers)
    if not isinstance(objective.scored_by, Surrogate):
        raise ValueError(f"the cheapest set is known by --fidelity coverage or surrogate, got {objective.fidelity}")
    return _by_surrogate(objective, objective.scored_by, progress, demand, seed, workers)


def _by_coverage(objective: Objective, progress: Progress, demand: Demand, seed: int, workers: int) -> Result:
    seen = objective.visibility
    if seen is None or objective.scored_by.views != 1 or len(objective.classes.names) > 1:  # type: ignore[attr-defined]
        raise ValueError("the cheapest coverage needs to know what each candidate sees, one view and one class")
    seen = seen.of_classes(objective.classes.labels)
    shares = demand.shares(objective, seen)
    parties = np.array([np.isin(seen.frame, frames) for frames in shares]).reshape(len(shares), len(seen.frame))
    levels = levels_of_coverage(seen.points >= LEAST, parties)
    needs = np.ceil(demand.at_least * parties.sum(axis=1) - MET).astype(np.int64)
    levels, need = _same_need(levels, needs)
    found, unit = _solve(objective, progress, levels, need, seed, workers, failing=demand.failing)
    what = f"covers {demand.at_least:.0%} of the objects{demand.described(len(parties))}"
    return _result(objective, progress, found, unit.unit, what)


def _same_need(levels: Levels, needs: Int64[np.ndarray, " k"]) -> tuple[Levels, int]:
    """Same programme with equal needs for all parties.

    Each party gets one more object, worth the amount by which its need is smaller.
    """
    need = int(needs.max())
    count = levels.known.shape[0]
    extra = len(needs)
    known = np.concatenate([levels.known, np.ones((count, extra), np.int64)], axis=1)
    threshold = np.concatenate([levels.threshold, np.zeros((1, extra), np.int64)], axis=1)
    gain = np.concatenate([levels.gain, (need - needs)[None]], axis=1)
    parties = np.concatenate([levels.parties, np.eye(extra, dtype=np.bool_)], axis=1)
    return Levels(known, threshold, gain, parties), need


def _by_surrogate(
    objective: Objective, surrogate: Surrogate, progress: Progress, demand: Demand, seed: int, workers: int
) -> Result:
    shares = [surrogate] if demand.parts == demand.levels == 1 else _in_shares(objective, surrogate, demand)
    what = f"reaches AP {demand.at_least:g}{demand.described(len(shares))}"

    def reached(sets: Bool[np.ndarray, "n C"]) -> Float64[np.ndarray, " n"]:
        return objective.scores(sets).ap if demand.plain else demand.reach(shares, sets)

    lost: list[Bool[np.ndarray, " C"]] = []
    above = levels_of_shares(shares, above=True)
    need = math.floor(demand.at_least * GAINS)
    solver = (seed, workers, demand.failing)
    until = 1.0 if demand.plain else BOUNDING
    relaxed, unit = _solve_in_cases(objective, progress, above, need, solver, lost, until=until)
    if relaxed.chosen is None and relaxed.optimal:
        return _result(objective, progress, relaxed, unit.unit, what)
    steps, asked = levels_of_shares(shares, above=False), demand.at_least
    answer: list[int] | None = None
    for _ in range(TRIES):
        need = math.ceil(asked * GAINS)
        found, _ = _solve_in_cases(objective, progress, steps, need, solver, lost)
        if found.chosen is None or progress.spent:
            break
        short = demand.at_least - float(reached(objective.row(found.chosen)[None])[0])
        if short <= MET:
            answer = found.chosen
            break
        asked += max(0.002, ASKED_MORE * short)
    if answer is None:
        most = swap.search(
            _demanding(objective, shares, demand), progress.budget, seed=seed, starts=2, evaluations=20_000
        )
        chosen = list(most.best.subset)
        enough = reached(objective.row(chosen)[None])[0] >= demand.at_least - MET
        answer = chosen if chosen and enough else None
    said = ""
    if answer is not None:
        answer = _prune(objective, answer, demand.at_least, reached)
        least = float(reached(objective.row(answer)[None])[0])
        said = "" if demand.plain else f"; by the surrogate it is AP {least:.4f} in the worst case"
    price = 0 if answer is None else unit.each.total(answer)
    solved = Solved(answer, price, min(relaxed.bound, price) if answer else relaxed.bound, False)
    solved = solved._replace(optimal=answer is not None and solved.bound >= price)
    return _result(objective, progress, solved, unit.unit, what, said=said)


def _in_shares(objective: Objective, surrogate: Surrogate, demand: Demand) -> list[Surrogate]:
    """Surrogate of each share of the traffic."""
    seen = objective.visibility
    if seen is None:
        raise ValueError("parts and levels of traffic need to know what each candidate sees: pass visibility=see(...)")
    seen = seen.of_classes(objective.classes.labels)
    return [surrogate.in_frames(frames) for frames in demand.shares(objective, seen)]


def _demanding(objective: Objective, shares: Sequence[Surrogate], demand: Demand) -> Objective:
    """Objective scored under the demand."""
    if demand.plain:
        return objective
    scored_by = DemandFidelity(objective.scored_by, shares, demand)
    setting = replace(objective.setting, candidates=objective.candidates, fidelity=scored_by)
    return Objective(setting, objective.run, visibility=objective.visibility)


def _solve_in_cases(
    objective: Objective,
    progress: Progress,
    levels: Levels,
    need: int,
    solver: tuple[int, int, int],
    lost: list[Bool[np.ndarray, " C"]],
    *,
    until: float = 1.0,
) -> tuple[Solved, UnitPrices]:
    """Solve with the failure cases that bind.

    These cases join those in `lost`. solver: seed, workers, and how many fail; until: share of the time. No set is
    cheaper than the bound, even if time runs out; only a set that satisfies every case is an answer.
    """
    seed, workers, failing = solver
    bound = 0
    while True:
        found, unit = _solve(objective, progress, levels, need, seed, workers, lost=lost, until=until)
        bound = max(bound, found.bound)
        if found.chosen is None:
            return found._replace(bound=bound), unit
        chosen = found.chosen
        cases = [
            gone for gone in _failures(objective, chosen) if failing and not any((gone == each).all() for each in lost)
        ]
        missing = [gone for gone in cases if levels.worth([c for c in chosen if not gone[c]]) < need]
        if not missing:
            return found._replace(bound=min(bound, found.figure)), unit
        if progress.limits.elapsed >= until * progress.limits.seconds:
            return Solved(None, 0, bound, False), unit
        lost += missing


def _failures(objective: Objective, chosen: list[int]) -> list[Bool[np.ndarray, " C"]]:
    """Candidates lost when each sensor of a set fails.

    A failure removes all candidates of its pole where the pole carries one sensor, else the sensor alone.
    """
    mount, places = objective.candidates.mount, objective.candidates.places
    each = np.arange(len(mount))
    return [mount == mount[c] if places[mount[c]] == 1 else each == c for c in chosen]


def levels_of_shares(surrogates: Sequence[Surrogate], *, above: bool) -> Levels:
    """Steps of several surrogates of the same candidates. Each surrogate has parties of its own."""
    each = [build_levels(surrogate, above=above) for surrogate in surrogates]
    known, threshold, gain = (
        np.concatenate([getattr(one, name) for one in each], axis=1) for name in ("known", "threshold", "gain")
    )
    parties = np.zeros((sum(len(one.parties) for one in each), known.shape[1]), np.bool_)
    row = column = 0
    for one in each:
        k, objects = one.parties.shape
        parties[row : row + k, column : column + objects] = one.parties
        row, column = row + k, column + objects
    return Levels(known, threshold, gain, parties)


def build_levels(surrogate: Surrogate, *, above: bool) -> Levels:
    """Steps of all classes. The mean of classes forms one party; the worst class gives one party per class."""
    evidence = surrogate.evidence()
    parts = [levels_of_hits(powers, model, above=above) for powers, _, model, _ in evidence]
    worst = surrogate.classes.combine == "worst"
    objects = np.concatenate([np.full(each.known.shape[1], k) for k, each in enumerate(parts)])
    known, threshold, gain = (
        np.concatenate([getattr(each, name) for each in parts], axis=1) for name in ("known", "threshold", "gain")
    )
    scale = np.concatenate([of_size * (1.0 if worst else share) for _, of_size, _, share in evidence])
    weighed = (np.ceil if above else np.rint)(gain * scale).astype(np.int64)
    count = len(parts) if worst else 1
    parties = objects == np.arange(count)[:, None] if worst else np.ones((1, len(objects)), np.bool_)
    return Levels(known, threshold, weighed, parties)


def _solve(
    objective: Objective,
    progress: Progress,
    levels: Levels,
    need: int,
    seed: int,
    workers: int,
    *,
    failing: int = 0,
    lost: Sequence[Bool[np.ndarray, " C"]] = (),
    until: float = 1.0,
) -> tuple[Solved, UnitPrices]:
    """The cheapest set that meets the need. It uses the rest of a share of the time."""
    prices = objective.candidates.prices
    unit = max(float(prices.max(initial=0.0)), 1e-300) / PRICE_UNITS
    each = Prices.in_units(objective, unit)
    left = max(0.1, until * progress.limits.seconds - progress.limits.elapsed)
    found = solve(
        levels, objective.candidates.mount, progress.budget, may_stand=objective.allowed([]), at_least=need,
        prices=each.alone, shared=each.shared, poles=Poles.of(objective), money=Prices.of(objective), seconds=left,
        workers=workers, seed=seed, failing=failing, lost=lost,
    )  # fmt: skip
    return found, UnitPrices(each, unit)


def _prune(objective: Objective, chosen: list[int], at_least: float, reached: Reached) -> list[int]:
    """Drop unneeded sensors or replace them by cheaper ones. Repeats as long as the set gets cheaper."""
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
        sets = sets[reached(sets) >= at_least - MET]
        if not len(sets):
            return sorted(chosen)
        chosen = np.flatnonzero(sets[objective.price(sets).argmin()]).tolist()


def _result(
    objective: Objective, progress: Progress, found: Solved, unit: float, what: str, *, said: str = ""
) -> Result:
    """Result, and the proof about its price."""
    bound = found.bound * unit
    if found.chosen is None:
        sure = "no set within the budget " if found.optimal else "no set was found in time that "
        return progress.result("cheapest", Certificate("none", 0.0, bound, note=f"{sure}{what}", measure="price"))
    progress.settle(sorted(found.chosen))
    price = float(objective.price(progress.best[None])[0])
    bound = price if found.optimal else min(bound, price)
    note = f"{what} for {price:g}, and no set that does costs less than {bound:g}{said}"
    kind: Literal["optimal", "bound"] = "optimal" if found.optimal else "bound"
    return progress.result("cheapest", Certificate(kind, price, bound, 1.0 if found.optimal else 0.0, note, "price"))
