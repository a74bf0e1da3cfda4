"""Ground plane z = a x + b y + c below a cloud.

The plane is found by RANSAC among the lowest points. A roof, a wall or a row of hedges may have
more points than the ground, and the ground may be seen on one side only. So points are thinned to
the low end of each cell of a grid. Cells that are above others near by, by more than `max_tilt`
and a kerb explain, are left out. A hypothesis is scored by the cells on it, less those well below
it, since nothing is under the ground. The best plane is fitted again to the points about it, cell
by cell, so that near rings of a lidar do not outweigh far ones (M. A. Fischler and R. C. Bolles,
1981; G. Vosselman, 2000)."""

import numpy as np

from toolkit.arrays import Float64, Points
from toolkit.calibration.height_map import GROUND_CELL, low_points, lowest_mask, support_mask

Plane = Float64[np.ndarray, "3"]
_Cells = Float64[np.ndarray, "m 3"]
MAX_TILT = float(np.deg2rad(15.0))
_STEP = 0.25  # m that ground may rise between cells beyond its slope: kerbs, noise
# m: a cell this near a plane counts for it, one this far below counts against it
_INLIER = 0.2
_BELOW = 0.5
_AGAINST = 2.0  # weight of a cell below a plane, relative to one on it
_STRAY = 0.03  # share of the cells that may lie below it at no cost
# hypotheses, and cells that score them
_DRAWS = 1500
_SCORED = 3000
_PLANES_AT_ONCE = 100  # so that their heights stay in the processor's cache
_BANDS = (0.25, 0.15, 0.10, 0.10)  # m about the plane; points within are used to fit it again
_SLOPE_PRIOR = (
    1e-3  # weight of "level" in the fit, per cell: matters only where the cells lie on one line
)


def fit_plane(points: Points, *, max_tilt: float = MAX_TILT, seed: int = 0) -> Plane:
    """Fit the ground plane a, b, c to points. max_tilt: limit (rad) on the lean of its normal.
    Raises ValueError if no three cells of the grid make such a plane."""
    cells = low_points(points, GROUND_CELL)
    cells = cells[support_mask(cells, _STEP, 0.3, min_supporters=3)]
    slope = np.tan(max_tilt)
    candidates = cells[lowest_mask(cells, slope, _STEP)]
    if len(candidates) < 3:
        problem = (
            f"they fill {len(candidates)} cells of {GROUND_CELL:g} m that might be ground, and a "
            "plane needs 3"
        )
        raise ValueError(f"no ground found in {len(points)} points: {problem}: give more points")
    rng = np.random.default_rng(seed)
    drawn = candidates[rng.integers(len(candidates), size=(_DRAWS, 3))]
    first_edge = drawn[:, 1] - drawn[:, 0]
    second_edge = drawn[:, 2] - drawn[:, 0]
    normals = np.cross(first_edge, second_edge)
    is_wide = (
        np.abs(normals[:, 2])
        > 0.05 * np.linalg.norm(first_edge, axis=1) * np.linalg.norm(second_edge, axis=1) + 1e-9
    )
    # of triples that are not nearly on a line
    normals = normals[is_wide]
    through = drawn[is_wide, 0]
    slopes = -normals[:, :2] / normals[:, 2:]
    planes = np.column_stack([slopes, through[:, 2] - (slopes * through[:, :2]).sum(axis=1)])
    planes = np.concatenate([planes, [[0.0, 0.0, float(np.median(candidates[:, 2]))]]])
    planes = planes[np.hypot(planes[:, 0], planes[:, 1]) <= slope]
    on_sample, below_sample = (
        pool[rng.permutation(len(pool))[:_SCORED]] for pool in (candidates, cells)
    )
    blocks = [
        planes[start : start + _PLANES_AT_ONCE] for start in range(0, len(planes), _PLANES_AT_ONCE)
    ]
    support = np.concatenate([_share_on(block, on_sample) for block in blocks]) * len(candidates)
    lower = np.concatenate(
        [(_heights_above(block, below_sample) < -_BELOW).mean(axis=1) for block in blocks]
    )
    penalty = np.clip(lower - _STRAY, 0, None) * len(cells)
    plane: Plane = planes[int(np.argmax(support - _AGAINST * penalty))]
    for band in _BANDS:  # fit it again, to ever nearer points
        above = heights_above_plane(plane, points)
        about = low_points(points[np.abs(above) < band], GROUND_CELL, share=0.5)
        if len(about) < 3:
            return plane
        middle = about[:, :2].mean(axis=0)
        flat = np.column_stack([about[:, :2] - middle, np.ones(len(about))])
        weight = (1 - (heights_above_plane(plane, about) / band) ** 2) ** 2
        prior = np.diag([_SLOPE_PRIOR, _SLOPE_PRIOR, 0.0]) * len(about)
        normal = flat.T @ (flat * weight[:, None]) + prior
        a, b, c = np.linalg.solve(normal, flat.T @ (weight * about[:, 2]))
        if np.hypot(a, b) > slope:
            return plane
        plane = np.array([a, b, c - a * middle[0] - b * middle[1]])
    return plane


def _heights_above(planes: Float64[np.ndarray, "k 3"], cells: _Cells) -> Float64[np.ndarray, "k m"]:
    """Height (m) of each cell above each plane."""
    heights = planes[:, :2] @ cells[:, :2].T
    np.subtract(cells[:, 2], heights, out=heights)
    heights -= planes[:, 2:]
    return heights


def _share_on(planes: Float64[np.ndarray, "k 3"], cells: _Cells) -> Float64[np.ndarray, " k"]:
    """Share of the cells on each plane, less for those farther off."""
    off = _heights_above(planes, cells)
    off /= _INLIER
    off *= off
    np.subtract(1, off, out=off)
    return np.clip(off, 0, None, out=off).mean(axis=1)


def heights_above_plane(plane: Plane, points: Points) -> Float64[np.ndarray, " n"]:
    """Height (m, along z) of each point above a plane."""
    return points[:, 2] - points[:, :2].astype(np.float64) @ plane[:2] - plane[2]
