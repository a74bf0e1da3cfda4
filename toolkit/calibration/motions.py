"""Motions of a pose: six numbers, turns and moves.

A motion is turns (rad) about the world's axes through the sensor, and moves (m) along them,

    pose = [exp(turn) R, t + move].

Turns are counted times `LEVER_M`, so that all six numbers are metres."""

import numpy as np

from toolkit.arrays import Float64, Points, Pose
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


def apply_motion(pose: Pose, motion: Motion) -> Pose:
    """Apply a motion, turns times `LEVER_M`, to a pose."""
    after = pose.copy()
    after[:3, :3] = make_rotation(motion[:3] / LEVER_M) @ pose[:3, :3]
    after[:3, 3] += motion[3:]
    return after


def motion_between(before: Pose, after: Pose) -> Motion:
    """Motion for `apply_motion` from one pose to another."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec()
    return np.concatenate([LEVER_M * turn, after[:3, 3] - before[:3, 3]])


def resistance(
    points: Points, position: Float64[np.ndarray, "3"], normals: Points
) -> Float64[np.ndarray, "n 6"]:
    """Distance that each point leaves its plane per unit of a motion about a position, turns times
    `LEVER_M`."""
    return np.concatenate([np.cross(points - position, normals) / LEVER_M, normals], axis=1)
