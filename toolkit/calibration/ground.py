"""Ground below a cloud: a plane z = a x + b y + c, and a height map upon it.

The plane is found by RANSAC among the lowest points. A roof, a wall or a row of hedges may have
more points than the ground, and the ground may be seen on one side only. So points are thinned to
the low end of each cell of a grid. Cells that stand above others near by, by more than `max_tilt`
and a kerb explain, are left out. A hypothesis is scored by the cells that lie on it, less those
that lie well below it, since nothing lies under the ground. The best plane is fitted again to the
points about it, cell by cell, so that near rings of a lidar do not outweigh far ones (M. A.
Fischler and R. C. Bolles, 1981; G. Vosselman, 2000)."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from toolkit.arrays import BoxRows, Float, Float64, Points, Pose
from toolkit.boxes import check_boxes
from toolkit.calibration.height_map import (
    GROUND_CELL,
    HeightMap,
    fit_map,
    low_points,
    lowest_mask,
    support_mask,
)
from toolkit.calibration.levels import GroundLevel, add_levels
from toolkit.geometry import invert, transform

if TYPE_CHECKING:
    from toolkit.clouds import PointCloud

_Plane = Float64[np.ndarray, "3"]
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


def fit_plane(points: Points, *, max_tilt: float = MAX_TILT, seed: int = 0) -> _Plane:
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
    plane: _Plane = planes[int(np.argmax(support - _AGAINST * penalty))]
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


def heights_above_plane(plane: _Plane, points: Points) -> Float64[np.ndarray, " n"]:
    """Height (m, along z) of each point above a plane."""
    return points[:, 2] - points[:, :2].astype(np.float64) @ plane[:2] - plane[2]


Levelling = Literal["map", "plane"]

TOLERANCE = 0.15  # m that the ground may be off zero before `level_warning` warns
_HARDLY = 0.02  # share of points between the ground and 4 m that counts as hardly any
_FEW = 200  # points: with fewer there is no warning
_LOW = 4.0  # m above the ground that a cloud may be cropped to
_MOST_COLUMNS = 4  # of an array of points: x y z intensity


@dataclass(frozen=True)
class Ground:
    """Ground in some frame: a plane z = a x + b y + c, and heights above it."""

    plane: _Plane
    deviation: HeightMap | None = None  # above the plane, once that is level
    levels: tuple[GroundLevel, ...] = ()  # away from the main ground

    @property
    def tilt(self) -> float:
        """Angle (rad) between the plane's normal and z."""
        return float(np.arctan(np.hypot(self.plane[0], self.plane[1])))

    @cached_property
    def level_SE3_frame(self) -> Pose:
        """Rigid motion (4, 4) from the ground's frame to level."""
        a, b, c = self.plane.tolist()
        normal = np.array([-a, -b, 1.0]) / np.sqrt(1 + a * a + b * b)
        cross = np.array(
            [[0.0, 0.0, -normal[0]], [0.0, 0.0, -normal[1]], [normal[0], normal[1], 0.0]]
        )
        motion = np.eye(4)
        motion[:3, :3] += cross + cross @ cross / (1 + normal[2])
        motion[2, 3] = -c * normal[2]
        return motion

    def height(self, xy: Float[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
        """Height (m) of the ground at places, own frame."""
        xy = np.asarray(xy, np.float64)
        on_plane = np.column_stack([xy, xy @ self.plane[:2] + self.plane[2]])
        return on_plane[:, 2] + self._deviation(transform(self.level_SE3_frame, on_plane)[:, :2])

    def points(self, points: Points) -> Points:
        """Return points with z as height above the ground."""
        level = transform(self.level_SE3_frame, np.asarray(points, np.float64))
        level[:, 2] -= self._deviation(level[:, :2])
        return level.astype(points.dtype)

    def points_back(self, points: Points) -> Points:
        """Undo `points`."""
        raised = np.array(points, np.float64)
        raised[:, 2] += self._deviation(raised[:, :2])
        return transform(invert(self.level_SE3_frame), raised).astype(points.dtype)

    def boxes(self, boxes: BoxRows) -> BoxRows:
        """Return boxes in the level frame, turned with the plane."""
        rows = check_boxes(boxes).copy()
        ahead = np.column_stack([np.cos(rows[:, 6]), np.sin(rows[:, 6])])
        ahead = np.column_stack([ahead, ahead @ self.plane[:2]]) @ self.level_SE3_frame[:3, :3].T
        rows[:, :3] = self.points(rows[:, :3])
        rows[:, 6] = np.arctan2(ahead[:, 1], ahead[:, 0])
        return rows

    def boxes_back(self, boxes: BoxRows) -> BoxRows:
        """Undo `boxes`."""
        rows = check_boxes(boxes).copy()
        ahead = np.column_stack([np.cos(rows[:, 6]), np.sin(rows[:, 6]), np.zeros(len(rows))])
        ahead = ahead @ self.level_SE3_frame[:3, :3]
        rows[:, :3] = self.points_back(rows[:, :3])
        rows[:, 6] = np.arctan2(ahead[:, 1], ahead[:, 0])
        return rows

    def _deviation(self, xy: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
        return np.zeros(len(xy)) if self.deviation is None else self.deviation.at(xy)


def level(
    cloud: "PointCloud | Points", *, method: Levelling = "map", max_tilt: float = MAX_TILT
) -> Ground:
    """Find the ground below a cloud, in any frame whose z is up to within `max_tilt` (rad).

    cloud: of any kind, see `plain_points`. method: "plane" for one plane, "map" for a smooth map of
    heights upon it. Raises ValueError if no ground is found."""
    points = plain_points(cloud)
    if method not in ("map", "plane"):
        raise ValueError(f'method must be "map" or "plane", got {method!r}')
    if not 0 <= max_tilt < np.pi / 4:
        raise ValueError(f"max_tilt must lie in 0..45 degrees, got {np.rad2deg(max_tilt):.1f}")
    points = points[np.isfinite(points).all(axis=1)]
    ground = Ground(fit_plane(points, max_tilt=max_tilt))
    if method == "plane":
        return ground
    lifted = ground.points(points.astype(np.float64))
    return Ground(ground.plane, *add_levels(fit_map(lifted), lifted))


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


def plain_points(cloud: object) -> Points:
    """Return the points (n, 3) of a cloud of Open3D, tensor or legacy, or of an array (n, 3) or (n,
    4)."""
    tensors = getattr(cloud, "point", None)
    legacy = getattr(cloud, "points", None)
    if tensors is not None:
        points = tensors.positions.cpu().numpy() if "positions" in tensors else np.empty((0, 3))
    else:
        points = np.asarray(cloud if legacy is None else legacy)
    if (
        points.ndim != 2
        or not 3 <= points.shape[1] <= _MOST_COLUMNS
        or points.dtype.kind not in "fiu"
    ):
        hint = ": pass points.T?" if points.ndim == 2 and points.shape[0] == 3 else ""
        raise ValueError(f"points must have shape (n, 3), got {points.shape}{hint}")
    return points[:, :3] if points.dtype.kind == "f" else points[:, :3].astype(np.float64)
