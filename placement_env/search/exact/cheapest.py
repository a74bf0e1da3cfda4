"""Cheapest set that reaches an AP, with a proven bound on the price of any such set (CP-SAT).

For coverage the programme is exact. For a surrogate, AP is not a sum over objects, but it never
exceeds the recall: a set that reaches the AP also reaches it in expected hits, and in steps above
their probability. The cheapest set of this relaxation is the bound. The answer comes from steps in
the middle of the curve, with a demand that rises until the AP is reached, and is then pruned. Its
AP is the surrogate's in every case of failure and share of the traffic.

A pole whose sensor fails is a separate case, in which the steps must be reached without it. Few
cases bind, so cases that an answer violates are added one after another. An answer that violates
none satisfies all cases, and every bound until then is valid.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from placement_env.cases import TIE_SHARE, Cases
from placement_env.checks import check_whole
from placement_env.fidelity.coverage import LEAST, Coverage
from placement_env.fidelity.surrogate import Surrogate
from placement_env.fidelity.visibility import Visibility
from placement_env.objective import Objective
from placement_env.protocol import Estimate, Fidelity
from placement_env.search import swap
from placement_env.search.exact.programme import (
    DEFAULT_SOLVER_S,
    GAIN_UNITS,
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

MAX_TRIES = 10  # tries with steps in the middle of the curve
DEMAND_STEP_SHARE = 0.5  # share of the missing AP that the next try adds to its demand
PRICE_UNITS = 1 << 30  # whole units of the highest price
BOUND_TIME_SHARE = 0.5  # share of the time that a bound may take if there are conditions
ROUNDING_AP = 1e-9  # largest effect of rounding


@dataclass(frozen=True)
class Demand:
    """AP that the cheapest set must reach, and the conditions under which it must.

    Raises ValueError if they do not fit.

    Attributes:
        at_least: AP, or covered share.
        failing: Number of sensors that may fail, 0 or 1.
        parts: Number of consecutive parts of the traffic that must each reach `at_least`.
        levels: Number of levels of traffic, by road users, that must each reach it.
    """

    at_least: float = 0.9
    failing: int = 0
    parts: int = 1
    levels: int = 1

    def __post_init__(self) -> None:
        """Raise ValueError if the fields do not fit."""
        check_whole("parts", self.parts, least=1)
        Cases(levels=self.levels)  # checks the number of levels of traffic
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
        """Describe the conditions in words that continue a sentence, empty without any.

        shares: Number of parts or levels of traffic that have an object."""
        conditions = f" in each of {shares} parts of the traffic" if self.parts > 1 else ""
        conditions += f" at each of {shares} levels of traffic" if self.levels > 1 else ""
        return conditions + (", whichever sensor fails" if self.failing else "")

    def shares(self, objective: Objective, seen: Visibility) -> list[Int64[np.ndarray, " _"]]:
        """Indices of the frames of each part, or each level, of the traffic.

        Shares without a counted object are left out. Without conditions all frames are one share.

        Args:
            objective: Objective whose preparation splits the frames into levels of traffic.
            seen: Visibility of the counted objects, with the frame of each. Without a preparation
                the number of objects in each frame gives the levels.
        """
        object_counts = np.bincount(seen.frame, minlength=seen.frames)  # in each frame
        shares: Sequence[Int64[np.ndarray, " _"]]
        if self.levels == 1:
            # consecutive parts that are equally long up to rounding
            part_of_frame = np.arange(seen.frames) * self.parts // max(1, seen.frames)
            shares = [np.flatnonzero(part_of_frame == part) for part in range(self.parts)]
        elif objective.preparation is not None:
            shares = objective.preparation.split(self.levels)
        else:
            shares = Cases(levels=self.levels).split(object_counts)
        return [frames for frames in shares if object_counts[frames].any()]

    def find_lowest_ap(
        self, fidelities: Sequence[Fidelity], sets: Sets
    ) -> Float64[np.ndarray, " n"]:
        """Lowest AP of each set over failures and shares of the traffic.

        It is 0 if a failure leaves no sensor.

        Args:
            fidelities: Scorer of sets in each share of the traffic.
            sets: n sets as rows of booleans.
        """
        if not len(sets):
            return np.zeros(0)
        cases = Cases(failing=self.failing)
        # the sets, and each set without one of its sensors; `owners`: index of the set of each row
        rows, owners = cases.expand(sets)
        row_ap = np.min([fidelity(rows).ap for fidelity in fidelities], axis=0)
        return cases.over_failures(row_ap, owners, tie=0.0)


class DemandFidelity:
    """Score sets by the lowest AP over the failures and shares of a demand.

    Recall and kbit are for intact sets in all frames.

    Args:
        whole: Scorer of sets in all frames.
        fidelities: Scorer of sets in each share of the traffic.
        demand: Demand with the failures."""

    def __init__(self, whole: Fidelity, fidelities: Sequence[Fidelity], demand: Demand) -> None:
        self._whole_fidelity = whole
        self._share_fidelities = tuple(fidelities)
        self._demand = demand
        self.name = whole.name

    def __call__(self, subsets: Sets, /) -> Estimate:
        """Lowest AP of each set; `TIE_SHARE` of the intact set's AP is added to separate equals."""
        intact = self._whole_fidelity(subsets)
        lowest_ap = self._demand.find_lowest_ap(self._share_fidelities, subsets)
        return intact._replace(ap=lowest_ap + TIE_SHARE * intact.ap)


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
    """Cheapest set of sensors that meets a demand, with a certificate of its price.

    Of equally cheap sets the one with the fewest sensors is chosen; the empty set means that no set
    that meets the demand exists, or none was found in time. The note of the certificate names the
    reason.

    Args:
        objective: Candidates, their prices, and the fidelity that scores sets.
        budget: Largest number of sensors.
        seed: Seed of the solver and of a search by swaps.
        seconds: Limit of the search, 60 if None; if there are conditions, the bound may take
            the share `BOUND_TIME_SHARE`.
        evaluations: Limit on scored sets in the search for an answer by a surrogate, None for none.
        demand: AP, or share of covered objects, to be reached, and conditions.
        effort: Limit of each programme in OR-Tools' deterministic seconds, None for none.

    Raises ValueError for fidelities other than coverage and surrogate (early, late fusion),
    ImportError without OR-Tools.
    """
    progress = Progress(
        objective,
        budget,
        seconds=DEFAULT_SOLVER_S if seconds is None else seconds,
        evaluations=evaluations,
    )
    prices = Prices.in_units(
        objective, max(float(objective.candidates.prices.max(initial=0.0)), 1e-300) / PRICE_UNITS
    )
    limits = SolverLimits(seed=seed, effort=effort)
    if isinstance(objective.scored_by, Coverage):
        return _search_coverage(
            progress, cover=objective.scored_by, prices=prices, demand=demand, limits=limits
        )
    if not isinstance(objective.scored_by, Surrogate):
        raise ValueError(
            "the cheapest set is known by --fidelity coverage or surrogate, got "
            f"{objective.fidelity}"
        )
    return _search_surrogate(
        progress, surrogate=objective.scored_by, prices=prices, demand=demand, limits=limits
    )


def _search_coverage(
    progress: Progress, cover: Coverage, prices: Prices, demand: Demand, limits: SolverLimits
) -> Result:
    """Cheapest set that covers a share of the objects, by one exact programme.

    Each share of the traffic (part or level) is a group of `Levels`, which needs a number of
    covered objects. To make the needs equal, each share gets one more object that all candidates
    see; its gain is the amount by which the share's need is smaller than the largest.

    Args:
        progress: Objective, budget and time of the search.
        cover: Coverage by which the objective scores sets.
        prices: Prices that are minimised.
        demand: Share of objects to be covered, and conditions.
        limits: Seed and effort of the solver."""
    objective = progress.objective
    if objective.visibility is None or cover.views != 1 or len(objective.classes.names) > 1:
        raise ValueError(
            "the cheapest coverage needs to know what each candidate sees, one view and one class"
        )
    seen = objective.visibility.of_classes(objective.classes.labels)
    shares = demand.shares(objective, seen)
    object_count = len(seen.frame)
    in_share = [np.isin(seen.frame, frames) for frames in shares]
    share_rows = np.array(in_share).reshape(len(shares), object_count)
    needs = np.ceil(demand.at_least * share_rows.sum(axis=1) - ROUNDING_AP).astype(np.int64)
    # one object for each share follows the others: all see it, and it needs no view
    added_objects = ((0, 0), (0, len(needs)))
    sees = np.pad((seen.points >= LEAST).astype(np.int64), added_objects, constant_values=1)
    threshold = np.pad(np.ones((1, object_count), np.int64), added_objects)
    gain = np.append(threshold[0, :object_count], needs.max() - needs)[None]
    levels = Levels(
        evidence=sees,
        threshold=threshold,
        gain=gain,
        groups=np.hstack([share_rows, np.eye(len(needs), dtype=np.bool_)]),
    )
    programme = Programme.from_objective(objective, progress.budget, levels, failing=demand.failing)
    solution = _solve(progress, programme, need=int(needs.max()), prices=prices, limits=limits)
    condition = f"covers {demand.at_least:.0%} of the objects{demand.describe(len(share_rows))}"
    return _build_result(progress, solution, prices.unit, condition)


def _search_surrogate(
    progress: Progress, surrogate: Surrogate, prices: Prices, demand: Demand, limits: SolverLimits
) -> Result:
    """Cheapest set that reaches an AP by a surrogate.

    The bound on the price comes from steps above the surrogate's curve, the set from steps in its
    middle or from swaps; it is then pruned."""
    objective = progress.objective
    shares = [surrogate]  # the surrogate in each share of the traffic
    has_conditions = demand != Demand(demand.at_least)
    if max(demand.parts, demand.levels) > 1:
        if objective.visibility is None:
            raise ValueError(
                "parts and levels of traffic need to know what candidates see: pass "
                "visibility=see(...)"
            )
        seen = objective.visibility.of_classes(objective.classes.labels)
        shares = [surrogate.in_frames(frames) for frames in demand.shares(objective, seen)]

    def score_ap(sets: Sets) -> Float64[np.ndarray, " n"]:
        """AP of each set; the lowest over failures and shares if the demand has conditions."""
        return demand.find_lowest_ap(shares, sets) if has_conditions else objective.scores(sets).ap

    condition = f"reaches AP {demand.at_least:g}{demand.describe(len(shares))}"
    # both programmes share this list, and `_solve` extends it in place
    lost_cases: list[Bool[np.ndarray, " candidates"]] | None = [] if demand.failing else None
    above = join_levels([build_levels(share, above=True) for share in shares])
    middle = join_levels([build_levels(share, above=False) for share in shares])
    relaxation = Programme.from_objective(objective, progress.budget, above, lost_cases=lost_cases)
    programme = Programme.from_objective(objective, progress.budget, middle, lost_cases=lost_cases)
    need = math.floor(demand.at_least * GAIN_UNITS)
    time_share = BOUND_TIME_SHARE if has_conditions else 1.0
    relaxed = _solve(progress, relaxation, need, prices, limits, time_share=time_share)
    if relaxed.members is None and relaxed.optimal:
        return _build_result(progress, relaxed, prices.unit, condition)
    answer = _raise_demand(progress, programme, prices, limits, demand.at_least, score_ap)
    if answer is None:
        search_objective = objective
        if has_conditions:
            scored_by = DemandFidelity(surrogate, shares, demand)
            setting = replace(
                objective.setting, candidates=objective.candidates, fidelity=scored_by
            )
            search_objective = Objective(setting, objective.run, visibility=objective.visibility)
        swapped = swap.search(
            search_objective, progress.budget, seed=limits.seed, starts=2, evaluations=20_000
        )
        members = list(swapped.best.subset)
        if members and _score_one(objective, score_ap, members) >= demand.at_least - ROUNDING_AP:
            answer = members
    if answer is None:
        unsolved = Solved(members=None, value=0, bound=relaxed.bound, optimal=False)
        return _build_result(progress, unsolved, prices.unit, condition)
    answer = _prune(objective, members=answer, at_least=demand.at_least, score_ap=score_ap)
    remark = ""
    if has_conditions:
        worst_ap = _score_one(objective, score_ap, answer)
        remark = f"; by the surrogate it is AP {worst_ap:.4f} in the worst case"
    price = prices.total(answer)
    bound = min(relaxed.bound, price)
    solved = Solved(members=answer, value=price, bound=bound, optimal=relaxed.bound >= price)
    return _build_result(progress, solved, prices.unit, condition, remark)


def _raise_demand(
    progress: Progress,
    programme: Programme,
    prices: Prices,
    limits: SolverLimits,
    at_least: float,
    score_ap: SetFunction,
) -> list[int] | None:
    """Cheapest set of a programme that reaches an AP, found with a rising demand.

    The programme only approximates the AP. So what it demands of a set rises by a share of the AP
    that is still missing, until the AP is reached.

    Args:
        progress: Objective and limits of the search.
        programme: Programme that approximates the AP, in `GAIN_UNITS`.
        prices: Prices that are minimised.
        limits: Limits of the solver in each try.
        at_least: AP that the set must reach.
        score_ap: Returns the true AP of sets, given as rows of booleans.

    Returns:
        Indices of candidates; None if the programme has no such set, or the tries or the time run
        out."""
    demanded_ap = at_least
    for _ in range(MAX_TRIES):
        need = math.ceil(demanded_ap * GAIN_UNITS)
        solution = _solve(progress, programme, need, prices, limits)
        if solution.members is None or progress.spent:
            return None
        missing_ap = at_least - _score_one(progress.objective, score_ap, solution.members)
        if missing_ap <= ROUNDING_AP:
            return solution.members
        # 0.002: few tries for a tiny lack
        demanded_ap += max(0.002, DEMAND_STEP_SHARE * missing_ap)
    return None


def _score_one(objective: Objective, score_ap: SetFunction, members: list[int]) -> float:
    """AP of one set (indices of candidates)."""
    return float(score_ap(objective.row(members)[None])[0])


def _solve(
    progress: Progress,
    programme: Programme,
    need: int,
    prices: Prices,
    limits: SolverLimits,
    time_share: float = 1.0,
) -> Solved:
    """Cheapest set whose worth meets a need, and a price below which no such set exists.

    If `programme.lost_cases` is a list, the set must meet the need after the failure of any sensor
    too. The programme is then solved again and again: cases of failure that an answer violates are
    added to the list in place. The bound holds even if time runs out before a set satisfies all
    cases.

    Args:
        progress: Objective and time of the search.
        programme: Candidates, constraints and levels.
        need: Worth that a set must have, in whole units.
        prices: Prices that are minimised.
        limits: Seed and effort of the solver; its seconds are replaced.
        time_share: Share of the whole search's time at which this must end."""
    bound = 0
    while True:
        # 0.1 s: the solver gets a little time even after the end
        remaining_s = max(0.1, time_share * progress.limits.seconds - progress.limits.elapsed)
        timed_limits = replace(limits, seconds=remaining_s)
        solution = solve(programme, timed_limits, at_least=need, cost=prices)
        bound = max(bound, solution.bound)
        if solution.members is None:
            return solution._replace(bound=bound)
        violated = _list_violated(progress, programme, solution.members, need)
        if programme.lost_cases is None or not violated:
            return solution._replace(bound=min(bound, solution.value))
        if progress.limits.elapsed >= time_share * progress.limits.seconds:
            return Solved(members=None, value=0, bound=bound, optimal=False)
        programme.lost_cases.extend(violated)


def _list_violated(
    progress: Progress, programme: Programme, members: list[int], need: int
) -> list[Bool[np.ndarray, " candidates"]]:
    """Failures of one sensor after which a set does not meet the need.

    Each failure is a mask of the candidates that are lost with the sensor. Failures that are in
    `programme.lost_cases` already are left out; the list is empty if that is None.

    Args:
        progress: Objective with the candidates.
        programme: Worth of sets, and the failures that its answers consider already.
        members: Set, as indices of candidates.
        need: Worth that the remaining set must have, in whole units."""
    if programme.lost_cases is None:
        return []
    candidates = progress.objective.candidates
    mount = candidates.mount
    has_one_place = candidates.places[mount] == 1
    violated_cases = []
    for failed in members:
        if has_one_place[failed]:
            # any candidate of this pole would fail alike, and at most one is built
            is_lost = mount == mount[failed]
        else:
            is_lost = np.arange(len(mount)) == failed
        if any((is_lost == case).all() for case in programme.lost_cases):
            continue
        remaining = [member for member in members if not is_lost[member]]
        if programme.levels.worth(remaining) < need:
            violated_cases.append(is_lost)
    return violated_cases


def join_levels(parts: Sequence[Levels]) -> Levels:
    """Join levels of evidence on several parts of the objects, seen by the same candidates.

    The objects of the result, on the second axis of all arrays, follow part after part. A part is,
    for instance, the objects of one class; all parts have the same number of levels of evidence.
    The groups of each part stay groups of the result, which hold no object of another part."""
    return Levels(
        evidence=np.concatenate([part.evidence for part in parts], axis=1),
        threshold=np.concatenate([part.threshold for part in parts], axis=1),
        gain=np.concatenate([part.gain for part in parts], axis=1),
        groups=block_diag(*[part.groups for part in parts]),
    )


def build_levels(surrogate: Surrogate, *, above: bool) -> Levels:
    """Steps of the hit probability of all objects of a surrogate, for the exact solver.

    With the evidence on an object (points of all sensors, as powers) its probability to be detected
    rises along a curve, which steps approximate. Objects follow class after class. Gains include
    the size of an object and, for the mean of classes, the weight of its class. The worth of a set
    is the sum over all objects for the mean of classes, and over the class with the lowest sum for
    the worst class (`Levels.groups`).

    Args:
        surrogate: Surrogate with the evidence of each candidate on each object.
        above: True for steps nowhere below the curve, False for steps that cut it in the middle."""
    is_worst = surrogate.classes.combine == "worst"
    class_levels = []
    class_factors = []  # factors on the gains of a class's objects
    # for each class: evidence (candidates × objects), factor for the size of each object, model of
    # the hit probability, and weight
    for powers, size_factor, model, weight in surrogate.evidence():
        class_levels.append(levels_of_hits(powers, model, above=above))
        class_factors.append(size_factor * (1.0 if is_worst else weight))
    levels = join_levels(class_levels)
    object_factor = np.concatenate(class_factors)
    round_gain = np.ceil if above else np.rint  # up, so that steps stay above the curve
    gain = round_gain(levels.gain * object_factor).astype(np.int64)
    one_group = np.ones((1, len(object_factor)), np.bool_)
    return levels._replace(gain=gain, groups=levels.groups if is_worst else one_group)


def _prune(
    objective: Objective, members: list[int], at_least: float, score_ap: SetFunction
) -> list[int]:
    """Set after dropping unneeded sensors, or replacing them by cheaper ones, at a sufficient AP.

    In each round the cheapest of all such changes of one sensor is made.

    Args:
        objective: Candidates, prices and mounts that must carry a sensor.
        members: Set to begin with, as indices of candidates.
        at_least: AP that every set must reach.
        score_ap: Returns the AP of sets, given as rows of booleans.

    Returns:
        Indices of candidates, ascending."""
    prices = objective.candidates.prices
    while True:
        options: list[list[int]] = []  # sets after a change of one sensor
        for dropped in members:
            remaining = [c for c in members if c != dropped]
            # candidates that may join the remaining ones, for less than the dropped one costs
            is_cheaper = objective.allowed(remaining) & (prices < prices[dropped] - ROUNDING_AP)
            options.append(remaining)
            options += [[*remaining, c] for c in np.flatnonzero(is_cheaper).tolist()]
        sets = as_rows(options, len(prices))
        # `keeps`: mounts that must carry a sensor still do
        sets = sets[objective.keeps(sets) & (score_ap(sets) >= at_least - ROUNDING_AP)]
        if not len(sets):
            return sorted(members)
        cheapest_set = sets[objective.price(sets).argmin()]
        members = np.flatnonzero(cheapest_set).tolist()


def _build_result(
    progress: Progress, solution: Solved, unit: float, condition: str, remark: str = ""
) -> Result:
    """Result of the search, with a certificate of the price.

    Args:
        progress: Progress of the search; the set becomes its best.
        solution: Set and lowest possible price in whole units, or no set.
        unit: Price of one whole unit.
        condition: Condition that the set meets, for the note, such as "reaches AP 0.9".
        remark: Text after the note."""
    bound = solution.bound * unit
    if solution.members is None:
        claim = (
            "no set within the budget " if solution.optimal else "no set was found in time that "
        )
        no_set = Certificate(
            kind="none", value=0.0, bound=bound, note=f"{claim}{condition}", measure="price"
        )
        return progress.result("cheapest", no_set)
    progress.settle(sorted(solution.members))
    # the best set as the only row of an array of sets, and its price
    price = float(progress.objective.price(progress.best[None])[0])
    bound = price if solution.optimal else min(bound, price)
    note = f"{condition} for {price:g}, and no set that does costs less than {bound:g}{remark}"
    certificate = Certificate.from_bound(price, bound, note, measure="price")
    return progress.result("cheapest", certificate)
