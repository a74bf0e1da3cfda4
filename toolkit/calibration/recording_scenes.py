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
from toolkit.calibration.empty_scene import SAMPLE, EmptyScene, SceneLearner, learn_empty_scenes
from toolkit.calibration.lidar_grid import LidarGrid, find_grid
from toolkit.frame import Frame, Frames, SensorCloud
from toolkit.sensors.models import RowLidar
from toolkit.sensors.sensor import Sensor

GRID_SAMPLES = 8  # first frames, used to find the grids
MIN_SCENE_FRAMES = 5  # with fewer frames, standing road users are taken for the scene
MAX_STILL_SENSOR_M = 0.5  # m that a sensor may be off its first place in the map
_KEPT_PIXELS = 1 << 26  # of all images kept of one sensor


@dataclass(frozen=True, eq=False)
class LearntScene:
    """Empty scene of one sensor."""

    scene: EmptyScene
    grid: LidarGrid | None = None  # of the images of its clouds
    points: int = 0  # number of points of its clouds
    # those that its images do not show, by kind
    left_out: dict[str, int] = field(default_factory=dict)


@dataclass(eq=False)
class Scenes:
    """Empty scenes of a recording's sensors, all learnt when the first is asked for (`used`).

    given: scenes in place of those the recording shows, found by the sensors' names; sample: images
    kept of each sensor at most. Raises ValueError, when asked, for an unknown sensor, one that
    moves, and clouds that make no image; warns if frames of clouds are few."""

    recording: Frames
    given: Sequence[EmptyScene] | None = None
    sample: int = field(default=SAMPLE, kw_only=True)
    used: bool = field(default=False, init=False)

    def __call__(self, sensor: int) -> EmptyScene:
        """Empty scene of a sensor by number."""
        return self[self._names[sensor]].scene

    def __getitem__(self, name: str) -> LearntScene:
        """Scene and grid of the sensor of that name."""
        if name not in self.every:
            raise ValueError(
                f"there are empty scenes of {', '.join(self.every) or 'no sensor'}, none of {name}"
            )
        return self.every[name]

    def image(self, cloud: SensorCloud) -> CloudImage:
        """Return a cloud in the grid of its sensor."""
        return rasterize_cloud(cloud, self.grid(cloud.name))

    def grid(self, name: str) -> LidarGrid:
        """Grid of the clouds of a sensor. Raises ValueError if its scene was learnt from images of
        its own."""
        learnt = self[name]
        if learnt.grid is None:
            raise ValueError(
                f"the scene of {name!r} was learnt from images of {learnt.scene.model}, not from "
                "clouds"
            )
        return learnt.grid

    @property
    def digests(self) -> list[str]:
        """Digests of all scenes, none if unused."""
        return [learnt.scene.digest for learnt in self.every.values()] if self.used else []

    @cached_property
    def _names(self) -> tuple[str, ...]:
        return tuple(sensor.name for sensor in self.recording[0].sensors)

    @cached_property
    def every(self) -> dict[str, LearntScene]:
        """Scenes of all sensors, by name."""
        self.used = True
        if self.given is not None:
            grids = [
                LidarGrid(given_scene.model) if type(given_scene.model) is RowLidar else None
                for given_scene in self.given
            ]
            return {
                given_scene.name: LearntScene(given_scene, grid)
                for given_scene, grid in zip(self.given, grids, strict=True)
            }
        if not (len(self.recording) and self.recording[0].has_images):
            return learn_sample_scenes(
                (self.recording[k] for k in range(len(self.recording))), sample=self.sample
            )
        return {
            scene.name: LearntScene(scene)
            for scene in learn_empty_scenes(self.recording, self.sample)
        }


def learn_sample_scenes(
    samples: Iterable[Frame], *, sample: int = SAMPLE
) -> dict[str, LearntScene]:
    """Learn grid and empty scene of every sensor by name, of `sample` images at most. Raises
    ValueError as `Scenes`."""
    remaining = iter(samples)
    first = list(islice(remaining, GRID_SAMPLES))
    clouds: dict[str, list[SensorCloud]] = {}
    for cloud in (cloud for frame in first for cloud in frame.clouds if len(cloud.points)):
        clouds.setdefault(cloud.name, []).append(cloud)
    learners = {
        name: _CloudSceneLearner(name, find_grid(learner), sample)
        for name, learner in clouds.items()
    }
    count = 0
    for frame in chain(first, remaining):
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
        warnings.warn(
            f"{problem}: give {MIN_SCENE_FRAMES} or more, spread over minutes", stacklevel=2
        )
    pairs = learners.items()
    return {
        name: LearntScene(learner.learner.scene(), learner.grid, learner.points, learner.left_out)
        for name, learner in pairs
    }


class _CloudSceneLearner:
    def __init__(self, name: str, grid: LidarGrid, sample: int) -> None:
        self.grid = grid
        self.points = 0
        self.left_out = Counter[str]()
        self._place: Float64[np.ndarray, "3"] | None = None
        sample_limit = max(16, _KEPT_PIXELS // (grid.model.shape[0] * grid.model.shape[1]))
        self.learner = SceneLearner(
            Sensor(name, grid.model, np.eye(4)), max(2, min(sample, sample_limit))
        )

    def add(self, cloud: SensorCloud, map_SE3_sensor: Pose) -> None:
        position = map_SE3_sensor[:3, 3]
        self._place = position if self._place is None else self._place
        if (moved := np.linalg.norm(position - self._place)) > MAX_STILL_SENSOR_M:
            remedy = "only a sensor that stands still has an empty scene"
            raise ValueError(f"{cloud.name} moves, by {moved:.1f} m: {remedy}")
        image = rasterize_cloud(cloud, self.grid)
        self.left_out.update(image.left_out)
        self.points += len(cloud.points)
        self.learner.add(image.measurement)
