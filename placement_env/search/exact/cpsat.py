"""The largest coverage, with a proven bound.

Maximum (k-)coverage is an integer programme, solved by CP-SAT (OR-Tools).

    max Σ_o w_o y_o    where  Σ_c seen[c, o] x_c >= k y_o,   Σ_{c on m} x_c <= 1 for each mount m,   Σ_c x_c <= budget

x_c: candidate c is built; y_o: at least k of the built ones see object o, each with enough points. Objects that the
same candidates see are one object of weight w. What cannot be covered is left out, and so is a pose that sees
nothing which another on its mount does not see. Of several classes of objects the shares that are covered count by
their weights, or the worst of them: max z where z <= Σ_o w_ko y_o for every class k.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from placement_env.checks import check_whole
from placement_env.classes import Classes
from placement_env.fidelity.coverage import LEAST
from placement_env.fidelity.visibility import Visibility
from placement_env.objective import Objective
from placement_env.protocol import ByFrames
from placement_env.search.exact.poles import Poles, Prices
from placement_env.search.exact.solver import build_solver, cp_model
from placement_env.search.exact.ties import best_of_equals
from placement_env.search.progress import Progress
from placement_env.search.result import Certificate, Result
from toolkit.arrays import Bool, Int64

if TYPE_CHECKING:
    from ortools.sat.python.cp_model import CpModel, IntVar

PARTS = 10**9  # parts into which the sum over several classes is divided
SECONDS = 60.0  # default limit of solving


class Cover(NamedTuple):
    """Solution of a coverage programme.

    chosen: candidates, ascending; covered: objects they cover; bound: most that any feasible set covers; optimal:
    whether the two are equal; merged: objects after merging; built, solved: seconds.
    """

    chosen: list[int]
    covered: int
    bound: int
    optimal: bool
    merged: int
    built: float
    solved: float


def search(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    visibility: Visibility | None = None,
    least: float = LEAST,
    views: int = 1,
    workers: int = 1,
    effort: float | None = None,
) -> Result:
    """The set that covers most, and its score.

    Among equally good sets, as far as they are tried, the objective picks the best, unless that takes a detector.

    The certificate is of the coverage. visibility: of the objective's candidates, None for its own; least: points that
    make a view; views: k; workers: threads of the solver; effort: of solving, in OR-Tools' deterministic seconds, None
    for unlimited: one worker cut short by it gives the same answer again; seconds: 60 if None; evaluations: of the
    choice among equals. One worker finds the same set for the same seed as long as `seconds` do not cut it short.
    Raises ValueError where the objective has no visibility and none is given, and ImportError without OR-Tools.
    """
    visibility = objective.visibility if visibility is None else visibility
    if visibility is None:
        raise ValueError("CP-SAT needs to know what each candidate sees: pass visibility=see(traffic, candidates)")
    progress = Progress(objective, budget, seconds, evaluations)
    visibility = visibility.of_classes(objective.classes.labels)
    seen, mount, may_stand = visibility.points >= least, objective.candidates.mount, objective.allowed([])
    worth, units = compute_worth(visibility.labels, objective.classes)
    left = SECONDS if seconds is None else seconds
    cover = cover_most(
        seen,
        mount,
        budget,
        views=views,
        may_stand=may_stand,
        seconds=left,
        workers=workers,
        seed=seed,
        effort=effort,
        prices=Prices.of(objective),
        worth=worth,
        poles=Poles.of(objective),
    )
    parts = np.ones((1, seen.shape[1]), np.int64) if worth is None else worth

    def covered(sets: Bool[np.ndarray, "n C"]) -> Int64[np.ndarray, " n"]:
        return np.array([int((parts @ (seen[row].sum(axis=0) >= views)).min()) for row in sets], np.int64)

    slow = isinstance(objective.scored_by, ByFrames)
    chosen = cover.chosen if slow else best_of_equals(progress, cover.chosen, covered)
    progress.settle(chosen)
    objects = max(1, units)
    members = ", ".join(map(str, chosen))
    view = f"{views} view(s) of {least:g} points or more from {{{members}}}"
    if worth is None:
        note = f"{cover.covered} of {units} objects have {view}, and no set covers more than {cover.bound}"
    else:
        share, most = cover.covered / units, cover.bound / units
        note = f"{share:.4f} of the {objective.classes.described()} has {view}, and no set covers more than {most:.4f}"
    certificate = Certificate(
        "optimal" if cover.optimal else "bound",
        cover.covered / objects,
        cover.bound / objects,
        1.0 if cover.optimal else 0.0,
        note,
        "coverage",
    )
    return progress.result("CP-SAT", certificate)


def cover_most(
    seen: Bool[np.ndarray, "C O"],
    mount: Int64[np.ndarray, " C"],
    budget: int,
    *,
    views: int = 1,
    may_stand: Bool[np.ndarray, " C"] | None = None,
    seconds: float = SECONDS,
    workers: int = 1,
    seed: int = 0,
    effort: float | None = None,
    prices: Prices | None = None,
    worth: Int64[np.ndarray, "k O"] | None = None,
    poles: Poles | None = None,
) -> Cover:
    """Choose candidates that cover the most objects.

    At most `budget` candidates are chosen, one per mount unless `poles` say more. An object is covered by at least
    `views` of them. seen: candidates × objects, True where seen; may_stand: candidates that may be built, all if None;
    seconds: in all; effort: see `search`; prices: with their limit, None for unlimited; worth: of each object to each
    of k parties, the least of whose sums counts (`compute_worth`), None to count objects. The solver starts from
    greedy's set, so the answer covers no less.

    >>> cover_most(np.array([[1, 1, 0], [0, 1, 1], [0, 0, 1]], bool), np.array([0, 0, 1]), 2).chosen
    [0, 2]
    """
    check_whole("budget", budget, least=1)
    check_whole("views", views, least=1)
    began = time.monotonic()
    rows = np.ones(len(seen), bool) if may_stand is None else may_stand
    there = Poles.single(mount) if poles is None else poles
    kept = useful(np.where(rows[:, None], seen, False), there.apart, None if prices is None else prices.alone)
    cost, there = None if prices is None else prices.select(kept), there.select(kept)
    each = np.ones((1, seen.shape[1]), np.int64) if worth is None else worth
    objects, weights = _merged_worth(seen[kept], there.apart, views, each)
    start = greedy_cover(objects, weights.sum(axis=0), there.mount, budget, views, poles=there, prices=cost)
    bound = min(prove_bound(objects, row, there.apart, budget, views=views, chosen=start) for row in weights)
    model, built = _model(objects, weights, there, budget, views=views, start=start, bound=bound)
    if cost is not None:
        model.add(cost.expression(model, built) <= cost.most)
    solver = build_solver(max(0.01, seconds - (time.monotonic() - began)), workers, seed, effort)
    ready = time.monotonic()
    status = solver.status_name(solver.solve(model))
    times = (ready - began, time.monotonic() - ready)
    if status in ("OPTIMAL", "FEASIBLE"):  # otherwise time ran out before a solution was found
        start = [c for c, x in enumerate(built) if solver.boolean_value(x)]
        bound = min(bound, int(np.floor(solver.best_objective_bound + 1e-6)))
    chosen = sorted(kept[start].tolist())
    covered = int((each @ (seen[chosen].sum(axis=0) >= views)).min())
    return Cover(chosen, covered, max(bound, covered), bound <= covered, weights.shape[1], *times)


def compute_worth(labels: Int64[np.ndarray, " O"], classes: Classes) -> tuple[Int64[np.ndarray, "k O"] | None, int]:
    """Worth of covering each object, and the total.

    Worth is in whole parts of the total; None counts objects, where one class counts. The parts of a class go to its
    objects in equal shares. The mean of classes uses their weights; the worst has one row per class, all with the same
    sum.
    """
    there = [label for label in classes.labels if (labels == label).any()]
    if len(classes.names) == 1 or not there:
        return None, len(labels)
    shares = np.zeros((len(there), len(labels)))
    for row, label in enumerate(there):
        shares[row, labels == label] = 1 / (labels == label).sum()
    if classes.combine == "worst":
        return np.rint(shares * PARTS).astype(np.int64), PARTS
    weights = np.array(
        [weight for label, weight in zip(classes.labels, classes.weights, strict=True) if label in there]
    )
    return np.rint(weights @ shares / weights.sum() * PARTS).astype(np.int64)[None], PARTS


def useful(
    seen: Bool[np.ndarray, "C O"], mount: Int64[np.ndarray, " C"], prices: Int64[np.ndarray, " C"] | None = None
) -> Int64[np.ndarray, " k"]:
    """Candidates that no other on their mount can replace.

    A useful candidate sees something, and no other on its mount sees all of that and more for no higher a price. Of
    several on a mount that see the same, the first is kept.

    >>> useful(np.array([[1, 0], [1, 1], [1, 0], [0, 0]], bool), np.array([0, 0, 1, 1]))
    array([1, 2])
    """
    keep = np.asarray(seen.any(axis=1))
    for here in np.unique(mount):
        poses = np.flatnonzero(keep & (mount == here))
        views = seen[poses].astype(np.float32)
        size = views.sum(axis=1)
        within = (views @ views.T) == size[:, None]  # all that i sees, j sees
        earlier = np.arange(len(poses))[None] < np.arange(len(poses))[:, None]
        price = np.zeros(len(poses), np.int64) if prices is None else prices[poses]
        cheaper = price[None] < price[:, None]
        more = (size[None] > size[:, None]) | cheaper
        equal = (size[None] == size[:, None]) & (price[None] == price[:, None])
        beaten = within & (price[None] <= price[:, None]) & (more | (equal & earlier))
        keep[poses[beaten.any(axis=1)]] = False
    return np.flatnonzero(keep)


def merged(
    seen: Bool[np.ndarray, "C O"], mount: Int64[np.ndarray, " C"], views: int
) -> tuple[Bool[np.ndarray, "C m"], Int64[np.ndarray, " m"]]:
    """Kinds of objects seen by different candidates.

    The number of objects of each kind comes too. Objects that fewer than `views` mounts see are left out.
    """
    objects, weights = _merged_worth(seen, mount, views, np.ones((1, seen.shape[1]), np.int64))
    return objects, weights[0]


def _merged_worth(
    seen: Bool[np.ndarray, "C O"], mount: Int64[np.ndarray, " C"], views: int, worth: Int64[np.ndarray, "k O"]
) -> tuple[Bool[np.ndarray, "C m"], Int64[np.ndarray, "k m"]]:
    """Kinds of objects as `merged`, with their total worth."""
    mounts = np.unique(mount)
    able = np.zeros(seen.shape[1], np.int64)
    for here in mounts:
        able += seen[mount == here].any(axis=0)
    seen, worth = seen[:, able >= views], worth[:, able >= views]
    if not seen.size:
        return seen[:, :0], worth[:, :0]
    packed = np.ascontiguousarray(np.packbits(seen, axis=0).T)
    keys = packed.view(np.dtype((np.void, packed.shape[1])))[:, 0]
    _, first, place = np.unique(keys, return_index=True, return_inverse=True)
    weights = np.zeros((len(worth), len(first)), np.int64)
    for row, own in zip(weights, worth, strict=True):
        np.add.at(row, place.ravel(), own)
    return seen[:, first], weights


def greedy_cover(
    seen: Bool[np.ndarray, "C m"],
    weight: Int64[np.ndarray, " m"],
    mount: Int64[np.ndarray, " C"],
    budget: int,
    views: int,
    *,
    poles: Poles | None = None,
    prices: Prices | None = None,
) -> list[int]:
    """Cover objects greedily, one candidate after another.

    Each step takes the candidate that adds most views to objects with fewer than `views`. It needs a free place and
    must fit the remaining money.

    >>> greedy_cover(np.array([[1, 1, 0], [0, 1, 1]], bool), np.array([1, 1, 5]), np.array([0, 1]), 1, 1)
    [1]
    """
    missing, free = np.full(len(weight), views), np.ones(len(seen), bool)
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
    seen: Bool[np.ndarray, "C m"],
    weight: Int64[np.ndarray, " m"],
    mount: Int64[np.ndarray, " C"],
    budget: int,
    *,
    views: int,
    chosen: list[int],
) -> int:
    """Most objects that any set can cover.

    Each covered object needs `views` views. For one view (Leskovec et al., KDD 2007) the bound is also the coverage of
    `chosen` plus the largest gains on top of it, one per mount.
    """

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
    seen: np.ndarray, weights: np.ndarray, poles: Poles, budget: int, *, views: int, start: list[int], bound: int
) -> tuple[CpModel, list[IntVar]]:
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
    total = cp.LinearExpr.weighted_sum(covered, weights[0].tolist())
    if len(weights) > 1:
        least = model.new_int_var(0, bound, "")
        for row in weights:
            model.add(cp.LinearExpr.weighted_sum(covered, row.tolist()) >= least)
        hinted = int((weights @ (seen[start].sum(axis=0) >= views)).min())
        model.add_hint(least, min(hinted, bound))
        model.maximize(least)
    else:
        model.add(total <= bound)
        model.maximize(total)
    hint = [*np.isin(np.arange(len(built)), start), *(seen[start].sum(axis=0) >= views)]
    for x, value in zip(built + covered, hint, strict=True):
        model.add_hint(x, bool(value))
    return model, built
