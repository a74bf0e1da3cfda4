"""A grid of rays at even steps of elevation and azimuth, as lidars have: its rays, what is in view, windows of boxes.

Frame: x forward, y left, z up. Rows from the top down, columns from the right (-y) to the left, centred on +x.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float32, Float64, Int64
from toolkit.sensors.model import clipped, frozen


class AngleGrid(NamedTuple):
    """rows from elevation `up` down to `down`, columns over `width` (rad), up to a range (m)."""

    rows: int
    columns: int
    up: float
    down: float
    width: float
    max_range: float


@lru_cache(maxsize=64)
def unit_rays(grid: AngleGrid) -> Float32[np.ndarray, "rows columns 3"]:
    """Unit ray per row and column."""
    elevation = np.linspace(grid.up, grid.down, grid.rows)[:, None]
    azimuth = (np.arange(grid.columns) - (grid.columns - 1) / 2) * grid.width / grid.columns
    flat = np.cos(elevation)
    return frozen(np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation) + 0 * azimuth], axis=-1))


def in_grid(grid: AngleGrid, points: Float64[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
    """Which points lie between the first and last row and column, and in range."""
    x, y, z = np.moveaxis(points, -1, 0)
    across = np.hypot(x, y)
    elevation = np.arctan2(z, across)
    in_rows = (grid.down <= elevation) & (elevation <= grid.up)
    return in_rows & (np.abs(np.arctan2(y, x)) <= grid.width / 2) & (np.hypot(across, z) < grid.max_range)


def grid_windows(grid: AngleGrid, sensor_corners: Float64[np.ndarray, "n 8 3"]) -> Int64[np.ndarray, "m 5"]:
    """Rectangles round the sphere through the corners of each box, at up to three turns of the azimuth."""
    middle = sensor_corners.mean(axis=1)
    radius = np.linalg.norm(sensor_corners - middle[:, None], axis=2).max(axis=1, initial=0)
    distance, across = np.linalg.norm(middle, axis=1), np.linalg.norm(middle[:, :2], axis=1)
    elevation = np.arcsin(middle[:, 2] / np.maximum(distance, 1e-9))
    azimuth = np.arctan2(middle[:, 1], middle[:, 0])
    per_row = (grid.up - grid.down) / max(grid.rows - 1, 1) or np.inf
    per_column = grid.width / grid.columns
    half_rows = _half_angle(radius, distance) / per_row
    half_columns = np.minimum(_half_angle(radius, across), np.pi) / per_column
    row = (grid.up - elevation) / per_row
    turns = []
    for turn in (-2 * np.pi, 0.0, 2 * np.pi):
        column = (azimuth + turn) / per_column + (grid.columns - 1) / 2
        bounds = (
            np.floor(row - half_rows),
            np.ceil(row + half_rows) + 1,
            np.floor(column - half_columns),
            np.ceil(column + half_columns) + 1,
        )
        turns.append(np.column_stack([np.arange(len(middle)), *bounds])[distance - radius < grid.max_range])
    return clipped(np.concatenate(turns), (grid.rows, grid.columns))


def _half_angle(radius: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Half the angle under which a sphere appears; a full turn from inside it."""
    return np.where(distance > radius, np.arcsin(np.minimum(radius / np.maximum(distance, 1e-9), 1)), 2 * np.pi)
