from collections import Counter
from dataclasses import replace
from importlib.util import find_spec
from itertools import count, pairwise

import numpy as np
import pytest
import shapely

from toolkit.bodies.fleet import catalogue, fleet_named
from toolkit.boxes import footprints, iou_bev
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE
from toolkit.sites.network import build_network, street
from toolkit.sites.site import Site, Solid
from toolkit.traffic.obstacles import BODY_GAP_M, Obstacles, outline_boxes, overlaps, separate
from toolkit.traffic.parked import MEAN_STAY_FRAMES, Parked
from toolkit.traffic.road_lanes import VIEW_MARGIN_M
from toolkit.traffic.snapshots import MOST_OBJECTS, Mix, simulate
from toolkit.traffic.spawner import LIFE
from toolkit.traffic.supply import Supply

pytestmark = pytest.mark.skipif(find_spec("libsumo") is None, reason="traffic needs SUMO")

BODIES = catalogue()
FRAMES = 120


@pytest.fixture(scope="module")
def snapshots(site):
    return list(simulate(site, BODIES, frames=FRAMES, seed=7))


@pytest.fixture(scope="module")
def road_without_footways():
    nodes = [
        {"id": "a", "x": -100, "y": 0},
        {"id": "b", "x": 0, "y": 0},
        {"id": "c", "x": 90, "y": 60},
    ]
    edges = [
        {"id": start + end, "from": start, "to": end, "lanes": street(1, footway=0.0)}
        for start, end in ("ab", "bc", "cb", "ba")
    ]
    return Site("road", np.array([-30.0, -30, 30, 30]), network=build_network(nodes, edges))


@pytest.fixture(scope="module")
def lights_and_one_way_streets():
    places = {
        "n": (0, 120),
        "e": (130, 10),
        "s": (5, -120),
        "w": (-120, 0),
        "stub": (12, 40),
        "x": (900, 900),
        "y": (950, 900),
    }
    nodes = [{"id": name, "x": x, "y": y} for name, (x, y) in places.items()]
    nodes.append({"id": "middle", "x": 0, "y": 0, "type": "traffic_light"})
    ways = [
        ("n", "middle"),
        ("middle", "s"),
        ("w", "middle"),
        ("middle", "w"),
        ("e", "middle"),
        ("middle", "e"),
    ]
    # a dead end inside the area, a road that meets no other
    ways += [("middle", "stub"), ("x", "y")]
    edges = [
        {"id": f"{a}-{b}", "from": a, "to": b, "lanes": street(2, footway=2.0)} for a, b in ways
    ]
    return Site("lights", np.array([-40.0, -40, 40, 40]), network=build_network(nodes, edges))


def same(a, b):
    pairs = [
        (getattr(a.objects, key), getattr(b.objects, key)) for key in ("boxes", "ids", "labels")
    ]
    return all(np.array_equal(*pair) for pair in (*pairs, (a.bodies, b.bodies)))


def test_snapshots_describe_bodies_on_the_ground_and_few_repairs(snapshots):
    assert [s.time for s in snapshots[:3]] == [0.0, 5.0, 10.0]
    for snapshot in snapshots:
        objects = snapshot.objects
        assert len(objects) <= MOST_OBJECTS
        assert len(set(objects.ids.tolist())) == len(objects)
        assert objects.labels.tolist() == [BODIES[row].label for row in snapshot.bodies]
        assert np.allclose(
            objects.boxes[:, 3:6],
            np.array([BODIES[row].size for row in snapshot.bodies]).reshape(-1, 3),
        )
    repaired = np.array([s.repaired for s in snapshots])
    assert 0 < (repaired > 0).mean() < 0.4
    assert repaired.sum() < 0.02 * sum(len(s.objects) for s in snapshots)
    stays = []
    for a, b in pairwise(s.objects for s in snapshots):
        common, i, j = np.intersect1d(a.ids, b.ids, return_indices=True)
        moved = np.hypot(*(a.boxes[i, :2] - b.boxes[j, :2]).T) > 1
        stays.append(1 - moved.sum() / max(len(a), 1) - (len(a) - len(common)) / max(len(a), 1))
    assert np.mean(stays) < 0.5, "most objects of a frame have moved or left by the next"


def test_boxes_stand_on_the_ground_apart_near_the_area(site, snapshots):
    near = shapely.box(*site.area).buffer(VIEW_MARGIN_M, join_style="mitre")
    for boxes in (s.objects.boxes for s in snapshots):
        floor = boxes[:, 2] - boxes[:, 5] / 2
        assert np.abs(floor - site.ground(boxes[:, :2])).max() < 0.05
        assert (np.abs(boxes[:, 6]) <= np.pi).all()
        assert shapely.intersects(shapely.polygons(footprints(boxes)), near).all()
    walls = shapely.union_all(
        [shapely.Polygon(s.footprint) for s in site.solids if s.top > 0.5 and s.base < 0.3]
    )
    for boxes in (s.objects.boxes for s in snapshots):
        assert (iou_bev(boxes, boxes)[~np.eye(len(boxes), dtype=bool)] < 1e-12).all()
        assert not shapely.intersects(shapely.polygons(footprints(boxes)), walls).any()
    bays = site.parking[:, None, :2]
    for boxes in (s.objects.boxes for s in snapshots):
        bay, row = np.nonzero(np.hypot(*(boxes[None, :, :2] - bays).transpose(2, 0, 1)) < 0.5)
        assert len(set(bay)) == len(bay), "one vehicle to a bay"
        assert np.allclose(np.sin(boxes[row, 6] - site.parking[bay, 2]), 0, atol=0.05)
        assert len(bay) <= MOST_OBJECTS // 5


def test_the_scene_is_as_crowded_as_the_papers_in_its_shares(site, snapshots):
    inside = [
        s.objects[
            (
                (s.objects.boxes[:, :2] > site.area[:2]) & (s.objects.boxes[:, :2] < site.area[2:])
            ).all(axis=1)
        ]
        for s in snapshots
    ]
    vehicles = np.mean([np.isin(o.labels, [VEHICLE, HEAVY]).sum() for o in inside])
    assert 12 < np.mean([len(o) for o in inside]) < 24
    assert 0.45 < vehicles / np.mean([len(o) for o in inside]) < 0.75
    label = {}
    for objects in (s.objects for s in snapshots):
        label.update(zip(objects.ids.tolist(), objects.labels.tolist(), strict=True))
    shares = {kind: times / len(label) for kind, times in Counter(label.values()).items()}
    assert shares[VEHICLE] + shares[HEAVY] == pytest.approx(0.6, abs=0.1)
    assert shares[CYCLIST] == pytest.approx(0.2, abs=0.07)
    assert shares[PEDESTRIAN] == pytest.approx(0.2, abs=0.07)
    assert 0.01 < shares[HEAVY] < 0.1


def test_traffic_keeps_to_its_ways_for_four_frames_by_its_seed(site, snapshots):
    seen = Counter(name for s in snapshots for name in s.objects.ids.tolist())
    where = {
        name: s.objects.boxes[i, :2]
        for s in snapshots
        for i, name in enumerate(s.objects.ids.tolist())
    }
    bays = shapely.MultiPoint(site.parking[:, :2]).buffer(1.5)
    long_seen = [name for name, times in seen.items() if times > LIFE]
    assert all(bays.contains(shapely.Point(where[name])) for name in long_seen)
    assert long_seen, "some vehicles park"
    assert len(seen) > FRAMES * 3, "objects are replaced"
    road, footway = (
        shapely.union_all([shapely.Polygon(p) for p in layer])
        for layer in (site.lanes, site.footways)
    )
    boxes, labels = (
        np.concatenate([getattr(s.objects, k) for s in snapshots]) for k in ("boxes", "labels")
    )
    points = shapely.points(boxes[:, :2])
    inside = shapely.contains(shapely.box(*site.area), points)
    parked = shapely.contains(shapely.MultiPoint(site.parking[:, :2]).buffer(1.5), points)
    assert shapely.contains(road, points[inside & ~parked & (labels != PEDESTRIAN)]).mean() > 0.99
    assert shapely.contains(footway, points[inside & (labels == PEDESTRIAN)]).mean() > 0.8
    list(simulate(site, BODIES, frames=2, seed=99))
    again = list(simulate(site, BODIES, frames=10, seed=7))
    assert all(same(a, b) for a, b in zip(snapshots, again, strict=False))
    assert not same(next(simulate(site, BODIES, frames=1, seed=8)), snapshots[0])


def test_classes_without_ways_or_bodies_are_left_out(road_without_footways):
    labels = {
        label
        for s in simulate(road_without_footways, BODIES, frames=10, seed=1)
        for label in s.objects.labels.tolist()
    }
    assert labels <= {VEHICLE, HEAVY, CYCLIST}
    assert {VEHICLE, CYCLIST} <= labels
    cars = [body for body in BODIES if body.label == VEHICLE]
    assert all(
        set(s.objects.labels) == {VEHICLE}
        for s in simulate(road_without_footways, cars, frames=5, seed=1)
    )


def test_lights_one_way_streets_and_dead_ends(lights_and_one_way_streets):
    snapshots = list(simulate(lights_and_one_way_streets, BODIES, frames=20, seed=3))
    assert np.mean([len(s.objects) for s in snapshots]) > 6
    assert {VEHICLE, CYCLIST, PEDESTRIAN} <= {
        label for s in snapshots for label in s.objects.labels.tolist()
    }
    assert max(s.repaired for s in snapshots) <= 3


@pytest.mark.parametrize(
    ("changes", "arguments", "says"),
    [
        ({"network": ""}, {}, "no network"),
        ({"area": np.array([900.0, 900, 990, 990])}, {}, "no lane open to cars within 25 m"),
        *(
            ({}, {"frames": -1}, "frames must be at least 0"),
            ({}, {"interval": 0.25}, "whole number of SUMO's steps"),
        ),
        ({}, {"interval": 0.05}, "whole number of SUMO's steps"),
        ({}, {"interval": 0.0}, "whole number of SUMO's steps"),
        ({}, {"interval": 1.5}, "whole number of SUMO's steps"),
        ({}, {"interval": float("nan")}, "whole number of SUMO's steps"),
        ({}, {"bodies": [b for b in BODIES if b.label == PEDESTRIAN]}, "at least one vehicle"),
    ],
)
def test_refuses(site, changes, arguments, says):
    arguments = {"bodies": BODIES, "frames": 1, "seed": 0, **arguments}
    with pytest.raises(ValueError, match=says):
        list(simulate(replace(site, **changes), arguments.pop("bodies"), **arguments))


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        *(
            ({"stay": 0}, "stay must be one frame or more, got 0"),
            ({"most": 0}, "most must be at least 1, got 0"),
        ),
        ({"parked": 31}, "parked must lie in 0..most 30, got 31"),
        ({"strays": 1.5}, "strays must be a share from 0 to 1, got 1.5"),
    ],
)
def test_a_mix_refuses(wrong, says):
    with pytest.raises(ValueError, match=says):
        Mix(**wrong)


def test_parked_vehicles_go_when_they_should_or_there_are_no_frames(site):
    assert list(simulate(site, BODIES, frames=0, seed=0)) == []
    parked = [
        parked_in(site, each) for each in simulate(site, BODIES, frames=33, seed=7, mix=Mix(stay=4))
    ]
    blocks = [parked[first : first + 4] for first in range(0, 33, 4)]
    assert all(each == block[0] for block in blocks for each in block)
    assert not any(before[0] & after[0] for before, after in pairwise(blocks))
    assert len({len(block[0]) for block in blocks}) > 1, "more or fewer of them"
    assert max(map(len, parked)) <= MOST_OBJECTS // 5


def parked_in(site, snapshot):
    """Ids and bodies of those who stand in bays."""
    far = np.hypot(
        *(snapshot.objects.boxes[:, None, :2] - site.parking[None, :, :2]).transpose(2, 0, 1)
    )
    rows = np.flatnonzero((far < 0.2).any(axis=1))
    return set(
        zip(snapshot.objects.ids[rows].tolist(), snapshot.bodies[rows].tolist(), strict=True)
    )


def test_of_a_drawn_fleet_everyone_has_a_body_of_its_own_and_some_walk_together(site):
    bodies = fleet_named("own").bodies(25, np.random.default_rng(2))
    worn: dict[int, set[int]] = {}
    abreast = alone = 0
    for frame in simulate(site, bodies, frames=25, seed=3, once=True):
        objects = frame.objects
        assert len(objects) <= MOST_OBJECTS
        assert np.allclose(objects.boxes[:, 3:6], [bodies[row].size for row in frame.bodies])
        for name, row in zip(objects.ids.tolist(), frame.bodies.tolist(), strict=True):
            worn.setdefault(name, set()).add(row)
        walkers = objects[objects.labels == PEDESTRIAN]
        gaps = np.hypot(
            *(walkers.boxes[:, None, :2] - walkers.boxes[None, :, :2]).transpose(2, 0, 1)
        )
        gaps[np.arange(len(walkers)), np.arange(len(walkers))] = np.inf
        near = (gaps < 1.0).any(axis=1) if len(walkers) else np.zeros(0, bool)
        abreast, alone = abreast + int(near.sum()), alone + int((~near).sum())
    assert all(len(rows) == 1 for rows in worn.values())
    assert len(set.union(*worn.values())) == len(worn) > 130
    assert 0.05 < abreast / (abreast + alone) < 0.75


AREA = np.array([-50.0, -50, 50, 50])
FREE = Obstacles(Site("free", AREA))


def wall(x0, y0, x1, y1, base=0.0, top=2.0, kind="wall"):
    return Solid(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], float), base, top, kind)


def cars(*offsets):
    return np.array([0.0, 0, 0.75, 4, 2, 1.5, 0]) + [
        [x, y, 0, 0, 0, 0, yaw] for x, y, yaw in offsets
    ]


def test_boxes_that_stand_free_stay():
    boxes = cars((0, 0, 0), (0, 2.0 + 2 * BODY_GAP_M, 0), (10, 0, 1))
    settled, kept, repaired = separate(boxes, FREE)
    assert settled is boxes
    assert (kept.tolist(), repaired) == ([True] * 3, 0)


def test_a_later_box_is_moved_aside_where_there_is_room():
    boxes = cars((0, 0, 0), (0, 1.8, 0))
    settled, kept, repaired = separate(boxes, FREE)
    assert (kept.tolist(), repaired) == ([True] * 2, 1)
    assert np.array_equal(settled[0], boxes[0])
    assert settled[1, 1] == pytest.approx(2.3)
    assert not overlaps(settled).any()


def test_a_box_without_room_is_dropped_and_pushes_nobody():
    # no room for the third
    settled, kept, repaired = separate(cars((0, 0, 0), (0, 4.2, 0), (0, 2.1, 0)), FREE)
    assert (kept.tolist(), repaired) == ([True, True, False], 1)
    assert not overlaps(settled[kept]).any()
    _, kept, _ = separate(cars((0, 0, 0), (0.5, 0, np.pi / 2), (0.5, 3.2, 0)), FREE)
    assert kept.tolist() == [
        True,
        False,
        True,
    ]  # the third touches only the second, which is dropped


def test_no_boxes_are_separated():
    settled, kept, repaired = separate(np.zeros((0, 7)), FREE)
    assert (settled.shape, kept.shape, repaired) == ((0, 7), (0,), 0)
    assert overlaps(settled).shape == (0, 0)


def test_random_boxes_neither_overlap_nor_hit_walls():
    rng = np.random.default_rng(0)
    obstacles = Obstacles(Site("walled", AREA, solids=(wall(-3, -3, 3, -2), wall(4, -9, 5, 9))))
    for _ in range(50):
        boxes = cars(*rng.uniform([-12, -12, -4], [12, 12, 4], (25, 3)))
        settled, kept, _ = separate(boxes, obstacles)
        assert not overlaps(settled[kept]).any()
        assert not obstacles.hit(settled[kept]).any()
        assert kept[0] or obstacles.hit(boxes[:1]).any()


def test_boxes_hit_what_their_outlines_touch():
    """Slanted walls, too, whose upright rectangles hold many boxes that touch nothing."""
    rng = np.random.default_rng(1)
    walls = []
    for x, y, turn in rng.uniform([-10, -10, 0], [10, 10, np.pi], (6, 3)):
        outline = footprints(np.array([[x, y, 1, 8, 0.3, 2, turn]]))[0]
        walls.append(Solid(outline[:, :2], 0.0, 2.0))
    obstacles = Obstacles(Site("walled", AREA, solids=tuple(walls)))
    shapes = [shapely.Polygon(solid.footprint) for solid in walls]
    for number in (1, 200):
        boxes = cars(*rng.uniform([-12, -12, -4], [12, 12, 4], (number, 3)))
        expected = shapely.intersects(outline_boxes(boxes)[:, None], shapes).any(axis=1)
        np.testing.assert_array_equal(obstacles.hit(boxes), expected)
    assert expected.any()
    assert not expected.all()
    assert not obstacles.hit(cars((500.0, 500.0, 0.0))).any()


def test_vehicles_are_parked_in_bays_of_their_own():
    labels = np.array([body.label for body in catalogue()])
    for seed in range(10):
        parked = draw(seed)
        assert 0 < len(parked.places) <= 20
        assert len(set(parked.places.tolist())) == len(parked.places)
        assert (labels[parked.bodies] == VEHICLE).all()
        assert np.abs(parked.poses[:, :2] - parked.bays[parked.places, :2]).max() < 0.2
        assert np.abs(np.sin(parked.poses[:, 2] - 0.5)).max() < 0.05


def test_blocked_bays_and_sites_without_bays_hold_nobody():
    assert len(draw(0, solids=(WALL,)).bays) == len(BAYS) - 1
    site = Site("none", np.array([-5.0, -5, 5, 5]))
    supply = Supply(catalogue(), np.random.default_rng(0))
    parked = Parked.draw(site, Obstacles(site), supply, max_parked=6)
    assert len(parked.ids) == len(parked.later(supply).ids) == 0


def test_parked_vehicles_leave_after_their_mean_stay():
    parked, supply = draw(1), Supply(catalogue(), np.random.default_rng(2))
    supply.ids, number, gone = count(100), len(parked.ids), 0
    for _ in range(400):
        later = parked.later(supply)
        gone += len(set(parked.ids.tolist()) - set(later.ids.tolist()))
        assert len(set(later.places.tolist())) == number
        parked = later
    assert 0.8 < gone * MEAN_STAY_FRAMES / (400 * number) < 1.2


@pytest.mark.parametrize(
    ("solid", "moves"),
    [
        *((wall(-5, 0.9, 5, 1.2), True), (wall(-5, 0.9, 5, 1.2, top=0.12, kind="kerb"), False)),
        (wall(-5, 0.9, 5, 1.2, base=1.0, top=4.0, kind="tree"), True),
        (wall(-5, 0.9, 5, 1.2, base=2.5, top=4.0, kind="tree"), False),
        (wall(-5, 0.9, 5, 1.2, base=-1.5, top=-0.5, kind="pond"), False),
    ],
)
def test_obstacles(solid, moves):
    _, kept, repaired = separate(cars((0, 0, 0)), Obstacles(Site("walled", AREA, solids=(solid,))))
    assert kept.all()
    assert repaired == moves


BAYS = np.column_stack([np.zeros(30), 3.0 * np.arange(30), np.full(30, 0.5)])
WALL = Solid(np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]]), 0.0, 2.0, "wall")  # in the first bay


def draw(seed, most=20, solids=()):
    site = Site("lot", np.array([-50.0, -50, 50, 100]), parking=BAYS, solids=solids)
    return Parked.draw(
        site, Obstacles(site), Supply(catalogue(), np.random.default_rng(seed)), max_parked=most
    )
