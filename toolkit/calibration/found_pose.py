"""Found poses of sensors: registration, deviation from the believed pose, and their file."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from toolkit.arrays import Float64, Pose
from toolkit.calibration.motions import LEVER_M, MOTION_NAMES, motion_between
from toolkit.calibration.registration import Registration
from toolkit.runtime.text_values import replace_infinite
from toolkit.runtime.writing import write_text
from toolkit.sensors.sensor import Sensor

# a pose turned or moved by more than this has drifted
MIN_DRIFT_RAD = float(np.deg2rad(0.1))
MIN_DRIFT_M = 0.02
_MIN_SIGMAS = 3.0  # and by more standard deviations than this


@dataclass(frozen=True, eq=False)
class FoundPose:
    """A sensor at its believed pose, and the pose that was found for it.

    Attributes:
        sensor: sensor at its believed pose.
        registration: found pose with its errors, None if no pose was found.
        refusal: reason why no pose was found, else empty."""

    sensor: Sensor
    registration: Registration | None
    refusal: str = ""

    @property
    def pose(self) -> Pose:
        """Pose world_SE3_sensor that was found, else the believed one."""
        return self.sensor.pose if self.registration is None else self.registration.pose

    @property
    def turn(self) -> float:
        """Angle (rad) between the believed pose and the found one, 0 if none was found."""
        return float(np.linalg.norm(motion_between(self.sensor.pose, self.pose)[:3])) / LEVER_M

    @property
    def distance(self) -> float:
        """Distance (m) between the believed position and the found one, 0 if none was found."""
        return float(np.linalg.norm(self.pose[:3, 3] - self.sensor.pose[:3, 3]))

    @property
    def deviation(self) -> tuple[float, float]:
        """Standard deviations of turn (rad) and distance (m), infinite if no pose was found."""
        if self.registration is None:
            return np.inf, np.inf
        turn, move = np.split(np.sqrt(np.diag(self.registration.covariance)), 2)
        return float(np.linalg.norm(turn)), float(np.linalg.norm(move))

    @property
    def has_drifted(self) -> bool:
        """True if the pose is clearly off: by 0.1° or 2 cm, and by three standard deviations."""
        turn, move = self.deviation
        has_turned = self.turn > max(MIN_DRIFT_RAD, _MIN_SIGMAS * turn)
        return has_turned or self.distance > max(MIN_DRIFT_M, _MIN_SIGMAS * move)

    def __str__(self) -> str:
        """Turn and move of the sensor with their standard deviations, in a line."""
        if self.registration is None:
            return f"{self.sensor.name}: not found: {self.refusal}"
        turn_deviation, move_deviation = self.deviation
        turn_text = f"turned by {np.rad2deg(self.turn):.2f}° (± {np.rad2deg(turn_deviation):.2f}°)"
        move_text = f"moved by {self.distance * 100:.1f} cm (± {move_deviation * 100:.1f} cm)"
        text = f"{self.sensor.name}: {turn_text}, {move_text}"
        unobserved_text = "; ".join(map(describe_motion, self.registration.unobserved))
        if unobserved_text:
            return f"{text}; not observed, so left as believed: {unobserved_text}"
        return text

    def as_dict(self) -> dict[str, object]:
        """Return the pose and its figures as plain values for files (degrees, metres, world axes).

        Deviations are infinite for motions that are not observed."""
        poses = {
            "world_SE3_sensor": self.pose.tolist(),
            "believed_world_SE3_sensor": self.sensor.pose.tolist(),
        }
        registration = self.registration
        if registration is None:
            return {**poses, "found": False, "why": self.refusal}
        # three turns (rad), then three moves (m)
        turn_deviations, move_deviations = np.split(registration.deviations, 2)
        return {
            **poses,
            "found": True,
            "turned_deg": float(np.rad2deg(self.turn)),
            "moved_m": self.distance,
            "drifted": self.has_drifted,
            "standard_deviation": {
                "turn_deg": np.rad2deg(turn_deviations).tolist(),
                "move_m": move_deviations.tolist(),
            },
            "covariance_rad_m": registration.covariance.tolist(),
            "unobserved": [describe_motion(motion) for motion in registration.unobserved],
            "overlap": registration.overlap,
            "scatter_m": registration.scatter,
        }


def describe_motion(motion: Float64[np.ndarray, "6"]) -> str:
    """Describe a unit motion in words, as the share of each number that is above a tenth.

    motion: turns times `LEVER_M`, and moves. Its sign does not matter."""
    # the sign that makes the largest share positive
    sign = -1 if motion[np.argmax(np.abs(motion))] < 0 else 1
    parts = []
    for name, share in zip(MOTION_NAMES, motion * sign, strict=True):
        if abs(share) > 0.1:
            parts.append(f"{name} {share:.2f}")
    return ", ".join(parts)


def save_poses(path: str | Path, found_poses: Sequence[FoundPose]) -> None:
    """Write the poses and figures of sensors as JSON, by name of the sensor.

    `toolkit.datasets.pose_files` reads such files. Infinite values become null."""
    figures = {found_pose.sensor.name: found_pose.as_dict() for found_pose in found_poses}
    write_text(path, json.dumps(replace_infinite(figures), indent=1))
