"""Stages of a plan check each other: figures of one set that exclude each other stop it."""

import numpy as np
import pytest

from placement_env.analysis.agreement import StageFigure, check_agreement
from placement_env.analysis.intervals import describe_sureness, is_comparable, share_beyond_reach
from toolkit.display import figure_digits


def test_a_broken_race_is_named_with_both_figures():
    race = StageFigure("in the race", 0.0, 412, 48)
    with pytest.raises(
        ValueError,
        match=r"set a, b: AP 0\.000 in the race .*, but AP 0\.820 in the judgement \(1079 to",
    ):
        check_agreement(("a", "b"), race, StageFigure("in the judgement", 0.82, 1079, 120))
    few = StageFigure("in the race", 0.0, 4, 8)
    # too few to exclude anything
    check_agreement(("a",), few, StageFigure("in the judgement", 0.82, 1079, 120))
    spread = race._replace(stage="by the prediction", ap=0.5, spread=0.1)
    check_agreement(("a",), spread, StageFigure("in the judgement", 0.82, 1079, 120))


def test_chance_alone_never_stops_a_plan():
    """Shares of objects that live four frames, at two stages."""
    rng = np.random.default_rng(0)
    for _ in range(2000):
        truth, counts = rng.uniform(0.02, 1.0), rng.integers(5, 300, 2)
        stages = [
            StageFigure("", rng.binomial(count, truth) / count, 4 * int(count), 40)
            for count in counts
        ]
        check_agreement((), *stages)


def test_nothing_is_better_than_one():
    draws = np.array([0.985, 0.992, 0.995, 1.0, np.nan])
    assert share_beyond_reach(draws) == 0.75
    assert share_beyond_reach(np.full(3, np.nan)) == 0.0
    assert [describe_sureness(sure) for sure in (0.19, 0.99, 0.991, 1.0)] == [
        "19%",
        "99%",
        "over 99%",
        "over 99%",
    ]
    assert is_comparable(20, 20)
    assert not is_comparable(19, 500)
    assert not is_comparable(500, 19)


@pytest.mark.parametrize(("objects", "digits"), [(0, 2), (6, 2), (99, 2), (100, 3), (5000, 3)])
def test_a_figure_has_as_many_decimals_as_its_objects_support(objects, digits):
    assert figure_digits(objects) == digits
