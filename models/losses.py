"""Training losses: the published one, and one that also learns direction and how good each box is."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from models.anchors import decode, encode, faces_back, per_anchor
from models.targets import IGNORED, POSITIVE
from models.voxelnet import Prediction
from toolkit.arrays import Float


def published_loss(
    prediction: Prediction, labels: Float[Tensor, "B H W A"], boxes: Tensor, anchors: Float[Tensor, "H W A 7"]
) -> dict[str, Tensor]:
    """Cross-entropy over the sampled anchors, and smooth L1 (σ = 3) of the positives' seven residuals.

    labels: see `models.targets`; boxes (B, H, W, A, 7): what each positive anchor should find.
    """
    count = anchors.shape[2]
    logits = per_anchor(prediction.class_logits, count)
    chosen = labels != IGNORED
    classes = F.cross_entropy(logits[chosen], (labels[chosen] == POSITIVE).long())
    positive = labels == POSITIVE
    residuals = per_anchor(prediction.residuals, count)[positive]
    target = encode(boxes[positive], anchors.expand_as(boxes)[positive], doubled=False)
    box = F.smooth_l1_loss(residuals, target, beta=1 / 9, reduction="sum") / positive.sum().clamp(min=1)
    return {"class": classes, "box": box}


def quality_loss(
    prediction: Prediction, labels: Float[Tensor, "B H W A"], boxes: Tensor, anchors: Float[Tensor, "H W A 7"]
) -> dict[str, Tensor]:
    """Focal loss (Lin et al. 2017) for the class; L1 of residuals and 1 - IoU for the box; direction; predicted IoU."""
    if prediction.direction_logits is None or prediction.quality_logits is None:
        raise ValueError('the quality loss needs a network with head="quality"')
    count = anchors.shape[2]
    logits = per_anchor(prediction.class_logits, count)[..., 0]
    positive = labels == POSITIVE
    number = positive.sum().clamp(min=1)
    anchor, wanted = anchors.expand_as(boxes)[positive], boxes[positive]
    residuals = per_anchor(prediction.residuals, count)[positive]
    backwards = faces_back(wanted, anchor)
    overlap = nearly_aligned_iou(decode(residuals, anchor, backwards), wanted)
    direction = per_anchor(prediction.direction_logits, count)[..., 0][positive]
    quality = per_anchor(prediction.quality_logits, count)[..., 0][positive]
    return {
        "class": focal_loss(logits, positive, labels != IGNORED) / number,
        "box": 2 * F.smooth_l1_loss(residuals, encode(wanted, anchor), beta=0.02, reduction="sum") / number,
        "iou": (1 - overlap).sum() / number,
        "direction": 0.2 * F.binary_cross_entropy_with_logits(direction, backwards.float(), reduction="sum") / number,
        "quality": 0.5
        * F.binary_cross_entropy_with_logits(quality, overlap.detach().clamp(0, 1), reduction="sum")
        / number,
    }


def focal_loss(logits: Tensor, positive: Tensor, counted: Tensor, *, alpha: float = 0.25, gamma: float = 2.0) -> Tensor:
    """Sum over the counted anchors of α (1 - p)^γ · cross-entropy."""
    logits, target = logits[counted], positive[counted].float()
    probability = torch.sigmoid(logits)
    miss = torch.where(target > 0, 1 - probability, probability)
    weight = torch.where(target > 0, alpha, 1 - alpha) * miss**gamma
    return (weight * F.binary_cross_entropy_with_logits(logits, target, reduction="none")).sum()


def nearly_aligned_iou(boxes: Float[Tensor, "n 7"], wanted: Float[Tensor, "n 7"]) -> Float[Tensor, " n"]:
    """3D IoU of each box with the one beside it, exact where their yaws agree, differentiable everywhere they overlap.

    A yaw difference δ takes a quarter of the other side times sin δ off each shared side, the first-order loss of two
    rectangles turned against each other about a common centre.
    """
    cos, sin = torch.cos(wanted[:, 6]), torch.sin(wanted[:, 6])
    dx, dy, dz = (boxes - wanted)[:, :3].unbind(1)
    gap = torch.stack((dx * cos + dy * sin, dy * cos - dx * sin, dz), 1).abs()
    size, target = boxes[:, 3:6], wanted[:, 3:6]
    turned = torch.sin(boxes[:, 6] - wanted[:, 6]).abs()[:, None] * target[:, [1, 0]] / 4
    lost = torch.cat((turned, torch.zeros_like(turned[:, :1])), 1)
    shared = (torch.minimum(torch.minimum(size, target), (size + target) / 2 - gap) - lost).clamp(min=0).prod(1)
    return shared / (size.prod(1) + target.prod(1) - shared)
