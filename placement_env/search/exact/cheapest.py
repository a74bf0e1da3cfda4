"""The cheapest set that reaches an AP, with a proven bound on the price of any such set (CP-SAT).

By coverage the programme is exact. By a surrogate, AP is no sum over objects but never exceeds the
recall: a set that reaches the AP also reaches it in expected hits, and in steps above their
probability. The cheapest set of that relaxation is the bound. The answer comes from steps in the
middle of the curve, with a demand that rises until the AP is reached, and is then pruned; its AP is
the surrogate's own in every case of failure and share of the traffic.

A pole whose sensor fails is a separate case, in which the steps must be reached without it. Few
cases bind, so those that an answer violates join one after another. When none is violated it
answers all cases, and every bound until then is valid."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from placement_env.cases import TIE, Cases
from placement_env.checks import check_whole
from placement_env.fidelity.coverage import LEAST, Coverage
from placement_env.fidelity.surrogate import Surrogate
from placement_env.fidelity.visibility import Visibility
from placement_env.objective import Objective
from placement_env.protocol import Estimate, Fidelity
from placement_env.search import swap
from placement_env.search.exact.programme import (
    GAINS,
    SECONDS,
    Levels,
    Prices,
    Programme,
    Solved,
    SolverLimits,
    levels_of_hits,
    solve,
)
from placement_env.search.progress import Progress, as_rows
from placement_env.search.result import Certificate, Result
from placement_env.subsets import SetFunction, Sets
from toolkit.arrays import Bool, Float64, Int64

TRIES = 10  # tries with steps in the middle of the curve
ASKED_MORE = 0.5  # share of the missing AP that the next try adds to its demand
PRICE_UNITS = 1 << 30  # whole units of the highest price
BOUNDING = 0.5  # share of the time that a bound under conditions may take
MET = 1e-9  # largest effect of rounding on an AP


@dataclass(frozen=True)
class Demand:
    """Conditions that the cheapest set must meet. Raises ValueError where these do not fit.

    at_least: AP, or share covered; failing: sensors that may fail, 0 or 1; parts, levels: number of
    consecutive parts of the traffic, or of its levels by the number of road users, that must each
    reach it."""

    at_least: float = 0.9
    failing: int = 0
    parts: int = 1
    levels: int = 1

    def __post_init__(self) -> None:
        check_whole("parts", self.parts, least=1)
        Cases(levels=self.levels)
        if not 0 < self.at_least <= 1:
            raise ValueError(
                f"the AP to be reached must lie above 0 and up to 1, got {self.at_least}: 0.9 is "
                "0.9"
            )
        if self.failing not in (0, 1):
            raise ValueError(f"0 or 1 sensor may fail here, got failing={self.failing}")
        if self.parts > 1 and self.levels > 1:
            raise ValueError(
                "an AP is asked for in parts of the traffic or at levels of it: leave one of "
                "them out"
            )

    def describe(self, shares: int) -> str:
        """The conditions in words. shares: their number."""
        what = f" in each of {shares} parts of the traffic" if self.parts > 1 else ""
        what += f" at each of {shares} levels of traffic" if self.levels > 1 else ""
        return what + (", whichever sensor fails" if self.failing else "")

    def shares(self, objective: Objective, seen: Visibility) -> list[Int64[np.ndarray, " _"]]:
        """Frames of each share of the traffic with a counted object. seen: these; they give levels
        without traffic."""
        there = np.bincount(seen.frame, minlength=seen.frames)
        found: Sequence[Int64[np.ndarray, " _"]]
        if self.levels == 1:
            part = np.arange(seen.frames) * self.parts // max(1, seen.frames)
            found = [np.flatnonzero(part == k) for k in range(self.parts)]
        elif objective.preparation is not None:
            found = objective.preparation.split(self.levels)
        else:
            found = Cases(levels=self.levels).split(there)
        return [frames for frames in found if there[frames].any()]

    def reach(self, by: Sequence[Fidelity], sets: Sets) -> Float64[np.ndarray, " n"]:
        """Least AP of each set over failures and shares; 0 if a failure leaves nothing. by:
        fidelity of each share."""
        if not len(sets):
            return np.zeros(0)
        cases = Cases(failing=self.failing)
        rows, owners = cases.expand(sets)
        return cases.over_failures(np.min([each(rows).ap for each in by], axis=0), owners, tie=0.0)


class DemandFidelity:
    """Score sets by the least AP of a demand over shares (`by`); recall and kbit are of intact sets
    in all traffic."""

    def __init__(self, whole: Fidelity, by: Sequence[Fidelity], demand: Demand) -> None:
        self._whole = whole
        self._by = tuple(by)
        self._demand = demand
        self.name = whole.name

    def __call__(self, subsets: Sets, /) -> Estimate:
        """Least AP of each set. A trace of the intact set's AP separates equal ones."""
        intact = self._whole(subsets)
        return intact._replace(ap=self._demand.reach(self._by, subsets) + TIE * intact.ap)


def search(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    demand: Demand = Demand(),
    effort: float | None = None,
) -> Result:
    """The cheapest set of at most `budget` sensors that meets a demand; the certificate is of the
    price.

    Fewest sensors decide among equally cheap sets; the empty set answers where none meets it.
    seconds: 60 if None, of which the bound may take `BOUNDING` under conditions; evaluations: of
    the search for an answer by a surrogate; effort: OR-Tools' deterministic seconds of each
    programme, None for unlimited. Raises ValueError for fidelities other than coverage and
    surrogate (early, late fusion), ImportError without OR-Tools."""
    progress = Progress(objective, budget, SECONDS if seconds is None else seconds, evaluations)
    prices = Prices.in_units(
        objective, max(float(objective.candidates.prices.max(initial=0.0)), 1e-300) / PRICE_UNITS
    )
    if isinstance(objective.scored_by, Coverage):
        return _by_coverage(
            progress, objective.scored_by, prices, demand, SolverLimits(seed=seed, effort=effort)
        )
    if not isinstance(objective.scored_by, Surrogate):
        raise ValueError(
            "the cheapest set is known by --fidelity coverage or surrogate, got "
            f"{objective.fidelity}"
        )
    return _by_surrogate(
        progress, objective.scored_by, prices, demand, SolverLimits(seed=seed, effort=effort)
    )


def _by_coverage(
    progress: Progress, cover: Coverage, prices: Prices, demand: Demand, limits: SolverLimits
) -> Result:
    objective = progress.objective
    if objective.visibility is None or cover.views != 1 or len(objective.classes.names) > 1:
        raise ValueError(
            "the cheapest coverage needs to know what each candidate sees, one view and one class"
        )
    seen = objective.visibility.of_classes(objective.classes.labels)
    shares = demand.shares(objective, seen)
    parties = np.array([np.isin(seen.frame, frames) for frames in shares]).reshape(
        len(shares), len(seen.frame)
    )
    needs = np.ceil(demand.at_least * parties.sum(axis=1) - MET).astype(np.int64)
    # equal needs: each party gets one more object, seen by all and worth the amount by which its
    # need is smaller
    known = np.pad(
        (seen.points >= LEAST).astype(np.int64), ((0, 0), (0, len(needs))), constant_values=1
    )
    threshold = np.pad(np.ones((1, len(seen.frame)), np.int64), ((0, 0), (0, len(needs))))
    gain = np.append(threshold[0, : len(seen.frame)], needs.max() - needs)[None]
    levels = Levels(
        known, threshold, gain, np.hstack([parties, np.eye(len(needs), dtype=np.bool_)])
    )
    programme = Programme.of(objective, progress.budget, levels, failing=demand.failing)
    found = _solve(progress, programme, int(needs.max()), prices, limits)
    what = f"covers {demand.at_least:.0%} of the objects{demand.describe(len(parties))}"
    return _result(progress, found, prices.unit, what)


def _by_surrogate(
    progress: Progress, surrogate: Surrogate, prices: Prices, demand: Demand, limits: SolverLimits
) -> Result:
    objective = progress.objective
    shares = [surrogate]
    plain = demand == Demand(demand.at_least)
    if max(demand.parts, demand.levels) > 1:
        if objective.visibility is None:
            raise ValueError(
                "parts and levels of traffic need to know what candidates see: pass "
                "visibility=see(...)"
            )
        seen = objective.visibility.of_classes(objective.classes.labels)
        shares = [surrogate.in_frames(frames) for frames in demand.shares(objective, seen)]

    def reached(sets: Sets) -> Float64[np.ndarray, " n"]:
        return objective.scores(sets).ap if plain else demand.reach(shares, sets)

    def reach(chosen: list[int]) -> float:
        return float(reached(objective.row(chosen)[None])[0])

    what = f"reaches AP {demand.at_least:g}{demand.describe(len(shares))}"
    lost: list[Bool[np.ndarray, " C"]] | None = [] if demand.failing else None
    levels = (
        join_levels([build_levels(share, above=each) for share in shares]) for each in (True, False)
    )
    above, steps = (Programme.of(objective, progress.budget, each, lost=lost) for each in levels)
    need = math.floor(demand.at_least * GAINS)
    until = 1.0 if plain else BOUNDING
    relaxed = _solve(progress, above, need, prices, limits, until)
    if relaxed.chosen is None and relaxed.optimal:
        return _result(progress, relaxed, prices.unit, what)
    asked = demand.at_least
    answer: list[int] | None = None
    for _ in range(TRIES):
        found = _solve(progress, steps, math.ceil(asked * GAINS), prices, limits)
        if found.chosen is None or progress.spent:
            break
        short = demand.at_least - reach(found.chosen)
        if short <= MET:
            answer = found.chosen
            break
        asked += max(0.002, ASKED_MORE * short)
    if answer is None:
        scored = objective
        if not plain:
            scored_by = DemandFidelity(surrogate, shares, demand)
            setting = replace(
                objective.setting, candidates=objective.candidates, fidelity=scored_by
            )
            scored = Objective(setting, objective.run, visibility=objective.visibility)
        chosen = list(
            swap.search(
                scored, progress.budget, seed=limits.seed, starts=2, evaluations=20_000
            ).best.subset
        )
        answer = chosen if chosen and reach(chosen) >= demand.at_least - MET else None
    if answer is None:
        return _result(progress, Solved(None, 0, relaxed.bound, False), prices.unit, what)
    answer = _prune(objective, answer, demand.at_least, reached)
    said = "" if plain else f"; by the surrogate it is AP {reach(answer):.4f} in the worst case"
    price = prices.total(answer)
    solved = Solved(answer, price, min(relaxed.bound, price), relaxed.bound >= price)
    return _result(progress, solved, prices.unit, what, said)


def _solve(
    progress: Progress,
    programme: Programme,
    need: int,
    prices: Prices,
    limits: SolverLimits,
    until: float = 1.0,
) -> Solved:
    """The cheapest set that meets the need, in the rest of a share of the time, in all cases that
    may be `lost`. Those that bind join them. No set is cheaper than the bound, even if time runs
    out before a set satisfies all cases."""
    mount = progress.objective.candidates.mount
    bound = 0
    # a failing sensor takes all candidates of such a pole
    alone = progress.objective.candidates.places[mount] == 1
    while True:
        left = max(0.1, until * progress.limits.seconds - progress.limits.elapsed)
        found = solve(programme, replace(limits, seconds=left), at_least=need, cost=prices)
        bound = max(bound, found.bound)
        if found.chosen is None:
            return found._replace(bound=bound)
        missing = []
        for c in found.chosen if programme.lost is not None else ():
            gone = mount == mount[c] if alone[c] else np.arange(len(mount)) == c
            known = any((gone == each).all() for each in programme.lost or ())
            if (
                not known
                and programme.levels.worth([other for other in found.chosen if not gone[other]])
                < need
            ):
                missing.append(gone)
        if programme.lost is None or not missing:
            return found._replace(bound=min(bound, found.figure))
        if progress.limits.elapsed >= until * progress.limits.seconds:
            return Solved(None, 0, bound, False)
        programme.lost.extend(missing)


def join_levels(parts: Sequence[Levels]) -> Levels:
    """Levels of the objects of several programmes over the same candidates. The parties of each
    stay apart."""
    known, threshold, gain, parties = zip(*parts, strict=True)
    joined, least, worth = (np.concatenate(each, axis=1) for each in (known, threshold, gain))
    return Levels(joined, least, worth, block_diag(*parties))


def build_levels(surrogate: Surrogate, *, above: bool) -> Levels:
    """Steps of all classes. The mean of classes forms one party; the worst class gives one party
    per class."""
    evidence = surrogate.evidence()
    levels = join_levels(
        [levels_of_hits(powers, model, above=above) for powers, _, model, _ in evidence]
    )
    worst = surrogate.classes.combine == "worst"
    scale = np.concatenate(
        [of_size * (1.0 if worst else share) for _, of_size, _, share in evidence]
    )
    gain = (np.ceil if above else np.rint)(levels.gain * scale).astype(np.int64)
    return levels._replace(
        gain=gain, parties=levels.parties if worst else np.ones((1, len(scale)), np.bool_)
    )


def _prune(
    objective: Objective, chosen: list[int], at_least: float, reached: SetFunction
) -> list[int]:
    """Drop unneeded sensors or replace them by cheaper ones, as long as the set gets cheaper."""
    prices = objective.candidates.prices
    while True:
        options: list[list[int]] = []
        for gone in chosen:
            rest = [c for c in chosen if c != gone]
            cheaper = objective.allowed(rest) & (prices < prices[gone] - MET)
            options += [rest, *([*rest, c] for c in np.flatnonzero(cheaper).tolist())]
        sets = as_rows(options, len(prices))
        sets = sets[objective.keeps(sets) & (reached(sets) >= at_least - MET)]
        if not len(sets):
            return sorted(chosen)
        chosen = np.flatnonzero(sets[objective.price(sets).argmin()]).tolist()


def _result(progress: Progress, found: Solved, unit: float, what: str, said: str = "") -> Result:
    bound = found.bound * unit
    if found.chosen is None:
        sure = "no set within the budget " if found.optimal else "no set was found in time that "
        return progress.result(
            "cheapest", Certificate("none", 0.0, bound, note=f"{sure}{what}", measure="price")
        )
    progress.settle(sorted(found.chosen))
    price = float(progress.objective.price(progress.best[None])[0])
    bound = price if found.optimal else min(bound, price)
    note = f"{what} for {price:g}, and no set that does costs less than {bound:g}{said}"
    return progress.result("cheapest", Certificate.from_bound(price, bound, note, "price"))
