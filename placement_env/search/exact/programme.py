"""Integer programmes over sensor sets whose objects gain worth with evidence, solved by CP-SAT
(OR-Tools).

    Σ_c known[c, o] x_c >= threshold[j, o] l_jo    level j of object o is reached: gain[j, o]
    Σ_c x_c <= budget
    Σ_{c on m} x_c <= places_m
    Σ_{c on m} load_c x_c <= 1 link
    Σ_{c on m} x_c >= 1 for mounts to be kept
    Σ_c price_c x_c + Σ_m shared_m z_m <= money,   z_m >= x_c

Either the worth of the reached levels is maximal, or the set is as cheap as possible for a given
worth. With one level of threshold 1 an object is covered or not; several make steps of a hit's
probability, which a surrogate says grows with the evidence Σ n_i ^ norm. Steps above the curve make
the programme worth no less than the truth, so anything it proves impossible is impossible; steps
that cut it in the middle are near the truth. Where every pole has one place, its price is part of
the sensor's."""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from placement_env.fidelity.hit_model import HitModel
from placement_env.objective import ROUNDING, Objective
from toolkit.arrays import Bool, Float, Int64

if TYPE_CHECKING:
    from ortools.sat.python.cp_model import CpModel, CpSolver, IntVar, LinearExpr

SECONDS = 60.0  # default limit of solving
FINEST = 1 << 40  # whole units of the highest price
LINK = 1 << 40  # whole units of a link
UNITS = 1000  # parts of the highest threshold of an object
GAINS = 10**6  # parts of the worth of all objects
_Mask = Bool[np.ndarray, " C"]  # of candidates
HIT_STEPS = (0.25, 0.5, 0.75, 0.9)  # shares of the highest probability at which a step begins


@dataclass(frozen=True)
class SolverLimits:
    """Limits of a solver. effort: OR-Tools' deterministic seconds, None for unlimited."""

    seconds: float = SECONDS
    seed: int = 0
    effort: float | None = None

    def build_solver(self) -> "CpSolver":
        """A solver of one worker within these limits."""
        solver = cp_model().CpSolver()
        solver.parameters.catch_sigint_signal = (
            False  # its handler would stay, and end Python at the next Ctrl-C
        )
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
    """OR-Tools' module of the same name. Raises ImportError where it is missing."""
    try:
        from ortools.sat.python import cp_model
    except ImportError as error:
        raise ImportError("CP-SAT needs OR-Tools: pip install coview[search]") from error
    return cp_model


class Prices(NamedTuple):
    """Prices in exact whole units, rounded down; the limit is rounded up, so no set within the
    money is excluded.

    each: of the candidates, with their mounts where these have one place; shared: of a mount with
    more, paid once; most: limit on the total; unit: price of one."""

    each: Int64[np.ndarray, " C"]
    shared: Int64[np.ndarray, " C"]
    mount: Int64[np.ndarray, " C"]
    most: int
    unit: float = 1.0

    @staticmethod
    def in_units(objective: Objective, unit: float) -> "Prices":
        """Prices of an objective's candidates, in units of a price."""
        candidates = objective.candidates
        several = candidates.places[candidates.mount] > 1
        each = np.where(several, candidates.model_prices, candidates.prices)
        shared = np.where(several, candidates.mount_prices[candidates.mount], 0.0)
        money = objective.most_price * (1 + ROUNDING) / unit
        most = -1 if math.isinf(money) else math.floor(money)
        return Prices(_whole(each, unit), _whole(shared, unit), candidates.mount, most, unit)

    @staticmethod
    def of(objective: Objective) -> "Prices | None":
        """Prices of an objective whose sets have a most price."""
        if math.isinf(objective.most_price):
            return None
        highest = float(objective.candidates.prices.max(initial=0.0))
        return Prices.in_units(objective, max(highest, objective.most_price, 1e-300) / FINEST)

    def select(self, kept: Int64[np.ndarray, " k"]) -> "Prices":
        """Prices of some candidates."""
        return self._replace(each=self.each[kept], shared=self.shared[kept], mount=self.mount[kept])

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
        for here in np.unique(self.mount[self.shared > 0]):
            own = np.flatnonzero(self.mount == here).tolist()
            paid = model.new_bool_var("")
            for c in own:
                model.add_implication(built[c], paid)
            parts.append(int(self.shared[own[0]]) * times * paid)
        return linear.sum(parts)


class Poles(NamedTuple):
    """Places and links of the mounts. load: of the link by each candidate, in parts of `LINK`;
    kept: mounts to use."""

    mount: Int64[np.ndarray, " C"]
    places: Int64[np.ndarray, " C"]
    load: Int64[np.ndarray, " C"]
    kept: tuple[int, ...] = ()

    @staticmethod
    def of(objective: Objective) -> "Poles":
        """Poles of an objective's candidates."""
        candidates = objective.candidates
        sent = objective.shared_links
        load = (
            np.zeros(len(candidates))
            if sent is None
            else np.minimum(sent / candidates.capacity, 2.0)
        )
        places = candidates.places[candidates.mount]
        kept = tuple(objective.kept.tolist())
        return Poles(candidates.mount, places, _whole(load, 1 / LINK), kept)

    @property
    def apart(self) -> Int64[np.ndarray, " C"]:
        """Mount of each candidate, for bounds: one of its own where its mount has several
        places."""
        count = int(self.mount.max(initial=-1)) + 1
        return np.where(self.places > 1, count + np.arange(len(self.mount)), self.mount)

    def select(self, kept: Int64[np.ndarray, " k"]) -> "Poles":
        """Poles of some candidates."""
        return self._replace(mount=self.mount[kept], places=self.places[kept], load=self.load[kept])

    def constrain(self, model: "CpModel", built: "list[IntVar]") -> None:
        """Add the constraints of places and links, and of mounts that must carry a sensor."""
        linear = cp_model().LinearExpr
        for here in self.kept:
            model.add_bool_or([built[c] for c in np.flatnonzero(self.mount == here).tolist()])
        for here in np.unique(self.mount):
            own = np.flatnonzero(self.mount == here).tolist()
            variables = [built[c] for c in own]
            if (places := int(self.places[own[0]])) == 1:
                model.add_at_most_one(variables)
                continue
            model.add(linear.sum(variables) <= places)
            if self.load[own].any():
                model.add(linear.weighted_sum(variables, self.load[own].tolist()) <= LINK)


def _whole(figures: np.ndarray, unit: float) -> Int64[np.ndarray, " C"]:
    return np.floor(figures / unit).astype(np.int64)


class Levels(NamedTuple):
    """Levels of evidence and their worth: `known` is what each candidate adds to each object, in
    whole numbers. threshold, gain: of each level of each object; parties: rows of worth that an
    object counts in; the least counts."""

    known: Int64[np.ndarray, "C O"]
    threshold: Int64[np.ndarray, "J O"]
    gain: Int64[np.ndarray, "J O"]
    parties: Bool[np.ndarray, "k O"]

    def worth(self, chosen: list[int]) -> int:
        """Worth of the levels that a set reaches, of the least party."""
        reached = self.known[chosen].sum(axis=0) >= self.threshold
        return int((self.parties @ (self.gain * reached).sum(axis=0)).min())

    @property
    def whole(self) -> int:
        """Worth of all levels, for the least party."""
        return int((self.parties @ self.gain.sum(axis=0)).min())


class Solved(NamedTuple):
    """Solution of a programme. chosen: None where no set satisfies it; figure: worth, or price in
    whole units. bound: no set has more worth, or costs less; optimal: whether the two are equal, or
    no set satisfies it for certain."""

    chosen: list[int] | None
    figure: int
    bound: int
    optimal: bool


@dataclass(frozen=True, eq=False)
class Programme:
    """Integer programme over sets of at most `budget` candidates.

    failing: 1 for the worth that survives the failure of any one sensor (levels of threshold 1
    alone); lost: cases of candidates without which worth is counted, the least of them, for levels
    of any threshold."""

    levels: Levels
    budget: int
    poles: Poles
    may_stand: _Mask
    money: Prices | None = None
    failing: int = 0
    lost: list[_Mask] | None = None

    @staticmethod
    def of(objective: Objective, budget: int, levels: Levels, **cases: Any) -> "Programme":
        """Programme of an objective's candidates, with its poles and money. cases: `failing` or
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
    """Steps of each object's hit probability, from n ^ norm of each candidate and object, without
    the floor. above: no step lies below the curve, else each cuts it in the middle."""
    count = powers.shape[1]
    e = (np.log(1 / (1 / np.array(HIT_STEPS) - 1)) - model.intercept) / max(model.density, 1e-9)
    needed = np.expm1(np.clip(model.norm * e, 1e-12, 500.0))
    unit = needed[-1] / UNITS
    known = (np.ceil if above else np.floor)(np.minimum(powers, needed[-1]) / unit).astype(np.int64)
    edges = (np.floor if above else np.ceil)(needed / unit).astype(np.int64)
    ends = np.append(HIT_STEPS, 1.0) * model.ceiling
    values = ends if above else np.concatenate([[0.0], (ends[1:] + ends[:-1]) / 2])
    thresholds = np.maximum.accumulate(np.concatenate([[1], np.maximum(edges, 1)]))
    per_object = -(-GAINS // max(1, count)) if above else GAINS // max(1, count)
    gains = (np.ceil if above else np.rint)(np.diff(values, prepend=0.0) * per_object).astype(
        np.int64
    )
    threshold, gain = (np.repeat(column[:, None], count, axis=1) for column in (thresholds, gains))
    return Levels(known, threshold, gain, np.ones((1, count), np.bool_))


def solve(
    programme: Programme,
    limits: SolverLimits = SolverLimits(),
    *,
    at_least: int = 0,
    cost: Prices | None = None,
    start: Sequence[int] = (),
) -> Solved:
    """The set of most worth; with a `cost` the cheapest of worth `at_least`, smallest first. start:
    an initial set."""
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
        cases = [may_stand & ~gone for gone in programme.lost or ()] or [may_stand]
        worths = [worth for case in cases for worth in _reached(model, built, levels, case)]
    least = model.new_int_var(0, max(0, levels.whole), "") if cost is None else at_least
    for worth in worths:
        model.add(worth >= least)
    if cost is None:
        model.maximize(least)
    else:  # the price, and in its last digit the number of sensors
        model.minimize(cost.expression(model, built, times=budget + 1, plus=1))
    for c in start:
        model.add_hint(built[c], True)
    solver = limits.build_solver()
    status = run_solver(solver, model)
    if status not in ("OPTIMAL", "FEASIBLE"):
        lowest = int(solver.best_objective_bound) if status == "UNKNOWN" and cost is not None else 0
        return Solved(None, 0, max(0, lowest) // (budget + 1), status == "INFEASIBLE")
    chosen = [c for c, x in enumerate(built) if solver.boolean_value(x)]
    if cost is None:
        figure = round(solver.objective_value)
        bound = max(figure, math.floor(solver.best_objective_bound + 1e-6))
    else:
        figure = cost.total(chosen)
        bound = min(figure, math.ceil(solver.best_objective_bound - 1e-6) // (budget + 1))
    return Solved(chosen, figure, bound, bound == figure)


def _reached(
    model: "CpModel", built: "list[IntVar]", levels: Levels, may_stand: _Mask
) -> "list[LinearExpr]":
    """Worth of the levels reached, of each party."""
    linear = cp_model().LinearExpr
    reached: list[tuple[int, IntVar, int]] = []
    for o, known in enumerate(levels.known.T):
        seen = np.flatnonzero((known > 0) & may_stand).tolist()
        evidence = linear.weighted_sum([built[c] for c in seen], known[seen].tolist())
        for threshold, gain in zip(
            levels.threshold[:, o].tolist(), levels.gain[:, o].tolist(), strict=True
        ):
            if gain > 0 and known[seen].sum() >= threshold:
                level = model.new_bool_var("")
                model.add(evidence >= threshold * level)
                reached.append((o, level, gain))
    own = [[(level, gain) for o, level, gain in reached if party[o]] for party in levels.parties]
    return [
        linear.weighted_sum([level for level, _ in each], [gain for _, gain in each])
        for each in own
    ]


def _surviving(
    model: "CpModel", built: "list[IntVar]", levels: Levels, may_stand: _Mask
) -> "list[LinearExpr]":
    """Worth of each party that survives any one failure: what two sensors see, or another than the
    failing one."""
    linear = cp_model().LinearExpr
    once: list[IntVar] = []
    twice: list[IntVar] = []
    for known, threshold in zip(levels.known.T, levels.threshold[0], strict=True):
        views = linear.sum([built[c] for c in np.flatnonzero((known > 0) & may_stand).tolist()])
        for number, found in ((1, once), (2, twice)):
            level = model.new_bool_var("")
            model.add(level == 1) if threshold <= 0 else model.add(views >= number * level)
            found.append(level)
    left: list[LinearExpr] = []
    for party in levels.parties:
        own = np.flatnonzero(party)
        gain = levels.gain[0]
        least = model.new_int_var(0, int(gain[own].sum()), "")
        whole = linear.weighted_sum([once[o] for o in own], gain[own].tolist())
        for c in np.flatnonzero(may_stand).tolist():
            mine = own[levels.known[c, own] > 0]
            seen, again = (
                linear.weighted_sum([level[o] for o in mine], gain[mine].tolist())
                for level in (once, twice)
            )
            model.add(least <= whole - (seen - again)).only_enforce_if(built[c])
        model.add(least == 0).only_enforce_if([x.negated() for x in built])
        left.append(least)
    return left
