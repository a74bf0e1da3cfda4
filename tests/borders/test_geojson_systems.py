"""GeoJSON of poles: systems, orders and missing places (RFC 7946; `crs` as in the specification of
2008, section 3)."""

import json
from pathlib import Path

import numpy as np
import pytest

from placement_env.candidates.poles import load_keep_out, load_poles
from toolkit.sites.files import load_site, save_site
from toolkit.sites.georeference import inverse_project, projection
from toolkit.sites.site import Site

CENTRE = (13.4, 52.505)
SITE = Site("berlin", np.array([-40.0, -30.0, 40.0, 30.0]), geo_reference=projection(*CENTRE))
UTM = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25833"}}


def write(folder: Path, *features, **members) -> Path:
    path = folder / "poles.geojson"
    path.write_text(
        json.dumps({"type": "FeatureCollection", **members, "features": list(features)}),
        "utf-8-sig",
    )
    return path


def pole(x: float, y: float, *more: float, swap: bool = False, **properties):
    longitude, latitude = inverse_project(np.array([[x, y]], float), CENTRE)[0].tolist()
    at = [latitude, longitude] if swap else [longitude, latitude]
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": "Point", "coordinates": [*at, *more]},
    }


def test_a_system_of_a_feature_or_geometry_is_read_too(tmp_path: Path):
    for part in ("feature", "geometry"):
        feature = pole(5.0, 10.0)
        (feature if part == "feature" else feature["geometry"])["crs"] = UTM
        with pytest.raises(
            ValueError, match=r"features\[1\].*crs must be WGS84, got .*25833.*EPSG:4326"
        ):
            load_poles(write(tmp_path, pole(0.0, 0.0), feature), SITE)
    area = {"type": "Polygon", "coordinates": [[[0, 0], [1, 0], [1, 1], [0, 0]]], "crs": UTM}
    with pytest.raises(ValueError, match="crs must be WGS84"):
        load_keep_out(
            write(tmp_path, {"type": "Feature", "properties": {}, "geometry": area}), SITE
        )


@pytest.mark.parametrize(
    "name", ["urn:ogc:def:crs:OGC:1.3:CRS84", "urn:ogc:def:crs:EPSG::4326", "EPSG:4326"]
)
def test_degrees_of_wgs84_under_any_name(tmp_path: Path, name):
    crs = {"type": "name", "properties": {"name": name}}
    (mount,) = load_poles(write(tmp_path, pole(5.0, 10.0, 34.0), crs=crs), SITE)
    assert mount.position == pytest.approx(
        [5.0, 10.0, 0.0], abs=1e-3
    )  # altitudes are those of the site's ground


@pytest.mark.parametrize(
    "name", ["urn:ogc:def:crs:EPSG::4258", "EPSG:3857", "EPSG:43260", "urn:ogc:def:crs:EPSG::31468"]
)
def test_other_systems_are_refused_by_name(tmp_path: Path, name):
    crs = {"type": "name", "properties": {"name": name}}
    with pytest.raises(ValueError, match=f"crs must be WGS84, got .*{name}"):
        load_poles(write(tmp_path, pole(5.0, 10.0), crs=crs), SITE)


def test_latitude_first_is_named(tmp_path: Path):
    with pytest.raises(ValueError, match="longitude comes first"):
        load_poles(write(tmp_path, pole(5.0, 10.0, swap=True)), SITE)


def test_a_feature_without_a_place_is_left_out_and_counted(tmp_path: Path):
    nowhere = {"type": "Feature", "properties": {"name": "planned"}, "geometry": None}
    with pytest.warns(UserWarning, match="2 features have no place"):
        mounts = load_poles(write(tmp_path, nowhere, pole(5.0, 10.0), nowhere), SITE)
    assert len(mounts) == 1


def area(x: float, y: float, kind: str = "Polygon", *, swap: bool = False):
    """A square of 5 m as a feature; of another kind, its outline."""
    corners = np.add([[0.0, 0], [5, 0], [5, 5], [0, 5], [0, 0]], [x, y])
    ring = inverse_project(corners, CENTRE)[:, :: -1 if swap else 1].tolist()
    geometry = {"type": kind, "coordinates": [ring] if kind == "Polygon" else ring}
    return {"type": "Feature", "properties": {}, "geometry": geometry}


def test_areas_elsewhere_do_not_bar_nothing_in_silence(tmp_path: Path):
    """RFC 7946 3.1.1: longitude comes first; an exchanged area bars nothing, so it is refused
    (geopandas#1882)."""
    with pytest.raises(
        ValueError, match=r"features\[1\].geometry has longitude and latitude exchanged"
    ):
        load_keep_out(write(tmp_path, area(0, 0), area(9, 0, swap=True)), SITE)
    with pytest.warns(
        UserWarning, match="none of its 1 keep-out areas is within 300 m of site 'berlin'"
    ):
        load_keep_out(write(tmp_path, area(9000, 0)), SITE)
    flat = area(0, 0)
    line = inverse_project(np.array([[0.0, 0], [5, 0], [9, 0], [0, 0]]), CENTRE).tolist()
    flat["geometry"]["coordinates"] = [line]
    with pytest.raises(ValueError, match="has no area"):
        load_keep_out(write(tmp_path, flat), SITE)


def test_what_is_no_area_or_no_pole_is_counted(tmp_path: Path):
    nowhere = {"type": "Feature", "properties": {}, "geometry": None}
    with pytest.warns(UserWarning, match="2 features are no areas"):
        barred = load_keep_out(
            write(tmp_path, area(0, 0), area(9, 0, "LineString"), pole(1, 1), nowhere), SITE
        )
    assert [round(shape.area, 1) for shape in barred] == [25.0]
    with pytest.warns(UserWarning, match="2 features are lines or areas, so they are no poles"):
        mounts = load_poles(
            write(tmp_path, pole(1, 1), area(0, 9), area(0, 20, "LineString")), SITE
        )
    assert len(mounts) == 1


def test_a_site_is_in_its_metres(tmp_path: Path):
    """A `crs` in a site's file says that another tool took its metres for something else."""
    save_site(SITE, tmp_path / "site.json")
    content = json.loads((tmp_path / "site.json").read_text())
    (tmp_path / "site.json").write_text(json.dumps({**content, "crs": UTM}))
    with pytest.raises(ValueError, match=r"crs must be left out, .* got .*25833"):
        load_site(tmp_path / "site.json")
