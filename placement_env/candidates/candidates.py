"""Candidates: the sensors a search may choose from, as a product of mount, height, heading, tilt and sensor model.

Heading is counter-clockwise from +x, tilt below the horizon (rad), height above the mount's foot (m). The five indices
of a candidate are its `factors`; not every combination of them is a candidate.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from typing import Any

import numpy as np

from toolkit.arrays import Bool, Float64, Int64
from toolkit.sensors.sensor import Sensor, SensorModel
from toolkit.sites.site import Mount


@dataclass(frozen=True, eq=False)
class Axes:
    """What the factors after the mount count: heights (m), headings and tilts (rad), sensor models.

    prices: of each model, in the unit of the mounts' prices; empty where sensors cost nothing beside their mounts.
    Raises ValueError unless there is one, finite and not negative, for each model.
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

    def prices_of(self, models: Sequence[SensorModel]) -> tuple[float, ...]:
        """`prices` for some of the models, in the order given."""
        return tuple(self.prices[self.models.index(model)] for model in models) if self.prices else ()

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """How many heights, headings, tilts and models there are."""
        return len(self.heights), len(self.headings), len(self.tilts), len(self.models)


@dataclass(frozen=True, eq=False)
class Candidates:
    """C sensors to choose from. sensors: their names differ; mount: which of the M mounts each hangs on; factors: its
    mount and its places on the `axes` (a mount's own range may have moved its height).

    Raises ValueError where the fields do not fit together.
    """

    sensors: tuple[Sensor, ...]
    mount: Int64[np.ndarray, " C"]
    mounts: tuple[Mount, ...]
    factors: Int64[np.ndarray, "C 5"]
    axes: Axes

    def __post_init__(self) -> None:
        count = len(self.sensors)
        if len(self.mount) != count or len(self.factors) != count:
            raise ValueError(
                f"need one mount and one row of factors per sensor, got {count} sensors, {len(self.mount)} mounts and "
                f"{len(self.factors)} rows"
            )
        if len({sensor.name for sensor in self.sensors}) < count:
            raise ValueError(f"names of candidates must differ, got {repeated(s.name for s in self.sensors)!r} twice")
        if count and not ((self.factors >= 0) & (self.factors < self.shape)).all():
            raise ValueError(f"factors must lie in 0..{self.shape}, got up to {self.factors.max(axis=0).tolist()}")
        if not np.array_equal(self.mount, self.factors[:, 0]):
            raise ValueError("the first factor of each candidate must be its mount")

    def __len__(self) -> int:
        return len(self.sensors)

    @property
    def shape(self) -> tuple[int, int, int, int, int]:
        """How many mounts, heights, headings, tilts and models the factors tell apart."""
        return len(self.mounts), *self.axes.shape

    @cached_property
    def mount_prices(self) -> Float64[np.ndarray, " M"]:
        """Price of each mount."""
        return np.array([mount.price for mount in self.mounts], np.float64)

    @cached_property
    def model_prices(self) -> Float64[np.ndarray, " C"]:
        """Price of the sensor of each candidate, without its mount."""
        each = np.array(self.axes.prices or np.zeros(len(self.axes.models)), np.float64)
        return each[self.factors[:, 4]]

    @cached_property
    def prices(self) -> Float64[np.ndarray, " C"]:
        """Price of each candidate built alone: its mount and its sensor."""
        return self.mount_prices[self.mount] + self.model_prices

    @cached_property
    def places(self) -> Int64[np.ndarray, " M"]:
        """How many sensors each mount may carry."""
        return np.array([mount.max_sensors for mount in self.mounts], np.int64)

    @cached_property
    def several(self) -> bool:
        """Whether any mount may carry more than one."""
        return bool((self.places > 1).any())

    @cached_property
    def links(self) -> Float64[np.ndarray, " M"]:
        """What the link of each mount carries (kbit per frame)."""
        return np.array([mount.capacity for mount in self.mounts], np.float64)

    @cached_property
    def capacity(self) -> Float64[np.ndarray, " C"]:
        """What the link of each candidate's mount carries (kbit per frame)."""
        return self.links[self.mount]

    @cached_property
    def on_mount(self) -> Bool[np.ndarray, "C M"]:
        """Which candidates hang on which mount; `on_mount @ on_mount[c]` are the rivals of candidate c, and itself."""
        return self.mount[:, None] == np.arange(len(self.mounts))

    def per_mount(self, subsets: Bool[np.ndarray, "n C"]) -> Int64[np.ndarray, "n M"]:
        """How many sensors of each set hang on each mount."""
        chosen, candidate = np.nonzero(subsets)
        cells = chosen * len(self.mounts) + self.mount[candidate]
        return np.bincount(cells, minlength=len(subsets) * len(self.mounts)).reshape(len(subsets), len(self.mounts))

    def at(self, mount: Any, height: Any, heading: Any, tilt: Any, model: Any) -> Any:
        """The candidate with these factors, -1 where there is none; of arrays of indices, an array."""
        factors = np.broadcast_arrays(mount, height, heading, tilt, model)
        inside = np.logical_and.reduce([(f >= 0) & (f < n) for f, n in zip(factors, self.shape, strict=True)])
        if not len(self):
            return np.full(inside.shape, -1)[()]
        asked = np.ravel_multi_index(factors, self.shape, mode="clip")
        order, keys = self._by_factors
        place = np.minimum(np.searchsorted(keys, asked), len(keys) - 1)
        return np.where(inside & (keys[place] == asked), order[place], -1)[()]

    def select(self, indices: Sequence[int] | Int64[np.ndarray, " n"]) -> Candidates:
        """Some of the candidates, in the order given; mounts and axes stay, so factors keep their meaning."""
        chosen = np.asarray(indices, np.int64)
        sensors = tuple(self.sensors[i] for i in chosen)
        return Candidates(sensors, self.mount[chosen], self.mounts, self.factors[chosen], self.axes)

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

    @cached_property
    def _by_factors(self) -> tuple[np.ndarray, np.ndarray]:
        """The candidates in order of their flat factors, and those."""
        flat = np.ravel_multi_index(tuple(self.factors.T), self.shape)
        order = np.argsort(flat, kind="stable")
        return order, flat[order]


def repeated(names: Iterable[str]) -> str:
    """The first name that occurs twice."""
    seen: set[str] = set()
    return next(name for name in names if name in seen or seen.add(name))  # type: ignore[func-returns-value]
