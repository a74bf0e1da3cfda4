"""A plan's files as GIS and spreadsheet programs read them: GeoJSON by shapely, places by pyproj,
tables by pandas."""

import io
import json

import numpy as np
import pandas as pd
import pytest
import shapely
from pyproj import Transformer

from placement_env.handover.exchange import plan_geojson, schedule_csv
from placement_env.handover.ground import GroundGrid
from placement_env.handover.mounted import PlannedSensor
from toolkit.geometry import look, pose
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import load_site, save_site
from toolkit.sites.site import Mount, Site

UTM = "EPSG:25832"
CENTRE = np.array([692000.0, 5336000.0])
TURN = 0.4
SITE = Site(
    "munich",
    np.array([-10.0, -10.0, 10.0, 10.0]),
    mounts=(Mount("north", np.array([0.0, 9.0, 0.0])),),
    sensors=(Sensor("n", DepthCamera(), look((0.0, 9.0, 5.0), -np.pi / 2, 0.2)),),
    map_SE3_site=pose(CENTRE[0], CENTRE[1], 520.0, yaw=TURN),
    geo_reference=UTM,
)
PLACE = (0.0, 9.0, 5.0, 11.58, 48.15, 5.0)
SENSOR = PlannedSensor(
    "n",
    "north; 信号灯",
    *PLACE,
    157.0,
    11.4,
    "depth-camera",
    1500.0,
    0.5,
    412.3,
    500.0,
    2000.0,
    480.0,
)


def ground():
    middles = np.arange(20) - 9.5
    x, y = np.meshgrid(middles, middles)
    none = np.zeros(x.shape, bool)
    seen = np.array([y > 0])
    return GroundGrid(middles, middles, seen, seen.astype(np.float32), ~none, none, none)


def on_earth(places):
    """Longitude and latitude of places in the site's frame, by pyproj alone."""
    turn = np.array([[np.cos(TURN), -np.sin(TURN)], [np.sin(TURN), np.cos(TURN)]])
    east, north = (np.asarray(places) @ turn.T + CENTRE).T
    longitude, latitude = Transformer.from_crs(UTM, "EPSG:4326", always_xy=True).transform(
        east, north
    )
    return np.column_stack([longitude, latitude])


def test_maps_lie_where_pyproj_has_them():
    """RFC 7946: WGS 84, longitude first."""
    features = json.loads(plan_geojson(SITE, [SENSOR], ground()))["features"]
    by_layer = {
        feature["properties"]["layer"]: shapely.geometry.shape(feature["geometry"])
        for feature in features
    }
    sensor = np.array(by_layer["sensor"].coords)[:, :2]
    np.testing.assert_allclose(sensor, on_earth([[0.0, 9.0]]), rtol=0, atol=1e-7)
    corners = shapely.MultiPoint(on_earth([[-10, -10], [10, -10], [10, 10], [-10, 10]]))
    assert by_layer["area"].is_valid
    assert by_layer["area"].hausdorff_distance(corners.convex_hull) < 1e-7
    assert by_layer["visible"].area == pytest.approx(by_layer["area"].area / 2, rel=0.02)


def test_schedules_in_pandas():
    table = pd.read_csv(io.StringIO(schedule_csv([SENSOR], "EUR")))
    row = table.iloc[0]
    assert row["pole"] == "north; 信号灯"
    assert (row["y_m"], row["longitude"], row["bearing_deg"], row["model_price"]) == (
        9.0,
        11.58,
        157.0,
        1500,
    )


def test_site_files_keep_places_of_a_map(tmp_path):
    save_site(SITE, tmp_path / "site.json")
    loaded = load_site(tmp_path / "site.json")
    np.testing.assert_allclose(loaded.map_SE3_site, SITE.map_SE3_site, rtol=0, atol=1e-6)
    assert loaded.geo_reference == UTM
    content = json.loads((tmp_path / "site.json").read_text(encoding="utf-8"))
    shapes = [shapely.geometry.shape(feature["geometry"]) for feature in content["features"]]
    assert all(shape.is_valid for shape in shapes)
