"""One horizontal offset of all labels from the points."""

from collections.abc import Sequence

import numpy as np

from toolkit.arrays import BoxRows, Float64, Points
from toolkit.doctor.box_fits import MIN_FITTED_BOXES, GroundView, fits, fits_better
from toolkit.doctor.explanations import Explanation
from toolkit.doctor.label_mistake import LabelMistake

MIN_OFFSET_M = 0.3  # smaller offsets between labels and points are no mistake
MAX_OFFSET_M = 5.0  # larger ones are not accepted
OFFSET_REACH_M = 2.0  # distance from a box within which its points may be
OFFSET_ROUNDS = 4  # rounds that refine the offset, with points around the moved boxes


def find_offset(
    views: Sequence[GroundView], current: Float64[np.ndarray, " n"]
) -> Explanation | None:
    """Find one horizontal offset of all labels from the points.

    views: frames with their points above the ground; current: fit of each box as it is. Returns
    None if the offset is too small or too large, or if boxes do not fit better without it."""
    boxes = [view.sample.objects.boxes for view in views]
    offset = np.zeros(2)
    for _ in range(OFFSET_ROUNDS):
        moved = [rows - np.array([*offset, 0, 0, 0, 0, 0]) for rows in boxes]
        view_offsets = [
            _measure_offsets(view.points, rows) for view, rows in zip(views, moved, strict=True)
        ]
        offsets = np.concatenate([np.zeros((0, 2)), *view_offsets])
        if len(offsets) < MIN_FITTED_BOXES:
            return None
        offset = offset - np.median(offsets, axis=0)
    moved = [rows - np.array([*offset, 0, 0, 0, 0, 0]) for rows in boxes]
    if not MIN_OFFSET_M <= np.hypot(*offset) <= MAX_OFFSET_M:
        return None
    undone = fits(views, moved)
    if not fits_better(current, undone):
        return None
    words = (
        f"all labels are {offset[0]:+.1f} m in x and {offset[1]:+.1f} m in y from where the "
        "points are"
    )
    remedy = (
        "take that off, and check which point of the vehicle, of the lidar or of the map they "
        "are counted from"
    )
    return Explanation(LabelMistake(words, remedy), moved, undone)


def _measure_offsets(points: Points, boxes: BoxRows) -> Float64[np.ndarray, "n 2"]:
    """Median horizontal offset (m) of the points around each box from its centre.

    Boxes without points around them are skipped."""
    from scipy.spatial import cKDTree

    if not len(points) or not len(boxes):
        return np.zeros((0, 2))
    centres = boxes[:, :2]
    length, width = boxes[:, 3], boxes[:, 4]
    radii = np.hypot(length, width) / 2 + OFFSET_REACH_M
    # indices of the points around each box
    neighbours = cKDTree(points[:, :2]).query_ball_point(centres, radii)
    offsets = [
        np.median(points[indices, :2], axis=0) - centre
        for indices, centre in zip(neighbours, centres, strict=True)
        if indices
    ]
    return np.array(offsets).reshape(-1, 2)
