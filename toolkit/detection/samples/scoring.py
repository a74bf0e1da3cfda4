"""What detections in samples are worth: AP by footprint and volume, by range and points, in three protocols by name.

- `ours`: `toolkit.detection.metrics`, exact, all points of the curve. By IoU over all objects, and at one IoU by range
  from the middle of the area and by the points that the object has in the sample's clouds.
- `KITTI R40` and `nuScenes`: `toolkit.detection.samples.protocols`.

An object counts if its centre lies in the area, its set's labels are complete there (`Sample.complete`) and it has at
least one point; other labelled objects are neither misses nor, where a detection lies on one, false alarms. An object
that is labelled twice, by boxes of one class that all but coincide (`TWICE`), counts once. Detections where the labels
are not complete do not count. By range, a detection goes with the object it overlaps, else with its own place; by
points, false alarms count in every row, as they have no object.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from toolkit.arrays import Bool
from toolkit.boxes import Overlap, count_points, iou_3d, iou_bev
from toolkit.datasets.records.labels import add_problem, add_problems
from toolkit.detection.metrics import evaluate
from toolkit.detection.samples.detected import Detected
from toolkit.detection.samples.protocols import (
    CENTRE_DISTANCES,
    KITTI_IOU,
    by_centre,
    kitti_ap,
    mean_of,
    nuscenes_ap,
)
from toolkit.objects import LABELS, Detections, Objects, label_index

LEAST_POINTS = 1
TWICE = 0.9  # 3D IoU of two labels of a class from which they are of one object: no two bodies share that much room
LABELLED_TWICE = "objects labelled twice, by boxes that differ a little (one counts)"
RANGES = (0.0, 20.0, 35.0, 50.0, float("inf"))  # m
POINTS = (1.0, 5.0, 20.0, 100.0, float("inf"))
_LARGE, _SMALL = (0.3, 0.5, 0.7), (0.1, 0.25, 0.5)
IOUS = {"vehicle": _LARGE, "heavy": _LARGE, "cyclist": _SMALL, "pedestrian": _SMALL}
METRICS: tuple[Overlap, ...] = ("bev", "3d")


@dataclass(frozen=True)
class SampleRow:
    """AP of one class under one protocol. measure: by what detections are true, such as BEV 0.5; among: which objects;
    truths: how many of them; scheme: how the sensors fused."""

    label: str
    protocol: str
    measure: str
    among: str
    ap: float
    truths: int
    scheme: str = "all clouds"

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return dict(vars(self))


@dataclass(frozen=True, eq=False)
class Judged:
    """One sample to be scored: what was found where labels are complete, what is there, which of it counts, points on
    it, and how far (m) both are from the middle."""

    found: Detections
    truths: Objects
    counted: np.ndarray
    points: np.ndarray
    truth_range: np.ndarray
    found_range: np.ndarray


@dataclass
class Scoring:
    """Collects samples as they come by. half: of the area's sides (m), about each sample's middle."""

    half: tuple[float, float] = (50.0, 50.0)
    judged: list[Judged] = field(default_factory=list)
    problems: dict[str, int] = field(default_factory=dict)
    level_ms: list[float] = field(default_factory=list)
    detect_ms: list[float] = field(default_factory=list)

    def add(self, each: Detected) -> None:
        """One sample more."""
        self.judged.append(judged(each, self.half))
        add_problems(self.problems, each.sample.problems)
        add_problem(self.problems, LABELLED_TWICE, int(repeated(each.sample.objects).sum()))
        self.level_ms.append(each.level_ms)
        self.detect_ms.append(each.detect_ms)

    def rows(self, classes: Sequence[str], ious: Sequence[float] | None = None) -> list[SampleRow]:
        """All rows of some classes, those without an object to find among them."""
        return [row for label in classes for row in _class_rows(self.judged, label, ious or IOUS[label])]


def judged(each: Detected, half: tuple[float, float] = (50.0, 50.0)) -> Judged:
    """A sample's detections and truths as they are scored."""
    sample, middle = each.sample, each.middle

    def in_area(boxes: np.ndarray) -> np.ndarray:
        return np.asarray((np.abs(boxes[:, :2] - middle) <= half).all(axis=1))

    boxes = sample.objects.boxes
    points = count_points(sample.points(), boxes)
    counted = in_area(boxes) & sample.complete.covers(boxes) & (points >= LEAST_POINTS) & ~repeated(sample.objects)
    found = each.detections[in_area(each.detections.boxes) & sample.complete.covers(each.detections.boxes)]
    ranges = np.linalg.norm(boxes[:, :2] - middle, axis=1)
    return Judged(found, sample.objects, counted, points, ranges, _ranges(found, boxes, ranges, middle))


def repeated(objects: Objects) -> Bool[np.ndarray, " n"]:
    """Which labels are of an object that an earlier one is of.

    >>> car = [5, 0, 0.75, 4, 2, 1.5, 0]
    >>> repeated(Objects(np.array([car, [5.01, *car[1:]], [5, 3, *car[2:]]]))).tolist()
    [False, True, False]
    """
    same = (iou_3d(objects.boxes, objects.boxes) >= TWICE) & (objects.labels[:, None] == objects.labels)
    return np.asarray(np.tril(same, -1).any(axis=1))


def _ranges(found: Detections, boxes: np.ndarray, ranges: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Range of each detection: of the object it overlaps most, else its own."""
    own = np.linalg.norm(found.boxes[:, :2] - middle, axis=1)
    if not len(found) or not len(boxes):
        return own
    overlap = iou_bev(found.boxes, boxes)
    return np.where(overlap.max(axis=1) > 0.1, ranges[overlap.argmax(axis=1)], own)


def _class_rows(samples: Sequence[Judged], label: str, ious: Sequence[float]) -> Iterable[SampleRow]:
    middle = sorted(ious)[len(ious) // 2]
    everything = list(samples)
    for metric in METRICS:
        yield from _ours(everything, label, ious, metric, "all")
    for low, high in pairwise(RANGES):
        chosen = [_within(each, low, high) for each in samples]
        for metric in METRICS:
            yield from _ours(chosen, label, [middle], metric, _span(low, high, " m"))
    for low, high in pairwise(POINTS):
        chosen = [_with(each, (each.points >= low) & (each.points < high)) for each in samples]
        for metric in METRICS:
            yield from _ours(chosen, label, [middle], metric, _span(low, high - 1, " points"))
    iou = KITTI_IOU[label]
    for metric in METRICS:
        at = _evaluated(everything, label, [iou], metric)[iou]
        yield SampleRow(label, "KITTI R40", _named(metric, iou), "all", kitti_ap(at.curve), at.truths)
    yield from _nuscenes(everything, label)


def _ours(
    samples: Sequence[Judged], label: str, ious: Sequence[float], metric: Overlap, among: str
) -> Iterable[SampleRow]:
    for iou, at in _evaluated(samples, label, ious, metric).items():
        yield SampleRow(label, "ours", _named(metric, iou), among, at.ap, at.truths)


def _evaluated(samples: Sequence[Judged], label: str, ious: Sequence[float], metric: Overlap) -> dict[float, Any]:
    return evaluate(
        [each.found for each in samples],
        [each.truths for each in samples],
        counted=[each.counted for each in samples],
        iou_thresholds=ious,
        metric=metric,
        label=label,
    )


def _nuscenes(samples: Sequence[Judged], label: str) -> Iterable[SampleRow]:
    found, truths, counted = ([getattr(each, name) for each in samples] for name in ("found", "truths", "counted"))
    aps, total = [], 0
    for distance in CENTRE_DISTANCES:
        matched = by_centre(found, truths, counted, distance, label_index(label))
        aps.append(nuscenes_ap(matched.curve) if matched.truths else float("nan"))
        total = matched.truths
        yield SampleRow(label, "nuScenes", f"centre {distance:g} m", "all", aps[-1], total)
    yield SampleRow(label, "nuScenes", "centre, mean", "all", mean_of(aps), total)


def _within(each: Judged, low: float, high: float) -> Judged:
    chosen = _with(each, (each.truth_range >= low) & (each.truth_range < high))
    near = (each.found_range >= low) & (each.found_range < high)
    return replace(chosen, found=each.found[near], found_range=each.found_range[near])


def _with(each: Judged, which: np.ndarray) -> Judged:
    return replace(each, counted=each.counted & which)


def _named(metric: Overlap, iou: float) -> str:
    return f"{'BEV' if metric == 'bev' else '3D'} {iou:g}"


def _span(low: float, high: float, unit: str) -> str:
    return f"{low:g}-{high:g}{unit}" if np.isfinite(high) else f"{low:g} and more{unit}"


def format_rows(rows: Sequence[SampleRow]) -> str:
    """Rows as tables, one per class and protocol: a line for each group of objects, a column for each measure."""
    tables = []
    for label in LABELS:
        for protocol in dict.fromkeys(row.protocol for row in rows if row.label == label):
            some = [row for row in rows if (row.label, row.protocol) == (label, protocol)]
            tables.append(f"{label}, {protocol}\n{_table(some)}")
    return "\n\n".join(tables)


def _table(rows: Sequence[SampleRow]) -> str:
    measures, groups = (list(dict.fromkeys(getattr(row, name) for row in rows)) for name in ("measure", "among"))
    cells = {(row.among, row.measure): row for row in rows}
    lines = [["objects", "to find", *measures]]
    for among in groups:
        own = [cells.get((among, measure)) for measure in measures]
        truths = next(row.truths for row in own if row is not None)
        lines.append([among, str(truths), *("" if row is None else _figure(row.ap) for row in own)])
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    sides = [str.ljust] + [str.rjust] * (len(widths) - 1)
    return "\n".join(
        "  ".join(side(cell, width) for side, cell, width in zip(sides, line, widths, strict=True)) for line in lines
    )


def _figure(ap: float) -> str:
    return "-" if np.isnan(ap) else f"{ap:.3f}"
