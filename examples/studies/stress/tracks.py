"""`Tracks`: move earlier detections to their present places.

Each track is a Kalman filter of position and velocity in the ground plane (Bar-Shalom, Li and
Kirubarajan: Estimation with Applications to Tracking and Navigation, 2001, section 6.2: white noise
acceleration). A detection joins the nearest track of its label within a gate, the nearest pairs
first. At ten frames a second road users move by at most a third of the distance between them, so
that an optimal assignment would join the same pairs. A box is moved only if its speed is certain:
`MIN_SPEED_SIGMAS` times its standard deviation."""

import math

import numpy as np

from toolkit.arrays import Float64, Int64
from toolkit.boxes import check_boxes
from toolkit.objects import Detections

GATE_M = 1.0  # least gate: distance between a detection and its track's predicted position
MAX_GATE_M = 8.0  # greatest gate
GATE_SIGMAS = 2.5  # standard deviations of the predicted position by which the gate widens
CENTRE_SIGMA_M = 0.15  # standard deviation of a detected centre
ACCELERATION_SIGMA_MPS2 = 3.0
FIRST_SPEED_SIGMA_MPS = 8.0  # before a second detection
MIN_SPEED_SIGMAS = 2.0  # standard deviations of a speed that counts
MAX_UNSEEN_S = 1.0  # time without a detection after which a track ends


class Tracks:
    """Tracks of detected objects; times in s.

    Attributes:
        time: Time of the last detections.
        state: (n, 4) position (m) and velocity (m/s) in the ground plane.
        covariance: (n, 4, 4) covariance of `state`.
        labels: (n,) classes.
        seen: (n,) time of the last detection of each track.
        detected: Last detections.
        rows: (m,) index of the track of each last detection."""

    def __init__(self) -> None:
        self.time = 0.0
        self.state = np.empty((0, 4))  # x, y and their velocities
        self.covariance = np.empty((0, 4, 4))
        self.labels = np.empty(0, np.int64)
        self.seen = np.empty(0)
        self.detected = Detections.empty()
        self.rows = np.empty(0, np.int64)  # track of each detection

    def __len__(self) -> int:
        return len(self.state)

    def update(self, detections: Detections, time: float) -> None:
        """Move all tracks to a time, and update them with its detections.

        Detections without a track begin one, and tracks unseen for long end. time: s, not before
        the last update; at the same time again, tracks are not corrected twice. Raises ValueError
        for an earlier time and impossible boxes."""
        check_boxes(detections.boxes)
        if not (math.isfinite(time) and (time >= self.time or not len(self))):
            raise ValueError(
                f"detections must come in order of time, got {time} s after {self.time} s"
            )
        step = time - self.time if len(self) else 0.0
        is_repeat = time == self.time
        move = np.eye(4)  # from a state to the state after the step
        acceleration_step = np.array([step**2 / 2, step]) * ACCELERATION_SIGMA_MPS2
        move[[0, 1], [2, 3]] = step
        state = self.state @ move.T
        noise = np.kron(np.outer(acceleration_step, acceleration_step), np.eye(2))
        covariance = move @ self.covariance @ move.T + noise
        rows = self._match(detections, state, covariance)  # track of each detection, -1 for none
        if not is_repeat:  # repeated measurements add nothing
            matched = np.flatnonzero(rows >= 0)
            prior = covariance[rows[matched]]
            gain = prior[:, :, :2] @ np.linalg.inv(prior[:, :2, :2] + CENTRE_SIGMA_M**2 * np.eye(2))
            offsets = detections.boxes[matched, :2] - state[rows[matched], :2]
            state[rows[matched]] += (gain @ offsets[:, :, None])[:, :, 0]
            covariance[rows[matched]] = prior - gain @ prior[:, :2, :]
        new_rows = np.flatnonzero(rows < 0)
        rows[new_rows] = len(self) + np.arange(len(new_rows))
        new_states = np.column_stack([detections.boxes[new_rows, :2], np.zeros((len(new_rows), 2))])
        sigmas = [CENTRE_SIGMA_M, CENTRE_SIGMA_M, FIRST_SPEED_SIGMA_MPS, FIRST_SPEED_SIGMA_MPS]
        spread = np.diag([sigma**2 for sigma in sigmas])
        new_covariance = np.tile(spread, (len(new_rows), 1, 1))
        seen = np.concatenate([self.seen, np.full(len(new_rows), time)])
        seen[rows] = time
        is_kept = time - seen <= MAX_UNSEEN_S
        self.time = time
        self.detected = detections
        self.seen = seen[is_kept]
        self.rows = (np.cumsum(is_kept) - 1)[rows]  # indices after ended tracks are removed
        self.state = np.concatenate([state, new_states])[is_kept]
        self.covariance = np.concatenate([covariance, new_covariance])[is_kept]
        self.labels = np.concatenate([self.labels, detections.labels[new_rows]])[is_kept]

    def _match(
        self,
        detections: Detections,
        state: Float64[np.ndarray, "n 4"],
        covariance: Float64[np.ndarray, "n 4 4"],
    ) -> Int64[np.ndarray, " m"]:
        """Index of the track of each detection, -1 without one.

        Pairs of one class within the gate are joined, the nearest first. state, covariance: the
        tracks', predicted for the time of the detections."""
        distances = np.linalg.norm(detections.boxes[:, None, :2] - state[None, :, :2], axis=2)
        distances[detections.labels[:, None] != self.labels[None]] = np.inf
        variance = covariance[:, 0, 0]  # as much along y
        gates = np.minimum(GATE_M + GATE_SIGMAS * np.sqrt(variance), MAX_GATE_M)
        rows = np.full(len(detections), -1, np.int64)
        is_taken = np.zeros(len(self), bool)
        pairs = np.argwhere(distances <= gates)
        for detection, track in pairs[np.argsort(distances[tuple(pairs.T)], kind="stable")]:
            if rows[detection] < 0 and not is_taken[track]:
                rows[detection] = track
                is_taken[track] = True
        return rows

    def at(self, time: float) -> Detections:
        """Return the last detections, moved to another time (s) if their speed is certain."""
        speed = self.state[self.rows, 2:]
        variance = np.diagonal(self.covariance, axis1=1, axis2=2)[self.rows, 2:].sum(axis=1)
        is_sure = np.linalg.norm(speed, axis=1) > MIN_SPEED_SIGMAS * np.sqrt(variance)
        boxes = self.detected.boxes.copy()
        boxes[:, :2] += np.where(is_sure[:, None], speed, 0) * (time - self.time)
        return Detections(boxes, self.detected.scores, self.detected.labels)
