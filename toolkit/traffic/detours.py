"""Detours: a driver who does not get to the lane of a turn goes on and comes back to it.

SUMO lets two drivers next to each other wait for each other for ever if one needs the other's lane,
and a roundabout is soon full of drivers behind them."""

from types import ModuleType

from toolkit.traffic.road_lanes import Roads
from toolkit.traffic.sumo import find_standing

PATIENCE_S = 3.0  # standing, before a driver gives a turn up
LANE_END_M = 1.0  # a driver who is nearer to the end of the lane cannot change it on the way


def send_round(sumo: ModuleType, roads: Roads) -> None:
    """Give drivers who stand at the end of a lane without their turn another way to their exit.

    It begins with what the lane leads to. Who has no other way keeps the old one.

    Args:
        sumo: libsumo module with a running simulation.
        roads: Lanes of its network."""
    vehicles = sumo.vehicle
    for name, lane_name in find_standing(sumo, PATIENCE_S).items():
        lane = roads.lanes.get(lane_name)  # None within a junction
        if lane is None or vehicles.getLanePosition(name) < lane.length - LANE_END_M:
            continue
        route = vehicles.getRoute(name)
        turn = route[vehicles.getRouteIndex(name) + 1 :][:1]  # next edge, if there is one
        next_edges = [roads.lanes[following].edge for following in lane.following]
        if not turn or turn[0] in next_edges:
            continue
        for edge in next_edges:
            onward = sumo.simulation.findRoute(edge, route[-1], vehicles.getTypeID(name)).edges
            if onward:
                vehicles.setRoute(name, (lane.edge, *onward))
                break
