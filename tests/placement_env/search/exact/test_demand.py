"""What the cheapest set must do, in the worst of failures and shares of the traffic."""

import numpy as np
import pytest

from placement_env.fidelity.visibility import Visibility
from placement_env.protocol import Estimate
from placement_env.search.exact.cheapest import Demand, DemandFidelity


class Sees:
    """The share of three objects that a set sees, by who sees which."""

    name = "surrogate"

    def __init__(self, *rows):
        self.seen = np.array(rows, bool)

    def __call__(self, subsets):
        share = (subsets.astype(int) @ self.seen.astype(int) > 0).mean(axis=1)
        return Estimate(share, share, subsets.sum(axis=1) * 10.0)


BY = (Sees([1, 1, 1], [1, 1, 0]), Sees([1, 0, 0], [0, 1, 1]))
SETS = np.array([[1, 1], [1, 0], [0, 1], [0, 0]], bool)


def test_the_least_over_shares_and_failures_breaks_ties_and_is_in_words():
    third = pytest.approx([1.0, 1 / 3, 2 / 3, 0.0])
    assert Demand(0.9).find_lowest_ap(BY, SETS) == third
    assert Demand(0.9, 1).find_lowest_ap(BY[:1], SETS) == pytest.approx([2 / 3, 0.0, 0.0, 0.0])
    assert Demand(0.9, 1).find_lowest_ap(BY, SETS) == pytest.approx([1 / 3, 0.0, 0.0, 0.0])
    assert Demand(0.9, 1).find_lowest_ap(BY, SETS[:0]).shape == (0,)
    found = DemandFidelity(BY[0], BY, Demand(0.9, 1))(SETS)
    assert found.ap == pytest.approx([1 / 3 + 1e-6, 1e-6, 2e-6 / 3, 0.0], abs=1e-12)
    assert found.recall == pytest.approx([1.0, 1.0, 2 / 3, 0.0])
    assert found.kbit.tolist() == [20.0, 10.0, 10.0, 0.0]
    assert Demand(0.9).describe(1) == ""
    assert (
        Demand(0.9, 1, parts=4).describe(3)
        == " in each of 3 parts of the traffic, whichever sensor fails"
    )


@pytest.fixture
def seen():
    """Six frames with 1, 0, 3, 0, 2 and 2 objects."""
    frame = np.repeat(np.arange(6), [1, 0, 3, 0, 2, 2])
    zeros, sent = np.zeros((1, 8), np.float32), np.zeros((1, 6), np.float32)
    return Visibility(zeros, zeros, frame, np.zeros((8, 7)), sent, sent)


def test_shares_of_the_traffic(seen, make):
    objective = make(3)  # of parts, so without traffic of its own

    def shares(**asked):
        return [frames.tolist() for frames in Demand(0.9, **asked).shares(objective, seen)]

    assert shares() == [[0, 1, 2, 3, 4, 5]]
    assert shares(parts=2) == [[0, 1, 2], [3, 4, 5]]
    assert shares(parts=6) == [[0], [2], [4], [5]]  # those with something to find
    assert shares(levels=3) == [
        [0, 4],
        [2, 5],
    ]  # by 0, 0, 1, 2, 2, 3 objects; the thinnest level is empty
    assert shares(levels=2) == [[0, 1, 3], [2, 4, 5]]


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"at_least": 90.0}, "must lie above 0 and up to 1, got 90.0: 0.9 is 0.9"),
        ({"failing": 2}, "0 or 1 sensor may fail here, got failing=2"),
        ({"parts": 0}, "parts must be a whole number of at least 1"),
        *(
            ({"levels": 5}, "traffic has 1 to 4 levels, got 5"),
            ({"parts": 2, "levels": 2}, "leave one of them out"),
        ),
    ],
)
def test_what_does_not_fit_is_refused(asked, message):
    with pytest.raises(ValueError, match=message):
        Demand(**asked)
