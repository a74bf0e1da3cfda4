"""`Judge`: AP of sensor sets by the detector on new traffic, with resamples for intervals.

AP and its resamples are reduced over the cases as in `placement_env.cases`. Every resample has its
worst case. Recall, precision and counts come from the worst case, or are means over cases."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from placement_env.analysis import intervals
from placement_env.analysis.agreement import StageFigure
from placement_env.analysis.intervals import BLOCK_FRAMES, Draws, Tally
from placement_env.cases import Cases
from placement_env.classes import Classes, Combine
from placement_env.defaults import USUAL_CASES
from placement_env.fidelity.detector import Detected, Outcome
from placement_env.fidelity.preparation import Preparation
from placement_env.report.content import CONFIDENCE, ClassAP, Judgement
from placement_env.search.portfolio.evaluators import CasesEvaluator, DetectorEvaluator, Report
from toolkit.arrays import Bool, Float64, Int64
from toolkit.objects import HEAVY, LABELS, known_labels
from toolkit.runtime.run import Run

# name of each class in sentences
CLASS_NOUNS = {name: "heavy vehicle" if name == LABELS[HEAVY] else name for name in LABELS}
# columns: AP, recall, precision, objects, frames; then the AP of each resample
_Figures = Float64[np.ndarray, "*cases figures"]
COUNT_COLUMNS = slice(3, 5)  # objects and frames
RESAMPLE_COLUMNS = slice(5, None)  # the AP of each resample


class SetJudgement(NamedTuple):
    """Judgement of a set, intact and in the requested cases.

    Fields have the names of `PlanOption`, so that they can be passed to it; cases that were not
    requested are None.

    Attributes:
        judged: Result of the intact set in undivided traffic.
        left: Result after failures, over the levels of traffic if there are several.
        over_levels: Result of the intact set over the levels of traffic.
        over_errors: Result over the error profiles, with failures and levels."""

    judged: Judgement
    left: Judgement | None = None
    over_levels: Judgement | None = None
    over_errors: Judgement | None = None

    @property
    def counted(self) -> Judgement:
        """Result by which sets are compared, over all requested cases."""
        return self.over_errors or self.left or self.over_levels or self.judged


@dataclass(frozen=True, eq=False)
class Judge:
    """The detector on one part of the traffic, which judges sensor sets.

    Sets are rows of booleans over all C candidates; members are the indices of one set's
    candidates.

    Attributes:
        profiles: The detector at each error profile, matched at all IoU thresholds of the cases.
        cases: Cases over which sets are judged.
        seed: Seed of the bootstrap.
        levels: Frames of each level of traffic, thin traffic first, empty if traffic is
            undivided.
        drawings: Judges of the same candidates at other drawings of the site. Figures of sets are
            means over all drawings."""

    profiles: tuple[Detected, ...]
    cases: Cases = USUAL_CASES
    seed: int = 0
    levels: tuple[Int64[np.ndarray, " _"], ...] = ()
    drawings: "tuple[Judge, ...]" = ()

    @classmethod
    def from_preparation(cls, prepared: Preparation, seed: int) -> "Judge":
        """Return a judge on the traffic of a preparation.

        Its detector runs at each error profile of the preparation's cases, and is matched to the
        objects at all their IoU thresholds.

        seed: seed of the bootstrap, not of the traffic."""
        cases = prepared.setting.cases
        profiles = [
            prepared.detected(errors).at(cases.ious[0], also=cases.ious)
            for errors in cases.profiles
        ]
        return cls(profiles=tuple(profiles), cases=cases, seed=seed, levels=prepared.levels)

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
        """Cases without failures and levels, at the first error profile; IoU stays."""
        return replace(self.cases, failing=0, levels=1, errors=self.cases.profiles[0])

    @cached_property
    def to_find(self) -> dict[int, Int64[np.ndarray, " frames"]]:
        """Number of objects to find in each frame, by class, which is an index into `LABELS`."""
        counts_by_class = {}
        for label in self.detected.classes.labels:
            # `Detected.to_find` marks the objects of a class that count in frame k
            frame_counts = [self.detected.to_find(k, label).sum() for k in range(self.frames)]
            counts_by_class[label] = np.array(frame_counts, np.int64)
        return counts_by_class

    @property
    def absent(self) -> tuple[str, ...]:
        """Names of the classes that count but have no object to find in any frame."""
        return tuple(LABELS[label] for label, counts in self.to_find.items() if not counts.any())

    @property
    def evaluator(self) -> CasesEvaluator:
        """Evaluator for races of sets, over the same cases and drawings of the site.

        It has one evaluator for each error profile, and one for each further drawing."""
        profile_evaluators = tuple(
            DetectorEvaluator(detected, self.cases.ious, self.seed) for detected in self.profiles
        )
        drawing_evaluators = tuple(drawing.evaluator for drawing in self.drawings)
        return CasesEvaluator(
            by_profile=profile_evaluators,
            cases=self.cases,
            levels=self.levels,
            drawings=drawing_evaluators,
        )

    @property
    def drawing_judges(self) -> "tuple[Judge, ...]":
        """Judges of one drawing of the site each: this judge's first, then the others."""
        return replace(self, drawings=()), *self.drawings

    def outcomes(self, members: tuple[int, ...]) -> list[Outcome]:
        """Return the detections of one set in every frame and the objects that they hit.

        They are at the first error profile."""
        return self.detected.outcomes([members], range(self.frames))[members]

    def kbit(self, members: tuple[int, ...]) -> Float64[np.ndarray, "k frames"]:
        """Return the kbit that each sensor of one set sends in every frame, rows as `members`."""
        return np.array([outcome.bits for outcome in self.outcomes(members)], np.float64).T / 1000

    def judge(
        self,
        sets: Bool[np.ndarray, "n C"],
        cases: Cases | None = None,
        *,
        progress: Report | None = None,
    ) -> list[Judgement]:
        """Judge sets over cases, and return one result for each set.

        sets: a row of booleans over all candidates for each set; cases: conditions to reduce over,
        None for `intact`; progress: called with the number of frames done."""
        judgements, _ = self.judge_drawn(sets, cases or self.intact, progress)
        return judgements

    def judge_drawn(
        self, sets: Bool[np.ndarray, "n C"], cases: Cases, progress: Report | None = None
    ) -> tuple[list[Judgement], _Figures]:
        """Judge sets over cases; return one result for each set, and AP in each resample.

        The AP of resamples have the axes set and resample. A resample has the same frames for all
        sets, so that they can be compared draw by draw. Figures are means over the drawings of the
        site; a drawing fills in at random what no map knows.

        Args:
            sets: A row of booleans over all candidates for each set.
            cases: Conditions (error profiles, failures, levels of traffic) to reduce over.
            progress: Called with the number of frames done."""
        if not len(sets):
            return [], np.empty((0, 0))
        # axes: drawing, error profile, set, figure
        drawing_figures = [
            judge._measure_profiles(sets, cases, progress) for judge in self.drawing_judges
        ]
        profile_figures = _reduce_cases(np.array(drawing_figures), "mean")
        figures = _reduce_cases(profile_figures, cases.errors_by)  # axes: set, figure
        # every resample has its worst profile, not the worst profile of all frames
        figures[..., RESAMPLE_COLUMNS] = cases.over_errors(profile_figures[..., RESAMPLE_COLUMNS])
        classes = self.detected.classes
        judgements = [_build_judgement(set_figures, classes) for set_figures in figures]
        return judgements, figures[..., RESAMPLE_COLUMNS]

    def judge_cases(
        self, sets: Bool[np.ndarray, "n C"], stage: Callable[[str], Report | None] = lambda _: None
    ) -> tuple[list[SetJudgement], _Figures]:
        """Judge sets intact and in all requested cases.

        Also returns the AP of each set in each resample, with the axes set and resample, for the
        result by which sets are compared (`SetJudgement.counted`).

        sets: a row of booleans over all candidates for each set; stage: function that returns a
        progress callback, or None, for the name of a stage; it is called for every kind of case
        except levels."""
        first_profile = replace(self.cases, errors=self.cases.profiles[0])
        # the last kind of case that was requested gives the draws, as in `SetJudgement.counted`
        intact, draws = self.judge_drawn(sets, self.intact, stage("chosen set"))
        # results of each set, None for kinds of cases that were not requested
        after_failures: Sequence[Judgement | None] = [None] * len(sets)
        over_levels = after_failures
        over_errors = after_failures
        if self.levels:
            over_levels, draws = self.judge_drawn(sets, replace(first_profile, failing=0))
        if first_profile.failing:
            after_failures, draws = self.judge_drawn(sets, first_profile, stage("failures"))
        if len(self.profiles) > 1:
            over_errors, draws = self.judge_drawn(sets, self.cases, stage("errors"))
        # in the order of the fields of `SetJudgement`
        rows = zip(intact, after_failures, over_levels, over_errors, strict=True)
        return [SetJudgement(*judgements) for judgements in rows], draws

    def by_level(self, members: tuple[int, ...]) -> list[Judgement | None]:
        """Judge one set without failures at each level of traffic, at the first error profile.

        Thin traffic comes first. A level without objects has None; undivided traffic has no levels.

        members: indices of the set's candidates."""
        judgements: list[Judgement | None] = []
        for level_frames in self.levels:
            figures = self._measure(self.outcomes(members), level_frames, self.cases.ious)
            ap = figures[0]
            judgement = None
            if not np.isnan(ap):  # AP is undefined without objects
                judgement = _build_judgement(figures, self.detected.classes)
            judgements.append(judgement)
        return judgements

    def by_errors(self, members: tuple[int, ...]) -> dict[str, Judgement]:
        """Judge one set at each error profile, by its name; empty if there is one profile.

        Failures and levels count as the cases ask; other drawings of the site do not.

        members: indices of the set's candidates."""
        if len(self.profiles) == 1:
            return {}
        is_member = np.isin(np.arange(len(self.detected.renders.sensors)), members)
        # axes: profile, set, figure; this set is the only one
        profile_figures = self._measure_profiles(is_member[None], self.cases)[:, 0]
        return {
            name: _build_judgement(figures, self.detected.classes)
            for name, figures in zip(self.cases.names, profile_figures, strict=True)
        }

    def of_classes(self, classes: Classes) -> "Judge":
        """Return a judge of other classes, for intact sets at the first error profile.

        It knows only the first drawing of the site and undivided traffic."""
        profiles = (self.detected.of_classes(classes),)
        return replace(self, profiles=profiles, cases=self.intact, levels=(), drawings=())

    def by_class(self, members: tuple[int, ...]) -> tuple[ClassAP, ...]:
        """Judge one set without failures for each class that counts, at the first error profile.

        members: indices of the set's candidates."""
        classes = self.detected.classes
        all_frames = np.arange(self.frames)
        class_aps = []
        # axes: IoU threshold, class
        tallies = _tally_outcomes(self, self.outcomes(members), all_frames, self.cases.ious)
        for k, (name, weight) in enumerate(zip(classes.names, classes.weights, strict=True)):
            tallies_of_class = [[class_tallies[k]] for class_tallies in tallies]  # one class
            judgement = judge_tallies(tallies_of_class, Classes((name,)), self.seed)
            ious = self.cases.class_ious(classes, name)
            class_aps.append(ClassAP(label=name, weight=weight, iou=ious, judged=judgement))
        return tuple(class_aps)

    def by_other_class(self, members: tuple[int, ...]) -> tuple[ClassAP, ...]:
        """Judge one set for each present class that the detector knows but that does not count.

        Their weights are 0. Classes without objects in this traffic are left out.

        members: indices of the set's candidates."""
        detector_labels = known_labels(self.detected.detector) or ()
        counted_names = self.detected.classes.names
        other_names = tuple(
            name for name in LABELS if name in detector_labels and name not in counted_names
        )
        if not other_names:
            return ()
        class_aps = self.of_classes(Classes(other_names)).by_class(members)
        # `vehicles` is the number of objects of the class, whatever the class
        return tuple(
            replace(class_ap, weight=0.0) for class_ap in class_aps if class_ap.judged.vehicles
        )

    def _measure_profiles(
        self, sets: Bool[np.ndarray, "n C"], cases: Cases, progress: Report | None = None
    ) -> Float64[np.ndarray, "profiles n figures"]:
        """Return the figures of sets at each error profile, over thresholds, levels, failures.

        The figures are AP, recall, precision, objects and frames, then AP in each resample. Every
        resample has its worst case; the other figures come from the worst case of all frames, or
        are means. Means over levels have the objects and frames of all levels with objects."""
        # rows: the sets, then what each failure leaves; equal rows are detected once
        rows, owners = cases.expand(sets)
        unique_rows, row_index = np.unique(rows, axis=0, return_inverse=True)
        members = [tuple(np.flatnonzero(row).tolist()) for row in unique_rows]
        levels = self.levels if cases.levels > 1 else (np.arange(self.frames),)
        profile_figures = []
        for detected in self.profiles[: len(cases.profiles)]:
            outcomes = detected.outcomes(members, range(self.frames), progress)
            member_outcomes = [outcomes[row_members] for row_members in members]
            profile_figures.append(
                [self._measure_sets(member_outcomes, frames, cases.ious) for frames in levels]
            )
        # axes: profile, level, row, figure
        figures = np.array(profile_figures)[:, :, row_index.reshape(-1)]
        reduced = _reduce_cases(np.moveaxis(figures, 1, 0), cases.levels_by)  # profile, row, figure
        if cases.levels_by == "mean":
            counts = np.where(np.isnan(figures[..., :1]), 0, figures[..., COUNT_COLUMNS])
            reduced[..., COUNT_COLUMNS] = counts.sum(axis=1)
        if cases.failing:
            set_figures = []
            for number in range(len(sets)):
                failure_rows = np.flatnonzero(owners == number)[1:]  # the first is the set itself
                over_failures = np.moveaxis(reduced[:, failure_rows], 1, 0)  # failures first
                set_figures.append(_reduce_cases(over_failures, cases.failures))
            reduced = np.stack(set_figures, axis=1)
        # `None` is the axis of IoU thresholds, over which the figures are means already
        drawn_aps = figures[:, :, None, :, RESAMPLE_COLUMNS]
        reduced[..., RESAMPLE_COLUMNS] = cases.at_profiles(drawn_aps, owners, tie=0.0)
        return reduced

    def _measure_sets(
        self,
        set_outcomes: Sequence[Sequence[Outcome]],
        frames: Int64[np.ndarray, " _"],
        ious: Sequence[float],
    ) -> list[_Figures]:
        """Return the figures of each set in some frames, from its outcomes in all frames."""
        return [self._measure(outcomes, frames, ious) for outcomes in set_outcomes]

    def _measure(
        self, outcomes: Sequence[Outcome], frames: Int64[np.ndarray, " _"], ious: Sequence[float]
    ) -> _Figures:
        """Return the figures of one set in some frames, with resamples of their blocks.

        They are AP, recall, precision, objects and frames, then AP in each resample.

        outcomes: in all frames; frames: indices of the frames to use; ious: thresholds to average
        over."""
        block_of_frame = frames // BLOCK_FRAMES  # resamples draw whole blocks
        draws = intervals.draws_of_blocks(block_of_frame, seed=self.seed)
        tallies = _tally_outcomes(self, outcomes, frames, ious)
        return _measure_tallies(tallies, self.detected.classes, draws)


def _tally_outcomes(
    judge: Judge,
    outcomes: Sequence[Outcome],
    frames: Int64[np.ndarray, " _"],
    ious: Sequence[float],
) -> list[list[Tally]]:
    """Tally the outcomes of one set in some frames; axes of the lists: IoU threshold, class.

    Args:
        judge: Gives the classes that count and their objects.
        outcomes: Outcomes of the set in all frames.
        frames: Indices of the frames to tally.
        ious: Thresholds, which the judge's detector must be matched at."""
    frame_outcomes = [outcomes[k] for k in frames.tolist()]
    tallies = []
    for iou in ious:
        iou_index = judge.detected.ious.index(iou)
        class_tallies = []
        for label, object_counts in judge.to_find.items():
            class_outcomes = [outcome.of_class(label) for outcome in frame_outcomes]
            class_tallies.append(Tally.of(class_outcomes, object_counts[frames], iou_index))
        tallies.append(class_tallies)
    return tallies


def one_stage(run: Run, name: str, frames: int) -> Callable[[str], Report | None]:
    """Return the argument `stage` of `Judge.judge_cases` that reports all work under one name.

    run: reports the stage; frames: number of frames to report."""
    return lambda _: run.stage(name, frames)


def judge_tallies(tallies: Sequence[Sequence[Tally]], classes: Classes, seed: int) -> Judgement:
    """Judge from tallies per IoU threshold and class; figures are means over the thresholds.

    Args:
        tallies: A list for each threshold, with a tally for each class.
        classes: The same classes, whose AP and recall are combined.
        seed: Seed of the bootstrap."""
    frames = len(tallies[0][0].truths)  # `truths` has the number of objects in each frame
    draws = intervals.block_draws(frames, seed=seed)
    return _build_judgement(_measure_tallies(tallies, classes, draws), classes)


def _measure_tallies(
    tallies: Sequence[Sequence[Tally]], classes: Classes, draws: Draws
) -> _Figures:
    """Return AP, recall, precision, objects, frames, and AP in each resample, in one row.

    They are means over the IoU thresholds. AP and recall are combined over the classes; precision
    is for the detections of all classes together, NaN without detections or objects.

    tallies: axes IoU threshold, class; draws: frames of each resample."""
    threshold_figures = []
    for class_tallies in tallies:
        class_aps = [tally.ap for tally in class_tallies]
        class_recalls = [tally.recall for tally in class_tallies]
        ap, recall = classes.combined(np.array([class_aps, class_recalls]))
        detections = sum(len(tally.hit) for tally in class_tallies)
        hits = sum(int(tally.hit.sum()) for tally in class_tallies)
        objects = sum(int(tally.truths.sum()) for tally in class_tallies)
        frames = len(class_tallies[0].truths)
        resamples = [tally.resamples(draws=draws) for tally in class_tallies]
        drawn_aps = classes.combined(np.stack(resamples, axis=1))
        precision = hits / detections if detections and objects else np.nan
        threshold_figures.append(np.array([ap, recall, precision, objects, frames, *drawn_aps]))
    return _reduce_cases(np.array(threshold_figures), "mean")


def _reduce_cases(
    figures: Float64[np.ndarray, "cases *rest figures"], by: Combine
) -> Float64[np.ndarray, "*rest figures"]:
    """Return all figures of the case with the lowest AP, or means of each figure over cases.

    Cases with undefined AP are never the worst, and NaNs are left out of means. Means have the
    number of objects and frames of the first case.

    figures: the first axis is reduced; the first column of the last axis is AP; by: "worst" or
    "mean"."""
    if by == "worst":
        ap = figures[..., :1]
        # index of the worst case; `None` keeps the axis of cases, for `take_along_axis`
        worst = np.where(np.isnan(ap), np.inf, ap).argmin(axis=0)[None]
        return np.take_along_axis(figures, worst, axis=0)[0]
    means = np.ma.masked_invalid(figures).mean(axis=0).filled(np.nan)
    means[..., COUNT_COLUMNS] = figures[0, ..., COUNT_COLUMNS]
    return means


def _build_judgement(figures: _Figures, classes: Classes) -> Judgement:
    """Return the result of one row of figures, with the interval of its AP.

    figures: AP, recall, precision, objects and frames, then AP in each resample; classes: classes
    over which the AP is combined."""
    ap, recall, precision, objects, frames = figures[: RESAMPLE_COLUMNS.start].tolist()
    drawn_aps = figures[RESAMPLE_COLUMNS]
    low, high = intervals.figure_interval(
        ap,
        drawn_aps,
        blocks=intervals.count_blocks(int(frames)),
        objects=int(objects),
        confidence=CONFIDENCE,
    )
    return Judgement(
        ap=ap,
        low=low,
        high=high,
        recall=recall,
        precision=None if np.isnan(precision) else precision,  # NaN: no detections or objects
        vehicles=int(objects),
        frames=int(frames),
        kind=CLASS_NOUNS[classes.names[0]] if len(classes) == 1 else "object",
    )


def state_figure(stage: str, judged: Judgement) -> StageFigure:
    """Return a judgement's AP as a figure to compare with other stages of the plan.

    stage: place of the figure in an error text, such as "in the judgement"."""
    return StageFigure(stage, ap=judged.ap, objects=judged.vehicles, frames=judged.frames)
