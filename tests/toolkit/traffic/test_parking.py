from itertools import count

import numpy as np

from toolkit.bodies.fleet import catalogue
from toolkit.objects import VEHICLE
from toolkit.sites.site import Site, Solid
from toolkit.traffic.collisions import Obstacles
from toolkit.traffic.parking import STAY, Parked
from toolkit.traffic.vehicle_types import VehicleTypes

TYPES = VehicleTypes.of(catalogue())
BAYS = np.column_stack([np.zeros(30), 3.0 * np.arange(30), np.full(30, 0.5)])
WALL = Solid(np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]]), 0.0, 2.0, "wall")  # in the first bay


def draw(seed, most=20, solids=()):
    site = Site("lot", np.array([-50.0, -50, 50, 100]), parking=BAYS, solids=solids)
    return Parked.draw(site, Obstacles(site), TYPES, np.random.default_rng(seed), count(), most=most)


def test_vehicles_stand_in_bays_of_their_own():
    for seed in range(10):
        parked = draw(seed)
        assert 0 < len(parked.places) <= 20
        assert len(set(parked.places.tolist())) == len(parked.places)
        assert (TYPES.labels[parked.bodies] == VEHICLE).all()
        assert np.abs(parked.poses[:, :2] - parked.bays[parked.places, :2]).max() < 0.2
        assert np.abs(np.sin(parked.poses[:, 2] - 0.5)).max() < 0.05


def test_bays_that_something_reaches_into_stay_empty():
    assert len(draw(0, solids=(WALL,)).bays) == len(BAYS) - 1


def test_each_stays_about_so_many_frames_and_another_comes():
    parked, rng, ids = draw(1), np.random.default_rng(2), count(100)
    number, gone = len(parked.ids), 0
    for _ in range(400):
        later = parked.later(TYPES, rng, ids)
        gone += len(set(parked.ids.tolist()) - set(later.ids.tolist()))
        assert len(set(later.places.tolist())) == number
        parked = later
    assert 0.8 < gone * STAY / (400 * number) < 1.2


def test_no_bays_no_vehicles():
    site = Site("none", np.array([-5.0, -5, 5, 5]))
    parked = Parked.draw(site, Obstacles(site), TYPES, np.random.default_rng(0), count(), most=6)
    assert len(parked.ids) == len(parked.later(TYPES, np.random.default_rng(0), count()).ids) == 0
