"""What is placed around a road: nothing on a lane, nothing in anything else, mounts where sensors can see."""

import numpy as np
import pytest
import shapely

from toolkit.sites.furniture import rectangle
from toolkit.sites.site import Mount, Solid
from toolkit.sites.surroundings import LANE_CLEARANCE, MOUNT_CLEARANCE, Plot, Road, place_mounts

AREA = np.array([-40.0, -20.0, 40.0, 20.0])
ROAD = Road(
    paths=[np.array([[-80.0, 0.0], [80.0, 0.0]])],
    half_widths=[(5.5, 5.5)],
    lanes=[rectangle(-80.0, -3.5, 80.0, 0.0), rectangle(-80.0, 0.0, 80.0, 3.5)],
    footways=[rectangle(-80.0, 3.5, 80.0, 5.5), rectangle(-80.0, -5.5, 80.0, -3.5)],
)


def spots(mounts):
    return [shapely.Point(mount.position[:2]) for mount in mounts]


def test_a_road_knows_its_surface_and_the_ground_it_encloses():
    assert ROAD.carriageway.area == pytest.approx(160 * 7, rel=0.01)
    assert ROAD.surface.area == pytest.approx(160 * 11, rel=0.01)
    assert ROAD.islands == []
    sides = [(-10.0, -10.0, 10.0, -6.0), (-10.0, 6.0, 10.0, 10.0), (-10.0, -10.0, -6.0, 10.0), (6.0, -10.0, 10.0, 10.0)]
    (island,) = Road([], [], [rectangle(*side) for side in sides], []).islands
    assert island.centroid.distance(shapely.Point(0, 0)) < 1e-6


def test_ground_is_taken_once_and_never_on_a_lane():
    mount = Mount("post", np.array([30.0, 10.0, 0.0]))
    plot = Plot(ROAD, shapely.box(*AREA), [mount])
    assert plot.claim(shapely.box(0, 8, 4, 12))
    assert not plot.claim(shapely.box(3, 11, 6, 14))
    assert not plot.claim(shapely.box(10, 3.5 + LANE_CLEARANCE / 2, 11, 5), footway=True)
    assert not plot.claim(shapely.box(20, 4, 21, 5))
    assert plot.claim(shapely.box(20, 4, 21, 5), footway=True)
    assert not plot.claim(shapely.box(30, 10, 31, 11).buffer(MOUNT_CLEARANCE / 2))
    assert not plot.claim(shapely.box(100, 8, 104, 12)), "outside the window"


def test_solids_are_placed_together_or_not_at_all():
    plot = Plot(ROAD, shapely.box(*AREA), [])
    free, in_the_way = (Solid(rectangle(x, y, x + 2, y + 2), 0.0, 1.0, "hedge") for x, y in ((0.0, 9.0), (4.0, 2.0)))
    assert not plot.place([free, in_the_way])
    assert plot.solids == []
    assert plot.place([free])
    assert plot.solids == [free]


@pytest.mark.parametrize("seed", range(3))
def test_mounts_stand_apart_beside_the_road_and_repeat(seed):
    mounts = place_mounts(ROAD, AREA, np.random.default_rng(seed), at_least=10, spacing=5.0)
    places = spots(mounts)
    assert 10 <= len(mounts) <= 20
    assert len({mount.name for mount in mounts}) == len(mounts)
    assert min(ROAD.carriageway.distance(place) for place in places) >= 0.6 - 1e-3
    apart = [a.distance(b) for i, a in enumerate(places) for b in places[:i]]
    assert min(apart) >= 5.0 - 0.01
    again = place_mounts(ROAD, AREA, np.random.default_rng(seed), at_least=10, spacing=5.0)
    assert [mount.position.tolist() for mount in again] == [mount.position.tolist() for mount in mounts]


def test_shoulders_may_be_built_on_and_driven_lanes_may_not():
    road = Road(ROAD.paths, ROAD.half_widths, ROAD.lanes, ROAD.footways, [rectangle(-80.0, 0.0, 80.0, 3.5)])
    plot = Plot(road, shapely.box(*AREA), [])
    assert road.driven.area == pytest.approx(160 * 3.5, rel=0.01)
    assert not plot.claim(shapely.box(0, 0.5, 4, 3), footway=True)
    assert plot.claim(shapely.box(0, 0.5, 4, 3), shoulder=True)
    assert not plot.claim(shapely.box(10, LANE_CLEARANCE / 2, 14, 3), shoulder=True)
    assert not plot.claim(shapely.box(1, 1, 2, 2), shoulder=True), "taken"
