"""Sites as GeoJSON files. Built-in ones go by name, saved ones by path.

The file has one Feature per polygon, mount, sensor and bay; everything else is a foreign member of
the collection. Coordinates are local metres of the site frame, so a GIS tool shows the plan at the
right scale but not at its place on earth; `map_SE3_site` and `geo_reference` say where that is.
Polygons are closed rings without holes; angles degrees. Sensors and bays have a `heading_deg`
(counter-clockwise from the site's +x), or a `bearing_deg` that a person wrote (clockwise from the
map's north).

Solids, mounts and bays have an `origin`, and the road a `road_origin`: mapped, surveyed or drawn.
Anything without an origin is mapped. Old files have no origins, so all that an import drew into
them counts as mapped."""

import json
from collections.abc import Collection, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.arrays import Float64
from toolkit.geometry import LEVEL, check_pose, pose
from toolkit.runtime.json_object import Json, JsonObject
from toolkit.runtime.reading import name_errors
from toolkit.runtime.text_values import read_json
from toolkit.runtime.writing import write_text
from toolkit.sensors.models import class_names, find_model_class, make_model
from toolkit.sensors.sensor import Sensor, SensorModel, find_angles
from toolkit.sites import BUILT_IN
from toolkit.sites.georeference import map_turn
from toolkit.sites.site import HYBRID_RADIUS_M, ORIGINS, Mount, Relief, Site, Solid, check_polygon

VERSION = 1  # version of the file format
_MAX_SITE_SENSORS = 10_000
_MAX_TILT_DEG = 90.0  # below or above the horizon
_MIN_LEVEL_LENGTH = 1e-9  # a unit vector with less length on the ground plane is vertical
JsonValue = Any  # value in a JSON document, not yet checked
# layers of features: names of their properties
_LAYERS: Mapping[str, tuple[str, ...]] = {
    "area": (),
    "lane": (),
    "footway": (),
    "solid": ("kind", "base", "top", "origin"),
    "parking": ("heading_deg", "origin"),
    "mount": ("name", "min_height", "max_height", "price", "capacity", "max_sensors", "origin"),
    "sensor": ("name", "heading_deg", "tilt_deg", "roll_deg", "model"),
}
_POINT_LAYERS = ("parking", "mount", "sensor")  # all others are polygons


def load_site(name_or_path: str | Path) -> Site:
    """Load a built-in site by its name, or a saved site by its path.

    Raises ValueError, in one line with file, field, rule and value, for a damaged file, and
    FileNotFoundError if neither a file nor a built-in site has that name."""
    path = Path(name_or_path)
    if str(name_or_path) in BUILT_IN:
        path = Path(__file__).parent / f"{name_or_path}.json"
    if path.is_dir() and (path / "site.json").is_file():
        raise FileNotFoundError(f"{path} is a folder, no site: give the file {path / 'site.json'}")
    if not path.is_file():
        raise FileNotFoundError(
            f"no site {str(name_or_path)!r}: give a file, or one of {', '.join(BUILT_IN)}"
        )
    if path.name.lower().endswith((".osm", ".osm.gz", ".osm.pbf", ".xodr")):
        option = "opendrive" if path.suffix.lower() == ".xodr" else "osm"
        command = f"coview site import --{option} {path} --centre X Y --size 80 60 --out site.json"
        raise ValueError(f"{path} is a map, of which a site must be made first: {command}")
    if path.suffix.lower() in (".hdf5", ".h5", ".bag", ".mcap"):
        raise ValueError(
            f"{path} is a recording, no site: give the file of its site, or one of "
            f"{', '.join(BUILT_IN)}"
        )
    content = read_json(path)
    with name_errors(path):  # errors begin with the path
        return parse(content)


def save_site(site: Site, path: str | Path) -> None:
    """Write a site as a GeoJSON file in local metres, which `load_site` reads."""
    write_text(path, format_site(site))


def document(site: Site) -> Json:
    """Build the GeoJSON FeatureCollection of a site as dicts, lists, texts and numbers.

    Features: the area, then lanes, footways, solids, bays, mounts and sensors, each in the site's
    order. Origins, the slope, `furnished` and a mount's `max_sensors` are left out at their
    defaults, which `parse` fills in."""
    xmin, ymin, xmax, ymax = site.area.tolist()
    features = [_polygon([[xmin, ymin], [xmax, ymin], [xmax, ymax], [xmin, ymax]], layer="area")]
    features += [_polygon(lane.tolist(), layer="lane") for lane in site.lanes]
    features += [_polygon(footway.tolist(), layer="footway") for footway in site.footways]
    for solid in site.solids:
        properties = {
            "kind": solid.kind,
            "base": solid.base,
            "top": solid.top,
            **_origin(solid.origin),
        }
        features.append(_polygon(solid.footprint.tolist(), layer="solid", **properties))
    for (x, y, yaw), origin in zip(site.parking.tolist(), site.bay_origins, strict=True):
        features.append(
            _point([x, y], layer="parking", heading_deg=_degrees(yaw), **_origin(origin))
        )
    for mount in site.mounts:
        left_out = (
            ("position", "origin")
            if mount.max_sensors > 1
            else ("position", "origin", "max_sensors")
        )
        members = {f.name: getattr(mount, f.name) for f in fields(mount) if f.name not in left_out}
        features.append(
            _point(mount.position.tolist(), layer="mount", **members, **_origin(mount.origin))
        )
    for sensor in site.sensors:
        members_of_sensor = {**format_attitude(sensor), "model": format_model(sensor.model)}
        features.append(
            _point(sensor.position.tolist(), layer="sensor", name=sensor.name, **members_of_sensor)
        )
    relief = {"amplitude": site.relief.amplitude, "seed": site.relief.seed}
    return {
        "type": "FeatureCollection",
        "coview_site": VERSION,
        "name": site.name,
        "height": site.height,
        "hybrid_radius": site.hybrid_radius,
        "relief": relief
        if site.relief.slope == LEVEL
        else {**relief, "slope": list(site.relief.slope)},
        "map_SE3_site": site.map_SE3_site.tolist(),
        "geo_reference": site.geo_reference,
        **({} if site.road_origin == "mapped" else {"road_origin": site.road_origin}),
        **({} if site.furnished == "none" else {"furnished": site.furnished}),
        "features": features,
        "network": site.network.splitlines() or None,
    }


def format_site(site: Site, *, without: Collection[str] = ()) -> str:
    """JSON text of a site's document, with each feature and each line of the network on a line.

    without: names of members of the document to leave out."""
    members = []
    for key, value in document(site).items():
        if key in ("features", "network") and value:
            rows = [json.dumps(row, allow_nan=False) for row in value]
            text = "[\n" + ",\n".join(rows) + "\n]"
        else:
            text = json.dumps(value, allow_nan=False)
        if key not in without:
            members.append(f"{json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(members) + "\n}\n"


def parse(collection: JsonValue) -> Site:
    """Build the site of a FeatureCollection that was read from JSON.

    collection: any JSON value, which is checked in full. Raises ValueError that names the field by
    its path in the document, such as `features[3].properties.kind`."""
    root = _check_collection(collection)
    members = root.value
    matrix = _read_matrix(root)
    layers = _read_layers(root, matrix)
    relief = root.node("relief")
    rise, across = relief.numbers("slope", 2) if "slope" in relief.value else LEVEL
    geo_reference = members.get("geo_reference")
    if not isinstance(geo_reference, str | None):
        raise ValueError(f"geo_reference must be a PROJ text or null, got {geo_reference!r}")
    lines = _read_network(root)
    return Site(
        name=root.get("name", str),
        area=layers["area"][0],
        height=root.number("height"),
        lanes=tuple(layers["lane"]),
        footways=tuple(layers["footway"]),
        solids=tuple(layers["solid"]),
        mounts=tuple(layers["mount"]),
        sensors=tuple(layers["sensor"]),
        parking=np.array([bay for bay, _ in layers["parking"]], np.float64).reshape(-1, 3),
        parking_origins=tuple(origin for _, origin in layers["parking"]),
        road_origin=root.get("road_origin", str) if "road_origin" in members else "mapped",
        furnished=root.get("furnished", str) if "furnished" in members else "none",
        network="".join(f"{line}\n" for line in lines),
        map_SE3_site=matrix,
        geo_reference=geo_reference,
        relief=Relief(relief.number("amplitude"), relief.get("seed", int), (rise, across)),
        hybrid_radius=root.number("hybrid_radius")
        if "hybrid_radius" in members
        else HYBRID_RADIUS_M,
    )


def _check_collection(collection: JsonValue) -> JsonObject:
    """Return the root of a site's document.

    Raises ValueError for another document, a frame of its own, and a newer version."""
    if not isinstance(collection, dict) or collection.get("type") != "FeatureCollection":
        raise ValueError(
            "type must be 'FeatureCollection': a site is a GeoJSON FeatureCollection written by "
            "Site.save"
        )
    if collection.get("crs") is not None:
        system = str(collection["crs"])[:90]
        raise ValueError(
            "crs must be left out, as a site is in metres of its frame (geo_reference), got "
            f"{system}"
        )
    root = JsonObject(collection)
    version = root.get("coview_site", int)
    if version > VERSION:
        raise ValueError(
            f"coview_site is version {version}, this coview reads up to {VERSION}: install a "
            "newer one"
        )
    return root


def _read_layers(
    root: JsonObject, matrix: Float64[np.ndarray, "..."]
) -> dict[str, list[JsonValue]]:
    """Values of the features of each layer, by the name of the layer.

    matrix: pose of the site in its map. Raises ValueError without exactly one area."""
    layers: dict[str, list[JsonValue]] = {layer: [] for layer in _LAYERS}
    for i, feature in enumerate(root.get("features", list)):
        layer, value = _read_feature(JsonObject(feature, f"features[{i}]"), matrix)
        layers[layer].append(value)
        if len(layers["sensor"]) > _MAX_SITE_SENSORS:
            raise ValueError(
                f"features must hold at most {_MAX_SITE_SENSORS} sensors: leave some out"
            )
    if len(layers["area"]) != 1:
        raise ValueError(
            f"features must hold exactly one of layer 'area', got {len(layers['area'])}"
        )
    return layers


def _read_network(root: JsonObject) -> list[JsonValue]:
    """Lines of the network of a site's document, none for null."""
    # only null is no network: a missing member, ... here, is an error of `root.get`
    if root.value.get("network", ...) is None:
        return []
    lines = root.get("network", list)
    if not lines or not all(isinstance(line, str) for line in lines):
        raise ValueError(
            "network must be the lines of a SUMO net.xml, or null for a site without traffic"
        )
    return list(lines)


def _read_matrix(root: JsonObject) -> Float64[np.ndarray, "..."]:
    """Array of the member `map_SE3_site` of a site's document.

    It may have any shape and values: `Site` checks them."""
    rows = root.get("map_SE3_site", list)
    try:
        return np.array(rows, np.float64)
    except (TypeError, ValueError):
        raise ValueError(
            f"map_SE3_site must be four rows of four numbers, got {str(rows)[:60]}"
        ) from None


def _replace_bearing(properties: JsonObject, matrix: Float64[np.ndarray, "..."]) -> None:
    """Replace `bearing_deg` of properties in place by the same direction as `heading_deg`.

    The bearing is clockwise from the map's north, the heading counter-clockwise from the site's +x.
    matrix: the document's `map_SE3_site`, not yet checked. Raises ValueError if there is a
    `heading_deg` already."""
    if "heading_deg" in properties.value:
        where = properties.where("bearing_deg")
        raise ValueError(f"{where} and heading_deg are two directions: leave one of them out")
    properties.angle("bearing_deg")  # raises if it is no number or too large; its result is rad
    # direction of the site's x axis on the map, counter-clockwise from the map's east
    turn_deg = float(np.rad2deg(map_turn(check_pose(matrix, "map_SE3_site"))))
    bearing_deg = properties.value.pop("bearing_deg")
    properties.value["heading_deg"] = 90.0 - bearing_deg - turn_deg


def _read_feature(feature: JsonObject, matrix: Float64[np.ndarray, "..."]) -> tuple[str, JsonValue]:
    """Layer of a GeoJSON feature ("lane", "solid", ...), and its value, such as a Solid.

    matrix: the document's `map_SE3_site`, for bearings."""
    properties = feature.node("properties")
    geometry = feature.node("geometry")
    # GIS tools write null for members that other features of a file have
    properties.value = {
        name: value for name, value in properties.value.items() if value is not None
    }
    layer = properties.get("layer", str)
    if layer not in _LAYERS:
        where = properties.where("layer")
        raise ValueError(f"{where} must be one of {', '.join(_LAYERS)}, got {layer!r}")
    known_names = _LAYERS[layer]
    if "bearing_deg" in properties.value and "heading_deg" in known_names:
        _replace_bearing(properties, matrix)
    needed_type = "Point" if layer in _POINT_LAYERS else "Polygon"
    geometry_type = geometry.value.get("type")
    if geometry_type != needed_type:
        where = geometry.where("type")
        rule = f"must be {needed_type!r}, got {geometry_type!r}"
        raise ValueError(f"{where} of layer {layer!r} {rule}")
    unknown_names = sorted(set(properties.value) - {"layer", *known_names})
    if unknown_names:
        where = properties.where(unknown_names[0])
        names = ", ".join(known_names) or "none"
        raise ValueError(f"{where} is unknown to layer {layer!r}: it has {names}")
    return layer, _read_geometry(layer, geometry, properties)


def _read_geometry(layer: str, geometry: JsonObject, properties: JsonObject) -> JsonValue:
    """Read the value of a feature of a layer in `_LAYERS`, and check it.

    geometry, properties: the feature's members of these names. Returns an array for the area, a
    lane or a footway, a Solid, Mount or Sensor, and for a parking bay its x, y, yaw and its
    origin."""
    if layer == "area":
        return _read_area(geometry)
    if layer in ("lane", "footway"):
        return _read_ring(geometry)
    if layer == "solid":
        return _read_solid(geometry, properties)
    if layer == "parking":
        return _read_parking(geometry, properties)
    if layer == "mount":
        return _read_mount(geometry, properties)
    return _read_sensor(geometry, properties)


def _read_ring(geometry: JsonObject) -> Float64[np.ndarray, "k 2"]:
    """Corners x, y (m) of a GeoJSON polygon without holes, the repeated last corner left out."""
    coordinates = geometry.get("coordinates", list)
    where = geometry.where("coordinates")  # path in the document, for errors
    if len(coordinates) != 1:
        raise ValueError(
            f"{where} must hold one ring, got {len(coordinates)}: split polygons with holes"
        )
    ring = coordinates[0]
    if not isinstance(ring, list) or len(ring) < 4 or ring[0] != ring[-1]:
        raise ValueError(
            f"{where} must be a closed ring of at least three corners: repeat the first corner at "
            "the end"
        )
    return check_polygon(ring[:-1], where)


def _read_area(geometry: JsonObject) -> Float64[np.ndarray, "4"]:
    """Area xmin ymin xmax ymax (m) of a GeoJSON polygon, a rectangle along x and y."""
    ring = _read_ring(geometry)
    (xmin, ymin), (xmax, ymax) = ring.min(axis=0), ring.max(axis=0)
    if len(ring) != 4 or not np.isin(ring, [[xmin, ymin], [xmax, ymax]]).all():
        where = geometry.where("coordinates")
        raise ValueError(
            f"{where}: the area must be a rectangle along x and y, got {ring.tolist()}"
        )
    return np.array([xmin, ymin, xmax, ymax])


def _read_solid(geometry: JsonObject, properties: JsonObject) -> Solid:
    """Build the solid of a feature with the footprint `geometry`.

    properties: base and top (m), kind and origin. Errors name their path in the document."""
    footprint = _read_ring(geometry)
    base = properties.number("base")
    top = properties.number("top")
    kind = properties.get("kind", str)
    origin = _read_origin(properties)
    with name_errors(properties.path):
        return Solid(footprint, base=base, top=top, kind=kind, origin=origin)


def _read_parking(
    geometry: JsonObject, properties: JsonObject
) -> tuple[tuple[float, float, float], str]:
    """Bay x, y (m), yaw (rad), and its origin."""
    x, y = geometry.numbers("coordinates", 2)
    return (x, y, properties.angle("heading_deg")), _read_origin(properties)


def _read_origin(properties: JsonObject) -> str:
    """Origin of a feature (mapped, surveyed or drawn), "mapped" if it states none.

    properties: the feature's. Raises ValueError for another origin."""
    if "origin" not in properties.value:
        return "mapped"
    origin: str = properties.get("origin", str)
    if origin not in ORIGINS:
        where = properties.where("origin")
        raise ValueError(f"{where} must be one of {', '.join(ORIGINS)}, got {origin[:60]!r}")
    return origin


def _read_mount(geometry: JsonObject, properties: JsonObject) -> Mount:
    """Build the mount of a feature, with its foot at the feature's x, y, z (m, site frame).

    Raises ValueError, which begins with the path of the properties, for wrong values."""
    position = np.array(geometry.numbers("coordinates", 3))
    name = properties.get("name", str)
    # heights, price and the like; those that a file leaves out have their defaults in `Mount`
    fields_by_name: Json = {
        key: properties.number(key)
        for key in properties.value
        if key not in ("layer", "name", "origin")
    }
    with name_errors(properties.path):  # errors begin with the path of the properties
        return Mount(name, position, origin=_read_origin(properties), **fields_by_name)


def _read_sensor(geometry: JsonObject, properties: JsonObject) -> Sensor:
    """Sensor at x, y, z (m, site frame)."""
    model = read_model(properties.node("model"))
    return read_sensor(geometry.numbers("coordinates", 3), properties, model)


def read_sensor(position: list[float], properties: JsonObject, model: SensorModel) -> Sensor:
    """Build the sensor of a model from a position and the members of a JSON object.

    position: x, y, z (m, site frame); properties: the sensor's `name`, and `heading_deg`
    (counter-clockwise from the site's +x), `tilt_deg` (positive below the horizon) and `roll_deg`
    of its body.

    Raises ValueError that names a member that does not fit."""
    x, y, z = position
    heading = properties.angle("heading_deg")  # rad
    tilt = properties.angle("tilt_deg")
    roll = properties.angle("roll_deg")
    if not abs(properties.value["tilt_deg"]) <= _MAX_TILT_DEG:
        where = properties.where("tilt_deg")
        limit = f"{_MAX_TILT_DEG:g} degrees"
        raise ValueError(
            f"{where} must lie within {limit} of the horizon, got {properties.value['tilt_deg']:g}"
        )
    name = properties.get("name", str)
    world_SE3_body = pose(x, y, z, yaw=heading, pitch=tilt, roll=roll)
    world_SE3_sensor = world_SE3_body @ model.body_SE3_sensor
    return Sensor(name, model, world_SE3_sensor)


def read_model(properties: JsonObject) -> SensorModel:
    """Build a sensor model from a JSON object, the inverse of `format_model`.

    properties: `type`, the name of the model's class, and fields of the class. A field that is an
    angle is in degrees, its name followed by `_deg`; fields left out have their defaults. Raises
    ValueError that names a member that does not fit."""
    kind = properties.get("type", str)
    if kind not in class_names():
        raise ValueError(
            f"{properties.where('type')} must be one of {', '.join(class_names())}, got "
            f"{kind[:60]!r}"
        )
    model = find_model_class(kind)
    angles = find_angles(model)
    entries = {}  # fields of the class, by their names in the file
    for entry in fields(model):
        entries[f"{entry.name}_deg" if angles[entry.name] else entry.name] = entry
    values: Json = {}
    for key, value in properties.value.items():
        if key != "type" and key not in entries:
            raise ValueError(
                f"{properties.where(key)} is unknown to {kind}: it has {', '.join(entries)}"
            )
        if key == "type":
            continue
        name = entries[key].name
        default = entries[key].default  # the value must have its type
        if isinstance(default, bool) and isinstance(value, bool):
            values[name] = value
        elif isinstance(default, str | int):
            values[name] = properties.get(key, str if isinstance(default, str) else int)
        else:
            is_array = isinstance(value, list) and not isinstance(default, float)
            numbers = np.array(properties.numbers(key) if is_array else properties.number(key))
            values[name] = (np.deg2rad(numbers) if angles[name] else numbers).tolist()
    with name_errors(properties.path):
        return make_model(kind, values)


def _origin(origin: str) -> Json:
    # member `origin` of a feature's properties, left out if it is the default
    return {} if origin == "mapped" else {"origin": origin}


def _polygon(corners: list[list[float]], **properties: JsonValue) -> Json:
    """GeoJSON feature of a polygon; the ring repeats its first corner at the end."""
    geometry = {"type": "Polygon", "coordinates": [[*corners, corners[0]]]}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def _point(coordinates: list[float], **properties: JsonValue) -> Json:
    """GeoJSON feature of a point x, y or x, y, z."""
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": "Point", "coordinates": coordinates},
    }


def format_model(model: SensorModel) -> Json:
    """Members of the JSON object of a sensor model, which `read_model` reads.

    They are the class name as `type`, and the fields that are not None. Angles, which the model has
    in rad, are in degrees under names that end in `_deg`; tuples become lists."""
    members: Json = {"type": type(model).__name__}
    for name, is_angle in find_angles(model).items():  # all fields of the model
        value = getattr(model, name)
        if value is None:
            continue
        if is_angle and isinstance(value, tuple):
            members[f"{name}_deg"] = [_degrees(angle) for angle in value]
        elif is_angle:
            members[f"{name}_deg"] = _degrees(value)
        else:
            members[name] = list(value) if isinstance(value, tuple) else value
    return members


def format_attitude(sensor: Sensor) -> Json:
    """Heading, tilt and roll of a sensor's body as `heading_deg`, `tilt_deg` and `roll_deg`.

    The body's x is forward, y left, z up. Heading is counter-clockwise from the site's +x, tilt
    positive below the horizon, roll about the forward axis. `read_sensor` takes the same members.
    A sensor straight up or down has roll 0, and its heading holds the whole turn."""
    # unit vectors x, y, z of the body's axes in the site frame
    forward, left, up = sensor.world_SE3_body[:3, :3].T
    forward_x, forward_y, forward_z = forward
    level_length = float(np.hypot(forward_x, forward_y))  # length of `forward` on the ground plane
    tilt = np.arctan2(-forward_z, level_length)
    if level_length < _MIN_LEVEL_LENGTH:
        # straight up or down: heading and roll turn about one axis
        left_x, left_y = left[:2]
        heading = np.arctan2(-left_x, left_y)  # left is (-sin heading, cos heading) without roll
        roll = np.float64(0.0)
    else:
        heading = np.arctan2(forward_y, forward_x)
        roll = np.arctan2(left[2], up[2])  # from z of both
    return {
        "heading_deg": _degrees(heading),
        "tilt_deg": _degrees(tilt),
        "roll_deg": _degrees(roll),
    }


def _degrees(angle: float) -> float:
    """Convert an angle (rad) to degrees, rounded so that radians and back give the same number."""
    # + 0.0 makes 0 of -0
    return round(float(np.rad2deg(angle)), 9) + 0.0
