from importlib.util import find_spec

import numpy as np
import pytest
import shapely

from toolkit.bodies.fleet import catalogue
from toolkit.boxes import footprints
from toolkit.objects import CYCLIST, PEDESTRIAN, VEHICLE
from toolkit.sites.network import unite
from toolkit.traffic.obstacles import Obstacles, overlaps
from toolkit.traffic.snapshots import Mix, simulate
from toolkit.traffic.spawner import LIFE
from toolkit.traffic.stray_ground import outward_edges
from toolkit.traffic.strays import Strays
from toolkit.traffic.supply import Supply

BODIES = catalogue()
NOBODY = np.zeros((0, 7))


@pytest.fixture(scope="module")
def obstacles(site):
    return Obstacles(site)


def supply(seed=3):
    return Supply(BODIES, np.random.default_rng(seed))


def test_edges_point_away_from_their_polygon_whichever_way_it_runs():
    square = np.array([[0, 0], [2, 0], [2, 2], [0, 2]], float)
    for corners in (square, square[::-1]):
        edges = outward_edges(shapely.polygons([corners, corners + 10]))
        assert len(edges) == 2 * 4 * 4
        for first, polygon in ((0, square), (10, square + 10)):
            ours = edges[(edges[:, 0] > first - 1) & (edges[:, 0] < first + 3)]
            outside = shapely.points(ours[:, :2] + 0.1 * ours[:, 2:])
            assert shapely.distance(shapely.Polygon(polygon), outside) == pytest.approx(0.1)
    assert len(outward_edges(np.zeros(0, object))) == 0


def test_strays_are_of_every_class_on_lanes_and_footways(site, obstacles):
    people = supply()
    drawn = Strays.draw(site, obstacles, people, 1500, NOBODY)
    labels = people.labels[drawn.bodies]
    assert (labels == PEDESTRIAN).mean() == pytest.approx(0.54, abs=0.07)
    on_lane = shapely.contains_xy(unite(site.lanes), *drawn.poses[:, :2].T)
    on_footway = shapely.contains_xy(unite(site.footways), *drawn.poses[:, :2].T)
    for label in (PEDESTRIAN, CYCLIST, VEHICLE):
        assert (on_lane & (labels == label)).sum() > 30
        assert (on_footway & (labels == label)).sum() > 5
    assert (drawn.speeds[labels == VEHICLE] == 0).all()
    assert 0.3 < (drawn.speeds[labels == PEDESTRIAN] > 0).mean() < 0.7
    assert len(set(drawn.ids.tolist())) == 1500
    assert (drawn.frames_left >= 1).all()
    assert (drawn.frames_left <= LIFE).all()


def test_companions_stand_shoulder_to_shoulder(site, obstacles):
    people = supply()
    drawn = Strays.draw(site, obstacles, people, 800, NOBODY)
    apart = np.hypot(*(drawn.poses[1:, :2] - drawn.poses[:-1, :2]).T)
    widths = people.sizes[drawn.bodies, 1]
    air = apart - (widths[1:] + widths[:-1]) / 2
    beside = (air < 0.9) & (np.abs(drawn.poses[1:, 2] - drawn.poses[:-1, 2]) < 0.6)
    assert 0.15 < beside.mean() < 0.45
    assert np.quantile(air[beside], 0.05) > 0.1


def test_they_stand_beside_vehicles_that_park(site, obstacles):
    car = np.array([[0.0, 0.0, 0.8, 4.5, 1.8, 1.6, 0.3]])
    drawn = Strays.draw(site, obstacles, supply(), 600, np.tile(car, (5, 1)))
    near = (
        shapely.distance(shapely.Polygon(footprints(car)[0]), shapely.points(drawn.poses[:, :2]))
        < 3
    )
    bare = Strays.draw(site, obstacles, supply(), 600, NOBODY)
    before = (
        shapely.distance(shapely.Polygon(footprints(car)[0]), shapely.points(bare.poses[:, :2])) < 3
    )
    assert near.sum() > 3 * max(before.sum(), 1)


def test_they_go_straight_on_and_live_as_long_as_others(site, obstacles):
    people = supply()
    now = Strays.draw(site, obstacles, people, 60, NOBODY)
    x, y, yaw = now.poses.T
    np.testing.assert_allclose(now.at(2.0)[:, 0], x + 2 * now.speeds * np.cos(yaw))
    np.testing.assert_allclose(now.at(2.0)[:, 1], y + 2 * now.speeds * np.sin(yaw))
    np.testing.assert_array_equal(now.at(2.0)[:, 2], yaw)
    lives = dict.fromkeys(now.ids.tolist(), 1)
    for step in range(1, 12):
        now = now.later(people, 5.0 * step)
        assert len(now.ids) == 60
        for number in now.ids.tolist():
            lives[number] = lives.get(number, 0) + 1
    new = [lives[number] for number in lives if number >= 60 and number not in now.ids]
    assert set(new) == {LIFE}


@pytest.mark.skipif(find_spec("libsumo") is None, reason="traffic needs SUMO")
def test_simulated_traffic_with_strays_keeps_apart_and_none_are_there_by_default(site):
    found = list(simulate(site, BODIES, frames=8, seed=5, mix=Mix(strays=0.6)))
    again = list(simulate(site, BODIES, frames=8, seed=5, mix=Mix(strays=0.6)))
    for one, two in zip(found, again, strict=True):
        assert one.objects.boxes.tobytes() == two.objects.boxes.tobytes()
        assert not overlaps(one.objects.boxes).any()
    lanes, footways = unite(site.lanes), unite(site.footways)

    def out_of_place(snapshots):
        boxes = np.concatenate([each.objects.boxes for each in snapshots])
        labels = np.concatenate([each.objects.labels for each in snapshots])
        walkers, riders = (
            shapely.points(boxes[labels == label, :2]) for label in (PEDESTRIAN, CYCLIST)
        )
        return shapely.contains(lanes, walkers).sum(), shapely.contains(footways, riders).sum()

    on_lanes, on_footways = out_of_place(found)
    assert on_lanes > 10
    assert on_footways > 3
    usual = out_of_place(list(simulate(site, BODIES, frames=8, seed=5)))
    assert usual[0] < on_lanes / 2
    assert usual[1] < max(on_footways, 1)
