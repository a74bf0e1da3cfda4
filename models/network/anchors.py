"""Anchors, and boxes as residuals to them (paper, section III-D; Zhou and Tuzel 2018).

Residuals of a box (x y z l w h ψ) to an anchor (a):

    Δx, Δy over √(l_a² + w_a²)    Δz over h_a    ln(l/l_a), ln(w/w_a), ln(h/h_a)    then the yaw, δ = ψ - ψ_a:
    published head:  δ                                    (a box and its half turn have far apart residuals)
    quality head:    sin 2δ, cos 2δ and a direction bit   (they have the same residuals; the bit tells them apart)
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from models.config import VoxelNetConfig
from toolkit.arrays import Bool, Float


def anchors(config: VoxelNetConfig) -> Float[Tensor, "H W A 7"]:
    """Return a box per cell, class and yaw in the frame of the grid, H along x, W along y.

    >>> anchors(VoxelNetConfig.published("tjunction"))[0, 0, 1]
    tensor([-39.8000, -19.8000,   1.6000,   3.9000,   1.5600,   1.6000,   1.5708])
    """
    (rows, columns), (dx, dy) = config.map_shape, config.stride
    x = config.area[0] + (torch.arange(rows, dtype=torch.float64) + 0.5) * dx
    y = config.area[1] + (torch.arange(columns, dtype=torch.float64) + 0.5) * dy
    each = [(kind.z, *kind.size, yaw) for kind in config.anchor_kinds for yaw in kind.yaws]
    boxes = torch.empty(rows, columns, len(each), 7)
    boxes[..., 0] = x[:, None, None]
    boxes[..., 1] = y[None, :, None]
    boxes[..., 2:] = torch.tensor(each)
    return boxes


def encode(
    boxes: Float[Tensor, "*n 7"], anchors: Float[Tensor, "*n 7"], *, doubled: bool = True
) -> Float[Tensor, "*n R"]:
    """Return residuals of boxes to anchors: eight with the doubled yaw difference, or seven with the plain one."""
    diagonal, size = torch.linalg.vector_norm(anchors[..., 3:5], dim=-1, keepdim=True), anchors[..., 3:6]
    delta = boxes - anchors
    centre, yaw = delta[..., :3] / torch.cat((diagonal, diagonal, size[..., 2:]), -1), delta[..., 6:]
    angle = (torch.sin(2 * yaw), torch.cos(2 * yaw)) if doubled else (yaw,)
    return torch.cat((centre, torch.log(boxes[..., 3:6] / size), *angle), -1)


def decode(
    residuals: Float[Tensor, "*n R"], anchors: Float[Tensor, "*n 7"], direction: Bool[Tensor, "*n"] | None = None
) -> Float[Tensor, "*n 7"]:
    """Return the boxes of residuals. Eight leave the yaw open by 180°, which `direction` settles.

    >>> anchor, box = torch.tensor([[0, 0, 0.8, 3.9, 1.6, 1.5, 0]]), torch.tensor([[1, 2, 0.7, 4.5, 1.8, 1.4, 3.0]])
    >>> decode(encode(box, anchor), anchor, faces_back(box, anchor))
    tensor([[1.0000, 2.0000, 0.7000, 4.5000, 1.8000, 1.4000, 3.0000]])
    """
    diagonal, size = torch.linalg.vector_norm(anchors[..., 3:5], dim=-1, keepdim=True), anchors[..., 3:6]
    centre = anchors[..., :3] + residuals[..., :3] * torch.cat((diagonal, diagonal, size[..., 2:]), -1)
    angle = residuals[..., 6:]
    delta = angle if angle.shape[-1] == 1 else torch.atan2(angle[..., :1], angle[..., 1:]) / 2
    if direction is not None:
        delta = delta + math.pi * direction[..., None]
    return torch.cat((centre, size * torch.exp(residuals[..., 3:6]), anchors[..., 6:] + delta), -1)


def faces_back(boxes: Float[Tensor, "*n 7"], anchors: Float[Tensor, "*n 7"]) -> Bool[Tensor, "*n"]:
    """Mark boxes headed more than 90° off their anchor."""
    return torch.cos(boxes[..., 6] - anchors[..., 6]) < 0


def per_anchor(channels: Float[Tensor, "B Ak H W"], anchors: int) -> Float[Tensor, "B H W A k"]:
    """Reshape a map of the head by cell and anchor."""
    items, _, rows, columns = channels.shape
    return channels.view(items, anchors, -1, rows, columns).permute(0, 3, 4, 1, 2)
