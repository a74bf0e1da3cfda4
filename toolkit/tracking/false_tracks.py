"""Tracks that are no road users: flickers on fixed things, and second tracks of one person."""

import numpy as np

from toolkit.arrays import Bool, BoxRows, Float64, Int64
from toolkit.boxes import iou_bev
from toolkit.objects import CYCLIST, PEDESTRIAN

MIN_WALKED_M = 0.7  # farther from its first place, a track has walked
# share of its frames in which somebody who stands in view is detected
MIN_DETECTED_SHARE = 0.8
MAX_GAP_FRAMES = 2  # of each gap that count; a long one is no flicker
MAX_WEIGHED_HITS = 20  # detections of a track that count when two tracks are compared
SAME_PERSON_IOU = 0.05  # above it, two people would stand in each other
MAX_WALKING_M_S = 2.5  # of adults in a hurry (Bohannon, Age and Ageing 26, 1997)
MAX_PERSON_REACH_M = 3.0  # distance of the centres of boxes that overlap so much


def count_frames(steps: Int64[np.ndarray, " k"]) -> Int64[np.ndarray, " k"]:
    """Number of frames in which a track should have been detected, of steps between detections.

    steps: frames from one detection to the next, 1 without a gap."""
    return np.minimum(steps, MAX_GAP_FRAMES + 1)


def is_flickering(
    labels: Int64[np.ndarray, " m"],
    walked_m: Float64[np.ndarray, " m"],
    hits: Int64[np.ndarray, " m"],
    frames: Int64[np.ndarray, " m"],
) -> Bool[np.ndarray, " m"]:
    """Mask of tracks of pedestrians that are false alarms on something fixed, such as a post.

    Somebody who waits has walked there, or is detected in nearly all frames unless hidden.

    Args:
        labels: Class of each track.
        walked_m: Largest distance (m) from its first place.
        hits: Number of its detections.
        frames: Number of its frames, see `count_frames`."""
    has_stayed = (labels == PEDESTRIAN) & (walked_m < MIN_WALKED_M)
    return has_stayed & (hits < MIN_DETECTED_SHARE * frames)


def weigh_tracks(
    scores: Float64[np.ndarray, " m"], hits: Int64[np.ndarray, " m"]
) -> Float64[np.ndarray, " m"]:
    """Weight of tracks by their mean score and number of detections, for `find_doubles`."""
    return scores * np.minimum(hits, MAX_WEIGHED_HITS)


def find_doubles(
    boxes: BoxRows,
    labels: Int64[np.ndarray, " n"],
    weights: Float64[np.ndarray, " n"],
    speeds: Float64[np.ndarray, " n"],
) -> Bool[np.ndarray, " n"]:
    """Mask of tracks at one instant that are in the place of a stronger one.

    Only people and cyclists are compared. A pedestrian is not dropped for a cyclist, since a
    detector that takes somebody on foot for a cyclist makes a larger box; but if both are faster
    than people walk, they are one cyclist.

    Args:
        boxes: Box of each track.
        labels: Class of each.
        weights: Weight of each, see `weigh_tracks`.
        speeds: Speed of each (m/s)."""
    is_double = np.zeros(len(boxes), np.bool_)
    rows = np.flatnonzero((labels == PEDESTRIAN) | (labels == CYCLIST))
    if len(rows) < 2:
        return is_double
    x = boxes[rows, 0]
    y = boxes[rows, 1]
    is_rival = np.hypot(x[:, None] - x, y[:, None] - y) < MAX_PERSON_REACH_M
    is_walker = labels[rows] == PEDESTRIAN
    is_mixed = is_walker[:, None] != is_walker
    is_fast = speeds[rows] > MAX_WALKING_M_S
    is_one_cyclist = is_mixed & is_fast[:, None] & is_fast
    # True at (i, j) if i is dropped for j
    is_dropped = weights[rows][:, None] < weights[rows]
    is_dropped &= ~(is_mixed & is_walker[:, None])
    is_rival &= np.where(is_one_cyclist, is_walker[:, None], is_dropped)
    near = rows[is_rival.any(axis=0) | is_rival.any(axis=1)]
    if not len(near):
        return is_double
    is_near = np.isin(rows, near)
    overlap = iou_bev(boxes[near], boxes[near])
    is_beaten = is_rival[np.ix_(is_near, is_near)] & (overlap > SAME_PERSON_IOU)
    is_double[near] = is_beaten.any(axis=1)
    return is_double
