"""Checks of coordinates: their extent, and the centimetres that they have lost."""

import numpy as np

from toolkit.arrays import Float64
from toolkit.geometry import MAX_COORDINATE_M

_MIN_COORDINATE_M = 1e-30  # smaller ones are whole numbers, or parts of others, read as floats
MIN_ROUNDING_M = 0.01  # rounding of float32 coordinates, for a warning
_MAX_SPREAD_M = 5000.0  # from the middle to half of a sensor's points; beyond are millimetres


def check_extent(points: Float64[np.ndarray, "n 3"]) -> None:
    """Raise ValueError for numbers that are no positions, or too far apart to be in metres."""
    # at most a thousand points, evenly taken
    sample = points[:: len(points) // 1000 + 1]
    finite = sample[np.isfinite(sample).all(axis=1)]
    if len(sample) and not np.isfinite(points).all(axis=1).any():
        raise ValueError(
            f"none of its {len(points)} points has three finite coordinates: record it again"
        )
    distances = (
        np.linalg.norm(finite - np.median(finite, axis=0), axis=1) if len(finite) else np.zeros(1)
    )
    if len(finite) and np.median(np.abs(finite).max(axis=1)) > MAX_COORDINATE_M:
        raise ValueError(
            f"half of its points are beyond {MAX_COORDINATE_M:g} m: give metres, or repair the file"
        )
    if np.median(distances) > _MAX_SPREAD_M:
        problem = (
            f"half of its points are more than {np.median(distances) / 1000:.3g} km from their "
            "middle"
        )
        raise ValueError(f"{problem}: give metres, or repair the file")
    is_tiny = (finite != 0) & (np.abs(finite) < _MIN_COORDINATE_M)
    outliers = np.unique(
        finite[(distances > _MAX_SPREAD_M) | is_tiny.any(axis=1)] if len(finite) else finite, axis=0
    )
    # a driver's value of no return is always the same
    if len(outliers) > max(5, 0.1 * len(finite)):
        raise ValueError(
            f"{len(outliers)} of {len(finite)} points, such as {outliers[0]}, are no places: "
            "repair the file"
        )


def describe_rounding(points: Float64[np.ndarray, "n 3"]) -> str | None:
    """Describe in words how coordinates were rounded before they were read; None if they were not.

    points: m, as stored. Coordinates far from 0 that fit float32 have lost centimetres."""
    sample = points[:: len(points) // 1000 + 1]
    sample = sample[np.isfinite(sample).all(axis=1)]
    farthest = np.median(np.abs(sample), axis=0).max() if len(sample) else 0.0
    step_m = float(np.spacing(np.float32(farthest)))
    if step_m < MIN_ROUNDING_M or (sample != sample.astype(np.float32)).any():
        return None
    lost = f"its coordinates are rounded to {step_m:g} m, as float32 does near {farthest:.0f} m"
    return f"{lost}: export them as double, or with an origin taken off"
