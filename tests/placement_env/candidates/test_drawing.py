import numpy as np
import pytest

from placement_env.candidates.drawing import (
    LEAST_PRICE,
    MODELS,
    MOST_PRICE,
    drawn_models,
    drawn_pool,
    one_heading_all_round,
    with_mounts,
)
from placement_env.candidates.pool import pool
from toolkit.sites.site import Mount, Site

SITE = Site(
    "plain",
    np.array([-20.0, -20.0, 20.0, 20.0]),
    mounts=tuple(Mount(f"m{k}", np.array([10.0 * k - 20, 21.0, 0.0])) for k in range(5)),
)


def test_places_and_poses_are_drawn_from_the_pool():
    drawn, every = drawn_pool(SITE, np.random.default_rng(3), places=3, poses=7), pool(SITE)
    names = [sensor.name for sensor in every.sensors]
    assert len(drawn) == 21
    assert {sensor.name for sensor in drawn.sensors} < set(names)
    for mount in np.unique(drawn.mount):
        assert len(np.unique(drawn.factors[drawn.mount == mount, 1])) == 1
    again = drawn_pool(SITE, np.random.default_rng(3), places=3, poses=7)
    other = drawn_pool(SITE, np.random.default_rng(4), places=3, poses=7)
    assert again.digest() == drawn.digest() != other.digest()


def test_all_where_there_are_fewer():
    drawn = drawn_pool(SITE, np.random.default_rng(0), places=50, poses=500)
    assert len(np.unique(drawn.mount)) == 5
    assert len(drawn) == sum(len(np.unique(drawn.mount)) and (drawn.mount == m).sum() for m in range(5))


def test_a_lidar_that_sees_all_round_is_headed_one_way():
    every = pool(SITE, models=MODELS[:2])
    kept = one_heading_all_round(every)
    lidar = every.factors[:, 4] == 1
    assert kept[~lidar].all()
    rest = every.factors[lidar & kept]
    assert len(np.unique(rest[:, [0, 1, 3]], axis=0)) == len(rest)
    assert len(rest) == len(np.unique(every.factors[lidar][:, [0, 1, 3]], axis=0))


def test_models_are_drawn_with_prices():
    drawn = [drawn_models(np.random.default_rng(seed)) for seed in range(60)]
    assert {len(models) for models, _ in drawn} == {1, 2}
    assert 20 < sum(models == MODELS[:1] for models, _ in drawn) < 50
    assert all(set(models) <= set(MODELS) for models, _ in drawn)
    prices = [price for _, each in drawn for price in each]
    assert LEAST_PRICE <= min(prices) < 1 < 3 < max(prices) <= MOST_PRICE
    assert all(len(models) == len(each) for models, each in drawn)


def test_mounts_and_models_may_cost_something_else():
    drawn = drawn_pool(SITE, np.random.default_rng(0), places=5, poses=2)
    priced = with_mounts(drawn, [1.0, 2.0, 3.0, 4.0, 5.0], [10.0, 20.0, 30.0, 40.0, 50.0], [0.5])
    assert priced.prices.tolist() == [m + 1.5 for m in drawn.mount]
    assert priced.capacity.tolist() == [10.0 * (m + 1) for m in drawn.mount]
    assert priced.sensors == drawn.sensors


@pytest.mark.parametrize("wrong", [{"places": 0}, {"poses": 0}, {"places": -3}])
def test_wrong_numbers(wrong):
    with pytest.raises(ValueError, match="must be a whole number of at least 1"):
        drawn_pool(SITE, np.random.default_rng(0), **wrong)
