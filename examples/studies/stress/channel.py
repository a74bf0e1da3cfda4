"""Channels: delay, jitter, loss and rate of messages.

Losses are single or in bursts. A channel has the two states of Gilbert and Elliott: one loses every
message, the other no message (Gilbert: Capacity of a burst-noise channel, Bell System Technical
Journal 39, 1960). With a share l lost in bursts of b messages on average, the bad state ends after
a message with probability 1 / b and begins with l / (b (1 - l)).

At each instant the centre has the newest frame of every sensor whose message has arrived. The
combined frame holds measurements of different instants and the truth of now, so every scheme fuses
it and is scored as usual. A message older than `MAX_AGE_S` is not shown; a sensor without one
measures nothing. Traffic restarts when no track continues from one frame to the next (as recordings
of `coview simulate` do after each block), and so do the messages."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64
from toolkit.datasets.recording_views import read_frame
from toolkit.frame import Frame, Frames
from toolkit.sensors.error_profile import ErrorProfile
from toolkit.sensors.error_profiles import PAPER_ERRORS
from toolkit.sensors.track_velocities import MOST_APART

MAX_AGE_S = 1.0  # older messages are not shown


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
    """Messages of one sensor through a channel, drawn from a seed.

    Each message takes two draws, lost or not, so that channels with one seed share their draws."""

    def __init__(self, channel: LinkChannel, seed: int | list[int]) -> None:
        self.channel = channel
        self._rng = np.random.default_rng(seed)
        self._sent = 0
        self._bad = bool(self._rng.random() < channel.loss)

    def arrival(self, time: float) -> float:
        """Arrival (s) of the next message, infinite if it is lost or not sent.

        time: time of its measurement (s), from which the delay counts."""
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

    Attributes:
        frame: Newest arrived measurement of each sensor, with the objects of now.
        ages: Age of each sensor's measurement (s), NaN without one.
        since: Time since traffic restarted (s).
        sent: Frame that the sensors measure now.
    """

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
    """Number of the first candidate whose needed messages have arrived, None without one.

    candidates: number of a frame, and numbers of the messages needed to read it; times: arrival of
    each message (s); now: present time (s)."""
    for number, needed_numbers in candidates:
        if all(times[needed] <= now + 1e-9 for needed in needed_numbers):
            return number
    return None


def _put_together(
    history: Sequence[Frame], newest: Sequence[int | None], frozen: Sequence[int]
) -> tuple[Frame, Float64[np.ndarray, " sensors"]]:
    # frame of the newest measurements with the objects of now, and their ages (s); newest: number
    # in `history` of each sensor's frame, None for a blank image; frozen: sensors that repeat the
    # first frame
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
