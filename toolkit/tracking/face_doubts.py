"""Doubts of faces, and what follows for sizes and centres of rigid bodies.

A doubt is the expected error (m) of a face of a box. Doubts of n boxes have shape (n, 5): front,
rear, left, right, top.
"""

import numpy as np

from toolkit.arrays import Bool, BoxRows, Float64, Int64
from toolkit.objects import USUAL_DOUBTS_M, Detections

# Errors of a face are alike from frame to frame: r is .4 to .5 after 3 s. The mean of any number of
# them has the variance of about 1 / .45 independent ones.
MAX_EQUIVALENT_FRAMES = 2.2
# least error of a face by class of `LABELS`: bodies are no boxes, and people move arms and legs
MIN_DOUBTS_M = np.array([0.005, 0.005, 0.02, 0.005])


def get_doubts(detections: Detections) -> Float64[np.ndarray, "n 5"]:
    """Doubts of the faces of detections, the usual ones if they have none."""
    if detections.doubts is not None:
        return detections.doubts
    return np.tile(USUAL_DOUBTS_M, (len(detections), 1))


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


def combine_doubts(
    doubts: Float64[np.ndarray, "n 5"],
    size_weight: Float64[np.ndarray, "n 3"],
    max_weight: Float64[np.ndarray, "n 3"],
    labels: Int64[np.ndarray, " n"],
    place_error: Float64[np.ndarray, " n"] | float = 0.0,
) -> Float64[np.ndarray, "n 5"]:
    """Doubts of the faces of tracked bodies, whose size is known from all their detections.

    A face that is not seen now follows from the opposite one and the size.

    Args:
        doubts: Expected error (m) of front, rear, left, right and top in a detection of each body.
        size_weight: Sum of the weights (1/m²) of the detections behind each size, see
            `weigh_sizes`.
        max_weight: Largest such weight.
        labels: Class of each body.
        place_error: Expected error (m) of places, which is added to all faces."""
    weight = np.minimum(size_weight, MAX_EQUIVALENT_FRAMES * max_weight)
    combined = doubts.copy()
    length_error = 1 / np.sqrt(weight[:, 0])
    width_error = 1 / np.sqrt(weight[:, 1])
    for face, opposite, error in ((0, 1, length_error), (2, 3, width_error)):
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
    """Covariance in x and y (m²) of variances (m²) along and across headings (rad)."""
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
    """Centres (x, y) of bodies of a known size that share their surer faces with detections.

    Args:
        boxes: Detection of each body.
        yaw: Heading of each body (rad); its detection may have the opposite one.
        size: Length, width and height (m) of each body.
        doubts: Expected error (m) of the detection's front, rear, left, right and top, with the
            front at the end to which `yaw` points."""
    weights = 1 / np.square(doubts)
    # the centre moves so far if the front (left) face is kept, and as far back if the rear (right)
    # one is; in between by their weights
    ahead = (boxes[:, 3] - size[:, 0]) / 2
    leftwards = (boxes[:, 4] - size[:, 1]) / 2
    ahead = ahead * (weights[:, 0] - weights[:, 1]) / (weights[:, 0] + weights[:, 1])
    leftwards = leftwards * (weights[:, 2] - weights[:, 3]) / (weights[:, 2] + weights[:, 3])
    cos = np.cos(yaw)
    sin = np.sin(yaw)
    x = boxes[:, 0] + ahead * cos - leftwards * sin
    y = boxes[:, 1] + ahead * sin + leftwards * cos
    return np.stack([x, y], axis=1)
