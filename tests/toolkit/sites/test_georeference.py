"""Places of a site on earth and back, bearings, and maps that are none."""

import builtins
import re
from dataclasses import replace

import numpy as np
import pytest

from toolkit.geometry import pose
from toolkit.sites.files import load_site
from toolkit.sites.georeference import (
    bearing_deg,
    inverse_project,
    longitude_latitude,
    project,
    projection,
    site_metres,
)
from toolkit.sites.site import Site

CENTRE = (13.4, 52.505)
AREA = np.array([-40.0, -30.0, 40.0, 30.0])
TURNED = Site("berlin", AREA, map_SE3_site=pose(3.0, 4.0, 34.0, yaw=np.pi / 2), geo_reference=projection(*CENTRE))
UTM = "+proj=utm +zone=33 +datum=WGS84 +units=m +no_defs"


def test_projection_is_transverse_mercator():
    # Independent figures: one degree of longitude and latitude at 52.505° on WGS84 are 67,922.6 m and 111,268.5 m.
    metres = project(np.array([[13.401, 52.505], [13.4, 52.506], CENTRE]), CENTRE)
    np.testing.assert_allclose(metres, [[67.9, 0.0], [0.0, 111.27], [0, 0]], atol=0.05)
    points = np.random.default_rng(0).uniform(-2000, 2000, (50, 2))
    np.testing.assert_allclose(project(inverse_project(points, CENTRE), CENTRE), points, atol=1e-6)


def test_our_own_projection_is_that_of_proj():
    """Within 2 km to 1 mm, also for southern, western and far northern places."""
    pyproj = pytest.importorskip("pyproj")
    points = np.random.default_rng(1).uniform(-1400, 1400, (50, 2))
    for centre in (CENTRE, (-70.25, -33.5), (179.999, 0.0), (25.7, 69.5)):
        there = pyproj.Transformer.from_crs(projection(*centre), "EPSG:4326", always_xy=True)
        degrees = np.stack(there.transform(*points.T), axis=1)
        assert np.abs((inverse_project(points, centre) - degrees + 180) % 360 - 180).max() < 2e-8, centre


def test_site_places_on_earth_and_back():
    xy = np.array([[0.0, 0.0], [100.0, 0.0], [-4.0, 3.0]])
    degrees = longitude_latitude(TURNED, xy)
    assert degrees is not None
    # x of the site points to the map's north, y to its west; the site's zero is 3 m east and 4 m north of CENTRE
    assert project(degrees, CENTRE) == pytest.approx(np.array([[3.0, 4.0], [3.0, 104.0], [0.0, 0.0]]), abs=1e-6)
    assert degrees[2] == pytest.approx(CENTRE, abs=1e-9)
    assert site_metres(TURNED, degrees) == pytest.approx(xy, abs=1e-6)
    assert longitude_latitude(TURNED, np.zeros((0, 2))) == pytest.approx(np.zeros((0, 2)))


def test_other_projections_through_pyproj():
    pytest.importorskip("pyproj")
    site = Site("utm", AREA, map_SE3_site=pose(500000.0, 4982950.400), geo_reference=UTM)
    degrees = longitude_latitude(site, np.array([[0.0, 0.0], [10.0, 20.0]]))
    assert degrees is not None
    # Independent figures: zone 33 is about 15°; the meridian from the equator to 45° is 4,984,944.378 m, times 0.9996
    assert degrees[0] == pytest.approx([15.0, 45.0], abs=1e-8)
    assert site_metres(site, degrees) == pytest.approx(np.array([[0.0, 0.0], [10.0, 20.0]]), abs=1e-5)


def test_georeference_of_carla_town01():
    """Its map's zero is where equator and Greenwich meet; 1 degree of longitude is 111,319.5 m there."""
    pytest.importorskip("pyproj")
    carla = "+proj=tmerc +lat_0=0 +lon_0=0 +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m +geoidgrids=egm96_15.gtx +vunits=m"
    site = Site("town01", AREA, map_SE3_site=pose(104.0, -196.0), geo_reference=carla)
    degrees = longitude_latitude(site, np.zeros((1, 2)))
    assert degrees == pytest.approx(np.array([[104 / 111319.49, -196 / 110574.28]]), abs=1e-8)


def test_site_that_is_nowhere_on_earth():
    assert longitude_latitude(load_site("tjunction"), np.zeros((2, 2))) is None
    with pytest.raises(ValueError, match=r"site 'tjunction' does not say where on earth it is \(geo_reference\)"):
        site_metres(load_site("tjunction"), np.zeros((2, 2)))


@pytest.mark.parametrize(
    "reference",
    [
        "+lat_0=4.9e+1 +lon_0=8.0",
        "nonsense",
        "",
        "EPSG:4326",
        "+proj=longlat +datum=WGS84",
        "+proj=tmerc +lat_0=x +lon_0=y ",
    ],
)
def test_what_is_no_projection_is_said_so(reference):
    pytest.importorskip("pyproj")
    site = replace(TURNED, geo_reference=reference)
    with pytest.raises(ValueError, match=f"got {re.escape(repr(reference))}: correct it in the site file"):
        longitude_latitude(site, np.zeros((1, 2)))
    with pytest.raises(ValueError, match="names no projection that PROJ knows"):
        site_metres(site, np.zeros((1, 2)))


def test_places_beyond_the_map():
    pytest.importorskip("pyproj")
    site = replace(TURNED, geo_reference="+proj=merc +datum=WGS84")
    with pytest.raises(ValueError, match=r"does not reach \[0.0, 95.0\]"):
        site_metres(site, np.array([[0.0, 0.0], [0.0, 95.0]]))


def test_without_pyproj_only_foreign_maps_are_refused(monkeypatch):
    real = builtins.__import__

    def without(name, *rest):
        if name.startswith("pyproj"):
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    assert longitude_latitude(TURNED, np.zeros((1, 2))) is not None
    with pytest.raises(ImportError, match=r"pip install 'coview\[report\]'"):
        longitude_latitude(replace(TURNED, geo_reference=UTM.replace("33", "31")), np.zeros((1, 2)))


@pytest.mark.parametrize(
    ("heading_deg", "map_yaw_deg", "bearing"),
    [(0, 0, 90), (90, 0, 0), (180, 0, 270), (-90, 0, 180), (45, 0, 45), (0, 90, 0), (90, 90, 270), (450, 0, 0)],
)
def test_bearings_are_clockwise_from_the_maps_north(heading_deg, map_yaw_deg, bearing):
    site = replace(TURNED, map_SE3_site=pose(104.0, -196.0, yaw=np.deg2rad(map_yaw_deg)))
    assert bearing_deg(site, float(np.deg2rad(heading_deg))) == pytest.approx(bearing, abs=1e-9)


def test_a_bearing_is_never_360():
    assert bearing_deg(TURNED, float(np.nextafter(0.0, 1.0))) == 0.0
    assert min(bearing_deg(TURNED, h) for h in np.linspace(-7, 7, 500).tolist()) >= 0
