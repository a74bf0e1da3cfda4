"""Clouds and boxes put on level ground: z = 0 where wheels stand, whatever frame they were measured in.

A detector that learnt on ground at z = 0 loses a third of the cars where the ground is 0.3 m off, and all of them in
a raw cloud, whose origin is the sensor. `level` finds the ground; what it returns turns points and boxes there and
back. Its first step is rigid: the smallest rotation about the frame's origin that makes the plane of the ground level,
and a shift along z. With a map, what the ground still deviates from that plane is taken off each point's height.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from toolkit.arrays import Float, Float64
from toolkit.boxes import check_boxes
from toolkit.calibration.ground_plane import MAX_TILT, fit_plane, heights_over
from toolkit.calibration.height_map import MAP_REACH, HeightMap, fit_map
from toolkit.geometry import invert, transform

Levelling = Literal["map", "plane"]

TOLERANCE = 0.15  # m that the ground may be off zero before `level_warning` says so
_HARDLY = 0.02  # share of points between the ground and 4 m that is hardly any
_FEW = 200  # points, of which nothing can be said


@dataclass(frozen=True)
class Ground:
    """The ground in some frame: a plane z = a x + b y + c, and how far it deviates from that plane once it is level."""

    plane: Float64[np.ndarray, "3"]
    deviation: HeightMap | None = None

    @property
    def tilt(self) -> float:
        """Angle (rad) between the plane's normal and z."""
        return float(np.arctan(np.hypot(self.plane[0], self.plane[1])))

    @cached_property
    def level_SE3_frame(self) -> Float64[np.ndarray, "4 4"]:
        """The rigid part: out of the frame the ground was found in, into the level one."""
        a, b, c = self.plane.tolist()
        normal = np.array([-a, -b, 1.0]) / np.sqrt(1 + a * a + b * b)
        cross = np.array([[0.0, 0.0, -normal[0]], [0.0, 0.0, -normal[1]], [normal[0], normal[1], 0.0]])
        motion = np.eye(4)
        motion[:3, :3] += cross + cross @ cross / (1 + normal[2])
        motion[2, 3] = -c * normal[2]
        return motion

    def height(self, xy: Float[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
        """z of the ground (m), in the frame it was found in, at places of that frame."""
        xy = np.asarray(xy, np.float64)
        on_plane = np.column_stack([xy, xy @ self.plane[:2] + self.plane[2]])
        return on_plane[:, 2] + self._deviation(transform(self.level_SE3_frame, on_plane)[:, :2])

    def points(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Points of the frame with z as their height above the ground; their dtype is kept."""
        level = transform(self.level_SE3_frame, np.asarray(points, np.float64))
        level[:, 2] -= self._deviation(level[:, :2])
        return level.astype(points.dtype)

    def points_back(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """What `points` undoes: from the level frame into the one the ground was found in."""
        raised = np.array(points, np.float64)
        raised[:, 2] += self._deviation(raised[:, :2])
        return transform(invert(self.level_SE3_frame), raised).astype(points.dtype)

    def boxes(self, boxes: Float[np.ndarray, "n 7"]) -> Float64[np.ndarray, "n 7"]:
        """Boxes that stand on the ground, their centres as `points`, their headings turned with the plane."""
        rows = check_boxes(boxes).copy()
        ahead = np.column_stack([np.cos(rows[:, 6]), np.sin(rows[:, 6])])
        ahead = np.column_stack([ahead, ahead @ self.plane[:2]]) @ self.level_SE3_frame[:3, :3].T
        rows[:, :3], rows[:, 6] = self.points(rows[:, :3]), np.arctan2(ahead[:, 1], ahead[:, 0])
        return rows

    def boxes_back(self, boxes: Float[np.ndarray, "n 7"]) -> Float64[np.ndarray, "n 7"]:
        """What `boxes` undoes: from the level frame into the one the ground was found in."""
        rows = check_boxes(boxes).copy()
        ahead = np.column_stack([np.cos(rows[:, 6]), np.sin(rows[:, 6]), np.zeros(len(rows))])
        ahead = ahead @ self.level_SE3_frame[:3, :3]
        rows[:, :3], rows[:, 6] = self.points_back(rows[:, :3]), np.arctan2(ahead[:, 1], ahead[:, 0])
        return rows

    def _deviation(self, xy: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
        return np.zeros(len(xy)) if self.deviation is None else self.deviation.at(xy)


def level(
    cloud: Any, *, method: Levelling = "map", max_tilt: float = MAX_TILT, reach: float = MAP_REACH, seed: int = 0
) -> Ground:
    """The ground below a cloud: an Open3D one or points (n, 3), in any frame whose z is up to within `max_tilt` (rad).

    method: "plane" for one plane, "map" for a smooth map of heights upon it, as far as `reach` (m) from the middle of
    the points. The same points and seed give the same ground. Raises ValueError where there is none to be found.

    >>> rng = np.random.default_rng(0)
    >>> street = np.column_stack([rng.uniform(-20, 20, (4000, 2)), np.full(4000, -1.7)])
    >>> ground = level(street, method="plane")
    >>> ground.height(np.array([[5.0, 5.0]])).round(3)
    array([-1.7])
    """
    points = plain_points(cloud)
    if method not in ("map", "plane"):
        raise ValueError(f'method must be "map" or "plane", got {method!r}')
    if not 0 <= max_tilt < np.pi / 4:
        raise ValueError(f"max_tilt must lie in 0..45 degrees, got {np.rad2deg(max_tilt):.1f}")
    points = points[np.isfinite(points).all(axis=1)]
    ground = Ground(fit_plane(points, max_tilt=max_tilt, seed=seed))
    if method == "plane":
        return ground
    return Ground(ground.plane, fit_map(ground.points(points.astype(np.float64)), reach=reach))


def level_warning(cloud: Any, *, height: float = 4.0, seed: int = 0) -> str | None:
    """One line that says where the ground of a cloud lies, if it is not about z = 0; else nothing.

    Less than half of the ground within `TOLERANCE` of zero, or no ground and hardly a point between 0 and `height` (m),
    is worth a warning. A cloud cropped to that slice is not: there is no ground left in it to be found.
    """
    points = plain_points(cloud)
    points = points[np.isfinite(points).all(axis=1)]
    within = (points[:, 2] > 0) & (points[:, 2] < height)
    if len(points) < _FEW or within.all():
        return None
    counted = f"{within.mean():.0%} of {len(points)} points lie between 0 and {height:g} m"
    try:
        ground = Ground(fit_plane(points, seed=seed))
    except ValueError:
        return (
            None if within.mean() > _HARDLY else f"{counted}, and no ground is to be found in them: check their frame"
        )
    on = points[np.abs(heights_over(ground.plane, points)) < TOLERANCE, 2]
    if (np.abs(on) < TOLERANCE).mean() >= 0.5:
        return None
    return (
        f"{counted}: their ground seems to lie at z = {np.median(on):.2f} m, tilted by {np.rad2deg(ground.tilt):.1f}°: "
        "level the points first"
    )


def plain_points(cloud: Any) -> Float[np.ndarray, "n 3"]:
    """The points (n, 3) of an array or of an Open3D cloud (anything with `point.positions`)."""
    held = getattr(cloud, "point", None)
    points = np.asarray(cloud) if held is None else held.positions.cpu().numpy()
    if points.ndim != 2 or points.shape[1] != 3:
        hint = ": pass points.T?" if points.ndim == 2 and points.shape[0] == 3 else ""
        raise ValueError(f"points must have shape (n, 3), got {points.shape}{hint}")
    return points if points.dtype.kind == "f" else points.astype(np.float64)
