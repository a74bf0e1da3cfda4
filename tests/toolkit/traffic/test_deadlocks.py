"""Deadlocks: one of two drivers who give way to each other goes."""

from types import SimpleNamespace

import pytest

from toolkit.traffic.deadlocks import end_deadlocks

IGNORED = "junctionModel.ignoreIDs"


class Vehicles:
    """Vehicles of SUMO: lane, time of standing (s) and foes by name, and parameters set."""

    def __init__(self, rows):
        self.rows = rows
        self.parameters = {}

    def getIDList(self):
        return tuple(self.rows)

    def getLaneID(self, name):
        return self.rows[name][0]

    def getWaitingTime(self, name):
        return self.rows[name][1]

    def getJunctionFoes(self, name, reach):
        return [foe for foe in self.rows[name][2] if abs(foe[1]) <= reach]

    def getParameter(self, name, key):
        return self.parameters.get((name, key), "")

    def setParameter(self, name, key, value):
        self.parameters[name, key] = value


def foe(name, own, other, *, gives_way=True, foe_gives_way=True):
    return (name, own, other, own + 4, other + 4, ":a_0", ":b_0", gives_way, foe_gives_way)


def pair(waits=(20.0, 30.0), lanes=(":a_0", ":b_0"), **responses):
    return Vehicles(
        {
            "far": (lanes[0], waits[0], [foe("near", 6.0, -0.5, **responses)]),
            "near": (lanes[1], waits[1], [foe("far", -0.5, 6.0, **responses)]),
        }
    )


def test_the_nearer_one_goes_and_the_other_waits():
    vehicles = pair()
    end_deadlocks(SimpleNamespace(vehicle=vehicles))
    assert vehicles.parameters == {("near", IGNORED): "far"}


@pytest.mark.parametrize(
    "vehicles",
    [
        pair(waits=(20.0, 9.0)),
        pair(lanes=(":a_0", "road_0")),
        pair(foe_gives_way=False),
        pair(gives_way=False),
    ],
    ids=["one does not stand long", "one is not in the junction", "one goes first", "nobody waits"],
)
def test_who_waits_for_somebody_that_goes_is_left_alone(vehicles):
    end_deadlocks(SimpleNamespace(vehicle=vehicles))
    assert not vehicles.parameters


def test_others_stay_ignored():
    vehicles = pair()
    vehicles.setParameter("near", IGNORED, "earlier")
    for _ in range(2):
        end_deadlocks(SimpleNamespace(vehicle=vehicles))
    assert vehicles.parameters == {("near", IGNORED): "earlier far"}
