"""`DepthCamera`: a pinhole depth camera."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from toolkit.arrays import Bool, Float, Float32, Float64, Int64
from toolkit.geometry import BODY_SE3_CAMERA
from toolkit.sensors.model import (
    NEAR,
    Measure,
    angle,
    check_noise,
    check_numbers,
    clipped,
    frozen,
    with_noise,
)

_PAIRS = np.array([(i, j) for i in range(8) for j in range(i + 1, 8)])  # of a box's corners, its edges among them


@dataclass(frozen=True)
class DepthCamera:
    """A pinhole depth camera; frame: x right, y down, z forward. The defaults are the paper's.

    width, height: full image (pixels); stride: every stride-th pixel of each row and column is measured;
    fov: horizontal field of view (rad); sigma: standard deviation of the additive depth noise (m);
    max_range: depth beyond which nothing returns (m); centre: principal point (u, v) in pixels of the full image,
    None for the middle.
    """

    kind: ClassVar[str] = "camera"
    measures: ClassVar[Measure] = "depth"
    body_SE3_sensor: ClassVar[np.ndarray] = BODY_SE3_CAMERA

    width: int = 400
    height: int = 300
    stride: int = 2
    fov: float = angle(np.pi / 2)
    sigma: float = 0.015
    max_range: float = 1000.0
    centre: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        check_numbers(self)
        if min(self.width, self.height, self.stride) < 1:
            raise ValueError(f"width, height and stride must be at least 1, got {self}")
        if not 0 < self.fov < np.pi:
            raise ValueError(f"fov must lie between 0 and pi rad, got {self.fov}: give degrees as np.deg2rad(90)")
        if self.centre is not None and not _is_pixel(self.centre):
            raise ValueError(f"centre must be two numbers (u, v) in pixels, got {self.centre}")
        check_noise(self.sigma, self.max_range)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns that are measured."""
        return -(-self.height // self.stride), -(-self.width // self.stride)

    @property
    def horizontal_fov(self) -> float:
        """`fov`."""
        return self.fov

    @property
    def vertical_fov(self) -> float:
        """Height of the field of view (rad), about the middle of the image."""
        return float(2 * np.arctan(self.height / 2 / self.intrinsic[1, 1]))

    @property
    def intrinsic(self) -> Float64[np.ndarray, "3 3"]:
        """K in pixels of the full image: f = (width / 2) / tan(fov / 2), both ways; principal point `centre`."""
        focal = self.width / 2 / np.tan(self.fov / 2)
        u, v = self.centre or (self.width / 2, self.height / 2)
        return np.array([[focal, 0.0, u], [0.0, focal, v], [0.0, 0.0, 1.0]])

    def rays(self) -> Float32[np.ndarray, "rows columns 3"]:
        """Ray per measured pixel, camera frame, z = 1: ((u - cu) / f, (v - cv) / f, 1)."""
        return _camera_rays(self)

    def deviation(self, measurement: Float[np.ndarray, "*shape"]) -> np.float32:
        """`sigma`, at every depth."""
        return np.float32(self.sigma)

    def noisy(
        self, measurement: Float[np.ndarray, "rows columns"], rng: np.random.Generator
    ) -> Float32[np.ndarray, "rows columns"]:
        """Depth with N(0, sigma) added; what returned nothing still returns nothing."""
        return with_noise(measurement, self, rng)

    def in_view(self, points: Float64[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
        """Which points of the camera's frame fall into its image, nearer than its range."""
        x, y, z = np.moveaxis(points, -1, 0)
        (focal, _, u), (_, _, v), _ = self.intrinsic
        in_columns = (-u * z <= focal * x) & (focal * x <= (self.width - u) * z)
        in_rows = (-v * z <= focal * y) & (focal * y <= (self.height - v) * z)
        return in_columns & in_rows & (z > 0) & (z < self.max_range)

    def windows(self, sensor_corners: Float64[np.ndarray, "n 8 3"]) -> Int64[np.ndarray, "m 5"]:
        """Rectangles round the corners of the part of each box that lies in front of the camera."""
        start, end = sensor_corners[:, _PAIRS[:, 0]], sensor_corners[:, _PAIRS[:, 1]]
        rise = end[..., 2:] - start[..., 2:]
        share = (NEAR - start[..., 2:]) / np.where(rise == 0, np.inf, rise)
        points = np.concatenate([sensor_corners, start + np.clip(share, 0, 1) * (end - start)], axis=1)
        depth = points[..., 2:]
        ahead = depth >= NEAR - 1e-6
        focal, centre = self.intrinsic[0, 0], self.intrinsic[:2, 2]
        pixels = (points[..., :2] / np.maximum(depth, NEAR - 1e-6) * focal + centre) / self.stride
        first = np.floor(np.where(ahead, pixels, 1e9).min(axis=1))
        last = np.ceil(np.where(ahead, pixels, -1e9).max(axis=1)) + 1
        near = sensor_corners[..., 2].min(axis=1) < self.max_range
        rows = np.arange(len(sensor_corners))
        bounds = np.column_stack([rows, first[:, 1], last[:, 1], first[:, 0], last[:, 0]])
        return clipped(bounds[near & ahead.any(axis=(1, 2))], self.shape)


def _is_pixel(centre: Any) -> bool:
    numbers = isinstance(centre, tuple) and all(isinstance(each, int | float | np.number) for each in centre)
    return numbers and len(centre) == 2 and bool(np.isfinite(centre).all())


@lru_cache(maxsize=64)
def _camera_rays(camera: DepthCamera) -> np.ndarray:
    (focal, _, cu), (_, _, cv), _ = camera.intrinsic
    u, v = np.arange(0, camera.width, camera.stride), np.arange(0, camera.height, camera.stride)
    x, y = np.meshgrid((u - cu) / focal, (v - cv) / focal)
    return frozen(np.stack([x, y, np.ones_like(x)], axis=-1))
