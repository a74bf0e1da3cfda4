"""A chosen set as it is mounted: its site, and each sensor for its installer, with links and
materials."""

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from string import ascii_lowercase

import numpy as np

from placement_env.candidates.candidates import Candidates, aims, name_sensor
from placement_env.candidates.sensor_catalogue import RATES, SensorCatalogue
from placement_env.links import LINK_SHARE, describe_share, link_load, max_load
from toolkit.arrays import Float64, Int64
from toolkit.sensors.models import name_in_words
from toolkit.sensors.sensor import Sensor
from toolkit.sites.georeference import bearing_deg, longitude_latitude
from toolkit.sites.site import Mount, Site

RATE = 10.0  # frames a second over a link
# in a pool's candidate, after its pole
POSE_NAME = re.compile(r"_\d+(\.\d+)?m_h-?\d+(\.\d+)?_t-?\d+(\.\d+)?_\w+")
LETTERED = re.compile(r" [a-z]{1,2}$")
SAME_SPOT = 0.1  # m between the feet of mounts that count as one
MBIT = 1000.0  # kbit

Chosen = Sequence[int] | Int64[np.ndarray, " k"]


@dataclass(frozen=True)
class PlannedSensor:
    """One sensor of a chosen set, as installers need it.

    x, y, z: position (m, site frame); longitude, latitude: degrees, None without a geographic
    reference; height: above the foot of its pole (m); bearing_deg: compass bearing of the optical
    axis, clockwise from north (+y of the site's map); tilt_deg: below the horizon; kbit, peak_kbit:
    mean and maximum per frame; capacity_kbit: its link's; load_kbit: what it takes of the link
    (`placement_env.links`)."""

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


@dataclass(frozen=True)
class LinkLoad:
    """Load of one pole's link at `RATE` frames a second, and its capacity.

    mbit_s, peak_mbit_s, load_mbit_s: mean, largest frame, and what counts against the capacity,
    with its `share`: see `placement_env.links`."""

    pole: str
    mbit_s: float
    peak_mbit_s: float
    capacity_mbit_s: float
    share: float
    fits: bool
    load_mbit_s: float


@dataclass(frozen=True)
class MaterialItem:
    """One line of the bill of materials."""

    item: str
    count: int
    unit_price: float
    price: float


def mounted_site(
    site: Site, candidates: Candidates, chosen: Chosen, moved: Sequence[Sensor] = ()
) -> Site:
    """Return `site` with only the chosen sensors, and their mounts if it lacks them. chosen:
    indices of candidates; moved: the same sensors, in that order, as placed by a search of
    continuous poses."""
    sensors, mounts = _sensors(candidates, chosen, moved)
    feet = np.array([mount.position[:2] for mount in site.mounts]).reshape(-1, 2)
    new = {
        m.name: m for m in mounts if not (np.hypot(*(feet - m.position[:2]).T) <= SAME_SPOT).any()
    }
    return replace(
        site,
        sensors=sensors,
        mounts=(*(m for m in site.mounts if m.name not in new), *new.values()),
    )


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

    chosen, moved: as for `mounted_site`, whose sensors have the same names; kbit: sent by each
    sensor, per frame; catalogue: with names of models, None for their usual names; link_share: part
    of the frames, for loads. A mount is paid for with the first sensor on it. Raises ValueError if
    their numbers differ; ImportError if the site's map needs pyproj."""
    sensors, mounts = _sensors(candidates, chosen, moved)
    if len(kbit) != len(sensors):
        raise ValueError(
            f"kbit must hold a row for each of {len(sensors)} sensors, got {len(kbit)}"
        )
    degrees = longitude_latitude(
        site, np.array([sensor.position for sensor in sensors]).reshape(-1, 3)[:, :2]
    )
    places = [(None, None)] * len(sensors) if degrees is None else degrees.tolist()
    headings, tilts = aims(sensors)
    prices = candidates.model_prices[np.asarray(chosen, np.int64)]
    mean_kbit = kbit.mean(axis=1)
    loads = link_load(kbit, link_share)
    return tuple(
        PlannedSensor(
            name=sensor.name,
            pole=mount.name,
            **dict(zip("xyz", sensor.position.tolist(), strict=True)),
            longitude=places[i][0],
            latitude=places[i][1],
            height=float(sensor.position[2] - mount.position[2]),
            bearing_deg=bearing_deg(site, float(headings[i])),
            tilt_deg=round(float(np.rad2deg(tilts[i])), 9) + 0.0,
            model=name_in_words(type(sensor.model).__name__)
            if catalogue is None
            else catalogue.get_name(sensor.model),
            model_price=float(prices[i]),
            pole_price=0.0
            if mount.name in {before.name for before in mounts[:i]}
            else float(mount.price),
            kbit=float(mean_kbit[i]),
            peak_kbit=float(kbit[i].max()),
            capacity_kbit=float(mount.capacity),
            load_kbit=float(loads[i]),
        )
        for i, (sensor, mount) in enumerate(zip(sensors, mounts, strict=True))
    )


def set_names(candidates: Candidates, chosen: Chosen) -> tuple[str, ...]:
    """Return the names that the sensors of a set have in its files."""
    return tuple(sensor.name for sensor in _sensors(candidates, chosen, ())[0])


def is_named_by_pole(name: str, pole: str) -> bool:
    """Return True for a sensor's name that says its pole.

    >>> is_named_by_pole("12-3 b", "12/3"), is_named_by_pole("P10", "P1")
    (True, False)
    """
    plain = name_sensor(pole)
    return name == plain or name.startswith(f"{plain} ")


def unused_mounts(
    candidates: Candidates, chosen: Chosen, moved: Sequence[Sensor] = ()
) -> tuple[Mount, ...]:
    """Mounts of candidates that carry no sensor of the set."""
    used = {mount.name for mount in _sensors(candidates, chosen, moved)[1]}
    return tuple(mount for mount in candidates.mounts if mount.name not in used)


def _sensors(
    candidates: Candidates, chosen: Chosen, moved: Sequence[Sensor]
) -> tuple[tuple[Sensor, ...], tuple[Mount, ...]]:
    """Sensors of the set, their file names and mounts."""
    members = np.asarray(chosen, np.int64)
    if len(moved) not in (0, len(members)):
        raise ValueError(
            f"moved must hold the {len(members)} chosen sensors, got {len(moved)}: pass one for "
            "each"
        )
    sensors = [candidates.sensors[member] for member in members]
    mounts = [candidates.mounts[mount] for mount in candidates.mount[members]]
    if len(moved):
        feet = np.array([mount.position[:2] for mount in candidates.mounts])
        mounts = [
            candidates.mounts[np.hypot(*(feet - each.position[:2]).T).argmin()] for each in moved
        ]
        stayed = {sensor.digest: sensor.name for sensor in sensors}
        sensors = []
        for sensor, mount in zip(moved, mounts, strict=True):
            (heading,), (tilt,) = np.rad2deg(aims([sensor])).round(1) + 0.0
            pose = f"{sensor.position[2] - mount.position[2]:.2f}m_h{heading % 360:.1f}_t{tilt:.1f}"
            # as in a pool
            name = stayed.get(sensor.digest) or f"{mount.name}_{pose}_{sensor.model.kind}"
            sensors.append(replace(sensor, name=name))
    poles = [mount.name for mount in candidates.mounts]
    names = name_by_poles(
        [sensor.name for sensor in sensors], [mount.name for mount in mounts], poles
    )
    return tuple(
        replace(sensor, name=name) for sensor, name in zip(sensors, names, strict=True)
    ), tuple(mounts)


def name_by_poles(
    names: Sequence[str], poles: Sequence[str], known: Sequence[str] = ()
) -> tuple[str, ...]:
    """Return the names that the sensors of a set have everywhere: their poles', with a, b, ...
    where several share one.

    names: as the sensors have them; poles: each sensor's; known: names of all poles. Only names of
    poses in a pool (post07_6.0m_h90_t15_camera) and names of poles are replaced: d0 of a site
    stays. Names hold - for /, as a recording's groups are named by them.

    >>> name_by_poles(["P1_6.0m_h0_t5_camera", "P1_6.0m_h90_t5_camera", "d4"], ["P1", "P1", "P2"])
    ('P1 a', 'P1 b', 'd4')
    """
    letters = Counter[str]()
    plain = [name_sensor(name) for name in names]
    bases = {name_sensor(pole) for pole in (*known, *poles)}
    by_pole = [
        POSE_NAME.fullmatch(name.removeprefix(name_sensor(pole))) is not None
        or LETTERED.sub("", name) in bases
        for name, pole in zip(plain, poles, strict=True)
    ]
    several = Counter(pole for pole, replaced in zip(poles, by_pole, strict=True) if replaced)
    settled = []
    for name, pole, replaced in zip(plain, poles, by_pole, strict=True):
        if replaced:
            name = name_sensor(pole)
            letters[pole] += 1
            name += f" {_letter(letters[pole])}" if several[pole] > 1 else ""
        settled.append(name)
    return tuple(settled) if len(set(settled)) == len(settled) else tuple(plain)


def _letter(number: int) -> str:
    """Letters of a number from 1 on: a to z, then aa."""
    more, last = divmod(number - 1, len(ascii_lowercase))
    return (_letter(more) if more else "") + ascii_lowercase[last]


def build_load(
    pole: str, mean: float, peak: float, load: float, capacity: float, *, limited: bool
) -> LinkLoad:
    """Load of one link from its amounts (Mbit/s). limited: as of `link_loads`."""
    fits = load <= max_load(capacity) or not limited
    return LinkLoad(pole, mean, peak, capacity, load / capacity, fits, load)


def link_loads(sensors: tuple[PlannedSensor, ...], *, limited: bool) -> tuple[LinkLoad, ...]:
    """Load of each pole's link. Sensors that share one add up, peaks too. limited: whether the
    scheme sends points; only points count against the capacity."""
    loads = []
    for pole in dict.fromkeys(sensor.pole for sensor in sensors):
        here = [sensor for sensor in sensors if sensor.pole == pole]
        names = ("kbit", "peak_kbit", "load_kbit")
        mean, peak, load = (
            sum(getattr(sensor, name) for sensor in here) * RATE / MBIT for name in names
        )
        loads.append(
            build_load(pole, mean, peak, load, here[0].capacity_kbit * RATE / MBIT, limited=limited)
        )
    return tuple(loads)


def describe_narrow_links(loads: Sequence[LinkLoad], link_share: float = LINK_SHARE) -> str:
    """Sentence on the links that cannot carry what is sent, with remedies; "" where each can."""
    narrow = [load for load in loads if not load.fits]
    if not narrow:
        return ""
    needs = [
        f"{load.pole} needs {load.load_mbit_s:.2f} of {load.capacity_mbit_s:.2f} Mbit/s"
        for load in narrow
    ]
    needed_kbit = math.ceil(max(load.load_mbit_s for load in narrow) * MBIT / RATE)
    links = "The link is too narrow" if len(narrow) == 1 else f"{len(narrow)} links are too narrow"
    return (
        f"{links} for {describe_share(link_share)}: {', '.join(needs)}; plan with links of "
        f"{needed_kbit} kbit per frame (--capacity), allow each sensor less (--max-kbit), or send "
        "less (--scheme foreground or late)."
    )


def bill_of_rates(
    sensors: Sequence[PlannedSensor], catalogue: SensorCatalogue | None
) -> tuple[MaterialItem, ...]:
    """List what the rates of a catalogue add to the price of the sensors and their poles, over the
    years it names."""
    if catalogue is None:
        return ()
    count = {"pole": len({sensor.pole for sensor in sensors}), "sensor": len(sensors)}
    found = []
    for name, price in catalogue.rates.items():
        per, yearly = RATES[name]
        each = price * (catalogue.years if yearly else 1)
        item = f"{name} for {catalogue.years:g} years" if yearly else name
        found.append(MaterialItem(item, count[per], each, count[per] * each))
    return tuple(found)


def bill_of_materials(sensors: tuple[PlannedSensor, ...]) -> tuple[MaterialItem, ...]:
    """List sensors by model, then poles by price."""
    models = Counter((sensor.model, sensor.model_price) for sensor in sensors)
    # with the first sensor on each
    paid = [{sensor.pole for sensor in sensors[:i]} for i in range(len(sensors))]
    poles = Counter(
        s.pole_price
        for s, old in zip(sensors, paid, strict=True)
        if s.pole_price or s.pole not in old
    )
    bought = [
        MaterialItem(model, count, price, count * price)
        for (model, price), count in sorted(models.items())
    ]
    return (
        *bought,
        *(
            MaterialItem("pole", count, price, count * price)
            for price, count in sorted(poles.items())
        ),
    )
