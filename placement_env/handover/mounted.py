"""Chosen set as it is mounted: its site, and each sensor for its installer, with links and
materials."""

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from string import ascii_lowercase
from typing import NamedTuple

import numpy as np

from placement_env.candidates.candidates import Candidates, aims, name_sensor
from placement_env.candidates.sensor_catalogue import RATES, SensorCatalogue
from placement_env.links import LINK_SHARE, describe_share, max_load, sent_in_most
from toolkit.arrays import Float64, Int64
from toolkit.detection.link.packets import count_packets, find_airtime_us
from toolkit.sensors.models import name_in_words
from toolkit.sensors.sensor import Sensor
from toolkit.sites.georeference import bearing_deg, longitude_latitude
from toolkit.sites.site import Mount, Site

FRAME_RATE_HZ = 10.0  # frames over a link
# end of a pool candidate's name, after its pole
POSE_NAME = re.compile(r"_\d+(\.\d+)?m_h-?\d+(\.\d+)?_t-?\d+(\.\d+)?_\w+")
LETTERED = re.compile(r" [a-z]{1,2}$")
SAME_FOOT_M = 0.1  # largest distance between the feet of mounts that count as one
KBIT_PER_MBIT = 1000.0

Chosen = Sequence[int] | Int64[np.ndarray, " k"]


@dataclass(frozen=True)
class PlannedSensor:
    """One sensor of a chosen set, as installers need it.

    Attributes:
        name: Name of the sensor.
        pole: Name of its pole.
        x: Position (m, site frame).
        y: Position (m, site frame).
        z: Position (m, site frame).
        longitude: Degrees, None without a geographic reference.
        latitude: Degrees, None without a geographic reference.
        height: Height above the foot of its pole (m).
        bearing_deg: Compass bearing of the optical axis, clockwise from north (+y of the site's
            map).
        tilt_deg: Tilt below the horizon.
        model: Name of the model.
        model_price: Price of the sensor.
        pole_price: Price of the pole, 0 if an earlier sensor of the set pays it.
        kbit: Mean data per frame.
        peak_kbit: Largest data per frame.
        capacity_kbit: Capacity of its link.
        load_kbit: Load of its link by this sensor (`placement_env.links`).
        packets: Mean packets per frame (`toolkit.detection.link.packets`).
        airtime_us: Mean airtime of these packets by 802.11p (µs per frame).
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
    load_kbit: float
    packets: float = 0.0
    airtime_us: float = 0.0


@dataclass(frozen=True)
class PoleLoad:
    """Load of one pole's link at `FRAME_RATE_HZ`, and its capacity (`placement_env.links`).

    Attributes:
        pole: Name of the pole.
        mbit_s: Mean data rate.
        peak_mbit_s: Data rate of the largest frame.
        capacity_mbit_s: Capacity of the link.
        share: Load as a share of the capacity.
        fits: Whether the link carries the load.
        load_mbit_s: Data rate that counts against the capacity.
        packets_s: Mean packets per second (`toolkit.detection.link.packets`).
        airtime_ms_s: Mean airtime of these packets by 802.11p (ms per second).
    """

    pole: str
    mbit_s: float
    peak_mbit_s: float
    capacity_mbit_s: float
    share: float
    fits: bool
    load_mbit_s: float
    packets_s: float = 0.0
    airtime_ms_s: float = 0.0


@dataclass(frozen=True)
class MaterialItem:
    """One line of the bill of materials.

    Attributes:
        item: Name of the article.
        count: Number of pieces.
        unit_price: Price of one piece.
        price: Price of all pieces.
    """

    item: str
    count: int
    unit_price: float
    price: float


def mounted_site(
    site: Site, candidates: Candidates, chosen: Chosen, moved: Sequence[Sensor] = ()
) -> Site:
    """Site with only the chosen sensors, and their mounts if it lacks them.

    chosen: indices of candidates; moved: the same sensors, in that order, as placed by a search of
    continuous poses.
    """
    sensors, mounts = _sensors(candidates, chosen, moved)
    feet = np.array([mount.position[:2] for mount in site.mounts]).reshape(-1, 2)
    new_mounts: dict[str, Mount] = {}
    for mount in mounts:
        distance = np.hypot(*(feet - mount.position[:2]).T)
        if not (distance <= SAME_FOOT_M).any():
            new_mounts[mount.name] = mount
    present_mounts = [mount for mount in site.mounts if mount.name not in new_mounts]
    return replace(site, sensors=sensors, mounts=(*present_mounts, *new_mounts.values()))


def format_sensors(
    site: Site,
    candidates: Candidates,
    chosen: Chosen,
    moved: Sequence[Sensor] = (),
    *,
    kbit: Float64[np.ndarray, "k frames"],
    catalogue: SensorCatalogue | None = None,
    link_share: float = LINK_SHARE,
) -> tuple[PlannedSensor, ...]:
    """Describe each sensor of a set for its installer, in the order of the set.

    chosen: indices of candidates; moved: the same sensors as placed by a search of continuous
    poses, empty if they keep the candidates' poses; kbit: data that each sensor sends in each
    frame; catalogue: with names of models, None for their usual names; link_share: share of the
    frames whose data a load must not exceed. The sensors of `mounted_site` have the same names. A
    mount is paid for with the first sensor on it. Raises ValueError if their numbers differ;
    ImportError if the site's map needs pyproj."""
    sensors, mounts = _sensors(candidates, chosen, moved)
    if len(kbit) != len(sensors):
        raise ValueError(
            f"kbit must hold a row for each of {len(sensors)} sensors, got {len(kbit)}"
        )
    positions = np.array([sensor.position for sensor in sensors]).reshape(-1, 3)
    degrees = longitude_latitude(site, positions[:, :2])
    coordinates = [(None, None)] * len(sensors) if degrees is None else degrees.tolist()
    headings, tilts = aims(sensors)
    prices = candidates.model_prices[np.asarray(chosen, np.int64)]
    mean_kbit = kbit.mean(axis=1)
    loads = sent_in_most(kbit, link_share)
    radio = measure_radio(kbit)
    paid_poles: set[str] = set()
    planned_sensors = []
    for i, (sensor, mount) in enumerate(zip(sensors, mounts, strict=True)):
        if catalogue is None:
            model = name_in_words(type(sensor.model).__name__)
        else:
            model = catalogue.get_name(sensor.model)
        x, y, z = sensor.position.tolist()
        planned_sensors.append(
            PlannedSensor(
                name=sensor.name,
                pole=mount.name,
                x=x,
                y=y,
                z=z,
                longitude=coordinates[i][0],
                latitude=coordinates[i][1],
                height=float(sensor.position[2] - mount.position[2]),
                bearing_deg=bearing_deg(site, float(headings[i])),
                tilt_deg=round(float(np.rad2deg(tilts[i])), 9) + 0.0,
                model=model,
                model_price=float(prices[i]),
                pole_price=0.0 if mount.name in paid_poles else float(mount.price),
                kbit=float(mean_kbit[i]),
                peak_kbit=float(kbit[i].max()),
                capacity_kbit=float(mount.capacity),
                load_kbit=float(loads[i]),
                packets=float(radio.packets[i]),
                airtime_us=float(radio.airtime_us[i]),
            )
        )
        paid_poles.add(mount.name)
    return tuple(planned_sensors)


def set_names(candidates: Candidates, chosen: Chosen) -> tuple[str, ...]:
    """Return the names that the sensors of a set have in its files."""
    return tuple(sensor.name for sensor in _sensors(candidates, chosen, ())[0])


def is_named_by_pole(name: str, pole: str) -> bool:
    """Return True for a sensor's name that begins with its pole's name, as `name_by_poles` gives.

    >>> is_named_by_pole("12-3 b", "12/3"), is_named_by_pole("P10", "P1")
    (True, False)
    """
    pole_name = name_sensor(pole)
    return name == pole_name or name.startswith(f"{pole_name} ")


def unused_mounts(
    candidates: Candidates, chosen: Chosen, moved: Sequence[Sensor] = ()
) -> tuple[Mount, ...]:
    """Mounts of candidates that carry no sensor of the set."""
    used_names = {mount.name for mount in _sensors(candidates, chosen, moved)[1]}
    return tuple(mount for mount in candidates.mounts if mount.name not in used_names)


def _sensors(
    candidates: Candidates, chosen: Chosen, moved: Sequence[Sensor]
) -> tuple[tuple[Sensor, ...], tuple[Mount, ...]]:
    """Sensors of the set with their final names, and each sensor's mount, in the set's order.

    chosen: indices of the set's candidates. moved: the same sensors as they were mounted, each on
    the mount nearest to it; empty if they keep the candidates' poses."""
    members = np.asarray(chosen, np.int64)
    if len(moved) not in (0, len(members)):
        raise ValueError(
            f"moved must hold the {len(members)} chosen sensors, got {len(moved)}: pass one for "
            "each"
        )
    sensors = [candidates.sensors[member] for member in members]
    mounts = [candidates.mounts[mount] for mount in candidates.mount[members]]
    if len(moved):
        # x, y of every mount
        feet = np.array([mount.position[:2] for mount in candidates.mounts])
        pool_names = {sensor.digest: sensor.name for sensor in sensors}
        sensors = []
        mounts = []
        for sensor in moved:
            mount = candidates.mounts[np.hypot(*(feet - sensor.position[:2]).T).argmin()]
            mounts.append(mount)
            # degrees; + 0.0 turns -0.0 into 0.0
            (heading,), (tilt,) = np.rad2deg(aims([sensor])).round(1) + 0.0
            pose = f"{sensor.position[2] - mount.position[2]:.2f}m_h{heading % 360:.1f}_t{tilt:.1f}"
            # an unchanged sensor keeps its name, others are named like candidates
            name = pool_names.get(sensor.digest) or f"{mount.name}_{pose}_{sensor.model.kind}"
            sensors.append(replace(sensor, name=name))
    names = name_by_poles(
        [sensor.name for sensor in sensors],
        [mount.name for mount in mounts],
        [mount.name for mount in candidates.mounts],
    )
    renamed_sensors = [
        replace(sensor, name=name) for sensor, name in zip(sensors, names, strict=True)
    ]
    return tuple(renamed_sensors), tuple(mounts)


def name_by_poles(
    names: Sequence[str], poles: Sequence[str], known: Sequence[str] = ()
) -> tuple[str, ...]:
    """Names of a set's sensors for all outputs: their poles', with a, b, ... for several on one
    pole.

    names: as the sensors have them; poles: each sensor's; known: names of all poles. Only names of
    poses in a pool (post07_6.0m_h90_t15_camera) and names of poles are replaced: d0 of a site
    stays. Names have - for /, since a recording's groups are named by them.

    >>> name_by_poles(["P1_6.0m_h0_t5_camera", "P1_6.0m_h90_t5_camera", "d4"], ["P1", "P1", "P2"])
    ('P1 a', 'P1 b', 'd4')
    """
    letters = Counter[str]()
    safe_names = [name_sensor(name) for name in names]
    bases = {name_sensor(pole) for pole in (*known, *poles)}
    by_pole = [
        POSE_NAME.fullmatch(name.removeprefix(name_sensor(pole))) is not None
        or LETTERED.sub("", name) in bases
        for name, pole in zip(safe_names, poles, strict=True)
    ]
    shared = Counter(pole for pole, is_replaced in zip(poles, by_pole, strict=True) if is_replaced)
    final_names = []
    for name, pole, is_replaced in zip(safe_names, poles, by_pole, strict=True):
        if is_replaced:
            name = name_sensor(pole)
            letters[pole] += 1
            name += f" {_letter(letters[pole])}" if shared[pole] > 1 else ""
        final_names.append(name)
    return tuple(final_names) if len(set(final_names)) == len(final_names) else tuple(safe_names)


def _letter(number: int) -> str:
    """Letters of a number from 1 on: a to z, then aa."""
    quotient, remainder = divmod(number - 1, len(ascii_lowercase))
    return (_letter(quotient) if quotient else "") + ascii_lowercase[remainder]


class RadioUse(NamedTuple):
    """Mean use of the radio by each sensor in a frame.

    packets: number of packets; airtime_us: their airtime by 802.11p (µs)."""

    packets: Float64[np.ndarray, " sensors"]
    airtime_us: Float64[np.ndarray, " sensors"]


def measure_radio(kbit: Float64[np.ndarray, "sensors frames"]) -> RadioUse:
    """Mean packets and airtime per frame of sensors that send a message in each frame.

    kbit: data that each sensor sends, per frame."""
    bits = np.rint(kbit * 1000).astype(np.int64)
    packets = count_packets(bits)
    airtime_us = find_airtime_us(bits)
    return RadioUse(packets.mean(axis=1), airtime_us.mean(axis=1))


def build_load(
    pole: str, mean: float, peak: float, load: float, capacity: float, *, limited: bool
) -> PoleLoad:
    """Load of one link, without its packets.

    Args:
        pole: Name of the pole.
        mean: Mean amount of data (Mbit/s).
        peak: Largest amount in a frame (Mbit/s).
        load: Data rate that counts against the capacity (Mbit/s).
        capacity: Capacity of the link (Mbit/s).
        limited: Whether the scheme sends points; only points count against the capacity."""
    fits = load <= max_load(capacity) or not limited
    return PoleLoad(
        pole,
        mbit_s=mean,
        peak_mbit_s=peak,
        capacity_mbit_s=capacity,
        share=load / capacity,
        fits=fits,
        load_mbit_s=load,
    )


def measure_links(
    candidates: Candidates,
    kbit: Float64[np.ndarray, "sensors frames"],
    link_share: float,
    *,
    limited: bool,
) -> tuple[PoleLoad, ...]:
    """Load of the link of each mount that carries a candidate.

    Args:
        candidates: Candidates, which all send.
        kbit: Data of each candidate in each frame.
        link_share: Part of the frames whose data a load must not exceed.
        limited: Whether the scheme sends points; only points count against the capacity."""
    mbit_s = kbit * FRAME_RATE_HZ / KBIT_PER_MBIT
    means = mbit_s.mean(axis=1)
    peaks = mbit_s.max(axis=1, initial=0)
    sensor_loads = sent_in_most(mbit_s, link_share)
    radio = measure_radio(kbit)
    loads = []
    for mount in np.unique(candidates.mount).tolist():
        on_mount = candidates.mount == mount
        mean = float(means[on_mount].sum())
        peak = float(peaks[on_mount].sum())
        load = float(sensor_loads[on_mount].sum())
        pole = candidates.mounts[mount]
        capacity = pole.capacity * FRAME_RATE_HZ / KBIT_PER_MBIT
        pole_load = build_load(
            pole=pole.name, mean=mean, peak=peak, load=load, capacity=capacity, limited=limited
        )
        packets = float(radio.packets[on_mount].sum())
        airtime_us = float(radio.airtime_us[on_mount].sum())
        loads.append(_add_radio(pole_load, packets=packets, airtime_us=airtime_us))
    return tuple(loads)


def _add_radio(load: PoleLoad, packets: float, airtime_us: float) -> PoleLoad:
    """Return a load with its packets and airtime per second.

    packets, airtime_us: number and airtime (µs) of its packets per frame."""
    return replace(
        load, packets_s=packets * FRAME_RATE_HZ, airtime_ms_s=airtime_us * FRAME_RATE_HZ / 1000
    )


def link_loads(sensors: tuple[PlannedSensor, ...], *, limited: bool) -> tuple[PoleLoad, ...]:
    """Load of each pole's link; loads and peaks of sensors that share one add up.

    limited: whether the scheme sends points; only points count against the capacity."""
    loads = []
    for pole in dict.fromkeys(sensor.pole for sensor in sensors):
        pole_sensors = [sensor for sensor in sensors if sensor.pole == pole]
        mean = sum(sensor.kbit for sensor in pole_sensors) * FRAME_RATE_HZ / KBIT_PER_MBIT
        peak = sum(sensor.peak_kbit for sensor in pole_sensors) * FRAME_RATE_HZ / KBIT_PER_MBIT
        load = sum(sensor.load_kbit for sensor in pole_sensors) * FRAME_RATE_HZ / KBIT_PER_MBIT
        capacity = pole_sensors[0].capacity_kbit * FRAME_RATE_HZ / KBIT_PER_MBIT
        pole_load = build_load(pole, mean, peak, load, capacity, limited=limited)
        # per frame
        packets = sum(sensor.packets for sensor in pole_sensors)
        airtime_us = sum(sensor.airtime_us for sensor in pole_sensors)
        loads.append(_add_radio(pole_load, packets=packets, airtime_us=airtime_us))
    return tuple(loads)


def describe_radio(loads: Sequence[PoleLoad]) -> str:
    """Packets and airtime of all links together, in words.

    >>> load = PoleLoad("p", 1.0, 1.0, 20.0, 0.05, True, 1.0, packets_s=20.0, airtime_ms_s=21.8)
    >>> describe_radio([load, load])
    '40 packets a second, 4.4 % of the airtime of 802.11p'
    """
    packets_s = sum(load.packets_s for load in loads)
    airtime_share = sum(load.airtime_ms_s for load in loads) / 1000
    share = f"{100 * airtime_share:,.1f} % of the airtime of 802.11p"
    if airtime_share > 1:
        share += ", more than a channel has"
    return f"{packets_s:,.0f} packets a second, {share}"


def describe_narrow_links(loads: Sequence[PoleLoad], link_share: float = LINK_SHARE) -> str:
    """Sentence on the links that cannot carry their load, with remedies; "" if all can.

    loads: load of each pole's link; link_share: share of the frames that a link must carry."""
    narrow_loads = [load for load in loads if not load.fits]
    if not narrow_loads:
        return ""
    needs = [
        f"{load.pole} needs {load.load_mbit_s:.2f} of {load.capacity_mbit_s:.2f} Mbit/s"
        for load in narrow_loads
    ]
    needed_kbit = math.ceil(
        max(load.load_mbit_s for load in narrow_loads) * KBIT_PER_MBIT / FRAME_RATE_HZ
    )
    links = (
        "The link is too narrow"
        if len(narrow_loads) == 1
        else f"{len(narrow_loads)} links are too narrow"
    )
    return (
        f"{links} for {describe_share(link_share)}: {', '.join(needs)}; plan with links of "
        f"{needed_kbit} kbit per frame (--capacity), allow each sensor less (--max-kbit), or send "
        "less (--scheme foreground or late)."
    )


def bill_of_rates(
    sensors: Sequence[PlannedSensor], catalogue: SensorCatalogue | None
) -> tuple[MaterialItem, ...]:
    """Costs that the rates of a catalogue add to sensors and poles, over its years.

    One item for each rate, in the catalogue's order; none without a catalogue."""
    if catalogue is None:
        return ()
    count = {"pole": len({sensor.pole for sensor in sensors}), "sensor": len(sensors)}
    items = []
    for name, price in catalogue.rates.items():
        unit, is_yearly = RATES[name]  # "pole" or "sensor", which the rate is paid for
        unit_price = price * (catalogue.years if is_yearly else 1)
        item = f"{name} for {catalogue.years:g} years" if is_yearly else name
        items.append(
            MaterialItem(
                item, count=count[unit], unit_price=unit_price, price=count[unit] * unit_price
            )
        )
    return tuple(items)


def bill_of_materials(sensors: tuple[PlannedSensor, ...]) -> tuple[MaterialItem, ...]:
    """Line for each model and price of sensors, then for each price of poles."""
    models = Counter((sensor.model, sensor.model_price) for sensor in sensors)
    # number of poles of each price
    poles = Counter[float]()
    earlier_poles: set[str] = set()
    for sensor in sensors:
        # a pole's price is on the first sensor of the pole
        if sensor.pole_price or sensor.pole not in earlier_poles:
            poles[sensor.pole_price] += 1
        earlier_poles.add(sensor.pole)
    items = []
    for (model, price), count in sorted(models.items()):
        items.append(MaterialItem(item=model, count=count, unit_price=price, price=count * price))
    for price, count in sorted(poles.items()):
        items.append(MaterialItem(item="pole", count=count, unit_price=price, price=count * price))
    return tuple(items)
