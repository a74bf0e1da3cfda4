"""Poles of a city as mounts, and keep-out areas, from GeoJSON.

Point features are poles, and so is every point of a MultiPoint; several in one feature are numbered
from 1. Properties, all optional: name (else the first of `NAMES` that differs from pole to pole),
height or max_height and min_height (m above the foot), price (in the catalogue's currency) or
price_factor (of the price of one ordinary pole), existing (true: it stands already and costs
nothing), capacity_kbit (of the link, per frame), origin (surveyed, mapped or drawn; surveyed when
left out). Polygons and multipolygons with `keep_out: true` or `kind: "keep_out"` are keep-out
areas, and in a file of keep-out areas all are. Other geometries are ignored, with a warning that
counts them; other properties too, with a warning that names them and what they may mean. Sensors
and parking bays of files that coview wrote (`layer`) are no poles, and its mounts cost as much as
ordinary poles. An area whose longitude and latitude are exchanged is refused; a file whose areas
are all far off is noted. Poles on the carriageway are left out, with a warning; within `SNAPPED_M`
of its edge, where maps draw lanes too wide, they move there, with a warning too.

Coordinates are longitude and latitude (RFC 7946, WGS84); altitude is ignored, as poles stand on the
ground of the site. A collection with the member `coview_site`, such as a saved site, is in the
site's metres, z that of the foot."""

import re
import unicodedata
import warnings
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from difflib import get_close_matches
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely.geometry import shape

from placement_env.candidates.sensor_catalogue import SensorCatalogue
from toolkit.arrays import Float64, Mask
from toolkit.runtime.files import read_json, read_own_table
from toolkit.sites.georeference import site_metres
from toolkit.sites.site import Mount, Site

MOST_POLES = 5000
SURROUNDINGS = 300.0  # m from the detection area within which a pole may stand
SAME_PLACE = 0.1  # m between two poles that are one
MIN_AREA_M2 = 0.01  # of a keep-out area
SNAPPED_M = 1.0  # from the edge of the carriageway within which a pole on it moves there
OFF_EDGE_M = 0.05  # that a moved pole is off the carriageway
MAX_POLE_M = 60.0  # sensors above the foot; the masts of motorways and stadiums are lower
MAX_CHECKED_ANGLES = 16  # directions off the edge that are tried
# keys that name a feature without a name, in this order
NAMES = ("ref", "id", "@id", "fid", "osm_id")
ABOVE_GROUND = 20.0  # m from the ground beyond which a foot must be an altitude above the sea
Json = dict[str, Any]
_TABLES = read_own_table(__file__, "poles.toml")
UNDERSTOOD: dict[str, str] = _TABLES["understood"]
# understood, or written by coview itself
SILENT = {"capacity", "kind", "origin", "layer", "used", *NAMES}


def load_poles(
    path: str | Path, site: Site, catalogue: SensorCatalogue | None = None
) -> tuple[Mount, ...]:
    """Load the poles in `path` where sensors may hang at `site`.

    catalogue: whose currency their prices are in, and which prices an ordinary pole. Unnamed ones
    are called pole and their number in the file. Poles in a keep-out area of the file or on the
    carriageway are left out, with a warning; those near its edge move there. Raises ValueError in
    one line if the file is damaged, has no pole, the same one twice, names that look alike, one far
    from the site, or a price that is none; ImportError if the site's map projection needs
    pyproj."""
    collection = _read(Path(path))
    where = str(path)
    features = list(_features(collection, where))
    # place in the file, name, properties, coordinates
    poles: list[tuple[str, str, Json, list[float]]] = []
    for place, name, properties, geometry in features:
        at: list[Any] = geometry.get("coordinates")  # type: ignore[assignment]  # checked below
        if geometry.get("type") == "Point":
            poles.append((place, name, properties, at))
        elif geometry.get("type") == "MultiPoint":
            if not isinstance(at, list):
                raise ValueError(
                    f"{place}.geometry.coordinates of a MultiPoint must be a list, got "
                    f"{str(at)[:60]}"
                )
            names = [name] if len(at) == 1 else [f"{name}-{k}" for k in range(1, len(at) + 1)]
            poles += [(place, own, properties, each) for own, each in zip(names, at, strict=True)]
    points, areas = (
        [f[2] for f in features if word in str(f[3].get("type"))] for word in ("Point", "Polygon")
    )
    for unknown in (list_unknown(points), list_unknown(areas, areas=True)):
        if unknown:
            warnings.warn(
                f"{where}: properties that are not understood, so not used: {unknown}", stacklevel=2
            )
    for place in [
        place for place, *_, geometry in features if geometry.get("type") == "GeometryCollection"
    ][:1]:
        warnings.warn(f"{place} is a GeometryCollection, not used: export its points", stacklevel=2)
    drawn = sum(_is_drawn(properties, geometry) for _, _, properties, geometry in features)
    if drawn and poles and not list_unknown(areas, areas=True):
        shapes = f"{drawn} features are lines or areas, so they are no poles"
        warnings.warn(
            f"{where}: {shapes}: export their middles (or mark areas with keep_out)", stacklevel=2
        )
    placeless = _list_placeless(collection)
    if placeless and poles:
        said = f"{len(placeless)} features have no place (geometry null), so they are no poles"
        warnings.warn(f"{where}: {said}", stacklevel=2)
    if placeless and not poles:
        nowhere = f"{where}: features[{placeless[0]}].geometry must be an object {{...}}"
        raise ValueError(f"{nowhere}: remove features without a place")
    if not poles:
        raise ValueError(
            f"{where}: holds no pole: give a GeoJSON with Point or MultiPoint features"
        )
    if len(poles) > MOST_POLES:
        raise ValueError(
            f"{where}: holds {len(poles)} poles, more than {MOST_POLES}: leave out those far off"
        )
    for place, _, _, row in poles:
        if not isinstance(row, list) or len(row) not in (2, 3) or not all(map(_is_number, row)):
            raise ValueError(
                f"{place}.geometry.coordinates must be two or three finite numbers, got "
                f"{str(row)[:60]}"
            )
    coordinates = np.array([[*row, np.nan][:3] for *_, row in poles], np.float64)
    places = _in_site(coordinates[:, :2], collection, site, where)
    given = np.isfinite(coordinates[:, 2]) & ("coview_site" in collection)
    feet = np.column_stack([places, np.where(given, coordinates[:, 2], site.ground(places))])
    priced = [_price_factor(own, catalogue, place) for place, _, own, _ in poles]
    rows = zip(poles, feet, priced, strict=True)
    mounts = [_mount(own, name, foot, price, place) for (place, name, own, _), foot, price in rows]
    _check(mounts, site, where)
    spots = shapely.points(feet[:, :2])
    free = np.ones(len(mounts), bool)
    carriageway = shapely.union_all([shapely.Polygon(lane) for lane in site.lanes])
    kept_out = shapely.union_all(list(_keep_out(collection, site, where)))
    mounts = _snap(mounts, carriageway, shapely.intersects(kept_out, spots), site, where)
    spots = shapely.points([mount.position[:2] for mount in mounts])
    for barring, said in ((kept_out, "in a keep-out area"), (carriageway, "on the carriageway")):
        barred = free & shapely.intersects(barring, spots)
        free &= ~barred
        if barred.any():
            left = ", ".join(mount.name for mount in compress(mounts, barred))
            warnings.warn(f"{where}: left out, since they stand {said}: {left}", stacklevel=2)
    return tuple(compress(mounts, free))


def _snap(
    mounts: Sequence[Mount], carriageway: shapely.Geometry, barred: Mask, site: Site, where: str
) -> list[Mount]:
    """Move the poles on the carriageway that are near its edge to it. barred: those that are left
    out in any case."""
    moved = list(mounts)
    notes = []
    for k, mount in enumerate(mounts):
        spot = shapely.Point(mount.position[:2])
        if barred[k] or not carriageway.intersects(spot):
            continue
        distance = float(carriageway.boundary.distance(spot))
        beside = _step_off(spot, carriageway) if distance <= SNAPPED_M else None
        if beside is not None:
            foot = np.array([beside.x, beside.y, mount.position[2]])
            foot[2] += float(site.ground(foot[:2])) - float(site.ground(mount.position[:2]))
            moved[k] = replace(mount, position=foot)
            notes.append(f"{mount.name} by {beside.distance(spot):.2f} m")
    if notes:
        said = "moved off the carriageway, whose edge is near"
        warnings.warn(f"{where}: {said}: {', '.join(notes)}", stacklevel=3)
    return moved


def _step_off(spot: shapely.Point, carriageway: shapely.Geometry) -> shapely.Point | None:
    """Return the place off the carriageway that is nearest to a spot on it, None within a hair's
    breadth of lanes."""
    edge = shapely.get_point(shapely.shortest_line(carriageway.boundary, spot), 0)
    for angle in np.linspace(0, 2 * np.pi, MAX_CHECKED_ANGLES, endpoint=False):
        away = np.arctan2(edge.y - spot.y, edge.x - spot.x) + angle
        beside = shapely.Point(
            edge.x + OFF_EDGE_M * np.cos(away), edge.y + OFF_EDGE_M * np.sin(away)
        )
        if not carriageway.intersects(beside):
            return beside
    return None


def load_keep_out(path: str | Path, site: Site) -> tuple[shapely.Geometry, ...]:
    """Load all areas in `path`, in the site's metres. Raises ValueError in one line for none and
    for a damaged one."""
    collection = _read(Path(path))
    areas = tuple(_keep_out(collection, site, str(path), every=True))
    if not areas:
        raise ValueError(
            f"{path}: holds no area: give a GeoJSON with Polygon or MultiPolygon features"
        )
    kinds = [str(geometry.get("type")) for *_, geometry in _features(collection, str(path))]
    # points may be its poles
    others = sum("Polygon" not in kind and "Point" not in kind for kind in kinds)
    others += len(_list_placeless(collection))
    if others:
        warnings.warn(
            f"{path}: {others} features are no areas (Polygon, MultiPolygon), not used",
            stacklevel=2,
        )
    return areas


def list_unknown(properties: Iterable[Json], *, areas: bool = False) -> str:
    """List unknown properties, each once, with what they may mean; of polygons (`areas`) only those
    of keep_out."""
    unknown = dict.fromkeys(
        key for each in properties for key in each if key not in UNDERSTOOD and key not in SILENT
    )
    meant = {key: guess_property(key) for key in unknown}
    if areas:
        meant = {key: near for key, near in meant.items() if near == "keep_out"}
    return ", ".join(
        key[:60] if near is None else f"{key[:60]}: {UNDERSTOOD[near]}?"
        for key, near in meant.items()
    )


def guess_property(key: str) -> str | None:
    """Return the property that a name of other letters, words or units may mean, or None."""
    parts = [
        part.lower()
        for part in re.findall(r"[^\W\d_]+", re.sub(r"(?<=[a-zäöü])(?=[A-ZÄÖÜ])", "_", key))
    ]
    joined = {*parts, "".join(parts)}
    meant = [name for name, words in _TABLES["words"].items() if joined & set(words)]
    return next(iter(meant or get_close_matches("_".join(parts), UNDERSTOOD, 1, 0.75)), None)


def _read(path: Path) -> Json:
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
    """Raise ValueError for a collection, feature or geometry that is not in longitude and latitude
    of WGS84. Before RFC 7946 each of them could name its own system (geojson.org, 2008, section
    3)."""
    system = re.sub(r"\W+", ":", str(element.get("crs") or "CRS84"))
    if not re.search(r"CRS:?84|EPSG:(0:)?4326\b", system, re.IGNORECASE):
        raise ValueError(
            f"{where}: crs must be WGS84, got {str(element['crs'])[:90]}: export it as EPSG:4326"
        )


def _list_placeless(collection: Json) -> list[int]:
    """Numbers of the features without a place, which RFC 7946 allows (section 3.2)."""
    features = enumerate(collection["features"])
    return [
        i
        for i, feature in features
        if isinstance(feature, dict) and feature.get("geometry", "") is None
    ]


def _features(collection: Json, where: str) -> Iterator[tuple[str, str, Json, Json]]:
    """Yield place in the file, name, properties and geometry, but for the sensors and bays of a
    site."""
    placeless = set(_list_placeless(collection))
    keys = _naming_keys(collection)
    for i, feature in enumerate(collection["features"]):
        place = f"{where}: features[{i}]"
        if i in placeless:
            continue
        if not isinstance(feature, dict) or not isinstance(feature.get("geometry"), dict):
            raise ValueError(
                f"{place}.geometry must be an object {{...}}: remove features without a place"
            )
        _check_system(feature, place)
        _check_system(feature["geometry"], f"{place}.geometry")
        properties = feature.get("properties") or {}
        if not isinstance(properties, dict):
            raise ValueError(
                f"{place}.properties must be an object {{...}}, got {str(properties)[:60]}"
            )
        if properties.get("layer") not in ("sensor", "parking"):
            properties = {key: value for key, value in properties.items() if value is not None}
            yield (
                place,
                _pole_name(properties, feature, keys, place) or f"pole{i:02}",
                properties,
                feature["geometry"],
            )


def _naming_keys(collection: Json) -> list[str]:
    """Keys of `NAMES` whose values differ among the features without a name, and from all names."""
    rows = [
        _naming_values(feature) for feature in collection["features"] if isinstance(feature, dict)
    ]
    names = {row["name"] for row in rows if "name" in row}
    values = {key: [row[key] for row in rows if key in row and "name" not in row] for key in NAMES}
    return [
        key for key, used in values.items() if len(set(used)) == len(used) and not names & set(used)
    ]


def _naming_values(feature: Json) -> dict[str, str]:
    """Values by which a feature may be named, as texts without blanks alone."""
    properties = feature.get("properties")
    values = {"id": feature.get("id")} | (properties if isinstance(properties, dict) else {})
    texts = {key: str(values[key]) for key in ("name", *NAMES) if values.get(key) is not None}
    return {key: text for key, text in texts.items() if text.strip()}


def _pole_name(properties: Json, feature: Json, keys: Sequence[str], place: str) -> str:
    """Name or id of a feature as the file writes it, empty for none or blanks."""
    values = {"id": feature.get("id")} | properties
    for key in ("name", *keys):
        name = values.get(key)
        if name is not None and (not isinstance(name, str | int | float) or isinstance(name, bool)):
            rule = f"{place}.properties.{key} must be a text or a number"
            raise ValueError(f"{rule}, got {str(name)[:60]}: write the name")
        if name is not None and str(name).strip():
            return str(name)
    return ""


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300


def _in_site(
    coordinates: Float64[np.ndarray, "n 2"], collection: Json, site: Site, where: str
) -> Float64[np.ndarray, "n 2"]:
    """Coordinates of the collection in the site's metres."""
    if "coview_site" in collection:
        return coordinates
    wrong = np.flatnonzero((np.abs(coordinates) > [180.0, 90.0]).any(axis=1))
    if len(wrong):
        raise ValueError(
            f"{where}: coordinates must be longitude and latitude (degrees), "
            f"got {coordinates[wrong[0]].tolist()}: export the file as EPSG:4326, "
            'or give the site\'s metres and add "coview_site": 1 beside "features"'
        )
    if site.geo_reference is None:
        raise ValueError(
            f"{where}: site {site.name!r} does not say where on earth it is (geo_reference): "
            'give the poles in the site\'s metres and add "coview_site": 1 beside "features"'
        )
    return site_metres(site, coordinates)


def _number(properties: Json, where: str, default: float, *keys: str) -> float:
    for key in keys:
        if key in properties and not _is_number(properties[key]):
            raise ValueError(
                f"{where}.properties.{key} must be a finite number, got "
                f"{str(properties[key])[:60]!r}"
            )
    return float(next((properties[key] for key in keys if key in properties), default))


def _price_factor(properties: Json, catalogue: SensorCatalogue | None, where: str) -> float:
    """Price of a pole in those of ordinary ones, or in the currency of a catalogue without a
    pole_price."""
    existing = properties.get("existing", False)
    if not isinstance(existing, bool):
        raise ValueError(f"{where}.properties.existing must be true or false, got {existing!r:.60}")
    if properties.get("layer") == "mount":  # of a site's file
        return 0.0 if existing else _number(properties, where, 1.0, "price")
    for key in ("price", "price_factor"):
        if (amount := _number(properties, where, 0.0, key)) < 0:
            raise ValueError(f"{where}.properties.{key} must be at least 0, got {amount:g}")
    factor = _number(properties, where, 1.0, "price_factor")
    ordinary = None if catalogue is None else catalogue.pole_price
    if "price" in properties:
        price = _number(properties, where, 0.0, "price")
        if "price_factor" in properties:
            raise ValueError(
                f"{where}.properties has price, which is money, and price_factor: leave one of "
                "them out"
            )
        if catalogue is None or ordinary == 0:
            said = (
                f"{where}.properties.price is money: give a catalogue with a pole_price above 0 "
                "(--sensors)"
            )
            raise ValueError(f"{said}, or price_factor, 1 for an ordinary pole")
        factor = price if ordinary is None else price / ordinary
    elif "price_factor" in properties and catalogue is not None and ordinary is None:
        raise ValueError(
            f"{where}.properties.price_factor needs a pole_price in the catalogue: add it, or "
            "give price"
        )
    return 0.0 if existing else factor


def _mount(
    properties: Json, name: str, foot: Float64[np.ndarray, "3"], price: float, where: str
) -> Mount:
    top = _number(properties, where, 8.0, "max_height", "height")
    heights = _number(properties, where, min(3.0, top), "min_height"), top
    capacity = _number(properties, where, 2000.0, "capacity_kbit", "capacity")
    sensors = _number(properties, where, 1.0, "max_sensors")
    origin = properties.get("origin", "surveyed")
    for key in ("max_height", "height", "min_height"):
        if (
            key in properties
            and not 0 <= (height := _number(properties, where, 0.0, key)) <= MAX_POLE_M
        ):
            unit = (
                f" (is it {height / 100:g} m, in centimetres?)"
                if MAX_POLE_M < height <= 100 * MAX_POLE_M
                else ""
            )
            rule = f"must be in m above the foot, 0 to {MAX_POLE_M:g}"
            raise ValueError(f"{where}.properties.{key} {rule}, got {height:g}{unit}")
    if not capacity > 0:
        key = "capacity_kbit" if "capacity_kbit" in properties else "capacity"
        raise ValueError(
            f"{where}.properties.{key} must be above 0 kbit per frame, got {capacity:g}"
        )
    try:
        return Mount(name, foot, *heights, price, capacity, sensors, origin)  # type: ignore[arg-type]  # checked there
    except ValueError as error:
        raise ValueError(f"{where} (pole {name!r}): {error}") from None


def _check(mounts: Sequence[Mount], site: Site, where: str) -> None:
    """Raise ValueError for poles that coincide or are out of place."""
    names = [mount.name for mount in mounts]
    feet = np.array([mount.position for mount in mounts])
    distance = shapely.distance(shapely.box(*site.area), shapely.points(feet[:, :2]))
    far = np.flatnonzero(~(distance <= SURROUNDINGS))
    if len(far):
        others = f" (and {len(far) - 1} more)" if len(far) > 1 else ""
        raise ValueError(
            f"{where}: pole {names[far[0]]!r}{others} stands {distance[far[0]]:.0f} m from the "
            f"area of site {site.name!r}, more than {SURROUNDINGS:g} m: longitude comes first; "
            "leave out the poles of other places"
        )
    high = np.flatnonzero(np.abs(feet[:, 2] - site.ground(feet[:, :2])) > ABOVE_GROUND)
    if len(high):
        said = f"{where}: pole {names[high[0]]!r} has its foot at z = {feet[high[0], 2]:g} m"
        raise ValueError(
            f"{said}, more than {ABOVE_GROUND:g} m from the ground of the site: leave out altitudes"
        )
    (name, times), *_ = Counter(names).most_common(1)
    if times > 1:
        raise ValueError(f"{where}: {times} poles are named {name!r}: rename all but one")
    alike = defaultdict(list)
    for name in names:
        alike[_file_name(name)].append(name)
    for same in alike.values():
        if len(same) > 1:
            pair = " and ".join(map(ascii, same[:2]))
            reason = "differ only in spaces, in how accents are encoded, or in / and -"
            raise ValueError(
                f"{where}: names of poles must be told apart, but {pair} {reason}: rename one"
            )
    spots = shapely.points(feet[:, :2])
    pairs = shapely.STRtree(spots).query(spots, "dwithin", SAME_PLACE).T
    pairs = pairs[pairs[:, 0] < pairs[:, 1]]
    if len(pairs):
        pair = " and ".join(repr(names[k]) for k in pairs[np.lexsort(pairs.T[::-1])[0]])
        raise ValueError(f"{where}: poles {pair} stand at the same place: remove one of them")


def _is_drawn(properties: Json, geometry: Json) -> bool:
    """True for a line or an area that does not say what it is, as those of sites and keep-out areas
    do."""
    if {"layer", "kind"} & properties.keys() or properties.get("keep_out"):
        return False
    return any(word in str(geometry.get("type")) for word in ("LineString", "Polygon"))


def _file_name(name: str) -> str:
    """Name in the form in which sensors take it over, letters composed as in Unicode's form NFC."""
    return " ".join(unicodedata.normalize("NFC", name).replace("/", "-").split())


def _keep_out(
    collection: Json, site: Site, where: str, *, every: bool = False
) -> Iterator[shapely.Geometry]:
    """Yield keep-out areas in the site's metres. every: those that are not marked too."""
    around = shapely.box(*site.area).buffer(SURROUNDINGS)
    is_near = []
    for place, drawn in _list_keep_out(collection, where, every=every):
        area = shapely.transform(drawn, lambda corners: _in_site(corners, collection, site, where))
        is_near.append(bool(area.intersects(around)))
        if not is_near[-1] and _is_exchanged(drawn, collection, site, around):
            raise ValueError(
                f"{place} has longitude and latitude exchanged: longitude comes first, export it "
                "again"
            )
        if area.area < MIN_AREA_M2:
            raise ValueError(
                f"{place} has no area, as its corners are in one line: draw the area again"
            )
        yield area
    if is_near and not any(is_near):
        far = (
            f"none of its {len(is_near)} keep-out areas is within {SURROUNDINGS:g} m of site "
            f"{site.name!r}"
        )
        warnings.warn(f"{where}: {far}: check that they belong to it", stacklevel=3)


def _is_exchanged(
    drawn: shapely.Geometry, collection: Json, site: Site, around: shapely.Geometry
) -> bool:
    """True if an area would lie `around` the site with longitude and latitude exchanged."""
    if "coview_site" in collection:
        return False
    swapped = shapely.get_coordinates(drawn)[:, ::-1]
    if (np.abs(swapped) > [180.0, 90.0]).any():
        return False
    try:
        return bool(shapely.MultiPoint(site_metres(site, swapped)).intersects(around))
    except ValueError:  # beyond the site's map
        return False


def _list_keep_out(
    collection: Json, where: str, *, every: bool
) -> Iterator[tuple[str, shapely.Geometry]]:
    """Yield places in the file and keep-out areas as they are drawn there."""
    for place, _, properties, geometry in _features(collection, where):
        if not isinstance(marked := properties.get("keep_out", False), bool):
            raise ValueError(
                f"{place}.properties.keep_out must be true or false, got {marked!r:.60}"
            )
        # those of a site are its ground
        area = "Polygon" in str(geometry.get("type")) and "layer" not in properties
        if not (marked or properties.get("kind") == "keep_out" or (every and area)):
            continue
        place = f"{place}.geometry"
        if (kind := geometry.get("type")) not in ("Polygon", "MultiPolygon"):
            raise ValueError(
                f"{place}.type of a keep-out area must be Polygon or MultiPolygon, got {kind}"
            )
        try:
            drawn = shapely.force_2d(shape(geometry))
        except (ValueError, TypeError, LookupError, AttributeError, shapely.errors.ShapelyError):
            raise ValueError(
                f"{place}.coordinates must be closed rings of [x, y] pairs: draw the area again"
            ) from None
        if drawn.is_empty or not np.isfinite(shapely.get_coordinates(drawn)).all():
            raise ValueError(f"{place}.coordinates are empty or hold NaN: draw the area again")
        if not drawn.is_valid:
            why = shapely.is_valid_reason(drawn)
            raise ValueError(f"{place} must be a simple polygon ({why}): draw the area again")
        yield place, drawn
