"""Classical detector: clusters of points with fitted rectangles.

It needs no labels and no training, only a look at the empty site, and is the baseline that a
trained detector must beat:

1. points in or next to a voxel that the empty site occupies are background; the rest is foreground;
2. foreground is gathered in cells seen from above, and neighbouring cells into clusters by DBSCAN
   (Open3D); clusters longer or wider than a car are split with a smaller reach if possible;
3. the yaw of each cluster's rectangle is the one whose edges its points are closest to (X. Zhang,
   W. Xu, C. Dong and J. M. Dolan, "Efficient L-shape fitting for vehicle detection using laser
   scanners", IV 2017, closeness criterion);
4. the class follows from the rectangle's size and the height above the ground; a car seen in part
   is completed to the usual size, into space in which the empty site is hidden; boxes are placed
   on the ground of the empty site;
5. the score grows with what was seen rather than assumed: the number of points and the share
   of length and width.

`learn_cluster_detector` learns it from the empty scenes of a recording of clouds."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import ClassVar, NamedTuple

import numpy as np

from toolkit.arrays import Float, Float64, Points, Rng
from toolkit.boxes import count_points, nms
from toolkit.calibration.place import Corners, Place, Stand, crop_points
from toolkit.calibration.recording_scenes import Scenes
from toolkit.datasets.dataset import CoopDataset
from toolkit.detection.background import EMPTY_SWEEPS, Background, empty_sweeps
from toolkit.frame import Frame
from toolkit.geometry import plane_rotation, transform
from toolkit.objects import CYCLIST, HEAVY, LABELS, PEDESTRIAN, VEHICLE, Detections
from toolkit.runtime.light_open3d import o3d

CAR_SIZE_M = np.array([4.4, 1.9])  # length and width to which a car seen in part is completed
MIN_CAR_HEIGHT_M = 1.3
MAX_CAR_LENGTH_M = 5.8  # a longer vehicle is heavy
MAX_CAR_WIDTH_M = 2.4  # a wider vehicle is heavy
MAX_CAR_HEIGHT_M = 2.5  # a taller vehicle is heavy
# length and width below which a cluster is a person, else a cyclist
MAX_PERSON_SIZE_M = (1.2, 1.0)
MAX_CYCLIST_SIZE_M = (2.3, 0.85)
MIN_SIDE_M = 0.2  # least length, width and height for a box
HALF_SCORE_POINTS = 30.0  # points that give half the score
MIN_WHOLE_LENGTH_M = 0.75 * CAR_SIZE_M[0]  # a longer car shows both ends and needs no completion
DOUBT_WEIGHT = 10.0  # weight of a cluster's points on a completed side, in points of free ground
REACH_TOLERANCE_SHARE = 1e-9  # so that cells exactly at the reach are neighbours despite rounding
SIDE_DEPTH_M = 0.2  # distance from a side of a rectangle within which points are on the side
# ends at which a car may grow, along the first and the second axis: True for the upper one
_GROWN_ENDS = np.array([[False, False], [False, True], [True, False], [True, True]])
MAX_CAR_IOU = 0.1  # IoU above which the worse of two cars is dropped


@dataclass(frozen=True)
class ClusterDetector:
    """Detector of all classes, learnt only from points of the empty site, world frame.

    Attributes:
        background: points of the empty site as voxels, and the height of its ground.
        cell: edge of the cells that are clustered (m).
        reach: distances (m), inclusive, up to which cells are neighbours in a cluster; the next one
            is tried while the cluster is too large for a car.
        fewest: minimum number of points in a cluster.
        area: xmin, ymin, xmax, ymax (m) to which points are cropped, below 4 m, None for no crop.
    """

    labels: ClassVar[tuple[str, ...]] = LABELS
    background: Background
    cell: float = 0.2
    reach: tuple[float, ...] = (0.9, 0.6, 0.4, 0.28)
    fewest: int = 5
    area: Corners | None = None

    @staticmethod
    def learn(background_points: Points | Iterable[Float[np.ndarray, "_ 3"]]) -> "ClusterDetector":
        """Learn from clouds (n, 3) of the empty site, world frame.

        They are cropped like the points to detect in. Several sweeps of the same sensors show their
        noise."""
        if isinstance(background_points, np.ndarray):
            clouds = [background_points]
        else:
            clouds = list(background_points)
        points = np.concatenate([np.zeros((0, 3), np.float32), *clouds])
        return ClusterDetector(Background.learn(points))

    @staticmethod
    def from_recording(recording: CoopDataset) -> "ClusterDetector":
        """Learn from four noisy sweeps of a recording's empty site."""
        return ClusterDetector.learn(empty_sweeps(recording))

    @property
    def digest(self) -> str:
        """SHA-256 of the empty site and the settings, followed by the area if there is one."""
        settings = repr((self.cell, self.reach, self.fewest)).encode()
        digest = self.background.digest_settings(settings)
        return digest if self.area is None else f"{digest} {self.area}"

    def __call__(self, points: Points) -> Detections:
        """Detect in points (m, world frame), ignoring points that are not finite."""
        points = points if self.area is None else crop_points(points, self.area)
        points = points[np.isfinite(points).all(axis=1)]
        is_background = self.background.holds(points)
        clusters = self._find_clusters(points[~is_background].astype(np.float64), self.reach)
        if not clusters:
            return Detections.empty()
        seen_rectangles = [_fit_rectangle(cluster[:, :2]) for cluster in clusters]
        ground = self.background.height(
            np.array([cluster[:, :2].mean(axis=0) for cluster in clusters])
        )
        # the highest hundredth of the points may be noise
        height = np.array([np.quantile(cluster[:, 2], 0.99) for cluster in clusters]) - ground
        length, width = np.array([rectangle.size for rectangle in seen_rectangles]).T
        is_heavy = (
            (length > MAX_CAR_LENGTH_M) | (width > MAX_CAR_WIDTH_M) | (height > MAX_CAR_HEIGHT_M)
        )
        person_length, person_width = MAX_PERSON_SIZE_M
        is_person = (length < person_length) & (width < person_width)
        cyclist_length, cyclist_width = MAX_CYCLIST_SIZE_M
        is_cyclist = (length < cyclist_length) & (width < cyclist_width)
        # the first mask that holds gives the class, a vehicle if none does
        labels = np.select([is_heavy, is_person, is_cyclist], [HEAVY, PEDESTRIAN, CYCLIST], VEHICLE)
        point_counts = np.array([len(cluster) for cluster in clusters])
        scores = point_counts / (point_counts + HALF_SCORE_POINTS)

        # indices of clusters
        cars = np.flatnonzero(labels == VEHICLE)
        non_cars = np.flatnonzero(labels != VEHICLE)
        seen_cars = [seen_rectangles[k] for k in cars]
        # share of length and width that was seen
        scores[cars] *= [np.prod(np.minimum(car.size / CAR_SIZE_M, 1)) for car in seen_cars]
        height[cars] = np.maximum(height[cars], MIN_CAR_HEIGHT_M)
        rectangles = list(seen_rectangles)
        whole_cars = _complete_cars(seen_cars, points[is_background])
        for k, whole_car in zip(cars.tolist(), whole_cars, strict=True):
            rectangles[k] = whole_car
        size = np.maximum(np.column_stack([[r.size for r in rectangles], height]), MIN_SIDE_M)
        centre = np.column_stack([[r.centre for r in rectangles], ground + size[:, 2] / 2])
        boxes = np.column_stack([centre, size, [r.yaw for r in rectangles]])
        rows = np.concatenate([cars[nms(boxes[cars], scores[cars], MAX_CAR_IOU)], non_cars])
        return Detections(boxes, scores, labels)[rows]

    def _find_clusters(
        self, points: Float64[np.ndarray, "n 3"], reach: tuple[float, ...]
    ) -> list[np.ndarray]:
        """Return the points (k, 3) of each cluster.

        Points are gathered in square cells seen from above. reach: distances (m), descending. Cells
        within the first are connected; the others split a cluster that is too large for a car.
        Clusters with too few points (below `fewest`) are left out."""
        if len(points) < self.fewest:
            return []
        xy = points[:, :2]
        column, row = ((xy - xy.min(axis=0)) / self.cell).astype(np.int64).T  # each point's cell
        # both indices in one number, the first above bit 32: quicker to sort than pairs
        keys, point_cells = np.unique(column << 32 | row, return_inverse=True)
        # whole numbers, for exact distances, and a third axis that Open3D needs
        cells = np.column_stack([keys >> 32, keys & 0xFFFFFFFF, np.zeros(len(keys))])
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cells))
        reach_cells = reach[0] / self.cell * (1 + REACH_TOLERANCE_SHARE)
        cell_clusters = np.asarray(cloud.cluster_dbscan(eps=reach_cells, min_points=1), np.int64)
        point_clusters = cell_clusters[point_cells]
        # points sorted by cluster, then cut between clusters
        order = np.argsort(point_clusters, kind="stable")
        groups = np.split(points[order], np.flatnonzero(np.diff(point_clusters[order])) + 1)
        clusters = []
        for group in groups:
            if len(reach) > 1 and _exceeds_car(group[:, :2]):
                clusters.extend(self._find_clusters(group, reach[1:]))
            elif len(group) >= self.fewest:
                clusters.append(group)
        return clusters


def _exceeds_car(xy: Float64[np.ndarray, "n 2"]) -> bool:
    """Return True if the rectangle around points (m) is longer or wider than a car."""
    # a quick test, so that no rectangle is fitted to small clusters
    if np.ptp(xy, axis=0).max() <= MAX_CAR_LENGTH_M / 2:
        return False
    return bool((_fit_rectangle(xy).size > [MAX_CAR_LENGTH_M, MAX_CAR_WIDTH_M]).any())


class _Rectangle(NamedTuple):
    """Rectangle seen from above, given by its ends along its two axes.

    Attributes:
        yaw: direction of the first axis, usually the longer (rad, counter-clockwise from +x); the
            second is a quarter turn further.
        low: lower ends (2,) along the axes (m, from the world's origin).
        high: upper ends (2,) along the axes (m, from the world's origin).
        at_low: share of points within 0.2 m of each lower side.
        at_high: share of points within 0.2 m of each upper side.
    """

    yaw: float
    low: np.ndarray
    high: np.ndarray
    at_low: np.ndarray
    at_high: np.ndarray

    @property
    def size(self) -> np.ndarray:
        """Length and width (m), along the first and the second axis."""
        return self.high - self.low

    @property
    def centre(self) -> np.ndarray:
        """Centre: x and y (m, world)."""
        along, across = (self.low + self.high) / 2
        cos = np.cos(self.yaw)
        sin = np.sin(self.yaw)
        return np.array([along * cos - across * sin, along * sin + across * cos])

    def turn(self) -> "_Rectangle":
        """Return the same rectangle with yaw a quarter turn further.

        The second axis becomes the first; the first, reversed, becomes the second."""
        # All are pairs, a number for each axis. Reversing an axis swaps its ends and changes their
        # signs.
        return _Rectangle(
            yaw=self.yaw + np.pi / 2,
            low=np.array([self.low[1], -self.high[0]]),
            high=np.array([self.high[1], -self.low[0]]),
            at_low=np.array([self.at_low[1], self.at_high[0]]),
            at_high=np.array([self.at_high[1], self.at_low[0]]),
        )


def _fit_rectangle(xy: Float64[np.ndarray, "n 2"]) -> _Rectangle:
    """Fit the rectangle whose sides are closest to points, with the longer axis first.

    xy: x and y (m) of the points. The yaw, in steps of 2°, maximises Σ 1 / distance to the nearest
    side, with distances of at least 0.1 m. The sides leave out 0.5 % of the points at each end."""
    x, y = xy[:: 1 + len(xy) // 150].T  # at most 150 points choose the yaw
    yaws = np.deg2rad(np.arange(0.0, 90.0, 2.0))
    # coordinates of each point in the axes of each yaw, (yaws, points)
    along = np.outer(np.cos(yaws), x) + np.outer(np.sin(yaws), y)
    across = np.outer(np.cos(yaws), y) - np.outer(np.sin(yaws), x)
    distance = np.minimum(_end_distance(along), _end_distance(across))
    closeness = (1 / np.maximum(distance, 0.1)).sum(axis=1)
    yaw = float(yaws[closeness.argmax()])
    aligned_points = xy @ plane_rotation(yaw)  # in the axes of the best yaw
    low, high = np.quantile(aligned_points, [0.005, 0.995], axis=0)
    # shares of the points near the lower and the upper side along both axes
    at_low = (aligned_points < low + SIDE_DEPTH_M).mean(axis=0)
    at_high = (aligned_points > high - SIDE_DEPTH_M).mean(axis=0)
    rectangle = _Rectangle(yaw, low=low, high=high, at_low=at_low, at_high=at_high)
    length, width = rectangle.size
    return rectangle if length >= width else rectangle.turn()


def _end_distance(values: np.ndarray) -> np.ndarray:
    """Distance of each value to the nearer of its row's minimum and maximum."""
    low = values.min(axis=1, keepdims=True)
    high = values.max(axis=1, keepdims=True)
    return np.minimum(values - low, high - values)


class _GrownCar(NamedTuple):
    """Car completed to the usual size in one of several ways.

    rectangle: the whole car; doubt: sum of the shares of points at the sides that have grown, at
    which the body seems to end."""

    rectangle: _Rectangle
    doubt: float


def _grow_car(seen_part: _Rectangle) -> list[_GrownCar]:
    """Ways to complete a car to the usual size, to either side along both axes.

    seen_part: rectangle of the part that was seen. A short one may also be the front or rear of a
    car, so that its axes swap."""
    length, _ = seen_part.size
    rectangles = [seen_part, seen_part.turn()] if length < MAX_CAR_WIDTH_M else [seen_part]
    min_size = [MIN_WHOLE_LENGTH_M, CAR_SIZE_M[1]]  # from which a car is seen whole along an axis
    grown_cars = []
    for rectangle in rectangles:
        missing_m = np.where(rectangle.size < min_size, CAR_SIZE_M - rectangle.size, 0.0)
        for at_high in _GROWN_ENDS:  # for each axis, True to grow at the upper end
            low = rectangle.low - missing_m * ~at_high
            high = rectangle.high + missing_m * at_high
            end_shares = np.where(at_high, rectangle.at_high, rectangle.at_low)
            # many points at an end that grows: the body seems to end there
            doubt = float(end_shares @ (missing_m > 0))
            grown_cars.append(_GrownCar(rectangle._replace(low=low, high=high), doubt))
    return grown_cars


def _complete_cars(cars: list[_Rectangle], background: Points) -> list[_Rectangle]:
    """Complete cars to the usual size, into space in which the fewest background points are.

    cars: rectangles of what was seen; background: points (m, world) of the empty site. Sides with
    many points rarely grow, as a body seems to end there."""
    options = list[_GrownCar]()
    starts = [0]  # index of each car's first option, and the number of all options
    for car in cars:
        options += _grow_car(car)
        starts.append(len(options))
    # boxes 15 cm narrower at each side and 100 m high, to count points in them from above
    boxes = []
    for rectangle, _ in options:
        length, width = np.maximum(rectangle.size - 0.3, 0.1)
        boxes.append((*rectangle.centre, 0.0, length, width, 100.0, rectangle.yaw))
    hidden_counts = count_points(background, np.array(boxes).reshape(-1, 7))
    cost = hidden_counts + DOUBT_WEIGHT * np.array([option.doubt for option in options])
    # the cheapest option of each car, the first of several
    best = [start + int(cost[start:end].argmin()) for start, end in pairwise(starts)]
    return [options[index].rectangle for index in best]


def learn_cluster_detector(scenes: Scenes, frame: Frame, place: Place = Place()) -> ClusterDetector:
    """Return a detector of all that differs from the empty scenes of lidars.

    scenes: empty scenes of the lidars, learnt from clouds; frame: has the poses of the lidars;
    place: area and ground of the later detection. Raises ValueError if the empty scenes have no
    point in the area."""
    rng = np.random.default_rng(0)
    sweeps = []
    centre = place.find_middle(frame)  # x and y (m, world) of the area's middle
    for _ in range(EMPTY_SWEEPS):
        clouds = [
            transform(cloud.world_SE3_sensor, draw_sweep(scenes, cloud.name, rng))
            for cloud in frame.clouds
        ]
        sweeps.append(np.concatenate([np.zeros((0, 3)), *clouds]))
    half_x, half_y = place.half
    method = place.level or "map"  # way to find the ground
    # grounds and areas count from the area's middle, as points on a lifted ground do
    ground = None if method == "none" else place.find_ground(sweeps[0] - [*centre, 0.0], method)
    area = (-half_x, -half_y, half_x, half_y)
    stand = Stand(area, middle=centre, ground=ground)
    detector = ClusterDetector.learn([crop_points(stand.lift(sweep), area) for sweep in sweeps])
    return replace(detector, area=area)


def draw_sweep(scenes: Scenes, name: str, rng: Rng) -> Float64[np.ndarray, "n 3"]:
    """Draw points (m, sensor frame) of one sweep of a sensor in its empty scene.

    scenes: empty scenes of the lidars; name: name of the sensor. Each pixel takes one of its two
    measurements, as often as it occurred, with normal noise of its spread. Pixels without a
    measurement give no point."""
    # one uniform, then one normal number for each pixel: this order fixes the results
    scene = scenes[name].scene
    model = scenes.grid(name).model
    takes_second = np.isfinite(scene.second) & (rng.random(scene.first.shape) > scene.share)
    median = np.where(takes_second, scene.second, scene.first).astype(np.float64)
    spread = np.where(takes_second, scene.second_spread, scene.spread)
    distance = median + spread * rng.standard_normal(median.shape)
    is_valid = (median > 0) & (distance > 0)
    return model.rays().astype(np.float64)[is_valid] * distance[is_valid][:, None]
