"""What the fusion centre has at each instant: of every sensor the newest frame whose message has arrived.

The frame that is put together so has the sensors' measurements from different instants and the truth of now, so that
every scheme fuses and is scored as if it were one. A message older than `STALE` is not shown; a sensor without one
measures nothing. Traffic begins anew where no track goes on from one frame to the next (as recordings of `coview
simulate` do after each block); so do the messages there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64
from toolkit.datasets.readings import Readable, read_frame
from toolkit.detection.link.channel import PERFECT, STALE, Line, LinkChannel
from toolkit.frame import Frame
from toolkit.sensors.errors.clock import MOST_APART
from toolkit.sensors.errors.profile import ErrorProfile
from toolkit.sensors.errors.profiles import PAPER_ERRORS


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
