"""`plan`: from a question to a plan, in stages that are all kept in the cache, so that a plan that was killed goes on.

Three parts of traffic, each with a seed of its own: searches see the first, the detector compares the finalists on the
second, and what the plan states of the chosen set is from the third.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.candidates.pool import NoCandidates
from placement_env.fidelity.detector import Detected
from placement_env.fidelity.preparation import Preparation, check_fidelity_for
from placement_env.fidelity.protocol import FidelityName
from placement_env.objective import Objective
from placement_env.report.content import Ground, Moment, Plan, PlanOption, Verdict
from placement_env.report.planning import breakdown, figures, mounting, refusals, sentences
from placement_env.report.planning.figures import Chosen
from placement_env.report.planning.finalists import Finalists, finalists
from placement_env.report.planning.judging import Judge
from placement_env.report.planning.moments import moments
from placement_env.report.planning.provenance import plan_origin
from placement_env.report.planning.question import Question
from placement_env.report.planning.selection import Selection, front, near_optimal, select
from toolkit.detection.schemes import scheme_of
from toolkit.sites.site import Site

MOST_SENSORS = 12  # that a sum of money alone may buy

Progress = Callable[[str, int, int | None], None]


@dataclass(frozen=True, eq=False)
class Planned:
    """A plan with what its pages and maps are made from. site: with the chosen sensors mounted; candidates: None where
    there are none; ground, moments: None and empty where no set may be built."""

    plan: Plan
    site: Site
    candidates: Candidates | None = None
    ground: Ground | None = None
    moments: tuple[Moment, ...] = ()


def plan(
    question: Question,
    *,
    cache: str | Path | None = Path("out/cache"),
    workers: int = 1,
    progress: Progress | None = None,
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
    progress: Progress | None

    def run(self) -> Planned:
        """All stages."""
        question = self.question
        fidelity = self._search_fidelity()
        searched = self._preparation(self.pool, 0)
        visibility = searched.look(self.progress)
        if not visibility.points.shape[1]:
            return _none(question, refusals.without_vehicles(question, question.search_frames, "simulated"), self.pool)
        everything = self._objective(searched, fidelity)
        sent, linked = everything.sent, everything.linked
        excluded = refusals.exclusions(self.pool, sent, linked, question)
        kept = np.flatnonzero(refusals.buildable(self.pool, sent, linked, question))
        if not len(kept):
            return _none(question, excluded, self.pool)
        candidates = self.pool.select(kept)
        objective = self._objective(searched.at(candidates, visibility.select(kept)), fidelity)
        found = finalists(objective, self._most_sensors(candidates), seed=question.seed, progress=self.progress)
        judge, final = self._judge(candidates, 1), self._judge(candidates, 2)
        for each in (judge, final):
            if not each.truths.sum():
                return _none(question, refusals.without_vehicles(question, each.frames, "judging"), self.pool)
        picked = select(objective, found, judge, min_ap=question.min_ap, seed=question.seed, progress=self.progress)
        return self._answer(objective, found, picked, final, (fidelity, excluded, searched.network))

    def _answer(
        self,
        objective: Objective,
        found: Finalists,
        picked: Selection,
        final: Judge,
        terms: tuple[str, tuple[str, ...], str],
    ) -> Planned:
        """All figures of the chosen set, on the final traffic."""
        question, candidates = self.question, objective.candidates
        fidelity, excluded, network = terms
        option = picked.options[picked.chosen]
        members = tuple(np.flatnonzero(picked.sets[picked.chosen]).tolist())
        chosen = Chosen(members, option.sensors)
        stage = self._stage("chosen set", final.frames)
        judged = final.judge(picked.sets[picked.chosen][None], progress=stage)[0]
        second = option.judged or judged
        answer = replace(option, judged=judged)
        missed = question.min_ap is not None and judged.ap < question.min_ap
        short = refusals.short_of(question, option, second, judged, excluded) if missed else ()
        scored = breakdown.scored_boxes(final, members)
        sensors = [candidates.sensors[c] for c in members]
        schemes = figures.by_scheme(final, chosen, self._stage("fusion schemes", final.frames))
        worth = figures.worths(final, objective, chosen, self._stage("subsets", final.frames))
        failures = figures.failure_cases(final, chosen, self._stage("failures", final.frames))
        order = figures.build_order(final, objective, chosen, self._stage("order of building", final.frames))
        mounted = replace(question.site, sensors=tuple(sensors))
        planned = mounting.planned_sensors(
            question.site, candidates, members, final.outcomes(members), model_name=self._model_name(), degrees=None
        )
        near = near_optimal(picked.options, picked.chosen)
        detector = f"the detector {type(final.detected.detector).__name__}"
        detector += f" (shipped network {network!r})" if question.detector is None else ""
        result = Plan(
            question=question.in_words,
            site=question.site.name,
            detector=detector.removeprefix("the detector "),
            iou=question.iou,
            scheme=question.scheme,
            currency=question.currency,
            verdict=sentences.verdict_of(question, answer, judged, short),
            chosen=answer,
            why=sentences.why(
                question, picked.options, option, picked.rule, considered=found.considered, near=len(near),
                schemes=schemes, failures=failures,
            ),
            sensors=planned,
            considered=_best_first(picked.options),
            near_optimal=near,
            front=front(picked.options),
            schemes=schemes,
            by_zone=breakdown.by_zone(scored, question.site, question.seed),
            by_range=breakdown.by_range(scored, sensors, question.seed),
            by_approach=breakdown.by_approach(scored, question.site, question.seed),
            by_class=breakdown.by_class(final, members, question.classes),
            worth=worth,
            failures=failures,
            links=mounting.link_loads(planned, limited=scheme_of(question.scheme).sends_points),
            materials=mounting.bill_of_materials(planned),
            order=order,
            poles_unused=mounting.unused_poles(candidates, members),
            assumptions=sentences.assumptions(
                question, search_fidelity=fidelity, detector=detector, worth_sampled=not chosen.is_small
            ),
            unknown=sentences.unknown(question, judged),
            provenance=plan_origin(
                question, self.pool, [self._preparation(self.pool, i).traffic for i in range(3)],
                final.detected.detector, network=network, search_fidelity=fidelity,
            ),
        )  # fmt: skip
        frames = moments(final.detected, members, seed=question.seed)
        return Planned(result, mounted, candidates, None, frames)

    def _preparation(self, candidates: Candidates, part: int) -> Preparation:
        """Of one of the three parts of the traffic."""
        question = self.question
        frames = (question.search_frames, question.judge_frames, question.final_frames)[part]
        return Preparation(
            site=question.site,
            candidates=candidates,
            frames=frames,
            scheme=scheme_of(question.scheme),
            iou=question.iou,
            seed=question.seed + part,
            cache=self.cache,
            workers=self.workers,
            detector=question.detector,
        )

    def _judge(self, candidates: Candidates, part: int) -> Judge:
        detected = self._preparation(candidates, part).fidelity("detector")
        if not isinstance(detected, Detected):
            raise TypeError("fidelity detector must be Detected")
        return Judge(detected, self.question.seed)

    def _objective(self, prepared: Preparation, fidelity: FidelityName) -> Objective:
        return Objective.of(
            prepared.candidates,
            prepared.fidelity(fidelity),
            prepared.scheme,
            site=self.question.site,
            visibility=prepared.visibility,
            codec=prepared.codec,
            most_price=self.question.most_price,
        )

    def _search_fidelity(self) -> FidelityName:
        """The surrogate where there is one for the scheme and IoU, else coverage."""
        question = self.question
        try:
            check_fidelity_for(question.site, self.pool, question.scheme, "surrogate", iou=question.iou)
        except ValueError:
            return "coverage"
        return "surrogate"

    def _most_sensors(self, candidates: Candidates) -> int:
        """How many sensors the budget allows: by number, money and mounts."""
        each = np.full(len(candidates.mounts), np.inf)
        np.minimum.at(each, candidates.mount, candidates.prices)
        each = np.sort(each[np.isfinite(each)])
        by_money = int((np.cumsum(each) <= self.question.most_price * (1 + 1e-9)).sum())
        asked = MOST_SENSORS if self.question.sensors is None else self.question.sensors
        return max(1, min(asked, by_money))

    def _model_name(self) -> Callable[..., str]:
        catalogue = self.question.catalogue
        return mounting.in_words if catalogue is None else catalogue.name_of

    def _stage(self, name: str, total: int) -> Callable[[int], None] | None:
        progress = self.progress
        return None if progress is None else lambda done: progress(name, done, total)


def _best_first(options: tuple[PlanOption, ...]) -> tuple[PlanOption, ...]:
    """Judged sets by AP, then the others by what is predicted."""
    return tuple(
        sorted(options, key=lambda each: (each.judged is None, -(each.judged.ap if each.judged else each.predicted)))
    )
