"""Clocks of a running centre."""

import time
from threading import Event
from typing import Protocol

_MAX_NAP_S = 0.2  # a sleeper looks for the end of the run this often


class Clock(Protocol):
    """Clock on which measurements and arrivals are timed."""

    @property
    def speed(self) -> float:
        """Seconds of this clock that pass in a second."""

    def now(self) -> float:
        """Time (s)."""

    def wait(self, time_s: float, stop: Event) -> None:
        """Return at a time (s) or when `stop` is set."""


class RunningClock:
    """Clock that shows a time when it is made, and runs on.

    Args:
        start_s: Time that it shows first (s).
        speed: Seconds of this clock that pass in a second, 1 for real time.

    Raises:
        ValueError: The speed is not above 0.
    """

    def __init__(self, start_s: float, speed: float = 1.0) -> None:
        """Begin now."""
        if not 0 < speed < float("inf"):
            raise ValueError(f"speed must be above 0, got {speed:g}: give 1 for real time")
        self.speed = speed
        self._start_s = start_s  # shown at `_begun_s` of the system's clock
        self._begun_s = time.monotonic()

    def now(self) -> float:
        """Time (s)."""
        return self._start_s + self.speed * (time.monotonic() - self._begun_s)

    def set_back(self, lag_s: float) -> None:
        """Show a time that is `lag_s` seconds earlier from now on."""
        self._start_s -= lag_s

    def wait(self, time_s: float, stop: Event) -> None:
        """Return at a time (s) or when `stop` is set."""
        while not stop.is_set():
            remaining_s = (time_s - self.now()) / self.speed
            if remaining_s <= 0:
                return
            time.sleep(min(remaining_s, _MAX_NAP_S))
