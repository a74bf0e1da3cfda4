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
_Mask = Bool[np.ndarray, " candidates"]  # candidates


@dataclass(frozen=True)
class SolverLimits:
    """Limits of one run of CP-SAT.

    The same seed gives the same answer as long as the seconds do not stop the solver."""

    seconds: float = DEFAULT_SOLVER_S  # by the clock
    seed: int = 0
    effort: float | None = None  # OR-Tools' deterministic seconds, None for unlimited

    def build_solver(self) -> "CpSolver":
        """Make a CP-SAT solver with one worker, this seed and these limits.

        Raises ImportError without OR-Tools."""
        solver = load_cp_model().CpSolver()
        # the solver's signal handler would remain after it, and end Python at the next Ctrl-C
        solver.parameters.catch_sigint_signal = False
        solver.parameters.max_time_in_seconds = self.seconds  # by the clock
        if self.effort is not None:
            solver.parameters.max_deterministic_time = self.effort  # the same on every machine
        solver.parameters.num_workers = 1  # several workers would not repeat their answer
        solver.parameters.random_seed = self.seed
        solver.parameters.linearization_level = 2  # all constraints also as linear relaxations
        return solver


def run_solver(solver: "CpSolver", model: "CpModel") -> str:
    """Solve a model, stopping at Ctrl-C; return OR-Tools' name of the status, such as "OPTIMAL".

    The solver runs in a second thread, so that this one can catch the interrupt. The solution can
    then be read from the solver."""
    with ThreadPoolExecutor(max_workers=1) as pool:
        solving = pool.submit(solver.solve, model)
        try:
            return solver.status_name(solving.result())
        except BaseException:  # KeyboardInterrupt too; the pool waits until the solver has stopped
            solver.stop_search()
            raise


def load_cp_model() -> ModuleType:
    """Import OR-Tools' module `cp_model`. Raises ImportError if OR-Tools is missing."""
    try:
        from ortools.sat.python import cp_model
    except ImportError as error:
        raise ImportError("CP-SAT needs OR-Tools: pip install coview[search]") from error
    return cp_model


class Prices(NamedTuple):
    """Prices of candidates in whole units, as an integer programme needs them.

    Prices are rounded down. The limit is raised by `PRICE_ROUNDING_SHARE` and rounded down, which
    excludes no valid set, as totals are whole.

    Attributes:
        sensor: Price of each candidate, including its mount if that has one place.
        per_mount: Price of each candidate's mount, which sensors on it pay once; 0 for a mount
            with one place.
        mount: Index of each candidate's mount.
        limit: Limit on the total, -1 for none.
        unit: Price of one unit in the candidates' currency.
    """

    sensor: Int64[np.ndarray, " candidates"]
    per_mount: Int64[np.ndarray, " candidates"]
    mount: Int64[np.ndarray, " candidates"]
    limit: int
    unit: float = 1.0

    @staticmethod
    def in_units(objective: Objective, unit: float) -> "Prices":
        """Prices of an objective's candidates and its maximum price, as whole numbers of a unit.

        A mount with one place is part of its sensor's price. A mount with several places is priced
        separately, as its sensors pay it once together.

        unit: price of one unit, in the candidates' currency."""
        candidates = objective.candidates
        has_several_places = candidates.places[candidates.mount] > 1
        sensor_prices = np.where(has_several_places, candidates.model_prices, candidates.prices)
        mount_prices = candidates.mount_prices[candidates.mount]
        shared_prices = np.where(has_several_places, mount_prices, 0.0)
        max_units = objective.most_price * (1 + PRICE_ROUNDING_SHARE) / unit
        return Prices(
            sensor=_round_down(sensor_prices, unit),
            per_mount=_round_down(shared_prices, unit),
            mount=candidates.mount,
            limit=-1 if math.isinf(max_units) else math.floor(max_units),
            unit=unit,
        )

    @staticmethod
    def from_objective(objective: Objective) -> "Prices | None":
        """Prices in whole units for an objective with a maximum price; None without a maximum.

        The unit is the maximum, or the highest price of a candidate if that is more, divided by
        `LIMIT_UNITS`, so that no price needs more than these units."""
        if math.isinf(objective.most_price):
            return None
        highest = float(objective.candidates.prices.max(initial=0.0))
        # 1e-300: no division by 0 if nothing costs anything
        largest = max(highest, objective.most_price, 1e-300)
        return Prices.in_units(objective, largest / LIMIT_UNITS)

    def select(self, candidates: Int64[np.ndarray, " k"]) -> "Prices":
        """Prices of some candidates (indices), in this order; limit and unit stay."""
        return self._replace(
            sensor=self.sensor[candidates],
            per_mount=self.per_mount[candidates],
            mount=self.mount[candidates],
        )

    def total(self, members: list[int]) -> int:
        """Price of a set (indices of candidates) in whole units, each shared mount paid once."""
        _, first_on_mount = np.unique(self.mount[members], return_index=True)
        sensors_price = self.sensor[members].sum()
        return int(sensors_price + self.per_mount[members][first_on_mount].sum())

    def expression(
        self, model: "CpModel", built: "list[IntVar]", *, times: int = 1, plus: int = 0
    ) -> "LinearExpr":
        """Price of the built sensors in whole units, as a linear expression for CP-SAT.

        A mount with several places gets a variable of the model that is 1 if any candidate on it
        is built, so that its price counts once.

        Args:
            model: Model that is extended in place.
            built: Variable of each candidate, 1 if it is built.
            times: Factor on the price.
            plus: Added for each built sensor, not multiplied by `times`.
        """
        linear = load_cp_model().LinearExpr
        sensor_terms = (self.sensor * times + plus).tolist()
        terms = [linear.weighted_sum(built, sensor_terms)]
        # mounts whose price is not in their sensors' prices, as several sensors share it
        for shared_mount in np.unique(self.mount[self.per_mount > 0]):
            on_mount = np.flatnonzero(self.mount == shared_mount).tolist()
            is_paid = model.new_bool_var("")
            for candidate in on_mount:
                model.add_implication(built[candidate], is_paid)
            mount_price = int(self.per_mount[on_mount[0]])  # the same for all candidates on it
            terms.append(mount_price * times * is_paid)
        return linear.sum(terms)


class Poles(NamedTuple):
    """Constraints of the mounts (poles) on candidates: places and shared links.

    Attributes:
        mount: Index of each candidate's mount.
        places: Number of sensors that each candidate's mount can carry.
        load: Load of each candidate on its mount's link, `LINK_UNITS` for a full link; 0 if
            sensors cannot exceed a link together.
        required: Indices of mounts that must carry a sensor.
    """

    mount: Int64[np.ndarray, " candidates"]
    places: Int64[np.ndarray, " candidates"]
    load: Int64[np.ndarray, " candidates"]
    required: tuple[int, ...] = ()

    @staticmethod
    def from_objective(objective: Objective) -> "Poles":
        """Places and links of the mounts of an objective's candidates.

        Loads stay 0 if the objective does not limit the links that sensors of a mount share."""
        candidates = objective.candidates
        link_shares = np.zeros(len(candidates))
        if objective.shared_links is not None:  # kbit per frame of each candidate
            # 2 is more than a link already, and keeps whole units small
            link_shares = np.minimum(objective.shared_links / candidates.capacity, 2.0)
        return Poles(
            mount=candidates.mount,
            places=candidates.places[candidates.mount],
            load=_round_down(link_shares, 1 / LINK_UNITS),
            required=tuple(objective.kept.tolist()),
        )

    @property
    def exclusive_mount(self) -> Int64[np.ndarray, " candidates"]:
        """Number of each candidate's mount, as if mounts with several places were several mounts.

        Each candidate on such a mount gets a number that no other has. So at most one candidate of
        a number is built, which bounds on coverage assume."""
        mount_count = int(self.mount.max(initial=-1)) + 1  # 0 without candidates
        unshared_numbers = mount_count + np.arange(len(self.mount))  # above all indices of mounts
        return np.where(self.places > 1, unshared_numbers, self.mount)

    def select(self, candidates: Int64[np.ndarray, " k"]) -> "Poles":
        """Places and links of some candidates (indices), in this order; `required` stays."""
        return self._replace(
            mount=self.mount[candidates], places=self.places[candidates], load=self.load[candidates]
        )

    def constrain(self, model: "CpModel", built: "list[IntVar]") -> None:
        """Add the constraints of the mounts to a model: places, links and required sensors.

        Args:
            model: Model that is extended in place.
            built: Variable of each candidate, 1 if it is built."""
        linear = load_cp_model().LinearExpr
        for mount in self.required:
            model.add_bool_or([built[c] for c in np.flatnonzero(self.mount == mount).tolist()])
        for mount in np.unique(self.mount):
            on_mount = np.flatnonzero(self.mount == mount).tolist()
            variables = [built[c] for c in on_mount]
            place_count = int(self.places[on_mount[0]])  # the same for all candidates on the mount
            if place_count == 1:
                model.add_at_most_one(variables)
                continue
            model.add(linear.sum(variables) <= place_count)
            loads = self.load[on_mount]
            if loads.any():
                model.add(linear.weighted_sum(variables, loads.tolist()) <= LINK_UNITS)


def _round_down(figures: np.ndarray, unit: float) -> Int64[np.ndarray, " candidates"]:
    """Figures in whole units, rounded down. unit: size of one unit."""
    return np.floor(figures / unit).astype(np.int64)


class Levels(NamedTuple):
    """Levels of evidence on objects, and the worth of reaching them, in whole numbers.

    A set reaches a level of an object if the evidence of its members adds up to the threshold. It
    then has the gain of this level and of all lower ones.

    Attributes:
        evidence: Evidence that each candidate adds on each object.
        threshold: Evidence needed for each level of each object, ascending.
        gain: Worth that each level adds to the one below.
        groups: k groups of objects, such as classes, True for the objects of a group. The worth
            of a set is the sum over the group with the lowest sum.
    """

    evidence: Int64[np.ndarray, "candidates objects"]
    threshold: Int64[np.ndarray, "levels objects"]
    gain: Int64[np.ndarray, "levels objects"]
    groups: Bool[np.ndarray, "k objects"]

    def worth(self, members: list[int]) -> int:
        """Worth of the levels that a set (indices of candidates) reaches, in its worst group."""
        is_reached = self.evidence[members].sum(axis=0) >= self.threshold  # levels × objects
        object_worths = (self.gain * is_reached).sum(axis=0)
        return int((self.groups @ object_worths).min())

    @property
    def max_worth(self) -> int:
        """Worth if all levels of all objects are reached, in the group with the least."""
        return int((self.groups @ self.gain.sum(axis=0)).min())


class Solved(NamedTuple):
    """Answer of CP-SAT to a programme.

    Attributes:
        members: Best set found, as indices of candidates; None if none was found.
        value: Its worth, or its price in whole units if a price is minimised; 0 without a set.
        bound: No set has more worth, or costs less.
        optimal: True if value and bound are equal, or if it is proven that no set satisfies the
            programme.
    """

    members: list[int] | None
    value: int
    bound: int
    optimal: bool


@dataclass(frozen=True, eq=False)
class Programme:
    """Integer programme over sets of at most `budget` candidates, solved by `solve`.

    Attributes:
        levels: Levels of evidence on the objects, and their gains.
        budget: Largest number of sensors.
        poles: Places and links of the mounts.
        is_buildable: Mask of candidates that may be built.
        prices: Prices with their limit, None for no limit.
        failing: 1 to count the worth that survives the failure of any one sensor, else 0. Only for
            one level of threshold 1 (or 0) for each object.
        lost_cases: Masks of candidates that fail together, for levels of any threshold. The worth
            of a set is the lowest over these cases; None or empty for no failure.
    """

    levels: Levels
    budget: int
    poles: Poles
    is_buildable: _Mask
    prices: Prices | None = None
    failing: int = 0
    lost_cases: list[_Mask] | None = None

    @staticmethod
    def from_objective(
        objective: Objective, budget: int, levels: Levels, **cases: Any
    ) -> "Programme":
        """Programme over an objective's candidates with their mounts, links and prices.

        Args:
            objective: Objective with the candidates and the limit on the price.
            budget: Largest number of sensors.
            levels: Levels of evidence on the objects, which give the worth of a set.
            cases: Keyword `failing` or `lost_cases`, as the fields; neither for no failure."""
        return Programme(
            levels=levels,
            budget=budget,
            poles=Poles.from_objective(objective),
            is_buildable=objective.allowed([]),  # as first sensor of an empty set
            prices=Prices.from_objective(objective),
            **cases,
        )


def levels_of_hits(
    powers: Float[np.ndarray, "candidates objects"], model: HitModel, *, above: bool
) -> Levels:
    """Steps that approximate each object's hit probability, as levels of evidence.

    The first step begins at any evidence, the others at the shares `HIT_STEPS` of the highest
    probability. Sure hits of all objects gain about `GAIN_UNITS` in all; sizes of objects
    are not considered.

    Args:
        powers: n ^ norm of each candidate and object; points below the model's floor count fully.
        model: Model of the hit probability.
        above: True for steps that are nowhere below the curve, rounded so that they stay above it;
            False for steps that cut it in the middle.
    """
    object_count = powers.shape[1]
    # Σ n ^ norm at which the probability is a share `HIT_STEPS` of the highest: the model's formula
    # solved for it (log(1 / (1 / h - 1)) is the logit of a share h), clipped so that expm1 neither
    # vanishes nor overflows
    log_evidence = (np.log(1 / (1 / np.array(HIT_STEPS) - 1)) - model.intercept) / max(
        model.density, 1e-9
    )
    needed_evidence = np.expm1(np.clip(model.norm * log_evidence, 1e-12, 500.0))
    unit = needed_evidence[-1] / EVIDENCE_UNITS
    # steps above the curve: evidence and gains rounded up, thresholds down
    round_evidence = np.ceil if above else np.floor
    round_threshold = np.floor if above else np.ceil
    round_gain = np.ceil if above else np.rint
    evidence = round_evidence(np.minimum(powers, needed_evidence[-1]) / unit).astype(np.int64)
    edges = round_threshold(needed_evidence / unit).astype(np.int64)
    probabilities = np.append(HIT_STEPS, 1.0) * model.ceiling  # at the upper end of each step
    values = (
        probabilities
        if above
        else np.concatenate([[0.0], (probabilities[1:] + probabilities[:-1]) / 2])
    )
    thresholds = np.maximum.accumulate(np.concatenate([[1], np.maximum(edges, 1)]))
    # whole units of a sure hit; -(-a // b) rounds a / b up
    divisor = max(1, object_count)
    units_per_object = -(-GAIN_UNITS // divisor) if above else GAIN_UNITS // divisor
    gains = round_gain(np.diff(values, prepend=0.0) * units_per_object).astype(np.int64)
    return Levels(
        evidence=evidence,
        threshold=np.repeat(thresholds[:, None], object_count, axis=1),
        gain=np.repeat(gains[:, None], object_count, axis=1),
        groups=np.ones((1, object_count), np.bool_),
    )


def solve(
    programme: Programme,
    limits: SolverLimits = SolverLimits(),
    *,
    at_least: int = 0,
    cost: Prices | None = None,
    start: Sequence[int] = (),
) -> Solved:
    """Find the set with the most worth, or the cheapest set with enough worth, by CP-SAT.

    Args:
        programme: Candidates, their constraints and levels.
        limits: Time and seed of the solver.
        at_least: Worth that the set must have if `cost` is given; otherwise not used.
        cost: Prices whose total is minimised; of equally cheap sets the smallest is best. None to
            maximise the worth.
        start: Indices of a set at which the solver may begin.

    Raises ImportError without OR-Tools."""
    cp = load_cp_model()
    model = cp.CpModel()
    levels = programme.levels
    is_buildable = programme.is_buildable
    budget = programme.budget
    built = [model.new_bool_var("") for _ in is_buildable]
    for c in np.flatnonzero(~is_buildable).tolist():
        model.add(built[c] == 0)
    programme.poles.constrain(model, built)
    model.add(cp.LinearExpr.sum(built) <= budget)
    if programme.prices is not None:
        model.add(programme.prices.expression(model, built) <= programme.prices.limit)
    if programme.failing:
        worths = _sum_surviving_worth(model, built, levels, is_buildable)
    else:
        cases = [is_buildable & ~lost_case for lost_case in programme.lost_cases or ()]
        cases = cases or [is_buildable]
        worths = []
        for case in cases:
            worths += _sum_reached_worth(model, built, levels, is_buildable=case)
    min_worth = model.new_int_var(0, max(0, levels.max_worth), "") if cost is None else at_least
    for worth in worths:
        model.add(worth >= min_worth)
    if cost is None:
        model.maximize(min_worth)
    else:  # price · (budget + 1) + number of sensors: the price decides, then the number
        model.minimize(cost.expression(model, built, times=budget + 1, plus=1))
    for c in start:
        model.add_hint(built[c], True)
    solver = limits.build_solver()
    status = run_solver(solver, model)
    if status not in ("OPTIMAL", "FEASIBLE"):
        # no set found: with "UNKNOWN" time ran out, but a bound on the price may be known
        lowest = int(solver.best_objective_bound) if status == "UNKNOWN" and cost is not None else 0
        return Solved(
            members=None,
            value=0,
            bound=max(0, lowest) // (budget + 1),
            optimal=status == "INFEASIBLE",
        )
    members = [c for c, x in enumerate(built) if solver.boolean_value(x)]
    # 1e-6: a bound just off a whole number is rounding
    if cost is None:
        figure = round(solver.objective_value)
        bound = max(figure, math.floor(solver.best_objective_bound + 1e-6))
    else:
        figure = cost.total(members)
        bound = min(figure, math.ceil(solver.best_objective_bound - 1e-6) // (budget + 1))
    return Solved(members=members, value=figure, bound=bound, optimal=bound == figure)


def _sum_reached_worth(
    model: "CpModel", built: "list[IntVar]", levels: Levels, is_buildable: _Mask
) -> "list[LinearExpr]":
    """Worth of the levels that the built sensors reach, for each group of `levels.groups`.

    A variable and a constraint are added to the model for each level that can be reached.

    Args:
        model: Model that is extended in place.
        built: Variable of each candidate, 1 if it is built.
        levels: Levels of evidence on the objects.
        is_buildable: Mask of the candidates whose evidence counts; lost ones are False.
    """
    linear = load_cp_model().LinearExpr
    # for each level that can be reached: index of its object, variable that is 1 if it is, gain
    objects: list[int] = []
    is_reached: list[IntVar] = []
    gains: list[int] = []
    for index, candidate_evidence in enumerate(levels.evidence.T):
        observers = np.flatnonzero((candidate_evidence > 0) & is_buildable).tolist()
        evidence = linear.weighted_sum(
            [built[c] for c in observers], candidate_evidence[observers].tolist()
        )
        for threshold, gain in zip(
            levels.threshold[:, index].tolist(), levels.gain[:, index].tolist(), strict=True
        ):
            if gain > 0 and candidate_evidence[observers].sum() >= threshold:
                level = model.new_bool_var("")
                model.add(evidence >= threshold * level)
                objects.append(index)
                is_reached.append(level)
                gains.append(gain)
    worths = []
    for group in levels.groups:
        rows = np.flatnonzero(group[objects]).tolist()
        worths.append(
            linear.weighted_sum([is_reached[row] for row in rows], [gains[row] for row in rows])
        )
    return worths


def _sum_surviving_worth(
    model: "CpModel", built: "list[IntVar]", levels: Levels, is_buildable: _Mask
) -> "list[LinearExpr]":
    """Worth that survives the failure of any one sensor, for each group of `levels.groups`.

    An object survives if two sensors see it, or one that does not fail. Only the first level of
    each object counts, and any evidence reaches a threshold above 0.

    Args:
        model: Model that is extended in place.
        built: Variable of each candidate, 1 if it is built.
        levels: One level for each object, of threshold 1, or 0 if it is reached without a sensor.
        is_buildable: Mask of candidates that may be built."""
    linear = load_cp_model().LinearExpr
    # variables of each object, 1 if at least one or two built sensors see it
    seen_once: list[IntVar] = []
    seen_twice: list[IntVar] = []
    for candidate_evidence, threshold in zip(levels.evidence.T, levels.threshold[0], strict=True):
        views = linear.sum(
            [built[c] for c in np.flatnonzero((candidate_evidence > 0) & is_buildable).tolist()]
        )
        for min_views, variables in ((1, seen_once), (2, seen_twice)):
            is_seen = model.new_bool_var("")
            model.add(is_seen == 1) if threshold <= 0 else model.add(views >= min_views * is_seen)
            variables.append(is_seen)
    worths: list[LinearExpr] = []
    gain = levels.gain[0]

    def sum_gains(variables: "list[IntVar]", objects: Int64[np.ndarray, " _"]) -> "LinearExpr":
        """Sum of the gains of some objects, each if its variable is 1."""
        return linear.weighted_sum([variables[o] for o in objects], gain[objects].tolist())

    for group in levels.groups:
        objects = np.flatnonzero(group)
        surviving_worth = model.new_int_var(0, int(gain[objects].sum()), "")
        total = sum_gains(seen_once, objects)
        for c in np.flatnonzero(is_buildable).tolist():
            in_view = objects[levels.evidence[c, objects] > 0]
            # the objects that no other sensor sees are lost with the candidate
            lost_worth = sum_gains(seen_once, in_view) - sum_gains(seen_twice, in_view)
            model.add(surviving_worth <= total - lost_worth).only_enforce_if(built[c])
        model.add(surviving_worth == 0).only_enforce_if([x.negated() for x in built])
        worths.append(surviving_worth)
    return worths
