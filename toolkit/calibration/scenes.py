"""`RecordingScenes`: the empty scenes of a recording's sensors, learnt when the first of them is asked for."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain, islice

import numpy as np

from toolkit.arrays import Float64
from toolkit.calibration.empty_scene import SAMPLE, EmptyScene, SceneLearner, learn_empty_scenes
from toolkit.datasets.lidar_grid import CloudImage, LidarGrid, find_grid, image_of
from toolkit.datasets.readings import Readable
from toolkit.datasets.sample import Sample, SensorCloud
from toolkit.sensors.error_profiles import PAPER_ERRORS, ErrorProfile
from toolkit.sensors.sensor import Sensor


class RecordingScenes:
    """The empty scene of a sensor (index). given: in place of what the recording itself shows, in any order, found by
    the sensors' names; errors, noise_seed: of the sensors.

    Raises ValueError, when asked, where one of a sensor is missing.
    """

    def __init__(
        self,
        recording: Readable,
        given: Sequence[EmptyScene] | None = None,
        *,
        errors: ErrorProfile | str = PAPER_ERRORS,
        noise_seed: int | None = 0,
    ) -> None:
        self._recording, self._given, self._errors, self._noise_seed = recording, given, errors, noise_seed
        self.used = False

    def __call__(self, sensor: int) -> EmptyScene:
        """Of the sensor with this index."""
        self.used = True
        return self._scenes[sensor]

    @property
    def digests(self) -> list[str]:
        """Of the scenes of all sensors, for results to say; none where nobody asked for a scene."""
        return [scene.digest for scene in self._scenes] if self.used else []

    @cached_property
    def _scenes(self) -> tuple[EmptyScene, ...]:
        if self._given is None:
            return learn_empty_scenes(self._recording, errors=self._errors, noise_seed=self._noise_seed)
        by_name = {scene.name: scene for scene in self._given}
        sensors = self._recording[0].sensors
        missing = [sensor.name for sensor in sensors if sensor.name not in by_name]
        if missing:
            raise ValueError(
                f"there are empty scenes of {', '.join(by_name)}, none of {', '.join(missing)}: learn them"
            )
        return tuple(by_name[sensor.name] for sensor in sensors)


GRID_SAMPLES = 8  # first samples, that the grids are found in
FEW_SAMPLES = 5  # below which who stands still is taken for the scene
STANDS_STILL = 0.5  # m that a sensor may be off its first place in the map
_KEPT_PIXELS = 1 << 26  # of all images kept of one sensor


@dataclass(frozen=True, eq=False)
class LearntScene:
    """The grid and the empty scene of one sensor. points: how many its clouds had; left_out: those of them that its
    images do not show, by kind."""

    grid: LidarGrid
    scene: EmptyScene
    points: int = 0
    left_out: dict[str, int] = field(default_factory=dict)


class SampleScenes:
    """Grid and empty scene of the sensors of a recording, by their names, learnt when the first is asked for.

    opened: gives the recording's samples, once for learning; given: empty scenes in place of those it shows. Raises
    ValueError, when asked, for a sensor that is not there, one that does not stand still, and clouds that are no image;
    warns where samples are few.
    """

    def __init__(
        self, opened: Callable[[], Iterable[Sample]], given: Sequence[EmptyScene] | None = None, *, sample: int = SAMPLE
    ) -> None:
        self._opened, self._given, self._sample = opened, given, sample

    def __getitem__(self, name: str) -> LearntScene:
        """Of the sensor of that name."""
        if name not in self.every:
            raise ValueError(f"there are empty scenes of {', '.join(self.every) or 'no sensor'}, none of {name}")
        return self.every[name]

    def image(self, cloud: SensorCloud) -> CloudImage:
        """A cloud in the grid of its sensor."""
        return image_of(cloud, self[cloud.name].grid)

    @cached_property
    def every(self) -> dict[str, LearntScene]:
        """Of all sensors."""
        if self._given is not None:
            return {scene.name: LearntScene(_grid_of(scene), scene) for scene in self._given}
        return learn_sample_scenes(self._opened(), sample=self._sample)


def learn_sample_scenes(samples: Iterable[Sample], *, sample: int = SAMPLE) -> dict[str, LearntScene]:
    """The grid and the empty scene of every sensor, by name, from samples that come one after another, in memory that
    does not grow; sample: images that are kept of each at most. Raises ValueError as `SampleScenes`."""
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


def _measured(sample: Sample) -> Iterator[SensorCloud]:
    return (cloud for cloud in sample.clouds if len(cloud.points))


def _by_sensor(samples: Sequence[Sample]) -> dict[str, list[SensorCloud]]:
    clouds: dict[str, list[SensorCloud]] = {}
    for each in samples:
        for cloud in _measured(each):
            clouds.setdefault(cloud.name, []).append(cloud)
    return clouds


def _grid_of(scene: EmptyScene) -> LidarGrid:
    from toolkit.sensors.models import RowLidar

    if type(scene.model) is not RowLidar:
        raise ValueError(f"the empty scene of {scene.name!r} was learnt from images of {scene.model}, not from clouds")
    return LidarGrid(scene.model)


class _Learner:
    """Learns one sensor's scene and counts what its images do not show."""

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
        image = image_of(cloud, self.grid)
        for kind, number in image.left_out.items():
            self.left_out[kind] = self.left_out.get(kind, 0) + number
        self.points += len(cloud.points)
        self._scene.add(image.measurement)

    def learnt(self) -> LearntScene:
        """What is known."""
        return LearntScene(self.grid, self._scene.scene(), self.points, self.left_out)
