import gzip
import os
import warnings
from pathlib import Path

import libsumo
import numpy as np
import pytest
import shapely

from toolkit.geometry import transform
from toolkit.sites import osm
from toolkit.sites.files import load_site, save_site
from toolkit.sites.maps import import_opendrive, import_osm
from toolkit.sites.site import Site

CENTRE = (13.4, 52.505)
SHARED = Path(os.environ.get("COVIEW_SHARED", Path(__file__).parents[4] / "shared"))
carla = pytest.mark.skipif(not (SHARED / "carla").is_dir(), reason="the CARLA maps are not here")


class Draft:
    """An OSM file in the making, its nodes given in metres around CENTRE."""

    def __init__(self) -> None:
        self.text: list[str] = []
        self.nodes: dict[tuple[float, float], int] = {}
        self.count = 1000

    def node(self, xy, **tags) -> int:
        if xy not in self.nodes:
            self.count += 1
            self.nodes[xy] = self.count
            ((longitude, latitude),) = osm.longitude_latitude(np.array([xy], float), CENTRE)
            self.text.append(f'<node id="{self.count}" lat="{latitude:.7f}" lon="{longitude:.7f}">{_tags(tags)}</node>')
        return self.nodes[xy]

    def way(self, *corners, missing=(), **tags) -> int:
        references = [*missing, *(self.node(xy) for xy in corners)]
        self.count += 1
        inside = "".join(f'<nd ref="{i}"/>' for i in references)
        self.text.append(f'<way id="{self.count}" version="3">{inside}{_tags(tags)}</way>')
        return self.count

    def relation(self, members, **tags) -> None:
        inside = "".join(f'<member type="way" ref="{i}" role="{role}"/>' for i, role in members)
        self.count += 1
        self.text.append(f'<relation id="{self.count}">{inside}{_tags(tags)}</relation>')

    def __str__(self) -> str:
        return '<?xml version="1.0" encoding="UTF-8"?>\n<osm version="0.6">\n' + "\n".join(self.text) + "\n</osm>\n"


def _tags(tags) -> str:
    written = {key.replace("__", ":").rstrip("_"): value for key, value in tags.items()}
    return "".join(f'<tag k="{key}" v="{value}"/>' for key, value in written.items())


def crossroads() -> Draft:
    """A main road and a side street that cross at (0, 0), 300 m long each."""
    draft = Draft()
    draft.node((0, 0), highway="traffic_signals")
    draft.way((-300, 0), (0, 0), (300, 0), highway="secondary", lanes="2", maxspeed="50", name="Hauptstraße &amp; Co")
    draft.way((0, -300), (0, 0), (10, 300), highway="residential")
    return draft


def box(xmin, ymin, xmax, ymax):
    return (xmin, ymin), (xmax, ymin), (xmax, ymax), (xmin, ymax), (xmin, ymin)


def put(draft, tmp_path, name="town.osm") -> Path:
    path = tmp_path / name
    path.write_text(str(draft), encoding="utf-8")
    return path


def imported(draft, tmp_path, **more) -> Site:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        site = import_osm(put(draft, tmp_path), centre=CENTRE, size=(80, 60), **more)
    check(site, tmp_path)
    return site


def union(polygons):
    return shapely.union_all([shapely.Polygon(p) for p in polygons])


def on_lanes(site, x, y) -> bool:
    spot = shapely.Point(x, y)
    return bool(union(p for p in site.lanes if shapely.Polygon(p).distance(spot) < 1).buffer(0.01).contains(spot))


def check(site: Site, tmp_path) -> None:
    """What every imported site promises: clear lanes, usable mounts and sensors, a round trip, traffic that moves."""
    lanes = union(site.lanes)
    for solid in site.solids:
        assert shapely.Polygon(solid.footprint).intersection(lanes).area < 1e-3, solid
    assert union(site.footways).intersection(lanes).area < 0.1
    assert len(site.mounts) >= 6
    assert 4 <= len(site.sensors) <= 6
    for sensor in site.sensors:
        spot, z = shapely.Point(sensor.position[:2]), sensor.position[2]
        inside = [s for s in site.solids if shapely.Polygon(s.footprint).contains(spot) and s.base < z < s.top]
        assert not inside, sensor.name
    save_site(site, tmp_path / "saved.json")
    assert load_site(tmp_path / "saved.json") == site
    assert drives(site, tmp_path) > 1.0


def drives(site: Site, tmp_path) -> float:
    """How far (m) a car gets in 5 s that SUMO lets onto an edge in the area."""
    (tmp_path / "net.xml").write_text(site.network)
    libsumo.start(["sumo", "-n", str(tmp_path / "net.xml"), "--no-warnings", "--no-step-log", "--duration-log.disable"])
    try:
        lanes = [lane for lane in libsumo.lane.getIDList() if lane[0] != ":"]
        allowed = [lane for lane in lanes if "passenger" not in libsumo.lane.getDisallowed(lane)]
        edge = libsumo.lane.getEdgeID(max(allowed, key=libsumo.lane.getLength))
        libsumo.route.add("drive", [edge])
        libsumo.vehicle.add("car", "drive")
        for _ in range(5):
            libsumo.simulationStep()
        return libsumo.vehicle.getDistance("car")
    finally:
        libsumo.close()


def of_kind(site, kind):
    return [solid for solid in site.solids if solid.kind == kind]


def top(site, x, y) -> list[float]:
    spot = shapely.Point(x, y)
    return sorted(round(s.top, 3) for s in of_kind(site, "building") if shapely.Polygon(s.footprint).contains(spot))


# OpenDRIVE


@carla
def test_tjunction_of_the_paper(tmp_path):
    site = import_opendrive(
        SHARED / "carla" / "Town01.xodr", centre=(104, -196), size=(80, 40), heading=np.pi / 2, name="t"
    )
    check(site, tmp_path)
    # The through road at b = 13.6 ± 4.3, the side road at a = -0.8 ± 4 going down, in the published picture's axes.
    for a in np.arange(-39, 40, 3.0):
        assert on_lanes(site, a, 13.6 - 4.0)
        assert on_lanes(site, a, 13.6 + 4.0)
        assert not on_lanes(site, a, 13.6 + 4.6)
        assert abs(a + 0.8) < 11 or not on_lanes(site, a, 13.6 - 4.6)
    for b in np.arange(-19, 5, 3.0):
        assert on_lanes(site, -0.8 - 3.8, b)
        assert on_lanes(site, -0.8 + 3.8, b)
        assert not on_lanes(site, -0.8 + 4.6, b)
    walk = union(site.footways)
    assert walk.contains(shapely.Point(30, 13.6 + 4.4 + 3.5))
    assert not walk.contains(shapely.Point(30, 13.6 + 4.4 + 4.5))
    np.testing.assert_allclose(transform(site.map_SE3_site, np.array([[0.0, 13.6, 0.0]]))[0], [90.4, -196, 0], atol=0.1)
    assert "+proj=tmerc" in site.geo_reference
    assert len(site.network) < 100_000


@carla
def test_roundabout_of_the_paper(tmp_path):
    site = import_opendrive(SHARED / "carla" / "Town03.xodr", centre=(0, 0), size=(96, 96))
    check(site, tmp_path)
    angles = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    ring = [on_lanes(site, 20.95 * np.cos(a), 20.95 * np.sin(a)) for a in angles]
    assert np.mean(ring) > 0.98
    assert not any(on_lanes(site, 12 * np.cos(a), 12 * np.sin(a)) for a in angles)
    for x, y in ((44, 6), (44, -6), (-44, 1), (3, 44), (-4, 44), (5, -45), (-7, -45)):
        assert on_lanes(site, x, y), (x, y)


@carla
def test_turned_site_is_the_same_place(tmp_path):
    town = SHARED / "carla" / "Town01.xodr"
    straight = import_opendrive(town, centre=(104, -196), size=(60, 60))
    turned = import_opendrive(town, centre=(104, -196), size=(60, 60), heading=0.6)
    spot = np.array([[-13.6, 5.0, 0.0]])
    assert on_lanes(straight, *spot[0, :2])
    moved = transform(np.linalg.inv(turned.map_SE3_site), transform(straight.map_SE3_site, spot))
    assert on_lanes(turned, *moved[0, :2])


@carla
def test_opendrive_without_a_road_there():
    with pytest.raises(ValueError, match="no road within the area about 200 -260"):
        import_opendrive(SHARED / "carla" / "Town01.xodr", centre=(200, -260), size=(20, 20))
    with pytest.raises(ValueError, match=r"centre 9000 0 lies outside the map, whose roads start at x"):
        import_opendrive(SHARED / "carla" / "Town01.xodr", centre=(9000, 0), size=(20, 20))


@pytest.mark.parametrize("reader", [import_opendrive, import_osm])
@pytest.mark.parametrize("content", [b"", b"hello", b"\x00\x01\x02", b"<html></html>", b"<osm", b"{}", b"<osm></osm>"])
def test_no_map(tmp_path, reader, content):
    (tmp_path / "bad.osm").write_bytes(content)
    with pytest.raises(ValueError, match=r"bad\.osm: .*: (give|download|export|it )") as raised:
        reader(tmp_path / "bad.osm", centre=(0, 0), size=(50, 50))
    assert "\n" not in str(raised.value)


def test_missing_file_and_bad_place(tmp_path):
    with pytest.raises(FileNotFoundError, match="no map"):
        import_osm(tmp_path / "none.osm", centre=CENTRE, size=(50, 50))
    path = put(crossroads(), tmp_path)
    with pytest.raises(ValueError, match="size must be two lengths above 0"):
        import_osm(path, centre=CENTRE, size=(50, -1))
    with pytest.raises(ValueError, match="centre must be two finite numbers"):
        import_osm(path, centre=(np.nan, 0.0), size=(50, 50))


# OpenStreetMap


def test_crossroads(tmp_path):
    site = imported(crossroads(), tmp_path)
    for spot in ((0, 0), (35, 2), (-35, -2), (0, 28), (0, -28)):
        assert on_lanes(site, *spot)
    assert not on_lanes(site, 25, 25)
    assert not on_lanes(site, 35, 9)
    assert union(site.footways).intersection(shapely.box(*site.area)).area > 100
    assert 'type="traffic_light"' in site.network
    assert 'function="crossing"' in site.network
    # traffic can come from at least 60 m beyond the area
    reach = [np.abs(lane).max(axis=0) for lane in (np.array(p) for p in site.lanes)]
    assert np.max(reach, axis=0)[0] >= 60
    assert "300" not in site.network.partition("convBoundary")[2][:40]


def test_place_on_earth(tmp_path):
    """The site's geo-reference and pose lead back to longitude and latitude."""
    site = imported(crossroads(), tmp_path, heading=0.3)
    assert site.geo_reference.startswith("+proj=tmerc +lat_0=52.505 +lon_0=13.4 ")
    east = transform(np.linalg.inv(site.map_SE3_site), np.array([[38.0, 2.0, 0.0]]))[0]
    assert on_lanes(site, *east[:2])


def test_projection_is_transverse_mercator():
    # Independent figures: one degree of longitude and latitude at 52.505° on WGS84 are 67,922.6 m and 111,268.5 m.
    metres = osm.project(np.array([[13.401, 52.505], [13.4, 52.506], CENTRE]), CENTRE)
    np.testing.assert_allclose(metres, [[67.9, 0.0], [0.0, 111.27], [0, 0]], atol=0.05)
    points = np.random.default_rng(0).uniform(-2000, 2000, (50, 2))
    np.testing.assert_allclose(osm.project(osm.longitude_latitude(points, CENTRE), CENTRE), points, atol=1e-6)


def test_buildings_and_their_heights(tmp_path):
    draft = crossroads()
    draft.way(*box(15, 15, 25, 25), building="yes", height="12 m")
    draft.way(*box(-25, 15, -15, 25), building="house", building__levels="3")
    draft.way(*box(-25, -25, -15, -15), building="yes")
    draft.way(*box(28, 15, 34, 25), building="yes", height="40'")
    draft.way(*box(15, -25, 25, -15), building="yes", height="3;4", min_height="1")
    draft.way(*box(28, -25, 34, -15), building="yes", height="tall", building__levels="x")
    draft.way(*box(-38, 15, -30, 25), building="no")
    site = imported(draft, tmp_path)
    assert top(site, 20, 20) == [12.0]
    assert top(site, -20, 20) == [9.0]
    assert top(site, -20, -20) == [6.0]
    assert top(site, 31, 20) == [12.192]
    assert top(site, 20, -20) == [4.0]
    assert top(site, 31, -20) == [6.0]
    assert top(site, -34, 20) == []


def test_multipolygons_holes_and_missing_members(tmp_path):
    draft = crossroads()
    half = draft.way((15, 15), (35, 15), (35, 28))
    rest = draft.way((35, 28), (15, 28), (15, 15))
    court = draft.way(*box(22, 19, 28, 24))
    draft.relation(
        [(half, "outer"), (rest, "outer"), (court, "inner")], type="multipolygon", building="yes", height="10"
    )
    torn = draft.way((-15, 15), (-35, 15), (-35, 28))
    draft.relation([(torn, "outer"), (999999, "outer")], type="multipolygon", building="yes")
    site = imported(draft, tmp_path)
    assert top(site, 18, 17) == [10.0]
    assert top(site, 25, 21.5) == []
    assert top(site, -25, 18) == []


def test_building_parts_replace_the_outline_where_they_are(tmp_path):
    draft = crossroads()
    draft.way(*box(15, 15, 35, 25), building="yes", height="8")
    draft.way(*box(15, 15, 25, 25), building__part="yes", height="20")
    site = imported(draft, tmp_path)
    assert top(site, 20, 20) == [20.0]
    assert top(site, 30, 20) == [8.0]


def test_buildings_over_the_road_are_cut_back(tmp_path):
    draft = crossroads()
    draft.way(*box(20, -12, 30, 30), building="yes")
    path = put(draft, tmp_path)
    with pytest.warns(UserWarning, match=r"town\.osm: 1 buildings reached over a road"):
        site = import_osm(path, centre=CENTRE, size=(80, 60))
    check(site, tmp_path)
    assert top(site, 25, 20) == [6.0]
    assert top(site, 25, 0) == []


def test_street_furniture(tmp_path):
    draft = crossroads()
    for x in range(-40, 41, 10):
        draft.node((x, 12.5), highway="street_lamp")
    draft.node((20, 20), natural="tree", height="9", diameter_crown="5")
    draft.node((20, 0.5), natural="tree")
    draft.node((25, 14), amenity="bench")
    draft.way((12, -14), (38, -14), barrier="hedge", height="1.2")
    draft.way((-12, -16), (-38, -16), barrier="wall")
    draft.way((-20, -14), (-20, 14), barrier="fence")
    draft.way((-12, 20), (-38, 20), natural="tree_row")
    site = imported(draft, tmp_path)
    assert len([mount for mount in site.mounts if mount.name.startswith("lamp")]) >= 7
    assert all(not mount.name.startswith("pole") for mount in site.mounts)
    assert {"tree", "trunk", "hedge", "wall", "fence", "bench", "post", "kerb"} <= {s.kind for s in site.solids}
    assert max(s.top for s in of_kind(site, "tree")) == 9.0
    assert max(s.top for s in of_kind(site, "hedge")) == 1.2


def test_what_real_extracts_contain(tmp_path):
    """Clipped ways, unknown values, deleted things, text where numbers belong."""
    draft = crossroads()
    draft.way((60, 0), (60, 50), missing=("77", "78"), highway="residential", lanes="2;3", maxspeed="DE:urban")
    draft.way((40, 30), missing=("79",), highway="residential")
    draft.way((-40, -30), (-40, 40), highway="proposed")
    draft.way((-45, -30), (-45, 40), highway="yes", oneway="maybe")
    draft.way((-30, 0), (-30, 60), highway="service", service="driveway")
    draft.way((5, 5), (6, 6), (5, 6), (6, 5), (5, 5), building="yes", height="-3")
    draft.way((30, 30), (30, 30), building="yes")
    draft.node((3, 30), natural="tree", height="ca. 5")
    draft.text.append('<node id="5"/><node id="6" lat="north" lon="1"/><way id="7"/><relation id="8"/>')
    draft.text.append('<way id="9" action="delete"><nd ref="5"/></way><note>made by hand</note>')
    imported(draft, tmp_path)


def test_one_way_and_its_reverse(tmp_path):
    for value, sign in (("yes", 1), ("-1", -1)):
        draft = Draft()
        draft.way((-300, 0), (300, 0), highway="residential", oneway=value, sidewalk="no")
        site = imported(draft, tmp_path)
        (tmp_path / "net.xml").write_text(site.network)
        shapes = [line for line in site.network.splitlines() if "<lane" in line and 'index="0"' in line]
        assert len(shapes) == 1
        first, *_, last = shapes[0].partition('shape="')[2].partition('"')[0].split()
        assert sign * (float(last.split(",")[0]) - float(first.split(",")[0])) > 200


def test_roundabout_and_cycleway(tmp_path):
    draft = Draft()
    ring = [(round(18 * np.cos(a), 2), round(18 * np.sin(a), 2)) for a in np.linspace(0, 2 * np.pi, 17)[:-1]]
    draft.way(*ring, ring[0], highway="tertiary", junction="roundabout")
    for k in (0, 4, 8, 12):
        far = tuple(float(c) * 15 for c in ring[k])
        draft.way(ring[k], far, highway="tertiary")
    draft.way((-200, 30), (200, 30), highway="cycleway")
    site = imported(draft, tmp_path)
    assert not on_lanes(site, 0, 0)
    assert np.mean([on_lanes(site, x, y) for x, y in ring]) == 1
    assert on_lanes(site, 39, 0)


def test_bridges_and_tunnels_leave_the_ground_clear(tmp_path):
    draft = crossroads()
    draft.way((-200, 20), (200, 20), highway="primary", bridge="yes", layer="1")
    draft.way((-200, -20), (200, -20), highway="primary", tunnel="yes", layer="-1")
    path = put(draft, tmp_path)
    with pytest.warns(UserWarning, match="2 tunnels or bridges over a road were left out"):
        site = import_osm(path, centre=CENTRE, size=(80, 60))
    assert not on_lanes(site, 25, 20)
    assert not on_lanes(site, 25, -20)


def test_bridge_that_carries_the_junction_stays(tmp_path):
    draft = Draft()
    draft.way((-300, 0), (-30, 0), highway="primary")
    draft.way((-30, 0), (30, 0), highway="primary", bridge="yes", layer="1")
    draft.way((30, 0), (300, 0), highway="primary")
    assert on_lanes(imported(draft, tmp_path), 0, 1)


def test_paths_and_squares(tmp_path):
    draft = crossroads()
    draft.way(*box(12, 12, 38, 28), highway="pedestrian", area="yes")
    draft.way((-12, 20), (-60, 20), highway="footway", width="3")
    site = imported(draft, tmp_path)
    walk = union(site.footways)
    assert walk.contains(shapely.Point(25, 20))
    assert walk.contains(shapely.Point(-30, 21.3))
    assert not walk.contains(shapely.Point(-30, 22))


def test_streets_that_cross_without_a_junction_keep_their_footways_off_each_other(tmp_path):
    draft = crossroads()
    draft.way((-100, -40), (100, 44), highway="tertiary")
    draft.way((20, 30), (20, -30), (21, 30), highway="residential")
    site = imported(draft, tmp_path)
    assert on_lanes(site, 36, 2 + 36 * 0.42 - 0.5)


def test_left_hand_traffic(tmp_path):
    site = imported(crossroads(), tmp_path, lefthand=True)
    assert 'lefthand="true"' in site.network
    assert on_lanes(site, 30, 2)


def test_gzip_and_wrong_formats(tmp_path):
    path = tmp_path / "town.osm.gz"
    path.write_bytes(gzip.compress(str(crossroads()).encode()))
    assert import_osm(path, centre=CENTRE, size=(60, 60)).name == "town"
    whole = path.read_bytes()
    path.write_bytes(whole[:150] + bytes(60) + whole[210:])
    with pytest.raises(ValueError, match="damaged gzip"):
        import_osm(path, centre=CENTRE, size=(60, 60))
    path.write_bytes(whole[:200])
    with pytest.raises(ValueError, match="damaged gzip"):
        import_osm(path, centre=CENTRE, size=(60, 60))
    (tmp_path / "town.pbf").write_bytes(b"1")
    with pytest.raises(ValueError, match=r"only \.osm, \.osm\.xml and \.osm\.gz are read"):
        import_osm(tmp_path / "town.pbf", centre=CENTRE, size=(60, 60))


def test_no_bicycle_on_a_motorway(tmp_path):
    draft = crossroads()
    draft.way((-300, 25), (300, 25), highway="motorway", oneway="yes", lanes="3")
    lanes = [lane for lane in imported(draft, tmp_path).network.split("<lane ")[1:] if 'speed="36.1' in lane]
    assert len(lanes) == 3
    assert not any("bicycle" in lane.partition('allow="')[2].partition('"')[0] for lane in lanes)
    assert all("passenger" in lane.partition('allow="')[2].partition('"')[0] for lane in lanes)


def test_cameras_near_a_small_area_look_down_into_it(tmp_path):
    for sensor in import_osm(put(crossroads(), tmp_path), centre=CENTRE, size=(5, 5)).sensors:
        away, below = np.hypot(*sensor.position[:2]), np.arctan2(-sensor.pose[2, 2], np.hypot(*sensor.pose[:2, 2]))
        assert abs(np.arctan2(sensor.position[2], away) - below) < np.arctan(0.75)


def test_entities_are_refused(tmp_path):
    bomb = '<?xml version="1.0"?><!DOCTYPE osm [<!ENTITY a "aaaa">]><osm><node id="1" lat="0" lon="0"/></osm>'
    with pytest.raises(ValueError, match="not OpenStreetMap XML"):
        import_osm(put(bomb, tmp_path), centre=(0, 0), size=(60, 60))


def test_truncated_map(tmp_path):
    text = str(crossroads())
    path = put(text[: len(text) // 2], tmp_path)
    with pytest.raises(ValueError, match="damaged XML"):
        import_osm(path, centre=CENTRE, size=(60, 60))


def test_centre_outside_and_off_the_road(tmp_path):
    path = put(crossroads(), tmp_path)
    with pytest.raises(ValueError, match=r"centre 52.505 13.4 lies outside the map, which spans longitude 13\.39"):
        import_osm(path, centre=CENTRE[::-1], size=(60, 60))
    (aside,) = osm.longitude_latitude(np.array([[120.0, 120.0]]), CENTRE)
    with pytest.raises(ValueError, match="no road within the area"):
        import_osm(path, centre=tuple(aside), size=(20, 20))
    draft = Draft()
    draft.way(*box(0, 0, 20, 20), building="yes")
    draft.way((-30, -30), (30, 30), highway="footway")
    with pytest.raises(ValueError, match="no road within the area"):
        import_osm(put(draft, tmp_path), centre=CENTRE, size=(20, 20))
