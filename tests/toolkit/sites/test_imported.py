"""Whole roads, kerbs and drawn surroundings of imported sites."""

import os
import warnings
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely

from toolkit.bodies.fleet import catalogue
from toolkit.boxes import footprints
from toolkit.objects import VEHICLE
from toolkit.points import centred_in
from toolkit.sites.furniture import post, rectangle
from toolkit.sites.imported import (
    bay_outline,
    bays_along,
    driven,
    free_bays,
    furnished,
    junction_corners,
    kerbstones,
    legs,
    turning,
    whole_road,
)
from toolkit.sites.maps import import_opendrive, import_osm
from toolkit.sites.site import Mount, Solid
from toolkit.traffic.snapshots import simulate

SHARED = Path(os.environ.get("COVIEW_SHARED", Path(__file__).parents[4] / "shared"))
DOCS = Path(__file__).parents[3] / "docs"
carla = pytest.mark.skipif(not (SHARED / "carla").is_dir(), reason="the CARLA maps are not here")
NET = (
    '<net><edge id="a"><lane id="a_0" index="0" allow="pedestrian" width="2" shape="-80,-5 0,-5"/>'
    '<lane id="a_1" index="1" width="3" shape="-80,-2 0,-2"/></edge><edge id="b"><lane id="b_0" index="0" width="3" '
    'disallow="all" shape="0,40 80,40"/></edge><edge id=":c_0" function="internal"><lane id=":c_0_0" index="0" '
    'width="5" shape="0,-2 20,-2"/></edge><edge id=":c_w0" function="walkingarea"><lane id=":c_w0_0" index="0" '
    'allow="pedestrian" shape="0,-6 8,-6 8,-2 0,-2"/></edge>'
    '<junction id="c" type="priority" shape="0,-8 9,-8 9,0 0,0"/>'
    '<junction id="d" type="dead_end" shape="90,-8 99,-8 99,0"/></net>'
)
WINDOW = shapely.box(-50, -50, 50, 50)


def shape(polygons):
    return shapely.union_all([shapely.Polygon(p) for p in polygons])


def test_driven_and_corners_of_a_network():
    tracks = driven(NET)  # the internal lane is 3.5 m wide at most, and a body of 5.5 m goes on from it
    assert tracks.bounds == pytest.approx((-80, -3.75, 25.5, -0.25), abs=0.5)
    assert tracks.area == pytest.approx(80 * 3 + 20 * 3.5 + 5.5 * 2.6, abs=1.5)
    carriageway, footway = junction_corners(NET)
    assert footway.bounds == (0, -6, 8, -2)
    assert carriageway.area == pytest.approx(72 - 32)


def test_a_vehicle_that_turns_needs_room_inside_the_bend():
    bend = "0,0 1,0 2,0.2 3,0.6 4,1.2 4.8,2 5.4,3 5.8,4 6,5 6,6"
    lane = f'<lane id=":c_0_0" index="0" width="2" shape="{bend}"/>'
    turn = driven(f'<net><edge id=":c_0" function="internal">{lane}</edge></net>')
    assert turn.contains(shapely.Point(3.2, 2.6))  # 1.3 m off the chord from one end of the body to the other
    assert not turn.contains(shapely.Point(1.0, 5.0))
    assert turning(f'<net><edge id=":c_0" function="internal">{lane}</edge></net>', 2.0).contains(turn)
    assert turning(NET).is_empty


def test_a_stub_of_footway_across_a_lane_is_carriageway():
    lanes = [shapely.box(-60, -4, -0.8, 4), shapely.box(0.8, -4, 60, 4)]
    footways = [shapely.box(-60, 4, 60, 6), shapely.box(-0.8, 1, 0.8, 5)]
    track = shapely.box(-60, -3, 60, 0)
    road, walk = (shape(each) for each in whole_road(lanes, footways, track, WINDOW))
    assert road.symmetric_difference(shapely.box(-50, -4, 50, 4)).area < 4.0  # the far side of the slot may stay open
    assert road.contains(shapely.box(-0.7, 1.1, 0.7, 3.9))
    assert walk.symmetric_difference(shapely.box(-50, 4, 50, 6)).area < 0.1
    assert road.intersection(walk).area < 1e-6


def test_cracks_close_slivers_go_and_the_ends_are_square():
    lanes = [shapely.box(-80, -4, 80, -0.1), shapely.box(-80, 0.1, 80, 4), shapely.box(-20, 20, 20, 20.6)]
    footways = [shapely.box(-80, 4.2, 80, 6), shapely.box(10, -4.3, 30, -4)]
    road, walk = (shape(each) for each in whole_road(lanes, footways, shapely.Polygon(), WINDOW))
    assert road.bounds[0::2] == walk.bounds[0::2] == (-50, 50)
    assert road.symmetric_difference(shapely.box(-50, -4, 50, 4)).area < 0.5
    assert walk.bounds[1] >= 4.0


def test_what_is_driven_is_no_footway_and_islets_go():
    lanes = [shapely.box(-60, -8, 60, 8).difference(shapely.box(0, -2, 4, 2))]
    islet, refuge = shapely.box(0, -2, 4, 2), shapely.box(-40, 8, 40, 12)
    track = shapely.box(-60, 7, 60, 9)
    road, walk = (shape(each) for each in whole_road(lanes, [islet, refuge], track, WINDOW))
    assert road.contains(islet.buffer(-0.05))
    assert walk.bounds == pytest.approx((-40, 9, 40, 12), abs=0.02)


def test_fillings_yield_to_what_the_map_says():
    lanes, walk = [shapely.box(-60, -4, 60, 4)], [shapely.box(-60, 4, 60, 6)]
    fillings = shapely.box(-10, -12, 10, 5), shapely.box(-10, -14, 10, -12)
    lanes_there, footways = whole_road(lanes, walk, shapely.Polygon(), WINDOW, fillings=fillings)
    assert shape(lanes_there).contains(shapely.box(-9.9, -11.9, 9.9, 0))
    assert shape(footways).contains(shapely.box(-9.9, 4.1, 9.9, 5.9))
    assert shape(footways).contains(shapely.box(-9.9, -13.9, 9.9, -12.1))


def test_kerbs_stand_on_the_footway():
    lanes, footways = (rectangle(-10.0, -4.0, 10.0, 4.0),), (rectangle(-10.0, 4.0, 10.0, 6.0),)
    stones = kerbstones(lanes, footways, shapely.Polygon())
    assert shape([s.footprint for s in stones]).bounds == pytest.approx((-10, 4.01, 10, 4.15), abs=0.011)
    assert [(s.base, s.top, s.kind) for s in stones] == [(0.0, 0.12, "kerb")] * 5
    assert kerbstones(lanes, (), shapely.Polygon()) == []
    lowered = shape([s.footprint for s in kerbstones(lanes, footways, shapely.box(-3, 0, 3, 9))])
    assert lowered.area == pytest.approx(14 * 0.14, abs=0.1)
    assert not lowered.intersects(shapely.box(-2.9, 0, 2.9, 9))


def test_legs_are_the_streets_that_cars_use():
    paths, widths = legs(NET)
    assert widths == [(3.5, 3.5)]  # 5 m of lanes, from the middle of the inner one
    np.testing.assert_allclose(paths[0], [[-80, -2], [0, -2], [130, -2]])


def test_bays_in_which_something_stands_or_drives_are_none():
    bays = [(0.0, 9.0, 0.0), (10.0, 9.0, 0.0), (20.0, 9.0, 0.0), (38.0, 9.0, 0.0)]
    window = shapely.box(-40, -40, 40, 40)
    rows = free_bays(bays, window, [post(10.0, 9.0, 3.0)], shapely.box(18, 0, 22, 20))
    np.testing.assert_allclose(rows, [[0, 9, 0]])


def test_the_front_of_a_slanted_bay_may_reach_over_the_edge_of_a_lane():
    strip, lane, window = 4.8, shapely.box(-40, -3.3, 40, 0), shapely.box(-40, -40, 40, 40)
    assert len(free_bays([(0.0, strip / 2, 0.25 * np.pi)], window, [], lane)) == 1
    assert len(free_bays([(0.0, strip / 2 - 0.5, 0.25 * np.pi)], window, [], lane)) == 0


def test_bays_follow_a_parking_lane():
    rows = bays_along(np.array([[0.0, 0], [0, 20]]))
    np.testing.assert_allclose(rows, [(0, 3.2, np.pi / 2), (0, 9.6, np.pi / 2), (0, 16.0, np.pi / 2)])
    assert bays_along(np.array([[0.0, 0], [5, 0]])) == []
    assert np.ptp(bay_outline(1.0, 2.0, 0.0), axis=0) == pytest.approx([5.8, 2.3])


@pytest.fixture(scope="module")
def bare():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return import_osm(DOCS / "own-junction.osm", centre=(8.0, 49.5), size=(70, 50))


def on_lanes(solids, lanes):
    """The largest area of a lane on which something stands; crowns of trees may be over it."""
    return max(shapely.Polygon(s.footprint).intersection(lanes).area for s in solids)


def low(site, below):
    """The solids that begin less than `below` m above the ground."""
    feet = site.ground(np.array([s.footprint.mean(axis=0) for s in site.solids]))
    return [s for s, foot in zip(site.solids, feet, strict=True) if s.base - foot < below]


def test_what_is_drawn_keeps_off_what_the_map_has(bare):
    house = Solid(rectangle(10.0, 10.0, 30.0, 30.0), 0.0, 7.0)
    lamp = Mount("lamp99", np.array([9.0, 9.0, 0.0]))
    made, said = furnished(bare, [*bare.mounts, lamp], [house], 3)
    again, _ = furnished(bare, [*bare.mounts, lamp], [house], 3)
    other, _ = furnished(bare, [*bare.mounts, lamp], [house], 4)
    assert made == again
    assert made != other
    ours = shapely.box(10, 10, 30, 30)
    assert sum(ours.buffer(0.15).intersects(shapely.Polygon(s.footprint)) for s in made.solids) == 1
    lanes = shape(made.lanes)
    assert on_lanes(low(made, 2.0), lanes) < 1e-3
    assert {"building", "tree"} <= {s.kind for s in made.solids}
    assert 0 < made.relief.amplitude <= 0.12
    assert said.startswith("drawn from seed 3, in no map: ")
    assert said.endswith(f"{len(made.parking)} bays, ground within {made.relief.amplitude} m")
    feet = np.array([m.position for m in made.mounts])
    np.testing.assert_allclose(feet[:, 2], made.ground(feet[:, :2]), atol=1e-3)
    with pytest.raises(ValueError, match="seed must be a whole number from 0 up, got -1"):
        furnished(bare, bare.mounts, [], -1)


def touched(site, frames, interval) -> np.ndarray:
    """How many vehicles of some traffic touch a solid that begins below 1.5 m, in the area; how many a kerb, onto which
    a vehicle drives that makes room for another; and how many there are."""
    solids = low(site, 1.5)
    kerb = np.array([s.kind == "kerb" for s in solids])
    tree = shapely.STRtree([shapely.Polygon(s.footprint) for s in solids])
    hits = np.zeros(3, int)
    for snapshot in simulate(site, catalogue(), frames=frames, seed=1, interval=interval):
        here = (snapshot.objects.labels == VEHICLE) & centred_in(snapshot.objects.boxes, site.area)
        boxes = snapshot.objects.boxes[here]
        vehicle, solid = tree.query(shapely.polygons(footprints(boxes)), predicate="intersects")
        hits += [len(set(vehicle[~kerb[solid]])), len(set(vehicle[kerb[solid]])), len(boxes)]
    return hits


def junctions(town):
    """Middles of the map's junctions."""
    starts = {}
    for road in ElementTree.parse(town).getroot().iter("road"):
        for piece in road.findall("planView/geometry") if road.get("junction") != "-1" else ():
            starts.setdefault(road.get("junction"), []).append([float(piece.get(key)) for key in "xy"])
    return [tuple(np.mean([np.min(xy, axis=0), np.max(xy, axis=0)], axis=0)) for xy in starts.values()]


def whole(town, centre):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        site = import_opendrive(SHARED / "carla" / town, centre=centre, size=(80, 70), seed=0)
    lanes = shape(site.lanes)
    assert on_lanes(low(site, 2.0), lanes) < 1e-3
    assert shape(site.footways).intersection(lanes).area < 0.1
    assert driven(site.network).intersection(shapely.box(*site.area)).difference(lanes.buffer(0.05)).area < 0.5
    assert len(site.mounts) >= 6
    kinds = {solid.kind for solid in site.solids}
    assert {"building", "tree", "kerb", "post"} <= kinds
    return site


@carla
@pytest.mark.parametrize(("town", "centre"), [("Town01.xodr", (95.9, -197.3)), ("Town03.xodr", (0.0, 0.0))])
def test_no_solid_is_in_the_way(town, centre):
    assert touched(whole(town, centre), 8, 5.0)[:2].tolist() == [0, 0]


@carla
@pytest.mark.slow
@pytest.mark.parametrize("town", ["Town01.xodr", "Town03.xodr"])
def test_no_solid_is_in_the_way_at_any_junction(town):
    hits = {centre: touched(whole(town, centre), 30, 2.0) for centre in junctions(SHARED / "carla" / town)}
    solids, kerbs, vehicles = np.sum(list(hits.values()), axis=0)
    assert solids == 0, hits
    assert kerbs < 0.002 * vehicles, hits
