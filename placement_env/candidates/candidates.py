"""Candidates: the sensors that a search may choose from, a product of mount, height, heading, tilt
and sensor model.

Heading is counter-clockwise from +x, tilt below the horizon (rad), height above the mount's foot
(m). The five indices of a candidate are its `factors`; not every combination of them is a
candidate. A mount carries up to `Mount.max_sensors` sensors; everything they send shares its one
link, and the mount itself is paid once.

Candidates of a site are its own sensors, pools of poses, poles or random samples."""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cached_property
from hashlib import sha256
from itertools import compress
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import ArrayLike

from placement_env.candidates.poles import load_poles
from placement_env.candidates.sensor_catalogue import SensorCatalogue
from placement_env.links import max_load
from placement_env.subsets import Sets
from toolkit.arrays import Bool, Float64, Int64, Mask, Rng, Shaped
from toolkit.display import Card, Displayed, Table, describe_count
from toolkit.geometry import pose
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor, SensorModel, tabulate_sensors
from toolkit.sites.site import Mount, Site


@dataclass(frozen=True, eq=False)
class Axes:
    """Values of the factors after the mount: heights (m), headings and tilts (rad), models. prices:
    of each model, in the unit of the mounts' prices, or none. Raises ValueError where they do not
    fit."""

    heights: Float64[np.ndarray, " H"]
    headings: Float64[np.ndarray, " Y"]
    tilts: Float64[np.ndarray, " T"]
    models: tuple[SensorModel, ...]
    prices: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.prices and len(self.prices) != len(self.models):
            raise ValueError(
                f"need a price for each of {len(self.models)} models, got {len(self.prices)}"
            )
        if not all(0 <= price < np.inf for price in self.prices):
            raise ValueError(f"prices of models must be finite and not negative, got {self.prices}")

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Number of heights, headings, tilts and models."""
        return len(self.heights), len(self.headings), len(self.tilts), len(self.models)


@dataclass(frozen=True, eq=False)
class Candidates(Displayed):
    """C sensors of different names to choose from, on M mounts.

    factors: index of each sensor's mount, and its place on each of the `axes` (a mount's own range
    may have moved its height). Raises ValueError where the fields do not fit together."""

    sensors: tuple[Sensor, ...]
    mounts: tuple[Mount, ...]
    factors: Int64[np.ndarray, "C 5"]
    axes: Axes

    def __post_init__(self) -> None:
        count = len(self.sensors)
        if len(self.factors) != count:
            raise ValueError(
                f"need one row of factors per sensor, got {count} sensors and {len(self.factors)} "
                "rows"
            )
        if len({sensor.name for sensor in self.sensors}) < count:
            repeat = find_repeat(s.name for s in self.sensors)
            raise ValueError(f"names of candidates must differ, got {repeat!r} twice")
        if count and not ((self.factors >= 0) & (self.factors < self.shape)).all():
            raise ValueError(
                f"factors must lie in 0..{self.shape}, got up to "
                f"{self.factors.max(axis=0).tolist()}"
            )

    @staticmethod
    def of_poses(
        sensors: Sequence[Sensor],
        mount: Int64[np.ndarray, " n"],
        aim: Float64[np.ndarray, "n 3"],
        pool: "Candidates",
    ) -> "Candidates":
        """Candidates in poses of their own on a pool's mounts. aim: height, heading and tilt of
        each."""
        models = tuple(dict.fromkeys(sensor.model for sensor in sensors))
        count = np.arange(len(sensors))
        model = [models.index(sensor.model) for sensor in sensors]
        known = pool.axes
        prices = (
            tuple(known.prices[known.models.index(each)] for each in models) if known.prices else ()
        )
        factors = np.column_stack([mount, count, count, count, model]).astype(np.int64)
        heights, headings, tilts = aim.T
        return Candidates(
            tuple(sensors), pool.mounts, factors, Axes(heights, headings, tilts, models, prices)
        )

    def __len__(self) -> int:
        return len(self.sensors)

    def _card(self) -> Card:
        _, heights, headings, tilts, _ = self.shape
        kinds = ", ".join(dict.fromkeys(model.kind for model in self.axes.models))
        numbers = {"mount": len(self.mounts), "height": heights, "heading": headings, "tilt": tilts}
        facts = *(describe_count(number, name) for name, number in numbers.items()), kinds
        title = describe_count(len(self), "candidate sensor")
        return Card(
            title, facts, {"sensors": self._tabulate}, "placement_env.report.maps:draw_pool"
        )

    def _tabulate(self) -> Table:
        heading, tilt = self.factors[:, 2:4].T
        axes = self.axes
        degrees = {
            "heading_deg": np.degrees(axes.headings)[heading],
            "tilt_deg": np.degrees(axes.tilts)[tilt],
        }
        poles = [self.mounts[mount].name for mount in self.mount]
        return {"mount": poles, **tabulate_sensors(self.sensors), **degrees, "price": self.prices}

    @property
    def shape(self) -> tuple[int, int, int, int, int]:
        """Number of mounts, heights, headings, tilts and models."""
        return len(self.mounts), *self.axes.shape

    @cached_property
    def mount(self) -> Int64[np.ndarray, " C"]:
        """Index of each candidate's mount."""
        return self.factors[:, 0].copy()

    @cached_property
    def mount_prices(self) -> Float64[np.ndarray, " M"]:
        """Price of each mount."""
        return np.array([mount.price for mount in self.mounts], np.float64)

    @cached_property
    def model_prices(self) -> Float64[np.ndarray, " C"]:
        """Price of each candidate's sensor, without its mount."""
        return np.array(self.axes.prices or np.zeros(len(self.axes.models)), np.float64)[
            self.factors[:, 4]
        ]

    @cached_property
    def prices(self) -> Float64[np.ndarray, " C"]:
        """Price of each candidate built alone: its mount and its sensor."""
        return self.mount_prices[self.mount] + self.model_prices

    @cached_property
    def places(self) -> Int64[np.ndarray, " M"]:
        """Most sensors that each mount may carry."""
        return np.array([mount.max_sensors for mount in self.mounts], np.int64)

    @cached_property
    def several(self) -> bool:
        """True where some mount may carry more than one sensor."""
        return bool((self.places > 1).any())

    @cached_property
    def capacity(self) -> Float64[np.ndarray, " C"]:
        """Capacity of the link of each candidate's mount (kbit per frame)."""
        return np.array([self.mounts[mount].capacity for mount in self.mount], np.float64)

    def find_mounts(self, names: Sequence[str]) -> Int64[np.ndarray, " k"]:
        """Indices of mounts by name. Raises ValueError for a name that none has."""
        known = {mount.name: m for m, mount in enumerate(self.mounts)}
        for name in names:
            if name not in known:
                near = " or ".join(get_close_matches(name, known, 3, 0.4) or list(known)[:3])
                raise ValueError(
                    f"no sensor may stand on a pole {name!r}, which is unknown, in a keep-out "
                    f"area or on the carriageway: name one of the {len(known)} poles that may be "
                    f"built, such as {near}"
                )
        return np.array([known[name] for name in names], np.int64)

    def per_mount(
        self, subsets: Sets, each: Float64[np.ndarray, " C"] | None = None
    ) -> Shaped[np.ndarray, "n M"]:
        """Count the sensors of each set on each mount, or add up a figure of theirs."""
        chosen, candidate = np.nonzero(subsets)
        cells = chosen * len(self.mounts) + self.mount[candidate]
        shape = (len(subsets), len(self.mounts))
        figures = None if each is None else each[candidate]
        return np.bincount(cells, figures, minlength=shape[0] * shape[1]).reshape(shape)

    def at(
        self,
        mount: ArrayLike,
        height: ArrayLike,
        heading: ArrayLike,
        tilt: ArrayLike,
        model: ArrayLike,
    ) -> np.int64 | Int64[np.ndarray, "..."]:
        """Return the candidate with these factors, -1 for none."""
        asked = np.stack(np.broadcast_arrays(mount, height, heading, tilt, model), axis=-1)
        same = (asked[..., None, :] == self.factors).all(axis=-1)
        place = np.concatenate([same, np.ones((*asked.shape[:-1], 1), np.bool_)], axis=-1).argmax(
            axis=-1
        )
        return np.where(place < len(self), place, -1)[()]

    def select(self, indices: Sequence[int] | Int64[np.ndarray, " n"]) -> "Candidates":
        """Return some of the candidates, in the given order. Mounts and axes stay, so factors keep
        their meaning."""
        chosen = np.asarray(indices, np.int64)
        return Candidates(
            tuple(self.sensors[i] for i in chosen), self.mounts, self.factors[chosen], self.axes
        )

    def digest(self) -> str:
        """SHA-256 over sensors, mounts and factors; the same on every machine."""
        sha = sha256(repr([(sensor.name, sensor.digest) for sensor in self.sensors]).encode())
        for mount in self.mounts:
            rest = (mount.name, mount.min_height, mount.max_height, mount.price, mount.capacity)
            sha.update(repr((rest, mount.position.tolist())).encode())
        sha.update(repr(self.places.tolist()).encode() if self.several else b"")
        axes = (self.axes.heights, self.axes.headings, self.axes.tilts)
        sha.update(
            repr(
                [[axis.tolist() for axis in axes], self.axes.models, self.factors.tolist()]
            ).encode()
        )
        sha.update(repr(self.axes.prices).encode() if any(self.axes.prices) else b"")
        return sha.hexdigest()


def find_repeat(names: Iterable[str]) -> str:
    """Return the first name that occurs twice."""
    seen: set[str] = set()
    return next(name for name in names if name in seen or seen.add(name))  # type: ignore[func-returns-value]


def aims(sensors: Sequence[Sensor]) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Heading and tilt below the horizon (rad) of each sensor."""
    turns = np.array([sensor.pose[:3, :3] for sensor in sensors]).reshape(-1, 3, 3)
    # sensor frames
    forward = np.array([sensor.model.body_SE3_sensor[0, :3] for sensor in sensors]).reshape(-1, 3)
    x, y, z = np.einsum("nij,nj->in", turns, forward)
    return np.arctan2(y, x), np.arctan2(-z, np.hypot(x, y))


def aim_sensor(
    sensor: Sensor, position: Float64[np.ndarray, "3"], heading: float, tilt: float
) -> Sensor:
    """Return the sensor at another position and aim."""
    x, y, z = position.tolist()
    return replace(
        sensor, pose=pose(x, y, z, yaw=heading, pitch=tilt) @ sensor.model.body_SE3_sensor
    )


def fit_together(
    candidates: Candidates, subsets: Sets, sent: Float64[np.ndarray, " C"] | None = None
) -> Mask:
    """Tell which sets fit on their mounts and shared links. sent: kbit per frame, None where links
    always suffice."""
    per_mount = candidates.per_mount(subsets)
    fits = np.asarray((per_mount <= candidates.places).all(axis=1))
    if sent is None or not candidates.several:
        return fits
    loads = candidates.per_mount(subsets, sent)
    links = np.array([mount.capacity for mount in candidates.mounts])
    return np.asarray(fits & ((loads <= max_load(links)) | (per_mount <= 1)).all(axis=1))


def room_beside(
    candidates: Candidates, subsets: Sets, sent: Float64[np.ndarray, " C"] | None = None
) -> Sets:
    """Tell which candidates have room beside each set."""
    mount = candidates.mount
    count = candidates.per_mount(subsets)
    room = np.asarray((count < candidates.places)[:, mount] & ~subsets)
    if sent is None or not candidates.several:
        return room
    load = candidates.per_mount(subsets, sent)[:, mount] + sent
    return np.asarray(room & ((load <= max_load(candidates.capacity)) | (count == 0)[:, mount]))


def extra_prices(candidates: Candidates, row: Bool[np.ndarray, " C"]) -> Float64[np.ndarray, " C"]:
    """Price that each candidate adds to a set. A mount that carries a sensor already is paid."""
    paid = np.isin(candidates.mount, candidates.mount[row])
    return np.where(paid, candidates.model_prices, candidates.prices)


HEIGHTS = (4.0, 6.0, 8.0)  # m above the foot of the mount
# rad below the horizon
TILTS = (float(np.deg2rad(5.0)), float(np.deg2rad(15.0)), float(np.deg2rad(25.0)))
ON_ITS_MOUNT = 1.0  # m, seen from above, between a sensor and the foot of a mount that carries it
CELLS = 16  # the area is checked at CELLS x CELLS places for poses that see none of it
CELL_HEIGHT = 1.0  # m above the street
PAPER = (DepthCamera(),)
MOST_POSES = 8  # of the pool in one random set
# with their prices, if sensors cost anything
Models = Sequence[SensorModel] | Mapping[SensorModel, float]


class NoCandidates(ValueError):
    """No mount or pose is left for a sensor."""


def paper_candidates(site: Site) -> Candidates:
    """Return the present sensors of `site`, each on its own mount. Raises ValueError if the site
    has none. That is the nearest within `ON_ITS_MOUNT` (a copy for a second sensor), else a new one
    where the sensor is."""
    if not site.sensors:
        raise ValueError(
            f"site {site.name!r} has no sensors of its own: take candidates from pool(site)"
        )
    mounts: list[Mount] = []
    for sensor in site.sensors:
        x, y, z = sensor.position.tolist()
        near = min(
            site.mounts, key=lambda m: float(np.hypot(*(m.position[:2] - (x, y)))), default=None
        )
        if near is None or np.hypot(*(near.position[:2] - (x, y))) > ON_ITS_MOUNT:
            foot = min(z, float(site.ground(np.array([x, y]))))
            low, high = min(3.0, z - foot), max(8.0, z - foot)
            near = Mount(f"{sensor.name}_mount", np.array([x, y, foot]), low, high)
        elif near.name in {mount.name for mount in mounts}:
            near = replace(near, name=f"{near.name}_{sensor.name}")
        mounts.append(near)
    heights = [s.position[2] - m.position[2] for s, m in zip(site.sensors, mounts, strict=True)]
    headings, tilts = aims(site.sensors)
    up, around, down = (
        np.unique(np.round(v, 6), return_inverse=True) for v in (heights, headings, tilts)
    )
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

    heights: m, clipped to the range of the mount, those that then coincide kept once; headings:
    number of them, evenly spaced from +x on; tilts: rad below the horizon; models: with their
    prices, or without if only mounts cost; keep_out: areas whose mounts are not used; mounts: None
    for the site's; blind: keep poses whose field of view misses the whole detection area. Raises
    ValueError where an argument does not fit, `NoCandidates` where nothing is left."""
    offered = site.mounts if mounts is None else mounts
    if len({mount.name for mount in offered}) < len(offered):
        raise ValueError(
            f"mounts[].name must differ, got {find_repeat(m.name for m in offered)!r} twice: "
            "rename one"
        )
    spots = np.array([mount.position[:2] for mount in offered]).reshape(-1, 2)
    chosen = tuple(
        compress(offered, ~shapely.intersects_xy(shapely.union_all(list(keep_out)), *spots.T))
    )
    if not chosen:
        where = f"site {site.name!r} has no mount outside the keep-out areas (of {len(offered)})"
        raise NoCandidates(f"{where}: give some poles")
    axes = _axes(heights, headings, tilts, models)
    feet = np.array([mount.position for mount in chosen])
    mounted = _heights(chosen, axes.heights)
    shape = (len(chosen), *axes.shape)
    factors = np.argwhere(
        np.broadcast_to(np.isfinite(mounted)[:, :, None, None, None], shape)
    ).astype(np.int64)
    position = feet[factors[:, 0]] + mounted[factors[:, 0], factors[:, 1], None] * [0.0, 0.0, 1.0]
    bodies = np.array(
        [[pose(yaw=float(y), pitch=float(t))[:3, :3] for t in axes.tilts] for y in axes.headings]
    )
    rotations = np.stack([bodies @ model.body_SE3_sensor[:3, :3] for model in axes.models], axis=2)
    if not blind:
        kept = _sees_area(site, position, factors, rotations, axes.models)
        factors = factors[kept]
        position = position[kept]
    if not len(factors):
        remedy = "give other heights, headings, tilts or mounts"
        raise NoCandidates(f"no pose sees the area of site {site.name!r}: {remedy}")
    poses = np.tile(np.eye(4), (len(factors), 1, 1))
    poses[:, :3, :3] = rotations[tuple(factors[:, 2:].T)]
    poses[:, :3, 3] = position
    rows = zip(_names(chosen, mounted, axes, factors), factors[:, 4], poses, strict=True)
    return Candidates(
        tuple(Sensor(name, axes.models[model], at) for name, model, at in rows),
        chosen,
        factors,
        axes,
    )


def choose_candidates(
    site: Site,
    which: str | Path,
    models: Sequence[SensorModel] = (),
    *,
    catalogue: SensorCatalogue | None = None,
    keep_out: Sequence[shapely.Geometry] = (),
) -> Candidates:
    """Return the candidates that a user names.

    which: "pool" for every pose on the site's mounts, "paper" for the site's own sensors, else a
    GeoJSON file of poles; models: none for the paper's camera; catalogue: models with prices, in
    place of these; keep_out: areas beside those of the file; how many mounts they hold is said as a
    warning. Raises ValueError if models or areas are given for sensors that hang already, and what
    `load_poles` and `pool` raise."""
    if which == "paper":
        if models:
            raise ValueError(
                "the site's own sensors have their models: give models with 'pool' or a file of "
                "poles"
            )
        if keep_out:
            raise ValueError(
                "the site's own sensors hang already: keep-out areas are for 'pool' or a file of "
                "poles"
            )
        return paper_candidates(site)
    offer: Models = models or PAPER
    if catalogue is not None:
        offer = {each.model: each.price for each in catalogue.models}
    mounts = site.mounts if which == "pool" else load_poles(which, site, catalogue)
    if keep_out:
        spots = np.array([mount.position[:2] for mount in mounts]).reshape(-1, 2)
        held = int(shapely.intersects_xy(shapely.union_all(list(keep_out)), *spots.T).sum())
        areas = f"{len(keep_out)} keep-out area{'s' * (len(keep_out) > 1)}"
        warnings.warn(
            f"{areas} at {site.name}: {held} of {len(mounts)} poles stand there", stacklevel=3
        )
    return pool(site, mounts=mounts, keep_out=keep_out, models=offer)


def own_and_random(
    site: Site, poses: int, rng: Rng, *, models: Sequence[SensorModel] = ()
) -> Candidates:
    """Return the site's own sensors, each on a mount of its own, then random poses of its pool.
    models: none for the paper's camera. Raises ValueError where the pool has fewer poses, or there
    would be no sensor."""
    more = pool(site, models=tuple(models) or PAPER)
    least = 0 if site.sensors else 1
    if not least <= poses <= len(more):
        raise ValueError(
            f"poses must be {least} to the {len(more)} of the pool of {site.name!r}, got {poses}"
        )
    more = more.select(np.sort(rng.choice(len(more), poses, replace=False)))
    if not site.sensors:
        return more
    own = paper_candidates(site)
    mount = np.concatenate([own.mount, len(own.mounts) + more.mount])
    factors = np.column_stack([mount, np.zeros((len(mount), 4), np.int64)])
    return replace(
        own, sensors=own.sensors + more.sensors, mounts=own.mounts + more.mounts, factors=factors
    )


def random_sets(candidates: Candidates, own: int, count: int, rng: np.random.Generator) -> Sets:
    """Draw up to `count` different sets, half of them from the first `own` candidates, if there are
    any. The others have 1 to `MOST_POSES` of the other candidates, at most one on a mount."""
    sets = np.zeros((count, len(candidates)), bool)
    of_own = count // 2 if own else 0
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
        raise ValueError(
            f"tilts must lie in -pi/2..pi/2 rad, got {list(tilts)}: give degrees as np.deg2rad(10)"
        )
    around = np.arange(headings) * 2 * np.pi / headings
    up = np.unique(np.asarray(heights, np.float64))
    down = np.unique(np.asarray(tilts, np.float64))
    prices = tuple(float(price) for price in models.values()) if isinstance(models, Mapping) else ()
    return Axes(up, around, down, tuple(dict.fromkeys(models)), prices)


def _heights(mounts: Sequence[Mount], heights: np.ndarray) -> Float64[np.ndarray, "M H"]:
    """Each height, clipped to the range of each mount. NaN where clipping gives the same as for a
    nearer height."""
    low, high = np.array([[mount.min_height, mount.max_height] for mount in mounts]).T[:, :, None]
    clipped = np.clip(heights, low, high)
    mounted = np.full(clipped.shape, np.nan)
    for row, (in_range, moved) in enumerate(zip(clipped, np.abs(clipped - heights), strict=True)):
        nearest_first = np.argsort(moved, kind="stable")
        values, first = np.unique(in_range[nearest_first], return_index=True)
        mounted[row, nearest_first[first]] = values
    return mounted


def _sees_area(
    site: Site,
    position: np.ndarray,
    factors: np.ndarray,
    rotations: np.ndarray,
    models: Sequence[SensorModel],
) -> Bool[np.ndarray, " C"]:
    """True for poses with some of the area in view. Nothing is taken to stand in between."""
    xmin, ymin, xmax, ymax = site.area
    middles = (np.arange(CELLS) + 0.5) / CELLS
    x, y = np.meshgrid(xmin + middles * (xmax - xmin), ymin + middles * (ymax - ymin))
    places = np.stack(
        [x, y, site.ground(np.stack([x, y], axis=-1)) + CELL_HEIGHT], axis=-1
    ).reshape(-1, 3)
    sees = np.zeros(len(factors), bool)
    for heading, tilt, model in np.ndindex(rotations.shape[:3]):
        rows = np.flatnonzero((factors[:, 2:] == (heading, tilt, model)).all(axis=1))
        offsets = (places - position[rows, None]) @ rotations[heading, tilt, model]
        sees[rows] = models[model].in_view(offsets).any(axis=1)
    return sees


def _names(
    mounts: Sequence[Mount], mounted: np.ndarray, axes: Axes, factors: np.ndarray
) -> list[str]:
    """Names such as post07_6.0m_h90_t15_camera."""
    heights, place = np.unique(mounted[factors[:, 0], factors[:, 1]], return_inverse=True)
    height, heading, tilt = (
        _format(heights, 1),
        *(_format(np.rad2deg(x), 0) for x in (axes.headings, axes.tilts)),
    )
    kinds = [model.kind for model in axes.models]
    model = [
        kind if kinds.count(kind) == 1 else f"{kind}{kinds[:i].count(kind)}"
        for i, kind in enumerate(kinds)
    ]
    poles = [name_sensor(mount.name) for mount in mounts]
    return [
        f"{poles[m]}_{height[h]}m_h{heading[y]}_t{tilt[t]}_{model[k]}"
        for h, (m, _, y, t, k) in zip(place, factors, strict=True)
    ]


def name_sensor(pole: str) -> str:
    """Return a pole's name as names of sensors hold it, by which a recording's groups are named:
    with - for /."""
    return pole.replace("/", "-")


def _format(values: np.ndarray, decimals: int) -> list[str]:
    """Different numbers with the fewest decimals that tell them apart."""
    texts = [f"{value:.{decimals}f}" for value in values]
    return (
        texts if len(set(texts)) == len(texts) or decimals > 15 else _format(values, decimals + 1)
    )


def with_terms(candidates: Candidates, pole_price: float, capacity: float | None) -> Candidates:
    """Return the candidates with mounts priced in a currency. capacity: of all links, None for
    their own."""
    mounts = tuple(
        replace(
            mount,
            price=mount.price * pole_price,
            capacity=mount.capacity if capacity is None else capacity,
        )
        for mount in candidates.mounts
    )
    return replace(candidates, mounts=mounts)
