"""Plans of the T-junction's own sensors by the shipped network: whole, repeated, interrupted, and
refused."""

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import shapely

from models.detector import VoxelNetDetector
from placement_env.candidates.candidates import paper_candidates
from placement_env.fidelity.preparation import Preparation
from placement_env.report.content import Judgement, Plan, Planned, PlanOption, Verdict
from placement_env.report.pages.decision import decision_section
from placement_env.report.planning import prepared_judge
from placement_env.report.planning.buildable import find_buildable
from placement_env.report.planning.judging import SetJudgement
from placement_env.report.planning.plan_writing import format_json, write_plan
from placement_env.report.planning.planning import plan
from placement_env.report.planning.prepared_judge import PreparedJudge, prepare_final_judge
from placement_env.search.exclusions import describe_exclusions
from placement_env.setting import Setting
from toolkit.objects import Detections
from toolkit.runtime.run import Run
from toolkit.sensors.error_profiles import POOR
from toolkit.sites.files import load_site
from toolkit.sites.site import Site

SITE = load_site("tjunction")


@pytest.fixture(scope="module")
def asked(ask, tmp_path_factory):
    """Builds the small question, with other options; all of them keep their work in one cache."""
    plain = {
        "sensors": 2,
        "candidates": "paper",
        "frames": 5,
        "cache": tmp_path_factory.mktemp("cache"),
    }
    return lambda **options: ask(**{"site": SITE} | plain | options)


@pytest.fixture(scope="module")
def planned(asked):
    """A plan that was interrupted while sets were judged, then made."""

    def interrupted(stage, done, total):
        if stage == "set sizes compared":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        plan(asked(progress=interrupted))
    return plan(asked())


def test_a_plan_mounts_the_sensors_that_it_judged(planned):
    made = planned.plan
    assert made.verdict.met is None
    assert len(made.chosen.sensors) == len(made.sensors) == len(planned.site.sensors) == 2
    assert made.chosen.sensors == tuple(sensor.name for sensor in made.sensors)
    judged = made.chosen.judged
    assert judged.frames == 5
    assert np.isnan([judged.low, judged.high]).all()
    assert judged.vehicles > 10


def test_tables_of_a_plan_add_up_to_its_judgement(planned):
    made, judged = planned.plan, planned.plan.chosen.judged
    assert {(row.scheme, row.iou) for row in made.schemes} == {
        (s, i) for s in ("early", "late", "hybrid") for i in (0.7, 0.8, 0.9)
    }
    assert (
        next(row for row in made.schemes if (row.scheme, row.iou) == ("early", 0.7)).judged
        == judged
    )
    for rows in (made.by_zone, made.by_range, made.by_approach):
        assert sum(row.judged.vehicles for row in rows if row.judged) == judged.vehicles
    assert made.by_class[0].objects == judged.vehicles
    assert sum(worth.shapley for worth in made.worth) == pytest.approx(judged.ap)
    assert [len(case.failed) for case in made.failures] == [1, 1]
    assert made.order[-1].judged == judged
    assert (
        made.order[-1].price
        == made.chosen.price
        == sum(item.price for item in made.materials)
        == 2.0
    )


def test_a_plan_has_links_ground_and_pictures(planned):
    made = planned.plan
    assert len(made.poles_unused) == 4
    assert made.links[0].mbit_s == pytest.approx(made.sensors[0].kbit / 100)
    assert 0 < made.ground.seen_by[0] <= 1
    assert planned.ground.seen.shape[0] == 2
    assert len(planned.moments) == 5
    assert made.detector == "tjunction"


def test_searches_comparison_and_judgement_have_traffic_of_their_own(planned):
    parts = planned.plan.provenance["traffic"]
    assert [parts[name]["seed"] for name in ("search", "comparison", "judgement")] == [
        0,
        1000003,
        2000006,
    ]
    assert len({part["sha256"] for part in parts.values()}) == 3


def test_considered_sets_go_from_the_best_to_those_that_were_only_predicted(planned):
    considered = planned.plan.considered
    assert {option.judged.frames for option in considered if option.judged} == {5}
    rank = [
        (not each.judged, -(each.judged.ap if each.judged else each.predicted))
        for each in considered
    ]
    assert rank == sorted(rank)  # the best first, then what was only predicted
    assert len({judged for judged, _ in rank}) == 2


def test_the_same_question_has_the_same_plan(planned, asked, fail):
    fail(VoxelNetDetector, "__call__", AssertionError("detected again"))
    again = plan(asked())
    assert format_json(again.plan) == format_json(planned.plan)
    assert all(
        np.array_equal(one, other)
        for first, second in zip(planned.moments, again.moments, strict=True)
        for one, other in zip(first.clouds, second.clouds, strict=True)
    )


def test_other_detector_other_figures(asked):
    class Blind:
        digest = "blind"

        def __call__(self, points, /):
            return Detections.empty()

    made = plan(asked(detector=Blind(), min_ap=0.5)).plan
    assert (made.detector, made.chosen.judged.ap, made.chosen.judged.precision) == (
        "Blind",
        0.0,
        None,
    )
    assert made.verdict.met is False
    assert "AP 0.00 (no interval from fewer than 80 frames)" in made.verdict.reasons[0]
    assert len(made.chosen.sensors) == 1  # of equal sets the cheapest


def test_requirements_and_limits_decide_by_the_ap_of_an_evaluation(planned, asked):
    one = min(
        (o for o in planned.plan.considered if o.judged and len(o.sensors) == 1),
        key=lambda o: -o.judged.ap,
    )
    made = plan(asked(min_ap=one.judged.ap / 2)).plan
    assert len(made.chosen.sensors) == 1
    assert made.verdict.met is (made.chosen.judged.ap >= one.judged.ap / 2)
    most = max(planned.plan.sensors, key=lambda sensor: sensor.kbit)
    made = plan(asked(max_kbit=most.kbit - 60.0, sensors=1)).plan
    assert made.sensors[0].name != most.name
    assert made.sensors[0].kbit < most.kbit
    # As the detector gives it on the third part of the traffic.
    run = asked().run.part(2)
    candidates = paper_candidates(SITE)
    detected = Preparation(
        Setting(SITE, candidates=candidates, fidelity="detector"), run
    ).fidelity()
    row = np.isin([sensor.name for sensor in candidates.sensors], planned.plan.chosen.sensors)
    estimate = detected(row[None])
    assert estimate.ap[0] == planned.plan.chosen.judged.ap
    assert estimate.kbit[0] == pytest.approx(planned.plan.chosen.kbit)


def test_a_sensor_may_send_exactly_what_is_allowed(street):
    most = street.objective.sent.max()
    over = np.flatnonzero(street.objective.sent == most)
    assert (
        len(find_buildable(street.objective, None))
        == len(find_buildable(street.objective, most))
        == 4
    )
    assert describe_exclusions(street.objective, most) == ()
    fewer = find_buildable(street.objective, np.nextafter(most, 0))
    assert sorted([*fewer, *over]) == [0, 1, 2, 3]
    assert (
        f"excludes {len(over)} of 4"
        in describe_exclusions(street.objective, np.nextafter(most, 0))[0]
    )


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"sensors": 0}, "The budget is 0 sensors"),
        (
            {"site": Site("bare", np.array([-9.0, -9, 9, 9]))},
            "has no road network, so there is no traffic",
        ),
        (
            {"candidates": "pool", "keep_out": (shapely.box(-500, -500, 500, 500),)},
            "There is no candidate: site",
        ),
        ({"capacity_kbit": 5.0}, "The links exclude 6 of 6 candidates"),
        ({"max_kbit": 5.0}, "The limit of 5 kbit per sensor and frame excludes 6 of 6"),
        ({"money": 0.5}, "The sum of the price of 0.5 ordinary poles excludes 6 of 6"),
        (
            {"money": 1.5, "keep": ("post00", "post01")},
            "Sensors on post00 and post01, as asked, cost together",
        ),
        (
            {"capacity_kbit": 5.0, "keep": ("post01",)},
            "Pole post01 must carry a sensor, but cannot: each pose sends",
        ),
    ],
)
def test_none_can_and_why(asked, options, reason):
    made = plan(asked(**options))
    assert (made.plan.verdict.met, made.plan.chosen, made.site.sensors) == (False, None, ())
    assert reason in " ".join(made.plan.verdict.reasons)
    assert format_json(made.plan)


def test_poles_to_be_kept_are_built_and_said(asked, planned):
    others = [m.name for m in planned.candidates.mounts if m.name not in planned.plan.chosen.poles]
    made = plan(asked(keep=others[:1])).plan
    assert others[0] in made.chosen.poles
    assert all(others[0] in option.poles for option in made.considered)
    assert json.loads(format_json(made))["question"]["keep"] == others[:1]
    assert f" {others[0]} had to carry a sensor, as asked." in str(
        decision_section(made, SITE, None)
    )


def test_a_site_without_vehicles(asked, monkeypatch):
    for module in ("visibility", "occlusion"):
        monkeypatch.setattr(
            f"placement_env.fidelity.{module}.scored",
            lambda objects, *_: np.zeros(len(objects), bool),
        )
    made = plan(asked(seed=77, cache=None))
    assert (
        "No vehicle enters the detection area of site 'tjunction' in 5 frames"
        in made.plan.verdict.reasons[0]
    )


def test_the_search_knows_no_errors_and_the_judges_do(ask):
    question = ask(SITE, candidates="paper", errors=("poor",))
    assert question.search_setting.cases.names == ("paper",)
    assert question.judge_setting(question.setting.pool).cases.profiles == (POOR,)


@pytest.mark.slow
def test_sets_are_judged_with_the_errors_that_are_asked_for(planned, asked):
    rough = plan(asked(errors=("poor",))).plan
    assert rough.provenance["errors"] == {"profile": "poor", "digest": POOR.digest}
    assert planned.plan.provenance["errors"]["profile"] == "paper"
    assert rough.provenance["traffic"] == planned.plan.provenance["traffic"]
    assert rough.chosen.judged.ap < planned.plan.chosen.judged.ap


@pytest.fixture(scope="module")
def mean_plan(asked):
    """Plan by the mean over three thresholds when one sensor fails."""
    return plan(asked(iou=(0.7, 0.8, 0.9), failing=1, min_ap=0.01)).plan


@pytest.mark.slow
def test_mean_iou_and_a_failure_decide(mean_plan):
    made, chosen = mean_plan, mean_plan.chosen
    assert made.question["iou"] == [0.7, 0.8, 0.9]
    assert (made.question["failing"], made.question["failures"]) == (1, "worst")
    assert len(chosen.sensors) == 2  # of one nothing is left
    assert chosen.left.ap == pytest.approx(min(case.judged.ap for case in made.failures))
    assert made.verdict.met is (chosen.left.ap >= 0.01)
    assert "what is left in the worst case when 1 sensor fails" in made.verdict.sentence
    assert "IoU 0.7 to 0.9 (mean of 3 thresholds)" in made.verdict.sentence


@pytest.mark.slow
def test_figures_at_the_mean_iou_add_up(mean_plan):
    made, chosen = mean_plan, mean_plan.chosen
    own = {row.iou: row.judged.ap for row in made.schemes if row.scheme == "early"}
    assert (
        own[(0.7, 0.8, 0.9)]
        == pytest.approx(np.mean([own[iou] for iou in (0.7, 0.8, 0.9)]))
        == chosen.judged.ap
    )
    for rows in (made.by_zone, made.by_range, made.by_approach):
        assert sum(row.judged.vehicles for row in rows if row.judged) == chosen.judged.vehicles
    assert sum(worth.shapley for worth in made.worth) == pytest.approx(chosen.judged.ap)


@pytest.mark.slow
def test_the_mean_and_failures_are_of_that_question_alone(mean_plan, planned):
    made = mean_plan
    assert any("as in COCO" in sentence for sentence in made.assumptions)
    assert {option.left is None for option in made.considered if option.judged} == {False}
    assert all(option.left is None for option in planned.plan.considered)


@pytest.mark.slow
def test_entrants_of_another_iou_are_searched_again(planned, asked):
    # Entrants that are kept depend on the IoU by which they were found.
    strict = plan(asked(iou=0.9)).plan
    loose = {option.sensors: option.predicted for option in planned.plan.considered}
    shared = [option for option in strict.considered if option.sensors in loose]
    assert shared
    assert all(loose[option.sensors] > option.predicted for option in shared)


@pytest.fixture(scope="module")
def levels_plan(asked):
    """Plan by the worst of two levels of traffic."""
    return plan(asked(sensors=1, levels=2, min_ap=0.01)).plan


@pytest.mark.slow
def test_levels_of_traffic_decide(levels_plan):
    made, chosen = levels_plan, levels_plan.chosen
    assert (made.question["levels"], made.question["levels_by"]) == (2, "worst")
    assert [row.name for row in made.by_level] == ["thin traffic", "dense traffic"]
    assert np.sum([row.judged.frames for row in made.by_level]) == 5
    assert chosen.over_levels.ap == min(row.judged.ap for row in made.by_level)
    assert chosen.judged.vehicles == np.sum([row.judged.vehicles for row in made.by_level])


@pytest.mark.slow
def test_verdict_and_reasons_are_at_the_worst_level(levels_plan, planned):
    made, chosen = levels_plan, levels_plan.chosen
    assert "at the worst of 2 levels of traffic" in made.verdict.sentence
    assert made.verdict.met is (chosen.over_levels.ap >= 0.01)
    assert any("compared is that at the worst of 2 levels" in sentence for sentence in made.why)
    assert {option.over_levels is None for option in made.considered if option.judged} == {False}
    assert planned.plan.by_level == ()
    assert planned.plan.chosen.over_levels is None


@pytest.mark.slow
def test_entrants_are_searched_over_levels(levels_plan, planned):
    made = levels_plan
    alone = {option.sensors: option.predicted for option in planned.plan.considered}
    both = [
        (each.predicted, alone[each.sensors]) for each in made.considered if each.sensors in alone
    ]
    assert both
    assert all(worst <= all_traffic for worst, all_traffic in both)
    assert any(
        worst < all_traffic for worst, all_traffic in both
    )  # searched over levels, not taken from the cache


def test_the_last_part_has_the_frames_that_a_width_takes(street, monkeypatch):
    """An interval as wide as what 100 vehicles leave, and none from few frames."""
    asked = []

    class Sure:
        absent_labels = ()

        def __init__(self, frames):
            self.frames = frames

        def judge_cases(self, sets, stage=None):
            half = math.nan if self.frames < 80 else 0.2 / math.sqrt(self.frames)
            judged = Judgement(0.9, 0.9 - half, 0.9 + half, 0.9, 0.9, self.frames, self.frames)
            return [SetJudgement(judged)], np.zeros((1, 1))

    def prepare(question, objectives, run):
        asked.append(run.frames)
        return PreparedJudge(SimpleNamespace(frames=run.frames), Sure(run.frames))

    monkeypatch.setattr(prepared_judge, "prepare_judge", prepare)
    for width, frames in (
        (None, [60]),
        (0.04, [60, 120]),
        (0.021, [60, 120, 364]),
        (0.001, [60, 120, 1200]),
    ):
        asked.clear()
        question = SimpleNamespace(part=lambda name: Run(frames=60), width=width, run=Run())
        _, judge = prepare_final_judge(question, [], np.zeros(4, bool))
        assert asked == frames, width
        assert judge.frames == frames[-1]


@pytest.fixture(scope="module")
def errors_plan(asked):
    """Plan by the worst of two error profiles."""
    return plan(asked(sensors=1, errors=("paper", "poor"), min_ap=0.01)).plan


@pytest.mark.slow
def test_error_profiles_have_a_row_each(errors_plan):
    """Judged at both profiles, searched as before; what else is said is at the first."""
    made = errors_plan
    assert (made.question["errors"], made.question["errors_by"]) == (["paper", "poor"], "worst")
    assert [row.name for row in made.by_errors] == ["paper", "poor"]


@pytest.mark.slow
def test_errors_are_drawn_ten_times(errors_plan):
    made = errors_plan
    (drawn,) = made.by_draw
    assert (drawn.profile, len(drawn.aps), drawn.frames) == ("poor", 10, 5)
    assert min(drawn.aps) <= drawn.tenth <= drawn.mean == pytest.approx(np.mean(drawn.aps))
    assert len(set(drawn.aps)) > 1


@pytest.mark.slow
def test_the_worst_profile_decides_and_searches_are_as_before(errors_plan, planned):
    made, chosen = errors_plan, errors_plan.chosen
    assert chosen.over_errors.ap == min(row.judged.ap for row in made.by_errors)
    assert chosen.judged == made.by_errors[0].judged
    assert "at the worst of the error profiles paper and poor" in made.verdict.sentence
    assert made.verdict.met is (chosen.over_errors.ap >= 0.01)
    assert {option.over_errors is None for option in made.considered if option.judged} == {False}
    assert (planned.plan.by_errors, planned.plan.chosen.over_errors) == ((), None)
    alone = {option.sensors: option.predicted for option in planned.plan.considered}
    assert all(
        alone[each.sensors] == each.predicted for each in made.considered if each.sensors in alone
    )


PLAN = Plan(
    {"site": "Straße", "money": float("inf")},
    "Straße",
    "Reader",
    0.7,
    "early",
    "",
    Verdict(None, "So."),
    PlanOption(("a",), 1.0, 2.0, 2.0, float("nan"), Judgement(0.5, 0.25, 0.75, 0.5, None, 4, 2)),
)


def test_plans_in_json_and_files_that_are_written_whole(tmp_path):
    text = format_json(PLAN)
    read = json.loads(text, parse_constant=pytest.fail)
    assert (read["question"], read["chosen"]["predicted"]) == (
        {"site": "Straße", "money": None},
        None,
    )
    assert read["chosen"]["judged"]["precision"] is None
    assert read["chosen"]["judged"]["low"] == 0.25
    assert "Straße" in text
    assert text.endswith("}\n")
    # Without ground there is nothing to hand over, so the schedule of another plan must not stay
    # beside this
    # one.
    planned = Planned(replace(PLAN, chosen=None), Site("s", np.array([0.0, 0, 1, 1])))
    out = tmp_path / "new" / "plan"
    out.mkdir(parents=True)
    for name in ("schedule.csv", "plan.json", "mine.txt"):
        (out / name).write_text("old")
    written = write_plan(planned, out)
    assert [path.name for path in written] == ["plan.json", "report.html", "report.pdf"]
    assert (out / "plan.json").read_text(encoding="utf-8") == format_json(planned.plan)
    assert sorted(each.name for each in out.iterdir()) == [
        "mine.txt",
        "plan.json",
        "report.html",
        "report.pdf",
    ]
    assert (out / "mine.txt").read_text() == "old"
