"""Judging sensor sets by the detector on traffic new to all searches, and choosing among the entrants.

AP and its resamples are reduced over the cases as `placement_env.cases` says; in every resample the worst case is that
of the resample. Recall, precision and counts are those of the worst case, or means over cases.

Sets of one size race each other until the best of them is known well enough (`placement_env.racing.race_until`), so
that small and cheap sets stay in; the best few of each size are judged on all frames. Without a requirement the answer
is the set with the highest AP. With one it is the cheapest set, by price, number of sensors, then kbit, whose interval
lies above it; failing that, the cheapest whose AP reaches it; failing that, the set with the highest AP. Among sets of
equal AP the higher mean AP over the detector's IoU thresholds wins, then the cheaper set. AP is that over the cases of
the plan (`PlanOption.counted`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from placement_env.analysis.intervals import BLOCK_FRAMES, Draws, Tally, block_draws, draws_of_blocks, figure_interval
from placement_env.cases import USUAL_CASES, Cases
from placement_env.classes import Classes, Combine
from placement_env.fidelity.detector import IOUS, Detected, Outcome
from placement_env.fidelity.preparation import Preparation
from placement_env.objective import Objective
from placement_env.report.content import CONFIDENCE, ClassAP, Judgement, PlanOption, overlap
from placement_env.search.exact.exhaustive import find_front
from placement_env.search.portfolio.entrants import Entrants
from placement_env.search.portfolio.evaluators import CasesEvaluator, DetectorEvaluator, Report
from placement_env.search.portfolio.portfolio import contest
from toolkit.arrays import Bool, Float64, Int64
from toolkit.objects import HEAVY, LABELS
from toolkit.runtime.run import Run

NOUNS = {name: "heavy vehicle" if name == LABELS[HEAVY] else name for name in LABELS}
COUNTS = slice(3, 5)  # vehicles and frames, after AP, recall and precision
DRAWS = slice(5, None)  # the AP of each resample, last

_Figures = Float64[np.ndarray, "*cases figures"]  # AP, recall, precision, vehicles, frames; AP of each resample


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
    frames of each level of traffic, none if traffic is undivided.
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
    def frames(self) -> int:
        """Number of frames."""
        return self.detected.frames

    @property
    def intact(self) -> Cases:
        """Cases without failures, levels and other error profiles than the first."""
        return replace(self.cases, failing=0, levels=1, errors=self.cases.profiles[0])

    @cached_property
    def to_find(self) -> dict[int, Int64[np.ndarray, " frames"]]:
        """Number of objects to find, per frame and class."""
        find = self.detected.to_find
        return {
            label: np.array([find(k, label).sum() for k in range(self.frames)], np.int64)
            for label in self.detected.classes.labels
        }

    @property
    def absent(self) -> tuple[str, ...]:
        """Classes that count but have no object to find."""
        return tuple(LABELS[label] for label, counts in self.to_find.items() if not counts.any())

    @property
    def evaluator(self) -> CasesEvaluator:
        """Evaluator for races of sets, over the same cases."""
        profiles = tuple(DetectorEvaluator(each, self.cases.ious, self.seed) for each in self.profiles)
        return CasesEvaluator(profiles, self.cases, self.levels)

    def outcomes(self, chosen: tuple[int, ...]) -> list[Outcome]:
        """Outcomes of one set in every frame."""
        return self.detected.outcomes([chosen], range(self.frames))[chosen]

    def judge(
        self, sets: Bool[np.ndarray, "n C"], cases: Cases | None = None, *, progress: Report | None = None
    ) -> list[Judgement]:
        """Judge sets over cases, by default those of `intact`. progress: called with the frames done."""
        if not len(sets):
            return []
        cases = cases or self.intact
        found = self._at_profiles(sets, cases, progress)
        over = _reduce(found, cases.errors_by)
        over[..., DRAWS] = cases.over_errors(found[..., DRAWS])
        return [_judgement(each, self.detected.classes) for each in over]

    def judge_cases(
        self, sets: Bool[np.ndarray, "n C"], stage: Callable[[str], Report | None] = lambda _: None
    ) -> list[SetJudgement]:
        """Judge sets intact and in all cases. stage: makes a progress callback from a name."""
        nothing, first = [None] * len(sets), replace(self.cases, errors=self.cases.profiles[0])
        judged = self.judge(sets, progress=stage("chosen set"))
        left = self.judge(sets, first, progress=stage("failures")) if first.failing else nothing
        over_levels = self.judge(sets, replace(first, failing=0)) if self.levels else nothing
        several = len(self.profiles) > 1
        over_errors = self.judge(sets, self.cases, progress=stage("errors")) if several else nothing
        return [SetJudgement(*each) for each in zip(judged, left, over_levels, over_errors, strict=True)]

    def by_level(self, chosen: tuple[int, ...]) -> list[Judgement | None]:
        """Judge one intact set at each level of traffic. None for a level without objects."""
        found = [self._draw(self.outcomes(chosen), part, self.cases.ious) for part in self.levels]
        return [None if np.isnan(each[0]) else _judgement(each, self.detected.classes) for each in found]

    def by_errors(self, chosen: tuple[int, ...]) -> dict[str, Judgement]:
        """Judge one set at each error profile, by name."""
        if len(self.profiles) == 1:
            return {}
        row = np.isin(np.arange(len(self.detected.renders.sensors)), chosen)[None]
        found = self._at_profiles(row, self.cases)[:, 0]
        return {name: _judgement(at, self.detected.classes) for name, at in zip(self.cases.names, found, strict=True)}

    def by_class(self, chosen: tuple[int, ...]) -> tuple[ClassAP, ...]:
        """Judge one set for each class that counts."""
        classes, every = self.detected.classes, np.arange(self.frames)
        tallies = self._tally(self.outcomes(chosen), every, self.cases.ious)
        return tuple(
            ClassAP(
                name,
                weight,
                self.cases.class_ious(classes, name),
                judge_tallies([[at[k]] for at in tallies], Classes((name,)), self.seed),
            )
            for k, (name, weight) in enumerate(zip(classes.names, classes.weights, strict=True))
        )

    def _at_profiles(
        self, sets: Bool[np.ndarray, "n C"], cases: Cases, progress: Report | None = None
    ) -> Float64[np.ndarray, "profiles n figures"]:
        """Figures of sets at each error profile, over thresholds, levels and failures."""
        rows, owners = cases.expand(sets)
        different, place = np.unique(rows, axis=0, return_inverse=True)
        members = [tuple(np.flatnonzero(row).tolist()) for row in different]
        parts = self.levels if cases.levels > 1 else (np.arange(self.frames),)
        drawn = []
        for detected in self.profiles[: len(cases.profiles)]:
            outcomes = detected.outcomes(members, range(self.frames), progress)
            drawn.append([[self._draw(outcomes[each], part, cases.ious) for each in members] for part in parts])
        found = np.array(drawn)[:, :, place.reshape(-1)]  # profile, level, row, figure
        over = _reduce(np.moveaxis(found, 1, 0), cases.levels_by)
        if cases.levels_by == "mean":
            counts = np.where(np.isnan(found[..., :1]), 0, found[..., COUNTS])
            over[..., COUNTS] = counts.sum(axis=1)
        if cases.failing:
            lost = [np.flatnonzero(owners == n)[1:] for n in range(len(sets))]  # the first is the set itself
            over = np.stack([_reduce(np.moveaxis(over[:, some], 1, 0), cases.failures) for some in lost], axis=1)
        over[..., DRAWS] = cases.at_profiles(found[:, :, None, :, DRAWS], owners, tie=0.0)
        return over

    def _draw(self, outcomes: Sequence[Outcome], frames: Int64[np.ndarray, " _"], ious: Sequence[float]) -> _Figures:
        """Figures of one set in some frames, whose blocks are drawn."""
        draws = draws_of_blocks(frames // BLOCK_FRAMES, seed=self.seed)
        return _draw_tallies(self._tally(outcomes, frames, ious), self.detected.classes, draws)

    def _tally(
        self, outcomes: Sequence[Outcome], frames: Int64[np.ndarray, " _"], ious: Sequence[float]
    ) -> list[list[Tally]]:
        own = [outcomes[k] for k in frames.tolist()]
        return [
            [Tally.of([o.of_class(label) for o in own], count[frames], at) for label, count in self.to_find.items()]
            for at in map(self.detected.ious.index, ious)
        ]


def judge_tallies(tallies: Sequence[Sequence[Tally]], classes: Classes, seed: int) -> Judgement:
    """Judge from a tally of each class at each IoU threshold, averaged over these."""
    draws = block_draws(len(tallies[0][0].truths), seed=seed)
    return _judgement(_draw_tallies(tallies, classes, draws), classes)


def _draw_tallies(tallies: Sequence[Sequence[Tally]], classes: Classes, draws: Draws) -> _Figures:
    found = []
    for at in tallies:
        ap, recall = classes.combined(np.array([[t.ap for t in at], [t.recall for t in at]]))
        detections, hits = sum(len(t.hit) for t in at), sum(int(t.hit.sum()) for t in at)
        counts = sum(int(t.truths.sum()) for t in at), len(at[0].truths)
        drawn = classes.combined(np.stack([t.resamples(draws=draws) for t in at], axis=1))
        precision = hits / detections if detections and counts[0] else np.nan
        found.append(np.array([ap, recall, precision, *counts, *drawn]))
    return _reduce(np.array(found), "mean")


def _reduce(figures: Float64[np.ndarray, "cases *rest figures"], by: Combine) -> Float64[np.ndarray, "*rest figures"]:
    """Figures of the case of least AP, or means over cases, without NaN."""
    if by == "worst":
        ap = figures[..., :1]
        worst = np.where(np.isnan(ap), np.inf, ap).argmin(axis=0)
        return np.take_along_axis(figures, worst[None], axis=0)[0]
    mean = np.ma.masked_invalid(figures).mean(axis=0).filled(np.nan)
    mean[..., COUNTS] = figures[0, ..., COUNTS]
    return mean


def _judgement(figures: _Figures, classes: Classes) -> Judgement:
    ap, recall, precision, vehicles, frames = figures[: DRAWS.start].tolist()
    low, high = figure_interval(ap, figures[DRAWS], confidence=CONFIDENCE)
    kind = NOUNS[classes.names[0]] if len(classes) == 1 else "object"
    defined = None if np.isnan(precision) else precision
    return Judgement(ap, low, high, recall, defined, int(vehicles), int(frames), kind)


KEPT = 3  # sets of each number of sensors that are judged on all frames

Rule = Literal["best", "interval", "estimate", "none"]


@dataclass(frozen=True, eq=False)
class Choice:
    """The answer among options: all entrants in their order, judged or not. chosen: index of the answer."""

    options: tuple[PlanOption, ...]
    sets: Bool[np.ndarray, "n C"]
    chosen: int
    rule: Rule

    @property
    def option(self) -> PlanOption:
        """The answer."""
        return self.options[self.chosen]

    @property
    def members(self) -> tuple[int, ...]:
        """Indices of the candidates of the answer, ascending."""
        return tuple(np.flatnonzero(self.sets[self.chosen]).tolist())


def choose_set(
    objective: Objective,
    found: Entrants,
    judge: Judge,
    *,
    min_ap: float | None = None,
    confidence: float = 0.95,
    run: Run = Run(),
) -> Choice:
    """Choose among the entrants, at least one. confidence: at which a race of one size ends."""
    options = []
    for i, score in enumerate(map(objective.score, map(np.flatnonzero, found.sets))):
        names = tuple(objective.names[c].replace("/", "-") for c in score.subset)  # as files name sensors
        predicted = round(float(found.predicted[i]), 6)  # as found: scored beside other sets it may round differently
        figures = score.price, score.kbit_per_sensor, score.kbit, predicted
        poles = tuple(objective.candidates.mounts[m].name for m in objective.candidates.mount[list(score.subset)])
        options.append(PlanOption(names, *figures, judged=None, searches=found.searches[i], poles=poles))
    sizes, evaluator = found.sets.sum(axis=1), judge.evaluator
    report = run.stage("judging", len(np.unique(sizes)))
    for done, size in enumerate(np.unique(sizes), 1):
        places = np.flatnonzero(sizes == size)
        ran = contest(objective, found.sets[places], evaluator, confidence=confidence, seed=run.seed)
        kept = places[ran.ranking[:KEPT]]
        estimates = judge.detected.estimates(found.sets[kept])
        mean_ap = np.mean([estimates[iou].ap for iou in IOUS], axis=0).tolist()
        for i, judged, mean in zip(kept.tolist(), judge.judge_cases(found.sets[kept]), mean_ap, strict=True):
            options[i] = replace(options[i], mean_ap=mean, **judged._asdict())
        if report is not None:
            report(done)
    return Choice(tuple(options), found.sets, *choose(tuple(options), min_ap))


def choose(options: tuple[PlanOption, ...], min_ap: float | None) -> tuple[int, Rule]:
    """Return the index of the answer among options, and the rule that chose it."""

    def thrift(entry: tuple[int, PlanOption, Judgement]) -> tuple[float, int, float, float]:
        _, option, judgement = entry
        return option.price, len(option.sensors), option.kbit_per_sensor, -judgement.ap

    judged = [(i, option, option.counted) for i, option in enumerate(options) if option.counted is not None]
    if min_ap is not None:
        sure = [entry for entry in judged if entry[2].low >= min_ap]
        reaching = [entry for entry in judged if entry[2].ap >= min_ap]
        if sure or reaching:
            return min(sure or reaching, key=thrift)[0], "interval" if sure else "estimate"
    best = min(judged, key=lambda entry: (-entry[2].ap, -(entry[1].mean_ap or 0.0), *thrift(entry)))[0]
    return best, "best" if min_ap is None else "none"


def near_optimal(options: tuple[PlanOption, ...], chosen: int) -> tuple[PlanOption, ...]:
    """Judged sets whose interval overlaps the chosen one's, cheap sets first."""
    best = options[chosen].counted
    others = [(option, option.counted) for i, option in enumerate(options) if i != chosen and option.counted]
    near = [(option, judged) for option, judged in others if best and overlap(judged, best)]
    return tuple(option for option, _ in sorted(near, key=lambda each: (each[0].price, -each[1].ap)))


def find_front_options(options: tuple[PlanOption, ...]) -> tuple[PlanOption, ...]:
    """Judged sets that no other beats in AP, kbit per sensor and price at once."""
    judged = [(option, option.counted) for option in options if option.counted is not None]
    figures = np.array([(-j.ap, o.kbit_per_sensor, o.price) for o, j in judged]).reshape(-1, 3)
    kept = [judged[i] for i in find_front(figures)]
    return tuple(option for option, _ in sorted(kept, key=lambda pair: (pair[0].price, pair[1].ap)))
