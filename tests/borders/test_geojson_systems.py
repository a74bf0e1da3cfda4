"""GeoJSON of poles: systems, orders and missing places (RFC 7946; `crs` as in the specification of 2008, section 3)."""

import json
from pathlib import Path

import numpy as np
import pytest

from placement_env.candidates.poles import load_keep_out, load_poles
from toolkit.sites.georeference import inverse_project, projection
from toolkit.sites.site import Site

CENTRE = (13.4, 52.505)
SITE = Site("berlin", np.array([-40.0, -30.0, 40.0, 30.0]), geo_reference=projection(*CENTRE))
UTM = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25833"}}


def write(folder: Path, *features, **members) -> Path:
    path = folder / "poles.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", **members, "features": list(features)}), "utf-8-sig")
    return path


def pole(x: float, y: float, *more: float, swap: bool = False, **properties):
    longitude, latitude = inverse_project(np.array([[x, y]]), CENTRE)[0].tolist()
    at = [latitude, longitude] if swap else [longitude, latitude]
    return {"type": "Feature", "properties": properties, "geometry": {"type": "Point", "coordinates": [*at, *more]}}


def test_a_system_of_a_feature_or_geometry_is_read_too(tmp_path: Path):
    for part in ("feature", "geometry"):
        feature = pole(5.0, 10.0)
        (feature if part == "feature" else feature["geometry"])["crs"] = UTM
        with pytest.raises(ValueError, match=r"features\[1\].*crs must be WGS84, got .*25833.*EPSG:4326"):
            load_poles(write(tmp_path, pole(0.0, 0.0), feature), SITE)
    area = {"type": "Polygon", "coordinates": [[[0, 0], [1, 0], [1, 1], [0, 0]]], "crs": UTM}
    with pytest.raises(ValueError, match="crs must be WGS84"):
        load_keep_out(write(tmp_path, {"type": "Feature", "properties": {}, "geometry": area}), SITE)


@pytest.mark.parametrize("name", ["urn:ogc:def:crs:OGC:1.3:CRS84", "urn:ogc:def:crs:EPSG::4326", "EPSG:4326"])
def test_degrees_of_wgs84_under_any_name(tmp_path: Path, name):
    crs = {"type": "name", "properties": {"name": name}}
    (mount,) = load_poles(write(tmp_path, pole(5.0, 10.0, 34.0), crs=crs), SITE)
    assert mount.position == pytest.approx([5.0, 10.0, 0.0], abs=1e-3)  # altitudes are those of the site's ground


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
