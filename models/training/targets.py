"""Which anchor should find which object, and which are left out of the loss (Zhou and Tuzel 2018, section 2.2)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from models.config import AnchorKind
from toolkit.arrays import Bool, Float, Int64, Shaped
from toolkit.objects import label_index

NEGATIVE, POSITIVE, IGNORED = 0, 1, -1


class Assignment(NamedTuple):
    """labels: POSITIVE, NEGATIVE or IGNORED per anchor; owner: row of the object that a positive one should find."""

    labels: Shaped[np.ndarray, "H W A"]
    owner: Int64[np.ndarray, "H W A"]


def assign(
    anchors: Float[np.ndarray, "H W A 7"],
    boxes: Float[np.ndarray, "n 7"],
    *,
    positive: float = 0.6,
    negative: float = 0.6,
    best: float = 0.1,
    ignored: Float[np.ndarray, "k 7"] | None = None,
    margin: float = 0.0,
) -> Assignment:
    """Match the anchors of a grid to objects by the IoU of their footprints, yaws snapped to 0 or 90°.

    An anchor is positive above `positive`, and so is the best anchor of each object if it reaches `best`. Up to
    `negative` it is negative, between the two ignored. An anchor that would be negative but stands within one of the
    boxes `ignored` is ignored. margin: by which length and width of all boxes and anchors are enlarged before (m).

    >>> anchors = np.array([[0, 0, 0.8, 4, 2, 1.6, 0], [9, 0, 0.8, 4, 2, 1.6, 0]]).reshape(2, 1, 1, 7)
    >>> assign(anchors, np.array([[0.5, 0, 0.7, 4, 2, 1.5, 3.1]])).labels.ravel()
    array([1, 0], dtype=int8)
    """
    if margin:
        anchors, boxes = _enlarged(anchors, margin), _enlarged(boxes, margin)
        ignored = None if ignored is None else _enlarged(ignored, margin)
    shape = anchors.shape[:3]
    overlap, owner = np.zeros(shape), np.zeros(shape, np.int64)
    forced: list[tuple[tuple[int, ...], int]] = []
    for row, box in enumerate(boxes):
        near = _window(anchors, box, anchors[0, 0, :, 3:5].max() / 2)
        iou = _snapped_iou(anchors[near], box)
        better = iou > overlap[near]
        overlap[near][better], owner[near][better] = iou[better], row
        if iou.size and iou.max() >= best:
            i, j, yaw = (int(at) for at in np.unravel_index(np.argmax(iou), iou.shape))
            forced.append(((near[0].start + i, near[1].start + j, yaw), row))
    labels = np.where(overlap > positive, POSITIVE, np.where(overlap <= negative, NEGATIVE, IGNORED)).astype(np.int8)
    for place, row in forced:
        labels[place], owner[place] = POSITIVE, row
    for box in () if ignored is None else ignored:
        near = _window(anchors, box, 0.0)
        labels[near][(labels[near] == NEGATIVE) & _centred_within(anchors[near], box)] = IGNORED
    return Assignment(labels, np.where(labels == POSITIVE, owner, 0))


def assign_by_kind(
    anchors: Float[np.ndarray, "H W A 7"],
    kinds: Sequence[AnchorKind],
    boxes: Float[np.ndarray, "n 7"],
    labels: Int64[np.ndarray, " n"],
    asked: Bool[np.ndarray, " n"],
) -> Assignment:
    """Match the anchors of each kind to the objects of its class alone. asked: objects that should be found; negatives
    on the others of that class are ignored. Owners are rows of `boxes`."""
    parts, first = [], 0
    for kind in kinds:
        last = first + len(kind.yaws)
        own = labels == label_index(kind.label)
        rows = np.flatnonzero(own & asked)
        found = assign(
            anchors[:, :, first:last], boxes[rows], positive=kind.positive, negative=kind.negative,
            ignored=boxes[own & ~asked], margin=kind.margin,
        )  # fmt: skip
        owner = np.where(found.labels == POSITIVE, np.append(rows, 0)[found.owner], 0)
        parts.append(Assignment(found.labels, owner))
        first = last
    return Assignment(*(np.concatenate(column, axis=2) for column in zip(*parts, strict=True)))


def sample(assignment: Assignment, rng: np.random.Generator, *, size: int = 256, positives: int = 128) -> Assignment:
    """Keep `size` random anchors, at most `positives` of them positive; ignore the rest (the published training)."""
    flat = assignment.labels.ravel()
    chosen_positive = _choose(flat == POSITIVE, positives, rng)
    chosen_negative = _choose(flat == NEGATIVE, size - len(chosen_positive), rng)
    labels = np.full_like(flat, IGNORED)
    labels[chosen_positive], labels[chosen_negative] = POSITIVE, NEGATIVE
    return Assignment(labels.reshape(assignment.labels.shape), assignment.owner)


def _enlarged(boxes: np.ndarray, margin: float) -> np.ndarray:
    larger = np.array(boxes)
    larger[..., 3:5] += margin
    return larger


def _window(anchors: np.ndarray, box: np.ndarray, reach: float) -> tuple[slice, slice]:
    """Rows and columns of the grid within `reach` (m) of the circle round a box: no others can touch it."""
    reach += np.hypot(box[3], box[4]) / 2
    rows = np.searchsorted(anchors[:, 0, 0, 0], [box[0] - reach, box[0] + reach])
    columns = np.searchsorted(anchors[0, :, 0, 1], [box[1] - reach, box[1] + reach])
    return slice(int(rows[0]), int(rows[1])), slice(int(columns[0]), int(columns[1]))


def _snapped_iou(anchors: np.ndarray, box: np.ndarray) -> Float[np.ndarray, "h w A"]:
    """Axis-aligned IoU of anchors and a box, each turned to the nearest multiple of 90°."""
    size, box_size = _snapped_size(anchors), _snapped_size(box)
    gap = np.abs(anchors[..., :2] - box[:2])
    shared = np.minimum(np.minimum(size, box_size), (size + box_size) / 2 - gap).clip(0).prod(-1)
    return shared / (size.prod(-1) + box_size.prod() - shared)


def _snapped_size(boxes: np.ndarray) -> np.ndarray:
    """Extent along x and y after the yaw is snapped to the nearest multiple of 90°."""
    across = np.abs(np.sin(boxes[..., 6:])) > np.abs(np.cos(boxes[..., 6:]))
    return np.where(across, boxes[..., [4, 3]], boxes[..., [3, 4]])


def _centred_within(anchors: np.ndarray, box: np.ndarray) -> Bool[np.ndarray, "h w A"]:
    (dx, dy), (cos, sin) = np.moveaxis(anchors[..., :2] - box[:2], -1, 0), (np.cos(box[6]), np.sin(box[6]))
    return (np.abs(dx * cos + dy * sin) <= box[3] / 2) & (np.abs(dy * cos - dx * sin) <= box[4] / 2)


def _choose(mask: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    rows = np.flatnonzero(mask)
    return rows if len(rows) <= count else rng.choice(rows, count, replace=False)
