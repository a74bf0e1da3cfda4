"""`plan`: from a question to a plan. The cache keeps its stages, so an interrupted plan resumes.

There are three parts of traffic, each with its own seed: searches see the first, the detector
compares the entrants on the second, and the plan's figures for the chosen set are from the third.
In breakdowns, vehicles and false alarms belong to the group of their box's centre, a hit to the
group of the vehicle it hit."""

import json
import math
import platform
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from placement_env.analysis.agreement import StageFigure, check_agreement
from placement_env.analysis.approaches import compass, find_approaches, find_streets
from placement_env.analysis.intervals import (
    AP_TOLERANCE,
    BLOCK_FRAMES,
    RESAMPLES,
    Tally,
    count_blocks,
    frames_for_width,
    is_as_good,
    share_beyond_reach,
)
from placement_env.analysis.worth import estimate_worth, exact_worth
from placement_env.candidates.candidates import Candidates, NoCandidates
from placement_env.cases import LEVEL_NAMES, Cases
from placement_env.classes import Classes
from placement_env.fidelity.coverage import LEAST
from placement_env.fidelity.detector import FALSE_ALARM, IGNORED, IOUS, Detected
from placement_env.fidelity.preparation import Preparation, check_scorable
from placement_env.fidelity.renders import Renders
from placement_env.fidelity.traffic import Traffic
from placement_env.fidelity.visibility import Visibility
from placement_env.handover import mounted
from placement_env.handover.exchange import EXCHANGE_FILES, write_exchange
from placement_env.handover.ground import Ground, ground_shares, visible_ground
from placement_env.objective import Objective
from placement_env.protocol import Doubting
from placement_env.report import content
from placement_env.report.pages.report import REPORT_FILES, write_report
from placement_env.report.planning import judging, sentences
from placement_env.report.planning.plan_folder import CONTENT, format_stock
from placement_env.report.planning.question import PART_FRAMES, Question
from placement_env.search.first_look import narrow_pool
from placement_env.search.order import describe_exclusions, explain_kept
from placement_env.search.portfolio.entrants import (
    Effort,
    Entrants,
    at_other_ious,
    join_entrants,
    keep_entrants,
)
from placement_env.setting import AP_ONLY
from placement_env.subsets import all_subsets
from toolkit.arrays import Bool, Float32, Float64, Int64
from toolkit.detection.provenance import coview_version, detector_origin
from toolkit.detection.schemes import PAPER_SCHEMES
from toolkit.objects import LABELS, Detector, label_index
from toolkit.points import count_on_ground, has_centre_inside
from toolkit.runtime.files import replace_infinite, write_text, writing_together
from toolkit.runtime.run import Run
from toolkit.sensors.error_profiles import only_own_noise
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import format_site
from toolkit.sites.site import Site
from toolkit.sites.surroundings import count_things

RANGE_ENDS = (10.0, 20.0, 30.0, 40.0)  # m from the nearest sensor, where groups end
CENTRE = 0.25  # of the shorter side of the area: radius of the zone in its middle
MOMENTS = 8  # frames of pictures
MOMENT_POINTS = 2500  # of each sensor in such a frame, at most

GroupOf = Callable[[Float64[np.ndarray, "n 7"]], Int64[np.ndarray, " n"]]


@dataclass(frozen=True, eq=False)
class Scored:
    """Detections of one set, box by box.

    truths: scored objects of all frames, in order; points: of the set on each; boxes: of the
    detections; hits: the truth that each hit at each IoU threshold, or FALSE_ALARM or IGNORED;
    frames: their number; classes: that count."""

    truths: Float64[np.ndarray, "t 7"]
    truth_frame: Int64[np.ndarray, " t"]
    truth_label: Int64[np.ndarray, " t"]
    points: Int64[np.ndarray, " t"]
    boxes: Float64[np.ndarray, "n 7"]
    scores: Float64[np.ndarray, " n"]
    frame: Int64[np.ndarray, " n"]
    label: Int64[np.ndarray, " n"]
    hits: Int64[np.ndarray, "ious n"]
    frames: int
    classes: Classes

    def tally(
        self, label: int, truths: Bool[np.ndarray, " t"], chosen: Bool[np.ndarray, " n"], at: int
    ) -> Tally:
        """Tally truths and detections of one class and IoU."""
        there = truths & (self.truth_label == label)
        found = chosen & (self.label == label)
        count = np.bincount(self.truth_frame[there], minlength=self.frames)
        return Tally(self.scores[found], self.hits[at, found] >= 0, self.frame[found], count)


def score_boxes(judge: judging.Judge, chosen: tuple[int, ...]) -> Scored:
    """Collect detections of the chosen set in all frames of a judge."""
    detected = judge.detected
    outcomes = judge.outcomes(chosen)
    objects = [detected.renders.objects(k)[detected.scored(k)] for k in range(judge.frames)]
    found = [detected.detections(chosen, k) for k in range(judge.frames)]
    frame = np.repeat(np.arange(judge.frames), [len(outcome.scores) for outcome in outcomes])
    first = np.cumsum([0, *map(len, objects)])[frame]
    truth = np.concatenate([each.truth for each in outcomes], axis=1)[
        [*map(detected.ious.index, judge.cases.ious)]
    ]
    return Scored(
        truths=np.concatenate([each.boxes for each in objects]),
        truth_frame=np.repeat(np.arange(judge.frames), [len(each) for each in objects]),
        truth_label=np.concatenate([each.labels for each in objects]),
        points=_count_points(detected, chosen),
        boxes=np.concatenate([each.boxes for each in found]),
        scores=np.concatenate([outcome.scores for outcome in outcomes]),
        frame=frame,
        label=np.concatenate([each.labels for each in found]),
        hits=np.where(truth >= 0, first + truth, truth).astype(np.int64),
        frames=judge.frames,
        classes=detected.classes,
    )


def fuse_clouds(detected: Detected, chosen: Sequence[int], k: int) -> Float32[np.ndarray, "n 3"]:
    """Join the points of a set's sensors in frame k."""
    return np.concatenate(
        [np.empty((0, 3), np.float32), *(detected.renders.clouds(k, c) for c in chosen)]
    )


def _count_points(detected: Detected, chosen: Sequence[int]) -> Int64[np.ndarray, " t"]:
    """Points of a set on each scored object, frame after frame."""
    counts = [np.empty(0, np.int64)]
    for k in range(detected.frames):
        boxes = detected.renders.objects(k).boxes[detected.scored(k)]
        counts.append(
            count_on_ground(fuse_clouds(detected, chosen, k), boxes, detected.renders.site)
        )
    return np.concatenate(counts)


def _row(
    name: str, judged: content.Judgement | None, points: Int64[np.ndarray, " t"]
) -> content.BreakdownRow:
    return content.BreakdownRow(name, judged, float(points.mean()) if len(points) else None)


def by_group(
    scored: Scored, names: Sequence[str], group_of: GroupOf, seed: int
) -> tuple[content.BreakdownRow, ...]:
    """Judge each group; group_of: group of each box."""
    of_truth = group_of(scored.truths)
    groups = np.where(scored.hits == IGNORED, -1, group_of(scored.boxes))
    hit = scored.hits >= 0
    groups[hit] = of_truth[scored.hits[hit]]
    rows = []
    for number, name in enumerate(names):
        here = of_truth == number
        parts = [
            [scored.tally(label, here, group == number, at) for label in scored.classes.labels]
            for at, group in enumerate(groups)
        ]
        judged = judging.judge_tallies(parts, scored.classes, seed) if here.any() else None
        rows.append(_row(name, judged, scored.points[here]))
    return tuple(rows)


def by_zone(scored: Scored, site: Site, seed: int) -> tuple[content.BreakdownRow, ...]:
    """Judge the middle and the quarters around it, named by the compass."""
    xmin, ymin, xmax, ymax = site.area
    middle = np.array([xmin + xmax, ymin + ymax]) / 2
    radius = CENTRE * min(xmax - xmin, ymax - ymin)
    quarters = [np.array([x, y]) for y in (1.0, -1.0) for x in (1.0, -1.0)]
    names = (f"centre (within {radius:g} m)", *(compass(site, quarter) for quarter in quarters))

    def group_of(boxes: Float64[np.ndarray, "n 7"]) -> Int64[np.ndarray, " n"]:
        offset = boxes[:, :2] - middle
        quarter = 1 + (offset[:, 0] < 0) + 2 * (offset[:, 1] < 0)
        return np.where(np.hypot(*offset.T) <= radius, 0, quarter).astype(np.int64)

    return by_group(scored, names, group_of, seed)


def by_range(
    scored: Scored, sensors: Sequence[Sensor], seed: int
) -> tuple[content.BreakdownRow, ...]:
    """Judge by distance to the nearest sensor."""
    places = np.array([sensor.position[:2] for sensor in sensors])
    edges = (0.0, *RANGE_ENDS)
    names = [
        *(f"{a:g} to {b:g} m" for a, b in zip(edges, RANGE_ENDS, strict=False)),
        f"beyond {RANGE_ENDS[-1]:g} m",
    ]

    def group_of(boxes: Float64[np.ndarray, "n 7"]) -> Int64[np.ndarray, " n"]:
        nearest = np.linalg.norm(boxes[:, None, :2] - places, axis=2).min(axis=1)
        return np.searchsorted(RANGE_ENDS, nearest).astype(np.int64)

    return by_group(scored, names, group_of, seed)


def by_approach(scored: Scored, site: Site, seed: int) -> tuple[content.BreakdownRow, ...]:
    """Judge by the lane nearest to each vehicle."""
    places = find_approaches(site)
    return tuple(
        row for row in by_group(scored, places.names, places.locate, seed) if row.judged is not None
    )


def measure_blind_streets(site: Site, ground: Ground) -> dict[str, float]:
    """Measure the lanes that no sensor sees (m²), by street, the largest first."""
    rows, columns = np.nonzero(ground.open_ground & ground.lanes & (ground.views == 0))
    boxes = np.zeros((len(rows), 7))
    boxes[:, 0] = ground.x[columns]
    boxes[:, 1] = ground.y[rows]
    streets = find_streets(site)
    areas = np.bincount(streets.locate(boxes), minlength=len(streets.names)) * ground.cell**2
    return {
        streets.names[k]: float(areas[k]) for k in np.argsort(-areas, kind="stable") if areas[k]
    }


def by_level(
    scored: Scored, judge: judging.Judge, chosen: tuple[int, ...]
) -> tuple[content.BreakdownRow, ...]:
    """Judge each level of traffic; empty if undivided."""
    each = zip(LEVEL_NAMES[judge.cases.levels], judge.by_level(chosen), judge.levels, strict=False)
    frame = scored.truth_frame
    points = scored.points
    return tuple(_row(name, judged, points[np.isin(frame, part)]) for name, judged, part in each)


def by_errors(judge: judging.Judge, chosen: tuple[int, ...]) -> tuple[content.BreakdownRow, ...]:
    """Judge each error profile. Failures and levels are included if they count; no row for one
    profile."""
    rows = zip(judge.by_errors(chosen).items(), judge.profiles, strict=False)
    return tuple(_row(*row, _count_points(at, chosen)) for row, at in rows)


def by_draw(
    judge: judging.Judge, chosen: tuple[int, ...], run: Run = Run()
) -> tuple[content.DrawnErrors, ...]:
    """Judge a set at each error profile in several draws of the errors, each for all frames. run:
    reports the draws."""
    rows = []
    for detected in judge.profiles:
        renders = detected.renders
        if not isinstance(renders, Renders) or only_own_noise(renders.errors):
            continue
        report = run.stage(f"draws of the errors {renders.errors.name}", ERROR_DRAWS)
        aps = []
        for seed in range(1, ERROR_DRAWS + 1):
            aps.append(_judge_draw(judge, detected, renders, chosen, seed))
            if report is not None:
                report(seed)
        mean = float(np.mean(aps))
        tenth = float(np.quantile(aps, 0.1))
        rows.append(
            content.DrawnErrors(
                renders.errors.name, tuple(aps), mean, tenth, min(judge.frames, DRAWN_FRAMES)
            )
        )
    return tuple(rows)


def _judge_draw(
    judge: judging.Judge, detected: Detected, renders: Renders, chosen: Sequence[int], seed: int
) -> float:
    drawn = renders.draw_once(seed, chosen, min(judge.frames, DRAWN_FRAMES))
    known = {name: getattr(detected, name) for name in ("codec", "memo", "processes", "classes")}
    ious = judge.cases.ious
    again = Detected(drawn, detected.detector, detected.scheme, **known).at(ious[0], ious)
    figures = again.estimates(np.ones((1, len(chosen)), np.bool_))
    return float(np.mean([figures[iou].ap[0] for iou in ious]))


def by_class(
    judge: judging.Judge, chosen: tuple[int, ...], labels: Sequence[str] = LABELS
) -> tuple[content.ClassSeen, ...]:
    """Coverage of each class: share of its road users in the area with `LEAST` points or more."""
    detected = judge.detected
    site = judge.detected.renders.site
    inside = []
    seen = []
    for k in range(judge.frames):
        objects = detected.renders.objects(k)
        objects = objects[has_centre_inside(objects.boxes, site.area)]
        inside.append(objects.labels)
        seen.append(count_on_ground(fuse_clouds(detected, chosen, k), objects.boxes, site) >= LEAST)
    of_class = np.concatenate(inside)
    all_seen = np.concatenate(seen)
    rows = {label: all_seen[of_class == label_index(label)] for label in labels}
    return tuple(
        content.ClassSeen(label, len(row), int(LEAST), float(row.mean()) if len(row) else None)
        for label, row in rows.items()
    )


def pick_moments(
    detected: Detected,
    chosen: tuple[int, ...],
    *,
    count: int = MOMENTS,
    points: int = MOMENT_POINTS,
    seed: int = 0,
) -> tuple[content.Moment, ...]:
    """Pick the first run of `count` frames with most vehicles. points: kept of each cloud, drawn
    from the seed."""
    found = np.array([detected.scored(k).sum() for k in range(detected.frames)], np.int64)
    count = min(count, detected.frames)
    first = int(np.convolve(found, np.ones(count, np.int64), mode="valid").argmax())
    return tuple(_moment(detected, chosen, k, points, seed) for k in range(first, first + count))


def _moment(
    detected: Detected, chosen: tuple[int, ...], k: int, points: int, seed: int
) -> content.Moment:
    truth = detected.outcomes([chosen], [k])[chosen][0].truth[detected.ious.index(detected.iou)]
    objects = detected.renders.objects(k)
    scored = detected.scored(k)
    hit = np.zeros(len(objects), np.bool_)
    hit[np.flatnonzero(scored)[truth[truth > FALSE_ALARM]]] = True
    clouds = tuple(thin(detected.renders.clouds(k, c), points, [seed, k, c]) for c in chosen)
    return content.Moment(
        clouds, objects, detected.detections(chosen, k), hit, ~scored, truth >= 0, truth == IGNORED
    )


def thin(
    cloud: Float32[np.ndarray, "n 3"], points: int, seed: list[int]
) -> Float32[np.ndarray, "m 3"]:
    """Draw at most this many points of a cloud, in order."""
    if len(cloud) <= points:
        return cloud
    return cloud[np.sort(np.random.default_rng(seed).choice(len(cloud), points, replace=False))]


# draws of errors that the chosen set is judged in, and frames of each at most
ERROR_DRAWS = 10
DRAWN_FRAMES = 60
MOST_FRAMES = 1200  # that a plan takes to reach a width
ALL_SUBSETS = 6  # sensors up to which every subset is judged by the detector
PACKAGES = (
    "numpy",
    "torch",
    "open3d-cpu",
    "open3d",
    "eclipse-sumo",
    "libsumo",
    "ortools",
    "shapely",
)


@dataclass(frozen=True, eq=False)
class Findings:
    """Everything that led to the chosen set.

    objective: of the searches; network: shipped one that detects if the question has no detector;
    excluded: sentences on what excludes candidates; traffic: of searches, comparison and judgement;
    drawings: results at each, where there are several."""

    question: Question
    found: Entrants
    choice: judging.Choice
    objective: Objective
    network: str
    excluded: tuple[str, ...]
    traffic: Sequence[Traffic]
    drawings: tuple[content.DrawingResult, ...] = ()


def build_plan(findings: Findings, final: judging.Judge, ground: Ground) -> content.Plan:
    """Put the plan together. final: the detector on the final traffic; ground: that the chosen
    sensors see."""
    question = findings.question
    choice = findings.choice
    objective = findings.objective
    candidates = objective.candidates
    site = question.site
    seed = question.run.seed
    members = choice.members
    chosen = ChosenSet(members, choice.option.sensors, final, objective, question.run)
    ((judged,), (drawn,)) = final.judge_cases(choice.sets[choice.chosen][None], chosen.stage)
    check_stages(findings, judged.judged)
    each_kbit = final.kbit(members)
    kbit = float(each_kbit.sum(axis=0).mean())
    fits = objective.fits_links(members, each_kbit)
    per_sensor = kbit / len(members)
    option = replace(
        choice.option, **judged._asdict(), kbit=kbit, kbit_per_sensor=per_sensor, fits_links=fits
    )
    scored = score_boxes(final, members)
    sensors = mounted.format_sensors(
        site,
        candidates,
        members,
        kbit=each_kbit,
        catalogue=question.stock.catalogue,
        link_share=question.setting.link_share,
    )
    links = mounted.link_loads(sensors, limited=question.setting.fusion.sends_points)
    detector: str = detector_origin(final.detected.detector)["detector"]
    considered = sorted(
        choice.options,
        key=lambda each: (not each.counted, -(each.counted.ap if each.counted else each.predicted)),
    )
    levels = by_level(scored, final, members)
    plan = content.Plan(
        question=question.as_dict(),
        site=site.name,
        detector=detector,
        iou=question.cases.threshold,
        scheme=question.setting.fusion.name,
        currency=question.currency,
        verdict=sentences.build_verdict(
            question, choice.option, option, findings.excluded, choice.rule, links=links
        ),
        chosen=option,
        best=choice.options[choice.best],
        confidence=judge_sureness(choice.confidence, judged.counted, drawn),
        sensors=sensors,
        considered=tuple(considered),
        near_optimal=choice.near_optimal,
        front=judging.find_front_options(choice.options),
        schemes=chosen.schemes(),
        by_zone=by_zone(scored, site, seed),
        by_range=by_range(scored, [candidates.sensors[c] for c in members], seed),
        by_approach=by_approach(scored, site, seed),
        by_level=levels,
        by_errors=by_errors(final, members),
        by_draw=by_draw(final, members, question.run),
        by_drawing=findings.drawings,
        by_class=by_class(final, members),
        class_ap=(*final.by_class(members), *final.by_other_class(members)),
        worth=chosen.worth(),
        failures=chosen.failures(),
        links=links,
        materials=mounted.bill_of_materials(sensors),
        running=mounted.bill_of_rates(sensors, question.stock.catalogue),
        order=chosen.order(),
        ground=ground_shares(ground, [sensor.name for sensor in sensors]),
        blind_streets=measure_blind_streets(site, ground),
        poles_unused=tuple(mount.name for mount in mounted.unused_mounts(candidates, members)),
        origins=count_things(replace(site, mounts=candidates.mounts)),
        head=question.stock.head,
        stock=format_stock(question, question.setting.pool),
        assumptions=sentences.list_assumptions(
            question, objective.fidelity, detector, sampled=not chosen.small
        ),
        unknown=sentences.list_unknowns(judged.counted, levels),
        provenance=trace_plan(findings, candidates, final.detected.detector),
    )
    count = findings.found.considered
    fidelity = objective.fidelity
    why = sentences.explain_choice(
        question, plan, choice.option, choice.rule, considered=count, fidelity=fidelity
    )
    planned = zip(members, sensors, strict=True)
    return content.rename(
        replace(plan, why=why), {candidates.sensors[c].name: sensor.name for c, sensor in planned}
    )


def check_stages(findings: Findings, judged: content.Judgement) -> None:
    """Raise ValueError where the prediction, the comparison and the judgement of the answer exclude
    each other.

    judged: the answer, intact. The prediction is the shipped network's without errors, so it is
    held against such a detector only."""
    choice = findings.choice
    question = findings.question
    objective = findings.objective
    last = judging.state_figure("in the judgement", judged)
    if (compared := choice.option.judged) is not None:
        before = judging.state_figure("in the comparison", compared)
        check_agreement(choice.option.sensors, before, last)
    predicts = (
        question.setting.detector is None and question.cases.noise_only and question.cases.plain
    )
    if predicts and isinstance(objective.scored_by, Doubting):
        spread = float(objective.scored_by.spread(choice.sets[[choice.chosen]])[0])
        if math.isfinite(spread):
            figures = choice.option.predicted, judged.vehicles, judged.frames, spread
            predicted = StageFigure("by the prediction", *figures)
            check_agreement(choice.option.sensors, predicted, last)


def judge_sureness(
    confidence: float | None, judged: content.Judgement, drawn: Float64[np.ndarray, " resamples"]
) -> float | None:
    """Confidence that no set of as many sensors is better, with what the judgement adds: no AP
    exceeds 1.

    None for an AP so near 1 that no set could be better, from frames too few for an interval that
    would show it."""
    if confidence is None or not judged.known:
        return None if judged.ap > 1 - AP_TOLERANCE else confidence
    return max(confidence, share_beyond_reach(drawn))


@dataclass(frozen=True, eq=False)
class ChosenSet:
    """Schemes, worth of each sensor, failures and order of building of the chosen set.

    members: indices of its candidates, ascending; names: of these; judge: on the final traffic;
    objective: of the searches, which scores subsets of large sets."""

    members: tuple[int, ...]
    names: tuple[str, ...]
    judge: judging.Judge
    objective: Objective
    run: Run = Run()

    @property
    def small(self) -> bool:
        """True if every subset is judged by the detector."""
        return len(self.members) <= ALL_SUBSETS

    def stage(self, name: str) -> Callable[[int], None] | None:
        """Callback that counts the frames of a stage."""
        return self.run.stage(f"frames of the {name}", self.judge.frames)

    def rows(self, subsets: Bool[np.ndarray, "n k"]) -> Bool[np.ndarray, "n C"]:
        """Expand subsets of the set to rows over all candidates."""
        rows = np.zeros((len(subsets), len(self.judge.detected.renders.sensors)), np.bool_)
        rows[:, list(self.members)] = subsets
        return rows

    def _judge(self, subsets: Bool[np.ndarray, "n k"], stage: str) -> list[content.Judgement]:
        return self.judge.judge(self.rows(subsets), progress=self.stage(stage))

    def _aps(self, subsets: Bool[np.ndarray, "n k"], stage: str) -> Float64[np.ndarray, " n"]:
        """AP of subsets, by the detector for small sets, else by the objective."""
        if self.small:
            return np.array([each.ap for each in self._judge(subsets, stage)])
        return self.objective.scores(self.rows(subsets)).ap

    def schemes(self) -> tuple[content.SchemeFigures, ...]:
        """The set under every scheme at every IoU."""
        judge = replace(self.judge, drawings=())
        figures = []
        known = judge.detected
        intact = judge.intact
        whole = self.rows(np.ones((1, len(self.members)), np.bool_))
        ious = intact.ious
        _, (own,) = judge.judge_drawn(whole, intact)
        for name in PAPER_SCHEMES:
            alike = {
                each: getattr(known, each) for each in ("codec", "memo", "processes", "classes")
            }
            at = replace(
                judge,
                profiles=(
                    Detected(known.renders, known.detector, name, **alike).at(ious[0], ious),
                ),
            )
            report = self.stage("fusion schemes")
            outcomes = at.detected.outcomes([self.members], range(at.frames), report)[self.members]
            kbit = float(np.mean([outcome.bits.mean() for outcome in outcomes])) / 1000
            for iou in sorted({*IOUS, *ious}) if len(ious) == 1 else (*IOUS, ious):
                (judged,), (drawn,) = at.judge_drawn(whole, replace(intact, iou=iou))
                good = iou == intact.threshold and is_as_good(
                    drawn, own, count_blocks(self.judge.frames)
                )
                figures.append(content.SchemeFigures(name, iou, judged, kbit, good))
        return tuple(figures)

    def worth(self) -> tuple[content.SensorWorth, ...]:
        """Shapley values and interactions. They are exact by the detector for small sets, else
        sampled."""
        count = len(self.members)
        if self.small:
            aps = self._aps(all_subsets(count), "subsets")
            worth = exact_worth(lambda _: aps, count)
        else:
            worth = estimate_worth(lambda sets: self._aps(sets, ""), count, rounds=64)
        found = []
        for name, shapley, pairs in zip(
            self.names, worth.shapley.tolist(), worth.synergy.tolist(), strict=True
        ):
            synergy = {
                other: value
                for other, value in zip(self.names, pairs, strict=True)
                if other != name
            }
            found.append(content.SensorWorth(name, shapley, synergy))
        return tuple(found)

    def failures(self) -> tuple[content.FailureCase, ...]:
        """Judge the remaining sensors after one or two failures, the worst first for each
        number."""
        count = len(self.members)
        names = np.array(self.names)
        cases: list[content.FailureCase] = []
        for failing in range(1, min(3, count)):
            left = Cases(failing=failing).expand(np.ones((1, count), np.bool_))[0][1:]
            judged = zip(left, self._judge(left, "failures"), strict=True)
            found = [content.FailureCase(tuple(names[~row].tolist()), each) for row, each in judged]
            cases += sorted(found, key=lambda case: case.judged.ap)
        return tuple(cases)

    def order(self) -> tuple[content.BuildStep, ...]:
        """Order of building, each sensor adding most AP. All steps are judged by the detector."""
        built = np.zeros((1, len(self.members)), np.bool_)
        while not built[-1].all():
            options = built[-1] | np.eye(len(self.members), dtype=np.bool_)[~built[-1]]
            best = int(np.argmax(self._aps(options, "order of building")))
            built = np.concatenate([built, options[best : best + 1]])
        added = np.diff(built, axis=0).argmax(axis=1)
        prices = self.objective.price(self.rows(built[1:])).tolist()
        steps = zip(
            added.tolist(), prices, self._judge(built[1:], "order of building"), strict=True
        )
        return tuple(content.BuildStep(self.names[i], price, each) for i, price, each in steps)


def trace_plan(findings: Findings, candidates: Candidates, detector: Detector) -> dict[str, object]:
    """Provenance of a plan: digests of all inputs, seeds and versions."""
    question = findings.question
    setting = question.setting
    stock = question.stock
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
            name: {"seed": question.part(name).seed, "frames": len(each), "sha256": each.digest()}
            for name, each in zip(PART_FRAMES, findings.traffic, strict=True)
        },
        "bootstrap": {"draws": RESAMPLES, "block_frames": BLOCK_FRAMES, "seed": question.run.seed},
        "versions": versions,
    }


MOST_BOUGHT = 12  # sensors that a sum of money alone may buy
PLAN_FILES = (*REPORT_FILES, *EXCHANGE_FILES, CONTENT)


def plan(question: Question) -> content.Planned:
    """Answer a question with a plan, which says why if nothing may be built.

    The same question has the same plan, byte for byte, whatever the cache and the processes. Raises
    ValueError and OSError for damaged inputs, ImportError without SUMO."""
    if reasons := sentences.refuse_question(question):
        return _refuse(question, reasons)
    try:
        pool = question.setting.pool
    except NoCandidates as error:
        return _refuse(question, (f"There is no candidate: {error}.",))
    check_scorable(question.judged(pool), "detector")
    first = question.part("search")
    if (poses := narrow_pool(question.searched, first)) is not None:
        names = tuple(pool.sensors[c].name for c in poses)
        stock = replace(question.stock, only=names)
        question = replace(question, setting=replace(question.setting, candidates=stock))
        pool = question.setting.pool
    asked = question.at_drawings
    prepared = [Preparation(each.searched, first) for each in asked]
    for each in prepared:
        there = each.visibility.labels
        missing = [
            LABELS[label] for label in question.setting.counted.labels if not (there == label).any()
        ]
        if missing:
            return _refuse(
                question,
                sentences.refuse_traffic(question, missing, each.frames, "simulated"),
                pool,
            )
    everything = [
        Objective.of_moved(each, each.setting.pool, each.visibility, AP_ONLY) for each in prepared
    ]
    excluded = describe_exclusions(everything[0], question.max_kbit, question.currency)
    kept = _keep_buildable(prepared, everything, question.max_kbit)
    alone = np.isin(everything[0].names, [sensor.name for sensor in kept[0][0].sensors])
    most = math.inf if question.max_kbit is None else question.max_kbit
    without = explain_kept(everything[0], alone, most, question.currency)
    if without or not len(kept[0][0]):
        return _refuse(question, without or excluded, pool)
    objectives = [
        Objective.of_moved(each, *seen, AP_ONLY) for each, seen in zip(prepared, kept, strict=True)
    ]
    objective = objectives[0]
    candidates = objectives[0].candidates
    effort = Effort(
        tuple(range(1, _most_sensors(question, candidates) + 1)), min_ap=question.min_ap
    )
    searched = list(zip(objectives, prepared, strict=True))
    if (
        not question.cases.plain
    ):  # what is best intact, in all traffic, may be best at its worst too
        pairs = zip(prepared, kept, strict=True)
        searched += [(Objective.of_moved(each.plain, *seen, AP_ONLY), each) for each, seen in pairs]
    each_found = [
        keep_entrants(
            scored,
            effort,
            first.memo,
            depends_on=each.traffic.digest(),
            others=at_other_ious(scored, each) if scored in objectives else {},
            seed=first.seed,
        )
        for scored, each in searched
    ]
    found = join_entrants(objectives, each_found)
    compared, judge = _prepare_judge(
        question, objectives, question.part("comparison"), compares=True
    )
    if judge.absent:
        return _refuse(
            question,
            sentences.refuse_traffic(question, judge.absent, judge.frames, "judging"),
            pool,
        )
    choice = judging.choose_set(
        objective,
        found,
        judge,
        min_ap=question.min_ap,
        confidence=question.confidence,
        run=question.run,
    )
    judged, final = judge_finally(question, objectives, choice.sets[choice.chosen])
    if final.absent:
        return _refuse(
            question,
            sentences.refuse_traffic(question, final.absent, final.frames, "judging"),
            pool,
        )
    parts = [prepared[0].traffic, compared.traffic, judged.traffic]
    drawings = judging.choose_at_drawings(judge, choice, question.min_ap)
    findings = Findings(
        question, found, choice, objective, prepared[0].network, excluded, parts, drawings
    )
    ground = visible_ground(question.site, [candidates.sensors[c] for c in choice.members])
    answer = build_plan(findings, final, ground)
    moments = pick_moments(final.detected, choice.members, seed=question.run.seed)
    site = mounted.mounted_site(question.site, candidates, choice.members)
    return content.Planned(answer, site, candidates, ground, moments)


def _prepare_judge(
    question: Question, objectives: Sequence[Objective], run: Run, *, compares: bool = False
) -> tuple[Preparation, judging.Judge]:
    """Prepare one part of the traffic at the first drawing, and the judge over all drawings."""
    pairs = zip(question.at_drawings, objectives, strict=True)
    prepared = [
        Preparation(each.judged(objective.candidates), run, compares=compares)
        for each, objective in pairs
    ]
    first, *others = (judging.Judge.of(each, question.run.seed) for each in prepared)
    return prepared[0], replace(first, drawings=tuple(others))


def judge_finally(
    question: Question, objectives: Sequence[Objective], chosen: Bool[np.ndarray, " C"]
) -> tuple[Preparation, judging.Judge]:
    """Prepare the traffic of the last part and its judge, with frames enough for the question's
    width."""
    run = question.part("judgement")
    width = question.width
    while True:
        prepared, judge = _prepare_judge(question, objectives, run)
        frames = prepared.frames
        if width is None or judge.absent or frames >= MOST_FRAMES:
            return prepared, judge
        stage = judging.one_stage(run, "frames of the chosen set", frames)
        ((found,), _) = judge.judge_cases(chosen[None], stage)
        ends = found.counted.high - found.counted.low
        if ends <= width:
            return prepared, judge
        needed = 2 * frames if math.isnan(ends) else frames_for_width(frames, ends, width)
        run = replace(
            run, frames=min(MOST_FRAMES, max(needed, frames + frames // 4 + BLOCK_FRAMES))
        )


def _keep_buildable(
    prepared: Sequence[Preparation], everything: Sequence[Objective], max_kbit: float | None
) -> list[tuple[Candidates, Visibility]]:
    """Candidates that may be built at every drawing of the site, in the same order, and what they
    see at each."""
    rows = [{each.names[c]: int(c) for c in find_buildable(each, max_kbit)} for each in everything]
    names = [name for name in rows[0] if all(name in other for other in rows[1:])]
    chosen = [np.array([places[name] for name in names], np.int64) for places in rows]
    pairs = zip(prepared, chosen, strict=True)
    return [(each.setting.pool.select(own), each.visibility.select(own)) for each, own in pairs]


def find_buildable(objective: Objective, max_kbit: float | None) -> Int64[np.ndarray, " n"]:
    """Candidates that may be built alone and send at most `max_kbit`, which is still allowed."""
    return np.flatnonzero(
        objective.allowed([]) & (objective.loads <= (np.inf if max_kbit is None else max_kbit))
    )


def _refuse(
    question: Question, reasons: tuple[str, ...], candidates: Candidates | None = None
) -> content.Planned:
    verdict = content.Verdict(False, "No set of sensors can be planned.", reasons)
    names = (
        question.site.name,
        "",
        question.cases.threshold,
        question.setting.fusion.name,
        question.currency,
    )
    return content.Planned(
        content.Plan(question.as_dict(), *names, verdict, chosen=None, head=question.stock.head),
        replace(question.site, sensors=()),
        candidates,
    )


def _most_sensors(question: Question, candidates: Candidates) -> int:
    """Most sensors that number, money and mounts allow."""
    each = np.full(len(candidates.mounts), np.inf)
    np.minimum.at(each, candidates.mount, candidates.prices)
    second = np.full(len(candidates.mounts), np.inf)
    np.minimum.at(second, candidates.mount, candidates.model_prices)
    each = np.sort(
        np.concatenate([each[np.isfinite(each)], np.repeat(second, candidates.places - 1)])
    )
    each = each[np.isfinite(each)]
    by_money = int((np.cumsum(each) <= question.setting.most_price * (1 + 1e-9)).sum())
    asked = (
        max(MOST_BOUGHT, len(question.setting.keep))
        if question.sensors is None
        else question.sensors
    )
    return max(1, min(asked, by_money))


def write_plan(planned: content.Planned, out: Path) -> list[Path]:
    """Write a plan's files into a folder, made if missing, all or none; return their paths.

    Files of `PLAN_FILES` that an earlier plan left there and this one lacks are removed. Raises
    ImportError without the packages of `coview[report]`, OSError if the folder cannot be
    written."""
    plan = planned.plan
    with writing_together(out) as folder:
        write_text(folder / CONTENT, format_json(plan))
        write_report(planned, folder)
        if planned.ground is not None and planned.candidates is not None:
            unused = [
                mount for mount in planned.candidates.mounts if mount.name in plan.poles_unused
            ]
            write_exchange(
                folder,
                planned.site,
                plan.sensors,
                planned.ground,
                unused=unused,
                currency=plan.currency,
            )
        names = sorted(path.name for path in folder.iterdir())
    for name in set(PLAN_FILES).difference(names):
        (out / name).unlink(missing_ok=True)
    return [out / name for name in names]


def format_json(plan: content.Plan) -> str:
    """Format a plan as JSON, the same for the same plan."""
    return (
        json.dumps(replace_infinite(plan.as_dict()), indent=1, allow_nan=False, ensure_ascii=False)
        + "\n"
    )
