"""Portfolio: several searches whose answers, and neighbours of these, race by the detector on
traffic of its own.

Traffic has three parts. The searches see the objective's own; the entrants race on the second until
the best is known confidently enough (`placement_env.racing.race_until`); the figures of the answer
come from the third. So the stated AP carries neither the optimism of the searches nor that of the
race. Picking the best of many by noisy or biased scores overrates it (the winner's curse), by the
amount that `Contender.curse` gives for each search."""

import math
from dataclasses import dataclass, replace

import numpy as np

from placement_env.analysis.agreement import StageFigure, check_agreement
from placement_env.analysis.intervals import (
    AP_TOLERANCE,
    BLOCK_FRAMES,
    is_comparable,
    share_beyond_reach,
)
from placement_env.checks import check_whole
from placement_env.fidelity.preparation import Preparation
from placement_env.objective import Objective
from placement_env.protocol import FidelityName
from placement_env.racing import Contest, RaceRules, Resampled, race_until
from placement_env.search.checkpoint import NOWHERE, Checkpoint
from placement_env.search.portfolio.entrants import (
    ENTRANTS,
    Effort,
    Entrants,
    at_other_ious,
    join_entrants,
    keep_entrants,
)
from placement_env.search.portfolio.evaluators import (
    CasesEvaluator,
    Evaluated,
    Frames,
    Report,
    Schedule,
    Timed,
    build_evaluator,
    race_order,
)
from placement_env.search.progress import Limits
from placement_env.search.result import Assessment, Certificate, Contender, ProfileAP, Result
from placement_env.setting import Setting
from placement_env.subsets import Sets
from toolkit.arrays import Float64

RACE_FRAMES = 96
JUDGED_FRAMES = 120
# lead in AP that other IoU thresholds may outweigh; the rest is left to chance
NEAR_TIE = 0.75 * AP_TOLERANCE
# frames of the race's first rung, and by how much the next ones are longer
FIRST = 12
ETA = 2
LEAST_RACED = 24  # fewest frames of a race: on fewer the luckiest of many wins
SET_FRAMES = 480.0  # set-frames that a race may score without a time limit, beyond its first rungs
SEARCHES = 8  # searches that share their time


@dataclass(frozen=True, kw_only=True)
class Judging:
    """Race and assessment of a portfolio. Raises ValueError for a confidence that does not lie
    between 0 and 1.

    by: fidelity of both; confidence: at which the race ends, that no entrant is better by more than
    `AP_TOLERANCE`; race_frames, final_frames: of parts 1 and 2 of the traffic of the run;
    neighbours: entrants that join the answers; contenders: judge the answer of each search beside
    the winner; setting: asked of both, None for the objective's; evaluators: of both, in place of
    most of these."""

    by: FidelityName = "detector"
    confidence: float = 0.95
    race_frames: int = RACE_FRAMES
    final_frames: int = JUDGED_FRAMES
    neighbours: int = ENTRANTS
    contenders: bool = False
    setting: Setting | None = None
    evaluators: tuple[CasesEvaluator, CasesEvaluator] | None = None

    def __post_init__(self) -> None:
        if not 0 < self.confidence < 1:
            raise ValueError(
                f"confidence must lie between 0 and 1, got {self.confidence}: 0.95 is usual"
            )

    def build_evaluators(
        self, objective: Objective, schedule: Schedule, *, seed: int = 0
    ) -> tuple[CasesEvaluator, CasesEvaluator]:
        """Evaluators of race and assessment within a schedule. Raises ValueError without a site to
        simulate traffic."""
        if self.evaluators is not None:
            return self.evaluators
        if self.setting is None and objective.preparation is None:
            raise ValueError(
                "a portfolio needs fresh traffic, so an objective made from a site: Objective(site)"
            )
        setting = self.setting or objective.setting.with_fidelity(self.by)
        run = objective.run
        parts = enumerate((self.race_frames, self.final_frames), 1)
        runs = [run.part(number, schedule.frames(count)) for number, count in parts]
        prepared = (Preparation(setting, each, compares=n == 0) for n, each in enumerate(runs))
        race, final = (build_evaluator(each, self.by, seed=seed) for each in prepared)
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
    """Winner of the race: its score by the objective, and the judge's assessment.

    seconds: of searches, race and assessment together; with less time there are fewer frames;
    evaluations: of each search; checkpoint: keeps the progress of the searches. Raises ValueError
    where these do not fit."""
    check_whole("budget", budget, least=1)
    objective.setting.check_budget(budget)
    limits = Limits(seconds, evaluations)
    confidence = judging.confidence
    schedule = Schedule.of(seconds, objective.run)
    racing, final = judging.build_evaluators(objective, schedule, seed=seed)
    effort = Effort((budget,), schedule.searching(SEARCHES), evaluations, judging.neighbours)
    others = at_other_ious(objective)
    found = keep_entrants(objective, effort, others=others, seed=seed, checkpoint=checkpoint)
    if objective.preparation is not None and not objective.setting.cases.plain:
        # what is best intact, in all traffic, may be best at its worst too
        made = objective.preparation
        intact = Objective(replace(made.plain.setting, candidates=objective.candidates), made.run)
        unharmed = keep_entrants(intact, effort, seed=seed, checkpoint=checkpoint.part("intact"))
        found = join_entrants([objective], [found, unharmed])
    limits.count = found.considered

    def answer(subset: list[int], note: str) -> Result:
        best = objective.score(subset)
        certificate = Certificate("none", best.reward, note=note)
        history = limits.history(best.reward)
        origin = objective.describe_origin(best.subset)
        return Result(
            "portfolio", best, history, certificate, found.considered, limits.elapsed, origin=origin
        )

    if not len(found.sets):
        return answer([], "no search found a set that may be built and pays")
    timed = schedule.limit(racing, 1 / 2, 1)
    most = SET_FRAMES if seconds is None else math.inf
    ran = contest(objective, found.sets, timed, confidence=confidence, seed=seed, most=most)
    if (
        ran.figures[0] <= 0
        and not len(objective.kept)
        and (objective.weights.comm or objective.weights.price)
    ):
        return answer(
            [],
            (
                f"by the {racing.name} none of the {len(found.sets)} compared sets is worth what "
                "it costs"
            ),
        )
    members = np.flatnonzero(found.sets[ran.ranking[0]]).tolist()
    limits.record(objective.score(members).reward)
    note = (
        f"the best of {len(found.sets)} sets compared by the {racing.name}; an estimate ruled out "
        "the others"
    )
    return replace(
        answer(members, note), assessment=_assess(objective, found, ran, (final, schedule), judging)
    )


def contest(
    objective: Objective,
    sets: Sets,
    evaluator: Timed,
    *,
    confidence: float = 0.95,
    seed: int = 0,
    most: float = SET_FRAMES,
    frames: int | None = None,
) -> Contest:
    """Race sets by their reward, of an evaluator's AP and the objective's prediction.

    most: set-frames to be scored; frames: to race on at most, None for all of the evaluator's.

    Of the sets that end within `NEAR_TIE` of the first, that of the greatest mean AP over the
    detector's IoU thresholds wins, then the cheapest."""

    def rewards(rows: Sets, frames: Frames) -> Resampled:
        found = evaluator.evaluate(rows, frames, objective.run.stage("frames raced", len(frames)))
        cost = weigh_costs(objective, rows, found.kbit)
        blocks = float(len(np.unique(frames[: found.frames] // BLOCK_FRAMES)))
        if objective.watch is not None:
            best = int((found.ap - cost).argmax())
            ahead = tuple(np.flatnonzero(rows[best]).tolist())
            objective.watch(ahead, float(found.ap[best] - cost[best]), len(frames[: found.frames]))
        return Resampled(found.ap - cost, found.resamples - cost[:, None], found.frames, blocks)

    order = race_order(evaluator.frames, seed=seed)[:frames]
    first = min(FIRST, evaluator.frames)
    rules = RaceRules(confidence, AP_TOLERANCE, first, ETA, least=LEAST_RACED, most=most)
    ran = race_until(rewards, sets, order, rules, predicted=objective.scores(sets).reward)
    close = np.flatnonzero(
        (ran.frames == ran.frames[0]) & (ran.expected >= ran.expected[0] - NEAR_TIE)
    )
    rows = sets[ran.ranking[close]]
    mean_ap = evaluator.mean_ap(rows, order[: ran.frames[0]]) if len(close) > 1 else np.zeros(1)
    won = int(close[np.lexsort((objective.price(rows), -mean_ap))[0]])
    first = np.r_[won, np.delete(np.arange(len(ran.ranking)), won)]
    own = ("ranking", "figures", "frames", "expected")
    reordered = replace(ran, **{name: getattr(ran, name)[first] for name in own})
    return replace(reordered, confidence=reordered.sureness(int(reordered.ranking[0])))


def weigh_costs(
    objective: Objective, sets: Sets, kbit: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    """Costs of communication and building, in AP. kbit: total that each set sends."""
    per_sensor = kbit / np.maximum(sets.sum(axis=1), 1)
    return np.asarray(
        objective.weights.comm * per_sensor + objective.weights.price * objective.price(sets)
    )


def _assess(
    objective: Objective,
    found: Entrants,
    ran: Contest,
    judge: tuple[CasesEvaluator, Schedule],
    judging: Judging,
) -> Assessment:
    """Judge the winner first, then any contenders as far as time allows, on the third part of the
    traffic."""
    winner, (final, schedule) = int(ran.ranking[0]), judge
    others = enumerate(found.searches) if judging.contenders else ()
    rows = np.array([winner, *(i for i, names in others if names and i != winner)])
    judged, frames = _judge_in_time(
        found.sets[rows], final, schedule, objective.run.stage("frames judged", final.frames)
    )
    contenders = []
    for row, ap, resamples in zip(
        rows.tolist(), judged.ap.tolist(), judged.resamples, strict=False
    ):
        interval = final.interval(ap, resamples, frames)
        members = tuple(np.flatnonzero(found.sets[row]).tolist())
        contenders.append(
            Contender(found.searches[row], members, float(found.predicted[row]), ap, *interval)
        )
    own = contenders[0]
    chosen = found.sets[[winner]]
    objects = final.count_objects(frames)
    names = [objective.names[c] for c in np.flatnonzero(chosen[0])]
    cost = float(weigh_costs(objective, chosen, judged.kbit[:1])[0])
    race_frames = int(ran.frames[0])
    if final.name == "detector" and final.cases.plain and len(final.profiles) == 1:
        raced_objects = round(objects * race_frames / len(frames))
        before = StageFigure(
            "in the race", float(ran.figures[0]) + cost, raced_objects, race_frames
        )
        check_agreement(
            names, before, StageFigure("in the judgement", own.ap, objects, len(frames))
        )
    confidence = math.nan
    if is_comparable(race_frames, objects):
        reach = 0.0 if math.isnan(own.low) else share_beyond_reach(judged.resamples[0] - cost)
        confidence = max(ran.confidence, reach)
    by_errors = aps_at_profiles(final, chosen, frames)[0]
    return Assessment(
        by=final.name,
        ap=own.ap,
        low=own.low,
        high=own.high,
        kbit=float(judged.kbit[0]),
        objects=objects,
        frames=len(frames),
        predicted=own.predicted,
        confidence=confidence,
        asked=judging.confidence,
        tolerance=AP_TOLERANCE,
        entrants=len(found.sets),
        raced=int(ran.frames[0]),
        contenders=tuple(each for each in contenders if each.searches)
        if judging.contenders
        else (),
        expected=float(ran.expected[0] + weigh_costs(objective, chosen, judged.kbit[:1])[0]),
        by_errors=by_errors,
        errors_by=final.cases.errors_by if by_errors else "",
    )


def aps_at_profiles(
    final: CasesEvaluator, sets: Sets, frames: Frames
) -> list[tuple[ProfileAP, ...]]:
    """AP of each set at each of several error profiles separately."""
    if len(final.profiles) == 1:
        return [()] * len(sets)
    aps, _, resamples = final.at_profiles(sets, frames)
    found = []
    for n in range(len(sets)):
        each = zip(final.cases.names, aps[:, n].tolist(), resamples[:, n], strict=True)
        intervals = ((name, ap, *final.interval(ap, drawn, frames)) for name, ap, drawn in each)
        found.append(tuple(ProfileAP(*figures) for figures in intervals))
    return found


def _judge_in_time(
    sets: Sets, final: CasesEvaluator, schedule: Schedule, report: Report | None
) -> tuple[Evaluated, Frames]:
    """Figures of the sets judged in time, the first in any case, and the frames, the same for
    all."""
    every = np.arange(final.frames)
    if schedule.seconds is None:
        return final.evaluate(sets, every, report), every
    order = race_order(final.frames)
    frames = order[: schedule.limit(final).evaluate(sets[:1], order, report).frames]
    done = 1
    for each in sets[1:]:
        if (
            schedule.left <= 0
            or schedule.limit(final).evaluate(each[None], frames).frames is not None
        ):
            break
        done += 1
    return final.evaluate(sets[:done], frames), frames
