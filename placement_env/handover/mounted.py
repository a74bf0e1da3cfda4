"""A chosen set as it is mounted.

The site has it; each sensor is described for its installer, with links and materials.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from placement_env.candidates.candidates import Candidates, aims
from placement_env.candidates.sensor_catalogue import SensorCatalogue
from toolkit.arrays import Float64, Int64
from toolkit.sensors.models import name_in_words
from toolkit.sensors.sensor import Sensor
from toolkit.sites.georeference import bearing_deg, longitude_latitude
from toolkit.sites.site import Mount, Site

RATE = 10.0  # frames a second over a link
SAME_SPOT = 0.1  # m between the feet of mounts that count as one
MBIT = 1000.0  # kbit

Chosen = Sequence[int] | Int64[np.ndarray, " k"]


@dataclass(frozen=True)
class PlannedSensor:
    """One sensor of a chosen set, as installers need it.

    x, y, z: position (m, site frame); longitude, latitude: degrees, None without a geographic reference; height: above
    the foot of its pole (m); bearing_deg: compass bearing of the optical axis, clockwise from north (+y of the site's
    map); tilt_deg: below the horizon; kbit, peak_kbit: mean and maximum per frame; capacity_kbit: of its link.
    """

    name: str
    pole: str
    x: float
    y: float
    z: float
    longitude: float | None
    latitude: float | None
    height: float
    bearing_deg: float
    tilt_deg: float
    model: str
    model_price: float
    pole_price: float
    kbit: float
    peak_kbit: float
    capacity_kbit: float


@dataclass(frozen=True)
class LinkLoad:
    """Load of one pole's link, and its capacity.

    The load is at `RATE` frames a second, for the average and the largest frame.
    """

    pole: str
    mbit_s: float
    peak_mbit_s: float
    capacity_mbit_s: float
    share: float
    fits: bool


@dataclass(frozen=True)
class MaterialItem:
    """One line of the bill of materials."""

    item: str
    count: int
    unit_price: float
    price: float


def mounted_site(site: Site, candidates: Candidates, chosen: Chosen, moved: Sequence[Sensor] = ()) -> Site:
    """Return `site` with only the chosen sensors.

    Their mounts are added if it lacks them. chosen: indices of candidates; moved: the same sensors, in that order, as
    placed by a search of continuous poses.
    """
    sensors, mounts = _sensors(candidates, chosen, moved)
    return replace(site, sensors=sensors, mounts=_merge_mounts(site.mounts, mounts))


def format_sensors(
    site: Site,
    candidates: Candidates,
    chosen: Chosen,
    moved: Sequence[Sensor] = (),
    *,
    kbit: Sequence[float] | Float64[np.ndarray, " k"],
    peak_kbit: Sequence[float] | Float64[np.ndarray, " k"],
    model_names: Sequence[str] | None = None,
    model_prices: Sequence[float] | Float64[np.ndarray, " k"] | None = None,
) -> tuple[PlannedSensor, ...]:
    """Describe each sensor of a set for its installer.

    All arguments but the first two follow the order of the set.

    chosen, moved: as for `mounted_site`, whose sensors have the same names; kbit, peak_kbit: sent by each, mean and
    maximum per frame; model_names: None for the usual names of the sensor models; model_prices: None for no price.
    A mount is paid for with the first sensor on it.
    Raises ValueError if their numbers differ; ImportError if the site's map needs pyproj.
    """
    sensors, mounts = _sensors(candidates, chosen, moved)
    names = (
        [name_in_words(type(sensor.model).__name__) for sensor in sensors] if model_names is None else list(model_names)
    )
    prices = np.zeros(len(sensors)) if model_prices is None else np.asarray(model_prices, np.float64)
    figures = {"kbit": kbit, "peak_kbit": peak_kbit, "model_names": names, "model_prices": prices}
    for argument, values in figures.items():
        if len(values) != len(sensors):
            raise ValueError(f"{argument} must hold one value for each of {len(sensors)} sensors, got {len(values)}")
    places = np.array([sensor.position for sensor in sensors]).reshape(-1, 3)
    degrees = longitude_latitude(site, places[:, :2])
    headings, tilts = aims(sensors)
    return tuple(
        PlannedSensor(
            name=sensor.name,
            pole=mount.name,
            **dict(zip("xyz", sensor.position.tolist(), strict=True)),
            longitude=None if degrees is None else float(degrees[i, 0]),
            latitude=None if degrees is None else float(degrees[i, 1]),
            height=float(sensor.position[2] - mount.position[2]),
            bearing_deg=bearing_deg(site, float(headings[i])),
            tilt_deg=round(float(np.rad2deg(tilts[i])), 9) + 0.0,
            model=names[i],
            model_price=float(prices[i]),
            pole_price=0.0 if mount.name in {before.name for before in mounts[:i]} else float(mount.price),
            kbit=float(kbit[i]),
            peak_kbit=float(peak_kbit[i]),
            capacity_kbit=float(mount.capacity),
        )
        for i, (sensor, mount) in enumerate(zip(sensors, mounts, strict=True))
    )


def unused_mounts(candidates: Candidates, chosen: Chosen, moved: Sequence[Sensor] = ()) -> tuple[Mount, ...]:
    """Mounts of candidates that carry no sensor of the set."""
    used = {mount.name for mount in _sensors(candidates, chosen, moved)[1]}
    return tuple(mount for mount in candidates.mounts if mount.name not in used)


def _sensors(
    candidates: Candidates, chosen: Chosen, moved: Sequence[Sensor]
) -> tuple[tuple[Sensor, ...], tuple[Mount, ...]]:
    """Sensors and mounts of the set. The sensors have their names in files."""
    members = np.asarray(chosen, np.int64)
    if len(moved) not in (0, len(members)):
        raise ValueError(f"moved must hold the {len(members)} chosen sensors, got {len(moved)}: pass one for each")
    if not len(moved):
        sensors = [candidates.sensors[member] for member in members]
        mounts = [candidates.mounts[mount] for mount in candidates.mount[members]]
    else:
        feet = np.array([mount.position[:2] for mount in candidates.mounts])
        nearest = [int(np.hypot(*(feet - sensor.position[:2]).T).argmin()) for sensor in moved]
        mounts = [candidates.mounts[mount] for mount in nearest]
        stayed = {candidates.sensors[member].digest: candidates.sensors[member].name for member in members}
        names = [stayed.get(s.digest) or _moved_name(s, m) for s, m in zip(moved, mounts, strict=True)]
        sensors = [replace(sensor, name=name) for sensor, name in zip(moved, names, strict=True)]
    return tuple(replace(sensor, name=sensor.name.replace("/", "-")) for sensor in sensors), tuple(mounts)


def _moved_name(sensor: Sensor, mount: Mount) -> str:
    """Name of a moved sensor, as in a pool.

    It has the mount, height, heading and tilt (degrees) of the new pose, and the model.
    """
    (heading,), (tilt,) = np.rad2deg(aims([sensor])).round(1) + 0.0
    height = sensor.position[2] - mount.position[2]
    return f"{mount.name}_{height:.2f}m_h{heading % 360:.1f}_t{tilt:.1f}_{sensor.model.kind}"


def _merge_mounts(mounts: Sequence[Mount], others: Sequence[Mount]) -> tuple[Mount, ...]:
    """Merge mounts with those of `others` elsewhere. These replace mounts of the same name."""
    feet = np.array([mount.position[:2] for mount in mounts]).reshape(-1, 2)
    new = [o for o in others if not (np.hypot(*(feet - o.position[:2]).T) <= SAME_SPOT).any()]
    names = {mount.name for mount in new}
    return (*(mount for mount in mounts if mount.name not in names), *new)


def mounted_sensors(
    site: Site,
    candidates: Candidates,
    members: Sequence[int],
    bits: Sequence[Int64[np.ndarray, " k"]],
    catalogue: SensorCatalogue | None,
) -> tuple[PlannedSensor, ...]:
    """Describe the sensors of a set.

    The set is indices of candidates, ascending. Names and prices of a catalogue are used, if any.

    bits: sent by each sensor, for every frame.
    """
    kbit = np.array(bits, np.float64).reshape(len(bits), -1) / 1000
    models = [candidates.sensors[c].model for c in members]
    return format_sensors(
        site,
        candidates,
        members,
        kbit=kbit.mean(axis=0),
        peak_kbit=kbit.max(axis=0),
        model_names=None if catalogue is None else [catalogue.get_name(model) for model in models],
        model_prices=candidates.model_prices[list(members)],
    )


def link_loads(sensors: tuple[PlannedSensor, ...], *, limited: bool) -> tuple[LinkLoad, ...]:
    """Load of each pole's link.

    Sensors that share one add up, peaks too.

    limited: whether the scheme sends points; only points count against the capacity.
    """
    loads = []
    for pole in dict.fromkeys(sensor.pole for sensor in sensors):
        here = [sensor for sensor in sensors if sensor.pole == pole]
        sums = sum(sensor.kbit for sensor in here), sum(sensor.peak_kbit for sensor in here), here[0].capacity_kbit
        mean, peak, capacity = (kbit * RATE / MBIT for kbit in sums)
        loads.append(LinkLoad(pole, mean, peak, capacity, peak / capacity, peak <= capacity or not limited))
    return tuple(loads)


def bill_of_materials(sensors: tuple[PlannedSensor, ...]) -> tuple[MaterialItem, ...]:
    """List sensors by model, then poles by price."""
    models = Counter((sensor.model, sensor.model_price) for sensor in sensors)
    paid = [{sensor.pole for sensor in sensors[:i]} for i in range(len(sensors))]  # with the first sensor on each
    poles = Counter(
        s.pole_price for s, before in zip(sensors, paid, strict=True) if s.pole_price or s.pole not in before
    )
    bought = [MaterialItem(model, count, price, count * price) for (model, price), count in sorted(models.items())]
    return (*bought, *(MaterialItem("pole", count, price, count * price) for price, count in sorted(poles.items())))
