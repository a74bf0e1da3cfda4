"""Candidates: scored boxes from a network's maps, without duplicates and cross-class rivals.

A score is the network's confidence: the probability of the anchor's class, lowered by the IoU
predicted for the box, and calibrated. Boxes suppress only boxes of their class, so a person on a
bicycle may be detected as a cyclist and as a pedestrian, and the cab of a truck as a vehicle. Each
of two such rivals keeps the part of its score that calibration (`models.training.second_stage`)
found to be true.
"""

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
MAX_CLOUD_CANDIDATES = 2000  # before non-maximum suppression
SAME_GROUND_SHARE = 0.3  # overlap of the smaller footprint above which two boxes are rivals
MIN_RIVAL_SCORE = 0.2
# share of the other class's score, if the network's header has no shares
LARGE_RIVAL_SHARES = {"vehicle": 0.8, "heavy": 0.3}
_SURE_LOGIT = 8.0  # larger logits may have larger rounding errors than `_LOGIT_ROUNDING`
_LOGIT_ROUNDING = 0.01  # largest rounding error below `_SURE_LOGIT`


class BoxCandidates(NamedTuple):
    """Boxes of anchors (m), and their score for each label or 0.

    Attributes:
        item: Item of the batch, ascending.
        place: Number of the anchor in its map.
        boxes: Boxes (m).
        scores: Score for each label.
    """

    item: Int64[Tensor, " n"]
    place: Int64[Tensor, " n"]
    boxes: Float32[Tensor, "n 7"]
    scores: Float32[Tensor, "n L"]

    def best(self, rows: Int64[Tensor, " m"] | slice) -> _Best:
        """Boxes and scores of the rows, at most `MAX_CLOUD_CANDIDATES`."""
        boxes = self.boxes[rows]
        scores = self.scores[rows]
        if len(boxes) <= MAX_CLOUD_CANDIDATES:
            return boxes, scores
        best_rows = torch.topk(scores.amax(-1), MAX_CLOUD_CANDIDATES).indices
        return boxes[best_rows], scores[best_rows]


def candidates(
    prediction: Prediction, anchors: _Grid, config: VoxelNetConfig, thresholds: Sequence[float]
) -> list[_Best]:
    """Boxes and scores of each cloud's best anchors."""
    passing = all_candidates(prediction, anchors, config, thresholds)
    ends = torch.bincount(passing.item, minlength=len(prediction.class_logits)).cumsum(0).tolist()
    return [passing.best(slice(first, end)) for first, end in zip([0, *ends], ends, strict=False)]


def all_candidates(
    prediction: Prediction,
    anchors: _Grid,
    config: VoxelNetConfig,
    thresholds: Sequence[float],
    corner: Int64[Tensor, "B 2"] | None = None,
) -> BoxCandidates:
    """Boxes of anchors above a label's threshold; scores for labels below theirs are 0.

    corner: first cell of the map in each item, if the items are tiles; anything beyond the map is
    left out.
    """
    count = len(config.anchor_labels)
    logits = per_anchor(prediction.class_logits, count)
    residuals = per_anchor(prediction.residuals, count)
    direction = quality = None
    if prediction.direction_logits is not None:
        direction = per_anchor(prediction.direction_logits, count)
    if prediction.quality_logits is not None:
        quality = per_anchor(prediction.quality_logits, count)
    label = torch.tensor(config.anchor_labels, device=logits.device)
    threshold = torch.tensor(thresholds, dtype=logits.dtype, device=logits.device)
    threshold = threshold[label][:, None] if config.kinds else threshold  # by anchor, or by label
    if config.head == "published":
        is_passing = torch.softmax(logits, -1)[..., 1:] > threshold
    else:  # only the class decides: a predicted IoU only lowers a score
        bound = torch.logit(threshold)
        if config.calibration:
            pairs = torch.tensor(config.calibration, dtype=logits.dtype, device=logits.device)
            slope, intercept = pairs[label].T[..., None] if config.kinds else pairs.T
            bound = (bound - intercept) / slope
        bound = torch.where(bound > math.log(1e-6), bound.clamp(max=_SURE_LOGIT), -torch.inf)
        is_passing = logits > bound - _LOGIT_ROUNDING
    cell = torch.nonzero(is_passing.any(-1), as_tuple=True)
    class_index = cell[3] if config.kinds else slice(None)
    if config.head == "published":
        scores = torch.softmax(logits[cell], -1)[..., 1:]
    else:
        scores = torch.sigmoid(logits[cell])
        if quality is not None and config.quality_power:
            scores = scores * torch.sigmoid(quality[cell]) ** config.quality_power
        if config.calibration:
            scores = torch.sigmoid(
                torch.logit(scores, 1e-6) * slope[class_index] + intercept[class_index]
            )
    scores = torch.where(scores > threshold[class_index], scores, 0.0)
    row = cell[1]
    column = cell[2]
    if corner is not None:
        row = row + corner[cell[0], 0]
        column = column + corner[cell[0], 1]
    is_inside = (scores.amax(-1) > 0) & (row < len(anchors)) & (column < anchors.shape[1])
    inside_rows = torch.nonzero(is_inside)[:, 0]
    scores = scores[inside_rows]
    row = row[inside_rows]
    column = column[inside_rows]
    cell = tuple(index[inside_rows] for index in cell)
    anchor = cell[3]
    is_backwards = None if direction is None else direction[cell][:, 0] > 0
    boxes = decode(residuals[cell], anchors[row, column, anchor], is_backwards)
    anchor_number = (row * anchors.shape[1] + column) * count + anchor
    if config.kinds:
        scores = scores * torch.eye(len(config.labels), device=logits.device)[label[anchor]]
    return BoxCandidates(cell[0], anchor_number, boxes, scores)


def suppress_boxes(
    boxes: Float[Tensor, "n 7"],
    scores: Float[Tensor, "n L"],
    config: VoxelNetConfig,
    nms_threshold: float,
) -> Detections:
    """Drop duplicates and candidates centred outside the area."""
    xmin, ymin, xmax, ymax = config.area
    x = boxes[:, 0]
    y = boxes[:, 1]
    is_inside_x = (x >= xmin) & (x <= xmax)
    is_inside_y = (y >= ymin) & (y <= ymax)
    is_inside = is_inside_x & is_inside_y & torch.isfinite(boxes).all(1)
    best, label = scores[is_inside].max(1)
    labels = np.array([label_index(name) for name in config.labels])[label.cpu().numpy()]
    detections = Detections(
        boxes[is_inside].double().cpu().numpy(), best.double().cpu().numpy(), labels
    )
    kept_rows = nms(detections.boxes, detections.scores, nms_threshold, labels=detections.labels)
    return (
        average_boxes(detections, kept_rows, config.averaging)
        if config.averaging
        else detections[kept_rows]
    )


def average_boxes(
    candidates: Detections, rows: Int64[np.ndarray, " k"], iou_threshold: float
) -> Detections:
    """Average each kept box with candidates of its class that overlap it.

    Weights are squared scores: neighbouring anchors err independently ("box voting", Gidaris and
    Komodakis 2015).
    """
    boxes = candidates.boxes
    best = candidates.boxes[rows]
    is_averaged = (iou_bev(best, boxes) > iou_threshold) & (
        candidates.labels[rows][:, None] == candidates.labels
    )
    weights = np.where(is_averaged, candidates.scores**2, 0.0)
    weights[np.arange(len(rows)), rows] = candidates.scores[rows] ** 2
    weights /= weights.sum(axis=1, keepdims=True)
    turn = boxes[:, 6] - best[:, 6:]
    # a box facing the other way has the same axis
    turn = (turn + np.pi / 2) % np.pi - np.pi / 2
    mean = weights @ boxes
    mean[:, 6] = best[:, 6] + (weights * turn).sum(axis=1)
    return Detections(mean, candidates.scores[rows], candidates.labels[rows])


def find_rivals(boxes: Float[np.ndarray, "n 7"]) -> Bool[np.ndarray, "n n"]:
    """Mask of pairs whose footprints overlap so much that only one can be an object."""
    overlap = footprint_overlap(boxes, boxes)
    return np.maximum(overlap, overlap.T) > SAME_GROUND_SHARE


def strongest_rivals(detections: Detections, config: VoxelNetConfig) -> Float[np.ndarray, "n L"]:
    """Greatest score of each other label on each detection's ground; 0 below `MIN_RIVAL_SCORE`."""
    strongest = np.zeros((len(detections), len(config.labels)))
    if not len(detections):
        return strongest
    is_rival = find_rivals(detections.boxes) & (detections.labels[:, None] != detections.labels)
    scores = np.where(is_rival & (detections.scores >= MIN_RIVAL_SCORE), detections.scores, 0.0)
    for column, name in enumerate(config.labels):
        strongest[:, column] = scores[:, detections.labels == label_index(name)].max(
            axis=1, initial=0.0
        )
    return strongest


def rival_shares(config: VoxelNetConfig) -> Float[np.ndarray, "L L"] | None:
    """Share of each rival label's score below which a box of a label is dropped; None if no
    box is dropped.

    Rows and columns are in the order of `config.labels`. Without `config.rival_shares` only
    vehicles and heavy vehicles are rivals: a person next to a car is another object, the front of a
    truck is not.
    """
    labels = config.labels
    shares = np.zeros((len(labels), len(labels)))
    if config.rival_shares:
        shares += np.array(config.rival_shares)[:, None]
    elif LARGE_RIVAL_SHARES.keys() <= set(labels):
        large = [labels.index(label) for label in LARGE_RIVAL_SHARES]
        shares[np.ix_(large, large)] = np.array(list(LARGE_RIVAL_SHARES.values()))[:, None]
    return shares if shares.any() else None


def apply_rivals(detections: Detections, config: VoxelNetConfig) -> Detections:
    """Lower scores of boxes that overlap boxes of other classes, by `config.rivalry`.

    score = sigmoid(slope · logit(score) + intercept - Σ weight of a label · score of its strongest
    rival).
    """
    if not config.rivalry or not len(detections):
        return detections
    label_rows = {label_index(name): row for row, name in enumerate(config.labels)}
    rows = np.array(config.rivalry)[[label_rows[int(label)] for label in detections.labels]]
    return Detections(
        detections.boxes,
        rescore(detections.scores, strongest_rivals(detections, config), rows),
        detections.labels,
    )


def rescore(
    scores: _Scores, rivals: Float[np.ndarray, "n L"], rows: Float[np.ndarray, "r K"]
) -> _Scores:
    """Lower scores by the scores of their rivals.

    rows: slope, intercept and weights, for each score or one for all.
    """
    log_odds = rows[:, 0] * logit(scores) + rows[:, 1]
    penalty = (rows[:, 2:] * rivals).sum(axis=1)
    return sigmoid(log_odds - penalty)


def logit(scores: _Scores) -> _Scores:
    """Log odds of scores, clipped as in the detector."""
    clipped = np.clip(scores, 1e-6, 1 - 1e-6)
    return np.log(clipped / (1 - clipped))


def sigmoid(values: _Scores) -> _Scores:
    """Inverse of `logit`."""
    return 1 / (1 + np.exp(-values))
