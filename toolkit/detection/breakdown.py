"""Average precision by groups of objects, and as KITTI and nuScenes count it.

KITTI (2019 on): AP is the mean, over the recalls 1/40, 2/40, ... 1, of the best precision at that
recall or above. IoU is 0.7 for cars, 0.5 for pedestrians and cyclists. Its levels of difficulty
need heights in an image and are not used here.

nuScenes: a detection is true if its centre is nearer than a threshold, on the ground plane, to a
truth of its frame that no surer detection took. Sizes do not matter. The thresholds are 0.5, 1, 2
and 4 m. AP is the area of the curve above precision 0.1 and beyond recall 0.1, taken at 101 recalls
and divided by 0.9. The figure is the mean over the four thresholds."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float64, Int64, Mask
from toolkit.boxes import Overlap, count_points, iou_3d, iou_bev
from toolkit.detection.metrics import Curve, evaluate, greedy, precision_recall
from toolkit.display import format_share
from toolkit.frame import Frame, Region
from toolkit.objects import LABELS, Detections, Objects, label_index
from toolkit.points import has_centre_inside
from toolkit.runtime.text_tables import align_columns

KITTI_IOU = {"vehicle": 0.7, "heavy": 0.7, "cyclist": 0.5, "pedestrian": 0.5}
KITTI_RECALLS = 40
CENTRE_DISTANCES = (0.5, 1.0, 2.0, 4.0)  # m
LEAST_RECALL = LEAST_PRECISION = 0.1
LEAST_POINTS = 1
TWICE = 0.9  # least 3D IoU of two labels of one object; no two bodies overlap that much
RANGES = (0.0, 20.0, 35.0, 50.0, float("inf"))  # m
POINTS = (1.0, 5.0, 20.0, 100.0, float("inf"))
_LARGE = (0.3, 0.5, 0.7)
_SMALL = (0.1, 0.25, 0.5)
IOUS = {"vehicle": _LARGE, "heavy": _LARGE, "cyclist": _SMALL, "pedestrian": _SMALL}
METRICS: dict[Overlap, str] = {"bev": "BEV", "3d": "3D"}


class Matched(NamedTuple):
    """Scores and hits of a class, and number of truths."""

    scores: np.ndarray
    hits: np.ndarray
    truths: int


def kitti_ap(curve: Curve) -> float:
    """AP at 40 recalls, NaN without a truth to find."""
    if len(curve.recall) and np.isnan(curve.recall).all():
        return float("nan")
    recalls = np.arange(1, KITTI_RECALLS + 1) / KITTI_RECALLS
    best = [curve.precision[curve.recall >= recall - 1e-12].max(initial=0.0) for recall in recalls]
    return float(np.mean(best))


def nuscenes_ap(curve: Curve) -> float:
    """Area above the least precision and beyond the least recall, 1 for a perfect detector."""
    if not len(curve.recall):
        return 0.0
    if np.isnan(curve.recall).all():
        return float("nan")
    precision = np.interp(np.linspace(0, 1, 101), curve.recall, curve.precision, right=0.0)
    beyond = precision[round(100 * LEAST_RECALL) + 1 :]
    return float(np.clip(beyond - LEAST_PRECISION, 0, None).mean() / (1 - LEAST_PRECISION))


def by_centre(frames: "Iterable[Judged]", within: float, label: int) -> Matched:
    """Match detections of a class by centres `within` metres on the ground.

    Detections on uncounted objects, and those outside the area that hit nothing, do not count."""
    scores = [np.zeros(0)]
    hits = [np.zeros(0, bool)]
    total = 0
    for frame in frames:
        of_label = np.flatnonzero(frame.found.labels == label)
        best_first = of_label[np.argsort(-frame.found.scores[of_label], kind="stable")]
        detections = frame.found[best_first]
        truths = frame.truths.labels == label
        sought = np.asarray(frame.counted)[truths]
        offsets = detections.boxes[:, None, :2] - frame.truths.boxes[truths, :2]
        distances = np.linalg.norm(offsets, axis=2)
        near = distances < within
        hit = greedy(np.where(near & sought, np.exp(-distances), 0.0), np.exp(-within)) >= 0
        excused = (near & ~sought).any(axis=1) | frame.outside[best_first]
        ignored = excused & ~hit
        scores.append(detections.scores[~ignored])
        hits.append(hit[~ignored])
        total += int(sought.sum())
    return Matched(np.concatenate(scores), np.concatenate(hits), total)


@dataclass(frozen=True)
class GroupRow:
    """AP of one class among some objects under one protocol. measure: rule by which detections are
        true, such as BEV
    0.5; among: the objects; truths: number of them; scheme: how the sensors fused."""

    label: str
    protocol: str
    measure: str
    among: str
    ap: float
    truths: int
    scheme: str = "all clouds"


@dataclass(frozen=True, eq=False)
class FrameTruth:
    """Objects of one frame, and those that count.

    objects: all that are there; counted: mask of those to be found; points: on each of them;
    corners: of the detection area (xmin ymin xmax ymax, m, world); complete: where labels are, None
    where they are anywhere."""

    objects: Objects
    counted: Mask
    points: Int64[np.ndarray, " n"]
    corners: Float64[np.ndarray, "4"]
    complete: Region | None = None

    def inside(self, found: Detections) -> Bool[np.ndarray, " m"]:
        """Mask of detections in the area, where labels are complete."""
        if self.complete is None:
            return np.ones(len(found), np.bool_)
        return np.asarray(
            has_centre_inside(found.boxes, self.corners) & self.complete.covers(found.boxes)
        )

    def judge(self, found: Detections) -> "Judged":
        """Return detections and truths with their ranges from the middle of the area.

        A detection that overlaps an object has the range of the one it overlaps most. Detections
        outside the area that overlap no object to be found are left out."""
        boxes = self.objects.boxes
        outside = ~self.inside(found)
        touching = (iou_bev(found.boxes, boxes[self.counted]) > 0).any(axis=1)
        kept = ~outside | touching
        found = found[kept]
        outside = outside[kept]
        middle = (self.corners[:2] + self.corners[2:]) / 2
        away, own = (np.linalg.norm(rows[:, :2] - middle, axis=1) for rows in (boxes, found.boxes))
        if len(found) and len(boxes):
            overlap = iou_bev(found.boxes, boxes)
            own = np.where(overlap.max(axis=1) > 0.1, away[overlap.argmax(axis=1)], own)
        return Judged(found, self.objects, self.counted, self.points, away, own, outside)


@dataclass(frozen=True, eq=False)
class Judged:
    """Detections and objects of one frame, ready to be matched.

    Attributes:
        found: n detections, in the area or overlapping an object to be found.
        truths: m objects.
        counted: mask (m,) of the objects to be found.
        points: number of points (m,) on each object.
        truth_range: range (m,) of each object from the middle of the area (m).
        found_range: range (n,) of each detection, as in `FrameTruth.judge` (m).
        outside: mask (n,) of detections outside the area, which can be hits but not false alarms.
    """

    found: Detections
    truths: Objects
    counted: np.ndarray
    points: np.ndarray
    truth_range: np.ndarray
    found_range: np.ndarray
    outside: np.ndarray


def select_truth(frame: Frame, corners: Float64[np.ndarray, "4"]) -> FrameTruth:
    """Return the objects that count for recorded labels: in the area, where labels are complete,
    with a point on them. Other labelled objects are not misses, and a detection on one is not a
    false alarm."""
    boxes = frame.objects.boxes
    points = count_points(frame.points(), boxes)
    counted = (
        has_centre_inside(boxes, corners) & frame.complete.covers(boxes) & (points >= LEAST_POINTS)
    )
    return FrameTruth(
        frame.objects, counted & ~repeated(frame.objects), points, corners, frame.complete
    )


def repeated(objects: Objects) -> Mask:
    """Mark labels of an object that is labelled already."""
    same = (iou_3d(objects.boxes, objects.boxes) >= TWICE) & (
        objects.labels[:, None] == objects.labels
    )
    return np.asarray(np.tril(same, -1).any(axis=1))


def group_rows(
    samples: Sequence[Judged], label: str, ious: Sequence[float] | None = None
) -> list[GroupRow]:
    """Return all rows of a class. ious: None for usual."""
    ious = ious or IOUS[label]
    middle = sorted(ious)[len(ious) // 2]
    rows = list[GroupRow]()

    def score(
        frames: Sequence[Judged], thresholds: Sequence[float], among: str, protocol: str = "ours"
    ) -> None:
        detections = [frame.found for frame in frames]
        truths = [frame.truths for frame in frames]
        counted = [frame.counted for frame in frames]
        outside = [frame.outside for frame in frames]
        evaluate_frames = partial(
            evaluate, detections, truths, counted=counted, outside=outside, label=label
        )
        for metric, said in METRICS.items():
            scores = evaluate_frames(iou_thresholds=thresholds, metric=metric)
            for iou, at in scores.items():
                ap = at.ap if protocol == "ours" or not at.truths else kitti_ap(at.curve)
                rows.append(GroupRow(label, protocol, f"{said} {iou:g}", among, ap, at.truths))

    score(samples, ious, "all")
    for low, high in pairwise(RANGES):
        chosen = []
        for each in samples:
            near = (each.found_range >= low) & (each.found_range < high)
            counted = each.counted & (each.truth_range >= low) & (each.truth_range < high)
            in_ring = replace(each, found=each.found[near], found_range=each.found_range[near])
            chosen.append(replace(in_ring, outside=each.outside[near], counted=counted))
        score(chosen, [middle], _span(low, high, " m"))
    for low, high in pairwise(POINTS):
        among = [
            replace(s, counted=s.counted & (s.points >= low) & (s.points < high)) for s in samples
        ]
        score(among, [middle], _span(low, high - 1, " points"))
    score(samples, [KITTI_IOU[label]], "all", "KITTI R40")
    aps = []
    for distance in CENTRE_DISTANCES:
        matched = by_centre(samples, distance, label_index(label))
        aps.append(nuscenes_ap(precision_recall(*matched)) if matched.truths else float("nan"))
        rows.append(
            GroupRow(label, "nuScenes", f"centre {distance:g} m", "all", aps[-1], matched.truths)
        )
    return [
        *rows,
        GroupRow(label, "nuScenes", "centre, mean", "all", float(np.mean(aps)), matched.truths),
    ]


def _span(low: float, high: float, unit: str) -> str:
    return f"{low:g}-{high:g}{unit}" if np.isfinite(high) else f"{low:g} and more{unit}"


def format_rows(rows: Sequence[GroupRow]) -> str:
    """Format rows as tables, one per class and protocol."""
    tables = []
    kinds = dict.fromkeys((r.label, r.protocol) for r in rows)
    for label, protocol in sorted(kinds, key=lambda kind: LABELS.index(kind[0])):
        cells = {
            (r.among, r.measure): r for r in rows if (r.label, r.protocol) == (label, protocol)
        }
        measures = list(dict.fromkeys(measure for _, measure in cells))
        lines = [["objects", "to find", *measures]]
        for among in dict.fromkeys(among for among, _ in cells):
            own = [cells.get((among, measure)) for measure in measures]
            truths = next(row.truths for row in own if row is not None)
            aps = [
                "" if row is None else "-" if np.isnan(row.ap) else format_share(row.ap, row.truths)
                for row in own
            ]
            lines.append([among, str(truths), *aps])
        tables.append(f"{label}, {protocol}\n{align_columns(lines, texts=1)}")
    return "\n\n".join(tables)
