"""Poses of a recording's sensors, by their empty scenes: against a reference, or against each
other."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64, Points
from toolkit.calibration.alignment import MorePairs, align, face_sensor
from toolkit.calibration.empty_scene import MAX_SCENE_IMAGES, learn_empty_scenes
from toolkit.calibration.found_pose import FoundPose
from toolkit.calibration.object_pairs import detect_boxes, object_pairs
from toolkit.calibration.recording_scenes import (
    GRID_FRAMES,
    MAX_STILL_SENSOR_M,
    learn_sample_scenes,
)
from toolkit.calibration.reference_surface import Surface, cloud_surface, scene_points
from toolkit.calibration.registration import Registration, register
from toolkit.frame import Frame, Frames, select_sensors
from toolkit.objects import Detector
from toolkit.sensors.models import RowLidar
from toolkit.sensors.sensor import Sensor

MIN_FRAMES = 5  # least number of frames for an empty scene to register a sensor by
MIN_OVERLAP_SHARE = 0.3  # fraction of a sensor's points that must have a counterpart
TOGETHER = "together"  # in place of a reference: sensors are fitted to each other
MIN_SHARED_ROWS = 50  # rows that a sensor must share with the others
OBJECT_FRAMES = 40  # largest number of frames in which road users are detected


class _StandingPoints(NamedTuple):
    """Points of the standing scene that one sensor sees.

    Attributes:
        points: points (m), sensor frame.
        deviation: standard deviation of each point (m), None if unknown."""

    points: Points
    deviation: Float64[np.ndarray, " n"] | None


def find_poses(
    recording: Frames,
    surface: Surface | None = None,
    *,
    held: Sequence[int | str] = (),
    detector: Detector | None = None,
    frames: int | None = None,
    sample: int = MAX_SCENE_IMAGES,
    progress: Callable[[int], None] | None = None,
) -> tuple[FoundPose, ...]:
    """Find the pose of every sensor of a recording in the first frame.

    It is found from the sensor's empty scene over the first `frames` frames. The scene of a lidar
    known by its clouds is learnt from their range images; if frames are fewer than five, or the
    lidar moves, its points in the first frame with any are used.

    surface: the standing surfaces; None to fit the sensors to each other. held: numbers or names of
    sensors that stay at their believed poses; without any, all move as little as they can, and
    their common pose stays. detector: finds road users in the cloud of one sensor, which determine
    what the scene leaves open. sample: images kept of each sensor. progress: called with the
    number of sensors done. held and detector are for sensors that are fitted to each other.

    Raises ValueError for too few frames of images, clouds without points, fewer than two sensors
    without a surface, and unknown sensors."""
    count = min(len(recording), len(recording) if frames is None else frames)
    more = None
    if len(recording) and not recording[0].has_images:
        sensors, standing_points = _find_in_clouds(recording, count)
        stay = select_sensors(sensors, held)
    else:
        _check_frames(count)
        sensors = recording[0].sensors
        if surface is None:
            _check_several(sensors)
        standing_points = _find_in_images(recording, count, sample)
        stay = select_sensors(sensors, held)
        if detector is not None:
            more = _pair_objects(recording, count, detector)
    if surface is None:
        return align_clouds(
            [scene.points for scene in standing_points], sensors, held=stay, more=more
        )
    found_poses: list[FoundPose] = []
    for scene, sensor in zip(standing_points, sensors, strict=True):
        found_poses.append(find_pose(scene.points, sensor, surface, deviation=scene.deviation))
        if progress is not None:
            progress(len(found_poses))
    return tuple(found_poses)


def _check_frames(count: int) -> None:
    """Raise ValueError if `count` frames are too few to learn empty scenes from."""
    if count < MIN_FRAMES:
        problem = f"{count} frames are too few to tell what stands still from who passes"
        raise ValueError(f"{problem}: give {MIN_FRAMES} or more")


def _check_several(sensors: Sequence[Sensor]) -> None:
    """Raise ValueError for fewer than two sensors, which cannot be fitted to each other."""
    if len(sensors) < 2:
        names = ", ".join(sensor.name for sensor in sensors) or "none"
        raise ValueError(
            f"sensors are fitted to each other, for which two or more are needed, got {names}: "
            "give a reference"
        )


def _find_in_images(recording: Frames, count: int, sample: int) -> list[_StandingPoints]:
    """Points of each sensor's empty scene, learnt from the first `count` frames of images.

    sample: largest number of images kept of each sensor."""
    standing_points = []
    for scene in learn_empty_scenes(recording, sample, frames=count):
        points, deviation = scene_points(scene)
        standing_points.append(_StandingPoints(points, deviation))
    return standing_points


def _pair_objects(recording: Frames, count: int, detector: Detector) -> MorePairs:
    """Return a function that pairs the objects a detector finds in some of the first frames.

    It takes poses and a search radius (m). Objects are detected here, once; count: number of first
    frames. Raises ValueError for a recording without a site."""
    # evenly spread over the frames
    frame_indices = np.linspace(0, count - 1, min(OBJECT_FRAMES, count)).astype(int)
    site = getattr(recording, "site", None)
    if site is None:
        raise ValueError("a detector is for a recording of a known site: leave it out")
    frames = [recording[k] for k in np.unique(frame_indices).tolist()]
    return partial(object_pairs, detect_boxes(frames, detector, site))


def find_pose(
    points: Points,
    sensor: Sensor,
    surface: Surface,
    *,
    deviation: Float64[np.ndarray, " n"] | None = None,
) -> FoundPose:
    """Find the pose of one sensor, near the believed one, by its standing points.

    Args:
        points: points (m) of the standing scene in the sensor's frame.
        sensor: sensor at its believed pose.
        surface: standing surfaces, world frame.
        deviation: standard deviation of each point (m).

    A pose that cannot be found, or has too little overlap, is a result with a refusal."""
    try:
        registration = register(points, surface, sensor.pose, deviation=deviation)
    except ValueError as error:
        return FoundPose(sensor, None, str(error))
    if registration.overlap >= MIN_OVERLAP_SHARE:
        return FoundPose(sensor, registration)
    problem = f"only {registration.overlap:.0%} of its points have a counterpart in the reference"
    remedy = "is it of the same place, and does it show what this sensor sees?"
    return FoundPose(sensor, None, f"{problem}, {MIN_OVERLAP_SHARE:.0%} are needed: {remedy}")


def align_clouds(
    clouds: list[np.ndarray],
    sensors: Sequence[Sensor],
    *,
    held: Sequence[int] = (),
    more: MorePairs | None = None,
) -> tuple[FoundPose, ...]:
    """Fit the poses of sensors to each other by clouds of the same standing scene.

    Args:
        clouds: points (m) of each sensor, in the sensor's frame.
        sensors: sensors at their believed poses.
        held: numbers of sensors whose poses stay.
        more: returns further pairs for poses and a search radius (m).

    A sensor that shares too few points with the others gets a refusal instead of a pose. Raises
    ValueError for fewer than two sensors."""
    _check_several(sensors)
    surfaces = [face_sensor(cloud_surface(points)) for points in clouds]
    alignment = align(surfaces, [sensor.pose for sensor in sensors], held=held, more=more)
    found_poses = []
    for k, sensor in enumerate(sensors):
        shared = int(alignment.shared[k].sum())
        if shared < MIN_SHARED_ROWS and k not in held:
            problem = (
                f"it shares {shared} points with the other sensors, {MIN_SHARED_ROWS} are needed: "
                "give a reference"
            )
            found_poses.append(FoundPose(sensor, None, problem))
            continue
        numbers = slice(6 * k, 6 * k + 6)  # this sensor's numbers among all motions
        registration = Registration(
            alignment.poses[k],
            covariance=np.ascontiguousarray(alignment.covariance[numbers, numbers]),
            unobserved=alignment.hidden_motions(k),
            overlap=min(1.0, shared / max(1, int(alignment.shared.max()))),
            scatter=float(alignment.scatter[k]),
        )
        found_poses.append(FoundPose(sensor, registration))
    return tuple(found_poses)


def _find_in_clouds(
    recording: Frames, count: int
) -> tuple[tuple[Sensor, ...], list[_StandingPoints]]:
    """Sensors of a recording of clouds, and their points of the standing scene.

    The points are learnt from the first `count` frames. If sensors move or frames are few, they are
    all points of the first frame with any. Raises ValueError if no frame has a point."""
    first_frames = [recording[k] for k in range(min(count, GRID_FRAMES))]
    points_by_name: dict[str, Points] = {}
    if len(first_frames) >= MIN_FRAMES and not _sensors_move(first_frames):
        scenes = learn_sample_scenes(recording[k] for k in range(count))
        for name, learnt in scenes.items():
            points_by_name[name], _ = scene_points(learnt.scene)
    else:
        for frame in first_frames:
            filled_clouds = [cloud for cloud in frame.clouds if len(cloud.points)]
            points_by_name = {cloud.name: cloud.in_sensor() for cloud in filled_clouds}
            if points_by_name:
                break
        if not points_by_name:
            raise ValueError("no frame has a point to find a pose by")
    # in the first frame with a cloud of the sensor, which is read last
    poses = {}
    for frame in reversed(first_frames):
        for cloud in frame.clouds:
            poses[cloud.name] = cloud.world_SE3_sensor
    # the model is unknown from clouds, and only the poses count
    sensors = tuple(Sensor(name, RowLidar(), poses[name]) for name in points_by_name)
    standing_points = [
        _StandingPoints(points, deviation=None) for points in points_by_name.values()
    ]
    return sensors, standing_points


def _sensors_move(frames: Sequence[Frame]) -> bool:
    """Return True if a sensor is ever more than `MAX_STILL_SENSOR_M` from its first place in the
    map."""
    first_positions = dict[str, np.ndarray]()  # x, y, z (m) in the map, by name of the sensor
    for frame in frames:
        for cloud in frame.clouds:
            position = (frame.map_SE3_world @ cloud.world_SE3_sensor)[:3, 3]
            # setdefault stores the position only for a new sensor
            first_position = first_positions.setdefault(cloud.name, position)
            if np.linalg.norm(position - first_position) > MAX_STILL_SENSOR_M:
                return True
    return False
