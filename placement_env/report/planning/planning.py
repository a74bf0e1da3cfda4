"""`plan`: from a question to a plan, in stages that are all kept in the cache, so that a plan that was killed goes on.

Three parts of traffic, each with a seed of its own: searches see the first, the detector compares the entrants on the
second, and what the plan states of the chosen set is from the third.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.candidates.pool import NoCandidates
from placement_env.cases import USUAL_CASES, Cases
from placement_env.fidelity.preparation import Preparation, check_scorable
from placement_env.handover.ground import visible_ground
from placement_env.handover.mounted import mounted_site
from placement_env.objective import Objective
from placement_env.protocol import FidelityName
from placement_env.report.content import Plan, Planned, Verdict
from placement_env.report.planning import refusals
from placement_env.report.planning.answer import PlanInputs, answer
from placement_env.report.planning.judging import Judge
from placement_env.report.planning.moments import moments
from placement_env.report.planning.question import Question
from placement_env.report.planning.selection import select
from placement_env.search.description import describe_exclusions
from placement_env.search.portfolio.entrants import Effort, keep_entrants
from placement_env.setting import Setting
from toolkit.objects import LABELS
from toolkit.runtime.run import Run, Stages

MOST_BOUGHT = 12  # that a sum of money alone may buy


def plan(
    question: Question,
    *,
    cache: str | Path | None = Path("out/cache"),
    workers: int = 1,
    progress: Stages | None = None,
) -> Planned:
    """The plan that answers a question; where nothing may be built or nothing reaches the requirement, it says why.

    cache: folder where what was seen, rendered and detected is kept, None for nowhere; workers: processes; progress:
    called with a stage, how many are done and of how many. The same question has the same plan, byte for byte.
    Raises ValueError and OSError for damaged inputs, ImportError without SUMO.
    """
    reasons = refusals.without_traffic(question)
    if reasons:
        return _none(question, reasons)
    try:
        pool = question.pool
    except NoCandidates as error:
        return _none(question, (f"There is no candidate: {error}.",))
    return _Planning(question, pool, cache, workers, progress).run()


def _none(question: Question, reasons: tuple[str, ...], candidates: Candidates | None = None) -> Planned:
    """The plan where nothing may be built."""
    verdict = Verdict(False, "No set of sensors can be planned.", reasons)
    empty = Plan(
        question.in_words, question.site.name, "", question.iou, question.scheme, question.currency, verdict, None
    )
    return Planned(empty, replace(question.site, sensors=()), candidates)


@dataclass(frozen=True, eq=False)
class _Planning:
    """The stages of one plan."""

    question: Question
    pool: Candidates
    cache: str | Path | None
    workers: int
    progress: Stages | None

    def run(self) -> Planned:
        """All stages."""

        question = self.question
        fidelity = self._search_fidelity()
        searched = self._preparation(self.pool, 0)
        check_scorable(searched.setting, "detector")
        visibility = searched.visibility
        missing = [LABELS[label] for label in question.classes.labels if not (visibility.labels == label).any()]
        if missing:
            reasons = refusals.without_objects(question, missing, question.search_frames, "simulated")
            return _none(question, reasons, self.pool)
        everything = self._objective(searched, fidelity)
        excluded = describe_exclusions(everything, question.max_kbit, question.currency)
        kept = np.flatnonzero(refusals.buildable(everything, question.max_kbit))
        if not len(kept):
            return _none(question, excluded, self.pool)
        candidates = self.pool.select(kept)
        objective = self._objective(searched.at(candidates, visibility.select(kept)), fidelity)
        found = keep_entrants(
            objective,
            Effort(tuple(range(1, self._most_sensors(candidates) + 1))),
            searched.run.memo,
            depends_on=searched.traffic.digest(),
            seed=question.seed,
        )
        judging = [self._preparation(candidates, part, question.cases) for part in (1, 2)]
        judge, final = map(self._judge, judging)
        for each in (judge, final):
            if each.absent:
                reasons = refusals.without_objects(question, each.absent, each.frames, "judging")
                return _none(question, reasons, self.pool)
        picked = select(
            objective, found, judge, min_ap=question.min_ap, confidence=question.confidence, seed=question.seed,
            progress=self.progress,
        )  # fmt: skip
        traffic = [prepared.traffic for prepared in (searched, *judging)]
        terms = PlanInputs(question, found, picked, fidelity, searched.network, excluded)
        members = tuple(np.flatnonzero(picked.sets[picked.chosen]).tolist())
        ground = visible_ground(question.site, [candidates.sensors[c] for c in members])
        answered = answer(terms, objective, final, ground, traffic, self.progress)
        frames = moments(final.detected, members, seed=question.seed)
        return Planned(answered, mounted_site(question.site, candidates, members), candidates, ground, frames)

    def _preparation(self, candidates: Candidates, part: int, cases: Cases | None = None) -> Preparation:
        """Preparation of one of the three parts of the traffic; without cases, those of the search."""
        question = self.question
        frames = (question.search_frames, question.judge_frames, question.final_frames)[part]
        setting = Setting(
            question.site,
            candidates=candidates,
            scheme=question.scheme,
            codec=question.codec,
            classes=question.classes,
            cases=replace(question.cases, errors=USUAL_CASES.errors) if cases is None else cases,
            detector=question.detector,
            most_price=question.most_price,
        )
        cache = None if self.cache is None else Path(self.cache)
        seed = question.seed + part
        run = Run(seed=seed, frames=frames, cache=cache, workers=self.workers, progress=self.progress)
        return Preparation(setting, run)

    def _judge(self, prepared: Preparation) -> Judge:
        cases = self.question.cases
        judges = []
        for errors in cases.profiles:
            detected = prepared.detected(errors).at(cases.ious[0], cases.ious)
            judges.append(Judge(detected, self.question.seed, cases, prepared.levels))
        first, *others = judges
        return replace(first, others=tuple(others))

    def _objective(self, prepared: Preparation, fidelity: FidelityName) -> Objective:
        setting = replace(prepared.setting, fidelity=prepared.fidelity(fidelity))
        return Objective(setting, prepared.run, visibility=prepared.visibility)

    def _search_fidelity(self) -> FidelityName:
        """The surrogate where there is one for the scheme and IoU, else coverage."""
        searched = self._preparation(self.pool, 0)
        try:
            check_scorable(searched.setting, "surrogate")
        except ValueError:
            return "coverage"
        return "surrogate"

    def _most_sensors(self, candidates: Candidates) -> int:
        """How many sensors the budget allows: by number, money and mounts."""
        each = np.full(len(candidates.mounts), np.inf)
        np.minimum.at(each, candidates.mount, candidates.prices)
        second = np.full(len(candidates.mounts), np.inf)
        np.minimum.at(second, candidates.mount, candidates.model_prices)
        each = np.sort(np.concatenate([each[np.isfinite(each)], np.repeat(second, candidates.places - 1)]))
        each = each[np.isfinite(each)]
        by_money = int((np.cumsum(each) <= self.question.most_price * (1 + 1e-9)).sum())
        asked = MOST_BOUGHT if self.question.sensors is None else self.question.sensors
        return max(1, min(asked, by_money))
