"""Channels: delay, jitter, loss and rate of messages.

Losses come singly or in bursts. A channel has the two states of Gilbert and Elliott: one loses
every message, the other none (Gilbert: Capacity of a burst-noise channel, Bell System Technical
Journal 39, 1960). With a share l lost in bursts of b messages on average, the bad state ends after
a message with probability 1 / b and begins with l / (b (1 - l)).

At each instant the centre has the newest frame of every sensor whose message has arrived. The
combined frame holds measurements of different instants and the truth of now, so every scheme fuses
it and is scored as usual. A message older than `STALE` is not shown; a sensor without one measures
nothing. Traffic restarts where no track continues from one frame to the next (as recordings of
`coview simulate` do after each block), and so do the messages.

`Tracks` moves earlier detections to their current places. Each track is a Kalman filter of position
    and velocity in the
ground plane (Bar-Shalom, Li and Kirubarajan: Estimation with Applications to Tracking and
    Navigation, 2001, section
6.2: white noise acceleration). A detection joins the nearest track of its label within a gate, the
    nearest pairs first.
At ten frames a second road users move by at most a third of the distance between them, so that an
    optimal assignment
would join the same pairs. A box is moved only where its speed is sure: `SURE_SPEED` times its
    standard deviation."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64
from toolkit.boxes import check_boxes
from toolkit.datasets.recordings import read_frame
from toolkit.frame import Frame, Frames
from toolkit.objects import Detections
from toolkit.sensors.error_profiles import PAPER_ERRORS, ErrorProfile
from toolkit.sensors.error_terms import MOST_APART

STALE = 1.0  # s, age at which a message is too old to be shown


@dataclass(frozen=True)
class LinkChannel:
    """Channel of one sensor's messages.

    delay: of every message (s); jitter: standard deviation of the extra delay, never below 0 (s);
    loss: share of lost messages; burst: mean number of messages lost in a row, None for independent
    losses; every: the sensor sends each n-th frame. Raises ValueError for what no channel can
    have."""

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
            said = (
                f"burst must be at least {1 / (1 - self.loss):g} messages where a share of "
                f"{self.loss} is lost"
            )
            raise ValueError(f"{said}, got {self.burst}: that is the mean of independent losses")
        if self.every < 1:
            raise ValueError(f"every must be at least 1 frame, got {self.every}")

    @property
    def mean_burst(self) -> float:
        """Mean number of messages lost in a row."""
        return 1 / (1 - self.loss) if self.burst is None else self.burst


PERFECT = LinkChannel()


class Line:
    """Messages of one sensor through a channel, by seed."""

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
    """Frame as the centre has it, and as the sensors measure now (`sent`). ages: of each sensor's
    measurement (s), NaN without one; since: seconds since traffic restarted."""

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

    channels: one for each sensor, or one for all, drawn apart from `seed`; frames: only the first
    ones; errors, noise_seed: see `toolkit.datasets.recordings.read_frame`; frozen: sensors
    (indices) that keep sending, with current times, their first measurement since traffic started;
    needed: numbers of a sensor's messages that must have arrived to read one, None for itself
    alone. Raises ValueError for channels with any effect if frames are more than `MOST_APART` from
    each other."""
    count = min(len(recording), len(recording) if frames is None else frames)
    history: list[Frame] = []
    lines: list[Line] = []
    arrived: list[list[float]] = []
    for k in range(count):
        now = read_frame(recording, k, errors=errors, noise_seed=noise_seed)
        begins = not history or not np.isin(now.objects.ids, history[-1].objects.ids).any()
        if begins:
            each = (
                [channels] * len(now.sensors)
                if isinstance(channels, LinkChannel)
                else list(channels)
            )
            history = []
            arrived = [[] for _ in now.sensors]
            lines = [Line(channel, [seed, k, sensor]) for sensor, channel in enumerate(each)]
        elif (apart := now.time - history[-1].time) > MOST_APART and any(
            line.channel != PERFECT for line in lines
        ):
            said = (
                f"frames must be at most {MOST_APART} s apart to show late or lost messages, got "
                f"{apart:g} s"
            )
            raise ValueError(f"{said}: record with coview simulate --every 0.1")
        history.append(now)
        for times, line in zip(arrived, lines, strict=True):
            times.append(line.arrival(now.time))
        stale = sum(now.time - frame.time > STALE + 1e-9 for frame in history)
        newest: list[int | None] = []  # number of the newest frame of each sensor that can be read
        for times in arrived:
            read = (
                (j, [j] if needed is None else needed(j))
                for j in reversed(range(stale, len(history)))
            )
            newest.append(
                next(
                    (j for j, of in read if all(times[each] <= now.time + 1e-9 for each in of)),
                    None,
                )
            )
        sent, _ = _put_together(history, [len(history) - 1] * len(arrived), frozen)
        yield Lagged(*_put_together(history, newest, frozen), now.time - history[0].time, sent)


def _put_together(
    history: Sequence[Frame], newest: Sequence[int | None], frozen: Sequence[int]
) -> tuple[Frame, Float64[np.ndarray, " sensors"]]:
    now = history[-1]
    sensors = []
    measurements = []
    shifts = []
    ages = []
    for sensor, k in enumerate(newest):
        shown = now if k is None else history[0 if sensor in frozen else k]
        sensors.append(shown.sensors[sensor])
        measured = shown.images[sensor]
        measurements.append(np.zeros_like(measured) if k is None else measured)
        shifts.append(shown.shifts[sensor] if shown.shifts else None)
        ages.append(np.nan if k is None else now.time - history[k].time)
    some = tuple(shifts) if any(shift is not None for shift in shifts) else ()
    put = replace(now, sensors=tuple(sensors), measurements=tuple(measurements), shifts=some)
    return put, np.array(ages)


# m between a detection and where its track is predicted
GATE = 1.0
WIDEST_GATE = 8.0
SIGMA = 2.5  # the gate widens by this many standard deviations of that position
MEASURED = 0.15  # m, standard deviation of a detected centre
ACCELERATION = 3.0  # m/s², standard deviation
FIRST_SPEED = 8.0  # m/s, standard deviation before a second detection
SURE_SPEED = 2.0  # least speed that counts, in its standard deviations
FORGOTTEN = 1.0  # s without a detection


class Tracks:
    """Tracks of detected objects, none at first; times in s."""

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
        """Update with detections of a time, not before the last. Raises ValueError for boxes that
        are none."""
        check_boxes(detections.boxes)
        if not (math.isfinite(time) and (time >= self._time or not len(self))):
            raise ValueError(
                f"detections must come in order of time, got {time} s after {self._time} s"
            )
        step = time - self._time if len(self) else 0.0
        again = time == self._time
        move = np.eye(4)
        pushed = np.array([step**2 / 2, step]) * ACCELERATION
        move[[0, 1], [2, 3]] = step
        state = self._state @ move.T
        covariance = move @ self._covariance @ move.T + np.kron(np.outer(pushed, pushed), np.eye(2))

        apart = np.linalg.norm(detections.boxes[:, None, :2] - state[None, :, :2], axis=2)
        apart[detections.labels[:, None] != self._labels[None]] = np.inf
        variance = covariance[:, 0, 0]  # as much along y
        # track of each detection
        rows = np.full(len(detections), -1, np.int64)
        taken = np.zeros(len(self), bool)
        near = np.argwhere(apart <= np.minimum(GATE + SIGMA * np.sqrt(variance), WIDEST_GATE))
        for detection, track in near[np.argsort(apart[tuple(near.T)], kind="stable")]:
            if rows[detection] < 0 and not taken[track]:
                rows[detection] = track
                taken[track] = True

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
        self._time = time
        self._detected = detections
        self._seen = seen[kept]
        self._rows = (np.cumsum(kept) - 1)[rows]
        self._state = np.concatenate([state, begun])[kept]
        self._covariance = np.concatenate([covariance, np.tile(spread, (len(fresh), 1, 1))])[kept]
        self._labels = np.concatenate([self._labels, detections.labels[fresh]])[kept]

    def at(self, time: float) -> Detections:
        """Last detections, moved to another time."""
        speed = self._state[self._rows, 2:]
        variance = np.diagonal(self._covariance, axis1=1, axis2=2)[self._rows, 2:].sum(axis=1)
        sure = np.linalg.norm(speed, axis=1) > SURE_SPEED * np.sqrt(variance)
        boxes = self._detected.boxes.copy()
        boxes[:, :2] += np.where(sure[:, None], speed, 0) * (time - self._time)
        return Detections(boxes, self._detected.scores, self._detected.labels)
