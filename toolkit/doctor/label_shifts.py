"""Delay of labels against their clouds."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import BoxRows, Float64, Mask
from toolkit.datasets import box_frames
from toolkit.doctor.box_fits import MIN_FITTED_BOXES, SHIFTS_S, GroundView, fits, fits_better
from toolkit.doctor.moving_boxes import MovingBoxes, find_moving
from toolkit.geometry import invert

MAX_FRAME_SHIFT = 3  # largest delay, in frames, that is tried
MAX_STILL_M = 0.2  # largest movement of a standing object between frames


class Shift(NamedTuple):
    """Delay of labels against the clouds.

    Attributes:
        amount: size of the delay in words, such as 0.2 s or 1 sample.
        behind: True if labels show objects at an earlier time than the clouds.
        before: fit of each moving box as it is.
        after: fit of the same boxes without the delay."""

    amount: str
    behind: bool
    before: Float64[np.ndarray, " n"]
    after: Float64[np.ndarray, " n"]


def find_shift(views: Sequence[GroundView]) -> Shift | None:
    """Find the delay of labels, None if there is no clear one.

    Moving labels are moved along their tracks. If that shows nothing, labels are compared with the
    clouds of other frames. views: consecutive frames with their points above the ground."""
    return _find_delay(views) or _find_frame_shift(views)


def _find_delay(views: Sequence[GroundView]) -> Shift | None:
    """Find the time along their tracks at which moving labels fit best.

    views: consecutive frames with their points above the ground. Returns None if it is not
    clear."""
    samples = [view.sample for view in views]
    movers = [find_moving(samples, k) for k in range(len(views))]
    if sum(len(moving.boxes) for moving in movers) < MIN_FITTED_BOXES:
        return None

    def measure_shifted_fits(shift_s: float) -> np.ndarray:
        # fit of each moving box, moved by this time (s) along its track
        return fits(views, [_move_along(moving, shift_s) for moving in movers])

    fits_now = measure_shifted_fits(0.0)
    shifts_s = [sign * seconds for seconds in SHIFTS_S for sign in (1, -1)]
    fits_by_shift = {shift_s: measure_shifted_fits(shift_s) for shift_s in shifts_s}
    best_s = max(fits_by_shift, key=lambda shift_s: fits_by_shift[shift_s].mean())
    if not fits_better(fits_now, fits_by_shift[best_s]):
        return None
    return Shift(
        amount=f"{abs(best_s):g} s", behind=best_s > 0, before=fits_now, after=fits_by_shift[best_s]
    )


def _find_frame_shift(views: Sequence[GroundView]) -> Shift | None:
    """Find the number of frames before or after at whose clouds labels fit best.

    views: consecutive frames with their points above the ground. Returns None if it is not
    clear."""
    best: Shift | None = None
    best_gain = -np.inf
    for steps in [sign * k for k in range(1, MAX_FRAME_SHIFT + 1) for sign in (1, -1)]:
        label_frames = [k for k in range(len(views)) if 0 <= k + steps < len(views)]
        # moving boxes of frame k, in the worlds of frames k and k + steps
        at_labels = []
        at_clouds = []
        for k in label_frames:
            labels = views[k].sample
            cloud = views[k + steps].sample
            cloud_SE3_labels = invert(cloud.map_SE3_world) @ labels.map_SE3_world
            boxes = box_frames.move_boxes(cloud_SE3_labels, labels.objects.boxes)
            is_moving = _mark_moved(boxes, cloud.objects.boxes)
            at_labels.append(labels.objects.boxes[is_moving])
            at_clouds.append(boxes[is_moving])
        before = fits([views[k] for k in label_frames], at_labels)
        after = fits([views[k + steps] for k in label_frames], at_clouds)
        if not fits_better(before, after):
            continue
        gain = after.mean() - before.mean()
        if gain > best_gain:
            unit = "samples" if abs(steps) > 1 else "sample"
            best = Shift(f"{abs(steps)} {unit}", behind=steps < 0, before=before, after=after)
            best_gain = gain
    return best


def _mark_moved(boxes: BoxRows, other_boxes: BoxRows) -> Mask:
    """Mark boxes whose centres are farther than `MAX_STILL_M` from the centres of all other boxes.

    other_boxes: boxes of another frame, in the same world frame."""
    from scipy.spatial import cKDTree

    if not len(boxes) or not len(other_boxes):
        return np.ones(len(boxes), bool)
    # distance (m) of each centre from the nearest centre of the others
    distances, _ = cKDTree(other_boxes[:, :3]).query(boxes[:, :3])
    return np.asarray(distances > MAX_STILL_M)


def _move_along(movers: MovingBoxes, seconds: float) -> BoxRows:
    """Boxes of moving objects some seconds later, or earlier if negative, at constant velocity."""
    path = np.column_stack([seconds * movers.velocities, np.zeros((len(movers.boxes), 5))])
    return movers.boxes + path
