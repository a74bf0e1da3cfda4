"""Warning of clouds whose ground is not level at z = 0."""

from typing import TYPE_CHECKING

import numpy as np

from toolkit.arrays import Points
from toolkit.calibration.ground import Ground, plain_points
from toolkit.calibration.ground_plane import fit_plane, heights_above_plane

if TYPE_CHECKING:
    from toolkit.clouds import PointCloud

TOLERANCE = 0.15  # m that the ground may be off zero before `level_warning` warns
_HARDLY = 0.02  # share of points between the ground and 4 m that counts as hardly any
_FEW = 200  # points: with fewer there is no warning
_LOW = 4.0  # m above the ground that a cloud may be cropped to


def level_warning(cloud: "PointCloud | Points") -> str | None:
    """Return a warning in one line if less than half of the ground lies within `TOLERANCE` of
    z = 0, else None. It also warns of no ground with hardly a point between 0 and `_LOW` (m), but
    not of a cloud cropped to that slice."""
    points = plain_points(cloud)
    points = points[np.isfinite(points).all(axis=1)]
    within = (points[:, 2] > 0) & (points[:, 2] < _LOW)
    if len(points) < _FEW or within.all():
        return None
    counted = f"{within.mean():.0%} of {len(points)} points lie between 0 and {_LOW:g} m"
    try:
        ground = Ground(fit_plane(points))
    except ValueError:
        return (
            None
            if within.mean() > _HARDLY
            else f"{counted}, and no ground is found in them: check their frame"
        )
    on = points[np.abs(heights_above_plane(ground.plane, points)) < TOLERANCE, 2]
    if (np.abs(on) < TOLERANCE).mean() >= 0.5:
        return None
    seems = (
        f"their ground seems to lie at z = {np.median(on):.2f} m, tilted by "
        f"{np.rad2deg(ground.tilt):.1f}°"
    )
    return f"{counted}: {seems}: level the points first"
