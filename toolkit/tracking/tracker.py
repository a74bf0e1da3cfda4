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

from toolkit.arrays import Bool, BoxRows, Float64, Int64
from toolkit.boxes import iou_bev
from toolkit.objects import LABELS, PEDESTRIAN, USUAL_DOUBTS_M, Detections
from toolkit.tracking.tracks import Tracks

# by class of `LABELS`: vehicle, cyclist, pedestrian, heavy
ACCELERATIONS_M_S2 = np.array([3.0, 3.0, 2.0, 2.0])  # standard deviation, from step to step
FIRST_SPEEDS_M_S = np.array([9.0, 5.0, 1.5, 8.0])  # standard deviation, of a new track
GATE_ALONG_M = np.array([0.8, 0.5, 0.35, 1.2])  # standard deviation for the assignment
GATE_ACROSS_M = np.array([0.4, 0.35, 0.35, 0.5])
MAX_SQUARED_DISTANCE = 12.0  # of a detection from a track, in such standard deviations
OTHER_CLASS_COST = 3.0  # added to the squared distance
SIZE_COST_M = 0.3  # difference of sizes that costs 1 after a gap
GAP_S = 0.5  # longer without a detection, the size of what returns counts
SURE_SCORE = 0.35  # of the detections that are assigned in the first round
MIN_HITS = 3  # detections that confirm a track
MAX_TENTATIVE_S = 0.15  # without a detection, of a track that is not confirmed
MAX_MOVING_S = 0.6
MAX_STANDING_S = 5.0
STANDING_M_S = 0.5
FADING_S = 0.5  # in which the score of a moving track without a detection falls to 1/e
STANDING_FADING_S = 5.0
SCORE_MEMORY_HITS = 8.0  # detections over which a score is averaged
MAX_EQUIVALENT_FRAMES = 12.0  # independent detections as which any number counts at most
YAW_GAIN = 0.55  # share of the difference to a detection's yaw that is taken over
YAW_RATE_GAIN = 0.12
MIN_HEADED_M_S = 1.5  # faster, the motion of a vehicle or cyclist says where its front is
SAME_PLACE_IOU = 0.15  # above it, a track without a detection is another one's ghost
_UNLIKE = np.array(  # True for two classes that cannot be one road user
    [
        [False, True, True, False],
        [True, False, False, True],
        [True, False, False, True],
        [False, True, True, False],
    ]
)


class _State(NamedTuple):
    """Tracks, a row for each.

    Attributes:
        ids: Number of each track.
        motion: x, y (m) and velocity along both (m/s).
        covariance: Of the motion.
        floor: z of the underside (m).
        yaw: Heading (rad).
        yaw_rate: Its change (rad/s).
        size: Length, width, height (m).
        size_weight: Sum of the weights (1/m²) of the detections behind each.
        max_weight: Largest such weight.
        votes: Scores of the detections of each class.
        score: Averaged score.
        hits: Number of detections.
        front_votes: Detections that faced the same way, minus those that faced the other way.
        doubts: Of front, rear, left, right and top in the last detection (m).
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
    max_weight: Float64[np.ndarray, "m 3"]
    votes: Float64[np.ndarray, "m classes"]
    score: Float64[np.ndarray, " m"]
    hits: Int64[np.ndarray, " m"]
    front_votes: Float64[np.ndarray, " m"]
    doubts: Float64[np.ndarray, "m 5"]
    first_time: Float64[np.ndarray, " m"]
    last_time: Float64[np.ndarray, " m"]
    detection: Int64[np.ndarray, " m"]

    def select(self, rows: np.ndarray) -> "_State":
        """Some of the tracks."""
        return _State(*(column[rows] for column in self))

    def label(self) -> Int64[np.ndarray, " m"]:
        """Class of each track, by its votes."""
        return self.votes.argmax(axis=1)


class Tracker:
    """Tracks of one place, updated with the detections of frame after frame.

    Args:
        area: xmin, ymin, xmax, ymax (m, world) within which road users are detected; a track that
            leaves it ends at once. None for no border.
    """

    def __init__(self, area: Sequence[float] | None = None) -> None:
        self._area = None if area is None else tuple(map(float, area))
        self._time: float | None = None
        self._next_id = 0
        self._tracks = _start(Detections.empty(), 0.0, 0)

    def update(self, detections: Detections, time: float) -> Tracks:
        """Return the tracks after the detections of a frame.

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
        is_finite = np.isfinite(detections.boxes).all(axis=1) & np.isfinite(detections.scores)
        finite_rows = np.flatnonzero(is_finite)
        detections = detections[finite_rows]
        tracks = self._tracks
        if self._time is not None:
            tracks = _predict(tracks, time - self._time)
        self._time = time
        sure = detections.scores >= SURE_SCORE
        matched_tracks = []
        matched_detections = []
        is_free = np.ones(len(tracks.ids), np.bool_)
        for is_of_round in (sure, ~sure):
            round_rows = np.flatnonzero(is_of_round)
            free = np.flatnonzero(is_free)
            mine, theirs = _assign(tracks.select(free), detections[round_rows], time)
            matched_tracks.append(free[mine])
            matched_detections.append(round_rows[theirs])
            is_free[free[mine]] = False
        mine = np.concatenate(matched_tracks)
        theirs = np.concatenate(matched_detections)
        order = np.argsort(mine)
        mine = mine[order]
        theirs = theirs[order]
        seen = _correct(tracks.select(mine), detections[theirs], time)
        seen = seen._replace(detection=finite_rows[theirs])
        unseen = tracks.select(is_free)
        unseen = unseen.select(self._stays(unseen, time))
        unseen = unseen._replace(detection=np.full(len(unseen.ids), -1))
        is_fresh = np.ones(len(detections), np.bool_)
        is_fresh[theirs] = False
        fresh_rows = np.flatnonzero(is_fresh)
        fresh = _start(detections[fresh_rows], time, self._next_id)
        fresh = fresh._replace(detection=finite_rows[fresh_rows])
        self._next_id += len(fresh.ids)
        unseen = unseen.select(~_is_ghost(unseen, seen, fresh))
        parts = zip(seen, unseen, fresh, strict=True)
        tracks = _State(*(np.concatenate(columns) for columns in parts))
        self._tracks = tracks.select(np.argsort(tracks.ids))
        return self.at(time)

    @property
    def detection_rows(self) -> Int64[np.ndarray, " n"]:
        """Row of the last frame's detection behind each track of `update`, -1 without one."""
        return self._tracks.detection

    def at(self, time: float) -> Tracks:
        """Return the tracks as they are expected to be at a time (s), without a detection.

        Raises ValueError for a time before the last frame."""
        if self._time is None:
            return Tracks.empty()
        if not time >= self._time:
            raise ValueError(
                f"tracks are known from {self._time:g} s on, got a question for {time:g} s"
            )
        tracks = _predict(self._tracks, time - self._time) if time > self._time else self._tracks
        unseen = time - tracks.last_time
        fading = np.where(_is_standing(tracks), STANDING_FADING_S, FADING_S)
        weight = np.minimum(tracks.size_weight, MAX_EQUIVALENT_FRAMES * tracks.max_weight)
        doubts = tracks.doubts.copy()
        # a face that is not seen now follows from the opposite one and the size
        length_error = 1 / np.sqrt(weight[:, 0])
        width_error = 1 / np.sqrt(weight[:, 1])
        for face, opposite, error in ((0, 1, length_error), (2, 3, width_error)):
            first = tracks.doubts[:, face]
            second = tracks.doubts[:, opposite]
            doubts[:, face] = np.minimum(first, np.hypot(second, error))
            doubts[:, opposite] = np.minimum(second, np.hypot(first, error))
        return Tracks(
            boxes=_make_boxes(tracks),
            scores=tracks.score * np.exp(-unseen / fading),
            labels=tracks.label(),
            doubts=doubts,
            ids=tracks.ids,
            velocities=np.column_stack([tracks.motion[:, 2:], np.zeros(len(tracks.ids))]),
            ages=time - tracks.first_time,
            unseen=unseen,
        )

    def _stays(self, tracks: _State, time: float) -> Bool[np.ndarray, " m"]:
        """Mask of tracks without a detection in this frame that live on."""
        max_unseen = np.where(_is_standing(tracks), MAX_STANDING_S, MAX_MOVING_S)
        max_unseen = np.where(tracks.hits < MIN_HITS, MAX_TENTATIVE_S, max_unseen)
        stays = time - tracks.last_time <= max_unseen
        if self._area is not None:
            xmin, ymin, xmax, ymax = self._area
            x = tracks.motion[:, 0]
            y = tracks.motion[:, 1]
            stays &= (x >= xmin) & (x <= xmax) & (y >= ymin) & (y <= ymax)
        return stays


def track_live(
    frames: Sequence[Detections], times: Sequence[float], area: Sequence[float] | None = None
) -> list[Tracks]:
    """Return the tracks in each frame of a recording, as they are known after that frame.

    Args:
        frames: Detections in each frame, world frame.
        times: Time of each frame (s), ascending.
        area: As in `Tracker`.

    Raises the errors of `Tracker.update`."""
    tracker = Tracker(area)
    return [tracker.update(rows, time) for rows, time in zip(frames, times, strict=True)]


def _is_standing(tracks: _State) -> Bool[np.ndarray, " m"]:
    # mask of tracks that hardly move
    return np.hypot(tracks.motion[:, 2], tracks.motion[:, 3]) < STANDING_M_S


def _make_boxes(tracks: _State) -> BoxRows:
    """Boxes of tracks."""
    middle = tracks.floor + tracks.size[:, 2] / 2
    yaw = np.arctan2(np.sin(tracks.yaw), np.cos(tracks.yaw))
    return np.column_stack([tracks.motion[:, :2], middle, tracks.size, yaw])


def _start(detections: Detections, time: float, first_id: int) -> _State:
    """New tracks, one for each detection. first_id: number of the first one."""
    count = len(detections)
    boxes = detections.boxes
    doubts = get_doubts(detections)
    weight = weigh_sizes(doubts)
    votes = np.zeros((count, len(LABELS)))
    votes[np.arange(count), detections.labels] = detections.scores
    covariance = np.zeros((count, 4, 4))
    covariance[:, :2, :2] = centre_covariance(boxes[:, 6], doubts)
    speed_variance = FIRST_SPEEDS_M_S[detections.labels] ** 2
    covariance[:, 2, 2] = speed_variance
    covariance[:, 3, 3] = speed_variance
    times = np.full(count, time)
    return _State(
        ids=first_id + np.arange(count),
        motion=np.column_stack([boxes[:, :2], np.zeros((count, 2))]),
        covariance=covariance,
        floor=boxes[:, 2] - boxes[:, 5] / 2,
        yaw=boxes[:, 6].copy(),
        yaw_rate=np.zeros(count),
        size=boxes[:, 3:6].copy(),
        size_weight=weight,
        max_weight=weight,
        votes=votes,
        score=detections.scores.copy(),
        hits=np.ones(count, np.int64),
        front_votes=np.ones(count),
        doubts=doubts,
        first_time=times,
        last_time=times,
        detection=np.arange(count),
    )


def get_doubts(detections: Detections) -> Float64[np.ndarray, "n 5"]:
    """Doubts of the faces of detections, the usual ones if they have none."""
    if detections.doubts is not None:
        return detections.doubts
    return np.tile(USUAL_DOUBTS_M, (len(detections), 1))


def turn_faces(
    doubts: Float64[np.ndarray, "n 5"], is_turned: Bool[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 5"]:
    """Doubts with front and rear, left and right exchanged for boxes that turn by a half turn."""
    return np.where(is_turned[:, None], doubts[:, [1, 0, 3, 2, 4]], doubts)


def weigh_sizes(doubts: Float64[np.ndarray, "n 5"]) -> Float64[np.ndarray, "n 3"]:
    """Weight (1/m²) of the length, width and height of detections, by the doubts of their faces."""
    length = np.square(doubts[:, :2]).sum(axis=1)
    width = np.square(doubts[:, 2:4]).sum(axis=1)
    return 1 / np.stack([length, width, np.square(doubts[:, 4])], axis=1)


def centre_covariance(
    yaw: Float64[np.ndarray, " n"], doubts: Float64[np.ndarray, "n 5"]
) -> Float64[np.ndarray, "n 2 2"]:
    """Covariance (m²) of the centres of boxes that are anchored at the surer faces."""
    weights = 1 / np.square(doubts)
    along = 1 / weights[:, :2].sum(axis=1)
    across = 1 / weights[:, 2:4].sum(axis=1)
    return _rotate_variances(yaw, along, across)


def _rotate_variances(
    yaw: Float64[np.ndarray, " n"],
    along: Float64[np.ndarray, " n"],
    across: Float64[np.ndarray, " n"],
) -> Float64[np.ndarray, "n 2 2"]:
    """Covariance in x and y of variances along and across a heading."""
    cos = np.cos(yaw)
    sin = np.sin(yaw)
    covariance = np.empty((len(yaw), 2, 2))
    covariance[:, 0, 0] = along * cos**2 + across * sin**2
    covariance[:, 1, 1] = along * sin**2 + across * cos**2
    covariance[:, 0, 1] = covariance[:, 1, 0] = (along - across) * cos * sin
    return covariance


def _predict(tracks: _State, seconds: float) -> _State:
    """Tracks so many seconds later, moved with their velocity."""
    (step,), (noise,) = constant_velocities(np.array([seconds]))
    variance = ACCELERATIONS_M_S2[tracks.label()] ** 2
    covariance = step @ tracks.covariance @ step.T + variance[:, None, None] * noise
    # bodies turn for a moment only
    turn = tracks.yaw_rate * min(seconds, GAP_S)
    return tracks._replace(
        motion=tracks.motion @ step.T, covariance=covariance, yaw=tracks.yaw + turn
    )


def constant_velocities(
    seconds: Float64[np.ndarray, " n"],
) -> tuple[Float64[np.ndarray, "n 4 4"], Float64[np.ndarray, "n 4 4"]]:
    """Transition of x, y and their velocities, and its covariance by white acceleration of 1 m/s².

    seconds: times that pass, a transition for each."""
    count = len(seconds)
    steps = np.zeros((count, 4, 4))
    steps[:, [0, 1, 2, 3], [0, 1, 2, 3]] = 1.0
    steps[:, 0, 2] = seconds
    steps[:, 1, 3] = seconds
    noise = np.zeros((count, 4, 4))
    noise[:, [0, 1], [0, 1]] = seconds[:, None] ** 4 / 4
    noise[:, [2, 3], [2, 3]] = seconds[:, None] ** 2
    noise[:, [0, 1, 2, 3], [2, 3, 0, 1]] = seconds[:, None] ** 3 / 2
    return steps, noise


def _assign(
    tracks: _State, detections: Detections, time: float
) -> tuple[Int64[np.ndarray, " k"], Int64[np.ndarray, " k"]]:
    """Rows of tracks and of detections that belong together, at the least cost in all."""
    from scipy.optimize import linear_sum_assignment

    if not len(tracks.ids) or not len(detections):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    labels = tracks.label()
    gates = _rotate_variances(tracks.yaw, GATE_ALONG_M[labels] ** 2, GATE_ACROSS_M[labels] ** 2)
    inverse = np.linalg.inv(tracks.covariance[:, :2, :2] + gates)
    x = detections.boxes[None, :, 0] - tracks.motion[:, None, 0]
    y = detections.boxes[None, :, 1] - tracks.motion[:, None, 1]
    cost = inverse[:, 0, 0, None] * x * x
    cost += 2 * inverse[:, 0, 1, None] * x * y
    cost += inverse[:, 1, 1, None] * y * y
    is_far = cost > MAX_SQUARED_DISTANCE
    cost += OTHER_CLASS_COST * (labels[:, None] != detections.labels)
    is_returning = (time - tracks.last_time > GAP_S) & (labels != PEDESTRIAN)
    sizes = tracks.size[is_returning, None, :2]
    size_difference = np.abs(detections.boxes[None, :, 3:5] - sizes).max(axis=2)
    cost[is_returning] += np.square(size_difference / SIZE_COST_M)
    impossible = is_far | _UNLIKE[labels][:, detections.labels]
    cost[impossible] = 1e6
    mine, theirs = linear_sum_assignment(cost)
    is_possible = ~impossible[mine, theirs]
    return mine[is_possible], theirs[is_possible]


def _correct(tracks: _State, detections: Detections, time: float) -> _State:
    """Tracks after a detection of each, in the same order."""
    boxes = detections.boxes
    doubts = get_doubts(detections)
    # a detection that faces the other way is turned, and its faces with it
    residual = np.arctan2(np.sin(boxes[:, 6] - tracks.yaw), np.cos(boxes[:, 6] - tracks.yaw))
    is_turned = np.abs(residual) > np.pi / 2
    residual = np.where(is_turned, residual - np.pi * np.sign(residual), residual)
    doubts = turn_faces(doubts, is_turned)
    seconds = np.maximum(time - tracks.last_time, 1e-3)
    yaw = tracks.yaw + YAW_GAIN * residual
    yaw_rate = tracks.yaw_rate + YAW_RATE_GAIN * residual / np.maximum(seconds, 0.1)
    weight = weigh_sizes(doubts)
    size_weight = tracks.size_weight + weight
    size = (tracks.size_weight * tracks.size + weight * boxes[:, 3:6]) / size_weight
    centre = anchor_centres(boxes, yaw, size, doubts)
    # Kalman's update by the anchored centre
    noise = centre_covariance(yaw, doubts)
    gain = tracks.covariance[:, :, :2] @ np.linalg.inv(tracks.covariance[:, :2, :2] + noise)
    innovation = (centre - tracks.motion[:, :2])[:, :, None]
    motion = tracks.motion + (gain @ innovation)[:, :, 0]
    covariance = tracks.covariance - gain @ tracks.covariance[:, :2]
    votes = tracks.votes.copy()
    votes[np.arange(len(boxes)), detections.labels] += detections.scores
    share = 1 / np.minimum(tracks.hits + 1, SCORE_MEMORY_HITS)
    floor = boxes[:, 2] - boxes[:, 5] / 2
    corrected = tracks._replace(
        motion=motion,
        covariance=covariance,
        floor=tracks.floor + np.maximum(share, 0.2) * (floor - tracks.floor),
        yaw=yaw,
        yaw_rate=yaw_rate,
        size=size,
        size_weight=size_weight,
        max_weight=np.maximum(tracks.max_weight, weight),
        votes=votes,
        score=tracks.score + share * (detections.scores - tracks.score),
        hits=tracks.hits + 1,
        front_votes=tracks.front_votes + np.where(is_turned, -1.0, 1.0),
        doubts=doubts,
        last_time=np.full(len(boxes), time),
    )
    return _turn_round(corrected)


def anchor_centres(
    boxes: BoxRows,
    yaw: Float64[np.ndarray, " n"],
    size: Float64[np.ndarray, "n 3"],
    doubts: Float64[np.ndarray, "n 5"],
) -> Float64[np.ndarray, "n 2"]:
    """Centres (x, y) of bodies of a known size that share their surer faces with detections.

    Args:
        boxes: Detections.
        yaw: Heading of each body; its detection may have the opposite one.
        size: Length, width and height of each body.
        doubts: Of the detections' faces, front and rear as seen by `yaw`."""
    weights = 1 / np.square(doubts)
    # how far the centre moves ahead if the front, not the rear, is kept, and by their weights
    ahead = (boxes[:, 3] - size[:, 0]) / 2
    leftwards = (boxes[:, 4] - size[:, 1]) / 2
    ahead = ahead * (weights[:, 0] - weights[:, 1]) / (weights[:, 0] + weights[:, 1])
    leftwards = leftwards * (weights[:, 2] - weights[:, 3]) / (weights[:, 2] + weights[:, 3])
    cos = np.cos(yaw)
    sin = np.sin(yaw)
    x = boxes[:, 0] + ahead * cos - leftwards * sin
    y = boxes[:, 1] + ahead * sin + leftwards * cos
    return np.stack([x, y], axis=1)


def _turn_round(tracks: _State) -> _State:
    """Turn tracks that face backwards, by their motion or by the votes of their detections."""
    along = tracks.motion[:, 2] * np.cos(tracks.yaw) + tracks.motion[:, 3] * np.sin(tracks.yaw)
    moves_backwards = (along < -MIN_HEADED_M_S) & (tracks.hits >= MIN_HITS)
    is_backwards = moves_backwards | ((tracks.front_votes < 0) & (along < MIN_HEADED_M_S))
    if not is_backwards.any():
        return tracks
    return tracks._replace(
        yaw=np.where(is_backwards, tracks.yaw + np.pi, tracks.yaw),
        front_votes=np.where(is_backwards, np.abs(tracks.front_votes), tracks.front_votes),
        doubts=turn_faces(tracks.doubts, is_backwards),
    )


def _is_ghost(unseen: _State, *detected: _State) -> Bool[np.ndarray, " m"]:
    """Mask of tracks without a detection where a detected track of their kind is."""
    is_ghost = np.zeros(len(unseen.ids), np.bool_)
    for tracks in detected:
        reach = np.hypot(unseen.size[:, 0], unseen.size[:, 1])[:, None] / 2
        reach = reach + np.hypot(tracks.size[:, 0], tracks.size[:, 1]) / 2
        x = unseen.motion[:, None, 0] - tracks.motion[:, 0]
        y = unseen.motion[:, None, 1] - tracks.motion[:, 1]
        is_near = x * x + y * y < reach * reach
        rows = np.flatnonzero(is_near.any(axis=1))
        columns = np.flatnonzero(is_near.any(axis=0))
        if not len(rows):
            continue
        near_unseen = unseen.select(rows)
        near_tracks = tracks.select(columns)
        overlap = iou_bev(_make_boxes(near_unseen), _make_boxes(near_tracks))
        is_alike = ~_UNLIKE[near_unseen.label()][:, near_tracks.label()]
        is_ghost[rows] |= ((overlap > SAME_PLACE_IOU) & is_alike).any(axis=1)
    return is_ghost
