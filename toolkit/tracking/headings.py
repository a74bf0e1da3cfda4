"""Headings of a track, from all its detections.

Detectors take a body's front for its rear, and at the border of the area the corner that is left of
a body for a small one across its course.
"""

import numpy as np

from toolkit.arrays import Bool, BoxRows, Float64
from toolkit.tracking.track_states import MIN_HEADED_M_S

MAX_SLIP_RAD = np.radians(10.0)  # between heading and course of a car, as in narrow bends
MIN_RADIUS_M = 10.0  # radius of a bend that the middle of a body takes; long bodies slip more
REFERENCE_S = 0.35  # time around a detection in which others show how the body faces and moves
MEDIAN_DETECTIONS = 7  # whose median heading a detection is compared with
MAX_HEADING_GAP_RAD = np.radians(12.0)  # error of a heading, on top of the turn of the body
MAX_YAW_RATE_RAD_S = 1.5  # no body on wheels turns faster


def settle_heading(
    boxes: BoxRows,
    scores: Float64[np.ndarray, " k"],
    seconds: Float64[np.ndarray, " k"],
    label: int,
) -> Float64[np.ndarray, " k"]:
    """Heading (rad, continuous) of a track at its detections, without half turns.

    The front points the way it moves; if it stands, the way most detections face, by their scores.

    Args:
        boxes: Detections of the track, in the order of time.
        scores: Score of each.
        seconds: Time of each (s).
        label: Class of the track."""
    detected_yaw = boxes[:, 6]
    axes = _find_axes(detected_yaw, scores, seconds)
    yaw = detected_yaw + np.pi * np.rint((axes - detected_yaw) / np.pi)
    is_backwards = np.sign(np.cos(detected_yaw - yaw)) @ scores < 0
    offset = boxes[-1, :2] - boxes[0, :2]
    span = seconds[-1] - seconds[0]
    # from its first to its last place, a third of the speed or its length is enough: it may have
    # stood in between
    min_offset_m = min(MIN_HEADED_M_S[label] * span / 3, np.median(boxes[:, 3]))
    if len(yaw) > 1 and np.hypot(*offset) > max(min_offset_m, 2.0):
        steps = np.diff(boxes[:, :2], axis=0)
        along = steps[:, 0] * np.cos(yaw[1:]) + steps[:, 1] * np.sin(yaw[1:])
        is_backwards = bool(along.sum() < 0)
    return yaw + np.pi if is_backwards else yaw


def _find_axes(
    yaw: Float64[np.ndarray, " k"],
    scores: Float64[np.ndarray, " k"],
    seconds: Float64[np.ndarray, " k"],
) -> Float64[np.ndarray, " k"]:
    """Mean axis (rad, continuous) of the detections within `REFERENCE_S` of each.

    A few that face across the body do not turn those after them.

    Args:
        yaw: Heading of each detection (rad).
        scores: Score of each.
        seconds: Time of each (s), ascending."""
    # doubled angles do not know half turns
    directions = np.append(0.0, np.cumsum(scores * np.exp(2j * yaw)))
    first = np.searchsorted(seconds, seconds - REFERENCE_S)
    last = np.searchsorted(seconds, seconds + REFERENCE_S, side="right")
    return np.unwrap(np.angle(directions[last] - directions[first])) / 2


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
    yaw: Float64[np.ndarray, " k"],
    motion: Float64[np.ndarray, "k 4"],
    seconds: Float64[np.ndarray, " k"],
    length: float,
    label: int,
) -> Float64[np.ndarray, " k"]:
    """Headings (rad, continuous) that do not slip too far from the course of what moves.

    So a body that is hardly seen at the border does not turn. In a bend the middle of a body
    slips by the angle whose sine is half its length by the radius; `MAX_SLIP_RAD` is allowed to
    all.

    Args:
        yaw: Headings.
        motion: x, y (m) and velocities along both (m/s).
        seconds: Time of each (s), ascending.
        length: Length of the body (m).
        label: Its class."""
    min_headed = MIN_HEADED_M_S[label]
    max_slip = max(MAX_SLIP_RAD, np.arcsin(min(1.0, length / 2 / MIN_RADIUS_M)))
    course = np.arctan2(motion[:, 3], motion[:, 2])
    slip = np.arctan2(np.sin(yaw - course), np.cos(yaw - course))
    # a body at rest may seem to move for a moment, but does not get on
    first = np.searchsorted(seconds, seconds - REFERENCE_S)
    last = np.searchsorted(seconds, seconds + REFERENCE_S, side="right") - 1
    steps = motion[last, :2] - motion[first, :2]
    way = steps[:, 0] * np.cos(course) + steps[:, 1] * np.sin(course)
    is_moving = way > min_headed * (seconds[last] - seconds[first])
    is_moving &= np.hypot(motion[:, 2], motion[:, 3]) > min_headed
    kept_slip = np.where(is_moving, np.clip(slip, -max_slip, max_slip), slip)
    return np.unwrap(yaw + kept_slip - slip)
