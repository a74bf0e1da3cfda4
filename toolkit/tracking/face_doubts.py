"""Doubts of faces, and what follows for sizes and centres of rigid bodies.

A doubt is the expected error (m) of a face of a box. Doubts of n boxes have shape (n, 5): front,
rear, left, right, top.
"""

from collections.abc import Sequence

import numpy as np

from toolkit.arrays import Bool, BoxRows, Float64, Int64
from toolkit.objects import USUAL_DOUBTS_M, Detections

# least error of a face by class of `LABELS`: bodies are no boxes, and people move arms and legs
MIN_DOUBTS_M = np.array([0.005, 0.005, 0.02, 0.005])
# by class: doubts much larger than this are too sure. Detectors learn them from cars, whose sizes
# differ by less than what is hidden of a truck.
TRUSTED_DOUBTS_M = np.array([0.14, np.inf, np.inf, 0.07])
# mean square of a normal error by its squared mean absolute value
USUAL_MISFIT = np.pi / 2
IS_RIGID = np.array([True, False, False, True])  # by class; the others move arms and legs
# by class: weight of a length or height above the mean. Parts of a long body are seen, which are
# shorter and lower.
LARGER_WEIGHTS = np.array([1.0, 1.0, 1.0, 4.0])
# the same for a height if the top is hidden. Detectors then take a van for as low as most cars are.
HIDDEN_TOP_WEIGHTS = np.array([16.0, 1.0, 1.0, 4.0])
MIN_HIDDEN_TOP_M = 0.06  # doubt of a top above which it is hidden
EXPECTILE_ROUNDS = 8
MISFIT_HITS = 10.0  # detections that the usual misfit counts as
# error of a vehicle's face that is guessed outside the area, by its distance from there
OUTER_ERROR_SHARE = 0.25
# by class: what a body is longer than guessed, by the same distance. On average as much again is
# outside of a truck.
OUTER_LENGTH_SHARES = np.array([0.0, 0.0, 0.0, 1.0])
_SIZE_OF_FACE = [0, 0, 1, 1, 2]  # length, width or height


def get_doubts(detections: Detections) -> Float64[np.ndarray, "n 5"]:
    """Doubts of the faces of detections, the usual ones if they have none."""
    if detections.doubts is not None:
        return detections.doubts
    return np.tile(USUAL_DOUBTS_M, (len(detections), 1))


def doubt_outer_faces(
    boxes: BoxRows,
    doubts: Float64[np.ndarray, "n 5"],
    labels: Int64[np.ndarray, " n"],
    area: Sequence[float],
) -> Float64[np.ndarray, "n 5"]:
    """Doubts of the faces of detections, larger for vehicles' faces outside the area.

    No point outside the area is looked at, so the detector has guessed these faces. People and
    cyclists are short, so that it guesses theirs well.

    Args:
        boxes: Detections.
        doubts: Expected error (m) of front, rear, left, right and top as the detector gives it.
        labels: Class of each detection.
        area: xmin, ymin, xmax, ymax (m) from which the detector had points."""
    cos = np.cos(boxes[:, 6])
    sin = np.sin(boxes[:, 6])
    ahead = boxes[:, 3:4] / 2 * np.column_stack([cos, sin])
    leftwards = boxes[:, 4:5] / 2 * np.column_stack([-sin, cos])
    outer = doubts.copy()
    is_rigid = IS_RIGID[labels]
    for face, offset in enumerate((ahead, -ahead, leftwards, -leftwards)):
        error = OUTER_ERROR_SHARE * _measure_distances(boxes[:, :2] + offset, area)
        outer[:, face] = np.hypot(doubts[:, face], np.where(is_rigid, error, 0))
    return outer


def extend_outer_ends(
    boxes: BoxRows, labels: Int64[np.ndarray, " n"], area: Sequence[float]
) -> BoxRows:
    """Detections that reach farther out of the area, by `OUTER_LENGTH_SHARES`.

    Args:
        boxes: Detections.
        labels: Class of each.
        area: xmin, ymin, xmax, ymax (m) from which the detector had points."""
    headings = np.column_stack([np.cos(boxes[:, 6]), np.sin(boxes[:, 6])])
    extended = boxes.copy()
    for ahead in (headings, -headings):
        ends = boxes[:, :2] + boxes[:, 3:4] / 2 * ahead
        missing = OUTER_LENGTH_SHARES[labels] * _measure_distances(ends, area)
        extended[:, 3] += missing
        extended[:, :2] += missing[:, None] / 2 * ahead
    return extended


def _measure_distances(
    points: Float64[np.ndarray, "n 2"], area: Sequence[float]
) -> Float64[np.ndarray, " n"]:
    """Distances (m) of points outside the area from it; 0 for those inside.

    area: xmin, ymin, xmax, ymax (m)."""
    xmin, ymin, xmax, ymax = area
    x, y = points.T
    outside_x = np.maximum(np.maximum(xmin - x, x - xmax), 0)
    outside_y = np.maximum(np.maximum(ymin - y, y - ymax), 0)
    return np.hypot(outside_x, outside_y)


def turn_faces(
    doubts: Float64[np.ndarray, "n 5"], is_turned: Bool[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 5"]:
    """Doubts of faces after some boxes made a half turn: front and rear, left and right exchanged.

    doubts: expected error (m) of front, rear, left, right and top, in this order."""
    return np.where(is_turned[:, None], doubts[:, [1, 0, 3, 2, 4]], doubts)


def weigh_sizes(doubts: Float64[np.ndarray, "n 5"]) -> Float64[np.ndarray, "n 3"]:
    """Weight (1/m²) of the length, width and height of detections, by the doubts of their faces.

    doubts: expected error (m) of front, rear, left, right and top; the ground is known."""
    length = np.square(doubts[:, :2]).sum(axis=1)
    width = np.square(doubts[:, 2:4]).sum(axis=1)
    return 1 / np.stack([length, width, np.square(doubts[:, 4])], axis=1)


def estimate_size(
    sizes: Float64[np.ndarray, "k 3"], weights: Float64[np.ndarray, "k 3"], label: int
) -> Float64[np.ndarray, "3"]:
    """Length, width and height (m) of a body: width as a mean, the others as expectiles.

    An expectile is a mean in which what is above it has more weight (Newey and Powell, Econometrica
    55(4), 1987), here the weight of `weigh_larger`.

    Args:
        sizes: Length, width and height of each detection (m).
        weights: Weight (1/m²) of each value above, the inverse of its variance.
        label: Class of the body."""
    size = (weights * sizes).sum(axis=0) / weights.sum(axis=0)
    if not IS_RIGID[label]:
        return size
    for _ in range(EXPECTILE_ROUNDS):
        side_weights = weights * weigh_larger(sizes, size, weights, np.array([label]))
        size = (side_weights * sizes).sum(axis=0) / side_weights.sum(axis=0)
    return size


def weigh_larger(
    sizes: Float64[np.ndarray, "n 3"],
    means: Float64[np.ndarray, "*m 3"],
    weights: Float64[np.ndarray, "n 3"],
    labels: Int64[np.ndarray, " #n"],
) -> Float64[np.ndarray, "n 3"]:
    """Factors of the weights of detected sizes: more for lengths and heights above the mean.

    Args:
        sizes: Length, width and height of each detection (m).
        means: Mean length, width and height (m) of the body of each, or of their one body.
        weights: Weight (1/m²) of each size, the inverse of its variance.
        labels: Class of each body, or of their one body."""
    is_hidden = weights[:, 2] < 1 / MIN_HIDDEN_TOP_M**2
    length_factors = LARGER_WEIGHTS[labels]
    height_factors = np.where(is_hidden, HIDDEN_TOP_WEIGHTS[labels], LARGER_WEIGHTS[labels])
    is_larger = sizes > means
    factors = np.ones(sizes.shape)
    factors[:, 0] = np.where(is_larger[:, 0], length_factors, 1.0)
    factors[:, 2] = np.where(is_larger[:, 2], height_factors, 1.0)
    return factors


def calibrate_doubts(
    doubts: Float64[np.ndarray, "n faces"], labels: Int64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n faces"]:
    """Expected errors (m) of faces or sizes, from doubts that are too sure of what is hidden.

    Measured on detections of trucks and buses, errors are up to three times doubts of 0.04 m, but
    four to eight times doubts of 0.12 m.

    Args:
        doubts: Expected error (m) by the detector, a column for each face or size.
        labels: Class of each body."""
    return doubts * (1 + np.square(doubts / TRUSTED_DOUBTS_M[labels][:, None]))


def doubt_sizes(
    weights: Float64[np.ndarray, "*n 3"], roots: Float64[np.ndarray, "*n 3"]
) -> Float64[np.ndarray, "*n 3"]:
    """Expected error (m) of means of sizes.

    Errors of a body's faces are alike from frame to frame, so no number of detections makes their
    weighted mean surer than the doubts are in the same mean.

    Args:
        weights: Sum of the weights of detections (1/m²), each the inverse of a variance.
        roots: Sum of their square roots (1/m), each a weight times a doubt."""
    return roots / weights


def find_misfit(
    differences: Float64[np.ndarray, "k 3"], weights: Float64[np.ndarray, "k 3"], label: int
) -> Float64[np.ndarray, "3"]:
    """Misfit of the length, width and height of a body.

    It is the mean of the squared differences from its size, by their variances as doubted. It is
    the usual one for bodies that are not rigid, and near it for few detections.

    Args:
        differences: Sizes of its detections less its size (m).
        weights: Weight (1/m²) of each value above, the inverse of its variance.
        label: Class of the body."""
    if not IS_RIGID[label]:
        return np.full(3, USUAL_MISFIT)
    surprise = (weights * np.square(differences)).sum(axis=0)
    return (surprise + MISFIT_HITS * USUAL_MISFIT) / (len(differences) + MISFIT_HITS)


def find_inflation(misfit: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
    """Factors, at least 1, by which doubts explain how sizes scatter: Birge's ratio.

    Detectors are too sure of bodies that they see in parts (Birge, Phys. Rev. 40, 1932).

    misfit: mean of the squared differences of length, width and height from the size of the body,
        by their variances as doubted."""
    return np.sqrt(np.maximum(misfit / USUAL_MISFIT, 1.0))


def inflate_doubts(
    doubts: Float64[np.ndarray, "n 5"], misfit: Float64[np.ndarray, "#n 3"]
) -> Float64[np.ndarray, "n 5"]:
    """Doubts times the factors of `find_inflation`: ends by the length's, sides by the width's."""
    return doubts * find_inflation(misfit)[:, _SIZE_OF_FACE]


def combine_doubts(
    doubts: Float64[np.ndarray, "n 5"],
    size_doubts: Float64[np.ndarray, "#n 3"],
    labels: Int64[np.ndarray, " n"],
    place_error: Float64[np.ndarray, " n"] | float = 0.0,
    *,
    misfit: Float64[np.ndarray, "#n 3"],
) -> Float64[np.ndarray, "n 5"]:
    """Doubts of the faces of tracked bodies, whose size is known from all their detections.

    A face that is not seen now follows from the opposite one and the size. Rows may be of n bodies
    or of n detections of one, whose size and misfit then have one row.

    Args:
        doubts: Expected error (m) of front, rear, left, right and top in a detection of each body.
        size_doubts: Expected error (m) of the length, width and height of each body, see
            `doubt_sizes`.
        labels: Class of each body.
        place_error: Expected error (m) of places, which is added to all faces.
        misfit: Mean of the squared differences of length, width and height from the size of each
            body, by their variances as doubted."""
    doubts = inflate_doubts(calibrate_doubts(doubts, labels), misfit)
    size_labels = labels[: len(size_doubts)]
    size_doubts = calibrate_doubts(size_doubts, size_labels) * find_inflation(misfit)
    combined = doubts.copy()
    for face, opposite, error in ((0, 1, size_doubts[:, 0]), (2, 3, size_doubts[:, 1])):
        first = doubts[:, face]
        second = doubts[:, opposite]
        combined[:, face] = np.minimum(first, np.hypot(second, error))
        combined[:, opposite] = np.minimum(second, np.hypot(first, error))
    least = np.hypot(MIN_DOUBTS_M[labels], place_error)
    return np.hypot(combined, least[:, None])


def centre_covariance(
    yaw: Float64[np.ndarray, " n"], doubts: Float64[np.ndarray, "n 5"]
) -> Float64[np.ndarray, "n 2 2"]:
    """Covariance (m²) along x and y of the centres of boxes that are anchored at the surer faces.

    Args:
        yaw: Heading of each box (rad).
        doubts: Expected error (m) of front, rear, left, right and top."""
    weights = 1 / np.square(doubts)
    along = 1 / weights[:, :2].sum(axis=1)
    across = 1 / weights[:, 2:4].sum(axis=1)
    return rotate_variances(yaw, along, across)


def rotate_variances(
    yaw: Float64[np.ndarray, " n"],
    along: Float64[np.ndarray, " n"],
    across: Float64[np.ndarray, " n"],
) -> Float64[np.ndarray, "n 2 2"]:
    """Covariance matrices in x and y (m²) of variances (m²) along and across headings (rad)."""
    cos = np.cos(yaw)
    sin = np.sin(yaw)
    covariance = np.empty((len(yaw), 2, 2))
    covariance[:, 0, 0] = along * cos**2 + across * sin**2
    covariance[:, 1, 1] = along * sin**2 + across * cos**2
    covariance[:, 0, 1] = covariance[:, 1, 0] = (along - across) * cos * sin
    return covariance


def anchor_centres(
    boxes: BoxRows,
    yaw: Float64[np.ndarray, " n"],
    size: Float64[np.ndarray, "n 3"],
    doubts: Float64[np.ndarray, "n 5"],
) -> Float64[np.ndarray, "n 2"]:
    """Centres (x, y) of bodies of a known size whose surer faces stay where they were detected.

    Args:
        boxes: Detection of each body.
        yaw: Heading of each body (rad); its detection may have the opposite one.
        size: Length, width and height (m) of each body.
        doubts: Expected error (m) of the detection's front, rear, left, right and top, with the
            front at the end to which `yaw` points."""
    weights = 1 / np.square(doubts)
    # movement (m) of the centre if the front (left) face is kept: its negative if the rear (right)
    # one is, in between by their weights
    ahead_by_front = (boxes[:, 3] - size[:, 0]) / 2
    leftwards_by_left = (boxes[:, 4] - size[:, 1]) / 2
    front, rear = weights[:, :2].T
    left, right = weights[:, 2:4].T
    ahead = ahead_by_front * (front - rear) / (front + rear)
    leftwards = leftwards_by_left * (left - right) / (left + right)
    cos = np.cos(yaw)
    sin = np.sin(yaw)
    x = boxes[:, 0] + ahead * cos - leftwards * sin
    y = boxes[:, 1] + ahead * sin + leftwards * cos
    return np.stack([x, y], axis=1)
