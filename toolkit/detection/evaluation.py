"""Score fusion schemes and sensor sets on a recording: the first table of the paper, and more.

What a sensor sees and detects is computed once per frame and shared by all schemes and sets
(`toolkit.detection.view`). Only the fused boxes of a frame are kept. Three protocols define the
objects to find:

- `exact`: objects whose centre is in the site's area. Objects outside it are ignored, neither
  misses nor false alarms (`counted` of `toolkit.detection.metrics.evaluate`).
- `published`: the same, but objects outside the area are removed, and detections are matched as in
  the published code.
- `measured`, the rule for recorded labels: objects in the area, in the region with complete labels,
  with at least one point. An object labelled twice counts once. Detections outside the region with
  complete labels do not count.

Each class is scored separately: a cyclist reported as a pedestrian is a false alarm for pedestrians
and a miss for cyclists. Detections are scored as the detector reports them, above its score
threshold; `ClassFigures` holds precision and recall at that threshold. With a breakdown, AP is also
given by range, by points, and as KITTI and nuScenes count it (`toolkit.detection.breakdown`).
Milliseconds are the median over frames, from measurements to fused boxes, with sensors working in
parallel as in the paper."""

import json
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import chain
from pathlib import Path
from time import perf_counter
from typing import Any, Literal, overload

import numpy as np

from toolkit.arrays import Float64, Mask
from toolkit.boxes import Overlap, count_points
from toolkit.calibration.empty_scene import Scenes
from toolkit.calibration.poses import FoundPose
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.recordings import Part, ReadRecording, Reads, with_errors
from toolkit.datasets.records import check_labels
from toolkit.detection.breakdown import FrameTruth, GroupRow, format_rows, group_rows, select_truth
from toolkit.detection.codec import PAPER, Codec, ImageCodec, check_codec
from toolkit.detection.detect import describe_summary
from toolkit.detection.link.message import LinkLoad, SetLoad, format_loads, link_load
from toolkit.detection.metrics import (
    TRUE_IOU,
    USUAL_IOUS,
    Curve,
    DetectionScore,
    Reliability,
    evaluate,
    matches,
    reliability,
    second_labels,
)
from toolkit.detection.place import Place, Stand
from toolkit.detection.provenance import (
    dataset_origin,
    detector_origin,
    settings_origin,
    with_file_digest,
)
from toolkit.detection.scheme import Chained, Fused, Scheme, scheme_codec
from toolkit.detection.schemes import PAPER_SCHEMES, find_scheme, fuse_frame
from toolkit.detection.view import NMS_IOU, LinkMemory, View, stand_view
from toolkit.display import format_share
from toolkit.frame import Frame, Recording, select_sensors
from toolkit.objects import LABELS, VEHICLE, Detections, Detector, check_known, label_index
from toolkit.plots.curves import draw_pr_curves
from toolkit.plots.plan_view import FrameOutcome, draw_frame
from toolkit.points import detect_on_ground, frame_points, has_centre_inside
from toolkit.runtime.files import replace_infinite, write_text, writing_together
from toolkit.runtime.run import Processes
from toolkit.runtime.text_tables import align_columns
from toolkit.sensors.error_profiles import PAPER_ERRORS
from toolkit.sites.site import Site

ALL_CLOUDS = "all clouds"
BATCH_FRAMES = 10  # frames that a worker scores in one go
EXAMPLE_IOU = 0.7  # at which a detection hits, in the paper's first column
Scoring = Literal["exact", "published", "measured"]


@dataclass(frozen=True)
class Row:
    """Figures of one scheme, sensor set, class and IoU threshold.

    Attributes:
        scheme: name of the scheme.
        sensors: indices of the sensors.
        iou: threshold from which a detection is true.
        ap: average precision.
        recall: recall over all detections.
        precision: precision over all detections.
        kbit_per_sensor: mean kbit that a sensor sends of a frame.
        ms_per_frame: median milliseconds from measurements to fused boxes.
        curve: precision and recall down to each score.
        label: class.
        truths: objects to find in all frames.
        false_alarms_per_frame: mean number of false alarms in a frame.
    """

    scheme: str
    sensors: tuple[int, ...]
    iou: float
    ap: float
    recall: float
    precision: float
    kbit_per_sensor: float
    ms_per_frame: float
    curve: Curve = field(repr=False, compare=False)
    label: str = LABELS[VEHICLE]
    truths: int = 0
    false_alarms_per_frame: float = 0.0

    def as_dict(self) -> dict[str, object]:
        """Return the row without its curve for JSON, undefined as None."""
        return replace_infinite(
            {name: value for name, value in vars(self).items() if name != "curve"}
        )


@dataclass(frozen=True)
class ClassFigures:
    """Figures of a class at the detector's score threshold, for one scheme and sensor set.

    The second label of an object (`second_labels`) is a false alarm here.

    Attributes:
        scheme: name of the scheme.
        sensors: indices of the sensors.
        label: class.
        iou: threshold from which a detection is true (`TRUE_IOU`).
        frames: number of frames.
        truths: objects to find in all frames.
        detections: detections that count in all frames.
        recall: share of the truths that were detected.
        precision: share of the detections that are true.
        false_alarms_per_frame: mean number of false alarms in a frame.
        reliability: share of true detections by score.
    """

    scheme: str
    sensors: tuple[int, ...]
    label: str
    iou: float
    frames: int
    truths: int
    detections: int
    recall: float
    precision: float
    false_alarms_per_frame: float
    reliability: Reliability = field(repr=False, compare=False)

    def as_dict(self) -> dict[str, object]:
        """Return the figures for JSON, undefined as None."""
        bins = {name: column.tolist() for name, column in vars(self.reliability).items()}
        return replace_infinite(
            {**vars(self), "calibration_error": self.reliability.error, "reliability": bins}
        )


@dataclass(frozen=True)
class Comparison:
    """Schemes and sensor sets to compare, and the rules.

    Attributes:
        schemes: objects or names, None for all clouds together, uncropped.
        sensor_sets: indices or names of sensors, None for all.
        classes: names or numbers of `toolkit.objects.LABELS`.
        iou_thresholds: thresholds of all classes, None for the usual ones of each class
            (`toolkit.detection.metrics.USUAL_IOUS`).
        protocol: rule for the objects that count, None for exact at a known site, else measured.
        metric: IoU of boxes or of footprints, see `toolkit.detection.metrics.evaluate`.
        codec: coding of the messages.
        nms_iou: BEV IoU above which the less sure of two boxes of one label is dropped.
        radius: hybrid radius (m), None for the site's.
        rate: frames per second (Hz) for the load on a link, None for no loads.
        breakdown: whether AP is broken down by range, points and other sets' protocols, None for
            only at unknown sites.
    """

    schemes: Sequence[Scheme | str | None] = PAPER_SCHEMES
    sensor_sets: Sequence[Sequence[int | str] | None] = (None,)
    classes: Sequence[str | int] = ("vehicle",)
    iou_thresholds: Sequence[float] | None = None
    protocol: Scoring | None = None
    metric: Overlap = "3d"
    codec: Codec = PAPER
    nms_iou: float = NMS_IOU
    radius: float | None = None
    rate: float | None = None
    breakdown: bool | None = None


@dataclass(frozen=True)
class Evaluation(Sequence[Row]):
    """Rows of an evaluation, with their context.

    Attributes:
        rows: figures of each scheme, sensor set, class and IoU threshold.
        provenance: data, detector, settings and version.
        classes: figures at the detector's score threshold.
        loads: loads on a link, if a rate was given.
        schemes: frames, detections, problems and median milliseconds of each scheme.
        breakdown: AP by range, by points and by other sets' protocols.
        poses: poses of the sensors, if they were estimated before.
    """

    rows: tuple[Row, ...]
    provenance: dict[str, object]
    classes: tuple[ClassFigures, ...] = ()
    loads: tuple[SetLoad, ...] = ()
    schemes: dict[str, dict[str, Any]] = field(default_factory=dict)
    breakdown: tuple[GroupRow, ...] = ()
    poses: tuple[FoundPose, ...] = ()

    @overload
    def __getitem__(self, index: int) -> Row: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Row, ...]: ...
    def __getitem__(self, index: int | slice) -> Row | tuple[Row, ...]:
        return self.rows[index]

    def __len__(self) -> int:
        return len(self.rows)

    def text(self) -> str:
        """Return all figures as tables."""
        parts = ["\n".join(map(str, self.poses))] if self.poses else []
        parts.append(format_table(self.rows))
        if self.loads:
            parts.append(
                f"on a link at {self.loads[0].load.rate:g} Hz:\n{format_loads(self.loads)}"
            )
        parts.append(f"above the detector's threshold:\n{format_class_table(self.classes)}")
        if self.breakdown:
            for name, figures in self.schemes.items():
                parts.append(_format_scheme(name, figures))
                parts.append(format_rows([row for row in self.breakdown if row.scheme == name]))
            return "\n\n".join(parts)
        # all schemes have the same problems
        problems: Mapping[str, int] = next(
            (figures["problems"] for figures in self.schemes.values()), {}
        )
        if problems:
            counts = ", ".join(f"{number} {kind}" for kind, number in problems.items())
            parts.append(f"left out or doubtful: {counts}")
        return "\n\n".join(parts)

    def as_dict(self) -> dict[str, Any]:
        """Return all but the provenance for JSON, undefined as None."""
        rows = [row.as_dict() for row in self.rows]
        classes = [figures.as_dict() for figures in self.classes]
        optional: dict[str, Any] = {"loads": [load.as_dict() for load in self.loads]}
        optional["breakdown"] = [vars(row) for row in self.breakdown]
        optional["poses"] = {pose.sensor.name: pose.described() for pose in self.poses}
        filled = {name: value for name, value in optional.items() if value}
        return replace_infinite(
            {"rows": rows, "classes": classes, "schemes": self.schemes, **filled}
        )


def _format_scheme(name: str, figures: Mapping[str, Any]) -> str:
    """Summary of a scheme, and what the images of its sensors leave out."""
    lines = [f"{name}: {describe_summary(dict(figures))}"]
    for sensor, counts in figures.get("images", {}).items():
        kinds = [f"{count} {kind}" for kind, count in counts.items() if kind != "points"]
        left_out = ", ".join(kinds) or "none"
        lines.append(f"{sensor}: of {counts['points']} points its images leave out {left_out}")
    return "\n".join(lines)


def _find_outside(
    truths: Sequence[FrameTruth], frame_detections: Sequence[Detections]
) -> list[Mask]:
    """Masks of the detections of each frame that are outside its area."""
    return [
        ~truth.inside(detections)
        for truth, detections in zip(truths, frame_detections, strict=True)
    ]


def evaluate_recording(
    recording: Recording,
    detector: Detector,
    comparison: Comparison = Comparison(),
    *,
    place: Place = Place(),
    reads: Reads = Reads(),
    scenes: Scenes | None = None,
    run: Processes = Processes(),
) -> Evaluation:
    """Score every scheme with every sensor set, class by class, at each of its IoU thresholds.

    place: detection area and ground; reads: errors of the sensors and number of frames; scenes:
    empty scenes for schemes that need them, learnt from this recording if None. Several workers
    share the frames, unless a scheme can only read its messages in order.

    Raises ValueError for an unknown scheme, sensor, class or error profile, a class that the
    detector does not know, two schemes of one name, and a recording without frames."""
    total = reads.count(recording)
    errors = reads.profile()
    ious = _list_ious(comparison)
    check_known(detector, list(ious))
    site = recording.site
    if site is not None and comparison.radius is not None:
        site = replace(site, hybrid_radius=comparison.radius)
    schemes = _name_schemes(comparison.schemes)
    check_labels(recording, total)
    measured = ReadRecording(recording, reads)
    at_site = place.at(site)
    first = measured[0]
    sets = _name_sets(first, comparison.sensor_sets)
    if scenes is None:
        scenes = Scenes(measured if at_site else Part(measured, total))
    job = _Job(
        measured,
        detector,
        comparison,
        place,
        site,
        at_site,
        schemes,
        sets,
        scenes,
        protocol=comparison.protocol or ("exact" if at_site else "measured"),
        count_points=(not at_site) if comparison.breakdown is None else comparison.breakdown,
    )
    results = _score_frames(job, first, total, run)
    rows = list[Row]()
    classes = list[ClassFigures]()
    loads = list[SetLoad]()
    groups = list[GroupRow]()
    figures: dict[str, dict[str, Any]] = {}
    for name, sensors in results[0].fused:
        pooled = _SetResults(job, results, name, sensors)
        for label, thresholds in ious.items():
            scores = pooled.score_class(label, thresholds)
            rows += [pooled.make_row(label, iou, scores[iou]) for iou in thresholds]
            classes.append(pooled.rate_threshold(label, scores[TRUE_IOU[label_index(label)]]))
        title = name if len(sets) == 1 else f"{name} {_sensor_text(sensors)}"
        if job.count_points:
            groups += pooled.break_down(title, ious)
        load = pooled.find_load()
        if load is not None:
            loads.append(SetLoad(name, sensors, load))
        figures[title] = pooled.summarise(load)

    settings = job.describe(ious, frames=total, noise_seed=reads.noise_seed, errors=errors.origin)
    origin = settings_origin(comparison.codec, **settings)
    provenance = dataset_origin(recording) | detector_origin(detector) | origin
    return Evaluation(tuple(rows), provenance, tuple(classes), tuple(loads), figures, tuple(groups))


def _list_ious(comparison: Comparison) -> dict[str, tuple[float, ...]]:
    """IoU thresholds of each class; ValueError if there is nothing to evaluate."""
    numbers = dict.fromkeys(map(label_index, comparison.classes))
    labels = [LABELS[number] for number in numbers]
    ious = {label: _thresholds(comparison.iou_thresholds, label) for label in labels}
    is_empty = not len(comparison.schemes) or not len(comparison.sensor_sets)
    if is_empty or not ious or not all(ious.values()):
        raise ValueError(
            "there must be a scheme, a sensor set, a class and an IoU threshold to evaluate"
        )
    return ious


def _name_schemes(schemes: Sequence[Scheme | str | None]) -> dict[str, Scheme | None]:
    """Schemes by name; ValueError if two schemes have one name."""
    by_name: dict[str, Scheme | None] = {}
    for scheme_or_name in schemes:
        scheme = None if scheme_or_name is None else find_scheme(scheme_or_name)
        name = ALL_CLOUDS if scheme is None else scheme.name
        if by_name.setdefault(name, scheme) != scheme:
            raise ValueError(
                f"two schemes are called {name!r}, {by_name[name]} and {scheme}: rename one"
            )
    return by_name


def _name_sets(
    frame: Frame, sensor_sets: Sequence[Sequence[int | str] | None]
) -> dict[tuple[int, ...], tuple[str, ...]]:
    """Names of the sensors in each set, by the set's indices."""
    names = {}
    for sensors in sensor_sets:
        indices = tuple(select_sensors(frame.sensors, sensors))
        names[indices] = tuple(frame.sensors[k].name for k in indices)
    return names


def _score_frames(job: "_Job", first: Frame, total: int, run: Processes) -> "list[_FrameResult]":
    """Score all frames; in this process if a scheme needs earlier messages."""
    progress = run.stage("frame", total)
    results = list[_FrameResult]()
    if run.alone or any(isinstance(scheme, Chained) for scheme in job.schemes.values()):
        frames = chain([first], (job.recording[k] for k in range(1, total)))
        for result in job.score(frames, range(total)):
            results.append(result)
            if progress is not None:
                progress(len(results))
        if results[0].warning is not None:
            warnings.warn(f"frame 0: {results[0].warning}", stacklevel=3)
        return results
    batches = [
        range(start, min(start + BATCH_FRAMES, total)) for start in range(0, total, BATCH_FRAMES)
    ]
    report = None if progress is None else lambda done: progress(min(total, BATCH_FRAMES * done))
    results += chain.from_iterable(run.map(job, batches, progress=report))
    return results


def _thresholds(iou_thresholds: Sequence[float] | None, label: str) -> tuple[float, ...]:
    thresholds = USUAL_IOUS[label_index(label)] if iou_thresholds is None else iou_thresholds
    return tuple(dict.fromkeys(map(float, thresholds)))


def _sends_images(scheme: Scheme | None, codec: Codec) -> bool:
    if scheme is None or not scheme.sends_points:
        return False
    return isinstance(scheme_codec(scheme, codec), ImageCodec)


@dataclass(frozen=True, eq=False)
class _FrameResult:
    """Truth of one frame, and the result of each scheme and sensor set.

    Attributes:
        truth: objects, and those that count.
        fused: fused detections by scheme and sensors (indices).
        problems: labels and points left out in reading, by kind.
        level_ms: time that finding the ground took.
        warning: warning of ground that is not level.
    """

    truth: FrameTruth
    fused: dict[tuple[str, tuple[int, ...]], Fused]
    problems: Mapping[str, int]
    level_ms: float
    warning: str | None = None


@dataclass(frozen=True)
class _Job:
    """Scores frames one after another; pickled to other processes.

    Attributes:
        recording: frames with the sensors' errors.
        detector: detector of all schemes.
        comparison: settings, as the caller gave them.
        place: detection area and ground.
        site: site of the recording, None if unknown.
        at_site: True if detection is at the site itself.
        schemes: schemes by name.
        sets: names of the sensors in each set, by the set's indices.
        scenes: empty scenes of the sensors.
        protocol: rule for the objects that count.
        count_points: whether points on objects are counted, for a breakdown.
    """

    recording: ReadRecording
    detector: Detector
    comparison: Comparison
    place: Place
    site: Site | None
    at_site: bool
    schemes: dict[str, Scheme | None]
    sets: dict[tuple[int, ...], tuple[str, ...]]
    scenes: Scenes
    protocol: Scoring
    count_points: bool

    def __call__(self, numbers: Sequence[int]) -> list[_FrameResult]:
        return list(self.score((self.recording[k] for k in numbers), numbers))

    def score(self, frames: Iterable[Frame], numbers: Iterable[int]) -> Iterator[_FrameResult]:
        """Yield the results of each frame, in order."""
        if None not in self.comparison.sensor_sets and not self.at_site:
            sensor_names = list(dict.fromkeys(chain.from_iterable(self.sets.values())))
            frames = (frame.seen_by(sensor_names) for frame in frames)
        memory = LinkMemory()
        remembered = list[str]()
        stands = self.place.stands(frames, self.site)
        for number, (frame, stand) in zip(numbers, stands, strict=True):
            names = [sensor.name for sensor in frame.sensors]
            if names != remembered:
                memory = LinkMemory()
            remembered = names
            numbered = frame if frame.index == number else replace(frame, index=number)
            fused = self._fuse(numbered, stand, memory)
            truth = self._find_truth(frame, stand)
            yield _FrameResult(truth, fused, frame.problems, stand.ms, stand.warning)

    def describe(self, ious: Mapping[str, tuple[float, ...]], **reads: object) -> dict[str, object]:
        """Settings that the figures depend on, for their provenance. reads: how frames are read."""
        settings: dict[str, object] = {
            "site": self.site and self.site.name,
            "hybrid_radius": self.site and self.site.hybrid_radius,
            **reads,
            "nms_iou": self.comparison.nms_iou,
            "metric": self.comparison.metric,
            "protocol": self.protocol,
        }
        if self.scenes.used:
            settings["empty_scenes"] = self.scenes.digests
        if len(ious) == 1:
            label = next(iter(ious))
            settings |= {"label": label, "iou": list(ious[label])}
        else:
            settings["classes"] = ious
        settings["schemes"] = {
            name: "all clouds at once" if scheme is None else scheme.digest
            for name, scheme in self.schemes.items()
        }
        return settings

    def _find_truth(self, frame: Frame, stand: Stand) -> FrameTruth:
        """Objects of a frame, and those that count by the protocol."""
        if self.protocol == "measured":
            return select_truth(frame, stand.corners)
        objects = frame.objects
        is_inside = has_centre_inside(objects.boxes, stand.corners)
        counts = np.zeros(len(is_inside), np.int64)
        if self.count_points:
            counts = count_points(frame.points(), objects.boxes)
        if self.protocol == "published":
            objects = objects[is_inside]
            counts = counts[is_inside]
            is_inside = is_inside[is_inside]
        return FrameTruth(objects, is_inside, counts, stand.corners)

    def _fuse(
        self, frame: Frame, stand: Stand, memory: LinkMemory
    ) -> dict[tuple[str, tuple[int, ...]], Fused]:
        """Fuse a frame by every scheme with every sensor set."""
        comparison = self.comparison
        fused = dict[tuple[str, tuple[int, ...]], Fused]()

        @cache
        def view(as_images: bool) -> View:
            return stand_view(
                frame,
                self.detector,
                stand,
                codec=check_codec(comparison.codec),
                nms_iou=comparison.nms_iou,
                scenes=self.scenes if as_images else None,
                memory=memory,
            )

        for name, scheme in self.schemes.items():
            for sensors, names in self.sets.items():
                # indices in this frame, which may lack some of the sensors
                present = list(range(len(frame.sensors)))
                if None not in comparison.sensor_sets or len(sensors) < max(map(len, self.sets)):
                    present = sorted(select_sensors(frame.sensors, names))
                if scheme is None:
                    result = self._detect_all(frame, stand, present)
                else:
                    as_images = self.at_site or _sends_images(scheme, comparison.codec)
                    result = scheme.fuse(view(as_images), present)
                detections = result.detections
                if not self.at_site:
                    detections = stand.put_back(detections)
                fused[name, sensors] = replace(result, detections=detections)
        return fused

    def _detect_all(self, frame: Frame, stand: Stand, present: list[int]) -> Fused:
        """Detect in all points of some sensors (indices) together, uncropped."""
        points = stand.lift(frame.seen_by(present).points())
        start = perf_counter()
        detections = Detections.empty()
        if len(points):
            detections = detect_on_ground(self.detector, points, stand.area)
        return Fused(detections, np.zeros(0, np.int64), 1e3 * (perf_counter() - start))


class _SetResults:
    """Results of one scheme and sensor set in all frames, pooled into figures."""

    def __init__(
        self, job: _Job, results: Sequence[_FrameResult], scheme: str, sensors: tuple[int, ...]
    ) -> None:
        self.job = job
        self.results = results
        self.scheme = scheme
        self.sensors = sensors
        self.truths = [result.truth for result in results]
        fused = [result.fused[scheme, sensors] for result in results]
        self.detections = [frame_fused.detections for frame_fused in fused]
        self.bits = [frame_fused.bits for frame_fused in fused]
        self.ms = float(np.median([frame_fused.ms for frame_fused in fused]))
        kbits = [bits.mean() / 1000 if len(bits) else 0.0 for bits in self.bits]
        self.kbit = float(np.mean(kbits))
        self.outside: list[Mask] | None = None
        if job.protocol == "measured":
            self.outside = _find_outside(self.truths, self.detections)

    def score_class(self, label: str, thresholds: Sequence[float]) -> dict[float, DetectionScore]:
        """Scores of a class at its thresholds, and at the one of a true detection."""
        return evaluate(
            self.detections,
            [truth.objects for truth in self.truths],
            iou_thresholds=[*thresholds, TRUE_IOU[label_index(label)]],
            metric=self.job.comparison.metric,
            protocol="published" if self.job.protocol == "published" else "exact",
            label=label,
            counted=[truth.counted for truth in self.truths],
            outside=self.outside,
        )

    def make_row(self, label: str, iou: float, score: DetectionScore) -> Row:
        """Row of a class at one threshold."""
        return Row(
            scheme=self.scheme,
            sensors=self.sensors,
            iou=iou,
            ap=score.ap,
            recall=score.recall,
            precision=score.precision,
            kbit_per_sensor=self.kbit,
            ms_per_frame=self.ms,
            curve=score.curve,
            label=label,
            truths=score.truths,
            false_alarms_per_frame=score.fp / len(self.results),
        )

    def rate_threshold(self, label: str, score: DetectionScore) -> ClassFigures:
        """Rate the detector's threshold, with second labels as false alarms."""
        second_scores = self._second_scores(label)
        frames = len(self.results)
        detections = score.tp + score.fp + len(second_scores)
        scores = np.append(score.scores, second_scores)
        hits = np.append(score.hits, np.zeros(len(second_scores), bool))
        return ClassFigures(
            scheme=self.scheme,
            sensors=self.sensors,
            label=label,
            iou=TRUE_IOU[label_index(label)],
            frames=frames,
            truths=score.truths,
            detections=detections,
            recall=score.recall,
            precision=score.tp / detections if detections else np.nan,
            false_alarms_per_frame=(score.fp + len(second_scores)) / frames,
            reliability=reliability(scores, hits),
        )

    def _second_scores(self, label: str) -> Float64[np.ndarray, " n"]:
        """Scores of detections that give an object a second label; only vehicles can."""
        scores = [np.zeros(0)]
        if label != LABELS[VEHICLE]:
            return scores[0]
        for number, truth in enumerate(self.truths):
            detections = self.detections[number]
            is_second = second_labels(
                detections,
                truth.objects,
                metric=self.job.comparison.metric,
                counted=truth.counted,
                outside=None if self.outside is None else self.outside[number],
            )
            scores.append(detections.scores[is_second])
        return np.concatenate(scores)

    def break_down(self, title: str, labels: Iterable[str]) -> list[GroupRow]:
        """AP of each class by range, by points and as other data sets count it."""
        judged = [
            truth.judge(detections)
            for truth, detections in zip(self.truths, self.detections, strict=True)
        ]
        rows = list[GroupRow]()
        for label in labels:
            rows += group_rows(judged, label, self.job.comparison.iou_thresholds)
        return [replace(row, scheme=title) for row in rows]

    def find_load(self) -> LinkLoad | None:
        """Load on a link; None without a rate, or if frames differ in their sensors."""
        rate = self.job.comparison.rate
        numbers = {len(bits) for bits in self.bits}
        if rate is None or len(numbers) != 1 or numbers == {0}:
            return None
        return link_load(np.array(self.bits), rate)

    def summarise(self, load: LinkLoad | None) -> dict[str, Any]:
        """Counts, problems and costs of a scheme and set."""
        problems = sum((Counter(result.problems) for result in self.results), Counter[str]())
        has_bits = any(len(bits) for bits in self.bits)
        summary: dict[str, Any] = {
            "samples": len(self.results),
            "detections": sum(len(detections.boxes) for detections in self.detections),
            "problems": dict(problems),
            "level_ms": float(np.median([result.level_ms for result in self.results])),
            "detect_ms": self.ms,
            "kbit_per_sensor": self.kbit if has_bits else None,
        }
        if load is not None:
            summary["load"] = vars(load)
        scheme = self.job.schemes[self.scheme]
        if not self.job.at_site and _sends_images(scheme, self.job.comparison.codec):
            summary["images"] = {
                sensor: {"points": scene.points, **scene.left_out}
                for sensor, scene in self.job.scenes.every.items()
            }
        return summary


def format_table(rows: Iterable[Row]) -> str:
    """Format rows like the paper's first table, class by class.

    Each scheme and sensor set has a line, each IoU threshold a column of AP."""
    by_class: dict[str, list[Row]] = {}
    for row in rows:
        by_class.setdefault(row.label, []).append(row)
    tables = []
    for label, class_rows in by_class.items():
        lines: dict[tuple[str, str], dict[float, Row]] = {}
        for row in class_rows:
            lines.setdefault((row.scheme, _sensor_text(row.sensors)), {})[row.iou] = row
        ious = list(dict.fromkeys(row.iou for row in class_rows))
        aps = [f"AP@{iou:g}" for iou in ious]
        table = [["scheme", "sensors", *aps, f"recall@{ious[0]:g}", "kbit/sensor", "ms/frame"]]
        for texts, line in lines.items():
            row = line[ious[0]]
            costs = [
                format_share(row.recall, row.truths),
                f"{row.kbit_per_sensor:.2f}",
                f"{row.ms_per_frame:.1f}",
            ]
            aps = [format_share(line[iou].ap, line[iou].truths) for iou in ious]
            table.append([*texts, *aps, *costs])
        heading = f"{label}, {class_rows[0].truths} to find\n" if len(by_class) > 1 else ""
        tables.append(heading + align_columns(table, texts=2))
    return "\n\n".join(tables)


def format_class_table(classes: Iterable[ClassFigures]) -> str:
    """Format the figures at the detector's threshold as a table."""
    headings = [
        "class",
        "scheme",
        "sensors",
        "to find",
        "recall",
        "precision",
        "false/frame",
        "calibration error",
        "IoU",
    ]
    table = [headings]
    for row in classes:
        shares = (row.precision, row.false_alarms_per_frame, row.reliability.error)
        texts = [row.label, row.scheme, _sensor_text(row.sensors), str(row.truths)]
        texts.append(format_share(row.recall, row.truths))
        table.append([*texts, *(f"{figure:.3f}" for figure in shares), f"{row.iou:g}"])
    return align_columns(table, texts=3)


def _sensor_text(sensors: Sequence[int]) -> str:
    return ",".join(map(str, sensors)) or "none"


def curve_files(
    classes: Sequence[str], iou_thresholds: Sequence[float] | None = None
) -> dict[str, tuple[str, float]]:
    """Return the class and IoU threshold of each PR picture, by file name.

    Vehicles have no class in the name: pr_0.7.png, but pr_cyclist_0.5.png."""
    return {
        f"pr_{'' if label == LABELS[VEHICLE] else label + '_'}{iou:g}.png": (label, iou)
        for label in classes
        for iou in _thresholds(iou_thresholds, label)
    }


def save_evaluation(rows: Evaluation, folder: str | Path) -> None:
    """Write table.json and the PR curves (`curve_files`) into a folder, made if missing.

    table.json is {"provenance": {...}, "rows": [...], "classes": [...]}. Either all files are
    written or, if that fails (OSError), no file is.
    """
    with writing_together(folder) as unfinished:
        table = {"provenance": with_file_digest(rows.provenance), **rows.as_dict()}
        write_text(unfinished / "table.json", json.dumps(table, indent=1))
        for label, iou in dict.fromkeys((row.label, row.iou) for row in rows):
            selected = [row for row in rows if (row.label, row.iou) == (label, iou)]
            curves = {}
            for row in selected:
                ap = format_share(row.ap, row.truths)
                legend = f"{row.scheme} {','.join(map(str, row.sensors))}: AP {ap}"
                curves[legend] = row.curve.recall, row.curve.precision
            (name,) = curve_files([label], [iou])
            title = f"IoU {iou:g}" if label == LABELS[VEHICLE] else f"{label}, IoU {iou:g}"
            draw_pr_curves(curves, unfinished / name, title=title)


def draw_example(
    recording: CoopDataset, detector: Detector, out: str | Path, *, seed: int = 0
) -> None:
    """Draw the frame with the most objects from above.

    Hits, misses and false alarms of vehicles are marked at `EXAMPLE_IOU`. Objects centred outside
    the area do not count. seed: seed of the sensors' noise."""
    site = recording.site
    frame = with_errors(max(recording, key=lambda frame: len(frame.objects)), PAPER_ERRORS, seed)
    truth = frame.objects
    detections = fuse_frame("early", frame, detector, site=site).detections
    (result,) = matches(
        detections, truth, [EXAMPLE_IOU], counted=has_centre_inside(truth.boxes, site.area)
    )
    sensors = f"{len(frame.sensors)} sensor{'s' * (len(frame.sensors) != 1)}"
    outcome = FrameOutcome(
        EXAMPLE_IOU, result.hit, ~result.scored, result.truth >= 0, result.ignored
    )
    name = detector_origin(detector)["detector"]
    title = f"{site.name}, frame {frame.index}: early fusion of {sensors}, {name}"
    clouds = frame_points(frame, area=site)
    draw_frame(
        site, out, clouds=clouds, truth=truth, detections=detections, outcome=outcome, title=title
    )
