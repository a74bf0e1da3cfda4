"""`smooth_tracks`: tracks of a whole recording, from all that was seen before and afterwards.

The tracker runs once; then each track gets one size, one class and one direction from all its
detections, its centres are anchored at the surer faces and smoothed forwards and backwards (Rauch,
Tung and Striebel 1965), and gaps between its detections are filled."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from toolkit.arrays import BoxRows, Float64, Int64
from toolkit.geometry import smooth_rows
from toolkit.objects import CYCLIST, LABELS, PEDESTRIAN, Detections
from toolkit.tracking.face_doubts import (
    USUAL_MISFIT,
    anchor_centres,
    centre_covariance,
    combine_doubts,
    doubt_outer_faces,
    doubt_sizes,
    estimate_size,
    extend_outer_ends,
    find_misfit,
    get_doubts,
    inflate_doubts,
    turn_faces,
    weigh_sizes,
)
from toolkit.tracking.false_tracks import count_frames, find_doubles, is_flickering, weigh_tracks
from toolkit.tracking.headings import find_heading_outliers, keep_near_course, settle_heading
from toolkit.tracking.motion_model import is_too_fast_to_run
from toolkit.tracking.motion_smoothing import MeasuredCourse, smooth_motions
from toolkit.tracking.track_states import has_evidence
from toolkit.tracking.tracker import TENTATIVE_SCORE, Tracker
from toolkit.tracking.tracks import Tracks

YAW_SMOOTHING_S = 0.25  # standard deviation of the mean over time
FILLED_SHARE = 0.7  # score of a box that fills a gap, per score of the track
OUTLIER_DOUBT = 5.0  # factor of the doubts of a detection that cannot face so
MIN_FAST_DETECTIONS = 10  # that show a way too fast for a runner; fewer may be another body's


class _TrackDetections(NamedTuple):
    """k detections of one track, in the order of time.

    Attributes:
        frame: Number of the frame of each.
        boxes: Their boxes.
        scores: Their scores.
        labels: Their classes.
        doubts: Expected error (m) of their front, rear, left, right and top."""

    frame: Int64[np.ndarray, " k"]
    boxes: BoxRows
    scores: Float64[np.ndarray, " k"]
    labels: Int64[np.ndarray, " k"]
    doubts: Float64[np.ndarray, "k 5"]

    def select(self, rows: slice | Int64[np.ndarray, " m"]) -> "_TrackDetections":
        """Select detections by a slice or by row numbers."""
        return _TrackDetections(*(column[rows] for column in self))


class _SingleDetections(NamedTuple):
    """m tracks of one detection each.

    Attributes:
        ids: Their ids.
        detections: Detection of each track, a row for each."""

    ids: Int64[np.ndarray, " m"]
    detections: _TrackDetections


class _TrackRows(NamedTuple):
    """Rows of tracks in frames, in columns: the number of the frame, then the columns of `Tracks`.

    The order of the columns after `frame` must be the one in `Tracks`."""

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
    *,
    place_error: float = 0.0,
) -> list[Tracks]:
    """Return the tracks in each frame of a recording.

    Tracks that their detections do not confirm are left out, unless their mean score is at least
    `TENTATIVE_SCORE`.

    Args:
        frames: Detections of each frame, in the world frame.
        times: Time of each frame (s), ascending.
        area: xmin, ymin, xmax, ymax (m, world) within which road users are detected, None for no
            border.
        progress: Called with the number of frames that the tracker has done.
        place_error: Expected error (m) of places that all frames share, as from the sensors' poses.

    Raises ValueError for another number of times than of frames, and for times that do not go on.
    """
    if len(frames) != len(times):
        raise ValueError(f"each frame needs a time, got {len(frames)} and {len(times)}")
    seconds = np.asarray(times, np.float64)
    single, detections_by_track = _collect(frames, seconds, area, progress)
    settled = [_settle_track(name, track, seconds) for name, track in detections_by_track.items()]
    motions = smooth_motions([track.course for track in settled])
    parts = [_make_single_rows(single, place_error)]
    for track, motion in zip(settled, motions, strict=True):
        if _is_fixed(track, motion):
            continue
        parts.append(_make_rows(track, detections_by_track[track.name], motion, place_error))
    columns = [np.concatenate(values) for values in zip(*parts, strict=True)]
    rows = _TrackRows(*columns)
    order = np.lexsort((rows.ids, rows.frame))
    joined = Tracks(*(column[order] for column in rows[1:]))
    begins = np.searchsorted(rows.frame[order], np.arange(len(frames) + 1))
    hits = {name: len(track.frame) for name, track in detections_by_track.items()}
    tracks_by_frame = []
    for first, last in pairwise(begins.tolist()):
        tracks = joined[first:last]
        track_hits = np.array([hits.get(name, 1) for name in tracks.ids.tolist()], np.int64)
        weights = weigh_tracks(tracks.scores, track_hits)
        is_double = find_doubles(tracks.boxes, tracks.labels, weights, tracks.speeds)
        tracks_by_frame.append(tracks[~is_double] if is_double.any() else tracks)
    return tracks_by_frame


def _collect(
    frames: Sequence[Detections],
    times: Float64[np.ndarray, " f"],
    area: Sequence[float] | None,
    progress: Callable[[int], None] | None,
) -> tuple[_SingleDetections, dict[int, _TrackDetections]]:
    """Run the tracker; return tracks of one detection, and the detections of others by their id.

    Only tracks that are reported are returned: confirmed ones and those with a sure mean score.

    Args:
        frames: Detections of each frame, in the world frame.
        times: Time of each frame (s), ascending.
        area: xmin, ymin, xmax, ymax (m, world) within which road users are detected, None for no
            border.
        progress: Called with the number of frames that the tracker has done."""
    tracker = Tracker(area)
    no_numbers = np.zeros(0, np.int64)
    track_parts = [no_numbers]  # track of each detection that has one
    frame_parts = [no_numbers]  # frame of each
    row_parts = [no_numbers]  # row of each among the detections of all frames
    first_row = 0
    for k, (detections, time) in enumerate(zip(frames, times.tolist(), strict=True)):
        detected = tracker.advance(detections, time)
        track_parts.append(detected.ids)
        frame_parts.append(np.full(len(detected.ids), k))
        row_parts.append(first_row + detected.rows)
        first_row += len(detections)
        if progress is not None:
            progress(k + 1)
    everything = Detections.merge(frames)
    boxes = everything.boxes
    doubts = np.concatenate([np.zeros((0, 5)), *map(get_doubts, frames)])
    if area is not None:
        boxes = extend_outer_ends(boxes, everything.labels, area)
        doubts = doubt_outer_faces(boxes, doubts, everything.labels, area)
    track_ids = np.concatenate(track_parts)
    order = np.argsort(track_ids, kind="stable")
    track_ids = track_ids[order]
    rows = np.concatenate(row_parts)[order]
    tracked = _TrackDetections(
        frame=np.concatenate(frame_parts)[order],
        boxes=boxes[rows],
        scores=everything.scores[rows],
        labels=everything.labels[rows],
        doubts=doubts[rows],
    )
    names, begins = np.unique(track_ids, return_index=True)
    counts = np.diff(np.append(begins, len(track_ids)))  # detections of each track
    # sum of the scores of each track; `reduceat` needs at least one
    evidence = np.add.reduceat(tracked.scores, begins) if len(names) else np.zeros(0)
    is_sure = evidence >= TENTATIVE_SCORE * counts
    is_reported = is_sure | has_evidence(evidence, counts)
    is_single = is_reported & (counts == 1)
    is_several = is_reported & (counts > 1)
    detections_by_track = {}
    several = zip(names[is_several], begins[is_several], counts[is_several], strict=True)
    for name, begin, count in several:
        detections_by_track[int(name)] = tracked.select(slice(begin, begin + count))
    single = _SingleDetections(names[is_single], tracked.select(begins[is_single]))
    return single, detections_by_track


class _Settled(NamedTuple):
    """Track of k detections in f frames whose class, size and heading are known, not its motion.

    Attributes:
        name: Its id.
        label: Its class.
        size: Length, width, height (m).
        frames: Numbers of its frames in the recording, without gaps.
        yaw: Heading at its detections (rad, continuous).
        doubts: Expected error (m) of the detections' faces: front, rear, left, right and top, with
            the front by this heading.
        size_doubts: Expected error of its length, width, height (m).
        misfit: Scatter of their sizes, see `find_inflation`.
        course: Measured places."""

    name: int
    label: int
    size: Float64[np.ndarray, "3"]
    frames: Int64[np.ndarray, " f"]
    yaw: Float64[np.ndarray, " k"]
    doubts: Float64[np.ndarray, "k 5"]
    size_doubts: Float64[np.ndarray, "1 3"]
    misfit: Float64[np.ndarray, "1 3"]
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
    label = _settle_class(track, times)
    yaw = settle_heading(track.boxes, track.scores, times[track.frame], label)
    doubts = turn_faces(track.doubts, np.cos(track.boxes[:, 6] - yaw) < 0)
    if label != PEDESTRIAN:
        usual_yaw, is_outlier = find_heading_outliers(yaw, times[track.frame])
        yaw = np.where(is_outlier, usual_yaw, yaw)
        doubts = np.where(is_outlier[:, None], OUTLIER_DOUBT * doubts, doubts)
    # boxes of another class are not the size of this body; they may be of another one next to it
    is_own_class = track.labels == label
    if not is_own_class.any():
        is_own_class[:] = True
    weights = weigh_sizes(doubts[is_own_class])
    measured_sizes = track.boxes[is_own_class, 3:6]
    size = estimate_size(measured_sizes, weights, label)
    misfit = find_misfit(measured_sizes - size, weights, label)[None]
    sizes = np.tile(size, (len(yaw), 1))
    course = MeasuredCourse(
        centres=anchor_centres(track.boxes, yaw, sizes, doubts),
        noise=centre_covariance(yaw, inflate_doubts(doubts, misfit)),
        seen=track.frame - first,
        seconds=times[frames],
        label=label,
    )
    size_doubts = doubt_sizes(weights.sum(axis=0), np.sqrt(weights).sum(axis=0))
    return _Settled(
        name,
        label,
        size,
        frames,
        yaw,
        doubts,
        size_doubts=size_doubts[None],
        misfit=misfit,
        course=course,
    )


def _settle_class(track: _TrackDetections, times: Float64[np.ndarray, " frames"]) -> int:
    """Class of a track by the scores of its detections; who is too fast to run rides a bicycle.

    track: its detections; times: time of each frame of the recording (s)."""
    label = int(np.bincount(track.labels, track.scores, len(LABELS)).argmax())
    if label != PEDESTRIAN:
        return label
    away = track.boxes[:, :2] - track.boxes[0, :2]
    seconds = times[track.frame] - times[track.frame[0]]
    is_too_fast = is_too_fast_to_run(np.hypot(away[:, 0], away[:, 1]), seconds)
    return CYCLIST if is_too_fast.sum() >= MIN_FAST_DETECTIONS else PEDESTRIAN


def _is_fixed(settled: _Settled, motion: Float64[np.ndarray, "f 4"]) -> bool:
    """True for a track that is a false alarm on something fixed.

    motion: x, y (m) and their velocities (m/s) in each of its frames."""
    away = motion[:, :2] - motion[0, :2]
    is_fixed = is_flickering(
        np.array([settled.label]),
        np.hypot(away[:, 0], away[:, 1]).max(keepdims=True),
        hits=np.array([len(settled.course.seen)]),
        frames=1 + count_frames(np.diff(settled.course.seen)).sum(keepdims=True),
    )
    return bool(is_fixed[0])


def _make_single_rows(single: _SingleDetections, place_error: float) -> _TrackRows:
    """Rows of tracks that have one detection only: that detection, at rest.

    single: ids of the tracks, and the detection of each in the same order; place_error: expected
    error (m) of places that all frames share."""
    count = len(single.ids)
    detections = single.detections
    yaw = detections.boxes[:, 6]
    # with yaw in -pi..pi
    boxes = detections.boxes.copy()
    boxes[:, 6] = np.arctan2(np.sin(yaw), np.cos(yaw))
    weights = weigh_sizes(detections.doubts)
    doubts = combine_doubts(
        detections.doubts,
        doubt_sizes(weights, np.sqrt(weights)),
        labels=detections.labels,
        place_error=place_error,
        misfit=np.full((count, 3), USUAL_MISFIT),
    )
    return _TrackRows(
        frame=detections.frame,
        boxes=boxes,
        scores=detections.scores,
        labels=detections.labels,
        doubts=doubts,
        ids=single.ids,
        velocities=np.zeros((count, 3)),
        ages=np.zeros(count),
        unseen=np.zeros(count),
    )


def _make_rows(
    settled: _Settled,
    track: _TrackDetections,
    motion: Float64[np.ndarray, "f 4"],
    place_error: float,
) -> _TrackRows:
    """Rows of a track in its f frames, from the first detection to the last one, without gaps.

    Args:
        settled: The track.
        track: Its detections.
        motion: x, y (m) and their velocities (m/s) in each of its frames.
        place_error: Expected error (m) of places that all frames share."""
    frames = settled.frames
    seconds = settled.course.seconds
    seen = settled.course.seen
    length = settled.size[0]
    yaw = keep_near_course(settled.yaw, motion[seen], seconds[seen], length, settled.label)
    floors = track.boxes[:, 2] - track.boxes[:, 5] / 2
    smoothed = _smooth_over_time(np.stack([yaw, floors], axis=1), seconds[seen], seconds)
    all_yaws, floor = smoothed.T
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
    labels = np.full(len(frames), settled.label)
    doubts = combine_doubts(
        settled.doubts,
        settled.size_doubts,
        labels=labels[seen],
        place_error=place_error,
        misfit=settled.misfit,
    )
    return _TrackRows(
        frame=frames,
        boxes=boxes,
        scores=scores,
        labels=labels,
        doubts=doubts[last_rows],
        ids=np.full(len(frames), settled.name),
        velocities=np.column_stack([motion[:, 2:], np.zeros(len(frames))]),
        ages=seconds - seconds[0],
        unseen=unseen,
    )


def _smooth_over_time(
    values: Float64[np.ndarray, "k c"],
    known_seconds: Float64[np.ndarray, " k"],
    seconds: Float64[np.ndarray, " f"],
) -> Float64[np.ndarray, "f c"]:
    """Interpolate c columns, such as a cosine and sine of yaw, from k times to f, and smooth them.

    The smoothing is a mean over time with `YAW_SMOOTHING_S` as standard deviation.

    Args:
        values: Columns at the known times.
        known_seconds: Times of the values (s), ascending.
        seconds: Times of the frames (s), ascending."""
    filled = np.stack([np.interp(seconds, known_seconds, column) for column in values.T], axis=1)
    if len(seconds) < 3:
        return filled
    sigma = YAW_SMOOTHING_S / float(np.median(np.diff(seconds)))
    return smooth_rows(filled, sigma)
