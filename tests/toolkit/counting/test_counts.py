"""Counts of ways whose movements, speeds and dwell times are known."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import binomtest

from toolkit.counting.arms import find_arm, find_arms, find_crossing
from toolkit.counting.count_totals import compare_totals
from toolkit.counting.counts import compare_counts, count_street, match_trips, pair_trips
from toolkit.counting.fragments import join_fragments
from toolkit.counting.trajectories import collect_trajectories, split_trajectories
from toolkit.counting.trips import find_trips, mask_inside
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE, Objects
from toolkit.sites.files import load_site
from toolkit.sites.site import Site
from toolkit.tracking.tracks import Tracks

SITE = load_site("tjunction")
ARMS = find_arms(SITE)
TIMES = np.round(np.arange(0, 60, 0.1), 6)


def test_arms_are_where_roads_leave_the_area():
    assert {arm.name for arm in ARMS} == {"south", "east", "north"}
    for arm in ARMS:
        on_border = np.isclose(arm.point, SITE.area[:2], atol=0.2) | np.isclose(
            arm.point, SITE.area[2:], atol=0.2
        )
        assert on_border.any()
    assert len(find_arms(load_site("roundabout"))) == 4


def test_a_crossing_is_straight_on_and_soon():
    area = np.array([-10.0, -10, 10, 10])
    np.testing.assert_allclose(find_crossing(np.array([7.0, 1]), np.array([3.0, 0]), area), [10, 1])
    assert find_crossing(np.array([0.0, 1]), np.array([3.0, 0]), area) is None
    assert find_crossing(np.array([9.0, 1]), np.array([0.0, 0]), area) is None


def test_without_roads_each_side_is_an_arm():
    """On a long street the nearest side counts, not the side whose middle is nearest."""
    arms = find_arms(Site("long", np.array([-100.0, -10, 100, 10])))
    assert {arm.name for arm in arms} == {"north", "east", "south", "west"}
    area = np.array([-100.0, -10, 100, 10])
    assert find_arm(np.array([80.0, 10]), np.array([0.0, 1]), arms, area) == "north"
    assert find_arm(np.array([-100.0, -9]), np.array([-1.0, 0]), arms, area) == "west"


def drive(name, label, points, times):
    """Rows of a road user at given places."""
    boxes = np.zeros((len(times), 7))
    boxes[:, :2] = points
    boxes[:, 3:6] = (4.5, 1.9, 1.5)
    step = np.gradient(points, axis=0)
    boxes[:, 6] = np.arctan2(step[:, 1], step[:, 0])
    return name, label, boxes, times


def join(*users):
    ids = np.concatenate([np.full(len(times), name) for name, _, _, times in users])
    labels = np.concatenate([np.full(len(times), label) for _, label, _, times in users])
    boxes = np.concatenate([boxes for _, _, boxes, _ in users])
    seconds = np.concatenate([times for _, _, _, times in users])
    order = np.argsort(seconds, kind="stable")
    return split_trajectories(ids[order], labels[order], boxes[order], seconds[order])


def along(x, y, count):
    return np.stack([np.broadcast_to(x, count), np.broadcast_to(y, count)], axis=1).astype(float)


def streets():
    """One along +x, to the north, at 8 m/s, one that stands 10 s, one first seen inside."""
    ten = TIMES[:100]
    through = drive(1, VEHICLE, along(np.linspace(-39.9, 39.3, 100), 13.6, 100), ten)
    x = np.concatenate(
        [np.linspace(-39.9, -20, 50), np.full(100, -20), np.linspace(-20, 39.9, 150)]
    )
    waiting = drive(2, HEAVY, along(x, 13.6, 300), TIMES[100:400])
    inside = drive(3, CYCLIST, along(np.linspace(0, 39.9, 80), 12.0, 80), TIMES[200:280])
    return through, waiting, inside


def test_movements_speeds_dwell_and_queues():
    counts = count_street(join(*streets()), SITE, ARMS, TIMES.tolist())
    through, waiting = sorted(counts.movements, key=lambda row: row.label, reverse=True)
    assert (through.label, through.entry, through.exit, through.count) == (
        *("vehicle", "south", "north"),
        1,
    )
    assert through.speed_km_h == pytest.approx(8 * 3.6, rel=0.02)
    assert through.dwell_s == pytest.approx(9.9)
    assert waiting.dwell_s == pytest.approx(29.9)
    assert counts.partial["cyclist"] == 1
    assert counts.total("vehicle", "heavy") == 2
    (queue,) = counts.queues
    assert (queue.entry, queue.longest) == ("south", 1)
    assert queue.mean == pytest.approx(100 / len(TIMES), rel=0.1)
    assert counts.seconds == pytest.approx(TIMES[-1])


def test_parked_vehicles_are_no_trips():
    parked = drive(1, VEHICLE, along(0.0, 0.0, 600), TIMES)
    counts = count_street(join(parked), SITE, ARMS, TIMES.tolist())
    assert counts.movements == ()
    assert sum(counts.partial.values()) == 0
    assert counts.queues == ()


def test_errors_are_counts_minus_true_counts():
    through, waiting, inside = streets()
    truth = count_street(join(through, waiting, inside), SITE, ARMS, TIMES.tolist())
    late = through[0], through[1], through[2], through[3] + 0.5
    counts = count_street(join(late), SITE, ARMS, TIMES.tolist())
    rows = {row.label: row for row in compare_counts(counts, truth)}
    assert (rows["vehicle"].count, rows["vehicle"].true_count) == (1, 1)
    assert (rows["heavy"].count, rows["heavy"].true_count) == (0, 1)
    assert np.isnan(rows["heavy"].speed_km_h)
    assert match_trips(counts, truth, "vehicle", "heavy") == (1, 1, 2)
    (pair,) = pair_trips(counts, truth, "vehicle", "heavy")
    assert [pair.true.begin, pair.counted.begin] == pytest.approx([0.0, 0.5])
    vehicles = compare_totals(counts, truth)[0]
    assert (vehicles.group, vehicles.count, vehicles.true_count, vehicles.error) == (
        *("vehicles", 1),
        *(2, -1),
    )
    assert (vehicles.found_share, vehicles.right_share) == (0.5, 1.0)
    expected = binomtest(1, 2).proportion_ci(method="wilson")
    assert vehicles.found_interval == pytest.approx(tuple(expected))
    much_later = through[0], through[1], through[2], through[3] + 20
    counts = count_street(join(much_later), SITE, ARMS, TIMES.tolist())
    assert match_trips(counts, truth, "vehicle", "heavy") == (0, 1, 2)
    assert match_trips(counts, truth, "cyclist") == (0, 0, 0)


def test_who_is_seen_once_has_no_velocity():
    (user,) = split_trajectories(
        np.array([7]), np.array([VEHICLE]), np.array([[1.0, 2, 1, 4, 2, 1.5, 0]]), np.zeros(1)
    )
    assert user.velocities.tolist() == [[0.0, 0.0]]


def test_trajectories_of_objects_and_of_tracks_that_are_sure():
    boxes = np.array([[0.0, 0, 1, 4, 2, 1.5, 0], [5, 5, 1, 4, 2, 1.5, 0]])
    moved = boxes + np.array([0.5, 0, 0, 0, 0, 0, 0])
    ids = np.array([4, 2])
    users = collect_trajectories(
        [Objects(boxes, ids=ids), Objects(moved[::-1], ids=ids[::-1])], [0.0, 0.1]
    )
    assert [user.id for user in users] == [2, 4]
    assert users[0].velocities[:, 0] == pytest.approx([5.0, 5.0])
    scores = np.array([0.9, 0.1])
    tracks = [Tracks(boxes, scores, ids=ids), Tracks(moved, scores, ids=ids)]
    assert [user.id for user in collect_trajectories(tracks, [0.0, 0.1])] == [4]
    assert collect_trajectories([Objects.empty()], [0.0]) == []
    with pytest.raises(ValueError, match="each frame needs a time"):
        collect_trajectories([], [0.0])


def stroll(name, points, gap=(0, 0)):
    """Pedestrian who goes straight from one place (x, y) to the next at 1.25 m/s.

    gap: first row that nobody sees, and the next one that is seen."""
    rows = [np.array(points[:1], float)]
    for begin, end in pairwise(points):
        count = round(float(np.hypot(*np.subtract(end, begin))) / 0.125)
        rows.append(np.linspace(begin, end, count + 1)[1:])
    places = np.concatenate(rows)
    times = np.round(0.1 * np.arange(len(places)), 6)
    seen = np.ones(len(places), np.bool_)
    seen[gap[0] : gap[1]] = False
    name, label, boxes, times = drive(name, PEDESTRIAN, places, times)
    return name, label, boxes[seen], times[seen]


# a road along x, and a pavement on the border of the area
PAVED = Site(
    "paved",
    np.array([-40.0, -12, 40, 12]),
    lanes=(np.array([[-60.0, -3], [60, -3], [60, 3], [-60, 3]]),),
)


@pytest.mark.parametrize(
    ("points", "gates"),
    [
        ([(-45, 6), (45, 6)], [("west", "east")]),
        ([(-45, 11.9), (45, 11.9)], [("west", "east")]),
        # along the border, over it in the middle
        ([(-45, 11.5), (0, 11.5), (4, 12.3), (45, 12.3)], [("west", None)]),
        ([(45, 12.3), (4, 12.3), (0, 11.5), (-45, 11.5)], [(None, "west")]),
        # straight over it
        ([(-45, 6), (0, 6), (0, 20)], [("west", None)]),
        ([(0, 20), (0, -20)], [(None, None)]),
        # over it to one side
        ([(-45, 6), (0, 6), (20, 20)], [("west", "east")]),
        ([(-45, 6), (0, 6), (-20, 20)], [("west", "west")]),
        ([(-20, 20), (20, -20)], [("west", "east")]),
        ([(20, 20), (-20, -20)], [("east", "west")]),
        # outside for 2 s, and for 8 s
        ([(-45, 11.9), (0, 11.9), (1, 12.1), (2, 11.9), (45, 11.9)], [("west", "east")]),
        (
            [(-45, 11.9), (0, 11.9), (1, 12.1), (10, 12.1), (11, 11.9), (45, 11.9)],
            [("west", None), (None, "east")],
        ),
    ],
)
def test_a_border_crossed_far_from_roads_leads_where_the_course_turns(points, gates):
    """Otherwise the arm is unknown. A track in the area counts as the whole way does."""
    arms = find_arms(PAVED)
    (user,) = join(stroll(1, points))
    whole = find_trips([user], arms, PAVED.area)
    assert [(trip.entry, trip.exit) for trip in whole] == gates
    inside = mask_inside(user, PAVED.area)
    parts = np.split(np.arange(len(inside)), np.flatnonzero(np.diff(inside.astype(int))) + 1)
    tracks = [
        user.select(slice(rows[0], rows[-1] + 1))._replace(id=number)
        for number, rows in enumerate(parts)
        if inside[rows[0]]
    ]
    trips = find_trips(join_fragments(tracks), arms, PAVED.area)
    assert [(trip.entry, trip.exit) for trip in trips] == gates


def test_a_gap_in_the_area_does_not_end_a_trip():
    (user,) = join(stroll(1, [(-45, 6), (45, 6)], gap=(300, 400)))
    (trip,) = find_trips([user], find_arms(PAVED), PAVED.area)
    assert (trip.entry, trip.exit) == ("west", "east")


def test_a_row_far_outside_leads_back_to_the_border():
    """Two frames a second: the first row outside may be farther from the road than any pavement."""
    times = 0.5 * np.arange(8)
    x = -70 + 40 * times
    y = np.where(np.abs(x) <= 40, 0.0, 14.0)
    (user,) = join(drive(1, VEHICLE, along(x, y, 8), times))
    (trip,) = find_trips([user], find_arms(PAVED), PAVED.area)
    assert (trip.entry, trip.exit) == ("west", "east")


def test_a_vehicle_that_returns_queues_on_each_of_its_trips():
    """It stands 3 s in the west, leaves in the east, turns there and stands 5 s on its way back."""
    there = np.concatenate([np.linspace(-45, -30, 15), np.full(30, -30), np.linspace(-30, 70, 100)])
    back = np.concatenate([np.linspace(70, 30, 40), np.full(50, 30), np.linspace(30, -45, 75)])
    x = np.concatenate([there, back])
    times = np.round(0.1 * np.arange(len(x)), 6)
    (user,) = join(drive(1, VEHICLE, along(x, 0.0, len(x)), times))
    counts = count_street([user], PAVED, find_arms(PAVED), times.tolist())
    assert [(trip.entry, trip.exit) for trip in counts.trips] == [
        ("west", "east"),
        ("east", "west"),
    ]
    means = {queue.entry: queue.mean * len(times) for queue in counts.queues}
    assert means == pytest.approx({"west": 30, "east": 50}, abs=8)
