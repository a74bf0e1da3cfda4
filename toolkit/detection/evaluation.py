"""Score fusion schemes and sensor sets over a recording with a detector: the first table of the paper.

What a sensor sees and detects is computed once per frame and shared by all schemes and sets (`toolkit.detection.view`);
of a frame only the fused boxes are kept, so memory does not grow with what the sensors measure. The truth is what
stands with its centre in the site's area. Under the exact protocol an object centred outside it is there but not
scored, neither a miss nor a false alarm (`counted` of `toolkit.detection.metrics.evaluate`); under the published one it
is not there.

Each class is scored by itself: detections of another class do not take part, so a cyclist reported as a pedestrian is a
false alarm of the one and a miss of the other. The detections are those that the detector reports, above its own
threshold; `ClassFigures` says what that threshold is worth. IoU thresholds, if none are given, are those usual for the
class (`toolkit.detection.metrics.USUAL_IOUS`).

Milliseconds are the median frame's, from measurements to fused boxes, sensors working side by side as in the paper.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol, overload, runtime_checkable

import numpy as np

from toolkit.arrays import Bool, Int64
from toolkit.boxes import Overlap
from toolkit.calibration.empty_scene import EmptyScene
from toolkit.calibration.scenes import RecordingScenes
from toolkit.datasets.readings import read_frame
from toolkit.detection.codec import PAPER, Codec, check_codec
from toolkit.detection.link.load import SetLoad, link_load
from toolkit.detection.metrics import TRUE_IOU, USUAL_IOUS, Curve, DetectionScore, Reliability, evaluate, reliability
from toolkit.detection.metrics import Protocol as Scoring
from toolkit.detection.provenance import dataset_origin, detector_origin, settings_origin, with_file_digest
from toolkit.detection.scheme import Fused, Scheme
from toolkit.detection.schemes import PAPER_SCHEMES, find_scheme
from toolkit.detection.view import NMS_IOU, frame_view
from toolkit.frame import Frame
from toolkit.objects import LABELS, VEHICLE, Detections, Detector, Objects, check_known, label_index
from toolkit.points import has_centre_inside, select_sensors
from toolkit.runtime.files import write_text, writing_together
from toolkit.runtime.text_tables import align_columns
from toolkit.sensors.error_profiles import PAPER_ERRORS, ErrorProfile, check_drawn, get_profile
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site


@runtime_checkable
class Recording(Protocol):
    """Frames at a site, such as `toolkit.datasets.dataset.CoopDataset`."""

    site: Site
    sensors: tuple[Sensor, ...]

    def __len__(self) -> int: ...
    def __getitem__(self, index: int, /) -> Frame: ...


@dataclass(frozen=True)
class Row:
    """One scheme, sensor set (indices), class and IoU threshold: AP, and at the last detection recall and precision;
    kbit per sensor and frame; milliseconds per frame; the PR curve; objects to find in all frames; false alarms per
    frame."""

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
        """The row for JSON, without its curve; a figure that is undefined, such as AP without any truth, is None."""
        names = (
            *("scheme", "sensors", "label", "iou", "ap", "recall", "precision", "truths", "false_alarms_per_frame"),
            *("kbit_per_sensor", "ms_per_frame"),
        )
        return {name: _defined(getattr(self, name)) for name in names}


@dataclass(frozen=True)
class ClassFigures:
    """What the detector's own threshold is worth for one class, scheme and sensor set, where a detection is true from
    the IoU `iou` on (`TRUE_IOU`): objects to find and detections that count in all `frames`; share that is found, share
    that is true, false alarms per frame; and whether scores are shares of true detections."""

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
        """The figures for JSON, with the reliability diagram bin by bin; None for a figure that is undefined."""
        diagram = self.reliability
        bins = {
            "score": [_defined(each) for each in diagram.score.tolist()],
            "true": [_defined(each) for each in diagram.true.tolist()],
            "count": diagram.count.tolist(),
        }
        own = {name: _defined(value) for name, value in vars(self).items() if name != "reliability"}
        return own | {"calibration_error": diagram.error, "reliability": bins}


@dataclass(frozen=True)
class Evaluation(Sequence[Row]):
    """The rows of an evaluation; what the detector's threshold is worth class by class; what each scheme and sensor set
    puts on a link, if a rate was given; and where all that comes from: dataset, detector, settings and version."""

    rows: tuple[Row, ...]
    provenance: dict[str, Any]
    classes: tuple[ClassFigures, ...] = ()
    loads: tuple[SetLoad, ...] = ()

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

    def as_dict(self) -> dict[str, Any]:
        """Rows and class figures for JSON."""
        return {
            "rows": [row.as_dict() for row in self.rows],
            "classes": [figures.as_dict() for figures in self.classes],
        } | ({"loads": [load.as_dict() for load in self.loads]} if self.loads else {})


def evaluate_dataset(
    dataset: Recording,
    detector: Detector,
    *,
    schemes: Sequence[Scheme | str] = PAPER_SCHEMES,
    sensor_sets: Sequence[Sequence[int | str] | None] = (None,),
    classes: Sequence[str | int] = ("vehicle",),
    iou_thresholds: Sequence[float] | None = None,
    frames: int | None = None,
    noise_seed: int | None = 0,
    errors: ErrorProfile | str = PAPER_ERRORS,
    radius: float | None = None,
    codec: Codec = PAPER,
    nms_iou: float = NMS_IOU,
    protocol: Scoring = "exact",
    metric: Overlap = "3d",
    scenes: Sequence[EmptyScene] | None = None,
    rate: float | None = None,
    progress: Callable[[int], None] | None = None,
) -> Evaluation:
    """Score every scheme with every sensor set, every class of it at every IoU threshold, in this order.

    schemes: objects or names; sensor_sets: indices or names, None for all; classes: names or numbers of
    `toolkit.objects.LABELS`; iou_thresholds: of all classes, None for those usual for each (vehicle and heavy 0.7, 0.8,
    0.9; cyclist and pedestrian 0.25, 0.5, 0.7); frames: only the first so many; noise_seed:
    None for none; errors: of the sensors, a profile or its name, drawn from that seed; radius: in place of the site's
    hybrid radius (m); codec: of what is sent; scenes: empty ones of all sensors, for schemes that need them, None to
    learn them from this recording; rate: of frames (Hz), to say what they put on a link; protocol and metric: see
    `toolkit.detection.metrics.evaluate`; progress is told the number of frames done. Raises ValueError for a scheme,
    sensor, class or error profile that does not
    exist, a class that the detector does not know, two schemes of one name, and a recording without frames.
    """
    count = min(len(dataset), len(dataset) if frames is None else frames)
    if count < 1 or isinstance(frames, float):
        raise ValueError(f"there must be a frame to evaluate, a whole number, got {frames} of {len(dataset)}")
    labels = [LABELS[k] for k in dict.fromkeys(label_index(label) for label in classes)]
    ious = {label: _thresholds(iou_thresholds, label) for label in labels}
    if not (len(schemes) and len(sensor_sets) and labels and all(ious.values())):
        raise ValueError("there must be a scheme, a sensor set, a class and an IoU threshold to evaluate")
    check_known(detector, labels)
    errors = get_profile(errors)
    check_drawn(errors, noise_seed)
    site = dataset.site if radius is None else replace(dataset.site, hybrid_radius=radius)
    named = _named(schemes)
    sets = [tuple(select_sensors(dataset.sensors, chosen)) for chosen in sensor_sets]
    runs = {(name, chosen): _Run() for name in named for chosen in sets}
    known = RecordingScenes(dataset, scenes, errors=errors, noise_seed=noise_seed)
    settings: dict[str, Any] = {"codec": check_codec(codec), "nms_iou": nms_iou, "scene": known, "memory": {}}
    truths, counted = [], []
    for k in range(count):
        frame = read_frame(dataset, k, errors=errors, noise_seed=noise_seed)
        truth, scored = _truth(frame.objects, site, protocol)
        truths.append(truth)
        counted.append(scored)
        view = frame_view(frame, detector, site, **settings)
        for (name, chosen), run in runs.items():
            run.add(named[name].fuse(view, sorted(chosen)))
        if progress is not None:
            progress(k + 1)

    scoring: dict[str, Any] = {"metric": metric, "protocol": protocol}
    rows: list[Row] = []
    summaries: list[ClassFigures] = []
    for (name, chosen), run in runs.items():
        for label, thresholds in ious.items():
            true_iou = TRUE_IOU[label_index(label)]
            at = evaluate(
                run.detections, truths, counted=counted, label=label, iou_thresholds=[*thresholds, true_iou], **scoring
            )
            rows += [_row(name, chosen, label, iou, at[iou], run) for iou in thresholds]
            summaries.append(_class_figures(name, chosen, label, true_iou, at[true_iou], count))
    loads = [SetLoad(*which, link_load(np.array(run.bits), rate)) for which, run in runs.items() if rate is not None]
    digests = {name: scheme.digest for name, scheme in named.items()}
    place = {"site": site.name, "hybrid_radius": site.hybrid_radius, "frames": count, "noise_seed": noise_seed}
    drawn = {"errors": errors.origin, "nms_iou": nms_iou, **scoring}
    drawn |= {"empty_scenes": known.digests} if known.used else {}
    scored_by = {"label": labels[0], "iou": list(ious[labels[0]])} if len(labels) == 1 else {"classes": ious}
    return Evaluation(
        tuple(rows),
        dataset_origin(dataset)
        | detector_origin(detector)
        | settings_origin(codec, **place, **drawn, schemes=digests, **scored_by),
        tuple(summaries),
        tuple(loads),
    )


def format_table(rows: Iterable[Row]) -> str:
    """The rows as the paper's first table: a line per scheme and sensor set, a column of AP per IoU threshold; of
    several classes one such table after another."""
    by_class: dict[str, list[Row]] = {}
    for row in rows:
        by_class.setdefault(row.label, []).append(row)
    tables = [_ap_table(some) for some in by_class.values()]
    if len(tables) < 2:
        return "".join(tables)
    return "\n\n".join(f"{label}, {by_class[label][0].truths} to find\n{table}"
                        for label, table in zip(by_class, tables, strict=True))  # fmt: skip


def format_class_table(classes: Iterable[ClassFigures]) -> str:
    """What the detector's threshold is worth: a line per class, scheme and sensor set."""
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
    """Name of the picture of PR curves of each class and IoU threshold: pr_0.7.png for vehicles, pr_cyclist_0.5.png
    for others."""
    return {
        f"pr_{'' if label == LABELS[VEHICLE] else label + '_'}{iou:g}.png": (label, iou)
        for label in classes
        for iou in _thresholds(iou_thresholds, label)
    }


def save_evaluation(rows: Evaluation, folder: str | Path) -> None:
    """Write table.json, {"provenance": {...}, "rows": [...], "classes": [...]}, and the PR curves (`curve_files`), into
    a folder made if missing: all, or where that fails (OSError) none."""
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


class _Run:
    """What one scheme and sensor set gave so far."""

    def __init__(self) -> None:
        self.detections: list[Detections] = []
        self.bits: list[Int64[np.ndarray, " sensors"]] = []
        self._kbit: list[float] = []
        self._ms: list[float] = []

    def add(self, fused: Fused) -> None:
        self.detections.append(fused.detections)
        self.bits.append(fused.bits)
        self._kbit.append(fused.kbit_per_sensor)
        self._ms.append(fused.ms)

    @property
    def kbit_per_sensor(self) -> float:
        return float(np.mean(self._kbit))

    @property
    def ms_per_frame(self) -> float:
        return float(np.median(self._ms))


def _truth(objects: Objects, site: Site, protocol: Scoring) -> tuple[Objects, Bool[np.ndarray, " n"]]:
    """The objects that are there, and which of them are scored."""
    within = has_centre_inside(objects.boxes, site.area)
    there = within if protocol == "published" else np.ones_like(within)
    return objects[there], within[there]


def _named(schemes: Sequence[Scheme | str]) -> dict[str, Scheme]:
    """The schemes by their names. Raises ValueError where two share one."""
    named: dict[str, Scheme] = {}
    for scheme in map(find_scheme, schemes):
        if named.setdefault(scheme.name, scheme) != scheme:
            raise ValueError(f"two schemes are called {scheme.name!r}, {named[scheme.name]} and {scheme}: rename one")
    return named


def _row(scheme: str, sensors: tuple[int, ...], label: str, iou: float, at: DetectionScore, run: _Run) -> Row:
    costs = (run.kbit_per_sensor, run.ms_per_frame)
    alarms = at.fp / len(run.detections)
    return Row(scheme, sensors, iou, at.ap, at.recall, at.precision, *costs, at.curve, label, at.truths, alarms)


def _class_figures(
    scheme: str, sensors: tuple[int, ...], label: str, iou: float, at: DetectionScore, frames: int
) -> ClassFigures:
    counts = (frames, at.truths, at.tp + at.fp)
    diagram = reliability(at.scores, at.hits)
    return ClassFigures(scheme, sensors, label, iou, *counts, at.recall, at.precision, at.fp / frames, diagram)


def _thresholds(given: Sequence[float] | None, label: str) -> tuple[float, ...]:
    """Those given, or those usual for a class."""
    return tuple(dict.fromkeys(float(iou) for iou in (USUAL_IOUS[label_index(label)] if given is None else given)))


def _defined(figure: Any) -> Any:
    return None if isinstance(figure, float) and math.isnan(figure) else figure
