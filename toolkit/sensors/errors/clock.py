"""Clocks that differ: a sensor measures somewhat earlier or later than it says, so that what moves is somewhere else.

Clocks agree to 1 to 10 ms when set by NTP, to below 1 ms by PTP or GNSS (Mills: Computer Network Time Synchronization,
2nd edition, 2010; IEEE 1588); delays of fusion come on top (Lei et al.: Latency-aware collaborative perception, ECCV
2022).

Approximation: nothing is rendered at another instant. The points on each object move by its velocity times the offset,
turns and changed occlusion are left out. Velocities come from the tracks of neighbouring frames, so that these must lie
at most `MOST_APART` from each other: 5 s, as in recordings of `coview simulate`, are too far apart to know them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from toolkit.arrays import Float64
from toolkit.objects import Objects
from toolkit.sensors.errors.draws import Draws
from toolkit.sensors.errors.profile import check_least
from toolkit.sensors.errors.reading import Reading

MOST_APART = 0.5  # s between frames from which velocities are known
_SAME = 1.0  # m by which what is measured may differ from what is there and still show it


@dataclass(frozen=True)
class ClockOffset:
    """offset: standard deviation (s) of each sensor's clock, constant over a recording."""

    needs_velocities: ClassVar[bool] = True

    offset: float = 0.0

    def __post_init__(self) -> None:
        check_least(self, offset=0)

    def apply(self, reading: Reading, draws: Draws) -> Reading:
        """The reading with the points on moving objects where these are when the sensor measures.

        Raises ValueError where velocities are not known.
        """
        if not self.offset:
            return reading
        truth = reading.truth
        if truth.velocities is None:
            raise ValueError("a clock's offset needs the objects' velocities: read a recording with tracks and times")
        late = draws.of_sensor().standard_normal() * self.offset
        moved = np.append(truth.velocities * late, np.zeros((1, 3)), axis=0)[truth.owners]
        same = reading.valid & (np.abs(reading.measurement - truth.measurement) < _SAME)
        shift = np.where(same[..., None], moved, 0).astype(np.float32)
        return replace(reading, shift=shift if reading.shift is None else reading.shift + shift)


def velocities(objects: Objects, time: float, around: Sequence[tuple[Objects, float]]) -> Float64[np.ndarray, "n 3"]:
    """Velocity (m/s, world frame) of each object of a frame, from the same tracks in the frames before and after: the
    mean over those that have it, 0 for a track that is in none.

    time: of the frame (s); around: objects and time of its neighbours. Raises ValueError where a neighbour is farther
    off than `MOST_APART` or there is none.
    """
    gaps = [abs(then - time) for _, then in around]
    if not gaps or not all(0 < gap <= MOST_APART for gap in gaps):
        apart = ", ".join(f"{gap:g} s" for gap in gaps) or "nothing"
        raise ValueError(
            f"velocities need frames at most {MOST_APART} s apart, got {apart}: leave the clock's offset out, or "
            "record more often"
        )
    total, count = np.zeros((len(objects), 3)), np.zeros(len(objects))
    for others, then in around:
        _, mine, theirs = np.intersect1d(objects.ids, others.ids, return_indices=True)
        total[mine] += (others.boxes[theirs, :3] - objects.boxes[mine, :3]) / (then - time)
        count[mine] += 1
    return total / np.maximum(count, 1)[:, None]
