"""A chosen set as it is to be mounted: the site that has it, and each sensor in the words of a plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from placement_env.candidates.aim import aims
from placement_env.candidates.candidates import Candidates
from placement_env.report.content import PlannedSensor
from toolkit.arrays import Float64, Int64
from toolkit.sensors.models import name_in_words
from toolkit.sensors.sensor import Sensor
from toolkit.sites.georeference import bearing_deg, longitude_latitude
from toolkit.sites.site import Mount, Site

SAME_SPOT = 0.1  # m between the feet of two mounts that are one

Chosen = Sequence[int] | Int64[np.ndarray, " k"]


def mounted_site(site: Site, candidates: Candidates, chosen: Chosen, moved: Sequence[Sensor] = ()) -> Site:
    """`site` with the chosen sensors, and no others; and with their mounts where they are not its own.

    chosen: indices of candidates; moved: the same sensors where a search of continuous poses put them, in that order.
    """
    sensors, mounts = _sensors(candidates, chosen, moved)
    return replace(site, sensors=sensors, mounts=_with(site.mounts, mounts))


def planned_sensors(
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
    """Each sensor of a set as whoever mounts it needs it. All arguments but the first two are of the set, in one order.

    chosen, moved: as of `mounted_site`, whose sensors have the same names; kbit, peak_kbit: what each sends, mean and
    greatest of a frame; model_names: None for those of the sensor models in words; model_prices: None for no price.
    A mount is paid with the first sensor on it.
    Raises ValueError where their numbers differ; ImportError where the site's map needs pyproj.
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
    """The mounts on which candidates hang, but none of the set."""
    used = {mount.name for mount in _sensors(candidates, chosen, moved)[1]}
    return tuple(mount for mount in candidates.mounts if mount.name not in used)


def _sensors(
    candidates: Candidates, chosen: Chosen, moved: Sequence[Sensor]
) -> tuple[tuple[Sensor, ...], tuple[Mount, ...]]:
    """The sensors of the set under the names that files give them, and their mounts."""
    members = np.asarray(chosen, np.int64)
    if len(moved) not in (0, len(members)):
        raise ValueError(f"moved must be the {len(members)} chosen sensors where they are now, got {len(moved)}")
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
    """As in a pool: mount, height, heading and tilt (degrees) where it is now, model."""
    (heading,), (tilt,) = np.rad2deg(aims([sensor])).round(1) + 0.0
    height = sensor.position[2] - mount.position[2]
    return f"{mount.name}_{height:.2f}m_h{heading % 360:.1f}_t{tilt:.1f}_{sensor.model.kind}"


def _with(mounts: Sequence[Mount], others: Sequence[Mount]) -> tuple[Mount, ...]:
    """Mounts and those of the others that do not stand where one of them does; of one name, the other's."""
    feet = np.array([mount.position[:2] for mount in mounts]).reshape(-1, 2)
    new = [o for o in others if not (np.hypot(*(feet - o.position[:2]).T) <= SAME_SPOT).any()]
    names = {mount.name for mount in new}
    return (*(mount for mount in mounts if mount.name not in names), *new)
