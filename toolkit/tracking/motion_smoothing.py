"""Kalman's filter and its smoother backwards (Rauch, Tung and Striebel 1965), of many tracks.

All tracks of about one length take each step together."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float64, Int64
from toolkit.tracking.motion_model import ACCELERATIONS_M_S2, FIRST_SPEEDS_M_S, constant_velocities

MAX_GROUP_ROWS = 60_000  # frames of the longest track, times tracks, that are held at a time


class MeasuredCourse(NamedTuple):
    """Measured places of one track.

    Attributes:
        centres: Measured x, y (m) of each detection.
        noise: Covariance of each place (m²).
        seen: Frame of each detection, counted from the track's first.
        seconds: Time of each of the track's frames (s).
        label: Class of the track."""

    centres: Float64[np.ndarray, "k 2"]
    noise: Float64[np.ndarray, "k 2 2"]
    seen: Int64[np.ndarray, " k"]
    seconds: Float64[np.ndarray, " f"]
    label: int


class _Group(NamedTuple):
    """Measured places of n tracks in f frames, the longest track first.

    Attributes:
        lengths: Number of frames of each track.
        seconds: Time of each frame, the last one repeated.
        is_seen: Mask of the frames with a detection.
        centres: Measured x, y (m), 0 without a detection.
        noise: Covariance of each.
        labels: Class of each track."""

    lengths: Int64[np.ndarray, " n"]
    seconds: Float64[np.ndarray, "f n"]
    is_seen: Bool[np.ndarray, "f n"]
    centres: Float64[np.ndarray, "f n 2"]
    noise: Float64[np.ndarray, "f n 2 2"]
    labels: Int64[np.ndarray, " n"]

    @staticmethod
    def from_courses(courses: Sequence[MeasuredCourse]) -> "_Group":
        """Make a group of courses that are sorted by their number of frames, the longest first.

        Frames are rows and courses columns. A shorter course ends with copies of its last time,
        without detections."""
        lengths = np.array([len(course.seconds) for course in courses])
        shape = (int(lengths[0]), len(courses))
        group = _Group(
            lengths,
            seconds=np.empty(shape),
            is_seen=np.zeros(shape, np.bool_),
            centres=np.zeros((*shape, 2)),
            noise=np.zeros((*shape, 2, 2)),
            labels=np.array([course.label for course in courses]),
        )
        for column, course in enumerate(courses):
            length = len(course.seconds)
            group.seconds[:length, column] = course.seconds
            group.seconds[length:, column] = course.seconds[-1]
            group.is_seen[course.seen, column] = True
            group.centres[course.seen, column] = course.centres
            group.noise[course.seen, column] = course.noise
        return group

    def count(self, frame: int) -> int:
        """Number of tracks that have a frame; they are the first ones, being the longest."""
        return int((self.lengths > frame).sum())


def smooth_motions(courses: Sequence[MeasuredCourse]) -> list[Float64[np.ndarray, "_ 4"]]:
    """Return x, y (m) and the velocity along both (m/s) of each track in each of its frames.

    courses: measured places of each track; the result has their order."""
    motions: list[Float64[np.ndarray, "_ 4"]] = [np.zeros((0, 4))] * len(courses)
    longest_first = sorted(range(len(courses)), key=lambda number: -len(courses[number].seconds))
    for numbers in _split(longest_first, courses):
        group = _Group.from_courses([courses[number] for number in numbers])
        states = _smooth_group(group)
        for column, number in enumerate(numbers):
            motions[number] = states[: group.lengths[column], column]
    return motions


def _split(order: Sequence[int], courses: Sequence[MeasuredCourse]) -> Iterator[list[int]]:
    """Yield the numbers of tracks that are smoothed together, at most `MAX_GROUP_ROWS` rows.

    order: numbers of all tracks, the longest first; courses: measured places, by number."""
    begin = 0
    while begin < len(order):
        longest = len(courses[order[begin]].seconds)
        size = max(1, MAX_GROUP_ROWS // longest)
        yield list(order[begin : begin + size])
        begin += size


def _smooth_group(group: _Group) -> Float64[np.ndarray, "f n 4"]:
    """x, y (m) and the velocity along both (m/s) of n tracks in f frames.

    Rows after a track's last frame mean nothing."""
    frames, tracks = group.seconds.shape
    states = np.zeros((frames, tracks, 4))
    covariances = np.zeros((frames, tracks, 4, 4))
    predicted_states = np.zeros_like(states)
    predicted_covariances = np.zeros_like(covariances)
    states[0, :, :2] = group.centres[0]
    covariances[0, :, :2, :2] = group.noise[0]
    first_variance = FIRST_SPEEDS_M_S[group.labels] ** 2
    covariances[0, :, 2, 2] = first_variance
    covariances[0, :, 3, 3] = first_variance
    variance = ACCELERATIONS_M_S2[group.labels] ** 2
    steps = np.diff(group.seconds, axis=0)
    # forwards: Kalman's filter
    for k in range(1, frames):
        count = group.count(k)
        transition, step_noise = constant_velocities(steps[k - 1, :count])
        state = (transition @ states[k - 1, :count, :, None])[..., 0]
        covariance = transition @ covariances[k - 1, :count] @ transition.transpose(0, 2, 1)
        covariance += variance[:count, None, None] * step_noise
        predicted_states[k, :count] = state
        predicted_covariances[k, :count] = covariance
        rows = np.flatnonzero(group.is_seen[k, :count])
        seen_covariance = covariance[rows]
        innovation = group.centres[k, rows] - state[rows, :2]
        spread = np.linalg.inv(seen_covariance[:, :2, :2] + group.noise[k, rows])
        gain = seen_covariance[:, :, :2] @ spread
        state[rows] += (gain @ innovation[:, :, None])[..., 0]
        covariance[rows] -= gain @ seen_covariance[:, :2]
        states[k, :count] = state
        covariances[k, :count] = covariance
    # backwards: Rauch, Tung and Striebel's smoother
    for k in range(frames - 2, -1, -1):
        count = group.count(k + 1)
        transition, _ = constant_velocities(steps[k, :count])
        inverse = np.linalg.inv(predicted_covariances[k + 1, :count])
        gain = covariances[k, :count] @ transition.transpose(0, 2, 1) @ inverse
        change = states[k + 1, :count] - predicted_states[k + 1, :count]
        states[k, :count] += (gain @ change[:, :, None])[..., 0]
    return states
