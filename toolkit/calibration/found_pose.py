"""Found poses of sensors: registration, deviation from the believed pose, and their file."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from toolkit.arrays import Float64, Pose
from toolkit.calibration import registration as reference_fit
from toolkit.calibration.registration import LEVER, Registration, motion_between
from toolkit.runtime.text_values import replace_infinite
from toolkit.runtime.writing import write_text
from toolkit.sensors.sensor import Sensor

# a pose farther off than this has drifted
WORTH_TURN = float(np.deg2rad(0.1))
WORTH_MOVE = 0.02
_SURE = 3.0  # standard deviations


@dataclass(frozen=True, eq=False)
class FoundPose:
    """A sensor's believed mounting and its registration."""

    sensor: Sensor
    registration: Registration | None  # None if no pose was found
    refusal: str = ""  # the reason then

    @property
    def pose(self) -> Pose:
        """Pose that was found, else the believed one."""
        return self.sensor.pose if self.registration is None else self.registration.pose

    @property
    def turn(self) -> float:
        """Angle (rad) between the believed pose and this one."""
        return float(np.linalg.norm(motion_between(self.sensor.pose, self.pose)[:3])) / LEVER

    @property
    def distance(self) -> float:
        """Distance (m) between the believed position and this one."""
        return float(np.linalg.norm(self.pose[:3, 3] - self.sensor.pose[:3, 3]))

    @property
    def deviation(self) -> tuple[float, float]:
        """Standard deviations of turn (rad) and distance (m)."""
        if self.registration is None:
            return np.inf, np.inf
        turn, move = np.split(np.sqrt(np.diag(self.registration.covariance)), 2)
        return float(np.linalg.norm(turn)), float(np.linalg.norm(move))

    @property
    def drifted(self) -> bool:
        """True if the pose is off by more than 0.1° or 2 cm, and by more than three standard
        deviations."""
        turn, move = self.deviation
        return self.turn > max(WORTH_TURN, _SURE * turn) or self.distance > max(
            WORTH_MOVE, _SURE * move
        )

    def __str__(self) -> str:
        if self.registration is None:
            return f"{self.sensor.name}: not found: {self.refusal}"
        turn, move = self.deviation
        unseen = "; ".join(map(describe_motion, self.registration.unobserved))
        turned = f"turned by {np.rad2deg(self.turn):.2f}° (± {np.rad2deg(turn):.2f}°)"
        moved = f"moved by {self.distance * 100:.1f} cm (± {move * 100:.1f} cm)"
        return (
            f"{self.sensor.name}: {turned}, "
            f"{moved}{unseen and f'; not observed, so left as believed: {unseen}'}"
        )

    def described(self) -> dict[str, object]:
        """Return figures for files (degrees, metres, world axes); deviations are infinite where not
        observed."""
        poses: dict[str, object] = {"world_SE3_sensor": self.pose.tolist()}
        poses["believed_world_SE3_sensor"] = self.sensor.pose.tolist()
        if self.registration is None:
            return {**poses, "found": False, "why": self.refusal}
        turn, move = np.split(self.registration.deviations, 2)
        figures = poses | {
            "found": True,
            "turned_deg": float(np.rad2deg(self.turn)),
            "moved_m": self.distance,
        }
        figures["drifted"] = self.drifted
        figures["standard_deviation"] = {
            "turn_deg": np.rad2deg(turn).tolist(),
            "move_m": move.tolist(),
        }
        figures["covariance_rad_m"] = self.registration.covariance.tolist()
        figures["unobserved"] = [describe_motion(motion) for motion in self.registration.unobserved]
        return figures | {
            "overlap": self.registration.overlap,
            "scatter_m": self.registration.scatter,
        }


def describe_motion(motion: Float64[np.ndarray, "6"]) -> str:
    """Describe a motion, turns times `LEVER`, in words."""
    motion = motion * (-1 if motion[np.argmax(np.abs(motion))] < 0 else 1)
    parts = [
        f"{name} {share:.2f}"
        for name, share in zip(reference_fit.NAMES, motion, strict=True)
        if abs(share) > 0.1
    ]
    return ", ".join(parts)


def save_poses(path: str | Path, found_poses: Sequence[FoundPose]) -> None:
    """Write `FoundPose.described` of each sensor as JSON by name, for
    `toolkit.datasets.pose_files.read_poses`."""
    write_text(
        path,
        json.dumps(
            replace_infinite(
                {found_pose.sensor.name: found_pose.described() for found_pose in found_poses}
            ),
            indent=1,
        ),
    )
