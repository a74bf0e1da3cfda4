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

PRICE_ROUNDING_SHARE = 1e-9  # share of a price by which rounding may exceed it
Members = Iterable[int | str] | Int64[np.ndarray, " k"]  # candidates of a set, by index or name


class FeasibleSets:
    """Sets of candidates that may be built. A subclass gives the `loads` of the candidates.

    Attributes:
        candidates: Sensors to choose from; a set is a row of booleans, one for each.
        scheme: Fusion scheme; links matter only if it sends points.
        most_price: Largest price of a set, in the unit of the candidates' prices; inf for any.
        keep: Names of mounts that must carry a sensor.
        link_share: Share of the frames (0 to 1) in which a link must carry all data.
    """

    candidates: Candidates
    scheme: Scheme
    most_price: float
    keep: tuple[str, ...]
    link_share: float

    @cached_property
    def loads(self) -> Float64[np.ndarray, " candidates"]:
        """Load (kbit per frame) of each candidate on the link of its mount."""
        raise NotImplementedError

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the candidates, in their order."""
        return tuple(sensor.name for sensor in self.candidates.sensors)

    def row(self, subset: Members) -> Bool[np.ndarray, " candidates"]:
        """Row with True for each candidate of a set.

        subset: indices or names. Raises ValueError for an unknown candidate."""
        row = np.zeros(len(self.candidates), np.bool_)
        for member in subset.tolist() if isinstance(subset, np.ndarray) else subset:
            row[find_index(member, self.names)] = True
        return row

    # links

    @cached_property
    def linked(self) -> Bool[np.ndarray, " candidates"]:
        """Mask of candidates whose load fits their mount's link; all if no points are sent."""
        if not self.scheme.sends_points:
            return np.ones(len(self.candidates), np.bool_)
        return np.asarray(self.loads <= max_load(self.candidates.capacity))

    @property
    def shared_links(self) -> Float64[np.ndarray, " candidates"] | None:
        """Load (kbit per frame) of each candidate, or None if loads need not be added up.

        They must be if a mount may carry several sensors, which share its link, and points are
        sent."""
        return (
            self.loads if self.candidates.has_shared_mounts and self.scheme.sends_points else None
        )

    def fits_links(self, members: Sequence[int], kbit: Float64[np.ndarray, "k frames"]) -> bool:
        """True if the links of a set carry the data of its sensors.

        members: indices of the set's candidates. kbit: data of each in each frame of any traffic,
        in the order of `members`.
        """
        if not self.scheme.sends_points:  # boxes fit any link
            return True
        sensor_mounts = self.candidates.mount[list(members)]
        sensor_loads = sent_in_most(kbit, self.link_share)
        mount_count = len(self.candidates.mounts)
        mount_loads = np.bincount(sensor_mounts, sensor_loads, minlength=mount_count)
        capacity = np.array([mount.capacity for mount in self.candidates.mounts])
        return bool((mount_loads <= max_load(capacity)).all())

    # prices

    def price(self, subsets: Sets) -> Float64[np.ndarray, " n"]:
        """Price of the sensors of each set and their mounts, each mount paid once."""
        # a pair for each member of each set; `nonzero` of the rows takes ten times as long
        _, candidate_count = subsets.shape
        flat_positions = np.flatnonzero(np.ascontiguousarray(subsets).ravel())
        row, candidate = np.divmod(flat_positions, candidate_count)
        is_mount_used = np.zeros((len(subsets), len(self.candidates.mounts)), np.bool_)
        is_mount_used[row, self.candidates.mount[candidate]] = True
        model_prices = self.candidates.model_prices[candidate]
        sensors_price = np.bincount(row, model_prices, minlength=len(subsets))
        return np.asarray(is_mount_used @ self.candidates.mount_prices + sensors_price)

    def affordable(self, prices: Float64[np.ndarray, " n"]) -> Mask:
        """Mask of prices that are within `most_price`, up to rounding."""
        return np.asarray(prices <= self.most_price * (1 + PRICE_ROUNDING_SHARE))

    @cached_property
    def _least_prices(self) -> Float64[np.ndarray, " mounts"]:
        """Lowest price of each mount with one sensor that fits its link.

        0 for mounts without such a sensor."""
        fits_link = self.linked
        lowest = np.full(len(self.candidates.mounts), np.inf)
        np.minimum.at(lowest, self.candidates.mount[fits_link], self.candidates.prices[fits_link])
        return np.where(np.isfinite(lowest), lowest, 0.0)

    # mounts that must carry a sensor

    @cached_property
    def kept(self) -> Int64[np.ndarray, " k"]:
        """Indices of the mounts that must carry a sensor."""
        return self.candidates.find_mounts(self.keep)

    def keeps(self, subsets: Sets) -> Mask:
        """Mask of sets with a sensor on every mount that must carry one."""
        if not len(self.kept):
            return np.ones(len(subsets), np.bool_)
        return np.asarray((self.candidates.per_mount(subsets)[:, self.kept] > 0).all(axis=1))

    # sets

    def feasible(self, subsets: Sets) -> Mask:
        """Mask of sets that may be built: room, links, price and required mounts all fit."""
        has_room = fit_together(self.candidates, subsets, self.shared_links)
        exceeds_link = (subsets & ~self.linked).any(axis=1)
        is_affordable = self.affordable(self.price(subsets))
        return np.asarray(has_room & self.keeps(subsets) & ~exceeds_link & is_affordable)

    def allowed(
        self, subset: Bool[np.ndarray, " candidates"] | Members
    ) -> Bool[np.ndarray, " candidates"]:
        """Mask of candidates that may join a set without making it unfeasible.

        There is room on their mounts and links, and the new price is affordable. subset: row of
        booleans, or indices or names of candidates."""
        return self._find_fitting(subset, reserve=0.0)

    def next_allowed(
        self, subset: Bool[np.ndarray, " candidates"] | Members
    ) -> Bool[np.ndarray, " candidates"]:
        """Mask of candidates to add next to a set.

        Until all mounts that must carry a sensor have one, these are candidates on such mounts that
        leave money for the others; then any that are allowed. subset: row of booleans, or indices
        or names of candidates.
        """
        mount = self.candidates.mount
        unfilled_mounts = np.setdiff1d(self.kept, mount[self._to_row(subset)])
        if not len(unfilled_mounts):
            return self.allowed(subset)
        # for each candidate: lowest price of the other mounts that still need a sensor
        reserve = self._least_prices[unfilled_mounts].sum() - self._least_prices[mount]
        return self._find_fitting(subset, reserve) & np.isin(mount, unfilled_mounts)

    def _find_fitting(
        self,
        subset: Bool[np.ndarray, " candidates"] | Members,
        reserve: float | Float64[np.ndarray, " candidates"],
    ) -> Bool[np.ndarray, " candidates"]:
        """Mask of candidates that may join a set and leave some money in reserve.

        subset: row of booleans, or indices or names of candidates; reserve: money that must remain
        below `most_price`, one amount or one for each candidate."""
        row = self._to_row(subset)
        (set_price,) = self.price(row[None])
        price = set_price + extra_prices(self.candidates, row)  # price of the set with each
        (has_room,) = room_beside(self.candidates, row[None], self.shared_links)
        return np.asarray(has_room & self.linked & self.affordable(price + reserve))

    def _to_row(
        self, subset: Bool[np.ndarray, " candidates"] | Members
    ) -> Bool[np.ndarray, " candidates"]:
        """Row of booleans for a set; a given row is returned itself, not copied."""
        if isinstance(subset, np.ndarray) and subset.dtype == np.bool_:
            return subset
        return self.row(subset)
