"""Score fusion schemes and sensor sets on a recording.

This gives the first table of the paper, and more. What a sensor sees and detects is computed once per frame and shared
by all schemes and sets (`toolkit.detection.view`). Only the fused boxes of a frame are kept, so memory does not grow
with the size of the measurements.

Three protocols say which objects are to be found:

- `exact`: those with their centre in the site's area. Others are there but not scored, neither misses nor false alarms
  (`counted` of `toolkit.detection.metrics.evaluate`).
- `published`: the same, but others are not there, and detections are matched as the published code does.
- `measured`, the rule for recorded labels: those in the area, where labels are complete, with at least one point.
  An object labelled twice counts once; detections where labels are not complete do not count.

Each class is scored separately: a cyclist reported as a pedestrian is a false alarm for pedestrians and a miss for
cyclists. Detections are those that the detector reports, above its own threshold; `ClassFigures` says what that
threshold is worth. With a breakdown, AP is also given by range, by points, and as KITTI and nuScenes count it
(`toolkit.detection.breakdown`).

Milliseconds are those of the median frame, from measurements to fused boxes, with sensors working side by side as in
the paper.
"""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from time import perf_counter
from typing import Any, Literal, overload

import numpy as np

from toolkit.arrays import Int64
from toolkit.boxes import Overlap, count_points
from toolkit.calibration.poses import FoundPose
from toolkit.calibration.scenes import Scenes
from toolkit.datasets.readings import ReadRecording, Reads
from toolkit.datasets.recordings import Part
from toolkit.datasets.records import add_problems
from toolkit.detection.breakdown import FrameTruth, GroupRow, format_rows, group_rows, select_truth
from toolkit.detection.codec import PAPER, Codec, ImageCodec, check_codec
from toolkit.detection.detect import describe_summary
from toolkit.detection.link.load import SetLoad, format_loads, link_load
from toolkit.detection.metrics import TRUE_IOU, USUAL_IOUS, Curve, DetectionScore, Reliability, evaluate, reliability
from toolkit.detection.place import Place, Stand
from toolkit.detection.provenance import dataset_origin, detector_origin, settings_origin, with_file_digest
from toolkit.detection.scheme import Chained, Fused, Scheme, scheme_codec
from toolkit.detection.schemes import PAPER_SCHEMES, find_scheme
from toolkit.detection.view import NMS_IOU, LinkMemory, View, stand_view
from toolkit.frame import Frame, Recording, select_sensors
from toolkit.objects import LABELS, VEHICLE, Detections, Detector, check_known, label_index
from toolkit.points import detect_on_ground, has_centre_inside
from toolkit.runtime.files import replace_infinite, write_text, writing_together
from toolkit.runtime.run import Processes
from toolkit.runtime.text_tables import align_columns
from toolkit.sites.site import Site

ALL_CLOUDS = "all clouds"
STRETCH = 10  # frames that a worker scores at once
Scoring = Literal["exact", "published", "measured"]


@dataclass(frozen=True)
class Row:
    """Figures of one scheme, sensor set, class and IoU threshold.

    Sensors are indices. AP, and recall and precision at the last detection; kbit per sensor and frame; milliseconds per
    frame; the PR curve; objects to find in all frames; false alarms per frame.
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

    def as_dict(self) -> dict[str, Any]:
        """Return the row for JSON, without its curve. An undefined figure is None, such as AP without any truth."""
        names = (
            *("scheme", "sensors", "label", "iou", "ap", "recall", "precision", "truths", "false_alarms_per_frame"),
            *("kbit_per_sensor", "ms_per_frame"),
        )
        return {name: _defined(getattr(self, name)) for name in names}


@dataclass(frozen=True)
class ClassFigures:
    """Worth of the detector's own threshold for one class.

    One scheme and sensor set. A detection is true from the IoU `iou` on (`TRUE_IOU`). Objects to find and detections
    that count in all `frames`; share of objects found, share of detections that are true, false alarms per frame; and
    whether scores are shares of true detections.
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

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for JSON. The reliability diagram is given bin by bin. An undefined figure is None."""
        diagram = self.reliability
        bins = {
            "score": [_defined(each) for each in diagram.score.tolist()],
            "true": [_defined(each) for each in diagram.true.tolist()],
            "count": diagram.count.tolist(),
        }
        own = {name: _defined(value) for name, value in vars(self).items() if name != "reliability"}
        return own | {"calibration_error": diagram.error, "reliability": bins}


@dataclass(frozen=True)
class Comparison:
    """Schemes and sensor sets to be compared, and rules.

    schemes: objects or names, None for all clouds at once, uncropped; sensor_sets: indices or names, None for all;
    classes: names or numbers of `toolkit.objects.LABELS`; iou_thresholds: of all classes, None for those usual for
    each (`toolkit.detection.metrics.USUAL_IOUS`); protocol: None for exact at a known site, else measured; metric: see
    `toolkit.detection.metrics.evaluate`; codec: of what is sent; radius: in place of the site's hybrid radius (m);
    rate: of frames (Hz), to say what is put on a link; breakdown: by range, points and other sets' protocols, None for
    where no site is known.
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

    def labels(self) -> list[str]:
        """Names of the classes."""
        return [LABELS[k] for k in dict.fromkeys(label_index(label) for label in self.classes)]

    def named(self) -> dict[str, Scheme | None]:
        """Return the schemes by name. Raises ValueError where two share one."""
        named: dict[str, Scheme | None] = {}
        for given in self.schemes:
            scheme = None if given is None else find_scheme(given)
            name = ALL_CLOUDS if scheme is None else scheme.name
            if named.setdefault(name, scheme) != scheme:
                raise ValueError(f"two schemes are called {name!r}, {named[name]} and {scheme}: rename one")
        return named


@dataclass(frozen=True)
class Evaluation(Sequence[Row]):
    """Rows of an evaluation, with their context.

    classes: worth of the detector's threshold, class by class; loads: of each scheme and sensor set on a link, if a
    rate was given; schemes: frames, detections, problems and median milliseconds of each; breakdown: by range, points
    and other sets' protocols; provenance: dataset, detector, settings and version; poses: of the sensors, where they
    were found before.
    """

    rows: tuple[Row, ...]
    provenance: dict[str, Any]
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

    def __iter__(self) -> Iterator[Row]:
        return iter(self.rows)

    def text(self) -> str:
        """Return all figures as tables.

        Sensors as they were found, AP, links, worth of the threshold, and the breakdown.
        """
        parts = ["\n".join(map(str, self.poses))] * bool(self.poses) + [format_table(self.rows)]
        if self.loads:
            parts.append(f"on a link at {self.loads[0].load.rate:g} Hz:\n{format_loads(self.loads)}")
        parts.append(f"above the detector's threshold:\n{format_class_table(self.classes)}")
        for name, figures in self.schemes.items() if self.breakdown else ():
            rows = [row for row in self.breakdown if row.scheme == name]
            parts.append(f"{name}: {describe_summary(figures)}{_images_text(figures)}\n\n{format_rows(rows)}")
        return "\n\n".join(parts)

    def as_dict(self) -> dict[str, Any]:
        """Return all but the provenance for JSON. An undefined figure is None."""
        optional = {
            "loads": [load.as_dict() for load in self.loads],
            "breakdown": [row.as_dict() for row in self.breakdown],
            "poses": {each.sensor.name: each.described() for each in self.poses},
        }
        return replace_infinite(
            {
                "rows": [row.as_dict() for row in self.rows],
                "classes": [figures.as_dict() for figures in self.classes],
                "schemes": self.schemes,
                **{name: value for name, value in optional.items() if value},
            }
        )


def evaluate_recording(
    recording: Recording,
    detector: Detector,
    asked: Comparison = Comparison(),
    *,
    place: Place = Place(),
    reads: Reads = Reads(),
    scenes: Scenes | None = None,
    run: Processes = Processes(),
) -> Evaluation:
    """Score every scheme with every sensor set.

    Each class is scored at each of its IoU thresholds, in this order. place: where the detector looks and on what
    ground; reads: errors of the sensors and number of frames; scenes: empty ones, for schemes that need them, None to
    learn them from this recording. Several workers share out the frames, unless a scheme's messages can only be read
    after others.

    Raises ValueError for a scheme, sensor, class or error profile that does not exist, a class that the detector does
    not know, two schemes of one name, and a recording without frames.
    """
    total, errors = reads.count(recording), reads.profile()
    labels = asked.labels()
    ious = {label: _thresholds(asked.iou_thresholds, label) for label in labels}
    if not (len(asked.schemes) and len(asked.sensor_sets) and labels and all(ious.values())):
        raise ValueError("there must be a scheme, a sensor set, a class and an IoU threshold to evaluate")
    check_known(detector, labels)
    site = recording.site
    if site is not None and asked.radius is not None:
        site = replace(site, hybrid_radius=asked.radius)
    named, known = asked.named(), place.at(site)
    measured = ReadRecording(recording, reads)
    first = measured[0]
    numbers = [tuple(select_sensors(first.sensors, chosen)) for chosen in asked.sensor_sets]
    sets = {chosen: tuple(first.sensors[k].name for k in chosen) for chosen in numbers}
    protocol = asked.protocol or ("exact" if known else "measured")
    breakdown = (not known) if asked.breakdown is None else asked.breakdown
    images = Scenes(measured if known else Part(measured, total)) if scenes is None else scenes
    job = _Job(measured, detector, asked, place, site, named, sets, images, protocol, breakdown)
    chained = any(isinstance(scheme, Chained) for scheme in named.values())
    scored = list(_spread(job, total, Processes() if chained else run, run.stage("frame", total)))
    truths, runs = [each.truth for each in scored], {key: _Run(key, scored) for key in scored[0].fused}

    counting: dict[str, Any] = {"metric": asked.metric, "protocol": "published" if protocol == "published" else "exact"}
    rows, summaries, groups = list[Row](), list[ClassFigures](), list[GroupRow]()
    for (name, chosen), each in runs.items():
        found = [truth.keep(fused.detections) for truth, fused in zip(truths, each.fused, strict=True)]
        objects, counted = [truth.objects for truth in truths], [truth.counted for truth in truths]
        for label, thresholds in ious.items():
            true_iou = TRUE_IOU[label_index(label)]
            at = evaluate(
                found, objects, counted=counted, label=label, iou_thresholds=[*thresholds, true_iou], **counting
            )
            rows += [_row(each, label, iou, at[iou]) for iou in thresholds]
            summaries.append(_class_figures(name, chosen, label, true_iou, at[true_iou], total))
        if breakdown:
            judged = [truth.judge(fused.detections) for truth, fused in zip(truths, each.fused, strict=True)]
            by_label = (group_rows(judged, label, asked.iou_thresholds) for label in ious)
            groups += [replace(row, scheme=each.title(len(sets))) for part in by_label for row in part]
    loads = [
        SetLoad(*key, link_load(each.bits, asked.rate))
        for key, each in runs.items()
        if asked.rate is not None and each.bits is not None
    ]
    figures = {each.title(len(sets)): each.summary(scored, asked.rate) for each in runs.values()}
    for name, scheme in named.items():
        if not known and sends_images(scheme, asked.codec):
            shown = {sensor: {"points": learnt.points, **learnt.left_out} for sensor, learnt in images.every.items()}
            figures |= {title: {**own, "images": shown} for title, own in figures.items() if title.startswith(name)}
    digests = {name: "all clouds at once" if scheme is None else scheme.digest for name, scheme in named.items()}
    placed = {"site": site and site.name, "hybrid_radius": site and site.hybrid_radius, "frames": total}
    drawn = {"noise_seed": reads.noise_seed, "errors": errors.origin, "nms_iou": asked.nms_iou, **counting}
    drawn["protocol"] = protocol
    drawn |= {"empty_scenes": images.digests} if images.used else {}
    scored_by = {"label": labels[0], "iou": list(ious[labels[0]])} if len(labels) == 1 else {"classes": ious}
    origin = settings_origin(asked.codec, **placed, **drawn, schemes=digests, **scored_by)
    provenance = dataset_origin(recording) | detector_origin(detector) | origin
    return Evaluation(tuple(rows), provenance, tuple(summaries), tuple(loads), figures, tuple(groups))


def _images_text(figures: Mapping[str, Any]) -> str:
    """Return what images of clouds leave out, sensor by sensor."""
    lines = []
    for name, each in figures.get("images", {}).items():
        kinds = ", ".join(f"{count} {kind}" for kind, count in each.items() if kind != "points")
        lines.append(f"\n{name}: of {each['points']} points its images leave out {kinds or 'none'}")
    return "".join(lines)


def sends_images(scheme: Scheme | None, codec: Codec) -> bool:
    """True where sensors send pixels of their images."""
    return scheme is not None and scheme.sends_points and isinstance(scheme_codec(scheme, codec), ImageCodec)


def format_table(rows: Iterable[Row]) -> str:
    """Format rows like the paper's first table.

    Each scheme and sensor set has a line, each IoU threshold a column of AP. Several classes have one such table after
    another.
    """
    by_class: dict[str, list[Row]] = {}
    for row in rows:
        by_class.setdefault(row.label, []).append(row)
    tables = [_ap_table(some) for some in by_class.values()]
    if len(tables) < 2:
        return "".join(tables)
    return "\n\n".join(f"{label}, {by_class[label][0].truths} to find\n{table}"
                        for label, table in zip(by_class, tables, strict=True))  # fmt: skip


def format_class_table(classes: Iterable[ClassFigures]) -> str:
    """Format the worth of the detector's threshold. Each class, scheme and sensor set has a line."""
    heads = ["class", "scheme", "sensors", "to find", "recall", "precision", "false/frame", "calibration error", "IoU"]
    table = [heads]
    for each in classes:
        shares = (each.recall, each.precision, each.false_alarms_per_frame, each.reliability.error)
        named = [each.label, each.scheme, _sensor_text(each.sensors), str(each.truths)]
        table.append([*named, *(f"{figure:.3f}" for figure in shares), f"{each.iou:g}"])
    return align_columns(table, texts=3)


def _ap_table(rows: Sequence[Row]) -> str:
    lines: dict[tuple[str, str], dict[float, Row]] = {}
    for row in rows:
        lines.setdefault((row.scheme, _sensor_text(row.sensors)), {})[row.iou] = row
    ious = list(dict.fromkeys(iou for line in lines.values() for iou in line))
    heads = ["scheme", "sensors", *(f"AP@{iou:g}" for iou in ious), f"recall@{ious[0]:g}", "kbit/sensor", "ms/frame"]
    table = [heads]
    for (scheme, sensors), line in lines.items():
        first = line[ious[0]]
        ap = [f"{line[iou].ap:.4f}" for iou in ious]
        costs = [f"{first.recall:.4f}", f"{first.kbit_per_sensor:.2f}", f"{first.ms_per_frame:.1f}"]
        table.append([scheme, sensors, *ap, *costs])
    return align_columns(table, texts=2)


def _sensor_text(sensors: Sequence[int]) -> str:
    return ",".join(map(str, sensors)) or "none"


def curve_files(classes: Sequence[str], iou_thresholds: Sequence[float] | None = None) -> dict[str, tuple[str, float]]:
    """Name the PR picture of each class and threshold.

    For example pr_0.7.png for vehicles at IoU 0.7, pr_cyclist_0.5.png for cyclists at 0.5.
    """
    return {
        f"pr_{'' if label == LABELS[VEHICLE] else label + '_'}{iou:g}.png": (label, iou)
        for label in classes
        for iou in _thresholds(iou_thresholds, label)
    }


def save_evaluation(rows: Evaluation, folder: str | Path) -> None:
    """Write table.json and the PR curves into a folder.

    table.json is {"provenance": {...}, "rows": [...], "classes": [...]}; `curve_files` names the curves. A missing
    folder is made. All files are written, or where that fails (OSError) none.
    """
    with writing_together(folder) as unfinished:
        _write_evaluation(rows, unfinished)


def _write_evaluation(rows: Evaluation, folder: Path) -> None:
    from toolkit.plots.curves import draw_pr_curves

    table = {"provenance": with_file_digest(rows.provenance), **rows.as_dict()}
    write_text(folder / "table.json", json.dumps(table, indent=1))
    for label, iou in dict.fromkeys((row.label, row.iou) for row in rows):
        curves = {
            f"{row.scheme} {','.join(map(str, row.sensors))}: AP {row.ap:.3f}": (row.curve.recall, row.curve.precision)
            for row in rows
            if (row.label, row.iou) == (label, iou)
        }
        (name,) = curve_files([label], [iou])
        title = f"IoU {iou:g}" if label == LABELS[VEHICLE] else f"{label}, IoU {iou:g}"
        draw_pr_curves(curves, folder / name, title=title)


@dataclass(frozen=True, eq=False)
class _Scored:
    """One scored frame.

    The objects that count in it, the result of each scheme and sensor set, and what was left out in reading it.
    """

    truth: FrameTruth
    fused: dict[tuple[str, tuple[int, ...]], Fused]
    problems: Mapping[str, int]
    level_ms: float
    warning: str | None = None


def _number(frame: Frame, index: int) -> Frame:
    return frame if frame.index == index else replace(frame, index=index)


@dataclass(frozen=True)
class _Job:
    """Scores frames one after another; pickled to other processes."""

    recording: ReadRecording
    detector: Detector
    asked: Comparison
    place: Place
    site: Site | None
    schemes: dict[str, Scheme | None]
    sets: dict[tuple[int, ...], tuple[str, ...]]
    scenes: Scenes
    protocol: Scoring
    count_points: bool

    def __call__(self, numbers: Sequence[int]) -> list[_Scored]:
        return list(self.frames(numbers))

    def frames(self, numbers: Iterable[int]) -> Iterator[_Scored]:
        """Yield what each frame gives, in order."""
        chosen = [names for names in self.sets.values() if names]
        wanted = None if None in self.asked.sensor_sets else list(dict.fromkeys(chain.from_iterable(chosen)))
        memory, remembered = LinkMemory(), list[str]()
        frames = (_number(self.recording[k], k) for k in numbers)
        some = (frame if wanted is None or self.place.at(self.site) else frame.seen_by(wanted) for frame in frames)
        for frame, stand in self.place.stands(some, self.site):
            names = [sensor.name for sensor in frame.sensors]
            memory, remembered = (memory if names == remembered else LinkMemory()), names
            yield self._scored(frame, stand, memory)

    def _scored(self, frame: Frame, stand: Stand, memory: LinkMemory) -> _Scored:
        asked, fused = self.asked, dict[tuple[str, tuple[int, ...]], Fused]()
        views: dict[bool, View] = {}
        for name, scheme in self.schemes.items():
            for chosen, names in self.sets.items():
                if scheme is None:
                    fused[name, chosen] = self._together(frame, stand, names, chosen)
                    continue
                scenes = self.scenes if self.place.at(self.site) or sends_images(scheme, asked.codec) else None
                if (scenes is None) not in views:
                    views[scenes is None] = stand_view(
                        frame,
                        self.detector,
                        stand,
                        codec=check_codec(asked.codec),
                        nms_iou=asked.nms_iou,
                        scenes=scenes,
                        memory=memory,
                    )
                made = scheme.fuse(views[scenes is None], self._present(frame, names, chosen))
                fused[name, chosen] = replace(made, detections=stand.put_back(made.detections))
        return _Scored(self._truth(frame, stand), fused, frame.problems, stand.ms, stand.warning)

    def _present(self, frame: Frame, names: tuple[str, ...], chosen: tuple[int, ...]) -> list[int]:
        """Positions in a frame of the sensors of a set. All of the frame's where the set is all."""
        if None in self.asked.sensor_sets and len(chosen) == max(map(len, self.sets)):
            return list(range(len(frame.sensors)))
        return sorted(select_sensors(frame.sensors, names))

    def _together(self, frame: Frame, stand: Stand, names: tuple[str, ...], chosen: tuple[int, ...]) -> Fused:
        """Detect in all points of a sensor set together. Points are uncropped."""
        points = stand.lift(frame.seen_by(self._present(frame, names, chosen)).points())
        start = perf_counter()
        found = detect_on_ground(self.detector, points, stand.area) if len(points) else Detections.empty()
        return Fused(stand.put_back(found), np.zeros(0, np.int64), 1e3 * (perf_counter() - start))

    def _truth(self, frame: Frame, stand: Stand) -> FrameTruth:
        if self.protocol == "measured":
            return select_truth(frame, stand.corners)
        objects, corners = frame.objects, stand.corners
        within = has_centre_inside(objects.boxes, corners)
        there = within if self.protocol == "published" else np.ones_like(within)
        counts = count_points(frame.points(), objects.boxes) if self.count_points else np.zeros(len(objects), np.int64)
        middle = (corners[:2] + corners[2:]) / 2
        return FrameTruth(objects[there], within[there], counts[there], corners, middle)


def _spread(job: _Job, total: int, run: Processes, progress: Callable[[int], None] | None) -> Iterator[_Scored]:
    """Score all frames. They are scored in this process, or shared out in stretches."""
    if run.alone:
        for done, each in enumerate(job.frames(range(total)), 1):
            if each.warning is not None and done == 1:
                warnings.warn(f"frame {done - 1}: {each.warning}", stacklevel=3)
            yield each
            if progress is not None:
                progress(done)
        return
    stretches = [range(k, min(k + STRETCH, total)) for k in range(0, total, STRETCH)]
    tell = None if progress is None else lambda done: progress(min(total, STRETCH * done))
    yield from chain.from_iterable(run.map(job, stretches, progress=tell))


@dataclass(frozen=True)
class _Run:
    """Results of one scheme and sensor set, all frames."""

    key: tuple[str, tuple[int, ...]]
    scored: Sequence[_Scored]

    @cached_property
    def fused(self) -> list[Fused]:
        return [each.fused[self.key] for each in self.scored]

    @cached_property
    def bits(self) -> Int64[np.ndarray, "frames sensors"] | None:
        """Bits of every sensor. None where frames have different sensors, or nothing is sent."""
        sizes = {len(each.bits) for each in self.fused}
        return np.array([each.bits for each in self.fused]) if len(sizes) == 1 and sizes != {0} else None

    @property
    def kbit_per_sensor(self) -> float:
        return float(np.mean([each.kbit_per_sensor for each in self.fused]))

    @property
    def ms_per_frame(self) -> float:
        return float(np.median([each.ms for each in self.fused]))

    def title(self, sets: int) -> str:
        """Name of the scheme. The sensors are added where there are several sets."""
        return self.key[0] if sets == 1 else f"{self.key[0]} {_sensor_text(self.key[1])}"

    def summary(self, scored: Sequence[_Scored], rate: float | None) -> dict[str, Any]:
        """Frames, detections, problems, median milliseconds, and what was sent."""
        problems: dict[str, int] = {}
        for each in scored:
            add_problems(problems, each.problems)
        figures = {
            "samples": len(scored),
            "detections": sum(len(each.detections) for each in self.fused),
            "problems": problems,
            "level_ms": float(np.median([each.level_ms for each in scored])),
            "detect_ms": self.ms_per_frame,
            "kbit_per_sensor": None if not any(len(each.bits) for each in self.fused) else self.kbit_per_sensor,
        }
        load = {} if rate is None or self.bits is None else {"load": link_load(self.bits, rate).as_dict()}
        return figures | load


def _row(run: _Run, label: str, iou: float, at: DetectionScore) -> Row:
    costs = (run.kbit_per_sensor, run.ms_per_frame)
    alarms = at.fp / len(run.fused)
    return Row(*run.key, iou, at.ap, at.recall, at.precision, *costs, at.curve, label, at.truths, alarms)


def _class_figures(
    scheme: str, sensors: tuple[int, ...], label: str, iou: float, at: DetectionScore, frames: int
) -> ClassFigures:
    counts = (frames, at.truths, at.tp + at.fp)
    diagram = reliability(at.scores, at.hits)
    return ClassFigures(scheme, sensors, label, iou, *counts, at.recall, at.precision, at.fp / frames, diagram)


def _thresholds(given: Sequence[float] | None, label: str) -> tuple[float, ...]:
    """IoU thresholds given, or the usual ones of a class."""
    return tuple(dict.fromkeys(float(iou) for iou in (USUAL_IOUS[label_index(label)] if given is None else given)))


def _defined(figure: Any) -> Any:
    return None if isinstance(figure, float) and math.isnan(figure) else figure
