"""Faces: a second stage that moves a box's faces to the end of the points, so that sizes are
measured, not recalled.

In the frame of a box (u ahead, v to the left, t above its floor) the points about a face are
counted by their distance beyond it, in steps of 4 cm and three zones:

    front, rear    low, middle and high: bumpers, bonnet or boot, windows
    left, right    low; high ahead; high behind: mirrors stand out high ahead only
    top            ahead, middle, behind

From these counts and those of the opposite face a tiny network per sort of face (end, side, top)
says how far outwards the face belongs (m), and how far off that may be. A face stays where the
answer is no nearer than the box already is, as where there are no points."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from toolkit.arrays import BoxRows, Float, Float32, Int64, Points
from toolkit.boxes import rows_in_boxes
from toolkit.objects import LABELS, Detections, label_index

STEP = 0.04  # m
# m, start of the counts inside the face, and their number
NEAREST = -0.6
BINS = 28
ZONES = 3
FLOOR_GAP = 0.2  # m above the floor of a box; lower points may be ground
BESIDE = 0.1  # m beside a face in which its points are counted too
LEAST_POINTS = 3  # points about a face or the one opposite, below which a face stays
HIDDEN = 56
SORTS = ("end", "side", "top")
_OWN = BINS * ZONES
_EXTRAS = 2 + 3 + len(LABELS)  # numbers of points, size of the box, its class


_BothSides = Float[np.ndarray, " 2*n"]


class FaceFeatures(NamedTuple):
    """Inputs of the networks for n boxes."""

    end: Float32[np.ndarray, "2*n F"]  # the fronts of all boxes, then their rears
    side: Float32[np.ndarray, "2*n F"]  # the left sides, then the right ones
    top: Float32[np.ndarray, "n F"]
    counted: tuple[Int64[np.ndarray, " 2*n"], Int64[np.ndarray, " 2*n"], Int64[np.ndarray, " n"]]


class FaceNetworks(nn.Module):
    """Three networks: features (n, F) to shifts outwards (m) and their log mean errors (m)."""

    # mean error of each sort of face as it is detected (m): a surer answer moves the face
    prior: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.end, self.side, self.top = (
            nn.Sequential(
                first, nn.ReLU(), nn.Linear(HIDDEN, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, 2)
            )
            for first in (
                nn.Linear(width + _EXTRAS, HIDDEN) for width in (2 * _OWN, 2 * _OWN, _OWN)
            )
        )
        self.register_buffer("prior", torch.full((len(SORTS),), np.inf))

    def answers(
        self, sort: str, features: Float[Tensor, "n F"]
    ) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
        """Shift outwards (m) and its log mean error (m) of faces of one sort."""
        shift, spread = getattr(self, sort)(features).unbind(1)
        return shift / 4, spread - 3

    @torch.inference_mode()
    def shifts(self, features: FaceFeatures) -> list[Float[np.ndarray, " k"]]:
        """Shift outwards (m) of each face, 0 without evidence."""
        found = []
        for sort, rows, counted, prior in zip(
            SORTS, features[:3], features.counted, self.prior, strict=True
        ):
            shift, spread = self.answers(sort, torch.from_numpy(rows))
            sure = (torch.exp(spread) < prior) & (torch.from_numpy(counted) >= LEAST_POINTS)
            found.append(torch.where(sure, shift, 0.0).double().numpy())
        return found


def measure_faces(
    networks: FaceNetworks, found: Detections, points: Points, labels: Sequence[str]
) -> Detections:
    """Move the faces of all boxes with these labels."""
    rows = np.flatnonzero(np.isin(found.labels, [label_index(label) for label in labels]))
    if not len(rows):
        return found
    boxes = found.boxes.copy()
    features = face_features(points, boxes[rows], found.labels[rows])
    boxes[rows] = move_faces(boxes[rows], *networks.shifts(features))
    return Detections(boxes, found.scores, found.labels)


def move_faces(
    boxes: BoxRows, end: _BothSides, side: _BothSides, top: Float[np.ndarray, " n"]
) -> BoxRows:
    """Move faces of boxes outwards (m), or inwards to a fifth of the size; the floor stays."""
    (front, rear), (left, right) = np.split(end, 2), np.split(side, 2)
    boxes = boxes.copy()
    grown = np.maximum(np.stack([front + rear, left + right, top], axis=1), -0.8 * boxes[:, 3:6])
    ahead = (front - rear) / 2
    aside = (left - right) / 2
    cos, sin = np.cos(boxes[:, 6]), np.sin(boxes[:, 6])
    boxes[:, 0] += ahead * cos - aside * sin
    boxes[:, 1] += ahead * sin + aside * cos
    boxes[:, 2] += grown[:, 2] / 2
    boxes[:, 3:6] += grown
    return boxes


def face_offsets(
    boxes: BoxRows, truths: BoxRows
) -> tuple[_BothSides, _BothSides, Float[np.ndarray, " n"]]:
    """Arguments of `move_faces` that turn boxes into true boxes, which may face the other way."""
    (dx, dy), cos, sin = (truths - boxes)[:, :2].T, np.cos(boxes[:, 6]), np.sin(boxes[:, 6])
    ahead = dx * cos + dy * sin
    aside = dy * cos - dx * sin
    grown = truths[:, 3:6] - boxes[:, 3:6]
    end = np.concatenate([grown[:, 0] / 2 + ahead, grown[:, 0] / 2 - ahead])
    side = np.concatenate([grown[:, 1] / 2 + aside, grown[:, 1] / 2 - aside])
    return end, side, truths[:, 2] - boxes[:, 2] + grown[:, 2] / 2


def face_features(
    points: Float[np.ndarray, "k 3"], boxes: BoxRows, labels: Int64[np.ndarray, " n"]
) -> FaceFeatures:
    """Count points about each face of each box."""
    # of the counts, beyond a face
    count = len(boxes)
    reach = NEAREST + STEP * BINS
    found = rows_in_boxes(
        points, boxes + np.array([0, 0, reach / 2, 2 * reach, 2 * reach, reach, 0])
    )
    row = np.repeat(np.arange(count), [len(each) for each in found])
    x, y, z = (
        points[np.concatenate([np.zeros(0, np.int64), *found])].astype(np.float64) - boxes[row, :3]
    ).T
    cos, sin, (length, width, height) = (
        np.cos(boxes[:, 6])[row],
        np.sin(boxes[:, 6])[row],
        boxes[row, 3:6].T,
    )
    u = x * cos + y * sin
    v = y * cos - x * sin
    t = z + height / 2
    near = (
        (np.abs(u) < length / 2 + reach)
        & (np.abs(v) < width / 2 + reach)
        & (t > FLOOR_GAP)
        & (t < height + reach)
    )
    row, u, v, t, length, width, height = (
        each[near] for each in (row, u, v, t, length, width, height)
    )
    across = np.abs(v) <= width / 2 + BESIDE
    along = np.abs(u) <= length / 2 + BESIDE
    band = (t >= 0.4 * height).astype(np.int64) + (t >= 0.7 * height)
    third = (u >= -length / 6).astype(np.int64) + (u >= length / 6)
    zone = np.where(t > 0.5 * height, 1 + (u > 0.05 * length), 0)
    end = np.stack([_counts(sign * u - length / 2, band, across, row, count) for sign in (1, -1)])
    side = np.stack([_counts(sign * v - width / 2, zone, along, row, count) for sign in (1, -1)])
    top = _counts(t - height, third, across & along, row, count)[None]
    kind = np.eye(len(LABELS))[labels]
    extras = np.column_stack([np.log(boxes[:, 3:6] / [4.5, 1.8, 1.6]), kind])
    (ends, by_end), (sides, by_side), (tops, by_top) = (
        _with_opposite(own, extras) for own in (end, side, top)
    )
    return FaceFeatures(ends, sides, tops, (by_end, by_side, by_top))


def _with_opposite(own: np.ndarray, extras: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Counts of each face and of the opposite one, size and class, as rows for a network; points of
    both faces."""
    faces = len(own)
    totals = own.sum(axis=2, keepdims=True)
    histograms = [own, own[::-1]] if faces == 2 else [own]
    parts = [np.log1p(each) for each in (*histograms, totals, totals[::-1])]
    rows = np.concatenate([*parts, np.broadcast_to(extras, (faces, *extras.shape))], axis=2)
    return rows.reshape(-1, rows.shape[2]).astype(np.float32), np.tile(
        totals.sum((0, 2)), faces
    ).astype(np.int64)


def _counts(
    distance: np.ndarray, zone: np.ndarray, chosen: np.ndarray, row: np.ndarray, boxes: int
) -> Float[np.ndarray, "n F"]:
    step = np.floor((distance - NEAREST) / STEP)
    inside = chosen & (step >= 0) & (step < BINS)
    place = (row[inside] * ZONES + zone[inside]) * BINS + step[inside].astype(np.int64)
    return np.bincount(place, minlength=boxes * _OWN).reshape(boxes, _OWN).astype(np.float64)
