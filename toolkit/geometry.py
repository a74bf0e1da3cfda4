"""Rigid motions as 4×4 float64 arrays: `world_SE3_sensor` turns sensor coordinates into world
coordinates."""

from collections.abc import Iterable
from typing import SupportsFloat

import numpy as np

from toolkit.arrays import Float, Pose

Slope = tuple[float, float]  # rise (m per m) along x and along y of a plane through the origin
LEVEL: Slope = (0.0, 0.0)
STEEPEST = 0.3  # slope of a street
# A camera's axes (x right, y down, z forward) in a body's axes (x forward, y left, z up).
BODY_SE3_CAMERA = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
MAX_COORDINATE_M = 1e8  # the one limit of absolute coordinates; maps reach 1e7


def pose(
    x: float = 0.0,
    y: float = 0.0,
    z: float = 0.0,
    *,
    yaw: float = 0.0,
    pitch: float = 0.0,
    roll: float = 0.0,
) -> Pose:
    """Pose of a body at x, y, z (m), turned by roll about its x, then pitch about y, then yaw about
    z (rad).

    >>> transform(pose(1.0, 2.0, yaw=np.pi / 2), np.array([[1.0, 0.0, 0.0]])).round(6)
    array([[1., 3., 0.]])
    """
    (cy, sy), (cp, sp), (cr, sr) = ((np.cos(a), np.sin(a)) for a in (yaw, pitch, roll))
    forward = [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr, x]
    left = [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr, y]
    return np.array([forward, left, [-sp, cp * sr, cp * cr, z], [0.0, 0.0, 0.0, 1.0]], np.float64)


def look(position: Iterable[SupportsFloat], heading: float, tilt: float = 0.0) -> Pose:
    """Pose of a camera (x right, y down, z forward) at a position, heading (rad, counter-clockwise)
    and tilt down.

    >>> transform(look((0.0, 0.0, 5.0), heading=np.pi / 2), np.array([[0.0, 0.0, 10.0]])).round(6)
    array([[ 0., 10.,  5.]])
    """
    x, y, z = (float(p) for p in position)
    return pose(x, y, z, yaw=heading, pitch=tilt) @ BODY_SE3_CAMERA


def invert(world_SE3_sensor: Pose) -> Pose:
    """Return the inverse motion, world → sensor.

    >>> np.allclose(invert(pose(1.0, 2.0, 3.0, yaw=0.5)) @ pose(1.0, 2.0, 3.0, yaw=0.5), np.eye(4))
    True
    """
    rotation = world_SE3_sensor[:3, :3]
    translation = world_SE3_sensor[:3, 3]
    inverse = np.eye(4)
    inverse[:3, :3] = rotation.T
    inverse[:3, 3] = -rotation.T @ translation
    return inverse


def transform(
    target_SE3_source: Pose, points: Float[np.ndarray, "*n 3"]
) -> Float[np.ndarray, "*n 3"]:
    """Transform points (..., 3), dtype kept (paper equation 1)."""
    points = np.asarray(points)
    if points.ndim < 1 or points.shape[-1] != 3:
        hint = ": pass points.T?" if points.ndim == 2 and points.shape[0] == 3 else ""
        raise ValueError(f"points must have shape (n, 3), got {points.shape}{hint}")
    return points @ target_SE3_source[:3, :3].T.astype(points.dtype) + target_SE3_source[
        :3, 3
    ].astype(points.dtype)


def plane_rotation(angle: float) -> Float[np.ndarray, "2 2"]:
    """Rotation of the plane by an angle (rad, counter-clockwise)."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def check_slope(slope: Iterable[SupportsFloat], name: str) -> Slope:
    """Return a slope as two floats; ValueError beyond `STEEPEST`."""
    numbers = tuple(map(float, slope))
    if len(numbers) != 2 or not np.hypot(*numbers) <= STEEPEST:
        raise ValueError(
            f"{name} must be a rise along x and along y, at most {STEEPEST:.0%} together, got "
            f"{numbers}"
        )
    return numbers


def level_motion(slope: Slope, about: tuple[float, float] = (0.0, 0.0)) -> Pose:
    """Shear of the world that makes a slope level, keeping heights at `about` (x, y) and verticals
    vertical."""
    shear = np.eye(4)
    shear[2, :2] = -np.array(slope)
    shear[2, 3] = np.dot(slope, about)
    return shear


def level_rows(rows: Float[np.ndarray, "n c"], slope: Slope) -> Float[np.ndarray, "n c"]:
    """Return points (x, y, z) or boxes (x, y, z, ...) with z counted from the slope's plane through
    the origin."""
    if slope == LEVEL:
        return rows
    moved = rows.copy()
    moved[:, 2] -= rows[:, :2] @ np.array(slope, rows.dtype)
    return moved


def tilt_rows(rows: Float[np.ndarray, "n c"], slope: Slope) -> Float[np.ndarray, "n c"]:
    """Put points or boxes from `level_rows` back on the slope."""
    return level_rows(rows, (-slope[0], -slope[1]))


def check_pose(candidate: Float[np.ndarray, "..."], name: str = "pose") -> Pose:
    """Return a pose as float64; ValueError for no rigid motion."""
    matrix = np.asarray(candidate, np.float64)
    if matrix.shape != (4, 4):
        raise ValueError(f"{name} must have shape (4, 4), got {matrix.shape}")
    if not np.isfinite(matrix).all():
        raise ValueError(f"{name} holds NaN or infinite numbers: {matrix.tolist()}")
    rotation = matrix[:3, :3]
    if np.abs(matrix[3] - (0, 0, 0, 1)).max() > 1e-5:
        raise ValueError(
            f"{name} must end with the row 0 0 0 1, got {matrix[3].tolist()}: pass the transpose?"
        )
    if np.abs(matrix[:3, 3]).max() > MAX_COORDINATE_M:
        limit = f"{name} lies farther than {MAX_COORDINATE_M:g} m from the origin"
        raise ValueError(f"{limit}: give metres, got {matrix[:3, 3]}")
    determinant = float(np.linalg.det(rotation))
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3 or determinant < 0:
        problem = f"its 3×3 part has determinant {determinant:.3g}"
        remedy = ": it mirrors, flip one axis" if determinant < -0.5 else ""
        raise ValueError(f"{name} must be a rotation and a translation, but {problem}{remedy}")
    return matrix
