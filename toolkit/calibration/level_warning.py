"""Warning of clouds whose ground is not level at z = 0."""

from typing import TYPE_CHECKING

import numpy as np

from toolkit.arrays import Points
from toolkit.calibration.ground import Ground, plain_points
from toolkit.calibration.ground_plane import fit_plane, heights_above_plane

if TYPE_CHECKING:
    from toolkit.clouds import PointCloud

LEVEL_TOLERANCE_M = 0.15  # m that the ground may be off zero before `level_warning` warns
_MAX_FEW_SHARE = 0.02  # share of points between the ground and 4 m that counts as hardly any
_MIN_POINTS = 200  # points: with fewer there is no warning
_CROP_M = 4.0  # m above the ground that a cloud may be cropped to


def level_warning(cloud: "PointCloud | Points") -> str | None:
    """Return a warning if most of the ground is not level at z = 0, else None.

    Level ground is within `LEVEL_TOLERANCE_M` of 0. A cloud without ground gets a warning too if it
    has hardly a point between 0 and `_CROP_M`. A cloud that is cropped to that slice, or has fewer
    than `_MIN_POINTS` finite points, gets none."""
    points = plain_points(cloud)
    points = points[np.isfinite(points).all(axis=1)]
    is_in_crop = (points[:, 2] > 0) & (points[:, 2] < _CROP_M)
    if len(points) < _MIN_POINTS or is_in_crop.all():
        return None
    share = is_in_crop.mean()
    counted_text = f"{share:.0%} of {len(points)} points lie between 0 and {_CROP_M:g} m"
    try:
        ground = Ground(fit_plane(points))
    except ValueError:  # no ground was found
        if share > _MAX_FEW_SHARE:
            return None
        return f"{counted_text}, and no ground is found in them: check their frame"
    is_on_ground = np.abs(heights_above_plane(ground.plane, points)) < LEVEL_TOLERANCE_M
    ground_z = points[is_on_ground, 2]
    if (np.abs(ground_z) < LEVEL_TOLERANCE_M).mean() >= 0.5:
        return None
    seems = (
        f"their ground seems to lie at z = {np.median(ground_z):.2f} m, tilted by "
        f"{np.rad2deg(ground.tilt):.1f}°"
    )
    return f"{counted_text}: {seems}: level the points first"
