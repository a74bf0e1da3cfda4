"""Sites for GIS tools: GeoJSON in longitude and latitude (RFC 7946), shown where they are on earth.

A site's own file (`toolkit.sites.geojson`) is in its metres, which keep every millimetre, and is what coview reads.
What is written here is to look at and to draw over: outer rings run counter-clockwise and holes clockwise, coordinates
have 8 decimals (about 1 mm), the collection has a bbox, and every feature says what it is as `layer`.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import shapely
from shapely.geometry import mapping
from shapely.geometry.polygon import orient

from toolkit.sensors.models import name_in_words
from toolkit.sensors.sensor import Sensor
from toolkit.sites.georeference import bearing_deg, longitude_latitude
from toolkit.sites.site import Mount, Site

DEGREE_DECIMALS, METRE_DECIMALS = 8, 3  # of coordinates: 1 mm both
_Json = dict[str, Any]


def site_geojson(site: Site) -> str:
    """The text of a site's GeoJSON in longitude and latitude.

    Raises ValueError where the site does not say where on earth it is; ImportError where its map needs pyproj.
    """
    if site.geo_reference is None:
        raise ValueError(
            f"site {site.name!r} does not say where on earth it is (geo_reference is null), so it has no longitude and "
            "latitude: import it from a map that has, or use the site file, which is GeoJSON in metres"
        )
    return feature_collection(_layers(site), name=site.name)


def feature(site: Site, geometry: shapely.Geometry, **properties: Any) -> _Json:
    """A GeoJSON feature of points or polygons of the site frame: in longitude and latitude, in the site's metres where
    it does not say where on earth it is."""
    decimals = METRE_DECIMALS if site.geo_reference is None else DEGREE_DECIMALS

    def moved(xy: np.ndarray) -> np.ndarray:
        degrees = longitude_latitude(site, xy)
        return (xy if degrees is None else degrees).round(decimals) + 0.0

    placed = shapely.transform(shapely.force_2d(geometry), moved)
    if isinstance(placed, shapely.Polygon):
        placed = orient(placed)
    elif isinstance(placed, shapely.MultiPolygon):
        placed = shapely.MultiPolygon([orient(part) for part in placed.geoms])
    return {"type": "Feature", "properties": properties, "geometry": mapping(placed)}


def mount_feature(site: Site, mount: Mount, **more: Any) -> _Json:
    """A pole; files of poles have its properties under the same names."""
    limits = {"min_height": mount.min_height, "max_height": mount.max_height}
    values = {"name": mount.name, **limits, "price": mount.price, "capacity_kbit": mount.capacity}
    if mount.max_sensors > 1:
        more = {"max_sensors": mount.max_sensors, **more}
    return feature(site, shapely.Point(mount.position[:2]), layer="mount", **values, **more)


def feature_collection(features: Iterable[_Json], **members: Any) -> str:
    """The text of a FeatureCollection with the bbox of its features, one of them to a line."""
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
    for i, lane in enumerate(site.lanes):
        yield feature(site, shapely.Polygon(lane), layer="lane", name=f"lane{i:03}")
    for i, footway in enumerate(site.footways):
        yield feature(site, shapely.Polygon(footway), layer="footway", name=f"footway{i:03}")
    for i, solid in enumerate(site.solids):
        heights = {"base": solid.base, "top": solid.top, "height": round(solid.top - solid.base, 6)}
        name = f"{solid.kind}{i:03}"
        yield feature(site, shapely.Polygon(solid.footprint), layer="solid", name=name, kind=solid.kind, **heights)
    for i, (x, y, yaw) in enumerate(site.parking.tolist()):
        bearing = _tenth(bearing_deg(site, yaw))
        yield feature(site, shapely.Point(x, y), layer="parking", name=f"bay{i:03}", bearing_deg=bearing)
    yield from (mount_feature(site, mount) for mount in site.mounts)
    yield from (_sensor(site, sensor) for sensor in site.sensors)


def _sensor(site: Site, sensor: Sensor) -> _Json:
    forward = sensor.world_SE3_body[:3, 0]
    bearing = bearing_deg(site, float(np.arctan2(forward[1], forward[0])))
    tilt = float(np.rad2deg(np.arctan2(-forward[2], np.hypot(forward[0], forward[1]))))
    height = float(sensor.position[2] - site.ground(sensor.position[:2]))
    return feature(
        site,
        shapely.Point(sensor.position[:2]),
        layer="sensor",
        name=sensor.name,
        model=name_in_words(type(sensor.model).__name__),
        height=round(height, 3),
        bearing_deg=_tenth(bearing),
        tilt_deg=round(tilt, 1) + 0.0,
    )


def _tenth(bearing: float) -> float:
    """A bearing to 0.1 degree, which is never 360."""
    return round(bearing, 1) % 360.0
