"""Files of a plan: what is in them, that spreadsheets cannot be made to compute, and that they are
always the same."""

import csv
import io
import json
from dataclasses import replace

import numpy as np
import pytest
import shapely
from shapely.geometry import shape

from placement_env.candidates.poles import load_poles
from placement_env.handover.exchange import (
    SCHEDULE_COLUMNS,
    plan_geojson,
    safe_cell,
    schedule_csv,
    write_exchange,
)
from placement_env.handover.ground import GroundGrid
from placement_env.handover.mounted import PlannedSensor
from toolkit.geometry import look, pose
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import load_site
from toolkit.sites.georeference import project, projection
from toolkit.sites.site import Mount, Site

CENTRE = (13.4, 52.505)
FREE = Mount("free", np.array([6.0, 6.0, 0.0]), 3.0, 9.0, 0.5, 700.0)
SITE = Site(
    "berlin",
    np.array([-10.0, -10.0, 10.0, 10.0]),
    mounts=(
        Mount("north", np.array([0.0, 9.0, 0.0])),
        Mount("south", np.array([0.0, -9.0, 0.0])),
        FREE,
    ),
    sensors=(
        Sensor("n", DepthCamera(), look((0.0, 9.0, 5.0), -np.pi / 2, 0.2)),
        Sensor("s", DepthCamera(), look((0.0, -9.0, 5.0), np.pi / 2, 0.2)),
    ),
    map_SE3_site=pose(3.0, 4.0, yaw=np.pi / 2),
    geo_reference=projection(*CENTRE),
)
NORTH = PlannedSensor(
    "n",
    "north",
    0.0,
    9.0,
    5.0,
    13.39996,
    52.505027,
    5.0,
    359.96,
    11.459,
    "depth-camera",
    1500.0,
    0.5,
    412.345,
    500.0,
    2000.0,
    480.0,
)
SOUTH = replace(
    NORTH,
    name="s",
    pole="south",
    y=-9.0,
    longitude=None,
    latitude=None,
    bearing_deg=0.04,
    tilt_deg=-0.04,
)


@pytest.fixture
def ground() -> GroundGrid:
    """20 x 20 m in cells of 1 m: the first sensor sees the half above y = 0, the second the quarter
    x < 0, y < 0; a house of 4 x 4 m stands in the middle of the upper half."""
    middles = np.arange(20) - 9.5
    x, y = np.meshgrid(middles, middles)
    seen = np.array([y > 0, (x < 0) & (y < 0)])
    open_ground = ~((np.abs(x) < 2) & (np.abs(y - 5) < 2))
    none = np.zeros_like(open_ground)
    return GroundGrid(
        middles, middles, seen & open_ground, seen.astype(np.float32), open_ground, none, none
    )


def test_schedules_line_by_line_as_rfc_4180_has_it():
    assert schedule_csv([NORTH, SOUTH], "EUR") == (
        "pole,sensor,x_m,y_m,z_m,longitude,latitude,height_m,bearing_deg,tilt_deg,model,model_price,pole_price,"
        "price_unit,kbit_per_frame,peak_kbit_per_frame,link_kbit_per_frame\r\n"
        "north,n,0.000,9.000,5.000,13.39996000,52.50502700,5.000,0.0,11.5,depth-camera,1500,0.5,EUR,412.3,500.0,2000.0\r\n"
        "south,s,0.000,-9.000,5.000,,,5.000,0.0,0.0,depth-camera,1500,0.5,EUR,412.3,500.0,2000.0\r\n"
    )
    assert schedule_csv([]) == ",".join(SCHEDULE_COLUMNS) + "\r\n"
    assert ",ordinary poles," in schedule_csv([NORTH])
    (row,) = csv.DictReader(
        io.StringIO(schedule_csv([replace(NORTH, pole='Straße "5",\nEcke')]), newline="")
    )
    assert row["pole"] == 'Straße "5",\nEcke'
    assert '"Straße ""5"",\nEcke",n,' in schedule_csv([replace(NORTH, pole='Straße "5",\nEcke')])
    assert float(row["y_m"]) == 9.0


@pytest.mark.parametrize("name", ["=cmd()", "+1", "-1+cmd", "@SUM(A1)", "\t=1", "\r=1", "\n=1"])
def test_no_text_is_a_formula(name):
    text = schedule_csv([replace(NORTH, pole=name, name=name, model=name)], name)
    (row,) = csv.DictReader(io.StringIO(text, newline=""))
    assert [row[column] for column in ("pole", "sensor", "model", "price_unit")] == [f"'{name}"] * 4
    for separator in (";", '; "', "\t", "\n") if name[0] in "=+-@" else ():
        assert (
            safe_cell(f"pole-1{separator}{name}") == f"pole-1{separator[0]}'{separator[1:]}{name}"
        )
    assert safe_cell("north-east; a=b, c@d") == "north-east; a=b, c@d"


def layers(text: str) -> dict[str, list[dict]]:
    found: dict[str, list[dict]] = {}
    for each in json.loads(text)["features"]:
        found.setdefault(each["properties"]["layer"], []).append(each)
    return found


def test_maps_have_all_layers(ground):
    found = layers(plan_geojson(SITE, [NORTH, SOUTH], ground, unused=[FREE]))
    assert {layer: len(features) for layer, features in found.items()} == {
        "area": 1,
        "sensor": 2,
        "visible": 2,
        "blind": 1,
        "mount": 1,
    }
    assert [each["properties"]["m2"] for each in (*found["visible"], *found["blind"])] == [
        184.0,
        100.0,
        100.0,
    ]
    assert found["sensor"][0]["properties"] == {
        "layer": "sensor",
        "name": "n",
        "pole": "north",
        "model": "depth-camera",
        "height": 5.0,
        "z": 5.0,
        "bearing_deg": 0.0,
        "tilt_deg": 11.5,
        "model_price": 1500.0,
        "pole_price": 0.5,
        "kbit": 412.3,
        "peak_kbit": 500.0,
        "capacity_kbit": 2000.0,
    }
    assert found["mount"][0]["properties"]["used"] is False


def test_maps_lie_where_the_site_is(ground):
    found = layers(plan_geojson(SITE, [NORTH, SOUTH], ground, unused=[FREE]))
    # y of the site points to the map's west; its zero is (3, 4)
    (at,) = project(np.array([found["sensor"][0]["geometry"]["coordinates"]]), CENTRE)
    assert at == pytest.approx([-6.0, 4.0], abs=2e-3)
    blind = shape(found["blind"][0]["geometry"])
    west, south, east, north = project(np.array(blind.bounds).reshape(2, 2), CENTRE).ravel()
    assert [west, south, east, north] == pytest.approx([3.0, 4.0, 13.0, 14.0], abs=0.02)
    (house,) = [
        ring for part in shape(found["visible"][0]["geometry"]).geoms for ring in part.interiors
    ]
    assert not shapely.LinearRing(house).is_ccw


def test_maps_without_a_reference_are_in_metres_with_a_note(ground):
    text = plan_geojson(replace(SITE, geo_reference=None), [NORTH, SOUTH], ground)
    assert json.loads(text)["coview_site"] == 1
    assert "metres of the site frame" in json.loads(text)["note"]
    assert layers(text)["sensor"][1]["geometry"]["coordinates"] == [0.0, -9.0]
    assert not {"coview_site", "note"} & set(json.loads(plan_geojson(SITE, [NORTH, SOUTH], ground)))


@pytest.mark.parametrize("geo_reference", [SITE.geo_reference, None])
def test_unused_poles_come_back_as_poles(geo_reference, ground, tmp_path):
    site = replace(SITE, geo_reference=geo_reference)
    write_exchange(tmp_path, site, [NORTH, SOUTH], ground, unused=[FREE])
    (mount,) = load_poles(tmp_path / "plan.geojson", site)
    assert (mount.name, mount.min_height, mount.max_height, mount.price, mount.capacity) == (
        "free",
        3,
        9,
        0.5,
        700,
    )
    assert mount.position == pytest.approx([6.0, 6.0, 0.0], abs=2e-3)


def test_three_files_always_the_same_of_one_set(ground, tmp_path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        write_exchange(
            tmp_path / folder, SITE, [NORTH, SOUTH], ground, unused=[FREE], currency="EUR"
        )
    files = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert files == ["plan.geojson", "schedule.csv", "site.json"]
    assert all(
        (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
        for name in files
    )
    assert load_site(tmp_path / "a" / "site.json") == SITE
    assert (tmp_path / "a" / "schedule.csv").read_bytes() == schedule_csv(
        [NORTH, SOUTH], "EUR"
    ).encode()
    with pytest.raises(
        ValueError, match=r"got \['n', 's'\] at the site, \['s', 'n'\] planned and 2 layers"
    ):
        write_exchange(tmp_path / "c", SITE, [SOUTH, NORTH], ground)
    with pytest.raises(ValueError, match="and 1 layers"):
        write_exchange(
            tmp_path / "c",
            SITE,
            [NORTH, SOUTH],
            replace(ground, seen=ground.seen[:1], density=ground.density[:1]),
        )
    assert {path.name for path in tmp_path.iterdir()} == {"a", "b"}
