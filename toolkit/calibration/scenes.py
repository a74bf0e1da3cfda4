"""Empty scenes of a recording's sensors, learnt on demand.

`Scenes` learns all of them when the first is asked for. Images teach a scene as they are
(`toolkit.calibration.empty_scene`). Clouds of a sensor become images of one grid first (`toolkit.datasets.lidar_grid`).
Sensors must stand still. Road users that pass or park for a while do not disturb; anything that never moves is part of
the scene.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain, islice

import numpy as np

from toolkit.arrays import Float64
from toolkit.calibration.empty_scene import SAMPLE, EmptyScene, SceneLearner, learn_empty_scenes
from toolkit.datasets.lidar_grid import CloudImage, LidarGrid, find_grid, rasterize_cloud
from toolkit.frame import Frame, Frames, SensorCloud
from toolkit.sensors.sensor import Sensor

GRID_SAMPLES = 8  # first frames, used to find the grids
FEW_SAMPLES = 5  # with fewer frames, standing road users are taken for the scene
STANDS_STILL = 0.5  # m that a sensor may be off its first place in the map
_KEPT_PIXELS = 1 << 26  # of all images kept of one sensor


@dataclass(frozen=True, eq=False)
class LearntScene:
    """Empty scene of one sensor.

    grid: of the images of its clouds, None if it measures images; points: number of points of its clouds; left_out:
    those that its images do not show, by kind.
    """

    scene: EmptyScene
    grid: LidarGrid | None = None
    points: int = 0
    left_out: dict[str, int] = field(default_factory=dict)


@dataclass(eq=False)
class Scenes:
    """Empty scenes of the sensors of a recording.

    They are learnt when the first is asked for (`used`); `scenes(k)` is that of sensor k.

    given: scenes in place of those the recording shows, in any order, found by the sensors' names; sample: images kept
    of each sensor at most. Raises ValueError, when asked, for an unknown sensor, one that moves, and clouds that make
    no image; warns if frames of clouds are few.
    """

    recording: Frames
    given: Sequence[EmptyScene] | None = None
    sample: int = field(default=SAMPLE, kw_only=True)
    used: bool = field(default=False, init=False)

    def __call__(self, sensor: int) -> EmptyScene:
        """Empty scene of the sensor with this number. The number is that in the first frame."""
        return self[self._names[sensor]].scene

    def __getitem__(self, name: str) -> LearntScene:
        """Scene and grid of the sensor of that name."""
        if name not in self.every:
            raise ValueError(f"there are empty scenes of {', '.join(self.every) or 'no sensor'}, none of {name}")
        return self.every[name]

    def image(self, cloud: SensorCloud) -> CloudImage:
        """Return a cloud in the grid of its sensor."""
        return rasterize_cloud(cloud, self.grid(cloud.name))

    def grid(self, name: str) -> LidarGrid:
        """Grid of the clouds of a sensor. Raises ValueError if its scene was learnt from images of its own."""
        learnt = self[name]
        if learnt.grid is None:
            raise ValueError(
                f"the empty scene of {name!r} was learnt from images of {learnt.scene.model}, not from clouds"
            )
        return learnt.grid

    @property
    def digests(self) -> list[str]:
        """Digests of all scenes, for results. Empty if nobody asked for a scene."""
        return [learnt.scene.digest for learnt in self.every.values()] if self.used else []

    @cached_property
    def _names(self) -> tuple[str, ...]:
        return tuple(sensor.name for sensor in self.recording[0].sensors)

    @cached_property
    def every(self) -> dict[str, LearntScene]:
        """Scenes of all sensors, by name."""
        self.used = True
        if self.given is not None:
            return {scene.name: LearntScene(scene, _grid_of(scene)) for scene in self.given}
        if not (len(self.recording) and self.recording[0].has_images):
            return learn_sample_scenes((self.recording[k] for k in range(len(self.recording))), sample=self.sample)
        return {scene.name: LearntScene(scene) for scene in learn_empty_scenes(self.recording, self.sample)}


def learn_sample_scenes(samples: Iterable[Frame], *, sample: int = SAMPLE) -> dict[str, LearntScene]:
    """Learn the grid and empty scene of every sensor.

    They are returned by sensor name. Frames come one after another, and memory does not grow. sample: images that are
    kept of each at most. Raises ValueError as `Scenes`.
    """
    coming = iter(samples)
    first = list(islice(coming, GRID_SAMPLES))
    grids: dict[str, LidarGrid] = {}
    for name, clouds in _by_sensor(first).items():
        grids[name] = find_grid(clouds)
    learners = {name: _Learner(name, grid, sample) for name, grid in grids.items()}
    count = 0
    for each in chain(first, coming):
        count += 1
        for cloud in _measured(each):
            if cloud.name in learners:
                learners[cloud.name].add(cloud, each.map_SE3_world @ cloud.world_SE3_sensor)
    if not learners:
        raise ValueError("no cloud has a point: there is no empty scene to learn")
    if count < FEW_SAMPLES:
        warnings.warn(
            f"empty scenes are learnt from {count} samples, so who stands still in them is part of the scene: give "
            f"{FEW_SAMPLES} or more, spread over minutes",
            stacklevel=2,
        )
    return {name: learner.learnt() for name, learner in learners.items()}


def _measured(sample: Frame) -> Iterator[SensorCloud]:
    return (cloud for cloud in sample.clouds if len(cloud.points))


def _by_sensor(samples: Sequence[Frame]) -> dict[str, list[SensorCloud]]:
    clouds: dict[str, list[SensorCloud]] = {}
    for each in samples:
        for cloud in _measured(each):
            clouds.setdefault(cloud.name, []).append(cloud)
    return clouds


def _grid_of(scene: EmptyScene) -> LidarGrid | None:
    from toolkit.sensors.models import RowLidar

    return LidarGrid(scene.model) if type(scene.model) is RowLidar else None


class _Learner:
    """Learner of one sensor's scene. It counts what its images do not show."""

    def __init__(self, name: str, grid: LidarGrid, sample: int) -> None:
        self.grid, self.points, self.left_out = grid, 0, dict[str, int]()
        self._place: Float64[np.ndarray, "3"] | None = None
        kept = max(16, _KEPT_PIXELS // (grid.model.shape[0] * grid.model.shape[1]))
        self._scene = SceneLearner(Sensor(name, grid.model, np.eye(4)), max(2, min(sample, kept)))

    def add(self, cloud: SensorCloud, map_SE3_sensor: Float64[np.ndarray, "4 4"]) -> None:
        """One more cloud."""
        place = map_SE3_sensor[:3, 3]
        self._place = place if self._place is None else self._place
        if np.linalg.norm(place - self._place) > STANDS_STILL:
            raise ValueError(
                f"{cloud.name} moves, by {np.linalg.norm(place - self._place):.1f} m: only a sensor that stands still "
                "has an empty scene"
            )
        image = rasterize_cloud(cloud, self.grid)
        for kind, number in image.left_out.items():
            self.left_out[kind] = self.left_out.get(kind, 0) + number
        self.points += len(cloud.points)
        self._scene.add(image.measurement)

    def learnt(self) -> LearntScene:
        """Return what was learnt."""
        return LearntScene(self._scene.scene(), self.grid, self.points, self.left_out)
