"""Poses of a recording's sensors, found again by what stands still.

Each sensor learns its empty scene and is registered against a reference, or all are aligned with each other.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.arrays import Float64
from toolkit.calibration.empty_scene import SAMPLE, EmptyScene, learn_empty_scenes
from toolkit.calibration.joint import (
    Alignment,
    Pairs,
    Poses,
    SitedRecording,
    align,
    face_sensor,
    object_pairs,
    seen_objects,
)
from toolkit.calibration.registration import (
    NAMES,
    Registration,
    Surface,
    cloud_surface,
    read_surface,
    register,
    scene_points,
)
from toolkit.calibration.scenes import GRID_SAMPLES, STANDS_STILL, LearntScene, learn_sample_scenes
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.doctor import Finding
from toolkit.datasets.readings import Readable, read_frame
from toolkit.datasets.sample import Sample
from toolkit.geometry import invert
from toolkit.objects import Detector
from toolkit.points import select_sensors
from toolkit.runtime.files import replace_infinite, write_text
from toolkit.sensors.error_profiles import PAPER_ERRORS, ErrorProfile
from toolkit.sensors.models import RowLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

LEAST_FRAMES = 5  # of an empty scene that sensors are registered by
LEAST_OVERLAP = 0.3  # fraction of a sensor's points that must have a counterpart
WORTH_TURN, WORTH_MOVE = float(np.deg2rad(0.1)), 0.02  # a pose farther off than this has drifted
_SURE = 3.0  # standard deviations


@dataclass(frozen=True, eq=False)
class FoundPose:
    """A sensor as it was believed to be mounted, and its registration.

    registration: None if no pose was found; refusal: the reason then.
    """

    sensor: Sensor
    registration: Registration | None
    refusal: str = ""

    @property
    def pose(self) -> Float64[np.ndarray, "4 4"]:
        """Pose that was found, else the believed one."""
        return self.sensor.pose if self.registration is None else self.registration.pose

    @property
    def turn(self) -> float:
        """Angle (rad) between the believed pose and this one."""
        between = self.pose[:3, :3] @ self.sensor.pose[:3, :3].T
        sine = np.array([between[2, 1] - between[1, 2], between[0, 2] - between[2, 0], between[1, 0] - between[0, 1]])
        return float(np.arctan2(np.linalg.norm(sine) / 2, (np.trace(between) - 1) / 2))

    @property
    def distance(self) -> float:
        """Distance (m) between the believed position and this one."""
        return float(np.linalg.norm(self.pose[:3, 3] - self.sensor.pose[:3, 3]))

    @property
    def drifted(self) -> bool:
        """True if it is off by more than 0.1° or 2 cm, and by more than three standard deviations."""
        if self.registration is None:
            return False
        turn, move = np.split(np.sqrt(np.diag(self.registration.covariance)), 2)
        return self.turn > max(WORTH_TURN, _SURE * float(np.linalg.norm(turn))) or self.distance > max(
            WORTH_MOVE, _SURE * float(np.linalg.norm(move))
        )

    def __str__(self) -> str:
        if self.registration is None:
            return f"{self.sensor.name}: not found: {self.refusal}"
        turn, move = np.split(np.sqrt(np.diag(self.registration.covariance)), 2)
        unseen = "; ".join(map(describe_motion, self.registration.unobserved))
        return (
            f"{self.sensor.name}: turned by {np.rad2deg(self.turn):.2f}° (± {np.rad2deg(np.linalg.norm(turn)):.2f}°), "
            f"moved by {self.distance * 100:.1f} cm (± {np.linalg.norm(move) * 100:.1f} cm)"
            f"{unseen and f'; not observed, so left as believed: {unseen}'}"
        )

    def described(self) -> dict[str, Any]:
        """Return its figures for files: degrees, metres, turns and moves about the world's axes.

        Standard deviations are infinite for motions that are not observed.
        """
        fixed = {
            "world_SE3_sensor": self.pose.tolist(),
            "believed_world_SE3_sensor": self.sensor.pose.tolist(),
        }
        if self.registration is None:
            return {**fixed, "found": False, "why": self.refusal}
        turn, move = np.split(self.registration.deviations, 2)
        return {
            **fixed,
            "found": True,
            "turned_deg": float(np.rad2deg(self.turn)),
            "moved_m": self.distance,
            "drifted": self.drifted,
            "standard_deviation": {
                "turn_deg": np.rad2deg(turn).tolist(),
                "move_m": move.tolist(),
            },
            "covariance_rad_m": self.registration.covariance.tolist(),
            "unobserved": [describe_motion(motion) for motion in self.registration.unobserved],
            "overlap": self.registration.overlap,
            "scatter_m": self.registration.scatter,
        }


def describe_motion(motion: Float64[np.ndarray, "6"]) -> str:
    """Describe a motion, turns times `LEVER`, in words.

    >>> describe_motion(np.array([0, 0, 0, 0.6, -0.8, 0]))
    'move along x -0.60, move along y 0.80'
    """
    motion = motion * (-1 if motion[np.argmax(np.abs(motion))] < 0 else 1)
    named = [f"{name} {share:.2f}" for name, share in zip(NAMES, motion, strict=True) if abs(share) > 0.1]
    return ", ".join(named)


def save_poses(path: str | Path, found: Sequence[FoundPose]) -> None:
    """Write `FoundPose.described` of each sensor as JSON, by its name.

    `toolkit.datasets.cloud_files.read_poses` reads the file.
    """
    write_text(path, json.dumps(replace_infinite({each.sensor.name: each.described() for each in found}), indent=1))


def find_poses(
    recording: Readable,
    surface: Surface,
    *,
    frames: int | None = None,
    sample: int = SAMPLE,
    errors: ErrorProfile | str = PAPER_ERRORS,
    noise_seed: int | None = 0,
    progress: Callable[[int], None] | None = None,
) -> tuple[FoundPose, ...]:
    """The pose of every sensor of a recording, from its empty scene over its first `frames` frames, all if not given.

    sample, errors, noise_seed: see `toolkit.calibration.empty_scene.learn_empty_scenes`; errors turn the believed poses
    too. progress: called with how many sensors are done. Raises ValueError for fewer than `LEAST_FRAMES` frames.
    """
    count = check_frames_suffice(recording, frames)
    scenes = learn_empty_scenes(recording, frames=count, sample=sample, errors=errors, noise_seed=noise_seed)
    sensors = read_frame(recording, 0, errors=errors, noise_seed=noise_seed).sensors
    found = []
    for scene, sensor in zip(scenes, sensors, strict=True):
        found.append(find_pose(scene, sensor, surface))
        if progress is not None:
            progress(len(found))
    return tuple(found)


def check_frames_suffice(recording: Readable, frames: int | None) -> int:
    """How many frames empty scenes are learnt from. Raises ValueError where they are fewer than `LEAST_FRAMES`."""
    count = min(len(recording), len(recording) if frames is None else frames)
    if count < LEAST_FRAMES:
        raise ValueError(
            f"{count} frames are too few to tell what stands still from who passes: give {LEAST_FRAMES} or more"
        )
    return count


def find_pose(scene: EmptyScene, sensor: Sensor, surface: Surface) -> FoundPose:
    """The pose of one sensor from its empty scene, near the one it is believed to have; a refusal says why not."""
    points, deviation = scene_points(scene)
    return find_pose_of_points(points, sensor, surface, deviation=deviation)


def find_pose_of_points(
    points: Float64[np.ndarray, "n 3"],
    sensor: Sensor,
    surface: Surface,
    *,
    deviation: Float64[np.ndarray, " n"] | None = None,
) -> FoundPose:
    """The same from points that it measured, own frame; deviation: of each (m)."""
    try:
        registration = register(points, surface, sensor.pose, deviation=deviation)
    except ValueError as error:
        return FoundPose(sensor, None, str(error))
    if registration.overlap < LEAST_OVERLAP:
        return FoundPose(
            sensor,
            None,
            f"only {registration.overlap:.0%} of its points have a counterpart in the reference, {LEAST_OVERLAP:.0%} "
            "are needed: is it of the same place, and does it show what this sensor sees?",
        )
    return FoundPose(sensor, registration)


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
    `toolkit.calibration.poses.find_poses`. Raises ValueError for too few frames, fewer than two sensors, and
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
    surfaces = [face_sensor(cloud_surface(points)) for points in clouds]
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
            alignment.hidden_motions(number),
            min(1.0, shared / max(1, int(alignment.shared.max()))),
            float(alignment.scatter[number]),
        ),
    )


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


def check_drift(path: str | Path, reference: str | Path, site: Site | None = None) -> list[Finding]:
    """Warn of each sensor of a recording that is not where the reference says, see `read_surface`.

    There is one warning if the recording cannot be read or is too short. Raises ValueError and OSError if the reference
    cannot be read.
    """
    surface = read_surface(reference)
    try:
        with CoopDataset(path, site) as recording:
            return drift_findings(find_poses(recording, surface, noise_seed=None), str(reference))
    except (ValueError, OSError) as error:
        return [Finding("warning", str(path), "its sensors' poses cannot be checked", str(error), "check them by hand")]


def drift_findings(found: Sequence[FoundPose], reference: str) -> list[Finding]:
    """Warn of each sensor that has clearly drifted, and of each without a pose."""
    return [_finding(each, reference) for each in found if each.drifted or each.registration is None]


def _finding(found: FoundPose, reference: str) -> Finding:
    where = f"sensor {found.sensor.name}"
    if found.registration is None:
        return Finding(
            "warning", where, f"its pose cannot be checked against {reference}", found.refusal, "check by hand"
        )
    turn, move = np.split(np.sqrt(np.diag(found.registration.covariance)), 2)
    evidence = (
        f"turned by {np.rad2deg(found.turn):.2f}° and moved by {found.distance * 100:.1f} cm against {reference}, "
        f"to within {np.rad2deg(np.linalg.norm(turn)):.2f}° and {np.linalg.norm(move) * 100:.1f} cm"
    )
    return Finding("warning", where, "it hangs crooked or has drifted", evidence, "write its pose by coview calibrate")
