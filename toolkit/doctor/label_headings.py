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

    samples: consecutive frames; undo: takes a frame and its moving boxes (n, 7), and returns the
    boxes without the mistake. Returns None if there are few tracks or boxes, or if undoing the
    mistake spoils more than a tenth as many boxes as it mends."""
    turned_tracks: set[int] = set()  # ids of tracks with a mended box
    mended_count = 0  # boxes that undoing the mistake turns along their motion
    spoilt_count = 0  # boxes that it turns against their motion
    moving_count = 0  # all moving boxes
    for k, sample in enumerate(samples):
        movers = find_moving(samples, k)
        # cosines between heading and motion
        cosines_before = _compare_headings(movers.boxes, movers.velocities)
        cosines_after = _compare_headings(undo(sample, movers.boxes), movers.velocities)
        is_mended = (cosines_before < 0) & (cosines_after > MIN_ALONG_COSINE)
        is_spoilt = (cosines_before > MIN_ALONG_COSINE) & (cosines_after < 0)
        turned_tracks |= set(movers.ids[is_mended].tolist())
        mended_count += int(is_mended.sum())
        spoilt_count += int(is_spoilt.sum())
        moving_count += len(movers.boxes)
    if len(turned_tracks) < MIN_TURNED_TRACKS or mended_count < MIN_FITTED_BOXES:
        return None
    if spoilt_count > mended_count / 10:
        return None
    return TurnedTracks(tracks=len(turned_tracks), boxes=mended_count, total=moving_count)


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
        counts = count_turned(samples, undo)
        if counts is not None:
            evidence = (
                f"{counts.boxes} of {counts.total} boxes that move, of {counts.tracks} objects, "
                "head against their way, and along it with that undone"
            )
            return [
                Finding(
                    severity="error",
                    where="labels",
                    suspected=YAW_SIGN.name,
                    evidence=evidence,
                    remedy=YAW_SIGN.remedy,
                )
            ]
    return []
