"""Accurate scores of a fast result and of the sets that differ from it in one sensor."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from placement_env.checks import check_whole
from placement_env.fidelity.cases_fidelity import CasesFidelity
from placement_env.objective import Objective, Score
from placement_env.protocol import ByFrames
from placement_env.racing import find_best
from placement_env.search.progress import Progress, as_rows
from placement_env.search.result import Result
from placement_env.subsets import Sets
from toolkit.arrays import Bool, Float64, Int64, Shaped
from toolkit.sensors.sensor import Sensor

MAX_RACED_SETS = 27  # that race if the accurate fidelity can score some of the frames


@dataclass(frozen=True, eq=False)
class AccurateRanking:
    """Best k sets by a fast reward, ranked by the accurate one, with both rewards.

    Attributes:
        sets: Sets, best by the accurate reward first.
        fast: Reward of each by the fast objective.
        accurate: Reward of each by the accurate objective."""

    sets: Bool[np.ndarray, "k candidates"]
    fast: Float64[np.ndarray, " k"]
    accurate: Float64[np.ndarray, " k"]


def verified(
    fast: Objective, accurate: Objective, subset: Int64[np.ndarray, " k"], *, best: int = 5
) -> AccurateRanking:
    """Best sets among a set and its feasible neighbours, ranked by the accurate reward.

    A neighbour differs in one sensor. The fast fidelity's error exceeds the effect of one sensor's
    pose, so a neighbour may be the better set. If the accurate fidelity can score some of the
    frames, the `MAX_RACED_SETS` best sets by the fast reward race. Sets that tie with the last of
    the best by the fast reward are ranked too. A set that may not be built by the fast objective
    has no neighbours. Raises ValueError if the candidates differ, and for `best` below 1.

    subset: indices of the set's candidates; best: number of sets to score accurately.
    """
    check_whole("best", best, least=1)
    if fast.candidates.digest() != accurate.candidates.digest():
        raise ValueError(
            "both objectives must choose from the same candidates: make the second from the first's"
        )
    sets = neighbours(subset, len(fast.candidates))  # the set itself is the first row
    is_feasible = fast.feasible(sets)
    sets = sets[is_feasible] if is_feasible[0] else sets[:1]
    if isinstance(accurate.scored_by, ByFrames):
        by_fast_reward = np.argsort(-fast.scores(sets).reward, kind="stable")
        sets = sets[by_fast_reward[:MAX_RACED_SETS]]
        sets = sets[accurate.race(sets, keep=best).winners]
    fast_rewards = fast.scores(sets).reward
    best_rows = find_best(fast_rewards, best)  # indices, the best first
    accurate_rewards = accurate.scores(sets[best_rows]).reward
    ranking = find_best(accurate_rewards, len(best_rows))
    ranked_rows = best_rows[ranking]
    return AccurateRanking(
        sets=sets[ranked_rows], fast=fast_rewards[ranked_rows], accurate=accurate_rewards[ranking]
    )


def verify_best(fast: Objective, accurate: Objective, result: Result) -> tuple[Score, int]:
    """Best accurate score of a result and its neighbours, and the number of sets scored for it.

    Neighbours differ in one sensor. Sensors in poses that a search moved (`Result.sensors`) have no
    neighbours, so their score is the only one.
    """
    if result.sensors:
        return score_result(accurate, result), 1
    ranking = verified(fast, accurate, np.array(result.best.subset))
    best_set = ranking.sets[0]
    return accurate.score(np.flatnonzero(best_set)), len(ranking.sets)


def score_result(accurate: Objective, result: Result) -> Score:
    """Score a result by another objective of the same candidates; moved sensors keep their poses.

    Raises ValueError if sensors were moved and the objective has no site, or they may not be built
    there.
    """
    if not result.sensors:
        return accurate.score(result.best.subset)
    from placement_env.search.cmaes import build_pose_scorer

    if accurate.preparation is None:
        raise ValueError("moved sensors need an objective made from a site: Objective(site)")
    (score,) = build_pose_scorer(accurate.preparation, accurate.weights)([result.sensors])
    if score is None:
        raise ValueError(
            "the moved sensors may not be built: one sends more than its link carries here"
        )
    return replace(score, subset=result.best.subset)


def ap_at_profiles(
    objective: Objective, subset: Sequence[int], moved_sensors: Sequence[Sensor] = ()
) -> dict[str, float]:
    """AP of a set at each of several error profiles, by name; empty for one profile.

    Empty too for the empty set and for fidelities without error profiles. A profile at which moved
    sensors may not be built is left out.

    subset: indices of the candidates; moved_sensors: its sensors in other poses, empty if they
    stay."""
    scored_by = objective.scored_by
    preparation = objective.preparation
    if not isinstance(scored_by, CasesFidelity) or len(scored_by.cases.names) == 1 or not subset:
        return {}
    if not moved_sensors or preparation is None:
        return {
            name: float(estimate.ap[0])
            for name, estimate in scored_by.at_each(objective.row(subset)[None]).items()
        }
    from placement_env.search.cmaes import build_pose_scorer

    aps = {}
    for name, profile in zip(scored_by.cases.names, scored_by.cases.profiles, strict=True):
        cases = replace(scored_by.cases, errors=profile)
        profile_preparation = replace(
            preparation, setting=replace(preparation.setting, cases=cases)
        ).with_traffic(preparation.traffic, detector=preparation.detector)
        score_poses = build_pose_scorer(profile_preparation, objective.weights)
        (score,) = score_poses([tuple(moved_sensors)])
        if score is not None:
            aps[name] = score.ap
    return aps


def neighbours(subset: Int64[np.ndarray, " k"], candidate_count: int) -> Sets:
    """Rows of a set and of each variant with one member replaced by a candidate outside of it.

    The set is the first row. Variants are not checked for feasibility.

    subset: indices of the set's candidates; candidate_count: number of all candidates, the length
    of a row."""
    row = as_rows([subset.tolist()], candidate_count)
    outside_candidates = np.flatnonzero(~row[0])
    sets = np.repeat(row, 1 + len(subset) * len(outside_candidates), axis=0)
    variant_rows = np.arange(1, len(sets))  # one for each pair of a member and an outside candidate
    sets[variant_rows, np.repeat(subset, len(outside_candidates))] = False
    sets[variant_rows, np.tile(outside_candidates, len(subset))] = True
    return sets


def improve_among_equals(
    progress: Progress, members: Sequence[int], measure: Callable[[Sets], Shaped[np.ndarray, " n"]]
) -> list[int]:
    """Best set by the objective among sets that changes of one sensor reach at the same measure.

    Coverage has many optima, and a solver answers with any: one set of coverage 1.000 has AP 0.918,
    its neighbour 0.98. Steps go to the best neighbour until none has a higher reward. The limits of
    the search hold.

    progress: scores sets within the limits of the search; members: set to begin with, as indices of
    candidates; measure: function that returns the figure of each set that must not fall, such as
    the number of its covered objects.
    """
    best = sorted(int(c) for c in members)
    if not best:
        return best
    row = as_rows([best], progress.size)
    (min_figure,) = measure(row)
    (reward,) = progress.rewards(row).tolist()
    while not progress.spent:
        sets = neighbours(np.array(best), progress.size)[1:]  # without the set itself
        sets = sets[progress.objective.feasible(sets)]
        sets = sets[measure(sets) >= min_figure]
        rewards = progress.rewards(sets)
        if not len(sets) or not rewards.max() > reward:
            break
        best = np.flatnonzero(sets[rewards.argmax()]).tolist()
        reward = float(rewards.max())
    return best
