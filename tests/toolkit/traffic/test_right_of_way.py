"""Giving way: nobody overlaps, pedestrians wait at kerbs, pass each other, or are refused."""

import numpy as np
import pytest
import shapely

from toolkit.boxes import WidenedBoxes, footprints
from toolkit.objects import HEAVY, PEDESTRIAN, VEHICLE
from toolkit.sites.site import Site, Solid
from toolkit.traffic.course import Course, list_asides
from toolkit.traffic.obstacles import Obstacles
from toolkit.traffic.occupancy import Moments, Occupancy, size_boxes
from toolkit.traffic.right_of_way import give_way
from toolkit.traffic.road_lanes import distance_to_area

AREA = np.array([-40.0, -20, 40, 20])
PERSON = np.array([0.5, 0.6, 1.75])
CAR = np.array([4.6, 1.9, 1.5])
TRUCK = np.array([16.5, 2.6, 4.0])
LAST = 900


@pytest.fixture
def occupancy():
    return Occupancy(AREA, Obstacles(Site("plain", AREA)), np.zeros((0, 7)), LAST)


def straight(start, velocity, first, steps, *, size=PERSON, label=PEDESTRIAN):
    points = np.array(start) + 0.1 * np.outer(np.arange(steps), velocity)
    yaw = np.full(steps, np.arctan2(velocity[1], velocity[0]))
    return Course(first, np.column_stack([points, yaw]), size, label)


def placed(course, occupancy):
    """Poses of a body that finds a way."""
    poses = give_way(course, occupancy)
    assert poses is not None
    return poses


def touch(one, one_course, other, other_course):
    """True if two bodies overlap at some step while both can be seen."""
    begin = max(one_course.first, other_course.first)
    end = min(one_course.first + len(one), other_course.first + len(other))
    shapes = []
    is_seen = np.ones(end - begin, bool)
    for poses, course in ((one, one_course), (other, other_course)):
        boxes = size_boxes(poses[begin - course.first : end - course.first], course.size)
        shapes.append(shapely.polygons(footprints(boxes)))
        is_seen = is_seen & (distance_to_area(boxes[:, :2], AREA) < 10)
    return shapely.intersects(*shapes)[is_seen].any()


def test_who_meets_nobody_goes_as_planned(occupancy):
    course = straight((-45, 0), (1.4, 0), 0, 700)
    assert give_way(course, occupancy) is course.poses
    assert occupancy.find_conflict(size_boxes(course.poses, PERSON), 0) == 0


def test_a_pedestrian_waits_for_cars_at_the_kerb_and_goes_on(occupancy):
    cars = [
        straight((-60, 0), (10, 0), 80 + 25 * k, 160, size=CAR, label=VEHICLE) for k in range(6)
    ]
    for car in cars:
        assert give_way(car, occupancy) is car.poses
    pedestrian = straight((2, -30), (0, 1.4), 0, 500)
    poses = placed(pedestrian, occupancy)
    for car in cars:
        assert not touch(poses, pedestrian, car.poses, car)
    assert 500 < len(poses) < 650
    acceleration = np.hypot(*np.diff(poses[:, :2], n=2, axis=0).T) / 0.01
    assert acceleration.max() < 5
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    standing = poses[1:][steps < 0.01]
    assert (np.abs(standing[:, 1]) > 1.2).all()  # not on the lane


def test_pedestrians_who_meet_head_on_step_aside(occupancy):
    one = straight((-45, 0), (1.4, 0), 0, 700)
    other = straight((45, 0.1), (-1.3, 0), 0, 750)
    assert give_way(one, occupancy) is one.poses
    poses = placed(other, occupancy)
    assert not touch(poses, other, one.poses, one)
    assert np.abs(poses[:, 1] - 0.1).max() < 1.3
    assert poses[-1, 0] == pytest.approx(other.poses[-1, 0], abs=0.5)


def test_a_car_follows_a_slower_one(occupancy):
    slow = straight((-60, 0), (5, 0), 0, 260, size=CAR, label=VEHICLE)
    fast = straight((-60, 0), (10, 0), 40, 130, size=CAR, label=VEHICLE)
    give_way(slow, occupancy)
    poses = placed(fast, occupancy)
    assert not touch(poses, fast, slow.poses, slow)
    assert (np.abs(poses[:, 1]) < 1e-6).all()


def test_no_way_through_is_refused(occupancy):
    fence = straight((0, 0), (0, 0), 300, LAST - 299, size=np.array([90.0, 50, 2]))
    give_way(fence, occupancy)
    waiting = placed(straight((-70, 0), (1.4, 0), 0, 700), occupancy)
    assert waiting[-1, 0] < -45
    assert give_way(straight((-5, 0), (0, 0), 0, LAST + 1), occupancy) is None


@pytest.mark.parametrize(("edge_y", "passes"), [(0.9, False), (1.25, True)])
def test_who_cannot_pass_a_house_is_refused_and_does_not_stand_there(edge_y, passes):
    house = Solid(np.array([[10, edge_y], [14, edge_y], [14, 20], [10, 20]]), 0.0, 8.0)
    site = Site("corner", AREA, solids=(house,))
    occupancy = Occupancy(AREA, Obstacles(site), np.zeros((0, 7)), LAST)
    truck = straight((-60, 0), (8, 0), 0, 160, size=TRUCK, label=HEAVY)
    poses = give_way(truck, occupancy)
    assert (poses is not None) == passes
    if poses is not None:
        assert poses[-1, 0] > 60


def test_what_is_not_seen_does_not_count(occupancy):
    give_way(straight((-80, 0), (0, 0), 0, 300), occupancy)
    beside = straight((-80, 0), (0, 0), 0, 300)
    assert give_way(beside, occupancy) is beside.poses
    before = straight((0, 0), (0, 0), -300, 200)
    give_way(before, occupancy)
    assert occupancy.find_conflict(size_boxes(before.poses, PERSON), -300) is None


@pytest.mark.parametrize(("x", "is_taken"), [(4.0, True), (4.3, False)])
def test_a_corner_within_the_gap_takes_a_place(occupancy, x, is_taken):
    """The corners are 1.28 and 1.58 m apart; boxes widened by half of 1.5 m touch in both cases."""
    occupancy.add(size_boxes(np.zeros((1, 3)), CAR), 0)
    boxes = size_boxes(np.array([[x, 0.0, np.pi / 4]]), np.array([0.6, 0.6, 1.7]))
    taken = occupancy.find_blocked(boxes[None], Moments(0, 1, 1), 1.5)
    assert taken.tolist() == [[[is_taken]]]


def test_taken_places_are_those_that_shapely_finds(occupancy):
    rng = np.random.default_rng(1)
    car = straight((-30, 3), (8, 1), 5, 70, size=CAR, label=VEHICLE)
    give_way(car, occupancy)
    poses = np.column_stack(
        [rng.uniform(-30, 20, 40), rng.uniform(-4, 14, 40), rng.uniform(-3, 3, 40)]
    )
    # five lines next to each of forty places
    boxes = Course(0, poses, PERSON, PEDESTRIAN).list_lines(np.arange(40.0), list_asides(2))
    moments = Moments(0, 4, 20)
    taken = occupancy.find_blocked(boxes, moments, 0.0).transpose(0, 2, 1).reshape(20, 200)
    boxes = boxes.reshape(200, 7)
    shapes = shapely.polygons(footprints(boxes))
    for moment, step in enumerate(moments.steps.tolist()):
        if 5 <= step < 75:
            shape = shapely.polygons(footprints(size_boxes(car.poses[[step - 5]], CAR)))[0]
            np.testing.assert_array_equal(taken[moment], shapely.intersects(shapes, shape))
        else:
            assert not taken[moment].any()
    assert taken.any()


def test_boxes_are_not_compared_body_by_body(occupancy, monkeypatch):
    """Each question compares all bodies together, however many there are."""
    queue = [np.array([[6.0 * number - 30, 0.0, 0.0]]).repeat(200, axis=0) for number in range(10)]
    course = straight((-35, 3), (8, 0), 0, 90, size=CAR, label=VEHICLE)
    lines = course.list_lines(np.arange(0, 90, 3.0), list_asides(2))
    overlap = WidenedBoxes.overlap
    calls = []

    def count(self, partner):
        """Count a comparison."""
        calls.append(1)
        return overlap(self, partner)

    monkeypatch.setattr(WidenedBoxes, "overlap", count)
    counts = []
    for poses in queue:
        occupancy.add(size_boxes(poses, CAR), 0)
        calls.clear()
        assert occupancy.find_conflict(size_boxes(course.poses, CAR), 0) is None
        blocked = occupancy.find_blocked(lines, Moments(0, 3, 30), 1.5)
        assert blocked.any()
        counts.append(len(calls))
    assert max(counts) == counts[0]


def test_boxes_at_solids_are_those_that_shapely_finds():
    solids = []
    for x in (-20.0, 0.0, 20.0):
        corners = np.array([[x, 0.0], [x + 4, 1.0], [x + 3, 6.0], [x, 5.0]])
        solids.append(Solid(corners, base=0.0, top=5.0))
    obstacles = Obstacles(Site("houses", AREA, solids=tuple(solids)))
    rng = np.random.default_rng(1)
    poses = np.column_stack([rng.uniform(-80, 80, (3000, 2)), rng.uniform(-3, 3, 3000)])
    boxes = size_boxes(poses, CAR)
    is_hit = obstacles.hit(boxes)
    houses = shapely.union_all([shapely.Polygon(solid.footprint) for solid in solids])
    wide = boxes + np.array([0, 0, 0, 0.1, 0.1, 0, 0])
    np.testing.assert_array_equal(
        is_hit, shapely.intersects(shapely.polygons(footprints(wide)), houses)
    )
    assert is_hit.any()
