"""Where on earth a site's places are: site metres ↔ longitude and latitude, headings → compass bearings.

Site → map is `map_SE3_site`; map → earth is the PROJ string `geo_reference`. The transverse Mercator maps that coview
itself makes of OpenStreetMap extracts (`projection`) are computed here, all others by pyproj. North is the map's +y:
the angle between it and true north (grid convergence), 0 at the centre of coview's own maps and up to 3 degrees in UTM,
is ignored.
"""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Any

import numpy as np

from toolkit.arrays import Float, Float64
from toolkit.geometry import invert, transform
from toolkit.sites.site import Site

_EQUATOR, _ECCENTRICITY2 = 6378137.0, 6.69437999014e-3  # WGS84: radius (m), first eccentricity squared
WGS84 = "EPSG:4326"


def longitude_latitude(site: Site, xy: Float[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"] | None:
    """Places of the site frame (m) as degrees of longitude and latitude (WGS84); None where the site does not say where
    on earth it is.

    Raises ValueError where `geo_reference` is no projection or does not reach there; ImportError where it is not one of
    coview's own and pyproj is missing.
    """
    if site.geo_reference is None:
        return None
    xy = np.asarray(xy, np.float64)
    on_map = transform(site.map_SE3_site, np.column_stack([xy, np.zeros(len(xy))]))[:, :2]
    centre = _own_centre(site.geo_reference)
    if centre is not None:
        return inverse_project(on_map, centre)
    return _checked(_transformer(site, site.geo_reference, inverse=True), on_map, site)


def site_metres(site: Site, lon_lat: Float[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
    """Degrees of longitude and latitude (WGS84) as places of the site frame (m).

    Raises ValueError where the site does not say where on earth it is, or as `longitude_latitude`; ImportError too.
    """
    if site.geo_reference is None:
        raise ValueError(
            f"site {site.name!r} does not say where on earth it is (geo_reference): give the site's metres"
        )
    lon_lat = np.asarray(lon_lat, np.float64)
    centre = _own_centre(site.geo_reference)
    if centre is not None:
        on_map = project(lon_lat, centre)
    else:
        on_map = _checked(_transformer(site, site.geo_reference, inverse=False), lon_lat, site)
    return transform(invert(site.map_SE3_site), np.column_stack([on_map, np.zeros(len(on_map))]))[:, :2]


def bearing_deg(site: Site, heading: float) -> float:
    """Compass bearing (degrees in 0..360, clockwise from the map's north) of a heading of the site frame (rad,
    counter-clockwise from +x).

    >>> bearing_deg(Site("example", np.array([0.0, 0, 10, 10])), np.pi)
    270.0
    """
    turn = np.arctan2(site.map_SE3_site[1, 0], site.map_SE3_site[0, 0])
    return round(90.0 - float(np.rad2deg(heading + turn)), 9) % 360.0


def projection(longitude: float, latitude: float) -> str:
    """PROJ string of the transverse Mercator map whose zero is there, true to scale near it."""
    return (
        f"+proj=tmerc +lat_0={latitude:.9g} +lon_0={longitude:.10g} +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m +no_defs"
    )


def project(lon_lat: Float[np.ndarray, "n 2"], centre: tuple[float, float]) -> Float64[np.ndarray, "n 2"]:
    """Degrees → metres of `projection(*centre)`, to 1 mm within 2 km (Snyder, Map Projections, equations 8-9 to 8-15,
    cut after the terms of third order)."""
    longitude, latitude = np.deg2rad(lon_lat).T
    longitude_0, latitude_0 = np.deg2rad(centre)
    sine, cosine = np.sin(latitude), np.cos(latitude)
    normal = _EQUATOR / np.sqrt(1 - _ECCENTRICITY2 * sine**2)
    a = (longitude - longitude_0) * cosine
    t, c = np.tan(latitude) ** 2, _ECCENTRICITY2 / (1 - _ECCENTRICITY2) * cosine**2
    x = normal * (a + (1 - t + c) * a**3 / 6)
    y = _meridian(latitude) - _meridian(latitude_0) + normal * np.tan(latitude) * a**2 / 2
    return np.stack([x, y], axis=1)


def inverse_project(metres: Float[np.ndarray, "n 2"], centre: tuple[float, float]) -> Float64[np.ndarray, "n 2"]:
    """Metres of `projection(*centre)` → degrees, by Newton's method on `project`."""
    guess = np.tile(np.asarray(centre, np.float64), (len(metres), 1))
    for _ in range(5):
        radius = _EQUATOR * np.stack([np.cos(np.deg2rad(guess[:, 1])), np.ones(len(guess))], axis=1)
        guess += np.rad2deg((metres - project(guess, centre)) / radius)
    return guess


def _meridian(latitude: Any) -> Any:
    """Distance along the meridian from the equator (Snyder, equation 3-21)."""
    e2 = _ECCENTRICITY2
    return _EQUATOR * (
        (1 - e2 / 4 - 3 * e2**2 / 64 - 5 * e2**3 / 256) * latitude
        - (3 * e2 / 8 + 3 * e2**2 / 32 + 45 * e2**3 / 1024) * np.sin(2 * latitude)
        + (15 * e2**2 / 256 + 45 * e2**3 / 1024) * np.sin(4 * latitude)
        - 35 * e2**3 / 3072 * np.sin(6 * latitude)
    )


def _own_centre(geo_reference: str) -> tuple[float, float] | None:
    """Longitude and latitude of the zero of a map that `projection` names; None for other maps."""
    zero = re.search(r"\+lat_0=([-+.\de]+) \+lon_0=([-+.\de]+) ", geo_reference)
    centre = (float(zero[2]), float(zero[1])) if zero else None
    return centre if centre is not None and projection(*centre) == geo_reference else None


def _transformer(site: Site, geo_reference: str, *, inverse: bool) -> Any:
    """Between degrees and metres of the site's map; `inverse`: to degrees."""
    try:
        return _proj(geo_reference, inverse)
    except ImportError:
        needs = "needs pyproj: pip install 'coview[report]'"
        raise ImportError(f"the map of site {site.name!r} ({geo_reference}) {needs}", name="pyproj") from None
    except ValueError:
        raise ValueError(
            f"geo_reference of site {site.name!r} names no projection that PROJ knows, got {geo_reference[:90]!r}: "
            "correct it in the site file, or set it to null"
        ) from None


@lru_cache(maxsize=8)  # to make one takes longer than to use it
def _proj(geo_reference: str, inverse: bool) -> Any:
    from pyproj import CRS, Transformer
    from pyproj.exceptions import ProjError

    try:
        crs = CRS.from_user_input(geo_reference)
        if not crs.is_projected:
            raise ValueError("degrees are no map in metres")
        source, target = (crs, WGS84) if inverse else (WGS84, crs)
        return Transformer.from_crs(source, target, always_xy=True)
    except ProjError as error:
        raise ValueError(str(error)) from None


def _checked(transformer: Any, points: np.ndarray, site: Site) -> Float64[np.ndarray, "n 2"]:
    turned = np.stack(transformer.transform(*points.T), axis=1)
    lost = np.flatnonzero(~np.isfinite(turned).all(axis=1))
    if len(lost):
        raise ValueError(
            f"the map of site {site.name!r} ({str(site.geo_reference)[:90]}) does not reach "
            f"{points[lost[0]].tolist()}: correct geo_reference or the coordinates"
        )
    return turned
