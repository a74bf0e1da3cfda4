"""Poses of a recording's sensors, by their empty scenes: against a reference, or against each
other."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from toolkit.arrays import Float64, Points
from toolkit.calibration import registration as reference_fit
from toolkit.calibration.alignment import MorePairs, align, face_sensor
from toolkit.calibration.empty_scene import SAMPLE, learn_empty_scenes
from toolkit.calibration.found_pose import FoundPose
from toolkit.calibration.object_pairs import detect_boxes, object_pairs
from toolkit.calibration.recording_scenes import (
    GRID_SAMPLES,
    MAX_STILL_SENSOR_M,
    learn_sample_scenes,
)
from toolkit.calibration.registration import Registration, Surface, scene_points
from toolkit.frame import Frames, select_sensors
from toolkit.objects import Detector
from toolkit.sensors.models import RowLidar
from toolkit.sensors.sensor import Sensor

LEAST_FRAMES = 5  # of an empty scene that sensors are registered by
LEAST_OVERLAP = 0.3  # fraction of a sensor's points that must have a counterpart
TOGETHER = "together"  # in place of a reference: sensors are fitted to each other
LEAST_SHARED = 50  # rows that a sensor must share with the others
OBJECT_FRAMES = 40  # searched for road users
_Seen = tuple[Points, Float64[np.ndarray, " n"] | None]  # points and their deviations (m)


def find_poses(
    recording: Frames,
    surface: Surface | None = None,
    *,
    held: Sequence[int | str] = (),
    detector: Detector | None = None,
    frames: int | None = None,
    sample: int = SAMPLE,
    progress: Callable[[int], None] | None = None,
) -> tuple[FoundPose, ...]:
    """Find the pose of every sensor of a recording in the first frame.

    It is found from the sensor's empty scene over the first `frames` frames, which a lidar known by
    its clouds learns from their range images; if frames are fewer than five, or it moves, from its
    points in the first frame with any.

    surface: what stands there; None to fit the sensors to each other. Then held: numbers or names
    of sensors that stay at their believed poses (without any, all move as little as they can, and
    their common pose stays), and detector: of road users in the cloud of one sensor, which say what
    the scene leaves open. sample: images kept of each sensor. progress: called with the number of
    sensors done.

    Raises ValueError for too few frames of images, clouds without points, fewer than two sensors
    without a surface, and unknown sensors."""
    count = min(len(recording), len(recording) if frames is None else frames)
    more = None
    if len(recording) and not recording[0].has_images:
        sensors, seen = _seen_in_clouds(recording, count)
        stay = select_sensors(sensors, held)
    else:
        if count < LEAST_FRAMES:
            problem = f"{count} frames are too few to tell what stands still from who passes"
            raise ValueError(f"{problem}: give {LEAST_FRAMES} or more")
        seen = [
            scene_points(scene) for scene in learn_empty_scenes(recording, sample, frames=count)
        ]
        sensors = recording[0].sensors
        stay = select_sensors(sensors, held)
        if detector is not None:
            numbers = np.unique(
                np.linspace(0, count - 1, min(OBJECT_FRAMES, count)).astype(int)
            ).tolist()
            site = getattr(recording, "site", None)
            if site is None:
                raise ValueError("a detector is for a recording of a known site: leave it out")
            more = partial(
                object_pairs, detect_boxes([recording[k] for k in numbers], detector, site)
            )
    if surface is None:
        return align_clouds([points for points, _ in seen], sensors, held=stay, more=more)
    found_poses: list[FoundPose] = []
    for (points, deviation), sensor in zip(seen, sensors, strict=True):
        found_poses.append(find_pose(points, sensor, surface, deviation=deviation))
        if progress is not None:
            progress(len(found_poses))
    return tuple(found_poses)


def find_pose(
    points: Points,
    sensor: Sensor,
    surface: Surface,
    *,
    deviation: Float64[np.ndarray, " n"] | None = None,
) -> FoundPose:
    """Find the pose of one sensor, near the believed one, from points in its own frame and their
    deviations (m)."""
    try:
        registration = reference_fit.register(points, surface, sensor.pose, deviation=deviation)
    except ValueError as error:
        return FoundPose(sensor, None, str(error))
    if registration.overlap >= LEAST_OVERLAP:
        return FoundPose(sensor, registration)
    few = f"only {registration.overlap:.0%} of its points have a counterpart in the reference"
    remedy = "is it of the same place, and does it show what this sensor sees?"
    return FoundPose(sensor, None, f"{few}, {LEAST_OVERLAP:.0%} are needed: {remedy}")


def align_clouds(
    clouds: list[np.ndarray],
    sensors: Sequence[Sensor],
    *,
    held: Sequence[int] = (),
    more: "MorePairs | None" = None,
) -> tuple[FoundPose, ...]:
    """Fit the poses of sensors to each other by clouds of the same standing scene, each in its
    sensor's frame. held: numbers of sensors that stay; more: see
    `toolkit.calibration.poses.align`."""
    surfaces = [face_sensor(reference_fit.cloud_surface(points)) for points in clouds]
    alignment = align(surfaces, [sensor.pose for sensor in sensors], held=held, more=more)
    found_poses = []
    for k, sensor in enumerate(sensors):
        shared = int(alignment.shared[k].sum())
        if shared < LEAST_SHARED and k not in held:
            problem = (
                f"it shares {shared} points with the other sensors, {LEAST_SHARED} are needed: "
                "give a reference"
            )
            found_poses.append(FoundPose(sensor, None, problem))
            continue
        of_sensor = slice(6 * k, 6 * k + 6)
        covariance = np.ascontiguousarray(alignment.covariance[of_sensor, of_sensor])
        overlap = min(1.0, shared / max(1, int(alignment.shared.max())))
        figures = covariance, alignment.hidden_motions(k), overlap, float(alignment.scatter[k])
        found_poses.append(FoundPose(sensor, Registration(alignment.poses[k], *figures)))
    return tuple(found_poses)


def _seen_in_clouds(recording: Frames, count: int) -> tuple[tuple[Sensor, ...], list[_Seen]]:
    """Sensors of clouds, and their points of the standing scene, each in its own frame."""
    first = [recording[k] for k in range(min(count, GRID_SAMPLES))]
    places = dict[str, np.ndarray]()
    moves = False
    for frame in first:
        for cloud in frame.clouds:
            position = (frame.map_SE3_world @ cloud.world_SE3_sensor)[:3, 3]
            moves |= bool(
                np.linalg.norm(position - places.setdefault(cloud.name, position))
                > MAX_STILL_SENSOR_M
            )
    if len(first) >= LEAST_FRAMES and not moves:
        learnt = learn_sample_scenes(recording[k] for k in range(count))
        points = {name: scene_points(first_frame.scene)[0] for name, first_frame in learnt.items()}
    else:
        points = dict[str, np.ndarray]()
        for frame in first:
            points = {cloud.name: cloud.in_sensor() for cloud in frame.clouds if len(cloud.points)}
            if points:
                break
        if not points:
            raise ValueError("no frame has a point to find a pose by")
    placed = {
        cloud.name: cloud.world_SE3_sensor for frame in reversed(first) for cloud in frame.clouds
    }
    return tuple(Sensor(name, RowLidar(), placed[name]) for name in points), [
        (sensor_points, None) for sensor_points in points.values()
    ]
