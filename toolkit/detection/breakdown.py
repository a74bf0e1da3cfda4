"""Average precision by groups of objects, and as KITTI and nuScenes count it.

KITTI (since 2019): AP is the mean, over the recalls 1/40, 2/40, ... 1, of the best precision at
that recall or above. The IoU threshold is 0.7 for cars, 0.5 for pedestrians and cyclists. KITTI's
levels of difficulty need heights in an image and are not used here.

nuScenes: a detection is true if its centre is within a threshold, on the ground plane, of a truth
of its frame that no surer detection took. Sizes do not matter. The thresholds are 0.5, 1, 2 and
4 m. AP is the area of the curve above precision 0.1 and beyond recall 0.1, sampled at 101 recalls
and divided by 0.9. The result is the mean over the four thresholds."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
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

# IoU from which a detection is true, by class
KITTI_IOU = {"vehicle": 0.7, "heavy": 0.7, "cyclist": 0.5, "pedestrian": 0.5}
KITTI_RECALLS = 40
CENTRE_DISTANCES_M = (0.5, 1.0, 2.0, 4.0)  # thresholds of nuScenes
MIN_RECALL = 0.1  # nuScenes
MIN_PRECISION = 0.1  # nuScenes
MIN_TRUTH_POINTS = 1  # on an object that counts
MIN_REPEATED_IOU = 0.9  # 3D, of two labels of one object; no two bodies overlap that much
MIN_RANGE_IOU = 0.1  # BEV, above which a detection takes the range of the object that it overlaps
RANGE_EDGES_M = (0.0, 20.0, 35.0, 50.0, float("inf"))  # from the middle of the area
POINT_EDGES = (1.0, 5.0, 20.0, 100.0, float("inf"))  # points on an object
# usual IoU thresholds of a breakdown, by class; the middle one is used for groups
_LARGE_IOUS = (0.3, 0.5, 0.7)
_SMALL_IOUS = (0.1, 0.25, 0.5)
BREAKDOWN_IOUS = {
    "vehicle": _LARGE_IOUS,
    "heavy": _LARGE_IOUS,
    "cyclist": _SMALL_IOUS,
    "pedestrian": _SMALL_IOUS,
}
METRIC_NAMES: dict[Overlap, str] = {"bev": "BEV", "3d": "3D"}


class Matched(NamedTuple):
    """Detections of a class in all frames, matched with the truth.

    scores: score of each detection that counts; hits: mask of the true ones among them; truths:
    number of objects to find."""

    scores: np.ndarray
    hits: np.ndarray
    truths: int


def kitti_ap(curve: Curve) -> float:
    """Average precision at KITTI's 40 recalls, NaN if there is no truth to find.

    curve: precision and recall of a class in all frames."""
    if len(curve.recall) and np.isnan(curve.recall).all():
        return float("nan")
    recalls = np.arange(1, KITTI_RECALLS + 1) / KITTI_RECALLS
    best_precisions = []
    for recall in recalls:
        # 1e-12: a recall that equals one of the 40 but for rounding counts as reached
        is_reached = curve.recall >= recall - 1e-12
        best_precisions.append(curve.precision[is_reached].max(initial=0.0))
    return float(np.mean(best_precisions))


def nuscenes_ap(curve: Curve) -> float:
    """Average precision of nuScenes: area above the minimum precision, beyond the minimum recall.

    curve: precision and recall of a class at one distance. The area is scaled to 1 for a perfect
    detector; it is 0 without detections and NaN without a truth to find."""
    if not len(curve.recall):
        return 0.0
    if np.isnan(curve.recall).all():
        return float("nan")
    # precision at recalls 0, 0.01, ... 1; recalls that are never reached have 0
    precision = np.interp(np.linspace(0, 1, 101), curve.recall, curve.precision, right=0.0)
    # only recalls 0.11, 0.12, ... 1 count
    counted_precision = precision[round(100 * MIN_RECALL) + 1 :]
    excess = np.clip(counted_precision - MIN_PRECISION, 0, None)
    return float(excess.mean() / (1 - MIN_PRECISION))


def by_centre(frames: "Iterable[Judged]", max_distance: float, label: int) -> Matched:
    """Match detections and truths of a class whose centres are near each other on the ground.

    frames: detections and objects of each frame; max_distance: distance (m) below which a detection
    can be a hit; label: class number. The best score chooses first, and takes the nearest free
    truth.
    Detections on uncounted objects do not count, nor do detections outside the area that hit
    nothing. Returns scores and hits of the detections that count in all frames, and the number of
    objects to find."""
    scores = [np.zeros(0)]
    hits = [np.zeros(0, bool)]
    truth_count = 0
    for frame in frames:
        label_rows = np.flatnonzero(frame.detections.labels == label)
        best_first = label_rows[np.argsort(-frame.detections.scores[label_rows], kind="stable")]
        detections = frame.detections[best_first]
        has_label = frame.truths.labels == label
        is_counted = np.asarray(frame.counted)[has_label]
        # x and y from each truth to each detection, (detections, truths, 2)
        offsets = detections.boxes[:, None, :2] - frame.truths.boxes[has_label, :2]
        distances = np.linalg.norm(offsets, axis=2)
        is_near = distances < max_distance
        # exp(-distance) falls with the distance, so greedy matching by overlap finds the nearest
        closeness = np.where(is_near & is_counted, np.exp(-distances), 0.0)
        is_hit = greedy(closeness, threshold=np.exp(-max_distance)) >= 0
        # no false alarm: near an object that does not count, or outside the area
        is_excused = (is_near & ~is_counted).any(axis=1) | frame.outside[best_first]
        is_ignored = is_excused & ~is_hit
        scores.append(detections.scores[~is_ignored])
        hits.append(is_hit[~is_ignored])
        truth_count += int(is_counted.sum())
    return Matched(np.concatenate(scores), np.concatenate(hits), truth_count)


@dataclass(frozen=True)
class GroupRow:
    """AP of one class over a group of objects, under one protocol.

    Attributes:
        label: name of the class.
        protocol: protocol that counts AP: "ours", "KITTI R40" or "nuScenes".
        measure: rule for a true detection, such as "BEV 0.5" or "centre 2 m".
        among: group of objects, such as "20-35 m", "5-19 points" or "all".
        ap: average precision (0 to 1), NaN without objects in the group.
        truths: number of objects to find in the group.
        scheme: name of the scheme, followed by its sensors if several sets are compared.
    """

    label: str
    protocol: str
    measure: str
    among: str
    ap: float
    truths: int
    scheme: str = "all clouds"


@dataclass(frozen=True, eq=False)
class FrameTruth:
    """Objects of one frame, with a mask of the objects that count.

    Attributes:
        objects: n labelled objects of the frame.
        counted: mask (n,) of the objects to find.
        point_counts: number of points on each object, 0 if they were not counted.
        corners: detection area (xmin, ymin, xmax, ymax, m, world frame).
        complete: region with complete labels, None if they are complete everywhere.
    """

    objects: Objects
    counted: Mask
    point_counts: Int64[np.ndarray, " n"]
    corners: Float64[np.ndarray, "4"]
    complete: Region | None = None

    def inside(self, detections: Detections) -> Bool[np.ndarray, " m"]:
        """Mask of detections that are in the area and in the region with complete labels.

        If labels are complete everywhere (`complete` is None), all detections count as inside."""
        if self.complete is None:
            return np.ones(len(detections), np.bool_)
        return np.asarray(
            has_centre_inside(detections.boxes, self.corners)
            & self.complete.covers(detections.boxes)
        )

    def judge(self, detections: Detections) -> "Judged":
        """Return detections and truths with their ranges: distances from the middle of the area.

        A detection that overlaps an object (BEV IoU above 0.1) has the range of the object that it
        overlaps most. Detections outside the area that overlap no object to find are left out."""
        boxes = self.objects.boxes
        is_outside = ~self.inside(detections)
        is_touching = (iou_bev(detections.boxes, boxes[self.counted]) > 0).any(axis=1)
        is_kept = ~is_outside | is_touching
        kept_detections = detections[is_kept]
        middle = (self.corners[:2] + self.corners[2:]) / 2  # mean of (xmin, ymin) and (xmax, ymax)
        object_ranges = np.linalg.norm(boxes[:, :2] - middle, axis=1)
        detection_ranges = np.linalg.norm(kept_detections.boxes[:, :2] - middle, axis=1)
        if len(kept_detections) and len(boxes):
            overlap = iou_bev(kept_detections.boxes, boxes)
            overlapped_ranges = object_ranges[overlap.argmax(axis=1)]
            is_on_object = overlap.max(axis=1) > MIN_RANGE_IOU
            detection_ranges = np.where(is_on_object, overlapped_ranges, detection_ranges)
        return Judged(
            detections=kept_detections,
            truths=self.objects,
            counted=self.counted,
            point_counts=self.point_counts,
            truth_range=object_ranges,
            detection_range=detection_ranges,
            outside=is_outside[is_kept],
        )


@dataclass(frozen=True, eq=False)
class Judged:
    """Detections and objects of one frame, ready to match.

    Attributes:
        detections: n detections, in the area or overlapping an object to find.
        truths: m objects.
        counted: mask (m,) of the objects to find.
        point_counts: number of points (m,) on each object.
        truth_range: distance (m,) of each object from the middle of the area, in metres.
        detection_range: distance (n,) of each detection from the middle of the area, or the
            distance of the object that it overlaps most, in metres.
        outside: mask (n,) of detections outside the area, which can be hits but not false alarms.
    """

    detections: Detections
    truths: Objects
    counted: np.ndarray
    point_counts: np.ndarray
    truth_range: np.ndarray
    detection_range: np.ndarray
    outside: np.ndarray


def select_truth(frame: Frame, corners: Float64[np.ndarray, "4"]) -> FrameTruth:
    """Return the objects of a frame, and mark those to find by the rule for recorded labels.

    corners: detection area (xmin, ymin, xmax, ymax, m, world frame). Objects to find are in the
    area, in the region with complete labels, have a point on them, and are not a second label of an
    object. Other labelled objects are not misses, and a detection on one is not a false alarm."""
    boxes = frame.objects.boxes
    point_counts = count_points(frame.points(), boxes)
    is_in_area = has_centre_inside(boxes, corners) & frame.complete.covers(boxes)
    is_counted = is_in_area & (point_counts >= MIN_TRUTH_POINTS) & ~mark_repeated(frame.objects)
    return FrameTruth(
        frame.objects,
        counted=is_counted,
        point_counts=point_counts,
        corners=corners,
        complete=frame.complete,
    )


def mark_repeated(objects: Objects) -> Mask:
    """Mark objects that repeat an earlier row: same class, and a 3D IoU of at least 0.9."""
    # (n, n) mask; its lower triangle compares each object with earlier rows only
    is_same = (iou_3d(objects.boxes, objects.boxes) >= MIN_REPEATED_IOU) & (
        objects.labels[:, None] == objects.labels
    )
    return np.asarray(np.tril(is_same, -1).any(axis=1))


def group_rows(
    samples: Sequence[Judged], label: str, ious: Sequence[float] | None = None
) -> list[GroupRow]:
    """Return the rows of a class: all objects, groups by range and by points, other protocols.

    samples: detections and objects of each frame; label: name of the class; ious: IoU thresholds,
    None for the usual ones (`BREAKDOWN_IOUS`). Groups have rows at the middle threshold only."""
    ious = ious or BREAKDOWN_IOUS[label]
    middle_iou = sorted(ious)[len(ious) // 2]
    rows = _score_group(samples, label, ious, among="all")
    for low, high in pairwise(RANGE_EDGES_M):
        ring = [_restrict_range(sample, low, high) for sample in samples]
        rows += _score_group(ring, label, [middle_iou], among=_name_span(low, high, " m"))
    for low, high in pairwise(POINT_EDGES):
        group = [_restrict_points(sample, low, high) for sample in samples]
        # numbers of points below `high` end at `high - 1`
        among = _name_span(low, high - 1, " points")
        rows += _score_group(group, label, [middle_iou], among=among)
    rows += _score_group(samples, label, [KITTI_IOU[label]], among="all", protocol="KITTI R40")
    return rows + _score_centres(samples, label)


def _score_centres(samples: Sequence[Judged], label: str) -> list[GroupRow]:
    """Return the rows of nuScenes of a class: one for each centre distance, then their mean.

    samples: detections and objects of each frame; label: name of the class."""
    rows = []
    aps = []
    truth_count = 0
    for distance in CENTRE_DISTANCES_M:
        matched = by_centre(samples, distance, label_index(label))
        truth_count = matched.truths  # the same at every distance
        ap = float("nan")
        if truth_count:
            ap = nuscenes_ap(precision_recall(matched.scores, matched.hits, truths=truth_count))
        aps.append(ap)
        measure = f"centre {distance:g} m"
        rows.append(GroupRow(label, "nuScenes", measure, among="all", ap=ap, truths=truth_count))
    mean_ap = float(np.mean(aps))
    rows.append(
        GroupRow(label, "nuScenes", "centre, mean", among="all", ap=mean_ap, truths=truth_count)
    )
    return rows


def _score_group(
    frames: Sequence[Judged], label: str, ious: Sequence[float], among: str, protocol: str = "ours"
) -> list[GroupRow]:
    """Return the rows of a group of objects, at each IoU threshold for BEV and 3D IoU.

    frames: detections and objects of each frame, restricted to the group; label: name of the class;
    among: name of the group; protocol: "ours" for AP of `toolkit.detection.metrics`, else AP at
    KITTI's 40 recalls."""
    rows = []
    for metric, metric_name in METRIC_NAMES.items():
        scores = evaluate(
            [frame.detections for frame in frames],
            [frame.truths for frame in frames],
            iou_thresholds=ious,
            metric=metric,
            label=label,
            counted=[frame.counted for frame in frames],
            outside=[frame.outside for frame in frames],
        )
        for iou, score in scores.items():
            is_ours = protocol == "ours" or not score.truths  # without truths AP is NaN anyway
            ap = score.ap if is_ours else kitti_ap(score.curve)
            measure = f"{metric_name} {iou:g}"
            rows.append(GroupRow(label, protocol, measure, among=among, ap=ap, truths=score.truths))
    return rows


def _restrict_range(frame: Judged, low: float, high: float) -> Judged:
    """Return a frame with only the detections and counted objects in a ring around the middle.

    low, high: distances (m) from the middle of the area; low is included, high is not."""
    is_in_ring = (frame.detection_range >= low) & (frame.detection_range < high)
    is_truth_in_ring = (frame.truth_range >= low) & (frame.truth_range < high)
    return replace(
        frame,
        detections=frame.detections[is_in_ring],
        detection_range=frame.detection_range[is_in_ring],
        outside=frame.outside[is_in_ring],
        counted=frame.counted & is_truth_in_ring,
    )


def _restrict_points(frame: Judged, low: float, high: float) -> Judged:
    """Return a frame in which only objects with `low` points to below `high` count.

    All detections stay: on other objects they are neither hits nor false alarms."""
    is_in_group = (frame.point_counts >= low) & (frame.point_counts < high)
    return replace(frame, counted=frame.counted & is_in_group)


def _name_span(low: float, high: float, unit: str) -> str:
    """Name of a group of objects between two bounds, such as "0-20 m", "100 and more points"."""
    return f"{low:g}-{high:g}{unit}" if np.isfinite(high) else f"{low:g} and more{unit}"


def _format_ap(row: GroupRow | None) -> str:
    """Cell of a table: empty without a row, "-" for an undefined AP."""
    if row is None:
        return ""
    return "-" if np.isnan(row.ap) else format_share(row.ap, row.truths)


def format_rows(rows: Sequence[GroupRow]) -> str:
    """Format rows as tables, one for each class and protocol.

    A table has a line for each group of objects (`among`) and a column for each measure. Classes
    are in the order of `LABELS`."""
    tables = []
    # dict.fromkeys: without repetition, in the order of the rows
    table_keys = dict.fromkeys((row.label, row.protocol) for row in rows)
    for label, protocol in sorted(table_keys, key=lambda key: LABELS.index(key[0])):
        table_rows = [row for row in rows if (row.label, row.protocol) == (label, protocol)]
        # one for each cell
        row_by_cell = {(row.among, row.measure): row for row in table_rows}
        measures = list(dict.fromkeys(row.measure for row in table_rows))
        lines = [["objects", "to find", *measures]]
        for among in dict.fromkeys(row.among for row in table_rows):
            # None for a measure that was not applied to these objects
            line_rows = [row_by_cell.get((among, measure)) for measure in measures]
            truths = next(row.truths for row in line_rows if row is not None)
            aps = [_format_ap(row) for row in line_rows]
            lines.append([among, str(truths), *aps])
        tables.append(f"{label}, {protocol}\n{align_columns(lines, texts=1)}")
    return "\n\n".join(tables)
