"""Candidates: the boxes that a network's maps hold with a score above a threshold, and these without duplicates.

A score says how sure the network is: the anchor's class, lowered by the IoU that it predicts for the box, as the
configuration's calibration has it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from models.config import VoxelNetConfig
from models.network.anchors import decode, per_anchor
from models.network.voxelnet import Prediction
from toolkit.arrays import Bool, Float, Float32, Int64
from toolkit.boxes import iou_bev, nms
from toolkit.objects import Detections, label_index

MOST_CANDIDATES = 2000  # per cloud, before non-maximum suppression
_SURE_LOGIT, _ROUNDING = 8.0, 0.01  # logits above the first are rounded by more than the second


class Candidates(NamedTuple):
    """Boxes of anchors, m, and their score for each label, 0 where it is not above the threshold.

    item: of the batch, ascending; place: the anchor's number among all of a map.
    """

    item: Int64[Tensor, " n"]
    place: Int64[Tensor, " n"]
    boxes: Float32[Tensor, "n 7"]
    scores: Float32[Tensor, "n L"]

    def of(self, rows: Int64[Tensor, " m"] | slice) -> Candidates:
        """Some of them."""
        return Candidates(*(column[rows] for column in self))

    def best(self) -> tuple[Float32[Tensor, "n 7"], Float32[Tensor, "n L"]]:
        """Boxes and scores of one cloud's, as many as are looked at: the surest first, where there are more."""
        if len(self.item) <= MOST_CANDIDATES:
            return self.boxes, self.scores
        chosen = torch.topk(self.scores.amax(-1), MOST_CANDIDATES).indices
        return self.boxes[chosen], self.scores[chosen]


def candidates(
    prediction: Prediction,
    anchors: Float32[Tensor, "H W A 7"],
    config: VoxelNetConfig,
    thresholds: Sequence[float],
) -> list[tuple[Float32[Tensor, "n 7"], Float32[Tensor, "n L"]]]:
    """Per cloud, the boxes of the best anchors above the threshold of a label, and their score for each label, 0 where
    it is not above that."""
    found = all_candidates(prediction, anchors, config, thresholds)
    ends = torch.bincount(found.item, minlength=len(prediction.class_logits)).cumsum(0).tolist()
    return [found.of(slice(first, end)).best() for first, end in zip([0, *ends], ends, strict=False)]


def all_candidates(
    prediction: Prediction,
    anchors: Float32[Tensor, "H W A 7"],
    config: VoxelNetConfig,
    thresholds: Sequence[float],
    corner: Int64[Tensor, "B 2"] | None = None,
) -> Candidates:
    """The boxes of all anchors above the threshold of a label. corner: the cell of the map that each item's begins at,
    if these are tiles of it; what is beyond the map is left out."""
    count = len(config.anchor_labels)
    logits, residuals = (per_anchor(each, count) for each in (prediction.class_logits, prediction.residuals))
    quality, direction = (
        None if each is None else per_anchor(each, count)[..., 0]
        for each in (prediction.quality_logits, prediction.direction_logits)
    )
    label = torch.tensor(config.anchor_labels, device=logits.device)
    own = torch.eye(len(config.labels), device=logits.device)
    least = torch.tensor(thresholds, dtype=logits.dtype, device=logits.device)
    cell = torch.nonzero(hopeful(logits, least, config), as_tuple=True)
    at = label[cell[3]]
    scores = _scores(logits[cell], None if quality is None else quality[cell][:, None], at, config)
    scores = torch.where(scores > (least[at][:, None] if config.kinds else least), scores, 0.0)
    row, column = cell[1:3] if corner is None else (axis + corner[cell[0], k] for k, axis in enumerate(cell[1:3]))
    there = (scores.amax(-1) > 0) & (row < len(anchors)) & (column < anchors.shape[1])
    chosen = torch.nonzero(there)[:, 0]
    scores, at, row, column = scores[chosen], at[chosen], row[chosen], column[chosen]
    cell = tuple(axis[chosen] for axis in cell)
    turned = None if direction is None else direction[cell] > 0
    boxes = decode(residuals[cell], anchors[row, column, cell[3]], turned)
    place = (row * anchors.shape[1] + column) * count + cell[3]
    return Candidates(cell[0], place, boxes, scores * own[at] if config.kinds else scores)


def label_scores(prediction: Prediction, config: VoxelNetConfig) -> Float[Tensor, "B H W A L"]:
    """How sure the network is of each label at each anchor, 0 to 1; where anchors are of one class, of that alone."""
    count = len(config.anchor_labels)
    logits = per_anchor(prediction.class_logits, count)
    quality = None if prediction.quality_logits is None else per_anchor(prediction.quality_logits, count)
    return _scores(logits, quality, torch.tensor(config.anchor_labels, device=logits.device), config)


def _scores(
    logits: Float[Tensor, "*n K"], quality: Float[Tensor, "*n 1"] | None, label: Int64[Tensor, "*m"],
    config: VoxelNetConfig,
) -> Float[Tensor, "*n L"]:  # fmt: skip
    """`label_scores` of anchors of these labels (of all anchors, or of those of a cell)."""
    if config.head == "published":
        return torch.softmax(logits, -1)[..., 1:]
    scores = torch.sigmoid(logits)
    if quality is not None and config.quality_power:
        scores = scores * torch.sigmoid(quality) ** config.quality_power
    return calibrated(scores, label, config)


def calibrated(
    scores: Float[Tensor, "*n L"], label: Int64[Tensor, "*m"], config: VoxelNetConfig
) -> Float[Tensor, "*n L"]:
    """Scores that say which share of the detections of that score are true, by the configuration's calibration."""
    if not config.calibration:
        return scores
    slope, intercept = _calibration(label, config, scores)
    return torch.sigmoid(torch.logit(scores, 1e-6) * slope + intercept)


def _calibration(label: Tensor, config: VoxelNetConfig, like: Tensor) -> tuple[Tensor, Tensor]:
    """Slope and intercept for anchors of these labels."""
    by_label = torch.tensor(config.calibration, dtype=like.dtype, device=like.device)
    slope, intercept = by_label[label].T[..., None] if config.kinds else by_label.T
    return slope, intercept


def hopeful(
    logits: Float[Tensor, "B H W A K"], least: Float[Tensor, " L"], config: VoxelNetConfig
) -> Bool[Tensor, "B H W A"]:
    """Anchors, hardly any, that can have a score above the least of a label: a glance at their class alone.

    A predicted IoU only lowers a score. Whoever is left out would be, with all that is known of it.
    """
    if config.head == "published":
        return (torch.softmax(logits, -1)[..., 1:] > least).any(-1)
    label = torch.tensor(config.anchor_labels, device=logits.device)
    bound = torch.logit(least[label][:, None] if config.kinds else least)
    if config.calibration:
        slope, intercept = _calibration(label, config, logits)
        bound = (bound - intercept) / slope
    bound = torch.where(bound > math.log(1e-6), bound.clamp(max=_SURE_LOGIT), -torch.inf)
    return (logits > bound - _ROUNDING).any(-1)


def suppressed(
    boxes: Float[Tensor, "n 7"], scores: Float[Tensor, "n L"], config: VoxelNetConfig, nms_threshold: float
) -> Detections:
    """Candidates without those whose centre is outside the area, and without duplicates."""
    xmin, ymin, xmax, ymax = config.area
    x, y = boxes[:, 0], boxes[:, 1]
    inside = (x >= xmin) & (x <= xmax) & (y >= ymin) & (y <= ymax) & torch.isfinite(boxes).all(1)
    best, label = scores[inside].max(1)
    labels = np.array([label_index(name) for name in config.labels])[label.cpu().numpy()]
    found = Detections(boxes[inside].double().cpu().numpy(), best.double().cpu().numpy(), labels)
    kept = nms(found.boxes, found.scores, nms_threshold, labels=found.labels)
    return averaged(found, kept, config.averaging) if config.averaging else found[kept]


def averaged(candidates: Detections, kept: Int64[np.ndarray, " k"], iou_threshold: float) -> Detections:
    """The candidates kept, each box the mean of those of its class whose footprints overlap it by more than the
    threshold, weighted by their squared scores: neighbouring anchors err independently ("box voting", Gidaris and
    Komodakis 2015)."""
    boxes, best = candidates.boxes, candidates.boxes[kept]
    together = (iou_bev(best, boxes) > iou_threshold) & (candidates.labels[kept][:, None] == candidates.labels)
    weights = np.where(together, candidates.scores**2, 0.0)
    weights[np.arange(len(kept)), kept] = candidates.scores[kept] ** 2
    weights /= weights.sum(axis=1, keepdims=True)
    turn = boxes[:, 6] - best[:, 6:]
    turn = (turn + np.pi / 2) % np.pi - np.pi / 2  # a candidate that faces the other way lies along the same line
    mean = weights @ boxes
    mean[:, 6] = best[:, 6] + (weights * turn).sum(axis=1)
    return Detections(mean, candidates.scores[kept], candidates.labels[kept])
