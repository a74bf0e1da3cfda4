"""Largest (k-)coverage, with a proven bound: an integer programme, solved by CP-SAT (OR-Tools).

    max Σ_o w_o y_o
    where  Σ_c seen[c, o] x_c >= k y_o,
           Σ_{c on m} x_c <= 1 for each mount m,
           Σ_c x_c <= budget

x_c: candidate c is built; y_o: at least k of the built ones see object o, each with enough points.
Objects that the same candidates see are one object of weight w. Objects that cannot be covered are
left out, as are poses whose objects another pose on the same mount sees too. Of several classes the
covered shares count by their weights, or the worst of them: max z, with z <= Σ_o w_ko y_o for every
class k.
"""

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
    DEFAULT_SOLVER_S,
    Poles,
    Prices,
    Solved,
    SolverLimits,
    load_cp_model,
    run_solver,
)
from placement_env.search.progress import Progress
from placement_env.search.result import Certificate, Result
from placement_env.search.verification import improve_among_equals
from placement_env.subsets import Sets
from toolkit.arrays import Bool, Int64

if TYPE_CHECKING:
    from ortools.sat.python.cp_model import CpModel, IntVar

WORTH_UNITS = 10**9  # whole units of the sum over several classes
_Seen = Bool[np.ndarray, "candidates objects"]  # candidates × objects, True if seen
_PerCandidate = Int64[np.ndarray, " candidates"]  # such as mounts or prices
_Weight = Int64[np.ndarray, " objects"]  # worth of covering each object
_Worth = Int64[np.ndarray, "k objects"]  # the same for k groups; the lowest sum counts


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
    """Set that covers the most objects, with a certificate of the coverage.

    Among equally good sets that are tried, the objective picks the best, unless that takes a
    detector. The same seed gives the same set as long as `seconds` do not stop the solver.

    Args:
        objective: Candidates, their constraints, and the score of the result.
        budget: Largest number of sensors.
        seed: Seed of the solver.
        seconds: Limit of the search, 60 if None.
        evaluations: Limit on scored sets in the choice among equals, None for none.
        visibility: Points of the candidates on the objects, None for the objective's.
        views: Number of sensors that must see an object, each with `LEAST` points or more.
        effort: Limit of solving in OR-Tools' deterministic seconds, None for unlimited.

    Raises ValueError without visibility, and ImportError without OR-Tools.
    """
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
        Poles.from_objective(objective),
        budget,
        views=views,
        is_buildable=objective.allowed([]),
        prices=Prices.from_objective(objective),
        worth=worth,
        limits=SolverLimits(
            seconds=DEFAULT_SOLVER_S if seconds is None else seconds, seed=seed, effort=effort
        ),
    )

    def covered(sets: Sets) -> Int64[np.ndarray, " n"]:
        """Worth that each set (row of booleans) covers, in its group with the lowest sum."""
        totals = np.zeros(len(sets), np.int64)
        for n, row in enumerate(sets):
            totals[n] = (worth @ (seen[row].sum(axis=0) >= views)).min()
        return totals

    members = cover.members or []
    if not isinstance(objective.scored_by, ByFrames):
        members = improve_among_equals(progress, members, covered)
    progress.settle(members)
    share = cover.value / max(1, units)
    max_share = cover.bound / max(1, units)
    note = _describe_coverage(cover, units, members, views=views, classes=objective.classes)
    return progress.result(
        "CP-SAT", Certificate.from_bound(share, bound=max_share, note=note, measure="coverage")
    )


def _describe_coverage(
    cover: Solved, units: int, members: list[int], *, views: int, classes: Classes
) -> str:
    """Sentence on what the set covers, and on the most that any set could cover.

    It gives shares if several classes are weighed, else numbers of objects.

    cover: covered units and their bound; units: units of all objects; members: the set; views:
    number of sensors that must see an object."""
    numbers = ", ".join(map(str, members))
    views_text = f"{views} view(s) of {LEAST:g} points or more from {{{numbers}}}"
    if units == WORTH_UNITS:
        share = cover.value / units
        max_share = cover.bound / units
        return (
            f"{share:.4f} of the {classes.described()} has {views_text}, and no set "
            f"covers more than {max_share:.4f}"
        )
    return (
        f"{cover.value} of {units} objects have {views_text}, and no set covers more than "
        f"{cover.bound}"
    )


def cover_most(
    seen: _Seen,
    poles: Poles,
    budget: int,
    *,
    views: int = 1,
    is_buildable: Bool[np.ndarray, " candidates"] | None = None,
    prices: Prices | None = None,
    worth: _Worth | None = None,
    limits: SolverLimits = SolverLimits(),
) -> Solved:
    """Choose candidates that cover the most objects, each seen by at least `views` candidates.

    The solver starts from the set of `greedy_cover`, so the answer covers no less if that
    set satisfies all constraints. Returns indices of candidates, ascending, and what they cover.

    Args:
        seen: Candidates × objects, True if seen.
        poles: Places and links of the candidates' mounts.
        budget: Largest number of candidates.
        views: Number of candidates that must see an object to cover it.
        is_buildable: Mask of candidates that may be built, None for all.
        prices: Prices with their limit, None for no limit.
        worth: Worth of covering each object, for k groups; the lowest sum counts
            (`compute_worth`); None to count objects.
        limits: Time and seed of the solver.
    """
    check_whole("budget", budget, least=1)
    check_whole("views", views, least=1)
    began = time.monotonic()
    is_allowed = np.ones(len(seen), np.bool_) if is_buildable is None else is_buildable
    is_required = is_allowed & np.isin(poles.mount, poles.required)
    useful = drop_dominated(
        seen & is_allowed[:, None],
        mount=poles.exclusive_mount,
        prices=None if prices is None else prices.sensor + prices.per_mount,
        is_required=is_required,
    )
    cost = None if prices is None else prices.select(useful)
    poles = poles.select(useful)
    object_worth = np.ones((1, seen.shape[1]), np.int64) if worth is None else worth
    objects, weights = merge_objects(
        seen[useful], mount=poles.exclusive_mount, views=views, worth=object_worth
    )
    # from here on candidates are counted among the useful ones
    total_weight = weights.sum(axis=0)
    start = greedy_cover(
        objects, weight=total_weight, mount=poles.mount, budget=budget, views=views, prices=cost
    )
    bound = _prove_lowest_bound(
        objects, weights, mount=poles.exclusive_mount, budget=budget, views=views, members=start
    )
    model, built = _build_model(
        objects, weights, poles, budget, views=views, start=start, bound=bound
    )
    if cost is not None:
        model.add(cost.expression(model, built) <= cost.limit)
    # 0.01 s: the solver gets a little time even after the end
    remaining_s = max(0.01, limits.seconds - (time.monotonic() - began))
    solver = replace(limits, seconds=remaining_s).build_solver()
    # for any other status time ran out before a solution: the start may lack required mounts
    answer = [] if poles.required else start
    if run_solver(solver, model) in ("OPTIMAL", "FEASIBLE"):
        answer = [c for c, x in enumerate(built) if solver.boolean_value(x)]
        # 1e-6: a bound just below a whole number is rounding
        bound = min(bound, int(np.floor(solver.best_objective_bound + 1e-6)))
    members = sorted(useful[answer].tolist())
    covered = int((object_worth @ (seen[members].sum(axis=0) >= views)).min())
    return Solved(
        members=members, value=covered, bound=max(bound, covered), optimal=bound <= covered
    )


def _prove_lowest_bound(
    objects: _Seen,
    weights: _Worth,
    *,
    mount: _PerCandidate,
    budget: int,
    views: int,
    members: list[int],
) -> int:
    """Lowest upper bound on what sets can cover, over groups of objects.

    Args:
        objects: Candidates × objects, True if seen.
        weights: Weight of covering each object, a row for each group.
        mount: Number of each candidate's mount; at most one candidate of a mount is built.
        budget: Largest number of candidates.
        views: Views that cover an object.
        members: Any set, as indices of candidates; the better it is, the tighter the bounds."""
    bounds = [
        prove_bound(objects, weight, mount, budget, views=views, members=members)
        for weight in weights
    ]
    return min(bounds)


def compute_worth(labels: Int64[np.ndarray, " objects"], classes: Classes) -> tuple[_Worth, int]:
    """Worth of covering each object in whole numbers, and the total of all.

    The worth has a row for each group of objects whose lowest sum counts. With one class each
    object counts 1, in one row. With several classes, the objects of a class share its units
    equally. For the mean of classes there is one row, in which classes have `WORTH_UNITS` together,
    by their weights. For the worst class there is a row for each class, which has all
    `WORTH_UNITS`. Classes without an object are left out.

    labels: class (number) of each object; classes: classes that count.
    """
    present_classes = [
        (label, weight)
        for label, weight in zip(classes.labels, classes.weights, strict=True)
        if label in labels
    ]
    if len(classes.names) == 1 or not present_classes:
        return np.ones((1, len(labels)), np.int64), len(labels)
    # classes × objects; each row of shares adds up to 1
    class_rows = np.array([labels == label for label, _ in present_classes])
    shares = class_rows / class_rows.sum(axis=1, keepdims=True)
    if classes.combine == "mean":
        weights = np.array([weight for _, weight in present_classes])
        shares = (weights @ shares / weights.sum())[None]
    return np.rint(shares * WORTH_UNITS).astype(np.int64), WORTH_UNITS


def drop_dominated(
    seen: _Seen,
    mount: _PerCandidate,
    prices: _PerCandidate | None = None,
    is_required: Bool[np.ndarray, " candidates"] | None = None,
) -> Int64[np.ndarray, " k"]:
    """Indices of candidates without those that another one on the same mount makes useless.

    A candidate is useless if it sees nothing, or if another one on its mount sees all the same
    objects for no higher a price; of equal ones the first stays.

    Args:
        seen: Candidates × objects, True if seen.
        mount: Number of each candidate's mount; at most one candidate of a mount is built.
        prices: Price of each candidate, None if prices do not matter.
        is_required: Mask of candidates that are useful even if they see nothing.

    Returns:
        Indices, ascending.
    """
    is_useful = np.asarray(
        seen.any(axis=1) if is_required is None else seen.any(axis=1) | is_required
    )
    for mount_number in np.unique(mount):
        poses = np.flatnonzero(is_useful & (mount == mount_number))
        pose_sees = seen[poses].astype(np.float32)  # poses × objects, 1 if seen
        seen_count = pose_sees.sum(axis=1)
        price = np.zeros(len(poses)) if prices is None else prices[poses]
        # masks of pairs: pose i on the first axis, pose j, which may make it useless, on the second
        is_covered = (pose_sees @ pose_sees.T) == seen_count[:, None]  # all that i sees, j sees
        is_earlier = np.arange(len(poses))[None] < np.arange(len(poses))[:, None]
        is_better = (seen_count[None] > seen_count[:, None]) | (price[None] < price[:, None])
        is_beaten = is_covered & (price[None] <= price[:, None]) & (is_better | is_earlier)
        is_useful[poses[is_beaten.any(axis=1)]] = False
    return np.flatnonzero(is_useful)


def merge_objects(
    seen: _Seen, mount: _PerCandidate, views: int, worth: _Worth
) -> tuple[Bool[np.ndarray, "candidates m"], Int64[np.ndarray, "k m"]]:
    """Merge objects that the same candidates see, and leave out those that cannot be covered.

    Args:
        seen: Candidates × objects, True if seen.
        mount: Number of each candidate's mount; at most one candidate of a mount is built.
        views: Number of mounts that must see an object to cover it.
        worth: Worth of each object, for k groups.

    Returns:
        Candidates × m merged objects, True if seen, and k groups × m, the sum of the worth of the
        objects merged into each."""
    observing_mounts = np.zeros(seen.shape[1])  # number for each object
    for mount_number in np.unique(mount):
        observing_mounts = observing_mounts + seen[mount == mount_number].any(axis=0)
    is_coverable = observing_mounts >= views
    seen = seen[:, is_coverable]
    worth = worth[:, is_coverable]
    if not seen.size:
        return seen[:, :0], worth[:, :0]
    # each object's column of bits as one opaque value, which np.unique can compare
    packed_columns = np.ascontiguousarray(np.packbits(seen, axis=0).T)
    _, byte_count = packed_columns.shape
    keys = packed_columns.view(np.dtype((np.void, byte_count)))[:, 0]
    _, first_object, merged_index = np.unique(keys, return_index=True, return_inverse=True)
    weights = np.zeros((len(worth), len(first_object)), np.int64)
    np.add.at(weights.T, merged_index.ravel(), worth.T)  # adds repeated indices too
    return seen[:, first_object], weights


def greedy_cover(
    seen: _Seen,
    weight: _Weight,
    mount: _PerCandidate,
    budget: int,
    views: int,
    *,
    prices: Prices | None = None,
) -> list[int]:
    """Set that covers objects greedily, as indices of candidates in the order of choice.

    Each step adds the candidate with the largest weight of seen objects that have fewer than
    `views` views so far. A mount carries at most one candidate.

    Args:
        seen: Candidates × objects, True if seen.
        weight: Weight of each object.
        mount: Index of each candidate's mount.
        budget: Largest number of candidates.
        views: Views that an object needs.
        prices: Prices with their limit, None for no limit.
    """
    missing_views = np.full(len(weight), views)  # per object; below 0 if seen more often
    is_free = np.ones(len(seen), bool)
    members: list[int] = []
    while len(members) < budget:
        if prices is not None:
            # no member shares a mount with a free candidate, which so pays the mount's price too
            is_free &= prices.sensor + prices.per_mount <= prices.limit - prices.total(members)
        if not is_free.any():
            break
        open_weight = (missing_views > 0).astype(np.float64) * weight
        best = int(np.where(is_free, seen @ open_weight, -1.0).argmax())
        members.append(best)
        missing_views = missing_views - seen[best]
        is_free &= mount != mount[best]
    return members


def prove_bound(
    seen: _Seen,
    weight: _Weight,
    mount: _PerCandidate,
    budget: int,
    *,
    views: int,
    members: list[int],
) -> int:
    """Upper bound on the weight that any set of at most `budget` candidates can cover.

    It is the lowest of some bounds. For one view the coverage of `members` plus the largest gains,
    one per mount, is another one (Leskovec et al., KDD 2007).

    Args:
        seen: Candidates × objects, True if seen.
        weight: Weight of each object.
        mount: Number of each candidate's mount; at most one candidate of a mount is built.
        budget: Largest number of candidates.
        views: Views that cover an object.
        members: Any set, as indices of candidates; the better it is, the tighter the bound.
    """

    def largest(gains: np.ndarray) -> float:
        """Sum of the `budget` largest gains of candidates, at most one on each mount."""
        best = np.zeros(int(mount.max(initial=-1)) + 1)
        np.maximum.at(best, mount, gains)
        return float(np.sort(best)[::-1][:budget].sum())

    # all objects; what each candidate sees, of which an object needs `views` candidates
    bounds = [float(weight.sum()), largest(seen @ weight.astype(np.float64)) / views]
    if views == 1:
        covered = seen[members].any(axis=0)
        bounds.append(float(weight[covered].sum()) + largest(seen @ np.where(covered, 0.0, weight)))
    return int(min(bounds) + 1e-6)  # 1e-6: a bound just below a whole number is rounding


def _build_model(
    seen: np.ndarray,
    weights: np.ndarray,
    poles: Poles,
    budget: int,
    *,
    views: int,
    start: list[int],
    bound: int,
) -> "tuple[CpModel, list[IntVar]]":
    """CP-SAT's model of the largest coverage, and its variable for each candidate.

    Args:
        seen: Candidates × objects, True if seen.
        weights: Weight of each object, for k groups; the lowest sum is maximised.
        poles: Places and links of the candidates' mounts.
        budget: Largest number of candidates.
        views: Views that cover an object.
        start: Set (indices of candidates) at which the solver begins; values are hinted for all
            variables.
        bound: Known upper bound on the covered weight."""
    cp = load_cp_model()
    model = cp.CpModel()
    built = [model.new_bool_var("") for _ in range(len(seen))]
    covered = [model.new_bool_var("") for _ in range(weights.shape[1])]
    for o, y in enumerate(covered):
        observers = [built[c] for c in np.flatnonzero(seen[:, o]).tolist()]
        model.add(cp.LinearExpr.sum(observers) >= views * y)
    poles.constrain(model, built)
    model.add(cp.LinearExpr.sum(built) <= budget)
    totals = [cp.LinearExpr.weighted_sum(covered, row.tolist()) for row in weights]
    is_covered = seen[start].sum(axis=0) >= views
    if len(totals) > 1:
        min_total = model.new_int_var(0, bound, "")
        for total in totals:
            model.add(total >= min_total)
        model.add_hint(min_total, min(int((weights @ is_covered).min()), bound))
        model.maximize(min_total)
    else:
        model.add(totals[0] <= bound)
        model.maximize(totals[0])
    for x, value in zip(
        built + covered, [*np.isin(np.arange(len(built)), start), *is_covered], strict=True
    ):
        model.add_hint(x, bool(value))
    return model, built
