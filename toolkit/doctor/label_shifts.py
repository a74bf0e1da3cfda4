"""Delay of labels against their clouds."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import BoxRows, Float, Float64, Mask
from toolkit.datasets import box_frames
from toolkit.doctor.box_fits import (
    MIN_FITTED_BOXES,
    SHIFTS_S,
    GroundView,
    fits_better,
    measure_view_fits,
)
from toolkit.doctor.moving_boxes import find_moving
from toolkit.geometry import invert

MAX_FRAME_SHIFT = 3  # largest delay, in frames, that is tried
MAX_STILL_M = 0.2  # largest movement of a standing object between frames


class Shift(NamedTuple):
    """Delay of labels against the clouds.

    Attributes:
        amount: size of the delay in words, such as 0.2 s or 1 sample.
        is_behind: True if labels show objects at an earlier time than the clouds.
        fits_before: fit of each moving box as it is.
        fits_after: fit of the same boxes without the delay."""

    amount: str
    is_behind: bool
    fits_before: Float64[np.ndarray, " n"]
    fits_after: Float64[np.ndarray, " n"]


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
        return measure_view_fits(views, [moving.move(shift_s) for moving in movers])

    fits_now = measure_shifted_fits(0.0)
    shifts_s = [sign * seconds for seconds in SHIFTS_S for sign in (1, -1)]
    fits_by_shift = {shift_s: measure_shifted_fits(shift_s) for shift_s in shifts_s}
    best_s = max(fits_by_shift, key=lambda shift_s: fits_by_shift[shift_s].mean())
    if not fits_better(fits_now, fits_by_shift[best_s]):
        return None
    return Shift(
        amount=f"{abs(best_s):g} s",
        is_behind=best_s > 0,
        fits_before=fits_now,
        fits_after=fits_by_shift[best_s],
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
        stored_boxes = []
        shifted_boxes = []
        for k in label_frames:
            sample = views[k].sample
            other_sample = views[k + steps].sample
            other_SE3_world = invert(other_sample.map_SE3_world) @ sample.map_SE3_world
            boxes = box_frames.move_boxes(other_SE3_world, sample.objects.boxes)
            is_moving = _mark_moved(boxes, other_sample.objects.boxes)
            stored_boxes.append(sample.objects.boxes[is_moving])
            shifted_boxes.append(boxes[is_moving])
        fits_before = measure_view_fits([views[k] for k in label_frames], stored_boxes)
        fits_after = measure_view_fits([views[k + steps] for k in label_frames], shifted_boxes)
        if not fits_better(fits_before, fits_after):
            continue
        gain = fits_after.mean() - fits_before.mean()
        if gain > best_gain:
            unit = "samples" if abs(steps) > 1 else "sample"
            best = Shift(
                amount=f"{abs(steps)} {unit}",
                is_behind=steps < 0,
                fits_before=fits_before,
                fits_after=fits_after,
            )
            best_gain = gain
    return best


def _mark_moved(boxes: BoxRows, other_boxes: Float[np.ndarray, "others 7"]) -> Mask:
    """Mark boxes whose centres are farther than `MAX_STILL_M` from the centres of all other boxes.

    other_boxes: boxes of another frame, in the same world frame."""
    from scipy.spatial import cKDTree

    if not len(boxes) or not len(other_boxes):
        return np.ones(len(boxes), bool)
    # distance (m) of each centre from the nearest centre of the others
    distances, _ = cKDTree(other_boxes[:, :3]).query(boxes[:, :3])
    return np.asarray(distances > MAX_STILL_M)
