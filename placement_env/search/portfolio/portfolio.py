"""Portfolio: several searches whose answers race by the detector.

Neighbours of the answers race too, on traffic that no search saw. Traffic has three parts. The searches see the
objective's own; the entrants race on the second until the best is known confidently enough
(`placement_env.racing.race_until`); the figures of the answer come from the third. So the stated AP carries neither the
optimism of the searches nor that of the race. Picking the best of many by noisy or biased scores overrates it (the
winner's curse), by the amount that `Contender.curse` gives for each search.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeGuard

import numpy as np

from placement_env.analysis.intervals import BLOCK_FRAMES, figure_interval
from placement_env.checks import check_whole
from placement_env.fidelity.preparation import Preparation
from placement_env.objective import Objective
from placement_env.protocol import FidelityName
from placement_env.racing import Contest, Resampled, race_until
from placement_env.search.checkpoint import NOWHERE, Checkpoint
from placement_env.search.portfolio.entrants import ENTRANTS, Effort, Entrants, keep_entrants
from placement_env.search.portfolio.evaluators import CasesEvaluator, Evaluated, Evaluator, build_evaluator, race_order
from placement_env.search.portfolio.schedule import Schedule
from placement_env.search.progress import Limits
from placement_env.search.result import Assessment, Certificate, Contender, ProfileAP, Result
from placement_env.setting import Setting
from toolkit.arrays import Bool, Float64, Int64

RACE_FRAMES, JUDGED_FRAMES = 96, 120
AP_TOLERANCE = 0.01  # lead in AP that the race ignores
FIRST, ETA = 12, 2  # frames of the race's first rung, and by how much the next ones are longer
LEAST_RACED = 24  # fewest frames of a race: on fewer the luckiest of many wins
SET_FRAMES = 1600.0  # set-frames that a race may score without a time limit
INTERVAL_SHARE = 0.95  # confidence of the stated AP's interval
SEARCHES = 5  # searches that share their time


@dataclass(frozen=True, kw_only=True)
class Judging:
    """Race and assessment of a portfolio.

    by: fidelity of both; confidence: at which the race ends, that no entrant is better by more than `AP_TOLERANCE`;
    race_frames, final_frames: of their traffic, of the seeds after the objective's; neighbours: entrants that join the
    answers; setting: asked of both, None for the objective's; evaluators: of both, in place of all but confidence and
    neighbours. Raises ValueError for a confidence that does not lie between 0 and 1.
    """

    by: FidelityName = "detector"
    confidence: float = 0.95
    race_frames: int = RACE_FRAMES
    final_frames: int = JUDGED_FRAMES
    neighbours: int = ENTRANTS
    setting: Setting | None = None
    evaluators: tuple[Evaluator, Evaluator] | None = None

    def __post_init__(self) -> None:
        if not 0 < self.confidence < 1:
            raise ValueError(f"confidence must lie between 0 and 1, got {self.confidence}: 0.95 is usual")

    def build_evaluators(
        self, objective: Objective, schedule: Schedule, *, seed: int = 0
    ) -> tuple[Evaluator, Evaluator]:
        """Evaluators of race and assessment.

        They use as many frames as a schedule allows. seed: of the resamples. Raises ValueError where the objective has
        no site, and so no fresh traffic.
        """
        if self.evaluators is not None:
            return self.evaluators
        setting = self.setting
        if setting is None:
            if objective.preparation is None:
                raise ValueError("a portfolio needs fresh traffic, so an objective made from a site: Objective(site)")
            setting = objective.setting.with_fidelity(self.by)
        run = objective.run
        race, final = (
            build_evaluator(
                Preparation(setting, replace(run, seed=run.seed + part, frames=schedule.frames(count))),
                self.by,
                seed=seed,
            )
            for part, count in enumerate((self.race_frames, self.final_frames), 1)
        )
        return race, final


def search(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    judging: Judging = Judging(),
    checkpoint: Checkpoint = NOWHERE,
) -> Result:
    """Winner of the race.

    `Result.best` is its score by the objective, `Result.assessment` that of the judge. The assessment also covers each
    search's own answer, on the third part of traffic. seconds: of searches, race and assessment together, divided by
    `placement_env.search.portfolio.schedule`. With less time there are fewer frames, and some searches' answers are not
    assessed. evaluations: of each search; checkpoint: keeps the progress of the searches (race and assessment
    detections are in the cache). Raises ValueError where these do not fit.
    """
    check_whole("budget", budget, least=1)
    limits, confidence = Limits(seconds, evaluations), judging.confidence
    schedule = Schedule.of(seconds, objective.run)
    racing, final = judging.build_evaluators(objective, schedule, seed=seed)
    effort = Effort((budget,), schedule.searching(SEARCHES), evaluations, judging.neighbours)
    found = find_entrants(objective, effort, seed, checkpoint)
    limits.count = found.considered
    if not len(found.sets):
        return _without(objective, found, limits, "no search found a set that may be built and pays")
    timed = schedule.racing(racing)
    most = SET_FRAMES if seconds is None else math.inf
    ran = contest(objective, found.sets, timed, confidence=confidence, seed=seed, most=most)
    if ran.figures[0] <= 0 and (objective.weights.comm or objective.weights.price):
        note = f"by the {racing.name} none of the {len(found.sets)} entrants is worth what it costs"
        return _without(objective, found, limits, note)
    winner = objective.score(np.flatnonzero(found.sets[ran.ranking[0]]))
    limits.record(winner.reward)
    searched = limits.elapsed
    assessment = _assess(objective, found, ran, (final, schedule), asked=confidence)
    note = f"raced by the {racing.name}: of the {len(found.sets)} entrants, not of all sets"
    certificate = Certificate("none", winner.reward, note=note)
    history = limits.history(winner.reward)
    return Result("portfolio", winner, history, certificate, found.considered, searched, assessment=assessment)


def _without(objective: Objective, found: Entrants, limits: Limits, note: str) -> Result:
    """Answer that builds nothing."""
    best = objective.score([])
    certificate = Certificate("none", best.reward, note=note)
    return Result("portfolio", best, limits.history(best.reward), certificate, found.considered, limits.elapsed)


def contest(
    objective: Objective,
    sets: Bool[np.ndarray, "n C"],
    evaluator: Evaluator,
    *,
    confidence: float = 0.95,
    seed: int = 0,
    most: float = SET_FRAMES,
    stop: Callable[[], bool] = lambda: False,
) -> Contest:
    """Race sets by their reward.

    The reward uses an evaluator's AP and the objective's prediction. most: set-frames to be scored; stop: called after
    each rung, true to end.
    """

    def rewards(rows: Bool[np.ndarray, "m C"], frames: Int64[np.ndarray, " k"]) -> Resampled:
        found = evaluator.evaluate(rows, frames, objective.run.stage("racing", len(frames)))
        cost = weigh_costs(objective, rows, found.kbit)
        blocks = float(len(np.unique(frames[: found.frames] // BLOCK_FRAMES)))
        return Resampled(found.ap - cost, found.resamples - cost[:, None], found.frames, blocks)

    order = race_order(evaluator.frames, seed=seed)
    first = min(FIRST, evaluator.frames)
    return race_until(
        rewards, sets, order, confidence=confidence, tolerance=AP_TOLERANCE, first=first, eta=ETA, least=LEAST_RACED,
        most=most, stop=stop, predicted=objective.scores(sets).reward,
    )  # fmt: skip


def weigh_costs(
    objective: Objective, sets: Bool[np.ndarray, "n C"], kbit: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    """Costs of communication and building, in AP. kbit: total that each set sends."""
    per_sensor = kbit / np.maximum(sets.sum(axis=1), 1)
    return np.asarray(objective.weights.comm * per_sensor + objective.weights.price * objective.price(sets))


def find_entrants(objective: Objective, effort: Effort, seed: int, checkpoint: Checkpoint = NOWHERE) -> Entrants:
    """Entrants of an objective, cached where possible. The cache is that of its run."""
    made = objective.preparation
    cache = None if made is None else objective.run.memo
    depends_on = "" if made is None else made.traffic.digest()
    return keep_entrants(objective, effort, cache, depends_on=depends_on, seed=seed, checkpoint=checkpoint)


def _assess(
    objective: Objective, found: Entrants, ran: Contest, judging: tuple[Evaluator, Schedule], *, asked: float
) -> Assessment:
    """Judge the winner and each search's answer.

    The third part of the traffic is used. The winner comes first, the others as far as time allows.
    """
    winner, (final, schedule) = int(ran.ranking[0]), judging
    rows = np.array([winner, *(i for i, names in enumerate(found.searches) if names and i != winner)])
    rows, judged, frames = judge_in_time(
        found.sets, rows, final, schedule, objective.run.stage("judging", final.frames)
    )
    contenders = tuple(
        _contender(found, int(row), judged, place) for place, row in enumerate(rows) if found.searches[row]
    )
    own = _contender(found, winner, judged, 0)
    return Assessment(
        by=final.name,
        ap=own.ap,
        low=own.low,
        high=own.high,
        kbit=float(judged.kbit[0]),
        objects=final.count_objects(frames),
        frames=len(frames),
        predicted=own.predicted,
        confidence=ran.confidence,
        asked=asked,
        tolerance=AP_TOLERANCE,
        entrants=len(found.sets),
        raced=int(ran.frames[0]),
        contenders=contenders,
        expected=float(ran.expected[0] + weigh_costs(objective, found.sets[[winner]], judged.kbit[:1])[0]),
        by_errors=aps_at_profiles(final, found.sets[[winner]], frames)[0],
        errors_by=final.cases.errors_by if _several_profiles(final) else "",
    )


def _several_profiles(final: Evaluator) -> TypeGuard[CasesEvaluator]:
    return isinstance(final, CasesEvaluator) and len(final.profiles) > 1


def aps_at_profiles(
    final: Evaluator, sets: Bool[np.ndarray, "n C"], frames: Int64[np.ndarray, " k"]
) -> list[tuple[ProfileAP, ...]]:
    """AP of each set at each error profile separately. Empty where there is one profile."""
    if not _several_profiles(final):
        return [()] * len(sets)
    each = final.at_each(sets, frames)
    return [
        tuple(
            ProfileAP(name, float(e.ap[n]), *figure_interval(e.ap[n], e.resamples[n], confidence=INTERVAL_SHARE))
            for name, e in each.items()
        )
        for n in range(len(sets))
    ]


def judge_in_time(
    sets: Bool[np.ndarray, "n C"],
    rows: Int64[np.ndarray, " k"],
    final: Evaluator,
    schedule: Schedule,
    report: Callable[[int], None] | None = None,
) -> tuple[Int64[np.ndarray, " m"], Evaluated, Int64[np.ndarray, " f"]]:
    """Judge rows on the third part of the traffic.

    Returns the rows judged in time, their figures, and the frames, the same for all. The first row is judged regardless
    of time.
    """
    every = np.arange(final.frames)
    if schedule.seconds is None:
        return rows, final.evaluate(sets[rows], every, report), every
    order = race_order(final.frames)
    first = schedule.judging(final).evaluate(sets[rows[:1]], order, report)
    frames = order[: first.frames]
    done = 1
    while done < len(rows) and schedule.left > 0:
        if schedule.judging(final).evaluate(sets[rows[done : done + 1]], frames).frames is not None:
            break
        done += 1
    return rows[:done], final.evaluate(sets[rows[:done]], frames), frames


def _contender(found: Entrants, row: int, judged: Evaluated, place: int) -> Contender:
    ap = float(judged.ap[place])
    low, high = figure_interval(ap, judged.resamples[place], confidence=INTERVAL_SHARE)
    members = tuple(np.flatnonzero(found.sets[row]).tolist())
    return Contender(found.searches[row], members, float(found.predicted[row]), ap, low, high)
