"""Sites on earth: site metres ↔ longitude and latitude, compass bearings, and GeoJSON (RFC 7946) for GIS tools.

Site → map is `map_SE3_site`; map → earth is the PROJ string `geo_reference`. The transverse Mercator maps that coview
makes of OpenStreetMap extracts (`projection`) are computed here, all others by pyproj. North is the map's +y: its angle
to true north (grid convergence), 0 at the centre of coview's own maps and up to 3 degrees in UTM, is ignored.

GeoJSON written here is to look at and to draw over; coview itself reads a site's own file (`toolkit.sites.files`).
Outer rings run counter-clockwise and holes clockwise, coordinates have 8 decimals (about 1 mm), the collection has a
bbox, and every feature says what it is as `layer`."""

import json
import re
from collections.abc import Iterable, Iterator
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from shapely.geometry import mapping

from toolkit.arrays import Float, Float64
from toolkit.geometry import invert, transform
from toolkit.sensors.models import name_in_words
from toolkit.sites.site import Mount, Site

if TYPE_CHECKING:
    from pyproj import Transformer

_EQUATOR, _ECCENTRICITY2 = 6378137.0, 6.69437999014e-3  # WGS84: radius (m), first eccentricity squared
WGS84 = "EPSG:4326"


def longitude_latitude(site: Site, xy: Float[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"] | None:
    """Convert site metres to degrees of longitude and latitude (WGS84).

    None if the site has no known place on earth. Raises ValueError if `geo_reference` is no projection or does
    not reach there; ImportError if pyproj is needed and missing."""
    if site.geo_reference is None:
        return None
    xy = np.asarray(xy, np.float64)
    on_map = transform(site.map_SE3_site, np.column_stack([xy, np.zeros(len(xy))]))[:, :2]
    return _convert(site, site.geo_reference, on_map, inverse=True)


def site_metres(site: Site, lon_lat: Float[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
    """Convert degrees of longitude and latitude (WGS84) to site metres. Raises ValueError for a site without a known
    place on earth, and the errors of `longitude_latitude`."""
    if site.geo_reference is None:
        raise ValueError(f"site {site.name!r} does not say where on earth it is (geo_reference): give site metres")
    on_map = _convert(site, site.geo_reference, np.asarray(lon_lat, np.float64), inverse=False)
    return transform(invert(site.map_SE3_site), np.column_stack([on_map, np.zeros(len(on_map))]))[:, :2]


def bearing_deg(site: Site, heading: float) -> float:
    """Compass bearing (degrees in 0..360, clockwise from the map's north) of a heading (rad, from the site's +x)."""
    turn = np.arctan2(site.map_SE3_site[1, 0], site.map_SE3_site[0, 0])
    return round(90.0 - float(np.rad2deg(heading + turn)), 9) % 360.0


def projection(longitude: float, latitude: float) -> str:
    """PROJ string of the transverse Mercator map about a point."""
    origin = f"+lat_0={latitude:.9g} +lon_0={longitude:.10g}"
    return f"+proj=tmerc {origin} +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m +no_defs"


def project(lon_lat: Float[np.ndarray, "n 2"], centre: tuple[float, float]) -> Float64[np.ndarray, "n 2"]:
    """Convert degrees to metres of `projection(*centre)`. Good to 1 mm within 2 km (Snyder, Map Projections, equations
    8-9 to 8-15, cut after the terms of third order)."""
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
    """Convert metres of `projection(*centre)` to degrees, by Newton's method."""
    guess = np.tile(np.asarray(centre, np.float64), (len(metres), 1))
    for _ in range(5):
        radius = _EQUATOR * np.stack([np.cos(np.deg2rad(guess[:, 1])), np.ones(len(guess))], axis=1)
        guess += np.rad2deg((metres - project(guess, centre)) / radius)
    return guess


def _meridian(latitude: float | Float64[np.ndarray, "*n"]) -> float | Float64[np.ndarray, "*n"]:
    """Distance along the meridian from the equator (Snyder, equation 3-21)."""
    e2 = _ECCENTRICITY2
    return _EQUATOR * (
        (1 - e2 / 4 - 3 * e2**2 / 64 - 5 * e2**3 / 256) * latitude
        - (3 * e2 / 8 + 3 * e2**2 / 32 + 45 * e2**3 / 1024) * np.sin(2 * latitude)
        + (15 * e2**2 / 256 + 45 * e2**3 / 1024) * np.sin(4 * latitude)
        - 35 * e2**3 / 3072 * np.sin(6 * latitude)
    )


def _convert(site: Site, reference: str, points: np.ndarray, *, inverse: bool) -> Float64[np.ndarray, "n 2"]:
    """Convert degrees to metres of the site's map; `inverse`: back."""
    zero = re.search(r"\+lat_0=([-+.\de]+) \+lon_0=([-+.\de]+) ", reference)
    centre = (float(zero[2]), float(zero[1])) if zero else None
    if centre is not None and projection(*centre) == reference:  # a map of ours
        return inverse_project(points, centre) if inverse else project(points, centre)
    try:
        turned = np.stack(_proj(reference, inverse).transform(*points.T), axis=1)
    except ImportError:
        needs = "needs pyproj: pip install 'coview[report]'"
        raise ImportError(f"the map of site {site.name!r} ({reference}) {needs}", name="pyproj") from None
    except ValueError:
        unknown = f"geo_reference of site {site.name!r} names no projection that PROJ knows, got {reference[:90]!r}"
        raise ValueError(f"{unknown}: correct it in the site file, or set it to null") from None
    lost = np.flatnonzero(~np.isfinite(turned).all(axis=1))
    if len(lost):
        far = f"the map of site {site.name!r} ({reference[:90]}) does not reach {points[lost[0]].tolist()}"
        raise ValueError(f"{far}: correct geo_reference or the coordinates")
    return turned


@lru_cache(maxsize=8)  # to make one takes longer than to use it
def _proj(geo_reference: str, inverse: bool) -> "Transformer":
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


DEGREE_DECIMALS, METRE_DECIMALS = 8, 3  # of coordinates: 1 mm both
_Json = dict[str, Any]


def site_geojson(site: Site) -> str:
    """GeoJSON of a site in longitude and latitude. Raises ValueError without a place, ImportError without pyproj."""
    if site.geo_reference is None:
        silent = f"site {site.name!r} does not say where on earth it is (geo_reference is null)"
        remedy = "import it from a map that has, or use the site file, which is GeoJSON in metres"
        raise ValueError(f"{silent}, so it has no longitude and latitude: {remedy}")
    return feature_collection(_layers(site), name=site.name)


def feature(site: Site, geometry: shapely.Geometry, **properties: object) -> _Json:
    """GeoJSON feature of points or polygons of the site frame, in degrees, or metres without a place on earth."""
    decimals = METRE_DECIMALS if site.geo_reference is None else DEGREE_DECIMALS

    def moved(xy: np.ndarray) -> np.ndarray:
        degrees = longitude_latitude(site, xy)
        return (xy if degrees is None else degrees).round(decimals) + 0.0

    placed = shapely.orient_polygons(shapely.transform(shapely.force_2d(geometry), moved))
    return {"type": "Feature", "properties": properties, "geometry": mapping(placed)}


def mount_feature(site: Site, mount: Mount, **more: object) -> _Json:
    """GeoJSON feature of a mount, as in files of poles."""
    limits = {"min_height": mount.min_height, "max_height": mount.max_height}
    values = {"name": mount.name, **limits, "price": mount.price, "capacity_kbit": mount.capacity}
    if mount.max_sensors > 1:
        more = {"max_sensors": mount.max_sensors, **more}
    values |= {"origin": mount.origin}
    return feature(site, shapely.Point(mount.position[:2]), layer="mount", **values, **more)


def feature_collection(features: Iterable[_Json], **members: object) -> str:
    """Text of a FeatureCollection with a bbox."""
    kept = list(features)
    lines = ",\n".join(json.dumps(each, allow_nan=False, ensure_ascii=False) for each in kept)
    corners = np.array([shapely.bounds(shapely.geometry.shape(each["geometry"])) for each in kept]).reshape(-1, 4)
    corners = corners[np.isfinite(corners).all(axis=1)]
    box = [*corners[:, :2].min(axis=0).tolist(), *corners[:, 2:].max(axis=0).tolist()] if len(corners) else None
    head = {"type": "FeatureCollection", **members, **({"bbox": box} if box else {})}
    texts = [f"{json.dumps(k)}: {json.dumps(v, allow_nan=False, ensure_ascii=False)}" for k, v in head.items()]
    return "{\n" + ",\n".join(texts) + f',\n"features": [\n{lines}\n]\n}}\n'


def _layers(site: Site) -> Iterator[_Json]:
    yield feature(site, shapely.box(*site.area), layer="area", name=site.name, height=site.height)
    for layer, outlines in (("lane", site.lanes), ("footway", site.footways)):
        for i, outline in enumerate(outlines):
            yield feature(site, shapely.Polygon(outline), layer=layer, name=f"{layer}{i:03}", origin=site.road_origin)
    for i, solid in enumerate(site.solids):
        said = {"name": f"{solid.kind}{i:03}", "kind": solid.kind, "origin": solid.origin, "base": solid.base}
        heights = {"top": solid.top, "height": round(solid.top - solid.base, 6)}
        yield feature(site, shapely.Polygon(solid.footprint), layer="solid", **said, **heights)
    for i, ((x, y, yaw), origin) in enumerate(zip(site.parking.tolist(), site.bay_origins, strict=True)):
        bearing = round(bearing_deg(site, yaw), 1) % 360.0
        yield feature(site, shapely.Point(x, y), layer="parking", name=f"bay{i:03}", bearing_deg=bearing, origin=origin)
    yield from (mount_feature(site, mount) for mount in site.mounts)
    for sensor in site.sensors:
        x, y, z = sensor.world_SE3_body[:3, 0]
        model, spot = name_in_words(type(sensor.model).__name__), sensor.position[:2]
        height = round(float(sensor.position[2] - site.ground(spot)), 3)
        bearing = round(bearing_deg(site, float(np.arctan2(y, x))), 1) % 360.0
        tilt = round(float(np.rad2deg(np.arctan2(-z, np.hypot(x, y)))), 1) + 0.0
        said = {"model": model, "height": height, "bearing_deg": bearing, "tilt_deg": tilt}
        yield feature(site, shapely.Point(spot), layer="sensor", name=sensor.name, **said)
