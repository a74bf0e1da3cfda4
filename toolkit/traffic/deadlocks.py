"""Deadlocks: drivers in the middle of a junction who wait for each other.

SUMO lets two drivers whose lanes merge or cross give way to each other for ever, and soon nobody
gets through the junction."""

from types import ModuleType
from typing import NamedTuple

from toolkit.traffic.sumo import find_standing

DEADLOCK_S = 10.0  # standing of both, before one of them goes
FOE_REACH_M = 30.0  # along a lane, within which others may be in the way
_IGNORED = "junctionModel.ignoreIDs"  # SUMO's parameter: drivers that need not be waited for


class _Foe(NamedTuple):
    """Another driver in a junction, in the order of libsumo's `getJunctionFoes`.

    Attributes:
        name: SUMO's name.
        distance: Distance to the meeting of both lanes (m), negative beyond it.
        foe_distance: The same of the other one.
        exit_distance: Distance to their parting (m).
        foe_exit_distance: The same of the other one.
        lane: SUMO's name of the lane.
        foe_lane: The same of the other one.
        gives_way: True if the driver has to wait for the other one.
        foe_gives_way: True if the other one has to wait."""

    name: str
    distance: float
    foe_distance: float
    exit_distance: float
    foe_exit_distance: float
    lane: str
    foe_lane: str
    gives_way: bool
    foe_gives_way: bool


def end_deadlocks(sumo: ModuleType) -> None:
    """Let one of two drivers go who stand in a junction and give way to each other.

    It is the one nearer to the meeting of their lanes, or farther beyond it.

    sumo: libsumo module with a running simulation."""
    vehicles = sumo.vehicle
    lanes = find_standing(sumo, DEADLOCK_S)
    # names of lanes inside a junction begin with a colon
    standing = {name for name, lane in lanes.items() if lane.startswith(":")}
    if len(standing) < 2:
        return
    for name in sorted(standing):
        ignored = vehicles.getParameter(name, _IGNORED).split()
        for foe in [_Foe(*values) for values in vehicles.getJunctionFoes(name, FOE_REACH_M)]:
            if not (foe.name in standing and foe.gives_way and foe.foe_gives_way):
                continue
            if foe.distance <= foe.foe_distance and foe.name not in ignored:
                ignored.append(foe.name)
                vehicles.setParameter(name, _IGNORED, " ".join(ignored))
