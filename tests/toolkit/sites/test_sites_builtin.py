"""What every built-in site promises."""

from hashlib import sha256
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely

from toolkit import geometry, sites
from toolkit.sites import BUILT_IN, files

FOLDER = Path(sites.__file__).parent
AREAS = {"tjunction": (-40, -20, 40, 20), "roundabout": (-48, -48, 48, 48)}
HEIGHTS = {"tjunction": (5.2, 6), "roundabout": (8.0, 8)}


@pytest.fixture(scope="module", params=sorted(BUILT_IN))
def site(request):
    return files.load_site(request.param)


def test_areas_sensors_and_traffic_are_the_papers(site):
    assert tuple(site.area) == AREAS[site.name]
    assert site.height == 4.0
    height, count = HEIGHTS[site.name]
    assert [s.name for s in site.sensors] == [f"d{i}" for i in range(count)]
    assert {round(s.position[2], 6) for s in site.sensors} == {height}
    assert {s.model.shape for s in site.sensors} == {(150, 200)}
    x0, y0, x1, y1 = map(
        float, ElementTree.fromstring(site.network).find("location").get("convBoundary").split(",")
    )
    beyond = np.array([site.area[0] - x0, site.area[1] - y0, x1 - site.area[2], y1 - site.area[3]])
    open_ends = beyond > 0  # the T-junction has no road upwards
    assert open_ends.sum() >= 3
    assert (beyond[open_ends] >= 60).all()


def test_nothing_is_in_the_way_on_the_road(site, union):
    lanes = union(site.lanes)
    walk = union(site.footways).buffer(-0.2)  # kerbstones lie on the footway's edge
    for solid in site.solids:
        footprint = shapely.Polygon(solid.footprint)
        if solid.base < 4:
            assert footprint.intersection(lanes).area < 0.02, (solid.kind, footprint.centroid)
        if solid.base < 2 and solid.kind != "kerb" and footprint.area > 0.04:
            assert footprint.intersection(walk).area < 0.02, (solid.kind, footprint.centroid)
    edges = [
        e
        for e in ElementTree.fromstring(site.network).iter("edge")
        if e.get("function") in (None, "internal")
    ]
    lanes = [lane for e in edges for lane in e.iter("lane") if "passenger" in lane.get("allow", "")]
    corners = [[spot.split(",") for spot in lane.attrib["shape"].split()] for lane in lanes]
    paths = [shapely.LineString(np.array(line, np.float64)) for line in corners]
    swept = shapely.union_all(paths).buffer(1.0)
    assert not [
        s.kind for s in site.solids if s.base < 4 and shapely.Polygon(s.footprint).intersects(swept)
    ]


def test_parking_bays_and_mounts_are_free_of_the_street(site, union):
    street_ = union([*site.lanes, *site.footways])
    standing = shapely.union_all(
        [shapely.Polygon(s.footprint) for s in site.solids if s.base < 1.5]
    )
    for x, y, yaw in site.parking:
        bay = shapely.affinity.rotate(
            shapely.box(x - 2.4, y - 1, x + 2.4, y + 1), yaw, use_radians=True
        )
        assert not bay.intersects(street_)
        assert not bay.intersects(standing)
    assert len(site.mounts) >= 40
    places = np.array([mount.position for mount in site.mounts])
    assert np.allclose(places[:, 2], site.ground(places[:, :2]), atol=1e-3)
    lanes = union(site.lanes).buffer(-0.02)
    tall = shapely.union_all(
        [shapely.Polygon(s.footprint) for s in site.solids if s.kind in ("building", "tree")]
    )
    for mount in site.mounts:
        assert not lanes.intersects(shapely.Point(mount.position)), mount
        assert not tall.contains(shapely.Point(mount.position)), mount
    present = {tuple(np.round(s.position[:2])) for s in site.sensors}
    places[places[:, 0] == -45.6, 1] = 10.1  # the arm of post 2
    assert present <= {tuple(place) for place in np.round(places[:, :2])}


def test_areas_and_poses_are_the_published_ones():
    """Recordings and tables refer to these sites, so the files change by no byte."""
    shipped = {
        name: sha256((FOLDER / f"{name}.json").read_bytes()).hexdigest()[:16]
        for name in sorted(BUILT_IN)
    }
    assert shipped == {"roundabout": "4a9ab46d1475b148", "tjunction": "04ad7bbaea6fac5b"}
    site = files.load_site("tjunction")
    xmin, ymin, xmax, ymax = site.area
    corners = geometry.transform(site.map_SE3_site, np.array([[xmin, ymin, 0], [xmax, ymax, 0]]))
    x, y_carla = corners[:, 0], -corners[:, 1]
    assert sorted(x) == [84, 124]
    assert sorted(y_carla) == [156, 236]
    a, b = 12.5, 13.6
    x, y, _ = geometry.transform(site.map_SE3_site, np.array([a, b, 0.0]))
    assert (a, b) == pytest.approx((196 + y, 104 - x))  # a = 196 - y_carla, b = 104 - x_carla
    assert np.array_equal(files.load_site("roundabout").map_SE3_site, np.eye(4))
    site = files.load_site("tjunction")
    published = [
        *(
            (40.9, 8.1, 155),
            (-7.7, 21.9, 295),
            (-45.6, 10.1, 15),
            (8, 5.6, 52),
            (-8.3, 18.5, 208),
            (-5.5, -27.5, 64),
        )
    ]
    assert np.allclose(np.array([s.position[:2] for s in site.sensors]), [p[:2] for p in published])
    headings = np.rad2deg([np.arctan2(s.pose[1, 2], s.pose[0, 2]) for s in site.sensors])
    assert np.allclose((headings - [p[2] for p in published] + 180) % 360, 180)
    site = files.load_site("roundabout")
    for i, sensor in enumerate(site.sensors):
        outwards = sensor.pose[:2, 2] @ (sensor.position[:2] / np.linalg.norm(sensor.position[:2]))
        assert outwards < -0.95 if i % 2 else outwards > 0.95
    assert np.allclose(
        [s.position[:2] for s in site.sensors[::2]], [(29, -2), (-28, 1), (0, 30), (-1.5, -30)]
    )


def test_network_runs_in_sumo_and_cars_cross_the_junction(site, tmp_path, union):
    libsumo = pytest.importorskip("libsumo")
    net, routes = tmp_path / "net.xml", tmp_path / "trips.rou.xml"
    net.write_text(site.network)
    ends = [
        *(
            ("left_junction", "junction_right"),
            ("side_junction", "junction_left"),
            ("right_junction", "junction_side"),
        )
    ]
    if site.name == "roundabout":
        legs = ("east", "north", "west", "south")
        ends = [(f"entry_{a}_on", f"exit_{b}_on") for a in legs for b in legs if a != b]
    trips = [f'<trip id="{i}" depart="{i}" from="{a}" to="{b}"/>' for i, (a, b) in enumerate(ends)]
    walks = [f'<person id="p" depart="0"><walk from="{ends[0][0]}" to="{ends[0][1]}"/></person>']
    routes.write_text("<routes>" + "".join([walks[0], *trips]) + "</routes>")
    libsumo.start(
        [
            "sumo",
            "-n",
            str(net),
            "-r",
            str(routes),
            "--no-step-log",
            "--end",
            "400",
            "--no-warnings",
        ]
    )
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
    inside = [
        p for p in seen if site.area[0] < p[0] < site.area[2] and site.area[1] < p[1] < site.area[3]
    ]
    assert np.mean([road.contains(shapely.Point(p)) for p in inside]) > 0.99


def test_streets_and_ring_lie_where_the_paper_has_them(union):
    tjunction = files.load_site("tjunction")
    road, walk = union(tjunction.lanes), union(tjunction.footways)
    assert all(
        road.contains(shapely.Point(p))
        for p in [(-30, 9.7), (30, 17.5), (-0.8, 13.6), (-4.7, -15), (3.1, -15)]
    )
    assert all(
        walk.contains(shapely.Point(p)) for p in [(-30, 5.4), (30, 21.8), (-9.0, -15), (7.4, -15)]
    )
    across = shapely.LineString([(-30, 0), (-30, 30)])
    assert across.intersection(road).length == pytest.approx(8.6, abs=0.01)
    assert across.intersection(walk).length == pytest.approx(8.0, abs=0.01)
    road = union(files.load_site("roundabout").lanes)
    ring = [
        (r * np.cos(t), r * np.sin(t))
        for r in (17.6, 20.95, 24.3)
        for t in np.linspace(0, 2 * np.pi, 73)
    ]
    assert all(road.distance(shapely.Point(p)) < 0.05 for p in ring)
    assert not road.intersects(shapely.Point(0, 0).buffer(17.2))
