"""All figures of the chosen set, as a `Plan`. They are by the detector on the final traffic."""

from __future__ import annotations

import platform
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from placement_env.analysis.intervals import BLOCK_FRAMES, RESAMPLES
from placement_env.analysis.worth import estimate_worth, exact_worth
from placement_env.candidates.candidates import Candidates
from placement_env.cases import Cases
from placement_env.fidelity.detector import IOUS, Detected
from placement_env.fidelity.traffic import Traffic
from placement_env.handover.ground import Ground, ground_shares
from placement_env.handover.mounted import bill_of_materials, format_sensors, link_loads, unused_mounts
from placement_env.objective import Objective
from placement_env.report.content import BuildStep, FailureCase, Judgement, Plan, SchemeFigures, SensorWorth
from placement_env.report.planning import breakdown, sentences
from placement_env.report.planning.choosing import Choice, find_front_options, near_optimal
from placement_env.report.planning.judging import Judge
from placement_env.report.planning.question import PART_FRAMES, Question
from placement_env.search.portfolio.entrants import Entrants
from placement_env.subsets import all_subsets
from toolkit.arrays import Bool, Float64
from toolkit.detection.provenance import coview_version, detector_origin
from toolkit.detection.schemes import PAPER_SCHEMES
from toolkit.objects import Detector
from toolkit.runtime.run import Run
from toolkit.sites.files import format_site

ALL_SUBSETS = 6  # sensors up to which every subset is judged by the detector
PACKAGES = ("numpy", "torch", "open3d-cpu", "open3d", "eclipse-sumo", "libsumo", "ortools", "shapely")


@dataclass(frozen=True, eq=False)
class Findings:
    """Everything that led to the chosen set.

    objective: of the searches; network: shipped one that detects if the question has no detector; excluded: sentences
    on what excludes candidates; traffic: of searches, comparison and judgement.
    """

    question: Question
    found: Entrants
    choice: Choice
    objective: Objective
    network: str
    excluded: tuple[str, ...]
    traffic: Sequence[Traffic]


def build_plan(findings: Findings, final: Judge, ground: Ground) -> Plan:
    """Put the plan together. final: the detector on the final traffic; ground: that the chosen sensors see."""
    question, choice, objective = findings.question, findings.choice, findings.objective
    candidates, site, seed = objective.candidates, question.site, question.run.seed
    members = choice.members
    chosen = ChosenSet(members, choice.option.sensors, final, objective, question.run)
    (judged,) = final.judge_cases(choice.sets[choice.chosen][None], chosen.stage)
    outcomes = final.outcomes(members)
    kbit = float(np.mean([outcome.bits.sum() for outcome in outcomes])) / 1000
    option = replace(choice.option, **judged._asdict(), kbit=kbit, kbit_per_sensor=kbit / len(members))
    scored = breakdown.score_boxes(final, members)
    each_kbit = np.array([outcome.bits for outcome in outcomes], np.float64).T / 1000
    sensors = format_sensors(site, candidates, members, kbit=each_kbit, catalogue=question.stock.catalogue)
    detector: str = detector_origin(final.detected.detector)["detector"]
    if question.setting.detector is None:
        detector = f"{detector} (shipped network {findings.network!r})"
    considered = sorted(
        choice.options, key=lambda each: (not each.counted, -(each.counted.ap if each.counted else each.predicted))
    )
    plan = Plan(
        question=question.as_dict(),
        site=site.name,
        detector=detector,
        iou=question.cases.threshold,
        scheme=question.setting.fusion.name,
        currency=question.currency,
        verdict=sentences.build_verdict(question, choice.option, option, findings.excluded),
        chosen=option,
        sensors=sensors,
        considered=tuple(considered),
        near_optimal=near_optimal(choice.options, choice.chosen),
        front=find_front_options(choice.options),
        schemes=chosen.schemes(),
        by_zone=breakdown.by_zone(scored, site, seed),
        by_range=breakdown.by_range(scored, [candidates.sensors[c] for c in members], seed),
        by_approach=breakdown.by_approach(scored, site, seed),
        by_level=breakdown.by_level(scored, final, members),
        by_errors=breakdown.by_errors(final, members),
        by_class=breakdown.by_class(final, members),
        class_ap=final.by_class(members),
        worth=chosen.worth(),
        failures=chosen.failures(),
        links=link_loads(sensors, limited=question.setting.fusion.sends_points),
        materials=bill_of_materials(sensors),
        order=chosen.order(),
        ground=ground_shares(ground, [sensor.name for sensor in sensors]),
        poles_unused=tuple(mount.name for mount in unused_mounts(candidates, members)),
        assumptions=sentences.list_assumptions(question, objective.fidelity, detector, sampled=not chosen.small),
        unknown=sentences.list_unknowns(option.counted or judged.judged),
        provenance=trace_plan(findings, candidates, final.detected.detector),
    )
    count, fidelity = findings.found.considered, objective.fidelity
    why = sentences.explain_choice(question, plan, choice.option, choice.rule, considered=count, fidelity=fidelity)
    return replace(plan, why=why)


@dataclass(frozen=True, eq=False)
class ChosenSet:
    """Schemes, worth of each sensor, failures and order of building of the chosen set.

    members: indices of its candidates, ascending; names: of these; judge: on the final traffic; objective: of the
    searches, which scores subsets of large sets.
    """

    members: tuple[int, ...]
    names: tuple[str, ...]
    judge: Judge
    objective: Objective
    run: Run = Run()

    @property
    def small(self) -> bool:
        """True if every subset is judged by the detector."""
        return len(self.members) <= ALL_SUBSETS

    def stage(self, name: str) -> Callable[[int], None] | None:
        """Callback that counts the frames of a stage."""
        return self.run.stage(name, self.judge.frames)

    def rows(self, subsets: Bool[np.ndarray, "n k"]) -> Bool[np.ndarray, "n C"]:
        """Expand subsets of the set to rows over all candidates."""
        rows = np.zeros((len(subsets), len(self.judge.detected.renders.sensors)), np.bool_)
        rows[:, list(self.members)] = subsets
        return rows

    def _judge(self, subsets: Bool[np.ndarray, "n k"], stage: str, cases: Cases | None = None) -> list[Judgement]:
        return self.judge.judge(self.rows(subsets), cases, progress=self.stage(stage))

    def _aps(self, subsets: Bool[np.ndarray, "n k"], stage: str) -> Float64[np.ndarray, " n"]:
        """AP of subsets, by the detector for small sets, else by the objective."""
        if self.small:
            return np.array([each.ap for each in self._judge(subsets, stage)])
        return self.objective.scores(self.rows(subsets)).ap

    def schemes(self) -> tuple[SchemeFigures, ...]:
        """The set under every scheme at every IoU. Detections are reused."""
        known, intact, figures = self.judge.detected, self.judge.intact, []
        whole, ious = np.ones((1, len(self.members)), np.bool_), intact.ious
        for name in PAPER_SCHEMES:
            other = Detected(
                known.renders,
                known.detector,
                name,
                codec=known.codec,
                memo=known.memo,
                processes=known.processes,
                classes=known.classes,
            ).at(ious[0], ious)
            at = replace(self, judge=replace(self.judge, profiles=(other,)))
            kbit = float(np.mean([outcome.bits.mean() for outcome in at.judge.outcomes(self.members)])) / 1000
            for iou in sorted({*IOUS, *ious}) if len(ious) == 1 else (*IOUS, ious):
                (judged,) = at._judge(whole, "fusion schemes", replace(intact, iou=iou))
                figures.append(SchemeFigures(name, iou, judged, kbit))
        return tuple(figures)

    def worth(self) -> tuple[SensorWorth, ...]:
        """Shapley values and interactions. They are exact by the detector for small sets, else sampled."""
        count = len(self.members)
        if self.small:
            aps = self._aps(all_subsets(count), "subsets")
            worth = exact_worth(lambda _: aps, count)
        else:
            worth = estimate_worth(lambda sets: self._aps(sets, ""), count, rounds=64)
        return tuple(
            SensorWorth(
                name,
                float(shapley),
                {other: float(s) for other, s in zip(self.names, pairs, strict=True) if other != name},
            )
            for name, shapley, pairs in zip(self.names, worth.shapley, worth.synergy, strict=True)
        )

    def failures(self) -> tuple[FailureCase, ...]:
        """Judge the remaining sensors after one or two failures, the worst first for each number."""
        count, names = len(self.members), np.array(self.names)
        cases: list[FailureCase] = []
        for failing in range(1, min(3, count)):
            left = Cases(failing=failing).expand(np.ones((1, count), np.bool_))[0][1:]
            judged = zip(left, self._judge(left, "failures"), strict=True)
            found = [FailureCase(tuple(names[~row].tolist()), each) for row, each in judged]
            cases += sorted(found, key=lambda case: case.judged.ap)
        return tuple(cases)

    def order(self) -> tuple[BuildStep, ...]:
        """Order of building, each sensor adding most AP. All steps are judged by the detector."""
        built = np.zeros((1, len(self.members)), np.bool_)
        while not built[-1].all():
            options = built[-1] | np.eye(len(self.members), dtype=np.bool_)[~built[-1]]
            best = int(np.argmax(self._aps(options, "order of building")))
            built = np.concatenate([built, options[best : best + 1]])
        added = np.diff(built, axis=0).argmax(axis=1)
        prices = self.objective.price(self.rows(built[1:])).tolist()
        judged = self._judge(built[1:], "order of building")
        steps = zip(added.tolist(), prices, judged, strict=True)
        return tuple(BuildStep(self.names[i], price, each) for i, price, each in steps)


def trace_plan(findings: Findings, candidates: Candidates, detector: Detector) -> dict[str, object]:
    """Provenance of a plan. It has digests of all inputs, seeds and versions; nothing depends on the clock."""
    question = findings.question
    setting, stock, seed = question.setting, question.stock, question.run.seed
    versions = {"coview": coview_version(), "python": platform.python_version()}
    for name in PACKAGES:
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    return {
        "site": question.site.name,
        "site_sha256": sha256(format_site(question.site).encode()).hexdigest(),
        "poles_sha256": stock.poles_digest,
        "catalogue_sha256": None if stock.catalogue is None else stock.catalogue.digest,
        "keep_out_sha256": sha256(repr([area.wkt for area in stock.keep_out]).encode()).hexdigest(),
        "candidates": candidates.digest(),
        **detector_origin(detector),
        "network": findings.network,
        "search_fidelity": findings.objective.fidelity,
        "classes": setting.counted.origin,
        "codec": setting.codec.digest,
        "errors": question.cases.errors_origin,
        "traffic": {
            name: {"seed": seed + i, "frames": len(each), "sha256": each.digest()}
            for i, (name, each) in enumerate(zip(PART_FRAMES, findings.traffic, strict=True))
        },
        "bootstrap": {"draws": RESAMPLES, "block_frames": BLOCK_FRAMES, "seed": seed},
        "versions": versions,
    }
