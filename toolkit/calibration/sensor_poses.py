"""Where the sensors of a recording really are: each registered by its learnt empty scene against a reference."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.arrays import Float64
from toolkit.calibration.empty_scene import SAMPLE, EmptyScene, learn_empty_scenes
from toolkit.calibration.reference import scene_points
from toolkit.calibration.registration import NAMES, Registration, Surface, register
from toolkit.datasets.readings import Readable, read_frame
from toolkit.runtime.files import finite, write_text
from toolkit.sensors.errors.profile import ErrorProfile
from toolkit.sensors.errors.profiles import PAPER_ERRORS
from toolkit.sensors.sensor import Sensor

LEAST_FRAMES = 5  # that an empty scene is learnt from, before sensors are registered by it
LEAST_OVERLAP = 0.3  # of a sensor's points that must have a counterpart
WORTH_TURN, WORTH_MOVE = float(np.deg2rad(0.1)), 0.02  # a pose farther off than this has drifted
_SURE = 3.0  # standard deviations


@dataclass(frozen=True, eq=False)
class FoundPose:
    """A sensor as it was believed to be mounted, and its registration, or why there is none."""

    sensor: Sensor
    registration: Registration | None
    refusal: str = ""

    @property
    def pose(self) -> Float64[np.ndarray, "4 4"]:
        """The pose that was found, else the believed one."""
        return self.sensor.pose if self.registration is None else self.registration.pose

    @property
    def turn(self) -> float:
        """Angle (rad) between the believed pose and this one."""
        between = self.pose[:3, :3] @ self.sensor.pose[:3, :3].T
        sine = np.array([between[2, 1] - between[1, 2], between[0, 2] - between[2, 0], between[1, 0] - between[0, 1]])
        return float(np.arctan2(np.linalg.norm(sine) / 2, (np.trace(between) - 1) / 2))

    @property
    def distance(self) -> float:
        """How far (m) this pose is from the believed one."""
        return float(np.linalg.norm(self.pose[:3, 3] - self.sensor.pose[:3, 3]))

    @property
    def drifted(self) -> bool:
        """Whether it is clearly off: by more than 0.1° or 2 cm, and more than three standard deviations."""
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
        unseen = "; ".join(map(spoken, self.registration.unobserved))
        return (
            f"{self.sensor.name}: turned by {np.rad2deg(self.turn):.2f}° (± {np.rad2deg(np.linalg.norm(turn)):.2f}°), "
            f"moved by {self.distance * 100:.1f} cm (± {np.linalg.norm(move) * 100:.1f} cm)"
            f"{unseen and f'; not observed, so left as believed: {unseen}'}"
        )

    def described(self) -> dict[str, Any]:
        """What files say of it: angles in degrees, lengths in metres, turns and moves by the world's axes; infinite
        what is not observed."""
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
            "unobserved": [spoken(motion) for motion in self.registration.unobserved],
            "overlap": self.registration.overlap,
            "scatter_m": self.registration.scatter,
        }


def spoken(motion: Float64[np.ndarray, "6"]) -> str:
    """A motion, turns times `LEVER`, in words.

    >>> spoken(np.array([0, 0, 0, 0.6, -0.8, 0]))
    'move along x -0.60, move along y 0.80'
    """
    motion = motion * (-1 if motion[np.argmax(np.abs(motion))] < 0 else 1)
    named = [f"{name} {share:.2f}" for name, share in zip(NAMES, motion, strict=True) if abs(share) > 0.1]
    return ", ".join(named)


def save_poses(path: str | Path, found: Sequence[FoundPose]) -> None:
    """Write what `FoundPose.described` says of each sensor as JSON, by its name, for
    `toolkit.datasets.cloud_files.read_poses` and for people."""
    write_text(path, json.dumps(finite({each.sensor.name: each.described() for each in found}), indent=1))


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
