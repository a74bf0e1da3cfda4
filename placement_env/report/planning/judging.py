"""Judging: sensor sets by the detector on traffic that no search saw, with intervals and the number of vehicles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from placement_env.analysis.intervals import BLOCK_FRAMES, Tally, draws_of_blocks, figure_interval
from placement_env.cases import USUAL_CASES, Cases, IoUs
from placement_env.classes import Classes
from placement_env.fidelity.detector import Detected, Outcome
from placement_env.report.content import CONFIDENCE, ClassAP, Judgement
from placement_env.search.portfolio.evaluators import CasesEvaluator, DetectorEvaluator, Evaluator
from toolkit.arrays import Bool, Float64, Int64
from toolkit.objects import HEAVY, LABELS

NOUNS = {name: "heavy vehicle" if name == LABELS[HEAVY] else name for name in LABELS}


@dataclass(frozen=True, eq=False)
class Judge:
    """The detector on one part of the traffic. seed: of the bootstrap; cases: over which its figures are taken, None
    for its own threshold alone; parts: the frames of each level, none where all traffic is one; others: the same
    detector at the error profiles after the first of `errors`, None where there is one profile. Figures are those at
    the first one unless it says otherwise."""

    detected: Detected
    seed: int
    cases: Cases | None = None
    parts: tuple[Int64[np.ndarray, " _"], ...] = ()
    others: tuple[Judge, ...] = ()

    def judge(
        self,
        sets: Bool[np.ndarray, "n C"],
        *,
        iou: float | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> list[Judgement]:
        """Judgement of each set over all frames. iou: None for the plan's own; progress: called with how many frames
        are done, where any has to be."""
        rows = [tuple(np.flatnonzero(row).tolist()) for row in sets]
        outcomes = self.detected.outcomes(dict.fromkeys(rows), range(self.frames), progress)
        ious = self.ious if iou is None else (iou,)
        return [mean_judgement(self.tallies(outcomes[row], ious), self.classes, self.seed) for row in rows]

    def left(
        self, sets: Bool[np.ndarray, "n C"], *, progress: Callable[[int], None] | None = None
    ) -> list[Judgement] | None:
        """What is left of each set when sensors fail, over the levels of traffic; None where none does. The worst case
        is that of each resample; recall and precision are those of the worst case, or means over all."""
        if self.cases is None or not self.cases.failing:
            return None
        return [_within(*each) for each in self._left(sets, self.cases, progress)]

    def _left(
        self, sets: Bool[np.ndarray, "n C"], cases: Cases, progress: Callable[[int], None] | None
    ) -> list[tuple[Judgement, Float64[np.ndarray, " resamples"]]]:
        rows, owners = cases.expand(sets)
        members = [tuple(np.flatnonzero(row).tolist()) for row in rows]
        outcomes = self.detected.outcomes(dict.fromkeys(members), range(self.frames), progress)
        judged, draws = {}, {}
        for each in dict.fromkeys(members):
            judged[each], draws[each] = self._over_levels(outcomes[each])
        resamples = cases.over_failures(np.array([draws[each] for each in members]), owners, tie=0)
        found = []
        for n in range(len(sets)):
            judgements = [
                judged[each]
                for each, owner in zip(members[len(sets) :], owners[len(sets) :], strict=True)
                if owner == n
            ]
            left = min(judgements, key=lambda case: case.ap) if cases.failures == "worst" else _mean(judgements)
            found.append((left, resamples[n]))
        return found

    def over_levels(
        self, sets: Bool[np.ndarray, "n C"], *, progress: Callable[[int], None] | None = None
    ) -> list[Judgement] | None:
        """Judgement of each intact set over the levels of traffic, None where all traffic is one. The worst level is
        that of each resample; recall, precision and how many there were are those of the worst level, or of all."""
        if not self.parts:
            return None
        rows = [tuple(np.flatnonzero(row).tolist()) for row in sets]
        outcomes = self.detected.outcomes(dict.fromkeys(rows), range(self.frames), progress)
        return [_within(*self._over_levels(outcomes[row])) for row in rows]

    def by_level(self, chosen: tuple[int, ...]) -> tuple[Judgement | None, ...]:
        """Judgement of one set at each level of traffic by itself, None where there is nothing to find."""
        outcomes = self.outcomes(chosen)
        found = [self._at_level(outcomes, part) for part in self.parts]
        return tuple(None if np.isnan(judged.ap) else _within(judged, draws) for judged, draws in found)

    def over_errors(
        self, sets: Bool[np.ndarray, "n C"], *, progress: Callable[[int], None] | None = None
    ) -> list[Judgement] | None:
        """What counts of each set over the error profiles: of what is left when sensors fail, and over the levels of
        traffic, where such are asked for; None where there is one profile. The worst profile is that of each resample;
        recall and precision are those of the worst profile, or means."""
        if self.cases is None or not self.others:
            return None
        found = []
        for cases in zip(*(each._counted(sets, progress) for each in (self, *self.others)), strict=True):
            judged = [case for case, _ in cases]
            worst = self.cases.errors_by == "worst"
            over = min(judged, key=lambda case: case.ap) if worst else _mean(judged)
            found.append(_within(over, self.cases.over_errors(np.stack([draws for _, draws in cases]))))
        return found

    def by_errors(self, chosen: tuple[int, ...]) -> dict[str, Judgement]:
        """What counts of one set at each error profile by itself, by its name; none where there is one profile."""
        if self.cases is None or not self.others:
            return {}
        row = np.zeros((1, len(self.detected.renders.sensors)), np.bool_)
        row[0, list(chosen)] = True
        judges = zip(self.cases.names, (self, *self.others), strict=True)
        return {name: _within(*each._counted(row)[0]) for name, each in judges}

    def _counted(
        self, sets: Bool[np.ndarray, "n C"], progress: Callable[[int], None] | None = None
    ) -> list[tuple[Judgement, Float64[np.ndarray, " resamples"]]]:
        """At this profile: what is left of each set where sensors fail, else the intact one, over the levels."""
        if self.cases is not None and self.cases.failing:
            return self._left(sets, self.cases, progress)
        rows = [tuple(np.flatnonzero(row).tolist()) for row in sets]
        outcomes = self.detected.outcomes(dict.fromkeys(rows), range(self.frames), progress)
        return [self._over_levels(outcomes[row]) for row in rows]

    def _over_levels(self, outcomes: Sequence[Outcome]) -> tuple[Judgement, Float64[np.ndarray, " resamples"]]:
        """Figures of one set in all frames, over the levels, and the AP of each resample."""
        if self.cases is None or not self.parts:
            tallies = self.tallies(outcomes)
            return mean_figures(tallies, self.classes), mean_resamples(tallies, self.classes, self.seed)
        found = [self._at_level(outcomes, part) for part in self.parts]
        resamples = self.cases.over_levels(np.stack([draws for _, draws in found]))
        cases = [judged for judged, _ in found if not np.isnan(judged.ap)]
        if self.cases.levels_by == "worst":
            return min(cases, key=lambda case: case.ap), resamples
        vehicles, frames = (sum(getattr(case, name) for case in cases) for name in ("vehicles", "frames"))
        return replace(_mean(cases), vehicles=vehicles, frames=frames), resamples

    def _at_level(
        self, outcomes: Sequence[Outcome], part: Int64[np.ndarray, " _"]
    ) -> tuple[Judgement, Float64[np.ndarray, " resamples"]]:
        """The same at one level, whose blocks of frames are drawn by themselves."""
        tallies = self.tallies(outcomes, frames=part)
        draws = draws_of_blocks(part // BLOCK_FRAMES, seed=self.seed)
        return mean_figures(tallies, self.classes), mean_resamples(tallies, self.classes, self.seed, draws=draws)

    def evaluator(self) -> Evaluator:
        """Evaluator that has sets race, over the same cases."""
        profiles = tuple(DetectorEvaluator(each.detected, self.ious, self.seed) for each in (self, *self.others))
        return CasesEvaluator(profiles, self.cases or USUAL_CASES, self.parts)

    def tallies(
        self,
        outcomes: Sequence[Outcome],
        ious: Sequence[float] | None = None,
        *,
        frames: Int64[np.ndarray, " _"] | None = None,
    ) -> list[list[Tally]]:
        """What became of one set's detections at each IoU threshold, class by class. outcomes: of all frames; ious:
        None for all that count; frames: of which it is, None for all."""
        which = np.arange(self.frames) if frames is None else frames
        own = [outcomes[k] for k in which.tolist()]
        return [
            [
                Tally.of([outcome.of_class(label) for outcome in own], self.truths_of(label)[which], at)
                for label in self.classes.labels
            ]
            for at in map(self.detected.ious.index, self.ious if ious is None else ious)
        ]

    def by_class(self, chosen: tuple[int, ...]) -> tuple[ClassAP, ...]:
        """Judgement of one set for each class that counts, by itself."""
        tallies = self.tallies(self.outcomes(chosen))
        classes, cases = self.classes, self.cases or Cases(iou=self.detected.iou)
        return tuple(
            ClassAP(name, weight, cases.class_ious(classes, name), mean_judgement(own, Classes((name,)), self.seed))
            for k, (name, weight) in enumerate(zip(classes.names, classes.weights, strict=True))
            for own in [[[at[k]] for at in tallies]]
        )

    @property
    def ious(self) -> tuple[float, ...]:
        """Thresholds over which the mean is taken."""
        return (self.detected.iou,) if self.cases is None else self.cases.ious

    @property
    def iou(self) -> IoUs:
        """The one, or all."""
        return self.ious[0] if len(self.ious) == 1 else self.ious

    @property
    def classes(self) -> Classes:
        """That count."""
        return self.detected.classes

    @property
    def absent(self) -> tuple[str, ...]:
        """Classes that count and of which there is nothing to find."""
        return tuple(LABELS[label] for label in self.classes.labels if not self.truths_of(label).any())

    def outcomes(self, chosen: tuple[int, ...]) -> list[Outcome]:
        """Of one set in every frame."""
        return self.detected.outcomes([chosen], range(self.frames))[chosen]

    @property
    def frames(self) -> int:
        """How many frames it judges by."""
        return self.detected.frames

    @property
    def truths(self) -> Int64[np.ndarray, " frames"]:
        """Vehicles, or objects of all classes that count, to be found in each frame."""
        return np.array([self.detected.scored(k).sum() for k in range(self.frames)], np.int64)

    def truths_of(self, label: int) -> Int64[np.ndarray, " frames"]:
        """Those of one class."""
        return np.array([self.detected.to_find(k, label).sum() for k in range(self.frames)], np.int64)


def mean_judgement(tallies: Sequence[Sequence[Tally]], classes: Classes, seed: int) -> Judgement:
    """Figures of a tally for each class at each of several IoU thresholds: means over these, the interval too; that of
    several classes is the interval of their combination, resample by resample."""
    return _within(mean_figures(tallies, classes), mean_resamples(tallies, classes, seed))


def mean_figures(tallies: Sequence[Sequence[Tally]], classes: Classes) -> Judgement:
    """The same without resamples, so with no interval but the AP itself."""
    return _mean([_combined(at, classes) for at in tallies])


def mean_resamples(
    tallies: Sequence[Sequence[Tally]],
    classes: Classes,
    seed: int,
    *,
    draws: Int64[np.ndarray, "resamples frames"] | None = None,
) -> Float64[np.ndarray, " resamples"]:
    """AP of each resample in the mean over IoU thresholds, of a tally for each class at each. draws: how often each
    frame is drawn, None for blocks of frames that follow each other."""
    found = [
        classes.combined(np.stack([each.resamples(seed=seed, draws=draws) for each in at], axis=1)) for at in tallies
    ]
    return np.asarray(np.mean(found, axis=0))


def _within(judged: Judgement, resamples: Float64[np.ndarray, " resamples"]) -> Judgement:
    """With the interval of its AP's resamples."""
    low, high = figure_interval(judged.ap, resamples, confidence=CONFIDENCE)
    return replace(judged, low=low, high=high)


def _mean(cases: Sequence[Judgement]) -> Judgement:
    """The mean of figures of the same traffic; precision of those that have one."""
    if len(cases) == 1:
        return cases[0]
    ap, recall = (float(np.mean([getattr(case, name) for case in cases])) for name in ("ap", "recall"))
    precisions = [case.precision for case in cases if case.precision is not None]
    precision = float(np.mean(precisions)) if precisions else None
    return replace(cases[0], ap=ap, low=ap, high=ap, recall=recall, precision=precision)


def _combined(tallies: Sequence[Tally], classes: Classes) -> Judgement:
    """Figures of a tally for each class, combined."""
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
