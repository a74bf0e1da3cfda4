"""`choose_set`: the answer of a plan among the entrants.

Without a requirement the answer is the cheapest set that is as good as the best of the races. With
a requirement it is the cheapest set whose AP reaches it; sets are judged by price until one does.
If none does, it is the best set. AP is always over the cases of the plan (`PlanOption.counted`)."""

import math
from dataclasses import replace

import numpy as np

from placement_env.analysis.intervals import AP_TOLERANCE, BLOCK_FRAMES
from placement_env.analysis.shrinkage import shrink
from placement_env.objective import Objective
from placement_env.report.content import DrawingResult
from placement_env.report.planning.choice import Choice, Rule, choose, rank_thrift
from placement_env.report.planning.judged_options import JudgedOptions
from placement_env.report.planning.judging import Judge
from placement_env.report.planning.size_races import SizeRaces, race_sizes
from placement_env.search.portfolio.entrants import Entrants
from placement_env.search.portfolio.evaluators import race_order
from toolkit.runtime.run import Run

FIRST_LOOK_FRAMES = 12  # frames of the first look at all sets that may reach a requirement
FIRST_LOOK_ERROR_AP = 0.1  # AP by which the first look may underrate a set


def choose_at_drawings(
    judge: Judge, choice: Choice, min_ap: float | None
) -> tuple[DrawingResult, ...]:
    """Judge the answer, and choose among the sets judged on all frames, at each drawing.

    Each result has the answer's figures at this drawing, and the poles of the set that would have
    been the answer there. It shows how much the answer depends on what no map knows. Empty for one
    drawing.

    Args:
        judge: Judge of the comparison.
        choice: The answer over all drawings.
        min_ap: Required AP, None without a requirement."""
    if not judge.drawings:
        return ()
    # rows among the entrants of the sets judged on all frames; below, n counts these only
    judged_rows = choice.list_judged_rows()
    judged_sets = choice.sets[judged_rows]
    results = []
    for drawing in judge.drawing_judges:
        judgements, draws = drawing.judge_cases(judged_sets)
        all_frames = np.arange(drawing.frames)
        mean_aps = drawing.evaluator.mean_ap(judged_sets, all_frames).tolist()
        options = [
            replace(choice.options[i], mean_ap=mean_aps[n], **judgements[n]._asdict())
            for n, i in enumerate(judged_rows)
        ]
        _, alike_options = choose(options, dict(enumerate(draws)))
        answer = alike_options[0]  # cheapest set as good as the best
        if min_ap is not None:
            met = [n for n, judgement in enumerate(judgements) if judgement.counted.ap >= min_ap]
            answer = min(met, key=lambda n: rank_thrift(options[n]), default=answer)
        chosen_result = judgements[judged_rows.index(choice.chosen)].counted
        results.append(DrawingResult(judged=chosen_result, poles=options[answer].poles))
    return tuple(results)


def choose_set(
    objective: Objective,
    entrants: Entrants,
    judge: Judge,
    *,
    min_ap: float | None = None,
    confidence: float = 0.95,
    run: Run = Run(),
) -> Choice:
    """Choose the answer among the entrants, which are the sets that the searches found.

    Without a required AP, or if no set reaches it, sets of each size race, and the close ones are
    judged on all frames, the winners of the other sizes in a sample.

    Args:
        objective: Objective of the searches.
        entrants: Sets to choose from, at least one.
        judge: Judge on the traffic of the comparison.
        min_ap: AP that the cheapest set must reach, None for no requirement.
        confidence: Confidence at which a race of one size ends.
        run: Gives the seed and reports progress.

    Raises ValueError if a set's AP in its race and its judgement exclude each other."""
    options = JudgedOptions(objective, entrants, judge)
    if min_ap is not None and (reached := _find_cheapest(options, min_ap, run)) is not None:
        return Choice(
            options=tuple(options.options),
            sets=entrants.sets,
            chosen=reached,
            best=reached,
            alike=(),
            rule="cheapest",
        )
    races = race_sizes(options, confidence, run)
    sizes = entrants.sets.sum(axis=1)
    order = race_order(judge.frames, seed=run.seed)
    options.judge_rows(races.list_rows(), run)
    _judge_behind(options, races, run)
    for race, winner, _ in races.by_size.values():
        options.check_race(winner, float(race.figures[0]), order[: race.frames[0]])
    best, alike_options = choose(options.options, options.draws)
    answer = best
    rule: Rule = "best" if min_ap is None else "none"
    if min_ap is None and alike_options[0] != best:
        answer = alike_options[0]
        rule = "as good"
    near_options = tuple(i for i in alike_options if i != answer)
    size_rows = np.flatnonzero(sizes == sizes[answer])
    size_race = races.by_size.get(int(sizes[answer]))
    answer_race = None if size_race is None else size_race.race
    sureness = options.measure_sureness(answer, size_rows, answer_race)
    return Choice(
        options=tuple(options.options),
        sets=entrants.sets,
        chosen=answer,
        best=best,
        alike=near_options,
        rule=rule,
        confidence=sureness,
    )


def _judge_behind(options: JudgedOptions, races: SizeRaces, run: Run) -> None:
    """Judge the winners of sizes that do not contend in a sample of the frames.

    Those that turn out within `AP_TOLERANCE` of the best that fits its links are judged on all
    frames, since they may be the answer. Judged sets are replaced in `options`."""
    rows = races.list_rows_behind()
    whole_options = [options.options[i] for i in options.draws]
    options.judge_rows(rows, run, reference=races.best.row)
    aps = [option.counted.ap for option in whole_options if option.counted and option.fits_links]
    min_ap = max(aps, default=-math.inf) - AP_TOLERANCE
    near_rows = []
    for i in rows:
        judgement = options.options[i].counted
        if judgement is not None and judgement.ap >= min_ap:
            near_rows.append(i)
    options.judge_rows(near_rows, run)


def _find_cheapest(options: JudgedOptions, min_ap: float, run: Run) -> int | None:
    """Return the row of the cheapest set whose AP reaches the requirement, None if none does.

    A first look at all sets on `FIRST_LOOK_FRAMES` frames excludes those whose expected AP is more
    than `FIRST_LOOK_ERROR_AP` below the requirement. The others are judged in the order of their
    prices, at one price by expected AP, until one reaches it and fits its links. Judged sets are
    replaced in `options`.

    options: entrants with their judge; min_ap: required AP over all cases; run: gives the seed and
    reports progress."""
    entrants = options.entrants
    judge = options.judge
    look_frames = race_order(judge.frames, seed=run.seed)[:FIRST_LOOK_FRAMES]
    report = run.stage("frames of the first look", len(look_frames))
    first_look = judge.evaluator.evaluate(entrants.sets, look_frames, report)
    blocks = len(np.unique(look_frames // BLOCK_FRAMES))
    # AP on few frames are noisy, so they are moved towards their predictions
    shrunk = shrink(first_look.ap, first_look.resamples, entrants.predicted, blocks)
    expected_aps = shrunk.figure
    prices = np.array([option.price for option in options.options])
    rows = np.lexsort((-expected_aps, prices)).tolist()  # by price, which is the last key
    report = run.stage("sets judged by price", len(rows))
    for step, i in enumerate(rows, 1):
        if expected_aps[i] >= min_ap - FIRST_LOOK_ERROR_AP:
            options.judge_rows([i])
            option = options.options[i]
            judgement = option.counted
            if judgement is not None and judgement.ap >= min_ap and option.fits_links:
                return i
        if report is not None:
            report(step)
    return None
