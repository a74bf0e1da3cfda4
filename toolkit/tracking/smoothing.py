"""`smooth_tracks`: tracks of a whole recording, from all that was seen before and afterwards.

The tracker runs once; then each track gets one size, one class and one direction from all its
detections, its centres are anchored at the surer faces and smoothed forwards and backwards (Rauch,
Tung and Striebel 1965), and gaps between its detections are filled."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, BoxRows, Float64, Int64
from toolkit.geometry import smooth_rows
from toolkit.objects import LABELS, PEDESTRIAN, Detections
from toolkit.tracking.tracker import (
    ACCELERATIONS_M_S2,
    FIRST_SPEEDS_M_S,
    MIN_HEADED_M_S,
    Tracker,
    anchor_centres,
    centre_covariance,
    constant_velocity,
    get_doubts,
    turn_faces,
    weigh_sizes,
)
from toolkit.tracking.tracks import Tracks

YAW_SMOOTHING_S = 0.25  # standard deviation of the mean over time
FILLED_SHARE = 0.7  # score of a box that fills a gap, per score of the track
MAX_SLIP_RAD = np.radians(10.0)  # between heading and course, as in narrow bends
MIN_FILLING_HITS = 3  # detections of a track whose gaps are filled
MEDIAN_DETECTIONS = 7  # whose median heading a detection is compared with
MAX_TURN_RAD = np.radians(12.0)  # error of a heading, on top of the turn of the body
MAX_YAW_RATE_RAD_S = 1.5  # of a body on wheels
OUTLIER_DOUBT = 5.0  # factor of the doubts of a detection that cannot face so


class _TrackDetections(NamedTuple):
    """Detections of one track, in the order of time.

    Attributes:
        frame: Number of the frame of each.
        boxes: Their boxes.
        scores: Their scores.
        labels: Their classes.
        doubts: Doubts of their faces (m)."""

    frame: Int64[np.ndarray, " k"]
    boxes: BoxRows
    scores: Float64[np.ndarray, " k"]
    labels: Int64[np.ndarray, " k"]
    doubts: Float64[np.ndarray, "k 5"]


def smooth_tracks(
    frames: Sequence[Detections],
    times: Sequence[float],
    area: Sequence[float] | None = None,
    progress: Callable[[int], None] | None = None,
) -> list[Tracks]:
    """Return the tracks in each frame of a recording.

    Args:
        frames: Detections of each frame, in the world frame.
        times: Time of each frame (s), ascending.
        area: xmin, ymin, xmax, ymax (m, world) within which road users are detected, None for no
            border.
        progress: Called with the number of frames that the tracker has done.

    Raises ValueError for another number of times than of frames, and for times that do not go on.
    """
    if len(frames) != len(times):
        raise ValueError(f"each frame needs a time, got {len(frames)} and {len(times)}")
    seconds = np.asarray(times, np.float64)
    detections_by_track = _collect(frames, seconds, area, progress)
    parts = [_smooth_track(name, track, seconds) for name, track in detections_by_track.items()]
    frame_parts = [np.zeros(0, np.int64)]
    tracks_of_all = [Tracks(np.zeros((0, 7)), np.zeros(0), doubts=np.zeros((0, 5)))]
    for numbers, tracks in parts:
        frame_parts.append(numbers)
        tracks_of_all.append(tracks)
    columns = zip(*(vars(tracks).values() for tracks in tracks_of_all), strict=True)
    joined = Tracks(*map(np.concatenate, columns))
    frame = np.concatenate(frame_parts)
    order = np.lexsort((joined.ids, frame))
    begin = np.searchsorted(frame[order], np.arange(len(frames) + 1))
    return [joined[order[first:last]] for first, last in pairwise(begin.tolist())]


def _collect(
    frames: Sequence[Detections],
    times: Float64[np.ndarray, " f"],
    area: Sequence[float] | None,
    progress: Callable[[int], None] | None,
) -> dict[int, _TrackDetections]:
    """Run the tracker; return the detections of each track by its id.

    Arguments as in `smooth_tracks`."""
    tracker = Tracker(area)
    rows: dict[int, list[tuple[int, int]]] = {}  # frame and row of the detections of each track
    for k, (detections, time) in enumerate(zip(frames, times.tolist(), strict=True)):
        tracks = tracker.update(detections, time)
        for name, row in zip(tracks.ids.tolist(), tracker.detection_rows.tolist(), strict=True):
            if row >= 0:
                rows.setdefault(name, []).append((k, row))
        if progress is not None:
            progress(k + 1)
    detections_by_track = {}
    for name, places in rows.items():
        parts = [frames[k][[row]] for k, row in places]
        detections_by_track[name] = _TrackDetections(
            frame=np.array([k for k, _ in places]),
            boxes=np.concatenate([part.boxes for part in parts]),
            scores=np.concatenate([part.scores for part in parts]),
            labels=np.concatenate([part.labels for part in parts]),
            doubts=np.concatenate([get_doubts(part) for part in parts]),
        )
    return detections_by_track


def _smooth_track(
    name: int, track: _TrackDetections, times: Float64[np.ndarray, " frames"]
) -> tuple[Int64[np.ndarray, " f"], Tracks]:
    """Frames of a track, and a row of it for each.

    Args:
        name: Its id.
        track: Its detections.
        times: Time of each frame of the recording (s)."""
    first = int(track.frame[0])
    frames = np.arange(first, int(track.frame[-1]) + 1)
    seen = track.frame - first  # positions of the detections among these frames
    seconds = times[frames]
    label = int(np.bincount(track.labels, track.scores, len(LABELS)).argmax())
    yaw = _settle_heading(track, times[track.frame])
    doubts = turn_faces(track.doubts, np.cos(track.boxes[:, 6] - yaw) < 0)
    if label != PEDESTRIAN:
        usual_yaw, is_outlier = _find_outliers(yaw, times[track.frame])
        yaw = np.where(is_outlier, usual_yaw, yaw)
        doubts = np.where(is_outlier[:, None], OUTLIER_DOUBT * doubts, doubts)
    weights = weigh_sizes(doubts)
    size = (weights * track.boxes[:, 3:6]).sum(axis=0) / weights.sum(axis=0)
    sizes = np.tile(size, (len(seen), 1))
    centres = anchor_centres(track.boxes, yaw, sizes, doubts)
    noise = centre_covariance(yaw, doubts)
    motion = _smooth_motion(centres, noise, seen, seconds, label)
    if label != PEDESTRIAN:
        yaw = _keep_near_course(yaw, motion[seen, 2:])
    all_yaws = _smooth_over_time(yaw, times[track.frame], seconds)
    floor = _smooth_over_time(
        track.boxes[:, 2] - track.boxes[:, 5] / 2, times[track.frame], seconds
    )
    # the last detection at each frame, which may be of an earlier one
    last_rows = np.searchsorted(seen, np.arange(len(frames)), side="right") - 1
    unseen = seconds - seconds[seen[last_rows]]
    score = track.scores.mean()
    scores = np.where(unseen > 0, FILLED_SHARE * score, score)
    boxes = np.empty((len(frames), 7))
    boxes[:, :2] = motion[:, :2]
    boxes[:, 2] = floor + size[2] / 2
    boxes[:, 3:6] = size
    boxes[:, 6] = np.arctan2(np.sin(all_yaws), np.cos(all_yaws))
    tracks = Tracks(
        boxes=boxes,
        scores=scores,
        labels=np.full(len(frames), label),
        doubts=doubts[last_rows],
        ids=np.full(len(frames), name),
        velocities=np.column_stack([motion[:, 2:], np.zeros(len(frames))]),
        ages=seconds - seconds[0],
        unseen=unseen,
    )
    is_kept = (unseen == 0) | (len(seen) >= MIN_FILLING_HITS)
    return frames[is_kept], tracks[is_kept]


def _settle_heading(
    track: _TrackDetections, seconds: Float64[np.ndarray, " k"]
) -> Float64[np.ndarray, " k"]:
    """Heading (rad, continuous) of a track at its detections, without half turns.

    The front is where it moves to; of a track that stands, where most detections have it. seconds:
    time of each detection."""
    raw = track.boxes[:, 6]
    # doubled angles do not know half turns
    yaw = np.unwrap(2 * raw) / 2
    backwards = np.sign(np.cos(raw - yaw)) @ track.scores < 0
    offset = track.boxes[-1, :2] - track.boxes[0, :2]
    passed = seconds[-1] - seconds[0]
    if len(raw) > 1 and np.hypot(*offset) > max(MIN_HEADED_M_S * passed / 3, 2.0):
        steps = np.diff(track.boxes[:, :2], axis=0)
        along = steps[:, 0] * np.cos(yaw[1:]) + steps[:, 1] * np.sin(yaw[1:])
        backwards = bool(along.sum() < 0)
    return yaw + np.pi if backwards else yaw


def _find_outliers(
    yaw: Float64[np.ndarray, " k"], seconds: Float64[np.ndarray, " k"]
) -> tuple[Float64[np.ndarray, " k"], Bool[np.ndarray, " k"]]:
    """Median heading (rad) around each detection, and a mask of those too far from it.

    At the border of the area a body of which a corner is left is detected across its course. yaw:
    heading of each detection (rad, continuous); seconds: time of each."""
    from scipy.ndimage import median_filter

    count = len(yaw)
    if count < MEDIAN_DETECTIONS:
        return yaw, np.zeros(count, np.bool_)
    median = median_filter(yaw, MEDIAN_DETECTIONS, mode="mirror")
    half = MEDIAN_DETECTIONS // 2
    rows = np.arange(count)
    span = seconds[np.minimum(rows + half, count - 1)] - seconds[np.maximum(rows - half, 0)]
    max_turn = MAX_TURN_RAD + MAX_YAW_RATE_RAD_S * span / 2
    return median, np.abs(yaw - median) > max_turn


def _keep_near_course(
    yaw: Float64[np.ndarray, " k"], velocities: Float64[np.ndarray, "k 2"]
) -> Float64[np.ndarray, " k"]:
    """Headings (rad) no farther than `MAX_SLIP_RAD` from the course of what moves.

    So a body of which little is seen at the border does not turn. velocities: along x and y (m/s).
    """
    course = np.arctan2(velocities[:, 1], velocities[:, 0])
    slip = np.arctan2(np.sin(yaw - course), np.cos(yaw - course))
    is_moving = np.hypot(velocities[:, 0], velocities[:, 1]) > MIN_HEADED_M_S
    kept_slip = np.where(is_moving, np.clip(slip, -MAX_SLIP_RAD, MAX_SLIP_RAD), slip)
    return yaw + kept_slip - slip


def _smooth_over_time(
    values: Float64[np.ndarray, " k"],
    known_seconds: Float64[np.ndarray, " k"],
    seconds: Float64[np.ndarray, " f"],
) -> Float64[np.ndarray, " f"]:
    """Means over time of values that are known at some times, at all frames.

    known_seconds: times of the values; seconds: times of the frames."""
    filled = np.interp(seconds, known_seconds, values)
    if len(seconds) < 3:
        return filled
    sigma = YAW_SMOOTHING_S / float(np.median(np.diff(seconds)))
    return smooth_rows(filled[:, None], sigma)[:, 0]


def _smooth_motion(
    centres: Float64[np.ndarray, "k 2"],
    noise: Float64[np.ndarray, "k 2 2"],
    seen: Int64[np.ndarray, " k"],
    seconds: Float64[np.ndarray, " f"],
    label: int,
) -> Float64[np.ndarray, "f 4"]:
    """Positions and velocities in all frames: Kalman's filter, then its smoother backwards.

    Args:
        centres: Measured x, y (m) of each detection.
        noise: Covariance of each.
        seen: Frame of each detection.
        seconds: Time of each frame.
        label: Class of the track."""
    count = len(seconds)
    detection_row = np.full(count, -1)
    detection_row[seen] = np.arange(len(seen))
    state = np.zeros(4)
    state[:2] = centres[0]
    covariance = np.diag([0.0, 0.0, 1.0, 1.0]) * FIRST_SPEEDS_M_S[label] ** 2
    covariance[:2, :2] = noise[0]
    states = np.empty((count, 4))
    covariances = np.empty((count, 4, 4))
    predicted_states = np.empty((count, 4))
    predicted_covariances = np.empty((count, 4, 4))
    transitions = np.empty((count, 4, 4))
    states[0] = state
    covariances[0] = covariance
    variance = ACCELERATIONS_M_S2[label] ** 2
    for k in range(1, count):
        transition, step_noise = constant_velocity(float(seconds[k] - seconds[k - 1]))
        state = transition @ state
        covariance = transition @ covariance @ transition.T + variance * step_noise
        transitions[k] = transition
        predicted_states[k] = state
        predicted_covariances[k] = covariance
        row = detection_row[k]
        if row >= 0:
            gain = covariance[:, :2] @ np.linalg.inv(covariance[:2, :2] + noise[row])
            state = state + gain @ (centres[row] - state[:2])
            covariance = covariance - gain @ covariance[:2]
        states[k] = state
        covariances[k] = covariance
    for k in range(count - 2, -1, -1):
        inverse = np.linalg.inv(predicted_covariances[k + 1])
        gain = covariances[k] @ transitions[k + 1].T @ inverse
        states[k] += gain @ (states[k + 1] - predicted_states[k + 1])
    return states
