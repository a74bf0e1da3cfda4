"""Parking along the kerbs of an OpenStreetMap extract: where the tags say, on the right side, at
the right angle."""

import numpy as np
import pytest
import shapely

from toolkit.bodies.fleet import catalogue
from toolkit.objects import VEHICLE
from toolkit.sites.maps.map_bays import MAP_BAY_SIZE_M
from toolkit.sites.maps.tracks import find_tracks
from toolkit.sites.osm.parking import Parking, ParkingRoad
from toolkit.sites.surroundings.parking_bays import bay_outline
from toolkit.traffic.snapshots import simulate


@pytest.fixture
def east_west(empty_map):
    """A street from west to east that another crosses, with these tags."""

    def draw(**tags):
        draft = empty_map()
        draft.node((0, 0), highway="traffic_signals")
        draft.way((-300, 0), (0, 0), (300, 0), highway="residential", **tags)
        draft.way((0, -300), (0, 0), (0, 300), highway="residential")
        return draft

    return draw


def south(site):
    return site.parking[site.parking[:, 1] < 0]


def north(site):
    return site.parking[site.parking[:, 1] > 0]


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    ("tags", "sides"),
    [
        ({"parking__both": "lane"}, (True, True)),
        ({"parking__right": "street_side", "parking__left": "no"}, (False, True)),
        (
            {"parking__left": "half_on_kerb", "parking__left__orientation": "parallel"},
            (True, False),
        ),
        ({"parking__both": "lane", "parking__left__restriction": "no_stopping"}, (False, True)),
        *(
            ({"parking__both": "separate"}, (False, False)),
            ({"parking__lane__both": "parallel"}, (True, True)),
        ),
        ({"parking__lane__left": "no_parking", "parking__lane__right": "marked"}, (False, True)),
        ({"parking__both": "no", "parking__lane__both": "parallel"}, (False, False)),
        ({"parking__left": "rubbish"}, (False, False)),
    ],
)
def test_sides_of_the_street(tmp_path, imported, east_west, tags, sides):
    site = imported(east_west(**tags), tmp_path)
    assert (len(north(site)) > 5, len(south(site)) > 5) == sides
    assert len(site.parking) == len(north(site)) + len(south(site)), (
        "none in the street that crosses"
    )
    np.testing.assert_allclose(np.abs(site.parking[:, 1]), 3.25 + 1.15, atol=0.01)
    assert np.cos(south(site)[:, 2]) == pytest.approx(1, abs=1e-3)
    assert np.cos(north(site)[:, 2]) == pytest.approx(-1, abs=1e-3), "as its traffic goes"


@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    ("orientation", "angle", "wide"), [("diagonal", 45, 4.8), ("perpendicular", 90, 5.2)]
)
@pytest.mark.parametrize("lefthand", [False, True])
def test_bays_at_an_angle_head_for_the_kerb(
    tmp_path, imported, east_west, orientation, angle, wide, lefthand
):
    draft = east_west(parking__right="lane", parking__right__orientation=orientation)
    site = imported(draft, tmp_path, lefthand=lefthand)
    assert len(site.parking) > 12
    np.testing.assert_allclose(site.parking[:, 1], -3.25 - wide / 2, atol=0.01)
    assert np.sin(site.parking[:, 2]) == pytest.approx(-np.sin(np.deg2rad(angle)), abs=1e-3)
    along = np.cos(np.deg2rad(angle)) * (-1 if lefthand else 1)  # of the lane beside them
    assert np.cos(site.parking[:, 2]) == pytest.approx(along, abs=1e-3)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("lefthand", [False, True])
def test_a_one_way_street_has_parking_on_both_sides(tmp_path, imported, east_west, lefthand):
    draft = east_west(
        oneway="yes",
        lanes="2",
        parking__left="lane",
        parking__right="lane",
        parking__right__orientation="diagonal",
    )
    site = imported(draft, tmp_path, lefthand=lefthand)
    assert min(len(north(site)), len(south(site))) > 8
    assert np.sin(north(site)[:, 2]) == pytest.approx(0, abs=1e-3)
    assert np.sin(south(site)[:, 2]) == pytest.approx(-np.sin(np.pi / 4), abs=1e-3)


def test_a_way_that_is_mapped_against_its_traffic(tmp_path, imported, east_west):
    site = imported(east_west(oneway="-1", parking__right="lane"), tmp_path)
    assert len(north(site)) == 0, "right is south as the way is drawn"
    assert len(south(site)) > 8


def test_a_parking_area_beside_the_road(tmp_path, imported, east_west, box):
    draft = east_west()
    draft.way(
        *box(14, 4, 38, 9), amenity="parking", parking="street_side", orientation="perpendicular"
    )
    draft.way(*box(-38, -40, -14, -20), amenity="parking", parking="surface")
    site = imported(draft, tmp_path)
    assert len(site.parking) > 4
    assert site.parking[:, 0].min() > 14
    assert site.parking[:, 0].max() < 38
    assert np.sin(site.parking[:, 2]) == pytest.approx(1, abs=1e-3)


def test_only_a_part_of_the_road_has_parking(tmp_path, imported, empty_map):
    draft = empty_map()
    draft.way((-300, 0), (0, 0), highway="residential", parking__both="lane")
    draft.way((0, 0), (300, 0), highway="residential")
    site = imported(draft, tmp_path)
    assert len(site.parking) > 10
    assert site.parking[:, 0].max() < 1


def test_a_turned_site_keeps_its_junction_whole(tmp_path, imported, east_west, union, on_lanes):
    site = imported(east_west(oneway="yes", parking__both="lane"), tmp_path, heading=0.4)
    assert on_lanes(site, 0.0, 0.0)
    road, tracks = union(site.lanes), find_tracks(site.network)
    assert tracks.intersection(shapely.box(*site.area)).difference(road.buffer(0.1)).area < 0.5
    for bay in site.parking:
        ground = bay_outline(bay, MAP_BAY_SIZE_M)
        assert ground.difference(road).area < 0.05
        assert ground.intersection(tracks).area < 0.05
        assert not any(
            shapely.Polygon(s.footprint).intersects(ground.buffer(-0.05)) for s in site.solids
        )


def test_vehicles_park_there_and_traffic_passes(tmp_path, imported, east_west):
    site = imported(east_west(parking__both="lane"), tmp_path)
    parked, passing = 0, 0
    for snapshot in simulate(site, catalogue(), frames=8, seed=3):
        vehicles = snapshot.objects.boxes[snapshot.objects.labels == VEHICLE]
        apart = np.hypot(*(vehicles[:, None, :2] - site.parking[:, :2]).T).min(axis=0)
        parked += int((apart < 0.3).sum())
        passing += int((np.abs(vehicles[:, 1]) < 3.0).sum())
    assert parked > 8
    assert passing > 8


def test_no_network_is_made_twice_where_nobody_parks(tmp_path, imported, east_west):
    site = imported(east_west(parking__both="no"), tmp_path)
    assert site.network == imported(east_west(), tmp_path).network
    assert not Parking((ParkingRoad(shapely.LineString([(0, 0), (9, 0)]), None, None),))
