"""Fit of boxes to the points of a frame.

A correct box has points just within its faces, none in its middle and nothing close around it but
ground. The fit of a box is the share of its points just within its faces, among all points within
the box and `SHELL_M` around it. Only points at least `CLEARANCE_M` above the ground count. A box
with hardly any points has a fit of 0."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Float, Float64, Points
from toolkit.boxes import count_points
from toolkit.calibration.ground import Ground, level
from toolkit.frame import Frame

CLEARANCE_M = 0.3  # least height above the ground of points that count
SHELL_M = 0.5  # width of the space around a box in which a correct box has no points
BOX_SLACK_M = 0.1  # distance that a point may be outside its box, as sensors err
HOLLOW_SHARE = 0.6  # inner share of a box's length and width, in which no sensor sees a vehicle
MIN_BOX_POINTS = 15  # points in and around a box; its fit is 0 below this
MIN_FITTED_BOXES = 5  # boxes with a fit; nothing is suspected below this
MIN_STANDARD_ERRORS = 3.0  # least mean change of fits for a suspicion, in standard errors
MIN_FIT_GAIN = 0.02  # least gain in mean fit for a suspicion
GROUND_POINTS = 20_000  # evenly spaced points of a cloud for finding its ground
SHIFTS_S = (0.05, 0.1, 0.2, 0.3, 0.5, 1.0)  # tried delays of labels and clouds, late or early


@dataclass(frozen=True, eq=False)
class GroundView:
    """Frame with its points above the ground.

    Attributes:
        sample: the frame.
        points: points (m, world frame) of its sensors, without those near or below the ground.
        ground: the ground, None if none was found; then all points are kept."""

    sample: Frame
    points: Float64[np.ndarray, "n 3"]
    ground: Ground | None = None

    @staticmethod
    def from_frame(sample: Frame) -> "GroundView":
        """Return a frame with its ground, and its points without the ground's.

        If no ground is found, `ground` is None and all points stay."""
        points = sample.points()
        step = max(1, len(points) // GROUND_POINTS)
        try:
            ground = level(points[::step], method="map")
        except ValueError:
            return GroundView(sample, points)
        unfiltered_view = GroundView(sample, points, ground)
        return GroundView(sample, unfiltered_view.above_ground(points), ground)

    def above_ground(self, points: Points) -> Float64[np.ndarray, "_ 3"]:
        """Points (world frame) at least `CLEARANCE_M` above the ground.

        All points are returned if there is no ground."""
        if self.ground is None:
            return np.asarray(points, np.float64)
        return points[points[:, 2] - self.ground.height(points[:, :2]) > CLEARANCE_M]


def measure_view_fits(
    views: Sequence[GroundView], boxes: Sequence[np.ndarray]
) -> Float64[np.ndarray, " n"]:
    """Share of points on the faces of boxes, 0 to 1, frame after frame in one array.

    views: frames with their points; boxes: boxes (m, 7) of each frame, world frame."""
    fits_by_frame = [np.zeros(0)]
    for view, view_boxes in zip(views, boxes, strict=True):
        if len(view_boxes):
            fits_by_frame.append(measure_fits(view.points, view_boxes))
    return np.concatenate(fits_by_frame)


def measure_fits(points: Points, boxes: Float[np.ndarray, "m 7"]) -> Float64[np.ndarray, " m"]:
    """Fit of boxes to points above the ground, 0 to 1.

    The fit is the share of the points in and around a box that are on its faces, 0 for fewer than
    `MIN_BOX_POINTS`. points: one frame's (m), in the frame of the boxes; boxes: x, y, z, length,
    width, height, yaw of each."""
    # Rows of x, y, z, length, width, height, yaw. Added to a box, this one grows it by one metre on
    # each side and above; z rises by half a metre, so that the floor stays where it is.
    one_metre_around = np.array([0, 0, 0.5, 2, 2, 1, 0])
    # the hollow middle of each box, from its floor to 0.2 m below its roof
    hollow_boxes = boxes * [1, 1, 1, HOLLOW_SHARE, HOLLOW_SHARE, 1, 1] - np.array(
        [0, 0, BOX_SLACK_M, 0, 0, 2 * BOX_SLACK_M, 0]
    )
    hollow_boxes[:, 5] = np.maximum(hollow_boxes[:, 5], 1e-6)  # heights of very low boxes
    boxes_with_surroundings = boxes + SHELL_M * one_metre_around
    boxes_with_slack = boxes + BOX_SLACK_M * one_metre_around
    all_boxes = np.concatenate([boxes_with_surroundings, boxes_with_slack, hollow_boxes])
    counts = count_points(points, all_boxes).reshape(3, -1)  # axes: kind of box as above, box
    near_counts = counts[0]
    face_counts = counts[1] - counts[2]  # in the box, but not in its hollow middle
    return np.where(near_counts >= MIN_BOX_POINTS, face_counts / np.maximum(near_counts, 1), 0.0)


def fits_better(
    before: Float64[np.ndarray, " n"], after: Float64[np.ndarray, " n"], gain: float = MIN_FIT_GAIN
) -> bool:
    """Return True if the same boxes fit better by `gain` on average, and beyond chance.

    before, after: fit of each box, 0 to 1; boxes whose fit is 0 in both do not count."""
    changes = (after - before)[(after > 0) | (before > 0)]
    if len(changes) < MIN_FITTED_BOXES or changes.mean() < gain:
        return False
    # the standard error of a mean is the deviation over the root of the number
    least_change = MIN_STANDARD_ERRORS * changes.std() / np.sqrt(len(changes))
    return bool(changes.mean() >= least_change)
