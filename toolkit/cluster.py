"""The classical detector: what is not background, in clusters, each given the rectangle and the size that fit it best.

It needs no labels and no training, only a look at the empty site, and is the baseline that a trained one must beat:

1. points in or beside a voxel that the empty site occupies are background; the rest is foreground;
2. foreground is gathered in cells seen from above, and neighbouring cells into clusters by DBSCAN (Open3D);
   clusters longer or wider than a car are taken apart with a smaller reach where that works;
3. the yaw of each cluster's rectangle is the one whose edges its points are closest to (X. Zhang, W. Xu, C. Dong and
   J. M. Dolan, "Efficient L-shape fitting for vehicle detection using laser scanners", IV 2017, closeness criterion);
4. the class follows from the rectangle's size and the height above the ground; a car seen in part is completed to the
   usual size, away from the side on which more of it was seen; boxes stand on the ground of the empty site;
5. the score grows with what had to be seen rather than assumed: the number of points and the share of length and width.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import open3d as o3d

from toolkit.arrays import Bool, Float, Float64, Int64
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE, Detections

CAR = (4.5, 1.95, 1.5)  # m, completes what was seen of a car
LONGEST_CAR, WIDEST_CAR, TALLEST_CAR = 5.8, 2.4, 2.5  # m
FRACTION_SEEN = 0.75  # of the usual length or width, beyond which both ends were seen


@dataclass(frozen=True)
class Background:
    """The empty site: which voxels it occupies, and how high its ground is.

    origin: (3,) lowest corner of the grid (m); voxel: edge of a voxel (m); occupied: (nx, ny, nz), one layer round
    the occupied voxels included; cell: edge of a ground cell (m); ground: (kx, ky) height of the ground (m).
    """

    origin: Float64[np.ndarray, "3"]
    voxel: float
    occupied: Bool[np.ndarray, "nx ny nz"]
    cell: float
    ground: Float64[np.ndarray, "kx ky"]

    @staticmethod
    def learn(points: Float[np.ndarray, "n 3"], voxel: float = 0.12, cell: float = 2.0) -> Background:
        """From the points of the empty site, best of several sweeps with their noise."""
        if not len(points):
            raise ValueError("the background needs at least one point of the empty site, got none: crop less?")
        origin = points.min(axis=0).astype(np.float64) - 2 * voxel
        index = ((points - origin) / voxel).astype(np.int64)
        occupied = np.zeros(index.max(axis=0) + 3, bool)
        occupied[tuple(index.T)] = True
        for axis in range(3):
            occupied |= np.roll(occupied, 1, axis) | np.roll(occupied, -1, axis)
        return Background(origin, voxel, occupied, cell, _ground(points, origin, cell))

    def holds(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Which points lie in or beside a voxel of the empty site."""
        index = np.floor((points - self.origin) / self.voxel).astype(np.int64)
        index = np.clip(index, 0, np.array(self.occupied.shape) - 1)  # the outermost layer is never occupied
        return self.occupied[tuple(index.T)]

    def height(self, x: float, y: float) -> float:
        """Height of the ground at a place (m)."""
        place = ((np.array([x, y]) - self.origin[:2]) / self.cell).astype(np.int64)
        return float(self.ground[tuple(np.clip(place, 0, np.array(self.ground.shape) - 1))])


@dataclass(frozen=True)
class ClusterDetector:
    """Turns points, world frame, into detections of all classes, with what `learn` knows of the empty site.

    cell: edge of the cells that are clustered (m); reach: greatest distance between neighbouring cells of a cluster,
    tried from the first to the last while the cluster is too large for a car (m); fewest: points of a cluster.
    """

    background: Background
    cell: float = 0.2
    reach: tuple[float, ...] = (0.75, 0.45, 0.3)
    fewest: int = 5

    @staticmethod
    def learn(background_points: Float[np.ndarray, "n 3"] | Iterable[Float[np.ndarray, "_ 3"]]) -> ClusterDetector:
        """From clouds (n, 3) of the empty site, world frame, cropped as the points to detect in will be: what the same
        sensors measure, a few times over, so that their noise is known."""
        clouds = [background_points] if isinstance(background_points, np.ndarray) else list(background_points)
        return ClusterDetector(Background.learn(np.concatenate([np.zeros((0, 3), np.float32), *clouds])))

    def __call__(self, points: Float[np.ndarray, "n 3"]) -> Detections:
        """Detect; points: (n, 3), world frame, without those that are not finite."""
        foreground = points[~self.background.holds(points)].astype(np.float64)
        found = [self._recognise(cluster) for cluster in self._clusters(foreground, self.reach)]
        if not found:
            return Detections.empty()
        boxes, scores, labels = zip(*found, strict=True)
        return Detections(np.array(boxes), np.array(scores), np.array(labels))

    def _clusters(self, points: Float64[np.ndarray, "n 3"], reach: tuple[float, ...]) -> list[np.ndarray]:
        """Points of each cluster."""
        if len(points) < self.fewest:
            return []
        label = _dbscan(points, self.cell, reach[0])
        order = np.argsort(label, kind="stable")
        parts = np.split(points[order], np.flatnonzero(np.diff(label[order])) + 1)
        clusters = []
        for part in parts:
            if len(reach) > 1 and np.ptp(part[:, :2], axis=0).max() > LONGEST_CAR / 2 and _fit(part[:, :2]).too_large:
                clusters.extend(self._clusters(part, reach[1:]))
            elif len(part) >= self.fewest:
                clusters.append(part)
        return clusters

    def _recognise(self, cluster: Float64[np.ndarray, "n 3"]) -> tuple[np.ndarray, float, int]:
        """Box, score and label of a cluster."""
        rectangle = _fit(cluster[:, :2])
        ground = self.background.height(*cluster[:, :2].mean(axis=0))
        height = float(np.quantile(cluster[:, 2], 0.99)) - ground
        label = _label(rectangle, height)
        seen = 1.0
        if label == VEHICLE:
            rectangle, seen = _complete(rectangle)
            height = max(height, 0.8 * CAR[2])
        x, y = rectangle.centre
        box = np.array([x, y, ground + height / 2, *np.maximum(rectangle.size, 0.2), max(height, 0.2), rectangle.yaw])
        return box, seen * len(cluster) / (len(cluster) + 30.0), label


class _Rectangle(NamedTuple):
    """A rectangle round points: along its own axes from `low` to `high` (m), the longer first; share of points within
    0.2 m of each side, `at_low` and `at_high`."""

    yaw: float
    low: np.ndarray
    high: np.ndarray
    at_low: np.ndarray
    at_high: np.ndarray

    @property
    def size(self) -> np.ndarray:
        return self.high - self.low

    @property
    def centre(self) -> np.ndarray:
        (along, across), cos, sin = (self.low + self.high) / 2, np.cos(self.yaw), np.sin(self.yaw)
        return np.array([along * cos - across * sin, along * sin + across * cos])

    @property
    def too_large(self) -> bool:
        return bool(self.size[0] > LONGEST_CAR or self.size[1] > WIDEST_CAR)


def _dbscan(points: np.ndarray, cell: float, reach: float) -> Int64[np.ndarray, " n"]:
    """Cluster number of each point, by DBSCAN of the cells it occupies seen from above."""
    index = ((points[:, :2] - points[:, :2].min(axis=0)) / cell).astype(np.int64)
    keys, which = np.unique(index[:, 0] << 32 | index[:, 1], return_inverse=True)
    centres = np.column_stack([(keys >> 32) * cell, (keys & 0xFFFFFFFF) * cell, np.zeros(len(keys))])
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(centres))
    return np.asarray(cloud.cluster_dbscan(eps=reach, min_points=1), np.int64)[which]


def _fit(xy: Float64[np.ndarray, "n 2"]) -> _Rectangle:
    """The rectangle whose sides the points are closest to: the yaw in 0..90° with the greatest Σ 1 / distance to the
    nearest side, distances under 0.1 m counting as 0.1 m."""
    some = xy[:: 1 + len(xy) // 300]
    yaws = np.deg2rad(np.arange(0.0, 90.0, 1.5))
    along = np.outer(np.cos(yaws), some[:, 0]) + np.outer(np.sin(yaws), some[:, 1])
    across = np.outer(np.cos(yaws), some[:, 1]) - np.outer(np.sin(yaws), some[:, 0])
    distance = np.minimum(_to_nearest_end(along), _to_nearest_end(across))
    yaw = float(yaws[(1 / np.maximum(distance, 0.1)).sum(axis=1).argmax()])
    axes = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    own = xy @ axes
    low, high = np.quantile(own, [0.005, 0.995], axis=0)
    at_low, at_high = (own < low + 0.2).mean(axis=0), (own > high - 0.2).mean(axis=0)
    if high[0] - low[0] >= high[1] - low[1]:
        return _Rectangle(yaw, low, high, at_low, at_high)
    return _Rectangle(  # turned by 90°: the second axis becomes the first, the first one backwards the second
        yaw + np.pi / 2,
        np.array([low[1], -high[0]]),
        np.array([high[1], -low[0]]),
        np.array([at_low[1], at_high[0]]),
        np.array([at_high[1], at_low[0]]),
    )


def _to_nearest_end(positions: Float64[np.ndarray, "k n"]) -> Float64[np.ndarray, "k n"]:
    low, high = positions.min(axis=1, keepdims=True), positions.max(axis=1, keepdims=True)
    return np.minimum(positions - low, high - positions)


def _label(rectangle: _Rectangle, height: float) -> int:
    length, width = rectangle.size
    if length > LONGEST_CAR or width > WIDEST_CAR or height > TALLEST_CAR:
        return HEAVY
    if length < 1.2 and width < 1.0:
        return PEDESTRIAN
    return CYCLIST if length < 2.3 and width < 0.85 else VEHICLE


def _complete(seen: _Rectangle) -> tuple[_Rectangle, float]:
    """A car's rectangle made up to the usual size, and the share of length times width that was seen."""
    usual = np.array(CAR[:2])
    short = seen.size < FRACTION_SEEN * usual
    extra = np.where(short, usual - seen.size, 0.0)
    beyond_high = seen.at_low > seen.at_high
    low, high = seen.low - np.where(beyond_high, 0, extra), seen.high + np.where(beyond_high, extra, 0)
    share = float(np.prod(np.minimum(seen.size / usual, 1)))
    return seen._replace(low=low, high=high), share


def _ground(points: np.ndarray, origin: np.ndarray, cell: float) -> Float64[np.ndarray, "kx ky"]:
    """Height of the ground in cells: of the lowest fifth of their points the highest; where there are none or they
    stand more than half a metre above the rest, the mean of the neighbours."""
    place = ((points[:, :2] - origin[:2]) / cell).astype(np.int64)
    shape = place.max(axis=0) + 1
    key = place[:, 0] * shape[1] + place[:, 1]
    order = np.lexsort((points[:, 2], key))
    keys, first, count = np.unique(key[order], return_index=True, return_counts=True)
    ground = np.full(shape[0] * shape[1], np.nan)
    ground[keys] = points[order[first + count // 5], 2]
    ground[ground > np.nanmedian(ground) + 0.5] = np.nan
    ground = ground.reshape(shape)
    while np.isnan(ground).any():
        padded = np.pad(ground, 1, constant_values=np.nan)
        windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).reshape(*shape, 9)
        known = np.isfinite(windows)
        mean = np.where(known, windows, 0).sum(axis=-1) / np.maximum(known.sum(axis=-1), 1)
        ground = np.where(np.isnan(ground) & known.any(axis=-1), mean, ground)
    return ground
