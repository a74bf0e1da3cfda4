"""`plan`: from a question to a plan. The cache keeps its stages, so an interrupted plan resumes.

There are three parts of traffic with different seeds. Searches see the first, the detector compares
the entrants on the second, and the plan's figures for the chosen set are from the third. In
breakdowns, vehicles and false alarms belong to the group of their box's centre, and a hit belongs
to the group of the vehicle it hit."""

import json
import math
import platform
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from itertools import pairwise
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
from placement_env.report.planning.plan_folder import PLAN_FILE, format_stock
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

PLAN_FILES = (*REPORT_FILES, *EXCHANGE_FILES, PLAN_FILE)
RANGE_ENDS_M = (10.0, 20.0, 30.0, 40.0)  # distances from the nearest sensor that end groups
CENTRE_SHARE = 0.25  # radius of the middle zone, as a share of the area's shorter side
MOMENTS = 8  # frames of pictures
MOMENT_POINTS = 2500  # points of each sensor in such a frame, at most
ERROR_DRAW_COUNT = 10  # draws of errors in which the chosen set is judged
MAX_DRAW_FRAMES = 60  # frames of each draw of errors
MAX_FINAL_FRAMES = 1200  # frames that a plan may use to reach a width
MAX_SUBSET_SENSORS = 6  # of larger sets, not every subset is judged by the detector
MAX_BOUGHT_SENSORS = 12  # sensors that money may buy if their number is not limited
TRACED_PACKAGES = (
    "numpy",
    "torch",
    "open3d-cpu",
    "open3d",
    "eclipse-sumo",
    "libsumo",
    "ortools",
    "shapely",
)

GroupOf = Callable[[Float64[np.ndarray, "n 7"]], Int64[np.ndarray, " n"]]


@dataclass(frozen=True, eq=False)
class Scored:
    """Detections of one set, box by box.

    Attributes:
        truths: Boxes of the scored objects of all frames, in order.
        truth_frame: Frame of each object.
        truth_label: Class of each object.
        points: Number of the set's points on each object.
        boxes: Boxes of the detections.
        scores: Score of each detection.
        frame: Frame of each detection.
        label: Class of each detection.
        hits: Index of the object that each detection hits at each IoU threshold, or FALSE_ALARM or
            IGNORED.
        frames: Number of frames.
        classes: Classes that count."""

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
        self,
        label: int,
        truths: Bool[np.ndarray, " t"],
        is_counted: Bool[np.ndarray, " n"],
        iou_index: int,
    ) -> Tally:
        """Tally truths and detections of one class and IoU."""
        is_truth = truths & (self.truth_label == label)
        is_detection = is_counted & (self.label == label)
        count = np.bincount(self.truth_frame[is_truth], minlength=self.frames)
        return Tally(
            self.scores[is_detection],
            self.hits[iou_index, is_detection] >= 0,
            self.frame[is_detection],
            count,
        )


def score_boxes(judge: judging.Judge, members: tuple[int, ...]) -> Scored:
    """Collect detections of the chosen set in all frames of a judge."""
    detected = judge.detected
    outcomes = judge.outcomes(members)
    objects = [detected.renders.objects(k)[detected.scored(k)] for k in range(judge.frames)]
    detections = [detected.detections(members, k) for k in range(judge.frames)]
    frame = np.repeat(np.arange(judge.frames), [len(outcome.scores) for outcome in outcomes])
    object_counts = list(map(len, objects))
    first_truth = np.cumsum([0, *object_counts])[frame]
    iou_rows = [detected.ious.index(iou) for iou in judge.cases.ious]
    truth = np.concatenate([outcome.truth for outcome in outcomes], axis=1)[iou_rows]
    return Scored(
        truths=np.concatenate([frame_objects.boxes for frame_objects in objects]),
        truth_frame=np.repeat(np.arange(judge.frames), object_counts),
        truth_label=np.concatenate([frame_objects.labels for frame_objects in objects]),
        points=_count_points(detected, members),
        boxes=np.concatenate([frame_detections.boxes for frame_detections in detections]),
        scores=np.concatenate([outcome.scores for outcome in outcomes]),
        frame=frame,
        label=np.concatenate([frame_detections.labels for frame_detections in detections]),
        hits=np.where(truth >= 0, first_truth + truth, truth).astype(np.int64),
        frames=judge.frames,
        classes=detected.classes,
    )


def fuse_clouds(detected: Detected, members: Sequence[int], k: int) -> Float32[np.ndarray, "n 3"]:
    """Join the points of a set's sensors in frame k."""
    no_points = np.empty((0, 3), np.float32)
    return np.concatenate([no_points, *(detected.renders.clouds(k, c) for c in members)])


def _count_points(detected: Detected, members: Sequence[int]) -> Int64[np.ndarray, " t"]:
    """Count the points of a set on each scored object, frame after frame."""
    counts = [np.empty(0, np.int64)]
    for k in range(detected.frames):
        cloud = fuse_clouds(detected, members, k)
        boxes = detected.renders.objects(k).boxes[detected.scored(k)]
        counts.append(count_on_ground(cloud, boxes, detected.renders.site))
    return np.concatenate(counts)


def _row(
    name: str, judged: content.Judgement | None, points: Int64[np.ndarray, " t"]
) -> content.BreakdownRow:
    return content.BreakdownRow(name, judged, float(points.mean()) if len(points) else None)


def by_group(
    scored: Scored, names: Sequence[str], group_of: GroupOf, seed: int
) -> tuple[content.BreakdownRow, ...]:
    """Judge each group. group_of: function that returns the group of each box."""
    truth_groups = group_of(scored.truths)
    detection_groups = np.where(scored.hits == IGNORED, -1, group_of(scored.boxes))
    is_hit = scored.hits >= 0
    detection_groups[is_hit] = truth_groups[scored.hits[is_hit]]
    rows = []
    for number, name in enumerate(names):
        is_truth = truth_groups == number
        judgement = None
        if is_truth.any():
            tallies = []
            for iou_index, groups in enumerate(detection_groups):
                is_counted = groups == number
                tallies.append(_tally_classes(scored, is_truth, is_counted, iou_index))
            judgement = judging.judge_tallies(tallies, scored.classes, seed)
        rows.append(_row(name, judgement, scored.points[is_truth]))
    return tuple(rows)


def _tally_classes(
    scored: Scored,
    is_truth: Bool[np.ndarray, " t"],
    is_counted: Bool[np.ndarray, " n"],
    iou_index: int,
) -> list[Tally]:
    labels = scored.classes.labels
    return [scored.tally(label, is_truth, is_counted, iou_index) for label in labels]


def by_zone(scored: Scored, site: Site, seed: int) -> tuple[content.BreakdownRow, ...]:
    """Judge the middle and the quarters around it, named by the compass."""
    xmin, ymin, xmax, ymax = site.area
    middle = np.array([xmin + xmax, ymin + ymax]) / 2
    radius = CENTRE_SHARE * min(xmax - xmin, ymax - ymin)
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
    positions = np.array([sensor.position[:2] for sensor in sensors])
    edges = pairwise((0.0, *RANGE_ENDS_M))
    names = [f"{start:g} to {end:g} m" for start, end in edges]
    names.append(f"beyond {RANGE_ENDS_M[-1]:g} m")

    def group_of(boxes: Float64[np.ndarray, "n 7"]) -> Int64[np.ndarray, " n"]:
        distances = np.linalg.norm(boxes[:, None, :2] - positions, axis=2).min(axis=1)
        return np.searchsorted(RANGE_ENDS_M, distances).astype(np.int64)

    return by_group(scored, names, group_of, seed)


def by_approach(scored: Scored, site: Site, seed: int) -> tuple[content.BreakdownRow, ...]:
    """Judge by the lane nearest to each vehicle."""
    approaches = find_approaches(site)
    rows = by_group(scored, approaches.names, approaches.locate, seed)
    return tuple(row for row in rows if row.judged is not None)


def measure_blind_streets(site: Site, ground: Ground) -> dict[str, float]:
    """Measure the lanes that no sensor sees (m²), by street, the largest first."""
    rows, columns = np.nonzero(ground.open_ground & ground.lanes & (ground.views == 0))
    boxes = np.zeros((len(rows), 7))
    boxes[:, 0] = ground.x[columns]
    boxes[:, 1] = ground.y[rows]
    streets = find_streets(site)
    areas = np.bincount(streets.locate(boxes), minlength=len(streets.names)) * ground.cell**2
    order = np.argsort(-areas, kind="stable")
    return {streets.names[k]: float(areas[k]) for k in order if areas[k]}


def by_level(
    scored: Scored, judge: judging.Judge, members: tuple[int, ...]
) -> tuple[content.BreakdownRow, ...]:
    """Judge each level of traffic; empty if traffic is undivided."""
    names = LEVEL_NAMES[judge.cases.levels]
    rows = []
    for name, judgement, frames in zip(names, judge.by_level(members), judge.levels, strict=False):
        points = scored.points[np.isin(scored.truth_frame, frames)]
        rows.append(_row(name, judgement, points))
    return tuple(rows)


def by_errors(judge: judging.Judge, members: tuple[int, ...]) -> tuple[content.BreakdownRow, ...]:
    """Judge each error profile, with failures and levels if they count; empty for one profile."""
    judgements = judge.by_errors(members)
    return tuple(
        _row(name, judgements[name], _count_points(detected, members))
        for name, detected in zip(judgements, judge.profiles, strict=False)
    )


def by_draw(
    judge: judging.Judge, members: tuple[int, ...], run: Run = Run()
) -> tuple[content.DrawnErrors, ...]:
    """Judge a set at each error profile in several draws of the errors.

    The errors of one draw are the same in all frames. run: reports the draws."""
    frames = min(judge.frames, MAX_DRAW_FRAMES)
    rows = []
    for detected in judge.profiles:
        renders = detected.renders
        if not isinstance(renders, Renders) or only_own_noise(renders.errors):
            continue
        report = run.stage(f"draws of the errors {renders.errors.name}", ERROR_DRAW_COUNT)
        aps: list[float] = []
        for seed in range(1, ERROR_DRAW_COUNT + 1):
            aps.append(_judge_draw(judge, detected, renders, members, seed))
            if report is not None:
                report(seed)
        mean = float(np.mean(aps))
        tenth = float(np.quantile(aps, 0.1))
        rows.append(content.DrawnErrors(renders.errors.name, tuple(aps), mean, tenth, frames))
    return tuple(rows)


def _judge_draw(
    judge: judging.Judge, detected: Detected, renders: Renders, members: Sequence[int], seed: int
) -> float:
    drawn_renders = renders.draw_once(seed, members, min(judge.frames, MAX_DRAW_FRAMES))
    options = {name: getattr(detected, name) for name in ("codec", "memo", "processes", "classes")}
    ious = judge.cases.ious
    redrawn = Detected(drawn_renders, detected.detector, detected.scheme, **options)
    figures = redrawn.at(ious[0], ious).estimates(np.ones((1, len(members)), np.bool_))
    return float(np.mean([figures[iou].ap[0] for iou in ious]))


def by_class(
    judge: judging.Judge, members: tuple[int, ...], labels: Sequence[str] = LABELS
) -> tuple[content.ClassSeen, ...]:
    """Return the coverage of each class: share of its road users with `LEAST` points or more."""
    detected = judge.detected
    site = judge.detected.renders.site
    frame_labels = []
    frame_seen = []
    for k in range(judge.frames):
        objects = detected.renders.objects(k)
        objects = objects[has_centre_inside(objects.boxes, site.area)]
        points = count_on_ground(fuse_clouds(detected, members, k), objects.boxes, site)
        frame_labels.append(objects.labels)
        frame_seen.append(points >= LEAST)
    object_labels = np.concatenate(frame_labels)
    is_seen = np.concatenate(frame_seen)
    rows = []
    for label in labels:
        label_seen = is_seen[object_labels == label_index(label)]
        share = float(label_seen.mean()) if len(label_seen) else None
        rows.append(content.ClassSeen(label, len(label_seen), int(LEAST), share))
    return tuple(rows)


def pick_moments(
    detected: Detected,
    members: tuple[int, ...],
    *,
    count: int = MOMENTS,
    points: int = MOMENT_POINTS,
    seed: int = 0,
) -> tuple[content.SceneMoment, ...]:
    """Pick the first run of `count` frames with the most vehicles.

    points: number of points to keep of each cloud, drawn from the seed."""
    object_counts = np.array([detected.scored(k).sum() for k in range(detected.frames)], np.int64)
    count = min(count, detected.frames)
    first = int(np.convolve(object_counts, np.ones(count, np.int64), mode="valid").argmax())
    return tuple(_moment(detected, members, k, points, seed) for k in range(first, first + count))


def _moment(
    detected: Detected, members: tuple[int, ...], k: int, points: int, seed: int
) -> content.SceneMoment:
    truth = detected.outcomes([members], [k])[members][0].truth[detected.ious.index(detected.iou)]
    objects = detected.renders.objects(k)
    scored = detected.scored(k)
    hit = np.zeros(len(objects), np.bool_)
    hit[np.flatnonzero(scored)[truth[truth > FALSE_ALARM]]] = True
    clouds = tuple(thin(detected.renders.clouds(k, c), points, [seed, k, c]) for c in members)
    return content.SceneMoment(
        clouds, objects, detected.detections(members, k), hit, ~scored, truth >= 0, truth == IGNORED
    )


def thin(
    cloud: Float32[np.ndarray, "n 3"], points: int, seed: list[int]
) -> Float32[np.ndarray, "m 3"]:
    """Draw at most `points` points of a cloud, in order."""
    if len(cloud) <= points:
        return cloud
    return cloud[np.sort(np.random.default_rng(seed).choice(len(cloud), points, replace=False))]


@dataclass(frozen=True, eq=False)
class Findings:
    """Everything that led to the chosen set.

    Attributes:
        question: The question.
        found: Entrants of the searches.
        choice: The answer among the entrants.
        objective: Objective of the searches.
        network: Name of the shipped network that detects if the question has no detector.
        excluded: Sentences on what excludes candidates.
        traffic: Traffic of searches, comparison and judgement.
        drawings: Results at each drawing, if there are several."""

    question: Question
    found: Entrants
    choice: judging.Choice
    objective: Objective
    network: str
    excluded: tuple[str, ...]
    traffic: Sequence[Traffic]
    drawings: tuple[content.DrawingResult, ...] = ()


def build_plan(findings: Findings, final: judging.Judge, ground: Ground) -> content.Plan:
    """Put the plan together.

    final: judge on the final traffic; ground: ground that the chosen sensors see."""
    question = findings.question
    choice = findings.choice
    objective = findings.objective
    candidates = objective.candidates
    site = question.site
    seed = question.run.seed
    members = choice.members
    chosen_set = ChosenSet(members, choice.option.sensors, final, objective, question.run)
    judgements, draws = final.judge_cases(choice.sets[choice.chosen][None], chosen_set.stage)
    judgement = judgements[0]
    check_stages(findings, judgement.judged)
    sensor_kbit = final.kbit(members)
    kbit = float(sensor_kbit.sum(axis=0).mean())
    option = replace(
        choice.option,
        **judgement._asdict(),
        kbit=kbit,
        kbit_per_sensor=kbit / len(members),
        fits_links=objective.fits_links(members, sensor_kbit),
    )
    scored = score_boxes(final, members)
    sensors = mounted.format_sensors(
        site,
        candidates,
        members,
        kbit=sensor_kbit,
        catalogue=question.stock.catalogue,
        link_share=question.setting.link_share,
    )
    links = mounted.link_loads(sensors, limited=question.setting.fusion.sends_points)
    detector: str = detector_origin(final.detected.detector)["detector"]
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
        confidence=judge_sureness(choice.confidence, judgement.counted, draws[0]),
        sensors=sensors,
        considered=tuple(sorted(choice.options, key=_rank_considered)),
        near_optimal=choice.near_optimal,
        front=judging.find_front_options(choice.options),
        schemes=chosen_set.schemes(),
        by_zone=by_zone(scored, site, seed),
        by_range=by_range(scored, [candidates.sensors[c] for c in members], seed),
        by_approach=by_approach(scored, site, seed),
        by_level=levels,
        by_errors=by_errors(final, members),
        by_draw=by_draw(final, members, question.run),
        by_drawing=findings.drawings,
        by_class=by_class(final, members),
        class_ap=(*final.by_class(members), *final.by_other_class(members)),
        worth=chosen_set.worth(),
        failures=chosen_set.failures(),
        links=links,
        materials=mounted.bill_of_materials(sensors),
        running=mounted.bill_of_rates(sensors, question.stock.catalogue),
        order=chosen_set.order(),
        ground=ground_shares(ground, [sensor.name for sensor in sensors]),
        blind_streets=measure_blind_streets(site, ground),
        poles_unused=tuple(mount.name for mount in mounted.unused_mounts(candidates, members)),
        origins=count_things(replace(site, mounts=candidates.mounts)),
        head=question.stock.head,
        stock=format_stock(question, question.setting.pool),
        assumptions=sentences.list_assumptions(
            question, objective.fidelity, detector, sampled=not chosen_set.small
        ),
        unknown=sentences.list_unknowns(judgement.counted, levels),
        provenance=trace_plan(findings, candidates, final.detected.detector),
    )
    reasons = sentences.explain_choice(
        question,
        plan,
        choice.option,
        choice.rule,
        considered=findings.found.considered,
        fidelity=objective.fidelity,
    )
    names = {
        candidates.sensors[c].name: sensor.name for c, sensor in zip(members, sensors, strict=True)
    }
    return content.rename(replace(plan, why=reasons), names)


def _rank_considered(option: content.PlanOption) -> tuple[bool, float]:
    """Sort key: judged sets by AP, then the other sets by predicted AP."""
    if option.counted:
        return False, -option.counted.ap
    return True, -option.predicted


def check_stages(findings: Findings, judged: content.Judgement) -> None:
    """Raise ValueError if prediction, comparison and judgement of the answer exclude each other.

    judged: the answer, intact. The prediction is for the shipped network without errors, so it is
    compared with such a detector only."""
    choice = findings.choice
    question = findings.question
    objective = findings.objective
    final_figure = judging.state_figure("in the judgement", judged)
    if (compared := choice.option.judged) is not None:
        compared_figure = judging.state_figure("in the comparison", compared)
        check_agreement(choice.option.sensors, compared_figure, final_figure)
    is_predicted = (
        question.setting.detector is None and question.cases.noise_only and question.cases.plain
    )
    if is_predicted and isinstance(objective.scored_by, Doubting):
        spread = float(objective.scored_by.spread(choice.sets[[choice.chosen]])[0])
        if math.isfinite(spread):
            figures = choice.option.predicted, judged.vehicles, judged.frames, spread
            predicted_figure = StageFigure("by the prediction", *figures)
            check_agreement(choice.option.sensors, predicted_figure, final_figure)


def judge_sureness(
    confidence: float | None, judged: content.Judgement, drawn: Float64[np.ndarray, " resamples"]
) -> float | None:
    """Return the confidence that no set of as many sensors is better.

    The judgement may raise it, because no AP exceeds 1. Returns None for an AP so near 1 that no
    set could be better, if there are too few frames for an interval that would show it."""
    if confidence is None or not judged.known:
        return None if judged.ap > 1 - AP_TOLERANCE else confidence
    return max(confidence, share_beyond_reach(drawn))


@dataclass(frozen=True, eq=False)
class ChosenSet:
    """Schemes, worth of each sensor, failures and order of building of the chosen set.

    Attributes:
        members: Indices of its candidates, ascending.
        names: Names of its candidates.
        judge: Judge on the final traffic.
        objective: Objective of the searches, which scores subsets of large sets.
        run: Run of the plan."""

    members: tuple[int, ...]
    names: tuple[str, ...]
    judge: judging.Judge
    objective: Objective
    run: Run = Run()

    @property
    def small(self) -> bool:
        """True if the detector judges every subset."""
        return len(self.members) <= MAX_SUBSET_SENSORS

    def stage(self, name: str) -> Callable[[int], None] | None:
        """Return a callback that counts the frames of a stage."""
        return self.run.stage(f"frames of the {name}", self.judge.frames)

    def rows(self, subsets: Bool[np.ndarray, "n k"]) -> Bool[np.ndarray, "n C"]:
        """Expand subsets of the set to rows over all candidates."""
        rows = np.zeros((len(subsets), len(self.judge.detected.renders.sensors)), np.bool_)
        rows[:, list(self.members)] = subsets
        return rows

    def _judge(self, subsets: Bool[np.ndarray, "n k"], stage: str) -> list[content.Judgement]:
        return self.judge.judge(self.rows(subsets), progress=self.stage(stage))

    def _aps(self, subsets: Bool[np.ndarray, "n k"], stage: str) -> Float64[np.ndarray, " n"]:
        """Return the AP of subsets, by the detector for small sets, else by the objective."""
        if self.small:
            return np.array([judgement.ap for judgement in self._judge(subsets, stage)])
        return self.objective.scores(self.rows(subsets)).ap

    def schemes(self) -> tuple[content.SchemeFigures, ...]:
        """Judge the set under every scheme at every IoU."""
        judge = replace(self.judge, drawings=())
        planned = judge.detected
        intact = judge.intact
        ious = intact.ious
        whole_set = self.rows(np.ones((1, len(self.members)), np.bool_))
        planned_draws = judge.judge_drawn(whole_set, intact)[1][0]
        blocks = count_blocks(self.judge.frames)
        thresholds = sorted({*IOUS, *ious}) if len(ious) == 1 else (*IOUS, ious)
        shared_names = ("codec", "memo", "processes", "classes")
        shared = {name: getattr(planned, name) for name in shared_names}
        figures = []
        for scheme in PAPER_SCHEMES:
            detected = Detected(planned.renders, planned.detector, scheme, **shared)
            scheme_judge = replace(judge, profiles=(detected.at(ious[0], ious),))
            report = self.stage("fusion schemes")
            frames = range(scheme_judge.frames)
            outcomes = scheme_judge.detected.outcomes([self.members], frames, report)[self.members]
            kbit = float(np.mean([outcome.bits.mean() for outcome in outcomes])) / 1000
            for iou in thresholds:
                judgements, draws = scheme_judge.judge_drawn(whole_set, replace(intact, iou=iou))
                as_good = iou == intact.threshold and is_as_good(draws[0], planned_draws, blocks)
                figures.append(content.SchemeFigures(scheme, iou, judgements[0], kbit, as_good))
        return tuple(figures)

    def worth(self) -> tuple[content.SensorWorth, ...]:
        """Return Shapley values and interactions, exact for small sets, else sampled."""
        count = len(self.members)
        if self.small:
            aps = self._aps(all_subsets(count), "subsets")
            worth = exact_worth(lambda _: aps, count)
        else:
            worth = estimate_worth(lambda sets: self._aps(sets, ""), count, rounds=64)
        sensor_worths = []
        for k, name in enumerate(self.names):
            synergy = dict(zip(self.names, worth.synergy[k].tolist(), strict=True))
            del synergy[name]
            sensor_worths.append(content.SensorWorth(name, float(worth.shapley[k]), synergy))
        return tuple(sensor_worths)

    def failures(self) -> tuple[content.FailureCase, ...]:
        """Judge the remaining sensors after one failure, then after two, the worst case first."""
        count = len(self.members)
        names = np.array(self.names)
        cases: list[content.FailureCase] = []
        for failing in range(1, min(3, count)):
            remaining = Cases(failing=failing).expand(np.ones((1, count), np.bool_))[0][1:]
            judgements = self._judge(remaining, "failures")
            failure_cases = [
                content.FailureCase(tuple(names[~is_left].tolist()), judgement)
                for is_left, judgement in zip(remaining, judgements, strict=True)
            ]
            cases += sorted(failure_cases, key=lambda case: case.judged.ap)
        return tuple(cases)

    def order(self) -> tuple[content.BuildStep, ...]:
        """Return the order of building, in which each sensor adds the most AP.

        The detector judges all steps."""
        built = np.zeros((1, len(self.members)), np.bool_)
        while not built[-1].all():
            options = built[-1] | np.eye(len(self.members), dtype=np.bool_)[~built[-1]]
            best = int(np.argmax(self._aps(options, "order of building")))
            built = np.concatenate([built, options[best : best + 1]])
        added = np.diff(built, axis=0).argmax(axis=1)
        prices = self.objective.price(self.rows(built[1:])).tolist()
        judgements = self._judge(built[1:], "order of building")
        names = [self.names[i] for i in added]
        return tuple(map(content.BuildStep, names, prices, judgements))


def trace_plan(findings: Findings, candidates: Candidates, detector: Detector) -> dict[str, object]:
    """Return the provenance of a plan: digests of all inputs, seeds and versions."""
    question = findings.question
    setting = question.setting
    stock = question.stock
    keep_out = repr([area.wkt for area in stock.keep_out])
    versions = {"coview": coview_version(), "python": platform.python_version()}
    for name in TRACED_PACKAGES:
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    traffic = {}
    for name, part in zip(PART_FRAMES, findings.traffic, strict=True):
        seed = question.part(name).seed
        traffic[name] = {"seed": seed, "frames": len(part), "sha256": part.digest()}
    return {
        "site": question.site.name,
        "site_sha256": sha256(format_site(question.site).encode()).hexdigest(),
        "poles_sha256": stock.poles_digest,
        "catalogue_sha256": None if stock.catalogue is None else stock.catalogue.digest,
        "keep_out_sha256": sha256(keep_out.encode()).hexdigest(),
        "candidates": candidates.digest(),
        **detector_origin(detector),
        "network": findings.network,
        "search_fidelity": findings.objective.fidelity,
        "classes": setting.counted.origin,
        "codec": setting.codec.digest,
        "errors": question.cases.errors_origin,
        "traffic": traffic,
        "bootstrap": {"draws": RESAMPLES, "block_frames": BLOCK_FRAMES, "seed": question.run.seed},
        "versions": versions,
    }


def plan(question: Question) -> content.Planned:
    """Answer a question with a plan, which gives reasons if nothing may be built.

    The same question has the same plan, byte for byte, whatever the cache and the processes. Raises
    ValueError and OSError for damaged inputs, ImportError without SUMO."""
    if reasons := sentences.refuse_question(question):
        return _refuse(question, reasons)
    try:
        pool = question.setting.pool
    except NoCandidates as error:
        return _refuse(question, (f"There is no candidate: {error}.",))
    check_scorable(question.judged(pool), "detector")
    search_run = question.part("search")
    question = _narrow(question, search_run)
    pool = question.setting.pool
    prepared = [Preparation(drawing.searched, search_run) for drawing in question.at_drawings]
    for preparation in prepared:
        missing = _list_missing(question, preparation)
        if missing:
            frames = preparation.frames
            reasons = sentences.refuse_traffic(question, missing, frames, "simulated")
            return _refuse(question, reasons, pool)
    all_objectives = [
        Objective.from_view(preparation, preparation.setting.pool, preparation.visibility, AP_ONLY)
        for preparation in prepared
    ]
    excluded = describe_exclusions(all_objectives[0], question.max_kbit, question.currency)
    buildable = _keep_buildable(prepared, all_objectives, question.max_kbit)
    buildable_names = [sensor.name for sensor in buildable[0][0].sensors]
    is_buildable = np.isin(all_objectives[0].names, buildable_names)
    max_kbit = math.inf if question.max_kbit is None else question.max_kbit
    obstacles = explain_kept(all_objectives[0], is_buildable, max_kbit, question.currency)
    if obstacles or not buildable_names:
        return _refuse(question, obstacles or excluded, pool)
    objectives = [
        Objective.from_view(preparation, *view, AP_ONLY)
        for preparation, view in zip(prepared, buildable, strict=True)
    ]
    objective = objectives[0]
    candidates = objective.candidates
    entrants = _search(question, search_run, prepared, objectives, buildable)
    compared, judge = _prepare_judge(
        question, objectives, question.part("comparison"), compares=True
    )
    if judge.absent:
        reasons = sentences.refuse_traffic(question, judge.absent, judge.frames, "judging")
        return _refuse(question, reasons, pool)
    choice = judging.choose_set(
        objective,
        entrants,
        judge,
        min_ap=question.min_ap,
        confidence=question.confidence,
        run=question.run,
    )
    judged, final = judge_finally(question, objectives, choice.sets[choice.chosen])
    if final.absent:
        reasons = sentences.refuse_traffic(question, final.absent, final.frames, "judging")
        return _refuse(question, reasons, pool)
    parts = [prepared[0].traffic, compared.traffic, judged.traffic]
    drawings = judging.choose_at_drawings(judge, choice, question.min_ap)
    findings = Findings(
        question, entrants, choice, objective, prepared[0].network, excluded, parts, drawings
    )
    ground = visible_ground(question.site, [candidates.sensors[c] for c in choice.members])
    answer = build_plan(findings, final, ground)
    moments = pick_moments(final.detected, choice.members, seed=question.run.seed)
    site = mounted.mounted_site(question.site, candidates, choice.members)
    return content.Planned(answer, site, candidates, ground, moments)


def _narrow(question: Question, run: Run) -> Question:
    """Return the question with the poses that see most, if there are too many to search."""
    narrowed_poses = narrow_pool(question.searched, run)
    if narrowed_poses is None:
        return question
    pool = question.setting.pool
    names = tuple(pool.sensors[c].name for c in narrowed_poses)
    stock = replace(question.stock, only=names)
    return replace(question, setting=replace(question.setting, candidates=stock))


def _list_missing(question: Question, preparation: Preparation) -> list[str]:
    """List the counted classes that no traffic of a preparation has."""
    seen_labels = preparation.visibility.labels
    counted_labels = question.setting.counted.labels
    return [LABELS[label] for label in counted_labels if not (seen_labels == label).any()]


def _search(
    question: Question,
    run: Run,
    prepared: Sequence[Preparation],
    objectives: Sequence[Objective],
    views: Sequence[tuple[Candidates, Visibility]],
) -> Entrants:
    """Search for entrants at each drawing of the site.

    If the cases have failures or levels, the intact sets in all traffic are searched too, because
    the best of them may be best in the worst case."""
    max_count = _max_sensors(question, objectives[0].candidates)
    effort = Effort(tuple(range(1, max_count + 1)), min_ap=question.min_ap)
    entrant_lists = [
        keep_entrants(
            objective,
            effort,
            run.memo,
            depends_on=preparation.traffic.digest(),
            others=at_other_ious(objective, preparation),
            seed=run.seed,
        )
        for objective, preparation in zip(objectives, prepared, strict=True)
    ]
    if not question.cases.plain:
        entrant_lists += [
            keep_entrants(
                Objective.from_view(preparation.plain, *view, AP_ONLY),
                effort,
                run.memo,
                depends_on=preparation.traffic.digest(),
                others={},
                seed=run.seed,
            )
            for preparation, view in zip(prepared, views, strict=True)
        ]
    return join_entrants(objectives, entrant_lists)


def _prepare_judge(
    question: Question, objectives: Sequence[Objective], run: Run, *, compares: bool = False
) -> tuple[Preparation, judging.Judge]:
    """Prepare one part of the traffic at the first drawing, and the judge over all drawings."""
    prepared = [
        Preparation(drawing.judged(objective.candidates), run, compares=compares)
        for drawing, objective in zip(question.at_drawings, objectives, strict=True)
    ]
    judges = [
        judging.Judge.from_preparation(preparation, question.run.seed) for preparation in prepared
    ]
    return prepared[0], replace(judges[0], drawings=tuple(judges[1:]))


def judge_finally(
    question: Question, objectives: Sequence[Objective], is_member: Bool[np.ndarray, " C"]
) -> tuple[Preparation, judging.Judge]:
    """Prepare the last part of the traffic and its judge, with enough frames for the width."""
    run = question.part("judgement")
    width = question.width
    while True:
        prepared, judge = _prepare_judge(question, objectives, run)
        frames = prepared.frames
        if width is None or judge.absent or frames >= MAX_FINAL_FRAMES:
            return prepared, judge
        stage = judging.one_stage(run, "frames of the chosen set", frames)
        judgements, _ = judge.judge_cases(is_member[None], stage)
        judgement = judgements[0].counted
        interval_width = judgement.high - judgement.low
        if interval_width <= width:
            return prepared, judge
        needed = 2 * frames
        if not math.isnan(interval_width):
            needed = frames_for_width(frames, interval_width, width)
        needed = max(needed, frames + frames // 4 + BLOCK_FRAMES)
        run = replace(run, frames=min(MAX_FINAL_FRAMES, needed))


def _keep_buildable(
    prepared: Sequence[Preparation], objectives: Sequence[Objective], max_kbit: float | None
) -> list[tuple[Candidates, Visibility]]:
    """Return the candidates that may be built at every drawing, and what they see at each.

    They have the same order at every drawing."""
    rows = []  # index by name, at each drawing
    for objective in objectives:
        indices = find_buildable(objective, max_kbit)
        rows.append({objective.names[c]: int(c) for c in indices})
    common = set(rows[0]).intersection(*rows[1:])
    names = [name for name in rows[0] if name in common]
    views = []
    for preparation, index_by_name in zip(prepared, rows, strict=True):
        indices = np.array([index_by_name[name] for name in names], np.int64)
        candidates = preparation.setting.pool.select(indices)
        views.append((candidates, preparation.visibility.select(indices)))
    return views


def find_buildable(objective: Objective, max_kbit: float | None) -> Int64[np.ndarray, " n"]:
    """Return the candidates that may be built first and send at most `max_kbit`."""
    limit = np.inf if max_kbit is None else max_kbit
    return np.flatnonzero(objective.allowed([]) & (objective.loads <= limit))


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


def _max_sensors(question: Question, candidates: Candidates) -> int:
    """Return the largest number of sensors that budget and mounts allow."""
    first_prices = np.full(len(candidates.mounts), np.inf)  # cheapest first sensor of each mount
    np.minimum.at(first_prices, candidates.mount, candidates.prices)
    more_prices = np.full(len(candidates.mounts), np.inf)  # cheapest further sensor of each mount
    np.minimum.at(more_prices, candidates.mount, candidates.model_prices)
    prices = np.concatenate([first_prices, np.repeat(more_prices, candidates.places - 1)])
    prices = np.sort(prices[np.isfinite(prices)])
    max_price = question.setting.most_price * (1 + 1e-9)
    affordable = int((np.cumsum(prices) <= max_price).sum())
    max_count = question.sensors
    if max_count is None:
        max_count = max(MAX_BOUGHT_SENSORS, len(question.setting.keep))
    return max(1, min(max_count, affordable))


def write_plan(planned: content.Planned, out: Path) -> list[Path]:
    """Write a plan's files into a folder, made if missing, all or none; return their paths.

    Files of `PLAN_FILES` that an earlier plan left there and this one lacks are removed. Raises
    ImportError without the packages of `coview[report]`, OSError if the folder cannot be
    written."""
    plan = planned.plan
    with writing_together(out) as folder:
        write_text(folder / PLAN_FILE, format_json(plan))
        write_report(planned, folder)
        if planned.ground is not None and planned.candidates is not None:
            mounts = planned.candidates.mounts
            unused = [mount for mount in mounts if mount.name in plan.poles_unused]
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
    values = replace_infinite(plan.as_dict())
    return json.dumps(values, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
