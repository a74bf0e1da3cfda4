import numpy as np
import pytest

from toolkit.traffic.routes import Lane, Roads, distance_to_area

AREA = np.array([-10.0, -10, 10, 10])


def lane(name, start, end, *, forbidden=("pedestrian",), following=(), length=None):
    shape = np.array([start, end], float)
    return Lane(
        name, name[:-2], length or float(np.hypot(*(shape[1] - shape[0]))), shape, frozenset(forbidden), following
    )


TOWARDS = lane("in_0", (-60, 0), (0, 0), following=("out_0",))
AWAY = lane("out_0", (0, 0), (60, 0))
FOOTWAY = lane("foot_0", (-60, 4), (60, 4), forbidden=("passenger",))
ROADS = Roads({each.name: each for each in (TOWARDS, AWAY, FOOTWAY)})


def test_offsets_are_in_sumos_length_of_the_lane():
    longer = lane("in_0", (0, 0), (10, 0), length=20.0)
    assert longer.at(np.array([0.0, 10.0, 20.0])).tolist() == [[0, 0], [5, 0], [10, 0]]


def test_cars_start_in_the_area_or_headed_for_it():
    places = ROADS.places(AREA, 20.0, "passenger")
    x = places.points[:, 0]
    assert set(places.lanes) == {"in_0", "out_0"}
    assert x.min() >= -30
    assert x.max() <= 10, "beyond the area the lane leads away from it"
    assert len(places) == len(places.offsets) == len(places.lengths)


def test_pedestrians_start_on_lanes_of_their_own_and_walk_either_way():
    places = ROADS.places(AREA, 20.0, "pedestrian")
    assert set(places.lanes) == {"foot_0"}
    assert places.points[:, 0].min() < -25
    assert places.points[:, 0].max() > 25


def test_a_route_goes_on_until_it_is_long_enough_or_the_road_ends():
    rng = np.random.default_rng(0)
    assert ROADS.route("in_0", "passenger", 1.0, rng) == ["in", "out"]
    assert ROADS.route("in_0", "passenger", 1e6, rng) == ["in", "out"]
    assert ROADS.route("out_0", "passenger", 100.0, rng) == ["out"]


def test_where_a_lane_ends_its_neighbours_links_are_taken():
    ends = lane("in_1", (-60, 3), (0, 3))
    roads = Roads({**ROADS.lanes, "in_1": ends})
    assert roads.route("in_1", "passenger", 1.0, np.random.default_rng(0)) == ["in", "out"]


@pytest.mark.parametrize(("point", "away"), [((0, 0), 0), ((10, 10), 0), ((13, 14), 5), ((-12, 0), 2)])
def test_distance_to_area(point, away):
    assert distance_to_area(np.array([point], float), AREA).tolist() == [away]
