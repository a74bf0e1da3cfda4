"""Ground plane z = a x + b y + c below a cloud.

The plane is found by RANSAC among the lowest points. A roof, a wall or a row of hedges may have
more points than the ground, and the ground may be seen on one side only. So points are thinned to
the low end of each cell of a grid. Cells that are above others near by, by more than `max_tilt`
and a kerb explain, are left out. A hypothesis is scored by the cells on it, less those well below
it, since nothing is under the ground. The best plane is fitted again to the points about it, cell
by cell, so that near rings of a lidar do not outweigh far ones (M. A. Fischler and R. C. Bolles,
1981; G. Vosselman, 2000)."""

import numpy as np

from toolkit.arrays import Float64, Points, Rng
from toolkit.calibration.height_map import GROUND_CELL_M, low_points, lowest_mask, support_mask

Plane = Float64[np.ndarray, "3"]
_Cells = Float64[np.ndarray, "m 3"]
MAX_TILT_RAD = float(np.deg2rad(15.0))
_KERB_M = 0.25  # by which ground may rise between cells beyond its slope: kerbs, noise
_INLIER_M = 0.2  # a cell this near a plane counts for it
_BELOW_M = 0.5  # a cell this far below a plane counts against it
_BELOW_WEIGHT = 2.0  # weight of a cell below a plane, relative to one on it
_MAX_STRAY_SHARE = 0.03  # share of the cells that may be below it at no cost
_HYPOTHESES = 1500
_SCORED_CELLS = 3000  # cells that score a hypothesis
_BATCH_PLANES = 100  # so that their heights stay in the processor's cache
_BANDS_M = (0.25, 0.15, 0.10, 0.10)  # about the plane, whose points fit it again
# weight of "level" in the fit, per cell: matters only if the cells are on one line
_SLOPE_PRIOR = 1e-3


def fit_plane(points: Points, *, max_tilt: float = MAX_TILT_RAD, seed: int = 0) -> Plane:
    """Fit the ground plane z = a x + b y + c to points.

    Args:
        points: (n, 3) m, in a frame whose z is about up.
        max_tilt: largest angle (rad) between the plane's normal and z.
        seed: seed of the random hypotheses.

    Returns a, b (m per m) and c (m). Raises ValueError if fewer than three cells of the grid might
    be ground."""
    cells = low_points(points, GROUND_CELL_M)
    cells = cells[support_mask(cells, step=_KERB_M, slope=0.3, min_supporters=3)]
    max_slope = float(np.tan(max_tilt))
    candidates = cells[lowest_mask(cells, max_slope, _KERB_M)]
    if len(candidates) < 3:
        problem = (
            f"they fill {len(candidates)} cells of {GROUND_CELL_M:g} m that might be ground, and a "
            "plane needs 3"
        )
        raise ValueError(f"no ground found in {len(points)} points: {problem}: give more points")
    rng = np.random.default_rng(seed)
    planes = _draw_planes(candidates, rng)
    planes = planes[np.hypot(planes[:, 0], planes[:, 1]) <= max_slope]  # slopes a and b
    scores = _score_planes(planes, candidates, cells, rng)
    plane: Plane = planes[int(np.argmax(scores))]
    for band in _BANDS_M:  # ever narrower
        refitted_plane = _refit_plane(plane, points, band)
        if refitted_plane is None or np.hypot(refitted_plane[0], refitted_plane[1]) > max_slope:
            return plane
        plane = refitted_plane
    return plane


def _draw_planes(candidates: _Cells, rng: Rng) -> Float64[np.ndarray, "k 3"]:
    """Planes z = a x + b y + c through random triples of cells, and a level one at their median.

    Rows are a, b and c; the level plane is the last. Triples that are nearly on a line, seen from
    above, are left out. candidates: cells (x, y, z in m) that may be ground."""
    # (hypotheses, 3 cells, xyz)
    triples = candidates[rng.integers(len(candidates), size=(_HYPOTHESES, 3))]
    first_edge = triples[:, 1] - triples[:, 0]
    second_edge = triples[:, 2] - triples[:, 0]
    normals = np.cross(first_edge, second_edge)
    first_length = np.linalg.norm(first_edge, axis=1)
    second_length = np.linalg.norm(second_edge, axis=1)
    # the z part of the normal is twice the triangle's area seen from above: the lengths of both
    # edges times the sine of the angle between them, which must be above 0.05
    is_wide = np.abs(normals[:, 2]) > 0.05 * first_length * second_length + 1e-9
    normals = normals[is_wide]
    first_cell = triples[is_wide, 0]
    slopes = -normals[:, :2] / normals[:, 2:]
    heights = first_cell[:, 2] - (slopes * first_cell[:, :2]).sum(axis=1)  # at x = y = 0
    level_plane = [0.0, 0.0, float(np.median(candidates[:, 2]))]
    return np.concatenate([np.column_stack([slopes, heights]), [level_plane]])


def _score_planes(
    planes: Float64[np.ndarray, "k 3"],
    candidates: _Cells,
    cells: Float64[np.ndarray, "cells 3"],
    rng: Rng,
) -> Float64[np.ndarray, " k"]:
    """Number of candidates on each plane, less a penalty for cells well below it.

    Args:
        planes: a, b, c of each plane.
        candidates: low points (m) that might be ground.
        cells: low points of all cells, which should not be below the ground.
        rng: chooses the cells that are compared, if they are many."""
    # for a seed, the order in which these two are drawn decides the result
    on_sample = candidates[rng.permutation(len(candidates))[:_SCORED_CELLS]]
    below_sample = cells[rng.permutation(len(cells))[:_SCORED_CELLS]]
    on_shares = []
    below_shares = []
    for start in range(0, len(planes), _BATCH_PLANES):
        batch = planes[start : start + _BATCH_PLANES]
        on_shares.append(_share_on_planes(batch, on_sample))
        is_below = _heights_above(batch, below_sample) < -_BELOW_M
        below_shares.append(is_below.mean(axis=1))
    support = np.concatenate(on_shares) * len(candidates)
    excess = np.clip(np.concatenate(below_shares) - _MAX_STRAY_SHARE, 0, None)
    return support - _BELOW_WEIGHT * (excess * len(cells))


def _refit_plane(plane: Plane, points: Points, band: float) -> Plane | None:
    """Fit a plane again to the points within `band` (m) above and below it.

    Points are reduced to a median height for each cell, weighed by their distance from the plane.
    Returns None for fewer than 3 cells with points."""
    above = heights_above_plane(plane, points)
    # a share of 0.5: the point of median height in each cell
    cells = low_points(points[np.abs(above) < band], GROUND_CELL_M, share=0.5)
    if len(cells) < 3:
        return None
    middle = cells[:, :2].mean(axis=0)
    # weighted least squares of z = a x + b y + c, with x and y counted from the middle
    columns = np.column_stack([cells[:, :2] - middle, np.ones(len(cells))])
    weight = (1 - (heights_above_plane(plane, cells) / band) ** 2) ** 2
    # pulls both slopes slightly to level, so that cells on one line have a solution
    prior = np.diag([_SLOPE_PRIOR, _SLOPE_PRIOR, 0.0]) * len(cells)
    information = columns.T @ (columns * weight[:, None]) + prior
    a, b, c = np.linalg.solve(information, columns.T @ (weight * cells[:, 2]))
    return np.array([a, b, c - a * middle[0] - b * middle[1]])


def _heights_above(planes: Float64[np.ndarray, "k 3"], cells: _Cells) -> Float64[np.ndarray, "k m"]:
    """Height (m, along z) of each cell above each plane, a row for each plane."""
    heights = planes[:, :2] @ cells[:, :2].T
    np.subtract(cells[:, 2], heights, out=heights)
    heights -= planes[:, 2:]
    return heights


def _share_on_planes(
    planes: Float64[np.ndarray, "k 3"], cells: _Cells
) -> Float64[np.ndarray, " k"]:
    """Share of the cells on each plane, 0 to 1.

    A cell counts 1 - (distance / `_INLIER_M`)²: 1 on the plane, and 0 from `_INLIER_M` on."""
    # (planes, cells) heights, which become the counts in place, to save memory
    counts = _heights_above(planes, cells)
    counts /= _INLIER_M
    counts *= counts
    np.subtract(1, counts, out=counts)
    return np.clip(counts, 0, None, out=counts).mean(axis=1)


def heights_above_plane(plane: Plane, points: Points) -> Float64[np.ndarray, " n"]:
    """Height (m, along z) of each point above a plane."""
    return points[:, 2] - points[:, :2].astype(np.float64) @ plane[:2] - plane[2]
