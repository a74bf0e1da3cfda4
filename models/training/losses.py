"""Training losses: the published one, and one that also learns direction and how good each box is."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional as F

from models.network.anchors import decode, encode, faces_back, per_anchor
from models.network.voxelnet import Prediction
from models.training.targets import IGNORED, POSITIVE
from toolkit.arrays import Bool, Float, Shaped


def published_loss(
    prediction: Prediction, labels: Shaped[Tensor, "B H W A"], boxes: Float[Tensor, "B H W A 7"], anchors: Tensor
) -> dict[str, Tensor]:
    """Cross-entropy over the sampled anchors, and smooth L1 (σ = 3) of the positives' seven residuals.

    labels: see `models.training.targets`; boxes: what each positive anchor should find; anchors: (H, W, A, 7).
    """
    count = anchors.shape[2]
    logits = per_anchor(prediction.class_logits, count)
    counted = torch.nonzero(labels != IGNORED, as_tuple=True)
    classes = F.cross_entropy(logits[counted], (labels[counted] == POSITIVE).long(), reduction="sum")
    positive = torch.nonzero(labels == POSITIVE, as_tuple=True)
    residuals = per_anchor(prediction.residuals, count)[positive]
    target = encode(boxes[positive], anchors[positive[1:]], doubled=False)
    box = F.smooth_l1_loss(residuals, target, beta=1 / 9, reduction="sum")
    return {"class": classes / max(len(counted[0]), 1), "box": box / max(len(positive[0]), 1)}


def quality_loss(
    prediction: Prediction,
    labels: Shaped[Tensor, "B H W A"],
    boxes: Float[Tensor, "B H W A 7"],
    anchors: Tensor,
    classes: Sequence[int] | None = None,
) -> dict[str, Tensor]:
    """Focal loss (Lin et al. 2017) for the class; smooth L1 of residuals and 1 - IoU for the box; direction; predicted
    IoU. Each class's sums are divided by the number of its own positive anchors, so that none drowns the others.

    classes: the class of each anchor of a cell (None: all of one); other arguments as in `published_loss`.
    """
    if prediction.direction_logits is None or prediction.quality_logits is None:
        raise ValueError('the quality loss needs a network with head="quality"')
    count = anchors.shape[2]
    maps = Prediction(*(per_anchor(each, count) for each in prediction if each is not None))
    assert maps.direction_logits is not None
    assert maps.quality_logits is not None
    kind = torch.tensor([0] * count if classes is None else list(classes), device=labels.device)
    positive = torch.nonzero(labels == POSITIVE, as_tuple=True)
    number = torch.bincount(kind[positive[3]], minlength=int(kind.max()) + 1).clamp(min=1)
    share = 1 / number[kind]  # per anchor of a cell: what one of its class counts
    classes_lost = focal_loss(maps.class_logits[..., 0], labels == POSITIVE, share * (labels != IGNORED))
    each = share[positive[3]]
    anchor, wanted = anchors[positive[1:]], boxes[positive]
    residuals = maps.residuals[positive]
    direction = maps.direction_logits[..., 0][positive]
    quality = maps.quality_logits[..., 0][positive]

    backwards = faces_back(wanted, anchor)
    overlap = nearly_aligned_iou(decode(residuals, anchor, backwards), wanted)
    box = F.smooth_l1_loss(residuals, encode(wanted, anchor), beta=0.02, reduction="none").sum(1)
    return {
        "class": classes_lost,
        "box": 2 * (each * box).sum(),
        "iou": (each * (1 - overlap)).sum(),
        "direction": 0.2 * _cross_entropy(direction, backwards.float(), each),
        "quality": 0.5 * _cross_entropy(quality, overlap.detach().clamp(0, 1), each),
    }


def focal_loss(
    logits: Float[Tensor, "*n"],
    positive: Bool[Tensor, "*n"],
    counted: Bool[Tensor, "*n"] | Float[Tensor, "*n"],
    *,
    alpha: float = 0.25,
    gamma: float = 2.0,
) -> Tensor:
    """Sum over the anchors of α (1 - p)^γ · cross-entropy times what each counts (bool: all or nothing), where p is the
    probability of what is true."""
    signed = torch.where(positive, logits, -logits)
    weight = torch.where(positive, alpha, 1 - alpha) * counted
    return -(weight * torch.sigmoid(-signed) ** gamma * F.logsigmoid(signed)).sum()


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


def _cross_entropy(logits: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    return F.binary_cross_entropy_with_logits(logits, target, weight, reduction="sum")
