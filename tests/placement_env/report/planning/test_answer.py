"""All figures of an answer on the known street, put together."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from placement_env.candidates.sensor_catalogue import SensorCatalogue
from placement_env.fidelity.traffic import Traffic
from placement_env.handover.ground import visible_ground
from placement_env.report.planning.answer import build_plan
from placement_env.report.planning.choice import Choice
from placement_env.report.planning.choosing import choose_set
from placement_env.report.planning.chosen_set import ChosenSet
from placement_env.report.planning.findings import Findings, trace_plan
from placement_env.search.portfolio.entrants import Entrants
from toolkit.objects import Detections, Objects
from toolkit.traffic.snapshots import Snapshot


@pytest.fixture
def answered(ask, street):
    def answered(**asked):
        question = ask(street.site, sensors=2, detector=street.detected.detector, **asked)
        sets = np.array([[1, 0, 0, 0], [0, 1, 0, 1], [1, 1, 0, 0]], bool)
        found = Entrants(sets, street.objective.scores(sets).ap, ((), (), ("greedy",)), 30)
        choice = choose_set(street.objective, found, street.judge, min_ap=question.min_ap)
        ground = visible_ground(
            street.site, [street.candidates.sensors[c] for c in choice.members], cell=4.0
        )
        empty = Traffic(street.site, (), (Snapshot(Objects.empty(), np.zeros(0, np.int64)),))
        excluded = ("The links exclude 1 of 5 candidates.",)
        findings = Findings(
            question, found, choice, street.objective, "general", excluded, [empty] * 3
        )
        return build_plan(findings, street.judge, ground)

    return answered


def test_the_cheaper_of_two_equal_sets_is_chosen(answered):
    plan = answered()
    # of the two sets with AP 0.75 the first costs 11 + 23 and the second 11 + 11
    assert plan.chosen.sensors == ("post0_eye", "post1_eye")
    assert (plan.chosen.price, plan.chosen.judged.ap, plan.chosen.searches) == (
        22.0,
        0.75,
        ("greedy",),
    )
    assert (
        plan.chosen.kbit_per_sensor == 4.8
    )  # as measured in the final traffic: 50 points of 96 bits


def test_considered_sets_and_the_front_have_their_prices(answered):
    plan = answered()
    assert [option.price for option in plan.considered] == [34.0, 22.0, 11.0]
    assert plan.near_optimal == ()  # two blocks of frames tell nothing apart
    assert plan.best.sensors == plan.chosen.sensors
    assert [option.price for option in plan.front] == [11.0, 22.0]
    assert plan.poles_unused == ("post2", "post3")


def test_order_materials_and_ground_are_of_the_chosen_sensors(answered):
    plan = answered()
    assert plan.detector == "Reader"
    assert plan.verdict.met is None
    assert [step.judged.ap for step in plan.order] == [0.5, 0.75]
    assert [item.price for item in plan.materials] == [20.0, 2.0]
    assert set(plan.ground.sensor_m2) == {"post0_eye", "post1_eye"}


def test_an_ap_out_of_reach_is_not_met_for_stated_reasons(answered):
    plan = answered(min_ap=0.9)
    assert plan.verdict.met is False
    assert plan.verdict.reasons[0].startswith(
        "The best set found, 2 sensors for the price of 22 ordinary poles"
    )
    assert plan.verdict.reasons[-1] == "The links exclude 1 of 5 candidates."
    assert {row.as_good for row in plan.schemes} == {False}


def test_the_cheapest_set_that_reaches_the_ap_is_chosen(answered):
    assert answered(min_ap=0.5).chosen.sensors == ("post0_eye",)
    assert answered(min_ap=0.5).verdict.met is True


@pytest.fixture
def chosen(street):
    return lambda *members, names: ChosenSet(members, names, street.judge, street.objective)


@pytest.fixture
def pair(chosen):
    return chosen(0, 1, names=("post0_eye", "post1_eye"))


def test_pairs_have_exact_worth_and_every_scheme(pair):
    first, second = pair.worth()
    # alone each detects 2 of 4 cars, together 3: one is seen by both
    assert (first.sensor, first.shapley, second.shapley) == ("post0_eye", 0.375, 0.375)
    assert first.synergy == {"post1_eye": -0.25}
    rows = pair.schemes()
    assert [(row.scheme, row.iou) for row in rows] == [
        (scheme, iou) for scheme in ("early", "late", "hybrid") for iou in (0.7, 0.8, 0.9)
    ]
    assert {row.judged.ap for row in rows} == {0.75}
    sent = {row.scheme: row.kbit_per_sensor for row in rows}
    assert (sent["early"], sent["late"]) == (50 * 96 / 1000, 2 * 256 / 1000)


def test_large_sets_are_sampled_by_the_fidelity_of_the_searches(street, pair, limits, fail):
    limits("placement_env.report.planning.chosen_set", MAX_SUBSET_SENSORS=1)
    fail(street.detected, "outcomes")
    first, second = pair.worth()
    assert (first.shapley, second.shapley) == pytest.approx((0.375, 0.375))


def test_failures_worst_first(chosen, pair):
    cases = chosen(0, 1, 3, names=("a", "b", "c")).failures()
    assert [(case.failed, case.judged.ap) for case in cases] == [
        *(
            (("b",), 0.5),
            (("a",), 0.75),
            (("c",), 0.75),
            (("a", "b"), 0.25),
            (("a", "c"), 0.5),
            (("b", "c"), 0.5),
        )
    ]
    assert chosen(0, names=("a",)).failures() == ()
    assert [case.failed for case in pair.failures()] == [("post0_eye",), ("post1_eye",)]


def test_what_adds_most_is_built_first_and_rows_are_subsets(chosen):
    steps = chosen(1, 2, 3, names=("b", "c", "d")).order()
    assert [step.sensor for step in steps] == ["b", "d", "c"]
    assert [step.price for step in steps] == [11.0, 34.0, 44.5]
    assert [step.judged.ap for step in steps] == pytest.approx([0.5, 0.75, 0.8])
    assert chosen(1, 3, names=("a", "b")).rows(np.array([[True, False], [True, True]])).astype(
        int
    ).tolist() == [[0, 1, 0, 0], [0, 1, 0, 1]]


class Reader:
    digest = "reader 1"

    def __call__(self, points):
        return Detections.empty()


def trace(street, question, *, frames=1):
    one = Snapshot(Objects.empty(), np.zeros(0, np.int64))
    traffic = [Traffic(question.site, (), (one,) * frames)] * 3
    found, choice = (
        Entrants(np.zeros((0, 4), bool), np.zeros(0), (), 0),
        Choice((), np.zeros((0, 4), bool), 0, 0, (), "best"),
    )
    findings = Findings(question, found, choice, street.objective, "general", (), traffic)
    return trace_plan(findings, street.candidates, Reader())


def test_provenance_holds_seeds_versions_and_files(ask, street, tmp_path):
    poles = tmp_path / "poles.geojson"
    poles.write_text("one")
    catalogue = SensorCatalogue((), "EUR", None, "digest of it")
    question = ask(street.site, candidates=poles, catalogue=catalogue, seed=5)
    before = trace(street, question)
    assert before == trace(street, question)
    assert (before["detector_digest"], before["catalogue_sha256"]) == ("reader 1", "digest of it")
    assert [part["seed"] for part in before["traffic"].values()] == [5, 1000008, 2000011]
    assert {"coview", "python", "numpy", "torch"} <= set(before["versions"])
    assert str(tmp_path) not in str(before)
    poles.write_text("two")
    changed = trace(street, question)
    assert {key for key in before if before[key] != changed[key]} == {"poles_sha256"}


def test_provenance_changes_with_site_areas_errors_and_frames(ask, street):
    question = ask(street.site)
    before = trace(street, question)
    assert (
        trace(street, ask(replace(street.site, height=5.0)))["site_sha256"] != before["site_sha256"]
    )
    fenced = ask(street.site, keep_out=(shapely.box(0, 0, 1, 1),))
    assert trace(street, fenced)["keep_out_sha256"] != before["keep_out_sha256"]
    assert trace(street, ask(street.site, errors=("typical",)))["errors"] != before["errors"]
    assert trace(street, question, frames=2)["traffic"] != before["traffic"]
    assert before["poles_sha256"] is None
