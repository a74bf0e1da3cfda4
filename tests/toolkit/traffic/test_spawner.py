from importlib.util import find_spec
from itertools import count, pairwise

import numpy as np
import pytest

from toolkit.bodies.fleet import catalogue
from toolkit.objects import PEDESTRIAN
from toolkit.traffic.snapshots import MARGIN
from toolkit.traffic.spawner import LIFE, SPAWN_REACH, Spawner
from toolkit.traffic.sumo import running
from toolkit.traffic.vehicle_types import VehicleTypes

pytestmark = pytest.mark.skipif(find_spec("libsumo") is None, reason="traffic needs SUMO")

BODIES = catalogue()


def test_headings_turn_continuously_and_point_where_it_goes(site):
    types, rng = VehicleTypes.of(BODIES), np.random.default_rng(3)
    track = {}
    with running(site.network, types.sumo_types(rng), seed=3, step=0.1) as sumo:
        spawner = Spawner(sumo, site, types, rng, count(), most=20, step=0.1)
        for _ in range(400):
            spawner.advance(0.1)
            for name, body, pose in zip(*spawner.state(), strict=True):
                if types.labels[body] != PEDESTRIAN:
                    track.setdefault(int(name), []).append((types.sizes[body, 0], *pose))
    turned = []
    for steps in track.values():
        for (length, x, y, yaw), (_, x2, y2, yaw2) in pairwise(steps[5:]):
            gone, turn = np.hypot(x2 - x, y2 - y), abs((yaw2 - yaw + np.pi) % (2 * np.pi) - np.pi)
            assert turn <= 2.5 * gone / length + 0.03, "no body turns faster than its front can move sideways"
            if gone > 0.3:
                course = np.arctan2(y2 - y, x2 - x)
                assert np.cos(course - yaw2) > np.cos(np.deg2rad(35))
        turned.append(abs((steps[-1][3] - steps[0][3] + np.pi) % (2 * np.pi) - np.pi))
    assert np.sum(np.array(turned) > 1.2) >= 5, "some went round the corner"


def test_so_many_are_spawned_and_gone_after_their_last_frame(site):
    types, rng = VehicleTypes.of(BODIES), np.random.default_rng(0)
    with running(site.network, types.sumo_types(rng), seed=0) as sumo:
        spawner = Spawner(sumo, site, types, rng, count(), most=12)
        spawner.advance(10.0)
        first = spawner.state()[0]
        assert 6 < len(first) <= 12
        for _ in range(LIFE):
            assert set(first.tolist()) <= set(spawner.state()[0].tolist())
            spawner.count_frame(first)
        assert not set(first.tolist()) & set(spawner.state()[0].tolist())
        spawner.advance(5.0)
        assert len(spawner.state()[0]) <= 12


def test_things_are_spawned_outside_of_what_snapshots_show():
    assert SPAWN_REACH > MARGIN
