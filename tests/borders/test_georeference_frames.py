"""Where maps lie on earth: units, axes and datums as PROJ knows them. The oracle is pyproj.

EPSG:2227 is in US survey feet, EPSG:2048 counts to the west and south (EPSG Dataset); a datum that
a PROJ string does not name is guessed by PROJ (proj.org, "ballpark transformation")."""

import warnings

import numpy as np
import pytest

from toolkit.geometry import pose
from toolkit.sites.georeference import doubt_place, doubt_scale, longitude_latitude, site_metres
from toolkit.sites.site import Site

pyproj = pytest.importorskip("pyproj")
AREA = np.array([-40.0, -30.0, 40.0, 30.0])
US_FOOT_M = 1200 / 3937
TOWARDS = {
    "EPSG:2227": (-122.4, 37.75),
    "EPSG:2048": (18.5, -33.9),
    "EPSG:2193": (174.8, -41.3),
    "EPSG:5513": (14.4, 50.1),
    "EPSG:31467": (9.2, 48.8),
    "EPSG:25832+5773": (11.6, 48.1),
    "EPSG:32661": (30.0, 85.0),
    "+proj=utm +zone=32 +datum=WGS84 +units=us-ft": (9.2, 48.8),
    "+proj=tmerc +lon_0=19 +axis=wsu +datum=WGS84": (18.5, -33.9),
}


def place(reference: str, lon_lat: tuple[float, float]) -> Site:
    """A site about a place, with its map's metres to the east and north."""
    crs = pyproj.CRS(reference)
    horizontal = crs.sub_crs_list[0] if crs.is_compound else crs
    at = pyproj.Transformer.from_crs("EPSG:4326", horizontal).transform(*lon_lat[::-1])
    metres = dict.fromkeys(("east", "north"), 0.0)
    for value, axis in zip(at, horizontal.axis_info, strict=False):
        sign = -1 if axis.direction in ("west", "south") and "32661" not in reference else 1
        name = {"west": "east", "south": "north"}.get(axis.direction, axis.direction)
        name = {"N": "north", "E": "east"}[axis.abbrev] if "32661" in reference else name
        metres[name] = sign * value * axis.unit_conversion_factor
    return Site(
        "here", AREA, map_SE3_site=pose(metres["east"], metres["north"]), geo_reference=reference
    )


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("reference", "lon_lat"), TOWARDS.items(), ids=TOWARDS)
def test_units_and_axes_are_those_of_the_map(reference, lon_lat):
    site = place(reference, lon_lat)
    found = longitude_latitude(site, np.zeros((1, 2)))
    assert found is not None
    assert found == pytest.approx(np.array([lon_lat]), abs=2e-8)
    assert site_metres(site, found) == pytest.approx(
        np.zeros((1, 2)), abs=5e-3
    )  # Krovak's inverse is iterated
    if "32661" not in reference:  # about the pole the map's north is not that of the place
        east, north = longitude_latitude(site, np.array([[100.0, 0.0], [0.0, 100.0]])) - found
        geod = pyproj.Geod(ellps="WGS84")
        for step, bearing in ((east, 90.0), (north, 0.0)):
            azimuth, _, metres = geod.inv(*found[0], *(found[0] + step))
            assert metres == pytest.approx(100.0, rel=2e-3)
            assert (azimuth - bearing + 180) % 360 - 180 == pytest.approx(
                0.0, abs=8.0
            )  # grid convergence


@pytest.mark.parametrize(
    ("reference", "off"),
    [
        ("+proj=utm +zone=32 +ellps=bessel +units=m", "some 100 m"),
        ("+proj=utm +zone=32 +ellps=intl", "some 100 m"),
        ("+proj=utm +zone=32 +ellps=GRS80", "2 m"),
        ("+proj=tmerc +lon_0=9 +ellps=bessel +nadgrids=@none_such.gsb,@null", "200 m"),
    ],
)
def test_a_guessed_datum_is_said(reference, off):
    site = Site("here", AREA, map_SE3_site=pose(500000.0, 5400000.0), geo_reference=reference)
    with pytest.warns(UserWarning, match=f"place on earth may be {off} off"):
        longitude_latitude(site, np.zeros((1, 2)))
    assert off in str(doubt_place(reference))


@pytest.mark.parametrize(
    "reference",
    [
        "+proj=utm +zone=32 +ellps=WGS84",
        "+proj=utm +zone=32 +datum=NAD83",
        "+proj=tmerc +lon_0=9 +ellps=bessel +towgs84=598.1,73.7,418.2,0.202,0.045,-2.455,6.7",
        "+proj=merc +a=6378137 +b=6378137 +nadgrids=@null",
        "EPSG:3857",
    ],
)
def test_a_stated_datum_needs_no_word(reference):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert doubt_place(reference) is None


@pytest.mark.parametrize(
    ("reference", "lon_lat", "noted"),
    [
        ("EPSG:3857", (8.0, 49.0), True),
        ("EPSG:32661", (0.0, 62.0), True),
        ("EPSG:2193", (174.8, -41.3), False),
    ],
)
def test_a_map_that_stretches_lengths_says_so(reference, lon_lat, noted):
    """Web Mercator at latitude 49: 100 m are 65.5 m on the ground (Snyder, equation 7-6)."""
    site = place(reference, lon_lat)
    note = doubt_scale(site)
    assert (note is not None) == noted
    if note is not None:
        degrees = longitude_latitude(site, np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0]]))
        assert degrees is not None
        geod = pyproj.Geod(ellps="WGS84")
        lengths = [geod.inv(*degrees[0], *end)[2] for end in degrees[1:]]
        assert f"100 m on it are {max(lengths, key=lambda length: abs(length - 100)):.1f} m" in note


@pytest.mark.parametrize(
    ("reference", "reason"),
    [
        ("EPSG:4326", "a system of degrees"),
        ("+proj=longlat +datum=WGS84", "a system of degrees"),
        ("EPSG:4978", "a Geocentric CRS"),
        ("EPSG:5773", "a Vertical CRS"),
        ('LOCAL_CS["yard",UNIT["metre",1]]', "a local system without a place on earth"),
        (
            "+proj=tmerc +lon_0=9 +ellps=bessel +nadgrids=none_such.gsb",
            "needs the grid none_such.gsb",
        ),
        ("+proj=nothing", "names no projection that PROJ knows"),
    ],
)
def test_what_is_no_map_is_refused_by_name(reference, reason):
    site = Site("here", AREA, geo_reference=reference)
    with pytest.raises(ValueError, match=reason):
        longitude_latitude(site, np.zeros((1, 2)))
