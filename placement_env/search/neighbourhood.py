"""`Neighbourhood`: feasible sets at random, and feasible sets that differ from a given one in one sensor."""

from __future__ import annotations

import numpy as np

from placement_env.objective import Objective
from toolkit.arrays import Bool, Int64

DROP = 0.05  # share of changes that drop a sensor
TURN = 0.5  # share of the others that stay on a mount of the set


class Neighbourhood:
    """Sets of at most `budget` of an objective's candidates: one per mount, each within the capacity of its link, all
    together for no more than the objective's `most_price`."""

    def __init__(self, objective: Objective, budget: int) -> None:
        self.budget, self.mount, self._objective = budget, objective.candidates.mount, objective
        self.free = np.flatnonzero(objective.allowed([]))
        self._of_mount = {int(m): self.free[self.mount[self.free] == m] for m in np.unique(self.mount[self.free])}

    def sample(self, rng: np.random.Generator) -> list[int]:
        """A set of `budget` candidates, or as many as there are mounts and money: mounts at random, then a candidate of
        each that can be paid."""
        chosen: list[int] = []
        for mount in rng.permutation(list(self._of_mount)) if self._of_mount else ():
            options = self._of_mount[int(mount)]
            options = options[self._payable(chosen, options)]
            if len(chosen) < self.budget and options.size:
                chosen.append(int(rng.choice(options)))
        return chosen

    def neighbour(self, chosen: list[int], rng: np.random.Generator) -> list[int]:
        """The set with one sensor dropped, added or replaced; the same set where one was drawn that it has, or where no
        candidate may stand. A sensor replaces the one on its mount, in a full set any, and as many as cost too much."""
        if not self.free.size or (chosen and rng.random() < DROP):
            gone = int(rng.integers(len(chosen))) if chosen else 0
            return chosen[:gone] + chosen[gone + 1 :]
        if chosen and rng.random() < TURN:
            new = int(rng.choice(self._of_mount[int(self.mount[chosen[int(rng.integers(len(chosen)))]])]))
        else:
            new = int(self.free[int(rng.integers(len(self.free)))])
        kept = [c for c in chosen if self.mount[c] != self.mount[new]]
        if len(kept) == self.budget:
            kept.pop(int(rng.integers(self.budget)))
        while not self._payable(kept, np.array([new]))[0]:
            kept.pop(int(rng.integers(len(kept))))
        return [*kept, new]

    def repair(self, chosen: list[int], rng: np.random.Generator) -> list[int]:
        """A feasible subset of a set: members in random order, without those that do not fit beside earlier ones."""
        kept: dict[int, int] = {}
        for candidate in rng.permutation(np.intersect1d(chosen, self.free)).tolist():
            if len(kept) < self.budget and self._payable(list(kept.values()), np.array([candidate]))[0]:
                kept.setdefault(int(self.mount[candidate]), int(candidate))
        return list(kept.values())

    def _payable(self, chosen: list[int], options: Int64[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """Which options can be paid beside the members of a set."""
        prices = self._objective.candidates.prices
        return self._objective.affordable(prices[chosen].sum() + prices[options])
