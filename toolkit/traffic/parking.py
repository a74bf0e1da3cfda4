"""Vehicles parked in a site's bays: some of the bays, other vehicles now and then."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from toolkit.arrays import Float64, Int64
from toolkit.objects import VEHICLE
from toolkit.sites.site import Site
from toolkit.traffic.collisions import Obstacles
from toolkit.traffic.supply import Supply
from toolkit.traffic.vehicle_types import VehicleTypes

STAY = 20.0  # frames, mean
ROOM = (5.8, 2.4, 2.0)  # m, length, width and height a bay must offer
OCCUPIED = (0.3, 0.9)  # share of the bays, from .. to
JITTER = (0.1, 0.1, np.radians(1.0))  # m, m, rad; how far off the middle of the bay


@dataclass(frozen=True, eq=False)
class Parked:
    """bays: (m, 3) x, y, yaw of all bays; of each parked vehicle: bay, body, id, and pose x, y, yaw."""

    bays: Float64[np.ndarray, "m 3"]
    places: Int64[np.ndarray, " n"]
    bodies: Int64[np.ndarray, " n"]
    ids: Int64[np.ndarray, " n"]
    poses: Float64[np.ndarray, "n 3"]

    @staticmethod
    def draw(
        site: Site,
        obstacles: Obstacles,
        types: VehicleTypes,
        rng: np.random.Generator,
        ids: Iterator[int],
        *,
        most: int,
        supply: Supply | None = None,
    ) -> Parked:
        """Vehicles in a random share of the bays that no obstacle reaches into, not more than `most`.

        supply: what hands out their bodies, any vehicle's unless given.
        """
        x, y, yaw = site.parking.T
        room = np.column_stack([x, y, np.full((len(x), 4), (ROOM[2] / 2, *ROOM)), yaw])
        bays = site.parking[~obstacles.hit(room)]
        number = min(round(len(bays) * rng.uniform(*OCCUPIED)), most)
        places = rng.permutation(len(bays))[:number]
        none = Parked(bays, places, np.zeros(number, np.int64), np.zeros(number, np.int64), np.zeros((number, 3)))
        return none._refilled(np.ones(number, bool), types, rng, ids, supply)

    def later(
        self, types: VehicleTypes, rng: np.random.Generator, ids: Iterator[int], supply: Supply | None = None
    ) -> Parked:
        """One frame later: each vehicle has left with probability 1 / `STAY`, and another stands in a free bay."""
        return self._refilled(rng.random(len(self.ids)) < 1 / STAY, types, rng, ids, supply)

    def _refilled(
        self,
        left: np.ndarray,
        types: VehicleTypes,
        rng: np.random.Generator,
        ids: Iterator[int],
        supply: Supply | None,
    ) -> Parked:
        if not left.any():
            return self
        number = int(left.sum())
        parked = replace(self, **{k: getattr(self, k).copy() for k in ("places", "bodies", "ids", "poses")})
        free = np.setdiff1d(np.arange(len(self.bays)), self.places[~left])
        parked.places[left] = rng.permutation(free)[:number]
        supply = supply or Supply(len(types.labels))
        parked.bodies[left] = supply.several(np.flatnonzero(types.labels == VEHICLE), number, rng)
        parked.ids[left] = [next(ids) for _ in range(number)]
        off_centre = JITTER * np.clip(rng.standard_normal((number, 3)), -1.5, 1.5)
        parked.poses[left] = self.bays[parked.places[left]] + off_centre
        parked.poses[left, 2] += np.pi * rng.integers(2, size=number)  # nose or tail first
        return parked
