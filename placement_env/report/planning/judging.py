"""`Judge`: AP of sensor sets by the detector on new traffic, with resamples for intervals.

Figures come from a `CasesEvaluator`, without the share of intact AP that races add."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from placement_env.analysis.agreement import StageFigure
from placement_env.analysis.case_figures import CaseFigures, measure_tallies
from placement_env.analysis.intervals import Tally, block_draws
from placement_env.cases import TIE_SHARE, Cases
from placement_env.classes import Classes
from placement_env.defaults import USUAL_CASES
from placement_env.fidelity.detector import Detected, Outcome
from placement_env.fidelity.preparation import Preparation
from placement_env.report.content import CONFIDENCE, ClassAP, Judgement
from placement_env.search.portfolio.evaluators import (
    CasesEvaluator,
    DetectorEvaluator,
    Frames,
    Report,
)
from toolkit.arrays import Bool, Float64, Int64
from toolkit.objects import HEAVY, LABELS, known_labels
from toolkit.runtime.run import Run

# name of each class in sentences
CLASS_NOUNS = {name: "heavy vehicle" if name == LABELS[HEAVY] else name for name in LABELS}
DrawnAPs = Float64[np.ndarray, "n resamples"]  # AP of each set in each resample


# judges sets over cases, with a progress callback: results of the sets, and AP in each resample
JudgeDrawn = Callable[
    [Bool[np.ndarray, "n candidates"], Cases, Report | None], tuple[list[Judgement], DrawnAPs]
]


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

    Sets are rows of booleans over all candidates; members are the indices of one set's
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

    @property
    def absent_labels(self) -> tuple[str, ...]:
        """Names of the classes that count but have no object to find in any frame."""
        all_frames = range(self.frames)
        return tuple(
            LABELS[label]
            for label in self.detected.classes.labels
            if not self.detected.count_to_find(all_frames, label).any()
        )

    @property
    def evaluator(self) -> CasesEvaluator:
        """Evaluator for races of sets, over the same cases and drawings of the site."""
        return self._evaluator(self.cases, TIE_SHARE)

    def _evaluator(self, cases: Cases, tie: float = 0.0) -> CasesEvaluator:
        """Return an evaluator over some cases and all drawings of the site.

        A drawing fills in at random what no map knows of the site.

        Args:
            cases: Conditions (error profiles, failures, levels of traffic) to reduce over.
            tie: Share of the AP before failures that is added to the AP after them, so that sets
                that fail completely differ."""
        return CasesEvaluator(
            by_profile=tuple(
                DetectorEvaluator(detected, cases.ious, self.seed)
                for detected in self.profiles[: len(cases.profiles)]
            ),
            cases=cases,
            levels=self.levels if cases.levels > 1 else (),
            drawings=tuple(drawing._evaluator(cases, tie) for drawing in self.drawings),
            tie=tie,
        )

    @property
    def drawing_judges(self) -> "tuple[Judge, ...]":
        """Judges of one drawing of the site each: this judge's first, then the others."""
        return replace(self, drawings=()), *self.drawings

    def outcomes(self, members: tuple[int, ...], frames: Frames | None = None) -> list[Outcome]:
        """Return the detections of one set in each frame and the objects that they hit.

        They are at the first error profile. frames: numbers of the frames, None for all."""
        numbers = range(self.frames) if frames is None else frames.tolist()
        return self.detected.outcomes([members], numbers)[members]

    def kbit(
        self, members: tuple[int, ...], frames: Frames | None = None
    ) -> Float64[np.ndarray, "sensors frames"]:
        """Return the kbit that each sensor of one set sends in each frame, a row for each sensor.

        members: indices of the set's candidates, in the order of the rows; frames: numbers of the
        frames, None for all."""
        outcomes = self.outcomes(members, frames)
        return np.array([outcome.bits for outcome in outcomes], np.float64).T / 1000

    def judge(
        self,
        sets: Bool[np.ndarray, "n candidates"],
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
        self, sets: Bool[np.ndarray, "n candidates"], cases: Cases, progress: Report | None = None
    ) -> tuple[list[Judgement], DrawnAPs]:
        """Judge sets over cases; return one result for each set, and AP in each resample.

        A resample has the same frames for all sets, so that they can be compared draw by draw.
        Figures are means over the drawings of the site.

        Args:
            sets: A row of booleans over all candidates for each set.
            cases: Conditions (error profiles, failures, levels of traffic) to reduce over.
            progress: Called with the number of frames done."""
        if not len(sets):
            return [], np.empty((0, 0))
        figures = self.evaluate(sets, cases, np.arange(self.frames), progress)
        judgements = [self._build_judgement(figures[n]) for n in range(len(sets))]
        return judgements, figures.resamples

    def evaluate(
        self,
        sets: Bool[np.ndarray, "n candidates"],
        cases: Cases,
        frames: Frames,
        progress: Report | None = None,
    ) -> CaseFigures:
        """Return the figures of sets over cases in some frames, with AP in each resample.

        Args:
            sets: A row of booleans over all candidates for each set.
            cases: Conditions (error profiles, failures, levels of traffic) to reduce over.
            frames: Numbers of the frames.
            progress: Called with the number of frames done."""
        return self._evaluator(cases).evaluate(sets, frames, progress)

    def _build_judgement(self, figures: CaseFigures) -> Judgement:
        """Return the result of one set from its figures."""
        return build_judgement(figures, np.arange(self.frames), self.detected.classes)

    def judge_cases(
        self,
        sets: Bool[np.ndarray, "n candidates"],
        stage: Callable[[str], Report | None] = lambda _: None,
        judge_drawn: JudgeDrawn | None = None,
    ) -> tuple[list[SetJudgement], DrawnAPs]:
        """Judge sets intact and in all requested cases.

        The kinds of cases are levels of traffic, failures and error profiles. Sets are compared by
        the result of the last requested one in this order, else by the intact result
        (`SetJudgement.counted`). The AP in that result of each set in each resample comes back,
        too, with the axes set and resample.

        sets: a row of booleans over all candidates for each set; stage: called with the name of
        each stage of the work ("chosen set", "failures", "errors"; levels have none), returns a
        function to call with the number of frames done, or None; judge_drawn: judges sets over one
        kind of case, as `Judge.judge_drawn` does, which is used if it is None."""
        judge_drawn = judge_drawn or self.judge_drawn
        first_profile = replace(self.cases, errors=self.cases.profiles[0])
        # the last kind of case that was requested gives the draws, as in `SetJudgement.counted`
        intact, draws = judge_drawn(sets, self.intact, stage("chosen set"))
        # results of each set, None for kinds of cases that were not requested
        after_failures: Sequence[Judgement | None] = [None] * len(sets)
        over_levels = after_failures
        over_errors = after_failures
        if self.levels:
            over_levels, draws = judge_drawn(sets, replace(first_profile, failing=0), None)
        if first_profile.failing:
            after_failures, draws = judge_drawn(sets, first_profile, stage("failures"))
        if len(self.profiles) > 1:
            over_errors, draws = judge_drawn(sets, self.cases, stage("errors"))
        # in the order of the fields of `SetJudgement`
        rows = zip(intact, after_failures, over_levels, over_errors, strict=True)
        return [SetJudgement(*judgements) for judgements in rows], draws

    def by_level(self, members: tuple[int, ...]) -> list[Judgement | None]:
        """Judge one set without failures at each level of traffic, at the first error profile.

        Thin traffic comes first. A level without objects has None; undivided traffic has no levels.

        members: indices of the set's candidates."""
        evaluator = self._evaluator(self.intact).by_profile[0]
        judgements: list[Judgement | None] = []
        for level_frames in self.levels:
            figures = CaseFigures(evaluator.measure(self._list_row(members), level_frames)[0])
            # AP is undefined without objects
            is_defined = not np.isnan(figures.ap)
            judgements.append(self._build_judgement(figures) if is_defined else None)
        return judgements

    def _list_row(self, members: tuple[int, ...]) -> Bool[np.ndarray, "1 candidates"]:
        # one set as a row over all candidates; members: indices of its candidates
        return np.isin(np.arange(len(self.detected.renders.sensors)), members)[None]

    def by_errors(self, members: tuple[int, ...]) -> dict[str, Judgement]:
        """Judge one set at each error profile, by its name; empty if there is one profile.

        Failures and levels of traffic are reduced as the cases ask. If the plan has several random
        variants of the site (`drawings`), only the first one counts.

        members: indices of the set's candidates."""
        if len(self.profiles) == 1:
            return {}
        evaluator = replace(self._evaluator(self.cases), drawings=())
        figures = evaluator.at_profiles(self._list_row(members), np.arange(self.frames))
        # index 0: the only set
        return {
            name: self._build_judgement(figures[k][0]) for k, name in enumerate(self.cases.names)
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
        class_aps = []
        evaluator = DetectorEvaluator(self.detected, self.cases.ious, self.seed)
        truths = evaluator.count_by_class(np.arange(self.frames))
        tallies = evaluator.tally(self.outcomes(members), truths)
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
    figures = CaseFigures(measure_tallies(tallies, classes, block_draws(frames, seed=seed)))
    return build_judgement(figures, np.arange(frames), classes)


def build_judgement(figures: CaseFigures, frames: Frames, classes: Classes) -> Judgement:
    """Return the result of one set from its figures, with the interval of its AP.

    frames: numbers of all frames that were evaluated; classes: over which AP is combined."""
    low, high = figures.interval(frames, confidence=CONFIDENCE)
    precision = float(figures.precision)
    return Judgement(
        ap=float(figures.ap),
        low=low,
        high=high,
        recall=float(figures.recall),
        precision=None if np.isnan(precision) else precision,  # NaN: no detections or objects
        vehicles=int(figures.objects),
        frames=int(figures.frames),
        kind=CLASS_NOUNS[classes.names[0]] if len(classes) == 1 else "object",
    )


def state_figure(stage: str, judged: Judgement) -> StageFigure:
    """Return a judgement's AP as a figure to compare with other stages of the plan.

    stage: place of the figure in an error text, such as "in the judgement"."""
    return StageFigure(stage, ap=judged.ap, objects=judged.vehicles, frames=judged.frames)
