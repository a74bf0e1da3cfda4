"""Score fusion schemes and sensor sets on a recording: the first table of the paper, and more.

What a sensor sees and detects is computed once per frame and shared by all schemes and sets
(`toolkit.detection.view`). Only the fused boxes of a frame are kept. Three protocols say which
objects are to be found:

- `exact`: those with their centre in the site's area. Others are there but not scored, neither
  misses nor false alarms (`counted` of `toolkit.detection.metrics.evaluate`).
- `published`: the same, but others are not there, and detections are matched as the published code
  does.
- `measured`, the rule for recorded labels: those in the area, where labels are complete, with at
  least one point. An object labelled twice counts once; detections where labels are not complete do
  not count.

Each class is scored separately: a cyclist reported as a pedestrian is a false alarm for pedestrians
and a miss for cyclists. Detections are those that the detector reports, above its own threshold;
`ClassFigures` says what that threshold is worth. With a breakdown, AP is also given by range, by
points, and as KITTI and nuScenes count it (`toolkit.detection.breakdown`). Milliseconds are those
of the median frame, from measurements to fused boxes, with sensors working side by side as in the
paper."""

import json
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
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
from toolkit.detection.link.message import SetLoad, format_loads, link_load
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
STRETCH = 10  # frames that a worker scores at once
EXAMPLE_IOU = 0.7  # at which a detection hits, in the paper's first column
Scoring = Literal["exact", "published", "measured"]


@dataclass(frozen=True)
class Row:
    """Figures of one scheme, sensor set (indices), class and IoU threshold. recall, precision: at
    the last detection; kbit and milliseconds are per frame; truths: to find in all frames."""

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
    """Worth of the detector's own threshold for one class, with one scheme and sensor set
    (indices). A detection is true from the IoU `iou` on (`TRUE_IOU`). truths, detections: those
    that count, in all `frames`. The second label of an object (`second_labels`) is a false alarm
    here."""

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
    """Schemes and sensor sets to be compared, and rules.

    schemes: objects or names, None for all clouds at once, uncropped; sensor_sets: indices or
    names, None for all; classes: names or numbers of `toolkit.objects.LABELS`; iou_thresholds: of
    all classes, None for those usual for each (`toolkit.detection.metrics.USUAL_IOUS`); protocol:
    None for exact at a known site, else measured; metric: see `toolkit.detection.metrics.evaluate`;
    codec: of what is sent; radius: in place of the site's hybrid radius (m); rate: of frames (Hz),
    to say what is put on a link; breakdown: by range, points and other sets' protocols, None for
    where no site is known."""

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

    classes: worth of the detector's threshold; loads: on a link, if a rate was given; schemes:
    frames, detections, problems and median milliseconds of each; breakdown: by range, points and
    other sets' protocols; poses: of the sensors, where they were found before."""

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
        parts = ["\n".join(map(str, self.poses))] * bool(self.poses) + [format_table(self.rows)]
        if self.loads:
            parts.append(
                f"on a link at {self.loads[0].load.rate:g} Hz:\n{format_loads(self.loads)}"
            )
        parts.append(f"above the detector's threshold:\n{format_class_table(self.classes)}")
        left: Mapping[str, int] = next((each["problems"] for each in self.schemes.values()), {})
        if left and not self.breakdown:
            parts.append(
                "left out or doubtful: "
                f"{', '.join(f'{number} {kind}' for kind, number in left.items())}"
            )
        for name, figures in self.schemes.items() if self.breakdown else ():
            parts.append(f"{name}: {describe_summary(figures)}")
            for sensor, each in figures.get("images", {}).items():
                kinds = ", ".join(
                    f"{count} {kind}" for kind, count in each.items() if kind != "points"
                )
                parts[-1] += (
                    f"\n{sensor}: of {each['points']} points its images leave out {kinds or 'none'}"
                )
            parts.append(format_rows([row for row in self.breakdown if row.scheme == name]))
        return "\n\n".join(parts)

    def as_dict(self) -> dict[str, Any]:
        """Return all but the provenance for JSON, undefined as None."""
        rows = [row.as_dict() for row in self.rows]
        classes = [figures.as_dict() for figures in self.classes]
        optional: dict[str, Any] = {"loads": [load.as_dict() for load in self.loads]}
        optional["breakdown"] = [vars(row) for row in self.breakdown]
        optional["poses"] = {each.sensor.name: each.described() for each in self.poses}
        known = {name: value for name, value in optional.items() if value}
        return replace_infinite(
            {"rows": rows, "classes": classes, "schemes": self.schemes, **known}
        )


def _find_outside(truths: Sequence[FrameTruth], found: Sequence[Detections]) -> list[Mask]:
    """Masks of the detections of each frame that are outside its area."""
    return [~truth.inside(detections) for truth, detections in zip(truths, found, strict=True)]


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
    """Score every scheme with every sensor set, class by class, at each of its IoU thresholds.

    place: where the detector looks and on what ground; reads: errors of the sensors and number of
    frames; scenes: empty ones, for schemes that need them, None to learn them from this recording.
    Several workers share out the frames, unless a scheme's messages can only be read after others.

    Raises ValueError for a scheme, sensor, class or error profile that does not exist, a class that
    the detector does not know, two schemes of one name, and a recording without frames."""
    total = reads.count(recording)
    errors = reads.profile()
    labels = [LABELS[k] for k in dict.fromkeys(map(label_index, asked.classes))]
    ious = {label: _thresholds(asked.iou_thresholds, label) for label in labels}
    if not (len(asked.schemes) and len(asked.sensor_sets) and labels and all(ious.values())):
        raise ValueError(
            "there must be a scheme, a sensor set, a class and an IoU threshold to evaluate"
        )
    check_known(detector, labels)
    site = recording.site
    if site is not None and asked.radius is not None:
        site = replace(site, hybrid_radius=asked.radius)
    named: dict[str, Scheme | None] = {}
    for given in asked.schemes:
        scheme = None if given is None else find_scheme(given)
        name = ALL_CLOUDS if scheme is None else scheme.name
        if named.setdefault(name, scheme) != scheme:
            raise ValueError(
                f"two schemes are called {name!r}, {named[name]} and {scheme}: rename one"
            )
    check_labels(recording, total)
    measured = ReadRecording(recording, reads)
    known = place.at(site)
    first = measured[0]
    numbers = [tuple(select_sensors(first.sensors, chosen)) for chosen in asked.sensor_sets]
    sets = {chosen: tuple(first.sensors[k].name for k in chosen) for chosen in numbers}
    protocol = asked.protocol or ("exact" if known else "measured")
    breakdown = (not known) if asked.breakdown is None else asked.breakdown
    images = Scenes(measured if known else Part(measured, total)) if scenes is None else scenes
    job = _Job(
        measured, detector, asked, place, site, known, named, sets, images, protocol, breakdown
    )

    progress = run.stage("frame", total)
    scored = list[_Scored]()
    if run.alone or any(isinstance(scheme, Chained) for scheme in named.values()):
        for each in job.score(chain([first], (measured[k] for k in range(1, total))), range(total)):
            scored.append(each)
            if progress is not None:
                progress(len(scored))
        if scored[0].warning is not None:
            warnings.warn(f"frame 0: {scored[0].warning}", stacklevel=2)
    else:
        stretches = [range(k, min(k + STRETCH, total)) for k in range(0, total, STRETCH)]
        tell = None if progress is None else lambda done: progress(min(total, STRETCH * done))
        scored += chain.from_iterable(run.map(job, stretches, progress=tell))

    problems = sum((Counter(each.problems) for each in scored), Counter[str]())
    truths = [each.truth for each in scored]
    objects = [truth.objects for truth in truths]
    counted = [truth.counted for truth in truths]
    counting: Literal["exact", "published"] = "published" if protocol == "published" else "exact"
    rows = list[Row]()
    classes = list[ClassFigures]()
    loads = list[SetLoad]()
    groups = list[GroupRow]()
    figures: dict[str, dict[str, Any]] = {}
    for name, chosen in scored[0].fused:
        fused = [each.fused[name, chosen] for each in scored]
        found = [each.detections for each in fused]
        outside = _find_outside(truths, found) if protocol == "measured" else None
        bits = [each.bits for each in fused]
        ms = float(np.median([each.ms for each in fused]))
        kbit = float(np.mean([sent.mean() / 1000 if len(sent) else 0.0 for sent in bits]))
        score = partial(
            evaluate, found, objects, metric=asked.metric, protocol=counting, counted=counted
        )
        for label, thresholds in ious.items():
            true_iou = TRUE_IOU[label_index(label)]
            scores = score(label=label, iou_thresholds=[*thresholds, true_iou], outside=outside)
            for iou, at in ((iou, scores[iou]) for iou in thresholds):
                shares = at.ap, at.recall, at.precision
                rows.append(
                    Row(
                        name,
                        chosen,
                        iou,
                        *shares,
                        kbit,
                        ms,
                        at.curve,
                        label,
                        at.truths,
                        at.fp / total,
                    )
                )
            second = _second_scores(found, truths, outside, metric=asked.metric, label=label)
            classes.append(_rate_class(name, chosen, label, scores[true_iou], total, second))
        title = name if len(sets) == 1 else f"{name} {_sensor_text(chosen)}"
        if breakdown:
            judged = [truth.judge(each) for truth, each in zip(truths, found, strict=True)]
            every = chain.from_iterable(
                group_rows(judged, label, asked.iou_thresholds) for label in labels
            )
            groups += [replace(row, scheme=title) for row in every]
        own = figures[title] = {
            "samples": total,
            "detections": sum(len(each.detections.boxes) for each in fused),
        }
        own |= {
            "problems": dict(problems),
            "level_ms": float(np.median([each.level_ms for each in scored])),
        }
        own |= {"detect_ms": ms, "kbit_per_sensor": kbit if any(map(len, bits)) else None}
        if asked.rate is not None and len({*map(len, bits)}) == 1 and len(bits[0]):
            loads.append(SetLoad(name, chosen, link_load(np.array(bits), asked.rate)))
            own["load"] = vars(loads[-1].load)
        if not known and _sends_images(named[name], asked.codec):
            learnt = images.every.items()
            own["images"] = {
                sensor: {"points": each.points, **each.left_out} for sensor, each in learnt
            }

    placed = {
        "site": site and site.name,
        "hybrid_radius": site and site.hybrid_radius,
        "frames": total,
    }
    drawn: dict[str, object] = {
        "noise_seed": reads.noise_seed,
        "errors": errors.origin,
        "nms_iou": asked.nms_iou,
    }
    drawn |= {"metric": asked.metric, "protocol": protocol} | (
        {"empty_scenes": images.digests} if images.used else {}
    )
    drawn |= (
        {"label": labels[0], "iou": list(ious[labels[0]])}
        if len(labels) == 1
        else {"classes": ious}
    )
    digests = {
        name: "all clouds at once" if each is None else each.digest for name, each in named.items()
    }
    origin = settings_origin(asked.codec, **placed, **drawn, schemes=digests)
    provenance = dataset_origin(recording) | detector_origin(detector) | origin
    return Evaluation(tuple(rows), provenance, tuple(classes), tuple(loads), figures, tuple(groups))


def _second_scores(
    found: Sequence[Detections],
    truths: Sequence[FrameTruth],
    outside: Sequence[Mask] | None,
    *,
    metric: Overlap,
    label: str,
) -> Float64[np.ndarray, " n"]:
    """Scores of the detections that are an object's second label, in all frames. Only vehicles
    are."""
    scores = [np.zeros(0)]
    if label != LABELS[VEHICLE]:
        return scores[0]
    for number, (detections, truth) in enumerate(zip(found, truths, strict=True)):
        beyond = None if outside is None else outside[number]
        second = second_labels(
            detections, truth.objects, metric=metric, counted=truth.counted, outside=beyond
        )
        scores.append(detections.scores[second])
    return np.concatenate(scores)


def _rate_class(
    scheme: str,
    sensors: tuple[int, ...],
    label: str,
    at: DetectionScore,
    frames: int,
    second: Float64[np.ndarray, " n"],
) -> ClassFigures:
    """Rate the detector's threshold, with scores of second labels as false alarms."""
    detections = at.tp + at.fp + len(second)
    scores = np.append(at.scores, second)
    hits = np.append(at.hits, np.zeros(len(second), bool))
    return ClassFigures(
        scheme=scheme,
        sensors=sensors,
        label=label,
        iou=TRUE_IOU[label_index(label)],
        frames=frames,
        truths=at.truths,
        detections=detections,
        recall=at.recall,
        precision=at.tp / detections if detections else np.nan,
        false_alarms_per_frame=(at.fp + len(second)) / frames,
        reliability=reliability(scores, hits),
    )


def _thresholds(given: Sequence[float] | None, label: str) -> tuple[float, ...]:
    return tuple(
        dict.fromkeys(
            float(iou) for iou in (USUAL_IOUS[label_index(label)] if given is None else given)
        )
    )


def _sends_images(scheme: Scheme | None, codec: Codec) -> bool:
    return (
        scheme is not None
        and scheme.sends_points
        and isinstance(scheme_codec(scheme, codec), ImageCodec)
    )


@dataclass(frozen=True, eq=False)
class _Scored:
    """Truth of one frame, and results of schemes and sets."""

    truth: FrameTruth
    fused: dict[tuple[str, tuple[int, ...]], Fused]
    problems: Mapping[str, int]
    level_ms: float
    warning: str | None = None


@dataclass(frozen=True)
class _Job:
    """Scores frames one after another; pickled to other processes."""

    recording: ReadRecording
    detector: Detector
    asked: Comparison
    place: Place
    site: Site | None
    known: bool
    schemes: dict[str, Scheme | None]
    sets: dict[tuple[int, ...], tuple[str, ...]]
    scenes: Scenes
    protocol: Scoring
    count_points: bool

    def __call__(self, numbers: Sequence[int]) -> list[_Scored]:
        return list(self.score((self.recording[k] for k in numbers), numbers))

    def score(self, frames: Iterable[Frame], numbers: Iterable[int]) -> Iterator[_Scored]:
        """Yield what each frame gives, in order."""
        every = None in self.asked.sensor_sets
        wanted = list(dict.fromkeys(chain.from_iterable(self.sets.values())))
        memory = LinkMemory()
        remembered = list[str]()
        some = (frame if every or self.known else frame.seen_by(wanted) for frame in frames)
        for number, (frame, stand) in zip(numbers, self.place.stands(some, self.site), strict=True):
            names = [sensor.name for sensor in frame.sensors]
            memory = memory if names == remembered else LinkMemory()
            remembered = names
            numbered = frame if frame.index == number else replace(frame, index=number)
            fused = self._fuse(numbered, stand, memory)
            if self.protocol == "measured":
                truth = select_truth(frame, stand.corners)
            else:
                objects = frame.objects
                within = has_centre_inside(frame.objects.boxes, stand.corners)
                counted = self.count_points
                counts = (
                    count_points(frame.points(), objects.boxes)
                    if counted
                    else np.zeros(len(within), np.int64)
                )
                if self.protocol == "published":
                    objects, within, counts = objects[within], within[within], counts[within]
                truth = FrameTruth(objects, within, counts, stand.corners)
            yield _Scored(truth, fused, frame.problems, stand.ms, stand.warning)

    def _fuse(
        self, frame: Frame, stand: Stand, memory: LinkMemory
    ) -> dict[tuple[str, tuple[int, ...]], Fused]:
        asked = self.asked
        fused = dict[tuple[str, tuple[int, ...]], Fused]()

        @cache
        def view(as_images: bool) -> View:
            codec = check_codec(asked.codec)
            scenes = self.scenes if as_images else None
            make = partial(
                stand_view, frame, self.detector, stand, codec=codec, nms_iou=asked.nms_iou
            )
            return make(scenes=scenes, memory=memory)

        for name, scheme in self.schemes.items():
            for chosen, names in self.sets.items():
                # also where all sensors are wanted and some are missing
                present = list(range(len(frame.sensors)))
                if None not in asked.sensor_sets or len(chosen) < max(map(len, self.sets)):
                    present = sorted(select_sensors(frame.sensors, names))
                if scheme is None:
                    points = stand.lift(frame.seen_by(present).points())
                    start = perf_counter()
                    found = (
                        detect_on_ground(self.detector, points, stand.area)
                        if len(points)
                        else Detections.empty()
                    )
                    made = Fused(found, np.zeros(0, np.int64), 1e3 * (perf_counter() - start))
                else:
                    made = scheme.fuse(
                        view(self.known or _sends_images(scheme, asked.codec)), present
                    )
                found = made.detections if self.known else stand.put_back(made.detections)
                fused[name, chosen] = replace(made, detections=found)
        return fused


def format_table(rows: Iterable[Row]) -> str:
    """Format rows like the paper's first table, class by class. Each scheme and sensor set has a
    line, each IoU threshold a column of AP."""
    by_class: dict[str, list[Row]] = {}
    for row in rows:
        by_class.setdefault(row.label, []).append(row)
    tables = []
    for label, some in by_class.items():
        lines: dict[tuple[str, str], dict[float, Row]] = {}
        for row in some:
            lines.setdefault((row.scheme, _sensor_text(row.sensors)), {})[row.iou] = row
        ious = list(dict.fromkeys(row.iou for row in some))
        aps = [f"AP@{iou:g}" for iou in ious]
        table = [["scheme", "sensors", *aps, f"recall@{ious[0]:g}", "kbit/sensor", "ms/frame"]]
        for named, line in lines.items():
            at = line[ious[0]]
            costs = [
                format_share(at.recall, at.truths),
                f"{at.kbit_per_sensor:.2f}",
                f"{at.ms_per_frame:.1f}",
            ]
            table.append(
                [*named, *(format_share(line[iou].ap, line[iou].truths) for iou in ious), *costs]
            )
        head = f"{label}, {some[0].truths} to find\n" if len(by_class) > 1 else ""
        tables.append(head + align_columns(table, texts=2))
    return "\n\n".join(tables)


def format_class_table(classes: Iterable[ClassFigures]) -> str:
    """Format the worth of the detector's threshold, line by line."""
    heads = [
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
    table = [heads]
    for each in classes:
        shares = (each.precision, each.false_alarms_per_frame, each.reliability.error)
        named = [each.label, each.scheme, _sensor_text(each.sensors), str(each.truths)]
        named.append(format_share(each.recall, each.truths))
        table.append([*named, *(f"{figure:.3f}" for figure in shares), f"{each.iou:g}"])
    return align_columns(table, texts=3)


def _sensor_text(sensors: Sequence[int]) -> str:
    return ",".join(map(str, sensors)) or "none"


def curve_files(
    classes: Sequence[str], iou_thresholds: Sequence[float] | None = None
) -> dict[str, tuple[str, float]]:
    """Name the PR picture of each class and threshold: pr_0.7.png for vehicles at IoU 0.7,
    pr_cyclist_0.5.png."""
    return {
        f"pr_{'' if label == LABELS[VEHICLE] else label + '_'}{iou:g}.png": (label, iou)
        for label in classes
        for iou in _thresholds(iou_thresholds, label)
    }


def save_evaluation(rows: Evaluation, folder: str | Path) -> None:
    """Write table.json and the PR curves (`curve_files`) into a folder, which is made if missing.
    table.json is {"provenance": {...}, "rows": [...], "classes": [...]}. All files are written, or
    where that fails (OSError) none.
    """
    with writing_together(folder) as unfinished:
        table = {"provenance": with_file_digest(rows.provenance), **rows.as_dict()}
        write_text(unfinished / "table.json", json.dumps(table, indent=1))
        for label, iou in dict.fromkeys((row.label, row.iou) for row in rows):
            some = [row for row in rows if (row.label, row.iou) == (label, iou)]
            curves = {}
            for row in some:
                title = (
                    f"{row.scheme} {','.join(map(str, row.sensors))}: AP "
                    f"{format_share(row.ap, row.truths)}"
                )
                curves[title] = row.curve.recall, row.curve.precision
            (name,) = curve_files([label], [iou])
            title = f"IoU {iou:g}" if label == LABELS[VEHICLE] else f"{label}, IoU {iou:g}"
            draw_pr_curves(curves, unfinished / name, title=title)


def draw_example(
    recording: CoopDataset, detector: Detector, out: str | Path, *, seed: int = 0
) -> None:
    """Draw the frame with the most objects, and hits, misses and false alarms of vehicles at
    `EXAMPLE_IOU`, from above. Objects centred outside the area do not count. seed: of the sensors'
    noise."""
    site = recording.site
    frame = with_errors(max(recording, key=lambda frame: len(frame.objects)), PAPER_ERRORS, seed)
    truth = frame.objects
    found = fuse_frame("early", frame, detector, site=site).detections
    (result,) = matches(
        found, truth, [EXAMPLE_IOU], counted=has_centre_inside(truth.boxes, site.area)
    )
    sensors = f"{len(frame.sensors)} sensor{'s' * (len(frame.sensors) != 1)}"
    outcome = FrameOutcome(
        EXAMPLE_IOU, result.hit, ~result.scored, result.truth >= 0, result.ignored
    )
    name = detector_origin(detector)["detector"]
    title = f"{site.name}, frame {frame.index}: early fusion of {sensors}, {name}"
    clouds = frame_points(frame, area=site)
    draw_frame(
        site, out, clouds=clouds, truth=truth, detections=found, outcome=outcome, title=title
    )
