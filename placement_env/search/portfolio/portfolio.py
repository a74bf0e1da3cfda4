"""Portfolio: several searches whose answers and neighbours race by the detector on fresh traffic.

Traffic has three parts. The searches use the objective's; the entrants race on the second until the
best is known confidently enough (`contest`); the figures of the answer come from the third. So the
stated AP carries neither the optimism of the searches nor of the race. Picking the best of many by
noisy or biased scores overrates it (the winner's curse), by the amount that `Contender.curse` gives
for each search.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from placement_env.analysis.agreement import StageFigure, check_agreement
from placement_env.analysis.case_figures import CaseFigures
from placement_env.analysis.intervals import (
    AP_TOLERANCE,
    Interval,
    is_comparable,
    share_beyond_reach,
)
from placement_env.checks import check_whole
from placement_env.fidelity.preparation import Preparation
from placement_env.objective import Objective
from placement_env.protocol import FidelityName
from placement_env.racing import Contest
from placement_env.search.checkpoint import Checkpoint
from placement_env.search.checkpoint_folder import NOWHERE
from placement_env.search.portfolio.entrants import (
    DEFAULT_NEIGHBOURS,
    Effort,
    Entrants,
    at_other_ious,
    join_entrants,
    keep_entrants,
)
from placement_env.search.portfolio.evaluators import (
    CasesEvaluator,
    Frames,
    Report,
    build_evaluator,
    race_order,
)
from placement_env.search.portfolio.reward_race import MAX_SET_FRAMES, contest, weigh_costs
from placement_env.search.portfolio.schedule import Schedule
from placement_env.search.progress import Limits
from placement_env.search.result import Assessment, Certificate, Contender, ProfileAP, Result
from placement_env.setting import Setting
from placement_env.subsets import Sets
from toolkit.arrays import Int64

RACE_FRAMES = 96
JUDGED_FRAMES = 120
SEARCH_COUNT = 8  # searches that share their time


@dataclass(frozen=True, kw_only=True)
class Judging:
    """Race and assessment of a portfolio. Raises ValueError for a confidence outside 0 to 1.

    Attributes:
        by: Fidelity of both.
        confidence: Confidence at which the race ends that no entrant is better by more than
            `AP_TOLERANCE`.
        race_frames: Frames of the race, part 1 of the run's traffic.
        final_frames: Frames of the assessment, part 2 of the run's traffic.
        neighbours: Number of neighbours that join the answers.
        contenders: Whether to assess the answer of each search in addition to the winner.
        setting: Setting of both, None for the objective's.
        evaluators: Evaluators of both, in place of most other attributes.
    """

    by: FidelityName = "detector"
    confidence: float = 0.95
    race_frames: int = RACE_FRAMES
    final_frames: int = JUDGED_FRAMES
    neighbours: int = DEFAULT_NEIGHBOURS
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
        """Evaluators of race and assessment, on parts 1 and 2 of the run's traffic.

        Part 0 is the traffic of the searches.

        schedule: gives fewer frames if time is short; seed: for the resamples. Raises ValueError
        without a site to simulate traffic.
        """
        if self.evaluators is not None:
            return self.evaluators
        if self.setting is None and objective.preparation is None:
            raise ValueError(
                "a portfolio needs fresh traffic, so an objective made from a site: Objective(site)"
            )
        setting = self.setting or objective.setting.with_fidelity(self.by)
        run = objective.run
        race_run = run.part(1, schedule.limit_frames(self.race_frames))
        final_run = run.part(2, schedule.limit_frames(self.final_frames))
        race = Preparation(setting, race_run, compares_sets=True)
        final = Preparation(setting, final_run, compares_sets=False)
        return (
            build_evaluator(race, self.by, seed=seed),
            build_evaluator(final, self.by, seed=seed, tie=0.0),  # its AP are stated
        )


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

    The answer is the empty set, without an assessment, if no search finds a feasible set or no set
    of the race pays its costs.

    Args:
        objective: Objective of the searches.
        budget: Largest number of sensors.
        seed: Seed of searches, race and resamples.
        seconds: Time for searches, race and assessment together; with less time there are fewer
            frames. None for no limit.
        evaluations: Largest number of scored sets of each search, None for its default.
        judging: Race and assessment.
        checkpoint: Keeps the progress of the searches.

    Raises ValueError if these do not fit.
    """
    check_whole("budget", budget, least=1)
    objective.setting.check_budget(budget)
    limits = Limits(seconds, evaluations)
    schedule = Schedule.from_processes(seconds, objective.run)
    race_evaluator, final_evaluator = judging.build_evaluators(objective, schedule, seed=seed)
    effort = Effort(
        sizes=(budget,),
        seconds=schedule.search_seconds(SEARCH_COUNT),
        evaluations=evaluations,
        neighbours=judging.neighbours,
    )
    entrants = _find_entrants(objective, effort, seed, checkpoint)
    limits.count = entrants.considered
    if not len(entrants.sets):
        note = "no search found a set that may be built and pays"
        return _build_result(objective, [], note, limits)
    race = contest(
        objective,
        entrants.sets,
        # half of the time left; the assessment gets the rest
        schedule.limit(race_evaluator, share=1 / 2, min_frames=1),
        confidence=judging.confidence,
        seed=seed,
        max_set_frames=MAX_SET_FRAMES if seconds is None else math.inf,
    )
    has_costs = bool(objective.weights.comm or objective.weights.price)
    if race.figures[0] <= 0 and not len(objective.kept) and has_costs:
        note = (
            f"by the {race_evaluator.name} none of the {len(entrants.sets)} compared sets is worth "
            "what it costs"
        )
        return _build_result(objective, [], note, limits)
    members = np.flatnonzero(entrants.sets[race.ranking[0]]).tolist()
    limits.record(objective.score(members).reward)
    note = (
        f"the best of {len(entrants.sets)} sets compared by the {race_evaluator.name}; an estimate "
        "ruled out the others"
    )
    assessment = _assess(
        objective, entrants, race, evaluator=final_evaluator, schedule=schedule, judging=judging
    )
    return replace(_build_result(objective, members, note, limits), assessment=assessment)


def _find_entrants(
    objective: Objective, effort: Effort, seed: int, checkpoint: Checkpoint
) -> Entrants:
    """Search for the sets to race.

    Unless there is one case (one IoU threshold, no failures, undivided traffic), sets are also
    searched for as if nothing failed and in all traffic together, because the best may be
    the best in the worst case. This needs `preparation`, which an objective has if its fidelity was
    given by name.

    objective: objective of the searches; effort: their limits; seed: for all searches; checkpoint:
    keeps the progress of both rounds of searches."""
    others = at_other_ious(objective)
    entrants = keep_entrants(objective, effort, others=others, seed=seed, checkpoint=checkpoint)
    preparation = objective.preparation
    if preparation is None or objective.setting.cases.is_one_case:
        return entrants
    intact_setting = replace(
        preparation.intact_preparation.setting, candidates=objective.candidates
    )
    intact_objective = Objective(intact_setting, preparation.run)
    intact_entrants = keep_entrants(
        intact_objective, effort, seed=seed, checkpoint=checkpoint.part("intact")
    )
    return join_entrants([objective], [entrants, intact_entrants])


def _build_result(objective: Objective, members: list[int], note: str, limits: Limits) -> Result:
    """Return the result for a set, without an assessment.

    members: indices of its candidates; note: explains why this set; limits: history so far."""
    best = objective.score(members)
    return Result(
        method="portfolio",
        best=best,
        history=limits.history(best.reward),
        certificate=Certificate("none", best.reward, note=note),
        evaluations=limits.count,
        seconds=limits.elapsed,
        origin=objective.describe_origin(best.subset),
    )


def _assess(
    objective: Objective,
    entrants: Entrants,
    race: Contest,
    *,
    evaluator: CasesEvaluator,
    schedule: Schedule,
    judging: Judging,
) -> Assessment:
    """Judge the winner, then contenders as far as time allows, on the third part of the traffic.

    Contenders are the answers of the searches, judged if `Judging.contenders` asks for it. Raises
    ValueError if race and judgement of the winner exclude each other.

    Args:
        objective: Objective of the searches.
        entrants: Sets that raced.
        race: Finished race, the winner first.
        evaluator: Evaluator of the third part of the traffic.
        schedule: Schedule with the time left.
        judging: Confidence that was asked for, and whether contenders are judged."""
    winner = int(race.ranking[0])
    rows = _list_judged_rows(entrants, winner, judging)  # the winner first
    report = objective.run.stage("frames judged", evaluator.frames)
    judged, frames = judge_in_time(entrants.sets[rows], evaluator, schedule, report)
    contenders = []
    # fewer figures than rows if time ran out
    for n, ap in enumerate(judged.ap.tolist()):
        interval = evaluator.interval(judged[n], frames)
        contenders.append(_build_contender(entrants, row=int(rows[n]), ap=ap, interval=interval))
    answer = contenders[0]
    winner_row = entrants.sets[[winner]]
    object_count = evaluator.count_objects(frames)
    cost = float(weigh_costs(objective, winner_row, judged.kbit[:1])[0])
    race_frames = int(race.frames[0])
    has_one_case = evaluator.cases.is_one_case and len(evaluator.by_profile) == 1
    if evaluator.name == "detector" and has_one_case:
        names = [objective.names[c] for c in np.flatnonzero(winner_row[0])]
        judged_figure = StageFigure(
            stage="in the judgement", ap=answer.ap, objects=object_count, frames=len(frames)
        )
        _check_race(names, race, cost, judged=judged_figure)
    confidence = math.nan
    if is_comparable(race_frames, object_count):
        reach = 0.0 if math.isnan(answer.low) else share_beyond_reach(judged.resamples[0] - cost)
        confidence = max(race.confidence, reach)  # an AP near 1 cannot be beaten by much
    (by_errors,) = aps_at_profiles(evaluator, winner_row, frames)
    return Assessment(
        by=evaluator.name,
        ap=answer.ap,
        low=answer.low,
        high=answer.high,
        kbit=float(judged.kbit[0]),
        objects=object_count,
        frames=len(frames),
        predicted=answer.predicted,
        confidence=confidence,
        asked=judging.confidence,
        tolerance=AP_TOLERANCE,
        entrants=len(entrants.sets),
        raced=race_frames,
        contenders=tuple(contender for contender in contenders if contender.searches)
        if judging.contenders
        else (),
        expected=float(race.expected[0]) + cost,
        by_errors=by_errors,
        errors_by=evaluator.cases.errors_by if by_errors else "",
    )


def _list_judged_rows(entrants: Entrants, winner: int, judging: Judging) -> Int64[np.ndarray, " n"]:
    """Rows of the sets to assess, the winner first, then the answers of searches if asked for.

    entrants: sets that raced; winner: its row among them; judging: has whether the answers of all
    searches (contenders) are assessed too."""
    if not judging.contenders:
        return np.array([winner], np.int64)
    answer_rows = [row for row, names in enumerate(entrants.searches) if names]
    return np.array([winner, *(row for row in answer_rows if row != winner)], np.int64)


def _build_contender(entrants: Entrants, row: int, ap: float, interval: Interval) -> Contender:
    """Answer of a search in the final assessment, with its AP there and the AP's interval.

    entrants: sets that raced; row: index of the set among them."""
    return Contender(
        searches=entrants.searches[row],
        subset=tuple(np.flatnonzero(entrants.sets[row]).tolist()),
        predicted=float(entrants.predicted[row]),
        ap=ap,
        low=interval.low,
        high=interval.high,
    )


def _check_race(names: list[str], race: Contest, cost: float, judged: StageFigure) -> None:
    """Raise ValueError if the winner's figures in race and assessment exclude each other.

    names: sensors of the winner; race: finished race, the winner first; cost: its costs in AP, by
    which the race ranked it lower; judged: AP of the winner in the assessment."""
    race_frames = int(race.frames[0])  # frames that scored the winner
    # the race did not count its objects: as many per frame as in the judgement
    race_objects = round(judged.objects * race_frames / judged.frames)
    race_figure = StageFigure(
        stage="in the race",
        ap=float(race.figures[0]) + cost,
        objects=race_objects,
        frames=race_frames,
    )
    check_agreement(names, race_figure, judged)


def aps_at_profiles(
    evaluator: CasesEvaluator, sets: Sets, frames: Frames
) -> list[tuple[ProfileAP, ...]]:
    """AP of each set at each of several error profiles, with intervals; empty for one profile.

    The list has an entry for each set, with the profiles in their order.

    frames: frame numbers of the evaluator's traffic."""
    if len(evaluator.by_profile) == 1:
        return [()] * len(sets)
    figures = evaluator.at_profiles(sets, frames)  # profiles × sets
    by_set = []
    for n in range(len(sets)):
        profile_aps = []
        for k, name in enumerate(evaluator.cases.names):
            set_figures = figures[k][n]
            low, high = evaluator.interval(set_figures, frames)
            profile_aps.append(ProfileAP(name, float(set_figures.ap), low=low, high=high))
        by_set.append(tuple(profile_aps))
    return by_set


def judge_in_time(
    sets: Sets, evaluator: CasesEvaluator, schedule: Schedule, report: Report | None
) -> tuple[CaseFigures, Frames]:
    """Figures of the sets evaluated in time, and the frames, the same for all sets.

    The first set is always evaluated, and decides on how many frames; each further set is evaluated
    only if time allows all these frames. So there may be figures of fewer sets, always the first.

    evaluator: evaluates sets on fresh traffic; schedule: gives the time, without a limit all frames
    are used; report: called with the number of frames done, None for silence.
    """
    if schedule.seconds is None:
        all_frames = np.arange(evaluator.frames)
        return evaluator.evaluate(sets, all_frames, report), all_frames
    order = race_order(evaluator.frames)
    first_figures = schedule.limit(evaluator).evaluate(sets[:1], order, report)
    frames = order[: first_figures.used]  # None: time sufficed for all
    judged_count = 1
    for row in sets[1:]:
        if schedule.remaining_s <= 0:
            break
        figures = schedule.limit(evaluator).evaluate(row[None], frames)
        if figures.used is not None:  # time did not suffice for all frames
            break
        judged_count += 1
    # quick, as the detections of the evaluated sets are kept
    return evaluator.evaluate(sets[:judged_count], frames), frames
