import numpy as np
import pytest

from toolkit.traffic.supply import Supply

ROWS = np.array([2, 5, 7])


def test_any_row_may_come_again_unless_each_is_to_come_once():
    supply, rng = Supply(8), np.random.default_rng(0)
    taken = [supply.offer(ROWS, rng) for _ in range(30)]
    assert set(taken) == set(ROWS.tolist())
    assert np.array_equal(supply.several(ROWS, 4, np.random.default_rng(3)), np.random.default_rng(3).choice(ROWS, 4))


def test_each_row_comes_once_before_any_comes_again():
    supply, rng = Supply(8, once=True), np.random.default_rng(0)
    for _ in range(3):
        assert sorted(supply.several(ROWS, 3, rng).tolist()) == ROWS.tolist()


def test_what_is_offered_and_not_taken_or_given_back_may_come_again():
    supply, rng = Supply(8, once=True), np.random.default_rng(1)
    assert {supply.offer(ROWS, rng) for _ in range(30)} == set(ROWS.tolist())
    for row in (2, 5):
        supply.take(row)
    assert {supply.offer(ROWS, rng) for _ in range(10)} == {7}
    supply.take(7)
    supply.give_back(5)
    assert {supply.offer(ROWS, rng) for _ in range(10)} == {5}


@pytest.mark.parametrize("once", [False, True])
def test_a_seed_gives_an_order(once):
    first, again = (Supply(8, once).several(ROWS, 9, np.random.default_rng(4)).tolist() for _ in range(2))
    assert first == again
