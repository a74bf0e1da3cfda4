"""Mounting: what whoever builds the chosen set needs: where each sensor goes, its link, what to buy."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np

from placement_env.candidates.aim import aims
from placement_env.candidates.candidates import Candidates
from placement_env.fidelity.detector import Outcome
from placement_env.report.content import RATE, LinkLoad, MaterialItem, PlannedSensor
from toolkit.arrays import Float64
from toolkit.sensors.model import SensorModel
from toolkit.sites.site import Site

MBIT = 1000.0  # kbit


def planned_sensors(
    site: Site,
    candidates: Candidates,
    chosen: tuple[int, ...],
    outcomes: list[Outcome],
    *,
    model_name: Callable[[SensorModel], str],
    degrees: Float64[np.ndarray, "k 2"] | None,
) -> tuple[PlannedSensor, ...]:
    """The sensors of a set, in the order of its members. outcomes: of the set in every frame; degrees: longitude and
    latitude of each, None where the site does not say where on earth it is."""
    kbit = np.array([outcome.bits for outcome in outcomes], np.float64) / 1000
    sensors = [candidates.sensors[c] for c in chosen]
    headings, tilts = aims(sensors)
    planned = []
    for i, (c, sensor) in enumerate(zip(chosen, sensors, strict=True)):
        mount = candidates.mounts[candidates.mount[c]]
        x, y, z = sensor.position.tolist()
        longitude, latitude = (None, None) if degrees is None else degrees[i].tolist()
        planned.append(
            PlannedSensor(
                name=sensor.name,
                pole=mount.name,
                x=x,
                y=y,
                z=z,
                longitude=longitude,
                latitude=latitude,
                height=z - float(mount.position[2]),
                bearing_deg=bearing(site, float(headings[i])),
                tilt_deg=float(np.rad2deg(tilts[i])),
                model=model_name(sensor.model),
                model_price=float(candidates.model_prices[c]),
                pole_price=float(mount.price),
                kbit=float(kbit[:, i].mean()),
                peak_kbit=float(kbit[:, i].max()),
                capacity_kbit=float(mount.capacity),
            )
        )
    return tuple(planned)


def bearing(site: Site, heading: float) -> float:
    """Compass bearing (degrees, clockwise from north, below 360) of a heading in the site's frame; north is +y of the
    site's map."""
    east, north = site.map_SE3_site[:2, :2] @ [np.cos(heading), np.sin(heading)]
    return float(round(np.rad2deg(np.arctan2(east, north)) % 360, 6) % 360)


def link_loads(sensors: tuple[PlannedSensor, ...], *, limited: bool) -> tuple[LinkLoad, ...]:
    """The link of each pole. limited: whether the scheme sends points, which alone count against the capacity."""
    loads = []
    for sensor in sensors:
        mean, peak, capacity = (kbit * RATE / MBIT for kbit in (sensor.kbit, sensor.peak_kbit, sensor.capacity_kbit))
        loads.append(LinkLoad(sensor.pole, mean, peak, capacity, peak / capacity, peak <= capacity or not limited))
    return tuple(loads)


def bill_of_materials(sensors: tuple[PlannedSensor, ...]) -> tuple[MaterialItem, ...]:
    """Sensors by model, then poles by price."""
    models = Counter((sensor.model, sensor.model_price) for sensor in sensors)
    poles = Counter(sensor.pole_price for sensor in sensors)
    bought = [MaterialItem(model, count, price, count * price) for (model, price), count in sorted(models.items())]
    return (*bought, *(MaterialItem("pole", count, price, count * price) for price, count in sorted(poles.items())))


def in_words(model: SensorModel) -> str:
    """A model without a catalogue: its class, and its size."""
    rows, columns = model.shape
    return f"{type(model).__name__} {columns} x {rows}"


def unused_poles(candidates: Candidates, chosen: tuple[int, ...]) -> tuple[str, ...]:
    """Names of the mounts that the set leaves free."""
    used = {int(candidates.mount[c]) for c in chosen}
    return tuple(mount.name for m, mount in enumerate(candidates.mounts) if m not in used)
