"""Road users that two sensors see at the same time, as rows of the joint system of `toolkit.calibration.joint`.

A detector finds boxes in the cloud of each sensor alone; boxes of two sensors that are each other's nearest, and head
the same way or the opposite one, are one road user, whose centres and headings must agree. Boxes are good to
decimetres, so they decide only what the standing scene leaves open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from toolkit.arrays import Float64
from toolkit.calibration.joint import Pairs, Poses
from toolkit.calibration.registration import LEVER, resistance
from toolkit.datasets.readings import Readable
from toolkit.frame import Frame
from toolkit.geometry import invert, transform
from toolkit.objects import Detector
from toolkit.points import detect_on_ground, frame_points
from toolkit.sites.site import Site

PAIR_GATE = 1.5  # m between the centres that two sensors give one road user, at first and at most
_LEAST_GATE = 0.8  # m
_CENTRE = 0.25  # m, standard deviation of a centre along each axis
_HEADING = float(np.deg2rad(4.0))  # standard deviation of a heading
_WORST_HEADING = float(np.deg2rad(20.0))  # between headings of one road user, up to a half turn
_NO_MATCH = (np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))


@runtime_checkable
class SitedRecording(Readable, Protocol):
    """Frames of a site."""

    @property
    def site(self) -> Site:
        """Where they were recorded."""


@dataclass(frozen=True, eq=False)
class SeenBoxes:
    """What one sensor said of one frame, in its own axes: centres (n, 3) and directions ahead (n, 3)."""

    centres: Float64[np.ndarray, "n 3"]
    ahead: Float64[np.ndarray, "n 3"]

    @classmethod
    def of(cls, boxes: Float64[np.ndarray, "n 7"], believed: Float64[np.ndarray, "4 4"]) -> SeenBoxes:
        """Boxes of the world that came of points placed by the believed pose."""
        ahead = np.column_stack([np.cos(boxes[:, 6]), np.sin(boxes[:, 6]), np.zeros(len(boxes))])
        return cls(transform(invert(believed), boxes[:, :3]), ahead @ believed[:3, :3])


SeenFrames = Sequence[Sequence[SeenBoxes]]  # of each frame, of each sensor


def seen_objects(recording: SitedRecording, frames: Sequence[Frame], detector: Detector) -> list[list[SeenBoxes]]:
    """What a detector finds in the cloud of each sensor alone, frame by frame."""
    seen = []
    for frame in frames:
        clouds = frame_points(frame, area=recording.site)
        boxes = [detect_on_ground(detector, cloud, recording.site).boxes for cloud in clouds]
        seen.append([SeenBoxes.of(found, sensor.pose) for found, sensor in zip(boxes, frame.sensors, strict=True)])
    return seen


def object_pairs(seen: SeenFrames, poses: Poses, radius: float) -> list[Pairs]:
    """The rows of all road users that two sensors see, at those poses: three for the centre, one for the heading."""
    gate = float(np.clip(radius, _LEAST_GATE, PAIR_GATE))
    made = []
    for one in range(len(poses)):
        for other in range(one + 1, len(poses)):
            matches = [_matched(frame[one], frame[other], poses[one], poses[other], gate) for frame in seen]
            here, there, turn = (np.concatenate(parts) for parts in zip(_NO_MATCH, *matches, strict=True))
            if len(here):
                made.append(_pairs(one, other, poses, (here, there, turn), gate))
    return made


def _matched(
    mine: SeenBoxes, theirs: SeenBoxes, pose: np.ndarray, other_pose: np.ndarray, gate: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres by the one and by the other sensor, and by how much the one's heading is ahead of the other's (rad)."""
    here, there = transform(pose, mine.centres), transform(other_pose, theirs.centres)
    if not (len(here) and len(there)):
        return _NO_MATCH
    apart = np.hypot(*(here[:, None, :2] - there[None, :, :2]).transpose(2, 0, 1))
    nearest = apart.argmin(axis=1)
    row = np.arange(len(here))
    mutual = (apart[:, nearest].argmin(axis=0) == row) & (apart[row, nearest] < gate)
    heading, other_heading = (
        np.arctan2(*(boxes.ahead @ at[:3, :3].T)[:, 1::-1].T) for boxes, at in ((mine, pose), (theirs, other_pose))
    )
    turn = (heading - other_heading[nearest] + np.pi / 2) % np.pi - np.pi / 2
    some = mutual & (np.abs(turn) < _WORST_HEADING)
    return here[some], there[nearest[some]], turn[some]


def _pairs(
    one: int, other: int, poses: Poses, matches: tuple[np.ndarray, np.ndarray, np.ndarray], gate: float
) -> Pairs:
    here, there, turn = matches
    count = len(here)
    axes = np.repeat(np.eye(3), count, axis=0)
    about_z = np.tile([0.0, 0.0, 1 / LEVER, 0.0, 0.0, 0.0], (count, 1))
    mine, theirs = (
        np.concatenate([resistance(np.tile(centres, (3, 1)), poses[sensor][:3, 3], axes), about_z])
        for sensor, centres in ((one, here), (other, there))
    )
    deviation = np.repeat([np.sqrt(2) * _CENTRE, np.sqrt(2) * _HEADING], [3 * count, count])
    limit = np.repeat([gate, _WORST_HEADING], [3 * count, count])
    return Pairs(one, other, mine, -theirs, np.concatenate([(here - there).T.ravel(), turn]), deviation, limit)
