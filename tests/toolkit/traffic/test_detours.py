"""Drivers who cannot reach their turn go round; more demand than a road takes is named."""

from importlib.util import find_spec
from types import SimpleNamespace

import numpy as np
import pytest

from toolkit.bodies.fleet import catalogue
from toolkit.objects import VEHICLE
from toolkit.sites.files import load_site
from toolkit.traffic.detours import LANE_END_M, PATIENCE_S, send_round
from toolkit.traffic.flow import Flow, Movement
from toolkit.traffic.road_lanes import Lane, Roads
from toolkit.traffic.supply import Supply
from toolkit.traffic.ways import possible_movements, simulate_ways

needs_sumo = pytest.mark.skipif(find_spec("libsumo") is None, reason="traffic needs SUMO")
# a lane of each edge; the outer lane of the ring leads to the exit, the inner one on round the ring
FOLLOWING = {
    "ring_0": ("exit_0", "next_0"),
    "ring_1": ("next_1",),
    "exit_0": (),
    "next_0": (),
    "next_1": (),
}
LENGTH_M = 16.0


def standing(lane, *, standing_s=PATIENCE_S, position_m=LENGTH_M):
    """Vehicle "7" of SUMO, which stands on the ring on its way to the exit."""
    routes = {}
    return SimpleNamespace(
        routes=routes,
        setRoute=routes.__setitem__,
        getIDList=lambda: ("7",),
        getWaitingTime=lambda _: standing_s,
        getLaneID=lambda _: lane,
        getLanePosition=lambda _: position_m,
        getRoute=lambda _: ("entry", "ring", "exit"),
        getRouteIndex=lambda _: 1,
        getTypeID=lambda _: "car",
    )


@pytest.fixture
def roads():
    shape = np.array([[0.0, 0.0], [LENGTH_M, 0.0]])
    lanes = {}
    for name, following in FOLLOWING.items():
        edge = name.rpartition("_")[0]
        lanes[name] = Lane(name, edge, LENGTH_M, shape, frozenset(), following)
    return Roads(lanes)


def find_routes(roads, vehicles, edges=("next", "ring", "exit")):
    """New routes of vehicles, by name. edges: the way from the next edge, () for none."""
    simulation = SimpleNamespace(findRoute=lambda *_: SimpleNamespace(edges=edges))
    send_round(SimpleNamespace(vehicle=vehicles, simulation=simulation), roads)
    return vehicles.routes


def test_who_stands_at_the_end_of_the_wrong_lane_goes_round(roads):
    routes = find_routes(roads, standing("ring_1"))
    assert routes == {"7": ("ring", "next", "ring", "exit")}


@pytest.mark.parametrize(
    "vehicles",
    [
        standing("ring_0"),  # the lane leads to the exit
        standing("ring_1", standing_s=PATIENCE_S / 2),
        standing("ring_1", position_m=LENGTH_M - 2 * LANE_END_M),
        standing(":inside_0"),  # within a junction
    ],
)
def test_others_keep_their_way(roads, vehicles):
    assert find_routes(roads, vehicles) == {}


def test_who_has_no_other_way_keeps_the_old_one(roads):
    assert find_routes(roads, standing("ring_1"), edges=()) == {}


def vehicle_flow(site, per_hour):
    """Demand of vehicles from each entry, in equal shares to its exits."""
    possible = possible_movements(site, supply_of(0))["vehicle"]
    movements = [
        Movement("vehicle", entry, leave, per_hour / len(exits))
        for entry, exits in possible.items()
        for leave in exits
    ]
    return Flow(tuple(movements))


def supply_of(seed):
    return Supply(catalogue(), np.random.default_rng(seed))


@needs_sumo
def test_a_roundabout_does_not_jam():
    site = load_site("roundabout")
    supply = supply_of(2)
    ways = simulate_ways(site, supply, seconds=60, flow=vehicle_flow(site, 320.0))
    steps = np.array([len(way.poses) for way in ways if way.first + len(way.poses) < 600])
    assert {int(supply.labels[way.traveller.body]) for way in ways} >= {VEHICLE}
    assert len(steps) > 30
    assert np.quantile(steps, 0.9) < 900  # 90 s


@needs_sumo
def test_more_demand_than_a_road_takes_is_named(site):
    movement = vehicle_flow(site, 3600.0).movements[0]
    with pytest.warns(UserWarning, match=f"come in at {movement.entry!r} than its road takes"):
        simulate_ways(
            site, supply_of(1), seconds=60, flow=Flow((movement._replace(per_hour=3600),))
        )
