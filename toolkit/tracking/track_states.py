"""State of tracks: what a tracker knows of each, and how a detection changes it."""

from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, BoxRows, Float64, Int64
from toolkit.objects import CYCLIST, LABELS, PEDESTRIAN, Detections
from toolkit.tracking.face_doubts import (
    IS_RIGID,
    LARGER_WEIGHTS,
    MISFIT_HITS,
    USUAL_MISFIT,
    anchor_centres,
    centre_covariance,
    doubt_sizes,
    get_doubts,
    inflate_doubts,
    turn_faces,
    weigh_larger,
    weigh_sizes,
)
from toolkit.tracking.false_tracks import count_frames
from toolkit.tracking.motion_model import (
    ACCELERATIONS_M_S2,
    FIRST_SPEEDS_M_S,
    constant_velocities,
    is_too_fast_to_run,
)

# largest weight of a size, in weights of its surest detection: so earlier detections fade, such as
# those at the border of the area, which look surer than they are
MAX_SIZE_MEMORY = 6.0
MIN_GUESS_DOUBT_M = 0.33  # doubt of an end above which it is guessed, as outside the area
GUESS_MEMORY = 0.05  # as `MAX_SIZE_MEMORY`, of a length that a longer guess replaces
MAX_MISFIT_HITS = 50.0  # detections over which the misfit of sizes is averaged
MAX_TURNING_S = 0.5  # without a detection; bodies turn for a moment only
MIN_EVIDENCE = 2.0  # sum of the scores of its detections that confirms a track
SURE_HITS = 10  # detections that confirm a track, however low their scores
MIN_HITS = 3  # detections from which the velocity of a track is trusted
STANDING_M_S = 0.5
SCORE_MEMORY_HITS = 8.0  # detections over which a score is averaged
YAW_GAIN = 0.55  # share of the difference to a detection's yaw that is taken over
YAW_RATE_GAIN = 0.12
# a bicycle with its rider; a pedestrian's box holds a part of both
USUAL_RIDER_SIZE_M = np.array([1.75, 0.6, 1.7])  # length, width, height
RIDER_WEIGHT_SHARE = 0.1  # share of the weight of that box that this usual size has
# by class of `LABELS`: faster, the motion of a road user says where its front is
MIN_HEADED_M_S = np.array([1.5, 1.5, 0.6, 1.5])


class MeasuredRows(NamedTuple):
    """n detections of one frame that a tracker can follow.

    Attributes:
        boxes: Boxes (m, rad), world frame.
        scores: Score of each, 0 to 1.
        labels: Class of each.
        doubts: Expected error (m) of the front, rear, left, right and top face.
        rows: Row of each among all detections of the frame."""

    boxes: BoxRows
    scores: Float64[np.ndarray, " n"]
    labels: Int64[np.ndarray, " n"]
    doubts: Float64[np.ndarray, "n 5"]
    rows: Int64[np.ndarray, " n"]

    @staticmethod
    def from_detections(detections: Detections) -> "MeasuredRows":
        """Take the detections whose boxes and scores are finite, in the same order."""
        is_finite = np.isfinite(detections.boxes).all(axis=1) & np.isfinite(detections.scores)
        measured = MeasuredRows(
            detections.boxes,
            detections.scores,
            detections.labels,
            doubts=get_doubts(detections),
            rows=np.arange(len(detections)),
        )
        return measured if is_finite.all() else measured.select(is_finite)

    def select(self, rows: np.ndarray) -> "MeasuredRows":
        """Select detections by row numbers or a mask."""
        return MeasuredRows(*(column[rows] for column in self))


class TrackStates(NamedTuple):
    """State of m tracks, a row for each.

    Attributes:
        ids: Number of each track.
        motion: x, y (m) and velocity along both (m/s).
        covariance: Covariance of `motion` (m², m²/s, m²/s²).
        floor: z of the underside (m).
        yaw: Heading (rad).
        yaw_rate: Its change (rad/s).
        size: Length, width, height (m).
        size_weight: Sum of the weights (1/m²) of the detections behind each.
        size_root: Sum of their square roots (1/m).
        max_weight: Largest of these weights.
        misfit: Scatter of each by its doubted variance, see `find_inflation`.
        votes: Sum of the scores of the track's detections of each class of `LABELS`.
        score: Mean score, the last `SCORE_MEMORY_HITS` detections counting most.
        hits: Number of detections.
        frames: Number of frames from its first detection to its last one, see `count_frames`.
        missed_frames: Number of frames since then.
        first_place: x, y of the centre (m) in its first frame.
        walked_m: Largest distance (m) of the centre from there.
        front_votes: Detections that faced the same way, minus those that faced the other way.
        doubts: Expected error (m) of the front, rear, left, right and top in the last detection.
        first_time: Time of the first detection (s).
        last_time: Time of the last detection (s).
        detection: Row of the track's detection in the last frame, -1 without one.
    """

    ids: Int64[np.ndarray, " m"]
    motion: Float64[np.ndarray, "m 4"]
    covariance: Float64[np.ndarray, "m 4 4"]
    floor: Float64[np.ndarray, " m"]
    yaw: Float64[np.ndarray, " m"]
    yaw_rate: Float64[np.ndarray, " m"]
    size: Float64[np.ndarray, "m 3"]
    size_weight: Float64[np.ndarray, "m 3"]
    size_root: Float64[np.ndarray, "m 3"]
    max_weight: Float64[np.ndarray, "m 3"]
    misfit: Float64[np.ndarray, "m 3"]
    votes: Float64[np.ndarray, "m classes"]
    score: Float64[np.ndarray, " m"]
    hits: Int64[np.ndarray, " m"]
    frames: Int64[np.ndarray, " m"]
    missed_frames: Int64[np.ndarray, " m"]
    first_place: Float64[np.ndarray, "m 2"]
    walked_m: Float64[np.ndarray, " m"]
    front_votes: Float64[np.ndarray, " m"]
    doubts: Float64[np.ndarray, "m 5"]
    first_time: Float64[np.ndarray, " m"]
    last_time: Float64[np.ndarray, " m"]
    detection: Int64[np.ndarray, " m"]

    def select(self, rows: np.ndarray) -> "TrackStates":
        """Select tracks by row numbers or a mask."""
        return TrackStates(*(column[rows] for column in self))

    def speeds(self) -> Float64[np.ndarray, " m"]:
        """Speed of each track (m/s)."""
        return np.hypot(self.motion[:, 2], self.motion[:, 3])

    def label(self) -> Int64[np.ndarray, " m"]:
        """Class of each track: the one with the most votes."""
        return self.votes.argmax(axis=1)

    def size_doubts(self) -> Float64[np.ndarray, "m 3"]:
        """Expected error (m) of the size of each track, but for its misfit."""
        return doubt_sizes(self.size_weight, self.size_root)

    def is_confirmed(self) -> Bool[np.ndarray, " m"]:
        """Mask of tracks with enough detections to be no false alarm of the detector."""
        return has_evidence(self.votes.sum(axis=1), self.hits)


def has_evidence(
    evidence: Float64[np.ndarray, " m"], hits: Int64[np.ndarray, " m"]
) -> Bool[np.ndarray, " m"]:
    """Mask of tracks with enough detections to be confirmed.

    evidence: sum of the scores of each track's detections; hits: their number."""
    return (evidence >= MIN_EVIDENCE) | (hits >= SURE_HITS)


def join_tracks(first: TrackStates, second: TrackStates) -> TrackStates:
    """Return the rows of both, those of the first before those of the second."""
    columns = zip(first, second, strict=True)
    return TrackStates(*(np.concatenate(pair) for pair in columns))


def is_standing(tracks: TrackStates) -> Bool[np.ndarray, " m"]:
    """Mask of tracks that hardly move."""
    return tracks.speeds() < STANDING_M_S


def make_track_boxes(tracks: TrackStates) -> BoxRows:
    """Boxes (m 7) of tracks, with headings from -pi to pi."""
    middle_z = tracks.floor + tracks.size[:, 2] / 2
    yaw = np.arctan2(np.sin(tracks.yaw), np.cos(tracks.yaw))
    return np.column_stack([tracks.motion[:, :2], middle_z, tracks.size, yaw])


def start_tracks(detections: MeasuredRows, time: float, first_id: int) -> TrackStates:
    """New tracks, one for each detection, in the same order.

    time: when they were made (s); first_id: number of the first track, the others count up."""
    boxes = detections.boxes
    count = len(boxes)
    doubts = detections.doubts
    weight = weigh_sizes(doubts)
    votes = np.zeros((count, len(LABELS)))
    votes[np.arange(count), detections.labels] = detections.scores
    covariance = np.zeros((count, 4, 4))
    covariance[:, :2, :2] = centre_covariance(boxes[:, 6], doubts)
    speed_variance = FIRST_SPEEDS_M_S[detections.labels] ** 2
    covariance[:, 2, 2] = speed_variance
    covariance[:, 3, 3] = speed_variance
    times = np.full(count, time)
    return TrackStates(
        ids=first_id + np.arange(count),
        motion=np.column_stack([boxes[:, :2], np.zeros((count, 2))]),
        covariance=covariance,
        floor=boxes[:, 2] - boxes[:, 5] / 2,
        yaw=boxes[:, 6].copy(),
        yaw_rate=np.zeros(count),
        size=boxes[:, 3:6].copy(),
        size_weight=weight,
        size_root=np.sqrt(weight),
        max_weight=weight,
        misfit=np.full((count, 3), USUAL_MISFIT),
        votes=votes,
        score=detections.scores.copy(),
        hits=np.ones(count, np.int64),
        frames=np.ones(count, np.int64),
        missed_frames=np.zeros(count, np.int64),
        first_place=boxes[:, :2].copy(),
        walked_m=np.zeros(count),
        front_votes=np.ones(count),
        doubts=doubts,
        first_time=times,
        last_time=times,
        detection=detections.rows,
    )


def predict_tracks(tracks: TrackStates, seconds: float) -> TrackStates:
    """Return tracks some seconds later, moved with their velocity and turned on.

    A standing one without a detection is expected where it is, however long it is hidden."""
    # one transition for all tracks: (4, 4) each
    (step,), (noise,) = constant_velocities(np.array([seconds]))
    variance = ACCELERATIONS_M_S2[tracks.label()] ** 2
    covariance = step @ tracks.covariance @ step.T + variance[:, None, None] * noise
    turn = tracks.yaw_rate * min(seconds, MAX_TURNING_S)
    stays = is_standing(tracks) & (tracks.detection < 0)
    return tracks._replace(
        motion=np.where(stays[:, None], tracks.motion, tracks.motion @ step.T),
        covariance=np.where(stays[:, None, None], tracks.covariance, covariance),
        yaw=tracks.yaw + turn,
    )


def correct_tracks(tracks: TrackStates, detections: MeasuredRows, time: float) -> TrackStates:
    """Return tracks after a detection of each.

    Args:
        tracks: Tracks as predicted for the time of the detections.
        detections: Detection of each track, in the same order.
        time: Time of the detections (s)."""
    boxes = detections.boxes
    doubts = detections.doubts
    # a detection that faces the other way is turned, and its faces with it
    residual = np.arctan2(np.sin(boxes[:, 6] - tracks.yaw), np.cos(boxes[:, 6] - tracks.yaw))
    is_turned = np.abs(residual) > np.pi / 2
    residual = np.where(is_turned, residual - np.pi * np.sign(residual), residual)
    doubts = turn_faces(doubts, is_turned)
    seconds = np.maximum(time - tracks.last_time, 1e-3)  # a step without time divides nothing
    yaw = tracks.yaw + YAW_GAIN * residual
    yaw_rate = tracks.yaw_rate + YAW_RATE_GAIN * residual / np.maximum(seconds, 0.1)
    votes = tracks.votes.copy()
    votes[np.arange(len(boxes)), detections.labels] += detections.scores
    labels_before = tracks.label()
    tracks = tracks._replace(votes=votes)
    has_other_class = tracks.label() != labels_before
    tracks = _correct_sizes(tracks, boxes[:, 3:6], doubts)
    tracks = _restart_sizes(tracks, boxes[:, 3:6], doubts, has_other_class)
    centre = anchor_centres(boxes, yaw, tracks.size, doubts)
    # Kalman's update by the anchored centre, which measures the first two parts of the motion
    noise = centre_covariance(yaw, inflate_doubts(doubts, tracks.misfit))
    gain = tracks.covariance[:, :, :2] @ np.linalg.inv(tracks.covariance[:, :2, :2] + noise)
    innovation = (centre - tracks.motion[:, :2])[:, :, None]
    motion = tracks.motion + (gain @ innovation)[:, :, 0]
    covariance = tracks.covariance - gain @ tracks.covariance[:, :2]
    share = 1 / np.minimum(tracks.hits + 1, SCORE_MEMORY_HITS)  # of this detection in a mean
    floor = boxes[:, 2] - boxes[:, 5] / 2
    away = motion[:, :2] - tracks.first_place
    corrected = tracks._replace(
        motion=motion,
        covariance=covariance,
        floor=tracks.floor + np.maximum(share, 0.2) * (floor - tracks.floor),
        yaw=yaw,
        yaw_rate=yaw_rate,
        score=tracks.score + share * (detections.scores - tracks.score),
        hits=tracks.hits + 1,
        frames=tracks.frames + count_frames(tracks.missed_frames + 1),
        missed_frames=np.zeros(len(boxes), np.int64),
        walked_m=np.maximum(tracks.walked_m, np.hypot(away[:, 0], away[:, 1])),
        front_votes=tracks.front_votes + np.where(is_turned, -1.0, 1.0),
        doubts=doubts,
        last_time=np.full(len(boxes), time),
        detection=detections.rows,
    )
    return _turn_round(_recognise_riders(corrected))


def _recognise_riders(tracks: TrackStates) -> TrackStates:
    """Return tracks, with those of pedestrians who are faster than people run as cyclists.

    A detector often takes a rider who is seen from ahead or behind for a pedestrian. The track's
    mean speed from its first place tells, in which errors of single places hardly count."""
    seconds = tracks.last_time - tracks.first_time
    is_rider = (tracks.label() == PEDESTRIAN) & is_too_fast_to_run(tracks.walked_m, seconds)
    if not is_rider.any():
        return tracks
    votes = tracks.votes.copy()
    votes[is_rider, CYCLIST] += votes[is_rider, PEDESTRIAN]
    votes[is_rider, PEDESTRIAN] = 0.0
    weight_share = np.where(is_rider, RIDER_WEIGHT_SHARE, 1.0)[:, None]
    return tracks._replace(
        votes=votes,
        size=np.where(is_rider[:, None], USUAL_RIDER_SIZE_M, tracks.size),
        size_weight=weight_share * tracks.size_weight,
        size_root=np.sqrt(weight_share) * tracks.size_root,
    )


def _correct_sizes(
    tracks: TrackStates, sizes: Float64[np.ndarray, "m 3"], doubts: Float64[np.ndarray, "m 5"]
) -> TrackStates:
    """Return tracks whose sizes are averaged with a further detection of each.

    Args:
        tracks: Tracks.
        sizes: Length, width and height of their detections (m).
        doubts: Expected errors of their detections' front, rear, left, right and top faces (m)."""
    labels = tracks.label()
    # for length, width and height (1 / m²)
    weight = weigh_sizes(doubts)
    # a detection that is larger than the track so far has another weight, by class
    weight *= weigh_larger(sizes, tracks.size, weight, labels)
    # limited, so that old detections do not outweigh new ones for ever
    memory = np.full(sizes.shape, MAX_SIZE_MEMORY)
    # a long body that comes in over the border is as long as the last guess: the more of it is
    # seen, the better the guess
    is_guess = (doubts[:, :2].max(axis=1) > MIN_GUESS_DOUBT_M) & (LARGER_WEIGHTS[labels] > 1)
    memory[is_guess & (sizes[:, 0] > tracks.size[:, 0]), 0] = GUESS_MEMORY
    earlier_weight = np.minimum(tracks.size_weight, memory * tracks.max_weight)
    kept_share = earlier_weight / tracks.size_weight
    size_weight = earlier_weight + weight
    # the difference from an earlier mean has both variances
    surprise = np.square(sizes - tracks.size) / (1 / weight + 1 / earlier_weight)
    misfit_share = 1 / np.minimum(tracks.hits + MISFIT_HITS, MAX_MISFIT_HITS)[:, None]
    misfit = tracks.misfit + misfit_share * (surprise - tracks.misfit)
    return tracks._replace(
        size=(earlier_weight * tracks.size + weight * sizes) / size_weight,
        size_weight=size_weight,
        size_root=kept_share * tracks.size_root + np.sqrt(weight),
        max_weight=np.maximum(tracks.max_weight, weight),
        misfit=np.where(IS_RIGID[labels][:, None], misfit, USUAL_MISFIT),
    )


def _restart_sizes(
    tracks: TrackStates,
    sizes: Float64[np.ndarray, "m 3"],
    doubts: Float64[np.ndarray, "m 5"],
    is_restarted: Bool[np.ndarray, " m"],
) -> TrackStates:
    """Return tracks, some of them with the size of their last detection.

    Before its class changed, a track may have had boxes around another body, such as the truck
    ahead of a car. Their sizes are not its size.

    Args:
        tracks: Tracks.
        sizes: Length, width and height of their last detections (m).
        doubts: Expected errors of these detections' front, rear, left, right and top faces (m).
        is_restarted: Mask of the tracks whose class has changed."""
    if not is_restarted.any():
        return tracks
    weight = weigh_sizes(doubts)
    is_restarted = is_restarted[:, None]
    return tracks._replace(
        size=np.where(is_restarted, sizes, tracks.size),
        size_weight=np.where(is_restarted, weight, tracks.size_weight),
        size_root=np.where(is_restarted, np.sqrt(weight), tracks.size_root),
        max_weight=np.where(is_restarted, weight, tracks.max_weight),
        misfit=np.where(is_restarted, USUAL_MISFIT, tracks.misfit),
    )


def _turn_round(tracks: TrackStates) -> TrackStates:
    """Turn tracks by a half turn that face backwards, by their motion or by their front votes."""
    # speed (m/s) in the direction of the yaw, negative backwards
    along = tracks.motion[:, 2] * np.cos(tracks.yaw) + tracks.motion[:, 3] * np.sin(tracks.yaw)
    min_headed = MIN_HEADED_M_S[tracks.label()]
    moves_backwards = (along < -min_headed) & (tracks.hits >= MIN_HITS)
    is_backwards = moves_backwards | ((tracks.front_votes < 0) & (along < min_headed))
    if not is_backwards.any():
        return tracks
    return tracks._replace(
        yaw=np.where(is_backwards, tracks.yaw + np.pi, tracks.yaw),
        front_votes=np.where(is_backwards, np.abs(tracks.front_votes), tracks.front_votes),
        doubts=turn_faces(tracks.doubts, is_backwards),
    )
