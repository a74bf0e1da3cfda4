"""Sites in longitude and latitude: what RFC 7946 asks, where places lie, and that poles come back from it."""

import json
from dataclasses import replace

import numpy as np
import pytest
import shapely
from shapely.geometry import shape

from toolkit.geometry import look, pose
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import load_site, save_site
from toolkit.sites.georeference import project, projection
from toolkit.sites.gis import feature, feature_collection, site_geojson

CENTRE = (13.4, 52.505)


@pytest.fixture
def site(small_site):
    """A small site with all that sites have, whose x points to the map's north."""
    turned = pose(3.0, 4.0, yaw=np.pi / 2)
    level = Sensor("level", DepthCamera(), look((0.0, 0.0, 5.0), 0.0, 0.0))
    made = small_site()
    return replace(made, map_SE3_site=turned, geo_reference=projection(*CENTRE), sensors=(*made.sensors, level))


def on_map(geometry):
    """Corners of a GeoJSON geometry in metres of the map."""
    return project(shapely.get_coordinates(shape(geometry)), CENTRE)


def test_every_layer_is_there_with_its_properties(site):
    features = json.loads(site_geojson(site))["features"]
    layers = [each["properties"]["layer"] for each in features]
    assert {layer: layers.count(layer) for layer in layers} == {
        "area": 1, "lane": 2, "footway": 1, "solid": 2, "parking": 1, "mount": 2, "sensor": 4,
    }  # fmt: skip
    by_name = {each["properties"]["name"]: each["properties"] for each in features}
    assert by_name["small"] == {"layer": "area", "name": "small", "height": 3.5}
    assert by_name["building000"] == {
        "layer": "solid", "name": "building000", "kind": "building", "base": -0.3, "top": 6.25, "height": 6.55,
    }  # fmt: skip
    assert by_name["pond001"]["kind"] == "pond"
    assert by_name["b"] == {
        "layer": "mount", "name": "b", "min_height": 2.0, "max_height": 9.0, "price": 0.5, "capacity_kbit": 800.0,
    }  # fmt: skip
    assert by_name["bay000"]["bearing_deg"] == pytest.approx(360 - 28.6)  # 0.5 rad counter-clockwise from north
    assert by_name["d0"]["bearing_deg"] == pytest.approx(360 - 17.2)
    assert by_name["d0"]["tilt_deg"] == 5.7
    assert by_name["d0"]["height"] == pytest.approx(5.2, abs=0.06)  # above ground that is uneven
    assert (by_name["level"]["bearing_deg"], by_name["level"]["tilt_deg"]) == (0.0, 0.0)
    assert (by_name["l0"]["model"], by_name["d0"]["model"]) == ("spinning-lidar", "depth-camera")


def test_places_lie_where_they_are_on_earth(site):
    features = {each["properties"]["name"]: each for each in json.loads(site_geojson(site))["features"]}
    # site (1, 3) is 3 m to the west and 1 m to the north of (3, 4)
    assert on_map(features["b"]["geometry"]) == pytest.approx(np.array([[0.0, 5.0]]), abs=2e-3)
    area = on_map(features["small"]["geometry"])
    assert [area.min(axis=0), area.max(axis=0)] == pytest.approx(np.array([[-2.0, -6.0], [8.0, 14.0]]), abs=2e-3)


def test_rings_boxes_and_members_as_rfc_7946_has_them(site):
    collection = json.loads(site_geojson(site))
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


def test_clockwise_polygons_and_holes_are_turned(site):
    outer, hole = [(0, 0), (0, 9), (9, 9), (9, 0)], [(2, 2), (4, 2), (4, 4), (2, 4)]
    both = shapely.MultiPolygon([shapely.Polygon(outer, [hole]), shapely.box(20, 0, 30, 9)])
    for place in (site, replace(site, geo_reference=None)):
        written = feature(place, both, layer="seen")
        assert written["geometry"]["type"] == "MultiPolygon"
        (first, inside), (second,) = written["geometry"]["coordinates"]
        assert shapely.LinearRing(first).is_ccw
        assert not shapely.LinearRing(inside).is_ccw
        assert shapely.LinearRing(second).is_ccw
        assert written["properties"] == {"layer": "seen"}


def test_metres_where_a_site_is_nowhere_on_earth(site):
    written = feature(replace(site, geo_reference=None), shapely.Point(1.23456, -0.0001, 7.0))
    assert written["geometry"] == {"type": "Point", "coordinates": (1.235, 0.0)}
    with pytest.raises(ValueError, match=r"site 'tjunction' does not say where on earth it is .* in metres"):
        site_geojson(load_site("tjunction"))


def test_the_same_site_gives_the_same_text(site, tmp_path):
    save_site(site, tmp_path / "site.json")
    assert site_geojson(load_site(tmp_path / "site.json")) == site_geojson(site)


def test_collections_without_features_have_no_box():
    assert json.loads(feature_collection([], name="none", note="Straße")) == {
        "type": "FeatureCollection", "name": "none", "note": "Straße", "features": [],
    }  # fmt: skip
    with pytest.raises(ValueError, match="JSON compliant"):
        feature_collection([], price=float("nan"))
