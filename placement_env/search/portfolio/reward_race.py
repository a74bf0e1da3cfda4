"""Race of sensor sets by their reward: AP by an evaluator, less the costs of each set.

Searches and plans race their sets here; `placement_env.racing.race_until` drops the sets. Sets that
nearly tie are compared by their mean AP over the detector's IoU thresholds.
"""

import math
from dataclasses import replace

import numpy as np

from placement_env.analysis.intervals import AP_TOLERANCE, BLOCK_FRAMES
from placement_env.objective import Objective
from placement_env.racing import Contest, RaceRules, Resampled, race_until
from placement_env.search.portfolio.evaluators import CasesEvaluator, Frames, race_order
from placement_env.search.portfolio.schedule import FrameEvaluator
from placement_env.subsets import Sets
from toolkit.arrays import Bool, Float64, Int64

NEAR_TIE_AP = 0.75 * AP_TOLERANCE  # lead that other IoU thresholds may outweigh
LIKELY_TIE_AP = 2 * NEAR_TIE_AP  # below a race's winner; mean AP over IoU decides who is judged too
MAX_FINALISTS = 3  # sets of each size that are judged on all frames if they are near the best
FIRST_RUNG_FRAMES = 12
RUNG_GROWTH = 2  # ratio of each rung's frames to the rung before
MIN_RACE_FRAMES = 24  # on fewer frames the luckiest of many sets wins
KEPT_SHARE = 0.5  # largest share of a rung's sets that goes on to the next
MAX_SET_FRAMES = 400.0  # that a race may score without a time limit, beyond its first rungs
MAX_SET_FRAMES_BEHIND = 200.0  # limit if the best set is behind another race
NEAR_AP = 0.03  # below the best of other races, which further frames may make up for
RACE_RULES = RaceRules(
    tolerance=AP_TOLERANCE,
    eta=RUNG_GROWTH,
    least=MIN_RACE_FRAMES,
    kept=KEPT_SHARE,
    most_behind=MAX_SET_FRAMES_BEHIND,
)


def contest(
    objective: Objective,
    sets: Sets,
    evaluator: FrameEvaluator,
    *,
    confidence: float = 0.95,
    seed: int = 0,
    max_set_frames: float = MAX_SET_FRAMES,
    frames: int | None = None,
    best_elsewhere: float = -math.inf,
) -> Contest:
    """Race sets by their reward, from an evaluator's AP and the objective's prediction.

    Among the sets that end within `NEAR_TIE_AP` of the first, the set with the greatest mean AP
    over the detector's IoU thresholds wins, then the cheapest. The winner is moved to the front of
    the ranking, and the confidence is the one in this winner.

    Args:
        objective: Gives predictions, prices and the weights of costs.
        sets: Sets that race.
        evaluator: Evaluator of the sets on more and more frames.
        confidence: Confidence at which the race ends that no set is better by more than
            `AP_TOLERANCE`.
        seed: Seed of the order of the frames.
        max_set_frames: Largest number of set-frames to be scored, a set on a frame being one.
        frames: Number of frames to race on at most, None for all of the evaluator's.
        best_elsewhere: Expected reward of the best set of other races. The race ends if all sets
            are surely `NEAR_AP` behind, and is shorter if the best is `NEAR_TIE_AP` behind.
    """

    def rewards(rows: Sets, frames: Frames) -> Resampled:
        """Rewards of sets (rows) on the first frames of a race, with resamples; for `race_until`.

        The set with the greatest reward is reported to the objective's watcher."""
        report = objective.run.stage("frames raced", len(frames))
        figures = evaluator.evaluate(rows, frames, report)
        used_frames = frames[: figures.used]  # all unless time ran out
        cost = weigh_costs(objective, rows, figures.kbit)  # the same in all resamples
        reward = figures.ap - cost
        if objective.watch is not None:
            best = int(reward.argmax())
            members = tuple(np.flatnonzero(rows[best]).tolist())
            objective.watch(members, float(reward[best]), len(used_frames))
        return Resampled(
            figure=reward,
            resamples=figures.resamples - cost[:, None],
            frames=figures.used,
            blocks=float(len(np.unique(used_frames // BLOCK_FRAMES))),
        )

    order = race_order(evaluator.frames, seed=seed)[:frames]
    rules = replace(
        RACE_RULES,
        confidence=confidence,
        first=min(FIRST_RUNG_FRAMES, evaluator.frames),
        most=max_set_frames,
        target=best_elsewhere - NEAR_AP,
        rival=best_elsewhere - NEAR_TIE_AP,
    )
    race = race_until(rewards, sets, order, rules, predicted=objective.scores(sets).reward)
    # ranks of the sets that raced on as many frames as the first and nearly tie with it
    near_ranks = np.flatnonzero(
        (race.frames == race.frames[0]) & (race.expected >= race.expected[0] - NEAR_TIE_AP)
    )
    near_sets = sets[race.ranking[near_ranks]]
    mean_ap = np.zeros(1)
    if len(near_ranks) > 1:
        mean_ap = evaluator.mean_ap(near_sets, order[: race.frames[0]])
    winner_rank = int(near_ranks[np.lexsort((objective.price(near_sets), -mean_ap))[0]])
    reordered = _move_to_front(race, winner_rank)
    return replace(reordered, confidence=reordered.sureness(int(reordered.ranking[0])))


def _move_to_front(race: Contest, rank: int) -> Contest:
    """Race with the set at a rank before all others."""
    order = np.r_[rank, np.delete(np.arange(len(race.ranking)), rank)]
    columns = ("ranking", "figures", "frames", "expected")
    return replace(race, **{name: getattr(race, name)[order] for name in columns})


def weigh_costs(
    objective: Objective, sets: Sets, kbit: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    """Costs of communication and building of each set, in AP.

    `weights.comm` is the cost of a kbit that each sensor sends on average, `weights.price` the cost
    of a unit of price. objective: gives weights and prices; sets: rows of booleans; kbit: total
    that each set sends per frame."""
    per_sensor = kbit / np.maximum(sets.sum(axis=1), 1)  # the empty set counts as one sensor
    return np.asarray(
        objective.weights.comm * per_sensor + objective.weights.price * objective.price(sets)
    )


def find_finalists(
    race: Contest,
    ranked_sets: Bool[np.ndarray, "n candidates"],
    evaluator: CasesEvaluator,
    order: Int64[np.ndarray, " frames"],
) -> Int64[np.ndarray, " k"]:
    """Return the ranks of the winner of a race and its `MAX_FINALISTS` - 1 likeliest rivals.

    Rank 0 is the winner. Sets that nearly tie with it (`LIKELY_TIE_AP`) follow by mean AP over
    IoU thresholds, highest first, then other sets by rank. The mean AP is on the frames of the
    race's first round, in which all sets took part.

    Args:
        race: The finished race.
        ranked_sets: Its sets, best first.
        evaluator: Evaluator of the race.
        order: All frames in the order in which races use them."""
    # `expected` is sorted like `ranked_sets`, so the first is the winner itself
    tied_ranks = np.flatnonzero(race.expected >= race.expected[0] - LIKELY_TIE_AP)[1:]
    mean_aps = np.empty(0)
    if len(tied_ranks):
        # `race.frames` has the number of frames on which each set raced
        first_round_frames = order[: race.frames.min()]
        mean_aps = evaluator.mean_ap(ranked_sets[tied_ranks], first_round_frames)
    tied_by_mean = tied_ranks[np.argsort(-mean_aps, kind="stable")]
    # each rank once, at its first place
    ranks = list(dict.fromkeys([0, *tied_by_mean.tolist(), *range(len(ranked_sets))]))
    return np.array(ranks[:MAX_FINALISTS], np.int64)
