"""Candidates: scored boxes from a network's maps, without duplicates and rivals.

A score says how sure the network is: the probability of the anchor's class, lowered by the IoU
predicted for the box, and calibrated. Boxes suppress only boxes of their own class, so a person on
a bicycle may be found as a cyclist and as a pedestrian, and the cab of a truck as a vehicle. Each
of two such rivals keeps the part of its score that calibration (`models.training.second_stage`)
found to be true."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from models.config import VoxelNetConfig
from models.network.grid import decode, per_anchor
from models.network.voxelnet import Prediction
from toolkit.arrays import Bool, Float, Float32, Int64
from toolkit.boxes import footprint_overlap, iou_bev, nms
from toolkit.objects import Detections, label_index

_Scores = Float[np.ndarray, " n"]
_Grid = Float32[Tensor, "H W A 7"]
_Best = tuple[Float32[Tensor, "k 7"], Float32[Tensor, "k L"]]  # boxes, and scores of each label
MOST_CANDIDATES = 2000  # per cloud, before non-maximum suppression
# logits above the first are rounded by more than the second
_SURE_LOGIT = 8.0
_ROUNDING = 0.01


class Candidates(NamedTuple):
    """Boxes of anchors (m), and their score for each label or 0.

    item: in the batch, ascending; place: number of the anchor in its map."""

    item: Int64[Tensor, " n"]
    place: Int64[Tensor, " n"]
    boxes: Float32[Tensor, "n 7"]
    scores: Float32[Tensor, "n L"]

    def best(self, rows: Int64[Tensor, " m"] | slice) -> _Best:
        """Boxes and scores of these rows, at most `MOST_CANDIDATES`."""
        boxes = self.boxes[rows]
        scores = self.scores[rows]
        if len(boxes) <= MOST_CANDIDATES:
            return boxes, scores
        chosen = torch.topk(scores.amax(-1), MOST_CANDIDATES).indices
        return boxes[chosen], scores[chosen]


def candidates(
    prediction: Prediction, anchors: _Grid, config: VoxelNetConfig, thresholds: Sequence[float]
) -> list[_Best]:
    """Boxes and scores of each cloud's best anchors."""
    found = all_candidates(prediction, anchors, config, thresholds)
    ends = torch.bincount(found.item, minlength=len(prediction.class_logits)).cumsum(0).tolist()
    return [found.best(slice(first, end)) for first, end in zip([0, *ends], ends, strict=False)]


def all_candidates(
    prediction: Prediction,
    anchors: _Grid,
    config: VoxelNetConfig,
    thresholds: Sequence[float],
    corner: Int64[Tensor, "B 2"] | None = None,
) -> Candidates:
    """Return the boxes of anchors above a label's threshold; scores for labels below theirs are 0.

    corner: first cell of the map in each item, if the items are tiles of it; anything beyond the
    map is left out."""
    count = len(config.anchor_labels)
    logits, residuals = (per_anchor(each, count) for each in prediction[:2])
    direction, quality = (
        None if each is None else per_anchor(each, count) for each in prediction[2:]
    )
    label = torch.tensor(config.anchor_labels, device=logits.device)
    least = torch.tensor(thresholds, dtype=logits.dtype, device=logits.device)
    least = least[label][:, None] if config.kinds else least  # by anchor, or by label
    if config.head == "published":
        hopeful = torch.softmax(logits, -1)[..., 1:] > least
    else:  # the class alone decides: a predicted IoU only lowers a score
        bound = torch.logit(least)
        if config.calibration:
            pairs = torch.tensor(config.calibration, dtype=logits.dtype, device=logits.device)
            slope, intercept = pairs[label].T[..., None] if config.kinds else pairs.T
            bound = (bound - intercept) / slope
        bound = torch.where(bound > math.log(1e-6), bound.clamp(max=_SURE_LOGIT), -torch.inf)
        hopeful = logits > bound - _ROUNDING
    cell = torch.nonzero(hopeful.any(-1), as_tuple=True)
    own = cell[3] if config.kinds else slice(None)
    if config.head == "published":
        scores = torch.softmax(logits[cell], -1)[..., 1:]
    else:
        scores = torch.sigmoid(logits[cell])
        if quality is not None and config.quality_power:
            scores = scores * torch.sigmoid(quality[cell]) ** config.quality_power
        if config.calibration:
            scores = torch.sigmoid(torch.logit(scores, 1e-6) * slope[own] + intercept[own])
    scores = torch.where(scores > least[own], scores, 0.0)
    row, column = (
        cell[1:3]
        if corner is None
        else (axis + corner[cell[0], k] for k, axis in enumerate(cell[1:3]))
    )
    there = (scores.amax(-1) > 0) & (row < len(anchors)) & (column < anchors.shape[1])
    chosen = torch.nonzero(there)[:, 0]
    scores, row, column, *kept = (each[chosen] for each in (scores, row, column, *cell))
    item, _, _, anchor = cell = tuple(kept)
    backwards = None if direction is None else direction[cell][:, 0] > 0
    boxes = decode(residuals[cell], anchors[row, column, anchor], backwards)
    place = (row * anchors.shape[1] + column) * count + anchor
    if config.kinds:
        scores = scores * torch.eye(len(config.labels), device=logits.device)[label[anchor]]
    return Candidates(item, place, boxes, scores)


def suppress(
    boxes: Float[Tensor, "n 7"],
    scores: Float[Tensor, "n L"],
    config: VoxelNetConfig,
    nms_threshold: float,
) -> Detections:
    """Drop duplicates and candidates centred outside the area."""
    xmin, ymin, xmax, ymax = config.area
    x, y = boxes[:, 0], boxes[:, 1]
    inside = (x >= xmin) & (x <= xmax) & (y >= ymin) & (y <= ymax) & torch.isfinite(boxes).all(1)
    best, label = scores[inside].max(1)
    labels = np.array([label_index(name) for name in config.labels])[label.cpu().numpy()]
    found = Detections(boxes[inside].double().cpu().numpy(), best.double().cpu().numpy(), labels)
    kept = nms(found.boxes, found.scores, nms_threshold, labels=found.labels)
    return average_boxes(found, kept, config.averaging) if config.averaging else found[kept]


def average_boxes(
    candidates: Detections, kept: Int64[np.ndarray, " k"], iou_threshold: float
) -> Detections:
    """Average each kept box with candidates of its class that overlap it. Weights are squared
    scores: neighbouring anchors err independently ("box voting", Gidaris and Komodakis 2015)."""
    boxes = candidates.boxes
    best = candidates.boxes[kept]
    together = (iou_bev(best, boxes) > iou_threshold) & (
        candidates.labels[kept][:, None] == candidates.labels
    )
    weights = np.where(together, candidates.scores**2, 0.0)
    weights[np.arange(len(kept)), kept] = candidates.scores[kept] ** 2
    weights /= weights.sum(axis=1, keepdims=True)
    turn = boxes[:, 6] - best[:, 6:]
    # a box facing the other way lies along the same line
    turn = (turn + np.pi / 2) % np.pi - np.pi / 2
    mean = weights @ boxes
    mean[:, 6] = best[:, 6] + (weights * turn).sum(axis=1)
    return Detections(mean, candidates.scores[kept], candidates.labels[kept])


TOGETHER = 0.3  # overlap, as a share of the smaller footprint, above which two claim one place
LEAST_RIVAL = 0.2  # least score of a rival
# of the other's score, if the network's header has no shares
LARGE_RIVAL_SHARES = {"vehicle": 0.8, "heavy": 0.3}


def share_ground(boxes: Float[np.ndarray, "n 7"]) -> Bool[np.ndarray, "n n"]:
    """Mask of pairs that claim one place."""
    inside = footprint_overlap(boxes, boxes)
    return np.maximum(inside, inside.T) > TOGETHER


def strongest_rivals(found: Detections, config: VoxelNetConfig) -> Float[np.ndarray, "n L"]:
    """Greatest score of each other label on each detection's ground; 0 below `LEAST_RIVAL`."""
    strongest = np.zeros((len(found), len(config.labels)))
    if not len(found):
        return strongest
    together = share_ground(found.boxes) & (found.labels[:, None] != found.labels)
    scores = np.where(together & (found.scores >= LEAST_RIVAL), found.scores, 0.0)
    for column, name in enumerate(config.labels):
        strongest[:, column] = scores[:, found.labels == label_index(name)].max(axis=1, initial=0.0)
    return strongest


def rival_shares(config: VoxelNetConfig) -> Float[np.ndarray, "L L"] | None:
    """Share of each rival label's score below which a box of a label is dropped; None if no box
    ever is.

    Rows and columns are in the order of `config.labels`. Without `config.rival_shares` only
    vehicles and heavy vehicles are rivals: a person next to a car is another object, the front of a
    truck is not."""
    labels = config.labels
    shares = np.zeros((len(labels), len(labels)))
    if config.rival_shares:
        shares += np.array(config.rival_shares)[:, None]
    elif LARGE_RIVAL_SHARES.keys() <= set(labels):
        large = [labels.index(label) for label in LARGE_RIVAL_SHARES]
        shares[np.ix_(large, large)] = np.array(list(LARGE_RIVAL_SHARES.values()))[:, None]
    return shares if shares.any() else None


def apply_rivals(found: Detections, config: VoxelNetConfig) -> Detections:
    """Lower scores where other classes claim the place, by `config.rivalry`. score = sigmoid(slope
    · logit(score) + intercept - Σ weight of a label · score of its strongest rival)."""
    if not config.rivalry or not len(found):
        return found
    own = {label_index(name): row for row, name in enumerate(config.labels)}
    rows = np.array(config.rivalry)[[own[int(label)] for label in found.labels]]
    return Detections(
        found.boxes, rescore(found.scores, strongest_rivals(found, config), rows), found.labels
    )


def rescore(
    scores: _Scores, rivals: Float[np.ndarray, "n L"], rows: Float[np.ndarray, "r K"]
) -> _Scores:
    """Lower scores by those of their rivals. rows: slope, intercept and weights, for each score or
    one for all."""
    return sigmoid(rows[:, 0] * logit(scores) + rows[:, 1] - (rows[:, 2:] * rivals).sum(axis=1))


def logit(scores: _Scores) -> _Scores:
    """Log odds of scores, clipped as in the detector."""
    cut = np.clip(scores, 1e-6, 1 - 1e-6)
    return np.log(cut / (1 - cut))


def sigmoid(values: _Scores) -> _Scores:
    """Inverse of `logit`."""
    return 1 / (1 + np.exp(-values))
