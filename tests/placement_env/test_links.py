"""One rule for links: the load of a sensor, in searches, plans, live figures and environments."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.candidates.candidates import with_terms
from placement_env.handover.mounted import build_load, describe_narrow_links
from placement_env.links import check_link_share, describe_share, max_load, sent_in_most
from placement_env.objective import Objective
from placement_env.report.planning.choice import choose
from placement_env.search import greedy
from placement_env.setting import Setting
from toolkit.runtime.run import Run


@pytest.mark.parametrize("share", [0.05, 0.5, 0.951, 1.0])
def test_a_load_is_not_exceeded_in_the_share_of_frames_and_is_the_least_such(share):
    kbit = np.random.default_rng(0).exponential(100.0, (7, 41))
    for load, frames in zip(sent_in_most(kbit, share), kbit, strict=True):
        assert (frames <= load).mean() >= share
        assert (frames < load).mean() < share
        assert load in frames


@pytest.mark.parametrize("share", [0, -0.1, 1.5, float("nan")])
def test_a_share_of_frames_lies_between_0_and_1(share):
    with pytest.raises(ValueError, match="link_share must lie above 0 and up to 1, got"):
        Setting("tjunction", link_share=share)


@pytest.mark.parametrize("share", [1e-6, 0.5, 1.0])
def test_a_share_of_frames_may_be_all_of_them(share):
    check_link_share(share)


def test_a_sum_of_loads_that_is_the_capacity_but_for_rounding_fits():
    assert 0.1 + 0.2 > 0.3
    assert max_load(0.3) >= 0.1 + 0.2
    assert max_load(0.3) == pytest.approx(0.3, rel=1e-8)
    np.testing.assert_array_less([0.3, 1e-6, 1e6], max_load(np.array([0.3, 1e-6, 1e6])))


def test_sensors_whose_mean_fits_and_whose_load_does_not_are_in_no_answer():
    run = Run(frames=16, seed=4)
    whole = Objective(Setting("tjunction"), run)
    assert (whole.loads > whole.sent).all()
    between = float((whole.loads + whole.sent)[0] / 2)
    limited = with_terms(whole.candidates, 1.0, between)
    objective = Objective(Setting("tjunction", candidates=limited), run)
    np.testing.assert_array_equal(objective.linked, objective.loads <= between)
    assert objective.sent[0] <= between
    assert not objective.linked[0]
    assert 0 not in greedy.search(objective, 6).best.subset
    lenient = Objective(Setting("tjunction", candidates=limited, link_share=0.05), run)
    assert lenient.linked[0]


def test_narrow_links_are_named_with_what_they_need():
    loads = [
        build_load("L1", 9.0, 30.0, 21.01, 20.0, limited=True),
        build_load("L2", 1, 2, 2, 20, limited=True),
    ]
    assert [load.fits for load in loads] == [False, True]
    assert loads[0].share == pytest.approx(1.0505)
    text = describe_narrow_links(loads)
    assert text.startswith(
        "The link is too narrow for 95 % of the frames: L1 needs 21.01 of 20.00 Mbit/s; "
    )
    assert "links of 2101 kbit per frame (--capacity)" in text
    assert describe_narrow_links(loads[1:]) == ""
    assert build_load("L1", 9.0, 30.0, 21.01, 20.0, limited=False).fits
    assert describe_share(1.0) == "every frame"


def test_the_links_of_an_answer_are_those_of_the_frames_that_judge_it(make):
    objective = make(capacity=1000.0)
    capacity = 1000.0
    kbit = np.full((1, 21), 0.5 * capacity)
    assert objective.fits_links((0,), kbit)
    kbit[0, :2] = 1.1 * capacity
    assert not objective.fits_links((0,), kbit)
    assert objective.fits_links((0,), kbit[:, 1:])


def test_a_set_that_no_link_carries_is_chosen_only_where_there_is_no_other():
    from placement_env.report.content import Judgement, PlanOption

    judged = Judgement(0.9, 0.8, 1.0, 0.9, 0.9, 100, 80)
    best = PlanOption(("a",), 1.0, 1.0, 1.0, 0.9, judged, mean_ap=0.9, fits_links=False)
    other = replace(best, sensors=("b",), judged=replace(judged, ap=0.5))
    draws = {0: np.full(100, 0.9), 1: np.full(100, 0.5)}
    assert choose([best, other], draws)[0] == 0
    assert choose([best, replace(other, fits_links=True)], draws)[0] == 1
