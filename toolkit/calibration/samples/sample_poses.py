"""Where the lidars of a recording of clouds really are: registered against a reference, or against each other.

Each lidar is known by its empty scene, learnt from the whole recording, as those of simulated recordings are; where
samples are fewer than five, or the lidars move, as on a vehicle, by the first sample alone, in which all measured at
about the same time. What is found is a correction in the sensor's own frame, the same in all samples.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from toolkit.arrays import Float64
from toolkit.calibration.poses_together import scenes_together
from toolkit.calibration.registration import Surface
from toolkit.calibration.samples.sample_scenes import GRID_SAMPLES, STANDS_STILL, LearntScene, learn_sample_scenes
from toolkit.calibration.sensor_poses import LEAST_FRAMES, FoundPose, find_pose
from toolkit.datasets.sample import Sample
from toolkit.geometry import invert
from toolkit.points import select_sensors
from toolkit.sensors.sensor import Sensor


def find_sample_poses(
    opened: Callable[[], Iterable[Sample]], surface: Surface | None = None, *, held: Sequence[int | str] = ()
) -> tuple[FoundPose, ...]:
    """The pose of every lidar of a recording in the first sample that has it.

    opened: gives the samples, twice; surface: what stands there, None to fit the lidars to each other, then held:
    numbers or names of those that stay. Raises ValueError where no cloud has points, and, without a surface, for fewer
    than two lidars and held ones that are not there.
    """
    first = list(islice(opened(), GRID_SAMPLES))
    learnt = learn_sample_scenes(opened()) if _still(first) else _of_one(first)
    placed = {cloud.name: cloud.world_SE3_sensor for sample in reversed(first) for cloud in sample.clouds}
    sensors = tuple(Sensor(name, each.grid.model, placed[name]) for name, each in learnt.items())
    scenes = [each.scene for each in learnt.values()]
    if surface is not None:
        return tuple(find_pose(scene, sensor, surface) for scene, sensor in zip(scenes, sensors, strict=True))
    return scenes_together(scenes, sensors, held=select_sensors(sensors, held))


def corrections(found: Iterable[FoundPose]) -> dict[str, Float64[np.ndarray, "4 4"]]:
    """believed_SE3_found of each sensor, by name: what its believed pose is multiplied with."""
    return {each.sensor.name: invert(each.sensor.pose) @ each.pose for each in found}


def with_corrections(
    samples: Iterable[Sample], corrected: Mapping[str, Float64[np.ndarray, "4 4"]]
) -> Iterator[Sample]:
    """The samples with their sensors where they were found to be; labels stay."""
    for sample in samples:
        clouds = tuple(
            replace(own := cloud.in_own_frame(), world_SE3_sensor=own.world_SE3_sensor @ corrected[cloud.name])
            if cloud.name in corrected
            else cloud
            for cloud in sample.clouds
        )
        yield replace(sample, clouds=clouds)


def _still(samples: Sequence[Sample]) -> bool:
    """Whether there are enough samples, and no sensor moves in the map."""
    places: dict[str, np.ndarray] = {}
    for sample in samples:
        for cloud in sample.clouds:
            place = (sample.map_SE3_world @ cloud.world_SE3_sensor)[:3, 3]
            if np.linalg.norm(place - places.setdefault(cloud.name, place)) > STANDS_STILL:
                return False
    return len(samples) >= LEAST_FRAMES


def _of_one(samples: Sequence[Sample]) -> dict[str, LearntScene]:
    sample = next((each for each in samples if any(len(cloud.points) for cloud in each.clouds)), None)
    if sample is None:
        raise ValueError("no sample has a point to find a pose by")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that one sample does not tell who stands still
        return learn_sample_scenes([sample])
