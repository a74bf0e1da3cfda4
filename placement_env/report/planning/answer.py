"""`build_plan`: a plan's figures, tables and sentences put together."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from placement_env.analysis.intervals import AP_TOLERANCE, share_beyond_reach
from placement_env.handover import mounted
from placement_env.handover.ground import GroundGrid, ground_shares
from placement_env.report import content
from placement_env.report.planning import sentences
from placement_env.report.planning.breakdowns import (
    by_approach,
    by_class,
    by_errors,
    by_level,
    by_range,
    by_zone,
    measure_blind_streets,
)
from placement_env.report.planning.choice import find_front_options
from placement_env.report.planning.chosen_set import ChosenSet
from placement_env.report.planning.error_draws import by_draw
from placement_env.report.planning.findings import Findings, check_stages, trace_plan
from placement_env.report.planning.judging import Judge, SetJudgement
from placement_env.report.planning.plan_stock import format_stock
from placement_env.report.planning.scored_boxes import score_boxes
from toolkit.arrays import Float64
from toolkit.detection.provenance import detector_origin
from toolkit.sites.surroundings.things import count_things


class FinalFigures(NamedTuple):
    """Figures of the chosen set on the final traffic.

    Final traffic is the third part, which no search or comparison saw.

    Attributes:
        option: The set with its figures.
        judgement: Its AP, intact and in the requested cases.
        draws: AP over all requested cases (`SetJudgement.counted`) in each bootstrap resample.
        sensor_kbit: Kilobits that each sensor sends in each frame; rows as the set's members."""

    option: content.PlanOption
    judgement: SetJudgement
    draws: Float64[np.ndarray, " resamples"]
    sensor_kbit: Float64[np.ndarray, "sensors frames"]


def build_plan(findings: Findings, final: Judge, ground: GroundGrid) -> content.Plan:
    """Build the whole plan: figures, tables and sentences about the chosen set.

    Sections are added in order, because later ones read earlier ones. Sensors carry the names of
    candidates while the plan is built and are renamed last to their names at the site.

    Args:
        findings: What led to the chosen set.
        final: Judge on the final traffic.
        ground: Ground that the chosen sensors see."""
    question = findings.question
    choice = findings.choice
    candidates = findings.objective.candidates
    members = choice.members
    chosen_set = ChosenSet(
        members,
        names=choice.option.sensors,
        judge=final,
        objective=findings.objective,
        run=question.run,
    )
    figures = _judge_chosen(findings, chosen_set)
    sensors = mounted.format_sensors(
        question.site,
        candidates,
        members,
        kbit=figures.sensor_kbit,
        catalogue=question.stock.catalogue,
        link_share=question.setting.link_share,
    )
    plan = _state_answer(findings, final, figures, sensors)
    plan = replace(plan, schemes=chosen_set.schemes())
    plan = _add_breakdowns(plan, findings, final)
    plan = replace(plan, worth=chosen_set.worth(), failures=chosen_set.failures())
    plan = _add_installation(plan, findings, ground)
    plan = replace(plan, order=chosen_set.order())
    plan = _add_limits(plan, findings, final, figures, sampled=not chosen_set.is_small)
    mounted_names = [sensor.name for sensor in sensors]
    candidate_names = [candidates.sensors[c].name for c in members]
    return content.rename(plan, dict(zip(candidate_names, mounted_names, strict=True)))


def _judge_chosen(findings: Findings, chosen_set: ChosenSet) -> FinalFigures:
    """Judge the chosen set on the final traffic, and check it against the earlier stages.

    Raises ValueError if prediction, comparison and judgement exclude each other."""
    choice = findings.choice
    members = choice.members
    judge = chosen_set.judge
    is_member = choice.sets[choice.chosen]
    # the judge takes many sets at a time; here it gets one row, and returns one
    judgements, draws = judge.judge_cases(is_member[None], chosen_set.stage)
    judgement = judgements[0]
    check_stages(findings, judgement.judged)
    sensor_kbit = judge.kbit(members)  # axes: sensor, frame
    kbit = float(sensor_kbit.sum(axis=0).mean())
    option = replace(
        choice.option,
        **judgement._asdict(),
        kbit=kbit,
        kbit_per_sensor=kbit / len(members),
        fits_links=findings.objective.fits_links(members, sensor_kbit),
    )
    return FinalFigures(option, judgement, draws=draws[0], sensor_kbit=sensor_kbit)


def _state_answer(
    findings: Findings,
    final: Judge,
    figures: FinalFigures,
    sensors: tuple[mounted.PlannedSensor, ...],
) -> content.Plan:
    """Start the plan with question, verdict, chosen set and the sets it was compared with.

    Args:
        findings: What led to the chosen set, with its figures from the comparison.
        final: Judge on the final traffic, for the name of its detector.
        figures: Figures of the chosen set on the final traffic.
        sensors: The chosen sensors as they are to be mounted."""
    question = findings.question
    choice = findings.choice
    links = mounted.link_loads(sensors, limited=question.setting.fusion.sends_points)
    return content.Plan(
        question=question.as_dict(),
        site=question.site.name,
        detector=detector_origin(final.detected.detector)["detector"],
        iou=question.cases.threshold,
        scheme=question.setting.fusion.name,
        currency=question.currency,
        verdict=sentences.build_verdict(
            question, choice.option, figures.option, findings.excluded, choice.rule, links=links
        ),
        chosen=figures.option,
        best=choice.options[choice.best],
        confidence=judge_sureness(choice.confidence, figures.judgement.counted, figures.draws),
        sensors=sensors,
        considered=tuple(sorted(choice.options, key=_rank_considered)),
        near_optimal=choice.near_optimal,
        front=find_front_options(choice.options),
        links=links,
        head=question.stock.head,
    )


def _add_breakdowns(plan: content.Plan, findings: Findings, final: Judge) -> content.Plan:
    """Return the plan with results by place, level, errors, drawing and class.

    All but `by_drawing` are computed here on the final traffic; results by drawing are already
    among the findings."""
    question = findings.question
    site = question.site
    seed = question.run.seed
    members = findings.choice.members
    scored_boxes = score_boxes(final, members)
    sensors = [findings.objective.candidates.sensors[c] for c in members]
    return replace(
        plan,
        by_zone=by_zone(scored_boxes, site, seed),
        by_range=by_range(scored_boxes, sensors, seed),
        by_approach=by_approach(scored_boxes, site, seed),
        by_level=by_level(scored_boxes, final, members),
        by_errors=by_errors(final, members),
        by_draw=by_draw(final, members, question.run),
        by_drawing=findings.drawings,
        by_class=by_class(final, members),
        class_ap=(*final.by_class(members), *final.by_other_class(members)),
    )


def _add_installation(plan: content.Plan, findings: Findings, ground: GroundGrid) -> content.Plan:
    """Return the plan with what is to be bought, what the sensors see of the ground, and the stock.

    Also added are mounts without a sensor, and where the things at the site come from. Reads the
    plan's sensors, which must already be in it."""
    question = findings.question
    site = question.site
    candidates = findings.objective.candidates
    unused_mounts = mounted.unused_mounts(candidates, findings.choice.members)
    return replace(
        plan,
        materials=mounted.bill_of_materials(plan.sensors),
        running=mounted.bill_of_rates(plan.sensors, question.stock.catalogue),
        ground=ground_shares(ground, [sensor.name for sensor in plan.sensors]),
        blind_streets=measure_blind_streets(site, ground),
        poles_unused=tuple(mount.name for mount in unused_mounts),
        origins=count_things(replace(site, mounts=candidates.mounts)),
        stock=format_stock(question, question.setting.pool),
    )


def _add_limits(
    plan: content.Plan, findings: Findings, final: Judge, figures: FinalFigures, *, sampled: bool
) -> content.Plan:
    """Return the plan with assumptions, unknowns, provenance, and last the reasons for the choice.

    Reasons are made last because they quote the plan so far (failures, schemes, compared sets).

    Args:
        plan: Plan with all other sections.
        findings: What led to the chosen set.
        final: Judge on the final traffic.
        figures: Figures of the chosen set on the final traffic.
        sampled: True if Shapley values were estimated from a sample of subsets, as for large
            sets."""
    question = findings.question
    choice = findings.choice
    objective = findings.objective
    plan = replace(
        plan,
        assumptions=sentences.list_assumptions(
            question, objective.fidelity, plan.detector, frames=final.frames, sampled=sampled
        ),
        unknown=sentences.list_unknowns(figures.judgement.counted, plan.by_level),
        provenance=trace_plan(findings, objective.candidates, final.detected.detector),
    )
    reasons = sentences.explain_choice(
        question,
        plan,
        choice.option,
        choice.rule,
        considered=findings.entrants.considered,
        fidelity=objective.fidelity,
    )
    return replace(plan, why=reasons)


def _rank_considered(option: content.PlanOption) -> tuple[bool, float]:
    """Sort key: judged sets first, highest AP first; then the others, highest predicted AP first.

    AP is over all requested cases (`PlanOption.counted`)."""
    if option.counted:
        return False, -option.counted.ap
    return True, -option.predicted


def judge_sureness(
    confidence: float | None, judged: content.Judgement, drawn: Float64[np.ndarray, " resamples"]
) -> float | None:
    """Return the confidence that no set of as many sensors is better than the chosen one.

    No AP exceeds 1, so the share of resamples within `AP_TOLERANCE` of 1 is a lower bound, which
    may raise the confidence of the race. Without a race, or with a judgement too small for an
    interval, the confidence comes back unchanged, but as None if AP is within `AP_TOLERANCE` of 1:
    no set could be better, but there are too few frames for an interval that would show it.

    Args:
        confidence: Confidence from the race of this size, None without one.
        judged: The set over all requested cases, on the final traffic.
        drawn: AP of the same judgement in each resample."""
    if confidence is None or not judged.known:
        return None if judged.ap > 1 - AP_TOLERANCE else confidence
    return max(confidence, share_beyond_reach(drawn))
