"""Which of the judged sets is the answer, and which stand beside it."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.cases import Cases
from placement_env.fidelity.detector import Detected
from placement_env.report.content import Judgement, PlanOption
from placement_env.report.planning import choosing, size_races
from placement_env.report.planning.choice import choose, find_front_options
from placement_env.report.planning.choosing import choose_set
from placement_env.report.planning.judging import Judge
from placement_env.search.portfolio.entrants import Entrants
from toolkit.runtime.run import Run


def option(ap, low, high, *, price=1.0, sensors=1, kbit=100.0, judged=True, mean_ap=None):
    names = tuple(f"s{i}" for i in range(sensors))
    said = Judgement(ap, low, high, ap, 1.0, 100, 120)
    return PlanOption(names, price, kbit, kbit * sensors, ap, said if judged else None, (), mean_ap)


def draws_of(options, spread=0.0, own=0.0):
    """Resamples of judged options: noise that all share, and noise of their own."""
    rng = np.random.default_rng(0)
    common = rng.normal(0.0, spread, 500)
    return {
        i: o.counted.ap + common + rng.normal(0.0, own, 500)
        for i, o in enumerate(options)
        if o.counted
    }


def test_of_those_within_the_tolerance_the_greatest_mean_ap_is_best():
    options = (
        *(option(0.95, 0.9, 1.0, mean_ap=0.7), option(0.945, 0.9, 1.0, price=2.0, mean_ap=0.8)),
        *(option(0.93, 0.9, 1.0, mean_ap=0.9), option(0.99, 0.9, 1.0, judged=False, mean_ap=0.99)),
    )
    assert choose(options, draws_of(options, own=0.02)) == (1, (1,))
    equal = (
        option(0.95, 0.9, 1.0, price=3.0, mean_ap=0.8),
        option(0.95, 0.9, 1.0, price=2.0, mean_ap=0.8),
    )
    assert choose(equal, draws_of(equal, own=0.02)) == (1, (1,))


def test_the_cheapest_set_that_cannot_be_told_from_the_best_is_recommended():
    """Whether sets can be told apart is a matter of the paired loss, not of their own wide
    intervals."""
    options = (
        *(
            option(0.995, 0.9, 1.0, price=4.0, mean_ap=0.9),
            option(0.994, 0.9, 1.0, price=3.0, mean_ap=0.85),
        ),
        *(
            option(0.992, 0.9, 1.0, price=2.0, mean_ap=0.8),
            option(0.873, 0.7, 1.0, price=1.0, mean_ap=0.7),
        ),
    )
    assert choose(options, draws_of(options, spread=0.1)) == (0, (2, 1, 0))
    assert choose(options, draws_of(options, spread=0.1, own=0.05)) == (0, (0,))
    few = tuple(replace(o, judged=replace(o.judged, frames=20)) for o in options)
    assert choose(few, draws_of(few, spread=0.1)) == (0, (0,))  # no interval from so few blocks


def test_the_front_holds_sets_that_no_other_beats():
    best, cheap, lean, beaten = (
        *(option(0.9, 0.8, 1.0, price=3.0), option(0.8, 0.7, 0.9, price=1.0)),
        *(
            option(0.7, 0.6, 0.8, price=2.0, kbit=10.0),
            option(0.7, 0.6, 0.8, price=2.0, kbit=150.0),
        ),
    )
    assert find_front_options((best, beaten, lean, cheap, option(1.0, 1.0, 1.0, judged=False))) == (
        cheap,
        lean,
        best,
    )


@pytest.fixture
def six(street):
    """Six sets of one to three sensors that the searches found."""
    sets = np.array(
        [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [1, 1, 0, 0], [1, 1, 1, 0]], bool
    )
    searches = (("greedy",), (), (), (), (), ())
    return Entrants(sets, street.objective.scores(sets).ap, searches, 77)


def test_sets_of_each_size_race_and_the_best_are_judged(street, six):
    stages = []
    run = Run(progress=lambda *stage: stages.append(stage))
    picked = choose_set(street.objective, six, street.judge, run=run)
    assert (picked.chosen, picked.rule) == (5, "best")
    assert [stage for stage in stages if stage[0] == "set sizes compared"] == [
        *(("set sizes compared", done, 3) for done in (1, 2, 3))
    ]
    judged = [o.judged and o.judged.ap for o in picked.options]
    # one of two equal ones; others come nowhere near the best
    assert judged[:4] == [0.5, None, None, None]
    assert judged[4:] == pytest.approx([0.75, 0.8])


def test_options_have_price_sensors_poles_and_searches(street, six):
    picked = choose_set(street.objective, six, street.judge)
    assert picked.options[5].price == 32.5
    assert picked.options[5].sensors == ("post0_eye", "post1_eye", "post2_eye")
    assert picked.options[0].searches == ("greedy",)
    assert [picked.options[i].poles for i in (3, 5)] == [("post3",), ("post0", "post1", "post2")]
    aps = street.judge.detected.estimates(six.sets[[4, 5]])
    means = np.mean([estimate.ap for estimate in aps.values()], 0)
    assert [o.mean_ap for o in picked.options[4:6]] == pytest.approx(means)
    assert picked.options[2].mean_ap is None


def test_predictions_are_those_of_the_searches(street, six):
    for predicted in (six.predicted, six.predicted / 2):  # not scored again
        found = replace(six, predicted=predicted)
        picked = choose_set(street.objective, found, street.judge)
        assert [o.predicted for o in picked.options] == predicted.round(6).tolist()


def test_the_cheapest_that_reaches_the_ap_is_chosen_or_none(street, six):
    cheap = choose_set(street.objective, six, street.judge, min_ap=0.75)
    assert (cheap.chosen, cheap.rule, cheap.confidence) == (4, "cheapest", None)
    assert [o.judged is not None for o in cheap.options] == [False] * 4 + [True, False]
    dear = choose_set(street.objective, six, street.judge, min_ap=0.9)
    assert (dear.chosen, dear.rule) == (5, "none")


def test_a_first_look_counts_the_blocks_that_its_frames_are_in(street, six, spy):
    calls = spy(choosing, "shrink")
    choose_set(street.objective, six, street.judge, min_ap=0.75)
    assert [call.args[3] for call in calls] == [2]  # blocks of eight frames


def test_a_set_that_links_do_not_carry_on_the_judging_frames_is_not_chosen(street, monkeypatch):
    sets = np.array([[1, 0, 0, 0], [1, 1, 0, 0], [1, 1, 1, 0]], bool)
    found = Entrants(sets, street.objective.scores(sets).ap, (("greedy",), (), ()), 77)

    def fits_links(objective, members, kbit):
        np.testing.assert_array_equal(kbit, street.judge.kbit(members))
        return 2 not in members

    monkeypatch.setattr(type(street.objective), "fits_links", fits_links)
    picked = choose_set(street.objective, found, street.judge)
    assert picked.chosen == 1
    assert [option.fits_links for option in picked.options] == [True, True, False]


def test_sets_are_compared_by_failures_and_levels(street):
    frail = replace(option(0.95, 0.9, 1.0, price=1.0), left=option(0.2, 0.1, 0.3).judged)
    tough = replace(option(0.9, 0.8, 1.0, price=2.0), left=option(0.7, 0.6, 0.8).judged)
    assert choose((frail, tough), draws_of((frail, tough)))[0] == 1
    assert find_front_options((frail, tough)) == (frail, tough)
    judge = Judge((street.detected,), Cases(failing=1))
    sets = np.array([[1, 1, 0, 0], [1, 1, 0, 1]], bool)
    picked = choose_set(street.objective, Entrants(sets, np.zeros(2), ((), ()), 2), judge)
    assert [(o.judged.ap, o.left.ap) for o in picked.options] == [(0.75, 0.5), (0.75, 0.5)]
    even = replace(option(0.8, 0.7, 0.9, price=2.0), over_levels=option(0.75, 0.7, 0.8).judged)
    uneven = replace(option(0.95, 0.9, 1.0, price=1.0), over_levels=option(0.2, 0.1, 0.3).judged)
    assert choose((uneven, even), draws_of((uneven, even)))[0] == 1
    assert replace(even, left=option(0.1, 0.0, 0.2).judged).counted.ap == 0.1
    judge = Judge((street.detected,), Cases(levels=2), levels=(np.arange(4), np.arange(4, 8)))
    picked = choose_set(
        street.objective, Entrants(np.array([[1, 1, 0, 0]], bool), np.zeros(1), ((),), 1), judge
    )
    (only,) = picked.options
    assert (only.judged.vehicles, only.over_levels.vehicles, only.over_levels.ap, only.left) == (
        32,
        16,
        0.75,
        None,
    )


def test_sets_are_compared_over_error_profiles(street, limits):
    """Exact, 0 finds with 1 as many cars as 3 does, for less money; where 0 is blinded, fewer."""
    steady = replace(
        option(0.8, 0.7, 0.9),
        left=option(0.7, 0.6, 0.8).judged,
        over_errors=option(0.6, 0.5, 0.7).judged,
    )
    touchy = replace(option(0.95, 0.9, 1.0), over_levels=option(0.9, 0.8, 1.0).judged)
    touchy = replace(touchy, over_errors=option(0.2, 0.1, 0.3).judged)
    assert choose((touchy, steady), draws_of((touchy, steady)))[0] == 1
    assert steady.counted.ap == 0.6

    class Blinded(type(street.detected.renders)):  # type: ignore[misc]
        def clouds(self, k, c):
            return super().clouds(k, c)[: 0 if c == 0 else None]

    rough = Detected(
        Blinded(street.site, street.detected.renders.sensors), street.detected.detector, "early"
    )
    judge = Judge((street.detected, rough), Cases(errors=("paper", "poor")))
    found = Entrants(np.array([[1, 1, 0, 0], [0, 1, 0, 1]], bool), np.zeros(2), ((), ()), 2)
    limits(size_races, NEAR_AP=1.0)
    picked, alone = (
        choose_set(street.objective, found, judge),
        choose_set(street.objective, found, street.judge),
    )
    assert [(each.judged.ap, each.over_errors.ap) for each in picked.options] == [
        (0.75, 0.5),
        (0.75, 0.75),
    ]
    assert (picked.chosen, alone.chosen) == (1, 0)
    assert {each.over_errors for each in alone.options} == {None}
