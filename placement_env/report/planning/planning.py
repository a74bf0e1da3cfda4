"""`plan`: from a question to a plan. The cache keeps its stages, so an interrupted plan resumes.

There are three parts of traffic with different seeds. Searches see the first, the detector compares
the entrants on the second, and the plan's figures for the chosen set are from the third. The last
stage follows road users on continuous traffic with a fourth seed."""

from dataclasses import replace
from typing import NamedTuple

from placement_env.candidates.candidates import NoCandidates
from placement_env.fidelity.preparation import check_scorable
from placement_env.fidelity.seeing import forget_stills
from placement_env.fidelity.traffic import Traffic
from placement_env.handover import mounted
from placement_env.handover.ground import visible_ground
from placement_env.report import content
from placement_env.report.planning.answer import build_plan
from placement_env.report.planning.buildable import narrow_question
from placement_env.report.planning.choice import Choice
from placement_env.report.planning.choosing import choose_at_drawings, choose_set
from placement_env.report.planning.entrant_search import (
    PreparedSearch,
    prepare_search,
    search_entrants,
)
from placement_env.report.planning.findings import Findings
from placement_env.report.planning.moments import pick_moments
from placement_env.report.planning.motion import measure_motion
from placement_env.report.planning.prepared_judge import (
    check_objects,
    prepare_final_judge,
    prepare_judge,
)
from placement_env.report.planning.question import Question
from placement_env.report.planning.refusals import Refusal, refuse, refuse_question
from placement_env.search.portfolio.entrants import Entrants
from toolkit.objects import Detector
from toolkit.rendering.renderer import body_scene
from toolkit.runtime.allocation import return_freed_memory


class _Comparison(NamedTuple):
    """Choice among the entrants, without the measurements that it is from.

    Attributes:
        choice: The chosen set and all entrants.
        traffic: Traffic of the comparison at the first drawing of the site.
        drawings: Answer at each drawing of the site."""

    choice: Choice
    traffic: Traffic
    drawings: tuple[content.DrawingResult, ...]


class _Judged(NamedTuple):
    """Plan without figures of motion, and the detector that judged the chosen set."""

    planned: content.Planned
    detector: Detector


def plan(question: Question) -> content.Planned:
    """Answer a question with a plan, which gives reasons if nothing may be built.

    The plan comes with the site and its chosen sensors, the candidates, and the ground and frames
    for pictures. A refused plan has no sensors, ground and frames. The same question has the same
    plan, byte for byte, whatever the cache and the processes.

    Raises ValueError and OSError for damaged inputs, ImportError without SUMO."""
    try:
        _check_question(question)
        # with the poses that see most in the search's traffic, if there are too many to search
        searchable_question = narrow_question(question, question.part("search"))
        return _answer(searchable_question)
    except Refusal as refusal:
        return refuse(question, refusal)


def _check_question(question: Question) -> None:
    """Raise `Refusal` if a question has no answer, whatever the traffic.

    Raises ValueError if the detector cannot score the question."""
    if reasons := refuse_question(question):
        raise Refusal(reasons)
    try:
        pool = question.setting.pool
    except NoCandidates as error:
        raise Refusal((f"There is no candidate: {error}.",)) from None
    check_scorable(question.judge_setting(pool), "detector")


def _answer(question: Question) -> content.Planned:
    """Search, compare, choose, judge the choice on fresh traffic, and build the plan.

    Raises `Refusal` if a stage finds that nothing can be planned.

    question: question with few enough poses to search (`narrow_question`)."""
    searched = prepare_search(question, question.part("search"))
    entrants = search_entrants(question, searched)
    _free_stage()
    comparison = _compare(question, searched, entrants)
    _free_stage()
    judged = _judge_choice(question, searched, entrants, comparison)
    _free_stage()
    planned = judged.planned
    candidates = searched.objectives[0].candidates
    motion = measure_motion(question, candidates, comparison.choice.members, judged.detector)
    _free_stage()  # the report is still to be drawn
    return replace(planned, plan=replace(planned.plan, motion=motion))


def _free_stage() -> None:
    """Return the memory of a stage to the system, with all scenes that later stages do not need."""
    body_scene.cache_clear()
    forget_stills()
    return_freed_memory()


def _compare(question: Question, searched: PreparedSearch, entrants: Entrants) -> _Comparison:
    """Choose among the entrants on traffic that no search saw.

    searched: inputs of the searches, with objectives at each drawing of the site; entrants: sets
    that the searches found."""
    objectives = searched.objectives
    compared = prepare_judge(question, objectives, question.part("comparison"), compares=True)
    check_objects(question, compared.judge)
    return_freed_memory()  # learning the background takes much
    choice = choose_set(
        objectives[0],
        entrants,
        compared.judge,
        min_ap=question.min_ap,
        confidence=question.confidence,
        run=question.run,
    )
    return _Comparison(
        choice=choice,
        traffic=compared.preparation.traffic,
        drawings=choose_at_drawings(compared.judge, choice, question.min_ap),
    )


def _judge_choice(
    question: Question, searched: PreparedSearch, entrants: Entrants, comparison: _Comparison
) -> _Judged:
    """Judge the chosen set on traffic that neither searches nor comparison saw.

    searched: inputs of the searches; entrants: sets that the searches found; comparison: choice
    among them. Returns the plan, and the detector that judged."""
    objectives = searched.objectives
    objective = objectives[0]  # at the first drawing, the site itself
    choice = comparison.choice
    final = prepare_final_judge(question, objectives, choice.sets[choice.chosen])
    check_objects(question, final.judge)
    search_preparation = searched.preparations[0]
    findings = Findings(
        question=question,
        entrants=entrants,
        choice=choice,
        objective=objective,
        network=search_preparation.network,
        excluded=searched.excluded,
        traffic=[search_preparation.traffic, comparison.traffic, final.preparation.traffic],
        drawings=comparison.drawings,
    )
    candidates = objective.candidates
    ground = visible_ground(question.site, [candidates.sensors[c] for c in choice.members])
    detected = final.judge.detected
    planned = content.Planned(
        plan=build_plan(findings, final.judge, ground),
        site=mounted.mounted_site(question.site, candidates, choice.members),
        candidates=candidates,
        ground=ground,
        moments=pick_moments(detected, choice.members, seed=question.run.seed),
    )
    return _Judged(planned, detected.detector)
