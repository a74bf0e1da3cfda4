"""Candidates: the sensors that a search may choose from, a product of mount, height, heading, tilt and sensor model.

Heading is counter-clockwise from +x, tilt below the horizon (rad), height above the mount's foot (m). The five indices
of a candidate are its `factors`; not every combination of them is a candidate. A mount carries up to
`Mount.max_sensors` sensors; everything they send shares its one link, and the mount itself is paid once.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cached_property
from hashlib import sha256

import numpy as np
from numpy.typing import ArrayLike

from toolkit.arrays import Bool, Float64, Int64, Shaped
from toolkit.display import Card, Displayed, Table, describe_count
from toolkit.geometry import pose
from toolkit.sensors.sensor import Sensor, SensorModel, tabulate_sensors
from toolkit.sites.site import Mount

ROUNDED = 1e-9  # share of a link's capacity by which rounding may exceed it


@dataclass(frozen=True, eq=False)
class Axes:
    """Values of the factors after the mount: heights (m), headings and tilts (rad), models.

    prices: of each model, in the unit of the mounts' prices, or none. Raises ValueError where they do not fit.
    """

    heights: Float64[np.ndarray, " H"]
    headings: Float64[np.ndarray, " Y"]
    tilts: Float64[np.ndarray, " T"]
    models: tuple[SensorModel, ...]
    prices: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.prices and len(self.prices) != len(self.models):
            raise ValueError(f"need a price for each of {len(self.models)} models, got {len(self.prices)}")
        if not all(0 <= price < np.inf for price in self.prices):
            raise ValueError(f"prices of models must be finite and not negative, got {self.prices}")

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Number of heights, headings, tilts and models."""
        return len(self.heights), len(self.headings), len(self.tilts), len(self.models)


@dataclass(frozen=True, eq=False)
class Candidates(Displayed):
    """C sensors of different names to choose from, on M mounts.

    factors: index of each sensor's mount, and its place on each of the `axes` (a mount's own range may have moved its
    height). Raises ValueError where the fields do not fit together.
    """

    sensors: tuple[Sensor, ...]
    mounts: tuple[Mount, ...]
    factors: Int64[np.ndarray, "C 5"]
    axes: Axes

    def __post_init__(self) -> None:
        count = len(self.sensors)
        if len(self.factors) != count:
            raise ValueError(f"need one row of factors per sensor, got {count} sensors and {len(self.factors)} rows")
        if len({sensor.name for sensor in self.sensors}) < count:
            repeat = find_repeat(s.name for s in self.sensors)
            raise ValueError(f"names of candidates must differ, got {repeat!r} twice")
        if count and not ((self.factors >= 0) & (self.factors < self.shape)).all():
            raise ValueError(f"factors must lie in 0..{self.shape}, got up to {self.factors.max(axis=0).tolist()}")

    @staticmethod
    def of_poses(
        sensors: Sequence[Sensor], mount: Int64[np.ndarray, " n"], aim: Float64[np.ndarray, "n 3"], pool: Candidates
    ) -> Candidates:
        """Candidates in poses of their own on a pool's mounts. aim: height, heading and tilt of each."""
        models, count = tuple(dict.fromkeys(sensor.model for sensor in sensors)), np.arange(len(sensors))
        model = [models.index(sensor.model) for sensor in sensors]
        known = pool.axes
        prices = tuple(known.prices[known.models.index(each)] for each in models) if known.prices else ()
        factors = np.column_stack([mount, count, count, count, model]).astype(np.int64)
        heights, headings, tilts = aim.T
        return Candidates(tuple(sensors), pool.mounts, factors, Axes(heights, headings, tilts, models, prices))

    def __len__(self) -> int:
        return len(self.sensors)

    def _card(self) -> Card:
        _, heights, headings, tilts, _ = self.shape
        kinds = ", ".join(dict.fromkeys(model.kind for model in self.axes.models))
        numbers = {"mount": len(self.mounts), "height": heights, "heading": headings, "tilt": tilts}
        facts = *(describe_count(number, name) for name, number in numbers.items()), kinds
        title = describe_count(len(self), "candidate sensor")
        return Card(title, facts, {"sensors": self._tabulate}, "placement_env.report.maps:draw_pool")

    def _tabulate(self) -> Table:
        heading, tilt = self.factors[:, 2:4].T
        axes = self.axes
        degrees = {"heading_deg": np.degrees(axes.headings)[heading], "tilt_deg": np.degrees(axes.tilts)[tilt]}
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
        return np.array(self.axes.prices or np.zeros(len(self.axes.models)), np.float64)[self.factors[:, 4]]

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
                    f"no sensor may stand on a pole {name!r}, which is unknown, in a keep-out area or on the "
                    f"carriageway: name one of the {len(known)} poles that may be built, such as {near}"
                )
        return np.array([known[name] for name in names], np.int64)

    def per_mount(
        self, subsets: Bool[np.ndarray, "n C"], each: Float64[np.ndarray, " C"] | None = None
    ) -> Shaped[np.ndarray, "n M"]:
        """Count the sensors of each set on each mount, or add up a figure of theirs."""
        chosen, candidate = np.nonzero(subsets)
        cells, shape = chosen * len(self.mounts) + self.mount[candidate], (len(subsets), len(self.mounts))
        figures = None if each is None else each[candidate]
        return np.bincount(cells, figures, minlength=shape[0] * shape[1]).reshape(shape)

    def at(
        self, mount: ArrayLike, height: ArrayLike, heading: ArrayLike, tilt: ArrayLike, model: ArrayLike
    ) -> np.int64 | Int64[np.ndarray, "..."]:
        """Return the candidate with these factors, -1 for none."""
        asked = np.stack(np.broadcast_arrays(mount, height, heading, tilt, model), axis=-1)
        same = (asked[..., None, :] == self.factors).all(axis=-1)
        place = np.concatenate([same, np.ones((*asked.shape[:-1], 1), np.bool_)], axis=-1).argmax(axis=-1)
        return np.where(place < len(self), place, -1)[()]

    def select(self, indices: Sequence[int] | Int64[np.ndarray, " n"]) -> Candidates:
        """Return some of the candidates, in the given order. Mounts and axes stay, so factors keep their meaning."""
        chosen = np.asarray(indices, np.int64)
        return Candidates(tuple(self.sensors[i] for i in chosen), self.mounts, self.factors[chosen], self.axes)

    def digest(self) -> str:
        """SHA-256 over sensors, mounts and factors; the same on every machine."""
        sha = sha256(repr([(sensor.name, sensor.digest) for sensor in self.sensors]).encode())
        for mount in self.mounts:
            rest = (mount.name, mount.min_height, mount.max_height, mount.price, mount.capacity)
            sha.update(repr((rest, mount.position.tolist())).encode())
        sha.update(repr(self.places.tolist()).encode() if self.several else b"")
        axes = (self.axes.heights, self.axes.headings, self.axes.tilts)
        sha.update(repr([[axis.tolist() for axis in axes], self.axes.models, self.factors.tolist()]).encode())
        sha.update(repr(self.axes.prices).encode() if any(self.axes.prices) else b"")
        return sha.hexdigest()


def find_repeat(names: Iterable[str]) -> str:
    """Return the first name that occurs twice."""
    seen: set[str] = set()
    return next(name for name in names if name in seen or seen.add(name))  # type: ignore[func-returns-value]


def aims(sensors: Sequence[Sensor]) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Heading and tilt below the horizon (rad) of each sensor."""
    turns = np.array([sensor.pose[:3, :3] for sensor in sensors]).reshape(-1, 3, 3)
    forward = np.array([sensor.model.body_SE3_sensor[0, :3] for sensor in sensors]).reshape(-1, 3)  # sensor frames
    x, y, z = np.einsum("nij,nj->in", turns, forward)
    return np.arctan2(y, x), np.arctan2(-z, np.hypot(x, y))


def aim_sensor(sensor: Sensor, position: Float64[np.ndarray, "3"], heading: float, tilt: float) -> Sensor:
    """Return the sensor at another position and aim."""
    x, y, z = position.tolist()
    return replace(sensor, pose=pose(x, y, z, yaw=heading, pitch=tilt) @ sensor.model.body_SE3_sensor)


def fit_together(
    candidates: Candidates, subsets: Bool[np.ndarray, "n C"], sent: Float64[np.ndarray, " C"] | None = None
) -> Bool[np.ndarray, " n"]:
    """Tell which sets fit on their mounts and shared links. sent: kbit per frame, None where links always suffice."""
    per_mount = candidates.per_mount(subsets)
    fits = np.asarray((per_mount <= candidates.places).all(axis=1))
    if sent is None or not candidates.several:
        return fits
    loads, links = candidates.per_mount(subsets, sent), np.array([mount.capacity for mount in candidates.mounts])
    return np.asarray(fits & ((loads <= links * (1 + ROUNDED)) | (per_mount <= 1)).all(axis=1))


def room_beside(
    candidates: Candidates, subsets: Bool[np.ndarray, "n C"], sent: Float64[np.ndarray, " C"] | None = None
) -> Bool[np.ndarray, "n C"]:
    """Tell which candidates have room beside each set."""
    mount, count = candidates.mount, candidates.per_mount(subsets)
    room = np.asarray((count < candidates.places)[:, mount] & ~subsets)
    if sent is None or not candidates.several:
        return room
    load = candidates.per_mount(subsets, sent)[:, mount] + sent
    return np.asarray(room & ((load <= candidates.capacity * (1 + ROUNDED)) | (count == 0)[:, mount]))


def extra_prices(candidates: Candidates, row: Bool[np.ndarray, " C"]) -> Float64[np.ndarray, " C"]:
    """Price that each candidate adds to a set. A mount that carries a sensor already is paid."""
    paid = np.isin(candidates.mount, candidates.mount[row])
    return np.where(paid, candidates.model_prices, candidates.prices)
