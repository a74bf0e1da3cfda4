"""First look: all candidates on a few frames, for a first answer and to narrow a large pool.

Memory and time of a search grow with the square of the candidates. So of more than `MAX_POSES`
poses only some go on. Poles are thinned first, before anything is rendered: in each square of a
grid the pole nearest to the area's middle goes on, in squares so large that at most `MAX_POLES` are
left. Then the poses go on that see most at the first look: the best few of each pole, then the best
of all. Poles that must carry a sensor stay."""

import math
from dataclasses import replace

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.fidelity.point_count import ENOUGH_POINTS, PointCount
from placement_env.fidelity.preparation import Preparation
from placement_env.objective import Objective
from placement_env.setting import Setting
from toolkit.arrays import Float64, Int64
from toolkit.display import describe_count
from toolkit.runtime.run import Run

LOOK_FRAMES = 8  # among the frames that are searched
MAX_POSES = 3_000  # that are searched
MAX_POLES = 400  # that carry them
MIN_POSES_ON_POLE = 4  # on each such pole, if it has as many
MIN_SPACING_M = 1.0  # side of the squares that thin the poles, at first
SPACING_GROWTH = 1.2  # by which they grow until few enough poles are left


def prepare_first_look(setting: Setting, run: Run, stride: int = 1) -> Preparation:
    """Prepare the first frames of a search."""
    whole = Preparation(setting, replace(run, progress=None), stride)
    few = Preparation(setting, whole.run, stride)
    vars(few)["traffic"] = whole.traffic.part(0, LOOK_FRAMES)
    return few


def narrow_pool(setting: Setting, run: Run, stride: int = 1) -> Int64[np.ndarray, " n"] | None:
    """Return the candidates of a large pool that are searched, ascending; None for all of a smaller
    one."""
    pool = setting.pool
    if len(pool) <= MAX_POSES:
        return None
    on_poles = np.flatnonzero(np.isin(pool.mount, thin_poles(pool, setting)))
    few = prepare_first_look(replace(setting, candidates=pool.select(on_poles)), run, stride)
    chosen = _choose_seeing(few)
    return on_poles if chosen is None else on_poles[chosen]


def thin_poles(pool: Candidates, setting: Setting) -> Int64[np.ndarray, " m"]:
    """Return the mounts of a pool that go on, ascending: at most `MAX_POLES`, spread evenly."""
    feet = np.array([mount.position[:2] for mount in pool.mounts])
    xmin, ymin, xmax, ymax = setting.place.area
    far = np.hypot(*(feet - [(xmin + xmax) / 2, (ymin + ymax) / 2]).T)
    used = np.unique(pool.mount)
    kept = pool.find_mounts(setting.keep)
    order = used[np.lexsort((far[used], ~np.isin(used, kept)))]
    side = MIN_SPACING_M
    while len(order) > MAX_POLES:
        cells = np.floor(feet[order] / side).astype(np.int64)
        first = np.sort(np.unique(cells, axis=0, return_index=True)[1])
        order = np.union1d(order[first], np.intersect1d(order, kept))
        order = order[np.lexsort((far[order], ~np.isin(order, kept)))]
        side *= SPACING_GROWTH
    return np.sort(order)


def _choose_seeing(few: Preparation) -> Int64[np.ndarray, " n"] | None:
    """Return the candidates that see most at the first look, ascending; None for all."""
    pool = few.setting.pool
    setting = few.setting
    if len(pool) <= MAX_POSES:
        return None
    points = PointCount(few.visibility, setting.fusion, codec=setting.codec)
    alone = replace(
        setting, candidates=pool, fidelity=points, surrogate=None, table=None, detector=None
    )
    objective = Objective(alone, few.run, visibility=few.visibility)
    allowed = objective.allowed([])
    if not allowed.any():
        return None
    score = np.where(allowed, _score_alone(few), -math.inf)
    return _choose_poses(pool, score, objective.kept)


def _score_alone(few: Preparation) -> Float64[np.ndarray, " C"]:
    """Score of each candidate alone, as of `PointCount`, row by row to save memory."""
    return np.array(
        [
            np.log1p(np.minimum(row, ENOUGH_POINTS)).sum(dtype=np.float64)
            for row in few.visibility.points
        ]
    )


def _choose_poses(
    pool: Candidates, score: Float64[np.ndarray, " C"], kept: Int64[np.ndarray, " k"]
) -> Int64[np.ndarray, " n"]:
    """Choose poses by score. kept: mounts that must carry a sensor."""
    best = np.full(len(pool.mounts), -math.inf)
    np.maximum.at(best, pool.mount, score)
    best[kept] = math.inf
    mounts = np.argsort(-best, kind="stable")[:MAX_POLES]
    order = np.lexsort((-score, pool.mount))
    first = np.unique(pool.mount[order], return_index=True)[1]
    rank = np.empty(len(pool), np.int64)
    rank[order] = np.arange(len(pool)) - np.repeat(first, np.diff(np.append(first, len(pool))))
    places = np.flatnonzero(np.isin(pool.mount, mounts) & np.isfinite(score))
    few_first = rank[places] >= MIN_POSES_ON_POLE
    chosen = places[np.lexsort((-score[places], few_first))][:MAX_POSES]
    return np.sort(chosen)


def describe_narrowing(pool: Candidates, chosen: Int64[np.ndarray, " n"]) -> str:
    """Sentence on how many poses of a large pool are searched."""
    poles = describe_count(len(np.unique(pool.mount)), "pole")
    poses = describe_count(len(pool), "pose")
    used = describe_count(len(np.unique(pool.mount[chosen])), "pole")
    return (
        f"{poles} with {poses} are too many to search: the {len(chosen):,} poses on {used} go on "
        f"that see most in the first {LOOK_FRAMES} frames."
    )
