"""`Tracks`: current places of earlier detections, which move at constant velocity.

Each track is a Kalman filter of position and velocity in the ground plane (Bar-Shalom,
Li and Kirubarajan: Estimation with Applications to Tracking and Navigation, 2001, section 6.2: white noise
acceleration). A detection joins the nearest track of its label within a gate, the nearest pairs first. At ten frames a
second road users move by at most a third of the distance between them. An optimal assignment would join the same pairs,
so no solver is needed.

A box is moved only where its speed is sure: `SURE_SPEED` times its standard deviation. Its size, height, yaw and score
stay.
"""

from __future__ import annotations

import numpy as np

from toolkit.objects import Detections

GATE, WIDEST_GATE = 1.0, 8.0  # m between a detection and where its track is predicted
SIGMA = 2.5  # the gate widens by this many standard deviations of that position
MEASURED = 0.15  # m, standard deviation of a detected centre
ACCELERATION = 3.0  # m/s², standard deviation
FIRST_SPEED = 8.0  # m/s, standard deviation before a second detection
SURE_SPEED = 2.0  # least speed that counts, in its standard deviations
FORGOTTEN = 1.0  # s without a detection


class Tracks:
    """Tracks of detected objects, none at first. Times are in s."""

    def __init__(self) -> None:
        self._time = 0.0
        self._state = np.zeros((0, 4))  # x, y and their velocities
        self._covariance = np.zeros((0, 4, 4))
        self._labels = np.zeros(0, np.int64)
        self._seen = np.zeros(0)
        self._detected = Detections.empty()
        self._rows = np.zeros(0, np.int64)  # track of each detection

    def __len__(self) -> int:
        return len(self._state)

    def update(self, detections: Detections, time: float) -> None:
        """Update with detections in measurements of a time. Raises ValueError for a time before the last one."""
        if len(self) and time < self._time:
            raise ValueError(f"detections must come in order of time, got {time} s after {self._time} s")
        step, again = time - self._time if len(self) else 0.0, bool(len(self)) and time == self._time
        move, pushed = np.eye(4), np.array([step**2 / 2, step]) * ACCELERATION
        move[[0, 1], [2, 3]] = step
        state = self._state @ move.T
        covariance = move @ self._covariance @ move.T + np.kron(np.outer(pushed, pushed), np.eye(2))

        apart = np.linalg.norm(detections.boxes[:, None, :2] - state[None, :, :2], axis=2)
        apart[detections.labels[:, None] != self._labels[None]] = np.inf
        variance = np.diagonal(covariance, axis1=1, axis2=2)[:, :2].max(axis=1, initial=0)
        rows, taken = np.full(len(detections), -1, np.int64), np.zeros(len(self), bool)  # track of each detection
        near = np.argwhere(apart <= np.minimum(GATE + SIGMA * np.sqrt(variance), WIDEST_GATE))
        for detection, track in near[np.argsort(apart[tuple(near.T)], kind="stable")]:
            if rows[detection] < 0 and not taken[track]:
                rows[detection], taken[track] = track, True

        if not again:  # repeated measurements add nothing
            matched = np.flatnonzero(rows >= 0)
            before = covariance[rows[matched]]
            gain = before[:, :, :2] @ np.linalg.inv(before[:, :2, :2] + MEASURED**2 * np.eye(2))
            off = detections.boxes[matched, :2] - state[rows[matched], :2]
            state[rows[matched]] += (gain @ off[:, :, None])[:, :, 0]
            covariance[rows[matched]] = before - gain @ before[:, :2, :]
        fresh = np.flatnonzero(rows < 0)
        rows[fresh] = len(self) + np.arange(len(fresh))
        begun = np.column_stack([detections.boxes[fresh, :2], np.zeros((len(fresh), 2))])
        spread = np.diag([MEASURED**2, MEASURED**2, FIRST_SPEED**2, FIRST_SPEED**2])
        seen = np.concatenate([self._seen, np.full(len(fresh), time)])
        seen[rows] = time
        kept = time - seen <= FORGOTTEN
        self._time, self._detected, self._seen, self._rows = time, detections, seen[kept], (np.cumsum(kept) - 1)[rows]
        self._state = np.concatenate([state, begun])[kept]
        self._covariance = np.concatenate([covariance, np.tile(spread, (len(fresh), 1, 1))])[kept]
        self._labels = np.concatenate([self._labels, detections.labels[fresh]])[kept]

    def at(self, time: float) -> Detections:
        """Last detections, moved to another time."""
        speed = self._state[self._rows, 2:]
        variance = np.diagonal(self._covariance, axis1=1, axis2=2)[self._rows, 2:].sum(axis=1)
        sure = (speed**2).sum(axis=1) > SURE_SPEED**2 * variance
        boxes = self._detected.boxes.copy()
        boxes[:, :2] += np.where(sure[:, None], speed, 0) * (time - self._time)
        return Detections(boxes, self._detected.scores, self._detected.labels)
