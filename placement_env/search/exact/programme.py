"""Integer programmes over sensor sets whose objects gain worth with evidence, solved by CP-SAT
(OR-Tools).

    Σ_c known[c, o] x_c >= threshold[j, o] l_jo    level j of object o is reached: gain[j, o]
    Σ_c x_c <= budget
    Σ_{c on m} x_c <= places_m
    Σ_{c on m} load_c x_c <= 1 link
    Σ_{c on m} x_c >= 1 for mounts to be kept
    Σ_c price_c x_c + Σ_m shared_m z_m <= money,   z_m >= x_c

Either the worth of the reached levels is maximal, or the set is as cheap as possible for a given
worth. With one level of threshold 1 an object is covered or not. Several levels make steps of a
hit's probability, which in a surrogate grows with the evidence Σ n_i ^ norm. With steps above the
curve the programme never gives less worth than the truth, so whatever it proves impossible is
impossible. Steps that cut the curve in the middle are close to the truth. If every pole has one
place, its price is part of the sensor's.
"""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from placement_env.feasibility import PRICE_ROUNDING_SHARE
from placement_env.fidelity.hit_model import HitModel
from placement_env.objective import Objective
from toolkit.arrays import Bool, Float, Int64

if TYPE_CHECKING:
    from ortools.sat.python.cp_model import CpModel, CpSolver, IntVar, LinearExpr

DEFAULT_SOLVER_S = 60.0  # limit of solving
LIMIT_UNITS = 1 << 40  # whole units of the highest price
LINK_UNITS = 1 << 40  # whole units of a link
EVIDENCE_UNITS = 1000  # whole units of an object's highest threshold
GAIN_UNITS = 10**6  # whole units of the worth of all objects
HIT_STEPS = (0.25, 0.5, 0.75, 0.9)  # shares of the highest probability at which a step begins
_Mask = Bool[np.ndarray, " C"]  # candidates


@dataclass(frozen=True)
class SolverLimits:
    """Limits of a solver. effort: OR-Tools' deterministic seconds, None for unlimited."""

    seconds: float = DEFAULT_SOLVER_S
    seed: int = 0
    effort: float | None = None

    def build_solver(self) -> "CpSolver":
        """Solver with one worker within these limits."""
        solver = cp_model().CpSolver()
        # its handler would stay, and end Python at the next Ctrl-C
        solver.parameters.catch_sigint_signal = False
        solver.parameters.max_time_in_seconds = self.seconds
        if self.effort is not None:
            solver.parameters.max_deterministic_time = self.effort
        solver.parameters.num_workers = 1
        solver.parameters.random_seed = self.seed
        solver.parameters.linearization_level = 2
        return solver


def run_solver(solver: "CpSolver", model: "CpModel") -> str:
    """Solve a model, stopping at Ctrl-C; return the name of the status."""
    with ThreadPoolExecutor(1) as pool:
        solving = pool.submit(solver.solve, model)
        try:
            return solver.status_name(solving.result())
        except BaseException:
            solver.stop_search()
            raise


def cp_model() -> ModuleType:
    """OR-Tools' module of the same name. Raises ImportError if it is missing."""
    try:
        from ortools.sat.python import cp_model
    except ImportError as error:
        raise ImportError("CP-SAT needs OR-Tools: pip install coview[search]") from error
    return cp_model


class Prices(NamedTuple):
    """Prices in exact whole units, rounded down; the limit is rounded up, so it excludes no valid
    set.

    Attributes:
        each: Price of each candidate, including its mount if that has one place.
        shared: Price of a mount with more places, paid once.
        mount: Mount of each candidate.
        most: Limit on the total, -1 for none.
        unit: Price of one unit.
    """

    each: Int64[np.ndarray, " C"]
    shared: Int64[np.ndarray, " C"]
    mount: Int64[np.ndarray, " C"]
    most: int
    unit: float = 1.0

    @staticmethod
    def in_units(objective: Objective, unit: float) -> "Prices":
        """Prices of an objective's candidates in units of this price."""
        candidates = objective.candidates
        has_places = candidates.places[candidates.mount] > 1
        sensor_prices = np.where(has_places, candidates.model_prices, candidates.prices)
        shared = np.where(has_places, candidates.mount_prices[candidates.mount], 0.0)
        money = objective.most_price * (1 + PRICE_ROUNDING_SHARE) / unit
        limit = -1 if math.isinf(money) else math.floor(money)
        return Prices(
            _whole(sensor_prices, unit), _whole(shared, unit), candidates.mount, limit, unit
        )

    @staticmethod
    def of(objective: Objective) -> "Prices | None":
        """Prices of an objective with a maximum price; None without one."""
        if math.isinf(objective.most_price):
            return None
        highest = float(objective.candidates.prices.max(initial=0.0))
        return Prices.in_units(objective, max(highest, objective.most_price, 1e-300) / LIMIT_UNITS)

    def select(self, candidates: Int64[np.ndarray, " k"]) -> "Prices":
        """Prices of some candidates."""
        return self._replace(
            each=self.each[candidates], shared=self.shared[candidates], mount=self.mount[candidates]
        )

    def total(self, chosen: list[int]) -> int:
        """Price of a set."""
        _, first = np.unique(self.mount[chosen], return_index=True)
        return int(self.each[chosen].sum() + self.shared[chosen][first].sum())

    def expression(
        self, model: "CpModel", built: "list[IntVar]", *, times: int = 1, plus: int = 0
    ) -> "LinearExpr":
        """Price of the built sensors, multiplied by `times`. `plus` is added for each sensor."""
        linear = cp_model().LinearExpr
        parts = [linear.weighted_sum(built, (self.each * times + plus).tolist())]
        for shared_mount in np.unique(self.mount[self.shared > 0]):
            poses = np.flatnonzero(self.mount == shared_mount).tolist()
            paid = model.new_bool_var("")
            for c in poses:
                model.add_implication(built[c], paid)
            parts.append(int(self.shared[poses[0]]) * times * paid)
        return linear.sum(parts)


class Poles(NamedTuple):
    """Places and links of the mounts.

    Attributes:
        mount: Mount of each candidate.
        places: Places of its mount.
        load: Load of the link by each candidate, in `LINK_UNITS`.
        kept: Mounts that must carry a sensor.
    """

    mount: Int64[np.ndarray, " C"]
    places: Int64[np.ndarray, " C"]
    load: Int64[np.ndarray, " C"]
    kept: tuple[int, ...] = ()

    @staticmethod
    def of(objective: Objective) -> "Poles":
        """Poles of an objective's candidates."""
        candidates = objective.candidates
        load = np.zeros(len(candidates))
        if objective.shared_links is not None:
            load = np.minimum(objective.shared_links / candidates.capacity, 2.0)
        places = candidates.places[candidates.mount]
        required = tuple(objective.kept.tolist())
        return Poles(candidates.mount, places, _whole(load, 1 / LINK_UNITS), required)

    @property
    def apart(self) -> Int64[np.ndarray, " C"]:
        """Mount of each candidate for bounds; candidates on mounts with several places count as
        separate."""
        count = int(self.mount.max(initial=-1)) + 1
        return np.where(self.places > 1, count + np.arange(len(self.mount)), self.mount)

    def select(self, candidates: Int64[np.ndarray, " k"]) -> "Poles":
        """Poles of some candidates."""
        return self._replace(
            mount=self.mount[candidates], places=self.places[candidates], load=self.load[candidates]
        )

    def constrain(self, model: "CpModel", built: "list[IntVar]") -> None:
        """Add the constraints of places and links, and of mounts that must carry a sensor."""
        linear = cp_model().LinearExpr
        for mount in self.kept:
            model.add_bool_or([built[c] for c in np.flatnonzero(self.mount == mount).tolist()])
        for mount in np.unique(self.mount):
            poses = np.flatnonzero(self.mount == mount).tolist()
            variables = [built[c] for c in poses]
            if (places := int(self.places[poses[0]])) == 1:
                model.add_at_most_one(variables)
                continue
            model.add(linear.sum(variables) <= places)
            if self.load[poses].any():
                model.add(linear.weighted_sum(variables, self.load[poses].tolist()) <= LINK_UNITS)


def _whole(figures: np.ndarray, unit: float) -> Int64[np.ndarray, " C"]:
    return np.floor(figures / unit).astype(np.int64)


class Levels(NamedTuple):
    """Levels of evidence and their worth.

    Attributes:
        known: Evidence that each candidate adds to each object, in whole numbers.
        threshold: Evidence for each level of each object.
        gain: Worth of each level of each object.
        parties: Sums of worth that an object counts in; the lowest sum counts.
    """

    known: Int64[np.ndarray, "C O"]
    threshold: Int64[np.ndarray, "J O"]
    gain: Int64[np.ndarray, "J O"]
    parties: Bool[np.ndarray, "k O"]

    def worth(self, chosen: list[int]) -> int:
        """Worth of the levels that a set reaches, for the party with the least."""
        reached = self.known[chosen].sum(axis=0) >= self.threshold
        return int((self.parties @ (self.gain * reached).sum(axis=0)).min())

    @property
    def whole(self) -> int:
        """Worth of all levels, for the party with the least."""
        return int((self.parties @ self.gain.sum(axis=0)).min())


class Solved(NamedTuple):
    """Solution of a programme.

    Attributes:
        chosen: Best set, None if no set satisfies the programme.
        figure: Its worth, or its price in whole units.
        bound: No set has more worth, or costs less.
        optimal: Whether figure and bound are equal, or it is proven that no set satisfies it.
    """

    chosen: list[int] | None
    figure: int
    bound: int
    optimal: bool


@dataclass(frozen=True, eq=False)
class Programme:
    """Integer programme over sets of at most `budget` candidates.

    Attributes:
        levels: Levels of evidence of the objects.
        budget: Largest number of sensors.
        poles: Places and links.
        may_stand: Candidates that may be built.
        money: Prices with their limit, None for no limit.
        failing: 1 for the worth that survives the failure of any one sensor, only for levels of
            threshold 1.
        lost: Cases of lost candidates, of which the lowest worth counts, for levels of any
            threshold.
    """

    levels: Levels
    budget: int
    poles: Poles
    may_stand: _Mask
    money: Prices | None = None
    failing: int = 0
    lost: list[_Mask] | None = None

    @staticmethod
    def of(objective: Objective, budget: int, levels: Levels, **cases: Any) -> "Programme":
        """Programme of an objective's candidates with their poles and prices. cases: `failing` or
        `lost`."""
        return Programme(
            levels,
            budget,
            Poles.of(objective),
            objective.allowed([]),
            Prices.of(objective),
            **cases,
        )


def levels_of_hits(powers: Float[np.ndarray, "C O"], model: HitModel, *, above: bool) -> Levels:
    """Steps of each object's hit probability.

    powers: n ^ norm of each candidate and object, without the floor; above: no step is below the
    curve, otherwise each step cuts it in the middle.
    """
    count = powers.shape[1]
    log_evidence = (np.log(1 / (1 / np.array(HIT_STEPS) - 1)) - model.intercept) / max(
        model.density, 1e-9
    )
    needed = np.expm1(np.clip(model.norm * log_evidence, 1e-12, 500.0))
    unit = needed[-1] / EVIDENCE_UNITS
    known = (np.ceil if above else np.floor)(np.minimum(powers, needed[-1]) / unit).astype(np.int64)
    edges = (np.floor if above else np.ceil)(needed / unit).astype(np.int64)
    probabilities = np.append(HIT_STEPS, 1.0) * model.ceiling
    values = (
        probabilities
        if above
        else np.concatenate([[0.0], (probabilities[1:] + probabilities[:-1]) / 2])
    )
    thresholds = np.maximum.accumulate(np.concatenate([[1], np.maximum(edges, 1)]))
    per_object = -(-GAIN_UNITS // max(1, count)) if above else GAIN_UNITS // max(1, count)
    gains = (np.ceil if above else np.rint)(np.diff(values, prepend=0.0) * per_object).astype(
        np.int64
    )
    threshold = np.repeat(thresholds[:, None], count, axis=1)
    gain = np.repeat(gains[:, None], count, axis=1)
    return Levels(known, threshold, gain, np.ones((1, count), np.bool_))


def solve(
    programme: Programme,
    limits: SolverLimits = SolverLimits(),
    *,
    at_least: int = 0,
    cost: Prices | None = None,
    start: Sequence[int] = (),
) -> Solved:
    """Set with the most worth, or with a `cost` the cheapest set with worth `at_least`, smallest
    first.

    start: an initial set.
    """
    cp = cp_model()
    model = cp.CpModel()
    levels = programme.levels
    may_stand = programme.may_stand
    budget = programme.budget
    built = [model.new_bool_var("") for _ in may_stand]
    for c in np.flatnonzero(~may_stand).tolist():
        model.add(built[c] == 0)
    programme.poles.constrain(model, built)
    model.add(cp.LinearExpr.sum(built) <= budget)
    if programme.money is not None:
        model.add(programme.money.expression(model, built) <= programme.money.most)
    if programme.failing:
        worths = _surviving(model, built, levels, may_stand)
    else:
        cases = [may_stand & ~lost_case for lost_case in programme.lost or ()] or [may_stand]
        worths = []
        for case in cases:
            worths += _reached(model, built, levels, case)
    min_worth = model.new_int_var(0, max(0, levels.whole), "") if cost is None else at_least
    for worth in worths:
        model.add(worth >= min_worth)
    if cost is None:
        model.maximize(min_worth)
    else:  # the price, and in its last digit the number of sensors
        model.minimize(cost.expression(model, built, times=budget + 1, plus=1))
    for c in start:
        model.add_hint(built[c], True)
    solver = limits.build_solver()
    status = run_solver(solver, model)
    if status not in ("OPTIMAL", "FEASIBLE"):
        lowest = int(solver.best_objective_bound) if status == "UNKNOWN" and cost is not None else 0
        return Solved(None, 0, max(0, lowest) // (budget + 1), status == "INFEASIBLE")
    members = [c for c, x in enumerate(built) if solver.boolean_value(x)]
    if cost is None:
        figure = round(solver.objective_value)
        bound = max(figure, math.floor(solver.best_objective_bound + 1e-6))
    else:
        figure = cost.total(members)
        bound = min(figure, math.ceil(solver.best_objective_bound - 1e-6) // (budget + 1))
    return Solved(members, figure, bound, bound == figure)


def _reached(
    model: "CpModel", built: "list[IntVar]", levels: Levels, may_stand: _Mask
) -> "list[LinearExpr]":
    """Worth of the reached levels for each party."""
    linear = cp_model().LinearExpr
    objects: list[int] = []
    reached: list[IntVar] = []
    gains: list[int] = []
    for number, candidate_evidence in enumerate(levels.known.T):
        seen = np.flatnonzero((candidate_evidence > 0) & may_stand).tolist()
        evidence = linear.weighted_sum([built[c] for c in seen], candidate_evidence[seen].tolist())
        for threshold, gain in zip(
            levels.threshold[:, number].tolist(), levels.gain[:, number].tolist(), strict=True
        ):
            if gain > 0 and candidate_evidence[seen].sum() >= threshold:
                level = model.new_bool_var("")
                model.add(evidence >= threshold * level)
                objects.append(number)
                reached.append(level)
                gains.append(gain)
    worths = []
    for party in levels.parties:
        rows = np.flatnonzero(party[objects]).tolist()
        worths.append(
            linear.weighted_sum([reached[row] for row in rows], [gains[row] for row in rows])
        )
    return worths


def _surviving(
    model: "CpModel", built: "list[IntVar]", levels: Levels, may_stand: _Mask
) -> "list[LinearExpr]":
    """Worth of each party that survives any one failure.

    Two sensors see the object, or one that does not fail."""
    linear = cp_model().LinearExpr
    seen_once: list[IntVar] = []
    seen_twice: list[IntVar] = []
    for candidate_evidence, threshold in zip(levels.known.T, levels.threshold[0], strict=True):
        views = linear.sum(
            [built[c] for c in np.flatnonzero((candidate_evidence > 0) & may_stand).tolist()]
        )
        for number, variables in ((1, seen_once), (2, seen_twice)):
            level = model.new_bool_var("")
            model.add(level == 1) if threshold <= 0 else model.add(views >= number * level)
            variables.append(level)
    survivors: list[LinearExpr] = []
    gain = levels.gain[0]

    def sum_gains(variables: "list[IntVar]", objects: Int64[np.ndarray, " _"]) -> "LinearExpr":
        return linear.weighted_sum([variables[o] for o in objects], gain[objects].tolist())

    for party in levels.parties:
        objects = np.flatnonzero(party)
        survived = model.new_int_var(0, int(gain[objects].sum()), "")
        total = sum_gains(seen_once, objects)
        for c in np.flatnonzero(may_stand).tolist():
            in_view = objects[levels.known[c, objects] > 0]
            lost = sum_gains(seen_once, in_view) - sum_gains(seen_twice, in_view)
            model.add(survived <= total - lost).only_enforce_if(built[c])
        model.add(survived == 0).only_enforce_if([x.negated() for x in built])
        survivors.append(survived)
    return survivors
