"""Objects that stand out from empty scenes, in a recording of clouds without labels or training.

`foreground_clusters` gathers the points of a frame
that stand out into objects by DBSCAN (M. Ester and others, 1996), as implemented in Open3D. `learn_cluster_detector`
turns the empty scenes into a detector with boxes and classes (`toolkit.detection.cluster`), scored like any other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Float, Float64, Int64
from toolkit.calibration.empty_scene import SIGMAS
from toolkit.calibration.ground import level
from toolkit.calibration.scenes import Scenes
from toolkit.detection.cluster import ClusterDetector
from toolkit.detection.place import Place, crop_points, find_middle
from toolkit.frame import Frame
from toolkit.geometry import transform
from toolkit.objects import Detections

CLUSTER_REACH, FEWEST = 0.8, 5  # m between neighbours of one object; points of an object
SWEEPS = 4  # noisy sweeps of the empty scenes for learning a background


@dataclass(frozen=True, eq=False)
class Clusters:
    """Points that stand out, gathered into objects. points: world frame; sensor: number of the cloud of each; of:
    number of the object of each, -1 for none.
    """

    points: Float64[np.ndarray, "n 3"]
    sensor: Int64[np.ndarray, " n"]
    of: Int64[np.ndarray, " n"]

    def __len__(self) -> int:
        """Number of objects."""
        return int(self.of.max(initial=-1)) + 1

    def __getitem__(self, number: int) -> Float64[np.ndarray, "m 3"]:
        """Points of an object."""
        if not 0 <= number < len(self):
            raise IndexError(f"there are {len(self)} objects, got number {number}")
        return self.points[self.of == number]


@dataclass(frozen=True)
class AreaClusters:
    """Cluster detector in an area (xmin ymin xmax ymax, m, below 4 m) with a known empty scene."""

    clusters: ClusterDetector
    area: tuple[float, float, float, float]

    @property
    def labels(self) -> tuple[str, ...]:
        """Classes it knows."""
        return self.clusters.labels

    @property
    def digest(self) -> str:
        """Digest of all that its detections depend on."""
        return f"{self.clusters.digest} {self.area}"

    def __call__(self, points: Float[np.ndarray, "n 3"]) -> Detections:
        """Detect in the points of the area."""
        return self.clusters(crop_points(points, self.area))


def foreground_clusters(
    sample: Frame, scenes: Scenes, *, reach: float = CLUSTER_REACH, fewest: int = FEWEST, sigmas: float = SIGMAS
) -> Clusters:
    """Gather the points of all clouds of a frame that stand out from their empty scenes into objects.

    reach: distance (m) within which points are neighbours; fewest: neighbours, itself among them, from which on a point
    is inside an object; sigmas: spreads of the empty scene within which a measurement shows it. Raises ValueError for a
    reach that is not above 0, fewer than one point, and a sensor without a scene.
    """
    if not 0 < reach < np.inf or fewest < 1:
        raise ValueError(f"reach must be above 0 m and fewest at least 1, got {reach} and {fewest}")
    parts, sensors = [np.zeros((0, 3))], [np.zeros(0, np.int64)]
    for number, cloud in enumerate(sample.clouds):
        if not len(cloud.points):
            continue
        image, scene = scenes.image(cloud), scenes[cloud.name].scene
        out = ~scene.shows(image.measurement, sigmas).ravel()[image.cells] & image.inside
        parts.append(cloud.in_world()[out])
        sensors.append(np.full(int(out.sum()), number, np.int64))
    points = np.concatenate(parts)
    return Clusters(points, np.concatenate(sensors), cluster_points(points, reach=reach, fewest=fewest))


def cluster_points(
    points: Float64[np.ndarray, "n 3"], *, reach: float = CLUSTER_REACH, fewest: int = FEWEST
) -> Int64[np.ndarray, " n"]:
    """Object of each point by DBSCAN, numbered from 0, -1 for none.

    >>> cluster_points(np.array([[0.0, 0, 0], [0.1, 0, 0], [5, 0, 0], [9, 0, 0], [9, 0.1, 0]]), reach=0.5, fewest=2)
    array([ 0,  0, -1,  1,  1])
    """
    import open3d as o3d

    if not len(points):
        return np.zeros(0, np.int64)
    middle = points.mean(axis=0)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points - middle))
    return np.asarray(cloud.cluster_dbscan(eps=reach, min_points=fewest), np.int64)


def learn_cluster_detector(scenes: Scenes, frame: Frame, place: Place = Place(), *, seed: int = 0) -> AreaClusters:
    """Return a detector of what stands out from the empty scenes of lidars that stand as in a frame. place: the one it
    will detect in. Raises ValueError where the empty scenes have no point in the area.
    """
    centre = find_middle(frame) if place.middle is None else place.middle
    rng = np.random.default_rng(seed)
    sweeps = []
    for _ in range(SWEEPS):
        parts = [transform(cloud.world_SE3_sensor, _sweep(scenes, cloud.name, rng)) for cloud in frame.clouds]
        sweeps.append(np.concatenate([np.zeros((0, 3)), *parts]) - [*centre, 0.0])
    (x, y), method = place.half, place.level or "map"
    ground = None if method == "none" else level(sweeps[0], method=method)
    area = (-x, -y, x, y)
    upright = [(sweep if ground is None else ground.points(sweep)).astype(np.float32) for sweep in sweeps]
    return AreaClusters(ClusterDetector.learn([crop_points(points, area) for points in upright]), area)


def _sweep(scenes: Scenes, name: str, rng: np.random.Generator) -> Float64[np.ndarray, "n 3"]:
    """Draw a sweep of a sensor in its empty scene, in the sensor's own frame. Each pixel takes one of its two
    measurements, as often as it was met, with its spread.
    """
    scene, model = scenes[name].scene, scenes.grid(name).model
    other = np.isfinite(scene.second) & (rng.random(scene.first.shape) > scene.share)
    median = np.where(other, scene.second, scene.first).astype(np.float64)
    measured = median + np.where(other, scene.second_spread, scene.spread) * rng.standard_normal(median.shape)
    there = (median > 0) & (measured > 0)
    return model.rays().astype(np.float64)[there] * measured[there][:, None]
