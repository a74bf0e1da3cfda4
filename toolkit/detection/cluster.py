"""Classical detector: clusters of points with fitted rectangles.

It needs no labels and no training, only a look at the empty site, and is the baseline that a
trained one must beat:

1. points in or beside a voxel that the empty site occupies are background; the rest is foreground;
2. foreground is gathered in cells seen from above, and neighbouring cells into clusters by DBSCAN
   (Open3D); clusters longer or wider than a car are taken apart with a smaller reach where that
   works;
3. the yaw of each cluster's rectangle is the one whose edges its points are closest to (X. Zhang,
   W. Xu, C. Dong and J. M. Dolan, "Efficient L-shape fitting for vehicle detection using laser
   scanners", IV 2017, closeness criterion);
4. the class follows from the rectangle's size and the height above the ground; a car seen in part
   is completed to the usual size, to where the empty site is hidden now; boxes stand on the ground
   of the empty site;
5. the score grows with what had to be seen rather than assumed: the number of points and the share
  of length and width.

`learn_cluster_detector` learns it from the empty scenes of a recording of clouds."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import ClassVar, NamedTuple

import numpy as np

from toolkit.arrays import Float, Float64, Points, Rng
from toolkit.boxes import count_points, nms
from toolkit.calibration.empty_scene import Scenes
from toolkit.datasets.dataset import CoopDataset
from toolkit.detection.background import SWEEPS, Background, empty_sweeps
from toolkit.detection.place import Corners, Place, Stand, crop_points
from toolkit.frame import Frame
from toolkit.geometry import plane_rotation, transform
from toolkit.objects import CYCLIST, HEAVY, LABELS, PEDESTRIAN, VEHICLE, Detections
from toolkit.runtime.light_open3d import o3d

CAR = np.array([4.4, 1.9])  # length and width (m) to which a car seen in part is completed
LOWEST_ROOF = 1.3  # m, least height of a car
# m, larger is heavy
LONGEST_CAR = 5.8
WIDEST_CAR = 2.4
TALLEST_CAR = 2.5
LENGTH_SEEN = 0.75 * CAR[0]  # m; a longer car shows both ends and needs no completion
DOUBT = 10.0  # weight of a cluster's points on a completed side, in points of free ground
REACH_TOLERANCE = (
    1e-9  # by which cells at just the reach are neighbours, whatever 0.6 / 0.2 is rounded to
)
OVERLAP = 0.1  # IoU above which the worse of two cars is dropped


@dataclass(frozen=True)
class ClusterDetector:
    """Detector of all classes, learnt from nothing but points of the empty site, world frame.

    Attributes:
        background: the empty site.
        cell: edge of the cells that are clustered, m.
        reach: distances up to which, and at which, cells are neighbours in a cluster, m; the next
            is tried while the cluster is too large for a car.
        fewest: points of a cluster.
        area: xmin ymin xmax ymax, m, below 4 m, to which points are cropped, None for no crop.
    """

    labels: ClassVar[tuple[str, ...]] = LABELS
    background: Background
    cell: float = 0.2
    reach: tuple[float, ...] = (0.9, 0.6, 0.4, 0.28)
    fewest: int = 5
    area: Corners | None = None

    @staticmethod
    def learn(background_points: Points | Iterable[Float[np.ndarray, "_ 3"]]) -> "ClusterDetector":
        """Learn from clouds (n, 3) of the empty site, cropped like the points to detect in, world
        frame. Several sweeps of the same sensors show their noise."""
        clouds = (
            [background_points]
            if isinstance(background_points, np.ndarray)
            else list(background_points)
        )
        return ClusterDetector(
            Background.learn(np.concatenate([np.zeros((0, 3), np.float32), *clouds]))
        )

    @staticmethod
    def of(recording: CoopDataset) -> "ClusterDetector":
        """Learn from four noisy sweeps of a recording's empty site."""
        return ClusterDetector.learn(empty_sweeps(recording))

    @property
    def digest(self) -> str:
        """SHA-256 of the empty site and the settings."""
        settings = repr((self.cell, self.reach, self.fewest)).encode()
        return self.background.digest_settings(settings) + (
            "" if self.area is None else f" {self.area}"
        )

    def __call__(self, points: Points) -> Detections:
        """Detect in points (n, 3), world frame, that are finite."""
        points = points if self.area is None else crop_points(points, self.area)
        points = points[np.isfinite(points).all(axis=1)]
        is_background = self.background.holds(points)
        clusters = self._clusters(points[~is_background].astype(np.float64), self.reach)
        if not clusters:
            return Detections.empty()
        seen = [_fit(cluster[:, :2]) for cluster in clusters]
        ground = self.background.height(
            np.array([cluster[:, :2].mean(axis=0) for cluster in clusters])
        )
        height = np.array([np.quantile(cluster[:, 2], 0.99) for cluster in clusters]) - ground
        length, width = np.array([rectangle.size for rectangle in seen]).T
        heavy = (length > LONGEST_CAR) | (width > WIDEST_CAR) | (height > TALLEST_CAR)
        slim = [(length < 1.2) & (width < 1.0), (length < 2.3) & (width < 0.85)]
        labels = np.select([heavy, *slim], [HEAVY, PEDESTRIAN, CYCLIST], VEHICLE)
        number = np.array([len(cluster) for cluster in clusters])
        scores = number / (number + 30.0)

        cars = np.flatnonzero(labels == VEHICLE)
        others = np.flatnonzero(labels != VEHICLE)
        scores[cars] *= [np.prod(np.minimum(seen[k].size / CAR, 1)) for k in cars]
        height[cars] = np.maximum(height[cars], LOWEST_ROOF)
        completed = dict(
            zip(
                cars.tolist(),
                _complete([seen[k] for k in cars], points[is_background]),
                strict=True,
            )
        )
        whole = [completed.get(k, rectangle) for k, rectangle in enumerate(seen)]
        size = np.maximum(np.column_stack([[r.size for r in whole], height]), 0.2)
        centre = np.column_stack([[r.centre for r in whole], ground + size[:, 2] / 2])
        boxes = np.column_stack([centre, size, [r.yaw for r in whole]])
        rows = np.concatenate([cars[nms(boxes[cars], scores[cars], OVERLAP)], others])
        return Detections(boxes, scores, labels)[rows]

    def _clusters(
        self, points: Float64[np.ndarray, "n 3"], reach: tuple[float, ...]
    ) -> list[np.ndarray]:
        if len(points) < self.fewest:
            return []
        # cells seen from above
        index = ((points[:, :2] - points[:, :2].min(axis=0)) / self.cell).astype(np.int64)
        keys, which = np.unique(index[:, 0] << 32 | index[:, 1], return_inverse=True)
        # whole numbers: exact distances
        cells = np.column_stack([keys >> 32, keys & 0xFFFFFFFF, np.zeros(len(keys))])
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cells))
        reach_cells = reach[0] / self.cell * (1 + REACH_TOLERANCE)
        label = np.asarray(cloud.cluster_dbscan(eps=reach_cells, min_points=1), np.int64)[which]
        order = np.argsort(label, kind="stable")
        parts = np.split(points[order], np.flatnonzero(np.diff(label[order])) + 1)
        clusters = []
        for part in parts:
            too_large = len(reach) > 1 and np.ptp(part[:, :2], axis=0).max() > LONGEST_CAR / 2
            if too_large and (_fit(part[:, :2]).size > [LONGEST_CAR, WIDEST_CAR]).any():
                clusters.extend(self._clusters(part, reach[1:]))
            elif len(part) >= self.fewest:
                clusters.append(part)
        return clusters


class _Rectangle(NamedTuple):
    """Rectangle, longer axis first: ends along its axes (m), and share of points within 0.2 m of
    each side."""

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

    def turn(self) -> "_Rectangle":
        """Swap the axes; the reversed first becomes the second."""
        low, high = np.array([[self.low[1], -self.high[0]], [self.high[1], -self.low[0]]])
        at_low, at_high = np.array(
            [[self.at_low[1], self.at_high[0]], [self.at_high[1], self.at_low[0]]]
        )
        return _Rectangle(self.yaw + np.pi / 2, low, high, at_low, at_high)


def _fit(xy: Float64[np.ndarray, "n 2"]) -> _Rectangle:
    """Fit the rectangle whose yaw has the greatest Σ 1 / distance to the nearest side, at least
    0.1 m."""
    some = xy[:: 1 + len(xy) // 150]
    yaws = np.deg2rad(np.arange(0.0, 90.0, 2.0))
    along = np.outer(np.cos(yaws), some[:, 0]) + np.outer(np.sin(yaws), some[:, 1])
    across = np.outer(np.cos(yaws), some[:, 1]) - np.outer(np.sin(yaws), some[:, 0])
    ends = [
        np.minimum(u - u.min(axis=1, keepdims=True), u.max(axis=1, keepdims=True) - u)
        for u in (along, across)
    ]
    distance = np.minimum(*ends)
    yaw = float(yaws[(1 / np.maximum(distance, 0.1)).sum(axis=1).argmax()])
    own = xy @ plane_rotation(yaw)
    low, high = np.quantile(own, [0.005, 0.995], axis=0)
    at_low = (own < low + 0.2).mean(axis=0)
    at_high = (own > high - 0.2).mean(axis=0)
    rectangle = _Rectangle(yaw, low, high, at_low, at_high)
    return rectangle if rectangle.size[0] >= rectangle.size[1] else rectangle.turn()


def _complete(cars: list[_Rectangle], background: Points) -> list[_Rectangle]:
    """Complete cars to the usual size where that covers least background; sides with many points
    rarely grow."""
    ways = list[_Rectangle]()
    doubts = list[float]()
    first = [0]
    for seen in cars:
        for rectangle in [seen, seen.turn()] if seen.size[0] < WIDEST_CAR else [seen]:
            missing = np.where(rectangle.size < [LENGTH_SEEN, CAR[1]], CAR - rectangle.size, 0.0)
            for at_high in np.array([[False, False], [False, True], [True, False], [True, True]]):
                low, high = rectangle.low - missing * ~at_high, rectangle.high + missing * at_high
                ways.append(rectangle._replace(low=low, high=high))
                doubts.append(
                    float(np.where(at_high, rectangle.at_high, rectangle.at_low) @ (missing > 0))
                )
        first.append(len(ways))
    columns = [(*way.centre, 0.0, *np.maximum(way.size - 0.3, 0.1), 100.0, way.yaw) for way in ways]
    cost = count_points(background, np.array(columns).reshape(-1, 7)) + DOUBT * np.array(doubts)
    return [ways[a + int(cost[a:b].argmin())] for a, b in pairwise(first)]


def learn_cluster_detector(scenes: Scenes, frame: Frame, place: Place = Place()) -> ClusterDetector:
    """Return a detector of what stands out from the empty scenes of lidars that stand as in a
    frame. place: the one it will detect in. Raises ValueError where the empty scenes have no point
    in the area."""
    rng = np.random.default_rng(0)
    sweeps = []
    centre = place.find_middle(frame)
    for _ in range(SWEEPS):
        parts = [
            transform(cloud.world_SE3_sensor, _sweep(scenes, cloud.name, rng))
            for cloud in frame.clouds
        ]
        sweeps.append(np.concatenate([np.zeros((0, 3)), *parts]))
    (x, y), method = place.half, place.level or "map"
    ground = None if method == "none" else place.find_ground(sweeps[0] - [*centre, 0.0], method)
    area = (-x, -y, x, y)
    stand = Stand((-x, -y, x, y), centre, ground)
    return replace(
        ClusterDetector.learn([crop_points(stand.lift(sweep), area) for sweep in sweeps]), area=area
    )


def _sweep(scenes: Scenes, name: str, rng: Rng) -> Float64[np.ndarray, "n 3"]:
    """Draw a sweep of a sensor in its empty scene, in the sensor's own frame. Each pixel takes one
    of its two measurements, as often as it was met, with its spread."""
    scene = scenes[name].scene
    model = scenes.grid(name).model
    other = np.isfinite(scene.second) & (rng.random(scene.first.shape) > scene.share)
    median = np.where(other, scene.second, scene.first).astype(np.float64)
    measured = median + np.where(other, scene.second_spread, scene.spread) * rng.standard_normal(
        median.shape
    )
    there = (median > 0) & (measured > 0)
    return model.rays().astype(np.float64)[there] * measured[there][:, None]
