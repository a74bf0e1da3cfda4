"""`FeasibleSets`: the sets of candidates that may be built.

A set is feasible if its mounts have room for its sensors, no sensor sends more than the link of its
mount carries (`placement_env.links`), its mounts and sensors cost no more than the maximum price,
and every mount that must carry a sensor has one.
"""

from collections.abc import Iterable, Sequence
from functools import cached_property

import numpy as np

from placement_env.candidates.candidates import Candidates, extra_prices, fit_together, room_beside
from placement_env.links import max_load, sent_in_most
from placement_env.subsets import Sets, find_index
from toolkit.arrays import Bool, Float64, Int64, Mask
from toolkit.detection.scheme import Scheme

PRICE_ROUNDING_SHARE = 1e-9  # excess over a price that rounding of sums may cause
Members = Iterable[int | str] | Int64[np.ndarray, " k"]  # members of a set, by index or name


class FeasibleSets:
    """Sets of candidates that may be built. A subclass gives the `loads` of the candidates.

    Attributes:
        candidates: Candidates.
        scheme: Fusion scheme.
        most_price: Largest price of a set.
        keep: Names of mounts that must carry a sensor.
        link_share: Share of the frames in which a link must carry all data.
    """

    candidates: Candidates
    scheme: Scheme
    most_price: float
    keep: tuple[str, ...]
    link_share: float

    @cached_property
    def loads(self) -> Float64[np.ndarray, " C"]:
        """kbit per frame that each candidate takes up of a link."""
        raise NotImplementedError

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the candidates."""
        return tuple(sensor.name for sensor in self.candidates.sensors)

    def row(self, subset: Members) -> Bool[np.ndarray, " C"]:
        """Row of booleans for a set of indices or names of candidates."""
        row = np.zeros(len(self.candidates), np.bool_)
        for member in subset.tolist() if isinstance(subset, np.ndarray) else subset:
            row[find_index(member, self.names)] = True
        return row

    # links

    @cached_property
    def linked(self) -> Bool[np.ndarray, " C"]:
        """Mask of candidates that fit their mount's link."""
        if not self.scheme.sends_points:
            return np.ones(len(self.candidates), np.bool_)
        return np.asarray(self.loads <= max_load(self.candidates.capacity))

    @property
    def shared_links(self) -> Float64[np.ndarray, " C"] | None:
        """Load of each candidate if sensors may share the link of a mount and exceed it together,
        else None."""
        return self.loads if self.candidates.several and self.scheme.sends_points else None

    def fits_links(self, members: Sequence[int], kbit: Float64[np.ndarray, "k frames"]) -> bool:
        """True if the links of a set carry the data of its sensors.

        kbit: data of each sensor in frames of any traffic.
        """
        if not self.scheme.sends_points:
            return True
        mounts = self.candidates.mount[list(members)]
        loads = np.bincount(
            mounts, sent_in_most(kbit, self.link_share), minlength=len(self.candidates.mounts)
        )
        capacity = np.array([mount.capacity for mount in self.candidates.mounts])
        return bool((loads <= max_load(capacity)).all())

    # prices

    def price(self, subsets: Sets) -> Float64[np.ndarray, " n"]:
        """Price of the sensors of each set and their mounts, each mount paid once."""
        built = np.zeros((len(subsets), len(self.candidates.mounts)), np.bool_)
        row, candidate = subsets.nonzero()
        built[row, self.candidates.mount[candidate]] = True
        models = np.bincount(row, self.candidates.model_prices[candidate], minlength=len(subsets))
        return np.asarray(built @ self.candidates.mount_prices + models)

    def affordable(self, prices: Float64[np.ndarray, " n"]) -> Mask:
        """Mask of prices within `most_price`, up to rounding."""
        return np.asarray(prices <= self.most_price * (1 + PRICE_ROUNDING_SHARE))

    @cached_property
    def _least_prices(self) -> Float64[np.ndarray, " M"]:
        """Lowest price of a mount plus one sensor; 0 for unusable mounts."""
        lowest = np.full(len(self.candidates.mounts), np.inf)
        np.minimum.at(
            lowest, self.candidates.mount[self.linked], self.candidates.prices[self.linked]
        )
        return np.where(np.isfinite(lowest), lowest, 0.0)

    # mounts that must carry a sensor

    @cached_property
    def kept(self) -> Int64[np.ndarray, " k"]:
        """Mounts that must carry a sensor."""
        return self.candidates.find_mounts(self.keep)

    def keeps(self, subsets: Sets) -> Mask:
        """Mask of sets with a sensor on every mount that must carry one."""
        if not len(self.kept):
            return np.ones(len(subsets), np.bool_)
        return np.asarray((self.candidates.per_mount(subsets)[:, self.kept] > 0).all(axis=1))

    # sets

    def feasible(self, subsets: Sets) -> Mask:
        """Mask of sets that may be built."""
        is_fitting = fit_together(self.candidates, subsets, self.shared_links) & self.keeps(subsets)
        return np.asarray(
            is_fitting
            & ~(subsets & ~self.linked).any(axis=1)
            & self.affordable(self.price(subsets))
        )

    def allowed(self, subset: Bool[np.ndarray, " C"] | Members) -> Bool[np.ndarray, " C"]:
        """Mask of candidates that may join a set: there is room on their mounts, and their price
        is affordable."""
        return self._fitting(subset, 0.0)

    def next_allowed(self, subset: Bool[np.ndarray, " C"] | Members) -> Bool[np.ndarray, " C"]:
        """Mask of candidates to add next.

        Until all mounts that must carry a sensor have one, these are candidates on such mounts that
        leave money for the others; then any that are allowed.
        """
        mount = self.candidates.mount
        empty_mounts = np.setdiff1d(self.kept, mount[self._to_row(subset)])
        if not len(empty_mounts):
            return self.allowed(subset)
        reserve = self._least_prices[empty_mounts].sum() - self._least_prices[mount]
        return self._fitting(subset, reserve) & np.isin(mount, empty_mounts)

    def _fitting(
        self, subset: Bool[np.ndarray, " C"] | Members, reserve: float | Float64[np.ndarray, " C"]
    ) -> Bool[np.ndarray, " C"]:
        """Mask of candidates that keep a set feasible and some money in reserve."""
        row = self._to_row(subset)
        price = self.price(row[None])[0] + extra_prices(self.candidates, row)
        has_room = room_beside(self.candidates, row[None], self.shared_links)[0]
        return np.asarray(has_room & self.linked & self.affordable(price + reserve))

    def _to_row(self, subset: Bool[np.ndarray, " C"] | Members) -> Bool[np.ndarray, " C"]:
        """Row of booleans for a set that may be one already."""
        if isinstance(subset, np.ndarray) and subset.dtype == np.bool_:
            return subset
        return self.row(subset)
