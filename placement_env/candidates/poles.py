"""Poles of a city as mounts, and keep-out areas, from GeoJSON.

Point features are poles, and so is every point of a MultiPoint; several in one feature are numbered
from 1. Properties, all optional:

    name                        else the first of `NAMING_KEYS` that differs from pole to pole
    height or max_height        m above the foot
    min_height                  m above the foot
    price                       in the catalogue's currency
    price_factor                price in ordinary poles
    existing                    true: the pole exists already and costs nothing
    capacity_kbit               capacity of the link, per frame
    origin                      surveyed (default), mapped or drawn

Polygons and multipolygons with `keep_out: true` or `kind: "keep_out"` are keep-out areas; in a file
of keep-out areas all are. Other geometries are ignored, with a warning that counts them. Unknown
properties are ignored too, with a warning that names them and guesses their meaning. Sensors and
parking bays of files that coview wrote (`layer`) are not poles, and its mounts cost as much as
ordinary poles. An area with exchanged longitude and latitude is refused; a file with only distant
areas is noted. Poles on the carriageway are left out, with a warning; within `MAX_SNAP_M` of its
edge, since maps draw lanes too wide, they move to the edge, with a warning too.

Coordinates are longitude and latitude (RFC 7946, WGS84); altitude is ignored, as poles are on the
ground of the site. A collection with the member `coview_site`, such as a saved site, is in the
site's metres, with z for the foot.
"""

import re
import unicodedata
import warnings
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from difflib import get_close_matches
from itertools import chain, compress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely
from shapely.geometry import shape

from placement_env.candidates.sensor_catalogue import SensorCatalogue
from toolkit.arrays import Float64, Mask
from toolkit.runtime.text_values import read_json, read_own_table
from toolkit.sites.georeference import site_metres
from toolkit.sites.site import Mount, Site

MAX_FILE_POLES = 5000  # poles in a file
MAX_POLE_DISTANCE_M = 300.0  # largest distance from the detection area to a pole
SAME_POLE_M = 0.1  # largest distance between two poles that are one
MIN_AREA_M2 = 0.01  # smallest keep-out area
MAX_SNAP_M = 1.0  # distance to the edge over which a pole moves off the carriageway
OFF_EDGE_M = 0.05  # distance of a moved pole from the carriageway
MAX_POLE_HEIGHT_M = 60.0  # sensors above the foot; masts of motorways and stadiums are lower
CHECKED_ANGLES = 16  # directions from the edge in which a place off the carriageway is looked for
MAX_ANGLES_DEG = (180.0, 90.0)  # largest longitude and latitude, east or west, north or south
DEFAULT_MIN_HEIGHT_M = 3.0  # lowest sensor above the foot of a pole without a property
DEFAULT_MAX_HEIGHT_M = 8.0  # highest sensor
DEFAULT_LINK_KBIT = 2000.0  # capacity of a link per frame
NAMING_KEYS = ("ref", "id", "@id", "fid", "osm_id")  # names of features without a name, in order
MAX_ABOVE_GROUND_M = 20.0  # a foot that is farther off the ground must be an altitude above the sea
Json = dict[str, Any]
_TABLES = read_own_table(__file__, "poles.toml")
KNOWN_PROPERTIES: dict[str, str] = _TABLES["understood"]
# properties without a warning although they are no known ones: written by coview itself, or names
IGNORED_KEYS = {"capacity", "kind", "origin", "layer", "used", *NAMING_KEYS}


class _Feature(NamedTuple):
    """Feature of a GeoJSON file that has a place.

    Attributes:
        location: Path of the file and index of the feature, for errors.
        name: Name of the feature.
        properties: Properties without null values.
        geometry: GeoJSON geometry, not checked yet."""

    location: str
    name: str
    properties: Json
    geometry: Json


class _Pole(NamedTuple):
    """One point of a Point or MultiPoint feature.

    Attributes:
        location: Path of the file and index of the feature, for errors.
        name: Name of the pole.
        properties: Properties of the feature.
        point: Coordinates as in the file, not checked yet."""

    location: str
    name: str
    properties: Json
    point: list[float]


class _DrawnArea(NamedTuple):
    """Keep-out area of a file.

    Attributes:
        location: Path of the file and index of the feature, for errors.
        shape: The area in the coordinates of the file."""

    location: str
    shape: shapely.Geometry


def load_poles(
    path: str | Path, site: Site, catalogue: SensorCatalogue | None = None
) -> tuple[Mount, ...]:
    """Load the poles in `path` as mounts at a site.

    Unnamed poles are called pole and their number in the file. Poles in a keep-out area of the file
    or on the carriageway are left out, with a warning; poles on it but near its edge move there.

    Args:
        path: GeoJSON file, see this module's docstring.
        site: Site in whose frame (m) the mounts are.
        catalogue: Gives the currency of the poles' prices and the price of an ordinary pole; None
            for prices in ordinary poles.

    Raises ValueError in one line if the file is damaged, has no pole, the same pole twice, names
    that look alike, a pole far from the site, or an invalid price; ImportError if the site's map
    projection needs pyproj."""
    collection = _read_collection(Path(path))
    where = str(path)
    features = list(_iterate_features(collection, where))
    poles = _list_poles(features)
    _warn_of_ignored(collection, features, poles, where)
    if len(poles) > MAX_FILE_POLES:
        raise ValueError(
            f"{where}: holds {len(poles)} poles, more than {MAX_FILE_POLES}: leave out those far "
            "off"
        )
    for pole in poles:
        row = pole.point
        if not isinstance(row, list) or len(row) not in (2, 3) or not all(map(_is_number, row)):
            raise ValueError(
                f"{pole.location}.geometry.coordinates must be two or three finite numbers, got "
                f"{str(row)[:60]}"
            )
    coordinates = np.array([[*pole.point, np.nan][:3] for pole in poles], np.float64)
    spots = _convert_to_site(coordinates[:, :2], collection, site, where)
    has_height = np.isfinite(coordinates[:, 2]) & ("coview_site" in collection)
    feet = np.column_stack([spots, np.where(has_height, coordinates[:, 2], site.ground(spots))])
    prices = [_price_factor(pole.properties, catalogue, pole.location) for pole in poles]
    mounts = []
    for pole, foot, price in zip(poles, feet, prices, strict=True):
        mounts.append(_build_mount(pole, foot, price))
    _check_poles(mounts, site, where)
    carriageway = shapely.union_all([shapely.Polygon(lane) for lane in site.lanes])
    kept_out = shapely.union_all(list(_iterate_keep_out(collection, site, where)))
    is_kept_out = shapely.intersects(kept_out, shapely.points(feet[:, :2]))
    mounts = _move_off_carriageway(mounts, carriageway, is_kept_out, site, where)
    points = shapely.points([mount.position[:2] for mount in mounts])
    is_free = np.ones(len(mounts), bool)
    for area, remark in ((kept_out, "in a keep-out area"), (carriageway, "on the carriageway")):
        is_barred = is_free & shapely.intersects(area, points)
        is_free &= ~is_barred
        if is_barred.any():
            names = ", ".join(mount.name for mount in compress(mounts, is_barred))
            warnings.warn(f"{where}: left out, since they stand {remark}: {names}", stacklevel=2)
    return tuple(compress(mounts, is_free))


def _list_poles(features: Sequence[_Feature]) -> list[_Pole]:
    """Poles of Point and MultiPoint features; several points of one feature are numbered from 1.

    Raises ValueError for a MultiPoint without a list of points."""
    poles = []
    for feature in features:
        coordinates: Any = feature.geometry.get("coordinates")  # a point or points, checked later
        if feature.geometry.get("type") == "Point":
            poles.append(
                _Pole(feature.location, feature.name, feature.properties, point=coordinates)
            )
        elif feature.geometry.get("type") == "MultiPoint":
            if not isinstance(coordinates, list):
                raise ValueError(
                    f"{feature.location}.geometry.coordinates of a MultiPoint must be a list, got "
                    f"{str(coordinates)[:60]}"
                )
            for number, point in enumerate(coordinates, 1):
                name = feature.name if len(coordinates) == 1 else f"{feature.name}-{number}"
                poles.append(_Pole(feature.location, name, feature.properties, point))
    return poles


def _warn_of_ignored(
    collection: Json, features: Sequence[_Feature], poles: Sequence[_Pole], where: str
) -> None:
    """Warn of properties and features of a file that are not used.

    Raises ValueError if there are no poles at all.

    Args:
        collection: The whole file.
        features: Its features with a place.
        poles: Poles found in these.
        where: Path of the file, for texts."""
    types = [str(feature.geometry.get("type")) for feature in features]
    points = [
        feature.properties for feature, kind in zip(features, types, strict=True) if "Point" in kind
    ]
    areas = [
        feature.properties
        for feature, kind in zip(features, types, strict=True)
        if "Polygon" in kind
    ]
    area_keys = list_unknown(areas, areas=True)
    for unknown_keys in (list_unknown(points), area_keys):
        if unknown_keys:
            warnings.warn(
                f"{where}: properties that are not understood, so not used: {unknown_keys}",
                stacklevel=3,
            )
    if "GeometryCollection" in types:
        location = features[types.index("GeometryCollection")].location
        warnings.warn(
            f"{location} is a GeometryCollection, not used: export its points", stacklevel=3
        )
    drawn_count = sum(_is_drawn(feature.properties, feature.geometry) for feature in features)
    if drawn_count and poles and not area_keys:
        shapes = f"{drawn_count} features are lines or areas, so they are no poles"
        warnings.warn(
            f"{where}: {shapes}: export their middles (or mark areas with keep_out)", stacklevel=3
        )
    placeless = _list_placeless(collection)
    if placeless and poles:
        remark = f"{len(placeless)} features have no place (geometry null), so they are no poles"
        warnings.warn(f"{where}: {remark}", stacklevel=3)
    if placeless and not poles:
        nowhere = f"{where}: features[{placeless[0]}].geometry must be an object {{...}}"
        raise ValueError(f"{nowhere}: remove features without a place")
    if not poles:
        raise ValueError(
            f"{where}: holds no pole: give a GeoJSON with Point or MultiPoint features"
        )


def _move_off_carriageway(
    mounts: Sequence[Mount],
    carriageway: shapely.Geometry,
    is_kept_out: Mask,
    site: Site,
    where: str,
) -> list[Mount]:
    """Mounts in the same order; those on the carriageway near its edge are moved off it.

    A moved foot keeps its height above the ground. A warning names the moved poles.

    Args:
        mounts: Mounts of a file.
        carriageway: All lanes (m, world frame).
        is_kept_out: Mask of mounts that are left out in any case, so they do not move.
        site: Site with the ground.
        where: Path of the file, for the warning.
    """
    moved_mounts = list(mounts)
    notes = []
    for k, mount in enumerate(mounts):
        spot = shapely.Point(mount.position[:2])
        if is_kept_out[k] or not carriageway.intersects(spot):
            continue
        distance = float(carriageway.boundary.distance(spot))
        roadside = _step_off(spot, carriageway) if distance <= MAX_SNAP_M else None
        if roadside is not None:
            foot = np.array([roadside.x, roadside.y, mount.position[2]])
            foot[2] += float(site.ground(foot[:2])) - float(site.ground(mount.position[:2]))
            moved_mounts[k] = replace(mount, position=foot)
            notes.append(f"{mount.name} by {roadside.distance(spot):.2f} m")
    if notes:
        remark = "moved off the carriageway, whose edge is near"
        warnings.warn(f"{where}: {remark}: {', '.join(notes)}", stacklevel=3)
    return moved_mounts


def _step_off(spot: shapely.Point, carriageway: shapely.Geometry) -> shapely.Point | None:
    """Point off the carriageway, `OFF_EDGE_M` from the point of its edge nearest to a spot on it.

    The direction straight off the edge is tried first, then others; None if all end on the
    carriageway, as in a very narrow gap between lanes."""
    edge = shapely.get_point(shapely.shortest_line(carriageway.boundary, spot), 0)
    for angle in np.linspace(0, 2 * np.pi, CHECKED_ANGLES, endpoint=False):
        direction = np.arctan2(edge.y - spot.y, edge.x - spot.x) + angle
        x = edge.x + OFF_EDGE_M * np.cos(direction)
        y = edge.y + OFF_EDGE_M * np.sin(direction)
        roadside = shapely.Point(x, y)
        if not carriageway.intersects(roadside):
            return roadside
    return None


def load_keep_out(path: str | Path, site: Site) -> tuple[shapely.Geometry, ...]:
    """Load all polygons of a GeoJSON file as keep-out areas (m, frame of the site).

    Raises ValueError in one line if there is no area, or for a damaged one.
    """
    collection = _read_collection(Path(path))
    areas = tuple(_iterate_keep_out(collection, site, str(path), all_polygons=True))
    if not areas:
        raise ValueError(
            f"{path}: holds no area: give a GeoJSON with Polygon or MultiPolygon features"
        )
    features = _iterate_features(collection, str(path))
    types = [str(feature.geometry.get("type")) for feature in features]
    # points are no reason for a warning, as the file may hold poles too
    other_count = sum("Polygon" not in kind and "Point" not in kind for kind in types)
    other_count += len(_list_placeless(collection))
    if other_count:
        warnings.warn(
            f"{path}: {other_count} features are no areas (Polygon, MultiPolygon), not used",
            stacklevel=2,
        )
    return areas


def list_unknown(properties: Iterable[Json], *, areas: bool = False) -> str:
    """List unknown properties in one text, each once, with a guess of its meaning; empty if none.

    Args:
        properties: Properties of each feature.
        areas: True for polygons: only properties that may mean keep_out are listed."""
    keys = dict.fromkeys(chain.from_iterable(properties))
    unknown_keys = [key for key in keys if key not in KNOWN_PROPERTIES and key not in IGNORED_KEYS]
    guesses = {key: guess_property(key) for key in unknown_keys}  # None for no guess
    if areas:
        guesses = {key: guess for key, guess in guesses.items() if guess == "keep_out"}
    return ", ".join(
        key[:60] if guess is None else f"{key[:60]}: {KNOWN_PROPERTIES[guess]}?"
        for key, guess in guesses.items()
    )


def guess_property(key: str) -> str | None:
    """Known property that an unknown one may mean, written in other letters, words or units.

    None without a guess."""
    spaced = re.sub(r"(?<=[a-zäöü])(?=[A-ZÄÖÜ])", "_", key)  # maxHeight becomes max_Height
    words = [word.lower() for word in re.findall(r"[^\W\d_]+", spaced)]  # letters only
    spellings = {*words, "".join(words)}
    matches = [name for name, synonyms in _TABLES["words"].items() if spellings & set(synonyms)]
    if not matches:
        matches = get_close_matches("_".join(words), KNOWN_PROPERTIES, n=1, cutoff=0.75)
    return next(iter(matches), None)


def _read_collection(path: Path) -> Json:
    """Content of a GeoJSON file, a FeatureCollection in WGS84.

    Raises FileNotFoundError for a missing file, ValueError for any other content."""
    if not path.is_file():
        raise FileNotFoundError(f"no file {str(path)!r}: give a GeoJSON of poles")
    if path.suffix.lower() in (".osm", ".xodr", ".csv", ".shp", ".kml"):
        raise ValueError(
            f"{path} is no GeoJSON: save the poles as points in a .geojson file, such as from QGIS"
        )
    collection = read_json(path)
    if not isinstance(collection, dict) or not isinstance(collection.get("features"), list):
        raise ValueError(
            f"{path}: must be a GeoJSON FeatureCollection with a list of features: export it again"
        )
    _check_system(collection, str(path))
    return collection


def _check_system(element: Json, where: str) -> None:
    """Raise ValueError for a collection, feature or geometry in other coordinates than WGS84.

    Before RFC 7946 each element could name a coordinate system (geojson.org, 2008, section 3).

    where: Place of the element in the file, for the error.
    """
    # only letters and digits, joined by colons, as in urn:ogc:def:crs:OGC:1.3:CRS84
    system = re.sub(r"\W+", ":", str(element.get("crs") or "CRS84"))
    if not re.search(r"CRS:?84|EPSG:(0:)?4326\b", system, re.IGNORECASE):
        raise ValueError(
            f"{where}: crs must be WGS84, got {str(element['crs'])[:90]}: export it as EPSG:4326"
        )


def _list_placeless(collection: Json) -> list[int]:
    """Indices of the features whose geometry is null, which RFC 7946 allows (section 3.2)."""
    # a feature without the key is damaged instead: its default "" is not None
    return [
        i
        for i, feature in enumerate(collection["features"])
        if isinstance(feature, dict) and feature.get("geometry", "") is None
    ]


def _iterate_features(collection: Json, where: str) -> Iterator[_Feature]:
    """Yield the features of a collection that have a place, with a name and without null values.

    Sensors and parking bays of a saved site are left out. A feature without a name is called pole
    and its index in the file. Raises ValueError for a damaged feature.

    where: Path of the file, for texts."""
    placeless = set(_list_placeless(collection))
    keys = _find_naming_keys(collection)
    for i, feature in enumerate(collection["features"]):
        location = f"{where}: features[{i}]"
        if i in placeless:
            continue
        if not isinstance(feature, dict) or not isinstance(feature.get("geometry"), dict):
            raise ValueError(
                f"{location}.geometry must be an object {{...}}: remove features without a place"
            )
        _check_system(feature, location)
        _check_system(feature["geometry"], f"{location}.geometry")
        properties = feature.get("properties") or {}
        if not isinstance(properties, dict):
            raise ValueError(
                f"{location}.properties must be an object {{...}}, got {str(properties)[:60]}"
            )
        if properties.get("layer") not in ("sensor", "parking"):
            properties = {key: value for key, value in properties.items() if value is not None}
            name = _read_name(properties, feature, keys, location) or f"pole{i:02}"
            yield _Feature(location, name, properties, geometry=feature["geometry"])


def _find_naming_keys(collection: Json) -> list[str]:
    """Keys of `NAMING_KEYS` whose values can serve as names of the unnamed features.

    All values differ, also from the names of other features."""
    features = [feature for feature in collection["features"] if isinstance(feature, dict)]
    # for each feature, the texts that may name it, by key: "name" and some of `NAMING_KEYS`
    texts = [_read_naming_texts(feature) for feature in features]
    names = {feature_texts["name"] for feature_texts in texts if "name" in feature_texts}
    unnamed = [feature_texts for feature_texts in texts if "name" not in feature_texts]
    keys = []
    for key in NAMING_KEYS:
        values = [feature_texts[key] for feature_texts in unnamed if key in feature_texts]
        if len(set(values)) == len(values) and not names & set(values):
            keys.append(key)
    return keys


def _read_naming_texts(feature: Json) -> dict[str, str]:
    """Texts by which a feature may be named, by key: "name" and `NAMING_KEYS`, blanks left out."""
    properties = feature.get("properties")
    values = {"id": feature.get("id")} | (properties if isinstance(properties, dict) else {})
    texts = {key: str(values[key]) for key in ("name", *NAMING_KEYS) if values.get(key) is not None}
    return {key: text for key, text in texts.items() if text.strip()}


def _read_name(properties: Json, feature: Json, keys: Sequence[str], location: str) -> str:
    """Name of a feature as the file writes it, or its value of the first key; empty for neither.

    Args:
        properties: Properties of the feature.
        feature: The feature, whose member `id` counts as a property.
        keys: Keys whose values can serve as names, in order.
        location: Place of the feature in the file, for errors."""
    values = {"id": feature.get("id")} | properties
    for key in ("name", *keys):
        name = values.get(key)
        if name is not None and (not isinstance(name, str | int | float) or isinstance(name, bool)):
            rule = f"{location}.properties.{key} must be a text or a number"
            raise ValueError(f"{rule}, got {str(name)[:60]}: write the name")
        if name is not None and str(name).strip():
            return str(name)
    return ""


def _is_number(value: object) -> bool:
    # True for a finite number; bool is an int in Python. Integers above 1e300 may not fit a float
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300


def _convert_to_site(
    coordinates: Float64[np.ndarray, "n 2"], collection: Json, site: Site, where: str
) -> Float64[np.ndarray, "n 2"]:
    """Convert coordinates of a file to x and y in the frame of the site (m).

    Args:
        coordinates: Longitude and latitude (deg), or metres if the collection has `coview_site`.
        collection: The whole file.
        site: Site with the map projection.
        where: Path of the file, for errors.

    Raises ValueError for angles out of range, or a site that is not georeferenced."""
    if "coview_site" in collection:
        return coordinates
    wrong_rows = np.flatnonzero((np.abs(coordinates) > MAX_ANGLES_DEG).any(axis=1))
    if len(wrong_rows):
        raise ValueError(
            f"{where}: coordinates must be longitude and latitude (degrees), "
            f"got {coordinates[wrong_rows[0]].tolist()}: export the file as EPSG:4326, "
            'or give the site\'s metres and add "coview_site": 1 beside "features"'
        )
    if site.geo_reference is None:
        raise ValueError(
            f"{where}: site {site.name!r} does not say where on earth it is (geo_reference): "
            'give the poles in the site\'s metres and add "coview_site": 1 beside "features"'
        )
    return site_metres(site, coordinates)


def _read_number(properties: Json, where: str, default: float, *keys: str) -> float:
    """Value of the first of some keys that a feature has, else the default.

    where: Place of the feature in the file, for errors. Raises ValueError if the value of any of
    these keys is no finite number."""
    for key in keys:
        if key in properties and not _is_number(properties[key]):
            raise ValueError(
                f"{where}.properties.{key} must be a finite number, got "
                f"{str(properties[key])[:60]!r}"
            )
    return float(next((properties[key] for key in keys if key in properties), default))


def _price_factor(properties: Json, catalogue: SensorCatalogue | None, where: str) -> float:
    """Price of a pole in ordinary poles, or in the currency of a catalogue without a pole_price.

    It is 0 for a pole that exists. Raises ValueError if properties and catalogue do not fit.

    Args:
        properties: Properties of the pole's feature.
        catalogue: Catalogue with the currency and the price of an ordinary pole, None without one.
        where: Place of the feature in the file, for errors."""
    existing = properties.get("existing", False)
    if not isinstance(existing, bool):
        raise ValueError(f"{where}.properties.existing must be true or false, got {existing!r:.60}")
    if properties.get("layer") == "mount":  # from a site's file
        return 0.0 if existing else _read_number(properties, where, 1.0, "price")
    for key in ("price", "price_factor"):
        amount = _read_number(properties, where, 0.0, key)
        if amount < 0:
            raise ValueError(f"{where}.properties.{key} must be at least 0, got {amount:g}")
    factor = _read_number(properties, where, 1.0, "price_factor")
    ordinary_price = None if catalogue is None else catalogue.pole_price
    if "price" in properties:
        price = _read_number(properties, where, 0.0, "price")
        if "price_factor" in properties:
            raise ValueError(
                f"{where}.properties has price, which is money, and price_factor: leave one of "
                "them out"
            )
        if catalogue is None or ordinary_price == 0:
            rule = (
                f"{where}.properties.price is money: give a catalogue with a pole_price above 0 "
                "(--sensors)"
            )
            raise ValueError(f"{rule}, or price_factor, 1 for an ordinary pole")
        factor = price if ordinary_price is None else price / ordinary_price
    elif "price_factor" in properties and catalogue is not None and ordinary_price is None:
        raise ValueError(
            f"{where}.properties.price_factor needs a pole_price in the catalogue: add it, or "
            "give price"
        )
    return 0.0 if existing else factor


def _build_mount(pole: _Pole, foot: Float64[np.ndarray, "3"], price: float) -> Mount:
    """Mount of a pole, with usual values for properties that it lacks.

    Args:
        pole: Pole of a file.
        foot: x, y and z of its foot (m, frame of the site).
        price: Its price in ordinary poles, or in the catalogue's currency.

    Raises ValueError for a property that does not fit."""
    where = pole.location
    properties = pole.properties
    max_height = _read_number(properties, where, DEFAULT_MAX_HEIGHT_M, "max_height", "height")
    default_min_height = min(DEFAULT_MIN_HEIGHT_M, max_height)
    min_height = _read_number(properties, where, default_min_height, "min_height")
    capacity = _read_number(properties, where, DEFAULT_LINK_KBIT, "capacity_kbit", "capacity")
    max_sensors = _read_number(properties, where, 1.0, "max_sensors")
    for key in ("max_height", "height", "min_height"):
        height = _read_number(properties, where, 0.0, key)  # 0, which is allowed, without the key
        if not 0 <= height <= MAX_POLE_HEIGHT_M:
            guess = ""
            if MAX_POLE_HEIGHT_M < height <= 100 * MAX_POLE_HEIGHT_M:
                guess = f" (is it {height / 100:g} m, in centimetres?)"
            rule = f"must be in m above the foot, 0 to {MAX_POLE_HEIGHT_M:g}"
            raise ValueError(f"{where}.properties.{key} {rule}, got {height:g}{guess}")
    if not capacity > 0:
        key = "capacity_kbit" if "capacity_kbit" in properties else "capacity"
        raise ValueError(
            f"{where}.properties.{key} must be above 0 kbit per frame, got {capacity:g}"
        )
    try:
        return Mount(
            name=pole.name,
            position=foot,
            min_height=min_height,
            max_height=max_height,
            price=price,
            capacity=capacity,
            max_sensors=max_sensors,  # type: ignore[arg-type]  # checked there
            origin=properties.get("origin", "surveyed"),
        )
    except ValueError as error:
        raise ValueError(f"{where} (pole {pole.name!r}): {error}") from None


def _check_poles(mounts: Sequence[Mount], site: Site, where: str) -> None:
    """Raise ValueError for poles that are far from the site or the ground, or hard to distinguish.

    Names must differ, also in the form that files have them, and feet must be more than
    `SAME_POLE_M` apart.

    where: Path of the file, for errors."""
    names = [mount.name for mount in mounts]
    feet = np.array([mount.position for mount in mounts])
    distance = shapely.distance(shapely.box(*site.area), shapely.points(feet[:, :2]))
    distant = np.flatnonzero(~(distance <= MAX_POLE_DISTANCE_M))
    if len(distant):
        more_text = f" (and {len(distant) - 1} more)" if len(distant) > 1 else ""
        raise ValueError(
            f"{where}: pole {names[distant[0]]!r}{more_text} stands {distance[distant[0]]:.0f} m "
            f"from the area of site {site.name!r}, more than {MAX_POLE_DISTANCE_M:g} m: longitude "
            "comes first; leave out the poles of other places"
        )
    raised = np.flatnonzero(np.abs(feet[:, 2] - site.ground(feet[:, :2])) > MAX_ABOVE_GROUND_M)
    if len(raised):
        problem = f"{where}: pole {names[raised[0]]!r} has its foot at z = {feet[raised[0], 2]:g} m"
        raise ValueError(
            f"{problem}, more than {MAX_ABOVE_GROUND_M:g} m from the ground of the site: leave "
            "out altitudes"
        )
    name, count = Counter(names).most_common(1)[0]
    if count > 1:
        raise ValueError(f"{where}: {count} poles are named {name!r}: rename all but one")
    by_file_name = defaultdict(list)
    for name in names:
        by_file_name[_file_name(name)].append(name)
    for namesakes in by_file_name.values():
        if len(namesakes) > 1:
            pair = " and ".join(map(ascii, namesakes[:2]))
            reason = "differ only in spaces, in how accents are encoded, or in / and -"
            raise ValueError(
                f"{where}: names of poles must be told apart, but {pair} {reason}: rename one"
            )
    spots = shapely.points(feet[:, :2])
    pairs = shapely.STRtree(spots).query(spots, "dwithin", SAME_POLE_M).T
    pairs = pairs[pairs[:, 0] < pairs[:, 1]]  # indices of poles, each pair once
    if len(pairs):  # the first pair in the order of the file is named
        pair = " and ".join(repr(names[k]) for k in pairs[np.lexsort(pairs.T[::-1])[0]])
        raise ValueError(f"{where}: poles {pair} stand at the same place: remove one of them")


def _is_drawn(properties: Json, geometry: Json) -> bool:
    """True if a feature is a line or area whose meaning no property states.

    Areas of a saved site (`layer`) and keep-out areas have a meaning."""
    if {"layer", "kind"} & properties.keys() or properties.get("keep_out"):
        return False
    return any(word in str(geometry.get("type")) for word in ("LineString", "Polygon"))


def _file_name(name: str) -> str:
    """Name of a pole as file names have it: Unicode's form NFC, - for /, single spaces."""
    return " ".join(unicodedata.normalize("NFC", name).replace("/", "-").split())


def _iterate_keep_out(
    collection: Json, site: Site, where: str, *, all_polygons: bool = False
) -> Iterator[shapely.Geometry]:
    """Yield the keep-out areas of a file (m, frame of the site).

    Raises ValueError for a damaged area; warns after the last one if all are far from the site.

    Args:
        collection: The whole file.
        site: Site in whose frame the areas are.
        where: Path of the file, for texts.
        all_polygons: True to yield polygons that are not marked as keep-out areas too."""
    surroundings = shapely.box(*site.area).buffer(MAX_POLE_DISTANCE_M)
    area_count = 0
    has_near_area = False

    def convert(corners: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
        # coordinates of the file in the frame of the site
        return _convert_to_site(corners, collection, site, where)

    for location, drawn_area in _list_drawn_areas(collection, where, all_polygons=all_polygons):
        area = shapely.transform(drawn_area, convert)
        is_near = bool(area.intersects(surroundings))
        area_count += 1
        has_near_area |= is_near
        if not is_near and _is_exchanged(drawn_area, collection, site, surroundings):
            raise ValueError(
                f"{location} has longitude and latitude exchanged: longitude comes first, export "
                "it again"
            )
        if area.area < MIN_AREA_M2:
            raise ValueError(
                f"{location} has no area, as its corners are in one line: draw the area again"
            )
        yield area
    if area_count and not has_near_area:
        problem = (
            f"none of its {area_count} keep-out areas is within {MAX_POLE_DISTANCE_M:g} m of "
            f"site {site.name!r}"
        )
        warnings.warn(f"{where}: {problem}: check that they belong to it", stacklevel=3)


def _is_exchanged(
    drawn_area: shapely.Geometry, collection: Json, site: Site, surroundings: shapely.Geometry
) -> bool:
    """True if an area would be near the site with longitude and latitude exchanged.

    Args:
        drawn_area: Area in the coordinates of the file.
        collection: The whole file.
        site: Site with the map projection.
        surroundings: Surroundings of the site (m, its frame)."""
    if "coview_site" in collection:  # a file of ours, in metres
        return False
    swapped = shapely.get_coordinates(drawn_area)[:, ::-1]
    if (np.abs(swapped) > MAX_ANGLES_DEG).any():
        return False
    try:
        return bool(shapely.MultiPoint(site_metres(site, swapped)).intersects(surroundings))
    except ValueError:  # beyond the site's map
        return False


def _list_drawn_areas(collection: Json, where: str, *, all_polygons: bool) -> Iterator[_DrawnArea]:
    """Yield the keep-out areas of a file.

    Args:
        collection: The whole file.
        where: Path of the file, for errors.
        all_polygons: True to yield polygons that are not marked as keep-out areas too.

    Raises ValueError for a damaged area."""
    for feature in _iterate_features(collection, where):
        properties = feature.properties
        geometry = feature.geometry
        location = feature.location
        if not isinstance(is_marked := properties.get("keep_out", False), bool):
            raise ValueError(
                f"{location}.properties.keep_out must be true or false, got {is_marked!r:.60}"
            )
        # areas with a layer are the ground of a site
        is_area = "Polygon" in str(geometry.get("type")) and "layer" not in properties
        if not (is_marked or properties.get("kind") == "keep_out" or (all_polygons and is_area)):
            continue
        location = f"{location}.geometry"
        if (kind := geometry.get("type")) not in ("Polygon", "MultiPolygon"):
            raise ValueError(
                f"{location}.type of a keep-out area must be Polygon or MultiPolygon, got {kind}"
            )
        try:
            drawn_area = shapely.force_2d(shape(geometry))
        except (ValueError, TypeError, LookupError, AttributeError, shapely.errors.ShapelyError):
            raise ValueError(
                f"{location}.coordinates must be closed rings of [x, y] pairs: draw the area again"
            ) from None
        if drawn_area.is_empty or not np.isfinite(shapely.get_coordinates(drawn_area)).all():
            raise ValueError(f"{location}.coordinates are empty or hold NaN: draw the area again")
        if not drawn_area.is_valid:
            reason = shapely.is_valid_reason(drawn_area)
            raise ValueError(f"{location} must be a simple polygon ({reason}): draw the area again")
        yield _DrawnArea(location, drawn_area)
