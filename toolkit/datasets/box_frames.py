"""Boxes and headings in other frames."""

import numpy as np

from toolkit.arrays import Float64, Pose, Shaped
from toolkit.datasets.problem_kinds import TILTED, Problems, add_problem
from toolkit.geometry import pose, transform

MIN_LEVEL_COSINE = np.cos(np.deg2rad(8.0))  # a road's slope tilts a vehicle's frame
MIN_UPRIGHT_COSINE = np.cos(np.deg2rad(20.0))  # tilt of a road user's box


def heading(target_SE3_source: Pose, yaw: object) -> Float64[np.ndarray, "*n"]:
    """Turn headings of the source frame into headings of the target frame (rad, -pi to pi).

    The result is the direction of the turned forward axis, seen from above. target_SE3_source: pose
    of the source frame in the target frame; yaw: number or array (rad), counter-clockwise from
    +x."""
    yaw = np.asarray(yaw, np.float64)
    forward = np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=-1)
    rotation = target_SE3_source[:3, :3]
    turned_forward = forward @ rotation.T
    x, y = turned_forward[..., 0], turned_forward[..., 1]
    return np.asarray(np.arctan2(y, x))


def level_frame(map_SE3_frame: Pose) -> Pose:
    """Return the pose of a frame with z up, in which boxes can be given.

    A pose tilted by more than 8° is a sensor's, not a vehicle's: it is turned level, with its
    position and heading kept. Any other pose comes back as it is."""
    tilt_cosine = map_SE3_frame[2, 2]
    if tilt_cosine >= MIN_LEVEL_COSINE:
        return map_SE3_frame
    x, y, z = map_SE3_frame[:3, 3]
    return pose(x, y, z, yaw=float(heading(map_SE3_frame, 0.0)))


def move_boxes(target_SE3_source: Pose, boxes: Shaped[np.ndarray, "n 7"]) -> np.ndarray:
    """Turn boxes of the source frame into boxes of the target frame.

    target_SE3_source: pose of the source frame in the target frame. z must be up in both, as a box
    keeps only its heading. Boxes with NaN give NaN."""
    centres, extents = boxes[:, :3], boxes[:, 3:6]
    yaws = boxes[:, 6]
    with np.errstate(all="ignore"):
        moved_centres = transform(target_SE3_source, centres)
        moved_yaws = heading(target_SE3_source, yaws)
        return np.column_stack([moved_centres, extents, moved_yaws])


def find_headings(
    rotations: Float64[np.ndarray, "n 3 3"], problems: Problems
) -> Float64[np.ndarray, " n"]:
    """Headings (rad, -pi to pi) of boxes, seen from above, from their rotation matrices.

    Boxes with more tilt than any road are counted in `problems`, which is changed in place."""
    tilt_cosines = rotations[:, 2, 2]
    forward_x, forward_y = rotations[:, 0, 0], rotations[:, 1, 0]
    with np.errstate(invalid="ignore"):
        add_problem(problems, TILTED, int((tilt_cosines < MIN_UPRIGHT_COSINE).sum()))
    return np.asarray(np.arctan2(forward_y, forward_x))
