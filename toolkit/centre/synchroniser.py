"""`Synchroniser`: messages of all sensors in groups of one moment.

A group opens with a message that fits no open group, and takes one message of every other sensor,
from half an interval before it to nearly an interval after. So sensors that turn freely, each in
another phase, make whole groups, too. A group is complete when it has every sensor that is
expected. It is given out then, or when its missing sensors have sent their next message already, or
after a wait. A message whose group is out, or has one of that sensor already, is counted as late
and left out."""

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np

from toolkit.centre.sensor_message import SensorMessage

_TOLERANCE_S = 1e-6  # rounding of times of measurement
MAX_AFTER_SHARE = 0.9  # share of an interval, from a group's first message to its last


@dataclass(eq=False)
class MessageGroup:
    """Messages of one moment, at most one of each sensor.

    Attributes:
        anchor_s: Measurement time of the first message (s).
        opened_s: Arrival of the first message (s).
        messages: By name of the sensor.
    """

    anchor_s: float
    opened_s: float
    messages: dict[str, SensorMessage] = field(default_factory=dict)

    @property
    def time_s(self) -> float:
        """Time of the newest measurement (s)."""
        return max(message.time_s for message in self.messages.values())


class Synchroniser:
    """Groups of messages, in the order of time.

    Args:
        interval_s: Time from one measurement of a sensor to its next (s).
        patience_s: Wait for missing sensors from a group's first message (s).

    Attributes:
        interval_s: As given.
        late: Numbers of late messages by sensor.
    """

    def __init__(self, interval_s: float, patience_s: float) -> None:
        """Begin without messages. Raises ValueError for an interval that is not above 0."""
        if not 0 < interval_s < np.inf:
            raise ValueError(f"the interval must be seconds above 0, got {interval_s:g}")
        self.interval_s = interval_s
        self.late: Counter[str] = Counter()
        self._before_s = interval_s / 2
        self._after_s = MAX_AFTER_SHARE * interval_s
        self._patience_s = patience_s
        self._groups: list[MessageGroup] = []
        self._last_anchor_s = -np.inf  # anchor of the last group given out

    def add(self, message: SensorMessage) -> None:
        """Add a message to its group, or count it as late.

        A group takes messages from half an interval before its first one on. A second message of a
        sensor in one group is late if it is near the group's first one, else it opens a group."""
        if message.time_s < self._last_anchor_s + self._before_s - _TOLERANCE_S:
            self.late[message.sensor] += 1
            return
        for group in self._groups:
            after_s = message.time_s - group.anchor_s
            is_near = -self._before_s + _TOLERANCE_S < after_s < self._after_s - _TOLERANCE_S
            if is_near and message.sensor not in group.messages:
                group.messages[message.sensor] = message
                return
            if is_near and abs(after_s) < self._before_s - _TOLERANCE_S:
                self.late[message.sensor] += 1
                return
        group = MessageGroup(message.time_s, message.arrival_s, {message.sensor: message})
        self._groups.append(group)
        self._groups.sort(key=lambda group: group.anchor_s)

    def take(self, now_s: float, expected: Collection[str]) -> list[MessageGroup]:
        """Return the groups that wait for nobody, the oldest first.

        now_s: time (s); expected: names of the sensors that work."""
        ready = []
        while self._groups and self._is_ready(self._groups[0], now_s, expected):
            group = self._groups.pop(0)
            self._last_anchor_s = group.anchor_s
            ready.append(group)
        return ready

    def flush(self) -> list[MessageGroup]:
        """Return all groups, complete or not, after the last message."""
        groups = self._groups
        self._groups = []
        return groups

    def _is_ready(self, group: MessageGroup, now_s: float, expected: Collection[str]) -> bool:
        """Return True if a group, the oldest one, needs no more messages."""
        if now_s - group.opened_s >= self._patience_s:
            return True
        missing = set(expected) - group.messages.keys()
        for younger in self._groups[1:]:
            missing -= younger.messages.keys()
        return not missing
