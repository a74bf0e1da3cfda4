"""Boxes and headings in other frames."""

import numpy as np

from toolkit.arrays import Float64, Pose, Shaped
from toolkit.datasets.problem_kinds import TILTED, Problems, add_problem
from toolkit.geometry import pose, transform

MIN_LEVEL_COSINE = np.cos(np.deg2rad(8.0))  # a road's slope tilts a vehicle's frame
MIN_UPRIGHT_COSINE = np.cos(np.deg2rad(20.0))  # tilt of a road user's box


def heading(target_SE3_source: Pose, yaw: object) -> Float64[np.ndarray, "*n"]:
    """Turn headings of the source frame into headings of the target frame (rad, -pi to pi).

    The result is the direction of the turned forward axis, seen from above. yaw: number or array,
    counter-clockwise from +x."""
    yaw = np.asarray(yaw, np.float64)
    forward = np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=-1)
    turned = forward @ target_SE3_source[:3, :3].T
    return np.asarray(np.arctan2(turned[..., 1], turned[..., 0]))


def level_frame(map_SE3_frame: Pose) -> Pose:
    """Return the pose of a frame that boxes can be given in.

    A pose tilted by more than 8° is of a sensor, not of a vehicle: it is turned level, with its
    position and heading kept. Any other pose comes back as it is."""
    if map_SE3_frame[2, 2] >= MIN_LEVEL_COSINE:
        return map_SE3_frame
    return pose(*map_SE3_frame[:3, 3], yaw=float(heading(map_SE3_frame, 0.0)))


def move_boxes(target_SE3_source: Pose, boxes: Shaped[np.ndarray, "n 7"]) -> np.ndarray:
    """Turn boxes of the source frame into boxes of the target frame.

    z must be up in both frames, as a box keeps only its heading. Boxes with NaN give NaN."""
    with np.errstate(all="ignore"):
        centres = transform(target_SE3_source, boxes[:, :3])
        yaws = heading(target_SE3_source, boxes[:, 6])
        return np.column_stack([centres, boxes[:, 3:6], yaws])


def find_headings(
    rotations: Float64[np.ndarray, "n 3 3"], problems: Problems
) -> Float64[np.ndarray, " n"]:
    """Headings (rad, -pi to pi) of boxes, seen from above, from their rotation matrices.

    Boxes with more tilt than any road are counted in `problems`, which changes."""
    with np.errstate(invalid="ignore"):
        add_problem(problems, TILTED, int((rotations[:, 2, 2] < MIN_UPRIGHT_COSINE).sum()))
    return np.asarray(np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0]))
