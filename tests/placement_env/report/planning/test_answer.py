"""All figures of an answer on the known street, put together."""

import numpy as np
import pytest

from placement_env.fidelity.traffic import Traffic
from placement_env.handover.ground import visible_ground
from placement_env.report.planning.answer import PlanInputs, answer, best_first, detector_in_words
from placement_env.report.planning.question import Question
from placement_env.report.planning.selection import select
from placement_env.search.portfolio.entrants import Entrants
from toolkit.objects import Objects
from toolkit.traffic.snapshots import Snapshot


@pytest.fixture
def answered(street):
    def answered(**asked):
        question = Question(site=street.site, sensors=2, detector=street.detected.detector, **asked)
        sets = np.array([[1, 0, 0, 0], [0, 1, 0, 1], [1, 1, 0, 0]], bool)
        found = Entrants(sets, street.objective.scores(sets).ap, ((), (), ("greedy",)), 30)
        picked = select(street.objective, found, street.judge, min_ap=question.min_ap)
        terms = PlanInputs(question, found, picked, "surrogate", "general", ("The links exclude 1 of 5 candidates.",))
        members = np.flatnonzero(sets[picked.chosen])
        ground = visible_ground(street.site, [street.candidates.sensors[c] for c in members], cell=4.0)
        empty = Traffic(street.site, (), (Snapshot(Objects.empty(), np.zeros(0, np.int64)),))
        return answer(terms, street.objective, street.judge, ground, [empty] * 3)

    return answered


def test_figures_fit_together(answered):
    plan = answered()
    # of the two sets with AP 0.75 the first costs 11 + 23 and the second 11 + 11
    assert plan.chosen.sensors == ("post0_eye", "post1_eye")
    assert (plan.chosen.price, plan.chosen.judged.ap, plan.chosen.searches) == (22.0, 0.75, ("greedy",))
    assert plan.chosen.kbit_per_sensor == 4.8  # as measured in the final traffic: 50 points of 96 bits
    assert [option.price for option in plan.considered] == [34.0, 22.0, 11.0]
    assert [option.price for option in plan.near_optimal] == [34.0]
    assert [option.price for option in plan.front] == [11.0, 22.0]
    assert plan.poles_unused == ("post2", "post3")
    assert plan.detector == "Reader"
    assert plan.verdict.met is None
    assert [step.judged.ap for step in plan.order] == [0.5, 0.75]
    assert [item.price for item in plan.materials] == [20.0, 2.0]
    assert set(plan.ground.sensor_m2) == {"post0_eye", "post1_eye"}


def test_a_requirement_that_is_not_met_says_why(answered):
    plan = answered(min_ap=0.9)
    assert plan.verdict.met is False
    assert plan.verdict.reasons[0].startswith("The best set found, 2 sensors for the price of 22 ordinary poles")
    assert plan.verdict.reasons[-1] == "The links exclude 1 of 5 candidates."
    assert answered(min_ap=0.5).chosen.sensors == ("post0_eye",)
    assert answered(min_ap=0.5).verdict.met is True


def test_detectors_in_words(street):
    assert detector_in_words(street.judge, None) == "Reader"
    assert detector_in_words(street.judge, "general") == "Reader (shipped network 'general')"
    assert best_first(()) == ()
