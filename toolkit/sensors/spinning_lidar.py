"""`SpinningLidar`: a lidar whose lasers turn about its axis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from toolkit.arrays import Bool, Float, Float32, Float64, Int64
from toolkit.sensors.angle_grid import AngleGrid, grid_windows, in_grid, unit_rays
from toolkit.sensors.model import Measure, angle, check_noise, check_numbers, with_noise


@dataclass(frozen=True)
class SpinningLidar:
    """A spinning lidar; frame: x forward, y left, z up.

    channels: laser rows, top first; fov_up, fov_down: highest and lowest row (rad above the horizon);
    azimuth_step: rad between columns; azimuth_fov: rad swept, centred on +x; sigma: noise of the range (m);
    max_range: range beyond which nothing returns (m).
    """

    kind: ClassVar[str] = "lidar"
    measures: ClassVar[Measure] = "range"
    body_SE3_sensor: ClassVar[np.ndarray] = np.eye(4)

    channels: int = 64
    fov_up: float = angle(np.deg2rad(10.0))
    fov_down: float = angle(np.deg2rad(-40.0))
    azimuth_step: float = angle(np.deg2rad(0.4))
    azimuth_fov: float = angle(2 * np.pi)
    sigma: float = 0.02
    max_range: float = 120.0

    def __post_init__(self) -> None:
        check_numbers(self)
        if self.channels < 1:
            raise ValueError(f"channels must be at least 1, got {self.channels}")
        if not -np.pi / 2 <= self.fov_down <= self.fov_up <= np.pi / 2:
            raise ValueError(f"need -pi/2 <= fov_down <= fov_up <= pi/2 rad, got {self.fov_down} and {self.fov_up}")
        if not 0 < self.azimuth_step <= self.azimuth_fov <= 2 * np.pi + 1e-9:
            raise ValueError(f"need 0 < azimuth_step <= azimuth_fov <= 2 pi rad, got {self.azimuth_step}")
        check_noise(self.sigma, self.max_range)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows (channels) and columns (azimuths)."""
        return self.channels, max(1, round(self.azimuth_fov / self.azimuth_step))

    @property
    def horizontal_fov(self) -> float:
        """`azimuth_fov`."""
        return self.azimuth_fov

    @property
    def vertical_fov(self) -> float:
        """From the lowest row to the highest (rad)."""
        return self.fov_up - self.fov_down

    def rays(self) -> Float32[np.ndarray, "rows columns 3"]:
        """Unit ray per laser and azimuth, sensor frame."""
        return unit_rays(self._grid)

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
        return in_grid(self._grid, points)

    def windows(self, sensor_corners: Float64[np.ndarray, "n 8 3"]) -> Int64[np.ndarray, "m 5"]:
        """Pixels that may meet each box; a box across the seam of the turn comes twice."""
        return grid_windows(self._grid, sensor_corners)

    @property
    def _grid(self) -> AngleGrid:
        return AngleGrid(*self.shape, self.fov_up, self.fov_down, self.azimuth_fov, self.max_range)
