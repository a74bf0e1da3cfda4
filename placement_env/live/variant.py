"""`Variant`: sensors on poles as they are moved by hand. `Yard`: the ground that poles may use."""

import math
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from string import ascii_lowercase
from typing import Any

import numpy as np
import shapely

from placement_env.candidates.candidates import Candidates, aim_sensor, aims, name_sensor
from toolkit.arrays import Float64
from toolkit.geometry import MAX_COORDINATE_M, pose
from toolkit.runtime.json_object import JsonObject
from toolkit.runtime.reading import name_errors
from toolkit.sensors.models import name_in_words
from toolkit.sensors.sensor import Sensor, SensorModel
from toolkit.sites.site import Mount, Site

TILT_SPAN_RAD = (float(np.deg2rad(-10.0)), float(np.deg2rad(89.0)))  # rad below the horizon
SNAP_M = 1.5  # distance from a pole within which a dragged sensor is taken to be on it
PASSABLE = ("kerb", "island")  # kinds of solids that may carry a pole
KERB_GAP_M = 0.3  # least distance between a pole and a lane, wall or keep-out area
MAX_DRAWN_POLE_DISTANCE_M = 100.0  # greatest distance of an additional pole from the detection area
MAX_NAME_LENGTH = 60
# limits of a variant that is read
MAX_VARIANT_SENSORS = 1000
MAX_VARIANT_POLES = 1000
MAX_TURN_RAD = 1000.0
SLACK_M = 1e-6  # rounding that is forgiven, in m, and for angles in rad
MAX_FOOT_GAP_M = 20.0  # between the foot of a pole and the ground
KEEP_OUT_REASON = "it is a keep-out area"  # in errors
PoleOrSpot = str | tuple[float, float]  # name of a pole, or x and y of a place (m)
Corners = tuple[tuple[float, float], ...]  # x and y (m) of each corner of an area


@dataclass(frozen=True)
class LiveSensor:
    """Sensor on a pole.

    Attributes:
        name: Name of the sensor.
        model: Name of its model in the stock.
        mount: Name of its pole.
        x: Position along the site's x axis (m), within `SNAP_M` of the pole.
        y: Position along the site's y axis (m).
        height: Height above the foot of the pole (m).
        heading: Heading, counter-clockwise from the site's +x (rad).
        tilt: Tilt below the horizon (rad).
        locked: Whether it may not be moved.
        failed: Whether it is mounted, but sees and sends nothing.
    """

    name: str
    model: str
    mount: str
    x: float
    y: float
    height: float
    heading: float
    tilt: float
    locked: bool = False
    failed: bool = False


@dataclass(frozen=True)
class Variant:
    """Sensors on poles, as they are moved by hand; each change makes another variant.

    Attributes:
        sensors: Sensors on poles of the stock or on `poles`.
        poles: Additional poles, which the stock lacks.
        keep_out: Corners of each area that no pole may use.
    """

    sensors: tuple[LiveSensor, ...] = ()
    poles: tuple[Mount, ...] = ()
    keep_out: tuple[Corners, ...] = ()

    def find(self, name: str) -> LiveSensor:
        """Return a sensor by name. Raises ValueError for an unknown one."""
        for sensor in self.sensors:
            if sensor.name == name:
                return sensor
        names = ", ".join(sensor.name for sensor in self.sensors) or "none"
        raise ValueError(f"there is no sensor {name!r}: the sensors are {names}")

    def find_unlocked(self, name: str) -> LiveSensor:
        """Return a sensor by name. Raises ValueError for an unknown or locked one."""
        sensor = self.find(name)
        if sensor.locked:
            raise ValueError(f"{name} is locked: unlock it first")
        return sensor

    def with_sensor(self, sensor: LiveSensor) -> "Variant":
        """Return the variant with a sensor in place of the one with the same name."""
        return replace(
            self,
            sensors=tuple(
                sensor if present.name == sensor.name else present for present in self.sensors
            ),
        )

    def without_sensor(self, name: str) -> "Variant":
        """Return the variant without the named sensor; unchanged if there is none."""
        return replace(self, sensors=tuple(s for s in self.sensors if s.name != name))

    def without_idle_poles(self) -> "Variant":
        """Return the variant without additional poles that carry no sensor."""
        mounts_in_use = {sensor.mount for sensor in self.sensors}
        return replace(self, poles=tuple(p for p in self.poles if p.name in mounts_in_use))

    def keeps_out(self, mount: Mount) -> bool:
        """True if a pole is in a keep-out area of the variant, or within `KERB_GAP_M` of one."""
        foot = shapely.Point(mount.position[:2])
        return any(shapely.Polygon(area).distance(foot) < KERB_GAP_M for area in self.keep_out)

    @property
    def movable_names(self) -> list[str]:
        """Names of the sensors that are neither locked nor failed."""
        return [s.name for s in self.sensors if not s.locked and not s.failed]

    @property
    def working_variant(self) -> "Variant":
        """The variant without the sensors that have failed."""
        return replace(self, sensors=tuple(s for s in self.sensors if not s.failed))

    def as_dict(self) -> dict[str, object]:
        """Return sensors, poles and keep-out areas as JSON values, which `from_dict` reads."""
        poles = [{**vars(pole), "position": pole.position.tolist()} for pole in self.poles]
        areas = [np.array(corners).tolist() for corners in self.keep_out]
        return {
            "sensors": [{**vars(sensor)} for sensor in self.sensors],
            "poles": poles,
            "keep_out": areas,
        }

    @staticmethod
    def from_dict(document: object, where: str = "") -> "Variant":
        """Read a variant from the JSON values that `as_dict` gave.

        where: path of the values in a file, for errors. Raises ValueError that names the value
        that does not fit."""
        variant = JsonObject(document, where)
        variant.check_keys(("sensors", "poles", "keep_out"))
        sensors = tuple(_read_sensor(row) for row in variant.nodes("sensors", MAX_VARIANT_SENSORS))
        poles = tuple(_read_pole(row) for row in variant.nodes("poles", MAX_VARIANT_POLES))
        areas = variant.get("keep_out", list) if "keep_out" in variant.value else []
        with name_errors(variant.where("keep_out")):
            return Variant(sensors, poles, tuple(map(check_keep_out, areas)))


def _read_sensor(row: JsonObject) -> LiveSensor:
    """Sensor from its JSON values, the fields of `LiveSensor`; locked and failed may be missing."""
    row.check_keys([field.name for field in fields(LiveSensor)])
    values: dict[str, Any] = {}
    for key in ("name", "model", "mount"):
        values[key] = row.get(key, str)
    for key in ("x", "y", "height"):  # m
        values[key] = row.number(key, -MAX_COORDINATE_M, MAX_COORDINATE_M)
    for key in ("heading", "tilt"):  # rad
        values[key] = row.number(key, -MAX_TURN_RAD, MAX_TURN_RAD)
    for key in ("locked", "failed"):
        if key in row.value:
            values[key] = row.get(key, bool)
    with name_errors(row.path):
        check_name(values["name"])
        return LiveSensor(**values)


def _read_pole(row: JsonObject) -> Mount:
    """Additional pole from its JSON values, the fields of `Mount`.

    Only name and position are needed."""
    row.check_keys([field.name for field in fields(Mount)])
    position = np.array(row.numbers("position", 3))  # x, y, z (m) of the foot
    name = row.get("name", str)
    optional_values: dict[str, Any] = {}
    if "origin" in row.value:
        optional_values["origin"] = row.get("origin", str)
    for key in ("min_height", "max_height", "price", "capacity", "max_sensors"):
        if key in row.value:
            optional_values[key] = row.number(key)
    with name_errors(row.path):
        return Mount(check_name(name), position, **optional_values)


def check_name(name: str) -> str:
    """Return a name unchanged.

    Raises ValueError unless it is one line of 1 to `MAX_NAME_LENGTH` printable characters."""
    if not 0 < len(name) <= MAX_NAME_LENGTH or not name.isprintable():
        raise ValueError(
            f"a name must be one line of 1 to {MAX_NAME_LENGTH} characters, got {name!r:.70}"
        )
    return name


def check_keep_out(corners: Iterable[Iterable[float]]) -> Corners:
    """Return the corners (x, y in m) of a keep-out area as tuples of floats.

    Raises ValueError unless they are three or more, at most `MAX_COORDINATE_M` from 0, and no edge
    crosses another."""
    rule = "an area needs three corners or more (x, y), and no edge may cross another"
    try:
        rows = tuple((float(x), float(y)) for x, y in corners)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{rule}, got {corners!r:.80}") from None
    has_usable_corners = len(rows) >= 3 and bool((np.abs(rows) <= MAX_COORDINATE_M).all())
    # checked first: fewer corners make shapely raise other errors
    if not has_usable_corners or not shapely.Polygon(rows).is_valid:
        raise ValueError(f"{rule}, got {rows!r:.80}")
    return rows


@dataclass(frozen=True, eq=False)
class Yard:
    """Site, stock and keep-out areas that variants are made of.

    Attributes:
        site: Site with its ground, lanes, solids and present sensors.
        stock: Candidates, whose poles and models a variant may use in any pose.
        keep_out: Areas where no new pole may be, for all variants.
    """

    site: Site
    stock: Candidates
    keep_out: tuple[shapely.Geometry, ...] = ()

    @cached_property
    def models(self) -> dict[str, SensorModel]:
        """Sensor models of the stock by name, such as "depth-camera", then "depth-camera 2"."""
        model_by_name: dict[str, SensorModel] = {}
        for model in self.stock.axes.models:
            stem = name_in_words(type(model).__name__)
            name = stem
            if stem in model_by_name:
                name = f"{stem} {1 + sum(known.startswith(stem) for known in model_by_name)}"
            model_by_name[name] = model
        return model_by_name

    @cached_property
    def mounts(self) -> dict[str, Mount]:
        """Poles of the stock, by name."""
        return {mount.name: mount for mount in self.stock.mounts}

    def find_mount(self, variant: Variant, name: str) -> Mount:
        """Return a pole by its name: one of `self.mounts`, or an additional one of the variant.

        Raises ValueError for an unknown one."""
        mounts = self.mounts | {pole.name: pole for pole in variant.poles}
        if name not in mounts:
            raise ValueError(
                f"there is no pole {name!r}: {', '.join(list(mounts)[:8])} and others are there"
            )
        return mounts[name]

    def name_model(self, model: SensorModel) -> str:
        """Return the name of a sensor model in `models`.

        Raises ValueError if the stock lacks the model."""
        for name, known_model in self.models.items():
            if known_model == model:
                return name
        raise ValueError(f"the stock has no {model}: it has {', '.join(self.models)}")

    @staticmethod
    def from_stock(
        site: Site,
        stock: Candidates,
        sensors: Iterable[Sensor],
        keep_out: Iterable[shapely.Geometry],
    ) -> "Yard":
        """Return a yard: a site with sensors and poses to choose from, the stock.

        Poles and models of present sensors are added to the stock.

        These models cost nothing, and a pole may carry at least as many sensors as it has now.
        sensors: present sensors, each on a pole within `SNAP_M` or on an additional one; keep_out:
        areas closed to new poles."""
        sensors = list(sensors)
        axes = stock.axes
        mounts = [*stock.mounts, *_list_missing_mounts(site, stock, sensors)]
        # each model once, in the order of the sensors
        missing_models = tuple(
            dict.fromkeys(s.model for s in sensors if s.model not in axes.models)
        )
        missing_prices = (0.0,) * len(missing_models)
        axes = replace(
            axes,
            models=(*axes.models, *missing_models),
            prices=(*axes.prices, *missing_prices) if axes.prices else (),
        )
        yard = Yard(site, replace(stock, axes=axes, mounts=tuple(mounts)), tuple(keep_out))
        # number of present sensors by name of the pole
        sensor_counts = Counter(sensor.mount for sensor in yard.place(sensors).sensors)
        mounts = [
            replace(mount, max_sensors=max(mount.max_sensors, sensor_counts[mount.name]))
            for mount in mounts
        ]
        return replace(yard, stock=replace(yard.stock, mounts=tuple(mounts)))

    def place(self, sensors: Iterable[Sensor]) -> Variant:
        """Return a variant of sensors in their poses, each on the nearest pole or an added one.

        The stock offers some heights, headings and tilts. A sensor whose height, heading or tilt
        differs from one of these only by rounding gets exactly that one, any other keeps its
        value. Raises ValueError for a model that the stock lacks."""
        variant = Variant()
        axes = self.stock.axes
        for sensor in sensors:
            x, y, z = sensor.position.tolist()
            (heading,), (tilt,) = aims([sensor])
            mount, variant = self._find_or_add_nearest(variant, (x, y))
            foot_z = float(mount.position[2])
            live_sensor = LiveSensor(
                name=free_name(variant, sensor.name),
                model=self.name_model(sensor.model),
                mount=mount.name,
                x=x,
                y=y,
                height=_find_step(axes.heights, z - foot_z),
                # headings that are a full turn apart are equal
                heading=_find_step(axes.headings, float(heading), math.tau),
                tilt=_find_step(axes.tilts, float(tilt)),
            )
            variant = replace(variant, sensors=(*variant.sensors, live_sensor))
        return variant

    def _find_or_add_nearest(
        self, variant: Variant, spot: tuple[float, float]
    ) -> tuple[Mount, Variant]:
        """Return the nearest pole within `SNAP_M` of a spot, and the variant unchanged.

        Without one, return a new pole on the ground at the spot, otherwise like the nearest, and
        the variant with this pole added. spot: x and y (m)."""
        mounts = [*self.stock.mounts, *variant.poles]
        distances = [float(np.hypot(*(mount.position[:2] - spot))) for mount in mounts]
        nearest = mounts[int(np.argmin(distances))]
        if min(distances) <= SNAP_M:
            return nearest, variant
        foot = np.array([*spot, float(self.site.ground(np.array(spot)))])
        taken_names = {mount.name for mount in mounts}
        number = 1
        while f"own pole {number}" in taken_names:
            number += 1
        pole = replace(
            nearest,
            name=f"own pole {number}",
            position=foot,
            price=max(mount.price for mount in self.stock.mounts),  # as dear as the dearest
            origin="drawn",
        )
        return pole, replace(variant, poles=(*variant.poles, pole))

    def find_or_add_pole(self, variant: Variant, where: PoleOrSpot) -> tuple[Mount, Variant]:
        """Find a pole by name or near a spot, or add one at the spot.

        where: name of a pole, or x and y (m) of a spot; a pole within `SNAP_M` of it is taken.

        Returns:
            The pole, and the variant: the same one, or with the new pole added.

        Raises:
            ValueError: For an unknown pole, and a spot or pole that may not be used.
        """
        if isinstance(where, str):
            mount = self.find_mount(variant, where)
            variant_with_pole = variant
        else:
            x, y = float(where[0]), float(where[1])
            mount, variant_with_pole = self._find_or_add_nearest(variant, (x, y))
            is_new = variant_with_pole is not variant
            if is_new and (reason := self.refusal_reason((x, y))):
                raise ValueError(f"no pole can stand at {x:.1f}, {y:.1f}: {reason}")
        if variant.keeps_out(mount):
            raise ValueError(f"{mount.name} cannot be used: {KEEP_OUT_REASON}")
        return mount, variant_with_pole

    def has_room(self, variant: Variant, mount: str) -> bool:
        """True if a pole, given by name, may carry one more sensor than it has in the variant."""
        max_sensors = self.find_mount(variant, mount).max_sensors
        return sum(sensor.mount == mount for sensor in variant.sensors) < max_sensors

    def check_room(self, variant: Variant, mount: str) -> None:
        """Raise ValueError if a pole, given by name, carries as many sensors as it may."""
        if not self.has_room(variant, mount):
            raise ValueError(f"{mount} carries all the sensors that it may: take another pole")

    def list_kept_out(self, variant: Variant) -> list[str]:
        """Names of the sensors of a variant whose poles are in its keep-out areas."""
        names = []
        for sensor in variant.sensors:
            if variant.keep_out and variant.keeps_out(self.find_mount(variant, sensor.mount)):
                names.append(sensor.name)
        return names

    def refusal_reason(self, spot: tuple[float, float]) -> str:
        """Reason why no new pole may be at a spot (x, y in m), "" if one may.

        The keep-out areas are the yard's; a variant's areas are for `Variant.keeps_out`."""
        point = shapely.Point(spot)
        xmin, ymin, xmax, ymax = self.site.area.tolist()
        if point.distance(shapely.box(xmin, ymin, xmax, ymax)) > MAX_DRAWN_POLE_DISTANCE_M:
            return f"it is more than {MAX_DRAWN_POLE_DISTANCE_M:g} m from the detection area"
        for reason, area in self._forbidden_areas.items():
            if area.distance(point) < KERB_GAP_M:
                return reason
        return ""

    @cached_property
    def _forbidden_areas(self) -> dict[str, shapely.Geometry]:
        """Areas that no new pole may use, joined by reason and prepared for distance queries.

        The reasons are texts for errors, such as "it is on a lane"."""
        obstacles = [
            shapely.Polygon(shape.footprint)
            for shape in self.site.solids
            if shape.kind not in PASSABLE
        ]
        lanes = [shapely.Polygon(lane) for lane in self.site.lanes]
        parts_by_reason = {
            "it is on a lane": lanes,
            "something stands there": obstacles,
            KEEP_OUT_REASON: self.keep_out,
        }
        area_by_reason = {}
        for reason, parts in parts_by_reason.items():
            if len(parts):
                area_by_reason[reason] = shapely.union_all(list(parts))
        for area in area_by_reason.values():
            shapely.prepare(area)
        return area_by_reason

    def candidates(self, variant: Variant) -> Candidates:
        """Sensors of a variant, failed ones included, as candidates in the same order.

        Their mounts are the stock's poles and then the variant's."""
        mounts = (*self.stock.mounts, *variant.poles)
        index_of = {mount.name: k for k, mount in enumerate(mounts)}
        sensors = [self.build_sensor(variant, live_sensor) for live_sensor in variant.sensors]
        aim_rows = [(s.height, s.heading, s.tilt) for s in variant.sensors]
        mount_indices = [index_of[s.mount] for s in variant.sensors]
        stock = replace(self.stock, mounts=mounts) if variant.poles else self.stock
        return Candidates.from_poses(
            sensors,
            mount=np.array(mount_indices, np.int64),
            aim=np.array(aim_rows).reshape(-1, 3),  # three columns even without a sensor
            pool=stock,
        )

    def build_sensor(self, variant: Variant, sensor: LiveSensor) -> Sensor:
        """Build the sensor, with model and pose in the site's frame, that a variant describes."""
        foot_z = float(self.find_mount(variant, sensor.mount).position[2])
        return _build_sensor(sensor, self.models[sensor.model], foot_z)

    def check(self, variant: Variant) -> Variant:
        """Return a variant unchanged if it fits the site and the stock of poles and models.

        Raises ValueError for an unknown model or pole, a repeated name, a sensor that is not on its
        pole or beyond its heights, and a pole that is not at the site."""
        names = [sensor.name for sensor in variant.sensors]
        if len(set(names)) < len(names):
            raise ValueError(f"names of sensors must differ, got {', '.join(names)[:80]}")
        poles = [pole.name for pole in variant.poles]
        if len(set(poles)) < len(poles) or not self.mounts.keys().isdisjoint(poles):
            raise ValueError(
                f"names of poles must differ, also from the site's, got {', '.join(poles)[:80]}"
            )
        for pole in variant.poles:
            self._check_pole(pole)
        for sensor in variant.sensors:
            mount = self.find_mount(variant, sensor.mount)
            if sensor.model not in self.models:
                raise ValueError(
                    f"there is no model {sensor.model!r}: the stock has {', '.join(self.models)}"
                )
            _check_mounting(sensor, mount, self._site_heights.get(mount.name, []))
        return variant

    def _check_pole(self, pole: Mount) -> None:
        """Raise ValueError for a pole far from the detection area, or off the ground.

        A pole of a present sensor of the site may be at any distance."""
        foot_xy = pole.position[:2]
        carries_present_sensor = any(
            np.hypot(*(sensor.position[:2] - foot_xy)) <= SNAP_M for sensor in self.site.sensors
        )
        distance_m = shapely.box(*self.site.area.tolist()).distance(shapely.Point(foot_xy))
        if distance_m > MAX_DRAWN_POLE_DISTANCE_M and not carries_present_sensor:
            problem = (
                f"{pole.name} stands {distance_m:.6g} m from the detection area, more than "
                f"{MAX_DRAWN_POLE_DISTANCE_M:g} m"
            )
            raise ValueError(f"{problem}: move it, or leave it out")
        foot_z = pole.position[2]
        ground_z = float(self.site.ground(foot_xy))
        if abs(foot_z - ground_z) > MAX_FOOT_GAP_M:
            raise ValueError(
                f"{pole.name} has its foot at z = {foot_z:g} m, but the ground is at "
                f"{ground_z:.1f} m"
            )

    @cached_property
    def _site_heights(self) -> dict[str, list[float]]:
        """Heights (m above the foot) of the site's present sensors, by name of the pole."""
        heights = defaultdict[str, list[float]](list)
        for sensor in self.place(self.site.sensors).sensors:
            heights[sensor.mount].append(sensor.height)
        return heights


def _list_missing_mounts(site: Site, stock: Candidates, sensors: Iterable[Sensor]) -> list[Mount]:
    """Mounts of the site within `SNAP_M` of a sensor that the stock lacks by name."""
    spots = [sensor.position[:2] for sensor in sensors]
    known_names = {mount.name for mount in stock.mounts}
    missing_mounts = []
    for mount in site.mounts:
        foot_xy = mount.position[:2]
        carries_sensor = any(np.hypot(*(spot - foot_xy)) <= SNAP_M for spot in spots)
        if carries_sensor and mount.name not in known_names:
            missing_mounts.append(mount)
            known_names.add(mount.name)
    return missing_mounts


def _check_mounting(sensor: LiveSensor, mount: Mount, present_heights: list[float]) -> None:
    """Raise ValueError for a sensor off its pole, beyond its heights, or tilted too far.

    present_heights: heights (m above the foot) of the pole's sensors at the site, which are allowed
    even beyond the pole's range."""
    distance_m = float(np.hypot(sensor.x - mount.position[0], sensor.y - mount.position[1]))
    if distance_m > SNAP_M:
        problem = (
            f"{sensor.name} hangs {distance_m:.6g} m from its pole {mount.name}, more than "
            f"{SNAP_M:g} m"
        )
        raise ValueError(f"{problem}: give it the place of its pole, or carry it to another one")
    # both ends twice, as `min` and `max` need two values if no sensor is present
    low = min(mount.min_height, mount.max_height, *present_heights)
    high = max(mount.min_height, mount.max_height, *present_heights)
    if not low - SLACK_M <= sensor.height <= high + SLACK_M:
        problem = (
            f"{sensor.name} hangs {sensor.height:.6g} m up, but {mount.name} takes {low:g} to "
            f"{high:g} m"
        )
        raise ValueError(f"{problem}: give another height")
    if not abs(sensor.tilt) <= np.pi / 2 + SLACK_M:
        raise ValueError(
            f"{sensor.name} is tilted by {np.rad2deg(sensor.tilt):.4g} degrees, more than 90"
        )


def _find_step(steps: Float64[np.ndarray, " n"], value: float, period: float = math.inf) -> float:
    """Return the step of the stock that equals a value but for rounding, else the value.

    A sensor that was written to a file and read again is then the candidate that it was, with the
    same noise. steps: heights (m), headings or tilts (rad) of the stock; period: turn after which
    values are equal, 2 pi for headings, inf for none."""
    gaps = np.abs([math.remainder(step - value, period) for step in steps.tolist()])
    return float(steps[gaps.argmin()]) if len(gaps) and gaps.min() < SLACK_M else value


@lru_cache(maxsize=64)
def _build_sensor(sensor: LiveSensor, model: SensorModel, foot_z: float) -> Sensor:
    """Sensor of a model in its pose. foot_z: z (m) of the pole's foot.

    Results are cached, as sensors rarely change."""
    position = np.array([sensor.x, sensor.y, foot_z + sensor.height])
    unaimed_sensor = Sensor(sensor.name, model, pose() @ model.body_SE3_sensor)
    return aim_sensor(unaimed_sensor, position, sensor.heading, sensor.tilt)


def name_on_pole(variant: Variant, pole: str) -> str:
    """Return an unused name for one more sensor on a pole: the pole's, with b, c, … if needed.

    After z come numbers. pole: name of the pole."""
    taken_names = {sensor.name for sensor in variant.sensors}
    stem = name_sensor(pole)[:MAX_NAME_LENGTH]
    lettered_names = [_add_suffix(stem, letter) for letter in ascii_lowercase[1:]]  # from b on
    for name in (stem, *lettered_names):
        if name not in taken_names:
            return name
    return free_name(variant, stem)


def free_name(variant: Variant, stem: str) -> str:
    """Return a name that no sensor of the variant has: a stem, with a number if that is taken.

    A number at the end of the stem is replaced: "cam 2" gives "cam 4" if 2 and 3 are taken."""
    taken_names = {sensor.name for sensor in variant.sensors}
    name = stem[:MAX_NAME_LENGTH]
    number = 1
    while name in taken_names:
        number += 1
        name = _add_suffix(stem.rstrip("0123456789").rstrip() or stem, str(number))
    return name


def _add_suffix(stem: str, suffix: str) -> str:
    """Return a stem, a space and a suffix; the stem is cut so that the name is not too long."""
    return f"{stem[: MAX_NAME_LENGTH - len(suffix) - 1]} {suffix}"
