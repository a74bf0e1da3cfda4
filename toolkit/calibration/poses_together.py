"""Where the sensors of a recording are to each other, without a reference: see `toolkit.calibration.joint`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from toolkit.arrays import Float64
from toolkit.calibration.empty_scene import SAMPLE, learn_empty_scenes
from toolkit.calibration.joint import Alignment, Pairs, Poses, align, towards_sensor
from toolkit.calibration.joint_objects import SitedRecording, object_pairs, seen_objects
from toolkit.calibration.reference import cloud_surface, scene_points
from toolkit.calibration.registration import Registration
from toolkit.calibration.sensor_poses import FoundPose, check_frames_suffice
from toolkit.datasets.readings import read_frame
from toolkit.objects import Detector
from toolkit.points import select_sensors
from toolkit.sensors.errors.profile import ErrorProfile
from toolkit.sensors.errors.profiles import PAPER_ERRORS
from toolkit.sensors.sensor import Sensor

LEAST_SHARED = 50  # rows that a sensor must share with the others
OBJECT_FRAMES = 40  # in which road users are looked for


def find_poses_together(
    recording: SitedRecording,
    *,
    held: Sequence[int | str] = (),
    detector: Detector | None = None,
    frames: int | None = None,
    sample: int = SAMPLE,
    errors: ErrorProfile | str = PAPER_ERRORS,
    noise_seed: int | None = 0,
) -> tuple[FoundPose, ...]:
    """The pose of every sensor of a recording that fits what the others see of the same standing scene.

    held: numbers or names of sensors that stay where they are believed to be; without any, all move as little as they
    can, and their common pose stays; detector: of road users in the cloud of one sensor, which then say what the scene
    does not, in up to `OBJECT_FRAMES` frames. The other arguments are those of
    `toolkit.calibration.sensor_poses.find_poses`. Raises ValueError for too few frames, fewer than two sensors, and
    sensors that are not there.
    """
    count = check_frames_suffice(recording, frames)
    scenes = learn_empty_scenes(recording, frames=count, sample=sample, errors=errors, noise_seed=noise_seed)
    sensors = read_frame(recording, 0, errors=errors, noise_seed=noise_seed).sensors
    stay = select_sensors(sensors, held)
    more = None
    if detector is not None:
        chosen = np.unique(np.linspace(0, count - 1, min(OBJECT_FRAMES, count)).astype(int)).tolist()
        read = [read_frame(recording, k, errors=errors, noise_seed=noise_seed) for k in chosen]
        more = partial(object_pairs, seen_objects(recording, read, detector))
    return clouds_together([scene_points(scene)[0] for scene in scenes], sensors, held=stay, more=more)


def clouds_together(
    clouds: Sequence[Float64[np.ndarray, "_ 3"]],
    sensors: Sequence[Sensor],
    *,
    held: Sequence[int] = (),
    more: Callable[[Poses, float], Sequence[Pairs]] | None = None,
) -> tuple[FoundPose, ...]:
    """The same of sensors whose points of the standing scene are known, each in its own frame; held: numbers; more: see
    `toolkit.calibration.joint.align`."""
    surfaces = [towards_sensor(cloud_surface(points)) for points in clouds]
    alignment = align(surfaces, [sensor.pose for sensor in sensors], held=held, more=more)
    return tuple(_found(sensor, k, alignment, k in held) for k, sensor in enumerate(sensors))


def _found(sensor: Sensor, number: int, alignment: Alignment, stays: bool) -> FoundPose:
    shared = int(alignment.shared[number].sum())
    if shared < LEAST_SHARED and not stays:
        return FoundPose(
            sensor,
            None,
            f"it shares {shared} points with the other sensors, {LEAST_SHARED} are needed: give a reference",
        )
    own = slice(6 * number, 6 * number + 6)
    return FoundPose(
        sensor,
        Registration(
            alignment.poses[number],
            np.ascontiguousarray(alignment.covariance[own, own]),
            alignment.unobserved_of(number),
            min(1.0, shared / max(1, int(alignment.shared.max()))),
            float(alignment.scatter[number]),
        ),
    )
