"""Turns of a lidar in captures of its packets, whatever its maker."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np


class Sweep(NamedTuple):
    """Points of one turn.

    Attributes:
        sensor: name of its sensor.
        number: number among the sensor's sweeps.
        time_s: when its first packet was captured.
        columns: positions (n, 3; m), intensity, ring and time_s from the first point, by name.
        is_partial: True if it is less than a turn.
        left_out: number of second returns, which are left out.
    """

    sensor: str
    number: int
    time_s: float
    columns: Mapping[str, np.ndarray]
    is_partial: bool
    left_out: int = 0


class SweepSource(Protocol):
    """Capture of the packets of some sensors."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sensors."""

    def decode(self) -> Iterator[Sweep]:
        """Yield all sweeps from the start."""


@dataclass(eq=False)
class SweepReader:
    """Reader of sweeps by number, which decodes on from where it is, or again from the start.

    decode: function that yields all sweeps of the capture."""

    decode: Callable[[], Iterator[Sweep]]
    _sweeps: Iterator[Sweep] | None = None
    _passed: dict[str, int] = field(default_factory=dict)
    _waiting: dict[tuple[str, int], Sweep] = field(default_factory=dict)

    def read(self, numbers: Mapping[str, int]) -> list[Sweep]:
        """Return one sweep of each sensor by its number.

        numbers: number of the sweep, from 0, for each sensor's name. Raises ValueError if the
        capture has fewer sweeps, such as one that was cut off meanwhile."""
        # a sweep was decoded and not kept: the capture is decoded from its start again
        is_behind = any(
            self._count(sensor) > number and (sensor, number) not in self._waiting
            for sensor, number in numbers.items()
        )
        if self._sweeps is None or is_behind:
            self._sweeps = self.decode()
            self._passed.clear()
            self._waiting.clear()
        while any(self._count(sensor) <= number for sensor, number in numbers.items()):
            sweep = next(self._sweeps, None)
            if sweep is None:
                self._sweeps = None  # decoded again for the next sweeps
                raise ValueError(
                    "the capture has fewer turns than when it was opened: restore the file"
                )
            self._passed[sweep.sensor] = sweep.number + 1
            self._waiting[sweep.sensor, sweep.number] = sweep
        sweeps = [self._waiting.pop(key) for key in numbers.items()]
        # sweeps before the ones returned are not kept
        for sensor, number in list(self._waiting):
            if number < numbers.get(sensor, 0):
                del self._waiting[sensor, number]
        return sweeps

    def _count(self, sensor: str) -> int:
        """Number of a sensor's sweeps that were decoded."""
        return self._passed.get(sensor, 0)
