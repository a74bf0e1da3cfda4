"""Sites on earth: longitude and latitude, compass bearings, and GeoJSON (RFC 7946) for GIS tools.

Site → map is `map_SE3_site`, in metres to the map's east and north; map → earth is `geo_reference`,
as PROJ names it. A map in feet, or with axes to the west and south, is turned into these metres by
its description of its axes. The transverse Mercator maps that coview makes of OpenStreetMap
extracts (`projection`) are computed here, all others by pyproj. North is the map's +y. Its angle to
true north (grid convergence) is ignored: it is 0 at the centre of coview's maps and up to 3 degrees
in UTM.

GeoJSON written here is to look at and to draw over; coview itself reads site files
(`toolkit.sites.files`). Outer rings run counter-clockwise and holes clockwise, coordinates have 8
decimals (about 1 mm), the collection has a bbox, and every feature names its `layer`."""

import json
import re
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from shapely.geometry import mapping

from toolkit.arrays import Float, Float64, Pose
from toolkit.geometry import invert, transform
from toolkit.sensors.models import name_in_words
from toolkit.sites.site import Mount, Site

if TYPE_CHECKING:
    from pyproj import CRS, Transformer

_EQUATOR_M = 6378137.0  # radius in WGS84
_ECCENTRICITY_SQUARED = 6.69437999014e-3  # first eccentricity of WGS84
_INVERSE_FLATTENING = 298.257223563  # of WGS84
# less than between WGS84 and GRS80, the ellipsoid of ETRS89, NAD83 and GDA
_WGS84_FLATTENING_GAP = 1e-7
MAX_AXIS_GAP_M = 0.01  # to ellipsoids whose datums are within 2 m of WGS84
MAX_FLATTENING_GAP = 1e-4  # to the same ellipsoids
_SCALE_LENGTH_M = 100.0  # length on the map that is measured on the ground to judge its scale
MAX_STRETCH_SHARE = 0.01  # relative error of a map's scale up to which there is no note
DEGREE_DECIMALS = 8  # for coordinates: about 1 mm
METRE_DECIMALS = 3  # for coordinates
# unit vectors east, north of the directions that PROJ names
_DIRECTIONS = {"east": (1.0, 0.0), "west": (-1.0, 0.0), "north": (0.0, 1.0), "south": (0.0, -1.0)}
# the same by the letters of the axes, for maps about a pole
_POLAR_AXES = {"E": (1.0, 0.0), "X": (1.0, 0.0), "N": (0.0, 1.0), "Y": (0.0, 1.0)}
WGS84 = "EPSG:4326"

_Json = dict[str, Any]


def longitude_latitude(
    site: Site, xy: Float[np.ndarray, "n 2"]
) -> Float64[np.ndarray, "n 2"] | None:
    """Convert site metres to degrees of longitude and latitude (WGS84).

    xy: places in the site frame. Returns rows longitude, latitude in the order of `xy`, or None if
    the site has no known place on earth. Warns if that place is uncertain. Raises ValueError if
    `geo_reference` is no projection or does not reach there; ImportError if pyproj is needed and
    missing."""
    if site.geo_reference is None:
        return None
    xy = np.asarray(xy, np.float64)
    xyz = np.column_stack([xy, np.zeros(len(xy))])
    map_xy = transform(site.map_SE3_site, xyz)[:, :2]
    return _convert(site, site.geo_reference, map_xy, inverse=True)


def site_metres(site: Site, lon_lat: Float[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
    """Convert degrees of longitude and latitude (WGS84) to x, y (m) in the site frame.

    lon_lat: rows longitude, latitude. Warns if the site's place on earth is uncertain. Raises
    ValueError for a site without a known place on earth or a `geo_reference` that is no projection
    or does not reach there; ImportError if pyproj is needed and missing."""
    if site.geo_reference is None:
        raise ValueError(
            f"site {site.name!r} does not say where on earth it is (geo_reference): give site "
            "metres"
        )
    map_xy = _convert(site, site.geo_reference, np.asarray(lon_lat, np.float64), inverse=False)
    map_xyz = np.column_stack([map_xy, np.zeros(len(map_xy))])
    return transform(invert(site.map_SE3_site), map_xyz)[:, :2]


def map_turn(map_SE3_site: Pose) -> float:
    """Direction of a site's x axis on its map (rad, counter-clockwise from the map's +x)."""
    return float(np.arctan2(map_SE3_site[1, 0], map_SE3_site[0, 0]))


def bearing_deg(site: Site, heading: float) -> float:
    """Compass bearing (degrees in 0..360, clockwise from the map's north) of a heading (rad, from
    the site's +x)."""
    turn = map_turn(site.map_SE3_site)
    return round(90.0 - float(np.rad2deg(heading + turn)), 9) % 360.0


def heading_from_bearing(site: Site, bearing: float) -> float:
    """Heading (rad in -pi..pi, from the site's +x) of a compass bearing (degrees), the inverse of
    `bearing_deg`."""
    heading = np.deg2rad(90.0 - bearing) - map_turn(site.map_SE3_site)
    return float(np.arctan2(np.sin(heading), np.cos(heading)))


def projection(longitude: float, latitude: float) -> str:
    """PROJ string of the transverse Mercator map in metres about a point (degrees, WGS84).

    `project` computes this map without pyproj, and `_find_centre` knows it again by its text."""
    origin = f"+lat_0={latitude:.9g} +lon_0={longitude:.10g}"
    return f"+proj=tmerc {origin} +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m +no_defs"


def project(
    lon_lat: Float[np.ndarray, "n 2"], centre: tuple[float, float]
) -> Float64[np.ndarray, "n 2"]:
    """Convert longitude, latitude to metres east, north on a transverse Mercator map.

    lon_lat: rows of degrees (WGS84); centre: longitude, latitude (degrees) of the map's origin.
    Good to 1 mm within 2 km (Snyder, Map Projections, equations 8-9 to 8-15, cut after the
    terms of third order)."""
    longitude, latitude = np.deg2rad(lon_lat).T
    longitude_0, latitude_0 = np.deg2rad(centre)
    sine = np.sin(latitude)
    cosine = np.cos(latitude)
    # n, a, t and c are Snyder's N, A, T and C; n: radius of curvature across the meridian (m)
    n = _EQUATOR_M / np.sqrt(1 - _ECCENTRICITY_SQUARED * sine**2)
    gap = longitude - longitude_0
    # a difference across the antimeridian is brought within a half turn
    gap = np.where(np.abs(gap) > np.pi, (gap + np.pi) % (2 * np.pi) - np.pi, gap)
    a = gap * cosine
    t = np.tan(latitude) ** 2
    c = _ECCENTRICITY_SQUARED / (1 - _ECCENTRICITY_SQUARED) * cosine**2
    east = n * (a + (1 - t + c) * a**3 / 6)
    north = (
        _meridian_length(latitude) - _meridian_length(latitude_0) + n * np.tan(latitude) * a**2 / 2
    )
    return np.stack([east, north], axis=1)


def inverse_project(
    metres: Float[np.ndarray, "n 2"], centre: tuple[float, float]
) -> Float64[np.ndarray, "n 2"]:
    """Convert metres east, north on a transverse Mercator map to longitude, latitude (degrees).

    This is the inverse of `project`, found by five steps of Newton's method from the centre.
    centre: longitude, latitude (degrees) of the map's origin. Longitudes come back in -180..180."""
    # rows longitude, latitude; both columns are views, which change with it
    degrees = np.tile(np.asarray(centre, np.float64), (len(metres), 1))
    longitude, latitude = degrees.T
    for _ in range(5):
        # m per rad of longitude and latitude on a sphere, which is near enough for a step
        cosines = np.stack([np.cos(np.deg2rad(latitude)), np.ones(len(degrees))], axis=1)
        radii = _EQUATOR_M * cosines
        degrees += np.rad2deg((metres - project(degrees, centre)) / radii)
    longitude[:] = np.where(
        np.abs(longitude) > 180.0, (longitude + 180.0) % 360.0 - 180.0, longitude
    )
    return degrees


def _meridian_length(
    latitude: float | Float64[np.ndarray, "*n"],
) -> float | Float64[np.ndarray, "*n"]:
    """Distance (m) along the meridian from the equator to a latitude (rad).

    Snyder, Map Projections, equation 3-21."""
    e2 = _ECCENTRICITY_SQUARED
    return _EQUATOR_M * (
        (1 - e2 / 4 - 3 * e2**2 / 64 - 5 * e2**3 / 256) * latitude
        - (3 * e2 / 8 + 3 * e2**2 / 32 + 45 * e2**3 / 1024) * np.sin(2 * latitude)
        + (15 * e2**2 / 256 + 45 * e2**3 / 1024) * np.sin(4 * latitude)
        - 35 * e2**3 / 3072 * np.sin(6 * latitude)
    )


def project_to_map(reference: str, lon_lat: tuple[float, float]) -> tuple[float, float]:
    """Convert longitude and latitude (degrees) to metres east and north on a map.

    reference: PROJ text of the map. Raises ValueError if it names no map, and ImportError if the
    map needs pyproj and it is missing."""
    centre = _find_centre(reference)  # None for a map that is not coview's, for pyproj
    degrees = np.array([lon_lat], np.float64)
    metres = _open_map(reference).to_metres(degrees) if centre is None else project(degrees, centre)
    ((east, north),) = metres.tolist()
    return east, north


def doubt_place(geo_reference: str | None) -> str | None:
    """Return a note on what is uncertain about a map's place on earth.

    geo_reference: PROJ text of the map, None if unknown. Returns None if nothing is uncertain,
    without a reference, and without pyproj. Raises ValueError, which names the reason, for a
    reference that is no map in lengths."""
    if geo_reference is None or _find_centre(geo_reference) is not None:
        return None
    try:
        return _open_map(geo_reference).doubt
    except ImportError:
        return None


def doubt_scale(site: Site) -> str | None:
    """Return a note on how much a site's map stretches lengths.

    Returns None for less than `MAX_STRETCH_SHARE`, for a site without a known place on earth, and
    without pyproj. Raises the ValueError of `longitude_latitude`."""
    # origin of the site, and the ends of a length along its x and along its y
    corners = np.array([[0.0, 0.0], [_SCALE_LENGTH_M, 0.0], [0.0, _SCALE_LENGTH_M]])
    try:
        degrees = longitude_latitude(site, corners)
    except ImportError:
        return None
    if degrees is None:
        return None
    origin, *ends = degrees
    longitude, latitude = origin.tolist()
    # m on the ground: a map about the origin does not stretch near it
    east, north = project(np.array(ends), (longitude, latitude)).T
    lengths = np.hypot(east, north)
    errors = np.abs(lengths / _SCALE_LENGTH_M - 1)  # relative
    if errors.max() < MAX_STRETCH_SHARE:
        return None
    ground_length = lengths[errors.argmax()]
    return (
        f"its map stretches lengths: {_SCALE_LENGTH_M:g} m on it are {ground_length:.1f} m on the "
        "ground, which no figure heeds"
    )


def _find_centre(reference: str) -> tuple[float, float] | None:
    """Longitude and latitude (degrees) of the centre of a map that `projection` named.

    reference: PROJ text. Returns None for all other maps, which need pyproj."""
    match = re.search(r"\+lat_0=([-+.\de]+) \+lon_0=([-+.\de]+) ", reference)
    if match is None:
        return None
    latitude, longitude = map(float, match.groups())
    # the whole text must be as we write it, not only its origin
    return (longitude, latitude) if projection(longitude, latitude) == reference else None


def _convert(
    site: Site, reference: str, points: np.ndarray, *, inverse: bool
) -> Float64[np.ndarray, "n 2"]:
    """Convert longitude, latitude (degrees) to metres east, north on a site's map, or back.

    reference: the site's `geo_reference`; points: rows of degrees, or of metres if `inverse`. Warns
    if the map's place on earth is uncertain. Raises ValueError if the reference names no map or
    the map does not reach a point, ImportError if it needs pyproj and it is missing."""
    centre = _find_centre(reference)
    if centre is not None:
        return inverse_project(points, centre) if inverse else project(points, centre)
    try:
        earth_map = _open_map(reference)
    except ImportError:
        needs = "needs pyproj: pip install 'coview[report]'"
        raise ImportError(
            f"the map of site {site.name!r} ({reference}) {needs}", name="pyproj"
        ) from None
    except ValueError as error:
        raise ValueError(
            f"geo_reference of site {site.name!r} {error}: correct it in the site file, or set it "
            "to null"
        ) from None
    if earth_map.doubt is not None:
        warnings.warn(f"site {site.name!r}: {earth_map.doubt}", stacklevel=4)
    converted_points = earth_map.to_degrees(points) if inverse else earth_map.to_metres(points)
    is_reached = np.isfinite(converted_points).all(axis=1)
    if not is_reached.all():
        far_point = points[np.argmin(is_reached)].tolist()  # the first one
        problem = f"the map of site {site.name!r} ({reference[:90]}) does not reach {far_point}"
        raise ValueError(f"{problem}: correct geo_reference or the coordinates")
    return converted_points


@dataclass(frozen=True, eq=False)
class _EarthMap:
    """A projected map of PROJ.

    Attributes:
        transformer: from the map's coordinates, as it orders them, to latitude and longitude
            (degrees).
        axes: (2, 2) matrix that turns metres to the east and north into the map's coordinates with
            their directions, order and units.
        doubt: note on what is uncertain about the map's place on earth, None for nothing.
    """

    transformer: "Transformer"
    axes: Float64[np.ndarray, "2 2"]
    doubt: str | None

    def to_degrees(self, metres: Float[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
        """Longitude, latitude (degrees) of places in metres to the east and north on the map.

        Places that the map does not reach come back infinite."""
        latitude, longitude = self.transformer.transform(*(self.axes @ metres.T))
        return np.column_stack([longitude, latitude])

    def to_metres(self, degrees: Float[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
        """Convert longitude, latitude (degrees) to metres to the east and north on the map.

        Places that the map does not reach come back as NaN."""
        longitude, latitude = degrees.T
        # in the map's order, directions and units, to which `axes` leads from metres east, north
        coordinates = np.column_stack(
            self.transformer.transform(latitude, longitude, direction="INVERSE")
        )
        # NaN, since infinities of different signs in a product would warn
        coordinates = np.where(np.isfinite(coordinates), coordinates, np.nan)
        return coordinates @ np.linalg.inv(self.axes).T


@lru_cache(maxsize=8)  # to make one takes longer than to use it
def _open_map(geo_reference: str) -> _EarthMap:
    """Open with pyproj the map that a reference (PROJ text) names.

    Raises ValueError if it is no map; its text begins with a verb whose subject, the name of the
    reference to the user, the caller adds. Raises ImportError without pyproj."""
    from pyproj import CRS, Transformer
    from pyproj.exceptions import ProjError

    quoted = geo_reference[:90]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)  # of +init=
            system = CRS.from_user_input(geo_reference)
    except ProjError:
        raise ValueError(f"names no projection that PROJ knows, got {quoted!r}") from None
    if system.is_compound:  # heights are not converted
        system = system.sub_crs_list[0]
    if not system.is_projected:
        raise ValueError(
            f"names no projection that PROJ knows: it is {_describe_system(system)}, got {quoted!r}"
        )
    axes = _find_axes(system, quoted)
    grids = _list_missing_grids(geo_reference)
    # first the exact way, which fails for a map without a known datum or without its grids
    try:
        exact_transformer = Transformer.from_crs(system, WGS84, allow_ballpark=False)
        return _EarthMap(exact_transformer, axes, doubt=_note_missing_grids(grids))
    except ProjError:
        pass
    # @ marks a grid that may be missing
    if grids and "@" not in geo_reference:
        raise ValueError(
            f"needs the grid {', '.join(grids)}, which PROJ has not here (projsync --file), got "
            f"{quoted!r}"
        )
    try:
        transformer = Transformer.from_crs(system, WGS84)
    except ProjError:
        raise ValueError(
            f"names no projection that PROJ can turn into degrees, got {quoted!r}"
        ) from None
    return _EarthMap(transformer, axes, doubt=_note_unknown_datum(system, quoted))


def _describe_system(system: "CRS") -> str:
    """Words for a system that is no projected map, for an error."""
    if system.is_geographic:
        return "a system of degrees, and a map must be in lengths"
    if system.is_engineering:
        return "a local system without a place on earth"
    return f"a {system.type_name}, not a map"


def _find_axes(system: "CRS", quoted: str) -> Float64[np.ndarray, "2 2"]:
    """Matrix (2, 2) from metres to the east and north into a system's coordinates.

    A row for each axis of the system, in its order and unit. quoted: the reference, for the
    ValueError about axes that do not span the plane."""
    rows = []
    axis_infos = system.axis_info[:2]  # a third axis is the height
    # about a pole, both axes lead away from it in one direction
    is_polar = len({info.direction for info in axis_infos}) < 2
    for axis in axis_infos:
        if is_polar:
            direction = _POLAR_AXES.get(axis.abbrev.upper())
        else:
            direction = _DIRECTIONS.get(axis.direction)
        if direction is None or not axis.unit_conversion_factor:
            raise ValueError(
                f"has an axis {axis.abbrev or axis.name} towards {axis.direction}, got {quoted!r}"
            )
        rows.append(np.array(direction) / axis.unit_conversion_factor)  # m per unit
    axes = np.array(rows)
    if axes.shape != (2, 2) or not np.linalg.det(axes):
        raise ValueError(f"has no axes to the east and north, got {quoted!r}")
    return axes


def _list_missing_grids(geo_reference: str) -> list[str]:
    """List the grids of a PROJ string's datum (`+nadgrids=`) that are not installed."""
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    missing_names = []
    for grid_list in re.findall(r"\+nadgrids=(\S+)", geo_reference):
        for grid in grid_list.split(","):
            name = grid.removeprefix("@")  # @ marks a grid that may be missing
            try:
                if name != "null":  # null: no shift, which needs no file
                    Transformer.from_pipeline(f"+proj=hgridshift +grids={name}")
            except ProjError:
                missing_names.append(name)
    return missing_names


def _note_missing_grids(missing: list[str]) -> str | None:
    """Note for a map whose grids are not installed, None if nothing is missing."""
    if not missing:
        return None
    return (
        f"the grid {', '.join(missing)} of its map is not installed, so its place on earth may be "
        "200 m off"
    )


def _note_unknown_datum(system: "CRS", quoted: str) -> str | None:
    """Note for a system without a datum, whose place on WGS84 PROJ only guesses.

    The more its ellipsoid differs from WGS84's, the larger the error that the note names; None if
    the ellipsoid is as good as WGS84's. quoted: the reference, for the note."""
    axis_gap = flattening_gap = np.inf  # without an ellipsoid
    if system.ellipsoid:
        axis_gap = abs(system.ellipsoid.semi_major_metre - _EQUATOR_M)
        flattening_gap = abs(system.ellipsoid.inverse_flattening - _INVERSE_FLATTENING)
    if axis_gap > MAX_AXIS_GAP_M or flattening_gap > MAX_FLATTENING_GAP:
        deviation = "some 100 m"
    elif flattening_gap > _WGS84_FLATTENING_GAP:
        deviation = "2 m"
    else:
        return None
    return (
        f"its map ({quoted}) names no datum that is known, so its place on earth may be "
        f"{deviation} off"
    )


def site_geojson(site: Site) -> str:
    """GeoJSON text of a site in longitude and latitude, a feature for each of its parts.

    Raises ValueError for a site without a place, ImportError without pyproj."""
    if site.geo_reference is None:
        problem = f"site {site.name!r} does not say where on earth it is (geo_reference is null)"
        remedy = "import it from a map that has, or use the site file, which is GeoJSON in metres"
        raise ValueError(f"{problem}, so it has no longitude and latitude: {remedy}")
    return feature_collection(_layers(site), name=site.name)


def feature(site: Site, geometry: shapely.Geometry, **properties: object) -> _Json:
    """GeoJSON feature of points or polygons that are given in the site frame (m).

    The feature is in degrees of longitude and latitude, or in site metres for a site without a
    place on earth; heights are left out. properties: JSON values of the feature by name."""
    decimals = METRE_DECIMALS if site.geo_reference is None else DEGREE_DECIMALS

    def convert_points(xy: np.ndarray) -> np.ndarray:
        """Coordinates of the feature, rounded; + 0.0 makes 0 of -0."""
        degrees = longitude_latitude(site, xy)
        return (xy if degrees is None else degrees).round(decimals) + 0.0

    converted_geometry = shapely.transform(shapely.force_2d(geometry), convert_points)
    # outer rings run counter-clockwise, as RFC 7946 asks
    oriented_geometry = shapely.orient_polygons(converted_geometry)
    return {"type": "Feature", "properties": properties, "geometry": mapping(oriented_geometry)}


def mount_feature(site: Site, mount: Mount, **more: object) -> _Json:
    """GeoJSON feature of a mount's foot, with the properties that files of poles have.

    more: further properties, which come last."""
    properties = {
        "layer": "mount",
        "name": mount.name,
        "min_height": mount.min_height,
        "max_height": mount.max_height,
        "price": mount.price,
        "capacity_kbit": mount.capacity,
        "origin": mount.origin,
    }
    if mount.max_sensors > 1:
        more = {"max_sensors": mount.max_sensors, **more}
    return feature(site, shapely.Point(mount.position[:2]), **properties, **more)


def feature_collection(features: Iterable[_Json], **members: object) -> str:
    """JSON text of a FeatureCollection, with a feature on each line.

    members: further members of the collection, before its `bbox` (xmin ymin xmax ymax of all
    features, left out if no feature has a place)."""
    entries = list(features)
    lines = ",\n".join(json.dumps(entry, allow_nan=False, ensure_ascii=False) for entry in entries)
    shapes = [shapely.geometry.shape(entry["geometry"]) for entry in entries]
    # rows xmin ymin xmax ymax, NaN for empty geometries
    bounds = np.array([shapely.bounds(shape) for shape in shapes]).reshape(-1, 4)
    bounds = bounds[np.isfinite(bounds).all(axis=1)]
    all_members = {"type": "FeatureCollection", **members}
    if len(bounds):
        low_corner = bounds[:, :2].min(axis=0).tolist()
        high_corner = bounds[:, 2:].max(axis=0).tolist()
        all_members["bbox"] = low_corner + high_corner
    texts = [
        f"{json.dumps(name)}: {json.dumps(value, allow_nan=False, ensure_ascii=False)}"
        for name, value in all_members.items()
    ]
    return "{\n" + ",\n".join(texts) + f',\n"features": [\n{lines}\n]\n}}\n'


def _layers(site: Site) -> Iterator[_Json]:
    """Features of the area, lanes, footways, solids, bays, mounts and sensors, in this order."""
    yield feature(site, shapely.box(*site.area), layer="area", name=site.name, height=site.height)
    for layer, outlines in (("lane", site.lanes), ("footway", site.footways)):
        for i, outline in enumerate(outlines):
            yield feature(
                site,
                shapely.Polygon(outline),
                layer=layer,
                name=f"{layer}{i:03}",
                origin=site.road_origin,
            )
    for i, solid in enumerate(site.solids):
        properties = {
            "name": f"{solid.kind}{i:03}",
            "kind": solid.kind,
            "origin": solid.origin,
            "base": solid.base,
        }
        heights = {"top": solid.top, "height": round(solid.top - solid.base, 6)}
        yield feature(
            site, shapely.Polygon(solid.footprint), layer="solid", **properties, **heights
        )
    for i, ((x, y, yaw), origin) in enumerate(
        zip(site.parking.tolist(), site.bay_origins, strict=True)
    ):
        bearing = round(bearing_deg(site, yaw), 1) % 360.0
        yield feature(
            site,
            shapely.Point(x, y),
            layer="parking",
            name=f"bay{i:03}",
            bearing_deg=bearing,
            origin=origin,
        )
    yield from (mount_feature(site, mount) for mount in site.mounts)
    for sensor in site.sensors:
        x, y, z = sensor.world_SE3_body[:3, 0]  # unit vector of the forward axis
        model = name_in_words(type(sensor.model).__name__)
        spot = sensor.position[:2]
        height = round(float(sensor.position[2] - site.ground(spot)), 3)
        bearing = round(bearing_deg(site, float(np.arctan2(y, x))), 1) % 360.0
        tilt = round(float(np.rad2deg(np.arctan2(-z, np.hypot(x, y)))), 1) + 0.0
        properties = {"model": model, "height": height, "bearing_deg": bearing, "tilt_deg": tilt}
        yield feature(site, shapely.Point(spot), layer="sensor", name=sensor.name, **properties)
