"""Evaluating sensor sets by the detector on new traffic, and choosing among the entrants.

AP and its resamples are reduced over the cases as in `placement_env.cases`. Every resample has its
worst case. Recall, precision and counts come from the worst case, or are means over cases.

Sets of one size race each other until the best of them is known well enough
(`placement_env.racing.race_until`), from the largest size down, until fewer sensors fall far
behind. The winner of each size, and others near the best of all, are judged on all frames. Among
those whose AP is within `NEAR_TIE_AP` of the highest, the best set has the greatest mean AP over
the detector's IoU thresholds.

Without a requirement the answer is the cheapest set that is as good as the best (`is_as_good`: on
the same frames, its whole interval of the loss is within the tolerance). With a requirement it is
the cheapest set whose AP reaches it; sets are judged by price until one does. If none does, it is
the best set. AP is always over the cases of the plan (`PlanOption.counted`)."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from placement_env.analysis import intervals
from placement_env.analysis.agreement import StageFigure, check_agreement
from placement_env.analysis.intervals import BLOCK_FRAMES, Draws, Resamples, Tally
from placement_env.analysis.shrinkage import shrink
from placement_env.candidates.candidates import name_sensor
from placement_env.cases import USUAL_CASES, Cases
from placement_env.classes import Classes, Combine
from placement_env.fidelity.detector import Detected, Outcome
from placement_env.fidelity.preparation import Preparation
from placement_env.objective import Objective
from placement_env.racing import Contest
from placement_env.report.content import CONFIDENCE, ClassAP, DrawingResult, Judgement, PlanOption
from placement_env.search.exact.exhaustive import find_front
from placement_env.search.portfolio.entrants import Entrants
from placement_env.search.portfolio.evaluators import (
    CasesEvaluator,
    DetectorEvaluator,
    Report,
    race_order,
)
from placement_env.search.portfolio.portfolio import NEAR_TIE_AP, contest
from toolkit.arrays import Bool, Float64, Int64
from toolkit.objects import HEAVY, LABELS, known_labels
from toolkit.runtime.run import Run

NOUNS = {name: "heavy vehicle" if name == LABELS[HEAVY] else name for name in LABELS}
COUNTS = slice(3, 5)  # vehicles and frames, after AP, recall and precision
DRAWS = slice(5, None)  # the AP of each resample, last
MAX_RACED_FRAMES = 60  # frames of a race
MAX_RIVALS = 3  # sets of each size that are judged on all frames if they come `NEAR_AP` the best
NEAR_AP = 0.03  # below the best of a race, which further frames may make up for
LIKELY_TIE_AP = 2 * NEAR_TIE_AP  # below a race's winner; mean AP over IoU decides who is judged too
FIRST_LOOK_FRAMES = 12  # frames of the first look at all sets that may reach a requirement
FIRST_LOOK_ERROR_AP = 0.1  # by which the first look may underrate a set

# AP, recall, precision, vehicles, frames; AP of each resample
_Figures = Float64[np.ndarray, "*cases figures"]
Rule = Literal["best", "as good", "cheapest", "none"]


class SetJudgement(NamedTuple):
    """Judgement of a set, intact and in the requested cases.

    The fields are those in `PlanOption`; cases that were not requested are None."""

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
    """The detector on one part of the traffic.

    Attributes:
        profiles: The detector at each error profile, matched at all IoU thresholds of the cases.
        cases: Cases over which sets are judged.
        seed: Seed of the bootstrap.
        levels: Frames of each level of traffic, empty if traffic is undivided.
        drawings: Judges of the same candidates at other drawings of the site. Figures of sets are
            means over all drawings."""

    profiles: tuple[Detected, ...]
    cases: Cases = USUAL_CASES
    seed: int = 0
    levels: tuple[Int64[np.ndarray, " _"], ...] = ()
    drawings: "tuple[Judge, ...]" = ()

    @classmethod
    def from_preparation(cls, prepared: Preparation, seed: int) -> "Judge":
        """Return a judge on the traffic of a preparation."""
        cases = prepared.setting.cases
        profiles = [
            prepared.detected(errors).at(cases.ious[0], cases.ious) for errors in cases.profiles
        ]
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
        """Cases without failures and levels, at the first error profile."""
        return replace(self.cases, failing=0, levels=1, errors=self.cases.profiles[0])

    @cached_property
    def to_find(self) -> dict[int, Int64[np.ndarray, " frames"]]:
        """Number of objects to find, per frame and class."""
        counts = {}
        for label in self.detected.classes.labels:
            frame_counts = [self.detected.to_find(k, label).sum() for k in range(self.frames)]
            counts[label] = np.array(frame_counts, np.int64)
        return counts

    @property
    def absent(self) -> tuple[str, ...]:
        """Classes that count but have no object to find."""
        return tuple(LABELS[label] for label, counts in self.to_find.items() if not counts.any())

    @property
    def evaluator(self) -> CasesEvaluator:
        """Evaluator for races of sets, over the same cases."""
        profiles = tuple(
            DetectorEvaluator(detected, self.cases.ious, self.seed) for detected in self.profiles
        )
        drawings = tuple(drawing.evaluator for drawing in self.drawings)
        return CasesEvaluator(profiles, self.cases, self.levels, drawings)

    @property
    def alone(self) -> "tuple[Judge, ...]":
        """Separate judge of each drawing of the site."""
        return replace(self, drawings=()), *self.drawings

    def outcomes(self, members: tuple[int, ...]) -> list[Outcome]:
        """Return the outcomes of one set in every frame."""
        return self.detected.outcomes([members], range(self.frames))[members]

    def kbit(self, members: tuple[int, ...]) -> Float64[np.ndarray, "k frames"]:
        """Return the kbit that each sensor of one set sends in every frame."""
        return np.array([outcome.bits for outcome in self.outcomes(members)], np.float64).T / 1000

    def judge(
        self,
        sets: Bool[np.ndarray, "n C"],
        cases: Cases | None = None,
        *,
        progress: Report | None = None,
    ) -> list[Judgement]:
        """Judge sets over cases, by default `intact`.

        progress: called with the number of frames done."""
        return self.judge_drawn(sets, cases or self.intact, progress)[0]

    def judge_drawn(
        self, sets: Bool[np.ndarray, "n C"], cases: Cases, progress: Report | None = None
    ) -> tuple[list[Judgement], _Figures]:
        """Judge sets over cases, and return the AP of each resample too.

        A resample has the same frames for all sets."""
        if not len(sets):
            return [], np.empty((0, 0))
        drawings = [drawing._at_profiles(sets, cases, progress) for drawing in self.alone]
        mean_figures = _reduce(np.array(drawings), "mean")
        figures = _reduce(mean_figures, cases.errors_by)
        figures[..., DRAWS] = cases.over_errors(mean_figures[..., DRAWS])
        judgements = [_judgement(set_figures, self.detected.classes) for set_figures in figures]
        return judgements, figures[..., DRAWS]

    def judge_cases(
        self, sets: Bool[np.ndarray, "n C"], stage: Callable[[str], Report | None] = lambda _: None
    ) -> tuple[list[SetJudgement], _Figures]:
        """Judge sets intact and in all cases.

        stage: returns a progress callback for a name. Also returns the compared AP of each set in
        each resample, [n, resamples]."""
        first = replace(self.cases, errors=self.cases.profiles[0])
        judged, draws = self.judge_drawn(sets, self.intact, stage("chosen set"))
        left: Sequence[Judgement | None] = [None] * len(sets)
        over_levels = left
        over_errors = left
        if self.levels:
            over_levels, draws = self.judge_drawn(sets, replace(first, failing=0))
        if first.failing:
            left, draws = self.judge_drawn(sets, first, stage("failures"))
        if len(self.profiles) > 1:
            over_errors, draws = self.judge_drawn(sets, self.cases, stage("errors"))
        rows = zip(judged, left, over_levels, over_errors, strict=True)
        return [SetJudgement(*judgements) for judgements in rows], draws

    def by_level(self, members: tuple[int, ...]) -> list[Judgement | None]:
        """Judge one intact set at each level of traffic. None for a level without objects."""
        judgements: list[Judgement | None] = []
        for level_frames in self.levels:
            figures = self._draw(self.outcomes(members), level_frames, self.cases.ious)
            has_objects = not np.isnan(figures[0])
            judgements.append(_judgement(figures, self.detected.classes) if has_objects else None)
        return judgements

    def by_errors(self, members: tuple[int, ...]) -> dict[str, Judgement]:
        """Judge one set at each error profile, by name."""
        if len(self.profiles) == 1:
            return {}
        is_member = np.isin(np.arange(len(self.detected.renders.sensors)), members)[None]
        figures = self._at_profiles(is_member, self.cases)[:, 0]
        return {
            name: _judgement(profile_figures, self.detected.classes)
            for name, profile_figures in zip(self.cases.names, figures, strict=True)
        }

    def of_classes(self, classes: Classes) -> "Judge":
        """Return a judge of other classes at the first error profile."""
        profiles = (self.detected.of_classes(classes),)
        return replace(self, profiles=profiles, cases=self.intact, levels=(), drawings=())

    def by_class(self, members: tuple[int, ...]) -> tuple[ClassAP, ...]:
        """Judge one set for each class that counts."""
        classes = self.detected.classes
        all_frames = np.arange(self.frames)
        class_aps = []
        tallies = self._tally(self.outcomes(members), all_frames, self.cases.ious)
        for k, (name, weight) in enumerate(zip(classes.names, classes.weights, strict=True)):
            tallies_of_class = [[class_tallies[k]] for class_tallies in tallies]
            judgement = judge_tallies(tallies_of_class, Classes((name,)), self.seed)
            class_aps.append(ClassAP(name, weight, self.cases.class_ious(classes, name), judgement))
        return tuple(class_aps)

    def by_other_class(self, members: tuple[int, ...]) -> tuple[ClassAP, ...]:
        """Judge one set for each present class that the detector knows but that does not count."""
        detector_labels = known_labels(self.detected.detector) or ()
        names = self.detected.classes.names
        other_labels = tuple(
            name for name in LABELS if name in detector_labels and name not in names
        )
        rows = self.of_classes(Classes(other_labels)).by_class(members) if other_labels else ()
        return tuple(replace(row, weight=0.0) for row in rows if row.judged.vehicles)

    def _at_profiles(
        self, sets: Bool[np.ndarray, "n C"], cases: Cases, progress: Report | None = None
    ) -> Float64[np.ndarray, "profiles n figures"]:
        """Return the figures of sets at each error profile, over thresholds, levels, failures."""
        rows, owners = cases.expand(sets)
        unique_rows, row_index = np.unique(rows, axis=0, return_inverse=True)
        members = [tuple(np.flatnonzero(row).tolist()) for row in unique_rows]
        levels = self.levels if cases.levels > 1 else (np.arange(self.frames),)
        profile_figures = []
        for detected in self.profiles[: len(cases.profiles)]:
            outcomes = detected.outcomes(members, range(self.frames), progress)
            member_outcomes = [outcomes[row_members] for row_members in members]
            profile_figures.append(
                [self._draw_sets(member_outcomes, frames, cases.ious) for frames in levels]
            )
        # axes: profile, level, row, figure
        figures = np.array(profile_figures)[:, :, row_index.reshape(-1)]
        reduced = _reduce(np.moveaxis(figures, 1, 0), cases.levels_by)
        if cases.levels_by == "mean":
            counts = np.where(np.isnan(figures[..., :1]), 0, figures[..., COUNTS])
            reduced[..., COUNTS] = counts.sum(axis=1)
        if cases.failing:
            set_figures = []
            for number in range(len(sets)):
                failure_rows = np.flatnonzero(owners == number)[1:]  # the first is the set itself
                over_failures = np.moveaxis(reduced[:, failure_rows], 1, 0)
                set_figures.append(_reduce(over_failures, cases.failures))
            reduced = np.stack(set_figures, axis=1)
        reduced[..., DRAWS] = cases.at_profiles(figures[:, :, None, :, DRAWS], owners, tie=0.0)
        return reduced

    def _draw_sets(
        self,
        set_outcomes: Sequence[Sequence[Outcome]],
        frames: Int64[np.ndarray, " _"],
        ious: Sequence[float],
    ) -> list[_Figures]:
        return [self._draw(outcomes, frames, ious) for outcomes in set_outcomes]

    def _draw(
        self, outcomes: Sequence[Outcome], frames: Int64[np.ndarray, " _"], ious: Sequence[float]
    ) -> _Figures:
        """Return the figures of one set in some frames, with resamples of their blocks."""
        draws = intervals.draws_of_blocks(frames // BLOCK_FRAMES, seed=self.seed)
        return _draw_tallies(self._tally(outcomes, frames, ious), self.detected.classes, draws)

    def _tally(
        self, outcomes: Sequence[Outcome], frames: Int64[np.ndarray, " _"], ious: Sequence[float]
    ) -> list[list[Tally]]:
        """Tally the outcomes of one set in some frames, per IoU and class."""
        frame_outcomes = [outcomes[k] for k in frames.tolist()]
        tallies = []
        for iou in ious:
            iou_index = self.detected.ious.index(iou)
            class_tallies = []
            for label, count in self.to_find.items():
                class_outcomes = [outcome.of_class(label) for outcome in frame_outcomes]
                class_tallies.append(Tally.of(class_outcomes, count[frames], iou_index))
            tallies.append(class_tallies)
        return tallies


def one_stage(run: Run, name: str, frames: int) -> Callable[[str], Report | None]:
    """Return what makes the callback of `Judge.judge_cases`: every part of its work counts as one
    stage."""
    return lambda _: run.stage(name, frames)


def judge_tallies(tallies: Sequence[Sequence[Tally]], classes: Classes, seed: int) -> Judgement:
    """Judge from a tally of each class at each IoU threshold, averaged over the thresholds."""
    draws = intervals.block_draws(len(tallies[0][0].truths), seed=seed)
    return _judgement(_draw_tallies(tallies, classes, draws), classes)


def _draw_tallies(tallies: Sequence[Sequence[Tally]], classes: Classes, draws: Draws) -> _Figures:
    threshold_figures = []
    for class_tallies in tallies:
        class_aps = [tally.ap for tally in class_tallies]
        class_recalls = [tally.recall for tally in class_tallies]
        ap, recall = classes.combined(np.array([class_aps, class_recalls]))
        detections = sum(len(tally.hit) for tally in class_tallies)
        hits = sum(int(tally.hit.sum()) for tally in class_tallies)
        truths = sum(int(tally.truths.sum()) for tally in class_tallies)
        frames = len(class_tallies[0].truths)
        resamples = [tally.resamples(draws=draws) for tally in class_tallies]
        drawn_aps = classes.combined(np.stack(resamples, axis=1))
        precision = hits / detections if detections and truths else np.nan
        threshold_figures.append(np.array([ap, recall, precision, truths, frames, *drawn_aps]))
    return _reduce(np.array(threshold_figures), "mean")


def _reduce(
    figures: Float64[np.ndarray, "cases *rest figures"], by: Combine
) -> Float64[np.ndarray, "*rest figures"]:
    """Return the figures of the case with the lowest AP, or means over cases, without NaN."""
    if by == "worst":
        ap = figures[..., :1]
        worst = np.where(np.isnan(ap), np.inf, ap).argmin(axis=0)[None]
        return np.take_along_axis(figures, worst, axis=0)[0]
    mean = np.ma.masked_invalid(figures).mean(axis=0).filled(np.nan)
    mean[..., COUNTS] = figures[0, ..., COUNTS]
    return mean


def _judgement(figures: _Figures, classes: Classes) -> Judgement:
    ap, recall, precision, vehicles, frames = figures[: DRAWS.start].tolist()
    counts = {"blocks": intervals.count_blocks(int(frames)), "objects": int(vehicles)}
    low, high = intervals.figure_interval(ap, figures[DRAWS], **counts, confidence=CONFIDENCE)
    kind = NOUNS[classes.names[0]] if len(classes) == 1 else "object"
    defined = None if np.isnan(precision) else precision
    return Judgement(ap, low, high, recall, defined, int(vehicles), int(frames), kind)


def state_figure(stage: str, judged: Judgement) -> StageFigure:
    """Return a judgement's AP as a figure to compare with other stages."""
    return StageFigure(stage, judged.ap, judged.vehicles, judged.frames)


@dataclass(frozen=True, eq=False)
class Choice:
    """The answer among options: all entrants in their order, judged or not.

    Attributes:
        options: Every entrant.
        sets: Members of each entrant.
        chosen: Index of the answer.
        best: Index of the best set.
        alike: Indices of sets as good as the best, without the answer.
        rule: Rule by which the answer was chosen.
        confidence: Probability that no set of as many sensors is better than the answer by more
            than `AP_TOLERANCE`, on all frames of the comparison. None without a race, as when sets
            were judged by price, and with too few frames or objects."""

    options: tuple[PlanOption, ...]
    sets: Bool[np.ndarray, "n C"]
    chosen: int
    best: int
    alike: tuple[int, ...]
    rule: Rule
    confidence: float | None = None

    @property
    def option(self) -> PlanOption:
        """The answer."""
        return self.options[self.chosen]

    @property
    def members(self) -> tuple[int, ...]:
        """Indices of the candidates of the answer, ascending."""
        return tuple(np.flatnonzero(self.sets[self.chosen]).tolist())

    @property
    def near_optimal(self) -> tuple[PlanOption, ...]:
        """Sets that are as good as the best, cheap ones first."""
        return tuple(sorted((self.options[i] for i in self.alike), key=_thrift))


def choose_at_drawings(
    judge: Judge, choice: Choice, min_ap: float | None
) -> tuple[DrawingResult, ...]:
    """Judge the answer, and choose among the judged sets, at each drawing of the site."""
    if not judge.drawings:
        return ()
    rows = [i for i, option in enumerate(choice.options) if option.judged is not None]
    sets = choice.sets[rows]
    results = []
    for drawing in judge.alone:
        judgements, draws = drawing.judge_cases(sets)
        mean_aps = drawing.evaluator.mean_ap(sets, np.arange(drawing.frames)).tolist()
        options = [
            replace(choice.options[i], mean_ap=mean_aps[n], **judgements[n]._asdict())
            for n, i in enumerate(rows)
        ]
        answer = choose(options, dict(enumerate(draws)))[1][0]
        if min_ap is not None:
            reaching = [n for n, judged in enumerate(judgements) if judged.counted.ap >= min_ap]
            answer = min(reaching, key=lambda n: _thrift(options[n]), default=answer)
        judgement = judgements[rows.index(choice.chosen)].counted
        results.append(DrawingResult(judgement, options[answer].poles))
    return tuple(results)


class _Options:
    """Options of a choice, which are judged on demand."""

    def __init__(self, objective: Objective, entrants: Entrants, judge: Judge) -> None:
        self.objective = objective
        self.entrants = entrants
        self.judge = judge
        self.draws: dict[int, Resamples] = {}
        self.options: list[PlanOption] = []
        mounts = objective.candidates.mounts
        for i, is_member in enumerate(entrants.sets):
            score = objective.score(np.flatnonzero(is_member))
            mount_indices = objective.candidates.mount[list(score.subset)]
            option = PlanOption(
                sensors=tuple(name_sensor(objective.names[c]) for c in score.subset),
                price=score.price,
                kbit_per_sensor=score.kbit_per_sensor,
                kbit=score.kbit,
                # as by its search: scored together with other sets it may round differently
                predicted=round(float(entrants.predicted[i]), 6),
                judged=None,
                searches=entrants.searches[i],
                poles=tuple(mounts[m].name for m in mount_indices),
            )
            self.options.append(option)

    def judge_rows(self, rows: Sequence[int], run: Run = Run()) -> None:
        """Judge sets on all frames, unless they are judged. run: reports the frames done."""
        new_rows = [i for i in rows if i not in self.draws]
        if not new_rows:
            return
        new_sets = self.entrants.sets[new_rows]
        stage = one_stage(run, "frames of the closest sets", self.judge.frames)
        judged_sets, draws = self.judge.judge_cases(new_sets, stage)
        all_frames = np.arange(self.judge.frames)
        mean_aps = self.judge.evaluator.mean_ap(new_sets, all_frames).tolist()
        for k, i in enumerate(new_rows):
            members = tuple(np.flatnonzero(self.entrants.sets[i]).tolist())
            self.options[i] = replace(
                self.options[i],
                mean_ap=mean_aps[k],
                fits_links=self.objective.fits_links(members, self.judge.kbit(members)),
                **judged_sets[k]._asdict(),
            )
            self.draws[i] = draws[k]

    def check_race(self, row: int, ap: float, frames: Int64[np.ndarray, " k"]) -> None:
        """Raise ValueError if a judged set had quite another AP in its race.

        The worst of several cases is lower on few frames, so it is not compared."""
        option = self.options[row]
        counted = option.judged
        if counted is not None and self.judge.cases.plain and len(self.judge.profiles) == 1:
            objects = self.judge.evaluator.count_objects(frames)
            raced = StageFigure("in the race", ap, objects, len(frames))
            check_agreement(option.sensors, raced, state_figure("in the comparison", counted))

    def measure_sureness(
        self, row: int, size_rows: Int64[np.ndarray, " k"], race: Contest | None
    ) -> float | None:
        """Return the probability that no set of as many sensors is better than a judged one.

        Better means by more than `AP_TOLERANCE`. Judged sets count with all frames, the others with
        the frames of their last rung. size_rows: rows of the sets of this size; race: their race.
        Returns None without a race, and with too few frames or objects."""
        counted = self.options[row].counted
        if race is None or counted is None:
            return None
        if not intervals.is_comparable(counted.frames, counted.vehicles):
            return None
        judged_rows = [i for i in size_rows.tolist() if i in self.draws]
        judgements = [self.options[i].counted for i in judged_rows]
        aps = np.array([judgement.ap for judgement in judgements if judgement])
        draws = np.stack([self.draws[i] for i in judged_rows])
        predicted = self.entrants.predicted[judged_rows]
        blocks = intervals.count_blocks(counted.frames)
        likely_aps = shrink(aps, draws, predicted, blocks).resamples
        gains = likely_aps - likely_aps[judged_rows.index(row)]
        is_better = gains > intervals.AP_TOLERANCE
        raced_rows = np.searchsorted(size_rows, [row, *judged_rows])
        dropped_doubt = race.doubt(int(raced_rows[0]), raced_rows[1:].tolist())
        return max(0.0, 1 - float(is_better.any(axis=0).mean()) - dropped_doubt)


def choose_set(
    objective: Objective,
    entrants: Entrants,
    judge: Judge,
    *,
    min_ap: float | None = None,
    confidence: float = 0.95,
    run: Run = Run(),
) -> Choice:
    """Choose among the entrants, at least one.

    confidence: confidence at which a race of one size ends."""
    options = _Options(objective, entrants, judge)
    if min_ap is not None and (reached := _find_cheapest(options, min_ap, run)) is not None:
        return Choice(tuple(options.options), entrants.sets, reached, reached, (), "cheapest")
    races = _race_sizes(options, confidence, run)
    sizes = entrants.sets.sum(axis=1)
    order = race_order(judge.frames, seed=run.seed)
    options.judge_rows(races.list_rows(), run)
    for race, winner in races.by_size.values():
        options.check_race(winner, float(race.figures[0]), order[: race.frames[0]])
    best, alike = choose(options.options, options.draws)
    answer = best
    rule: Rule = "best" if min_ap is None else "none"
    if min_ap is None and alike[0] != best:
        answer = alike[0]
        rule = "as good"
    near_options = tuple(i for i in alike if i != answer)
    size_rows = np.flatnonzero(sizes == sizes[answer])
    size_race = races.by_size.get(int(sizes[answer]))
    answer_race = None if size_race is None else size_race.race
    sureness = options.measure_sureness(answer, size_rows, answer_race)
    return Choice(tuple(options.options), entrants.sets, answer, best, near_options, rule, sureness)


class _SizeRace(NamedTuple):
    """Race of the sets of one size, and the row of its winner."""

    race: Contest
    winner: int


@dataclass(frozen=True)
class _SizeRaces:
    """Races of all sizes.

    by_size: races that were run; winners: row of the winner of each size; close_sets: expected AP
    and row of winners and their rivals."""

    by_size: dict[int, _SizeRace]
    winners: list[int]
    close_sets: list[tuple[float, int]]

    def list_rows(self) -> list[int]:
        """List the rows of all winners, and of rivals near the best of all races."""
        min_expected = max(self.close_sets)[0] - NEAR_AP
        near_rows = [row for expected, row in self.close_sets if expected >= min_expected]
        return list(dict.fromkeys([*self.winners, *near_rows]))


def _race_sizes(options: _Options, confidence: float, run: Run) -> _SizeRaces:
    """Race the sets of each size, the largest size first.

    Once the winner of a size is far behind the best of all, smaller sets fall further behind: then
    the set with the highest prediction is taken without a race."""
    entrants = options.entrants
    evaluator = options.judge.evaluator
    order = race_order(options.judge.frames, seed=run.seed)
    races = _SizeRaces({}, [], [])
    sizes = entrants.sets.sum(axis=1)
    different_sizes = np.unique(sizes)[::-1]
    report = run.stage("set sizes compared", len(different_sizes))
    winner_ap = math.inf  # expected AP of the last race's winner
    for step, size in enumerate(different_sizes, 1):
        size_rows = np.flatnonzero(sizes == size)
        if races.close_sets and winner_ap < max(races.close_sets)[0] - NEAR_AP:
            best = size_rows[int(entrants.predicted[size_rows].argmax())]
            races.winners.append(int(best))
        else:
            race = contest(
                options.objective,
                entrants.sets[size_rows],
                evaluator,
                confidence=confidence,
                seed=run.seed,
                frames=MAX_RACED_FRAMES,
            )
            rows = size_rows[race.ranking]
            rivals = _find_rivals(race, entrants.sets[rows], evaluator, order)
            expected_aps = race.expected[rivals].tolist()
            races.close_sets.extend(zip(expected_aps, rows[rivals].tolist(), strict=True))
            races.winners.append(int(rows[0]))
            races.by_size[int(size)] = _SizeRace(race, int(rows[0]))
            winner_ap = float(race.expected[0])
        if report is not None:
            report(step)
    return races


def _find_rivals(
    race: Contest,
    ranked: Bool[np.ndarray, "n C"],
    evaluator: CasesEvaluator,
    order: Int64[np.ndarray, " frames"],
) -> Int64[np.ndarray, " k"]:
    """Return the ranks of the winner of a race and its `MAX_RIVALS` - 1 likeliest rivals.

    Rivals are ordered by mean AP over IoU, then by rank. The mean AP is on the frames of the first
    rung, which all sets share."""
    tied = np.flatnonzero(race.expected >= race.expected[0] - LIKELY_TIE_AP)[1:]
    mean_aps = np.empty(0)
    if len(tied):
        mean_aps = evaluator.mean_ap(ranked[tied], order[: race.frames.min()])
    by_mean = tied[np.argsort(-mean_aps, kind="stable")]
    ranks = list(dict.fromkeys([0, *by_mean.tolist(), *range(len(ranked))]))
    return np.array(ranks[:MAX_RIVALS], np.int64)


def _find_cheapest(options: _Options, min_ap: float, run: Run) -> int | None:
    """Return the cheapest set whose AP reaches the requirement, None without one.

    Sets are judged by price until one reaches it."""
    entrants = options.entrants
    judge = options.judge
    order = race_order(judge.frames, seed=run.seed)[:FIRST_LOOK_FRAMES]
    report = run.stage("frames of the first look", len(order))
    first_look = judge.evaluator.evaluate(entrants.sets, order, report)
    blocks = len(np.unique(order // BLOCK_FRAMES))
    shrunk = shrink(first_look.ap, first_look.resamples, entrants.predicted, blocks)
    expected_aps = shrunk.figure
    prices = np.array([option.price for option in options.options])
    rows = np.lexsort((-expected_aps, prices)).tolist()
    report = run.stage("sets judged by price", len(rows))
    for step, i in enumerate(rows, 1):
        if expected_aps[i] >= min_ap - FIRST_LOOK_ERROR_AP:
            options.judge_rows([i])
            counted = options.options[i].counted
            if counted is not None and counted.ap >= min_ap and options.options[i].fits_links:
                return i
        if report is not None:
            report(step)
    return None


def _thrift(option: PlanOption) -> tuple[float, int, float, float]:
    return option.price, len(option.sensors), -(option.mean_ap or 0.0), option.kbit_per_sensor


def choose(
    options: Sequence[PlanOption], draws: Mapping[int, Resamples]
) -> tuple[int, tuple[int, ...]]:
    """Return the index of the best option, and of all options as good as it, cheap ones first.

    The best option is among both. Options with too narrow links are left out, unless all have
    them. draws: resampled AP of each judged option, on the same frames."""
    judged = {i: counted for i in sorted(draws) if (counted := options[i].counted) is not None}
    fitting = {i: counted for i, counted in judged.items() if options[i].fits_links}
    judged = fitting or judged
    highest_ap = max(judgement.ap for judgement in judged.values())
    close = [i for i, judgement in judged.items() if judgement.ap >= highest_ap - NEAR_TIE_AP]
    best = min(close, key=lambda i: (-(options[i].mean_ap or 0.0), *_thrift(options[i])))
    blocks = intervals.count_blocks(judged[best].frames)
    alike = [i for i in judged if i == best or intervals.is_as_good(draws[i], draws[best], blocks)]
    return best, tuple(sorted(alike, key=lambda i: (*_thrift(options[i]), i != best)))


def find_front_options(options: tuple[PlanOption, ...]) -> tuple[PlanOption, ...]:
    """Return the judged sets that no other beats in AP, kbit per sensor and price together."""
    judged_options = [(option, option.counted) for option in options if option.counted is not None]
    figures = [
        (-judgement.ap, option.kbit_per_sensor, option.price)
        for option, judgement in judged_options
    ]
    front = [judged_options[i] for i in find_front(np.array(figures).reshape(-1, 3))]
    front.sort(key=lambda pair: (pair[0].price, pair[1].ap))
    return tuple(option for option, _ in front)
