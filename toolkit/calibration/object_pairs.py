"""Pairs of objects that two sensors see at the same time.

They determine motions of a sensor that shares too little of the standing scene."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from toolkit.arrays import BoxRows, Float64, Pose
from toolkit.calibration.joint_system import Pairs, Poses
from toolkit.calibration.motions import LEVER_M, resistance
from toolkit.frame import Frame
from toolkit.geometry import invert, transform
from toolkit.objects import Detector
from toolkit.points import detect_on_ground, frame_points
from toolkit.sites.site import Site

# largest horizontal distance between the centres that two sensors give one road user: the search
# radius of a level of the alignment, within these limits
MAX_PAIR_GATE_M = 1.5
_MIN_GATE_M = 0.8
_CENTRE_M = 0.25  # standard deviation of a centre along each axis
_HEADING_RAD = float(np.deg2rad(4.0))  # standard deviation of a heading
# largest difference between the headings of one road user, half turns left out
_MAX_HEADING_GAP_RAD = float(np.deg2rad(20.0))
# centres of both sensors, and turns, without a row
_NO_MATCH = (np.empty((0, 3)), np.empty((0, 3)), np.empty(0))


@dataclass(frozen=True, eq=False)
class SensorBoxes:
    """Objects that one sensor sees in one frame, in the sensor's frame.

    Attributes:
        centres: centres of the boxes (m).
        ahead: unit vectors along their headings."""

    centres: Float64[np.ndarray, "n 3"]
    ahead: Float64[np.ndarray, "n 3"]

    @classmethod
    def from_boxes(cls, boxes: BoxRows, believed: Pose) -> "SensorBoxes":
        """Return boxes, given in the world frame, in the frame of their sensor.

        believed: world_SE3_sensor that the boxes were detected with."""
        centre = boxes[:, :3]
        yaw = boxes[:, 6]
        world_ahead = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(boxes))])
        return cls(
            centres=transform(invert(believed), centre), ahead=world_ahead @ believed[:3, :3]
        )


class _Matches(NamedTuple):
    """Objects that two sensors see, a row each.

    Attributes:
        first: centres by the first sensor (m), world frame.
        second: centres by the second sensor.
        turn: heading by the first sensor less the second's (rad), half turns left out."""

    first: Float64[np.ndarray, "n 3"]
    second: Float64[np.ndarray, "n 3"]
    turn: Float64[np.ndarray, " n"]


def detect_boxes(
    frames: Sequence[Frame], detector: Detector, site: Site
) -> list[list[SensorBoxes]]:
    """Detect objects in the cloud of each sensor.

    Returns, for each frame, the boxes of its sensors in order, each in the sensor's frame."""
    boxes_by_frame: list[list[SensorBoxes]] = []
    for frame in frames:
        frame_boxes = []
        for cloud, sensor in zip(frame_points(frame, area=site), frame.sensors, strict=True):
            boxes = detect_on_ground(detector, cloud, site).boxes
            frame_boxes.append(SensorBoxes.from_boxes(boxes, sensor.pose))
        boxes_by_frame.append(frame_boxes)
    return boxes_by_frame


def object_pairs(seen: Sequence[Sequence[SensorBoxes]], poses: Poses, radius: float) -> list[Pairs]:
    """Pair the road users that two sensors see, for every two sensors.

    Each match gives three rows for the centre (all matches in x, then y, then z) and one for the
    heading, after all centres.

    Args:
        seen: for each frame, the boxes of each sensor.
        poses: world_SE3_sensor of each sensor.
        radius: search radius (m)."""
    gate = float(np.clip(radius, _MIN_GATE_M, MAX_PAIR_GATE_M))
    pairs = []
    for first, second in combinations(range(len(poses)), 2):
        matches = [
            _match_boxes(
                mine=frame[first],
                theirs=frame[second],
                pose=poses[first],
                other_pose=poses[second],
                gate=gate,
            )
            for frame in seen
        ]
        # matches of all frames; empty arrays in case there are no frames
        joined_matches = _Matches(*map(np.concatenate, zip(_NO_MATCH, *matches, strict=True)))
        count = len(joined_matches.turn)
        if not count:
            continue
        centre_deviation = np.sqrt(2) * _CENTRE_M
        heading_deviation = np.sqrt(2) * _HEADING_RAD
        pair = Pairs(
            first_sensor=first,
            second_sensor=second,
            first_rows=_centre_rows(joined_matches.first, poses[first]),
            second_rows=-_centre_rows(joined_matches.second, poses[second]),
            residual=np.concatenate(
                [(joined_matches.first - joined_matches.second).T.ravel(), joined_matches.turn]
            ),
            deviation=np.repeat([centre_deviation, heading_deviation], [3 * count, count]),
            limit=np.repeat([gate, _MAX_HEADING_GAP_RAD], [3 * count, count]),
        )
        pairs.append(pair)
    return pairs


def _centre_rows(centres: Float64[np.ndarray, "n 3"], pose: Pose) -> Float64[np.ndarray, "m 6"]:
    """Growth of centres along x, y and z, then of headings, per unit of a sensor's motion.

    centres: (n, 3) m, world frame; pose: world_SE3_sensor. Returns m = 4 n rows: all centres along
    x, along y, along z, and all headings; columns are turns times `LEVER_M`, and moves."""
    count = len(centres)
    # a plane across each axis through each centre: all x, then y, then z
    normals = np.repeat(np.eye(3), count, axis=0)
    centre_rows = resistance(np.tile(centres, (3, 1)), position=pose[:3, 3], normals=normals)
    # headings change with turns about z only
    heading_rows = np.tile([0.0, 0.0, 1 / LEVER_M, 0.0, 0.0, 0.0], (count, 1))
    return np.concatenate([centre_rows, heading_rows])


def _match_boxes(
    mine: SensorBoxes, theirs: SensorBoxes, pose: Pose, other_pose: Pose, gate: float
) -> _Matches:
    """Match boxes of two sensors in one frame that are each other's nearest, and head alike.

    Args:
        mine: boxes of the first sensor.
        theirs: boxes of the second sensor.
        pose: world_SE3_sensor of the first.
        other_pose: world_SE3_sensor of the second.
        gate: largest horizontal distance (m) between two centres."""
    first_centres = transform(pose, mine.centres)
    second_centres = transform(other_pose, theirs.centres)
    if not (len(first_centres) and len(second_centres)):
        return _Matches(*_NO_MATCH)
    # x and y from each second centre to each first one, (first, second, 2)
    offsets = first_centres[:, None, :2] - second_centres[None, :, :2]
    distance = np.hypot(offsets[:, :, 0], offsets[:, :, 1])
    nearest_row = distance.argmin(axis=1)
    row = np.arange(len(first_centres))
    # for each first box, if the second one nearest to it has no nearer first box
    is_mutual = (distance[:, nearest_row].argmin(axis=0) == row) & (
        distance[row, nearest_row] < gate
    )
    heading = _find_headings(mine, pose)
    other_heading = _find_headings(theirs, other_pose)
    # to -90..90 degrees: boxes that are a half turn apart head alike
    turn = (heading - other_heading[nearest_row] + np.pi / 2) % np.pi - np.pi / 2
    is_matched = is_mutual & (np.abs(turn) < _MAX_HEADING_GAP_RAD)
    return _Matches(
        first=first_centres[is_matched],
        second=second_centres[nearest_row[is_matched]],
        turn=turn[is_matched],
    )


def _find_headings(boxes: SensorBoxes, pose: Pose) -> Float64[np.ndarray, " n"]:
    """Headings (rad, world frame) of boxes in a sensor's frame. pose: world_SE3_sensor."""
    ahead = boxes.ahead @ pose[:3, :3].T
    return np.arctan2(ahead[:, 1], ahead[:, 0])
