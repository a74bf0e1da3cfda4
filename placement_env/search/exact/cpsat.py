"""Largest (k-)coverage, with a proven bound: an integer programme, solved by CP-SAT (OR-Tools).

    max Σ_o w_o y_o
    where  Σ_c seen[c, o] x_c >= k y_o,
           Σ_{c on m} x_c <= 1 for each mount m,
           Σ_c x_c <= budget

x_c: candidate c is built; y_o: at least k of the built ones see object o, each with enough points.
Objects that the same candidates see are one object of weight w. What cannot be covered is left out,
and so is a pose that sees nothing which another on its mount does not see. Of several classes the
shares that are covered count by their weights, or the worst of them: max z where z <= Σ_o w_ko y_o
for every class k."""

import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from placement_env.checks import check_whole
from placement_env.classes import Classes
from placement_env.fidelity.coverage import LEAST
from placement_env.fidelity.visibility import Visibility
from placement_env.objective import Objective
from placement_env.protocol import ByFrames
from placement_env.search.exact.programme import (
    SECONDS,
    Poles,
    Prices,
    Solved,
    SolverLimits,
    cp_model,
    run_solver,
)
from placement_env.search.progress import Progress
from placement_env.search.result import Certificate, Result
from placement_env.search.verification import best_of_equals
from placement_env.subsets import Sets
from toolkit.arrays import Bool, Int64

if TYPE_CHECKING:
    from ortools.sat.python.cp_model import CpModel, IntVar

PARTS = 10**9  # parts into which the sum over several classes is divided
_Seen = Bool[np.ndarray, "C O"]  # of candidates × objects, True where seen
_Each = Int64[np.ndarray, " C"]  # of candidates, such as their mounts or prices
_Weight = Int64[np.ndarray, " O"]
_Worth = Int64[np.ndarray, "k O"]


def search(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    visibility: Visibility | None = None,
    views: int = 1,
    effort: float | None = None,
) -> Result:
    """The set that covers most, and its score; the certificate is of the coverage.

    Among equally good sets, as far as they are tried, the objective picks the best, unless that
    takes a detector. visibility: of the candidates, None for the objective's own; views: k; effort:
    of solving, in OR-Tools' deterministic seconds, None for unlimited; seconds: 60 if None;
    evaluations: of the choice among equals. The same seed finds the same set as long as `seconds`
    do not cut the solver short. Raises ValueError without visibility, and ImportError without
    OR-Tools."""
    visibility = objective.visibility if visibility is None else visibility
    if visibility is None:
        raise ValueError(
            "CP-SAT needs to know what each candidate sees: pass visibility=see(traffic, "
            "candidates)"
        )
    progress = Progress(objective, budget, seconds, evaluations)
    visibility = visibility.of_classes(objective.classes.labels)
    seen = visibility.points >= LEAST
    worth, units = compute_worth(visibility.labels, objective.classes)
    cover = cover_most(
        seen,
        Poles.of(objective),
        budget,
        views=views,
        may_stand=objective.allowed([]),
        prices=Prices.of(objective),
        worth=worth,
        limits=SolverLimits(SECONDS if seconds is None else seconds, seed, effort),
    )

    def covered(sets: Sets) -> Int64[np.ndarray, " n"]:
        return np.array(
            [int((worth @ (seen[row].sum(axis=0) >= views)).min()) for row in sets], np.int64
        )

    chosen = cover.chosen or []
    if not isinstance(objective.scored_by, ByFrames):
        chosen = best_of_equals(progress, chosen, covered)
    progress.settle(chosen)
    share = cover.figure / max(1, units)
    most = cover.bound / max(1, units)
    view = f"{views} view(s) of {LEAST:g} points or more from {{{', '.join(map(str, chosen))}}}"
    if units == PARTS:
        note = (
            f"{share:.4f} of the {objective.classes.described()} has {view}, and no set covers "
            f"more than {most:.4f}"
        )
    else:
        note = (
            f"{cover.figure} of {units} objects have {view}, and no set covers more than "
            f"{cover.bound}"
        )
    return progress.result("CP-SAT", Certificate.from_bound(share, most, note, "coverage"))


def cover_most(
    seen: _Seen,
    poles: Poles,
    budget: int,
    *,
    views: int = 1,
    may_stand: Bool[np.ndarray, " C"] | None = None,
    prices: Prices | None = None,
    worth: _Worth | None = None,
    limits: SolverLimits = SolverLimits(),
) -> Solved:
    """Choose at most `budget` candidates that cover the most objects, each by at least `views` of
    them.

    seen: candidates × objects; may_stand: candidates that may be built, all if None; prices: with
    their limit; worth: of each object to each of k parties, the least of whose sums counts
    (`compute_worth`), None to count objects. The solver starts from greedy's set, so the answer
    covers no less."""
    check_whole("budget", budget, least=1)
    check_whole("views", views, least=1)
    began = time.monotonic()
    may = np.ones(len(seen), np.bool_) if may_stand is None else may_stand
    needed = may & np.isin(poles.mount, poles.kept)
    kept = useful(
        seen & may[:, None],
        poles.apart,
        None if prices is None else prices.each + prices.shared,
        needed,
    )
    cost = None if prices is None else prices.select(kept)
    poles = poles.select(kept)
    each = np.ones((1, seen.shape[1]), np.int64) if worth is None else worth
    objects, weights = merge_objects(seen[kept], poles.apart, views, each)
    start = greedy_cover(objects, weights.sum(axis=0), poles.mount, budget, views, prices=cost)
    bound = min(
        prove_bound(objects, row, poles.apart, budget, views=views, chosen=start) for row in weights
    )
    model, built = _model(objects, weights, poles, budget, views=views, start=start, bound=bound)
    if cost is not None:
        model.add(cost.expression(model, built) <= cost.most)
    solver = replace(
        limits, seconds=max(0.01, limits.seconds - (time.monotonic() - began))
    ).build_solver()
    if run_solver(solver, model) in (
        "OPTIMAL",
        "FEASIBLE",
    ):  # else time ran out before any solution
        start = [c for c, x in enumerate(built) if solver.boolean_value(x)]
        bound = min(bound, int(np.floor(solver.best_objective_bound + 1e-6)))
    elif poles.kept:
        start = []
    chosen = sorted(kept[start].tolist())
    covered = int((each @ (seen[chosen].sum(axis=0) >= views)).min())
    return Solved(chosen, covered, max(bound, covered), bound <= covered)


def compute_worth(labels: Int64[np.ndarray, " O"], classes: Classes) -> tuple[_Worth, int]:
    """Whole worth of covering each object, and the total: their number where one class counts, else
    `PARTS`. The objects of a class share its parts equally. The mean of classes is one row; the
    worst has one row per class."""
    there = [
        (label, weight)
        for label, weight in zip(classes.labels, classes.weights, strict=True)
        if label in labels
    ]
    if len(classes.names) == 1 or not there:
        return np.ones((1, len(labels)), np.int64), len(labels)
    of_class = np.array([labels == label for label, _ in there])
    shares = of_class / of_class.sum(axis=1, keepdims=True)
    if classes.combine == "mean":
        weights = np.array([weight for _, weight in there])
        shares = (weights @ shares / weights.sum())[None]
    return np.rint(shares * PARTS).astype(np.int64), PARTS


def useful(
    seen: _Seen,
    mount: _Each,
    prices: _Each | None = None,
    needed: Bool[np.ndarray, " C"] | None = None,
) -> Int64[np.ndarray, " k"]:
    """Candidates that see something, and more than any on their mount for no higher a price; the
    first of equal ones.

    needed: candidates that count though they see nothing."""
    keep = np.asarray(seen.any(axis=1) if needed is None else seen.any(axis=1) | needed)
    for here in np.unique(mount):
        poses = np.flatnonzero(keep & (mount == here))
        views = seen[poses].astype(np.float32)
        size = views.sum(axis=1)
        price = np.zeros(len(poses)) if prices is None else prices[poses]
        within = (views @ views.T) == size[:, None]  # all that i sees, j sees
        earlier = np.arange(len(poses))[None] < np.arange(len(poses))[:, None]
        better = (size[None] > size[:, None]) | (price[None] < price[:, None])
        beaten = within & (price[None] <= price[:, None]) & (better | earlier)
        keep[poses[beaten.any(axis=1)]] = False
    return np.flatnonzero(keep)


def merge_objects(
    seen: _Seen, mount: _Each, views: int, worth: _Worth
) -> tuple[Bool[np.ndarray, "C m"], Int64[np.ndarray, "k m"]]:
    """Kinds of objects seen by different candidates and at least `views` mounts, with their total
    worth."""
    able = (
        sum((seen[mount == here].any(axis=0) for here in np.unique(mount)), np.zeros(seen.shape[1]))
        >= views
    )
    seen = seen[:, able]
    worth = worth[:, able]
    if not seen.size:
        return seen[:, :0], worth[:, :0]
    packed = np.ascontiguousarray(np.packbits(seen, axis=0).T)
    keys = packed.view(np.dtype((np.void, packed.shape[1])))[:, 0]
    _, first, place = np.unique(keys, return_index=True, return_inverse=True)
    weights = np.zeros((len(worth), len(first)), np.int64)
    np.add.at(weights.T, place.ravel(), worth.T)
    return seen[:, first], weights


def greedy_cover(
    seen: _Seen,
    weight: _Weight,
    mount: _Each,
    budget: int,
    views: int,
    *,
    prices: Prices | None = None,
) -> list[int]:
    """Cover objects greedily, by most views of objects with fewer than `views`, on a mount each,
    within the money."""
    missing = np.full(len(weight), views)
    free = np.ones(len(seen), bool)
    chosen: list[int] = []
    while len(chosen) < budget:
        if prices is not None:
            free &= prices.each <= prices.most - prices.each[chosen].sum()
        if not free.any():
            break
        needed = (missing > 0).astype(np.float64) * weight
        best = int(np.where(free, seen @ needed, -1.0).argmax())
        chosen.append(best)
        missing = missing - seen[best]
        free &= mount != mount[best]
    return chosen


def prove_bound(
    seen: _Seen, weight: _Weight, mount: _Each, budget: int, *, views: int, chosen: list[int]
) -> int:
    """Most objects that any set can cover with `views` views of each. For one view the coverage of
    `chosen` plus the largest gains, one per mount, bounds too (Leskovec et al., KDD 2007)."""

    def largest(gains: np.ndarray) -> float:
        best = np.zeros(int(mount.max(initial=-1)) + 1)
        np.maximum.at(best, mount, gains)
        return float(np.sort(best)[::-1][:budget].sum())

    bounds = [float(weight.sum()), largest(seen @ weight.astype(np.float64)) / views]
    if views == 1:
        covered = seen[chosen].any(axis=0)
        bounds.append(float(weight[covered].sum()) + largest(seen @ np.where(covered, 0.0, weight)))
    return int(min(bounds) + 1e-6)


def _model(
    seen: np.ndarray,
    weights: np.ndarray,
    poles: Poles,
    budget: int,
    *,
    views: int,
    start: list[int],
    bound: int,
) -> "tuple[CpModel, list[IntVar]]":
    """The programme and its variables x. The set `start` is a complete hint."""
    cp = cp_model()
    model = cp.CpModel()
    built = [model.new_bool_var("") for _ in range(len(seen))]
    covered = [model.new_bool_var("") for _ in range(weights.shape[1])]
    for o, y in enumerate(covered):
        by = [built[c] for c in np.flatnonzero(seen[:, o]).tolist()]
        model.add(cp.LinearExpr.sum(by) >= views * y)
    poles.constrain(model, built)
    model.add(cp.LinearExpr.sum(built) <= budget)
    totals = [cp.LinearExpr.weighted_sum(covered, row.tolist()) for row in weights]
    reached = seen[start].sum(axis=0) >= views
    if len(totals) > 1:
        least = model.new_int_var(0, bound, "")
        for total in totals:
            model.add(total >= least)
        model.add_hint(least, min(int((weights @ reached).min()), bound))
        model.maximize(least)
    else:
        model.add(totals[0] <= bound)
        model.maximize(totals[0])
    for x, value in zip(
        built + covered, [*np.isin(np.arange(len(built)), start), *reached], strict=True
    ):
        model.add_hint(x, bool(value))
    return model, built
