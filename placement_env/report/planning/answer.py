"""Answer: all figures of the chosen set, by the detector on the final traffic, put together as a `Plan`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from placement_env.fidelity.traffic import Traffic
from placement_env.handover.ground import Ground, ground_shares
from placement_env.handover.mounted import bill_of_materials, link_loads, mounted_sensors, unused_mounts
from placement_env.objective import Objective
from placement_env.report.content import Plan, PlanOption
from placement_env.report.planning import breakdown, figures, refusals, sentences
from placement_env.report.planning.figures import ChosenSet
from placement_env.report.planning.judging import Judge
from placement_env.report.planning.provenance import plan_origin
from placement_env.report.planning.question import Question
from placement_env.report.planning.selection import Selection, judged_front, near_optimal
from placement_env.search.portfolio.entrants import Entrants
from toolkit.detection.provenance import detector_origin
from toolkit.detection.schemes import find_scheme
from toolkit.objects import LABELS
from toolkit.runtime.run import Stages


@dataclass(frozen=True, eq=False)
class PlanInputs:
    """How the chosen set was come by. fidelity: of the searches; network: shipped one that detects where the question
    has no detector of its own; excluded: sentences on what excludes candidates."""

    question: Question
    found: Entrants
    picked: Selection
    fidelity: str
    network: str
    excluded: tuple[str, ...]


def answer(
    terms: PlanInputs,
    objective: Objective,
    final: Judge,
    ground: Ground,
    traffic: Sequence[Traffic],
    progress: Stages | None = None,
) -> Plan:
    """The plan. objective: of the searches; final: the detector on the final traffic; ground: that the chosen sensors
    see; traffic: of searches, comparison and judgement."""
    question, picked, candidates = terms.question, terms.picked, objective.candidates
    option = picked.options[picked.chosen]
    members = tuple(np.flatnonzero(picked.sets[picked.chosen]).tolist())
    chosen = ChosenSet(members, option.sensors)

    def stage(name: str) -> Callable[[int], None] | None:
        return None if progress is None else lambda done: progress(name, done, final.frames)

    (judged,) = final.judge(picked.sets[picked.chosen][None], progress=stage("chosen set"))
    outcomes = final.outcomes(members)
    kbit = float(np.mean([outcome.bits.sum() for outcome in outcomes])) / 1000
    left = next(iter(final.left(picked.sets[picked.chosen][None], progress=stage("failures")) or ()), None)
    over_levels = next(iter(final.over_levels(picked.sets[picked.chosen][None]) or ()), None)
    over_errors = next(iter(final.over_errors(picked.sets[picked.chosen][None], progress=stage("errors")) or ()), None)
    final_option = replace(
        option, judged=judged, left=left, over_levels=over_levels, over_errors=over_errors, kbit=kbit,
        kbit_per_sensor=kbit / len(members),
    )  # fmt: skip
    short: tuple[str, ...] = ()
    counted = final_option.counted or judged
    if question.min_ap is not None and counted.ap < question.min_ap:
        short = refusals.short_of(question, option, counted, terms.excluded)
    scored = breakdown.scored_boxes(final, members)
    schemes = figures.by_scheme(final, chosen, stage("fusion schemes"))
    worth = figures.worths(final, objective, chosen, stage("subsets"))
    failures = figures.failure_cases(final, chosen, stage("failures"))
    near = near_optimal(picked.options, picked.chosen)
    planned = mounted_sensors(question.site, candidates, members, [each.bits for each in outcomes], question.catalogue)
    detector = detector_in_words(final, terms.network if question.detector is None else None)
    return Plan(
        question=question.in_words,
        site=question.site.name,
        detector=detector,
        iou=question.iou,
        scheme=question.scheme,
        currency=question.currency,
        verdict=sentences.verdict_of(question, final_option, counted, short),
        chosen=final_option,
        why=sentences.why(
            question, picked.options, option, picked.rule, considered=terms.found.considered,
            fidelity=terms.fidelity, near=len(near), schemes=schemes, failures=failures,
        ),
        sensors=planned,
        considered=best_first(picked.options),
        near_optimal=near,
        front=judged_front(picked.options),
        schemes=schemes,
        by_zone=breakdown.by_zone(scored, question.site, question.seed),
        by_range=breakdown.by_range(scored, [candidates.sensors[c] for c in members], question.seed),
        by_approach=breakdown.by_approach(scored, question.site, question.seed),
        by_level=breakdown.by_level(scored, final, members),
        by_errors=breakdown.by_errors(final, members),
        by_class=breakdown.by_class(final, members, LABELS),
        class_ap=final.by_class(members),
        worth=worth,
        failures=failures,
        links=link_loads(planned, limited=find_scheme(question.scheme).sends_points),
        materials=bill_of_materials(planned),
        order=figures.build_order(final, objective, chosen, stage("order of building")),
        ground=ground_shares(ground, [sensor.name for sensor in planned]),
        poles_unused=tuple(mount.name for mount in unused_mounts(candidates, members)),
        assumptions=sentences.assumptions(
            question, search_fidelity=terms.fidelity, detector=detector, worth_sampled=not chosen.is_small,
        ),
        unknown=sentences.unknown(counted),
        provenance=plan_origin(
            question, candidates, traffic, final.detected.detector,
            network=terms.network, search_fidelity=terms.fidelity,
        ),
    )  # fmt: skip


def best_first(options: Sequence[PlanOption]) -> tuple[PlanOption, ...]:
    """Judged sets by AP, then the others by what is predicted."""
    return tuple(
        sorted(options, key=lambda each: (each.counted is None, -(each.counted.ap if each.counted else each.predicted)))
    )


def detector_in_words(judge: Judge, network: str | None) -> str:
    """Its kind, and which of the shipped networks it is."""
    kind: str = detector_origin(judge.detected.detector)["detector"]
    return kind if network is None else f"{kind} (shipped network {network!r})"
