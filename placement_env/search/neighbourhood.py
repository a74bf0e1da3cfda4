"""`Neighbourhood`: feasible sets at random, and feasible sets that differ from a given one in one sensor."""

from __future__ import annotations

import numpy as np

from placement_env.objective import Objective
from toolkit.arrays import Bool, Int64

DROP = 0.05  # share of changes that drop a sensor
SECOND = 0.5  # of drawn sets that have a free place and budget left, where mounts carry several, take another sensor
TURN = 0.5  # share of the others that stay on a mount of the set


class Neighbourhood:
    """Sets of at most `budget` of an objective's candidates: on no mount more than it carries, each within the capacity
    of its link, all together for no more than the objective's `most_price`."""

    def __init__(self, objective: Objective, budget: int) -> None:
        self.budget, self.mount, self._objective = budget, objective.candidates.mount, objective
        self.free = np.flatnonzero(objective.allowed([]))
        self._several = objective.candidates.several
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
        while self._several and len(chosen) < self.budget and rng.random() < SECOND:
            options = np.flatnonzero(self._objective.allowed(chosen))
            if not options.size:
                break
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
        kept = self._beside(chosen, new, rng) if self._several else self._elsewhere(chosen, new)
        if len(kept) == self.budget:
            kept.pop(int(rng.integers(self.budget)))
        while kept and not self._fits(kept, new):
            kept.pop(int(rng.integers(len(kept))))
        return [*kept, new]

    def repair(self, chosen: list[int], rng: np.random.Generator) -> list[int]:
        """A feasible subset of a set: members in random order, without those that do not fit beside earlier ones."""
        kept: list[int] = []
        for candidate in rng.permutation(np.intersect1d(chosen, self.free)).tolist():
            free = self._several or len(self._elsewhere(kept, candidate)) == len(kept)
            if free and len(kept) < self.budget and self._fits(kept, candidate):
                kept.append(candidate)
        return kept

    def _elsewhere(self, chosen: list[int], new: int) -> list[int]:
        """The members of a set on other mounts than a candidate."""
        return [c for c in chosen if self.mount[c] != self.mount[new]]

    def _beside(self, chosen: list[int], new: int, rng: np.random.Generator) -> list[int]:
        """The members of a set that stay when a candidate joins: where its mount is full, and else half of the time,
        one of those on it goes."""
        here = [c for c in chosen if self.mount[c] == self.mount[new] and c != new]
        full = len(here) >= self._objective.candidates.places[self.mount[new]]
        gone = here[int(rng.integers(len(here)))] if here and (full or rng.random() < TURN) else new
        return [c for c in chosen if c not in (gone, new)]

    def _fits(self, chosen: list[int], new: int) -> bool:
        """Whether a candidate may join a set; of those on its mount there is none, unless mounts carry several."""
        if self._several:
            return bool(self._objective.allowed(chosen)[new])
        return bool(self._payable(chosen, np.array([new]))[0])

    def _payable(self, chosen: list[int], options: Int64[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """Which options can be paid beside the members of a set."""
        prices = self._objective.candidates.prices
        return self._objective.affordable(prices[chosen].sum() + prices[options])
