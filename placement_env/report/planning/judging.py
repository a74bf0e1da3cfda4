"""Judging sensor sets by the detector.

The traffic is new to all searches. Results have intervals and the number of vehicles.

Figures are reduced over the cases as `placement_env.cases` says; in every resample of the bootstrap the worst case is
that of the resample. Recall, precision and counts are those of the worst case, or means over cases.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from placement_env.analysis.intervals import BLOCK_FRAMES, Tally, draws_of_blocks, figure_interval
from placement_env.cases import USUAL_CASES, Cases
from placement_env.classes import Classes, Combine
from placement_env.fidelity.detector import Detected, Outcome
from placement_env.fidelity.preparation import Preparation
from placement_env.report.content import CONFIDENCE, ClassAP, Judgement
from placement_env.search.portfolio.evaluators import CasesEvaluator, DetectorEvaluator
from toolkit.arrays import Bool, Float64, Int64
from toolkit.objects import HEAVY, LABELS

NOUNS = {name: "heavy vehicle" if name == LABELS[HEAVY] else name for name in LABELS}

Report = Callable[[int], None]


class Drawn(NamedTuple):
    """A judgement without interval, and the AP in each resample."""

    judged: Judgement
    draws: Float64[np.ndarray, " resamples"]

    @property
    def finished(self) -> Judgement:
        """The judgement with the interval of its resamples."""
        low, high = figure_interval(self.judged.ap, self.draws, confidence=CONFIDENCE)
        return replace(self.judged, low=low, high=high)


class SetJudgement(NamedTuple):
    """Judgement of a set, intact and in requested cases. Other cases are None; fields as of `PlanOption`."""

    judged: Judgement
    left: Judgement | None = None
    over_levels: Judgement | None = None
    over_errors: Judgement | None = None


@dataclass(frozen=True, eq=False)
class Judge:
    """The detector on one part of the traffic.

    profiles: at each error profile of the cases, matched at all their IoU thresholds; seed: of the bootstrap; levels:
    frames of each level of traffic, none if traffic is undivided. Figures are at the first profile unless stated.
    """

    profiles: tuple[Detected, ...]
    cases: Cases = USUAL_CASES
    seed: int = 0
    levels: tuple[Int64[np.ndarray, " _"], ...] = ()

    @classmethod
    def of(cls, prepared: Preparation, seed: int) -> Judge:
        """Judge on the traffic of a preparation."""
        cases = prepared.setting.cases
        profiles = [prepared.detected(errors).at(cases.ious[0], cases.ious) for errors in cases.profiles]
        return cls(tuple(profiles), cases, seed, prepared.levels)

    @property
    def detected(self) -> Detected:
        """The detector at the first error profile."""
        return self.profiles[0]

    @property
    def classes(self) -> Classes:
        """Classes that count."""
        return self.detected.classes

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.detected.frames

    @cached_property
    def to_find(self) -> dict[int, Int64[np.ndarray, " frames"]]:
        """Number of objects to find, per frame and class."""
        every = range(self.frames)
        return {
            label: np.array([self.detected.to_find(k, label).sum() for k in every], np.int64)
            for label in self.classes.labels
        }

    @property
    def absent(self) -> tuple[str, ...]:
        """Classes that count but have no object to find."""
        return tuple(LABELS[label] for label, counts in self.to_find.items() if not counts.any())

    def evaluator(self) -> CasesEvaluator:
        """Evaluator for races of sets, over the same cases."""
        profiles = tuple(DetectorEvaluator(each, self.cases.ious, self.seed) for each in self.profiles)
        return CasesEvaluator(profiles, self.cases, self.levels)

    def outcomes(self, chosen: tuple[int, ...]) -> list[Outcome]:
        """Outcomes of one set in every frame."""
        return self.detected.outcomes([chosen], range(self.frames))[chosen]

    def judge(
        self, sets: Bool[np.ndarray, "n C"], *, iou: float | None = None, progress: Report | None = None
    ) -> list[Judgement]:
        """Judge intact sets over all frames. iou: one threshold, None for the cases' own; progress: frames done."""
        ious = self.cases.ious if iou is None else (iou,)
        found = self._detect(self.detected, sets, progress)
        return [self._draw(outcomes, ious=ious).finished for outcomes in found]

    def judge_cases(
        self, sets: Bool[np.ndarray, "n C"], stage: Callable[[str], Report | None] = lambda _: None
    ) -> list[SetJudgement]:
        """Judge sets intact and in all cases. stage: makes the callback of frames done from the name of a stage."""
        nothing = [None] * len(sets)
        judged = self.judge(sets, progress=stage("chosen set"))
        left = self.left(sets, progress=stage("failures")) or nothing
        return [
            SetJudgement(*each)
            for each in zip(
                judged,
                left,
                self.over_levels(sets) or nothing,
                self.over_errors(sets, progress=stage("errors")) or nothing,
                strict=True,
            )
        ]

    def left(self, sets: Bool[np.ndarray, "n C"], *, progress: Report | None = None) -> list[Judgement] | None:
        """Judge the remaining sensors when some fail. The levels of traffic are included; None if none fail."""
        if not self.cases.failing:
            return None
        return [each.finished for each in self._at_profile(self.detected, sets, progress)]

    def over_levels(self, sets: Bool[np.ndarray, "n C"]) -> list[Judgement] | None:
        """Judge intact sets over the levels of traffic. None if it is undivided."""
        if not self.levels:
            return None
        return [self._over_levels(outcomes).finished for outcomes in self._detect(self.detected, sets)]

    def over_errors(self, sets: Bool[np.ndarray, "n C"], *, progress: Report | None = None) -> list[Judgement] | None:
        """Judge sets over the error profiles. Failures and levels are included if asked for; None for one profile."""
        if len(self.profiles) == 1:
            return None
        found = []
        for each in zip(*(self._at_profile(at, sets, progress) for at in self.profiles), strict=True):
            draws = self.cases.over_errors(np.stack([case.draws for case in each]))
            found.append(Drawn(_reduce([case.judged for case in each], self.cases.errors_by), draws).finished)
        return found

    def by_level(self, chosen: tuple[int, ...]) -> tuple[Judgement | None, ...]:
        """Judge one set at each level of traffic. None for a level without objects."""
        outcomes = self.outcomes(chosen)
        found = [self._draw(outcomes, part) for part in self.levels]
        return tuple(None if np.isnan(each.judged.ap) else each.finished for each in found)

    def by_errors(self, chosen: tuple[int, ...]) -> dict[str, Judgement]:
        """Judge one set at each error profile, by name. Empty if there is one profile."""
        if len(self.profiles) == 1:
            return {}
        row = np.isin(np.arange(len(self.detected.renders.sensors)), chosen)[None]
        at_each = zip(self.cases.names, self.profiles, strict=True)
        return {name: self._at_profile(at, row)[0].finished for name, at in at_each}

    def by_class(self, chosen: tuple[int, ...]) -> tuple[ClassAP, ...]:
        """Judge one set for each class that counts."""
        tallies, classes = self._tally(self.outcomes(chosen)), self.classes
        return tuple(
            ClassAP(
                name,
                weight,
                self.cases.class_ious(classes, name),
                judge_tallies([[at[k]] for at in tallies], Classes((name,)), self.seed),
            )
            for k, (name, weight) in enumerate(zip(classes.names, classes.weights, strict=True))
        )

    def _detect(
        self, detected: Detected, sets: Bool[np.ndarray, "n C"], progress: Report | None = None
    ) -> list[list[Outcome]]:
        members = [tuple(np.flatnonzero(row).tolist()) for row in sets]
        outcomes = detected.outcomes(dict.fromkeys(members), range(self.frames), progress)
        return [outcomes[each] for each in members]

    def _at_profile(
        self, detected: Detected, sets: Bool[np.ndarray, "n C"], progress: Report | None = None
    ) -> list[Drawn]:
        """Figures of sets at one error profile. They cover levels and failures."""
        rows, owners = self.cases.expand(sets)
        different, place = np.unique(rows, axis=0, return_inverse=True)
        each = [self._over_levels(outcomes) for outcomes in self._detect(detected, different, progress)]
        found = [each[i] for i in place.reshape(-1).tolist()]
        if not self.cases.failing:
            return found
        draws = self.cases.over_failures(np.stack([case.draws for case in found]), owners, tie=0.0)
        lost = range(len(sets), len(rows))
        cases = [[found[i].judged for i in lost if owners[i] == n] for n in range(len(sets))]
        return [Drawn(_reduce(own, self.cases.failures), draws[n]) for n, own in enumerate(cases)]

    def _over_levels(self, outcomes: Sequence[Outcome]) -> Drawn:
        """Figures of one set over the levels of traffic."""
        if not self.levels:
            return self._draw(outcomes)
        found = [self._draw(outcomes, part) for part in self.levels]
        draws = self.cases.over_levels(np.stack([each.draws for each in found]))
        cases = [each.judged for each in found if not np.isnan(each.judged.ap)]
        judged = _reduce(cases, self.cases.levels_by)
        if self.cases.levels_by == "mean":
            counts = {name: sum(getattr(case, name) for case in cases) for name in ("vehicles", "frames")}
            judged = replace(judged, **counts)
        return Drawn(judged, draws)

    def _draw(
        self,
        outcomes: Sequence[Outcome],
        frames: Int64[np.ndarray, " _"] | None = None,
        ious: Sequence[float] | None = None,
    ) -> Drawn:
        """Figures of one set in some frames. The blocks of these frames are drawn separately; None for all."""
        draws = None if frames is None else draws_of_blocks(frames // BLOCK_FRAMES, seed=self.seed)
        return draw_tallies(self._tally(outcomes, frames, ious), self.classes, self.seed, draws)

    def _tally(
        self,
        outcomes: Sequence[Outcome],
        frames: Int64[np.ndarray, " _"] | None = None,
        ious: Sequence[float] | None = None,
    ) -> list[list[Tally]]:
        """Tally of one set, by IoU threshold and class."""
        which = np.arange(self.frames) if frames is None else frames
        own = [outcomes[k] for k in which.tolist()]
        return [
            [
                Tally.of([o.of_class(label) for o in own], self.to_find[label][which], at)
                for label in self.classes.labels
            ]
            for at in map(self.detected.ious.index, self.cases.ious if ious is None else ious)
        ]


def judge_tallies(tallies: Sequence[Sequence[Tally]], classes: Classes, seed: int) -> Judgement:
    """Judge from tallies by class and IoU threshold."""
    return draw_tallies(tallies, classes, seed).finished


def draw_tallies(
    tallies: Sequence[Sequence[Tally]],
    classes: Classes,
    seed: int,
    draws: Int64[np.ndarray, "resamples frames"] | None = None,
) -> Drawn:
    """Average over IoU thresholds.

    The input is a tally of each class at each threshold.

    draws: how often each frame is drawn in each resample, None for blocks of consecutive frames.
    """
    resampled = [
        classes.combined(np.stack([each.resamples(seed=seed, draws=draws) for each in at], axis=1)) for at in tallies
    ]
    return Drawn(_mean([_combine(at, classes) for at in tallies]), np.mean(resampled, axis=0))


def _reduce(cases: Sequence[Judgement], combine: Combine) -> Judgement:
    return min(cases, key=lambda case: case.ap) if combine == "worst" else _mean(cases)


def _mean(cases: Sequence[Judgement]) -> Judgement:
    """Mean of judgements on the same traffic. Precision is averaged over those that have one."""
    if len(cases) == 1:
        return cases[0]
    ap, recall = (float(np.mean([getattr(case, name) for case in cases])) for name in ("ap", "recall"))
    precisions = [case.precision for case in cases if case.precision is not None]
    precision = float(np.mean(precisions)) if precisions else None
    return replace(cases[0], ap=ap, low=ap, high=ap, recall=recall, precision=precision)


def _combine(tallies: Sequence[Tally], classes: Classes) -> Judgement:
    """Judgement from a tally of each class, combined."""
    ap, recall = (
        float(classes.combined(np.array([[getattr(tally, name) for tally in tallies]]))[0]) for name in ("ap", "recall")
    )
    detections, hits = (sum(len(each.hit) for each in tallies), sum(int(each.hit.sum()) for each in tallies))
    return Judgement(
        ap=ap,
        low=ap,
        high=ap,
        recall=recall,
        precision=hits / detections if detections else None,
        vehicles=sum(int(each.truths.sum()) for each in tallies),
        frames=len(tallies[0].truths),
        kind=NOUNS[classes.names[0]] if len(classes.names) == 1 else "object",
    )
