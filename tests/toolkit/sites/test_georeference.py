import json
import re
from dataclasses import replace

import numpy as np
import pytest
import shapely
from shapely.geometry import shape

from toolkit.geometry import look, pose
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites import files, georeference
from toolkit.sites.site import Site

CENTRE = (13.4, 52.505)
AREA = np.array([-40.0, -30.0, 40.0, 30.0])
TURNED = Site(
    "berlin",
    AREA,
    map_SE3_site=pose(3.0, 4.0, 34.0, yaw=np.pi / 2),
    geo_reference=georeference.projection(*CENTRE),
)
UTM = "+proj=utm +zone=33 +datum=WGS84 +units=m +no_defs"


def test_metres_are_those_of_wgs84():
    # Independent figures: one degree of longitude and latitude at 52.505° on WGS84 are 67,922.6 m
    # and 111,268.5 m.
    metres = georeference.project(np.array([[13.401, 52.505], [13.4, 52.506], CENTRE]), CENTRE)
    np.testing.assert_allclose(metres, [[67.9, 0.0], [0.0, 111.27], [0, 0]], atol=0.05)
    points = np.random.default_rng(0).uniform(-2000, 2000, (50, 2))
    np.testing.assert_allclose(
        georeference.project(georeference.inverse_project(points, CENTRE), CENTRE),
        points,
        atol=1e-6,
    )


def test_projections_are_those_of_proj_within_a_millimetre():
    # Within 2 km to 1 mm, also for southern, western and far northern places.
    pyproj = pytest.importorskip("pyproj")
    points = np.random.default_rng(1).uniform(-1400, 1400, (50, 2))
    for centre in (CENTRE, (-70.25, -33.5), (179.999, 0.0), (25.7, 69.5)):
        there = pyproj.Transformer.from_crs(
            georeference.projection(*centre), "EPSG:4326", always_xy=True
        )
        degrees = np.stack(there.transform(*points.T), axis=1)
        assert (
            np.abs((georeference.inverse_project(points, centre) - degrees + 180) % 360 - 180).max()
            < 2e-8
        ), centre


def test_sites_in_utm_lie_on_earth():
    site = Site("utm", AREA, map_SE3_site=pose(500000.0, 4982950.400), geo_reference=UTM)
    found = georeference.longitude_latitude(site, np.array([[0.0, 0.0], [10.0, 20.0]]))
    assert found is not None
    # Independent figures: zone 33 is about 15°; the meridian from the equator to 45° is
    # 4,984,944.378 m, times 0.9996
    assert found[0] == pytest.approx([15.0, 45.0], abs=1e-8)
    assert georeference.site_metres(site, found) == pytest.approx(
        np.array([[0.0, 0.0], [10.0, 20.0]]), abs=1e-5
    )


def test_sites_of_carla_lie_where_equator_and_greenwich_meet():
    # Its map's zero is where equator and Greenwich meet; 1 degree of longitude is 111,319.5 m
    # there.
    carla = (
        "+proj=tmerc +lat_0=0 +lon_0=0 +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m "
        "+geoidgrids=egm96_15.gtx +vunits=m"
    )
    site = Site("town01", AREA, map_SE3_site=pose(104.0, -196.0), geo_reference=carla)
    assert georeference.longitude_latitude(site, np.zeros((1, 2))) == pytest.approx(
        np.array([[104 / 111319.49, -196 / 110574.28]]), abs=1e-8
    )


def test_turned_sites_lie_on_earth():
    xy = np.array([[0.0, 0.0], [100.0, 0.0], [-4.0, 3.0]])
    placed = georeference.longitude_latitude(TURNED, xy)
    assert placed is not None
    # x of the site points to the map's north, y to its west; the site's zero is 3 m east and 4 m
    # north of CENTRE
    assert georeference.project(placed, CENTRE) == pytest.approx(
        np.array([[3.0, 4.0], [3.0, 104.0], [0.0, 0.0]]), abs=1e-6
    )
    assert placed[2] == pytest.approx(CENTRE, abs=1e-9)
    assert georeference.site_metres(TURNED, placed) == pytest.approx(xy, abs=1e-6)
    assert georeference.longitude_latitude(TURNED, np.zeros((0, 2))) == pytest.approx(
        np.zeros((0, 2))
    )


def test_sites_without_a_reference_lie_nowhere():
    assert georeference.longitude_latitude(files.load_site("tjunction"), np.zeros((2, 2))) is None
    with pytest.raises(
        ValueError, match=r"site 'tjunction' does not say where on earth it is \(geo_reference\)"
    ):
        georeference.site_metres(files.load_site("tjunction"), np.zeros((2, 2)))


def test_places_that_a_projection_does_not_reach_are_refused():
    pytest.importorskip("pyproj")
    site = replace(TURNED, geo_reference="+proj=merc +datum=WGS84")
    with pytest.raises(ValueError, match=r"does not reach \[0.0, 95.0\]"):
        georeference.site_metres(site, np.array([[0.0, 0.0], [0.0, 95.0]]))


def test_bearings_lie_from_0_to_360():
    assert georeference.bearing_deg(TURNED, float(np.nextafter(0.0, 1.0))) == 0.0
    assert min(georeference.bearing_deg(TURNED, h) for h in np.linspace(-7, 7, 500).tolist()) >= 0


def test_collections_are_json_in_utf_8_without_nan():
    assert json.loads(georeference.feature_collection([], name="none", note="Straße")) == {
        "type": "FeatureCollection",
        "name": "none",
        "note": "Straße",
        "features": [],
    }
    with pytest.raises(ValueError, match="JSON compliant"):
        georeference.feature_collection([], price=float("nan"))


@pytest.mark.parametrize(
    "reference",
    [
        *("+lat_0=4.9e+1 +lon_0=8.0", "nonsense", "", "EPSG:4326", "+proj=longlat +datum=WGS84"),
        "+proj=tmerc +lat_0=x +lon_0=y ",
    ],
)
def test_what_is_no_projection_is_said_so(reference):
    pytest.importorskip("pyproj")
    site = replace(TURNED, geo_reference=reference)
    with pytest.raises(
        ValueError, match=f"got {re.escape(repr(reference))}: correct it in the site file"
    ):
        georeference.longitude_latitude(site, np.zeros((1, 2)))
    with pytest.raises(ValueError, match="names no projection that PROJ knows"):
        georeference.site_metres(site, np.zeros((1, 2)))


def test_without_pyproj_only_foreign_maps_are_refused(without_packages):
    without_packages("pyproj", "pyproj.exceptions")
    assert georeference.longitude_latitude(TURNED, np.zeros((1, 2))) is not None
    with pytest.raises(ImportError, match=r"pip install 'coview\[report\]'"):
        georeference.longitude_latitude(
            replace(TURNED, geo_reference=UTM.replace("33", "31")), np.zeros((1, 2))
        )


@pytest.mark.parametrize(
    ("heading_deg", "map_yaw_deg", "bearing"),
    [
        (0, 0, 90),
        (90, 0, 0),
        (180, 0, 270),
        (-90, 0, 180),
        (45, 0, 45),
        (0, 90, 0),
        (90, 90, 270),
        (450, 0, 0),
    ],
)
def test_bearings_are_clockwise_from_the_maps_north(heading_deg, map_yaw_deg, bearing):
    site = replace(TURNED, map_SE3_site=pose(104.0, -196.0, yaw=np.deg2rad(map_yaw_deg)))
    assert georeference.bearing_deg(site, float(np.deg2rad(heading_deg))) == pytest.approx(
        bearing, abs=1e-9
    )


@pytest.fixture
def site(small_site):
    """A small site with all that sites have, whose x points to the map's north."""
    turned = pose(3.0, 4.0, yaw=np.pi / 2)
    level = Sensor("level", DepthCamera(), look((0.0, 0.0, 5.0), 0.0, 0.0))
    made = small_site()
    return replace(
        made,
        map_SE3_site=turned,
        geo_reference=georeference.projection(*CENTRE),
        sensors=(*made.sensors, level),
    )


def on_map(geometry):
    return georeference.project(shapely.get_coordinates(shape(geometry)), CENTRE)


def test_every_layer_is_there_with_its_properties(site):
    features = json.loads(georeference.site_geojson(site))["features"]
    layers = [each["properties"]["layer"] for each in features]
    assert {layer: layers.count(layer) for layer in layers} == {
        "area": 1,
        "lane": 2,
        "footway": 1,
        "solid": 2,
        "parking": 1,
        "mount": 2,
        "sensor": 4,
    }
    by_name = {each["properties"]["name"]: each["properties"] for each in features}
    assert by_name["small"] == {"layer": "area", "name": "small", "height": 3.5}
    assert by_name["building000"] == {
        "layer": "solid",
        "name": "building000",
        "kind": "building",
        "base": -0.3,
        "top": 6.25,
        "height": 6.55,
        "origin": "mapped",
    }
    assert by_name["pond001"]["kind"] == "pond"
    assert by_name["b"] == {
        "layer": "mount",
        "name": "b",
        "min_height": 2.0,
        "max_height": 9.0,
        "price": 0.5,
        "capacity_kbit": 800.0,
        "origin": "drawn",
    }


def test_bearings_and_heights_are_those_of_the_sensors(site):
    features = json.loads(georeference.site_geojson(site))["features"]
    by_name = {each["properties"]["name"]: each["properties"] for each in features}
    assert by_name["bay000"]["bearing_deg"] == pytest.approx(
        360 - 28.6
    )  # 0.5 rad counter-clockwise from north
    assert by_name["d0"]["bearing_deg"] == pytest.approx(360 - 17.2)
    assert by_name["d0"]["tilt_deg"] == 5.7
    assert by_name["d0"]["height"] == pytest.approx(5.2, abs=0.06)  # above ground that is uneven
    assert (by_name["level"]["bearing_deg"], by_name["level"]["tilt_deg"]) == (0.0, 0.0)
    assert (by_name["l0"]["model"], by_name["d0"]["model"]) == ("spinning-lidar", "depth-camera")


def test_rings_boxes_and_members_as_rfc_7946_has_them(site):
    collection = json.loads(georeference.site_geojson(site))
    assert collection["type"] == "FeatureCollection"
    assert collection["name"] == "small"
    assert not {"crs", "coview_site"} & set(collection)
    west, south, east, north = collection["bbox"]
    assert 13.39 < west < east < 13.41
    assert 52.50 < south < north < 52.51
    every = shapely.union_all([shape(each["geometry"]) for each in collection["features"]])
    assert every.bounds == tuple(collection["bbox"])
    for each in collection["features"]:
        assert each["geometry"]["type"] in ("Point", "Polygon")
        if each["geometry"]["type"] == "Polygon":
            (ring,) = each["geometry"]["coordinates"]
            assert ring[0] == ring[-1]
            assert shapely.LinearRing(ring).is_ccw


def test_features_lie_where_the_site_has_them(site):
    features = {
        each["properties"]["name"]: each
        for each in json.loads(georeference.site_geojson(site))["features"]
    }
    # site (1, 3) is 3 m to the west and 1 m to the north of (3, 4)
    assert on_map(features["b"]["geometry"]) == pytest.approx(np.array([[0.0, 5.0]]), abs=2e-3)
    area = on_map(features["small"]["geometry"])
    assert [area.min(axis=0), area.max(axis=0)] == pytest.approx(
        np.array([[-2.0, -6.0], [8.0, 14.0]]), abs=2e-3
    )


def test_a_feature_without_a_reference_is_in_metres_and_a_file_is_refused(site):
    written = georeference.feature(
        replace(site, geo_reference=None), shapely.Point(1.23456, -0.0001, 7.0)
    )
    assert written["geometry"] == {"type": "Point", "coordinates": (1.235, 0.0)}
    with pytest.raises(
        ValueError, match=r"site 'tjunction' does not say where on earth it is .* in metres"
    ):
        georeference.site_geojson(files.load_site("tjunction"))


def test_polygons_are_turned_in_the_same_text(site, tmp_path):
    outer, hole = [(0, 0), (0, 9), (9, 9), (9, 0)], [(2, 2), (4, 2), (4, 4), (2, 4)]
    both = shapely.MultiPolygon([shapely.Polygon(outer, [hole]), shapely.box(20, 0, 30, 9)])
    for place in (site, replace(site, geo_reference=None)):
        written = georeference.feature(place, both, layer="seen")
        assert written["geometry"]["type"] == "MultiPolygon"
        (first, inside), (second,) = written["geometry"]["coordinates"]
        assert shapely.LinearRing(first).is_ccw
        assert not shapely.LinearRing(inside).is_ccw
        assert shapely.LinearRing(second).is_ccw
        assert written["properties"] == {"layer": "seen"}
    files.save_site(site, tmp_path / "site.json")
    assert georeference.site_geojson(
        files.load_site(tmp_path / "site.json")
    ) == georeference.site_geojson(site)
