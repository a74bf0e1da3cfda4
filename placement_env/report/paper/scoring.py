"""AP and its interval from stored detections: of a scheme and sensor set, in the whole area or in a shared region."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from placement_env.analysis.intervals import Interval, ap_interval
from placement_env.fidelity.detector import IGNORED, IOUS
from placement_env.report.paper.stored import SchemeRun, StoredDetections
from toolkit.arrays import Bool, Float64
from toolkit.detection.metrics import Curve, average_precision, precision_recall
from toolkit.geometry import invert, transform
from toolkit.sensors.sensor import Sensor


class Believed(NamedTuple):
    """Per frame: score of each detection that is not ignored, whether it hit, and how many vehicles were to be found;
    hit_iou: mean IoU of the hits' vehicles with the detection that overlaps them most."""

    scores: list[Float64[np.ndarray, " _"]]
    hits: list[Bool[np.ndarray, " _"]]
    to_find: list[int]
    hit_iou: float


class ApScore(NamedTuple):
    """At one IoU: AP, its interval, recall of all detections, vehicles to be found, mean IoU of the hits; NaN where
    undefined."""

    ap: float
    interval: Interval
    recall: float
    vehicles: int
    hit_iou: float


def in_view_of_all(sensors: list[Sensor], boxes: Float64[np.ndarray, "n 7"]) -> Bool[np.ndarray, " n"]:
    """Which boxes have their centre in the field of view of every sensor, whatever stands in between: the region of
    the paper's table 3."""
    views = [s.model.in_view(transform(invert(s.pose), boxes[:, :3])) for s in sensors]
    return np.logical_and.reduce([np.ones(len(boxes), bool), *views])


def believed(stored: StoredDetections, run: SchemeRun, iou: float = 0.7, region: tuple[int, ...] = ()) -> Believed:
    """What is scored of a run. region: of these sensors, () for the whole area: there a vehicle is to be found, a hit
    counts if it is one of these, and a false alarm if its centre lies there."""
    row, sensors = IOUS.index(iou), [stored.sensors[c] for c in region]
    scores, hits, to_find, ious = [], [], [], [np.zeros(0)]
    for truth, found in zip(stored.truths, stored.runs[run], strict=True):
        hit_of = found.truth[row]
        there = in_view_of_all(sensors, truth.boxes)
        alarm_there = in_view_of_all(sensors, found.boxes)
        hit = hit_of >= 0
        in_region = np.where(hit, np.append(there, False)[np.where(hit, hit_of, -1)], alarm_there)
        counts = in_region & (hit_of != IGNORED)
        scores.append(found.scores[counts])
        hits.append(hit[counts])
        to_find.append(int(there.sum()))
        ious.append(found.best[hit_of[counts & hit]])
    all_ious = np.concatenate(ious)
    return Believed(scores, hits, to_find, float(all_ious.mean()) if len(all_ious) else float("nan"))


def score_run(stored: StoredDetections, run: SchemeRun, iou: float = 0.7, region: tuple[int, ...] = ()) -> ApScore:
    """AP of a run, as `toolkit.detection.metrics.evaluate` gives it by the exact protocol."""
    what = believed(stored, run, iou, region)
    vehicles, hits = sum(what.to_find), sum(int(hit.sum()) for hit in what.hits)
    ap = average_precision(_curve(what)) if vehicles else float("nan")
    recall = hits / vehicles if vehicles else float("nan")
    return ApScore(ap, ap_interval(what.scores, what.hits, what.to_find), recall, vehicles, what.hit_iou)


def pr_curve(stored: StoredDetections, run: SchemeRun, iou: float = 0.7) -> Curve:
    """Precision over recall of a run."""
    return _curve(believed(stored, run, iou))


def published_ap(stored: StoredDetections, run: SchemeRun, iou: float = 0.7) -> float:
    """AP of a run by the protocol `published` of `toolkit.detection.metrics`; NaN where nothing is to be found."""
    row = IOUS.index(iou)
    frames = [f for truth, f in zip(stored.truths, stored.runs[run], strict=True) if len(truth.boxes)]
    if not frames:
        return float("nan")
    scores = np.concatenate([f.scores for f in frames])
    outcome = np.concatenate([f.published[row] for f in frames])
    counts = outcome != IGNORED
    return average_precision(precision_recall(scores[counts], outcome[counts] >= 0, stored.vehicles))


def kbit_per_sensor(stored: StoredDetections, run: SchemeRun) -> float:
    """Mean over frames and sensors of what a run sends."""
    return float(np.mean([f.bits.mean() for f in stored.runs[run]])) / 1000


def ms_per_frame(stored: StoredDetections, run: SchemeRun) -> float:
    """Median from measurement to fused boxes, the sensors working side by side."""
    return float(np.median([f.ms[0] for f in stored.runs[run]]))


def visible_share(stored: StoredDetections, sensors: tuple[int, ...], region: tuple[int, ...] = ()) -> float:
    """Share of the vehicles, or of those in a region, on which a set has a point; NaN without any."""
    boxes = np.concatenate([np.zeros((0, 7)), *(truth.boxes for truth in stored.truths)])
    there = in_view_of_all([stored.sensors[c] for c in region], boxes)
    points = stored.points(sensors)[there]
    return float((points > 0).mean()) if len(points) else float("nan")


def _curve(what: Believed) -> Curve:
    scores, hits = (np.concatenate([np.zeros(0), *each]) for each in (what.scores, what.hits))
    return precision_recall(scores, hits.astype(bool), sum(what.to_find))
