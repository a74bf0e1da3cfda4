"""Where the sensors of a recording are to each other, without a reference: see `toolkit.calibration.joint`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from toolkit.calibration.empty_scene import SAMPLE, learn_empty_scenes
from toolkit.calibration.joint import Alignment, align, towards_sensor
from toolkit.calibration.reference import cloud_surface, scene_points
from toolkit.calibration.registration import Registration
from toolkit.calibration.sensor_poses import FoundPose, check_frames_suffice
from toolkit.datasets.readings import Readable, read_frame
from toolkit.points import select_sensors
from toolkit.sensors.errors.profile import ErrorProfile
from toolkit.sensors.errors.profiles import PAPER_ERRORS
from toolkit.sensors.sensor import Sensor

LEAST_SHARED = 50  # rows that a sensor must share with the others


def find_poses_together(
    recording: Readable,
    *,
    held: Sequence[int | str] = (),
    frames: int | None = None,
    sample: int = SAMPLE,
    errors: ErrorProfile | str = PAPER_ERRORS,
    noise_seed: int | None = 0,
) -> tuple[FoundPose, ...]:
    """The pose of every sensor of a recording that fits what the others see of the same standing scene.

    held: numbers or names of sensors that stay where they are believed to be; without any, all move as little as they
    can, and their common pose stays. The other arguments are those of `toolkit.calibration.sensor_poses.find_poses`.
    Raises ValueError for too few frames, fewer than two sensors, and sensors that are not there.
    """
    count = check_frames_suffice(recording, frames)
    scenes = learn_empty_scenes(recording, frames=count, sample=sample, errors=errors, noise_seed=noise_seed)
    sensors = read_frame(recording, 0, errors=errors, noise_seed=noise_seed).sensors
    stay = select_sensors(sensors, held)
    surfaces = [towards_sensor(cloud_surface(scene_points(scene)[0])) for scene in scenes]
    alignment = align(surfaces, [sensor.pose for sensor in sensors], held=stay)
    return tuple(_found(sensor, k, alignment, k in stay) for k, sensor in enumerate(sensors))


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
