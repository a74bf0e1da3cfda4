"""Candidates: scored boxes from a network's maps, without duplicates and cross-class rivals.

A score is the network's confidence: the probability of the anchor's class, lowered by the IoU
predicted for the box, and calibrated. Boxes suppress only boxes of their class, so a person on a
bicycle may be detected as a cyclist and as a pedestrian, and the cab of a truck as a vehicle. Each
of two such rivals keeps the part of its score that calibration (`models.training.second_stage`)
found to be true.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from models.config import VoxelNetConfig
from models.network.grid import decode, per_anchor
from models.network.sparse import ClassifiedCells
from models.network.voxelnet import AnchorPlaces, Prediction
from toolkit.arrays import Bool, Float, Float32, Int64
from toolkit.boxes import footprint_overlap, iou_bev, nms
from toolkit.objects import Detections, label_index

_Scores = Float[np.ndarray, " n"]
_Grid = Float32[Tensor, "H W A 7"]
MAX_CLOUD_CANDIDATES = 2000  # before non-maximum suppression
SAME_GROUND_SHARE = 0.3  # overlap of the smaller footprint above which two boxes are rivals
MIN_RIVAL_SCORE = 0.2
# share of the other class's score, if the network's header has no shares
LARGE_RIVAL_SHARES = {"vehicle": 0.8, "heavy": 0.3}
_SURE_LOGIT = 8.0  # larger logits may have larger rounding errors than `_LOGIT_ROUNDING`
_LOGIT_ROUNDING = 0.01  # largest rounding error below `_SURE_LOGIT`


class BestCandidates(NamedTuple):
    """Boxes (m) of one cloud, and their score for each of `config.labels`."""

    boxes: Float32[Tensor, "k 7"]
    scores: Float32[Tensor, "k labels"]


class BoxCandidates(NamedTuple):
    """Boxes of anchors, and their score for each label.

    Attributes:
        item: Index of the cloud or tile in the batch, ascending.
        place: Number of the anchor in the whole map: (row · columns + column) · A + anchor.
        boxes: Boxes (x y z length width height yaw; m and radians) in the frame of the grid.
        scores: Score for each of `config.labels`; 0 below the label's threshold.
    """

    item: Int64[Tensor, " n"]
    place: Int64[Tensor, " n"]
    boxes: Float32[Tensor, "n 7"]
    scores: Float32[Tensor, "n labels"]

    def best(self, rows: Int64[Tensor, " m"] | slice) -> BestCandidates:
        """Boxes and scores of these rows; the `MAX_CLOUD_CANDIDATES` best if there are more."""
        boxes = self.boxes[rows]
        scores = self.scores[rows]
        if len(boxes) <= MAX_CLOUD_CANDIDATES:
            return BestCandidates(boxes, scores)
        best_rows = torch.topk(scores.amax(-1), MAX_CLOUD_CANDIDATES).indices
        return BestCandidates(boxes[best_rows], scores[best_rows])


def candidates(
    prediction: Prediction | ClassifiedCells,
    anchors: _Grid,
    config: VoxelNetConfig,
    thresholds: Sequence[float],
) -> list[BestCandidates]:
    """Boxes and scores of each cloud's best anchors.

    anchors: one box for each cell and anchor of the map. thresholds: lowest score to keep, for each
    of `config.labels`.
    """
    passing = all_candidates(prediction, anchors, config, thresholds)
    counts = torch.bincount(passing.item, minlength=len(prediction.class_logits))
    last_rows = counts.cumsum(0).tolist()  # rows are sorted by item
    return [
        passing.best(slice(first, last))
        for first, last in zip([0, *last_rows], last_rows, strict=False)
    ]


def all_candidates(
    prediction: Prediction | ClassifiedCells,
    anchors: _Grid,
    config: VoxelNetConfig,
    thresholds: Sequence[float],
    corner: Int64[Tensor, "B 2"] | None = None,
) -> BoxCandidates:
    """Boxes of anchors above a label's threshold; scores for labels below theirs are 0.

    An anchor has scores for all labels, or with `config.kinds` only for its label.

    thresholds: lowest score to keep, for each of `config.labels`. corner: cell (row, column) of the
    map at which each item begins, if the items are tiles; anything beyond the map is left out.
    """
    count = len(config.anchor_labels)  # A, anchors in a cell
    logits = per_anchor(prediction.class_logits, count)
    anchor_label = torch.tensor(config.anchor_labels, device=logits.device)
    threshold = torch.tensor(thresholds, dtype=logits.dtype, device=logits.device)
    # (anchors, 1) by anchor, or (labels,) by label; slope and intercept below have the same shape
    threshold = threshold[anchor_label][:, None] if config.kinds else threshold
    if config.head == "published":
        is_passing = torch.softmax(logits, -1)[..., 1:] > threshold
    else:  # only the class decides: a predicted IoU only lowers a score
        min_logit = torch.logit(threshold)
        if config.calibration:
            pairs = torch.tensor(config.calibration, dtype=logits.dtype, device=logits.device)
            slope, intercept = pairs[anchor_label].T[..., None] if config.kinds else pairs.T
            min_logit = (min_logit - intercept) / slope
        is_passing = logits > _subtract_rounding(min_logit)
    places = AnchorPlaces(*torch.nonzero(is_passing.any(-1), as_tuple=True))
    outputs = prediction.at(places, count)
    class_index = places.anchor if config.kinds else slice(None)
    if config.head == "published":
        scores = torch.softmax(logits[places], -1)[..., 1:]  # class 0 is the background
    else:
        scores = torch.sigmoid(logits[places])
        if outputs.quality_logits is not None and config.quality_power:
            quality = torch.sigmoid(outputs.quality_logits)[:, None]
            scores = scores * quality**config.quality_power
        if config.calibration:
            scores = torch.sigmoid(
                torch.logit(scores, 1e-6) * slope[class_index] + intercept[class_index]
            )
    scores = torch.where(scores > threshold[class_index], scores, 0.0)
    row = places.row
    column = places.column
    if corner is not None:
        row = row + corner[places.item, 0]
        column = column + corner[places.item, 1]
    is_candidate = (scores.amax(-1) > 0) & (row < len(anchors)) & (column < anchors.shape[1])
    candidate_rows = torch.nonzero(is_candidate)[:, 0]
    scores = scores[candidate_rows]
    row = row[candidate_rows]
    column = column[candidate_rows]
    anchor = places.anchor[candidate_rows]
    direction = outputs.direction_logits
    is_backwards = None if direction is None else direction[candidate_rows] > 0
    boxes = decode(outputs.residuals[candidate_rows], anchors[row, column, anchor], is_backwards)
    anchor_number = (row * anchors.shape[1] + column) * count + anchor
    if config.kinds:  # spread the single score over the columns of the labels
        is_label = torch.eye(len(config.labels), device=logits.device)
        scores = scores * is_label[anchor_label[anchor]]
    item = places.item[candidate_rows]
    return BoxCandidates(item=item, place=anchor_number, boxes=boxes, scores=scores)


def _subtract_rounding(min_logit: Tensor) -> Tensor:
    """Lowest logits to keep, lower than the threshold's by the largest rounding error.

    min_logit: logits of thresholds, any shape. Scores are clipped to 1e-6, so below that every
    logit is kept."""
    clamped = torch.where(min_logit > math.log(1e-6), min_logit.clamp(max=_SURE_LOGIT), -torch.inf)
    return clamped - _LOGIT_ROUNDING


def suppress_boxes(
    boxes: Float[Tensor, "n 7"],
    scores: Float[Tensor, "n labels"],
    config: VoxelNetConfig,
    nms_threshold: float,
    *,
    area: tuple[float, float, float, float] | None = None,
) -> Detections:
    """Detections of one cloud's candidates, each with its label of the highest score.

    Duplicates, boxes centred outside the area and boxes that are not finite are dropped.

    scores: for each of `config.labels`. nms_threshold: IoU above which the weaker of two boxes of a
    class is a duplicate. area: xmin, ymin, xmax, ymax (m) in the frame of the boxes, None for
    `config.area`.
    """
    xmin, ymin, xmax, ymax = area or config.area
    x = boxes[:, 0]
    y = boxes[:, 1]
    is_inside = (x >= xmin) & (x <= xmax) & (y >= ymin) & (y <= ymax) & torch.isfinite(boxes).all(1)
    best_scores, best_columns = scores[is_inside].max(1)
    label_numbers = np.array([label_index(name) for name in config.labels])
    detections = Detections(
        boxes[is_inside].double().cpu().numpy(),
        best_scores.double().cpu().numpy(),
        label_numbers[best_columns.cpu().numpy()],
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
    """Kept boxes, each averaged with the candidates of its class that overlap it.

    Weights are squared scores: neighbouring anchors err independently ("box voting", Gidaris and
    Komodakis 2015). Scores and labels stay.

    rows: rows of the kept boxes among the candidates. iou_threshold: IoU seen from above over which
    a candidate takes part.
    """
    boxes = candidates.boxes
    best = candidates.boxes[rows]
    is_averaged = (iou_bev(best, boxes) > iou_threshold) & (
        candidates.labels[rows][:, None] == candidates.labels
    )
    weights = np.where(is_averaged, candidates.scores**2, 0.0)
    # a kept box always counts itself
    weights[np.arange(len(rows)), rows] = candidates.scores[rows] ** 2
    weights /= weights.sum(axis=1, keepdims=True)
    turn = boxes[:, 6] - best[:, 6:]
    turn = (turn + np.pi / 2) % np.pi - np.pi / 2  # a box facing the other way has the same axis
    mean = weights @ boxes
    mean[:, 6] = best[:, 6] + (weights * turn).sum(axis=1)
    return Detections(mean, candidates.scores[rows], candidates.labels[rows])


def find_rivals(boxes: Float[np.ndarray, "n 7"]) -> Bool[np.ndarray, "n n"]:
    """Symmetric mask of pairs whose footprints overlap so much that only one can be an object."""
    # [i, j]: share of the footprint of box i that box j covers
    overlap = footprint_overlap(boxes, boxes)
    return np.maximum(overlap, overlap.T) > SAME_GROUND_SHARE


def strongest_rivals(
    detections: Detections, config: VoxelNetConfig
) -> Float[np.ndarray, "n labels"]:
    """Highest score of each other label among the boxes that overlap each detection, or 0.

    Columns are in the order of `config.labels`. Scores below `MIN_RIVAL_SCORE` count as 0.
    """
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


def rival_shares(config: VoxelNetConfig) -> Float[np.ndarray, "labels labels"] | None:
    """Share of each rival label's score below which a box of a label is dropped; None if no
    box is dropped.

    Rows are the labels of boxes to drop, columns their rivals' labels, both in the order of
    `config.labels`. Without `config.rival_shares` only
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
    detection_rows = [label_rows[int(label)] for label in detections.labels]
    scores = rescore(
        detections.scores,
        strongest_rivals(detections, config),
        np.array(config.rivalry)[detection_rows],
    )
    return replace(detections, scores=scores)


def rescore(
    scores: _Scores, rivals: Float[np.ndarray, "n labels"], rows: Float[np.ndarray, "r columns"]
) -> _Scores:
    """Calibrated scores, lowered by the scores of their rivals.

    rivals: highest score of each label that overlaps the box, 0 if none does. rows: slope,
    intercept and a weight for each label; one row for each score (r = n) or for all
    (r = 1).
    """
    slope = rows[:, 0]
    intercept = rows[:, 1]
    weights = rows[:, 2:]
    return sigmoid(slope * logit(scores) + intercept - (weights * rivals).sum(axis=1))


def logit(scores: _Scores) -> _Scores:
    """Log odds of scores, clipped as in the detector."""
    clipped = np.clip(scores, 1e-6, 1 - 1e-6)
    return np.log(clipped / (1 - clipped))


def sigmoid(values: _Scores) -> _Scores:
    """Inverse of `logit`."""
    return 1 / (1 + np.exp(-values))
