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

_Labels = Shaped[Tensor, "B H W A"]  # POSITIVE, NEGATIVE or IGNORED for each anchor
_Targets = Float[Tensor, "B H W A 7"]  # boxes that positive anchors should detect
_Grid = Float[np.ndarray, "H W A 7"]  # boxes of anchors: H cells along x, W along y, A in a cell
NEGATIVE = 0
POSITIVE = 1
IGNORED = -1


class Assignment(NamedTuple):
    """Targets of the anchors.

    Attributes:
        labels: POSITIVE, NEGATIVE or IGNORED.
        owner: Row of the object that a positive anchor should detect; 0 for other anchors.
    """

    labels: Shaped[np.ndarray, "H W A"]
    owner: Int64[np.ndarray, "H W A"]


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
    # a box is x, y, z, length, width, height, yaw
    if margin:
        wider = np.array([0, 0, 0, margin, margin, 0, 0])
        anchors = anchors + wider
        boxes = boxes + wider
        ignored = ignored + wider
    best_iou = np.zeros(anchors.shape[:3])  # each anchor's with any object
    owner = np.zeros(anchors.shape[:3], np.int64)
    # index (row, column, anchor of the cell) of an anchor, and row of its object
    best_anchors: list[tuple[tuple[int, ...], int]] = []
    max_half_side = anchors[0, 0, :, 3:5].max() / 2
    for row, box in enumerate(boxes):
        window = _window(anchors, box, max_half_side)  # `[window]` is a view
        size = _snap_size(anchors[window])
        box_size = _snap_size(box)
        gap = np.abs(anchors[window][..., :2] - box[:2])  # between the centres, along x and y
        overlap_sides = np.minimum(np.minimum(size, box_size), (size + box_size) / 2 - gap)
        overlap_area = overlap_sides.clip(0).prod(-1)
        iou = overlap_area / (size.prod(-1) + box_size.prod() - overlap_area)
        is_better = iou > best_iou[window]
        best_iou[window][is_better] = iou[is_better]
        owner[window][is_better] = row
        if iou.size and iou.max() >= best:
            i, j, k = map(int, np.unravel_index(np.argmax(iou), iou.shape))
            best_anchors.append(((window[0].start + i, window[1].start + j, k), row))
    labels = np.where(best_iou <= negative, NEGATIVE, IGNORED)
    labels = np.where(best_iou > positive, POSITIVE, labels).astype(np.int8)
    for anchor, row in best_anchors:
        labels[anchor] = POSITIVE
        owner[anchor] = row
    for box in ignored:
        length, width = box[3:5]
        yaw = box[6]
        window = _window(anchors, box, 0.0)
        dx, dy = np.moveaxis(anchors[window][..., :2] - box[:2], -1, 0)
        cos = np.cos(yaw)
        sin = np.sin(yaw)
        ahead = np.abs(dx * cos + dy * sin)
        aside = np.abs(dy * cos - dx * sin)
        is_within = (ahead <= length / 2) & (aside <= width / 2)
        labels[window][(labels[window] == NEGATIVE) & is_within] = IGNORED
    return Assignment(labels, np.where(labels == POSITIVE, owner, 0))


def assign_by_kind(
    anchors: _Grid,
    kinds: Sequence[AnchorKind],
    boxes: BoxRows,
    labels: Int64[np.ndarray, " n"],
    is_required: Mask,
) -> Assignment:
    """Match anchors to objects of their class; owners are rows of `boxes`.

    kinds: classes of anchors, in the order of the anchors of a cell. labels: class of each box.
    is_required: True for objects that should be detected. Inside the other boxes of an anchor's
    class it may detect something or not: an anchor that would be negative there is ignored.
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
        # `assignment.owner` is an index in `rows`, and 0 for anchors without an owner. One more row
        # makes 0 valid if `rows` is empty.
        owner_rows = np.append(rows, 0)
        owner = np.where(assignment.labels == POSITIVE, owner_rows[assignment.owner], 0)
        parts.append(Assignment(assignment.labels, owner))
        first_anchor = end_anchor
    return Assignment(
        labels=np.concatenate([assignment.labels for assignment in parts], axis=2),
        owner=np.concatenate([assignment.owner for assignment in parts], axis=2),
    )


def sample(
    assignment: Assignment, rng: Rng, *, size: int = 256, positives: int = 128
) -> Assignment:
    """Assignment with `size` random anchors, the others ignored, as in the published training.

    positives: greatest number of positive anchors; negative ones fill up to `size`.
    """
    flat_labels = assignment.labels.ravel()
    labels = np.full(assignment.labels.size, IGNORED, assignment.labels.dtype)
    # the positive ones first, then as many negative ones as there is room for
    for label, max_count in ((POSITIVE, positives), (NEGATIVE, size)):
        rows = np.flatnonzero(flat_labels == label)
        room = min(max_count, size - int((labels == POSITIVE).sum()))
        labels[rows if len(rows) <= room else rng.choice(rows, room, replace=False)] = label
    return Assignment(labels.reshape(assignment.labels.shape), assignment.owner)


def _window(anchors: np.ndarray, box: np.ndarray, reach: float) -> tuple[slice, slice]:
    """Rows and columns of cells within `reach` (m) of the circle about a box.

    anchors: (rows, columns, anchors of a cell, 7) boxes; box: x, y, z, length, width, ... (m)."""
    x, y = box[:2]
    length, width = box[3:5]
    reach += np.hypot(length, width) / 2
    # x of each row and y of each column of cells, both ascending
    first_row, end_row = np.searchsorted(anchors[:, 0, 0, 0], [x - reach, x + reach])
    first_column, end_column = np.searchsorted(anchors[0, :, 0, 1], [y - reach, y + reach])
    return slice(int(first_row), int(end_row)), slice(int(first_column), int(end_column))


def _snap_size(boxes: Float[np.ndarray, "*n 7"]) -> Float[np.ndarray, "*n 2"]:
    """Extents of boxes along x and y (m) after their yaw is rounded to 0 or 90°."""
    yaw = boxes[..., 6:]
    is_across = np.abs(np.sin(yaw)) > np.abs(np.cos(yaw))
    return np.where(is_across, boxes[..., [4, 3]], boxes[..., [3, 4]])


def paper_loss(
    prediction: Prediction, labels: _Labels, boxes: _Targets, anchors: Tensor
) -> dict[str, Tensor]:
    """Published loss of sampled anchors, by its parts: "class" (cross-entropy) and "box" (smooth L1
    of residuals, σ = 3).

    labels: from an `Assignment`; boxes: target of each positive anchor; anchors: (H, W, A, 7).
    """
    count = anchors.shape[2]
    logits = per_anchor(prediction.class_logits, count)
    # indices of the item, row, column and anchor
    counted_anchors = torch.nonzero(labels != IGNORED, as_tuple=True)
    positive_anchors = torch.nonzero(labels == POSITIVE, as_tuple=True)
    class_loss = F.cross_entropy(
        logits[counted_anchors], (labels[counted_anchors] == POSITIVE).long(), reduction="sum"
    )
    residuals = per_anchor(prediction.residuals, count)[positive_anchors]
    targets = encode_residuals(
        boxes[positive_anchors], anchors[positive_anchors[1:]], doubled=False
    )
    box_loss = F.smooth_l1_loss(residuals, targets, beta=1 / 9, reduction="sum")  # 1 / σ²
    return {
        "class": class_loss / max(len(counted_anchors[0]), 1),
        "box": box_loss / max(len(positive_anchors[0]), 1),
    }


def quality_loss(
    prediction: Prediction,
    labels: _Labels,
    boxes: _Targets,
    anchors: Tensor,
    classes: Sequence[int] | None = None,
) -> dict[str, Tensor]:
    """Loss by its parts: "class", "box", "iou", "direction" and "quality" (the predicted IoU).

    The class has a focal loss (Lin et al. 2017), the box smooth L1 of residuals and 1 - IoU. A
    class's sums are divided by the number of its positive anchors.

    labels: from an `Assignment`; boxes: target of each positive anchor; anchors: (H, W, A, 7);
    classes: class of each anchor of a cell (None: one class).
    """
    if prediction.direction_logits is None or prediction.quality_logits is None:
        raise ValueError('the quality loss needs a network with head="quality"')
    count = anchors.shape[2]
    maps = Prediction(
        *(per_anchor(channels, count) for channels in prediction if channels is not None)
    )
    assert maps.direction_logits is not None
    assert maps.quality_logits is not None
    # class of each anchor of a cell
    anchor_class = torch.tensor(
        [0] * count if classes is None else list(classes), device=labels.device
    )
    # indices of the item, row, column and anchor
    positive = torch.nonzero(labels == POSITIVE, as_tuple=True)
    # number by class; `positive[3]` has the anchor within its cell
    positives = torch.bincount(
        anchor_class[positive[3]], minlength=int(anchor_class.max()) + 1
    ).clamp(min=1)
    weight = 1 / positives[anchor_class]  # for each anchor of a cell
    class_loss = focal_loss(
        maps.class_logits[..., 0], labels == POSITIVE, weight * (labels != IGNORED)
    )
    positive_weight = weight[positive[3]]
    anchor_boxes = anchors[positive[1:]]
    target_boxes = boxes[positive]
    residuals = maps.residuals[positive]
    direction = maps.direction_logits[..., 0][positive]
    quality = maps.quality_logits[..., 0][positive]
    is_backwards = faces_back(target_boxes, anchor_boxes)
    iou = nearly_aligned_iou(decode(residuals, anchor_boxes, is_backwards), target_boxes)
    box_loss = F.smooth_l1_loss(
        residuals, encode_residuals(target_boxes, anchor_boxes), beta=0.02, reduction="none"
    ).sum(1)
    cross_entropy = partial(F.binary_cross_entropy_with_logits, reduction="sum")
    # gradients are added in the reverse of this order
    return {
        "class": class_loss,
        "box": 2 * (positive_weight * box_loss).sum(),
        "iou": (positive_weight * (1 - iou)).sum(),
        "direction": 0.2 * cross_entropy(direction, is_backwards.float(), positive_weight),
        "quality": 0.5 * cross_entropy(quality, iou.detach().clamp(0, 1), positive_weight),
    }


def focal_loss(
    logits: Float[Tensor, "*n"], positive: Bool[Tensor, "*n"], counted: Shaped[Tensor, "*n"]
) -> Tensor:
    """Sum of α (1 - p)² · cross-entropy · `counted` over anchors.

    p is the probability of the truth, and α is 0.25 for positive anchors and 0.75 for others.
    logits: probability that each anchor is positive, as a logit; counted: weight of each anchor, 0
    for ignored ones.
    """
    true_logits = torch.where(positive, logits, -logits)  # p = sigmoid(true_logits)
    weight = torch.where(positive, 0.25, 0.75) * counted
    return -(weight * torch.sigmoid(-true_logits) ** 2.0 * F.logsigmoid(true_logits)).sum()


def nearly_aligned_iou(
    boxes: Float[Tensor, "n 7"], targets: Float[Tensor, "n 7"]
) -> Float[Tensor, " n"]:
    """3D IoU of each box and its target, differentiable in any overlap, and exact for equal yaws.

    A yaw difference δ takes a quarter of the other side times sin δ off each shared side: the
    first-order loss of two rectangles turned about a common centre. boxes, targets: x, y, z,
    length, width, height (m), yaw (rad)."""
    target_yaw = targets[:, 6]
    cos = torch.cos(target_yaw)
    sin = torch.sin(target_yaw)
    dx, dy, dz = (boxes - targets)[:, :3].unbind(1)
    # between the centres, along the target's length, width and height
    gap = torch.stack((dx * cos + dy * sin, dy * cos - dx * sin, dz), 1).abs()
    size = boxes[:, 3:6]
    target_size = targets[:, 3:6]
    # lost of the shared length and width; the height loses nothing
    turn_loss = torch.sin(boxes[:, 6] - target_yaw).abs()[:, None] * target_size[:, [1, 0]] / 4
    loss = torch.cat((turn_loss, torch.zeros_like(turn_loss[:, :1])), 1)
    shared_size = torch.minimum(torch.minimum(size, target_size), (size + target_size) / 2 - gap)
    overlap = (shared_size - loss).clamp(min=0).prod(1)  # volume
    return overlap / (size.prod(1) + target_size.prod(1) - overlap)
