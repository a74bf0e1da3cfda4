from itertools import pairwise

import numpy as np
import pytest
import shapely

from toolkit.sites.furniture import rectangle
from toolkit.sites.site import Mount, Solid
from toolkit.sites.surroundings.mount_places import place_mounts
from toolkit.sites.surroundings.parking_bays import (
    BAY_DEPTHS_M,
    BAY_SIZE_M,
    bay_outline,
    bays_between,
    bays_from_junction,
    forecourts,
    kerb_bays,
)
from toolkit.sites.surroundings.plot import LANE_CLEARANCE_M, MOUNT_CLEARANCE_M, Plot, Road

AREA = np.array([-40.0, -20.0, 40.0, 20.0])
ROAD = Road(
    paths=[np.array([[-80.0, 0.0], [80.0, 0.0]])],
    half_widths=[(5.5, 5.5)],
    lanes=[rectangle(-80.0, -3.5, 80.0, 0.0), rectangle(-80.0, 0.0, 80.0, 3.5)],
    footways=[rectangle(-80.0, 3.5, 80.0, 5.5), rectangle(-80.0, -5.5, 80.0, -3.5)],
)


def test_roads_have_surfaces_and_islands():
    assert ROAD.carriageway.area == pytest.approx(160 * 7, rel=0.01)
    assert ROAD.surface.area == pytest.approx(160 * 11, rel=0.01)
    assert ROAD.islands == []
    sides = [
        (-10.0, -10.0, 10.0, -6.0),
        (-10.0, 6.0, 10.0, 10.0),
        (-10.0, -10.0, -6.0, 10.0),
        (6.0, -10.0, 10.0, 10.0),
    ]
    (island,) = Road([], [], [rectangle(*side) for side in sides], []).islands
    assert island.centroid.distance(shapely.Point(0, 0)) < 1e-6


def test_ground_is_claimed_once_and_off_lanes_and_mounts():
    mount = Mount("post", np.array([30.0, 10.0, 0.0]))
    plot = Plot(ROAD, shapely.box(*AREA), [mount])
    assert plot.claim(shapely.box(0, 8, 4, 12))
    assert not plot.claim(shapely.box(3, 11, 6, 14))
    assert not plot.claim(shapely.box(10, 3.5 + LANE_CLEARANCE_M / 2, 11, 5), on_footways=True)
    assert not plot.claim(shapely.box(20, 4, 21, 5))
    assert plot.claim(shapely.box(20, 4, 21, 5), on_footways=True)
    assert not plot.claim(shapely.box(30, 10, 31, 11).buffer(MOUNT_CLEARANCE_M / 2))
    assert not plot.claim(shapely.box(100, 8, 104, 12)), "outside the window"


def test_solids_are_placed_together_or_not_at_all():
    plot = Plot(ROAD, shapely.box(*AREA), [])
    free, in_the_way = (
        Solid(rectangle(x, y, x + 2, y + 2), 0.0, 1.0, "hedge") for x, y in ((0.0, 9.0), (4.0, 2.0))
    )
    assert not plot.place([free, in_the_way])
    assert plot.solids == []
    assert plot.place([free])
    assert plot.solids == [free]


@pytest.mark.parametrize("seed", range(3))
def test_mounts_stand_apart_beside_the_road_and_repeat(seed):
    mounts = place_mounts(ROAD, AREA, np.random.default_rng(seed))
    places = [shapely.Point(mount.position[:2]) for mount in mounts]
    assert 12 <= len(mounts) <= 24
    assert len({mount.name for mount in mounts}) == len(mounts)
    assert min(ROAD.carriageway.distance(place) for place in places) >= 0.6 - 1e-3
    assert min([a.distance(b) for i, a in enumerate(places) for b in places[:i]]) >= 5.0 - 0.01
    again = place_mounts(ROAD, AREA, np.random.default_rng(seed))
    assert [mount.position.tolist() for mount in again] == [
        mount.position.tolist() for mount in mounts
    ]


def test_shoulders_may_be_built_on_and_bays_are_claimed():
    road = Road(
        ROAD.paths,
        ROAD.half_widths,
        ROAD.lanes,
        ROAD.footways,
        {"out0": (LINE - np.array([0.0, -7.85]), 3.5)},
    )
    shoulder = Plot(road, shapely.box(*AREA), [])
    assert road.driven_ground.area == pytest.approx(160 * 3.5, rel=0.01)
    assert not shoulder.claim(shapely.box(0, 0.5, 4, 3), on_footways=True)
    assert shoulder.claim(shapely.box(0, 0.5, 4, 3), on_shoulders=True)
    assert not shoulder.claim(shapely.box(10, LANE_CLEARANCE_M / 2, 14, 3), on_shoulders=True)
    assert not shoulder.claim(shapely.box(1, 1, 2, 2), on_shoulders=True), "taken"
    counts = []
    for seed in range(12):
        ground = plot()
        bays = kerb_bays(
            ground, {"in0": (LINE, 5.2)}, {"in0": 90, "out7": 0}, np.random.default_rng(seed)
        )
        again = kerb_bays(plot(), {"in0": (LINE, 5.2)}, {"in0": 90}, np.random.default_rng(seed))
        assert np.array_equal(bays, again)
        assert not ground.claim(bay_outline(bays[0]).buffer(-0.5), on_shoulders=True), "taken"
        counts.append(len(bays))
    assert 5 < min(counts) < 15
    assert 15 < max(counts) < 25


SHOULDER = rectangle(-80.0, -8.7, 80.0, -3.5)
LINE = np.array([[-80.0, -6.1], [80.0, -6.1]])  # middle of the shoulder, as its traffic goes
ROAD_BAYS = Road(
    paths=[np.array([[-80.0, 0.0], [80.0, 0.0]])],
    half_widths=[(5.5, 10.7)],
    lanes=[rectangle(-80.0, -3.5, 80.0, 0.0), rectangle(-80.0, 0.0, 80.0, 3.5), SHOULDER],
    footways=[rectangle(-80.0, 3.5, 80.0, 5.5), rectangle(-80.0, -10.7, 80.0, -8.7)],
    strips={"in0": (LINE, 5.2)},
)


def plot():
    return Plot(ROAD_BAYS, shapely.box(*AREA).buffer(25.0, join_style="mitre"), [])


@pytest.mark.parametrize("angle", BAY_DEPTHS_M)
def test_bays_are_headed_for_the_kerb_on_the_right_and_do_not_overlap(angle):
    rows = bays_from_junction((LINE, BAY_DEPTHS_M[angle]), angle, at_end=True)
    assert len(rows) > (10 if angle == 0 else 15)
    assert np.rad2deg(rows[:, 2]) == pytest.approx(-angle, abs=0.01)
    assert rows[:, 1] == pytest.approx(-6.1)
    assert rows[:, 0].max() < 80 - 6 - BAY_SIZE_M[0] / 2 + 0.01, "clear of the junction at the end"
    assert rows[:, 0].min() > 80 - 76
    shapes = [bay_outline(row, (BAY_SIZE_M[0] - 0.2, BAY_SIZE_M[1] - 0.2)) for row in rows]
    assert max(a.intersection(b).area for a, b in pairwise(shapes)) < 1e-6


@pytest.mark.parametrize("angle", BAY_DEPTHS_M)
def test_bays_and_forecourts_keep_clear_of_street_and_junctions(angle):
    line = shapely.LineString(LINE)
    right, left = (bays_between(line, angle), bays_between(line, angle, kerb_left=True))
    assert np.abs(right[:, 0]).max() < 80 - 6 - BAY_SIZE_M[0] / 2 + 0.01
    assert np.abs(right[:, 0]).max() > 60
    assert np.rad2deg(right[:, 2]) == pytest.approx(-angle, abs=0.01)
    assert np.rad2deg(left[:, 2]) == pytest.approx(angle, abs=0.01)
    assert len(bays_between(shapely.LineString([(0, 0), (15, 0)]), angle)) == 0
    rows = bays_from_junction((LINE, 2.3), 0, at_end=False)
    assert -80 + 6 + BAY_SIZE_M[0] / 2 - 0.01 < rows[:, 0].min() < rows[:, 0].max() < -80 + 76
    for seed in range(6):
        bays = forecourts(plot(), np.random.default_rng(seed))
        assert all(bay_outline(bay).intersection(ROAD_BAYS.surface).is_empty for bay in bays)
