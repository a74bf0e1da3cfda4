"""Channels: delay, jitter, loss and rate of messages.

Losses are single or in bursts. A channel has the two states of Gilbert and Elliott: one loses every
message, the other no message (Gilbert: Capacity of a burst-noise channel, Bell System Technical
Journal 39, 1960). With a share l lost in bursts of b messages on average, the bad state ends after
a message with probability 1 / b and begins with l / (b (1 - l)).

At each instant the centre has the newest frame of every sensor whose message has arrived. The
combined frame holds measurements of different instants and the truth of now, so every scheme fuses
it and is scored as usual. A message older than `MAX_AGE_S` is not shown; a sensor without one
measures nothing. Traffic restarts when no track continues from one frame to the next (as recordings
of `coview simulate` do after each block), and so do the messages.

`Tracks` moves earlier detections to their current positions. Each track is a Kalman filter of
position and velocity in the ground plane (Bar-Shalom, Li and Kirubarajan: Estimation with
Applications to Tracking and Navigation, 2001, section 6.2: white noise acceleration). A detection
joins the nearest track of its label within a gate, the nearest pairs first. At ten frames a second
road users move by at most a third of the distance between them, so that an optimal assignment would
join the same pairs. A box is moved only if its speed is certain: `MIN_SPEED_SIGMAS` times its
standard deviation."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64, Int64
from toolkit.boxes import check_boxes
from toolkit.datasets.recording_views import read_frame
from toolkit.frame import Frame, Frames
from toolkit.objects import Detections
from toolkit.sensors.error_profile import ErrorProfile
from toolkit.sensors.error_profiles import PAPER_ERRORS
from toolkit.sensors.track_velocities import MOST_APART

MAX_AGE_S = 1.0  # older messages are not shown
GATE_M = 1.0  # between a detection and the predicted position of its track
MAX_GATE_M = 8.0
GATE_SIGMAS = 2.5  # standard deviations of the predicted position by which the gate widens
CENTRE_SIGMA_M = 0.15  # standard deviation of a detected centre
ACCELERATION_SIGMA_MPS2 = 3.0
FIRST_SPEED_SIGMA_MPS = 8.0  # before a second detection
MIN_SPEED_SIGMAS = 2.0  # standard deviations of a speed that counts
MAX_UNSEEN_S = 1.0  # without a detection


@dataclass(frozen=True)
class LinkChannel:
    """Channel of one sensor's messages. Raises ValueError for impossible values.

    Attributes:
        delay: delay of every message (s).
        jitter: standard deviation of the extra delay, which is never below 0 (s).
        loss: share of lost messages.
        burst: mean number of messages lost in a row, None for independent losses.
        every: the sensor sends each n-th frame.
    """

    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0
    burst: float | None = None
    every: int = 1

    def __post_init__(self) -> None:
        for name in ("delay", "jitter"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be seconds from 0 on, got {getattr(self, name)}")
        if not 0 <= self.loss < 1:
            raise ValueError(f"loss must be a share from 0 to below 1, got {self.loss}")
        if self.burst is not None and not 1 / (1 - self.loss) <= self.burst < math.inf:
            rule = (
                f"burst must be at least {1 / (1 - self.loss):g} messages where a share of "
                f"{self.loss} is lost"
            )
            raise ValueError(f"{rule}, got {self.burst}: that is the mean of independent losses")
        if self.every < 1:
            raise ValueError(f"every must be at least 1 frame, got {self.every}")

    @property
    def mean_burst(self) -> float:
        """Mean number of messages lost in a row."""
        return 1 / (1 - self.loss) if self.burst is None else self.burst


PERFECT = LinkChannel()


class Line:
    """Messages of one sensor through a channel, drawn from a seed."""

    def __init__(self, channel: LinkChannel, seed: int | list[int]) -> None:
        self.channel = channel
        self._rng = np.random.default_rng(seed)
        self._sent = 0
        self._bad = bool(self._rng.random() < channel.loss)

    def arrival(self, time: float) -> float:
        """Arrival (s) of a message, infinite if it is lost."""
        channel = self.channel
        number = self._sent
        self._sent += 1
        jitter = self._rng.standard_normal() * channel.jitter
        change = self._rng.random()
        if number % channel.every:
            return math.inf
        lost = self._bad
        begins = channel.loss / (channel.mean_burst * (1 - channel.loss))
        self._bad = change >= 1 / channel.mean_burst if lost else change < begins
        return math.inf if lost else time + channel.delay + max(jitter, 0.0)


class Lagged(NamedTuple):
    """Frame as the centre has it, and as the sensors measure now.

    ages: age of each sensor's measurement (s), NaN without one; since: seconds since traffic
    restarted; sent: the frame that the sensors measure now."""

    frame: Frame
    ages: Float64[np.ndarray, " sensors"]
    since: float
    sent: Frame


def delay_frames(
    recording: Frames,
    channels: Sequence[LinkChannel] | LinkChannel,
    *,
    frames: int | None = None,
    seed: int = 0,
    errors: ErrorProfile | str = PAPER_ERRORS,
    noise_seed: int | None = 0,
    frozen: Sequence[int] = (),
    needed: Callable[[int], Sequence[int]] | None = None,
) -> Iterator[Lagged]:
    """Yield the centre's frame at the time of each frame.

    channels: one for each sensor, or one for all, drawn from `seed`; frames: number of frames, None
    for all; errors, noise_seed: see `toolkit.datasets.recording_views.read_frame`; frozen: sensors
    (indices) that keep sending, with current times, their first measurement since traffic started;
    needed: numbers of a sensor's messages that must have arrived to read one, None for only that
    message. Raises ValueError for channels with any effect if frames are more than `MOST_APART`
    apart."""
    count = min(len(recording), len(recording) if frames is None else frames)
    history: list[Frame] = []
    lines: list[Line] = []
    arrived: list[list[float]] = []
    for k in range(count):
        now = read_frame(recording, k, errors=errors, noise_seed=noise_seed)
        begins = not history or not np.isin(now.objects.ids, history[-1].objects.ids).any()
        if begins:
            if isinstance(channels, LinkChannel):
                sensor_channels = [channels] * len(now.sensors)
            else:
                sensor_channels = list(channels)
            history = []
            arrived = [[] for _ in now.sensors]
            lines = [
                Line(channel, [seed, k, sensor]) for sensor, channel in enumerate(sensor_channels)
            ]
        else:
            _check_spacing(now.time - history[-1].time, lines)
        history.append(now)
        for times, line in zip(arrived, lines, strict=True):
            times.append(line.arrival(now.time))
        stale = sum(now.time - frame.time > MAX_AGE_S + 1e-9 for frame in history)
        newest: list[int | None] = []  # number of the newest frame of each sensor that can be read
        for times in arrived:
            candidates = (
                (j, [j] if needed is None else needed(j))
                for j in reversed(range(stale, len(history)))
            )
            newest.append(_find_readable(candidates, times, now.time))
        sent, _ = _put_together(history, [len(history) - 1] * len(arrived), frozen)
        yield Lagged(*_put_together(history, newest, frozen), now.time - history[0].time, sent)


def _check_spacing(step: float, lines: Sequence[Line]) -> None:
    """Raise ValueError if channels have any effect and frames are too far apart to show it."""
    if step > MOST_APART and any(line.channel != PERFECT for line in lines):
        rule = (
            f"frames must be at most {MOST_APART} s apart to show late or lost messages, got "
            f"{step:g} s"
        )
        raise ValueError(f"{rule}: record with coview simulate --every 0.1")


def _find_readable(
    candidates: Iterable[tuple[int, Sequence[int]]], times: Sequence[float], now: float
) -> int | None:
    """First candidate whose needed messages have arrived, None without one.

    candidates: number of a frame, and numbers of the messages needed to read it; times: when
    the messages arrive (s)."""
    for number, needed_numbers in candidates:
        if all(times[needed] <= now + 1e-9 for needed in needed_numbers):
            return number
    return None


def _put_together(
    history: Sequence[Frame], newest: Sequence[int | None], frozen: Sequence[int]
) -> tuple[Frame, Float64[np.ndarray, " sensors"]]:
    now = history[-1]
    sensors = []
    measurements = []
    shifts = []
    ages = []
    for sensor, k in enumerate(newest):
        source = now
        if k is not None:
            source = history[0 if sensor in frozen else k]
        sensors.append(source.sensors[sensor])
        measured = source.images[sensor]
        measurements.append(np.zeros_like(measured) if k is None else measured)
        shifts.append(source.shifts[sensor] if source.shifts else None)
        ages.append(np.nan if k is None else now.time - history[k].time)
    frame_shifts = tuple(shifts) if any(shift is not None for shift in shifts) else ()
    combined = replace(
        now, sensors=tuple(sensors), measurements=tuple(measurements), shifts=frame_shifts
    )
    return combined, np.array(ages)


class Tracks:
    """Tracks of detected objects; times in s."""

    def __init__(self) -> None:
        self._time = 0.0
        self._state = np.empty((0, 4))  # x, y and their velocities
        self._covariance = np.empty((0, 4, 4))
        self._labels = np.empty(0, np.int64)
        self._seen = np.empty(0)
        self._detected = Detections.empty()
        self._rows = np.empty(0, np.int64)  # track of each detection

    def __len__(self) -> int:
        return len(self._state)

    def update(self, detections: Detections, time: float) -> None:
        """Update with detections of a time, not before the last. Raises ValueError for impossible
        boxes."""
        check_boxes(detections.boxes)
        if not (math.isfinite(time) and (time >= self._time or not len(self))):
            raise ValueError(
                f"detections must come in order of time, got {time} s after {self._time} s"
            )
        step = time - self._time if len(self) else 0.0
        is_repeat = time == self._time
        move = np.eye(4)
        acceleration_step = np.array([step**2 / 2, step]) * ACCELERATION_SIGMA_MPS2
        move[[0, 1], [2, 3]] = step
        state = self._state @ move.T
        noise = np.kron(np.outer(acceleration_step, acceleration_step), np.eye(2))
        covariance = move @ self._covariance @ move.T + noise
        rows = self._match(detections, state, covariance)
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
        seen = np.concatenate([self._seen, np.full(len(new_rows), time)])
        seen[rows] = time
        is_kept = time - seen <= MAX_UNSEEN_S
        self._time = time
        self._detected = detections
        self._seen = seen[is_kept]
        self._rows = (np.cumsum(is_kept) - 1)[rows]
        self._state = np.concatenate([state, new_states])[is_kept]
        self._covariance = np.concatenate([covariance, new_covariance])[is_kept]
        self._labels = np.concatenate([self._labels, detections.labels[new_rows]])[is_kept]

    def _match(
        self,
        detections: Detections,
        state: Float64[np.ndarray, "n 4"],
        covariance: Float64[np.ndarray, "n 4 4"],
    ) -> Int64[np.ndarray, " m"]:
        """Track of each detection, -1 without one: nearest pairs within the gate first."""
        distances = np.linalg.norm(detections.boxes[:, None, :2] - state[None, :, :2], axis=2)
        distances[detections.labels[:, None] != self._labels[None]] = np.inf
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
        """Return the last detections, moved to another time."""
        speed = self._state[self._rows, 2:]
        variance = np.diagonal(self._covariance, axis1=1, axis2=2)[self._rows, 2:].sum(axis=1)
        is_sure = np.linalg.norm(speed, axis=1) > MIN_SPEED_SIGMAS * np.sqrt(variance)
        boxes = self._detected.boxes.copy()
        boxes[:, :2] += np.where(is_sure[:, None], speed, 0) * (time - self._time)
        return Detections(boxes, self._detected.scores, self._detected.labels)
