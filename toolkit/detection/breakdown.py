"""Average precision as KITTI and nuScenes count it.

It is reported beside ours (`toolkit.detection.metrics`).

KITTI (2019 on): AP is the mean, over the recalls 1/40, 2/40, ... 1, of the best precision at that recall or above. IoU
is 0.7 for cars, 0.5 for pedestrians and cyclists. Its levels of difficulty need heights in an image and are not used
here.

nuScenes: a detection is true if its centre is nearer than a threshold, on the ground plane, to a truth of its frame
that no surer detection took. Sizes do not matter. The thresholds are 0.5, 1, 2 and 4 m. AP is the area of the curve
above precision 0.1 and beyond recall 0.1, taken at 101 recalls and divided by 0.9. The figure is the mean over the four
thresholds.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float64, Int64
from toolkit.boxes import Overlap, count_points, iou_3d, iou_bev
from toolkit.detection.metrics import Curve, evaluate, precision_recall
from toolkit.frame import Frame, Region
from toolkit.objects import LABELS, Detections, Objects, label_index
from toolkit.points import has_centre_inside

KITTI_IOU = {"vehicle": 0.7, "heavy": 0.7, "cyclist": 0.5, "pedestrian": 0.5}
KITTI_RECALLS = 40
CENTRE_DISTANCES = (0.5, 1.0, 2.0, 4.0)  # m
LEAST_RECALL = LEAST_PRECISION = 0.1


class Matched(NamedTuple):
    """Pooled detections of a class.

    Their scores, whether each hit (detections that do not count are left out), and the number of truths to find.
    """

    scores: np.ndarray
    hits: np.ndarray
    truths: int

    @property
    def curve(self) -> Curve:
        """Precision and recall."""
        return precision_recall(self.scores, self.hits, self.truths)


def kitti_ap(curve: Curve) -> float:
    """AP at 40 recalls.

    NaN where nothing is to be found.

    >>> kitti_ap(precision_recall(np.array([0.9, 0.8]), np.array([True, False]), truths=2))
    0.5
    """
    if len(curve.recall) and np.isnan(curve.recall).all():
        return float("nan")
    recalls = np.arange(1, KITTI_RECALLS + 1) / KITTI_RECALLS
    best = [curve.precision[curve.recall >= recall - 1e-12].max(initial=0.0) for recall in recalls]
    return float(np.mean(best))


def nuscenes_ap(curve: Curve) -> float:
    """Area above the least precision and beyond the least recall.

    It is 1 for a perfect detector.

    >>> round(nuscenes_ap(precision_recall(np.array([0.9]), np.array([True]), truths=1)), 9)
    1.0
    """
    if not len(curve.recall):
        return 0.0
    if np.isnan(curve.recall).all():
        return float("nan")
    recalls = np.linspace(0, 1, 101)
    precision = np.interp(recalls, curve.recall, curve.precision, right=0.0)
    beyond = precision[round(100 * LEAST_RECALL) + 1 :]
    return float(np.clip(beyond - LEAST_PRECISION, 0, None).mean() / (1 - LEAST_PRECISION))


def by_centre(
    detections: Iterable[Detections],
    truths: Iterable[Objects],
    counted: Iterable[Bool[np.ndarray, " m"]],
    distance: float,
    label: int,
) -> Matched:
    """Match detections of a class by distance of centres.

    Distances (m) to truths are measured on the ground. A detection that hits only uncounted objects does not count.
    """
    scores, hits, total = [np.zeros(0)], [np.zeros(0, bool)], 0
    for found, there, mask in zip(detections, truths, counted, strict=True):
        found, rows = found[found.labels == label], there.labels == label
        hit, ignored = _nearest(found, there.boxes[rows], np.asarray(mask)[rows], distance)
        scores.append(found.scores[~ignored])
        hits.append(hit[~ignored])
        total += int(np.asarray(mask)[rows].sum())
    return Matched(np.concatenate(scores), np.concatenate(hits), total)


def _nearest(
    found: Detections, boxes: np.ndarray, counted: np.ndarray, distance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Mark detections that take a counted truth. Also mark those that take none but lie on an uncounted one."""
    hit, ignored = np.zeros(len(found), bool), np.zeros(len(found), bool)
    away = np.linalg.norm(found.boxes[:, None, :2] - boxes[None, :, :2], axis=2)
    free = np.where(counted, away, np.inf)
    for row in np.argsort(-found.scores, kind="stable"):
        nearest = int(free[row].argmin()) if len(boxes) else -1
        if nearest >= 0 and free[row, nearest] < distance:
            hit[row] = True
            free[:, nearest] = np.inf
        else:
            ignored[row] = bool((away[row, ~counted] < distance).any())
    return hit, ignored


def compute_mean(values: Sequence[float]) -> float:
    """Mean; NaN of none."""
    return float(np.mean(values)) if len(values) else float("nan")


LEAST_POINTS = 1
TWICE = 0.9  # least 3D IoU of two labels of one object; no two bodies overlap that much
RANGES = (0.0, 20.0, 35.0, 50.0, float("inf"))  # m
POINTS = (1.0, 5.0, 20.0, 100.0, float("inf"))
_LARGE, _SMALL = (0.3, 0.5, 0.7), (0.1, 0.25, 0.5)
IOUS = {"vehicle": _LARGE, "heavy": _LARGE, "cyclist": _SMALL, "pedestrian": _SMALL}
METRICS: tuple[Overlap, ...] = ("bev", "3d")


@dataclass(frozen=True)
class GroupRow:
    """AP of one class among some objects under one protocol.

    measure: rule by which detections are true, such as BEV 0.5; among: the objects; truths: number of them; scheme:
    how the sensors fused.
    """

    label: str
    protocol: str
    measure: str
    among: str
    ap: float
    truths: int
    scheme: str = "all clouds"

    def as_dict(self) -> dict[str, Any]:
        """Return the row for JSON."""
        return dict(vars(self))


@dataclass(frozen=True, eq=False)
class FrameTruth:
    """Objects of one frame, and those that count.

    objects: all that are there; counted: mask of those to be found; points: on each of them; corners: of the detection
    area (xmin ymin xmax ymax, m, world); middle: of the area; complete: where labels are, None where they are anywhere.
    """

    objects: Objects
    counted: Bool[np.ndarray, " n"]
    points: Int64[np.ndarray, " n"]
    corners: Float64[np.ndarray, "4"]
    middle: Float64[np.ndarray, "2"]
    complete: Region | None = None

    def keep(self, found: Detections) -> Detections:
        """Return the detections that count.

        Where labels may be incomplete, these are the ones in the area and where labels are complete.
        """
        if self.complete is None:
            return found
        return found[has_centre_inside(found.boxes, self.corners) & self.complete.covers(found.boxes)]

    def judge(self, found: Detections) -> Judged:
        """Return detections and truths with their ranges. Ranges are measured from the middle of the area."""
        boxes, found = self.objects.boxes, self.keep(found)
        ranges = np.linalg.norm(boxes[:, :2] - self.middle, axis=1)
        return Judged(
            found, self.objects, self.counted, self.points, ranges, _ranges(found, boxes, ranges, self.middle)
        )


@dataclass(frozen=True, eq=False)
class Judged:
    """One frame to be scored.

    Detections that count, objects, mask of the objects that count, points on them, and ranges (m).
    """

    found: Detections
    truths: Objects
    counted: np.ndarray
    points: np.ndarray
    truth_range: np.ndarray
    found_range: np.ndarray


def select_truth(frame: Frame, corners: Float64[np.ndarray, "4"]) -> FrameTruth:
    """Return the objects that count for recorded labels.

    They lie in the area, where labels are complete, and have a point on them. Other labelled objects are not misses,
    and a detection on one is not a false alarm.
    """
    boxes = frame.objects.boxes
    points = count_points(frame.points(), boxes)
    counted = has_centre_inside(boxes, corners) & frame.complete.covers(boxes) & (points >= LEAST_POINTS)
    middle = (corners[:2] + corners[2:]) / 2
    return FrameTruth(frame.objects, counted & ~repeated(frame.objects), points, corners, middle, frame.complete)


def group_rows(samples: Sequence[Judged], label: str, ious: Sequence[float] | None = None) -> list[GroupRow]:
    """Return all rows of a class.

    A class without an object to find has rows too. ious: None for the usual ones of the class.
    """
    return list(_class_rows(samples, label, ious or IOUS[label]))


def repeated(objects: Objects) -> Bool[np.ndarray, " n"]:
    """Mark labels of an object that is labelled already.

    >>> car = [5, 0, 0.75, 4, 2, 1.5, 0]
    >>> repeated(Objects(np.array([car, [5.01, *car[1:]], [5, 3, *car[2:]]]))).tolist()
    [False, True, False]
    """
    same = (iou_3d(objects.boxes, objects.boxes) >= TWICE) & (objects.labels[:, None] == objects.labels)
    return np.asarray(np.tril(same, -1).any(axis=1))


def _ranges(found: Detections, boxes: np.ndarray, ranges: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Range of each detection. It is that of the object it overlaps most, else its own."""
    own = np.linalg.norm(found.boxes[:, :2] - middle, axis=1)
    if not len(found) or not len(boxes):
        return own
    overlap = iou_bev(found.boxes, boxes)
    return np.where(overlap.max(axis=1) > 0.1, ranges[overlap.argmax(axis=1)], own)


def _class_rows(samples: Sequence[Judged], label: str, ious: Sequence[float]) -> Iterable[GroupRow]:
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
        yield GroupRow(label, "KITTI R40", _named(metric, iou), "all", kitti_ap(at.curve), at.truths)
    yield from _nuscenes(everything, label)


def _ours(
    samples: Sequence[Judged], label: str, ious: Sequence[float], metric: Overlap, among: str
) -> Iterable[GroupRow]:
    for iou, at in _evaluated(samples, label, ious, metric).items():
        yield GroupRow(label, "ours", _named(metric, iou), among, at.ap, at.truths)


def _evaluated(samples: Sequence[Judged], label: str, ious: Sequence[float], metric: Overlap) -> dict[float, Any]:
    return evaluate(
        [each.found for each in samples],
        [each.truths for each in samples],
        counted=[each.counted for each in samples],
        iou_thresholds=ious,
        metric=metric,
        label=label,
    )


def _nuscenes(samples: Sequence[Judged], label: str) -> Iterable[GroupRow]:
    found, truths, counted = ([getattr(each, name) for each in samples] for name in ("found", "truths", "counted"))
    aps, total = [], 0
    for distance in CENTRE_DISTANCES:
        matched = by_centre(found, truths, counted, distance, label_index(label))
        aps.append(nuscenes_ap(matched.curve) if matched.truths else float("nan"))
        total = matched.truths
        yield GroupRow(label, "nuScenes", f"centre {distance:g} m", "all", aps[-1], total)
    yield GroupRow(label, "nuScenes", "centre, mean", "all", compute_mean(aps), total)


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


def format_rows(rows: Sequence[GroupRow]) -> str:
    """Format rows as tables, one per class and protocol. Each group of objects has a line, each measure a column."""
    tables = []
    for label in LABELS:
        for protocol in dict.fromkeys(row.protocol for row in rows if row.label == label):
            some = [row for row in rows if (row.label, row.protocol) == (label, protocol)]
            tables.append(f"{label}, {protocol}\n{_table(some)}")
    return "\n\n".join(tables)


def _table(rows: Sequence[GroupRow]) -> str:
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
