"""Average precision as KITTI and nuScenes count it, beside ours (`toolkit.detection.metrics`).

KITTI (2019 on): AP is the mean, over the recalls 1/40, 2/40, ... 1, of the best precision at that recall or above; IoU
0.7 for cars, 0.5 for pedestrians and cyclists. Its levels of difficulty need heights in an image and are not used here.

nuScenes: a detection is true if a truth of its frame that no surer one took has its centre nearer than a threshold, on
the ground plane, whatever the sizes: 0.5, 1, 2 and 4 m. AP is the area of the curve above precision 0.1 and beyond
recall 0.1, taken at 101 recalls and divided by 0.9; the figure is the mean over the four thresholds.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool
from toolkit.detection.metrics import Curve, precision_recall
from toolkit.objects import Detections, Objects

KITTI_IOU = {"vehicle": 0.7, "heavy": 0.7, "cyclist": 0.5, "pedestrian": 0.5}
KITTI_RECALLS = 40
CENTRE_DISTANCES = (0.5, 1.0, 2.0, 4.0)  # m
LEAST_RECALL = LEAST_PRECISION = 0.1


class Matched(NamedTuple):
    """Pooled detections of a class: scores, whether each hit (none that does not count), and how many to find."""

    scores: np.ndarray
    hits: np.ndarray
    truths: int

    @property
    def curve(self) -> Curve:
        """Precision and recall."""
        return precision_recall(self.scores, self.hits, self.truths)


def kitti_ap(curve: Curve) -> float:
    """AP at 40 recalls; NaN where nothing is to be found.

    >>> kitti_ap(precision_recall(np.array([0.9, 0.8]), np.array([True, False]), truths=2))
    0.5
    """
    if len(curve.recall) and np.isnan(curve.recall).all():
        return float("nan")
    recalls = np.arange(1, KITTI_RECALLS + 1) / KITTI_RECALLS
    best = [curve.precision[curve.recall >= recall - 1e-12].max(initial=0.0) for recall in recalls]
    return float(np.mean(best))


def nuscenes_ap(curve: Curve) -> float:
    """The area above the least precision and beyond the least recall, 1 for a perfect detector.

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
    """Detections of a class against truths by the distance (m) of their centres on the ground; a detection that hits
    only what is not counted does not count."""
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
    """Which detections take a counted truth, and which have none but lie on one that is not counted."""
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


def mean_of(values: Sequence[float]) -> float:
    """The mean, NaN of none."""
    return float(np.mean(values)) if len(values) else float("nan")
