"""Conflicts: closed formulas of two straight ways, and a brute force with GEOS."""

import tracemalloc

import numpy as np
import pytest
import shapely

from toolkit.boxes import footprints
from toolkit.counting import conflicts
from toolkit.counting.conflicts import Conflict, find_conflicts, match_conflicts, time_to_collision
from toolkit.counting.trajectories import split_trajectories
from toolkit.objects import CYCLIST, PEDESTRIAN, VEHICLE

SIZES = {VEHICLE: (4.0, 2.0, 1.5), CYCLIST: (1.8, 0.6, 1.8), PEDESTRIAN: (0.5, 0.5, 1.8)}


def straight(name, label, start, velocity, *, seconds=10.0, delay=0.0):
    """Rows of a road user that goes straight on, at 10 Hz."""
    times = np.round(np.arange(0, seconds, 0.1) + delay, 6)
    points = np.array(start) + np.outer(times - delay, velocity)
    boxes = np.zeros((len(times), 7))
    boxes[:, :2] = points
    boxes[:, 2] = 0.8
    boxes[:, 3:6] = SIZES[label]
    boxes[:, 6] = np.arctan2(velocity[1], velocity[0])
    return name, label, boxes, times


def join(*users):
    ids = np.concatenate([np.full(len(times), name) for name, _, _, times in users])
    labels = np.concatenate([np.full(len(times), label) for _, label, _, times in users])
    boxes = np.concatenate([boxes for _, _, boxes, _ in users])
    seconds = np.concatenate([times for _, _, _, times in users])
    order = np.argsort(seconds, kind="stable")
    return split_trajectories(ids[order], labels[order], boxes[order], seconds[order])


@pytest.mark.parametrize("delay", [1.0, 2.3])
def test_pet_of_two_crossing_cars_is_the_closed_formula(delay):
    # the first leaves the square of both lanes at x = 1 + 2, the second comes in at y = -1 - 2
    first = straight(1, VEHICLE, (-30, 0), (10, 0))
    second = straight(2, VEHICLE, (0, -30), (0, 10), delay=delay)
    (conflict,) = find_conflicts(join(first, second))
    assert (conflict.first, conflict.second) == (1, 2)
    assert conflict.pet_s == pytest.approx(delay - 0.6, abs=0.1001)
    assert conflict.angle_deg == pytest.approx(90, abs=1)
    assert np.hypot(conflict.x, conflict.y) < 4


def test_a_long_pet_counts_up_to_the_limit():
    users = join(
        straight(1, VEHICLE, (-30, 0), (10, 0)), straight(2, VEHICLE, (0, -30), (0, 10), delay=3.0)
    )
    assert find_conflicts(users, max_pet=1.5) == []
    assert len(find_conflicts(users, max_pet=3.0)) == 1
    assert find_conflicts(users, np.array([5.0, 5.0, 9.0, 9.0])) == []


def test_a_conflict_on_the_edge_of_the_area_counts():
    users = join(
        straight(1, VEHICLE, (-30, 0), (10, 0)), straight(2, VEHICLE, (0, -30), (0, 10), delay=1.0)
    )
    (conflict,) = find_conflicts(users)
    x, y = conflict.x, conflict.y
    for corner in ((x - 5, y - 5, x, y), (x, y, x + 5, y + 5)):
        assert find_conflicts(users, np.array(corner)) == [conflict]


def test_who_is_seen_for_a_moment_is_in_no_conflict():
    car = straight(1, VEHICLE, (-30, 0), (10, 0))
    seen = {}
    for seconds in (0.5, 3.0):
        walker = straight(2, PEDESTRIAN, (0, -1.5), (0, 1.4), seconds=seconds, delay=4.0)
        seen[seconds] = len(find_conflicts(join(car, walker), max_pet=3.0))
    assert seen == {0.5: 0, 3.0: 1}


def test_who_follows_goes_beside_or_walks_too_is_in_no_conflict():
    first = straight(1, VEHICLE, (-30, 0), (10, 0))
    follower = straight(2, VEHICLE, (-40, 0), (10, 0))
    assert find_conflicts(join(first, follower)) == []
    walkers = (
        straight(1, PEDESTRIAN, (-5, 0), (1.4, 0)),
        straight(2, PEDESTRIAN, (0, -5), (0, 1.4)),
    )
    assert find_conflicts(join(*walkers)) == []
    assert len(find_conflicts(join(walkers[0], straight(2, CYCLIST, (0, -14), (0, 4))))) == 1
    # side by side in a bend: the outer one takes up places of the inner one, turned
    angles = np.arange(0, 1.5, 0.05)
    bend = []
    for name, radius in ((1, 10.0), (2, 12.0)):
        boxes = np.zeros((len(angles), 7))
        boxes[:, 0] = radius * np.sin(angles)
        boxes[:, 1] = radius * (1 - np.cos(angles)) - (radius - 10)
        boxes[:, 3:6] = SIZES[VEHICLE]
        boxes[:, 6] = angles
        bend.append((name, VEHICLE, boxes, 0.1 * np.arange(len(angles))))
    assert find_conflicts(join(*bend)) == []


def test_pet_is_what_a_brute_force_with_geos_finds():
    rng = np.random.default_rng(3)
    found = 0
    for _ in range(25):
        angle = rng.uniform(np.deg2rad(40), np.deg2rad(140))
        speeds = rng.uniform(3, 12, 2)
        directions = np.array([[1.0, 0.0], [np.cos(angle), np.sin(angle)]])
        users = [
            straight(1, VEHICLE, -3 * speeds[0] * directions[0], speeds[0] * directions[0]),
            straight(
                2,
                CYCLIST,
                -3 * speeds[1] * directions[1],
                speeds[1] * directions[1],
                delay=round(rng.uniform(0, 2), 1),
            ),
        ]
        shapes = [shapely.polygons(footprints(boxes)) for _, _, boxes, _ in users]
        touches = shapely.intersects(shapes[0][:, None], shapes[1][None])
        gaps = np.abs(users[1][3][None] - users[0][3][:, None])
        expected = gaps[touches].min(initial=np.inf)
        conflicts = find_conflicts(join(*users))
        if expected > 5:
            assert conflicts == []
        else:
            found += 1
            assert conflicts[0].pet_s == pytest.approx(expected, abs=1e-6)
    assert found > 15


def test_time_to_collision_is_distance_over_speed_and_what_steps_find():
    box = np.array([[0.0, 0, 0, 4, 2, 1.5, 0]])
    ahead = np.array([[20.0, 0, 0, 4, 2, 1.5, 0]])
    assert time_to_collision(box, ahead, np.array([[-8.0, 0]])) == pytest.approx(2.0)
    assert time_to_collision(box, ahead, np.array([[8.0, 0]])) == np.inf
    assert time_to_collision(box, ahead, np.zeros((1, 2))) == np.inf
    assert time_to_collision(box, box + np.eye(7)[0], np.zeros((1, 2))) == 0
    rng = np.random.default_rng(5)
    hits = 0
    for _ in range(60):
        other = np.array([[*rng.uniform(-15, 15, 2), 0, 4.5, 1.8, 1.5, rng.uniform(-3, 3)]])
        velocity = -other[:, :2] / 2 + rng.normal(0, 2, (1, 2))
        (seconds,) = time_to_collision(box, other, velocity)
        steps = np.arange(0, 6, 0.005)
        moved = np.repeat(other, len(steps), axis=0)
        moved[:, :2] += steps[:, None] * velocity
        touches = shapely.intersects(
            shapely.polygons(footprints(box))[0], shapely.polygons(footprints(moved))
        )
        first = steps[touches].min(initial=np.inf)
        if first < 5.9:
            hits += 1
            assert seconds == pytest.approx(first, abs=0.006)
        else:
            assert seconds > 5.8
    assert hits > 30


def conflict(time, pet, x=0.0):
    labels = ("vehicle", "cyclist")
    return Conflict(
        first=1, second=2, labels=labels, time=time, x=x, y=0.0, pet_s=pet, ttc_s=1.0, angle_deg=90
    )


def test_matches_may_exceed_the_limit_by_the_tolerance():
    true = [conflict(10, 1.0), conflict(20, 1.4), conflict(30, 1.7), conflict(40, 0.5)]
    found = [conflict(10.2, 1.1), conflict(20, 1.6), conflict(30, 1.45), conflict(40, 0.5, x=50)]
    matches = match_conflicts(found, true, max_pet=1.5, tolerance=0.3)
    assert (matches.true, matches.detected) == (3, 2)
    assert (matches.found, matches.right) == (3, 2)
    np.testing.assert_allclose(matches.pet_errors_s, [0.1, 0.2])
    nothing = match_conflicts([], true, max_pet=1.5, tolerance=0.3)
    assert (nothing.found, nothing.true, nothing.detected) == (0, 3, 0)


def circle(name, turn, *, count, seconds=60.0):
    """Rows of a car on a roundabout, a share of a turn after others."""
    times = np.round(np.arange(0, seconds, 0.1), 6)
    angles = 2 * np.pi * (times / 30 + turn / count)
    boxes = np.zeros((len(times), 7))
    boxes[:, 0] = 40 * np.cos(angles)
    boxes[:, 1] = 40 * np.sin(angles)
    boxes[:, 3:6] = SIZES[VEHICLE]
    boxes[:, 6] = angles + np.pi / 2
    return name, VEHICLE, boxes, times


def test_only_pairs_that_come_near_soon_are_compared(monkeypatch):
    """On a circle all ways cover the same ground, but only neighbours come to it soon."""
    compared = []
    find = conflicts._find_conflict

    def count(*pair):
        """Count a comparison."""
        compared.append(1)
        return find(*pair)

    monkeypatch.setattr(conflicts, "_find_conflict", count)
    users = join(*(circle(number, number, count=12) for number in range(12)))
    assert find_conflicts(users, max_pet=1.5) == []
    assert len(compared) == 12  # of 66 pairs; 2.5 s are between neighbours, in the same periods


def test_memory_of_a_pair_does_not_grow_with_the_square_of_its_times():
    users = join(circle(1, 0, count=4, seconds=400.0), circle(2, 1, count=4, seconds=400.0))
    tracemalloc.start()
    try:
        assert find_conflicts(users, max_pet=5.0) == []
        peak_bytes = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak_bytes < 60e6  # 16 million pairs of times would take 128 MB for each number
