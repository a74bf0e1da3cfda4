"""Headings of a track, from all its detections.

Detectors take a body's front for its rear, and at the border of the area the corner that is left of
a body for a small one across its course.
"""

import numpy as np

from toolkit.arrays import Bool, BoxRows, Float64
from toolkit.tracking.track_states import MIN_HEADED_M_S

MAX_SLIP_RAD = np.radians(10.0)  # between heading and course, as in narrow bends
MEDIAN_DETECTIONS = 7  # whose median heading a detection is compared with
MAX_HEADING_GAP_RAD = np.radians(12.0)  # error of a heading, on top of the turn of the body
MAX_YAW_RATE_RAD_S = 1.5  # no body on wheels turns faster


def settle_heading(
    boxes: BoxRows, scores: Float64[np.ndarray, " k"], seconds: Float64[np.ndarray, " k"]
) -> Float64[np.ndarray, " k"]:
    """Heading (rad, continuous) of a track at its detections, without half turns.

    The front points the way it moves; if it stands, the way most detections face, by their scores.

    Args:
        boxes: Detections of the track, in the order of time.
        scores: Score of each.
        seconds: Time of each (s)."""
    detected_yaw = boxes[:, 6]
    # doubled angles do not know half turns
    yaw = np.unwrap(2 * detected_yaw) / 2
    is_backwards = np.sign(np.cos(detected_yaw - yaw)) @ scores < 0
    offset = boxes[-1, :2] - boxes[0, :2]
    span = seconds[-1] - seconds[0]
    # from its first to its last place, a third of the speed is enough: it may have stood in between
    if len(yaw) > 1 and np.hypot(*offset) > max(MIN_HEADED_M_S * span / 3, 2.0):
        steps = np.diff(boxes[:, :2], axis=0)
        along = steps[:, 0] * np.cos(yaw[1:]) + steps[:, 1] * np.sin(yaw[1:])
        is_backwards = bool(along.sum() < 0)
    return yaw + np.pi if is_backwards else yaw


def find_heading_outliers(
    yaw: Float64[np.ndarray, " k"], seconds: Float64[np.ndarray, " k"]
) -> tuple[Float64[np.ndarray, " k"], Bool[np.ndarray, " k"]]:
    """Median heading (rad) around each detection, and a mask of headings too far from it.

    At the border of the area, where a corner of a body is left, detections face across its course.
    Less than `MEDIAN_DETECTIONS` have no median: then their headings come back, none an outlier.

    Args:
        yaw: Heading of each detection (rad, continuous).
        seconds: Time of each (s), ascending."""
    from scipy.ndimage import median_filter

    count = len(yaw)
    if count < MEDIAN_DETECTIONS:
        return yaw, np.zeros(count, np.bool_)
    median = median_filter(yaw, MEDIAN_DETECTIONS, mode="mirror")
    half = MEDIAN_DETECTIONS // 2
    rows = np.arange(count)
    # from the first to the last detection of each median; the median is in its middle
    span = seconds[np.minimum(rows + half, count - 1)] - seconds[np.maximum(rows - half, 0)]
    max_turn = MAX_HEADING_GAP_RAD + MAX_YAW_RATE_RAD_S * span / 2
    return median, np.abs(yaw - median) > max_turn


def keep_near_course(
    yaw: Float64[np.ndarray, " k"], velocities: Float64[np.ndarray, "k 2"]
) -> Float64[np.ndarray, " k"]:
    """Headings (rad), of moving bodies at most `MAX_SLIP_RAD` from their course.

    So a body that is hardly seen at the border does not turn.

    Args:
        yaw: Heading of a body at k times (rad).
        velocities: Velocity along x and y (m/s) at these times."""
    course = np.arctan2(velocities[:, 1], velocities[:, 0])
    slip = np.arctan2(np.sin(yaw - course), np.cos(yaw - course))
    is_moving = np.hypot(velocities[:, 0], velocities[:, 1]) > MIN_HEADED_M_S
    kept_slip = np.where(is_moving, np.clip(slip, -MAX_SLIP_RAD, MAX_SLIP_RAD), slip)
    return yaw + kept_slip - slip
