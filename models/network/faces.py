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

from toolkit.arrays import Bool, BoxRows, Float, Float32, Int64, Points
from toolkit.boxes import rows_in_boxes
from toolkit.objects import LABELS, USUAL_DOUBTS_M, Detections, label_index

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


# one value for the front (or left) of each of n boxes, then one for the rear (or right) of each
_BothSides = Float[np.ndarray, " 2*n"]


class FaceFeatures(NamedTuple):
    """Inputs of the networks for n boxes, in the order of `SORTS`.

    Attributes:
        end: Features of the fronts of all boxes, then of their rears.
        side: Features of the left sides, then of the right ones.
        top: Features of the tops.
        counted: Points counted about each face of an end, side and top, opposite face included.
    """

    end: Float32[np.ndarray, "2*n features"]
    side: Float32[np.ndarray, "2*n features"]
    top: Float32[np.ndarray, "n features"]
    counted: tuple[Int64[np.ndarray, " 2*n"], Int64[np.ndarray, " 2*n"], Int64[np.ndarray, " n"]]


class FaceShifts(NamedTuple):
    """Shifts of the faces of n boxes outwards (m), in the order of `SORTS`.

    Attributes:
        end: Shift of the fronts of all boxes, then of their rears.
        side: Shift of the left sides, then of the right ones.
        top: Shift of the tops.
    """

    end: _BothSides
    side: _BothSides
    top: Float[np.ndarray, " n"]


class FaceMeasurements(NamedTuple):
    """Measurements of the faces of n boxes.

    Attributes:
        shifts: Shift of each face outwards (m), 0 without evidence.
        doubts: Expected error (m) of each face once it is shifted.
    """

    shifts: FaceShifts
    doubts: FaceShifts


class _FaceRows(NamedTuple):
    """Rows of features of one sort of face, and the points counted about each face and its
    opposite."""

    features: Float32[np.ndarray, "m features"]
    points: Int64[np.ndarray, " m"]


def _build_network(count_features: int) -> nn.Sequential:
    """Network from the features of a face to its shift and the logarithm of the shift's error.

    count_features: number of features that count points; some others follow them."""
    return nn.Sequential(
        nn.Linear(count_features + _EXTRA_FEATURES, HIDDEN_WIDTH),
        nn.ReLU(),
        nn.Linear(HIDDEN_WIDTH, HIDDEN_WIDTH),
        nn.ReLU(),
        nn.Linear(HIDDEN_WIDTH, 2),
    )


class FaceNetworks(nn.Module):
    """Three networks: from features to shifts outwards (m) and their log mean errors (m)."""

    # mean error of each sort of face as detected (m): an answer with a smaller error moves the face
    prior: Tensor

    def __init__(self) -> None:
        """Untrained networks of front and rear, of both sides, and of the top."""
        super().__init__()
        self.end = _build_network(2 * _FACE_COUNTS)
        self.side = _build_network(2 * _FACE_COUNTS)
        self.top = _build_network(_FACE_COUNTS)
        self.register_buffer("prior", torch.full((len(SORTS),), np.inf))

    def answers(
        self, sort: str, features: Float[Tensor, "n features"]
    ) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
        """Shift outwards (m) and its log mean error (m) of faces of one of `SORTS`.

        features: a row for each face."""
        shift, spread = getattr(self, sort)(features).unbind(1)  # the network of this sort
        # scaled so that an untrained network answers shifts near 0 with an error of some 5 cm
        return shift / 4, spread - 3

    @torch.inference_mode()
    def measure(self, features: FaceFeatures) -> FaceMeasurements:
        """Shifts of faces and their expected errors.

        A face stays, with the usual error of its sort, if it has fewer than `MIN_FACE_POINTS` or
        would not become surer."""
        shifts = []
        doubts = []
        for number, sort in enumerate(SORTS):
            shift, spread = self.answers(sort, torch.from_numpy(features[number]))
            has_points = torch.from_numpy(features.counted[number]) >= MIN_FACE_POINTS
            error = torch.exp(spread)
            prior = self.prior[number]
            is_moved = (error < prior) & has_points  # only if that makes a smaller error likely
            shifts.append(torch.where(is_moved, shift, 0.0).double().numpy())
            doubts.append(torch.where(is_moved, error, prior).double().numpy())
        return FaceMeasurements(FaceShifts(*shifts), FaceShifts(*doubts))


def measure_faces(
    networks: FaceNetworks, detections: Detections, points: Points, labels: Sequence[str]
) -> Detections:
    """Detections with the faces of all boxes of some labels moved; scores and order stay.

    Boxes of other labels have `USUAL_DOUBTS_M`. points: x y z (m) in the frame of the
    boxes.
    """
    rows = np.flatnonzero(np.isin(detections.labels, [label_index(label) for label in labels]))
    if not len(rows):
        return detections
    boxes = detections.boxes.copy()
    features = face_features(points, boxes[rows], detections.labels[rows])
    measurements = networks.measure(features)
    boxes[rows] = move_faces(boxes[rows], *measurements.shifts)
    doubts = None
    if bool(torch.isfinite(networks.prior).all()):  # networks that were trained
        doubts = np.empty((len(boxes), 5))
        doubts[:] = USUAL_DOUBTS_M
        doubts[rows] = _by_box(measurements.doubts)
    return Detections(boxes, detections.scores, detections.labels, doubts)


def _by_box(faces: FaceShifts) -> Float[np.ndarray, "n 5"]:
    """Values of the front, rear, left, right and top of each box, a row for each."""
    front, rear = np.split(faces.end, 2)
    left, right = np.split(faces.side, 2)
    return np.stack([front, rear, left, right, faces.top], axis=1)


def move_faces(
    boxes: BoxRows, end: _BothSides, side: _BothSides, top: Float[np.ndarray, " n"]
) -> BoxRows:
    """Boxes with their faces moved outwards; the floor stays.

    Shifts inwards (below 0) leave a fifth of the size.

    Args:
        boxes: n boxes: x, y, z, length, width, height (m), yaw (rad).
        end: Shift (m) of the fronts of all boxes, then of their rears.
        side: Shift (m) of the left sides, then of the right ones.
        top: Shift (m) of the tops.
    """
    front, rear = np.split(end, 2)
    left, right = np.split(side, 2)
    boxes = boxes.copy()
    sizes = boxes[:, 3:6]  # length, width and height; a view
    yaw = boxes[:, 6]
    growth = np.maximum(np.stack([front + rear, left + right, top], axis=1), -0.8 * sizes)
    ahead = (front - rear) / 2
    leftwards = (left - right) / 2
    cos = np.cos(yaw)
    sin = np.sin(yaw)
    boxes[:, 0] += ahead * cos - leftwards * sin
    boxes[:, 1] += ahead * sin + leftwards * cos
    boxes[:, 2] += growth[:, 2] / 2
    sizes += growth
    return boxes


def face_offsets(boxes: BoxRows, truths: BoxRows) -> FaceShifts:
    """Shifts of faces (m, outwards) that turn boxes into their true boxes.

    Only centre and size of the true boxes are used, so that they may face the other way."""
    # rows are x, y, z, length, width, height, yaw; from the box's centre to the true one along x
    # and y, then the same ahead and to the left of the box
    dx, dy = (truths - boxes)[:, :2].T
    yaw = boxes[:, 6]
    cos = np.cos(yaw)
    sin = np.sin(yaw)
    ahead = dx * cos + dy * sin
    leftwards = dy * cos - dx * sin
    growth = truths[:, 3:6] - boxes[:, 3:6]  # in length, width and height
    half_length = growth[:, 0] / 2
    half_width = growth[:, 1] / 2
    return FaceShifts(
        end=np.concatenate([half_length + ahead, half_length - ahead]),  # fronts, then rears
        side=np.concatenate([half_width + leftwards, half_width - leftwards]),  # left, then right
        top=truths[:, 2] - boxes[:, 2] + growth[:, 2] / 2,
    )


def face_features(
    points: Float[np.ndarray, "k 3"], boxes: BoxRows, labels: Int64[np.ndarray, " n"]
) -> FaceFeatures:
    """Features of each face of each box: counts of the points about it and the opposite face.

    points: x y z (m) in the frame of the boxes. labels: class of each box.
    """
    count = len(boxes)
    last_bin_m = FIRST_BIN_M + BIN_M * BIN_COUNT  # end of the counts, beyond a face
    # x y z length width height yaw: wider on all sides and higher, the floor stays
    reach = np.array([0, 0, last_bin_m / 2, 2 * last_bin_m, 2 * last_bin_m, last_bin_m, 0])
    near_rows = rows_in_boxes(points, boxes + reach)  # rows of points near each box
    row = np.repeat(np.arange(count), [len(rows) for rows in near_rows])
    point_rows = np.concatenate([np.zeros(0, np.int64), *near_rows])
    x, y, z = (points[point_rows].astype(np.float64) - boxes[row, :3]).T
    cos = np.cos(boxes[:, 6])[row]
    sin = np.sin(boxes[:, 6])[row]
    length, width, height = boxes[row, 3:6].T  # box of each point
    # from the box's middle ahead and to the left, and from its floor up (m)
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
    is_within_width = np.abs(v) <= width / 2 + SIDE_MARGIN_M
    is_within_length = np.abs(u) <= length / 2 + SIDE_MARGIN_M
    end_zone = (t >= 0.4 * height).astype(np.int64) + (t >= 0.7 * height)  # low, middle, high
    side_zone = np.where(t > 0.5 * height, 1 + (u > 0.05 * length), 0)  # low, high behind or ahead
    top_zone = (u >= -length / 6).astype(np.int64) + (u >= length / 6)  # behind, middle, ahead
    front = _counts(u - length / 2, end_zone, is_within_width, row, count)
    rear = _counts(-u - length / 2, end_zone, is_within_width, row, count)
    left = _counts(v - width / 2, side_zone, is_within_length, row, count)
    right = _counts(-v - width / 2, side_zone, is_within_length, row, count)
    top = _counts(t - height, top_zone, is_within_width & is_within_length, row, count)
    is_class = np.eye(len(LABELS))[labels]
    usual_size = [4.5, 1.8, 1.6]  # length, width, height of a car (m)
    extras = np.column_stack([np.log(boxes[:, 3:6] / usual_size), is_class])
    ends = _with_opposite(np.stack([front, rear]), extras)
    sides = _with_opposite(np.stack([left, right]), extras)
    tops = _with_opposite(top[None], extras)
    return FaceFeatures(
        end=ends.features,
        side=sides.features,
        top=tops.features,
        counted=(ends.points, sides.points, tops.points),
    )


def _with_opposite(
    face_counts: Float[np.ndarray, "faces n features"], extras: Float[np.ndarray, "n extras"]
) -> _FaceRows:
    """Features of one face of all n boxes, then of the opposite one if there are two.

    A row has log(1 + count) of a face and of the opposite one, then extras: the size and class.
    """
    faces = len(face_counts)
    totals = face_counts.sum(axis=2, keepdims=True)
    histograms = [face_counts, face_counts[::-1]] if faces == 2 else [face_counts]
    columns = [np.log1p(counts) for counts in (*histograms, totals, totals[::-1])]
    columns.append(np.broadcast_to(extras, (faces, *extras.shape)))
    rows = np.concatenate(columns, axis=2)
    points = np.tile(totals.sum((0, 2)), faces).astype(np.int64)
    return _FaceRows(rows.reshape(-1, rows.shape[2]).astype(np.float32), points)


def _counts(
    distance: Float[np.ndarray, " k"],
    zone: Int64[np.ndarray, " k"],
    is_chosen: Bool[np.ndarray, " k"],
    row: Int64[np.ndarray, " k"],
    boxes: int,
) -> Float[np.ndarray, "n features"]:
    """Number of chosen points for each box, zone and step of distance (zones · steps columns).

    distance: how far each point is beyond the face (m). zone, row: zone and box of each point.
    boxes: number n of boxes. Points too far inside or outside for a step are not counted.
    """
    step = np.floor((distance - FIRST_BIN_M) / BIN_M)
    is_counted = is_chosen & (step >= 0) & (step < BIN_COUNT)
    first_bin = (row[is_counted] * ZONES + zone[is_counted]) * BIN_COUNT
    bin_number = first_bin + step[is_counted].astype(np.int64)
    return (
        np.bincount(bin_number, minlength=boxes * _FACE_COUNTS)
        .reshape(boxes, _FACE_COUNTS)
        .astype(np.float64)
    )
