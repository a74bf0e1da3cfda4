"""Motion of bodies whose points SUMO moves: smooth, with headings that follow the course."""

from math import atan2, cos, hypot, sin

import numpy as np

from toolkit.arrays import Float64
from toolkit.geometry import smooth_rows
from toolkit.traffic.sumo import FINE_STEP_S

SMOOTHING_S = 0.4  # standard deviation of the mean over time that makes motion smooth
REAR_AXLE_SHARE = 0.75  # distance of the rear axle from the front bumper, per length of the body
DIRECTION_SMOOTHING_S = 1.5  # smooths the direction that sides are counted from
MIN_WALKING_M_S = 0.25  # a slower pedestrian keeps the heading


def move_driver(
    fronts: Float64[np.ndarray, "steps 2"], yaw: float, length: float
) -> Float64[np.ndarray, "steps 3"]:
    """Return the poses (x, y of the middle, yaw) of a vehicle whose front takes a course.

    The rear axle follows the front as a trailer does, so headings turn smoothly and no body slides
    sideways.

    Args:
        fronts: x, y of the middle of the front bumper (m), one for each step of `FINE_STEP_S`.
        yaw: heading at the start (rad).
        length: length of the body (m)."""
    return _follow_front(smooth_motion(fronts), yaw, length)


def change_length(
    poses: Float64[np.ndarray, "steps 3"], length: float, new_length: float
) -> Float64[np.ndarray, "steps 3"]:
    """Return the poses of a vehicle of another length whose front takes the same course.

    Args:
        poses: x, y of the middle (m), yaw (rad), one for each step of `FINE_STEP_S`.
        length: length of the body that has these poses (m).
        new_length: length of the other body (m)."""
    directions = np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
    fronts = poses[:, :2] + length / 2 * directions
    return _follow_front(fronts, float(poses[0, 2]), new_length)


def _follow_front(
    fronts: Float64[np.ndarray, "steps 2"], yaw: float, length: float
) -> Float64[np.ndarray, "steps 3"]:
    """Return the poses (x, y of the middle, yaw) of a vehicle, given a smooth course of its front.

    Args:
        fronts: x, y of the middle of the front bumper (m), one for each step of `FINE_STEP_S`.
        yaw: heading at the start (rad).
        length: length of the body (m)."""
    axle_distance = REAR_AXLE_SHARE * length  # from the front bumper
    rear_x = float(fronts[0, 0]) - axle_distance * cos(yaw)
    rear_y = float(fronts[0, 1]) - axle_distance * sin(yaw)
    yaws = []
    for x, y in fronts.tolist():
        dx = x - rear_x
        dy = y - rear_y
        share = axle_distance / hypot(dx, dy)
        rear_x = x - share * dx
        rear_y = y - share * dy
        yaws.append(atan2(dy, dx))
    poses = np.empty((len(fronts), 3))
    poses[:, 2] = yaws
    poses[:, 0] = fronts[:, 0] - length / 2 * np.cos(poses[:, 2])
    poses[:, 1] = fronts[:, 1] - length / 2 * np.sin(poses[:, 2])
    return poses


def move_pedestrian(
    points: Float64[np.ndarray, "steps 2"], yaw: float
) -> Float64[np.ndarray, "steps 3"]:
    """Poses (x, y, yaw) of a pedestrian who takes a course and faces where it leads.

    Args:
        points: x, y (m), one for each step of `FINE_STEP_S`.
        yaw: heading at the start (rad), for one who does not move."""
    smoothed = smooth_motion(points)
    return np.column_stack([smoothed, face_course(smoothed, yaw)])


def face_course(
    points: Float64[np.ndarray, "steps 2"], yaw: float
) -> Float64[np.ndarray, " steps"]:
    """Headings (rad, without jumps) of a pedestrian who faces where the course leads.

    Slower than `MIN_WALKING_M_S` a pedestrian keeps the last heading.

    Args:
        points: x, y (m), one for each step of `FINE_STEP_S`.
        yaw: heading (rad) of one who never walks."""
    if len(points) < 2:
        return np.full(len(points), yaw)
    velocities = np.gradient(points, FINE_STEP_S, axis=0)
    is_walking = np.hypot(*velocities.T) >= MIN_WALKING_M_S
    if not is_walking.any():
        return np.full(len(points), yaw)
    yaws = np.arctan2(velocities[:, 1], velocities[:, 0])
    # step of the last heading that holds; before the first one, that one
    last = np.maximum.accumulate(np.where(is_walking, np.arange(len(yaws)), -1))
    last[last < 0] = int(np.argmax(is_walking))
    return smooth_motion(np.unwrap(yaws[last])[:, None])[:, 0]


def face_along(
    poses: Float64[np.ndarray, "steps 3"], moved: Float64[np.ndarray, "steps 3"]
) -> Float64[np.ndarray, "steps 3"]:
    """Poses of a pedestrian whose path was moved, turned as much as the path is.

    poses: x, y (m), yaw (rad) on the earlier path; moved: the same steps on the new path, still
    with the earlier headings."""
    turned = moved.copy()
    turned[:, 2] += face_course(moved[:, :2], yaw=0.0) - face_course(poses[:, :2], yaw=0.0)
    return turned


def smooth_motion(values: Float64[np.ndarray, "steps k"]) -> Float64[np.ndarray, "steps k"]:
    """Means over time, weighted by a Gaussian of `SMOOTHING_S`; the first and last value stay.

    values: one row for each step of `FINE_STEP_S`."""
    return smooth_rows(values, SMOOTHING_S / FINE_STEP_S)


def smooth_direction(yaws: Float64[np.ndarray, " steps"]) -> Float64[np.ndarray, " steps"]:
    """Headings (`yaws`, rad) smoothed over `DIRECTION_SMOOTHING_S`, without jumps at half turns.

    A body at a distance to the side of the course then takes a wide bend, instead of swinging round
    with each turn of the heading."""
    unwrapped = np.unwrap(yaws)[:, None]
    return smooth_rows(unwrapped, DIRECTION_SMOOTHING_S / FINE_STEP_S)[:, 0]


def shift_left(
    poses: Float64[np.ndarray, "steps 3"],
    directions: Float64[np.ndarray, " steps"],
    left: Float64[np.ndarray, " steps"] | float,
) -> Float64[np.ndarray, "steps 3"]:
    """Poses (x, y in m, yaw in rad) moved to the left of directions (rad) by distances (m).

    Headings stay."""
    shifted = poses.copy()
    shifted[:, 0] -= left * np.sin(directions)
    shifted[:, 1] += left * np.cos(directions)
    return shifted
