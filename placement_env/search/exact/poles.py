"""Shared constraints of sensors on poles: places, links, and the price of the pole, for integer programmes.

    Σ_{c on m} x_c <= places_m,   Σ_{c on m} load_c x_c <= 1 link
    Σ_c price_c x_c + Σ_m shared_m z_m <= money,   z_m >= x_c

Where every pole has one place, that is at most one sensor on each, and its price is part of the sensor's.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from placement_env.objective import ROUNDING, Objective
from placement_env.search.exact.solver import cp_model
from toolkit.arrays import Int64

if TYPE_CHECKING:
    from ortools.sat.python.cp_model import CpModel, IntVar, LinearExpr

FINEST = 1 << 40  # whole units of the highest price
LINK = 1 << 40  # whole units of a link


class Prices(NamedTuple):
    """Prices in exact whole units, rounded down; the limit is rounded up, so no set within the money is excluded.

    each: of the candidates, with their mounts where these have one place; shared: of a mount with more places, which is
    paid once; mount: of each candidate; most: limit on the total; unit: price of one.
    """

    each: Int64[np.ndarray, " C"]
    shared: Int64[np.ndarray, " C"]
    mount: Int64[np.ndarray, " C"]
    most: int
    unit: float = 1.0

    @staticmethod
    def in_units(objective: Objective, unit: float) -> Prices:
        """Prices of an objective's candidates, in units of a price."""
        candidates = objective.candidates
        several = candidates.places[candidates.mount] > 1
        each = np.where(several, candidates.model_prices, candidates.prices)
        shared = np.where(several, candidates.mount_prices[candidates.mount], 0.0)
        money = objective.most_price * (1 + ROUNDING) / unit
        most = -1 if math.isinf(money) else math.floor(money)
        return Prices(_whole(each, unit), _whole(shared, unit), candidates.mount, most, unit)

    @staticmethod
    def of(objective: Objective) -> Prices | None:
        """Prices of an objective whose sets have a most price."""
        if math.isinf(objective.most_price):
            return None
        highest = float(objective.candidates.prices.max(initial=0.0))
        return Prices.in_units(objective, max(highest, objective.most_price, 1e-300) / FINEST)

    def select(self, kept: Int64[np.ndarray, " k"]) -> Prices:
        """Prices of some candidates."""
        return self._replace(each=self.each[kept], shared=self.shared[kept], mount=self.mount[kept])

    def total(self, chosen: list[int]) -> int:
        """Price of a set."""
        _, first = np.unique(self.mount[chosen], return_index=True)
        return int(self.each[chosen].sum() + self.shared[chosen][first].sum())

    def expression(self, model: CpModel, built: list[IntVar], *, times: int = 1, plus: int = 0) -> LinearExpr:
        """Price of the built sensors, multiplied by `times`. `plus` is added for each sensor."""
        linear = cp_model().LinearExpr
        parts = [linear.weighted_sum(built, (self.each * times + plus).tolist())]
        for here in np.unique(self.mount[self.shared > 0]):
            own = np.flatnonzero(self.mount == here).tolist()
            paid = model.new_bool_var("")
            for c in own:
                model.add_implication(built[c], paid)
            parts.append(int(self.shared[own[0]]) * times * paid)
        return linear.sum(parts)


class Poles(NamedTuple):
    """Places and links of the mounts. load: of the link by each candidate, in parts of `LINK`."""

    mount: Int64[np.ndarray, " C"]
    places: Int64[np.ndarray, " C"]
    load: Int64[np.ndarray, " C"]

    @staticmethod
    def of(objective: Objective) -> Poles:
        """Poles of an objective's candidates."""
        candidates, sent = objective.candidates, objective.shared_links
        load = np.zeros(len(candidates)) if sent is None else np.minimum(sent / candidates.capacity, 2.0)
        return Poles(candidates.mount, candidates.places[candidates.mount], _whole(load, 1 / LINK))

    @staticmethod
    def single(mount: Int64[np.ndarray, " C"]) -> Poles:
        """Poles of mounts that have one place each."""
        return Poles(mount, np.ones_like(mount), np.zeros_like(mount))

    @property
    def apart(self) -> Int64[np.ndarray, " C"]:
        """Mount of each candidate, for bounds: one of its own where its mount has several places.

        A bound that holds with one place on each of these holds for every set.
        """
        count = int(self.mount.max(initial=-1)) + 1
        return np.where(self.places > 1, count + np.arange(len(self.mount)), self.mount)

    def select(self, kept: Int64[np.ndarray, " k"]) -> Poles:
        """Poles of some candidates."""
        return Poles(*(column[kept] for column in self))

    def constrain(self, model: CpModel, built: list[IntVar]) -> None:
        """Add the constraints of places and links."""
        linear = cp_model().LinearExpr
        for here in np.unique(self.mount):
            own = np.flatnonzero(self.mount == here).tolist()
            variables = [built[c] for c in own]
            places = int(self.places[own[0]])
            if places == 1:
                model.add_at_most_one(variables)
                continue
            model.add(linear.sum(variables) <= places)
            if self.load[own].any():
                model.add(linear.weighted_sum(variables, self.load[own].tolist()) <= LINK)


def _whole(figures: np.ndarray, unit: float) -> Int64[np.ndarray, " C"]:
    return np.floor(figures / unit).astype(np.int64)
