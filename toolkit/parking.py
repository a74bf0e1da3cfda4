"""Vehicles parked in a site's bays: some of the bays, other vehicles now and then."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from toolkit.arrays import Float64, Int64
from toolkit.objects import VEHICLE
from toolkit.site import Site

if TYPE_CHECKING:
    from toolkit.bodies import Body

STAY = 20.0  # frames, mean
OCCUPIED = (0.3, 0.9)  # share of the bays, from .. to


@dataclass(frozen=True, eq=False)
class Parked:
    """bays: (m, 3) x, y, yaw of all bays; of each parked vehicle: bay, body, id, and pose x, y, yaw."""

    bays: Float64[np.ndarray, "m 3"]
    places: Int64[np.ndarray, " n"]
    bodies: Int64[np.ndarray, " n"]
    ids: Int64[np.ndarray, " n"]
    poses: Float64[np.ndarray, "n 3"]

    @staticmethod
    def draw(site: Site, bodies: Sequence[Body], rng: np.random.Generator, ids: Iterator[int], most: int) -> Parked:
        """Vehicles in a random share of the site's bays, not more than `most`."""
        bays = site.parking
        number = min(round(len(bays) * rng.uniform(*OCCUPIED)), most)
        places = rng.permutation(len(bays))[:number]
        none = Parked(bays, places, np.zeros(number, np.int64), np.zeros(number, np.int64), np.zeros((number, 3)))
        return none._refilled(np.ones(number, bool), bodies, rng, ids)

    def later(self, bodies: Sequence[Body], rng: np.random.Generator, ids: Iterator[int]) -> Parked:
        """One frame later: each vehicle has left with probability 1 / `STAY`, and another stands in a free bay."""
        return self._refilled(rng.random(len(self.ids)) < 1 / STAY, bodies, rng, ids)

    def _refilled(
        self, left: np.ndarray, bodies: Sequence[Body], rng: np.random.Generator, ids: Iterator[int]
    ) -> Parked:
        if not left.any():
            return self
        number = int(left.sum())
        parked = replace(self, **{k: getattr(self, k).copy() for k in ("places", "bodies", "ids", "poses")})
        free = np.setdiff1d(np.arange(len(self.bays)), self.places[~left])
        parked.places[left] = rng.permutation(free)[:number]
        parked.bodies[left] = rng.choice([row for row, body in enumerate(bodies) if body.label == VEHICLE], number)
        parked.ids[left] = [next(ids) for _ in range(number)]
        parked.poses[left] = self.bays[parked.places[left]] + rng.normal(0, [0.15, 0.15, np.deg2rad(2.0)], (number, 3))
        parked.poses[left, 2] += np.pi * rng.integers(2, size=number)  # nose or tail first
        return parked
