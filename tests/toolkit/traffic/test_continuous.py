"""Continuous traffic: nobody appears, vanishes, jumps or overlaps inside the view."""

import sys
import weakref
from importlib.util import find_spec
from itertools import permutations

import numpy as np
import pytest
import shapely

from toolkit.bodies.fleet import catalogue, fleet_named
from toolkit.boxes import footprints
from toolkit.datasets.simulation import Job
from toolkit.objects import HEAVY, LABELS, PEDESTRIAN, VEHICLE
from toolkit.sites.files import load_site
from toolkit.sites.network import build_network, street
from toolkit.sites.site import Site
from toolkit.traffic import continuous, ways as ways_module
from toolkit.traffic.body_motion import change_length, move_driver, move_pedestrian, smooth_motion
from toolkit.traffic.continuous import simulate_continuously
from toolkit.traffic.flow import Flow, Movement
from toolkit.traffic.road_lanes import distance_to_area
from toolkit.traffic.snapshots import simulate
from toolkit.traffic.sumo import FINE_STEP_S
from toolkit.traffic.supply import Supply
from toolkit.traffic.ways import NoPassage, possible_movements, simulate_ways

needs_sumo = pytest.mark.skipif(find_spec("libsumo") is None, reason="traffic needs SUMO")
BODIES = catalogue()
FRAMES = 600


def supply_of(seed):
    return Supply(BODIES, np.random.default_rng(seed))


@pytest.fixture(scope="module", params=["tjunction", "roundabout"])
def traffic(request):
    return simulate_continuously(
        load_site(request.param), supply_of(5), frames=FRAMES, interval=0.1, max_parked=4
    )


@pytest.fixture(scope="module")
def tracks(traffic):
    """By id: class, first frame, and a row of the box for each frame."""
    found = {}
    for k in range(FRAMES):
        objects, _ = traffic.objects(k)
        for box, label, name in zip(objects.boxes, objects.labels, objects.ids, strict=True):
            found.setdefault(int(name), (int(label), k, []))[2].append(box)
    return {name: (label, first, np.array(boxes)) for name, (label, first, boxes) in found.items()}


@pytest.mark.one_in(2)
@needs_sumo
def test_all_classes_come_in_at_the_border_and_leave_there(traffic, tracks):
    parked = set(traffic.parked_ids.tolist())
    seen = set()
    for name, (label, first, boxes) in tracks.items():
        if name in parked:
            assert len(boxes) == FRAMES
            assert np.ptp(boxes, axis=0).max() == 0
            continue
        seen.add(LABELS[label])
        outside = distance_to_area(boxes[:, :2], traffic.site.area) > 0
        assert outside[0] or first == 0
        assert outside[-1] or first + len(boxes) == FRAMES
    assert {"vehicle", "cyclist", "pedestrian"} <= seen
    assert len(tracks) > 20


@needs_sumo
def test_hardly_anybody_is_refused(traffic):
    assert traffic.refused <= 1  # of some 50 in a minute


@needs_sumo
def test_a_truck_too_long_for_its_turn_is_replaced_by_a_shorter_one():
    # in this recording a truck of 16.5 m cannot get round a house, and one of 12.6 m can
    site = load_site("tjunction")
    job = Job(site, site.sensors, fleet_named(), 1000, seed=13, interval=0.1)
    traffic = job.with_traffic().traffic
    assert traffic is not None
    assert traffic.refused == 0
    is_long = np.abs(traffic.boxes[:, 3] - 12.6) < 0.05
    assert is_long.sum() > 50


@needs_sumo
def test_motion_is_smooth_and_headed(tracks):
    steps: dict[int, list[np.ndarray]] = {}
    for label, _, boxes in tracks.values():
        if len(boxes) < 5:
            continue
        velocity = np.diff(boxes[:, :2], axis=0) / 0.1
        steps.setdefault(label, []).append(np.hypot(*(np.diff(velocity, axis=0) / 0.1).T))
        speed = np.hypot(*velocity.T)
        turn = np.abs(np.angle(np.exp(1j * np.diff(boxes[:, 6]))))
        assert np.quantile(turn, 0.99) < np.deg2rad(25)
        if label != PEDESTRIAN:
            course = np.arctan2(velocity[:, 1], velocity[:, 0])
            away = np.abs(np.angle(np.exp(1j * (course - boxes[1:, 6]))))
            assert np.quantile(np.where(speed > 2, away, 0.0), 0.99) < np.deg2rad(35)
    for accelerations in steps.values():
        assert (np.concatenate(accelerations) > 15).mean() < 1e-3


@needs_sumo
def test_nothing_overlaps(traffic):
    for k in range(0, FRAMES, 7):
        objects, _ = traffic.objects(k)
        shapes = shapely.polygons(footprints(objects.boxes))
        first, second = shapely.STRtree(shapes).query(shapes, predicate="intersects")
        assert (first == second).all()


@needs_sumo
def test_the_demand_is_kept(site):
    supply = supply_of(1)
    possible = possible_movements(site, supply)
    entry = next(iter(possible["vehicle"]))
    leave = possible["vehicle"][entry][0]
    flow = Flow((Movement("vehicle", entry, leave, 900.0),))
    # a lane in front of traffic lights takes less
    with pytest.warns(UserWarning, match=f"come in at '{entry}' than its road takes"):
        traffic = simulate_continuously(
            site, supply, frames=240, interval=1.0, max_parked=0, flow=flow
        )
    assert {(user.entry, user.exit) for user in traffic.travellers} == {(entry, leave)}
    assert 40 <= len(traffic.travellers) <= 85  # 60 expected within 240 s, with Poisson's spread
    with pytest.raises(ValueError, match="no vehicle can come in at 'nowhere'"):
        simulate_continuously(
            site,
            supply_of(1),
            frames=2,
            interval=0.1,
            max_parked=0,
            flow=Flow((Movement("vehicle", "nowhere", leave, 1.0),)),
        )


@needs_sumo
def test_a_roundabout_with_two_lanes_carries_1200_vehicles_an_hour():
    gates = ("north", "east", "south", "west")
    per_hour = {"vehicle": 100.0, "cyclist": 15.0, "pedestrian": 30.0}  # from each to each other
    movements = []
    for kind, number in per_hour.items():
        for entry, leave in permutations(gates, 2):
            movements.append(Movement(kind, entry, leave, number))
    supply = supply_of(2)
    ways = simulate_ways(
        load_site("roundabout"), supply, seconds=300.0, flow=Flow(tuple(movements))
    )
    speeds = []
    for way in ways:
        if supply.labels[way.traveller.body] in (VEHICLE, HEAVY):
            speeds.append(np.hypot(*np.diff(way.poses[:, :2], axis=0).T) / FINE_STEP_S)
    # a share of .07 to .19 stood with drivers who change lanes where nobody has to brake
    assert (np.concatenate(speeds) < 0.3).mean() < 0.06


@needs_sumo
def test_the_same_seed_gives_the_same_snapshots(site):
    def boxes(seed):
        snapshots = simulate(site, BODIES, frames=30, seed=seed, interval=0.1)
        return np.concatenate([snapshot.objects.boxes for snapshot in snapshots])

    np.testing.assert_array_equal(boxes(3), boxes(3))
    assert not np.array_equal(boxes(3)[:5], boxes(4)[:5])


def test_a_driver_s_rear_follows_its_front():
    angle = np.linspace(0, np.pi / 2, 60)  # a bend of 15 m, then straight on
    bend = 15 * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    straight = bend[-1] + np.column_stack([np.zeros(80), np.arange(1, 81) * 0.4])
    poses = move_driver(np.concatenate([bend, straight]), 0.0, 4.0)
    assert poses[0] == pytest.approx([-2.0, 0.0, 0.0], abs=0.05)
    assert poses[-1, 2] == pytest.approx(np.pi / 2, abs=0.01)
    assert np.diff(poses[:, 2]).min() > -1e-3
    rears = poses[:, :2] - np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
    sideways = np.diff(rears, axis=0) * np.column_stack(
        [-np.sin(poses[1:, 2]), np.cos(poses[1:, 2])]
    )
    assert np.abs(sideways.sum(axis=1)).max() < 0.02


def test_a_shorter_body_keeps_the_course_of_the_front():
    bend = np.concatenate([np.zeros(40), np.linspace(0, np.pi / 2, 60), np.full(40, np.pi / 2)])
    fronts = np.cumsum(np.column_stack([np.cos(bend), np.sin(bend)]) * 0.5, axis=0)
    long_poses = move_driver(fronts, 0.0, 16.0)
    shortened = change_length(long_poses, 16.0, 8.0)
    np.testing.assert_allclose(shortened, move_driver(fronts, 0.0, 8.0), atol=1e-9)


def test_a_pedestrian_faces_its_way_and_keeps_facing_it_while_it_waits():
    x = np.concatenate([np.arange(40) * 0.13, np.full(60, 39 * 0.13)])
    poses = move_pedestrian(np.column_stack([x, np.zeros(100)]), 2.0)
    assert np.abs(poses[:, 2]).max() < 1e-6
    assert move_pedestrian(np.zeros((9, 2)), 2.0)[:, 2] == pytest.approx(2.0)
    assert move_pedestrian(np.zeros((1, 2)), 2.0)[0] == pytest.approx([0, 0, 2.0])


@pytest.mark.parametrize("steps", [1, 2, 3, 200])
def test_smoothing_keeps_ends_and_straight_lines(steps):
    line = np.column_stack([np.arange(steps) * 0.3, 4 - np.arange(steps) * 0.1])
    np.testing.assert_allclose(smooth_motion(line), line, atol=1e-9)
    rng = np.random.default_rng(0)
    noise = line + rng.normal(0, 0.1, line.shape)
    smoothed = smooth_motion(noise)
    np.testing.assert_allclose(smoothed[[0, -1]], noise[[0, -1]], atol=1e-9)
    if steps > 100:
        assert np.diff(smoothed, 2, axis=0).std() < 0.1 * np.diff(noise, 2, axis=0).std()


@needs_sumo
def test_a_site_without_a_road_through_is_refused_by_name():
    """The only road begins and ends inside the area."""
    nodes = [{"id": "a", "x": -10, "y": 0}, {"id": "b", "x": 10, "y": 0}]
    edges = [{"id": "ab", "from": "a", "to": "b", "lanes": street(1, footway=0.0)}]
    area = np.array([-30.0, -30.0, 30.0, 30.0])
    site = Site("inside", area, network=build_network(nodes, edges))
    with pytest.raises(NoPassage, match="import a larger piece of the map"):
        simulate_continuously(site, supply_of(1), frames=2, interval=0.1, max_parked=0)


@needs_sumo
def test_poses_are_not_kept_once_a_way_is_placed(monkeypatch):
    """Memory would grow with the length of a recording, though few frames need their poses."""
    kept = []
    alive = []

    def watch(way, supply, occupancy):
        """Count the poses of earlier ways that are still in memory."""
        alive.append(sum(poses() is not None for poses in kept))
        kept.append(weakref.ref(way.poses))
        return place(way, supply, occupancy)

    place = continuous._place
    monkeypatch.setattr(continuous, "_place", watch)
    simulate_continuously(
        load_site("tjunction"), supply_of(5), frames=100, interval=0.5, max_parked=0
    )
    assert len(alive) > 20
    assert max(alive) <= 2


@needs_sumo
def test_points_of_courses_are_numbers_in_arrays(monkeypatch):
    """Pairs of numbers would take seven times as much memory."""
    sizes = []
    make = ways_module._make_ways

    def watch(course, supply):
        """Note the memory of a course for each of its steps."""
        journeys = make(course, supply)
        assert memoryview(course.points).itemsize == 8
        sizes.append(sys.getsizeof(course.points) / len(journeys[0].poses))
        return journeys

    monkeypatch.setattr(ways_module, "_make_ways", watch)
    simulate_ways(load_site("tjunction"), supply_of(5), seconds=20.0)
    assert np.median(sizes) < 24  # bytes: two numbers of 8, and room to grow
