"""Faces: a second stage that moves a box's faces to the end of the points, so that sizes are
measured.

In the frame of a box (u ahead, v to the left, t above its floor) the points about a face are
counted by their distance beyond it, in steps of 4 cm and three zones:

    front, rear    low, middle and high: bumpers, bonnet or boot, windows
    left, right    low; high ahead; high behind: mirrors stick out only high ahead
    top            ahead, middle, behind

From these counts and the opposite face's, a tiny network per sort of face (end, side, top)
estimates how far outwards the face belongs (m), and its error. A face stays if the estimate
is no better than the box, for example without points.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from toolkit.arrays import BoxRows, Float, Float32, Int64, Points
from toolkit.boxes import rows_in_boxes
from toolkit.objects import LABELS, Detections, label_index

BIN_M = 0.04
FIRST_BIN_M = -0.6  # start of the counts, inside the face
BIN_COUNT = 28
ZONES = 3
FLOOR_GAP_M = 0.2  # lower points may be ground
SIDE_MARGIN_M = 0.1  # next to a face, in which its points are counted too
MIN_FACE_POINTS = 3  # about a face or the opposite one; with fewer a face stays
HIDDEN_WIDTH = 56
SORTS = ("end", "side", "top")
_FACE_COUNTS = BIN_COUNT * ZONES
_EXTRA_FEATURES = 2 + 3 + len(LABELS)  # numbers of points, size of the box, its class


_BothSides = Float[np.ndarray, " 2*n"]


class FaceFeatures(NamedTuple):
    """Inputs of the networks for n boxes."""

    end: Float32[np.ndarray, "2*n F"]  # the fronts of all boxes, then their rears
    side: Float32[np.ndarray, "2*n F"]  # the left sides, then the right ones
    top: Float32[np.ndarray, "n F"]
    counted: tuple[Int64[np.ndarray, " 2*n"], Int64[np.ndarray, " 2*n"], Int64[np.ndarray, " n"]]


def _build_network(counts: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(counts + _EXTRA_FEATURES, HIDDEN_WIDTH),
        nn.ReLU(),
        nn.Linear(HIDDEN_WIDTH, HIDDEN_WIDTH),
        nn.ReLU(),
        nn.Linear(HIDDEN_WIDTH, 2),
    )


class FaceNetworks(nn.Module):
    """Three networks: features (n, F) to shifts outwards (m) and their log mean errors (m)."""

    # mean error of each sort of face as detected (m): an answer with a smaller error moves the face
    prior: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.end = _build_network(2 * _FACE_COUNTS)
        self.side = _build_network(2 * _FACE_COUNTS)
        self.top = _build_network(_FACE_COUNTS)
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
        shifts = []
        for number, sort in enumerate(SORTS):
            shift, spread = self.answers(sort, torch.from_numpy(features[number]))
            has_points = torch.from_numpy(features.counted[number]) >= MIN_FACE_POINTS
            is_sure = (torch.exp(spread) < self.prior[number]) & has_points
            shifts.append(torch.where(is_sure, shift, 0.0).double().numpy())
        return shifts


def measure_faces(
    networks: FaceNetworks, detections: Detections, points: Points, labels: Sequence[str]
) -> Detections:
    """Move the faces of all boxes with these labels."""
    rows = np.flatnonzero(np.isin(detections.labels, [label_index(label) for label in labels]))
    if not len(rows):
        return detections
    boxes = detections.boxes.copy()
    features = face_features(points, boxes[rows], detections.labels[rows])
    boxes[rows] = move_faces(boxes[rows], *networks.shifts(features))
    return Detections(boxes, detections.scores, detections.labels)


def move_faces(
    boxes: BoxRows, end: _BothSides, side: _BothSides, top: Float[np.ndarray, " n"]
) -> BoxRows:
    """Move faces of boxes outwards (m), or inwards to a fifth of the size; the floor stays."""
    front, rear = np.split(end, 2)
    left, right = np.split(side, 2)
    boxes = boxes.copy()
    growth = np.stack([front + rear, left + right, top], axis=1)
    grown = np.maximum(growth, -0.8 * boxes[:, 3:6])
    ahead = (front - rear) / 2
    aside = (left - right) / 2
    cos = np.cos(boxes[:, 6])
    sin = np.sin(boxes[:, 6])
    boxes[:, 0] += ahead * cos - aside * sin
    boxes[:, 1] += ahead * sin + aside * cos
    boxes[:, 2] += grown[:, 2] / 2
    boxes[:, 3:6] += grown
    return boxes


def face_offsets(
    boxes: BoxRows, truths: BoxRows
) -> tuple[_BothSides, _BothSides, Float[np.ndarray, " n"]]:
    """Arguments of `move_faces` that turn boxes into true boxes, which may face the other way."""
    dx, dy = (truths - boxes)[:, :2].T
    cos = np.cos(boxes[:, 6])
    sin = np.sin(boxes[:, 6])
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
    count = len(boxes)
    last_bin_m = FIRST_BIN_M + BIN_M * BIN_COUNT  # end of the counts, beyond a face
    reach = np.array([0, 0, last_bin_m / 2, 2 * last_bin_m, 2 * last_bin_m, last_bin_m, 0])
    near_rows = rows_in_boxes(points, boxes + reach)
    row = np.repeat(np.arange(count), [len(rows) for rows in near_rows])
    point_rows = np.concatenate([np.zeros(0, np.int64), *near_rows])
    x, y, z = (points[point_rows].astype(np.float64) - boxes[row, :3]).T
    cos = np.cos(boxes[:, 6])[row]
    sin = np.sin(boxes[:, 6])[row]
    length, width, height = boxes[row, 3:6].T
    u = x * cos + y * sin
    v = y * cos - x * sin
    t = z + height / 2
    is_near_along = np.abs(u) < length / 2 + last_bin_m
    is_near_across = np.abs(v) < width / 2 + last_bin_m
    is_near_height = (t > FLOOR_GAP_M) & (t < height + last_bin_m)
    is_near = is_near_along & is_near_across & is_near_height
    row = row[is_near]
    u = u[is_near]
    v = v[is_near]
    t = t[is_near]
    length = length[is_near]
    width = width[is_near]
    height = height[is_near]
    is_across = np.abs(v) <= width / 2 + SIDE_MARGIN_M
    is_along = np.abs(u) <= length / 2 + SIDE_MARGIN_M
    height_zone = (t >= 0.4 * height).astype(np.int64) + (t >= 0.7 * height)
    third_zone = (u >= -length / 6).astype(np.int64) + (u >= length / 6)
    side_zone = np.where(t > 0.5 * height, 1 + (u > 0.05 * length), 0)
    front = _counts(u - length / 2, height_zone, is_across, row, count)
    rear = _counts(-u - length / 2, height_zone, is_across, row, count)
    left = _counts(v - width / 2, side_zone, is_along, row, count)
    right = _counts(-v - width / 2, side_zone, is_along, row, count)
    top = _counts(t - height, third_zone, is_across & is_along, row, count)
    kind = np.eye(len(LABELS))[labels]
    extras = np.column_stack([np.log(boxes[:, 3:6] / [4.5, 1.8, 1.6]), kind])
    ends, end_points = _with_opposite(np.stack([front, rear]), extras)
    sides, side_points = _with_opposite(np.stack([left, right]), extras)
    tops, top_points = _with_opposite(top[None], extras)
    return FaceFeatures(ends, sides, tops, (end_points, side_points, top_points))


def _with_opposite(face_counts: np.ndarray, extras: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows for a network, and the number of points of both faces.

    A row has the counts of a face and of the opposite one, the size and the class."""
    faces = len(face_counts)
    totals = face_counts.sum(axis=2, keepdims=True)
    histograms = [face_counts, face_counts[::-1]] if faces == 2 else [face_counts]
    columns = [np.log1p(counts) for counts in (*histograms, totals, totals[::-1])]
    columns.append(np.broadcast_to(extras, (faces, *extras.shape)))
    rows = np.concatenate(columns, axis=2)
    points = np.tile(totals.sum((0, 2)), faces).astype(np.int64)
    return rows.reshape(-1, rows.shape[2]).astype(np.float32), points


def _counts(
    distance: np.ndarray, zone: np.ndarray, is_chosen: np.ndarray, row: np.ndarray, boxes: int
) -> Float[np.ndarray, "n F"]:
    step = np.floor((distance - FIRST_BIN_M) / BIN_M)
    is_inside = is_chosen & (step >= 0) & (step < BIN_COUNT)
    bin_number = (row[is_inside] * ZONES + zone[is_inside]) * BIN_COUNT + step[is_inside].astype(
        np.int64
    )
    return (
        np.bincount(bin_number, minlength=boxes * _FACE_COUNTS)
        .reshape(boxes, _FACE_COUNTS)
        .astype(np.float64)
    )
