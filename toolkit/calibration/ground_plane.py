"""The plane of the ground in a cloud of any frame: z = a x + b y + c, found by RANSAC among what lies lowest.

A roof, a wall or a row of hedges may have more points than the ground, and the ground may be seen on one side only. So
points are thinned to the low end of each cell of a grid, cells that stand above others near by are left out (a steeper
step than `max_tilt` and a kerb explain), and a hypothesis is scored by the cells that lie on it less those that lie
well below it: under the ground there is nothing. The winner is fitted again to the points about it, cell by cell, so
that near rings of a lidar do not outweigh far ones (M. A. Fischler and R. C. Bolles, 1981; G. Vosselman, 2000).
"""

from __future__ import annotations

import numpy as np

from toolkit.arrays import Bool, Float, Float64

GROUND_CELL = 1.0  # m
STEP_WINDOW = 12.0  # m, within which something lower makes a cell no ground
MAX_TILT = float(np.deg2rad(15.0))
_STEP = 0.25  # m, that ground may rise between cells beyond its slope: kerbs, noise
_NEIGHBOUR = 8.0  # m, beyond which a cell supports no other
_MOST_CELLS = 4_000_000
_NOTHING = 1e6  # m, the height of a cell without points
_INLIER, _BELOW = 0.2, 0.5  # m; a cell so near a plane speaks for it, one so far below it against it
_AGAINST = 2.0  # what a cell below a plane counts, beside one on it
_STRAY = 0.03  # share of the cells that may lie below it for nothing
_DRAWS, _SCORED = 1500, 3000  # hypotheses, and cells that they are scored by
_BANDS = (0.25, 0.15, 0.10, 0.10)  # m about the plane, from which it is fitted again
_SLOPE_PRIOR = 1e-3  # weight of "level" in the fit, per cell: decides only where the cells lie on one line


def fit_plane(
    points: Float[np.ndarray, "n 3"], *, max_tilt: float = MAX_TILT, seed: int = 0
) -> Float64[np.ndarray, "3"]:
    """a, b, c of the ground z = a x + b y + c, whose normal leans by `max_tilt` (rad) at most.

    Raises ValueError where no three cells of the grid make such a plane.
    """
    cells = low_points(points, GROUND_CELL)
    cells = cells[supported(cells, _STEP, 0.3, others=3)]
    candidates = cells[lowest_around(cells, np.tan(max_tilt), _STEP)]
    if len(candidates) < 3:
        raise ValueError(
            f"there is no ground to be found in {len(points)} points: they fill {len(candidates)} cells of "
            f"{GROUND_CELL:g} m that might be ground, and a plane needs 3"
        )
    plane = _best_plane(candidates, cells, np.tan(max_tilt), np.random.default_rng(seed))
    return _refined(plane, points, np.tan(max_tilt))


def heights_over(plane: Float64[np.ndarray, "3"], points: Float[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    """How far (m, along z) each point lies above the plane.

    >>> heights_over(np.array([0.1, 0.0, 1.0]), np.array([[10.0, 0.0, 5.0]]))
    array([3.])
    """
    return points[:, 2] - points[:, :2].astype(np.float64) @ plane[:2] - plane[2]


def low_points(points: Float[np.ndarray, "n 3"], cell: float, share: float = 0.1) -> Float64[np.ndarray, "m 3"]:
    """One point for each cell of a grid: its middle point's x and y, and the height that `share` of its points are
    below; of up to 1 / share points the lowest.

    >>> low_points(np.array([[0.2, 0.2, 5.0], [0.4, 0.2, 1.0], [9.0, 0.0, 2.0]]), 1.0).tolist()
    [[0.4, 0.2, 1.0], [9.0, 0.0, 2.0]]
    """
    points = points[np.isfinite(points).all(axis=1)].astype(np.float64)
    if not len(points):
        return np.zeros((0, 3))
    place = np.floor(points[:, :2] / cell).astype(np.int64)
    place -= place.min(axis=0)
    key = place[:, 0] * (int(place[:, 1].max()) + 1) + place[:, 1]
    order = np.lexsort((points[:, 2], key))
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    count = np.diff(np.append(first, len(order)))
    return points[order[first + np.floor(share * (count - 1)).astype(np.int64)]]


def supported(cells: Float64[np.ndarray, "m 3"], step: float, slope: float, *, others: int) -> Bool[np.ndarray, " m"]:
    """Which cells have so many others among the twelve nearest at about its height, to within a slope and a step:
    the rest are reflections and stray points."""
    from scipy.spatial import cKDTree

    near = min(13, len(cells))
    if near <= others:
        return np.ones(len(cells), bool)
    apart, other = cKDTree(cells[:, :2]).query(cells[:, :2], near)
    rise = np.abs(cells[other, 2] - cells[:, None, 2])
    alike = (rise < step + slope * apart) & (apart < _NEIGHBOUR)
    return alike[:, 1:].sum(axis=1) >= others


def lowest_around(
    cells: Float64[np.ndarray, "m 3"], slope: float, step: float, *, window: float = STEP_WINDOW
) -> Bool[np.ndarray, " m"]:
    """Which cells no other within the window (m) lies below by more than the slope to it, along x and y, and a step.

    Raises ValueError where the cells reach too far for an image of them.
    """
    from scipy.ndimage import grey_erosion

    if not len(cells):
        return np.zeros(0, bool)
    place = np.floor(cells[:, :2] / GROUND_CELL).astype(np.int64)
    place -= place.min(axis=0)
    rows, columns = (place.max(axis=0) + 1).tolist()
    if rows * columns > _MOST_CELLS:
        extent = f"{rows * GROUND_CELL:.0f} by {columns * GROUND_CELL:.0f} m"
        raise ValueError(f"the points reach over {extent}: crop them to the place in question")
    image = np.full((rows, columns), _NOTHING)
    image[place[:, 0], place[:, 1]] = cells[:, 2]
    reach = round(window / GROUND_CELL)
    rise = -slope * GROUND_CELL * np.abs(np.arange(-reach, reach + 1))
    along = grey_erosion(image, structure=rise[:, None], mode="constant", cval=_NOTHING)
    allowed = grey_erosion(along, structure=rise[None], mode="constant", cval=_NOTHING)
    return cells[:, 2] <= allowed[place[:, 0], place[:, 1]] + step


def _best_plane(
    candidates: Float64[np.ndarray, "m 3"],
    cells: Float64[np.ndarray, "k 3"],
    slope: float,
    rng: np.random.Generator,
) -> Float64[np.ndarray, "3"]:
    """The hypothesis of the highest score, of those through three candidates that are not too steep."""
    drawn = candidates[rng.integers(len(candidates), size=(_DRAWS, 3))]
    planes = np.concatenate([_through(drawn), [[0.0, 0.0, float(np.median(candidates[:, 2]))]]])
    planes = planes[np.hypot(planes[:, 0], planes[:, 1]) <= slope]
    on, above = (_heights(planes, some[rng.permutation(len(some))[:_SCORED]]) for some in (candidates, cells))
    speak = np.clip(1 - (on / _INLIER) ** 2, 0, None).mean(axis=1) * len(candidates)
    against = np.clip((above < -_BELOW).mean(axis=1) - _STRAY, 0, None) * len(cells)
    score = speak - _AGAINST * against
    return planes[int(np.argmax(score))]


def _heights(planes: Float64[np.ndarray, "p 3"], cells: Float64[np.ndarray, "m 3"]) -> Float64[np.ndarray, "p m"]:
    """How far each cell lies above each plane."""
    return cells[:, 2] - planes[:, :2] @ cells[:, :2].T - planes[:, 2:]


def _through(triples: Float64[np.ndarray, "d 3 3"]) -> Float64[np.ndarray, "_ 3"]:
    """a, b, c of the plane through each three points; triples that are nearly on a line are left out."""
    one, two = triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0]
    normal = np.cross(one, two)
    wide = np.abs(normal[:, 2]) > 0.05 * np.linalg.norm(one, axis=1) * np.linalg.norm(two, axis=1) + 1e-9
    normal, through = normal[wide], triples[wide, 0]
    slopes = -normal[:, :2] / normal[:, 2:]
    return np.column_stack([slopes, through[:, 2] - (slopes * through[:, :2]).sum(axis=1)])


def _refined(
    plane: Float64[np.ndarray, "3"], points: Float[np.ndarray, "n 3"], slope: float
) -> Float64[np.ndarray, "3"]:
    """The plane through the middles of the cells of points about it, narrower each time, unless that is too steep."""
    for band in _BANDS:
        above = heights_over(plane, points)
        about = low_points(points[np.abs(above) < band], GROUND_CELL, share=0.5)
        if len(about) < 3:
            return plane
        middle = about[:, :2].mean(axis=0)
        flat = np.column_stack([about[:, :2] - middle, np.ones(len(about))])
        weight = np.clip(1 - (heights_over(plane, about) / band) ** 2, 0, None) ** 2
        prior = np.diag([_SLOPE_PRIOR, _SLOPE_PRIOR, 0.0]) * len(about)
        normal = flat.T @ (flat * weight[:, None]) + prior
        a, b, c = np.linalg.solve(normal, flat.T @ (weight * about[:, 2]))
        if np.hypot(a, b) > slope:
            return plane
        plane = np.array([a, b, c - a * middle[0] - b * middle[1]])
    return plane
