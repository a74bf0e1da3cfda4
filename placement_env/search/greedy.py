"""Greedy search: add the most useful sensor each time. Candidates are scored in full, or they race.

A search goes on to `budget` sensors even where one loses, since a pair may gain where one does not,
and answers with the best set on the way. Where money limits it and prices differ, it goes a second
way by gain per price: the better of both, with the best single buy among its first steps, cannot be
fooled by one dear sensor that uses up the money (Khuller, Moss, Naor 1999; Leskovec et al. 2007).

With a monotone submodular objective (coverage, not AP, and no cost weights) a share of the optimum
is sure: 1 - 1/e with every candidate on its own mount (Nemhauser, Wolsey, Fisher 1978), 1/2 where
poses share mounts, a matroid (Fisher, Nemhauser, Wolsey 1978), none where links are shared. A bound
from the data is usually far tighter ("online bound", Leskovec et al., KDD 2007): for the answer S
and any feasible T of at most k sensors f(T) <= f(S) + sum over t in T of [f(S + t) - f(S)]. So no T
has more than f(S) and the k largest gains, of which each mount gives as many as it carries.

`with_first_sensors` gives a site without any sensors its first ones by greedy coverage, to try the
site."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from placement_env.candidates.candidates import PAPER, Models, pool
from placement_env.checks import check_whole
from placement_env.fidelity.coverage import LEAST
from placement_env.fidelity.seeing import see
from placement_env.fidelity.traffic import simulate_traffic
from placement_env.fidelity.visibility import Visibility
from placement_env.handover.mounted import mounted_site
from placement_env.objective import Objective
from placement_env.protocol import Estimate
from placement_env.search.progress import Progress, add_each, as_rows
from placement_env.search.result import Certificate, Result
from placement_env.setting import Setting
from placement_env.subsets import MemberSums, Sets
from toolkit.arrays import Float64
from toolkit.sites.site import Site

TOLERANCE = 1e-6  # a gain that rises by no more is rounding: figures are sums of float32


def search(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    submodular: bool | None = None,
) -> Result:
    """Best set on greedy's way; of equal candidates the first is taken, `seed` is not used.

    submodular: True for a custom fidelity that is known to be monotone submodular, None to check
    for coverage by one view. The answer then has a certificate, for C more sets, unless a gain was
    seen to grow."""
    progress = Progress(objective, budget, seconds, evaluations)
    chosen, rise = grow(progress)
    prices = objective.candidates.prices
    if math.isfinite(objective.most_price) and np.ptp(prices) > 0:
        grow(progress, prices)
    if is_submodular(objective) if submodular is None else submodular:
        known = certify(
            progress, chosen, guarantee(objective) if len(chosen) == budget else 0.0, rise
        )
    elif rise > TOLERANCE:
        grew = f"gains grew by up to {rise:.2g} as sensors joined"
        known = progress.unknown(f"{grew}: not submodular, nothing is promised")
    else:
        known = progress.unknown(
            "greedy promises nothing unless the objective is submodular, and AP is not"
        )
    return progress.result("greedy", known)


def grow(
    progress: Progress,
    prices: Float64[np.ndarray, " C"] | None = None,
    *,
    start: Sequence[int] = (),
) -> tuple[list[int], float]:
    """Greedy's candidates in order, as many as fit and the limits allow, and the largest growth of
    any gain. prices: of the candidates, to take the greatest gain per price; None for the greatest
    gain; start: first candidates."""
    chosen = list(start)
    reward = 0.0
    rise = 0.0
    gains = np.full(progress.size, np.inf)
    while len(chosen) < progress.budget:
        options = np.flatnonzero(progress.objective.next_allowed(chosen))
        rewards = progress.rewards(add_each(chosen, options, progress.size))
        if not (scored := np.isfinite(rewards)).any():
            break
        rise = max(rise, float((rewards[scored] - reward - gains[options[scored]]).max()))
        gains[options[scored]] = rewards[scored] - reward
        worth = (
            rewards if prices is None else (rewards - reward) / np.maximum(prices[options], 1e-300)
        )
        best = int(worth.argmax())
        chosen.append(int(options[best]))
        reward = float(rewards[best])
    return chosen, rise


def raced(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
) -> Result:
    """Greedy set whose candidates race for each place (`Objective.race`), for the detector, where a
    frame is slow.

    Evaluations count sets on all frames, rounded up; limits are checked between races. Raises
    ValueError for a fidelity that cannot score some of the frames."""
    progress = Progress(objective, budget, seconds, evaluations)
    chosen: list[int] = []
    while len(chosen) < budget and not progress.spent:
        options = np.flatnonzero(objective.next_allowed(chosen))
        if not len(options):
            break
        sets = add_each(chosen, options, progress.size)
        ran = objective.race(sets, seed=seed)
        winner = int(ran.winners[0])
        progress.limits.count += math.ceil(len(sets) * ran.spent / ran.full) - 1
        progress.rewards(sets[winner][None])
        chosen.append(int(options[winner]))
    return progress.result(
        "raced greedy", progress.unknown("greedy promises nothing for AP, and a race may miss")
    )


def is_submodular(objective: Objective) -> bool:
    """True where AP is known to be monotone submodular: coverage by at least one view, of the mean
    of classes."""
    additive = len(objective.classes.names) == 1 or objective.classes.combine == "mean"
    return (
        additive
        and objective.fidelity == "coverage"
        and getattr(objective.scored_by, "views", None) == 1
    )


def guarantee(objective: Objective) -> float:
    """Share of the optimum that greedy reaches for monotone submodular objectives without cost
    weights."""
    if len(objective.kept):
        return 0.0
    mount = objective.candidates.mount[objective.allowed([])]
    alone = not objective.candidates.several and len(np.unique(mount)) == len(mount)
    return 1 - 1 / np.e if alone else 0.0 if objective.shared_links is not None else 0.5


def online_bound(progress: Progress, chosen: list[int]) -> float:
    """Upper bound on AP and reward of any feasible set, if AP is monotone submodular here; inf
    where limits hide it."""
    candidates = progress.objective.candidates
    options = np.flatnonzero(progress.objective.allowed([]))
    subsets = np.vstack(
        [as_rows([chosen], progress.size), add_each(chosen, options, progress.size)]
    )
    ap = progress.figures(subsets).ap
    if np.isnan(ap).any():
        return np.inf
    gains = np.maximum(ap[1:] - ap[0], 0.0)
    mount = candidates.mount[options]
    each = [np.sort(gains[mount == m])[::-1][: candidates.places[m]] for m in np.unique(mount)]
    return float(
        ap[0] + np.sort(np.concatenate([*each, np.zeros(1)]))[::-1][: progress.budget].sum()
    )


def certify(progress: Progress, chosen: list[int], ratio: float, rise: float) -> Certificate:
    """Greedy's certificate for a monotone submodular objective. ratio: guaranteed share of the
    optimum, void under cost weights; rise: largest observed growth of a gain."""
    costs = progress.objective.weights.comm > 0 or progress.objective.weights.price > 0
    if rise > TOLERANCE and not costs:
        return progress.unknown(
            f"said to be submodular, but a gain grew by {rise:.2g} as other sensors joined"
        )
    ratio = 0.0 if costs else ratio
    promise = f", and at least {ratio:.3f} of the optimum" if ratio else ""
    note = (
        "if AP is monotone submodular here, as coverage is: the online bound of Leskovec et al. "
        f"2007{promise}"
    )
    return Certificate("bound", progress.reward, online_bound(progress, chosen), ratio, note)


HEIGHT = 6.0  # m above the foot of the mount
TILT = float(np.deg2rad(15.0))  # rad below the horizon
HEADINGS = 8
FIRST_FRAMES = 40


@dataclass(frozen=True, eq=False)
class FirstSensors:
    """A site with first sensors. covered: share of the vehicles on which a sensor has `LEAST`
    points or more."""

    site: Site
    poses: int
    covered: float

    def __str__(self) -> str:
        count = len(self.site.sensors)
        mounts = len(self.site.mounts)
        return (
            f"{count} sensors placed by coverage: from {self.poses} poses of the paper's camera "
            f"on {mounts} mounts ({HEIGHT:g} m up, {np.rad2deg(TILT):.0f} degrees down, "
            f"{HEADINGS} headings), each in turn the pose that sees most vehicles with {LEAST:g} "
            f"points in {FIRST_FRAMES} frames of traffic; together they see {self.covered:.0%}. "
            "This is a start to try the site: coview plan or coview search says what to build"
        )


class HalvedViews:
    """Mean over objects of 1 - 2^-n where n sensors of a set have `LEAST` points on the object.
    Submodular. Each further view is worth half of the one before, so sensors that add no object
    still spread their views."""

    name = "halved views"

    def __init__(self, visibility: Visibility) -> None:
        self._sums = MemberSums((visibility.points >= LEAST).astype(np.uint16))

    def __call__(self, subsets: Sets, /) -> Estimate:
        """Return the mean of each set as AP and recall."""
        worth = np.zeros(len(subsets))
        for block, views in self._sums.blocks(subsets):
            worth[block] = (1 - 0.5 ** views.astype(np.float64)).mean(axis=1)
        return Estimate(worth, worth.copy(), np.zeros(len(subsets)))


def with_first_sensors(
    site: Site, count: int, *, models: Models = PAPER, tilts: Sequence[float] = (TILT,)
) -> FirstSensors:
    """Replace a site's sensors by `count` on its mounts, fewer if no more fit or see a vehicle.
    models, tilts: as `pool` takes them. Raises ValueError for a count below 1, and for a site
    without mounts, poses or vehicles."""
    check_whole("number of sensors", count, least=1)
    candidates = pool(site, heights=[HEIGHT], headings=HEADINGS, tilts=tilts, models=models)
    visibility = see(simulate_traffic(site, FIRST_FRAMES), candidates)
    if not visibility.points.shape[1]:
        said = f"no vehicle enters the area of site {site.name!r} in {FIRST_FRAMES} frames"
        raise ValueError(f"{said}: place sensors yourself")
    setting = Setting(site, candidates=candidates, fidelity=HalvedViews(visibility))
    chosen = search(Objective(setting, visibility=visibility), count).best.subset
    covered = (visibility.points[list(chosen)] >= LEAST).any(axis=0).mean() if chosen else 0.0
    return FirstSensors(mounted_site(site, candidates, chosen), len(candidates), float(covered))
