"""`LinkChannel`: delay, jitter, losses and rate of the messages of one sensor, drawn one after another.

Losses come singly or in bursts: the two states of Gilbert and Elliott, of which one loses every message and the other
none (Gilbert: Capacity of a burst-noise channel, Bell System Technical Journal 39, 1960). With a share l lost in bursts
of b messages in the mean, the bad state ends after a message with probability 1 / b and begins with l / (b (1 - l)).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64
from toolkit.datasets.readings import Readable, read_frame
from toolkit.frame import Frame
from toolkit.sensors.error_profiles import PAPER_ERRORS, ErrorProfile
from toolkit.sensors.error_terms import MOST_APART

STALE = 1.0  # s, from which on a message is too old to be shown


@dataclass(frozen=True)
class LinkChannel:
    """delay: of every message (s); jitter: standard deviation of what comes on top, never below 0 (s); loss: share of
    messages that are lost; burst: of how many in the mean a loss consists, None for losses that are independent; every:
    the sensor sends each so-many-th frame.

    Raises ValueError for times below 0, a share outside 0..1 or 1 itself, bursts that are shorter than losses that are
    independent make them, and every below 1.
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
            raise ValueError(
                f"burst must be at least {1 / (1 - self.loss):g} messages where a share of {self.loss} is lost, got "
                f"{self.burst}: independent losses come so already"
            )
        if self.every < 1:
            raise ValueError(f"every must be at least 1 frame, got {self.every}")

    @property
    def mean_burst(self) -> float:
        """Messages that are lost one after another, in the mean."""
        return 1 / (1 - self.loss) if self.burst is None else self.burst


PERFECT = LinkChannel()


class Line:
    """The messages of one sensor through a channel, in the order they are sent; seed: of all that is drawn."""

    def __init__(self, channel: LinkChannel, seed: int | list[int]) -> None:
        self.channel, self._rng, self._sent = channel, np.random.default_rng(seed), 0
        self._bad = bool(self._rng.random() < channel.loss)

    def arrival(self, time: float) -> float:
        """When a message arrives that was measured at a time (s); infinite where it is lost or not sent."""
        channel, number = self.channel, self._sent
        self._sent += 1
        jitter, change = self._rng.standard_normal() * channel.jitter, self._rng.random()
        if number % channel.every:
            return math.inf
        lost = self._bad
        begins = channel.loss / (channel.mean_burst * (1 - channel.loss))
        self._bad = change >= 1 / channel.mean_burst if lost else change < begins
        return math.inf if lost else time + channel.delay + max(jitter, 0.0)


class Lagged(NamedTuple):
    """frame: what the centre has; ages: of each sensor's measurement (s), NaN where there is none; since: seconds since
    traffic began anew; sent: what the sensors measure now."""

    frame: Frame
    ages: Float64[np.ndarray, " sensors"]
    since: float
    sent: Frame


def lagged_frames(
    recording: Readable,
    channels: Sequence[LinkChannel] | LinkChannel,
    *,
    frames: int | None = None,
    seed: int = 0,
    errors: ErrorProfile | str = PAPER_ERRORS,
    noise_seed: int | None = 0,
    frozen: Sequence[int] = (),
    needed: Callable[[int], Sequence[int]] | None = None,
) -> Iterator[Lagged]:
    """What the centre has at the time of each frame.

    channels: one for each sensor, or one that they all have, drawn apart; frames: only the first so many; seed: of the
    channels; errors, noise_seed: see `toolkit.datasets.readings.read_frame`; frozen: sensors (indices) that send, with
    the time of now, what they measured when traffic began; needed: which of a sensor's messages, counted from 0 since
    traffic began, must have arrived for one to be read, None for itself alone.

    Raises ValueError for channels that do anything where frames are more than `MOST_APART` from each other.
    """
    count = min(len(recording), len(recording) if frames is None else frames)
    history: list[Frame] = []
    lines: list[Line] = []
    arrived: list[list[float]] = []
    for k in range(count):
        now = read_frame(recording, k, errors=errors, noise_seed=noise_seed)
        begins = not history or not np.isin(now.objects.ids, history[-1].objects.ids).any()
        if begins:
            each = [channels] * len(now.sensors) if isinstance(channels, LinkChannel) else list(channels)
            history, arrived = [], [[] for _ in now.sensors]
            lines = [Line(channel, [seed, k, sensor]) for sensor, channel in enumerate(each)]
        elif any(line.channel != PERFECT for line in lines) and now.time - history[-1].time > MOST_APART:
            apart = now.time - history[-1].time
            raise ValueError(
                f"frames {apart:g} s apart cannot show what is late or lost, {MOST_APART} s is most: record some with "
                "coview simulate --every 0.1"
            )
        history.append(now)
        for times, line in zip(arrived, lines, strict=True):
            times.append(line.arrival(now.time))
        newest = [_newest(times, history, now.time, needed) for times in arrived]
        sent, _ = _put_together(history, [len(history) - 1] * len(arrived), frozen)
        yield Lagged(*_put_together(history, newest, frozen), now.time - history[0].time, sent)


def _newest(
    arrivals: Sequence[float],
    history: Sequence[Frame],
    now: float,
    needed: Callable[[int], Sequence[int]] | None,
) -> int | None:
    """The newest frame that has arrived, with all that it takes to read it, and is not too old."""
    for k in range(len(arrivals) - 1, -1, -1):
        if now - history[k].time > STALE + 1e-9:
            return None
        if all(arrivals[each] <= now + 1e-9 for each in ([k] if needed is None else needed(k))):
            return k
    return None


def _put_together(
    history: Sequence[Frame], newest: Sequence[int | None], frozen: Sequence[int]
) -> tuple[Frame, Float64[np.ndarray, " sensors"]]:
    """The frame of these instants, and how old each of its measurements seems."""
    now = history[-1]
    sensors, measurements, shifts, ages = [], [], [], []
    for sensor, k in enumerate(newest):
        shown = now if k is None else history[0 if sensor in frozen else k]
        sensors.append(shown.sensors[sensor])
        measured = shown.measurements[sensor]
        measurements.append(np.zeros_like(measured) if k is None else measured)
        shifts.append(shown.shifts[sensor] if shown.shifts else None)
        ages.append(np.nan if k is None else now.time - history[k].time)
    some = tuple(shifts) if any(shift is not None for shift in shifts) else ()
    put = replace(now, sensors=tuple(sensors), measurements=tuple(measurements), shifts=some)
    return put, np.array(ages)
