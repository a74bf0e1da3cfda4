"""Targets of the anchors, and the published loss and one with quality (Zhou and Tuzel 2018, section
2.2).
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from models.anchor_kind import AnchorKind
from models.network.grid import decode, encode_residuals, faces_back, per_anchor
from models.network.voxelnet import Prediction
from toolkit.arrays import Bool, BoxRows, Float, Int64, Mask, Rng, Shaped
from toolkit.objects import label_index

_Labels = Shaped[Tensor, "B H W A"]
_Targets = Float[Tensor, "B H W A 7"]
_Grid = Float[np.ndarray, "H W A 7"]
NEGATIVE = 0
POSITIVE = 1
IGNORED = -1


class Assignment(NamedTuple):
    """Targets of the anchors."""

    labels: Shaped[np.ndarray, "H W A"]  # POSITIVE, NEGATIVE or IGNORED
    owner: Int64[np.ndarray, "H W A"]  # row of the object that a positive anchor should detect


def assign(
    anchors: _Grid,
    boxes: BoxRows,
    *,
    positive: float = 0.6,
    negative: float = 0.6,
    best: float = 0.1,
    ignored: Float[np.ndarray, "k 7"] | None = None,
    margin: float = 0.0,
) -> Assignment:
    """Match anchors of a grid to objects by footprint IoU, with yaws snapped to 0 or 90°.

    An anchor is positive above `positive`, and so is the best anchor of each object if it reaches
    `best`. Up to `negative` it is negative; in between it is ignored. A negative anchor inside one
    of the boxes `ignored` is ignored too. margin: metres added to length and width of all boxes and
    anchors first.
    """
    ignored = boxes[:0] if ignored is None else ignored
    if margin:
        wider = np.array([0, 0, 0, margin, margin, 0, 0])
        anchors = anchors + wider
        boxes = boxes + wider
        ignored = ignored + wider
    overlap = np.zeros(anchors.shape[:3])
    owner = np.zeros(anchors.shape[:3], np.int64)
    best_anchors: list[tuple[tuple[int, ...], int]] = []
    for row, box in enumerate(boxes):
        window = _window(anchors, box, anchors[0, 0, :, 3:5].max() / 2)
        size = _snap_size(anchors[window])
        box_size = _snap_size(box)
        gap = np.abs(anchors[window][..., :2] - box[:2])
        smaller = np.minimum(size, box_size)
        shared_sides = np.minimum(smaller, (size + box_size) / 2 - gap).clip(0)
        overlap_area = shared_sides.prod(-1)
        iou = overlap_area / (size.prod(-1) + box_size.prod() - overlap_area)
        is_better = iou > overlap[window]
        overlap[window][is_better] = iou[is_better]
        owner[window][is_better] = row
        if iou.size and iou.max() >= best:
            i, j, yaw = map(int, np.unravel_index(np.argmax(iou), iou.shape))
            cell = (window[0].start + i, window[1].start + j)
            best_anchors.append(((*cell, yaw), row))
    labels = np.where(overlap <= negative, NEGATIVE, IGNORED)
    labels = np.where(overlap > positive, POSITIVE, labels).astype(np.int8)
    for anchor, row in best_anchors:
        labels[anchor] = POSITIVE
        owner[anchor] = row
    for box in ignored:
        window = _window(anchors, box, 0.0)
        dx, dy = np.moveaxis(anchors[window][..., :2] - box[:2], -1, 0)
        cos = np.cos(box[6])
        sin = np.sin(box[6])
        ahead = np.abs(dx * cos + dy * sin)
        aside = np.abs(dy * cos - dx * sin)
        is_within = (ahead <= box[3] / 2) & (aside <= box[4] / 2)
        is_negative = labels[window] == NEGATIVE
        labels[window][is_negative & is_within] = IGNORED
    return Assignment(labels, np.where(labels == POSITIVE, owner, 0))


def assign_by_kind(
    anchors: _Grid,
    kinds: Sequence[AnchorKind],
    boxes: BoxRows,
    labels: Int64[np.ndarray, " n"],
    is_required: Mask,
) -> Assignment:
    """Match anchors to objects of their class; owners are rows of `boxes`.

    is_required: objects that should be detected; negatives on other objects of the class are
    ignored.
    """
    parts = []
    first_anchor = 0
    for kind in kinds:
        end_anchor = first_anchor + len(kind.yaws)
        is_kind = labels == label_index(kind.label)
        rows = np.flatnonzero(is_kind & is_required)
        optional = boxes[is_kind & ~is_required]
        matching = {"positive": kind.positive, "negative": kind.negative, "margin": kind.margin}
        assignment = assign(
            anchors[:, :, first_anchor:end_anchor], boxes[rows], ignored=optional, **matching
        )
        owner = np.where(assignment.labels == POSITIVE, np.append(rows, 0)[assignment.owner], 0)
        parts.append(Assignment(assignment.labels, owner))
        first_anchor = end_anchor
    return Assignment(
        labels=np.concatenate([part.labels for part in parts], axis=2),
        owner=np.concatenate([part.owner for part in parts], axis=2),
    )


def sample(
    assignment: Assignment, rng: Rng, *, size: int = 256, positives: int = 128
) -> Assignment:
    """Keep `size` random anchors, as in the published training."""
    flat = assignment.labels.ravel()
    labels = np.full(assignment.labels.size, IGNORED, assignment.labels.dtype)
    for kind, max_count in ((POSITIVE, positives), (NEGATIVE, size)):
        rows = np.flatnonzero(flat == kind)
        room = min(max_count, size - int((labels == POSITIVE).sum()))
        if len(rows) > room:
            rows = rng.choice(rows, room, replace=False)
        labels[rows] = kind
    return Assignment(labels.reshape(assignment.labels.shape), assignment.owner)


def _window(anchors: np.ndarray, box: np.ndarray, reach: float) -> tuple[slice, slice]:
    """Rows and columns within `reach` (m) of a box's circle."""
    reach += np.hypot(box[3], box[4]) / 2
    rows = np.searchsorted(anchors[:, 0, 0, 0], [box[0] - reach, box[0] + reach])
    columns = np.searchsorted(anchors[0, :, 0, 1], [box[1] - reach, box[1] + reach])
    return slice(int(rows[0]), int(rows[1])), slice(int(columns[0]), int(columns[1]))


def _snap_size(boxes: np.ndarray) -> np.ndarray:
    yaw = boxes[..., 6:]
    is_across = np.abs(np.sin(yaw)) > np.abs(np.cos(yaw))
    return np.where(is_across, boxes[..., [4, 3]], boxes[..., [3, 4]])


def paper_loss(
    prediction: Prediction, labels: _Labels, boxes: _Targets, anchors: Tensor
) -> dict[str, Tensor]:
    """Published loss of sampled anchors: cross-entropy, and smooth L1 (σ = 3) of residuals.

    labels: from an `Assignment`; boxes: target of each positive anchor; anchors: (H, W, A, 7).
    """
    count = anchors.shape[2]
    logits = per_anchor(prediction.class_logits, count)
    counted = torch.nonzero(labels != IGNORED, as_tuple=True)
    classes = F.cross_entropy(
        logits[counted], (labels[counted] == POSITIVE).long(), reduction="sum"
    )
    positive = torch.nonzero(labels == POSITIVE, as_tuple=True)
    residuals = per_anchor(prediction.residuals, count)[positive]
    target = encode_residuals(boxes[positive], anchors[positive[1:]], doubled=False)
    box = F.smooth_l1_loss(residuals, target, beta=1 / 9, reduction="sum")
    return {"class": classes / max(len(counted[0]), 1), "box": box / max(len(positive[0]), 1)}


def quality_loss(
    prediction: Prediction,
    labels: _Labels,
    boxes: _Targets,
    anchors: Tensor,
    classes: Sequence[int] | None = None,
) -> dict[str, Tensor]:
    """Loss of class, box, direction and predicted IoU.

    The class has a focal loss (Lin et al. 2017), the box smooth L1 of residuals and 1 - IoU. A
    class's sums are divided by the number of its positive anchors. classes: class of each anchor of
    a cell (None: one class).
    """
    if prediction.direction_logits is None or prediction.quality_logits is None:
        raise ValueError('the quality loss needs a network with head="quality"')
    count = anchors.shape[2]
    maps = Prediction(
        *(per_anchor(channels, count) for channels in prediction if channels is not None)
    )
    assert maps.direction_logits is not None
    assert maps.quality_logits is not None
    kind = torch.tensor([0] * count if classes is None else list(classes), device=labels.device)
    positive = torch.nonzero(labels == POSITIVE, as_tuple=True)
    number = torch.bincount(kind[positive[3]], minlength=int(kind.max()) + 1).clamp(min=1)
    share = 1 / number[kind]  # weight of one anchor of its class, per anchor of a cell
    counted_share = share * (labels != IGNORED)
    class_loss = focal_loss(maps.class_logits[..., 0], labels == POSITIVE, counted_share)
    share_each = share[positive[3]]
    anchor = anchors[positive[1:]]
    target_boxes = boxes[positive]
    residuals = maps.residuals[positive]
    direction = maps.direction_logits[..., 0][positive]
    quality = maps.quality_logits[..., 0][positive]
    is_backwards = faces_back(target_boxes, anchor)
    overlap = nearly_aligned_iou(decode(residuals, anchor, is_backwards), target_boxes)
    target_residuals = encode_residuals(target_boxes, anchor)
    box_losses = F.smooth_l1_loss(residuals, target_residuals, beta=0.02, reduction="none").sum(1)
    cross_entropy = partial(F.binary_cross_entropy_with_logits, reduction="sum")
    # gradients are added in the reverse of this order
    box_loss = 2 * (share_each * box_losses).sum()
    iou_loss = (share_each * (1 - overlap)).sum()
    direction_loss = 0.2 * cross_entropy(direction, is_backwards.float(), share_each)
    quality_target = overlap.detach().clamp(0, 1)
    predicted_loss = 0.5 * cross_entropy(quality, quality_target, share_each)
    return {
        "class": class_loss,
        "box": box_loss,
        "iou": iou_loss,
        "direction": direction_loss,
        "quality": predicted_loss,
    }


def focal_loss(
    logits: Float[Tensor, "*n"], positive: Bool[Tensor, "*n"], counted: Shaped[Tensor, "*n"]
) -> Tensor:
    """Sum α (1 - p)² · cross-entropy · `counted` over anchors.

    p is the probability of the truth, and α is 0.25 for positive ones and 0.75 for others.
    """
    signed = torch.where(positive, logits, -logits)
    weight = torch.where(positive, 0.25, 0.75) * counted
    return -(weight * torch.sigmoid(-signed) ** 2.0 * F.logsigmoid(signed)).sum()


def nearly_aligned_iou(
    boxes: Float[Tensor, "n 7"], targets: Float[Tensor, "n 7"]
) -> Float[Tensor, " n"]:
    """3D IoU of box pairs, differentiable in any overlap, and exact for equal yaws.

    A yaw difference δ takes a quarter of the other side times sin δ off each shared side: the
    first-order loss of two rectangles turned about a common centre."""
    cos = torch.cos(targets[:, 6])
    sin = torch.sin(targets[:, 6])
    dx, dy, dz = (boxes - targets)[:, :3].unbind(1)
    gap = torch.stack((dx * cos + dy * sin, dy * cos - dx * sin, dz), 1).abs()
    size = boxes[:, 3:6]
    target = targets[:, 3:6]
    sin_difference = torch.sin(boxes[:, 6] - targets[:, 6]).abs()
    turned = sin_difference[:, None] * target[:, [1, 0]] / 4
    lost = torch.cat((turned, torch.zeros_like(turned[:, :1])), 1)
    smaller = torch.minimum(size, target)
    shared_sides = torch.minimum(smaller, (size + target) / 2 - gap) - lost
    shared = shared_sides.clamp(min=0).prod(1)
    return shared / (size.prod(1) + target.prod(1) - shared)
