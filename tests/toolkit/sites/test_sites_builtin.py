"""What every built-in site promises."""

import importlib
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely

from toolkit.sites import BUILT_IN
from toolkit.sites.files import load_site

AREAS = {"tjunction": (-40, -20, 40, 20), "roundabout": (-48, -48, 48, 48)}
HEIGHTS = {"tjunction": (5.2, 6), "roundabout": (8.0, 8)}


@pytest.fixture(scope="module", params=sorted(BUILT_IN))
def site(request):
    return load_site(request.param)


def test_areas_heights_and_sensors_are_the_papers(site):
    assert tuple(site.area) == AREAS[site.name]
    assert site.height == 4.0
    height, count = HEIGHTS[site.name]
    assert [s.name for s in site.sensors] == [f"d{i}" for i in range(count)]
    assert {round(s.position[2], 6) for s in site.sensors} == {height}
    assert {s.model.shape for s in site.sensors} == {(150, 200)}


def test_nothing_stands_on_the_road_and_only_posts_on_footways(site, union):
    lanes = union(site.lanes)
    walk = union(site.footways).buffer(-0.2)  # kerbstones lie on the footway's edge
    for solid in site.solids:
        footprint = shapely.Polygon(solid.footprint)
        if solid.base < 4:
            assert footprint.intersection(lanes).area < 0.02, (solid.kind, footprint.centroid)
        if solid.base < 2 and solid.kind != "kerb" and footprint.area > 0.04:
            assert footprint.intersection(walk).area < 0.02, (solid.kind, footprint.centroid)


def test_no_solid_is_in_the_way_of_what_drives(site):
    edges = [e for e in ElementTree.fromstring(site.network).iter("edge") if e.get("function") in (None, "internal")]
    lanes = [lane for e in edges for lane in e.iter("lane") if "passenger" in lane.get("allow", "")]
    corners = [[spot.split(",") for spot in lane.attrib["shape"].split()] for lane in lanes]
    paths = [shapely.LineString(np.array(line, np.float64)) for line in corners]
    swept = shapely.union_all(paths).buffer(1.0)
    blocking = [s.kind for s in site.solids if s.base < 4 and shapely.Polygon(s.footprint).intersects(swept)]
    assert not blocking


def test_parking_bays_are_free_and_off_the_street(site, union):
    street_ = union([*site.lanes, *site.footways])
    standing = shapely.union_all([shapely.Polygon(s.footprint) for s in site.solids if s.base < 1.5])
    for x, y, yaw in site.parking:
        bay = shapely.affinity.rotate(shapely.box(x - 2.4, y - 1, x + 2.4, y + 1), yaw, use_radians=True)
        assert not bay.intersects(street_)
        assert not bay.intersects(standing)


def test_mounts_are_many_on_the_ground_and_clear(site, union):
    assert len(site.mounts) >= 40
    places = np.array([mount.position for mount in site.mounts])
    assert np.allclose(places[:, 2], site.ground(places[:, :2]), atol=1e-3)
    lanes = union(site.lanes).buffer(-0.02)
    tall = shapely.union_all([shapely.Polygon(s.footprint) for s in site.solids if s.kind in ("building", "tree")])
    for mount in site.mounts:
        assert not lanes.intersects(shapely.Point(mount.position)), mount
        assert not tall.contains(shapely.Point(mount.position)), mount
    present = {tuple(np.round(s.position[:2])) for s in site.sensors}
    places[places[:, 0] == -45.6, 1] = 10.1  # the arm of post 2
    assert present <= {tuple(place) for place in np.round(places[:, :2])}


def test_traffic_comes_from_60_metres_beyond_the_area(site):
    x0, y0, x1, y1 = map(float, ElementTree.fromstring(site.network).find("location").get("convBoundary").split(","))
    beyond = np.array([site.area[0] - x0, site.area[1] - y0, x1 - site.area[2], y1 - site.area[3]])
    open_ends = beyond > 0  # the T-junction has no road upwards
    assert open_ends.sum() >= 3
    assert (beyond[open_ends] >= 60).all()


def test_packaged_file_is_what_the_code_builds(site):
    pytest.importorskip("sumo")
    assert importlib.import_module(f"toolkit.sites.{site.name}").build() == site


def test_network_runs_in_sumo_and_cars_cross_the_junction(site, tmp_path, union):
    libsumo = pytest.importorskip("libsumo")
    net, routes = tmp_path / "net.xml", tmp_path / "trips.rou.xml"
    net.write_text(site.network)
    ends = [
        ("left_junction", "junction_right"),
        ("side_junction", "junction_left"),
        ("right_junction", "junction_side"),
    ]
    if site.name == "roundabout":
        legs = ("east", "north", "west", "south")
        ends = [(f"entry_{a}_on", f"exit_{b}_on") for a in legs for b in legs if a != b]
    trips = [f'<trip id="{i}" depart="{i}" from="{a}" to="{b}"/>' for i, (a, b) in enumerate(ends)]
    walks = [f'<person id="p" depart="0"><walk from="{ends[0][0]}" to="{ends[0][1]}"/></person>']
    routes.write_text("<routes>" + "".join([walks[0], *trips]) + "</routes>")
    libsumo.start(["sumo", "-n", str(net), "-r", str(routes), "--no-step-log", "--end", "400", "--no-warnings"])
    try:
        arrived, seen = 0, []
        while libsumo.simulation.getMinExpectedNumber() > 0 and libsumo.simulation.getTime() < 400:
            libsumo.simulationStep()
            arrived += libsumo.simulation.getArrivedNumber()
            seen += [libsumo.vehicle.getPosition(v) for v in libsumo.vehicle.getIDList()]
    finally:
        libsumo.close()
    assert arrived == len(ends)
    road = union(site.lanes).buffer(0.3)
    inside = [p for p in seen if site.area[0] < p[0] < site.area[2] and site.area[1] < p[1] < site.area[3]]
    assert np.mean([road.contains(shapely.Point(p)) for p in inside]) > 0.99
