"""Mounting: the links and the bill of materials of the chosen set, and its sensors in the words of a plan."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.candidates.sensor_catalogue import SensorCatalogue
from placement_env.fidelity.detector import Outcome
from placement_env.report.content import RATE, LinkLoad, MaterialItem, PlannedSensor
from placement_env.report.mounted import planned_sensors
from toolkit.sites.site import Site

MBIT = 1000.0  # kbit


def mounted_sensors(
    site: Site,
    candidates: Candidates,
    members: Sequence[int],
    outcomes: Sequence[Outcome],
    catalogue: SensorCatalogue | None,
) -> tuple[PlannedSensor, ...]:
    """The sensors of a set (indices of candidates, ascending). outcomes: of the set in every frame; catalogue: that
    says what models are called, None where there is none."""
    kbit = np.array([outcome.bits for outcome in outcomes], np.float64).reshape(len(outcomes), -1) / 1000
    models = [candidates.sensors[c].model for c in members]
    return planned_sensors(
        site,
        candidates,
        members,
        kbit=kbit.mean(axis=0),
        peak_kbit=kbit.max(axis=0),
        model_names=None if catalogue is None else [catalogue.name_of(model) for model in models],
        model_prices=candidates.model_prices[list(members)],
    )


def link_loads(sensors: tuple[PlannedSensor, ...], *, limited: bool) -> tuple[LinkLoad, ...]:
    """The link of each pole; of sensors that share one, the sum of what each sends at most. limited: whether the scheme
    sends points, which alone count against the capacity."""
    loads = []
    for pole in dict.fromkeys(sensor.pole for sensor in sensors):
        here = [sensor for sensor in sensors if sensor.pole == pole]
        sums = sum(sensor.kbit for sensor in here), sum(sensor.peak_kbit for sensor in here), here[0].capacity_kbit
        mean, peak, capacity = (kbit * RATE / MBIT for kbit in sums)
        loads.append(LinkLoad(pole, mean, peak, capacity, peak / capacity, peak <= capacity or not limited))
    return tuple(loads)


def bill_of_materials(sensors: tuple[PlannedSensor, ...]) -> tuple[MaterialItem, ...]:
    """Sensors by model, then poles by price."""
    models = Counter((sensor.model, sensor.model_price) for sensor in sensors)
    paid = [{sensor.pole for sensor in sensors[:i]} for i in range(len(sensors))]  # with the first sensor on each
    poles = Counter(
        s.pole_price for s, before in zip(sensors, paid, strict=True) if s.pole_price or s.pole not in before
    )
    bought = [MaterialItem(model, count, price, count * price) for (model, price), count in sorted(models.items())]
    return (*bought, *(MaterialItem("pole", count, price, count * price) for price, count in sorted(poles.items())))
