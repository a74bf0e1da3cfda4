"""Motions of a pose: six numbers, three turns and three moves.

A motion is turns (rad) about the world's axes through the sensor, and moves (m) along them,

    pose = [exp(turn) R, t + move].

Turns are counted times `LEVER_M`, so that all six numbers are metres."""

from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float64, Points, Pose
from toolkit.sensors.error_terms import make_rotation

Motion = Float64[np.ndarray, "6"]  # turns times `LEVER_M` and moves, m
MOTION_NAMES = (
    "turn about x",
    "turn about y",
    "turn about z",
    "move along x",
    "move along y",
    "move along z",
)
LEVER_M = 10.0  # m: a turn is compared with a move as the move of a point this far off


class MotionModes(NamedTuple):
    """Independent motions, as eigenvectors of the information that pairs of points give.

    Attributes:
        values: eigenvalue of each mode: the information about it.
        vectors: (m, m) unit motion of each mode in its column, turns times `LEVER_M`.
        observed: mask of the modes that enough pairs resist."""

    values: Float64[np.ndarray, " m"]
    vectors: Float64[np.ndarray, "m m"]
    observed: Bool[np.ndarray, " m"]


def apply_motion(pose: Pose, motion: Motion) -> Pose:
    """Return a pose after a motion.

    pose: world_SE3_sensor; motion: turns (rad, about the world's axes through the sensor) times
    `LEVER_M`, then moves (m)."""
    after = pose.copy()
    after[:3, :3] = make_rotation(motion[:3] / LEVER_M) @ pose[:3, :3]
    after[:3, 3] += motion[3:]
    return after


def motion_between(before: Pose, after: Pose) -> Motion:
    """Return the motion that `apply_motion` needs to turn the pose `before` into `after`.

    Turns (a rotation vector in rad, world axes) times `LEVER_M`, then moves (m)."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec()
    return np.concatenate([LEVER_M * turn, after[:3, 3] - before[:3, 3]])


def resistance(
    points: Points, position: Float64[np.ndarray, "3"], normals: Points
) -> Float64[np.ndarray, "n 6"]:
    """Distance (m) that each point leaves its plane per unit of a sensor's motion.

    Args:
        points: points that move with the sensor, world frame.
        position: position of the sensor, about which turns are.
        normals: unit normal of the plane at each point, world axes.

    Columns are the motion's six numbers, turns times `LEVER_M` and moves."""
    by_turns = np.cross(points - position, normals) / LEVER_M
    by_moves = normals
    return np.concatenate([by_turns, by_moves], axis=1)
