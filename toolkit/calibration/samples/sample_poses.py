"""Where the lidars of a recording of clouds really are: registered against a reference, or against each other.

Each lidar is known by its empty scene, learnt from the whole recording, as those of simulated recordings are; where
samples are fewer than five, or the lidars move, as on a vehicle, by its points in the first sample, where all measured
at about the same time. What is found is a correction in the sensor's own frame, the same in all samples.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from toolkit.arrays import Float64
from toolkit.calibration.poses_together import clouds_together
from toolkit.calibration.reference import scene_points
from toolkit.calibration.registration import Surface
from toolkit.calibration.samples.sample_scenes import GRID_SAMPLES, STANDS_STILL, LearntScene, learn_sample_scenes
from toolkit.calibration.sensor_poses import LEAST_FRAMES, FoundPose, find_pose_of_points
from toolkit.datasets.sample import Sample
from toolkit.geometry import invert
from toolkit.points import select_sensors
from toolkit.sensors.row_lidar import RowLidar
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
    points = _standing(learn_sample_scenes(opened())) if _still(first) else _of_one(first)
    placed = {cloud.name: cloud.world_SE3_sensor for sample in reversed(first) for cloud in sample.clouds}
    sensors = tuple(Sensor(name, RowLidar(), placed[name]) for name in points)
    if surface is not None:
        every = zip(points.values(), sensors, strict=True)
        return tuple(find_pose_of_points(own, sensor, surface) for own, sensor in every)
    return clouds_together(list(points.values()), sensors, held=select_sensors(sensors, held))


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


def _standing(learnt: Mapping[str, LearntScene]) -> dict[str, Float64[np.ndarray, "_ 3"]]:
    return {name: scene_points(each.scene)[0] for name, each in learnt.items()}


def _of_one(samples: Sequence[Sample]) -> dict[str, Float64[np.ndarray, "_ 3"]]:
    """The points of each lidar in the first sample that has any, own frame."""
    for sample in samples:
        points = {cloud.name: cloud.in_sensor() for cloud in sample.clouds if len(cloud.points)}
        if points:
            return points
    raise ValueError("no sample has a point to find a pose by")
