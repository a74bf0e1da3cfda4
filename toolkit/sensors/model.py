"""Sensor models: which rays a sensor casts, and how what it measures along them becomes points.

Both models share one rule. `rays()` gives a vector per pixel in the sensor's own frame, scaled so that

    point = measurement · ray                                    (paper equation 2 for the camera)
    point in the world = measurement · (R ray) + t               (paper equation 1; R ray is `Sensor.world_rays`)

For a camera the ray has z = 1 and the measurement is depth along the optical axis; for a lidar the ray has length 1
and the measurement is range. A measurement that is NaN, infinite, zero or negative is no return and makes no point.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from toolkit.arrays import Bool, Float


def returned(measurement: Float[np.ndarray, "*shape"], max_range: float = np.inf) -> Bool[np.ndarray, "*shape"]:
    """Mask of measurements that make a point: finite, positive and nearer than `max_range`.

    >>> returned(np.array([np.nan, -1.0, 0.0, 5.0, 50.0, np.inf]), max_range=50.0)
    array([False, False, False,  True, False, False])
    """
    return (measurement > 0) & (measurement < min(max_range, np.finfo(np.float32).max))


def frozen(rays: np.ndarray) -> np.ndarray:
    """Rays as float32 that nobody may write to."""
    rays = rays.astype(np.float32)
    rays.setflags(write=False)
    return rays


def with_noise(measurement: np.ndarray, model: Any, rng: np.random.Generator) -> np.ndarray:
    """A model's measurement with N(0, sigma) added; what returned nothing still returns nothing."""
    clean = np.asarray(measurement, np.float32)
    noise = rng.standard_normal(clean.shape, dtype=np.float32) * np.float32(model.sigma)
    return np.where(returned(clean, model.max_range), clean + noise, np.float32(0))


def check_noise(sigma: float, max_range: float) -> None:
    """ValueError where noise or range make no sense."""
    if not sigma >= 0 or not max_range > 0:
        raise ValueError(f"need sigma >= 0 and max_range > 0, got sigma {sigma} and max_range {max_range}")
