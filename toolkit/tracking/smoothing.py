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
from toolkit.tracking.motion_smoothing import MeasuredCourse, smooth_motions
from toolkit.tracking.tracker import (
    MIN_HEADED_M_S,
    Tracker,
    anchor_centres,
    centre_covariance,
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
MAX_HEADING_GAP_RAD = np.radians(12.0)  # error of a heading, on top of the turn of the body
MAX_YAW_RATE_RAD_S = 1.5  # no body on wheels turns faster
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

    def select(self, rows: slice | Int64[np.ndarray, " m"]) -> "_TrackDetections":
        """Some of the detections."""
        return _TrackDetections(*(column[rows] for column in self))


class _SingleDetections(NamedTuple):
    """Tracks of one detection each.

    Attributes:
        ids: Their ids.
        detections: Detection of each."""

    ids: Int64[np.ndarray, " m"]
    detections: _TrackDetections


class _TrackRows(NamedTuple):
    """Frames of tracks, and columns of `Tracks` in each."""

    frame: Int64[np.ndarray, " n"]
    boxes: BoxRows
    scores: Float64[np.ndarray, " n"]
    labels: Int64[np.ndarray, " n"]
    doubts: Float64[np.ndarray, "n 5"]
    ids: Int64[np.ndarray, " n"]
    velocities: Float64[np.ndarray, "n 3"]
    ages: Float64[np.ndarray, " n"]
    unseen: Float64[np.ndarray, " n"]


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
    single, detections_by_track = _collect(frames, seconds, area, progress)
    settled = [_settle_track(name, track, seconds) for name, track in detections_by_track.items()]
    motions = smooth_motions([track.course for track in settled])
    parts = [_make_single_rows(single)]
    for track, motion in zip(settled, motions, strict=True):
        parts.append(_make_rows(track, detections_by_track[track.name], motion))
    columns = [np.concatenate(values) for values in zip(*parts, strict=True)]
    rows = _TrackRows(*columns)
    order = np.lexsort((rows.ids, rows.frame))
    joined = Tracks(*(column[order] for column in rows[1:]))
    begin = np.searchsorted(rows.frame[order], np.arange(len(frames) + 1))
    return [joined[first:last] for first, last in pairwise(begin.tolist())]


def _collect(
    frames: Sequence[Detections],
    times: Float64[np.ndarray, " f"],
    area: Sequence[float] | None,
    progress: Callable[[int], None] | None,
) -> tuple[_SingleDetections, dict[int, _TrackDetections]]:
    """Run the tracker; return tracks of one detection, and the detections of others by their id.

    Arguments as in `smooth_tracks`."""
    tracker = Tracker(area)
    no_numbers = np.zeros(0, np.int64)
    track_parts = [no_numbers]  # track of each detection that has one
    frame_parts = [no_numbers]  # frame of each
    row_parts = [no_numbers]  # row of each among the detections of all frames
    first_row = 0
    for k, (detections, time) in enumerate(zip(frames, times.tolist(), strict=True)):
        tracks = tracker.update(detections, time)
        is_detected = tracker.detection_rows >= 0
        track_parts.append(tracks.ids[is_detected])
        frame_parts.append(np.full(int(is_detected.sum()), k))
        row_parts.append(first_row + tracker.detection_rows[is_detected])
        first_row += len(detections)
        if progress is not None:
            progress(k + 1)
    everything = Detections.merge(frames)
    doubts = np.concatenate([np.zeros((0, 5)), *map(get_doubts, frames)])
    track_ids = np.concatenate(track_parts)
    order = np.argsort(track_ids, kind="stable")
    track_ids = track_ids[order]
    rows = np.concatenate(row_parts)[order]
    tracked = _TrackDetections(
        frame=np.concatenate(frame_parts)[order],
        boxes=everything.boxes[rows],
        scores=everything.scores[rows],
        labels=everything.labels[rows],
        doubts=doubts[rows],
    )
    names, begins = np.unique(track_ids, return_index=True)
    counts = np.diff(np.append(begins, len(track_ids)))
    is_single = counts == 1
    detections_by_track = {}
    several = zip(names[~is_single], begins[~is_single], counts[~is_single], strict=True)
    for name, begin, count in several:
        detections_by_track[int(name)] = tracked.select(slice(begin, begin + count))
    single = _SingleDetections(names[is_single], tracked.select(begins[is_single]))
    return single, detections_by_track


class _Settled(NamedTuple):
    """Track whose class, size and heading are known, but not its motion.

    Attributes:
        name: Its id.
        label: Its class.
        size: Length, width, height (m).
        frames: Its frames in the recording.
        yaw: Heading at its detections (rad, continuous).
        doubts: Doubts of the detections' faces, by this heading (m).
        course: Measured places."""

    name: int
    label: int
    size: Float64[np.ndarray, "3"]
    frames: Int64[np.ndarray, " f"]
    yaw: Float64[np.ndarray, " k"]
    doubts: Float64[np.ndarray, "k 5"]
    course: MeasuredCourse


def _settle_track(
    name: int, track: _TrackDetections, times: Float64[np.ndarray, " frames"]
) -> _Settled:
    """Find the class, size and heading of a track, and the places of its centre.

    Args:
        name: Its id.
        track: Its detections.
        times: Time of each frame of the recording (s)."""
    first = int(track.frame[0])
    frames = np.arange(first, int(track.frame[-1]) + 1)
    label = int(np.bincount(track.labels, track.scores, len(LABELS)).argmax())
    yaw = _settle_heading(track, times[track.frame])
    doubts = turn_faces(track.doubts, np.cos(track.boxes[:, 6] - yaw) < 0)
    if label != PEDESTRIAN:
        usual_yaw, is_outlier = _find_outliers(yaw, times[track.frame])
        yaw = np.where(is_outlier, usual_yaw, yaw)
        doubts = np.where(is_outlier[:, None], OUTLIER_DOUBT * doubts, doubts)
    weights = weigh_sizes(doubts)
    size = (weights * track.boxes[:, 3:6]).sum(axis=0) / weights.sum(axis=0)
    sizes = np.tile(size, (len(yaw), 1))
    course = MeasuredCourse(
        centres=anchor_centres(track.boxes, yaw, sizes, doubts),
        noise=centre_covariance(yaw, doubts),
        seen=track.frame - first,
        seconds=times[frames],
        label=label,
    )
    return _Settled(name, label, size, frames, yaw, doubts, course)


def _make_single_rows(single: _SingleDetections) -> _TrackRows:
    """Rows of tracks of one detection: that detection, at rest."""
    count = len(single.ids)
    detections = single.detections
    yaw = detections.boxes[:, 6]
    boxes = detections.boxes.copy()
    boxes[:, 6] = np.arctan2(np.sin(yaw), np.cos(yaw))
    return _TrackRows(
        frame=detections.frame,
        boxes=boxes,
        scores=detections.scores,
        labels=detections.labels,
        doubts=detections.doubts,
        ids=single.ids,
        velocities=np.zeros((count, 3)),
        ages=np.zeros(count),
        unseen=np.zeros(count),
    )


def _make_rows(
    settled: _Settled, track: _TrackDetections, motion: Float64[np.ndarray, "f 4"]
) -> _TrackRows:
    """Rows of a track in its frames.

    Args:
        settled: The track.
        track: Its detections.
        motion: x, y (m) and their velocities (m/s) in each of its frames."""
    frames = settled.frames
    seconds = settled.course.seconds
    seen = settled.course.seen
    yaw = settled.yaw
    if settled.label != PEDESTRIAN:
        yaw = _keep_near_course(yaw, motion[seen, 2:])
    all_yaws = _smooth_over_time(yaw, seconds[seen], seconds)
    floor = _smooth_over_time(track.boxes[:, 2] - track.boxes[:, 5] / 2, seconds[seen], seconds)
    # the last detection at each frame, which may be of an earlier one
    last_rows = np.searchsorted(seen, np.arange(len(frames)), side="right") - 1
    unseen = seconds - seconds[seen[last_rows]]
    score = track.scores.mean()
    scores = np.where(unseen > 0, FILLED_SHARE * score, score)
    boxes = np.empty((len(frames), 7))
    boxes[:, :2] = motion[:, :2]
    boxes[:, 2] = floor + settled.size[2] / 2
    boxes[:, 3:6] = settled.size
    boxes[:, 6] = np.arctan2(np.sin(all_yaws), np.cos(all_yaws))
    is_kept = (unseen == 0) | (len(seen) >= MIN_FILLING_HITS)
    rows = _TrackRows(
        frame=frames,
        boxes=boxes,
        scores=scores,
        labels=np.full(len(frames), settled.label),
        doubts=settled.doubts[last_rows],
        ids=np.full(len(frames), settled.name),
        velocities=np.column_stack([motion[:, 2:], np.zeros(len(frames))]),
        ages=seconds - seconds[0],
        unseen=unseen,
    )
    return _TrackRows(*(column[is_kept] for column in rows))


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
    """Median heading (rad) around each detection, and a mask of headings too far from it.

    At the border of the area, where a corner of a body is left, detections face across its course.
    yaw: heading of each detection (rad, continuous); seconds: time of each."""
    from scipy.ndimage import median_filter

    count = len(yaw)
    if count < MEDIAN_DETECTIONS:
        return yaw, np.zeros(count, np.bool_)
    median = median_filter(yaw, MEDIAN_DETECTIONS, mode="mirror")
    half = MEDIAN_DETECTIONS // 2
    rows = np.arange(count)
    span = seconds[np.minimum(rows + half, count - 1)] - seconds[np.maximum(rows - half, 0)]
    max_turn = MAX_HEADING_GAP_RAD + MAX_YAW_RATE_RAD_S * span / 2
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
