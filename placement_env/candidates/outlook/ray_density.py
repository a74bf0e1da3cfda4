"""How densely the rays of a sensor model lie in each direction, for any model: counted from its rays."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from toolkit.arrays import Float, Float32, Int64
from toolkit.sensors.model import SensorModel

BIN = float(np.deg2rad(2.0))  # of azimuth and elevation
AZIMUTH_BINS, ELEVATION_BINS = 180, 90


@lru_cache(maxsize=64)
def ray_density(model: SensorModel) -> Float32[np.ndarray, "180 90"]:
    """Rays per steradian by azimuth (counter-clockwise from straight ahead, from -π on) and elevation (from -π/2 on),
    seen from the body that carries the sensor."""
    rays = model.rays().reshape(-1, 3).astype(np.float64) @ model.body_SE3_sensor[:3, :3].T
    azimuth, elevation = ray_angles(rays)
    cells = np.ravel_multi_index(bins(azimuth, elevation), (AZIMUTH_BINS, ELEVATION_BINS))
    counts = np.bincount(cells, minlength=AZIMUTH_BINS * ELEVATION_BINS).reshape(AZIMUTH_BINS, ELEVATION_BINS)
    edges = np.sin(np.arange(ELEVATION_BINS + 1) * BIN - np.pi / 2)
    density = (counts / (BIN * np.diff(edges))).astype(np.float32)
    density.setflags(write=False)
    return density


def ray_angles(
    directions: Float[np.ndarray, "*n 3"],
) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
    """Azimuth and elevation (rad) of directions of a body: x forward, y left, z up."""
    x, y, z = np.moveaxis(directions, -1, 0)
    return np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))


def bins(
    azimuth: Float[np.ndarray, "*n"], elevation: Float[np.ndarray, "*n"]
) -> tuple[Int64[np.ndarray, "*n"], Int64[np.ndarray, "*n"]]:
    """Places in the table of `ray_density`."""
    column = np.floor((azimuth + np.pi) / BIN).astype(np.int64) % AZIMUTH_BINS
    row = np.clip(np.floor((elevation + np.pi / 2) / BIN).astype(np.int64), 0, ELEVATION_BINS - 1)
    return column, row
