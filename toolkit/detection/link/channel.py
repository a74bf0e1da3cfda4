"""`LinkChannel`: delay, jitter, losses and rate of the messages of one sensor, drawn one after another.

Losses come singly or in bursts: the two states of Gilbert and Elliott, of which one loses every message and the other
none (Gilbert: Capacity of a burst-noise channel, Bell System Technical Journal 39, 1960). With a share l lost in bursts
of b messages in the mean, the bad state ends after a message with probability 1 / b and begins with l / (b (1 - l)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

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
