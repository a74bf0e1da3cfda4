"""Candidates of a site: own sensors, pools of poses, poles, random samples."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import compress
from pathlib import Path

import numpy as np
import shapely

from placement_env.candidates.candidates import Axes, Candidates, aims, find_repeat
from placement_env.candidates.poles import load_poles
from placement_env.candidates.sensor_catalogue import SensorCatalogue
from toolkit.arrays import Bool, Float64
from toolkit.geometry import pose
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor, SensorModel
from toolkit.sites.site import Mount, Site

HEIGHTS = (4.0, 6.0, 8.0)  # m above the foot of the mount
TILTS = (float(np.deg2rad(5.0)), float(np.deg2rad(15.0)), float(np.deg2rad(25.0)))  # rad below the horizon
ON_ITS_MOUNT = 1.0  # m, seen from above, between a sensor and the foot of a mount that carries it
CELLS = 16  # the area is checked at CELLS x CELLS places for poses that see none of it
CELL_HEIGHT = 1.0  # m above the street
PAPER = (DepthCamera(),)
MOST_POSES = 8  # of the pool in one random set
Models = Sequence[SensorModel] | Mapping[SensorModel, float]  # with their prices, if sensors cost anything


class NoCandidates(ValueError):
    """No mount or pose is left for a sensor."""


def paper_candidates(site: Site) -> Candidates:
    """Return the present sensors of `site`, each on its own mount. Raises ValueError if the site has none.

    That is the nearest within `ON_ITS_MOUNT` (a copy for a second sensor), else a new one where the sensor is.
    """
    if not site.sensors:
        raise ValueError(f"site {site.name!r} has no sensors of its own: take candidates from pool(site)")
    mounts: list[Mount] = []
    for sensor in site.sensors:
        x, y, z = sensor.position.tolist()
        near = min(site.mounts, key=lambda m: float(np.hypot(*(m.position[:2] - (x, y)))), default=None)
        if near is None or np.hypot(*(near.position[:2] - (x, y))) > ON_ITS_MOUNT:
            foot = min(z, float(site.ground(np.array([x, y]))))
            low, high = min(3.0, z - foot), max(8.0, z - foot)
            near = Mount(f"{sensor.name}_mount", np.array([x, y, foot]), low, high)
        elif near.name in {mount.name for mount in mounts}:
            near = replace(near, name=f"{near.name}_{sensor.name}")
        mounts.append(near)
    heights = [s.position[2] - m.position[2] for s, m in zip(site.sensors, mounts, strict=True)]
    headings, tilts = aims(site.sensors)
    up, around, down = (np.unique(np.round(v, 6), return_inverse=True) for v in (heights, headings, tilts))
    models = tuple(dict.fromkeys(sensor.model for sensor in site.sensors))
    model = np.array([models.index(sensor.model) for sensor in site.sensors])
    factors = np.column_stack([np.arange(len(mounts)), up[1], around[1], down[1], model])
    return Candidates(site.sensors, tuple(mounts), factors, Axes(up[0], around[0], down[0], models))


def pool(
    site: Site,
    *,
    heights: Sequence[float] = HEIGHTS,
    headings: int = 8,
    tilts: Sequence[float] = TILTS,
    models: Models = PAPER,
    keep_out: Sequence[shapely.Geometry] = (),
    mounts: Sequence[Mount] | None = None,
    blind: bool = False,
) -> Candidates:
    """Return every model on every mount, at every height, heading and tilt.

    heights: m, clipped to the range of the mount, those that then coincide kept once; headings: number of them, evenly
    spaced from +x on; tilts: rad below the horizon; models: with their prices, or without if only mounts cost;
    keep_out: areas whose mounts are not used; mounts: None for the site's; blind: keep poses whose field of view misses
    the whole detection area. Raises ValueError where an argument does not fit, `NoCandidates` where nothing is left.
    """
    offered = site.mounts if mounts is None else mounts
    if len({mount.name for mount in offered}) < len(offered):
        raise ValueError(f"mounts[].name must differ, got {find_repeat(m.name for m in offered)!r} twice: rename one")
    spots = np.array([mount.position[:2] for mount in offered]).reshape(-1, 2)
    chosen = tuple(compress(offered, ~shapely.intersects_xy(shapely.union_all(list(keep_out)), *spots.T)))
    if not chosen:
        where = f"site {site.name!r} has no mount outside the keep-out areas (of {len(offered)})"
        raise NoCandidates(f"{where}: give some poles")
    axes = _axes(heights, headings, tilts, models)
    feet = np.array([mount.position for mount in chosen])
    mounted = _heights(chosen, axes.heights)
    shape = (len(chosen), *axes.shape)
    factors = np.argwhere(np.broadcast_to(np.isfinite(mounted)[:, :, None, None, None], shape)).astype(np.int64)
    position = feet[factors[:, 0]] + mounted[factors[:, 0], factors[:, 1], None] * [0.0, 0.0, 1.0]
    bodies = np.array([[pose(yaw=float(y), pitch=float(t))[:3, :3] for t in axes.tilts] for y in axes.headings])
    rotations = np.stack([bodies @ model.body_SE3_sensor[:3, :3] for model in axes.models], axis=2)
    if not blind:
        kept = _sees_area(site, position, factors, rotations, axes.models)
        factors, position = factors[kept], position[kept]
    if not len(factors):
        remedy = "give other heights, headings, tilts or mounts"
        raise NoCandidates(f"no pose sees the area of site {site.name!r}: {remedy}")
    poses = np.tile(np.eye(4), (len(factors), 1, 1))
    poses[:, :3, :3] = rotations[tuple(factors[:, 2:].T)]
    poses[:, :3, 3] = position
    rows = zip(_names(chosen, mounted, axes, factors), factors[:, 4], poses, strict=True)
    return Candidates(tuple(Sensor(name, axes.models[model], at) for name, model, at in rows), chosen, factors, axes)


def choose_candidates(
    site: Site,
    which: str | Path,
    models: Sequence[SensorModel] = (),
    *,
    catalogue: SensorCatalogue | None = None,
    keep_out: Sequence[shapely.Geometry] = (),
) -> Candidates:
    """Return the candidates that a user names.

    which: "pool" for every pose on the site's mounts, "paper" for the site's own sensors, else a GeoJSON file of poles;
    models: none for the paper's camera; catalogue: models with prices, in place of these; keep_out: areas beside those
    of the file; how many mounts they hold is said as a warning. Raises ValueError if models or areas are given for
    sensors that hang already, and what `load_poles` and `pool` raise.
    """
    if which == "paper":
        if models:
            raise ValueError("the site's own sensors have their models: give models with 'pool' or a file of poles")
        if keep_out:
            raise ValueError("the site's own sensors hang already: keep-out areas are for 'pool' or a file of poles")
        return paper_candidates(site)
    offer: Models = models or PAPER
    if catalogue is not None:
        offer = {each.model: each.price for each in catalogue.models}
    mounts = site.mounts if which == "pool" else load_poles(which, site, catalogue)
    if keep_out:
        spots = np.array([mount.position[:2] for mount in mounts]).reshape(-1, 2)
        held = int(shapely.intersects_xy(shapely.union_all(list(keep_out)), *spots.T).sum())
        areas = f"{len(keep_out)} keep-out area{'s' * (len(keep_out) > 1)}"
        warnings.warn(f"{areas} at {site.name}: {held} of {len(mounts)} poles stand there", stacklevel=3)
    return pool(site, mounts=mounts, keep_out=keep_out, models=offer)


def own_and_random(
    site: Site, poses: int, rng: np.random.Generator, *, models: Sequence[SensorModel] = ()
) -> Candidates:
    """Return the site's own sensors, each on a mount of its own, then random poses of its pool.

    models: none for the paper's camera. Raises ValueError where the pool has fewer poses, or there would be no sensor.
    """
    more, least = pool(site, models=tuple(models) or PAPER), 0 if site.sensors else 1
    if not least <= poses <= len(more):
        raise ValueError(f"poses must be {least} to the {len(more)} of the pool of {site.name!r}, got {poses}")
    more = more.select(np.sort(rng.choice(len(more), poses, replace=False)))
    if not site.sensors:
        return more
    own = paper_candidates(site)
    mount = np.concatenate([own.mount, len(own.mounts) + more.mount])
    factors = np.column_stack([mount, np.zeros((len(mount), 4), np.int64)])
    return replace(own, sensors=own.sensors + more.sensors, mounts=own.mounts + more.mounts, factors=factors)


def random_sets(candidates: Candidates, own: int, count: int, rng: np.random.Generator) -> Bool[np.ndarray, "n C"]:
    """Draw up to `count` different sets, half of them from the first `own` candidates, if there are any.

    The others have 1 to `MOST_POSES` of the other candidates, at most one on a mount.
    """
    sets, of_own = np.zeros((count, len(candidates)), bool), count // 2 if own else 0
    for row in sets[:of_own]:
        row[rng.choice(own, rng.integers(1, own + 1), replace=False)] = True
    for row in sets[of_own:]:
        members = own + rng.permutation(len(candidates) - own)
        _, first = np.unique(candidates.mount[members], return_index=True)
        row[members[np.sort(first)][: rng.integers(1, MOST_POSES + 1)]] = True
    return np.unique(sets, axis=0)


def _axes(heights: Sequence[float], headings: int, tilts: Sequence[float], models: Models) -> Axes:
    if headings < 1 or not (len(heights) and len(tilts) and len(models)):
        raise ValueError("a pool needs at least one height, heading, tilt and sensor model")
    if not (np.isfinite(heights).all() and min(heights) >= 0):
        raise ValueError(f"heights must be finite and not negative, got {list(heights)}")
    if not (np.isfinite(tilts).all() and np.abs(tilts).max() <= np.pi / 2):
        raise ValueError(f"tilts must lie in -pi/2..pi/2 rad, got {list(tilts)}: give degrees as np.deg2rad(10)")
    around = np.arange(headings) * 2 * np.pi / headings
    up, down = np.unique(np.asarray(heights, np.float64)), np.unique(np.asarray(tilts, np.float64))
    prices = tuple(float(price) for price in models.values()) if isinstance(models, Mapping) else ()
    return Axes(up, around, down, tuple(dict.fromkeys(models)), prices)


def _heights(mounts: Sequence[Mount], heights: np.ndarray) -> Float64[np.ndarray, "M H"]:
    """Each height, clipped to the range of each mount. NaN where clipping gives the same as for a nearer height."""
    low, high = np.array([[mount.min_height, mount.max_height] for mount in mounts]).T[:, :, None]
    clipped = np.clip(heights, low, high)
    mounted = np.full(clipped.shape, np.nan)
    for row, (in_range, moved) in enumerate(zip(clipped, np.abs(clipped - heights), strict=True)):
        nearest_first = np.argsort(moved, kind="stable")
        values, first = np.unique(in_range[nearest_first], return_index=True)
        mounted[row, nearest_first[first]] = values
    return mounted


def _sees_area(
    site: Site, position: np.ndarray, factors: np.ndarray, rotations: np.ndarray, models: Sequence[SensorModel]
) -> Bool[np.ndarray, " C"]:
    """True for poses with some of the area in view. Nothing is taken to stand in between."""
    xmin, ymin, xmax, ymax = site.area
    middles = (np.arange(CELLS) + 0.5) / CELLS
    x, y = np.meshgrid(xmin + middles * (xmax - xmin), ymin + middles * (ymax - ymin))
    places = np.stack([x, y, site.ground(np.stack([x, y], axis=-1)) + CELL_HEIGHT], axis=-1).reshape(-1, 3)
    sees = np.zeros(len(factors), bool)
    for heading, tilt, model in np.ndindex(rotations.shape[:3]):
        rows = np.flatnonzero((factors[:, 2:] == (heading, tilt, model)).all(axis=1))
        offsets = (places - position[rows, None]) @ rotations[heading, tilt, model]
        sees[rows] = models[model].in_view(offsets).any(axis=1)
    return sees


def _names(mounts: Sequence[Mount], mounted: np.ndarray, axes: Axes, factors: np.ndarray) -> list[str]:
    """Names such as post07_6.0m_h90_t15_camera."""
    heights, place = np.unique(mounted[factors[:, 0], factors[:, 1]], return_inverse=True)
    height, heading, tilt = _format(heights, 1), *(_format(np.rad2deg(x), 0) for x in (axes.headings, axes.tilts))
    kinds = [model.kind for model in axes.models]
    model = [kind if kinds.count(kind) == 1 else f"{kind}{kinds[:i].count(kind)}" for i, kind in enumerate(kinds)]
    return [
        f"{mounts[m].name}_{height[h]}m_h{heading[y]}_t{tilt[t]}_{model[k]}"
        for h, (m, _, y, t, k) in zip(place, factors, strict=True)
    ]


def _format(values: np.ndarray, decimals: int) -> list[str]:
    """Different numbers with the fewest decimals that tell them apart."""
    texts = [f"{value:.{decimals}f}" for value in values]
    return texts if len(set(texts)) == len(texts) or decimals > 15 else _format(values, decimals + 1)


def with_terms(candidates: Candidates, pole_price: float, capacity: float | None) -> Candidates:
    """Return the candidates with mounts priced in a currency. capacity: of all links, None for their own."""
    mounts = tuple(
        replace(mount, price=mount.price * pole_price, capacity=mount.capacity if capacity is None else capacity)
        for mount in candidates.mounts
    )
    return replace(candidates, mounts=mounts)
