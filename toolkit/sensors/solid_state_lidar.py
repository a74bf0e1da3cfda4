"""`SolidStateLidar`: a lidar without moving parts, whose field of view is a rectangle of angles ahead."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from toolkit.arrays import Bool, Float, Float32, Float64, Int64
from toolkit.sensors.angle_grid import AngleGrid, grid_windows, in_grid, unit_rays
from toolkit.sensors.model import Measure, angle, check_noise, check_numbers, with_noise


@dataclass(frozen=True)
class SolidStateLidar:
    """A solid-state lidar; frame: x forward, y left, z up.

    rows, columns: pixels; horizontal_fov, vertical_fov: its field of view (rad), centred on +x; sigma: noise of the
    range (m) at the sensor, which grows by `sigma_per_metre` with the range; max_range: range beyond which nothing
    returns (m).
    """

    kind: ClassVar[str] = "solidstate"
    measures: ClassVar[Measure] = "range"
    body_SE3_sensor: ClassVar[np.ndarray] = np.eye(4)

    rows: int = 64
    columns: int = 300
    horizontal_fov: float = angle(float(np.deg2rad(120.0)))
    vertical_fov: float = angle(float(np.deg2rad(25.0)))
    sigma: float = 0.02
    sigma_per_metre: float = 0.0003
    max_range: float = 150.0

    def __post_init__(self) -> None:
        check_numbers(self)
        if min(self.rows, self.columns) < 1:
            raise ValueError(f"rows and columns must be at least 1, got {self.rows} and {self.columns}")
        if not (0 < self.horizontal_fov <= 2 * np.pi and 0 < self.vertical_fov <= np.pi):
            raise ValueError(
                "need 0 < horizontal_fov <= 2 pi and 0 < vertical_fov <= pi rad, got "
                f"{self.horizontal_fov} and {self.vertical_fov}: give degrees as np.deg2rad(120)"
            )
        check_noise(self.sigma, self.max_range)
        if not 0 <= self.sigma_per_metre < np.inf:
            raise ValueError(f"sigma_per_metre must be finite and not negative, got {self.sigma_per_metre}")

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rows, self.columns

    def rays(self) -> Float32[np.ndarray, "rows columns 3"]:
        """Unit ray per pixel, sensor frame."""
        return unit_rays(self._grid)

    def deviation(self, measurement: Float[np.ndarray, "*shape"]) -> Float32[np.ndarray, "*shape"]:
        """sigma + sigma_per_metre · range."""
        return np.float32(self.sigma) + np.float32(self.sigma_per_metre) * np.asarray(measurement, np.float32)

    def noisy(
        self, measurement: Float[np.ndarray, "rows columns"], rng: np.random.Generator
    ) -> Float32[np.ndarray, "rows columns"]:
        """Ranges with normal noise of their `deviation`; what returned nothing still returns nothing."""
        return with_noise(measurement, self, rng)

    def in_view(self, points: Float64[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
        """Which points of the lidar's frame lie in its field of view and range."""
        return in_grid(self._grid, points)

    def windows(self, sensor_corners: Float64[np.ndarray, "n 8 3"]) -> Int64[np.ndarray, "m 5"]:
        """Pixels that may meet each box."""
        return grid_windows(self._grid, sensor_corners)

    @property
    def _grid(self) -> AngleGrid:
        up = self.vertical_fov / 2
        return AngleGrid(self.rows, self.columns, up, -up, self.horizontal_fov, self.max_range)
