"""One horizontal offset of all labels from the points."""

from collections.abc import Sequence

import numpy as np

from toolkit.arrays import BoxRows, Float, Float64
from toolkit.doctor.box_fits import MIN_FITTED_BOXES, GroundView, fits_better, measure_view_fits
from toolkit.doctor.explanations import Explanation
from toolkit.doctor.label_mistake import LabelMistake

MIN_OFFSET_M = 0.3  # smaller offsets between labels and points are no mistake
MAX_OFFSET_M = 5.0  # larger ones are not accepted
OFFSET_REACH_M = 2.0  # distance from a box within which its points may be
OFFSET_ROUNDS = 4  # rounds that refine the offset, with points around the moved boxes


def find_offset(
    views: Sequence[GroundView], current_fits: Float64[np.ndarray, " n"]
) -> Explanation | None:
    """Find one horizontal offset of all labels from the points.

    views: frames with their points above the ground; current_fits: fit of each box now. Returns
    None if the offset is too small or too large, or if boxes do not fit better without it."""
    boxes = [view.sample.objects.boxes for view in views]
    offset = np.zeros(2)  # x, y (m) from the points to the labels
    for _ in range(OFFSET_ROUNDS):
        moved_boxes = [_shift_boxes(view_boxes, -offset) for view_boxes in boxes]
        # offsets (m) that remain, of the points from the moved boxes
        remaining_by_view = [
            _measure_offsets(view.points, view_boxes)
            for view, view_boxes in zip(views, moved_boxes, strict=True)
        ]
        remaining = np.concatenate([np.zeros((0, 2)), *remaining_by_view])
        if len(remaining) < MIN_FITTED_BOXES:
            return None
        offset = offset - np.median(remaining, axis=0)
    moved_boxes = [_shift_boxes(view_boxes, -offset) for view_boxes in boxes]
    offset_x, offset_y = offset
    if not MIN_OFFSET_M <= np.hypot(offset_x, offset_y) <= MAX_OFFSET_M:
        return None
    moved_fits = measure_view_fits(views, moved_boxes)
    if not fits_better(current_fits, moved_fits):
        return None
    words = (
        f"all labels are {offset_x:+.1f} m in x and {offset_y:+.1f} m in y from where the "
        "points are"
    )
    remedy = (
        "take that off, and check which point of the vehicle, of the lidar or of the map they "
        "are counted from"
    )
    return Explanation(LabelMistake(words, remedy), boxes=moved_boxes, fits=moved_fits)


def _shift_boxes(boxes: BoxRows, offset: Float64[np.ndarray, "2"]) -> BoxRows:
    """Boxes with their centres moved by x and y (m)."""
    return boxes + np.array([*offset, 0, 0, 0, 0, 0])


def _measure_offsets(
    points: Float[np.ndarray, "points 3"], boxes: BoxRows
) -> Float64[np.ndarray, "near 2"]:
    """Median horizontal offset (m) of the points around each box from its centre, as x, y.

    Points within `OFFSET_REACH_M` of a box's circle count. Boxes without any are skipped."""
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
