"""Pairs of objects that two sensors see at the same time.

They determine motions of a sensor that shares too little of the standing scene."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from toolkit.arrays import BoxRows, Float64, Pose
from toolkit.calibration.joint_system import Pairs, Poses
from toolkit.calibration.registration import LEVER, resistance
from toolkit.frame import Frame
from toolkit.geometry import invert, transform
from toolkit.objects import Detector
from toolkit.points import detect_on_ground, frame_points
from toolkit.sites.site import Site

PAIR_GATE = 1.5  # m: greatest distance between the centres that two sensors give one road user
_LEAST_GATE = 0.8  # m
_CENTRE = 0.25  # m, standard deviation of a centre along each axis
_HEADING = float(np.deg2rad(4.0))  # standard deviation of a heading
# greatest difference of the headings of one road user, up to a half turn
_WORST_HEADING = float(np.deg2rad(20.0))
_NO_MATCH = (np.empty((0, 3)), np.empty((0, 3)), np.empty(0))


@dataclass(frozen=True, eq=False)
class SensorBoxes:
    """Objects of one sensor and frame, in its axes."""

    centres: Float64[np.ndarray, "n 3"]
    ahead: Float64[np.ndarray, "n 3"]

    @classmethod
    def from_boxes(cls, boxes: BoxRows, believed: Pose) -> "SensorBoxes":
        """Return boxes of the world in the sensor's axes."""
        ahead = np.column_stack([np.cos(boxes[:, 6]), np.sin(boxes[:, 6]), np.zeros(len(boxes))])
        return cls(transform(invert(believed), boxes[:, :3]), ahead @ believed[:3, :3])


def detect_boxes(
    frames: Sequence[Frame], detector: Detector, site: Site
) -> list[list[SensorBoxes]]:
    """Detect objects in each sensor's cloud alone, per frame."""
    seen: list[list[SensorBoxes]] = []
    for frame in frames:
        clouds = zip(frame_points(frame, area=site), frame.sensors, strict=True)
        per_sensor = (
            (detect_on_ground(detector, cloud, site).boxes, sensor.pose) for cloud, sensor in clouds
        )
        seen.append([SensorBoxes.from_boxes(*detected) for detected in per_sensor])
    return seen


def object_pairs(seen: Sequence[Sequence[SensorBoxes]], poses: Poses, radius: float) -> list[Pairs]:
    """Rows of all road users that two sensors at `poses` see: three for the centre, one for the
    heading."""
    gate = float(np.clip(radius, _LEAST_GATE, PAIR_GATE))
    pairs = []
    for first, second in combinations(range(len(poses)), 2):
        matches = [
            _match_boxes(frame[first], frame[second], poses[first], poses[second], gate)
            for frame in seen
        ]
        first_centres, second_centres, turn = (
            np.concatenate(parts) for parts in zip(_NO_MATCH, *matches, strict=True)
        )
        if count := len(first_centres):
            axes = np.repeat(np.eye(3), count, axis=0)
            about_z = np.tile([0.0, 0.0, 1 / LEVER, 0.0, 0.0, 0.0], (count, 1))
            places = (
                (np.tile(first_centres, (3, 1)), poses[first][:3, 3]),
                (np.tile(second_centres, (3, 1)), poses[second][:3, 3]),
            )
            mine, theirs = (
                np.concatenate([resistance(*position, axes), about_z]) for position in places
            )
            residual = np.concatenate([(first_centres - second_centres).T.ravel(), turn])
            deviation = np.repeat([np.sqrt(2) * _CENTRE, np.sqrt(2) * _HEADING], [3 * count, count])
            limit = np.repeat([gate, _WORST_HEADING], [3 * count, count])
            pairs.append(Pairs(first, second, mine, -theirs, residual, deviation, limit))
    return pairs


def _match_boxes(
    mine: SensorBoxes, theirs: SensorBoxes, pose: Pose, other_pose: Pose, gate: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres matched by two sensors, and the first one's headings less the other's (rad)."""
    first_centres = transform(pose, mine.centres)
    second_centres = transform(other_pose, theirs.centres)
    if not (len(first_centres) and len(second_centres)):
        return _NO_MATCH
    distance = np.hypot(
        *(first_centres[:, None, :2] - second_centres[None, :, :2]).transpose(2, 0, 1)
    )
    nearest = distance.argmin(axis=1)
    row = np.arange(len(first_centres))
    mutual = (distance[:, nearest].argmin(axis=0) == row) & (distance[row, nearest] < gate)
    headings_ahead = (
        boxes.ahead @ at[:3, :3].T for boxes, at in ((mine, pose), (theirs, other_pose))
    )
    heading, other_heading = (np.arctan2(ahead[:, 1], ahead[:, 0]) for ahead in headings_ahead)
    turn = (heading - other_heading[nearest] + np.pi / 2) % np.pi - np.pi / 2
    matched = mutual & (np.abs(turn) < _WORST_HEADING)
    return first_centres[matched], second_centres[nearest[matched]], turn[matched]
