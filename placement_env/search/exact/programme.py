"""Integer programmes whose objects gain worth with evidence.

CP-SAT solves them over sensor sets.

    Σ_c known[c, o] x_c >= threshold[j, o] l_jo      level j of object o is reached, which is worth gain[j, o]
    Σ_c x_c <= budget, and the places, links and money of `placement_env.search.exact.poles`

Either the worth of the reached levels is maximal, or the set is as cheap as possible for a given worth. With one level
of threshold 1 an object is covered or not; several make steps of a hit's probability, which a surrogate says grows with
the evidence Σ n_i ^ norm. Steps above the curve make the programme worth no less than the truth, so anything it proves
impossible is impossible; steps that cut it in the middle are near the truth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from placement_env.fidelity.hits.hit_model import HitModel
from placement_env.search.exact.cpsat import SECONDS
from placement_env.search.exact.poles import Poles, Prices
from placement_env.search.exact.solver import build_solver, cp_model
from toolkit.arrays import Bool, Float, Int64

if TYPE_CHECKING:
    from ortools.sat.python.cp_model import IntVar

UNITS = 1000  # parts of the highest threshold of an object
GAINS = 10**6  # parts of the worth of all objects
HIT_STEPS = (0.25, 0.5, 0.75, 0.9)  # shares of the highest probability at which a step begins


class Levels(NamedTuple):
    """Levels of evidence and their worth.

    known: amount that each candidate adds to each object, whole numbers; threshold, gain: of each level of each object;
    parties: rows of worth, k of them, that an object counts in; the least counts.
    """

    known: Int64[np.ndarray, "C O"]
    threshold: Int64[np.ndarray, "J O"]
    gain: Int64[np.ndarray, "J O"]
    parties: Bool[np.ndarray, "k O"]

    def worth(self, chosen: list[int]) -> int:
        """Worth of the levels that a set reaches. The party with the least counts."""
        reached = self.known[chosen].sum(axis=0) >= self.threshold
        return int((self.parties @ (self.gain * reached).sum(axis=0)).min())

    def surviving(self, chosen: list[int]) -> int:
        """Worth that survives the worst failure of one sensor."""
        return min((self.worth([c for c in chosen if c != gone]) for gone in chosen), default=0)

    @property
    def whole(self) -> int:
        """Worth of all levels, for the least party."""
        return int((self.parties @ self.gain.sum(axis=0)).min())


class Solved(NamedTuple):
    """Solution of a programme.

    chosen: candidates, ascending, None where no set satisfies it; figure: worth, or price in whole units; bound: no set
    has more worth, or costs less; optimal: whether the two are equal.
    """

    chosen: list[int] | None
    figure: int
    bound: int
    optimal: bool


def levels_of_coverage(seen: Bool[np.ndarray, "C O"], parties: Bool[np.ndarray, "k O"] | None = None) -> Levels:
    """Equal worth for every object that a candidate sees. parties: one with all objects by default."""
    count = seen.shape[1]
    own = np.ones((1, count), np.bool_) if parties is None else parties
    return Levels(seen.astype(np.int64), np.ones((1, count), np.int64), np.ones((1, count), np.int64), own)


def levels_of_hits(
    powers: Float[np.ndarray, "C O"], model: HitModel, *, above: bool, parties: Bool[np.ndarray, "k O"] | None = None
) -> Levels:
    """Steps of each object's hit probability.

    They come from n ^ norm of each candidate and object. above: no step lies below the curve, else each cuts it in the
    middle. The floor, which only lowers the probability, is left out.
    """
    count = powers.shape[1]
    e = (np.log(1 / (1 / np.array(HIT_STEPS) - 1)) - model.intercept) / max(model.density, 1e-9)
    needed = np.expm1(np.clip(model.norm * e, 1e-12, 500.0))
    unit = needed[-1] / UNITS
    add = np.ceil if above else np.floor
    known = add(np.minimum(powers, needed[-1]) / unit).astype(np.int64)
    edges = np.floor(needed / unit).astype(np.int64) if above else np.ceil(needed / unit).astype(np.int64)
    ends = np.append(HIT_STEPS, 1.0) * model.ceiling
    values = ends if above else np.concatenate([[0.0], (ends[1:] + ends[:-1]) / 2])
    thresholds = np.maximum.accumulate(np.concatenate([[1], np.maximum(edges, 1)]))
    per_object = -(-GAINS // max(1, count)) if above else GAINS // max(1, count)
    gains = np.diff(np.concatenate([[0.0], values]))
    whole = (np.ceil if above else np.rint)(gains * per_object).astype(np.int64)
    own = np.ones((1, count), np.bool_) if parties is None else parties
    return Levels(known, np.repeat(thresholds[:, None], count, axis=1), np.repeat(whole[:, None], count, axis=1), own)


def solve(
    levels: Levels,
    mount: Int64[np.ndarray, " C"],
    budget: int,
    *,
    may_stand: Bool[np.ndarray, " C"],
    at_least: int | None = None,
    prices: Int64[np.ndarray, " C"] | None = None,
    shared: Int64[np.ndarray, " C"] | None = None,
    poles: Poles | None = None,
    money: Prices | None = None,
    start: list[int] | None = None,
    seconds: float = SECONDS,
    workers: int = 1,
    seed: int = 0,
    effort: float | None = None,
    failing: int = 0,
    lost: Sequence[Bool[np.ndarray, " C"]] = (),
) -> Solved:
    """The set of most worth, or the cheapest.

    Where `at_least` is given, it is the cheapest by `prices` with that worth, and of equally cheap ones that of fewest
    sensors.

    shared: part of each price that belongs to a mount with several places, None for nothing; poles: places and links,
    None for one place on each mount; money: limit on the total; start: an initial set; effort: see `cpsat.search`;
    failing: 1 for the worth that is left whichever sensor of the set fails (levels of threshold 1 alone); lost:
    candidates without which worth is counted, the least of several cases, for levels of any threshold.
    """
    cp = cp_model()
    model = cp.CpModel()
    once = np.zeros(len(mount), np.int64) if shared is None else shared
    cost = None if prices is None else Prices(prices - once, once, mount, -1)
    built = [model.new_bool_var("") for _ in range(len(mount))]
    for c in np.flatnonzero(~may_stand).tolist():
        model.add(built[c] == 0)
    (Poles.single(mount) if poles is None else poles).constrain(model, built)
    model.add(cp.LinearExpr.sum(built) <= budget)
    if money is not None:
        model.add(money.expression(model, built) <= money.most)
    if failing:
        worths = _surviving(model, built, levels, may_stand)
    else:
        cases = [may_stand & ~gone for gone in lost] or [may_stand]
        worths = [worth for case in cases for worth in _reached(model, built, levels, case)]
    if at_least is None:
        least = model.new_int_var(0, max(0, levels.whole), "")
        for worth in worths:
            model.add(worth >= least)
        model.maximize(least)
    else:
        for worth in worths:
            model.add(worth >= at_least)
        count = cp.LinearExpr.sum(built)
        model.minimize(count if cost is None else cost.expression(model, built, times=budget + 1, plus=1))
    for c in start or ():
        model.add_hint(built[c], True)
    solver = build_solver(seconds, workers, seed, effort)
    status = solver.status_name(solver.solve(model))
    if status not in ("OPTIMAL", "FEASIBLE"):
        lowest = int(solver.best_objective_bound) if status == "UNKNOWN" and at_least is not None else 0
        return Solved(None, 0, _price_of(max(0, lowest), budget, prices), status == "INFEASIBLE")
    chosen = [c for c, x in enumerate(built) if solver.boolean_value(x)]
    if at_least is None:
        left = [[c for c in chosen if not gone[c]] for gone in lost] or [chosen]
        figure = levels.surviving(chosen) if failing else min(map(levels.worth, left))
        bound = max(figure, math.floor(solver.best_objective_bound + 1e-6))
        return Solved(chosen, figure, bound, bound == figure)
    figure = len(chosen) if cost is None else cost.total(chosen)
    bound = min(figure, _price_of(math.ceil(solver.best_objective_bound - 1e-6), budget, prices))
    return Solved(chosen, figure, bound, bound == figure)


def _price_of(cost: int, budget: int, prices: Int64[np.ndarray, " C"] | None) -> int:
    """Price within a cost that also counts sensors."""
    return cost if prices is None else cost // (budget + 1)


def _reached(model: Any, built: list[IntVar], levels: Levels, may_stand: Bool[np.ndarray, " C"]) -> list[Any]:
    """Worth of the levels reached, of each party."""
    cp = cp_model()
    reached: list[tuple[int, Any, int]] = []
    for o in range(levels.known.shape[1]):
        seen = np.flatnonzero((levels.known[:, o] > 0) & may_stand).tolist()
        known = cp.LinearExpr.weighted_sum([built[c] for c in seen], levels.known[seen, o].tolist())
        for threshold, gain in zip(levels.threshold[:, o].tolist(), levels.gain[:, o].tolist(), strict=True):
            if gain <= 0 or levels.known[seen, o].sum() < threshold:
                continue
            level = model.new_bool_var("")
            model.add(known >= threshold * level)
            reached.append((o, level, gain))
    return [
        cp.LinearExpr.weighted_sum(
            [level for o, level, _ in reached if party[o]], [gain for o, _, gain in reached if party[o]]
        )
        for party in levels.parties
    ]


def _surviving(model: Any, built: list[IntVar], levels: Levels, may_stand: Bool[np.ndarray, " C"]) -> list[Any]:
    """Worth of each party that survives any one failure.

    An object that two sensors see loses nothing. An object that one sensor sees is lost when that sensor fails.
    """
    cp = cp_model()
    once: list[IntVar] = []
    twice: list[IntVar] = []
    for o in range(levels.known.shape[1]):
        seen = np.flatnonzero((levels.known[:, o] > 0) & may_stand).tolist()
        views = cp.LinearExpr.sum([built[c] for c in seen])
        free = int(levels.threshold[0, o]) <= 0
        for number, of in ((1, once), (2, twice)):
            level = model.new_bool_var("")
            model.add(level == 1) if free else model.add(views >= number * level)
            of.append(level)
    left = []
    for party in levels.parties:
        own = np.flatnonzero(party)
        most = int(levels.gain[0, own].sum())
        least = model.new_int_var(0, most, "")
        whole = cp.LinearExpr.weighted_sum([once[o] for o in own], levels.gain[0, own].tolist())
        for c in np.flatnonzero(may_stand).tolist():
            mine = [o for o in own.tolist() if levels.known[c, o] > 0]
            gains = levels.gain[0, mine].tolist()
            lost = cp.LinearExpr.weighted_sum([once[o] for o in mine], gains) - cp.LinearExpr.weighted_sum(
                [twice[o] for o in mine], gains
            )
            model.add(least <= whole - lost).only_enforce_if(built[c])
        model.add(least == 0).only_enforce_if([x.negated() for x in built])
        left.append(least)
    return left
