"""Which anchor should find which object, and which anchors are left out of the loss."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float, Int64, Shaped

NEGATIVE, POSITIVE, IGNORED = 0, 1, -1


class Assignment(NamedTuple):
    """labels: POSITIVE, NEGATIVE or IGNORED per anchor; owner: the object a positive anchor should find, else 0."""

    labels: Shaped[np.ndarray, " N"]
    owner: Int64[np.ndarray, " N"]


def assign(
    anchors: Float[np.ndarray, "N 7"],
    boxes: Float[np.ndarray, "n 7"],
    *,
    positive: float = 0.6,
    negative: float = 0.6,
    best: float = 0.1,
    ignored: Float[np.ndarray, "k 7"] | None = None,
) -> Assignment:
    """Match anchors to objects by the IoU of their footprints, yaws snapped to 0 or 90° (VoxelNet, section 2.2).

    An anchor is positive above `positive`, and so is the best anchor of each object if it reaches `best`. Below
    `negative` it is negative, between the two ignored. An anchor that would be negative but stands within one of the
    `ignored` boxes is ignored.

    >>> anchors = np.array([[0, 0, 0.8, 4, 2, 1.6, 0], [9, 0, 0.8, 4, 2, 1.6, 0]])
    >>> assign(anchors, np.array([[0.5, 0, 0.7, 4, 2, 1.5, 3.1]])).labels
    array([1, 0], dtype=int8)
    """
    overlap = np.zeros(len(anchors), np.float32)
    owner = np.zeros(len(anchors), np.int64)
    forced: list[tuple[int, int]] = []
    for index, box in enumerate(boxes):
        near, iou = _snapped_iou(anchors, box)
        better = iou > overlap[near]
        overlap[near[better]], owner[near[better]] = iou[better], index
        if len(iou) and iou.max() >= best:
            forced.append((int(near[np.argmax(iou)]), index))
    labels = np.where(overlap > positive, POSITIVE, np.where(overlap < negative, NEGATIVE, IGNORED)).astype(np.int8)
    if positive == negative:
        labels[labels == IGNORED] = NEGATIVE
    for anchor, index in forced:
        labels[anchor], owner[anchor] = POSITIVE, index
    if ignored is not None and len(ignored):
        labels[(labels == NEGATIVE) & _centres_within(anchors, ignored)] = IGNORED
    return Assignment(labels, np.where(labels == POSITIVE, owner, 0))


def sample(assignment: Assignment, rng: np.random.Generator, *, size: int = 256, positives: int = 128) -> Assignment:
    """Keep `size` random anchors, at most `positives` of them positive; ignore the rest (the published training)."""
    chosen_positive = _choose(assignment.labels == POSITIVE, positives, rng)
    chosen_negative = _choose(assignment.labels == NEGATIVE, size - len(chosen_positive), rng)
    labels = np.full_like(assignment.labels, IGNORED)
    labels[chosen_positive], labels[chosen_negative] = POSITIVE, NEGATIVE
    return Assignment(labels, assignment.owner)


def _snapped_iou(anchors: np.ndarray, box: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The anchors that can overlap a box, and their axis-aligned IoU with it."""
    reach = float(box[3:5].max() + anchors[:, 3:5].max()) / 2
    near = np.flatnonzero((np.abs(anchors[:, 0] - box[0]) < reach) & (np.abs(anchors[:, 1] - box[1]) < reach))
    size, box_size = _snapped_size(anchors[near]), _snapped_size(box[None])
    gap = np.abs(anchors[near, :2] - box[:2])
    shared = np.minimum(np.minimum(size, box_size), (size + box_size) / 2 - gap).clip(0).prod(axis=1)
    return near, (shared / (size.prod(axis=1) + box_size.prod() - shared)).astype(np.float32)


def _snapped_size(boxes: np.ndarray) -> np.ndarray:
    """Extent along x and y after the yaw is snapped to the nearest multiple of 90°."""
    across = np.abs(np.sin(boxes[:, 6])) > np.abs(np.cos(boxes[:, 6]))
    return np.where(across[:, None], boxes[:, [4, 3]], boxes[:, [3, 4]])


def _centres_within(anchors: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    inside = np.zeros(len(anchors), bool)
    for x, y, _, length, width, _, yaw in boxes:
        dx, dy = anchors[:, 0] - x, anchors[:, 1] - y
        along, across = dx * np.cos(yaw) + dy * np.sin(yaw), dy * np.cos(yaw) - dx * np.sin(yaw)
        inside |= (np.abs(along) <= length / 2) & (np.abs(across) <= width / 2)
    return inside


def _choose(mask: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    rows = np.flatnonzero(mask)
    return rows if len(rows) <= count else rng.choice(rows, count, replace=False)
