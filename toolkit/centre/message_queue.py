"""`MessageQueue`: bounded queue between the inputs and the centre, which drops the oldest."""

from collections import Counter, deque
from threading import Condition, Event
from typing import Protocol

from toolkit.centre.sensor_message import SensorMessage

MAX_WAITING_MESSAGES = 64  # a second of six sensors at 10 Hz


class MessageSource(Protocol):
    """Messages that have arrived, as the centre takes them."""

    @property
    def drops(self) -> Counter[str]:
        """Numbers of dropped messages by sensor."""

    def take(self, wait_s: float) -> list[SensorMessage] | None:
        """Return the messages that arrive within `wait_s` seconds, None after the last one."""

    def rest(self, wait_s: float) -> None:
        """Return after some seconds, sooner if woken. For the time after the last message."""

    def wake(self) -> None:
        """End the wait of `take` or `rest`, from another thread."""


class MessageQueue:
    """Queue of messages that several threads fill and one empties.

    Args:
        stop: Ends the queue at once when it is set.
        max_messages: Largest number of messages that wait; beyond it the oldest is dropped.

    Attributes:
        drops: Numbers of dropped messages by sensor.
    """

    def __init__(self, stop: Event, max_messages: int = MAX_WAITING_MESSAGES) -> None:
        """Begin without messages.

        stop: ends the run; max_messages: number of messages beyond which the oldest is dropped."""
        if max_messages < 1:
            raise ValueError(f"a queue must hold at least 1 message, got {max_messages}")
        self.drops: Counter[str] = Counter()
        self._stop = stop
        self._max_messages = max_messages
        self._messages: deque[SensorMessage] = deque()
        self._is_closed = False
        self._is_woken = False
        self._changed = Condition()

    def __len__(self) -> int:
        return len(self._messages)

    def put(self, message: SensorMessage) -> None:
        """Add a message; if the queue is full, the oldest one is dropped and counted."""
        with self._changed:
            if len(self._messages) == self._max_messages:
                self.drops[self._messages.popleft().sensor] += 1
            self._messages.append(message)
            self._changed.notify()

    def close(self) -> None:
        """Let `take` return None once the queue is empty."""
        with self._changed:
            self._is_closed = True
            self._changed.notify()

    def wake(self) -> None:
        """Let a `take` or `rest` that waits, or else the next one, return without a wait."""
        with self._changed:
            self._is_woken = True
            self._changed.notify()

    def rest(self, wait_s: float) -> None:
        """Wait for some seconds, at most until `wake` is called."""
        with self._changed:
            if not self._is_woken:
                self._changed.wait(wait_s)
            self._is_woken = False

    def take(self, wait_s: float) -> list[SensorMessage] | None:
        """Return all waiting messages, after a wait of at most `wait_s` for the first one.

        None if the queue is closed and empty, or was stopped."""
        with self._changed:
            if not (self._messages or self._is_closed or self._is_woken):
                self._changed.wait(wait_s)
            self._is_woken = False
            is_finished = self._is_closed and not self._messages
            if is_finished or self._stop.is_set():
                return None
            messages = list(self._messages)
            self._messages.clear()
            return messages
