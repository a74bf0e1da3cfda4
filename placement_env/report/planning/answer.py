"""All figures of the chosen set, as a `Plan`. They are by the detector on the final traffic."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from itertools import combinations

import numpy as np

from placement_env.analysis.intervals import BLOCK_FRAMES, RESAMPLES
from placement_env.analysis.worth import estimate_worth, exact_worth
from placement_env.candidates.candidates import Candidates
from placement_env.fidelity.detector import IOUS, Detected
from placement_env.fidelity.traffic import Traffic
from placement_env.handover.ground import Ground, ground_shares
from placement_env.handover.mounted import bill_of_materials, link_loads, mounted_sensors, unused_mounts
from placement_env.objective import Objective
from placement_env.report.content import BuildStep, FailureCase, Plan, PlanOption, SchemeFigures, SensorWorth
from placement_env.report.planning import breakdown, sentences
from placement_env.report.planning.choosing import Choice, find_front_options, near_optimal
from placement_env.report.planning.judging import Judge, Report
from placement_env.report.planning.question import PART_FRAMES, Question
from placement_env.search.portfolio.entrants import Entrants
from placement_env.subsets import all_subsets
from toolkit.arrays import Bool
from toolkit.detection.provenance import coview_version, detector_origin
from toolkit.detection.schemes import PAPER_SCHEMES, find_scheme
from toolkit.objects import Detector
from toolkit.sites.files import format_site

ALL_SUBSETS = 6  # sensors up to which every subset is judged by the detector
PACKAGES = ("numpy", "torch", "open3d-cpu", "open3d", "eclipse-sumo", "libsumo", "ortools", "shapely")


@dataclass(frozen=True, eq=False)
class Findings:
    """Everything that led to the chosen set.

    found, choice: entrants and the answer among them; objective: of the searches; network: shipped one that detects if
    the question has no detector; excluded: sentences on what excludes candidates; traffic: of searches, comparison and
    judgement.
    """

    question: Question
    found: Entrants
    choice: Choice
    objective: Objective
    network: str
    excluded: tuple[str, ...]
    traffic: Sequence[Traffic]

    @property
    def fidelity(self) -> str:
        """Fidelity of the searches."""
        return self.objective.fidelity


def build_plan(findings: Findings, final: Judge, ground: Ground) -> Plan:
    """Put the plan together. final: the detector on the final traffic; ground: that the chosen sensors see."""
    question, choice = findings.question, findings.choice
    candidates, site, seed = findings.objective.candidates, question.site, question.run.seed
    members = choice.members
    chosen = ChosenSet(members, choice.option.sensors, final, findings.objective, question)
    row = choice.sets[choice.chosen][None]
    (judged,) = final.judge_cases(row, chosen.report)
    outcomes = final.outcomes(members)
    kbit = float(np.mean([outcome.bits.sum() for outcome in outcomes])) / 1000
    option = replace(choice.option, **judged._asdict(), kbit=kbit, kbit_per_sensor=kbit / len(members))
    counted = option.counted or judged.judged
    scored = breakdown.score_boxes(final, members)
    near = near_optimal(choice.options, choice.chosen)
    sensors = mounted_sensors(site, candidates, members, [each.bits for each in outcomes], question.stock.catalogue)
    detector = name_detector(final.detected.detector, findings.network if question.setting.detector is None else None)
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
        considered=best_first(choice.options),
        near_optimal=near,
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
        assumptions=sentences.list_assumptions(question, findings.fidelity, detector, sampled=not chosen.small),
        unknown=sentences.list_unknowns(counted),
        provenance=trace_plan(findings, candidates, final.detected.detector),
    )
    why = sentences.explain_choice(
        question, plan, choice.option, choice.rule, considered=findings.found.considered, fidelity=findings.fidelity
    )
    return replace(plan, why=why)


def best_first(options: Sequence[PlanOption]) -> tuple[PlanOption, ...]:
    """Sort judged sets by AP, then others by predicted AP."""
    return tuple(
        sorted(options, key=lambda each: (each.counted is None, -(each.counted.ap if each.counted else each.predicted)))
    )


def name_detector(detector: Detector, network: str | None) -> str:
    """Name the kind of detector. The name of a shipped network is added."""
    kind: str = detector_origin(detector)["detector"]
    return kind if network is None else f"{kind} (shipped network {network!r})"


@dataclass(frozen=True, eq=False)
class ChosenSet:
    """Figures of the chosen set.

    They are schemes, worth of each sensor, failures, and order of building.

    members: indices of its candidates, ascending; names: of these; judge: on the final traffic; objective: of the
    searches, which scores subsets of large sets.
    """

    members: tuple[int, ...]
    names: tuple[str, ...]
    judge: Judge
    objective: Objective
    question: Question | None = None

    @property
    def small(self) -> bool:
        """True if every subset is judged by the detector."""
        return len(self.members) <= ALL_SUBSETS

    def report(self, stage: str) -> Report | None:
        """Callback that counts the frames of a stage."""
        return None if self.question is None else self.question.run.stage(stage, self.judge.frames)

    def rows(self, subsets: Bool[np.ndarray, "n k"]) -> Bool[np.ndarray, "n C"]:
        """Expand subsets of the set to rows over all candidates."""
        rows = np.zeros((len(subsets), len(self.judge.detected.renders.sensors)), np.bool_)
        rows[:, list(self.members)] = subsets
        return rows

    def schemes(self) -> tuple[SchemeFigures, ...]:
        """The set under every scheme at every IoU. Detections are reused."""
        detected, judge, rows = self.judge.detected, self.judge, []
        whole = self.rows(np.ones((1, len(self.members)), np.bool_))
        ious = judge.cases.ious
        for name in PAPER_SCHEMES:
            other = Detected(
                detected.renders,
                detected.detector,
                find_scheme(name),
                codec=detected.codec,
                iou=ious[0],
                memo=detected.memo,
                processes=detected.processes,
                classes=detected.classes,
            ).at(ious[0], detected.ious)
            at = replace(judge, profiles=(other,), cases=replace(judge.cases, errors=judge.cases.profiles[0]))
            (own,) = at.judge(whole, progress=self.report("fusion schemes"))
            kbit = float(np.mean([outcome.bits.mean() for outcome in at.outcomes(self.members)])) / 1000
            for iou in sorted({*IOUS, *ious[:1]} if len(ious) == 1 else IOUS):
                judged = own if ious == (iou,) else at.judge(whole, iou=iou)[0]
                rows.append(SchemeFigures(name, iou, judged, kbit))
            if len(ious) > 1:
                rows.append(SchemeFigures(name, judge.cases.threshold, own, kbit))
        return tuple(rows)

    def worth(self) -> tuple[SensorWorth, ...]:
        """Shapley values and interactions.

        They are exact by the detector for small sets, else sampled by the objective.
        """
        count = len(self.members)
        if self.small:
            judged = self.judge.judge(self.rows(all_subsets(count)), progress=self.report("subsets"))
            aps = np.array([each.ap for each in judged])
            worth = exact_worth(lambda _: aps, count)
        else:
            worth = estimate_worth(lambda sets: self.objective.scores(self.rows(sets)).ap, count, rounds=64)
        return tuple(
            SensorWorth(
                name,
                float(worth.shapley[i]),
                {other: float(worth.synergy[i, j]) for j, other in enumerate(self.names) if j != i},
            )
            for i, name in enumerate(self.names)
        )

    def failures(self) -> tuple[FailureCase, ...]:
        """Judge the remaining sensors after one or two failures.

        The list may be empty; the worst comes first for each number.
        """
        count = len(self.members)
        cases: list[FailureCase] = []
        for failing in (1, 2):
            lost = list(combinations(range(count), failing)) if failing < count else []
            left = np.array([~np.isin(np.arange(count), each) for each in lost], np.bool_).reshape(len(lost), count)
            judged = self.judge.judge(self.rows(left), progress=self.report("failures"))
            found = [FailureCase(tuple(self.names[i] for i in each), ap) for each, ap in zip(lost, judged, strict=True)]
            cases += sorted(found, key=lambda case: case.judged.ap)
        return tuple(cases)

    def order(self) -> tuple[BuildStep, ...]:
        """Order of building, each sensor adding most AP.

        The steps are judged by the detector. For small sets the detector chooses, for larger ones the objective.
        """
        built, order, prefixes = np.zeros(len(self.members), np.bool_), [], []
        while not built.all():
            options = np.flatnonzero(~built)
            rows = np.repeat(built[None], len(options), axis=0)
            rows[np.arange(len(options)), options] = True
            best = int(np.argmax(self._aps(rows)))
            built = rows[best]
            order.append(int(options[best]))
            prefixes.append(built)
        sets = self.rows(np.array(prefixes))
        judged = self.judge.judge(sets, progress=self.report("order of building"))
        steps = zip(order, self.objective.price(sets).tolist(), judged, strict=True)
        return tuple(BuildStep(self.names[i], price, ap) for i, price, ap in steps)

    def _aps(self, subsets: Bool[np.ndarray, "n k"]) -> Sequence[float]:
        rows = self.rows(subsets)
        if not self.small:
            return self.objective.scores(rows).ap.tolist()
        return [each.ap for each in self.judge.judge(rows, progress=self.report("order of building"))]


def trace_plan(findings: Findings, candidates: Candidates, detector: Detector) -> dict[str, object]:
    """Provenance of a plan. It has digests of all inputs, seeds and versions; nothing depends on the clock."""
    question = findings.question
    setting, stock, seed = question.setting, question.stock, question.run.seed
    return {
        "site": question.site.name,
        "site_sha256": sha256(format_site(question.site).encode()).hexdigest(),
        "poles_sha256": stock.poles_digest,
        "catalogue_sha256": None if stock.catalogue is None else stock.catalogue.digest,
        "keep_out_sha256": sha256(repr([area.wkt for area in stock.keep_out]).encode()).hexdigest(),
        "candidates": candidates.digest(),
        **detector_origin(detector),
        "network": findings.network,
        "search_fidelity": findings.fidelity,
        "classes": setting.counted.origin,
        "codec": setting.codec.digest,
        "errors": question.cases.errors_origin,
        "traffic": {
            name: {"seed": seed + i, "frames": len(each), "sha256": each.digest()}
            for i, (name, each) in enumerate(zip(PART_FRAMES, findings.traffic, strict=True))
        },
        "bootstrap": {"draws": RESAMPLES, "block_frames": BLOCK_FRAMES, "seed": seed},
        "versions": {"coview": coview_version(), "python": platform.python_version(), **_package_versions()},
    }


def _package_versions() -> dict[str, str]:
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
