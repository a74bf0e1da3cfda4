"""Parked vehicles on the bays of a site."""

from dataclasses import dataclass, replace

import numpy as np

from toolkit.arrays import Float64, Int64
from toolkit.objects import VEHICLE
from toolkit.sites.site import Site
from toolkit.traffic.obstacles import LevelBoxes, Obstacles
from toolkit.traffic.supply import Supply

MEAN_STAY_FRAMES = 20.0  # mean number of frames that a vehicle stays
BAY_ROOM_M = (5.8, 2.4, 2.0)  # length, width and height (m) that must be free in a bay
OCCUPIED_SHARES = (0.3, 0.9)  # lowest and highest share of the bays that are taken
# standard deviations of x (m), y (m) and yaw (rad) from the middle of the bay
PARKING_JITTER = (0.1, 0.1, np.radians(1.0))


@dataclass(frozen=True, eq=False)
class Parked:
    """Parked vehicles, and the bays of the site that can be used.

    Attributes:
        bays: x, y (m), yaw (rad) of each bay, site frame.
        places: row in `bays` for each vehicle.
        bodies: row of its body in the supply.
        ids: its id.
        poses: its x, y (m), yaw (rad), site frame."""

    bays: Float64[np.ndarray, "m 3"]
    places: Int64[np.ndarray, " n"]
    bodies: Int64[np.ndarray, " n"]
    ids: Int64[np.ndarray, " n"]
    poses: Float64[np.ndarray, "n 3"]

    @staticmethod
    def draw(site: Site, obstacles: Obstacles, supply: Supply, *, max_parked: int) -> "Parked":
        """Park vehicles in a random share of the bays, `max_parked` at most.

        Bays without `BAY_ROOM_M` between the obstacles are left out. supply: gives bodies, ids and
        random numbers."""
        x, y, yaw = site.parking.T
        room_height = BAY_ROOM_M[2]
        # boxes of the room that bays must offer: z of the middle, length, width, height
        size_columns = np.full((len(x), 4), (room_height / 2, *BAY_ROOM_M))
        rooms = np.column_stack([x, y, size_columns, yaw])
        bays = site.parking[~obstacles.hit(rooms)]
        number = min(round(len(bays) * supply.rng.uniform(*OCCUPIED_SHARES)), max_parked)
        places = supply.rng.permutation(len(bays))[:number]
        # the vehicles themselves are drawn next, as if all had just been replaced
        zeros = np.zeros(number, np.int64)
        unfilled = Parked(bays, places, bodies=zeros, ids=zeros, poses=np.zeros((number, 3)))
        return unfilled._replace_vehicles(np.ones(number, bool), supply)

    def later(self, supply: Supply) -> "Parked":
        """Parked vehicles a frame later.

        Each has left with probability 1 / `MEAN_STAY_FRAMES`; for each that left, another is in
        some free bay."""
        is_gone = supply.rng.random(len(self.ids)) < 1 / MEAN_STAY_FRAMES
        return self._replace_vehicles(is_gone, supply)

    def boxes(self, supply: Supply) -> LevelBoxes:
        """Box of each vehicle, on level ground; `supply` gives the sizes."""
        sizes = supply.sizes[self.bodies]
        centre_z = sizes[:, 2] / 2
        yaw = self.poses[:, 2]
        return np.column_stack([self.poses[:, :2], centre_z, sizes, yaw])

    def _replace_vehicles(self, is_gone: np.ndarray, supply: Supply) -> "Parked":
        """Return the vehicles with new ones, in random free bays, for those that left.

        is_gone: mask of the vehicles that left; their rows become the new vehicles'."""
        if not is_gone.any():
            return self
        rng = supply.rng
        number = int(is_gone.sum())
        # bays that were left are free too, so there are always enough
        free_bays = np.setdiff1d(np.arange(len(self.bays)), self.places[~is_gone])
        places = self.places.copy()
        bodies = self.bodies.copy()
        ids = self.ids.copy()
        poses = self.poses.copy()
        places[is_gone] = rng.permutation(free_bays)[:number]
        bodies[is_gone] = supply.several(np.flatnonzero(supply.labels == VEHICLE), number)
        ids[is_gone] = [next(supply.ids) for _ in range(number)]
        off_centre = PARKING_JITTER * np.clip(rng.standard_normal((number, 3)), -1.5, 1.5)
        poses[is_gone] = self.bays[places[is_gone]] + off_centre
        poses[is_gone, 2] += np.pi * rng.integers(2, size=number)  # yaw: nose or tail first
        return replace(self, places=places, bodies=bodies, ids=ids, poses=poses)
