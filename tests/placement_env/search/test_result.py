import numpy as np
import pytest

from placement_env.search.exact import exhaustive
from placement_env.search.result import Certificate, History

HISTORY = History(np.array([1, 5, 9]), np.array([0.1, 0.5, 0.9]), np.array([0.2, 0.6, 0.6]))


@pytest.mark.parametrize(
    ("limits", "reward"),
    [
        ({}, 0.6),
        ({"evaluations": 0.0}, 0.0),
        ({"evaluations": 4.0}, 0.2),
        ({"seconds": 0.5}, 0.6),
        ({"seconds": 0.4}, 0.2),
    ],
)
def test_history_knows_the_best_at_any_time(limits, reward):
    assert HISTORY.at(**limits) == reward


@pytest.mark.parametrize(("bound", "gap"), [(np.inf, np.inf), (0.75, 0.25), (0.5, 0.0), (0.4, 0.0)])
def test_the_gap_is_what_the_optimum_may_be_better(bound, gap):
    assert Certificate("bound", 0.5, bound).gap == gap


def test_a_result_reads_as_one_line(make):
    said = str(exhaustive.search(make(3, 1), 2))
    assert said.startswith("exhaustive: {")
    assert "after 6 sets" in said
    assert "optimal, at most" in said
