"""The ground's height on a grid, from a cloud whose plane of ground is level already: kerbs, crowns and far slopes.

Each cell that returned anything near the plane gives the low end of its points; cells that stand above others near by
by more than a slope explains (cars, hedges, walls, people) are left out. What is left is smoothed and carried into
cells without ground from coarse to fine: Gaussian means, 12 m wide first, each blended into the wider one by how much
ground it has, so that a cell far from any ground keeps the plane (normalised convolution, H. Knutsson and
C.-F. Westin, 1993). It is drawn several times: at first through what is near the plane, so that it climbs slopes from
where the plane holds, then with little weight for what stands above it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Float, Float64
from toolkit.calibration.ground_plane import GROUND_CELL, low_points, lowest_around, supported

MAP_REACH = 100.0  # m from the middle of the points, as far as a map goes; farther out its edge holds
_BAND = 2.0  # m above and below the plane, within which ground is looked for
_SLOPE, _STEP = 0.08, 0.10  # beside the plane's own slope, and m of a kerb
_WINDOW = 8.0  # m, within which something lower makes a cell no ground
_SCALES = (12.0, 6.0, 3.0, 1.5)  # m, of the Gaussian means
_PRIOR = 1.0  # cells' worth of trust in the wider mean
# How far (m) above the map a cell of ground may be, and how far so that it counts half, drawing by drawing.
_DRAWINGS = ((0.25, np.inf), (0.25, np.inf), (0.20, np.inf), (0.20, 0.09), (0.20, 0.09), (0.20, 0.09), (0.12, 0.09))


@dataclass(frozen=True)
class HeightMap:
    """Heights (m) at the corners of a grid: heights[i, j] at origin + cell · (i, j)."""

    origin: Float64[np.ndarray, "2"]
    heights: Float64[np.ndarray, "rows columns"]
    cell: float = GROUND_CELL

    def at(self, xy: Float[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
        """The height at each place, bilinear; outside the grid that of its edge.

        >>> HeightMap(np.zeros(2), np.array([[0.0, 1.0], [2.0, 3.0]])).at(np.array([[0.5, 0.5], [9.0, 0.0]]))
        array([1.5, 2. ])
        """
        last = np.array(self.heights.shape) - 1.0
        place = np.clip((np.asarray(xy, np.float64) - self.origin) / self.cell, 0.0, last)
        low = np.minimum(place.astype(np.int64), np.maximum(last - 1, 0).astype(np.int64))
        (i, j), (u, v) = low.T, (place - low).T
        i1, j1 = np.minimum(i + 1, int(last[0])), np.minimum(j + 1, int(last[1]))
        near = self.heights[i, j] * (1 - u) + self.heights[i1, j] * u
        far = self.heights[i, j1] * (1 - u) + self.heights[i1, j1] * u
        return near * (1 - v) + far * v


def fit_map(points: Float[np.ndarray, "n 3"], *, reach: float = MAP_REACH) -> HeightMap:
    """The ground's height below points whose ground is nearly z = 0. Raises ValueError for a reach that is none."""
    if not 0 < reach < np.inf:
        raise ValueError(f"reach must be a length above 0 m, got {reach}")
    near = points[np.abs(points[:, 2]) < _BAND]
    if not len(near):
        return HeightMap(np.zeros(2), np.zeros((1, 1)))
    middle = np.median(near[:, :2], axis=0).astype(np.float64)
    near = near[np.abs(near[:, :2] - middle).max(axis=1) <= reach]
    origin = np.floor(near[:, :2].min(axis=0).astype(np.float64) / GROUND_CELL) * GROUND_CELL + GROUND_CELL / 2
    shape = np.floor((near[:, :2].max(axis=0) - origin) / GROUND_CELL).astype(np.int64) + 2
    low = low_points(near, GROUND_CELL)
    low = low[supported(low, _STEP, _SLOPE, others=4)]
    low = low[lowest_around(low, _SLOPE, _STEP, window=_WINDOW)]
    low = low[supported(low, _STEP, _SLOPE, others=6)]
    surface = HeightMap(origin, np.zeros(tuple(shape)))
    for kept, kerb in _DRAWINGS:
        surface = _redrawn(surface, low, kept, kerb)
    on = np.abs(near[:, 2] - surface.at(near[:, :2])) < _DRAWINGS[-1][0]
    return _redrawn(surface, low_points(near[on], GROUND_CELL, share=0.5), *_DRAWINGS[-1])


def _redrawn(surface: HeightMap, cells: Float64[np.ndarray, "m 3"], kept: float, kerb: float) -> HeightMap:
    """The map through those cells that lie at most `kept` (m) above it and twice that below. Cells above it count
    little: beside a kerb the lower level is the one that wheels stand on."""
    above = cells[:, 2] - surface.at(cells[:, :2])
    some = (above < kept) & (above > -2 * kept)
    weight = 1 / (1 + (np.clip(above[some], 0, None) / kerb) ** 4)
    return HeightMap(surface.origin, _smooth(cells[some], weight, surface))


def _smooth(
    cells: Float64[np.ndarray, "m 3"], weight: Float64[np.ndarray, " m"], grid: HeightMap
) -> Float64[np.ndarray, "rows columns"]:
    """Heights on the whole grid from those cells that have one, coarse to fine; zero far from all of them."""
    from scipy.ndimage import gaussian_filter

    known, total = np.zeros(grid.heights.shape), np.zeros(grid.heights.shape)
    i, j = np.round((cells[:, :2] - grid.origin) / grid.cell).astype(np.int64).T
    np.add.at(known, (i, j), weight)
    np.add.at(total, (i, j), weight * cells[:, 2])
    heights = np.zeros(grid.heights.shape)
    for scale in _SCALES:
        wide = scale / grid.cell
        spread = 2 * np.pi * wide**2  # so that a mean counts cells
        count = gaussian_filter(known, wide, mode="constant", truncate=3.0) * spread
        summed = gaussian_filter(total, wide, mode="constant", truncate=3.0) * spread
        heights = (summed + _PRIOR * heights) / (count + _PRIOR)
    return heights
