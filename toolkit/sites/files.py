"""Sites as GeoJSON files.

Built-in ones go by name, saved ones by path. The file has one Feature per polygon, mount, sensor and bay; everything
else is a foreign member of the collection. Coordinates are local metres of the site frame, so a GIS tool shows the
plan at the right scale but not at its place on earth; `map_SE3_site` and `geo_reference` say where that is. Polygons
are closed rings without holes; angles degrees.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Collection, Mapping
from dataclasses import Field, fields
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.geometry import LEVEL, pose
from toolkit.runtime.files import read_json, write_text
from toolkit.sensors.models import class_names, find_model_class, make_model
from toolkit.sensors.sensor import Sensor, SensorModel, is_angle
from toolkit.sites import BUILT_IN
from toolkit.sites.site import HYBRID_RADIUS, Mount, Relief, Site, Solid, check_polygon


def load_site(name_or_path: str | Path) -> Site:
    """Load a site by name or path.

    Built-in sites go by name, saved ones by path.

    Raises ValueError, in one line with file, field, rule and value, for a damaged file; FileNotFoundError if neither a
    file nor a built-in site has that name.
    """
    path = Path(name_or_path)
    if str(name_or_path) in BUILT_IN:
        path = Path(__file__).parent / f"{name_or_path}.json"
    if not path.is_file():
        raise FileNotFoundError(f"no site {str(name_or_path)!r}: give a file, or one of {', '.join(BUILT_IN)}")
    content = read_json(path)
    try:
        return parse(content)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def save_site(site: Site, path: str | Path) -> None:
    """Write a site as GeoJSON (local metres) for `load_site`."""
    write_text(path, format_site(site))


VERSION = 1
JsonValue = Any  # of a JSON document, not yet checked
Json = dict[str, JsonValue]


def document(site: Site) -> Json:
    """Build the GeoJSON FeatureCollection of a site, in plain Python."""
    xmin, ymin, xmax, ymax = site.area.tolist()
    features = [
        _polygon([[xmin, ymin], [xmax, ymin], [xmax, ymax], [xmin, ymax]], layer="area"),
        *(_polygon(lane.tolist(), layer="lane") for lane in site.lanes),
        *(_polygon(footway.tolist(), layer="footway") for footway in site.footways),
        *(_polygon(s.footprint.tolist(), layer="solid", kind=s.kind, base=s.base, top=s.top) for s in site.solids),
        *(_point([x, y], layer="parking", heading_deg=_degrees(yaw)) for x, y, yaw in site.parking.tolist()),
        *(_point(m.position.tolist(), layer="mount", **_rest(m, "position")) for m in site.mounts),
        *(
            _point(s.position.tolist(), layer="sensor", name=s.name, **_attitude(s), model=_model(s.model))
            for s in site.sensors
        ),
    ]
    return {
        "type": "FeatureCollection",
        "coview_site": VERSION,
        "name": site.name,
        "height": site.height,
        "hybrid_radius": site.hybrid_radius,
        "relief": _relief(site.relief),
        "map_SE3_site": site.map_SE3_site.tolist(),
        "geo_reference": site.geo_reference,
        "features": features,
        "network": site.network.splitlines() or None,
    }


def format_site(site: Site, *, without: Collection[str] = ()) -> str:
    """Text of `document(site)`, one feature or network line a line. without: members to leave out."""
    members = []
    for key, value in document(site).items():
        if key in without:
            continue
        if key in ("features", "network") and value:
            rows = ",\n".join(json.dumps(row, allow_nan=False) for row in value)
            members.append(f"{json.dumps(key)}: [\n{rows}\n]")
        else:
            members.append(f"{json.dumps(key)}: {json.dumps(value, allow_nan=False)}")
    return "{\n" + ",\n".join(members) + "\n}\n"


def parse(collection: JsonValue) -> Site:
    """Parse a site's FeatureCollection. Raises ValueError that names the field by its path in the document."""
    if not isinstance(collection, dict) or collection.get("type") != "FeatureCollection":
        raise ValueError("type must be 'FeatureCollection': a site is a GeoJSON FeatureCollection written by Site.save")
    version = _member(collection, "coview_site", int, "")
    if version > VERSION:
        raise ValueError(f"coview_site is version {version}, this coview reads up to {VERSION}: install a newer one")
    layers: dict[str, list[JsonValue]] = {layer: [] for layer in _READERS}
    for i, feature in enumerate(_member(collection, "features", list, "")):
        layer, value = _feature(feature, f"features[{i}]")
        layers[layer].append(value)
    if len(layers["area"]) != 1:
        raise ValueError(f"features must hold exactly one of layer 'area', got {len(layers['area'])}")
    relief = _member(collection, "relief", dict, "")
    geo_reference = collection.get("geo_reference")
    if not isinstance(geo_reference, str | None):
        raise ValueError(f"geo_reference must be a PROJ text or null, got {geo_reference!r}")
    return Site(
        name=_member(collection, "name", str, ""),
        area=layers["area"][0],
        height=_number(collection, "height", ""),
        lanes=tuple(layers["lane"]),
        footways=tuple(layers["footway"]),
        solids=tuple(layers["solid"]),
        mounts=tuple(layers["mount"]),
        sensors=tuple(layers["sensor"]),
        parking=np.array(layers["parking"], np.float64).reshape(-1, 3),
        network=_network(collection),
        map_SE3_site=_matrix(collection, "map_SE3_site"),
        geo_reference=geo_reference,
        relief=_read_relief(relief),
        hybrid_radius=_hybrid_radius(collection),
    )


def _relief(relief: Relief) -> Json:
    """Members of a relief; level ground has no slope member."""
    slope = {} if relief.slope == LEVEL else {"slope": list(relief.slope)}
    return {"amplitude": relief.amplitude, "seed": relief.seed} | slope


def _read_relief(relief: Json) -> Relief:
    slope = _numbers(_member(relief, "slope", list, "relief"), 2, "relief.slope") if "slope" in relief else LEVEL
    return Relief(_number(relief, "amplitude", "relief"), _member(relief, "seed", int, "relief"), (slope[0], slope[1]))


def _hybrid_radius(collection: Json) -> float:
    return _number(collection, "hybrid_radius", "") if "hybrid_radius" in collection else HYBRID_RADIUS


def _feature(feature: JsonValue, where: str) -> tuple[str, JsonValue]:
    properties = _member(feature, "properties", dict, where)
    properties = {key: value for key, value in properties.items() if value is not None}  # GIS tools fill columns up
    geometry = _member(feature, "geometry", dict, where)
    layer = _member(properties, "layer", str, f"{where}.properties")
    if layer not in _READERS:
        raise ValueError(f"{where}.properties.layer must be one of {', '.join(_READERS)}, got {layer!r}")
    kind, read, known = _READERS[layer]
    if geometry.get("type") != kind:
        raise ValueError(f"{where}.geometry.type of layer {layer!r} must be {kind!r}, got {geometry.get('type')!r}")
    unknown = sorted(set(properties) - {"layer", *known})
    if unknown:
        raise ValueError(
            f"{where}.properties.{unknown[0]} is unknown to layer {layer!r}: it has {', '.join(known) or 'none'}"
        )
    coordinates = _member(geometry, "coordinates", list, f"{where}.geometry")
    return layer, read(coordinates, properties, where)


def _ring(coordinates: list[JsonValue], where: str) -> np.ndarray:
    if len(coordinates) != 1:
        raise ValueError(
            f"{where}.geometry.coordinates must hold one ring, got {len(coordinates)}: split polygons with holes"
        )
    where = f"{where}.geometry.coordinates"
    ring = coordinates[0]
    if not isinstance(ring, list) or len(ring) < 4 or ring[0] != ring[-1]:
        raise ValueError(f"{where} must be a closed ring of at least three corners: repeat the first corner at the end")
    return check_polygon(ring[:-1], where)


def _read_area(coordinates: list[JsonValue], properties: Json, where: str) -> np.ndarray:
    ring = _ring(coordinates, where)
    (xmin, ymin), (xmax, ymax) = ring.min(axis=0), ring.max(axis=0)
    if len(ring) != 4 or not np.isin(ring, [[xmin, ymin], [xmax, ymax]]).all():
        raise ValueError(
            f"{where}.geometry.coordinates: the area must be a rectangle along x and y, got {ring.tolist()}"
        )
    return np.array([xmin, ymin, xmax, ymax])


def _read_polygon(coordinates: list[JsonValue], properties: Json, where: str) -> np.ndarray:
    return _ring(coordinates, where)


def _read_solid(coordinates: list[JsonValue], properties: Json, where: str) -> Solid:
    footprint = _ring(coordinates, where)
    where = f"{where}.properties"
    base, top = (_number(properties, key, where) for key in ("base", "top"))
    return _name_errors(where, lambda: Solid(footprint, base, top, _member(properties, "kind", str, where)))


def _read_parking(coordinates: list[JsonValue], properties: Json, where: str) -> tuple[float, float, float]:
    x, y = _position(coordinates, 2, where)
    return x, y, float(np.deg2rad(_number(properties, "heading_deg", f"{where}.properties")))


def _read_mount(coordinates: list[JsonValue], properties: Json, where: str) -> Mount:
    position = np.array(_position(coordinates, 3, where))
    where = f"{where}.properties"
    name = _member(properties, "name", str, where)
    numbers: dict[str, JsonValue] = {k: _number(properties, k, where) for k in properties if k not in ("layer", "name")}
    return _name_errors(where, lambda: Mount(name, position, **numbers))


def _read_sensor(coordinates: list[JsonValue], properties: Json, where: str) -> Sensor:
    x, y, z = _position(coordinates, 3, where)
    where = f"{where}.properties"
    heading, tilt, roll = (np.deg2rad(_number(properties, f"{key}_deg", where)) for key in ("heading", "tilt", "roll"))
    model = _read_model(_member(properties, "model", dict, where), f"{where}.model")
    world_SE3_body = pose(x, y, z, yaw=heading, pitch=tilt, roll=roll)
    return Sensor(_member(properties, "name", str, where), model, world_SE3_body @ model.body_SE3_sensor)


def _read_model(properties: Json, where: str) -> SensorModel:
    kind = _member(properties, "type", str, where)
    if kind not in class_names():
        raise ValueError(f"{where}.type must be one of {', '.join(class_names())}, got {kind[:60]!r}")
    known = {_written(f): f for f in fields(find_model_class(kind))}
    values: dict[str, JsonValue] = {}
    for key in properties:
        if key not in ("type", *known):
            raise ValueError(f"{where}.{key} is unknown to {kind}: it has {', '.join(known)}")
        if key != "type":
            values[known[key].name] = _read_field(known[key], properties, key, where)
    return _name_errors(where, lambda: make_model(kind, values))


def _read_field(entry: Field[Any], properties: Json, key: str, where: str) -> JsonValue:
    """Read a field of a sensor model. It gets the type of its default."""
    if isinstance(entry.default, str):
        return _member(properties, key, str, where)
    if isinstance(entry.default, bool) and isinstance(properties[key], bool):
        return properties[key]
    if isinstance(entry.default, int):
        return _member(properties, key, int, where)
    if isinstance(properties[key], list) and not isinstance(entry.default, float):
        numbers = _numbers(properties[key], len(properties[key]), f"{where}.{key}")
        return tuple(np.deg2rad(numbers).tolist() if is_angle(entry) else numbers)
    number = _number(properties, key, where)
    return float(np.deg2rad(number)) if is_angle(entry) else number


_READERS: Mapping[str, tuple[str, Callable[[list[JsonValue], Json, str], JsonValue], tuple[str, ...]]] = {
    "area": ("Polygon", _read_area, ()),
    "lane": ("Polygon", _read_polygon, ()),
    "footway": ("Polygon", _read_polygon, ()),
    "solid": ("Polygon", _read_solid, ("kind", "base", "top")),
    "parking": ("Point", _read_parking, ("heading_deg",)),
    "mount": ("Point", _read_mount, ("name", "min_height", "max_height", "price", "capacity", "max_sensors")),
    "sensor": ("Point", _read_sensor, ("name", "heading_deg", "tilt_deg", "roll_deg", "model")),
}


def _name_errors(where: str, build: Callable[[], JsonValue]) -> JsonValue:
    try:
        return build()
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def _member(container: JsonValue, key: str, kind: type, where: str) -> JsonValue:
    path = f"{where}.{key}" if where else key
    if not isinstance(container, dict):
        raise ValueError(f"{where} must be an object {{...}}, got {str(container)[:60]}")
    if key not in container:
        raise ValueError(f"{path} is missing: add it, or save the site again")
    value = container[key]
    if not isinstance(value, kind) or isinstance(value, bool):
        raise ValueError(f"{path} must be {_WORDS[kind]}, got {str(value)[:60]!r}")
    return value


_WORDS = {str: "a text", int: "a whole number", float: "a number", list: "a list", dict: "an object {...}"}


def _number(container: Json, key: str, where: str) -> float:
    path = f"{where}.{key}" if where else key
    value = container.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= sys.float_info.max:
        raise ValueError(f"{path} must be a finite number, got {str(value)[:60]}")
    return float(value)


def _position(coordinates: list[JsonValue], dimensions: int, where: str) -> list[float]:
    return _numbers(coordinates, dimensions, f"{where}.geometry.coordinates")


def _numbers(row: list[JsonValue], count: int, where: str) -> list[float]:
    if len(row) != count:
        raise ValueError(f"{where} must be {count} numbers, got {len(row)}")
    return [_number({str(i): value}, str(i), where) for i, value in enumerate(row)]


def _matrix(container: Json, key: str) -> np.ndarray:
    rows = _member(container, key, list, "")
    try:
        return np.array(rows, np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{key} must be four rows of four numbers, got {str(rows)[:60]}") from None


def _network(collection: Json) -> str:
    if collection.get("network", ...) is None:
        return ""
    lines = _member(collection, "network", list, "")
    if not lines or not all(isinstance(line, str) for line in lines):
        raise ValueError("network must be the lines of a SUMO net.xml, or null for a site without traffic")
    return "\n".join(lines) + "\n"


def _polygon(corners: list[list[float]], **properties: JsonValue) -> Json:
    geometry = {"type": "Polygon", "coordinates": [[*corners, corners[0]]]}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def _point(coordinates: list[float], **properties: JsonValue) -> Json:
    return {"type": "Feature", "properties": properties, "geometry": {"type": "Point", "coordinates": coordinates}}


def _rest(mount: Mount, *left_out: str) -> Json:
    """Fields of a mount; max_sensors only if above 1."""
    left_out = left_out if mount.max_sensors > 1 else (*left_out, "max_sensors")
    return {f.name: getattr(mount, f.name) for f in fields(mount) if f.name not in left_out}


def _model(model: SensorModel) -> Json:
    values = [(f, getattr(model, f.name)) for f in fields(model)]
    members = {_written(f): _written_value(f, value) for f, value in values if value is not None}
    return {"type": type(model).__name__, **members}


def _written_value(entry: Field[Any], value: JsonValue) -> JsonValue:
    if is_angle(entry):
        return [_degrees(each) for each in value] if isinstance(value, tuple) else _degrees(value)
    return list(value) if isinstance(value, tuple) else value


def _written(entry: Field[Any]) -> str:
    return f"{entry.name}_deg" if is_angle(entry) else entry.name


def _attitude(sensor: Sensor) -> Json:
    """Heading, tilt and roll (degrees) of a sensor's body.

    The body has x forward, y left, z up; tilt counts below the horizon.
    """
    world_SE3_body = sensor.world_SE3_body
    forward, left, up = world_SE3_body[:3, 0], world_SE3_body[:3, 1], world_SE3_body[:3, 2]
    across = float(np.hypot(forward[0], forward[1]))
    tilt = np.arctan2(-forward[2], across)
    if across < 1e-9:  # straight up or down: heading and roll turn about one axis, so roll is zero
        return {"heading_deg": _degrees(np.arctan2(-left[0], left[1])), "tilt_deg": _degrees(tilt), "roll_deg": 0.0}
    heading, roll = np.arctan2(forward[1], forward[0]), np.arctan2(left[2], up[2])
    return {"heading_deg": _degrees(heading), "tilt_deg": _degrees(tilt), "roll_deg": _degrees(roll)}


def _degrees(angle: float) -> float:
    """Convert an angle to degrees. It is rounded so that radians and back give the same number."""
    return round(float(np.rad2deg(angle)), 9) + 0.0
