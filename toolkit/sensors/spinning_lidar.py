"""`SpinningLidar`: a lidar whose lasers turn about its axis."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from toolkit.arrays import Float, Float32
from toolkit.sensors.model import check_noise, frozen, with_noise


@dataclass(frozen=True)
class SpinningLidar:
    """A spinning lidar; frame: x forward, y left, z up.

    channels: laser rows, top first; fov_up, fov_down: highest and lowest row (rad above the horizon);
    azimuth_step: rad between columns; azimuth_fov: rad swept, centred on +x; sigma: noise of the range (m);
    max_range: range beyond which nothing returns (m).
    """

    channels: int = 64
    fov_up: float = np.deg2rad(10.0)
    fov_down: float = np.deg2rad(-40.0)
    azimuth_step: float = np.deg2rad(0.4)
    azimuth_fov: float = 2 * np.pi
    sigma: float = 0.02
    max_range: float = 120.0

    def __post_init__(self) -> None:
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

    def rays(self) -> Float32[np.ndarray, "rows columns 3"]:
        """Unit ray per laser and azimuth, sensor frame."""
        return _lidar_rays(self)

    def noisy(
        self, ranges: Float[np.ndarray, "rows columns"], rng: np.random.Generator
    ) -> Float32[np.ndarray, "rows columns"]:
        """Ranges with N(0, sigma) added; what returned nothing still returns nothing."""
        return with_noise(ranges, self, rng)


@lru_cache(maxsize=64)
def _lidar_rays(lidar: SpinningLidar) -> np.ndarray:
    rows, columns = lidar.shape
    elevation = np.linspace(lidar.fov_up, lidar.fov_down, rows)[:, None]
    azimuth = (np.arange(columns) - (columns - 1) / 2) * lidar.azimuth_fov / columns
    flat = np.cos(elevation)
    return frozen(np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation) + 0 * azimuth], axis=-1))
