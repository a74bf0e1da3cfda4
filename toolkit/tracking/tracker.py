"""`Tracker`: tracks from detections, frame after frame.

Poles do not move and bodies are rigid, so a track knows more than its last detection. Its size is a
mean over all detections, weighed by the doubt of each face, and its box is anchored at the faces
that are surer now: a car seen from behind keeps its rear, and its front follows from its length.
Positions are filtered with constant velocity (Kalman 1960). Detections are assigned in two rounds,
sure ones first (Zhang et al., ByteTrack, ECCV 2022), by distances that count less along the
heading.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Int64
from toolkit.boxes import iou_bev
from toolkit.objects import Detections
from toolkit.tracking.assignment import assign_detections, find_unlike
from toolkit.tracking.face_doubts import combine_doubts, doubt_outer_faces, extend_outer_ends
from toolkit.tracking.false_tracks import find_doubles, is_flickering, weigh_tracks
from toolkit.tracking.track_states import (
    MIN_HITS,
    MeasuredRows,
    TrackStates,
    correct_tracks,
    is_standing,
    join_tracks,
    make_track_boxes,
    predict_tracks,
    start_tracks,
)
from toolkit.tracking.tracks import Tracks

MAX_TENTATIVE_S = 0.15  # without a detection, of a track that is not confirmed
MAX_MOVING_S = 0.6
MAX_STANDING_S = 5.0
# without a detection, the score of a moving track falls to 1/e, and then it is not reported
FADING_S = 0.5
STANDING_FADING_S = 5.0
TENTATIVE_SCORE = 0.8  # of a detection that is reported though its track is not confirmed
SAME_PLACE_IOU = 0.15  # above it, a track without a detection is another one's ghost
MAX_GHOST_REACH = 0.75  # distance of two boxes of that overlap, by the sum of their half diagonals


class TrackedDetections(NamedTuple):
    """Detections of one frame that have a track.

    Attributes:
        ids: Number of each track.
        rows: Row of its detection among the frame's."""

    ids: Int64[np.ndarray, " n"]
    rows: Int64[np.ndarray, " n"]


class Tracker:
    """Tracks of one place, updated with the detections of frame after frame.

    Args:
        area: xmin, ymin, xmax, ymax (m, world) within which road users are detected; a track that
            leaves it ends at once. None for no border.
        place_error: Expected error (m) of places that all frames share, as from the sensors' poses
            (`ErrorProfile.place_error`). No mean over frames removes it; it is in all doubts.

    A track is reported once its detections confirm it, or while the last one is sure. So it may be
    known later than its first detection, but a detector's flickers are not reported, nor is the
    weaker of two tracks of one person (`toolkit.tracking.false_tracks`).
    """

    def __init__(self, area: Sequence[float] | None = None, place_error: float = 0.0) -> None:
        self._area = None if area is None else tuple(map(float, area))
        self._place_error = place_error
        self._time: float | None = None
        self._next_id = 0
        nothing = MeasuredRows.from_detections(Detections.empty())
        self._tracks = start_tracks(nothing, time=0.0, first_id=0)

    def update(self, detections: Detections, time: float) -> Tracks:
        """Return the tracks after the detections (world frame) of a frame.

        time: time of the frame (s), later than the frame before. Raises ValueError for another."""
        self.advance(detections, time)
        return self.at(time)

    def advance(self, detections: Detections, time: float) -> TrackedDetections:
        """Take the detections of a frame; return each with its track, reported or not.

        Args:
            detections: Detections in the world frame.
            time: Time of the frame (s), later than the frame before.

        Raises ValueError for a time that is not finite or does not go on."""
        if not np.isfinite(time):
            raise ValueError(f"the time of a frame must be a number of seconds, got {time}")
        if self._time is not None and time <= self._time:
            raise ValueError(
                f"frames must come in the order of time, got {time:g} s after {self._time:g} s"
            )
        measured = MeasuredRows.from_detections(detections)
        if self._area is not None:
            boxes = extend_outer_ends(measured.boxes, measured.labels, self._area)
            doubts = doubt_outer_faces(boxes, measured.doubts, measured.labels, self._area)
            measured = measured._replace(boxes=boxes, doubts=doubts)
        tracks = self._tracks
        if self._time is not None:
            tracks = predict_tracks(tracks, time - self._time)
        self._time = time
        mine, theirs = assign_detections(tracks, measured, time)
        seen = correct_tracks(tracks.select(mine), measured.select(theirs), time)
        is_fresh = np.ones(len(measured.rows), np.bool_)
        is_fresh[theirs] = False
        fresh = start_tracks(measured.select(is_fresh), time, self._next_id)
        self._next_id += len(fresh.ids)
        detected = join_tracks(seen, fresh)
        is_kept = self._stays(tracks, time)
        is_kept[mine] = False
        unseen = tracks.select(is_kept)
        unseen = unseen.select(~_is_ghost(unseen, detected))
        unseen = unseen._replace(
            detection=np.full(len(unseen.ids), -1), missed_frames=unseen.missed_frames + 1
        )
        tracks = join_tracks(detected, unseen)
        self._tracks = tracks.select(np.argsort(tracks.ids))
        return TrackedDetections(detected.ids, detected.detection)

    def at(self, time: float) -> Tracks:
        """Return the reported tracks as they are expected to be at a time (s), without a detection.

        Raises ValueError for a time before the last frame."""
        if self._time is None:
            return Tracks.empty()
        if not time >= self._time:
            raise ValueError(
                f"tracks are known from {self._time:g} s on, got a question for {time:g} s"
            )
        tracks = (
            predict_tracks(self._tracks, time - self._time) if time > self._time else self._tracks
        )
        unseen = time - tracks.last_time
        fading = np.where(is_standing(tracks), STANDING_FADING_S, FADING_S)
        is_sure = (tracks.detection >= 0) & (tracks.score >= TENTATIVE_SCORE)
        is_reported = (tracks.is_confirmed() | is_sure) & (unseen <= fading)
        labels = tracks.label()
        is_reported &= ~is_flickering(labels, tracks.walked_m, tracks.hits, tracks.frames)
        rows = np.flatnonzero(is_reported)
        weights = weigh_tracks(tracks.score, tracks.hits)
        boxes = make_track_boxes(tracks)
        speeds = tracks.speeds()[rows]
        rows = rows[~find_doubles(boxes[rows], labels[rows], weights[rows], speeds)]
        tracks = tracks.select(rows)
        unseen = unseen[rows]
        fading = fading[rows]
        labels = labels[rows]
        # a place that is extrapolated is unsure
        variance = (tracks.covariance[:, 0, 0] + tracks.covariance[:, 1, 1]) / 2
        place_error = np.hypot(self._place_error, np.where(unseen > 0, np.sqrt(variance), 0.0))
        doubts = combine_doubts(
            tracks.doubts, tracks.size_doubts(), labels, place_error, misfit=tracks.misfit
        )
        return Tracks(
            boxes=boxes[rows],
            scores=tracks.score * np.exp(-unseen / fading),
            labels=labels,
            doubts=doubts,
            ids=tracks.ids,
            velocities=np.column_stack([tracks.motion[:, 2:], np.zeros(len(tracks.ids))]),
            ages=time - tracks.first_time,
            unseen=unseen,
        )

    def _stays(self, tracks: TrackStates, time: float) -> Bool[np.ndarray, " m"]:
        """Mask of tracks that live on without a detection in this frame. time: the frame's (s)."""
        # longest time (s) without a detection; a later rule replaces an earlier one
        max_unseen = np.where(is_standing(tracks), MAX_STANDING_S, MAX_MOVING_S)
        max_unseen = np.where(tracks.is_confirmed(), max_unseen, MAX_MOVING_S)
        max_unseen = np.where(tracks.hits < MIN_HITS, MAX_TENTATIVE_S, max_unseen)
        stays = time - tracks.last_time <= max_unseen
        if self._area is not None:
            xmin, ymin, xmax, ymax = self._area
            x = tracks.motion[:, 0]
            y = tracks.motion[:, 1]
            stays &= (x >= xmin) & (x <= xmax) & (y >= ymin) & (y <= ymax)
        return stays


def track_live(
    frames: Sequence[Detections],
    times: Sequence[float],
    area: Sequence[float] | None = None,
    *,
    place_error: float = 0.0,
) -> list[Tracks]:
    """Return the tracks in each frame of a recording, as they are known after that frame.

    Args:
        frames: Detections in each frame, world frame.
        times: Time of each frame (s), ascending.
        area: xmin, ymin, xmax, ymax (m, world) within which road users are detected, None for no
            border.
        place_error: Expected error (m) of places that all frames share, as from the sensors' poses.

    Raises the errors of `Tracker.update`."""
    tracker = Tracker(area, place_error)
    pairs = zip(frames, times, strict=True)
    return [tracker.update(detections, time) for detections, time in pairs]


def _is_ghost(unseen: TrackStates, detected: TrackStates) -> Bool[np.ndarray, " m"]:
    """Mask of tracks `unseen`, without a detection: those at the place of a detected one.

    Both must be of one kind. Such a track is the other one under a second number."""
    is_ghost = np.zeros(len(unseen.ids), np.bool_)
    # boxes that overlap so much are nearer than this
    diagonals = np.hypot(unseen.size[:, 0], unseen.size[:, 1])[:, None]
    reach = MAX_GHOST_REACH * (diagonals + np.hypot(detected.size[:, 0], detected.size[:, 1])) / 2
    # differences of x and y (m): (unseen, detected)
    x = unseen.motion[:, :1] - detected.motion[:, 0]
    y = unseen.motion[:, 1:2] - detected.motion[:, 1]
    is_near = x * x + y * y < reach * reach
    is_near &= ~find_unlike(unseen.label(), detected.label())
    rows = np.flatnonzero(is_near.any(axis=1))
    if not len(rows):
        return is_ghost
    columns = np.flatnonzero(is_near.any(axis=0))
    # IoU only of tracks that are near another, since it takes longer
    near_boxes = make_track_boxes(unseen.select(rows))
    overlap = iou_bev(near_boxes, make_track_boxes(detected.select(columns)))
    is_same = (overlap > SAME_PLACE_IOU) & is_near[rows[:, None], columns]
    is_ghost[rows] = is_same.any(axis=1)
    return is_ghost
