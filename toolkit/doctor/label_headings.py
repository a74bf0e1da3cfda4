"""Headings against the direction of motion."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import BoxRows, Float64
from toolkit.doctor.box_fits import MIN_FITTED_BOXES
from toolkit.doctor.findings import Finding
from toolkit.doctor.label_mistake import undo_mistake
from toolkit.doctor.label_mistakes import YAW_SIGN
from toolkit.doctor.moving_boxes import find_moving
from toolkit.frame import Frame

MIN_ALONG_COSINE = 0.7  # least cosine between heading and direction of motion that agree
MIN_TURNED_TRACKS = 2  # least number of tracks that head along their motion only without a mistake


class TurnedTracks(NamedTuple):
    """Counts of moving boxes that head against their motion, but along it without a mistake.

    Attributes:
        tracks: number of tracks with such a box.
        boxes: number of such boxes.
        total: number of all moving boxes."""

    tracks: int
    boxes: int
    total: int


def count_turned(samples: Sequence[Frame], undo: Callable[..., np.ndarray]) -> TurnedTracks | None:
    """Count tracks and boxes that a mistake turns against their motion, and all moving boxes.

    samples: consecutive frames; undo: takes a frame and its moving boxes, and returns the boxes
    without the mistake. Returns None if they are few, or if undoing it spoils many boxes."""
    turned_tracks: set[int] = set()
    # boxes that undoing the mistake turns along their motion, or against it, and all
    mended_count = 0
    spoilt_count = 0
    total = 0
    for k, sample in enumerate(samples):
        movers = find_moving(samples, k)
        # cosines between heading and motion
        before = _compare_headings(movers.boxes, movers.velocities)
        after = _compare_headings(undo(sample, movers.boxes), movers.velocities)
        is_mended = (before < 0) & (after > MIN_ALONG_COSINE)
        is_spoilt = (before > MIN_ALONG_COSINE) & (after < 0)
        turned_tracks |= set(movers.ids[is_mended].tolist())
        mended_count += int(is_mended.sum())
        spoilt_count += int(is_spoilt.sum())
        total += len(movers.boxes)
    if len(turned_tracks) < MIN_TURNED_TRACKS or mended_count < MIN_FITTED_BOXES:
        return None
    if spoilt_count > mended_count / 10:
        return None
    return TurnedTracks(tracks=len(turned_tracks), boxes=mended_count, total=total)


def _compare_headings(
    boxes: BoxRows, velocities: Float64[np.ndarray, "n 2"]
) -> Float64[np.ndarray, " n"]:
    """Cosine between each box's heading and its direction of motion.

    velocities: along x and y, in the frame of the boxes (m/s)."""
    speeds = np.linalg.norm(velocities, axis=1, keepdims=True)
    direction_x, direction_y = (velocities / np.maximum(speeds, 1e-9)).T
    yaw = boxes[:, 6]
    return np.cos(yaw) * direction_x + np.sin(yaw) * direction_y


def suspect_headings(samples: Sequence[Frame]) -> list[Finding]:
    """Find moving boxes whose yaw has the wrong sign, in the world or in the map.

    samples: consecutive frames. Returns one finding or none."""
    undos = (  # each takes a frame and its boxes
        lambda _, boxes: YAW_SIGN.undo(boxes),
        lambda sample, boxes: undo_mistake(YAW_SIGN, boxes, sample.map_SE3_world),
    )
    for undo in undos:
        turned = count_turned(samples, undo)
        if turned is not None:
            evidence = (
                f"{turned.boxes} of {turned.total} boxes that move, of {turned.tracks} objects, "
                "head against their way, and along it with that undone"
            )
            return [Finding("error", "labels", YAW_SIGN.name, evidence, YAW_SIGN.remedy)]
    return []
