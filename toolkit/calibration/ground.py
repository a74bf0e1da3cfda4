"""Ground below a cloud: a plane, and a height map upon it."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from toolkit.arrays import BoxRows, Float, Float64, Points, Pose
from toolkit.boxes import check_boxes
from toolkit.calibration.ground_plane import MAX_TILT_RAD, Plane, fit_plane
from toolkit.calibration.height_map import HeightMap, fit_map
from toolkit.calibration.levels import GroundLevel, add_levels
from toolkit.geometry import invert, transform

if TYPE_CHECKING:
    from toolkit.clouds import PointCloud

Levelling = Literal["map", "plane"]
_MAX_COLUMNS = 4  # x y z intensity, in an array of points


@dataclass(frozen=True)
class Ground:
    """Ground of a cloud: a plane z = a x + b y + c, and heights above it.

    Attributes:
        plane: a, b (m per m) and c (m).
        deviation: height of the ground above the plane, in the level frame, None for a bare plane.
        levels: surfaces away from the main ground, such as raised roads and roofs."""

    plane: Plane
    deviation: HeightMap | None = None  # above the plane, once that is level
    levels: tuple[GroundLevel, ...] = ()  # away from the main ground

    @property
    def tilt(self) -> float:
        """Angle (rad) between the plane's normal and z."""
        return float(np.arctan(np.hypot(self.plane[0], self.plane[1])))

    @cached_property
    def level_SE3_frame(self) -> Pose:
        """Rigid motion (4, 4) from the ground's frame to the level one.

        It is the smallest turn that makes the plane level, and a move along z that brings it to
        z = 0."""
        a, b, c = self.plane.tolist()
        normal = np.array([-a, -b, 1.0]) / np.sqrt(1 + a * a + b * b)
        x, y, z = normal
        # Rodrigues' formula for the turn from the normal to the z axis: matrix of their cross
        # product, and z as the cosine of the angle between them
        cross_matrix = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
        motion = np.eye(4)
        motion[:3, :3] += cross_matrix + cross_matrix @ cross_matrix / (1 + z)
        motion[2, 3] = -c * z
        return motion

    def height(self, xy: Float[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
        """Height z (m) of the ground at each x and y, all in the ground's frame."""
        xy = np.asarray(xy, np.float64)
        # the deviation is looked up at the plane's points with these x and y
        plane_height = xy @ self.plane[:2] + self.plane[2]
        plane_points = np.column_stack([xy, plane_height])
        level_points = transform(self.level_SE3_frame, plane_points)
        return plane_height + self._find_deviation(level_points[:, :2])

    def points(self, points: Points) -> Points:
        """Return points of the ground's frame in the level one, with z as height above the ground.

        The type of the numbers stays."""
        level_points = transform(self.level_SE3_frame, np.asarray(points, np.float64))
        level_points[:, 2] -= self._find_deviation(level_points[:, :2])
        return level_points.astype(points.dtype)

    def points_back(self, points: Points) -> Points:
        """Return points of the level frame in the ground's frame, the inverse of `points`."""
        raised_points = np.array(points, np.float64)
        raised_points[:, 2] += self._find_deviation(raised_points[:, :2])
        return transform(invert(self.level_SE3_frame), raised_points).astype(points.dtype)

    def boxes(self, boxes: BoxRows) -> BoxRows:
        """Return boxes of the ground's frame in the level one; yaw is turned with the plane.

        boxes: x, y, z, length, width, height (m) and yaw (rad) of each. In the result, z is the
        height of the centre above the ground."""
        rows = check_boxes(boxes).copy()
        yaw = rows[:, 6]
        heading = np.column_stack([np.cos(yaw), np.sin(yaw)])
        rise = heading @ self.plane[:2]  # headings rise with the plane
        level_heading = np.column_stack([heading, rise]) @ self.level_SE3_frame[:3, :3].T
        rows[:, :3] = self.points(rows[:, :3])
        rows[:, 6] = np.arctan2(level_heading[:, 1], level_heading[:, 0])
        return rows

    def boxes_back(self, boxes: BoxRows) -> BoxRows:
        """Return boxes of the level frame in the ground's frame, the inverse of `boxes`.

        boxes: x, y, z, length, width, height (m) and yaw (rad) of each."""
        rows = check_boxes(boxes).copy()
        yaw = rows[:, 6]
        level_heading = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(rows))])
        heading = level_heading @ self.level_SE3_frame[:3, :3]
        rows[:, :3] = self.points_back(rows[:, :3])
        rows[:, 6] = np.arctan2(heading[:, 1], heading[:, 0])
        return rows

    def _find_deviation(self, xy: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
        # height (m) of the ground above the plane at places of the level frame
        return np.zeros(len(xy)) if self.deviation is None else self.deviation.at(xy)


def level(
    cloud: "PointCloud | Points", *, method: Levelling = "map", max_tilt: float = MAX_TILT_RAD
) -> Ground:
    """Find the ground below a cloud, in any frame whose z is up to within `max_tilt`.

    Args:
        cloud: cloud of Open3D, or array (n, 3) or (n, 4) of x, y, z (m) and intensity.
        method: "plane" for one plane, "map" for a smooth map of heights upon it.
        max_tilt: largest angle (rad) between the ground's normal and z, below 45 degrees.

    Raises ValueError if no ground is found."""
    points = plain_points(cloud)
    if method not in ("map", "plane"):
        raise ValueError(f'method must be "map" or "plane", got {method!r}')
    if not 0 <= max_tilt < np.pi / 4:
        raise ValueError(f"max_tilt must lie in 0..45 degrees, got {np.rad2deg(max_tilt):.1f}")
    points = points[np.isfinite(points).all(axis=1)]
    ground = Ground(fit_plane(points, max_tilt=max_tilt))
    if method == "plane":
        return ground
    level_points = ground.points(points.astype(np.float64))
    deviation, levels = add_levels(fit_map(level_points), level_points)
    return Ground(ground.plane, deviation=deviation, levels=levels)


def plain_points(cloud: object) -> Points:
    """Return the points (n, 3) of a cloud as an array of floats.

    cloud: a cloud of Open3D, tensor or legacy, or an array (n, 3) or (n, 4), whose fourth column is
    left out. Integers become float64. Raises ValueError for another shape or type."""
    tensors = getattr(cloud, "point", None)  # attribute of tensor clouds
    legacy_points = getattr(cloud, "points", None)  # attribute of legacy clouds
    if tensors is not None:
        points = tensors.positions.cpu().numpy() if "positions" in tensors else np.empty((0, 3))
    else:
        points = np.asarray(cloud if legacy_points is None else legacy_points)
    has_columns = points.ndim == 2 and 3 <= points.shape[1] <= _MAX_COLUMNS
    if not has_columns or points.dtype.kind not in "fiu":  # floats, integers, unsigned integers
        hint = ": pass points.T?" if points.ndim == 2 and points.shape[0] == 3 else ""
        raise ValueError(f"points must have shape (n, 3), got {points.shape}{hint}")
    return points[:, :3] if points.dtype.kind == "f" else points[:, :3].astype(np.float64)
