"""Pools small enough to be prepared by the hundred: some places of a site's pool, some poses at each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.candidates.pool import pool
from placement_env.checks import check_whole
from toolkit.arrays import Bool
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.model import SensorModel
from toolkit.sensors.solid_state_lidar import SolidStateLidar
from toolkit.sensors.spinning_lidar import SpinningLidar
from toolkit.sites.site import Site

RANGE = 200.0  # m of the lidars that are drawn, beyond the farthest corner of any random site
MODELS: tuple[SensorModel, ...] = (
    DepthCamera(),
    SpinningLidar(max_range=RANGE),
    SolidStateLidar(max_range=RANGE),
)
LEAST_PRICE, MOST_PRICE = 0.5, 4.0  # of a sensor that is drawn, in units of an ordinary mount


def drawn_models(rng: np.random.Generator) -> tuple[tuple[SensorModel, ...], tuple[float, ...]]:
    """The paper's camera alone at half of the sites, else one or two of `MODELS`; and the price of each."""
    if rng.random() < 0.5:
        models: tuple[SensorModel, ...] = MODELS[:1]
    else:
        some = np.sort(rng.permutation(len(MODELS))[: rng.integers(1, 3)])
        models = tuple(MODELS[k] for k in some)
    return models, tuple(np.exp(rng.uniform(np.log(LEAST_PRICE), np.log(MOST_PRICE), len(models))).round(2).tolist())


def drawn_pool(
    site: Site,
    rng: np.random.Generator,
    *,
    places: int = 12,
    poses: int = 24,
    models: Sequence[SensorModel] = MODELS[:1],
    prices: Sequence[float] = (),
) -> Candidates:
    """Up to `poses` random poses of the pool at each of up to `places` of its mounts, at one height there.

    Of a sensor that sees all round one heading is taken, since the others see the same. prices: of the models, none
    where only mounts cost. Raises ValueError where a number is below 1, and what `placement_env.candidates.pool.pool`
    raises.
    """
    check_whole("places", places, least=1)
    check_whole("poses", poses, least=1)
    every = pool(site, models=models, prices=prices)
    free = np.flatnonzero(one_heading_all_round(every))
    kept: list[int] = []
    mounts = np.unique(every.mount[free])
    for mount in np.sort(rng.permutation(mounts)[:places]):
        there = free[every.mount[free] == mount]
        height = rng.choice(np.unique(every.factors[there, 1]))
        there = there[every.factors[there, 1] == height]
        kept += np.sort(rng.permutation(there)[:poses]).tolist()
    return every.select(kept)


def one_heading_all_round(candidates: Candidates) -> Bool[np.ndarray, " C"]:
    """Which candidates are the first of those at their place that differ by the heading of a sensor that sees all
    round, and level; all others are."""
    first = np.ones(len(candidates), np.bool_)
    seen: set[tuple[int, ...]] = set()
    for c, (sensor, factors) in enumerate(zip(candidates.sensors, candidates.factors.tolist(), strict=True)):
        if sensor.model.horizontal_fov < 2 * np.pi - 1e-6:
            continue
        place = (factors[0], factors[1], *factors[3:])
        first[c] = place not in seen
        seen.add(place)
    return first


def with_mounts(
    candidates: Candidates, prices: Sequence[float], capacities: Sequence[float], models: Sequence[float]
) -> Candidates:
    """The same candidates where mounts cost, and their links carry (kbit per frame), something else; models: the price
    of each sensor model."""
    mounts = tuple(
        replace(mount, price=float(price), capacity=float(capacity))
        for mount, price, capacity in zip(candidates.mounts, prices, capacities, strict=True)
    )
    return replace(candidates, mounts=mounts, axes=replace(candidates.axes, prices=tuple(map(float, models))))
