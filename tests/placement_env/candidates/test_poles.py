"""A city's file becomes mounts at the right places, or one line that names the mistake."""

import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from placement_env.candidates.candidates import choose_candidates, pool
from placement_env.candidates.poles import guess_property, list_unknown, load_keep_out, load_poles
from placement_env.candidates.sensor_catalogue import PricedModel, SensorCatalogue
from placement_env.report.planning.question import Stock
from toolkit.geometry import pose
from toolkit.sensors.models import DepthCamera
from toolkit.sites.files import load_site, save_site
from toolkit.sites.georeference import inverse_project, projection, site_geojson
from toolkit.sites.site import Mount, Relief, Site

CENTRE = (13.4, 52.505)
AREA = np.array([-40.0, -30.0, 40.0, 30.0])


@pytest.fixture
def site() -> Site:
    """80 x 60 m in Berlin, x to the north-east, one road along x, uneven ground."""
    road = np.array([[-90.0, -4.0], [90.0, -4.0], [90.0, 4.0], [-90.0, 4.0]])
    turn = pose(yaw=np.pi / 4)
    return Site(
        "berlin",
        AREA,
        lanes=(road,),
        map_SE3_site=turn,
        geo_reference=projection(*CENTRE),
        relief=Relief(0.1, 1),
    )


def degrees(places: list[list[float]]) -> list[list[float]]:
    on_map = np.array(places) @ pose(yaw=np.pi / 4)[:2, :2].T
    return inverse_project(on_map, CENTRE).tolist()


def point(coordinates: list[Any], **properties) -> dict:
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": "Point", "coordinates": coordinates},
    }


def polygon(corners: list[list[float]], **properties) -> dict:
    geometry = {"type": "Polygon", "coordinates": [[*corners, corners[0]]]}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def write(folder, *features, **members) -> str:
    path = folder / "poles.geojson"
    path.write_text(
        json.dumps({"type": "FeatureCollection", **members, "features": list(features)})
    )
    return str(path)


def local(folder, *features) -> str:
    return write(folder, *features, coview_site=1)


def test_poles_in_degrees_stand_where_they_do(site, tmp_path):
    places = [[10.0, 12.0], [-30.0, -8.0], [60.0, 20.0]]
    lon_lat = degrees(places)
    path = write(
        tmp_path,
        point(
            lon_lat[0], name="L/1", height=9.0, price_factor=0.5, capacity_kbit=800, max_sensors=2
        ),
        point([*lon_lat[1], 34.0], min_height=None, owner="tram"),
        {**point(lon_lat[2], min_height=4, max_height=5), "id": 17},
        {
            "type": "Feature",
            "properties": None,
            "geometry": {"type": "LineString", "coordinates": lon_lat},
        },
    )
    with pytest.warns(UserWarning, match="not used: owner"):
        mounts = load_poles(path, site)
    feet = np.array([mount.position for mount in mounts])
    assert np.abs(feet[:, :2] - places).max() < 2e-3
    assert np.allclose(feet[:, 2], site.ground(feet[:, :2]))
    assert [m.name for m in mounts] == ["L/1", "pole01", "17"]
    assert [(m.min_height, m.max_height, m.price, m.capacity) for m in mounts] == [
        *((3.0, 9.0, 0.5, 800.0), (3.0, 8.0, 1.0, 2000.0), (4.0, 5.0, 1.0, 2000.0))
    ]
    assert [m.max_sensors for m in mounts] == [2, 1, 1]
    assert {c.name for c in pool(site, mounts=mounts).mounts} == {"L/1", "pole01", "17"}


def test_mounts_of_a_site_come_back_saved_or_exported(tmp_path, site):
    built = load_site("tjunction")
    save_site(built, tmp_path / "site.json")
    saved, own = (
        [(m.name, *m.position, m.max_height, m.price, m.capacity) for m in each]
        for each in (load_poles(tmp_path / "site.json", built), built.mounts)
    )
    assert saved == own
    mounts = tuple(
        Mount(n, np.array([x, 12.0, site.ground(np.array([x, 12.0]))]), 2.0, 9.0, 0.5, 800.0)
        for n, x in [("a", 5.0), ("b", 9.0)]
    )
    (tmp_path / "site.geojson").write_text(
        site_geojson(replace(site, mounts=mounts, parking=np.array([[0, 20.0, 0]])))
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = load_poles(tmp_path / "site.geojson", site)
    assert [(m.name, m.min_height, m.max_height, m.price, m.capacity) for m in found] == [
        ("a", 2.0, 9.0, 0.5, 800.0),
        ("b", 2.0, 9.0, 0.5, 800.0),
    ]
    assert np.abs(np.array([m.position for m in found]) - [m.position for m in mounts]).max() < 2e-3


def test_poles_in_the_way_are_left_out_by_name(site, tmp_path):
    corners = [[5.0, 5.0], [20.0, 5.0], [20.0, 20.0], [5.0, 20.0]]
    path = write(
        tmp_path,
        *(
            point(at, name=name)
            for name, at in zip(
                "abc", degrees([[10.0, 10.0], [0.0, 0.0], [-10.0, 10.0]]), strict=True
            )
        ),
        polygon(degrees(corners), keep_out=True),
        polygon(degrees([[-50.0, 0.0], [0.0, 0.0], [0.0, 50.0]]), kind="building"),
    )
    with pytest.warns(UserWarning, match="left out") as told:
        mounts = load_poles(path, site)
    assert [mount.name for mount in mounts] == ["c"]
    assert [str(w.message).partition(": ")[2] for w in told] == [
        "left out, since they stand in a keep-out area: a",
        "left out, since they stand on the carriageway: b",
    ]
    area, _ = load_keep_out(path, site)  # given as such, so the building keeps out as well
    assert shapely.hausdorff_distance(area, shapely.Polygon(corners)) < 2e-3


def test_poles_keep_out_and_name_what_is_not_understood(site, tmp_path):
    outer = [[-40, 6], [40, 6], [40, 30], [-40, 30], [-40, 6]]
    hole = [[-5, 8], [5, 8], [5, 20], [-5, 20], [-5, 8]]
    south = [[-40, -30], [40, -30], [40, -20], [-40, -20], [-40, -30]]
    geometry = {"type": "MultiPolygon", "coordinates": [[outer, hole], [south]]}
    area = {"type": "Feature", "properties": {"kind": "keep_out"}, "geometry": geometry}
    path = local(
        tmp_path,
        point([0.0, 10.0]),
        point([20.0, 10.0]),
        point([0.0, -25.0]),
        point([0.0, -10.0]),
        area,
    )
    with pytest.warns(UserWarning, match="pole01, pole02"):
        assert [mount.name for mount in load_poles(path, site)] == ["pole00", "pole03"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(pool(site, mounts=load_poles(local(tmp_path, point([0.0, 10.0])), site))) > 0
    path = write(
        tmp_path,
        point(degrees([[10.0, 12.0]])[0], Height=9.0, cost_eur=900, name="a"),
        point(degrees([[-10.0, 12.0]])[0], Height=None, owner="tram", cost_eur=100, name="b"),
        polygon(degrees([[-5.0, 5.0], [20.0, 5.0], [20.0, 20.0]]), KeepOut=True, colour="red"),
    )
    with pytest.warns(UserWarning, match="not understood") as caught:
        mounts = load_poles(path, site)
    assert [str(w.message) for w in caught] == [
        f"{path}: properties that are not understood, so not used: Height: height (m above the "
        "foot)?, cost_eur: price (in the catalogue's currency)?, owner",
        (
            f"{path}: properties that are not understood, so not used: KeepOut: keep_out (true or "
            "false, of a polygon)?"
        ),
    ]
    assert [(mount.max_height, mount.price) for mount in mounts] == [(8.0, 1.0), (8.0, 1.0)]


def multipoint(places: list[Any], **properties) -> dict:
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": "MultiPoint", "coordinates": places},
    }


BOX = [[0.0, 6.0], [9.0, 6.0], [9.0, 9.0], [0.0, 9.0]]
BOW = [[0.0, 6.0], [9.0, 9.0], [9.0, 6.0], [0.0, 9.0]]


@pytest.mark.parametrize(
    ("features", "message"),
    [
        *(([], "holds no pole"), ([polygon(BOX, keep_out=True)], "holds no pole")),
        ([point([0.0, 400.0], name="far")], "pole 'far' stands 370 m from the area"),
        ([point([0.0, 10.0], name="a"), point([5.0, 10.0], name="a")], "2 poles are named 'a'"),
        (
            [point([0.0, 10.0]), point([0.05, 10.0])],
            "poles 'pole00' and 'pole01' stand at the same place",
        ),
        ([point([0.0, 10.0, 34.5])], "z = 34.5 m.*leave out altitudes"),
        ([point([0.0])], r"features\[0\].geometry.coordinates must be two or three"),
        ([point([0.0, "10"])], "must be two or three finite numbers"),
        ([point([0.0, float("nan")])], "must be two or three finite numbers"),
        (
            [point([0.0, 10.0], height="8 m")],
            r"features\[0\].properties.height must be a finite number, got '8 m'",
        ),
        (
            [point([0.0, 10.0], min_height=9, max_height=5)],
            r"features\[0\] \(pole 'pole00'\): mount.min_height",
        ),
        (
            [point([0.0, 10.0], capacity_kbit=0)],
            "capacity_kbit must be above 0 kbit per frame, got 0",
        ),
        (
            [point([0.0, 10.0], height=500)],
            r"properties.height must be in m above the foot, 0 to 60, got 500 \(is it 5 m",
        ),
        (
            [point([0.0, 10.0], max_height=8000)],
            "max_height must be in m above the foot, 0 to 60, got 8000$",
        ),
        (
            [point([0.0, 10.0], min_height=-1)],
            "min_height must be in m above the foot, 0 to 60, got -1",
        ),
        ([point([0.0, 10.0], price_factor=-2)], "price_factor must be at least 0, got -2"),
        ([point([0.0, 10.0], price=-5)], "price must be at least 0, got -5"),
        (
            [point([0.0, 10.0], max_sensors=1.5)],
            "max_sensors must be a whole number from 1 up, got 1.5",
        ),
        (
            [point([0.0, 10.0], max_sensors=0)],
            "max_sensors must be a whole number from 1 up, got 0",
        ),
        (
            [{"type": "Feature", "properties": {}, "geometry": None}],
            r"features\[0\].geometry must be an object",
        ),
        ([point([0.0, 10.0]) | {"properties": []}, 3], r"features\[1\].geometry must be an object"),
        ([point([0.0, 10.0]) | {"properties": [1]}], r"features\[0\].properties must be an object"),
        (
            [point([0.0, 10.0]), polygon(BOW, keep_out=True)],
            r"features\[1\].geometry must be a simple polygon",
        ),
        ([point([0.0, 10.0]), polygon([[0.0]], keep_out=True)], "must be closed rings"),
        ([point([0.0, 10.0], keep_out=True)], "must be Polygon or MultiPolygon, got Point"),
        (
            [point([0.0, 10.0]), polygon(BOX, keep_out="true")],
            r"features\[1\].properties.keep_out must be true",
        ),
        ([point([0.0, 10.0]), polygon(BOX, keep_out=1)], "keep_out must be true or false, got 1"),
        (
            [point([0.0, 10.0], price=float("nan"))],
            r"^\S*: features\[0\].properties.price must be a finite number",
        ),
        (
            [multipoint([[0.0, 10.0], [0.0, float("nan")]])],
            r"features\[0\].geometry.coordinates must be two or three",
        ),
        ([multipoint([[0.0, 10.0, 0.0, 1.0]])], "two or three finite numbers"),
        ([multipoint([0.0, 10.0])], "two or three finite numbers, got 0.0"),
        *(
            ([multipoint(3)], "of a MultiPoint must be a list, got 3"),
            ([multipoint([])], "holds no pole"),
        ),
        (
            [multipoint([[0.0, 10.0], [0.0, 10.0]])],
            "'pole00-1' and 'pole00-2' stand at the same place",
        ),
        (
            [multipoint([[0.0, 10.0], [5.0, 10.0]], name="a"), point([9.0, 10.0], name="a-2")],
            "2 poles are named 'a-2'",
        ),
        ([point([0.0, 10.0, 0.0, 7.0])], "two or three finite numbers"),
        (
            [
                {
                    "type": "Feature",
                    "properties": {},
                    "geometry": {"type": "point", "coordinates": [0, 10]},
                }
            ],
            "no pole",
        ),
    ],
)
def test_what_is_wrong_is_told_in_one_line(site, tmp_path, features, message):
    path = local(tmp_path, *features)
    with pytest.raises(ValueError, match=message) as error:
        load_poles(path, site)
    assert str(error.value).startswith(path)
    assert "\n" not in str(error.value)


def test_other_systems_of_coordinates_are_refused_or_need_pyproj(site, tmp_path):
    (lon_lat,) = degrees([[10.0, 12.0]])
    with pytest.raises(ValueError, match=r"longitude and latitude.*EPSG:4326"):
        load_poles(write(tmp_path, point([392000.0, 5819000.0])), site)
    with pytest.raises(ValueError, match="crs must be WGS84"):
        load_poles(
            write(
                tmp_path,
                point(lon_lat),
                crs={"properties": {"name": "urn:ogc:def:crs:EPSG::25833"}},
            ),
            site,
        )
    for name in ("urn:ogc:def:crs:OGC:1.3:CRS84", "urn:ogc:def:crs:EPSG::4326", "EPSG:4326"):
        assert load_poles(
            write(tmp_path, point(lon_lat), crs={"type": "name", "properties": {"name": name}}),
            site,
        )
    with pytest.raises(ValueError, match="longitude comes first"):
        load_poles(write(tmp_path, point(lon_lat[::-1])), site)
    with pytest.raises(ValueError, match="coview_site"):
        load_poles(write(tmp_path, point(lon_lat)), replace(site, geo_reference=None))
    (lon_lat,) = degrees([[10.0, 12.0]])
    other = replace(
        site,
        geo_reference="+proj=utm +zone=33 +datum=WGS84",
        map_SE3_site=pose(391410.0, 5818600.0),
    )
    try:
        import pyproj
    except ImportError:
        with pytest.raises(ImportError, match="pip install pyproj"):
            load_poles(write(tmp_path, point(lon_lat)), other)
        return
    x, y = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:32633", always_xy=True).transform(
        *lon_lat
    )
    (mount,) = load_poles(
        write(tmp_path, point(lon_lat)), replace(other, map_SE3_site=pose(x - 5.0, y - 9.0))
    )
    assert np.allclose(mount.position[:2], [5.0, 9.0], atol=1e-3)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        *(
            (b"", "not JSON from line 1"),
            (b'{"type": "FeatureCollection", "features": [', "not JSON"),
        ),
        *((b"\xff\xfe\x00", "not a text file"), (b"[]", "must be a GeoJSON FeatureCollection")),
        (b'{"type": "FeatureCollection"}', "must be a GeoJSON FeatureCollection"),
    ],
)
def test_damaged_files_are_told_in_one_line(site, tmp_path, content, message):
    path = tmp_path / "poles.geojson"
    path.write_bytes(content)
    for load in (load_poles, load_keep_out):
        with pytest.raises(ValueError, match=message) as error:
            load(path, site)
        assert "\n" not in str(error.value)
    with pytest.raises(FileNotFoundError, match="no file"):
        load_poles(tmp_path / "none", site)


def test_a_multipoint_is_several_poles_and_a_geometry_collection_none(site, tmp_path):
    path = local(
        tmp_path,
        multipoint([[0.0, 10.0], [5.0, 10.0, 0.2]], name="row", height=6.0),
        multipoint([[10.0, 10.0], [15.0, 10.0]]),
        multipoint([[20.0, 10.0]], name="alone"),
        multipoint([]),
    )
    mounts = load_poles(path, site)
    assert [m.name for m in mounts] == ["row-1", "row-2", "pole01-1", "pole01-2", "alone"]
    assert [m.position[0] for m in mounts] == [0.0, 5.0, 10.0, 15.0, 20.0]
    assert mounts[1].position[2] == 0.2
    assert [m.max_height for m in mounts] == [6.0, 6.0, 8.0, 8.0, 8.0]
    lon_lat = write(tmp_path, multipoint(degrees([[0.0, 10.0], [5.0, 10.0]]), name="row"))
    assert (
        np.abs(
            np.array([m.position[:2] for m in load_poles(lon_lat, site)]) - [[0, 10], [5, 10]]
        ).max()
        < 2e-3
    )
    inside = {"type": "Point", "coordinates": [9.0, 10.0]}
    geometry = {"type": "GeometryCollection", "geometries": [inside]}
    path = local(
        tmp_path, point([0.0, 10.0]), {"type": "Feature", "properties": {}, "geometry": geometry}
    )
    with pytest.warns(
        UserWarning, match=r"features\[1\] is a GeometryCollection, not used: export its points"
    ):
        assert len(load_poles(path, site)) == 1


CAMERA = PricedModel("camera", DepthCamera(), 1500.0)


def test_a_price_is_money_and_what_stands_costs_nothing(site, tmp_path):
    rows = [{"price": 1200}, {"price_factor": 1.5}, {"existing": True}, {}]
    spots = enumerate(rows)
    path = local(tmp_path, *(point([5.0 * k, 10.0], **row) for k, row in spots))
    stock = Stock(candidates=path, catalogue=SensorCatalogue((CAMERA,), "EUR", 4000.0))
    assert stock(site).mount_prices == pytest.approx([1200.0, 6000.0, 0.0, 4000.0])
    money = local(tmp_path, point([0.0, 10.0], price=900), point([5.0, 10.0], existing=True))
    assert Stock(candidates=money, catalogue=SensorCatalogue((CAMERA,), "EUR"))(
        site
    ).mount_prices.tolist() == [900, 0]


@pytest.mark.parametrize(
    ("row", "pole_price", "message"),
    [
        ({"price": 900, "price_factor": 2}, 4000.0, "has price, which is money, and price_factor"),
        ({"price": 900}, 0.0, "price is money: give a catalogue with a pole_price above 0"),
        ({"price_factor": 2}, None, "price_factor needs a pole_price in the catalogue"),
        ({"existing": "yes"}, 4000.0, "existing must be true or false, got 'yes'"),
        ({"price": -4}, 4000.0, "price"),
    ],
)
def test_prices_that_cannot_be_meant(row, pole_price, message, site, tmp_path):
    path = local(tmp_path, point([0.0, 10.0], **row))
    with pytest.raises(ValueError, match=message):
        load_poles(path, site, SensorCatalogue((CAMERA,), "EUR", pole_price))
    if "price" in row and pole_price:
        with pytest.raises(ValueError, match="price"):
            load_poles(path, site)


def test_every_area_of_a_file_given_as_keep_out_keeps_out(site, tmp_path):
    ring = [[-1.0, 9.0], [6.0, 9.0], [6.0, 11.0], [-1.0, 11.0], [-1.0, 9.0]]
    area = {
        "type": "Feature",
        "properties": {},
        "geometry": {"type": "Polygon", "coordinates": [ring]},
    }
    poles = local(tmp_path, *(point([5.0 * k, 10.0]) for k in range(3)))
    kept = Path(poles).rename(tmp_path / "three.geojson")
    areas = load_keep_out(local(tmp_path, area), site)
    with pytest.warns(UserWarning, match="1 keep-out area at .*: 2 of 3 poles stand there"):
        assert {mount.name for mount in choose_candidates(site, kept, keep_out=areas).mounts} == {
            "pole02"
        }
    with pytest.raises(ValueError, match="holds no area"):
        load_keep_out(kept, site)
    with pytest.raises(ValueError, match="hang already: keep-out areas are for"):
        choose_candidates(site, "paper", keep_out=areas)


def test_properties_are_guessed_named_once_and_cut():
    for meant, keys in {
        "height": ("Height", "HEIGHT_M", "pole height [m]", "heigth", "Höhe"),
        "min_height": ("minHeight",),
        "max_height": ("Max. height",),
        "price": ("cost_eur", "Preis", "Price"),
        "capacity_kbit": ("capacity_mbit", "Capacity", "linkKbit"),
        "name": ("Name",),
        "keep_out": ("keepout", "Keep_Out", "keep-out"),
        None: ("owner", "fid", "", "2024"),
    }.items():
        assert [guess_property(key) for key in keys] == [meant] * len(keys)
    known = {
        "name": 1,
        "height": 2,
        "max_height": 3,
        "min_height": 4,
        "price": 5,
        "capacity_kbit": 6,
        "capacity": 7,
    }
    known |= {"price_factor": 8, "existing": True}
    assert (
        list_unknown([known | {"keep_out": True, "kind": "x", "layer": "mount", "used": False}])
        == ""
    )
    assert list_unknown([]) == ""
    poles = [{"Price": 1, "fid": 3}, {"fid": 4, "Price": 2}, {"colour": "red"}]
    assert list_unknown(poles) == "Price: price (in the catalogue's currency)?, colour"
    areas = [{"building": "yes", "Height": 9, "KeepOut": True}]
    assert list_unknown(areas, areas=True) == "KeepOut: keep_out (true or false, of a polygon)?"
    assert len(list_unknown([{"x" * 500: 1}])) == 60


def test_a_whole_city_of_poles_is_refused_and_a_quarter_is_read(site, tmp_path):
    grid = [[0.5 * x - 20.0, 0.5 * y + 10.0] for x in range(80) for y in range(63)]
    assert len(load_poles(local(tmp_path, *map(point, grid[:5000])), site)) > 1000
    with pytest.raises(
        ValueError, match="holds 5040 poles, more than 5000: leave out those far off"
    ):
        load_poles(local(tmp_path, *map(point, grid)), site)
    near = [[0.0, 10.0], [5.0, 10.0], [5.05, 10.0], [9.0, 10.0], [9.0, 10.05]]
    with pytest.raises(ValueError, match="poles 'pole01' and 'pole02' stand at the same place"):
        load_poles(local(tmp_path, *map(point, near)), site)


class TestNamesOfOtherTools:
    """Poles without a name are named by what OpenStreetMap's, QGIS's and PostGIS's exports number
    them with."""

    def names(self, folder, site, *features):
        return [mount.name for mount in load_poles(local(folder, *features), site)]

    @pytest.mark.parametrize("key", ["ref", "id", "@id", "fid", "osm_id"])
    def test_a_key_that_differs_names_poles(self, key, site, tmp_path):
        rows = [
            point([0.0, 10.0], **{key: 7}),
            point([5.0, 10.0], **{key: "node/8"}),
            point([9.0, 10.0], name="L"),
        ]
        assert self.names(tmp_path, site, *rows) == ["7", "node/8", "L"]

    def test_a_key_that_repeats_itself_names_none(self, site, tmp_path):
        rows = [point([0.0, 10.0], ref="1", fid=3), point([5.0, 10.0], ref="1", fid=4)]
        assert self.names(tmp_path, site, *rows) == ["3", "4"]
        rows = [point([0.0, 10.0], ref="1"), point([5.0, 10.0], name="1")]
        assert self.names(tmp_path, site, *rows) == ["pole00", "1"]

    def test_the_feature_has_an_id_too(self, site, tmp_path):
        rows = [{**point([0.0, 10.0]), "id": "way/5"}, point([5.0, 10.0], name="  ", ref="12/3")]
        assert self.names(tmp_path, site, *rows) == ["way/5", "12/3"]


class TestPolesNearTheEdgeOfLanes:
    """Maps draw lanes too wide: a lamp up to 1 m within them stands at the kerb; the road of `site`
    ends at y = 4."""

    def load(self, folder, site, *features):
        with warnings.catch_warnings(record=True) as noted:
            warnings.simplefilter("always")
            mounts = load_poles(local(folder, *features), site)
        return mounts, [str(note.message) for note in noted]

    def test_they_move_to_the_edge_with_a_note(self, site, tmp_path):
        rows = [
            point([0.0, 3.2], name="A"),
            point([5.0, -3.5], name="B"),
            point([7.0, 0.0], name="C"),
        ]
        mounts, notes = self.load(tmp_path, site, *rows)
        assert [mount.name for mount in mounts] == ["A", "B"]
        np.testing.assert_allclose(
            [mount.position[:2] for mount in mounts], [[0, 4.05], [5, -4.05]], atol=1e-6
        )
        lanes = shapely.union_all([shapely.Polygon(lane) for lane in site.lanes])
        assert not any(lanes.intersects(shapely.Point(mount.position[:2])) for mount in mounts)
        for mount in mounts:
            np.testing.assert_allclose(
                mount.position[2], site.ground(mount.position[:2]), atol=1e-6
            )
        assert notes[0].endswith(
            "moved off the carriageway, whose edge is near: A by 0.85 m, B by 0.55 m"
        )
        assert notes[1].endswith("left out, since they stand on the carriageway: C")

    def test_the_seam_of_two_lanes_is_no_edge(self, site, tmp_path):
        halves = [
            np.array([[-90.0, a], [90.0, a], [90.0, b], [-90.0, b]])
            for a, b in ((-4.0, 0.0), (0.0, 4.0))
        ]
        mounts, notes = self.load(
            tmp_path, replace(site, lanes=tuple(halves)), point([0.0, 0.2]), point([0.0, 9.0])
        )
        assert len(mounts) == 1
        assert "left out" in notes[0]

    def test_those_in_a_keep_out_area_stay_out(self, site, tmp_path):
        barred = polygon([[-2.0, 2.0], [2.0, 2.0], [2.0, 6.0], [-2.0, 6.0]], keep_out=True)
        mounts, notes = self.load(
            tmp_path, site, point([0.0, 3.5], name="A"), point([0.0, 9.0], name="B"), barred
        )
        assert [mount.name for mount in mounts] == ["B"]
        assert notes[0].endswith("left out, since they stand in a keep-out area: A")
