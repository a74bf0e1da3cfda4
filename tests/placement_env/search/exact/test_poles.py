"""Places, links and prices of poles in whole units; the programmes that keep to them are in test_places."""

import numpy as np

from placement_env.search.exact.programme import LINK, Poles, Prices

PRICES = Prices(np.array([5, 7, 20]), np.array([10, 10, 0]), np.array([0, 0, 1]), 40)
POLES = Poles(np.array([0, 0, 0, 1]), np.array([2, 2, 2, 1]), np.array([LINK // 2, LINK // 2, LINK // 2 + 1, 0]))


def test_shared_poles_are_paid_once(make):
    assert PRICES.total([0, 1, 2]) == 42
    assert PRICES.total([1]) == 17
    assert PRICES.total([]) == 0
    some = PRICES.select(np.array([1, 2]))
    assert (some.total([0]), some.most, some.total([0, 1])) == (17, 40, 37)
    objective = make(3, 2)
    assert Prices.of(objective) is None
    price = objective.candidates.prices
    exact = objective.weighed(objective.weights, most_price=float(price[0] + price[2]))
    prices = Prices.of(exact)
    assert prices is not None
    assert prices.total([0, 2]) <= prices.most < prices.total([0, 2]) + 2**20
    assert prices.shared.tolist() == [0] * 6


def test_places_of_a_pole_are_apart_for_bounds():
    assert POLES.apart.tolist() == [2, 3, 4, 1]
