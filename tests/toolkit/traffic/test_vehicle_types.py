from xml.etree import ElementTree

import numpy as np
import pytest

from toolkit.bodies.fleet import catalogue
from toolkit.objects import CYCLIST, HEAVY, LABELS, PEDESTRIAN, VEHICLE
from toolkit.traffic.vehicle_types import POSITIONS, SHARES, VehicleTypes

BODIES = catalogue()


def test_shares_are_the_papers():
    assert sum(SHARES.values()) == pytest.approx(1)
    assert SHARES[VEHICLE] + SHARES[HEAVY] == pytest.approx(0.6)
    assert set(SHARES) == set(range(len(LABELS)))


def test_classes_say_what_lanes_are_open():
    types = VehicleTypes.of(BODIES)
    by_label = {label: {types.classes[row] for row in np.flatnonzero(types.labels == label)} for label in SHARES}
    assert by_label == {
        VEHICLE: {"passenger"}, HEAVY: {"truck"}, CYCLIST: {"bicycle", "motorcycle"}, PEDESTRIAN: {"pedestrian"}
    }  # fmt: skip


def test_sumo_gets_a_type_for_each_body_and_position_with_its_size():
    types = VehicleTypes.of(BODIES)
    declared = ElementTree.fromstring(types.sumo_types(np.random.default_rng(0)))
    assert [v.get("id") for v in declared] == [f"{row}-{p}" for row in range(len(BODIES)) for p in range(POSITIONS)]
    lengths = [float(v.get("length")) for v in declared][::POSITIONS]
    assert lengths == pytest.approx(types.sizes[:, 0], abs=1e-3)
