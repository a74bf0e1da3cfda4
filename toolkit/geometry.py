"""Rigid motions as 4×4 float64 arrays: `world_SE3_sensor` turns sensor coordinates into world
coordinates."""

from collections.abc import Iterable
from typing import SupportsFloat

import numpy as np

from toolkit.arrays import Float, Float64, Pose

Slope = tuple[float, float]  # rise (m per m) along x and along y of a plane through the origin
LEVEL: Slope = (0.0, 0.0)
STEEPEST = 0.3  # largest slope of the ground (m per m), steeper than any street
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
    """Pose (4, 4) of a body at x, y, z (m) with yaw, pitch and roll (rad).

    The body is turned by roll about x, then pitch about y (positive: nose down), then yaw about z
    (counter-clockwise from +x), all fixed axes of the outer frame.

    >>> transform(pose(1.0, 2.0, yaw=np.pi / 2), np.array([[1.0, 0.0, 0.0]])).round(6)
    array([[1., 3., 0.]])
    """
    cy, sy = np.cos(yaw), np.sin(yaw)
    cp, sp = np.cos(pitch), np.sin(pitch)
    cr, sr = np.cos(roll), np.sin(roll)
    # rows of the product Rz(yaw) Ry(pitch) Rx(roll), each with its part of the translation
    x_row = [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr, x]
    y_row = [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr, y]
    z_row = [-sp, cp * sr, cp * cr, z]
    return np.array([x_row, y_row, z_row, [0.0, 0.0, 0.0, 1.0]], np.float64)


def look(position: Iterable[SupportsFloat], heading: float, tilt: float = 0.0) -> Pose:
    """Pose (4, 4) of a camera (x right, y down, z forward) at a position, with a viewing direction.

    position: x, y, z (m); heading: direction of view (rad, counter-clockwise from +x); tilt: angle
    of view below the horizon (rad).

    >>> transform(look((0.0, 0.0, 5.0), heading=np.pi / 2), np.array([[0.0, 0.0, 10.0]])).round(6)
    array([[ 0., 10.,  5.]])
    """
    x, y, z = (float(p) for p in position)
    return pose(x, y, z, yaw=heading, pitch=tilt) @ BODY_SE3_CAMERA


def invert(world_SE3_sensor: Pose) -> Pose:
    """Return the inverse (4, 4) of a rigid motion: sensor_SE3_world of world_SE3_sensor.

    It transposes the rotation, so it is wrong for matrices with a shear or a scale.

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
    """Turn points from source into target coordinates (paper equation 1).

    points: x, y, z on the last axis (m). The result has their shape and dtype: float32 points give
    float32 results. The matrix may hold a shear."""
    points = np.asarray(points)
    if points.ndim < 1 or points.shape[-1] != 3:
        hint = ": pass points.T?" if points.ndim == 2 and points.shape[0] == 3 else ""
        raise ValueError(f"points must have shape (n, 3), got {points.shape}{hint}")
    rotation = target_SE3_source[:3, :3].astype(points.dtype)
    translation = target_SE3_source[:3, 3].astype(points.dtype)
    return points @ rotation.T + translation


def plane_rotation(angle: float) -> Float[np.ndarray, "2 2"]:
    """Matrix (2, 2) that turns column vectors x, y by an angle (rad, counter-clockwise)."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def smooth_rows(values: Float64[np.ndarray, "n k"], sigma: float) -> Float64[np.ndarray, "n k"]:
    """Means of neighbouring rows, weighted by a Gaussian; the first and last row stay.

    sigma: standard deviation (rows)."""
    from scipy.ndimage import gaussian_filter1d

    reach = int(np.ceil(4 * sigma))
    # continued by its mirror image through each end, so that a straight line stays
    continued = np.pad(values, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
    smoothed = gaussian_filter1d(continued, sigma, axis=0, mode="nearest")
    return np.asarray(smoothed[reach : reach + len(values)])


def check_slope(slope: Iterable[SupportsFloat], name: str) -> Slope:
    """Return a slope as two floats, rise along x and along y (m per m).

    Raises ValueError for another number of values, and for more than `STEEPEST` together. name:
    what errors call the slope."""
    numbers = tuple(map(float, slope))
    if len(numbers) != 2 or not np.hypot(*numbers) <= STEEPEST:
        raise ValueError(
            f"{name} must be a rise along x and along y, at most {STEEPEST:.0%} together, got "
            f"{numbers}"
        )
    return numbers


def level_motion(slope: Slope, about: tuple[float, float] = (0.0, 0.0)) -> Pose:
    """Matrix (4, 4) of a shear that makes sloping ground level.

    It changes z only, so verticals stay vertical. about: x, y (m) of the place at which heights
    stay as they are."""
    shear = np.eye(4)
    shear[2, :2] = -np.array(slope)
    shear[2, 3] = np.dot(slope, about)
    return shear


def level_rows(rows: Float[np.ndarray, "n c"], slope: Slope) -> Float[np.ndarray, "n c"]:
    """Return points or boxes with z counted from the plane of the slope through the origin.

    rows: x, y, z (m) in the first columns; other columns stay. For level ground the array itself
    comes back, otherwise a copy."""
    if slope == LEVEL:
        return rows
    levelled = rows.copy()
    ground_height = rows[:, :2] @ np.array(slope, rows.dtype)
    levelled[:, 2] -= ground_height
    return levelled


def tilt_rows(rows: Float[np.ndarray, "n c"], slope: Slope) -> Float[np.ndarray, "n c"]:
    """Undo `level_rows`: return points or boxes with z counted from z = 0 again."""
    return level_rows(rows, (-slope[0], -slope[1]))


def check_pose(candidate: Float[np.ndarray, "..."], name: str = "pose") -> Pose:
    """Return a pose as float64 (4, 4), or raise ValueError if it is no rigid motion.

    name: what errors call the pose. A float64 array comes back itself, not a copy."""
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
