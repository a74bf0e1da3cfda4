"""Assignment of detections to tracks: at the least cost in all, sure detections first.

The two rounds follow ByteTrack (Zhang et al., ECCV 2022). Distances count less along the heading of
a track. After a gap, a body must have the size that went: a difference costs, but is no wall.
"""

import numpy as np

from toolkit.arrays import Bool, Float64, Int64
from toolkit.objects import PEDESTRIAN
from toolkit.tracking.face_doubts import rotate_variances
from toolkit.tracking.track_states import MeasuredRows, TrackStates

# by class of `LABELS`: standard deviations
GATE_ALONG_M = np.array([0.8, 0.5, 0.35, 1.2])
GATE_ACROSS_M = np.array([0.4, 0.35, 0.35, 0.5])
# least deviation along the heading by the length: now one end of a long body is seen, now another
GATE_LENGTH_SHARE = 0.15
MAX_SQUARED_DISTANCE = 12.0  # of a detection from a track, in such standard deviations
OTHER_CLASS_COST = 3.0  # added to the squared distance
SIZE_COST_M = 0.3  # difference of sizes that costs 1 after a gap
HEIGHT_COST_M = 0.2  # difference of heights of pedestrians that costs 1
GAP_S = 0.5  # longer without a detection, the size of what returns counts
SURE_SCORE = 0.35  # of the detections that are assigned in the first round

# True for two classes that cannot be one road user; rows and columns as in `LABELS`
_UNLIKE = np.array(
    [
        [False, True, True, False],
        [True, False, False, True],
        [True, False, False, True],
        [False, True, True, False],
    ]
)
_IMPOSSIBLE_COST = 1e6


def find_unlike(
    labels: Int64[np.ndarray, " m"], other_labels: Int64[np.ndarray, " n"]
) -> Bool[np.ndarray, "m n"]:
    """Mask of the pairs that cannot be one road user by their classes (`labels`)."""
    return _UNLIKE[labels][:, other_labels]


def assign_detections(
    tracks: TrackStates, detections: MeasuredRows, time: float
) -> tuple[Int64[np.ndarray, " k"], Int64[np.ndarray, " k"]]:
    """Return the rows of the tracks that get a detection, ascending, and the row of each detection.

    Sure detections are assigned first, the others to the tracks that are left.

    Args:
        tracks: Tracks as predicted for the time of the detections.
        detections: Detections of a frame.
        time: Time of the frame (s)."""
    from scipy.optimize import linear_sum_assignment

    assigned = np.full(len(tracks.ids), -1)  # row of each track's detection, -1 without one
    if not len(tracks.ids) or not len(detections.rows):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    cost = _measure_costs(tracks, detections, time)
    is_sure = detections.scores >= SURE_SCORE
    for is_in_round in (is_sure, ~is_sure):
        round_detections = np.flatnonzero(is_in_round)
        free_tracks = np.flatnonzero(assigned < 0)
        round_cost = cost[free_tracks[:, None], round_detections]
        # the solver pairs all that it can, impossible pairs too
        rows, columns = linear_sum_assignment(round_cost)
        is_possible = round_cost[rows, columns] < _IMPOSSIBLE_COST
        matched_tracks = free_tracks[rows[is_possible]]
        assigned[matched_tracks] = round_detections[columns[is_possible]]
    assigned_tracks = np.flatnonzero(assigned >= 0)
    return assigned_tracks, assigned[assigned_tracks]


def _measure_costs(
    tracks: TrackStates, detections: MeasuredRows, time: float
) -> Float64[np.ndarray, "m n"]:
    """Cost of each detection for each track, `_IMPOSSIBLE_COST` if they cannot be one road user.

    The cost is the squared Mahalanobis distance of the centres (in variances of the predicted place
    and of the gate), more for another class and, after a gap, for another size.

    Args:
        tracks: m tracks as predicted for the time of the detections.
        detections: n detections of a frame.
        time: Time of the frame (s)."""
    labels = tracks.label()
    boxes = detections.boxes
    along = np.maximum(GATE_ALONG_M[labels], GATE_LENGTH_SHARE * tracks.size[:, 0])
    gates = rotate_variances(tracks.yaw, along**2, GATE_ACROSS_M[labels] ** 2)
    inverse = np.linalg.inv(tracks.covariance[:, :2, :2] + gates)
    dx = boxes[:, 0] - tracks.motion[:, :1]  # (m, n)
    dy = boxes[:, 1] - tracks.motion[:, 1:2]
    cost = inverse[:, 0, 0, None] * dx * dx
    cost += 2 * inverse[:, 0, 1, None] * dx * dy
    cost += inverse[:, 1, 1, None] * dy * dy
    is_impossible = cost > MAX_SQUARED_DISTANCE
    is_impossible |= find_unlike(labels, detections.labels)
    cost += OTHER_CLASS_COST * (labels[:, None] != detections.labels)
    # people who walk next to each other are told apart by their heights
    is_walker = labels == PEDESTRIAN
    if is_walker.any():
        heights = tracks.size[is_walker, 2]
        cost[is_walker] += np.square((boxes[:, 5] - heights[:, None]) / HEIGHT_COST_M)
    # a pedestrian's length and width change with each step, so they say nothing
    is_returning = (time - tracks.last_time > GAP_S) & (labels != PEDESTRIAN)
    if is_returning.any():
        sizes = tracks.size[is_returning, None, :2]
        size_difference = np.abs(boxes[:, 3:5] - sizes).max(axis=2)
        cost[is_returning] += np.square(size_difference / SIZE_COST_M)
    cost[is_impossible] = _IMPOSSIBLE_COST
    return cost
