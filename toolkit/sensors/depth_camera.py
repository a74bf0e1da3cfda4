"""`DepthCamera`: a pinhole depth camera."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from toolkit.arrays import Float, Float32, Float64
from toolkit.sensors.model import check_noise, frozen, with_noise


@dataclass(frozen=True)
class DepthCamera:
    """A pinhole depth camera; frame: x right, y down, z forward. The defaults are the paper's.

    width, height: full image (pixels); stride: every stride-th pixel of each row and column is measured;
    fov: horizontal field of view (rad); sigma: standard deviation of the additive depth noise (m);
    max_range: depth beyond which nothing returns (m); centre: principal point (u, v) in pixels of the full image,
    None for the middle.
    """

    width: int = 400
    height: int = 300
    stride: int = 2
    fov: float = np.pi / 2
    sigma: float = 0.015
    max_range: float = 1000.0
    centre: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if min(self.width, self.height, self.stride) < 1:
            raise ValueError(f"width, height and stride must be at least 1, got {self}")
        if not 0 < self.fov < np.pi:
            raise ValueError(f"fov must lie between 0 and pi rad, got {self.fov}: give degrees as np.deg2rad(90)")
        if self.centre is not None and not (len(self.centre) == 2 and np.isfinite(self.centre).all()):
            raise ValueError(f"centre must be two numbers u, v (pixels), got {self.centre}")
        check_noise(self.sigma, self.max_range)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns that are measured."""
        return -(-self.height // self.stride), -(-self.width // self.stride)

    @property
    def intrinsic(self) -> Float64[np.ndarray, "3 3"]:
        """K in pixels of the full image: f = (width / 2) / tan(fov / 2), both ways; principal point `centre`."""
        focal = self.width / 2 / np.tan(self.fov / 2)
        u, v = self.centre or (self.width / 2, self.height / 2)
        return np.array([[focal, 0.0, u], [0.0, focal, v], [0.0, 0.0, 1.0]])

    def rays(self) -> Float32[np.ndarray, "rows columns 3"]:
        """Ray per measured pixel, camera frame, z = 1: ((u - cu) / f, (v - cv) / f, 1)."""
        return _camera_rays(self)

    def noisy(
        self, depth: Float[np.ndarray, "rows columns"], rng: np.random.Generator
    ) -> Float32[np.ndarray, "rows columns"]:
        """Depth with N(0, sigma) added; what returned nothing still returns nothing."""
        return with_noise(depth, self, rng)


@lru_cache(maxsize=64)
def _camera_rays(camera: DepthCamera) -> np.ndarray:
    (focal, _, cu), (_, _, cv), _ = camera.intrinsic
    u, v = np.arange(0, camera.width, camera.stride), np.arange(0, camera.height, camera.stride)
    x, y = np.meshgrid((u - cu) / focal, (v - cv) / focal)
    return frozen(np.stack([x, y, np.ones_like(x)], axis=-1))
