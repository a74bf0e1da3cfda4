"""`Terms`: on what terms sensors are placed: how many, for how much money, at what prices, over what links, and which
candidates have failed. All of it is known before anything is rendered.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.candidates.drawing import LEAST_PRICE, MOST_PRICE, with_mounts
from placement_env.candidates.places import added_prices, room_beside
from placement_env.checks import check_range
from placement_env.objective import AP_ONLY, ROUNDING, Weights
from toolkit.arrays import Bool, Float64

LEAST_LINK, MOST_LINK = 500.0, 8000.0  # kbit per frame of a link that is drawn
MOST_COMM, MOST_PAID = 1e-4, 0.03  # AP that a kbit, and a unit of price, count at most


@dataclass(frozen=True, eq=False)
class Terms:
    """budget: sensors to place; candidates: with what their mounts, links and models cost and carry; failed: those that
    may not be placed; weights: of kbit and price; most_price: that a set may cost."""

    budget: int
    candidates: Candidates
    failed: Bool[np.ndarray, " C"]
    weights: Weights = AP_ONLY
    most_price: float = math.inf

    @staticmethod
    def plain(
        candidates: Candidates, budget: int, *, weights: Weights = AP_ONLY, most_price: float = math.inf
    ) -> Terms:
        """Candidates as they are, none failed."""
        return Terms(budget, candidates, np.zeros(len(candidates), np.bool_), weights, most_price)

    def allowed(self, chosen: Sequence[int]) -> Bool[np.ndarray, " C"]:
        """Which candidates may join as far as is known without looking: not failed, on a mount with room for another
        sensor, for what is left of the money."""
        row = self.row(chosen)
        price = self.price(chosen) + added_prices(self.candidates, row)
        free = room_beside(self.candidates, row) & ~self.failed
        return np.asarray(free & (price <= self.most_price * (1 + ROUNDING)))

    def price(self, chosen: Sequence[int]) -> float:
        """What a set costs: its sensors, and each of its mounts once."""
        members = np.asarray(chosen, np.int64)
        count = np.bincount(self.candidates.mount[members], minlength=len(self.candidates.mounts))
        paid_again = np.maximum(count - 1, 0) @ self.candidates.mount_prices
        return float(self.candidates.prices[members].sum() - paid_again)

    def row(self, chosen: Sequence[int]) -> Bool[np.ndarray, " C"]:
        """A set as a row of booleans."""
        row = np.zeros(len(self.candidates), np.bool_)
        row[np.asarray(chosen, np.int64)] = True
        return row


def drawn_terms(
    candidates: Candidates,
    rng: np.random.Generator,
    *,
    budget: int | Sequence[int],
    failures: int | Sequence[int],
) -> Terms:
    """Terms of an episode. Budget and number of failed candidates are drawn where (lowest, highest) is given; prices of
    mounts and models, what links carry, what kbit and price count (nothing in half of the episodes, each) and, in half
    of them, how much money there is, are drawn always."""
    check_range("budget", budget, least=1, unit="sensor")
    check_range("failures", failures, least=0, unit="candidates")
    sensors, broken = (_within(number, rng) for number in (budget, failures))
    failed = np.zeros(len(candidates), np.bool_)
    failed[rng.permutation(len(candidates))[:broken]] = True
    prices = _drawn(rng, 0.5, 2.0, len(candidates.mounts)).round(2)
    links = _drawn(rng, LEAST_LINK, MOST_LINK, len(candidates.mounts)).round()
    models = _drawn(rng, LEAST_PRICE, MOST_PRICE, len(candidates.axes.models)).round(2)
    priced = with_mounts(candidates, prices.tolist(), links.tolist(), models.tolist())
    weights = Weights(*(float(most * max(0.0, rng.uniform(-1, 1))) for most in (MOST_COMM, MOST_PAID)))
    money = float(np.median(priced.prices)) * sensors * float(rng.uniform(0.7, 1.3)) if rng.random() < 0.5 else math.inf
    return Terms(sensors, priced, failed, weights, money)


def _within(number: int | Sequence[int], rng: np.random.Generator) -> int:
    low, high = (number, number) if isinstance(number, int | np.integer) else number
    return int(low) if low == high else int(rng.integers(low, high + 1))


def _drawn(rng: np.random.Generator, low: float, high: float, count: int) -> Float64[np.ndarray, " count"]:
    """Numbers whose logarithms are uniform."""
    return np.asarray(np.exp(rng.uniform(np.log(low), np.log(high), count)))
