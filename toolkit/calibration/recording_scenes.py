"""Empty scenes of a recording's sensors, learnt on demand.

Clouds of a sensor become images of one grid first (`toolkit.calibration.lidar_grid`). Sensors must
not move."""

import warnings
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain, islice

import numpy as np

from toolkit.arrays import Float64, Pose
from toolkit.calibration.cloud_image import CloudImage, rasterize_cloud
from toolkit.calibration.empty_scene import (
    MAX_SCENE_IMAGES,
    EmptyScene,
    SceneLearner,
    learn_empty_scenes,
)
from toolkit.calibration.lidar_grid import LidarGrid, find_grid
from toolkit.frame import Frame, Frames, SensorCloud
from toolkit.sensors.models import RowLidar
from toolkit.sensors.sensor import Sensor

GRID_FRAMES = 8  # first frames, used to find the grids
MIN_SCENE_FRAMES = 5  # with fewer frames, standing road users are taken for the scene
MAX_STILL_SENSOR_M = 0.5  # largest distance of a sensor that stands still from its first place
_MAX_KEPT_PX = 1 << 26  # pixels in all kept images of one sensor: 256 MiB


@dataclass(frozen=True, eq=False)
class LearntScene:
    """Empty scene of one sensor, and how its clouds became images.

    Attributes:
        scene: the empty scene.
        grid: rows and columns of the sensor's clouds, None if the scene was learnt from images.
        points: number of points of all clouds, 0 for images.
        left_out: number of points that the images of the clouds lack, by the words for the
            reason."""

    scene: EmptyScene
    grid: LidarGrid | None = None
    points: int = 0
    left_out: dict[str, int] = field(default_factory=dict)


@dataclass(eq=False)
class Scenes:
    """Empty scenes of a recording's sensors, all learnt when the first is needed.

    Looking up a scene raises ValueError for an unknown sensor, one that moves, and clouds that make
    no image; it warns if frames of clouds are few.

    Attributes:
        recording: frames to learn from; sensors must not move.
        given: scenes by name of their sensors, in place of the scenes that the recording shows.
        sample: maximum number of images kept of each sensor.
        used: True once scenes were learnt.
    """

    recording: Frames
    given: Sequence[EmptyScene] | None = None
    sample: int = field(default=MAX_SCENE_IMAGES, kw_only=True)
    used: bool = field(default=False, init=False)

    def __call__(self, sensor: int) -> EmptyScene:
        """Return the empty scene of a sensor by its number in the first frame."""
        return self[self._names[sensor]].scene

    def __getitem__(self, name: str) -> LearntScene:
        """Scene and grid of a sensor by name."""
        if name not in self.every:
            raise ValueError(
                f"there are empty scenes of {', '.join(self.every) or 'no sensor'}, none of {name}"
            )
        return self.every[name]

    def image(self, cloud: SensorCloud) -> CloudImage:
        """Return a cloud as an image in the grid of its sensor."""
        return rasterize_cloud(cloud, self.grid(cloud.name))

    def grid(self, name: str) -> LidarGrid:
        """Grid of a sensor's clouds. Raises ValueError if its scene was learnt from images."""
        learnt = self[name]
        if learnt.grid is None:
            raise ValueError(
                f"the scene of {name!r} was learnt from images of {learnt.scene.model}, not from "
                "clouds"
            )
        return learnt.grid

    @property
    def digests(self) -> list[str]:
        """SHA-256 digests of all scenes, an empty list if no scene was looked up."""
        return [learnt.scene.digest for learnt in self.every.values()] if self.used else []

    @cached_property
    def _names(self) -> tuple[str, ...]:
        # names of the first frame's sensors, by number
        return tuple(sensor.name for sensor in self.recording[0].sensors)

    @cached_property
    def every(self) -> dict[str, LearntScene]:
        """Scenes of all sensors, by name, learnt on the first call unless they were given.

        A recording without images is learnt from its clouds."""
        self.used = True
        if self.given is not None:
            return {scene.name: _wrap_scene(scene) for scene in self.given}
        # a recording without frames takes this way too, which raises a ValueError
        if not (len(self.recording) and self.recording[0].has_images):
            frames = (self.recording[k] for k in range(len(self.recording)))
            return learn_sample_scenes(frames, sample=self.sample)
        scenes = learn_empty_scenes(self.recording, self.sample)
        return {scene.name: LearntScene(scene) for scene in scenes}


def _wrap_scene(scene: EmptyScene) -> LearntScene:
    """Return a given scene, with a grid if its model is of a lidar's clouds."""
    grid = LidarGrid(scene.model) if type(scene.model) is RowLidar else None
    return LearntScene(scene, grid)


def learn_sample_scenes(
    samples: Iterable[Frame], *, sample: int = MAX_SCENE_IMAGES
) -> dict[str, LearntScene]:
    """Learn the grid and the empty scene of every sensor with clouds, by name of the sensor.

    samples: frames of clouds, read once, in order; sample: largest number of images kept of each
    sensor. The first `GRID_FRAMES` frames give the grids, and sensors without points in them are
    left out. Warns if frames are few. Raises ValueError for a sensor that moves, clouds that make
    no grid, and frames without points."""
    remaining = iter(samples)
    first_frames = list(islice(remaining, GRID_FRAMES))
    clouds: dict[str, list[SensorCloud]] = {}
    for frame in first_frames:
        for cloud in frame.clouds:
            if len(cloud.points):
                clouds.setdefault(cloud.name, []).append(cloud)
    learners = {
        name: CloudSceneLearner(name, find_grid(first_clouds), sample)
        for name, first_clouds in clouds.items()
    }
    count = 0
    for frame in chain(first_frames, remaining):
        count += 1
        for cloud in frame.clouds:
            if len(cloud.points) and cloud.name in learners:
                learners[cloud.name].add(cloud, frame.map_SE3_world @ cloud.world_SE3_sensor)
    if not learners:
        raise ValueError("no cloud has a point: there is no empty scene to learn")
    if count < MIN_SCENE_FRAMES:
        problem = (
            f"empty scenes are learnt from {count} samples, so who stands still in them is part "
            "of the scene"
        )
        remedy = f"give {MIN_SCENE_FRAMES} or more, spread over minutes"
        warnings.warn(f"{problem}: {remedy}", stacklevel=2)
    return {name: learner.finish() for name, learner in learners.items()}


class CloudSceneLearner:
    """Learner of the empty scene of one sensor from its clouds.

    Attributes:
        grid: rows and columns of the images that clouds become.
        points: number of points of all clouds so far.
        left_out: number of points that the images lack, by the words for the reason.
        learner: learner that the images are passed to."""

    def __init__(self, name: str, grid: LidarGrid, sample: int) -> None:
        """Begin without clouds. name: the sensor's; sample: largest number of clouds to keep."""
        self.grid = grid
        self.points = 0
        self.left_out = Counter[str]()
        self._first_position: Float64[np.ndarray, "3"] | None = None  # x, y, z (m) in the map
        # fewer images than `sample` if they are large, to limit memory, but at least 16
        rows, columns = grid.model.shape
        max_images = max(16, _MAX_KEPT_PX // (rows * columns))
        sensor = Sensor(name, grid.model, np.eye(4))  # its pose is not used
        self.learner = SceneLearner(sensor, sample=max(2, min(sample, max_images)))

    def add(self, cloud: SensorCloud, map_SE3_sensor: Pose) -> None:
        """Add the next cloud.

        map_SE3_sensor: pose of the sensor at that time. Raises ValueError if it has moved by more
        than `MAX_STILL_SENSOR_M` from the first one."""
        position = map_SE3_sensor[:3, 3]
        if self._first_position is None:
            self._first_position = position
        distance = np.linalg.norm(position - self._first_position)
        if distance > MAX_STILL_SENSOR_M:
            remedy = "only a sensor that stands still has an empty scene"
            raise ValueError(f"{cloud.name} moves, by {distance:.1f} m: {remedy}")
        image = rasterize_cloud(cloud, self.grid)
        self.left_out.update(image.left_out)
        self.points += len(cloud.points)
        self.learner.add(image.measurement)

    def finish(self) -> LearntScene:
        """Return the scene learnt so far, with its grid and the counts of points."""
        scene = self.learner.scene()
        return LearntScene(scene, self.grid, points=self.points, left_out=self.left_out)
