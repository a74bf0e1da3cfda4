"""`Result`: what every search returns: the best set, how it got there, and what is known of how good it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from placement_env.objective import Score
from toolkit.arrays import Float64, Int64
from toolkit.sensors.sensor import Sensor


@dataclass(frozen=True, eq=False)
class History:
    """The best reward so far after each improvement, and at the end: it never falls.

    evaluations: sets scored until then; seconds: since the search began, on this machine; reward: of the best set.
    """

    evaluations: Int64[np.ndarray, " n"]
    seconds: Float64[np.ndarray, " n"]
    reward: Float64[np.ndarray, " n"]

    def at(self, *, evaluations: float = np.inf, seconds: float = np.inf) -> float:
        """The best reward when so many sets were scored, or so many seconds had passed; 0, the empty set's, before."""
        known = (self.evaluations <= evaluations) & (self.seconds <= seconds)
        return float(self.reward[known][-1]) if known.any() else 0.0


@dataclass(frozen=True)
class Certificate:
    """What is known of how good an answer is.

    kind: "optimal", no feasible set is better; "bound", none is better than `bound`; "local optimum", none that differs
    in one sensor is better; "none", nothing is known.
    value, bound: of the answer and of all feasible sets, in `measure`; ratio: the share of the optimum that the method
    is sure to reach before it starts, 0 where none; note: in words, with the conditions.
    """

    kind: Literal["optimal", "bound", "local optimum", "none"]
    value: float
    bound: float = np.inf
    ratio: float = 0.0
    note: str = ""
    measure: Literal["reward", "coverage"] = "reward"

    @property
    def gap(self) -> float:
        """How much better the optimum may be, in `measure`: 0 when the answer is proven optimal."""
        return max(0.0, self.bound - self.value)


@dataclass(frozen=True, eq=False)
class Result:
    """The answer of a search.

    evaluations: sets scored, repeated ones too; front: the sets that no other beats in AP, kbit and price at once, of
    those that were scored, by price and kbit (searches for fronts only); by_size: the best set of 1, 2, ... sensors
    (exhaustive only); sensors: as they are mounted, for continuous poses.
    """

    method: str
    best: Score
    history: History
    certificate: Certificate
    evaluations: int
    seconds: float
    front: tuple[Score, ...] = ()
    by_size: tuple[Score, ...] = ()
    sensors: tuple[Sensor, ...] = ()

    def __str__(self) -> str:
        known = self.certificate
        bound = f", at most {known.bound:.4f} {known.measure}" if np.isfinite(known.bound) else ""
        chosen = ", ".join(str(c) for c in self.best.subset)
        return (
            f"{self.method}: {{{chosen}}} reward {self.best.reward:.4f} after {self.evaluations} sets and "
            f"{self.seconds:.1f} s ({known.kind}{bound})"
        )
