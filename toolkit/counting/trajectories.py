"""Trajectories: one road user after the other, from the road users of frame after frame."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import BoxRows, Float64, Int64
from toolkit.geometry import smooth_rows
from toolkit.objects import LABELS, Detections, Objects
from toolkit.tracking.tracks import Tracks

MIN_TRACK_SCORE = 0.3  # mean score of a track that counts
SPEED_SMOOTHING_S = 0.3  # standard deviation of the mean over time of measured positions
MOVING_M_S = 0.5  # slower is standing
MAX_EVEN_STEPS = 1.5  # median steps between rows, above which some are missing


class Trajectory(NamedTuple):
    """Road user in the n frames in which it is known.

    Attributes:
        id: its number.
        label: class of `toolkit.objects.LABELS`, as a number.
        times: time of each row (s), ascending.
        boxes: box at each time.
        velocities: along x and y at each time (m/s)."""

    id: int
    label: int
    times: Float64[np.ndarray, " n"]
    boxes: BoxRows
    velocities: Float64[np.ndarray, "n 2"]

    @property
    def speeds(self) -> Float64[np.ndarray, " n"]:
        """Speed at each time (m/s)."""
        return np.hypot(self.velocities[:, 0], self.velocities[:, 1])

    @property
    def known_s(self) -> float:
        """Seconds in which it is known, without gaps; 0 for a single time."""
        steps = np.diff(self.times)
        return len(self.times) * float(np.median(steps)) if len(steps) else 0.0

    def select(self, rows: slice) -> "Trajectory":
        """Part of the trajectory. rows: its rows."""
        return self._replace(
            times=self.times[rows], boxes=self.boxes[rows], velocities=self.velocities[rows]
        )


def collect_trajectories(
    frames: Sequence[Objects] | Sequence[Tracks], times: Sequence[float]
) -> list[Trajectory]:
    """Trajectories of true objects, or of tracks that are sure enough, in the order of their ids.

    A track has the class in which most of its boxes are, by their scores. Velocities
    follow from the positions, smoothed over `SPEED_SMOOTHING_S`.

    Args:
        frames: Road users in each frame, with ids that last.
        times: Time of each frame (s), ascending.

    Raises ValueError for another number of times than of frames, and for times that do not rise."""
    if len(frames) != len(times):
        raise ValueError(f"each frame needs a time, got {len(frames)} and {len(times)}")
    steps = np.diff(times)
    if not (steps > 0).all():
        number = int(np.argmin(steps > 0)) + 1
        raise ValueError(
            "trajectories need frames in the order of time, one at each time, got "
            f"{times[number]:g} s after {times[number - 1]:g} s at frame {number}"
        )
    counts = [len(objects) for objects in frames]
    seconds = np.repeat(np.asarray(times, np.float64), counts)
    if not len(seconds):
        return []
    scores = None
    if isinstance(frames[0], Detections):
        scores = np.concatenate([tracks.scores for tracks in frames if isinstance(tracks, Tracks)])
    return split_trajectories(
        np.concatenate([_list_ids(objects) for objects in frames]),
        np.concatenate([objects.labels for objects in frames]),
        np.concatenate([objects.boxes for objects in frames]),
        seconds,
        scores=scores,
    )


def split_trajectories(
    ids: Int64[np.ndarray, " n"],
    labels: Int64[np.ndarray, " n"],
    boxes: BoxRows,
    seconds: Float64[np.ndarray, " n"],
    *,
    scores: Float64[np.ndarray, " n"] | None = None,
) -> list[Trajectory]:
    """Trajectories from rows of all road users at all times, in the order of their ids.

    Args:
        ids: Number of each row's road user.
        labels: Class of each row.
        boxes: Box of each row.
        seconds: Time of each row, ascending.
        scores: Score of each row, None for true objects."""
    order = np.argsort(ids, kind="stable")
    names, begins = np.unique(ids[order], return_index=True)
    trajectories = []
    for name, rows in zip(names.tolist(), np.split(order, begins[1:]), strict=True):
        weights = None if scores is None else scores[rows]
        if weights is not None and weights.mean() < MIN_TRACK_SCORE:
            continue
        label = int(np.bincount(labels[rows], weights, len(LABELS)).argmax())
        velocities = _find_velocities(boxes[rows, :2], seconds[rows])
        trajectories.append(
            Trajectory(
                id=name, label=label, times=seconds[rows], boxes=boxes[rows], velocities=velocities
            )
        )
    return trajectories


def _list_ids(objects: Objects | Tracks) -> np.ndarray:
    """Ids of the road users of a frame, in the order of its boxes."""
    return np.asarray(objects.ids)


def _find_velocities(
    points: Float64[np.ndarray, "n 2"], seconds: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 2"]:
    """Velocity along x and y at each time (m/s), 0 for a single one.

    points: x, y (m); seconds: their times (s), ascending."""
    if len(points) < 2:
        return np.zeros((len(points), 2))
    steps = np.diff(seconds)
    step = float(np.median(steps))
    sigma = SPEED_SMOOTHING_S / step  # in rows
    if steps.max() > MAX_EVEN_STEPS * step:
        # rows are smoothed at equal distances in time
        even_times = np.arange(seconds[0], seconds[-1] + step, step)
        even_points = smooth_rows(_interpolate(even_times, seconds, points), sigma)
        smoothed = _interpolate(seconds, even_times, even_points)
    else:
        smoothed = smooth_rows(points, sigma)
    return np.stack([np.gradient(smoothed[:, axis], seconds) for axis in (0, 1)], axis=1)


def _interpolate(
    times: Float64[np.ndarray, " k"],
    seconds: Float64[np.ndarray, " n"],
    points: Float64[np.ndarray, "n 2"],
) -> Float64[np.ndarray, "k 2"]:
    """Points (x, y) at some times (s), on straight lines between known points.

    seconds: times of the known points (s), ascending."""
    return np.stack([np.interp(times, seconds, points[:, axis]) for axis in (0, 1)], axis=1)
