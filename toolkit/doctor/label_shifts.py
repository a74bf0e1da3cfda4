"""Delay of labels against their clouds."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import BoxRows, Float64
from toolkit.datasets import box_frames
from toolkit.doctor.box_fits import MIN_FITTED_BOXES, SHIFTS_S, GroundView, fits, fits_better
from toolkit.doctor.moving_boxes import MovingBoxes, find_moving
from toolkit.geometry import invert

MAX_FRAME_SHIFT = 3  # tried delays of clouds without times
MAX_STILL_M = 0.2  # between frames, of an object that does not move


class Shift(NamedTuple):
    """Delay of labels, and fits with and without it.

    amount: delay in words; behind: True if labels are late."""

    amount: str
    behind: bool
    before: Float64[np.ndarray, " n"]
    after: Float64[np.ndarray, " n"]


def find_shift(views: Sequence[GroundView]) -> Shift | None:
    """Find the delay of labels, None if there is no clear one.

    Moving labels are moved along their tracks. If that shows nothing, labels are tried in other
    clouds; only labels that are not in the same place in both frames count."""
    from scipy.spatial import cKDTree

    samples = [view.sample for view in views]
    movers = [find_moving(samples, k) for k in range(len(views))]

    def measure_shifted_fits(shift: float) -> np.ndarray:
        return fits(views, [_move_along(moving, shift) for moving in movers])

    if sum(len(moving.boxes) for moving in movers) >= MIN_FITTED_BOXES:
        now = measure_shifted_fits(0.0)
        shifted = {
            sign * seconds: measure_shifted_fits(sign * seconds)
            for seconds in SHIFTS_S
            for sign in (1, -1)
        }
        best = max(shifted, key=lambda shift: shifted[shift].mean())
        if fits_better(now, shifted[best]):
            return Shift(f"{abs(best):g} s", best > 0, now, shifted[best])
    frame_shift: Shift | None = None
    for steps in [sign * k for k in range(1, MAX_FRAME_SHIFT + 1) for sign in (1, -1)]:
        numbers = [k for k in range(len(views)) if 0 <= k + steps < len(views)]
        pairs = [(views[k], views[k + steps]) for k in numbers]
        at_labels = []
        at_clouds = []
        for labels, cloud in pairs:
            to_cloud = invert(cloud.sample.map_SE3_world) @ labels.sample.map_SE3_world
            boxes = box_frames.move_boxes(to_cloud, labels.sample.objects.boxes)
            cloud_boxes = cloud.sample.objects.boxes
            # farther than `MAX_STILL_M` from all labels of the cloud's frame
            is_moving = np.ones(len(boxes), bool)
            if len(boxes) and len(cloud_boxes):
                distances = cKDTree(cloud_boxes[:, :3]).query(boxes[:, :3])[0]
                is_moving = np.asarray(distances > MAX_STILL_M)
            at_labels.append(labels.sample.objects.boxes[is_moving])
            at_clouds.append(boxes[is_moving])
        before = fits([labels for labels, _ in pairs], at_labels)
        after = fits([cloud for _, cloud in pairs], at_clouds)
        if not fits_better(before, after):
            continue
        best_gain = -np.inf
        if frame_shift is not None:
            best_gain = frame_shift.after.mean() - frame_shift.before.mean()
        if after.mean() - before.mean() > best_gain:
            amount = f"{abs(steps)} sample{'s' * (abs(steps) > 1)}"
            frame_shift = Shift(amount, steps < 0, before, after)
    return frame_shift


def _move_along(movers: MovingBoxes, seconds: float) -> BoxRows:
    """Boxes of moving objects after some time."""
    path = np.column_stack([seconds * movers.velocities, np.zeros((len(movers.boxes), 5))])
    return movers.boxes + path
