"""Score fusion schemes and sensor sets over a recording with a detector: the first table of the paper.

What a sensor sees and detects is computed once per frame and shared by all schemes and sets; of a frame only the fused
boxes are kept, so memory does not grow with what the sensors measure. The truth is what stands with its centre in the
site's area. Under the exact protocol an object centred outside it is there but not scored, neither a miss nor a false
alarm (`counted` of `toolkit.detection.metrics.evaluate`); under the published one it is not there.

Milliseconds are the median frame's, from measurements to fused boxes, sensors working side by side as in the paper:

    early    slowest sensor's crop  +  detection in the fused cloud
    late     slowest sensor's crop and detection  +  fusion of boxes
    hybrid   the slower of the two: sensors' own detection, detection in the fused far points  +  fusion of boxes
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any, Literal, NamedTuple, Protocol, TypeVar, get_args, runtime_checkable

import numpy as np

from toolkit.arrays import Bool
from toolkit.boxes import Metric as Overlap
from toolkit.datasets.dataset import noisy
from toolkit.detection.fusion import (
    NMS_IOU,
    PAPER,
    Accounting,
    Fused,
    fuse_early,
    fuse_hybrid,
    fuse_late,
    hybrid_radius,
)
from toolkit.detection.metrics import Curve, evaluate
from toolkit.detection.metrics import Protocol as Scoring
from toolkit.frame import Frame
from toolkit.objects import Detections, Detector, Objects
from toolkit.points import Metric, beyond, centred_in, frame_points, select_sensors
from toolkit.runtime.files import write_text
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

Scheme = Literal["early", "late", "hybrid"]
SCHEMES: tuple[Scheme, ...] = get_args(Scheme)
Result = TypeVar("Result")


@runtime_checkable
class Recording(Protocol):
    """Frames at a site, such as `toolkit.datasets.dataset.CoopDataset`."""

    site: Site
    sensors: tuple[Sensor, ...]

    def __len__(self) -> int: ...
    def __getitem__(self, index: int, /) -> Frame: ...


@dataclass(frozen=True)
class Row:
    """One scheme, sensor set (indices) and IoU threshold: AP, and at the last detection recall and precision; kbit per
    sensor and frame; milliseconds per frame; the PR curve."""

    scheme: Scheme
    sensors: tuple[int, ...]
    iou: float
    ap: float
    recall: float
    precision: float
    kbit_per_sensor: float
    ms_per_frame: float
    curve: Curve = field(repr=False, compare=False)

    def as_dict(self) -> dict[str, Any]:
        """The row for JSON, without its curve; a figure that is undefined, such as AP without any truth, is None."""
        names = ("scheme", "sensors", "iou", "ap", "recall", "precision", "kbit_per_sensor", "ms_per_frame")
        row = {name: getattr(self, name) for name in names}
        return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in row.items()}


def evaluate_dataset(
    dataset: Recording,
    detector: Detector,
    *,
    schemes: Sequence[Scheme] = SCHEMES,
    sensor_sets: Sequence[Sequence[int | str] | None] = (None,),
    iou_thresholds: Sequence[float] = (0.7, 0.8, 0.9),
    frames: int | None = None,
    noise_seed: int | None = 0,
    radius: float | None = None,
    radius_metric: Metric = "horizontal",
    accounting: Accounting = PAPER,
    nms_iou: float = NMS_IOU,
    protocol: Scoring = "exact",
    metric: Overlap = "3d",
    label: str | int = "vehicle",
    progress: Callable[[int], None] | None = None,
) -> list[Row]:
    """Score every scheme with every sensor set at every IoU threshold, in this order.

    sensor_sets: indices or names, None for all; frames: only the first so many; noise_seed: None for none;
    radius (m) and radius_metric: of hybrid fusion, see `toolkit.detection.fusion.hybrid`; protocol, metric and label:
    see `toolkit.detection.metrics.evaluate`; progress is told the number of frames done. Raises ValueError for a scheme
    or sensor that does not exist and for a recording without frames.
    """
    site, count = dataset.site, min(len(dataset), len(dataset) if frames is None else frames)
    if count < 1:
        raise ValueError(f"there must be a frame to evaluate, got {count} of {len(dataset)}")
    if not (len(schemes) and len(sensor_sets) and len(iou_thresholds)):
        raise ValueError("there must be a scheme, a sensor set and an IoU threshold to evaluate")
    sets = [tuple(select_sensors(dataset.sensors, chosen)) for chosen in sensor_sets]
    runs = {(_known(scheme), chosen): _Run() for scheme in schemes for chosen in sets}
    rules = _Rules(
        detector, site, hybrid_radius(site) if radius is None else radius, radius_metric, accounting, nms_iou
    )
    truths, counted = [], []
    for k in range(count):
        frame = dataset[k] if noise_seed is None else noisy(dataset[k], noise_seed)
        truth, scored = _truth(frame.objects, site, protocol)
        truths.append(truth)
        counted.append(scored)
        seen = _Seen(frame, rules)
        for (scheme, chosen), run in runs.items():
            run.add(*seen.fused(scheme, chosen))
        if progress is not None:
            progress(k + 1)

    score = partial(
        evaluate,
        truths=truths,
        counted=counted,
        iou_thresholds=iou_thresholds,
        metric=metric,
        protocol=protocol,
        label=label,
    )
    return [
        Row(scheme, chosen, iou, at.ap, at.recall, at.precision, run.kbit_per_sensor, run.ms_per_frame, at.curve)
        for (scheme, chosen), run in runs.items()
        for iou, at in score(run.detections).items()
    ]


def format_table(rows: Iterable[Row]) -> str:
    """The rows as the paper's first table: a line per scheme and sensor set, a column of AP per IoU threshold."""
    lines: dict[tuple[str, str], dict[float, Row]] = {}
    for row in rows:
        lines.setdefault((row.scheme, ",".join(map(str, row.sensors)) or "none"), {})[row.iou] = row
    ious = list(dict.fromkeys(iou for line in lines.values() for iou in line))
    heads = ["scheme", "sensors", *(f"AP@{iou:g}" for iou in ious), f"recall@{ious[0]:g}", "kbit/sensor", "ms/frame"]
    table = [heads]
    for (scheme, sensors), line in lines.items():
        first = line[ious[0]]
        ap = [f"{line[iou].ap:.4f}" for iou in ious]
        costs = [f"{first.recall:.4f}", f"{first.kbit_per_sensor:.2f}", f"{first.ms_per_frame:.1f}"]
        table.append([scheme, sensors, *ap, *costs])
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    sides = [str.ljust] * 2 + [str.rjust] * (len(heads) - 2)
    return "\n".join(
        "  ".join(side(cell, width) for side, cell, width in zip(sides, line, widths, strict=True)) for line in table
    )


def save_evaluation(rows: Sequence[Row], folder: str | Path) -> None:
    """Write table.json, {"rows": [...]}, and the PR curves, pr_0.7.png and so on, into a folder made if missing."""
    from toolkit.plots import draw_pr_curves

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / "table.json", json.dumps({"rows": [row.as_dict() for row in rows]}, indent=1))
    for iou in dict.fromkeys(row.iou for row in rows):
        curves = {
            f"{row.scheme} {','.join(map(str, row.sensors))}: AP {row.ap:.3f}": (row.curve.recall, row.curve.precision)
            for row in rows
            if row.iou == iou
        }
        draw_pr_curves(curves, folder / f"pr_{iou:g}.png", title=f"IoU {iou:g}")


class _Rules(NamedTuple):
    """What stays the same over all frames."""

    detector: Detector
    site: Site
    radius: float
    radius_metric: Metric
    accounting: Accounting
    nms_iou: float


class _Run:
    """What one scheme and sensor set gave so far."""

    def __init__(self) -> None:
        self.detections: list[Detections] = []
        self._kbit: list[float] = []
        self._ms: list[float] = []

    def add(self, fused: Fused, ms: float) -> None:
        self.detections.append(fused.detections)
        self._kbit.append(fused.kbit_per_sensor)
        self._ms.append(ms)

    @property
    def kbit_per_sensor(self) -> float:
        return float(np.mean(self._kbit))

    @property
    def ms_per_frame(self) -> float:
        return float(np.median(self._ms))


class _Seen:
    """One frame as its sensors see it, each step done when first asked for, with the milliseconds it took."""

    def __init__(self, frame: Frame, rules: _Rules) -> None:
        self._frame, self._rules = frame, rules
        self._points: dict[int, tuple[np.ndarray, float]] = {}
        self._detections: dict[int, tuple[Detections, float]] = {}

    def points(self, sensor: int) -> tuple[np.ndarray, float]:
        """The cropped points of one sensor."""
        if sensor not in self._points:
            (points,), ms = _timed(partial(frame_points, self._frame, [sensor], area=self._rules.site))
            self._points[sensor] = points, ms
        return self._points[sensor]

    def detections(self, sensor: int) -> tuple[Detections, float]:
        """What one sensor detects by itself, cropping included."""
        if sensor not in self._detections:
            points, crop_ms = self.points(sensor)
            detections, ms = _timed(partial(self._rules.detector, points))
            self._detections[sensor] = detections, crop_ms + ms
        return self._detections[sensor]

    def far(self, sensor: int) -> tuple[np.ndarray, float]:
        """The cropped points of one sensor outside hybrid fusion's radius."""
        points, crop_ms = self.points(sensor)
        place, radius, metric = self._frame.sensors[sensor], self._rules.radius, self._rules.radius_metric
        outside, ms = _timed(lambda: points[beyond(points, place, radius, metric)])
        return outside, crop_ms + ms

    def fused(self, scheme: Scheme, sensors: Sequence[int]) -> tuple[Fused, float]:
        """One scheme with one sensor set."""
        costs: dict[str, Any] = {"accounting": self._rules.accounting, "iou_threshold": self._rules.nms_iou}
        sensors = sorted(sensors)
        if scheme == "late":
            boxes, boxes_ms = _parallel(map(self.detections, sensors))
            fused, ms = _timed(partial(fuse_late, boxes, **costs))
            return fused, boxes_ms + ms
        clouds, clouds_ms = _parallel(map(self.points if scheme == "early" else self.far, sensors))
        centre, ms = _timed(partial(fuse_early, clouds, self._rules.detector, **costs))
        if scheme == "early":
            return centre, clouds_ms + ms
        boxes, boxes_ms = _parallel(map(self.detections, sensors))
        fused, fusion_ms = _timed(partial(fuse_hybrid, boxes, centre, **costs))
        return fused, max(boxes_ms, clouds_ms + ms) + fusion_ms


def _truth(objects: Objects, site: Site, protocol: Scoring) -> tuple[Objects, Bool[np.ndarray, " n"]]:
    """The objects that are there, and which of them are scored."""
    within = centred_in(objects.boxes, site.area)
    there = within if protocol == "published" else np.ones_like(within)
    return objects[there], within[there]


def _timed(call: Callable[[], Result]) -> tuple[Result, float]:
    start = perf_counter()
    result = call()
    return result, (perf_counter() - start) * 1e3


def _parallel(steps: Iterable[tuple[Result, float]]) -> tuple[list[Result], float]:
    """The results of steps that run side by side, and the milliseconds of the slowest."""
    steps = list(steps)
    return [result for result, _ in steps], max((ms for _, ms in steps), default=0.0)


def _known(scheme: Scheme) -> Scheme:
    if scheme not in SCHEMES:
        raise ValueError(f"scheme must be one of {', '.join(SCHEMES)}, got {scheme!r}")
    return scheme
