"""`RowLidar`: a lidar whose rows of lasers are not evenly spaced, as many are built and as clouds of any show them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from toolkit.arrays import Bool, Float, Float32, Float64, Int64
from toolkit.geometry import pose
from toolkit.sensors.angle_grid import AngleGrid, grid_windows, in_grid
from toolkit.sensors.model import Measure, angle, check_noise, check_numbers, frozen, with_noise

_DEGREES = [15, 10, 7, 5, 3, *np.arange(2.0, -4.5, -1 / 3), -5, -6, -7, -9, -11, -15, -25]
_ELEVATIONS = tuple(np.deg2rad(_DEGREES).tolist())


@dataclass(frozen=True)
class RowLidar:
    """A lidar of rows; frame: x forward, y left, z up.

    elevations: of its rows (rad above the horizon), top first; columns: of the azimuths it sweeps; azimuth_fov: rad
    swept, centred on `heading` (rad from +x to the left); sigma: noise of the range (m); max_range: range beyond which
    nothing returns (m).
    """

    kind: ClassVar[str] = "rowlidar"
    measures: ClassVar[Measure] = "range"

    elevations: tuple[float, ...] = angle(_ELEVATIONS)
    columns: int = 1800
    azimuth_fov: float = angle(2 * np.pi)
    heading: float = angle(0.0)
    sigma: float = 0.02
    max_range: float = 200.0

    def __post_init__(self) -> None:
        check_numbers(self)
        rows = np.array(self.elevations, np.float64)
        if rows.ndim != 1 or not len(rows) or not np.isfinite(rows).all() or (np.diff(rows) >= 0).any():
            raise ValueError(f"elevations must fall from row to row, got {str(self.elevations)[:60]}")
        if np.abs(rows).max() > np.pi / 2:
            raise ValueError(f"elevations must lie in -pi/2..pi/2 rad, got {rows[0]:.2f} to {rows[-1]:.2f}")
        if self.columns < 1:
            raise ValueError(f"columns must be at least 1, got {self.columns}")
        if not (0 < self.azimuth_fov <= 2 * np.pi + 1e-9 and abs(self.heading) <= np.pi + 1e-9):
            raise ValueError(f"need 0 < azimuth_fov <= 2 pi and heading within pi rad, got {self.azimuth_fov}")
        check_noise(self.sigma, self.max_range)

    @property
    def body_SE3_sensor(self) -> Float64[np.ndarray, "4 4"]:
        """The body looks along `heading`."""
        return pose(yaw=-self.heading)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return len(self.elevations), self.columns

    @property
    def horizontal_fov(self) -> float:
        """`azimuth_fov`."""
        return self.azimuth_fov

    @property
    def vertical_fov(self) -> float:
        """From the lowest row to the highest (rad)."""
        return self.elevations[0] - self.elevations[-1]

    def rays(self) -> Float32[np.ndarray, "rows columns 3"]:
        """Unit ray per row and azimuth, sensor frame; columns from the right to the left."""
        return _rays(self.elevations, self.columns, self.azimuth_fov, self.heading)

    def deviation(self, measurement: Float[np.ndarray, "*shape"]) -> np.float32:
        """`sigma`, at every range."""
        return np.float32(self.sigma)

    def noisy(
        self, measurement: Float[np.ndarray, "rows columns"], rng: np.random.Generator
    ) -> Float32[np.ndarray, "rows columns"]:
        """Ranges with N(0, sigma) added; what returned nothing still returns nothing."""
        return with_noise(measurement, self, rng)

    def in_view(self, points: Float64[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
        """Which points of the lidar's frame lie between its rows, in the azimuths it sweeps and in range."""
        return in_grid(self._grid(2), self._ahead(points))

    def windows(self, sensor_corners: Float64[np.ndarray, "n 8 3"]) -> Int64[np.ndarray, "m 5"]:
        """Pixels that may meet each box; a box across the seam of the turn comes twice."""
        found = grid_windows(self._grid(1), self._ahead(sensor_corners))
        middle = sensor_corners.mean(axis=1)
        radius = np.linalg.norm(sensor_corners - middle[:, None], axis=2).max(axis=1, initial=0)
        distance = np.linalg.norm(middle, axis=1)
        half = np.where(distance > radius, np.arcsin(np.minimum(radius / np.maximum(distance, 1e-9), 1)), np.pi)
        elevation = np.arcsin(middle[:, 2] / np.maximum(distance, 1e-9))
        falling = -np.array(self.elevations)
        found[:, 1] = np.searchsorted(falling, -(elevation + half) - 1e-6)[found[:, 0]]
        found[:, 2] = np.searchsorted(falling, -(elevation - half) + 1e-6, side="right")[found[:, 0]]
        return found[found[:, 1] < found[:, 2]]

    def _ahead(self, points: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 3"]:
        return points @ self.body_SE3_sensor[:3, :3].T if self.heading else points

    def _grid(self, rows: int) -> AngleGrid:
        up, down = self.elevations[0], self.elevations[-1]
        return AngleGrid(rows, self.columns, up, down, self.azimuth_fov, self.max_range)


@lru_cache(maxsize=64)
def _rays(
    elevations: tuple[float, ...], columns: int, width: float, heading: float
) -> Float32[np.ndarray, "rows columns 3"]:
    elevation = np.array(elevations)[:, None]
    azimuth = heading + (np.arange(columns) - (columns - 1) / 2) * width / columns
    flat = np.cos(elevation)
    return frozen(np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation) + 0 * azimuth], axis=-1))
