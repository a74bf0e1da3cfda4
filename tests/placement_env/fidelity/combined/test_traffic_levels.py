"""Levels of traffic: frames by how full they are, and the worst level or the mean of all."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.candidates.pool import paper_candidates
from placement_env.fidelity.combined.prepared import Counting
from placement_env.fidelity.combined.robust import Failing
from placement_env.fidelity.combined.traffic_levels import LevelFidelity, TrafficLevels
from placement_env.fidelity.coverage import Coverage
from placement_env.fidelity.preparation import Preparation
from placement_env.fidelity.traffic import scored
from placement_env.fidelity.visibility import of_frames
from placement_env.objective import Objective
from toolkit.detection.schemes import find_scheme

SETS = np.array([[0, 0, 0, 0], [1, 0, 0, 0], [1, 1, 0, 0], [1, 1, 1, 1]], bool)


@pytest.fixture(scope="module")
def made(small_traffic):
    preparation = Preparation(
        site=small_traffic.site, candidates=paper_candidates(small_traffic.site), frames=5, scheme=find_scheme("early")
    )
    vars(preparation)["traffic"] = small_traffic
    return preparation


@pytest.mark.parametrize(("count", "combine"), [(0, "worst"), (5, "worst"), (1.5, "mean"), (2, "median")])
def test_what_is_no_level_is_refused(count, combine):
    with pytest.raises((TypeError, ValueError), match=r"levels|beartype|jaxtyping|TrafficLevels"):
        TrafficLevels(count, combine)


def test_parts_are_ordered_by_how_full_frames_are():
    objects = np.array([4, 4, 0, 9, 7, 1, 2])
    parts = TrafficLevels(3).parts(objects)
    assert [part.tolist() for part in parts] == [[2, 5, 6], [0, 1], [3, 4]]
    assert [part.tolist() for part in TrafficLevels(4).parts(objects[:2])] == [[0], [1]]
    assert [part.tolist() for part in TrafficLevels().parts(objects)] == [[0, 1, 2, 3, 4, 5, 6]]


def test_levels_with_nothing_to_find_say_nothing():
    figures = np.array([[0.5, np.nan, np.nan], [0.9, 0.3, np.nan]])
    assert TrafficLevels(2).combined(figures)[:2].tolist() == [0.5, 0.3]
    assert TrafficLevels(2, "mean").combined(figures)[:2].tolist() == [0.7, 0.3]
    assert np.isnan(TrafficLevels(2).combined(figures)[2])


@pytest.mark.parametrize("combine", ["worst", "mean"])
def test_the_figure_is_that_of_each_level_alone(made, small_traffic, combine):
    counting = Counting.of(0.7, 0, TrafficLevels(2, combine))
    fidelity = counting.fidelity(made, "coverage")
    full = [int(scored(each.objects, small_traffic.site, range(5)).sum()) for each in small_traffic.snapshots]
    dense = sorted(np.argsort(full, kind="stable")[3:])
    thin = [frame for frame in range(5) if frame not in dense]
    each = np.array([Coverage(of_frames(made.visibility, np.array(part)))(SETS).ap for part in (thin, dense)])
    expected = each.min(axis=0) if combine == "worst" else each.mean(axis=0)
    found = fidelity(SETS)
    assert found.ap.tolist() == pytest.approx(expected.tolist())
    whole = made.fidelity("coverage")(SETS)
    assert found.kbit.tolist() == whole.kbit.tolist()
    assert found.ap.tolist() != whole.ap.tolist()
    assert isinstance(fidelity, LevelFidelity)
    assert fidelity.by_class(SETS).ap[:, 0].tolist() == pytest.approx(expected.tolist())


def test_beside_failures_and_thresholds(made):
    counting = Counting.of((0.5, 0.7), Failing(1), 2)
    assert not counting.plain
    assert not Counting.of(0.7, 0, 2).plain
    assert counting.origin["levels"] == {"count": 2, "combine": "worst"}
    assert "levels" not in Counting.of(0.7).origin
    found = counting.fidelity(made, "coverage")(SETS).ap
    intact = Counting.of((0.5, 0.7), 0, 2).fidelity(made, "coverage")(SETS).ap
    assert (found <= intact * (1 + 2e-6)).all()
    assert found[-1] < intact[-1]


def test_a_detector_is_not_searched_by_levels(made):
    with pytest.raises(ValueError, match="known to fidelity coverage and surrogate, got 'detector'"):
        Counting.of(0.7, 0, 2).check(made, "detector")
    with pytest.raises(ValueError, match="known to fidelity coverage and surrogate, got 'table'"):
        Objective("tjunction", fidelity="table", levels=2)
    Counting.of(0.7, 0, 2).check(replace(made, frames=3), "coverage")
