"""`plan`: from a question to a plan. The cache keeps its stages, so an interrupted plan resumes.

There are three parts of traffic, each with its own seed: searches see the first, the detector compares the entrants on
the second, and the plan's figures for the chosen set are from the third.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.candidates.pool import NoCandidates
from placement_env.fidelity.preparation import Preparation, check_scorable
from placement_env.handover.exchange import EXCHANGE_FILES, write_exchange
from placement_env.handover.ground import visible_ground
from placement_env.handover.mounted import mounted_site
from placement_env.objective import Objective
from placement_env.report.content import Plan, Planned, Verdict
from placement_env.report.pages.report import REPORT_FILES, write_report
from placement_env.report.planning import sentences
from placement_env.report.planning.answer import Findings, build_plan, pick_moments
from placement_env.report.planning.judging import Judge, choose_set
from placement_env.report.planning.question import Question
from placement_env.search.order import describe_exclusions
from placement_env.search.portfolio.entrants import Effort, keep_entrants
from placement_env.setting import AP_ONLY
from toolkit.objects import LABELS
from toolkit.runtime.files import replace_infinite, write_text, writing_together

MOST_BOUGHT = 12  # sensors that a sum of money alone may buy
CONTENT = "plan.json"
PLAN_FILES = (*REPORT_FILES, *EXCHANGE_FILES, CONTENT)


def plan(question: Question) -> Planned:
    """Answer a question with a plan. If nothing may be built or nothing reaches the requirement, it says why.

    The same question has the same plan, byte for byte, whatever the cache and the processes. Raises ValueError and
    OSError for damaged inputs, ImportError without SUMO.
    """
    if reasons := sentences.refuse_question(question):
        return _refuse(question, reasons)
    try:
        pool = question.setting.pool
    except NoCandidates as error:
        return _refuse(question, (f"There is no candidate: {error}.",))
    check_scorable(question.judged(pool), "detector")
    first = question.part("search")
    prepared = Preparation(question.searched, first)
    seen, traffic = prepared.visibility, prepared.traffic
    missing = [LABELS[label] for label in question.setting.counted.labels if not (seen.labels == label).any()]
    if missing:
        return _refuse(question, sentences.refuse_traffic(question, missing, prepared.frames, "simulated"), pool)
    everything = Objective.of_moved(prepared, pool, seen, AP_ONLY)
    excluded = describe_exclusions(everything, question.max_kbit, question.currency)
    most_kbit = np.inf if question.max_kbit is None else question.max_kbit
    kept = np.flatnonzero(everything.allowed([]) & (everything.sent <= most_kbit))
    if not len(kept):
        return _refuse(question, excluded, pool)
    candidates = pool.select(kept)
    objective = Objective.of_moved(prepared, candidates, seen.select(kept), AP_ONLY)
    sizes = tuple(range(1, _most_sensors(question, candidates) + 1))
    found = keep_entrants(objective, Effort(sizes), first.memo, depends_on=traffic.digest(), seed=first.seed)
    judging = [Preparation(question.judged(candidates), question.part(name)) for name in ("comparison", "judgement")]
    judge, final = (Judge.of(each, question.run.seed) for each in judging)
    for each in (judge, final):
        if each.absent:
            return _refuse(question, sentences.refuse_traffic(question, each.absent, each.frames, "judging"), pool)
    choice = choose_set(
        objective, found, judge, min_ap=question.min_ap, confidence=question.confidence, run=question.run
    )
    parts = [traffic, *(each.traffic for each in judging)]
    findings = Findings(question, found, choice, objective, prepared.network, excluded, parts)
    ground = visible_ground(question.site, [candidates.sensors[c] for c in choice.members])
    answer = build_plan(findings, final, ground)
    moments = pick_moments(final.detected, choice.members, seed=question.run.seed)
    return Planned(answer, mounted_site(question.site, candidates, choice.members), candidates, ground, moments)


def _refuse(question: Question, reasons: tuple[str, ...], candidates: Candidates | None = None) -> Planned:
    """Plan where nothing may be built."""
    verdict = Verdict(False, "No set of sensors can be planned.", reasons)
    names = question.site.name, "", question.cases.threshold, question.setting.fusion.name, question.currency
    return Planned(
        Plan(question.as_dict(), *names, verdict, chosen=None), replace(question.site, sensors=()), candidates
    )


def _most_sensors(question: Question, candidates: Candidates) -> int:
    """Most sensors that the budget allows. Number, money and mounts limit it."""
    each = np.full(len(candidates.mounts), np.inf)
    np.minimum.at(each, candidates.mount, candidates.prices)
    second = np.full(len(candidates.mounts), np.inf)
    np.minimum.at(second, candidates.mount, candidates.model_prices)
    each = np.sort(np.concatenate([each[np.isfinite(each)], np.repeat(second, candidates.places - 1)]))
    each = each[np.isfinite(each)]
    by_money = int((np.cumsum(each) <= question.setting.most_price * (1 + 1e-9)).sum())
    asked = MOST_BOUGHT if question.sensors is None else question.sensors
    return max(1, min(asked, by_money))


def write_plan(planned: Planned, out: Path) -> list[Path]:
    """Write a plan's files into a folder, made if missing, all or none; return their paths.

    Files of `PLAN_FILES` that an earlier plan left there and this one lacks are removed. Raises ImportError without
    the packages of `coview[report]`, OSError if the folder cannot be written.
    """
    plan = planned.plan
    with writing_together(out) as folder:
        write_text(folder / CONTENT, format_json(plan))
        write_report(planned, folder)
        if planned.ground is not None and planned.candidates is not None:
            unused = [mount for mount in planned.candidates.mounts if mount.name in plan.poles_unused]
            write_exchange(folder, planned.site, plan.sensors, planned.ground, unused=unused, currency=plan.currency)
        names = sorted(path.name for path in folder.iterdir())
    for name in set(PLAN_FILES).difference(names):
        (out / name).unlink(missing_ok=True)
    return [out / name for name in names]


def format_json(plan: Plan) -> str:
    """Format a plan as JSON. The same plan gives the same text; non-finite numbers become null."""
    return json.dumps(replace_infinite(plan.as_dict()), indent=1, allow_nan=False, ensure_ascii=False) + "\n"
