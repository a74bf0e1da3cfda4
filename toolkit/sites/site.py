"""A junction: detection area, road, solids next to it, sensors, and the network of its traffic.

Site frame: right-handed, metres, z up, zero at the mean height of the street; on a sloping street,
z is 0 at the origin. `map_SE3_site` turns it into the frame of the map from which the site was
taken, which is right-handed too (a CARLA map: x, -y_carla, z)."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, Literal, get_args
from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.arrays import Float, Float64, Pose
from toolkit.display import Card, Displayed, Table, describe_count
from toolkit.frozen import set_fields
from toolkit.geometry import LEVEL, MAX_COORDINATE_M, Slope, check_pose, check_slope
from toolkit.sensors.sensor import Sensor, tabulate_sensors

_STREET_KINDS = ("building", "wall", "fence", "hedge", "bush", "tree", "trunk", "post", "sign")
_FURNITURE_KINDS = ("bin", "bench", "shelter", "container", "cabinet", "planter")
_WORKS_KINDS = ("barrier", "cone", "heap", "machine", "bicycle")
_GROUND_KINDS = ("kerb", "island", "pond")
KINDS = _STREET_KINDS + _FURNITURE_KINDS + _WORKS_KINDS + _GROUND_KINDS
# taken from a map, measured on site, or made up by coview
ORIGINS = ("mapped", "surveyed", "drawn")
MAX_BUILT_HEIGHT_M = 1000.0  # for solids and mounts
# m, rad: numbers of equal sites differ by no more, which is what angles lose as degrees in a file
EQUAL_TOLERANCE = 1e-9
Furnishing = Literal["none", "light", "dense"]  # how much of a site's surroundings coview drew
HYBRID_RADIUS_M = 20.0  # unless the paper gives another for a site (its section IV-B)


@dataclass(frozen=True, eq=False)
class Solid:
    """Upright prism that never moves, from `base` up to `top` (z in m, site frame).

    footprint: (k, 2) corners x, y (m) of a simple polygon, the first not repeated; kind: one of
    `KINDS`; origin: one of `ORIGINS`. A tree is several solids, a `trunk` and a crown (`tree`). A
    `pond` is a hole: there is no ground inside its footprint, but a surface at `top`, below the
    street."""

    footprint: Float64[np.ndarray, "k 2"]
    base: float
    top: float
    kind: str = "building"
    origin: str = "mapped"

    def __post_init__(self) -> None:
        """Check the footprint, kind, origin and heights. Raises ValueError if one is wrong."""
        set_fields(self, footprint=check_polygon(self.footprint, "solid.footprint"))
        if self.kind not in KINDS:
            raise ValueError(f"solid.kind must be one of {', '.join(KINDS)}, got {self.kind!r}")
        _check_origin(self.origin, "solid.origin")
        if not (np.isfinite([self.base, self.top]).all() and self.base < self.top):
            raise ValueError(
                f"solid.top must lie above its base, got base {self.base} and top {self.top}"
            )
        if self.top - self.base > MAX_BUILT_HEIGHT_M:
            raise ValueError(
                f"a solid is at most {MAX_BUILT_HEIGHT_M:g} m high, got {self.top - self.base:g}: "
                "give metres"
            )


@dataclass(frozen=True, eq=False)
class Mount:
    """Pole, or corner of a house, that can carry sensors."""

    name: str  # unique in its site
    position: Float64[np.ndarray, "3"]  # foot on the ground: x, y, z (m, site frame)
    min_height: float = 3.0  # lowest height of sensors above the foot (m)
    max_height: float = 8.0  # greatest height of sensors above the foot (m)
    price: float = 1.0  # price of building there, in units of one ordinary mount
    capacity: float = 2000.0  # kbit per frame of its link to the centre, for all its sensors
    max_sensors: int = 1  # most sensors it can carry
    # one of `ORIGINS`; places along the kerb that an import suggests are drawn
    origin: str = "mapped"

    def __post_init__(self) -> None:
        """Check all fields, and turn them into arrays and numbers. Raises ValueError."""
        position = np.asarray(self.position, np.float64)
        if position.shape != (3,) or not np.isfinite(position).all():
            raise ValueError(
                f"mount.position must be three finite numbers x, y, z, got {self.position}"
            )
        if not np.abs(position).max() <= MAX_COORDINATE_M:
            rule = f"mount.position must lie within {MAX_COORDINATE_M:g} m of the origin"
            raise ValueError(f"{rule}, got {position.tolist()}: give metres of the site")
        set_fields(self, position=position)
        if not 0 <= self.min_height <= self.max_height <= MAX_BUILT_HEIGHT_M:
            got = f"{self.min_height:g} and {self.max_height:g}"
            raise ValueError(
                f"mount.min_height <= max_height must lie in 0..{MAX_BUILT_HEIGHT_M:g} m, got {got}"
            )
        if not 0 <= self.price < np.inf or not self.capacity > 0:
            raise ValueError(
                f"mount needs price >= 0 and capacity > 0, got {self.price} and {self.capacity}"
            )
        _check_origin(self.origin, "mount.origin")
        if self.max_sensors != int(self.max_sensors) or self.max_sensors < 1:
            raise ValueError(
                f"mount.max_sensors must be a whole number from 1 up, got {self.max_sensors}"
            )
        set_fields(self, max_sensors=int(self.max_sensors))


@dataclass(frozen=True)
class Relief:
    """Shape of the ground: a plane, and unevenness on it (`Site.ground` has the heights)."""

    amplitude: float = 0.0  # largest deviation from the plane (m)
    seed: int = 0  # decides the unevenness: one seed gives one shape
    slope: Slope = LEVEL  # rise of the plane through the site's origin along x and y (m per m)

    def __post_init__(self) -> None:
        """Check all fields, and turn the slope into floats. Raises ValueError."""
        if not 0 <= self.amplitude < np.inf:
            raise ValueError(
                f"relief.amplitude must be finite and not negative, got {self.amplitude}"
            )
        if self.seed != int(self.seed) or self.seed < 0:
            raise ValueError(f"relief.seed must be a whole number from 0 up, got {self.seed}")
        set_fields(self, slope=check_slope(self.slope, "relief.slope"))


@dataclass(frozen=True, eq=False)
class Site(Displayed):
    """A junction: detection area, roads, solids, mounts, sensors and network.

    Two sites are equal if all fields are, numbers to `EQUAL_TOLERANCE`, networks line by line.
    Raises ValueError that names the field that does not fit.

    Attributes:
        name: name of the site.
        area: xmin ymin xmax ymax (m) of the detection area.
        height: height up to which points are kept (m).
        lanes: polygons of the ground for wheels, in and around the area, each with corners x, y
            (m), the first not repeated.
        footways: polygons of the ground for feet, as `lanes`.
        solids: buildings, furniture and other things that never move.
        mounts: possible places of sensors, with unique names.
        sensors: sensors that are present, with unique names.
        parking: a row for each bay: x, y (m) of its middle, yaw (rad) of a vehicle in it.
        parking_origins: origin of each bay in the order of `parking`, () for all mapped.
        road_origin: origin of lanes, footways and network.
        furnished: density of the surroundings that coview drew because the map lacks them.
        network: SUMO net.xml text in site coordinates, "" for a site without traffic.
        map_SE3_site: pose of the site in the map frame, which turns site into map coordinates.
        geo_reference: PROJ string of the map frame, None if unknown.
        relief: shape of the ground.
        hybrid_radius: m within which sensors send no points in hybrid fusion (paper IV-B)."""

    name: str
    area: Float64[np.ndarray, "4"]
    height: float = 4.0
    lanes: tuple[Float64[np.ndarray, "_ 2"], ...] = ()
    footways: tuple[Float64[np.ndarray, "_ 2"], ...] = ()
    solids: tuple[Solid, ...] = ()
    mounts: tuple[Mount, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    parking: Float64[np.ndarray, "n 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    parking_origins: tuple[str, ...] = ()
    road_origin: str = "mapped"
    furnished: Furnishing = "none"
    network: str = ""
    map_SE3_site: Pose = field(default_factory=lambda: np.eye(4))
    geo_reference: str | None = None
    relief: Relief = Relief()
    hybrid_radius: float = HYBRID_RADIUS_M

    def __post_init__(self) -> None:
        """Check the fields, and convert them to arrays and tuples.

        Raises ValueError with the name of a field that does not fit."""
        checked_fields: dict[str, Any] = {"area": check_area(self.area)}
        if not 0 < self.height < np.inf:
            raise ValueError(f"height must be positive, got {self.height}")
        if not 0 <= self.hybrid_radius < np.inf:
            raise ValueError(
                f"hybrid_radius must be finite and at least 0 m, got {self.hybrid_radius}"
            )
        for layer in ("lanes", "footways"):
            checked_fields[layer] = tuple(
                check_polygon(p, f"{layer}[{i}]") for i, p in enumerate(getattr(self, layer))
            )
        for layer in ("solids", "mounts", "sensors"):
            checked_fields[layer] = tuple(getattr(self, layer))
        for layer in ("mounts", "sensors"):
            _check_unique([entry.name for entry in checked_fields[layer]], layer)
        bays = np.asarray(self.parking, np.float64)
        checked_fields["parking"] = bays = bays.reshape(-1, 3) if bays.size == 0 else bays
        if bays.ndim != 2 or bays.shape[1] != 3 or not np.isfinite(bays).all():
            raise ValueError(f"parking must be finite rows x, y, yaw, got shape {bays.shape}")
        checked_fields["parking_origins"] = origins = tuple(self.parking_origins)
        if len(origins) not in (0, len(bays)):
            raise ValueError(
                f"parking_origins needs one for each of {len(bays)} bays, got {len(origins)}"
            )
        for origin in {*origins, self.road_origin}:
            _check_origin(origin, "parking_origins" if origin in origins else "road_origin")
        if set(origins) == {"mapped"}:
            checked_fields["parking_origins"] = ()
        if self.furnished not in get_args(Furnishing):
            raise ValueError(
                f"furnished must be one of {', '.join(get_args(Furnishing))}, got "
                f"{self.furnished!r}"
            )
        _check_network(self.network)
        checked_fields["map_SE3_site"] = check_pose(self.map_SE3_site, "map_SE3_site")
        set_fields(self, **checked_fields)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Site) and _are_equal(self, other)

    __hash__ = None  # type: ignore[assignment]

    def _card(self) -> Card:
        """Card that a notebook shows: size and counts, then tables of sensors and of mounts."""
        xmin, ymin, xmax, ymax = self.area
        layers = {
            "lane polygon": self.lanes,
            "solid": self.solids,
            "mount": self.mounts,
            "parking bay": self.parking,
        }
        facts = [f"{xmax - xmin:g} x {ymax - ymin:g} m"]
        facts += [describe_count(len(layer), name) for name, layer in layers.items()]
        names = [f"{sensor.name} ({type(sensor.model).__name__})" for sensor in self.sensors[:4]]
        more_text = f" and {len(self.sensors) - 4} more" if len(self.sensors) > 4 else ""
        facts.append(f"sensors {', '.join(names) or 'none'}{more_text}")
        tables = {"sensors": lambda: tabulate_sensors(self.sensors), "mounts": self._list_mounts}
        if not self.sensors:  # the first table is the one that opens
            tables = dict(reversed(tables.items()))
        return Card(
            title=f"Site({self.name!r})",
            facts=tuple(facts),
            tables=tables,
            drawing="toolkit.plots.plan_view:draw_site",
        )

    def _list_mounts(self) -> Table:
        """Columns of a table of the mounts, a row for each, in metres of the site frame."""
        positions = np.array([mount.position for mount in self.mounts])
        x, y, _ = positions.reshape(-1, 3).T  # reshape is for a site without mounts
        return {
            "name": [mount.name for mount in self.mounts],
            "x": x,
            "y": y,
            "min_height": [mount.min_height for mount in self.mounts],
            "max_height": [mount.max_height for mount in self.mounts],
            "price": [mount.price for mount in self.mounts],
            "origin": [mount.origin for mount in self.mounts],
        }

    @property
    def bay_origins(self) -> tuple[str, ...]:
        """Origin of each bay in the order of `parking`, one of `ORIGINS`."""
        return self.parking_origins or ("mapped",) * len(self.parking)

    def ground(self, xy: Float[np.ndarray, "*n 2"]) -> Float64[np.ndarray, "*n"]:
        """Height of the ground (z in m, site frame) at places x, y (m), shape (..., 2).

        Returns shape (...): the plane plus the relief's unevenness. The unevenness is a smooth,
        seeded sum of plane waves 7 to 160 m long, whose mean over a large place is zero. Ponds,
        kerbs and islands are solids, not ground."""
        xy = np.asarray(xy, np.float64)
        plane = self.plane(xy)
        if self.relief.amplitude == 0:
            return plane
        rng = np.random.default_rng(self.relief.seed)
        wavelengths = np.array([160.0, 90, 50, 28, 16, 11, 7])  # m
        relative_heights = np.array([5.0, 4, 4, 3, 2, 1, 1])  # each wave's, in the same order
        directions = rng.uniform(0, 2 * np.pi, len(wavelengths))
        # (2, waves), rad per m
        wave_vectors = 2 * np.pi / wavelengths * np.stack([np.cos(directions), np.sin(directions)])
        phases = rng.uniform(0, 2 * np.pi, len(wavelengths))
        # m; their sum, the largest deviation that all waves can add up to, is the amplitude
        heights = self.relief.amplitude * relative_heights / relative_heights.sum()
        return np.asarray(plane + np.cos(xy @ wave_vectors + phases) @ heights)

    def plane(self, xy: Float[np.ndarray, "*n 2"]) -> Float64[np.ndarray, "*n"]:
        """Height (m) of the sloping plane, without unevenness, at places x, y, shape (..., 2)."""
        # + 0.0 makes 0 of -0
        return np.asarray(
            np.asarray(xy, np.float64) @ np.array(self.relief.slope, np.float64) + 0.0
        )


def _are_equal(first: object, second: object) -> bool:
    """Test two field values or dataclasses for equality.

    Floats and arrays are equal to `EQUAL_TOLERANCE`, texts line by line, so that line ends do not
    count, dataclasses and tuples entry by entry."""
    if is_dataclass(first):
        names = [entry.name for entry in fields(first)]
        return type(first) is type(second) and all(
            _are_equal(getattr(first, name), getattr(second, name)) for name in names
        )
    if isinstance(first, tuple) and isinstance(second, tuple):
        return len(first) == len(second) and all(map(_are_equal, first, second))
    if isinstance(first, str) and isinstance(second, str):
        return first.splitlines() == second.splitlines()
    if isinstance(first, float | np.ndarray) and isinstance(second, float | np.ndarray):
        return np.shape(first) == np.shape(second) and np.allclose(
            first, second, rtol=0, atol=EQUAL_TOLERANCE
        )
    return bool(first == second)


class PlaceMismatch(ValueError):
    """A detector was opened for a place that it is not for."""


def check_area(area: object) -> Float64[np.ndarray, "4"]:
    """Return `area` as an array xmin ymin xmax ymax (m).

    Raises ValueError if it is not four finite numbers, is empty, or is longer than 10 km or larger
    than 4 km²."""
    box = np.asarray(area, np.float64)
    if box.shape != (4,) or not np.isfinite(box).all():
        raise ValueError(f"area must be four finite numbers xmin, ymin, xmax, ymax, got {area}")
    low_corner = box[:2]  # x, y
    high_corner = box[2:]
    if not (low_corner < high_corner).all():
        raise ValueError(f"area is empty: it needs xmin < xmax and ymin < ymax, got {box.tolist()}")
    # divided first, so that huge numbers do not overflow
    size_km = high_corner / 1e3 - low_corner / 1e3
    if not (size_km.max() <= 10 and size_km.prod() <= 4):
        raise ValueError(
            f"area must be at most 10 km long and 4 km² large, got {box.tolist()}: cut it into "
            "several"
        )
    return box


def check_polygon(vertices: object, where: str) -> Float64[np.ndarray, "k 2"]:
    """Return `vertices` as an array (k, 2) of corners x, y (m), in their order.

    Raises ValueError, which begins with `where`, the name of the polygon to the user, if they are
    not three finite corners or more, cross themselves, or enclose no area."""
    try:
        polygon = np.asarray(vertices, np.float64)
    except (TypeError, ValueError):
        raise ValueError(
            f"{where} must be a list of [x, y] pairs of numbers, got {str(vertices)[:60]}"
        ) from None
    if polygon.ndim != 2 or polygon.shape[1] != 2 or len(polygon) < 3:
        raise ValueError(
            f"{where} must be at least three [x, y] corners, got shape {polygon.shape}"
        )
    is_finite = np.isfinite(polygon).all(axis=1)
    if not is_finite.all():
        first = int(np.argmin(is_finite))
        raise ValueError(f"{where} holds NaN or infinite numbers at corner {first}")
    shape = shapely.Polygon(polygon)
    if not shape.is_valid:
        # the reason ends in the place, as [x y]
        _, _, place = shapely.is_valid_reason(shape).partition("[")
        xy = place.rstrip("]").replace(" ", ", ")
        raise ValueError(
            f"{where}: polygon crosses itself near ({xy}): put its corners in order round the "
            "outline"
        )
    if shape.area < 1e-6:
        raise ValueError(
            f"{where}: polygon has no area, its corners lie on one line near {polygon[0].tolist()}"
        )
    return polygon


def _check_origin(origin: object, where: str) -> None:
    """Raise ValueError unless an origin is one of `ORIGINS`.

    where: name of the field to the user."""
    if origin not in ORIGINS:
        raise ValueError(f"{where} must be one of {', '.join(ORIGINS)}, got {origin!r:.60}")


def _check_unique(names: Sequence[str], where: str) -> None:
    """Raise ValueError if a name is no text, is empty, or is there twice.

    where: layer of the names."""
    first_index: dict[str, int] = {}  # index of the first entry with a name
    for i, name in enumerate(names):
        if not name or not isinstance(name, str):
            raise ValueError(f"{where}[{i}].name must be a text that is not empty, got {name!r}")
        first = first_index.setdefault(name, i)
        if first != i:
            raise ValueError(
                f"{where}[{i}].name {name!r} is taken by {where}[{first}]: rename one of them"
            )


def _check_network(network: str) -> None:
    """Raise ValueError unless the network is "" or the text of a SUMO network with edges."""
    if not network:
        return
    try:
        root = ElementTree.fromstring(network)
    except ElementTree.ParseError as error:
        raise ValueError(
            f"network is damaged XML ({error}): build it again with toolkit.sites.network"
        ) from None
    if root.tag != "net" or root.find("edge") is None:
        raise ValueError(
            f"network must be a SUMO <net> with edges, got <{root.tag}>: pass the text of a "
            ".net.xml"
        )
