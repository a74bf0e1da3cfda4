"""Which bodies the next road users get: any of their class, or each body once before any comes again."""

from __future__ import annotations

import numpy as np

from toolkit.arrays import Int64


class Supply:
    """Bodies in the order in which chance hands them out.

    count: how many bodies there are; once: a body that was taken does not come again before all others it was offered
    with have been taken too, so that of a fleet that is large enough everyone has a body of its own.
    """

    def __init__(self, count: int, once: bool = False) -> None:
        self._once, self._taken = once, np.zeros(count, bool)

    def offer(self, rows: Int64[np.ndarray, " n"], rng: np.random.Generator) -> int:
        """One of these rows, drawn; `take` it where it is used."""
        if not self._once:
            return int(rng.choice(rows))
        free = rows[~self._taken[rows]]
        if not len(free):
            self._taken[rows], free = False, rows
        return int(rng.choice(free))

    def take(self, row: int) -> None:
        """Note that a row is used."""
        self._taken[row] = True

    def give_back(self, row: int) -> None:
        """Note that a row was not used after all."""
        self._taken[row] = False

    def several(self, rows: Int64[np.ndarray, " n"], number: int, rng: np.random.Generator) -> Int64[np.ndarray, " m"]:
        """`number` of these rows, drawn and taken."""
        if not self._once:
            return rng.choice(rows, number)
        drawn = []
        for _ in range(number):
            drawn.append(self.offer(rows, rng))
            self.take(drawn[-1])
        return np.array(drawn, np.int64)
