"""Fragments of one road user are joined, those of two are not."""

import numpy as np
import pytest

from toolkit.counting.fragments import join_fragments
from toolkit.counting.trajectories import Trajectory
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE

TIMES = np.round(np.arange(0, 20, 0.1), 6)


def moving(name, start, velocity, label=VEHICLE):
    boxes = np.zeros((len(TIMES), 7))
    boxes[:, :2] = np.array(start) + np.outer(TIMES, velocity)
    boxes[:, 3:6] = 1.0
    return Trajectory(
        name, label, TIMES, boxes, np.tile(np.array(velocity, float), (len(TIMES), 1))
    )


def cut(trajectory, *spans):
    return [
        trajectory.select(slice(*span))._replace(id=trajectory.id + 10 * number)
        for number, span in enumerate(spans)
    ]


def test_a_track_that_broke_twice_is_one():
    car = moving(1, (0, 0), (8, 0))
    fragments = cut(car, (0, 50), (65, 100), (130, 200))
    fragments[1] = fragments[1]._replace(label=HEAVY)
    (joined,) = join_fragments(fragments[::-1])
    assert (joined.id, joined.label) == (21, VEHICLE)
    np.testing.assert_allclose(joined.times, np.delete(TIMES, [*range(50, 65), *range(100, 130)]))


@pytest.mark.parametrize("goes_on", [False, True])
def test_who_stops_or_sets_off_in_a_gap_is_one(goes_on):
    """Standing ones seem to move a little in any direction, such as back."""
    before, after = cut(moving(1, (0, 0), (0.6, 0), PEDESTRIAN), (0, 80), (88, 200))
    standing = before if goes_on else after
    standing.boxes[:, 0] = 4.8
    standing.velocities[:] = (-0.1, 0.02)
    (joined,) = join_fragments([before, after])
    assert len(joined.times) == 192


def test_two_side_by_side_keep_apart():
    cars = [moving(1, (0, 0), (8, 0)), moving(2, (0, 3), (8, 0))]
    fragments = [part for car in cars for part in cut(car, (0, 80), (95, 200))]
    joined = join_fragments(fragments)
    assert len(joined) == 2
    assert [np.ptp(user.boxes[:, 1]) for user in joined] == [0, 0]


def test_long_gaps_other_places_and_other_classes_stay_apart():
    car = moving(1, (0, 0), (8, 0))
    assert len(join_fragments(cut(car, (0, 50), (100, 200)))) == 2
    ahead, behind = cut(car, (0, 50), (70, 200))
    assert len(join_fragments([ahead, behind._replace(label=CYCLIST)])) == 2
    away = behind._replace(boxes=behind.boxes + np.eye(7)[1] * 9)
    assert len(join_fragments([ahead, away])) == 2
    back = behind._replace(velocities=-behind.velocities, boxes=behind.boxes.copy())
    back.boxes[:, 0] = ahead.boxes[-1, 0] - 8 * (back.times - back.times[0])
    assert len(join_fragments([ahead, back])) == 2
    standing = moving(3, (5, 5), (0, 0))
    assert len(join_fragments(cut(standing, (0, 20), (180, 200)))) == 1
    assert join_fragments([]) == []


@pytest.mark.parametrize("velocity", [(8, 0), (0, 8)])
def test_who_moved_on_is_not_who_stands_there_later(velocity):
    """A gap of 6 s would do if both sides stood."""
    (car,) = cut(moving(1, (0, 0), velocity), (0, 50))
    half_way = car.boxes[-1, :2] + 6.0 / 2 * np.array(velocity)
    (parked,) = cut(moving(2, half_way, (0, 0)), (109, 150))
    assert len(join_fragments([car, parked])) == 2


def test_a_track_that_begins_before_the_last_one_ends_goes_on():
    car = moving(1, (0, 0), (8, 0))
    (joined,) = join_fragments(cut(car, (0, 110), (100, 200)))
    np.testing.assert_allclose(joined.times, TIMES)
    assert len(join_fragments(cut(car, (0, 140), (100, 200)))) == 2


def test_the_nearest_fragment_comes_first():
    fragments = cut(moving(1, (0, 0), (8, 0)), (0, 60), (70, 90), (99, 200))
    fragments[1] = fragments[1]._replace(boxes=fragments[1].boxes + 0.4 * np.eye(7)[1])
    (joined,) = join_fragments(fragments)
    assert len(joined.times) == 181


def test_second_tracks_of_one_body_are_left_out():
    car = moving(1, (0, 0), (8, 0))
    car.boxes[:, 3:6] = (4.5, 1.9, 1.5)
    part = car.select(slice(50, 90))
    shadow = part._replace(id=2, boxes=part.boxes + 0.5 * np.eye(7)[0])
    beside = part._replace(id=3, boxes=part.boxes + 2.5 * np.eye(7)[1])
    assert [user.id for user in join_fragments([shadow, car, beside])] == [1, 3]


@pytest.mark.parametrize("yaw", [0.0, 1.0])
@pytest.mark.parametrize(
    ("ahead", "aside", "is_shadow"),
    [(1.8, -0.7, True), (-1.8, 0.7, True), (2.7, 0.0, False), (0.0, 1.3, False)],
)
def test_a_shadow_is_within_the_length_and_width_of_a_turned_body(yaw, ahead, aside, is_shadow):
    along = np.array([np.cos(yaw), np.sin(yaw)])
    left = np.array([-np.sin(yaw), np.cos(yaw)])
    car = moving(1, (0, 0), 8 * along)
    car.boxes[:, 3:] = (4.5, 1.9, 1.5, yaw)
    part = car.select(slice(50, 90))
    boxes = part.boxes.copy()
    boxes[:, :2] += ahead * along + aside * left
    other = part._replace(id=2, boxes=boxes)
    assert [user.id for user in join_fragments([car, other])] == ([1] if is_shadow else [1, 2])
