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
    finite_points = sample[np.isfinite(sample).all(axis=1)]
    # all points are looked at, since the sample may miss the few that are finite
    if len(sample) and not np.isfinite(points).all(axis=1).any():
        raise ValueError(
            f"none of its {len(points)} points has three finite coordinates: record it again"
        )
    if not len(finite_points):
        return
    if np.median(np.abs(finite_points).max(axis=1)) > MAX_COORDINATE_M:
        raise ValueError(
            f"half of its points are beyond {MAX_COORDINATE_M:g} m: give metres, or repair the file"
        )
    middle = np.median(finite_points, axis=0)
    distances = np.linalg.norm(finite_points - middle, axis=1)
    if np.median(distances) > _MAX_SPREAD_M:
        half_beyond = f"more than {np.median(distances) / 1000:.3g} km from their middle"
        raise ValueError(f"half of its points are {half_beyond}: give metres, or repair the file")
    # bytes of another type read as numbers are huge, or tiny without being 0
    is_tiny = (finite_points != 0) & (np.abs(finite_points) < _MIN_COORDINATE_M)
    is_outlier = (distances > _MAX_SPREAD_M) | is_tiny.any(axis=1)
    # each place once: a driver's value of no return is always the same
    outliers = np.unique(finite_points[is_outlier], axis=0)
    if len(outliers) > max(5, 0.1 * len(finite_points)):
        raise ValueError(
            f"{len(outliers)} of {len(finite_points)} points, such as {outliers[0]}, are no "
            "places: repair the file"
        )


def describe_rounding(points: Float64[np.ndarray, "n 3"]) -> str | None:
    """Describe in words how coordinates were rounded before they were read; None if they were not.

    points: m, as stored. Coordinates far from 0 that fit float32 have lost centimetres."""
    sample = points[:: len(points) // 1000 + 1]
    sample = sample[np.isfinite(sample).all(axis=1)]
    # the usual distance from 0 on the axis with the largest numbers
    usual_distance = np.median(np.abs(sample), axis=0).max() if len(sample) else 0.0
    step_m = float(np.spacing(np.float32(usual_distance)))
    fits_float32 = not (sample != sample.astype(np.float32)).any()
    if step_m < MIN_ROUNDING_M or not fits_float32:
        return None
    float32_rule = f"rounded to {step_m:g} m, as float32 does near {usual_distance:.0f} m"
    return f"its coordinates are {float32_rule}: export them as double, or with an origin taken off"
