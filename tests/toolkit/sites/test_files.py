import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from toolkit.geometry import pose
from toolkit.sensors.models import SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import document, load_site, parse, save_site
from toolkit.sites.site import Relief, Site

NET = '<net version="1.20">\n    <edge id="a"/>\n</net>\n'


def test_saved_sites_come_back_equal_also_with_null_columns(tmp_path, small_site, saved):
    site, (path, document) = small_site(), saved(tmp_path)
    loaded = load_site(path)
    assert loaded == site
    assert loaded.network == NET
    assert loaded.hybrid_radius == 15.5
    for before, after in zip(site.sensors, loaded.sensors, strict=True):
        assert np.abs(before.pose - after.pose).max() < 1e-9
        assert before.model.shape == after.model.shape
    save_site(loaded, path)
    assert json.loads(path.read_text()) == document
    path, _ = saved(tmp_path, says("lane", kind=None))
    assert load_site(path) == small_site()


def test_slopes_are_kept_and_files_that_are_no_json_refused(tmp_path, small_site):
    path = tmp_path / "cut.json"
    save_site(small_site(), path)
    path.write_text(path.read_text()[:500])
    with pytest.raises(ValueError, match="not JSON from line"):
        load_site(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="not a text file"):
        load_site(path)
    path.write_text("[1, 2]")
    with pytest.raises(ValueError, match="FeatureCollection"):
        load_site(path)
    with pytest.raises(FileNotFoundError, match="roundabout, tjunction"):
        load_site("tjunctoin")
    steep = replace(small_site(), relief=Relief(0.06, 7, (0.0512, -0.03)))
    save_site(steep, tmp_path / "steep.json")
    assert load_site(tmp_path / "steep.json") == steep
    assert document(small_site())["relief"] == {"amplitude": 0.06, "seed": 7}


def test_a_byte_order_mark_does_no_harm(tmp_path):
    path = tmp_path / "site.json"
    save_site(load_site("tjunction"), path)
    path.write_text(path.read_text(encoding="utf-8"), encoding="utf-8-sig")
    assert load_site(path) == load_site("tjunction")


SQUARE = np.array([[0.0, 0], [4, 0], [4, 4], [0, 4]])
BOW_TIE = [[0, 0], [4, 4], [4, 0], [0, 4], [0, 0]]


def first(document, layer):
    return next(f for f in document["features"] if f["properties"]["layer"] == layer)


def drop(key):
    return lambda d: d.pop(key)


def put(**values):
    return lambda d: d.update(values)


def shape(layer, coordinates):
    return lambda d: first(d, layer)["geometry"].update(coordinates=coordinates)


def says(layer, /, **values):
    return lambda d: first(d, layer)["properties"].update(values)


AREA, LANE = (rf"features\[{k}\]\.geometry\.coordinates" for k in (0, 1))


DAMAGE = [
    (shape("lane", [BOW_TIE]), rf"{LANE}: polygon crosses itself near \(2, 2\)"),
    (shape("lane", [SQUARE.tolist()]), rf"{LANE} must be a closed ring"),
    (shape("lane", [[[0, 0], [1, 1], [2, 2], [0, 0]]]), rf"{LANE}: polygon"),
    (shape("lane", [[["x", 0], [1, 1], [2, 0], ["x", 0]]]), rf"{LANE} must be a list of \[x, y\]"),
    (shape("lane", [BOW_TIE, BOW_TIE]), rf"{LANE} must hold one ring, got 2"),
    (
        lambda d: first(d, "lane")["geometry"].update(type="Point"),
        r"\[1\]\.geometry\.type .* must be 'Polygon'",
    ),
    (says("lane", layer="lain"), r"features\[1\]\.properties\.layer must be one of"),
    (says("solid", kind="castle"), r"properties: solid\.kind must be one of .*'castle'"),
    (says("mount", hight=3), r"properties\.hight is unknown to layer 'mount'"),
    (
        says("solid", origin="guessed"),
        r"properties\.origin must be one of mapped, surveyed, drawn, got 'guessed'",
    ),
    (says("parking", origin=3), r"properties\.origin must be a text"),
    (put(road_origin="found"), r"road_origin must be one of mapped, surveyed, drawn, got 'found'"),
    (put(furnished="much"), r"furnished must be one of none, light, dense, got 'much'"),
    (says("solid", top=-5), r"properties: solid\.top must lie above its base"),
    (says("solid", top=float("nan")), r"properties\.top must be a finite number, got nan"),
    (shape("area", [[[0, 0], [0, 0], [0, 0], [0, 0], [0, 0]]]), rf"{AREA}: polygon"),
    (
        shape("area", [[[0, 0], [4, 1], [4, 4], [0, 4], [0, 0]]]),
        rf"{AREA}: the area must be a rectangle",
    ),
    (lambda d: d["features"].pop(0), r"exactly one of layer 'area', got 0"),
    (
        lambda d: d["features"].append(first(d, "mount")),
        r"mounts\[2\]\.name 'a' is taken by mounts\[0\]",
    ),
    (
        lambda d: d["features"].append(first(d, "sensor")),
        r"sensors\[3\]\.name 'd0' is taken by sensors\[0\]",
    ),
    (says("mount", name=""), r"mounts\[0\]\.name must be a text"),
    (
        says("sensor", heading_deg=float("nan")),
        r"properties\.heading_deg must be a finite number, got nan",
    ),
    (shape("sensor", [0, float("nan"), 5]), r"geometry\.coordinates\.1 must be a finite number"),
    (shape("sensor", [0, 0]), r"geometry\.coordinates must be 3 numbers, got 2"),
    (
        says("sensor", model={"type": "Radar"}),
        r"type must be one of DepthCamera, SpinningLidar, .*, got 'Radar'",
    ),
    (
        says("sensor", model={"type": "DepthCamera", "fov": 1}),
        r"fov is unknown to DepthCamera: it has .*fov_deg",
    ),
    (says("sensor", model={"type": "DepthCamera", "fov_deg": 200}), r"model: fov must lie between"),
    (put(map_SE3_site=np.zeros((4, 4)).tolist()), r"map_SE3_site must end with the row"),
    (
        put(map_SE3_site=np.diag([1.0, -1, 1, 1]).tolist()),
        r"map_SE3_site must be a rotation .* it mirrors",
    ),
    (put(map_SE3_site=[[1, 0], [1]]), r"map_SE3_site must be four rows"),
    *(
        (drop("network"), r"network is missing"),
        (put(network=[]), r"network must be the lines of a SUMO net\.xml"),
    ),
    (put(network=["<net>"]), r"network is damaged XML"),
    (put(network=["<routes/>"]), r"network must be a SUMO <net>"),
    (drop("height"), r"height must be a finite number, got None"),
    (put(height=10**400), r"it has a number of 401 digits"),
    (put(relief=3), r"relief must be an object \{\.\.\.\}, got '3'"),
    (put(height=-4), r"height must be positive, got -4"),
    (put(hybrid_radius=[]), r"hybrid_radius must be a finite number"),
    (put(hybrid_radius=-3), r"hybrid_radius must be finite and at least 0"),
    (put(relief={"amplitude": -1, "seed": 0}), r"relief\.amplitude must be finite"),
    *(
        (put(coview_site=99), r"coview_site is version 99"),
        (drop("coview_site"), r"coview_site is missing"),
    ),
    *(
        (put(type="Feature"), r"type must be 'FeatureCollection'"),
        (put(features={}), r"features must be a list"),
    ),
    (
        says("sensor", heading_deg=1.7e12),
        r"properties\.heading_deg must lie within 3600 degrees of 0, got 1\.7e\+12",
    ),
    (says("mount", max_height=1.7e18), r"must lie in 0\.\.1000 m, got"),
    (says("solid", top=1e6), r"at most 1000 m high"),
    (lambda d: d["features"].extend([first(d, "sensor")] * 10_001), r"at most 10000 sensors"),
    (lambda d: d["features"].insert(0, 3), r"features\[0\] must be an object"),
]


@pytest.mark.parametrize(("change", "message"), DAMAGE)
def test_a_damaged_file_is_refused_in_one_line_that_names_the_field(
    tmp_path, change, message, saved
):
    path, _ = saved(tmp_path, change)
    with pytest.raises(ValueError, match=message) as refusal:
        load_site(path)
    assert "\n" not in str(refusal.value)
    assert str(refusal.value).startswith(str(path))


@settings(max_examples=40, deadline=None)
@given(st.floats(-np.pi, np.pi), st.floats(-np.pi / 2, np.pi / 2), st.floats(-np.pi, np.pi))
def test_every_attitude_survives_the_file(tmp_path_factory, yaw, pitch, roll):
    path = tmp_path_factory.mktemp("site") / "s.json"
    sensor = Sensor("d0", SpinningLidar(), pose(0.0, 0.0, 5.0, yaw=yaw, pitch=pitch, roll=roll))
    save_site(Site("s", np.array([0.0, 0, 1, 1]), sensors=(sensor,)), path)
    assert np.abs(load_site(path).sensors[0].pose - sensor.pose).max() < 1e-6


def test_the_file_is_geojson_with_closed_rings(tmp_path, saved):
    _, document = saved(tmp_path)
    assert document["type"] == "FeatureCollection"
    for feature in document["features"]:
        assert feature["type"] == "Feature"
        if feature["geometry"]["type"] == "Polygon":
            (ring,) = feature["geometry"]["coordinates"]
            assert ring[0] == ring[-1]
    sensor = next(f for f in document["features"] if f["properties"]["layer"] == "sensor")
    assert sensor["properties"]["heading_deg"] == pytest.approx(np.rad2deg(0.3))
    assert sensor["properties"]["tilt_deg"] == pytest.approx(np.rad2deg(0.1))


@pytest.mark.parametrize("name", ["small", "roundabout"])
def test_a_file_without_a_hybrid_radius_has_the_papers_usual_one_whatever_its_name(
    tmp_path, name, saved
):
    path, _ = saved(tmp_path, lambda d: (d.pop("hybrid_radius"), d.update(name=name)))
    assert load_site(path).hybrid_radius == 20.0


@pytest.mark.parametrize("slope", [0.05, [0.05], [0.05, "x"], [0.4, 0.0]])
def test_a_slope_that_is_none_is_refused(tmp_path, saved, slope):
    path, _ = saved(tmp_path, lambda d: d["relief"].update(slope=slope))
    with pytest.raises(ValueError, match="relief"):
        load_site(path)


def test_a_bearing_that_a_person_wrote_is_read_as_a_direction(small_site):
    turned = replace(small_site(), map_SE3_site=pose(yaw=np.deg2rad(20.0)))
    written = document(turned)
    for feature in written["features"]:
        properties = feature["properties"]
        if "heading_deg" in properties:
            properties["bearing_deg"] = 90.0 - properties.pop("heading_deg") - 20.0
    assert parse(written) == turned


def test_a_direction_is_given_once_and_no_tilt_passes_straight_down(small_site):
    written = document(small_site())
    sensor = next(f for f in written["features"] if f["properties"]["layer"] == "sensor")[
        "properties"
    ]
    sensor["bearing_deg"] = 3.0
    with pytest.raises(
        ValueError, match=r"bearing_deg and heading_deg are two directions: leave one of them out"
    ):
        parse(written)
    del sensor["bearing_deg"]
    sensor["tilt_deg"] = 95.0
    with pytest.raises(
        ValueError, match=r"tilt_deg must lie within 90 degrees of the horizon, got 95"
    ):
        parse(written)
