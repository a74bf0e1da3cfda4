"""`plan`: from a question to a plan. The cache keeps its stages, so an interrupted plan resumes.

There are three parts of traffic with different seeds. Searches see the first, the detector compares
the entrants on the second, and the plan's figures for the chosen set are from the third. The last
stage follows road users on continuous traffic with a fourth seed."""

from dataclasses import replace

from placement_env.candidates.candidates import NoCandidates
from placement_env.fidelity.preparation import check_scorable
from placement_env.handover import mounted
from placement_env.handover.ground import visible_ground
from placement_env.report import content
from placement_env.report.planning.answer import build_plan
from placement_env.report.planning.buildable import narrow_question
from placement_env.report.planning.choosing import choose_at_drawings, choose_set
from placement_env.report.planning.entrant_search import prepare_search, search_entrants
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


def plan(question: Question) -> content.Planned:
    """Answer a question with a plan, which gives reasons if nothing may be built.

    The plan comes with the site and its chosen sensors, the candidates, and the ground and frames
    for pictures. A refused plan has no sensors, ground and frames. The same question has the same
    plan, byte for byte, whatever the cache and the processes.

    Raises ValueError and OSError for damaged inputs, ImportError without SUMO."""
    try:
        _check_question(question)
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
    objectives = searched.objectives
    objective = objectives[0]
    compared = prepare_judge(question, objectives, question.part("comparison"), compares=True)
    check_objects(question, compared.judge)
    choice = choose_set(
        objective,
        entrants,
        compared.judge,
        min_ap=question.min_ap,
        confidence=question.confidence,
        run=question.run,
    )
    final = prepare_final_judge(question, objectives, choice.sets[choice.chosen])
    check_objects(question, final.judge)
    parts = [searched.preparations[0], compared.preparation, final.preparation]
    findings = Findings(
        question=question,
        entrants=entrants,
        choice=choice,
        objective=objective,
        network=searched.preparations[0].network,
        excluded=searched.excluded,
        traffic=[preparation.traffic for preparation in parts],
        drawings=choose_at_drawings(compared.judge, choice, question.min_ap),
    )
    candidates = objective.candidates
    ground = visible_ground(question.site, [candidates.sensors[c] for c in choice.members])
    unfollowed_plan = build_plan(findings, final.judge, ground)
    detector = final.judge.detected.detector
    motion = measure_motion(question, candidates, choice.members, detector)
    return content.Planned(
        plan=replace(unfollowed_plan, motion=motion),
        site=mounted.mounted_site(question.site, candidates, choice.members),
        candidates=candidates,
        ground=ground,
        moments=pick_moments(final.judge.detected, choice.members, seed=question.run.seed),
    )
