"""`Inbox`: what the fusion centre takes of the messages of one sensor: each once, none after a newer one.

Messages are numbered by their sensor. Whatever arrives is read first, so that what is damaged is a ValueError and
changes nothing. A message whose number is not above the last one taken is a duplicate, where it has that number or one
that was taken before, or else late; both are counted and not shown. Numbers left out are lost, until they arrive late.
"""

from __future__ import annotations

from collections import deque
from enum import Enum

from toolkit.detection.link.message import MessageHeader, read_message

REMEMBERED = 1024  # numbers of messages that were taken, for telling what is late from what comes twice


class Arrival(Enum):
    """What became of a message."""

    TAKEN = "taken"
    DUPLICATE = "duplicate"
    LATE = "late"


class Inbox:
    """Of the sensor with this number, see `toolkit.detection.link.message.sensor_number`.

    latest: header of the last message taken, None before the first; taken, duplicates, late: how many.
    """

    def __init__(self, sensor: int) -> None:
        self.sensor = sensor
        self.latest: MessageHeader | None = None
        self.taken = self.duplicates = self.late = 0
        self._seen: deque[int] = deque(maxlen=REMEMBERED)
        self._first = self._missing = 0

    def receive(self, message: bytes) -> Arrival:
        """Take a message or say why not. Raises ValueError where it is damaged, another sensor's, or its time runs
        backwards while its number does not; the inbox stays as it was."""
        header, _ = read_message(message)
        if header.sensor != self.sensor:
            raise ValueError(f"expected a message with sensor {self.sensor}, got {header.sensor}: it is another's")
        if self.latest is not None and header.number <= self.latest.number:
            if header.number in self._seen:
                self.duplicates += 1
                return Arrival.DUPLICATE
            self._seen.append(header.number)
            self.late += 1
            self._missing -= header.number > self._first
            return Arrival.LATE
        if self.latest is not None and header.time_us < self.latest.time_us:
            raise ValueError(
                f"message {header.number} was measured at {header.time} s, before message {self.latest.number} at "
                f"{self.latest.time} s: the sensor's clock was set back, begin with a new inbox"
            )
        if self.latest is None:
            self._first = header.number
        else:
            self._missing += header.number - self.latest.number - 1
        self.latest = header
        self.taken += 1
        self._seen.append(header.number)
        return Arrival.TAKEN

    @property
    def lost(self) -> int:
        """Messages that were numbered between the first and the last one taken and have not arrived."""
        return self._missing

    def age(self, now: float) -> float:
        """Seconds since the measurement that is shown, infinite before the first."""
        return float("inf") if self.latest is None else now - self.latest.time
