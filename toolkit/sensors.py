"""Sensor models: which rays a sensor casts, and how what it measures along them becomes points.

Both models share one rule. `rays()` gives a vector per pixel in the sensor's own frame, scaled so that

    point = measurement · ray                                    (paper equation 2 for the camera)
    point in the world = measurement · (R ray) + t               (paper equation 1; R ray is `Sensor.world_rays`)

For a camera the ray has z = 1 and the measurement is depth along the optical axis; for a lidar the ray has length 1
and the measurement is range. A measurement that is NaN, infinite, zero or negative is no return and makes no point.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np

from toolkit.arrays import Bool, Float, Float32, Float64
from toolkit.geometry import check_pose


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
        _check_noise(self.sigma, self.max_range)

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
        return _noisy(depth, self, rng)


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
        _check_noise(self.sigma, self.max_range)

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
        return _noisy(ranges, self, rng)


SensorModel = DepthCamera | SpinningLidar


@dataclass(frozen=True, eq=False)
class Sensor:
    """A sensor model at a place: `pose` is world_SE3_sensor. Raises ValueError where the pose is no rigid motion.

    The world is a site's own frame, metres from an origin near by: points are float32, good to 1 mm within 10 km of it.
    """

    name: str
    model: SensorModel
    pose: Float64[np.ndarray, "4 4"] = field(repr=False)

    def __post_init__(self) -> None:
        pose = check_pose(self.pose, f"pose of sensor {self.name!r}").copy()
        pose.setflags(write=False)
        object.__setattr__(self, "pose", pose)

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Sensor)
            and (self.name, self.model) == (other.name, other.model)
            and np.array_equal(self.pose, other.pose)
        )

    def __hash__(self) -> int:
        return hash((self.name, self.model))

    @property
    def position(self) -> Float64[np.ndarray, "3"]:
        """Where it is, world frame (m)."""
        return self.pose[:3, 3]

    @cached_property
    def world_rays(self) -> Float32[np.ndarray, "3 pixels"]:
        """x, y and z of each pixel's ray in the world's axes, row after row of the image (paper equation 1)."""
        rays = self.model.rays().reshape(-1, 3).astype(np.float64)
        return _frozen(np.ascontiguousarray(self.pose[:3, :3] @ rays.T))


def returned(measurement: Float[np.ndarray, "*shape"], max_range: float = np.inf) -> Bool[np.ndarray, "*shape"]:
    """Mask of measurements that make a point: finite, positive and nearer than `max_range`.

    >>> returned(np.array([np.nan, -1.0, 0.0, 5.0, 50.0, np.inf]), max_range=50.0)
    array([False, False, False,  True, False, False])
    """
    return (measurement > 0) & (measurement < min(max_range, np.finfo(np.float32).max))


@lru_cache(maxsize=64)
def _camera_rays(camera: DepthCamera) -> np.ndarray:
    (focal, _, cu), (_, _, cv), _ = camera.intrinsic
    u, v = np.arange(0, camera.width, camera.stride), np.arange(0, camera.height, camera.stride)
    x, y = np.meshgrid((u - cu) / focal, (v - cv) / focal)
    return _frozen(np.stack([x, y, np.ones_like(x)], axis=-1))


@lru_cache(maxsize=64)
def _lidar_rays(lidar: SpinningLidar) -> np.ndarray:
    rows, columns = lidar.shape
    elevation = np.linspace(lidar.fov_up, lidar.fov_down, rows)[:, None]
    azimuth = (np.arange(columns) - (columns - 1) / 2) * lidar.azimuth_fov / columns
    flat = np.cos(elevation)
    return _frozen(np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation) + 0 * azimuth], axis=-1))


def _frozen(rays: np.ndarray) -> np.ndarray:
    rays = rays.astype(np.float32)
    rays.setflags(write=False)
    return rays


def _noisy(measurement: np.ndarray, model: SensorModel, rng: np.random.Generator) -> np.ndarray:
    clean = np.asarray(measurement, np.float32)
    noise = rng.standard_normal(clean.shape, dtype=np.float32) * np.float32(model.sigma)
    return np.where(returned(clean, model.max_range), clean + noise, np.float32(0))


def _check_noise(sigma: float, max_range: float) -> None:
    if not sigma >= 0 or not max_range > 0:
        raise ValueError(f"need sigma >= 0 and max_range > 0, got sigma {sigma} and max_range {max_range}")
