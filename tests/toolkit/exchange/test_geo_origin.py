"""Degrees of the world frame's points, against PROJ's topocentric coordinates."""

import numpy as np
import pytest

from toolkit.exchange.geo_origin import GeoOrigin
from toolkit.geometry import pose
from toolkit.sites.georeference import longitude_latitude, projection
from toolkit.sites.site import Site

pyproj = pytest.importorskip("pyproj")


@pytest.mark.parametrize("latitude", [-71.0, 0.0, 48.1])
@pytest.mark.parametrize("turn", [0.0, 2.5])
def test_degrees_are_projs(latitude, turn):
    origin = GeoOrigin(latitude, 179.9995, turn)
    pipeline = pyproj.Transformer.from_pipeline(
        f"+proj=pipeline +step +inv +proj=topocentric +ellps=WGS84 +lat_0={latitude} "
        "+lon_0=179.9995 +h_0=0 +step +inv +proj=cart +ellps=WGS84 +step +proj=unitconvert "
        "+xy_in=rad +xy_out=deg"
    )
    points = np.random.default_rng(2).uniform(-2000, 2000, (40, 3)) * [1, 1, 0.01]
    cosine, sine = np.cos(turn), np.sin(turn)
    east = cosine * points[:, 0] - sine * points[:, 1]
    north = sine * points[:, 0] + cosine * points[:, 1]
    expected = np.column_stack(pipeline.transform(east, north, points[:, 2])[:2])
    np.testing.assert_allclose(origin.degrees(points), expected, atol=1e-10)


def test_a_site_on_a_map_says_where_it_is():
    site = Site(
        "crossing",
        np.array([-25.0, -20, 25, 20]),
        map_SE3_site=pose(600.0, -900.0, yaw=0.6),
        geo_reference=projection(11.5, 48.2),
    )
    origin = GeoOrigin.from_site(site)
    places = np.array([[0.0, 0.0], [80.0, -30.0], [-10.0, 90.0]])
    expected = longitude_latitude(site, places)
    found = origin.degrees(np.column_stack([places, np.zeros(3)]))
    np.testing.assert_allclose(found, expected, atol=2e-8)  # 2 mm
    assert GeoOrigin.from_site(None) is None
    assert GeoOrigin.from_site(Site("nowhere", np.array([-25.0, -20, 25, 20]))) is None


def test_bearings_turn_with_the_world():
    yaws = np.array([0.0, np.pi / 2, -np.pi / 2])
    assert GeoOrigin(0, 0).bearings_deg(yaws).tolist() == [90.0, 0.0, 180.0]
    assert GeoOrigin(0, 0, np.pi / 2).bearings_deg(yaws).round(9).tolist() == [0.0, 270.0, 90.0]


@pytest.mark.parametrize(("latitude", "longitude"), [(90, 0), (11.6, 181), (float("nan"), 0)])
def test_places_that_are_none_are_refused(latitude, longitude):
    with pytest.raises(ValueError, match="must lie within"):
        GeoOrigin(latitude, longitude)
