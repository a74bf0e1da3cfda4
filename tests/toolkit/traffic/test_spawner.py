from importlib.util import find_spec
from itertools import pairwise
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest

from toolkit.bodies.fleet import catalogue
from toolkit.objects import CYCLIST, HEAVY, LABELS, PEDESTRIAN, VEHICLE
from toolkit.traffic.road_lanes import VIEW_MARGIN_M, Lane, Roads, distance_to_area
from toolkit.traffic.spawner import LIFE, SPAWN_REACH_M, Spawner
from toolkit.traffic.sumo import running
from toolkit.traffic.supply import POSITIONS, SHARES, Supply

pytestmark = pytest.mark.skipif(find_spec("libsumo") is None, reason="traffic needs SUMO")

BODIES = catalogue()


def test_all_are_spawned_turn_continuously_and_leave(site):
    supply, track = Supply(BODIES, np.random.default_rng(3)), {}
    with running(site.network, supply.sumo_types(), seed=3, step=0.1) as sumo:
        spawner = Spawner(sumo, site, supply, max_objects=20, step=0.1)
        for _ in range(400):
            spawner.advance(0.1)
            for name, body, pose in zip(*spawner.state(), strict=True):
                if supply.labels[body] != PEDESTRIAN:
                    track.setdefault(int(name), []).append((supply.sizes[body, 0], *pose))
    turned = []
    for steps in track.values():
        for (length, x, y, yaw), (_, x2, y2, yaw2) in pairwise(steps[5:]):
            gone, turn = np.hypot(x2 - x, y2 - y), abs((yaw2 - yaw + np.pi) % (2 * np.pi) - np.pi)
            assert turn <= 2.5 * gone / length + 0.03, (
                "no body turns faster than its front can move sideways"
            )
            if gone > 0.3:
                assert np.cos(np.arctan2(y2 - y, x2 - x) - yaw2) > np.cos(np.deg2rad(35))
        turned.append(abs((steps[-1][3] - steps[0][3] + np.pi) % (2 * np.pi) - np.pi))
    assert np.sum(np.array(turned) > 1.2) >= 5, "some went round the corner"
    supply = Supply(BODIES, np.random.default_rng(0))
    with running(site.network, supply.sumo_types(), seed=0) as sumo:
        spawner = Spawner(sumo, site, supply, max_objects=12)
        spawner.advance(10.0)
        first = spawner.state()[0]
        assert 6 < len(first) <= 12
        for _ in range(LIFE):
            assert set(first.tolist()) <= set(spawner.state()[0].tolist())
            spawner.count_frame(first)
        assert not set(first.tolist()) & set(spawner.state()[0].tolist())
        spawner.advance(5.0)
        assert len(spawner.state()[0]) <= 12


def test_an_undefined_angle_is_that_of_the_lane(site):
    """SUMO gives NaN for some bicycles that change the lane; here for all."""
    supply = Supply(BODIES, np.random.default_rng(0))
    with running(site.network, supply.sumo_types(), seed=0) as sumo:
        spawner = Spawner(sumo, site, supply, max_objects=12)
        spawner.advance(10.0)
        known = spawner.state()[2]
        for walks, domain in spawner.domains.items():
            own = {
                name: getattr(domain, name)
                for name in ("getPosition", "getLaneID", "getLanePosition")
            }
            spawner.domains[walks] = SimpleNamespace(**own, getAngle=lambda name: np.nan)
        poses = spawner.state()[2]
    assert np.isfinite(poses).all()
    rides = [not spawned.walks for spawned in spawner.spawned.values()]
    assert np.cos(poses[rides, 2] - known[rides, 2]).min() > 0.7, "on its way"


def test_shares_lanes_and_types_of_classes():
    assert SPAWN_REACH_M > VIEW_MARGIN_M
    assert sum(SHARES.values()) == pytest.approx(1)
    assert SHARES[VEHICLE] + SHARES[HEAVY] == pytest.approx(0.6)
    assert set(SHARES) == set(range(len(LABELS)))
    supply = Supply(ONE_EACH, np.random.default_rng(0))
    by_label = {
        label: {supply.classes[row] for row in np.flatnonzero(supply.labels == label)}
        for label in SHARES
    }
    assert by_label == {
        VEHICLE: {"passenger"},
        HEAVY: {"truck"},
        CYCLIST: {"bicycle", "motorcycle"},
        PEDESTRIAN: {"pedestrian"},
    }
    declared = ElementTree.fromstring(supply.sumo_types())
    assert [v.get("id") for v in declared] == [
        f"{row}-{p}" for row in range(len(ONE_EACH)) for p in range(POSITIONS)
    ]
    lengths = [float(v.get("length")) for v in declared][::POSITIONS]
    assert lengths == pytest.approx(supply.sizes[:, 0], abs=1e-3)


ONE_EACH = catalogue()


ROWS = np.array([2, 5, 7])


def eight(seed, *, once=False):
    return Supply(BODIES[:8], np.random.default_rng(seed), once=once)


def test_rows_come_again_or_once_before_any_comes_again():
    supply = eight(0)
    assert {supply.offer(ROWS) for _ in range(30)} == set(ROWS.tolist())
    assert np.array_equal(eight(3).several(ROWS, 4), np.random.default_rng(3).choice(ROWS, 4))
    supply = eight(0, once=True)
    for _ in range(3):
        assert sorted(supply.several(ROWS, 3).tolist()) == ROWS.tolist()
    supply = eight(1, once=True)
    assert {supply.offer(ROWS) for _ in range(30)} == set(ROWS.tolist())
    for row in (2, 5):
        supply.take(row)
    assert {supply.offer(ROWS) for _ in range(10)} == {7}
    supply.take(7)
    supply.take(5, is_used=False)
    assert {supply.offer(ROWS) for _ in range(10)} == {5}


@pytest.mark.parametrize("once", [False, True])
def test_a_seed_gives_an_order(once):
    first, again = (eight(4, once=once).several(ROWS, 9).tolist() for _ in range(2))
    assert first == again


AREA = np.array([-10.0, -10, 10, 10])


def lane(name, start, end, *, forbidden=("pedestrian",), following=(), length=None):
    shape = np.array([start, end], float)
    return Lane(
        name,
        name[:-2],
        length or float(np.hypot(*(shape[1] - shape[0]))),
        shape,
        frozenset(forbidden),
        following,
    )


TOWARDS = lane("in_0", (-60, 0), (0, 0), following=("out_0",))
FOOTWAY = lane("foot_0", (-60, 4), (60, 4), forbidden=("passenger",))
ROADS = Roads({each.name: each for each in (TOWARDS, lane("out_0", (0, 0), (60, 0)), FOOTWAY)})


def test_places_on_a_lane_are_scaled_to_its_length():
    longer = lane("in_0", (0, 0), (10, 0), length=20.0)
    assert longer.at(np.array([0.0, 10.0, 20.0])).tolist() == [[0, 0], [5, 0], [10, 0]]


def test_vehicles_begin_on_lanes_within_reach():
    places = ROADS.places(AREA, 20.0, "passenger")
    x = places.points[:, 0]
    assert set(places.lanes) == {"in_0", "out_0"}
    assert x.min() >= -30
    assert x.max() <= 10, "beyond the area the lane leads away from it"
    assert len(places.lanes) == len(places.offsets) == len(places.lengths)


def test_a_lane_along_the_area_counts_if_it_comes_nearer_by_centimetres():
    nearer = lane("nearer_0", (-8, 15), (8, 14.5))
    farther = lane("farther_0", (8, 14.5), (-8, 15))
    places = Roads({"nearer_0": nearer, "farther_0": farther}).places(AREA, 20.0, "passenger")
    assert places.lanes == ("nearer_0",) * 8


def test_pedestrians_begin_on_footways():
    places = ROADS.places(AREA, 20.0, "pedestrian")
    assert set(places.lanes) == {"foot_0"}
    assert places.points[:, 0].min() < -25
    assert places.points[:, 0].max() > 25


def test_routes_go_on_by_links():
    rng = np.random.default_rng(0)
    assert ROADS.route("in_0", "passenger", 1.0, rng) == ["in", "out"]
    assert ROADS.route("in_0", "passenger", 1e6, rng) == ["in", "out"]
    assert ROADS.route("out_0", "passenger", 100.0, rng) == ["out"]
    ends = lane("in_1", (-60, 3), (0, 3))
    roads = Roads({**ROADS.lanes, "in_1": ends})
    assert roads.route("in_1", "passenger", 1.0, np.random.default_rng(0)) == ["in", "out"]


@pytest.mark.parametrize(
    ("point", "away"), [((0, 0), 0), ((10, 10), 0), ((13, 14), 5), ((-12, 0), 2)]
)
def test_distance_to_area(point, away):
    assert distance_to_area(np.array([point], float), AREA).tolist() == [away]
