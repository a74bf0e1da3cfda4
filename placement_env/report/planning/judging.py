"""Judging sensor sets by the detector on traffic new to all searches, and choosing among the
entrants.

AP and its resamples are reduced over the cases as `placement_env.cases` says; in every resample the
worst case is that of the resample. Recall, precision and counts are those of the worst case, or
means over cases.

Sets of one size race each other until the best of them is known well enough
(`placement_env.racing.race_until`), so that small and cheap sets stay in, until fewer sensors fall
far behind; the winner of each size, and others near the best of all, are judged on all frames. The
best of them has the greatest mean AP over the detector's IoU thresholds of those whose AP is within
`NEAR_TIE` of the highest. Without a requirement the answer is the cheapest set that cannot be told
from it (`is_as_good`: on the same frames, its whole interval of the loss lies within the
tolerance). With one it is the cheapest set whose AP reaches it; sets are judged by price until one
does. If none does, it is the best set. AP is that over the cases of the plan
(`PlanOption.counted`)."""

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
from placement_env.search.portfolio.portfolio import NEAR_TIE, contest
from toolkit.arrays import Bool, Float64, Int64
from toolkit.objects import HEAVY, LABELS, known_labels
from toolkit.runtime.run import Run

NOUNS = {name: "heavy vehicle" if name == LABELS[HEAVY] else name for name in LABELS}
COUNTS = slice(3, 5)  # vehicles and frames, after AP, recall and precision
DRAWS = slice(5, None)  # the AP of each resample, last

# AP, recall, precision, vehicles, frames; AP of each resample
_Figures = Float64[np.ndarray, "*cases figures"]


class SetJudgement(NamedTuple):
    """Judgement of a set, intact and in requested cases. Other cases are None; fields as of
    `PlanOption`."""

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

    profiles: at each error profile of the cases, matched at all their IoU thresholds; seed: of the
    bootstrap; levels: frames of each level of traffic, none if traffic is undivided; drawings:
    judges of the same candidates at other drawings of the site, over which figures of sets are
    means."""

    profiles: tuple[Detected, ...]
    cases: Cases = USUAL_CASES
    seed: int = 0
    levels: tuple[Int64[np.ndarray, " _"], ...] = ()
    drawings: "tuple[Judge, ...]" = ()

    @classmethod
    def of(cls, prepared: Preparation, seed: int) -> "Judge":
        """Judge on the traffic of a preparation."""
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
        profiles = tuple(
            DetectorEvaluator(each, self.cases.ious, self.seed) for each in self.profiles
        )
        return CasesEvaluator(
            profiles, self.cases, self.levels, tuple(each.evaluator for each in self.drawings)
        )

    @property
    def alone(self) -> "tuple[Judge, ...]":
        """Judge of each drawing of the site by itself."""
        return replace(self, drawings=()), *self.drawings

    def outcomes(self, chosen: tuple[int, ...]) -> list[Outcome]:
        """Outcomes of one set in every frame."""
        return self.detected.outcomes([chosen], range(self.frames))[chosen]

    def kbit(self, chosen: tuple[int, ...]) -> Float64[np.ndarray, "k frames"]:
        """kbit that each sensor of one set sends in every frame."""
        return np.array([outcome.bits for outcome in self.outcomes(chosen)], np.float64).T / 1000

    def judge(
        self,
        sets: Bool[np.ndarray, "n C"],
        cases: Cases | None = None,
        *,
        progress: Report | None = None,
    ) -> list[Judgement]:
        """Judge sets over cases, by default those of `intact`. progress: called with the frames
        done."""
        return self.judge_drawn(sets, cases or self.intact, progress)[0]

    def judge_drawn(
        self, sets: Bool[np.ndarray, "n C"], cases: Cases, progress: Report | None = None
    ) -> tuple[list[Judgement], _Figures]:
        """Judge sets over cases; also the AP of each resample, which is of the same frames for all
        sets."""
        if not len(sets):
            return [], np.empty((0, 0))
        found = _reduce(
            np.array([each._at_profiles(sets, cases, progress) for each in self.alone]), "mean"
        )
        over = _reduce(found, cases.errors_by)
        over[..., DRAWS] = cases.over_errors(found[..., DRAWS])
        return [_judgement(each, self.detected.classes) for each in over], over[..., DRAWS]

    def judge_cases(
        self, sets: Bool[np.ndarray, "n C"], stage: Callable[[str], Report | None] = lambda _: None
    ) -> tuple[list[SetJudgement], _Figures]:
        """Judge sets intact and in all cases. stage: makes a progress callback from a name. Also
        returns the AP by which sets are compared in each resample, [n, resamples]."""
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
        return [
            SetJudgement(*figures)
            for figures in zip(judged, left, over_levels, over_errors, strict=True)
        ], draws

    def by_level(self, chosen: tuple[int, ...]) -> list[Judgement | None]:
        """Judge one intact set at each level of traffic. None for a level without objects."""
        found = [self._draw(self.outcomes(chosen), part, self.cases.ious) for part in self.levels]
        return [
            None if np.isnan(each[0]) else _judgement(each, self.detected.classes) for each in found
        ]

    def by_errors(self, chosen: tuple[int, ...]) -> dict[str, Judgement]:
        """Judge one set at each error profile, by name."""
        if len(self.profiles) == 1:
            return {}
        row = np.isin(np.arange(len(self.detected.renders.sensors)), chosen)[None]
        found = self._at_profiles(row, self.cases)[:, 0]
        return {
            name: _judgement(at, self.detected.classes)
            for name, at in zip(self.cases.names, found, strict=True)
        }

    def of_classes(self, classes: Classes) -> "Judge":
        """Judge of other classes at the first error profile."""
        return replace(
            self,
            profiles=(self.detected.of_classes(classes),),
            cases=self.intact,
            levels=(),
            drawings=(),
        )

    def by_class(self, chosen: tuple[int, ...]) -> tuple[ClassAP, ...]:
        """Judge one set for each class that counts."""
        classes = self.detected.classes
        every = np.arange(self.frames)
        found = []
        tallies = self._tally(self.outcomes(chosen), every, self.cases.ious)
        for k, (name, weight) in enumerate(zip(classes.names, classes.weights, strict=True)):
            judged = judge_tallies([[at[k]] for at in tallies], Classes((name,)), self.seed)
            found.append(ClassAP(name, weight, self.cases.class_ious(classes, name), judged))
        return tuple(found)

    def by_other_class(self, chosen: tuple[int, ...]) -> tuple[ClassAP, ...]:
        """Judge one set for each class that does not count but is there, and that the detector
        knows."""
        known = known_labels(self.detected.detector) or ()
        names = self.detected.classes.names
        others = tuple(name for name in LABELS if name in known and name not in names)
        found = self.of_classes(Classes(others)).by_class(chosen) if others else ()
        return tuple(replace(each, weight=0.0) for each in found if each.judged.vehicles)

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
            drawn.append(
                [
                    [self._draw(outcomes[each], part, cases.ious) for each in members]
                    for part in parts
                ]
            )
        found = np.array(drawn)[:, :, place.reshape(-1)]  # profile, level, row, figure
        over = _reduce(np.moveaxis(found, 1, 0), cases.levels_by)
        if cases.levels_by == "mean":
            over[..., COUNTS] = np.where(np.isnan(found[..., :1]), 0, found[..., COUNTS]).sum(
                axis=1
            )
        if cases.failing:
            # the first is the set itself
            lost = [np.flatnonzero(owners == n)[1:] for n in range(len(sets))]
            over = np.stack(
                [_reduce(np.moveaxis(over[:, some], 1, 0), cases.failures) for some in lost], axis=1
            )
        over[..., DRAWS] = cases.at_profiles(found[:, :, None, :, DRAWS], owners, tie=0.0)
        return over

    def _draw(
        self, outcomes: Sequence[Outcome], frames: Int64[np.ndarray, " _"], ious: Sequence[float]
    ) -> _Figures:
        """Figures of one set in some frames, whose blocks are drawn."""
        draws = intervals.draws_of_blocks(frames // BLOCK_FRAMES, seed=self.seed)
        return _draw_tallies(self._tally(outcomes, frames, ious), self.detected.classes, draws)

    def _tally(
        self, outcomes: Sequence[Outcome], frames: Int64[np.ndarray, " _"], ious: Sequence[float]
    ) -> list[list[Tally]]:
        own = [outcomes[k] for k in frames.tolist()]
        return [
            [
                Tally.of([o.of_class(label) for o in own], count[frames], at)
                for label, count in self.to_find.items()
            ]
            for at in map(self.detected.ious.index, ious)
        ]


def one_stage(run: Run, name: str, frames: int) -> Callable[[str], Report | None]:
    """Return what makes the callback of `Judge.judge_cases`: every part of its work counts as one
    stage."""
    return lambda _: run.stage(name, frames)


def judge_tallies(tallies: Sequence[Sequence[Tally]], classes: Classes, seed: int) -> Judgement:
    """Judge from a tally of each class at each IoU threshold, averaged over these."""
    draws = intervals.block_draws(len(tallies[0][0].truths), seed=seed)
    return _judgement(_draw_tallies(tallies, classes, draws), classes)


def _draw_tallies(tallies: Sequence[Sequence[Tally]], classes: Classes, draws: Draws) -> _Figures:
    found = []
    for at in tallies:
        ap, recall = classes.combined(np.array([[t.ap for t in at], [t.recall for t in at]]))
        detections = sum(len(t.hit) for t in at)
        hits = sum(int(t.hit.sum()) for t in at)
        counts = sum(int(t.truths.sum()) for t in at), len(at[0].truths)
        drawn = classes.combined(np.stack([t.resamples(draws=draws) for t in at], axis=1))
        precision = hits / detections if detections and counts[0] else np.nan
        found.append(np.array([ap, recall, precision, *counts, *drawn]))
    return _reduce(np.array(found), "mean")


def _reduce(
    figures: Float64[np.ndarray, "cases *rest figures"], by: Combine
) -> Float64[np.ndarray, "*rest figures"]:
    """Figures of the case of least AP, or means over cases, without NaN."""
    if by == "worst":
        ap = figures[..., :1]
        return np.take_along_axis(
            figures, np.where(np.isnan(ap), np.inf, ap).argmin(axis=0)[None], axis=0
        )[0]
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
    """Figure of a judgement by the detector, to be held against another stage's."""
    return StageFigure(stage, judged.ap, judged.vehicles, judged.frames)


RACED = 60  # frames of a race at most
# sets of each number of sensors that are judged on all frames where they come `NEAR` the best
KEPT = 3
NEAR = 0.03  # AP below the best of a race that further frames may make up for
# AP below the winner of a race within which other IoU thresholds say who is judged too
LIKELY_TIE = 2 * NEAR_TIE
LOOKED_AT = 12  # frames on which all sets are looked at that may reach a requirement
DOUBT = 0.1  # AP by which a first look may underrate a set

Rule = Literal["best", "as good", "cheapest", "none"]


@dataclass(frozen=True, eq=False)
class Choice:
    """The answer among options: all entrants in their order, judged or not.

    chosen, best: indices of the answer and of the best set; alike: of sets that cannot be told from
    the best, without the answer; confidence: on all frames that compared the sets, that no set of
    as many sensors is better than the answer by more than `AP_TOLERANCE`; None where no race was
    run, as where sets were judged by price, and where frames or objects are too few."""

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
        """Sets that cannot be told from the best, cheap ones first."""
        return tuple(sorted((self.options[i] for i in self.alike), key=_thrift))


def choose_at_drawings(
    judge: Judge, choice: Choice, min_ap: float | None
) -> tuple[DrawingResult, ...]:
    """Judge the answer, and choose among the judged sets, at each drawing of the site by itself."""
    if not judge.drawings:
        return ()
    rows = [i for i, option in enumerate(choice.options) if option.judged is not None]
    sets = choice.sets[rows]
    results = []
    for each in judge.alone:
        found, draws = each.judge_cases(sets)
        figures = zip(
            rows, found, each.evaluator.mean_ap(sets, np.arange(each.frames)).tolist(), strict=True
        )
        options = [
            replace(choice.options[i], mean_ap=mean, **judged._asdict())
            for i, judged, mean in figures
        ]
        place = choose(options, dict(enumerate(draws)))[1][0]
        if min_ap is not None:
            reaching = [n for n, judged in enumerate(found) if judged.counted.ap >= min_ap]
            place = min(reaching, key=lambda n: _thrift(options[n]), default=place)
        results.append(
            DrawingResult(found[rows.index(choice.chosen)].counted, options[place].poles)
        )
    return tuple(results)


class _Options:
    """Options of a choice, which are judged when they are asked for."""

    def __init__(self, objective: Objective, found: Entrants, judge: Judge) -> None:
        self.objective = objective
        self.found = found
        self.judge = judge
        self.draws: dict[int, Resamples] = {}
        self.options: list[PlanOption] = []
        for i, score in enumerate(map(objective.score, map(np.flatnonzero, found.sets))):
            names = tuple(name_sensor(objective.names[c]) for c in score.subset)
            # as found: scored beside other sets it may round differently
            figures = (
                score.price,
                score.kbit_per_sensor,
                score.kbit,
                round(float(found.predicted[i]), 6),
            )
            poles = tuple(
                objective.candidates.mounts[m].name
                for m in objective.candidates.mount[list(score.subset)]
            )
            self.options.append(
                PlanOption(names, *figures, judged=None, searches=found.searches[i], poles=poles)
            )

    def judge_rows(self, rows: Sequence[int], run: Run = Run()) -> None:
        """Judge sets on all frames, unless they are judged. run: reports the frames done."""
        new = [i for i in rows if i not in self.draws]
        if not new:
            return
        stage = one_stage(run, "frames of the closest sets", self.judge.frames)
        judged_sets, draws = self.judge.judge_cases(self.found.sets[new], stage)
        mean_ap = self.judge.evaluator.mean_ap(
            self.found.sets[new], np.arange(self.judge.frames)
        ).tolist()
        for i, judged, mean, drawn in zip(new, judged_sets, mean_ap, draws, strict=True):
            members = tuple(np.flatnonzero(self.found.sets[i]).tolist())
            fits = self.objective.fits_links(members, self.judge.kbit(members))
            self.options[i] = replace(
                self.options[i], mean_ap=mean, fits_links=fits, **judged._asdict()
            )
            self.draws[i] = drawn

    def check_race(self, row: int, ap: float, frames: Int64[np.ndarray, " k"]) -> None:
        """Raise ValueError where a judged set had quite another AP in its race.

        The worst of several cases is lower on few frames, so it is not held against that on all."""
        option = self.options[row]
        counted = option.judged
        if counted is not None and self.judge.cases.plain and len(self.judge.profiles) == 1:
            objects = self.judge.evaluator.count_objects(frames)
            raced = StageFigure("in the race", ap, objects, len(frames))
            check_agreement(option.sensors, raced, state_figure("in the comparison", counted))

    def measure_sureness(
        self, row: int, places: Int64[np.ndarray, " k"], ran: Contest | None
    ) -> float | None:
        """Measure how sure it is that no set of as many sensors is better than a judged one by
        `AP_TOLERANCE`.

        Judged sets count with all frames, the others with their last rung's. places: the sets of
        the size; ran: their race. None without one, and where frames or objects are too few."""
        counted = self.options[row].counted
        if (
            ran is None
            or counted is None
            or not intervals.is_comparable(counted.frames, counted.vehicles)
        ):
            return None
        judged = [i for i in places.tolist() if i in self.draws]
        aps = np.array(
            [
                option.counted.ap
                for option in map(self.options.__getitem__, judged)
                if option.counted
            ]
        )
        draws = np.stack([self.draws[i] for i in judged])
        likely = shrink(
            aps, draws, self.found.predicted[judged], intervals.count_blocks(counted.frames)
        ).resamples
        better = likely - likely[judged.index(row)] > intervals.AP_TOLERANCE
        place = np.searchsorted(places, [row, *judged])
        dropped = ran.doubt(int(place[0]), place[1:].tolist())
        return max(0.0, 1 - float(better.any(axis=0).mean()) - dropped)


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
    known = _Options(objective, found, judge)
    if min_ap is not None and (reached := _find_cheapest(known, min_ap, run)) is not None:
        return Choice(tuple(known.options), found.sets, reached, reached, (), "cheapest")
    sizes = found.sets.sum(axis=1)
    evaluator = judge.evaluator
    races = dict[int, Contest]()
    winners = list[tuple[int, float]]()
    close = list[tuple[float, int]]()
    order = race_order(judge.frames, seed=run.seed)
    raced = dict[int, tuple[float, Int64[np.ndarray, " k"]]]()
    report = run.stage("set sizes compared", len(np.unique(sizes)))
    for done, size in enumerate(np.unique(sizes)[::-1], 1):
        places = np.flatnonzero(sizes == size)
        if (
            close and winners[-1][1] < max(close)[0] - NEAR
        ):  # fewer sensors fall further behind: no race shows more
            best = places[int(found.predicted[places].argmax())]
            winners.append((int(best), winners[-1][1]))
        else:
            ran = contest(
                objective,
                found.sets[places],
                evaluator,
                confidence=confidence,
                seed=run.seed,
                frames=RACED,
            )
            rows = places[ran.ranking]
            kept = _find_rivals(ran, found.sets[rows], evaluator, order)
            close += zip(ran.expected[kept].tolist(), rows[kept].tolist(), strict=True)
            winners.append((int(rows[0]), float(ran.expected[0])))
            races[int(size)] = ran
            raced[int(rows[0])] = float(ran.figures[0]), order[: ran.frames[0]]
        if report is not None:
            report(done)
    near = [row for expected, row in close if expected >= max(close)[0] - NEAR]
    known.judge_rows(list(dict.fromkeys([*(row for row, _ in winners), *near])), run)
    options = tuple(known.options)
    for row, (raced_ap, frames) in raced.items():
        known.check_race(row, raced_ap, frames)
    best, alike = choose(options, known.draws)
    chosen = best
    rule: Rule = "best" if min_ap is None else "none"
    if min_ap is None and alike[0] != best:
        chosen = alike[0]
        rule = "as good"
    others = tuple(i for i in alike if i != chosen)
    places = np.flatnonzero(sizes == sizes[chosen])
    sureness = known.measure_sureness(chosen, places, races.get(int(sizes[chosen])))
    return Choice(options, found.sets, chosen, best, others, rule, sureness)


def _find_rivals(
    ran: Contest,
    ranked: Bool[np.ndarray, "n C"],
    evaluator: CasesEvaluator,
    order: Int64[np.ndarray, " frames"],
) -> Int64[np.ndarray, " k"]:
    """Places of the winner of a race and its `KEPT` - 1 likeliest rivals: by mean AP over IoU, then
    by rank. The mean AP is that on the frames of the first rung, which all sets share."""
    tied = np.flatnonzero(ran.expected >= ran.expected[0] - LIKELY_TIE)[1:]
    means = evaluator.mean_ap(ranked[tied], order[: ran.frames.min()]) if len(tied) else np.empty(0)
    by_mean = tied[np.argsort(-means, kind="stable")]
    return np.array(
        list(dict.fromkeys([0, *by_mean.tolist(), *range(len(ranked))]))[:KEPT], np.int64
    )


def _find_cheapest(known: _Options, min_ap: float, run: Run) -> int | None:
    """Return the cheapest set whose AP reaches the requirement, None if none does. Sets are judged
    by price."""
    found = known.found
    judge = known.judge
    order = race_order(judge.frames, seed=run.seed)[:LOOKED_AT]
    seen = judge.evaluator.evaluate(
        found.sets, order, run.stage("frames of the first look", len(order))
    )
    likely = shrink(
        seen.ap, seen.resamples, found.predicted, len(np.unique(order // BLOCK_FRAMES))
    ).figure
    rows = np.lexsort((-likely, np.array([option.price for option in known.options]))).tolist()
    report = run.stage("sets judged by price", len(rows))
    for done, i in enumerate(rows, 1):
        if likely[i] >= min_ap - DOUBT:
            known.judge_rows([i])
            counted = known.options[i].counted
            if counted is not None and counted.ap >= min_ap and known.options[i].fits_links:
                return i
        if report is not None:
            report(done)
    return None


def _thrift(option: PlanOption) -> tuple[float, int, float, float]:
    return option.price, len(option.sensors), -(option.mean_ap or 0.0), option.kbit_per_sensor


def choose(
    options: Sequence[PlanOption], draws: Mapping[int, Resamples]
) -> tuple[int, tuple[int, ...]]:
    """Return the index of the best option, and those that cannot be told from it, itself too, cheap
    ones first. Options whose links are too narrow are left out, unless all are. draws: resampled AP
    of each judged option, on the same frames."""
    judged = {i: counted for i in sorted(draws) if (counted := options[i].counted) is not None}
    carried = {i: counted for i, counted in judged.items() if options[i].fits_links}
    judged = carried or judged
    highest = max(each.ap for each in judged.values())
    close = [i for i, each in judged.items() if each.ap >= highest - NEAR_TIE]
    best = min(close, key=lambda i: (-(options[i].mean_ap or 0.0), *_thrift(options[i])))
    blocks = intervals.count_blocks(judged[best].frames)
    alike = [i for i in judged if i == best or intervals.is_as_good(draws[i], draws[best], blocks)]
    return best, tuple(sorted(alike, key=lambda i: (*_thrift(options[i]), i != best)))


def find_front_options(options: tuple[PlanOption, ...]) -> tuple[PlanOption, ...]:
    """Judged sets that no other beats in AP, kbit per sensor and price at once."""
    judged = [(option, option.counted) for option in options if option.counted is not None]
    figures = np.array([(-j.ap, o.kbit_per_sensor, o.price) for o, j in judged]).reshape(-1, 3)
    kept = [judged[i] for i in find_front(figures)]
    return tuple(option for option, _ in sorted(kept, key=lambda pair: (pair[0].price, pair[1].ap)))
