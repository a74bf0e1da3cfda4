"""First look: all candidates on a few frames, for a first answer and to narrow a large pool.

Memory and time of a search grow with the square of the candidates, so only some of more than
`MAX_POSES` poses are searched. Poles are thinned first, before anything is rendered: in each square
of a grid the pole nearest to the middle of the area stays, in squares so large that at most
`MAX_POLES` are left. Then the poses that see most at the first look stay: the best few of each
pole, then the best of all. Poles that must carry a sensor always stay.
"""

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

LOOK_FRAMES = 8  # first frames of the search that are looked at
MAX_POSES = 3_000  # in a search
MAX_POLES = 400  # in a search
MIN_POSES_ON_POLE = 4  # that stay on each pole if it has as many
MIN_SPACING_M = 1.0  # first side of the squares that thin the poles
SPACING_GROWTH = 1.2  # growth of the squares until few enough poles are left


def prepare_first_look(setting: Setting, run: Run, stride: int = 1) -> Preparation:
    """Prepare the first `LOOK_FRAMES` frames of a search's traffic.

    The traffic is the same as in the search; here it is simulated without reports of progress.

    setting: question with the candidates to look at; stride: step between frames that count."""
    full = Preparation(setting, replace(run, progress=None), stride)
    first_look = Preparation(setting, full.run, stride)
    return first_look.with_traffic(full.traffic.part(0, LOOK_FRAMES))


def narrow_pool(setting: Setting, run: Run, stride: int = 1) -> Int64[np.ndarray, " n"] | None:
    """Indices of the candidates to search in a large pool, ascending; None for all of a small one.

    setting: has the pool and the poles that must stay; run: seed and frames of the search; stride:
    step between frames that count."""
    pool = setting.pool
    if len(pool) <= MAX_POSES:
        return None
    on_thinned_poles = np.flatnonzero(np.isin(pool.mount, thin_poles(pool, setting)))
    thinned_setting = replace(setting, candidates=pool.select(on_thinned_poles))
    first_look = prepare_first_look(thinned_setting, run, stride)
    best_rows = choose_at_first_look(first_look)  # indices in the thinned pool
    return on_thinned_poles if best_rows is None else on_thinned_poles[best_rows]


def thin_poles(pool: Candidates, setting: Setting) -> Int64[np.ndarray, " m"]:
    """Indices of the mounts of a pool that stay, ascending: at most `MAX_POLES`, spread evenly.

    In each square of a grid only the mount nearest to the middle of the area stays; the squares
    grow until few enough mounts are left. Mounts that must carry a sensor always stay, even if they
    are more.

    setting: has the area of the site and the names of such mounts."""
    feet = np.array([mount.position[:2] for mount in pool.mounts])  # x, y (m)
    xmin, ymin, xmax, ymax = setting.place.area
    middle = [(xmin + xmax) / 2, (ymin + ymax) / 2]
    distance = np.hypot(*(feet - middle).T)
    mounts = np.unique(pool.mount)
    required = pool.find_mounts(setting.keep)
    # required mounts first, then by distance from the middle of the area
    order = mounts[np.lexsort((distance[mounts], ~np.isin(mounts, required)))]
    side_m = MIN_SPACING_M
    while len(order) > max(MAX_POLES, len(required)):
        # np.unique returns the first mount of each square, which by the order is the one to keep
        squares = np.floor(feet[order] / side_m).astype(np.int64)
        _, first_in_square = np.unique(squares, axis=0, return_index=True)
        order = np.union1d(order[np.sort(first_in_square)], np.intersect1d(order, required))
        order = order[np.lexsort((distance[order], ~np.isin(order, required)))]
        side_m *= SPACING_GROWTH
    return np.sort(order)


def choose_at_first_look(first_look: Preparation) -> Int64[np.ndarray, " n"] | None:
    """Indices of the candidates that see most at the first look, ascending; None for all.

    All stay if they are few enough, or if none may be built."""
    pool = first_look.setting.pool
    setting = first_look.setting
    if len(pool) <= MAX_POSES:
        return None
    points = PointCount(first_look.visibility, setting.fusion, codec=setting.codec)
    point_setting = replace(
        setting, candidates=pool, fidelity=points, surrogate=None, table=None, detector=None
    )
    objective = Objective(point_setting, first_look.run, visibility=first_look.visibility)
    is_allowed = objective.allowed([])
    if not is_allowed.any():
        return None
    score = np.where(is_allowed, _score_poses(first_look), -math.inf)
    return choose_poses(pool, score, objective.kept)


def _score_poses(first_look: Preparation) -> Float64[np.ndarray, " candidates"]:
    """Score of each single candidate by its points on objects, row by row to save memory.

    It is the sum of log(1 + points) over the objects, with at most `ENOUGH_POINTS` on each, which
    ranks candidates as the fidelity `PointCount` does."""
    scores = []
    for object_points in first_look.visibility.points:  # a row of objects for each candidate
        log_points = np.log1p(np.minimum(object_points, ENOUGH_POINTS))
        scores.append(log_points.sum(dtype=np.float64))
    return np.array(scores)


def choose_poses(
    pool: Candidates, score: Float64[np.ndarray, " candidates"], required: Int64[np.ndarray, " k"]
) -> Int64[np.ndarray, " n"]:
    """Indices of the poses with the highest scores, ascending, at most `MAX_POSES`.

    The best `MAX_POLES` mounts take part, with their best `MIN_POSES_ON_POLE` poses before all
    other poses.

    score: one for each pose, -inf if it may not be built; required: indices of the mounts that must
    carry a sensor, which always take part."""
    best_score = np.full(len(pool.mounts), -math.inf)  # on each mount
    np.maximum.at(best_score, pool.mount, score)
    best_score[required] = math.inf
    best_mounts = np.argsort(-best_score, kind="stable")[:MAX_POLES]
    order = np.lexsort((-score, pool.mount))  # by mount, then from the best pose
    _, first = np.unique(pool.mount[order], return_index=True)  # where each mount begins
    pose_counts = np.diff(np.append(first, len(pool)))  # on each mount
    # rank of each pose on its mount, 0 for the best: its place in `order` less the mount's first
    rank = np.empty(len(pool), np.int64)
    rank[order] = np.arange(len(pool)) - np.repeat(first, pose_counts)
    poses = np.flatnonzero(np.isin(pool.mount, best_mounts) & np.isfinite(score))
    is_surplus = rank[poses] >= MIN_POSES_ON_POLE
    best_poses = poses[np.lexsort((-score[poses], is_surplus))][:MAX_POSES]
    return np.sort(best_poses)


def describe_first_frames(search_frames: int) -> str:
    """Text of the frames that are looked at, such as "first 8 frames": all of a shorter search.

    search_frames: number of frames of the search."""
    return f"first {describe_count(min(LOOK_FRAMES, search_frames), 'frame')}"


def describe_narrowing(
    pool: Candidates, searched_poses: Int64[np.ndarray, " n"], search_frames: int
) -> str:
    """Sentence on how many poses of a large pool are searched.

    searched_poses: their indices; search_frames: number of frames of the search."""
    frames_text = describe_first_frames(search_frames)
    pole_text = describe_count(len(np.unique(pool.mount)), "pole")
    pose_text = describe_count(len(pool), "pose")
    searched_pole_text = describe_count(len(np.unique(pool.mount[searched_poses])), "pole")
    return (
        f"{pole_text} with {pose_text} are too many to search: the {len(searched_poses):,} poses "
        f"on {searched_pole_text} go on that see most in the {frames_text}."
    )
