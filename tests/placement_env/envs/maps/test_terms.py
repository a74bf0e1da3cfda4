import math
from dataclasses import replace

import numpy as np
import pytest

from placement_env.candidates.pool import pool
from placement_env.envs.maps.terms import LEAST_LINK, MOST_COMM, MOST_LINK, MOST_PAID, Terms, drawn_terms
from toolkit.sites.site import Mount, Site

SITE = Site("plain", np.array([-20.0, -20.0, 20.0, 20.0]))
MOUNTS = [Mount(f"m{k}", np.array([10.0 * k - 20, 0.0, 0.0]), price=k + 1.0) for k in range(4)]
SOME = pool(SITE, heights=(5.0,), headings=2, tilts=(0.3,), mounts=MOUNTS, blind=True)


def test_plain_terms_ask_for_nothing():
    terms = Terms.plain(SOME, 3)
    assert (terms.budget, terms.most_price, terms.weights.comm, terms.weights.price) == (3, math.inf, 0, 0)
    assert terms.allowed([]).all()


def test_who_may_join():
    failed = np.zeros(8, np.bool_)
    failed[1] = True
    terms = Terms(2, SOME, failed, most_price=5.0)
    assert terms.allowed([]).tolist() == [True, False, True, True, True, True, True, True]
    assert terms.allowed([2]).tolist() == [True, False, False, False, True, True, False, False]  # 3 left
    assert not terms.allowed([7]).tolist()[2]
    assert Terms(2, SOME, failed, most_price=3 + 1e-12).allowed([2]).tolist()[:2] == [True, False]


def test_a_mount_carries_several_and_is_paid_once():
    mounts = tuple(replace(mount, max_sensors=n) for mount, n in zip(SOME.mounts, (2, 1, 2, 1), strict=True))
    some = replace(SOME, mounts=mounts, axes=replace(SOME.axes, prices=(0.5,)))  # mounts cost 1, 2, 3, 4
    terms = Terms.plain(some, 9, most_price=5.0)
    assert terms.price([]) == 0
    assert terms.price([0, 1]) == 2.0
    assert terms.price([0, 1, 4]) == 5.5
    assert terms.allowed([0]).tolist() == [False, True, True, True, True, True, False, False]  # 3.5 left
    assert terms.allowed([0, 1]).tolist() == [False, False, True, True, False, False, False, False]  # 3 left
    assert terms.allowed([2]).tolist() == [True, True, False, False, False, False, False, False]  # 2.5 left
    assert terms.row([0, 5]).tolist() == [True, False, False, False, False, True, False, False]
    exact = Terms.plain(some, 9, most_price=2.0)
    assert exact.allowed([0])[1]
    assert not Terms.plain(some, 9, most_price=2.0 - 1e-6).allowed([0])[1]
    assert Terms.plain(some, 9, most_price=2.0 - 1e-10).allowed([0])[1]  # rounding


def test_terms_are_drawn_within_bounds():
    drawn = [drawn_terms(SOME, np.random.default_rng(k), budget=(2, 5), failures=(0, 3)) for k in range(80)]
    assert {terms.budget for terms in drawn} == {2, 3, 4, 5}
    assert {int(terms.failed.sum()) for terms in drawn} == {0, 1, 2, 3}
    links = np.concatenate([terms.candidates.capacity for terms in drawn])
    assert LEAST_LINK <= links.min() < 800 < 5000 < links.max() <= MOST_LINK
    for most, weights in ((MOST_COMM, "comm"), (MOST_PAID, "price")):
        values = np.array([getattr(terms.weights, weights) for terms in drawn])
        assert 20 < (values == 0).sum() < 60
        assert most / 2 < values.max() <= most
    limited = [terms for terms in drawn if np.isfinite(terms.most_price)]
    assert 20 < len(limited) < 60
    for terms in limited:
        dearest = float(np.median(terms.candidates.prices)) * terms.budget
        assert 0.7 * dearest <= terms.most_price <= 1.3 * dearest
    assert all(terms.candidates.sensors == SOME.sensors for terms in drawn)


def test_the_same_generator_draws_the_same():
    one, two = (drawn_terms(SOME, np.random.default_rng(5), budget=3, failures=1) for _ in range(2))
    assert one.candidates.prices.tolist() == two.candidates.prices.tolist()
    assert (one.budget, one.weights, one.most_price) == (two.budget, two.weights, two.most_price)
    assert one.failed.tolist() == two.failed.tolist()


@pytest.mark.parametrize("wrong", [{"budget": 0}, {"budget": (3, 2)}, {"failures": -1}])
def test_wrong_ranges(wrong):
    with pytest.raises(ValueError, match="must be at least"):
        drawn_terms(SOME, np.random.default_rng(0), **({"budget": 2, "failures": 0} | wrong))
