"""What each stage of a plan is asked, on the known street, with no traffic simulated."""

import json
import math
from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest

from placement_env.analysis.intervals import Tally
from placement_env.candidates.candidates import Axes
from placement_env.candidates.sensor_catalogue import PricedModel, SensorCatalogue
from placement_env.cases import Cases
from placement_env.classes import Classes
from placement_env.defaults import VEHICLES
from placement_env.fidelity.detector import FALSE_ALARM, IGNORED, Detected
from placement_env.fidelity.traffic import Traffic
from placement_env.handover.ground import GroundGrid
from placement_env.objective import Objective
from placement_env.racing import Contest
from placement_env.report.content import (
    BreakdownRow,
    DrawingResult,
    Judgement,
    Plan,
    Planned,
    PlanOption,
    Verdict,
)
from placement_env.report.planning import (
    answer,
    breakdowns,
    buildable,
    choosing,
    chosen_set,
    entrant_search,
    error_draws,
    judged_options,
    judging,
    moments,
    plan_writing,
    planning,
    prepared_judge,
    question as questions,
    scored_boxes,
    sentences,
    size_races,
)
from placement_env.report.planning.breakdowns import measure_blind_streets
from placement_env.report.planning.choice import Choice, choose
from placement_env.report.planning.chosen_set import ChosenSet
from placement_env.report.planning.findings import check_stages
from placement_env.report.planning.judging import Judge
from placement_env.report.planning.moments import pick_moments
from placement_env.report.planning.plan_writing import write_plan
from placement_env.report.planning.planning import plan
from placement_env.report.planning.prepared_judge import PreparedJudge, prepare_judge
from placement_env.search.portfolio import reward_race
from placement_env.search.portfolio.entrants import Entrants
from placement_env.search.portfolio.reward_race import NEAR_TIE_AP
from placement_env.setting import Weights
from toolkit.objects import LABELS, Detections, Objects
from toolkit.runtime.run import Run
from toolkit.sensors.error_profiles import PAPER_ERRORS, POOR
from toolkit.sites.site import Site
from toolkit.traffic.snapshots import Snapshot

SETS = np.array([[1, 0, 0, 0], [0, 1, 0, 1], [1, 1, 0, 0]], bool)
WHOLE = Plan({}, "s", "Reader", 0.7, "early", "", Verdict(None, "So."), None)


@pytest.fixture
def staged(ask, street, spy, monkeypatch):
    """Plans on the street: searches answer at once, and what they, the choice and the pictures are
    asked is noted."""
    site = replace(street.site, network="<net><edge/></net>")
    monkeypatch.setattr(questions, "choose_candidates", lambda *_, **__: street.candidates)
    traffic = Traffic(site, (), (Snapshot(Objects.empty(), np.zeros(0, np.int64)),))
    noted = SimpleNamespace(
        searched=[],
        others=[],
        parts=[],
        followed=[],
        labels=np.array([0, 0, 2]),
        judge=street.judge,
    )

    class Prepared:
        def __init__(self, setting, run):
            self.setting, self.run, self.frames, self.traffic, self.network = (
                setting,
                run,
                8,
                traffic,
                "general",
            )
            self.visibility = SimpleNamespace(
                labels=noted.labels, select=lambda rows: ("seen", rows.tolist())
            )
            self.intact_preparation = "plain"

    def moved(preparation, candidates, visibility, weights):
        assert weights == Weights()
        return replace_objective(preparation)

    def replace_objective(preparation):
        found = street.objective.with_weights(street.objective.weights)
        vars(found).update(preparation_asked=preparation)
        return found

    def searched(objective, effort, memo, *, depends_on, others, seed):
        noted.searched.append((objective, effort, memo, depends_on, seed))
        noted.others.append(others)
        return Entrants(SETS, street.objective.scores(SETS).ap, ((), (), ("greedy",)), 30)

    def judged(question, objectives, run, *, compares=False):
        noted.parts.append(run)
        return PreparedJudge(Prepared(question.setting, run), noted.judge)

    monkeypatch.setattr(entrant_search, "Preparation", Prepared)
    monkeypatch.setattr(Objective, "from_view", staticmethod(moved))
    monkeypatch.setattr(entrant_search, "keep_entrants", searched)
    monkeypatch.setattr(planning, "prepare_judge", judged)
    monkeypatch.setattr(prepared_judge, "prepare_judge", judged)
    # its traffic needs a real network
    monkeypatch.setattr(planning, "measure_motion", lambda *given: noted.followed.append(given))
    noted.chosen, noted.moments = spy(planning, "choose_set"), spy(planning, "pick_moments")

    def made(**options):
        plain = {"sensors": 2, "detector": street.detected.detector, "seed": 7}
        return plan(ask(**{"site": site} | plain | options))

    noted.plan, noted.traffic = made, traffic
    return noted


def test_every_stage_has_its_seed_and_its_part_of_the_traffic(staged, tmp_path):
    staged.plan(confidence=0.9, min_ap=0.4, cache=tmp_path)
    ((objective, effort, memo, depends_on, seed),) = staged.searched
    assert (effort.sizes, effort.min_ap, seed) == ((1, 2), 0.4, 7)
    assert (memo is not None, depends_on) == (True, staged.traffic.digest())
    assert objective.preparation_asked.run.seed == 7
    ((given, asked),) = staged.chosen
    assert (given[0], given[2]) == (objective, staged.judge)
    assert (asked["min_ap"], asked["confidence"], asked["run"].seed) == (0.4, 0.9, 7)
    assert [(run.seed, run.frames) for run in staged.parts] == [(1000010, 120), (2000013, 120)]
    ((given, asked),) = staged.moments
    assert (given[1], asked) == ((0,), {"seed": 7})  # the cheapest that finds two of five
    ((_, candidates, members, detector),) = staged.followed
    assert (candidates, members) == (objective.candidates, (0,))
    assert detector is staged.judge.detected.detector


def test_a_plan_has_sensors_traffic_and_pictures_of_its_stages(staged):
    planned = staged.plan(confidence=0.9, min_ap=0.4)
    made = planned.plan
    assert (
        made.chosen.sensors
        == tuple(sensor.name for sensor in planned.site.sensors)
        == ("post0_eye",)
    )
    assert made.chosen.kbit == made.chosen.kbit_per_sensor == 4.8
    assert [part["seed"] for part in made.provenance["traffic"].values()] == [7, 1000010, 2000013]
    assert made.provenance["network"] == "general"
    assert (planned.ground.seen.shape[0], len(planned.moments)) == (1, 8)
    assert any("30 sets were scored" in sentence for sentence in made.why)
    both = staged.plan().plan.chosen
    assert (both.kbit, both.kbit_per_sensor) == (9.6, 4.8)


def test_with_failures_what_is_best_intact_enters_too(staged):
    staged.plan(failing=1)
    assert len(staged.searched) == 2
    first, other = (objective.preparation_asked for objective, *_ in staged.searched)
    assert (type(first).__name__, other) == ("Prepared", "plain")


def test_other_iou_thresholds_are_for_the_searches_of_the_question(staged, monkeypatch):
    monkeypatch.setattr(entrant_search, "at_other_ious", lambda scored, prepared: {0.5: "other"})
    staged.plan(failing=1)
    assert staged.others == [{0.5: "other"}, {}]


def test_classes_that_are_not_there_are_refused_and_some_objects_are_enough(staged):
    assert staged.plan().plan.chosen is not None  # not all objects are vehicles
    staged.labels = np.array([2, 2])
    refused = staged.plan().plan
    assert refused.chosen is None
    assert refused.verdict.reasons[0].startswith(
        "No vehicle enters the detection area of site 'street' in 8 frames"
    )
    staged.labels = np.array([0, 3])
    old = staged.judge.detected
    staged.judge = Judge(
        (Detected(old.renders, old.detector, "early", classes=Classes(("vehicle", "heavy"))),)
    )
    refused = staged.plan().plan  # there when searched, not where sets are compared
    assert refused.verdict.reasons[0].startswith("No heavy enters")
    assert "of judging traffic" in refused.verdict.reasons[0]


@pytest.mark.parametrize(
    ("asked", "most"),
    [
        *(({"sensors": 3}, 3), ({"sensors": 9}, 4), ({"sensors": None, "money": 55.5}, 4)),
        *(
            ({"sensors": 3, "money": 21.5}, 2),
            ({"sensors": 3, "money": 21.4}, 1),
            ({"sensors": 3, "money": 1.0}, 1),
        ),
    ],
)
def test_searches_go_to_the_size_that_number_money_and_mounts_allow(street, ask, asked, most):
    """The four sensors cost 11, 11, 10.5 and 23, each on a pole of its own."""
    assert buildable.find_max_sensors(ask(street.site, **asked), street.candidates) == most


def test_poles_for_several_sensors_take_the_second_for_the_price_of_its_model(street, ask):
    """Poles cost 1, 1, 0.5 and 3, the models 10 and 20. Where each pole carries two, the second on
    it costs 10, 10, 10 and 20. Post 3 is unused here."""
    mounts = tuple(replace(mount, max_sensors=2) for mount in street.candidates.mounts)
    double = replace(street.candidates, mounts=mounts).select(np.array([0, 1, 2]))
    free = replace(double, axes=Axes(*vars(double.axes).values()))
    assert buildable.find_max_sensors(ask(street.site, sensors=9), free) == 6
    # ascending: 10, 10, 10, 10.5, 11, 11
    for money, most in ((30.0, 3), (40.5, 4), (40.4, 3), (62.5, 6)):
        assert buildable.find_max_sensors(ask(street.site, sensors=9, money=money), free) == most


def test_money_alone_buys_a_dozen_at_most(ask, make):
    site = Site("s", np.array([0.0, 0, 9, 9]))
    assert (
        buildable.find_max_sensors(ask(site, sensors=None, money=1e6), make(mounts=20).candidates)
        == 12
    )


def test_blind_lanes_are_measured_by_street():
    """Cells of 2 m: of the lane's six the sensors see two, and one is no open ground."""
    network = (
        '<net><edge id="1" name="Elm Road"><lane id="1_0" shape="-10,1 -0.5,1"/></edge>'
        '<edge id="2" name="Oak Road"><lane id="2_0" shape="0.5,1 10,1"/></edge></net>'
    )
    site = Site("s", np.array([-6.0, -2.0, 6.0, 2.0]), network=network)
    x, y = np.array([-5.0, -3, -1, 1, 3, 5]), np.array([-1.0, 1.0])
    lanes = np.array([[0] * 6, [1] * 6], bool)
    seen = np.zeros((2, 2, 6), bool)
    seen[0, 1, 3] = seen[1, 1, 0] = True
    ground = np.ones((2, 6), bool)
    ground[1, 1] = False
    made = GroundGrid(x, y, seen, np.zeros((2, 2, 6), np.float32), ground, lanes, ~lanes)
    assert measure_blind_streets(site, made) == {
        "Oak Road in the east": 8.0,
        "Elm Road in the west": 4.0,
    }
    assert list(measure_blind_streets(site, made)) == [
        "Oak Road in the east",
        "Elm Road in the west",
    ]
    assert measure_blind_streets(site, replace(made, seen=np.ones((2, 2, 6), bool))) == {}


@pytest.mark.parametrize(("frames", "drawn"), [(8, 8), (80, 60)])
def test_errors_are_drawn_ten_times_and_a_tenth_is_below(street, monkeypatch, frames, drawn):
    class Stub:
        def __init__(self, errors):
            self.errors = errors

    monkeypatch.setattr(error_draws, "Renders", Stub)
    monkeypatch.setattr(
        error_draws, "judge_draw", lambda judge, detected, renders, chosen, seed: seed**2 / 100
    )
    profiles = [
        SimpleNamespace(renders=each) for each in (Stub(PAPER_ERRORS), Stub(POOR), "others")
    ]
    told: list[tuple[str, int, int | None]] = []
    run = Run(progress=lambda *stage: told.append(stage))
    (row,) = error_draws.by_draw(SimpleNamespace(profiles=profiles, frames=frames), (0,), run)
    assert told == [("draws of the errors poor", done, 10) for done in range(1, 11)]
    assert (row.profile, row.aps, row.frames) == (
        "poor",
        tuple(n**2 / 100 for n in range(1, 11)),
        drawn,
    )
    assert (row.mean, row.tenth) == pytest.approx((0.385, 0.01 + 0.9 * 0.03))


def test_one_draw_is_judged_as_the_plan_is_on_as_many_frames(street):
    """Drawn once, sensor 1 sees nothing: of four cars 0 finds two."""
    asked = []

    class Drawn(type(street.detected.renders)):  # type: ignore[misc]
        def clouds(self, k, c):
            return super().clouds(k, c)[: 0 if c == 1 else None]

    drawn = Drawn(street.site, street.detected.renders.sensors[:2])

    def draw_once(*given):
        asked.append(given)
        return drawn

    renders: Any = SimpleNamespace(draw_once=draw_once)
    judge = Judge((street.detected.at(0.7, (0.7, 0.9)),), Cases(iou=(0.7, 0.9)))
    assert error_draws.judge_draw(judge, judge.detected, renders, (0, 1), 3) == 0.5
    assert asked == [(3, (0, 1), 8)]


def test_schemes_are_judged_at_every_threshold_and_as_good_only_at_the_plans(street, monkeypatch):
    """The reader's boxes are exact in footprint and 0.75 m high, so every threshold finds them."""
    judge = Judge((street.detected.at(0.7, (0.7, 0.9)),), Cases(iou=(0.7, 0.9)))
    rows = ChosenSet((0, 1), ("a", "b"), judge, street.objective).schemes()
    assert [row.iou for row in rows] == [0.7, 0.8, 0.9, (0.7, 0.9)] * 3
    monkeypatch.setattr(
        chosen_set, "is_as_good", lambda drawn, own, blocks: blocks == 2 and (drawn == own).all()
    )
    single = ChosenSet((0, 1), ("a", "b"), street.judge, street.objective)
    assert [row.as_good for row in single.schemes()] == [True, False, False] * 3
    odd = ChosenSet(
        (0, 1),
        ("a", "b"),
        Judge((street.detected.at(0.75, (0.75,)),), Cases(iou=0.75)),
        street.objective,
    )
    assert [row.iou for row in odd.schemes()] == [0.7, 0.75, 0.8, 0.9] * 3

    class Rough(type(street.detected.detector)):  # type: ignore[misc]
        digest = "rough"

        def __call__(self, points, /):
            found = super().__call__(points)
            boxes = found.boxes.copy()
            boxes[:, 3] *= 1.2  # IoU 1 / 1.2 = 0.83
            return Detections(boxes, found.scores)

    rough = Judge((Detected(street.detected.renders, Rough(), "early"),))
    drawn = replace(street.judge, drawings=(rough,))  # schemes are those of the first drawing
    of_first = ChosenSet((0, 1), ("a", "b"), drawn, street.objective).schemes()
    assert [(row.iou, row.judged.ap, row.as_good) for row in of_first] == [
        (row.iou, row.judged.ap, row.as_good) for row in single.schemes()
    ]
    aps = {
        row.iou: row.judged.ap
        for row in ChosenSet((0, 1), ("a", "b"), rough, street.objective).schemes()[:3]
    }
    assert aps == {0.7: 0.75, 0.8: 0.75, 0.9: 0.0}


def test_what_a_plan_hands_over_and_what_an_earlier_one_left(street, tmp_path, monkeypatch):
    handed = []
    monkeypatch.setattr(
        plan_writing,
        "write_report",
        lambda planned, folder: (folder / "report.html").write_text("x"),
    )

    def noted(folder, site, sensors, ground, *, unused, currency):
        handed.append((site.name, ground, [mount.name for mount in unused], currency))
        (folder / "schedule.csv").write_text("x")

    monkeypatch.setattr(plan_writing, "write_exchange", noted)
    made = replace(WHOLE, currency="EUR", poles_unused=("post1", "post3"))
    assert write_plan(Planned(made, street.site, street.candidates, "ground"), tmp_path) == [
        tmp_path / name for name in ("plan.json", "report.html", "schedule.csv")
    ]
    assert handed == [("street", "ground", ["post1", "post3"], "EUR")]
    for planned in (
        Planned(made, street.site, street.candidates),
        Planned(made, street.site, None, "ground"),
    ):
        assert [path.name for path in write_plan(planned, tmp_path)] == ["plan.json", "report.html"]
        assert sorted(path.name for path in tmp_path.iterdir()) == ["plan.json", "report.html"]
    assert len(handed) == 1
    text = (tmp_path / "plan.json").read_text()
    assert text == json.dumps(json.loads(text), indent=1, ensure_ascii=False) + "\n"


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        *(({"width": 0.0}, "width of the interval"), ({"width": 1.0}, "got 1.0: 0.02 is narrow")),
        *(({"confidence": 0.0}, "confidence must lie"), ({"confidence": 1.0}, "0.95 is usual")),
        *(
            ({"drawings": 0}, "drawings must be a whole"),
            ({"drawings": 2}, "nothing was drawn at site 'street'"),
        ),
        *(
            ({"sensors": 1, "failing": 1}, "of 1 sensors nothing"),
            ({"max_kbit": math.inf}, "max_kbit must be a finite"),
        ),
    ],
)
def test_widths_confidences_and_drawings_are_checked(ask, street, wrong, message):
    with pytest.raises(ValueError, match=message):
        ask(street.site, **wrong)


def test_what_may_just_be_asked(ask, street, monkeypatch):
    asked = ask(
        street.site, width=0.999, confidence=0.001, max_kbit=0.0, min_ap=1.0, sensors=2, failing=1
    )
    assert ask(street.site).as_dict() | {"sensors": 2} == ask(street.site, sensors=2).as_dict()
    said = asked.as_dict()
    assert (said["width"], said["confidence"], said["max_kbit"], said["min_ap"]) == (
        0.999,
        0.001,
        0.0,
        1.0,
    )
    assert asked.at_drawings == (asked,)
    assert ask(street.site, sensors=0, failing=1).sensors == 0  # refused in words of its own
    monkeypatch.setattr(
        questions, "redraw", lambda site, seed: replace(site, name=f"{site.name} {seed}")
    )
    several = ask(replace(street.site, furnished="dense"), drawings=3).at_drawings
    assert [each.drawings for each in several] == [3, 1, 1]
    assert [each.site.name for each in several] == ["street", "street 7001", "street 7002"]


def test_results_at_drawings_come_through_and_the_cheapest_that_just_reaches_counts(street):
    """Both sets find two of four cars; the second is cheaper."""
    options = tuple(
        PlanOption(
            (name,), price, 1.0, 1.0, 0.5, Judgement(0.5, 0.4, 0.6, 0.5, 1.0, 32, 8), poles=(name,)
        )
        for name, price in (("a", 2.0), ("b", 1.0))
    )
    both = replace(street.judge, drawings=(street.judge,))
    choice = Choice(options, np.array([[1, 1, 0, 0], [1, 0, 0, 0]], bool), 0, 0, (), "best")
    results = choosing.choose_at_drawings(both, choice, 0.5)  # 0.75 and 0.5, to reach just 0.5
    assert [(each.judged.ap, each.poles) for each in results] == [(0.75, ("b",))] * 2
    results = choosing.choose_at_drawings(both, choice, 0.76)  # none reaches it, so the best
    assert [each.poles for each in results] == [("a",)] * 2
    assert results[0] == DrawingResult(results[0].judged, ("a",))


def test_sets_near_the_best_are_listed_from_the_cheapest(street):
    options = tuple(
        PlanOption((name,), price, 1.0, 1.0, 0.5, None)
        for name, price in (("a", 3.0), ("b", 1.0), ("c", 2.0))
    )
    choice = Choice(options, SETS, 0, 0, (0, 2, 1), "best")
    assert [option.sensors for option in choice.near_optimal] == [("b",), ("c",), ("a",)]


def test_pictures_are_drawn_by_the_seed(street, spy):
    class Dense(type(street.detected.renders)):  # type: ignore[misc]
        def clouds(self, k, c):
            return np.random.default_rng(c).normal(size=(200, 3)).astype(np.float32)

    detected = Detected(
        Dense(street.site, street.detected.renders.sensors), street.detected.detector, "early"
    )
    calls = spy(moments, "build_scene_moment")
    pick_moments(detected, (0,), count=1)
    pick_moments(detected, (0,), count=2, points=9, seed=5)
    # frame, points and seed
    assert [call.args[2:] for call in calls] == [(0, 2500, 0), (0, 9, 5), (1, 9, 5)]


def test_what_is_refused_alone_is_not_built_whatever_it_sends(street):
    """The four cost 11, 11, 10.5 and 23."""
    poor = street.objective.with_weights(street.objective.weights, most_price=11.0)
    assert buildable.find_buildable(poor, None).tolist() == [0, 1, 2]
    least = float(poor.sent.min())
    assert buildable.find_buildable(poor, least).tolist() == [
        c for c in range(3) if poor.sent[c] == least
    ]


def test_a_number_that_is_none_never_gets_into_a_plan(monkeypatch):
    monkeypatch.setattr(plan_writing, "replace_infinite", lambda values: values)
    with pytest.raises(ValueError, match="not JSON compliant"):
        plan_writing.format_json(replace(WHOLE, question={"money": math.nan}))


def test_false_alarms_where_nothing_is_to_be_found_have_no_precision():
    alarms = Tally(np.array([0.9]), np.array([False]), np.array([1]), np.zeros(4, np.int64))
    judged = judging.judge_tallies([[alarms]], VEHICLES, 0)
    assert (judged.precision, judged.vehicles, judged.frames) == (None, 0, 4)
    assert np.isnan([judged.ap, judged.recall]).all()
    one = Tally(np.array([0.9]), np.array([False]), np.array([1]), np.array([1, 0, 0, 0]))
    assert judging.judge_tallies([[one]], VEHICLES, 0).precision == 0.0


def test_failures_and_levels_alone_are_judged_at_the_first_profile(street):
    """Where sensor 0 is blind, 0 and 1 find two of four cars; exact, without 1 or 0 they do."""

    class Hazy(type(street.detected.renders)):  # type: ignore[misc]
        def clouds(self, k, c):
            return super().clouds(k, c)[: 0 if c == 0 else None]

    rough = Detected(
        Hazy(street.site, street.detected.renders.sensors), street.detected.detector, "early"
    )
    cases = Cases(failing=1, levels=2, errors=("paper", "poor"))
    judge = Judge((street.detected, rough), cases, levels=(np.arange(4), np.arange(4, 8)))
    ((found,), _) = judge.judge_cases(np.array([[1, 1, 0, 0]], bool))
    figures = [each.ap for each in (found.judged, found.over_levels, found.left, found.over_errors)]
    assert figures == [0.75, 0.75, 0.5, 0.0]
    other = judge.of_classes(Classes(("pedestrian",)))
    assert (other.levels, other.drawings, other.cases, len(other.profiles)) == (
        (),
        (),
        judge.intact,
        1,
    )


def test_other_classes_that_the_detector_knows_are_judged_too(street):
    class Knowing:
        labels, digest = ("vehicle", "pedestrian", "heavy"), "knowing"

        def __call__(self, points, /):
            walker = Detections(
                np.array([[5.0, -5.0, 0.9, 0.6, 0.6, 1.8, 0.0]]), np.array([0.4]), np.array([2])
            )
            return Detections.merge([street.detected.detector(points), walker])

    judge = Judge((Detected(street.detected.renders, Knowing(), "early"),))
    (walker,) = judge.by_other_class((0, 1))
    assert (walker.label, walker.weight, walker.judged.ap, walker.judged.vehicles) == (
        "pedestrian",
        0.0,
        1.0,
        8,
    )
    assert (
        street.judge.by_other_class((0, 1)) == ()
    )  # of a detector that does not say what it knows


def test_an_answer_as_good_as_the_best_is_set_beside_it(ask, street):
    judged = Judgement(0.91, 0.85, 0.95, 0.92, 0.9, 812, 120)
    best = PlanOption(("a", "b"), 2.0, 5.0, 10.0, 0.9, judged)
    cheap = PlanOption(("a",), 1.0, 5.0, 5.0, 0.8, replace(judged, ap=0.905))
    made = replace(WHOLE, best=best, considered=(best, cheap))
    for rule, said in (("as good", True), ("best", False)):
        lines = sentences.explain_choice(
            ask(street.site), made, cheap, rule, considered=9, fidelity="surrogate"
        )
        beside = "The best set, 2 sensors, has AP 0.910 for the price of 2 ordinary poles, +0.005."
        assert (beside in lines) is said
        assert "No other is surely within 0.01 of the best on the same frames." in lines


def test_no_part_of_a_plan_is_left_out(staged, street):
    """All but what the question does not ask for: levels, error profiles, drawings."""
    named = zip(("narrow", "wide"), street.candidates.axes.models, strict=True)
    models = tuple(PricedModel(name, model, 0.0) for name, model in named)
    rates = {"permit": 7.0}
    catalogue = SensorCatalogue(models, "EUR", 1.0, rates=rates, report={"title": "Street"})
    made = staged.plan(catalogue=catalogue).plan
    asked = {"by_level", "by_errors", "by_draw", "by_drawing", "near_optimal", "blind_streets"}
    asked |= {"confidence", "motion"}  # of 8 frames; the street has no network
    assert {each.name for each in fields(made) if not getattr(made, each.name)} == asked
    assert (made.currency, made.head) == ("EUR", {"title": "Street"})
    assert [sensor.model for sensor in made.sensors] == ["narrow", "narrow"]
    assert sum(item.price for item in made.running) == 14.0
    assert [link.mbit_s for link in made.links] == pytest.approx([0.048, 0.048])
    assert made.origins["mapped"] == {"pole": 4}
    assert [(row.label, row.judged.ap) for row in made.class_ap] == [("vehicle", 0.75)]
    assert {name for row in made.by_class for name in [row.label]} == set(LABELS)
    assert made.best.counted.ap == 0.75
    assert "No cheaper set is surely within 0.01 of it" in " ".join(made.why)


def test_the_search_has_the_pool_that_was_narrowed(staged, street, fail, spy, monkeypatch):
    monkeypatch.setattr(buildable, "narrow_pool", lambda setting, run: [1, 3])
    fail(entrant_search, "Preparation", KeyError("far enough"))
    calls = spy(entrant_search, "Preparation")
    with pytest.raises(KeyError, match="far enough"):
        staged.plan()
    (call,) = calls
    assert call.args[0].candidates.sensors == tuple(street.candidates.sensors[k] for k in (1, 3))


@pytest.mark.parametrize(("share", "of"), [(0.125, np.min), (1.0, np.max)])
def test_links_carry_the_share_of_frames_that_was_asked_for(staged, street, monkeypatch, share, of):
    kbit = np.linspace(100.0, 800.0, 2 * 8).reshape(2, 8)
    monkeypatch.setattr(judging.Judge, "kbit", lambda judge, members, frames=None: kbit)
    made = staged.plan(link_share=share).plan
    assert [link.load_mbit_s for link in made.links] == pytest.approx(
        (of(kbit, axis=1) * 10.0 / 1000.0).tolist()
    )


def test_results_of_drawings_are_part_of_the_plan(staged, monkeypatch):
    result = DrawingResult(Judgement(0.5, 0.4, 0.6, 0.5, 1.0, 32, 8), ("post1",))
    asked = []

    def noted(judge, choice, min_ap):
        asked.append((judge, choice.members, min_ap))
        return (result,)

    monkeypatch.setattr(planning, "choose_at_drawings", noted)
    assert staged.plan(min_ap=0.7).plan.by_drawing == (result,)
    assert asked == [(staged.judge, (0, 1), 0.7)]


def test_judges_are_over_all_drawings_by_the_seed_of_the_question(street, monkeypatch):
    monkeypatch.setattr(
        Judge,
        "from_preparation",
        staticmethod(lambda prepared, seed: replace(street.judge, seed=seed)),
    )
    each = [
        SimpleNamespace(judge_setting=lambda candidates, n=n: (n, candidates)) for n in range(2)
    ]
    asked: Any = SimpleNamespace(at_drawings=each, run=Run(seed=5))
    objectives: Any = [SimpleNamespace(candidates="a"), SimpleNamespace(candidates="b")]
    made, judge = prepare_judge(asked, objectives, Run(seed=9))
    prepared: Any = made
    assert (prepared.setting, prepared.run) == ((0, "a"), Run(seed=9))
    assert (judge.seed, [other.seed for other in judge.drawings]) == (5, [5])


def test_ignored_detections_count_in_no_group(street):
    scored = scored_boxes.score_boxes(street.judge, (0, 2))
    ghost = scored.hits[0] == FALSE_ALARM
    assert ghost.sum() == 8

    def side(boxes):
        return (boxes[:, 0] > -6).astype(np.int64)

    ignored = replace(scored, hits=np.where(ghost, IGNORED, scored.hits))
    rows = breakdowns.by_group(ignored, ["west", "east"], side, 0)
    assert [row.judged.precision for row in rows] == [1.0, 1.0]
    assert rows[0].judged.ap == 1.0


def test_points_of_pictures_are_thinned_by_frame_and_sensor(street, spy):
    calls = spy(moments, "thin")
    pick_moments(street.detected, (0, 2), count=1, points=9, seed=5)
    asked = [(len(cloud), points, seed) for (cloud, points, seed), _ in calls]
    assert asked == [(50, 9, [5, 0, 0]), (50, 9, [5, 0, 2])]


@pytest.mark.parametrize(("vehicles", "few"), [(99, True), (100, False)])
def test_levels_with_few_road_users_are_named(vehicles, few):
    judged = Judgement(0.9, 0.8, 1.0, 0.9, 0.9, vehicles, 120)
    rows = [BreakdownRow("thin traffic", judged), BreakdownRow("none", None)]
    said = " ".join(sentences.list_unknowns(judged, rows))
    assert (f"What holds at thin traffic ({vehicles}): fewer than 100" in said) is few
    assert "How far" not in said


def test_intervals_are_of_the_seed_and_where_all_is_found_wilsons(street, limits):
    """Eighty frames: in half of each block of four sensor 0 is blind, so that resamples differ by
    the seed."""

    class Long(type(street.detected.renders)):  # type: ignore[misc]
        def clouds(self, k, c):
            return super().clouds(k, c)[: 0 if c == 0 and k // 4 % 2 else None]

    renders = Long(street.site, street.detected.renders.sensors, frames=80)
    detected = Detected(renders, street.detected.detector, "early")
    row = np.array([[1, 0, 0, 0]], bool)
    first, again, other = (
        Judge((detected,), seed=seed).judge_drawn(row, Cases())[1] for seed in (0, 0, 1)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    # half of four in every frame
    (found,) = Judge((detected,)).judge(np.array([[0, 1, 0, 0]], bool))
    # 320 vehicles, each in four frames
    wilson = binomtest(40, 80).proportion_ci(0.95, method="wilson")
    assert (found.low, found.high) == pytest.approx((wilson.low, wilson.high))
    limits(judging, CONFIDENCE=0.8)
    (found,) = Judge((detected,)).judge(np.array([[0, 1, 0, 0]], bool))
    wilson = binomtest(40, 80).proportion_ci(0.8, method="wilson")
    assert (found.low, found.high) == pytest.approx((wilson.low, wilson.high))


def test_a_set_just_near_the_highest_ap_may_be_best(street):
    """Within three quarters of the tolerance the greater mean AP decides, also at just that."""
    highest, least = 1.0, 1.0 - NEAR_TIE_AP
    options = tuple(
        PlanOption(
            (name,), 1.0, 1.0, 1.0, 0.5, Judgement(ap, 0.9, 1.0, ap, 1.0, 320, 80), mean_ap=mean
        )
        for name, ap, mean in (
            ("a", highest, 0.7),
            ("b", least, 0.8),
            ("c", np.nextafter(least, 0), 0.9),
        )
    )
    draws = {i: np.linspace(0.0, 1.0, 100) ** (i + 1) for i in range(3)}
    assert choose(options, draws)[0] == 1


def test_a_hit_of_the_very_first_vehicle_counts_in_its_group(street):
    scored = scored_boxes.score_boxes(street.judge, (0,))
    assert (scored.hits == 0).sum() == 1
    far = scored.boxes.copy()
    far[scored.hits[0] == 0, 0] = (
        40.0  # the detection lies in the other group, the vehicle does not
    )
    rows = breakdowns.by_group(
        replace(scored, boxes=far),
        ["west", "east"],
        lambda boxes: (boxes[:, 0] > 20).astype(int),
        0,
    )
    assert (rows[0].judged.recall, rows[1].judged) == (0.5, None)


def test_races_have_the_confidence_and_the_seed_and_sets_just_near_the_best_are_judged(
    street, limits, monkeypatch
):
    """Of one sensor each, sets end at 1, 0.75 and just below; a quarter is near."""
    asked = []

    def ended(objective, sets, evaluator, **given):
        asked.append(given)
        expected = np.array([1.0, 0.75, np.nextafter(0.75, 0)])
        return Contest(np.arange(3), expected, np.full(3, 8), 0.8, 24, expected)

    monkeypatch.setattr(size_races, "contest", ended)
    monkeypatch.setattr(
        judged_options, "check_agreement", lambda *_: None
    )  # of AP that are made up
    limits(size_races, NEAR_AP=0.25)
    sets = np.eye(4, dtype=bool)[:3]
    found = Entrants(sets, np.zeros(3), ((),) * 3, 3)
    choice = choosing.choose_set(
        street.objective, found, street.judge, confidence=0.6, run=Run(seed=5)
    )
    rules = {"confidence": 0.6, "seed": 5, "frames": size_races.MAX_RACED_FRAMES}
    assert asked == [{**rules, "best_elsewhere": -math.inf}]
    assert [option.judged is not None for option in choice.options] == [True, True, False]
    assert choice.confidence is None  # of 8 frames


def test_other_iou_thresholds_say_which_likely_ties_are_judged():
    """Of six sets in the order of their race, the last is too far behind; means are those of the
    shared frames."""
    expected = 1.0 - reward_race.LIKELY_TIE_AP * np.array([0.0, 0.1, 0.2, 0.3, 1.0, 1.01])
    ran = Contest(np.arange(6), expected, np.array([24, 24, 12, 12, 12, 12]), 0.8, 24, expected)
    asked = []

    def mean_ap(sets, frames):
        asked.append((sets.argmax(axis=1).tolist(), frames.tolist()))
        return np.array([0.5, 0.6, 0.4, 0.7])

    evaluator: Any = SimpleNamespace(mean_ap=mean_ap)
    found = reward_race.find_finalists(ran, np.eye(6, dtype=bool), evaluator, np.arange(60))
    assert found.tolist() == [0, 4, 2]
    assert asked == [([1, 2, 3, 4], list(range(12)))]
    alone = replace(ran, expected=expected - np.array([0.0, 1, 1, 1, 1, 1]))
    assert reward_race.find_finalists(
        alone, np.eye(6, dtype=bool), evaluator, np.arange(60)
    ).tolist() == [0, 1, 2]


def test_what_may_be_built_at_every_drawing_is_kept_in_the_order_of_the_first(street):
    """At the second drawing sensor 3 is too dear, at the third sensor 0 sends too much."""

    class Pool:
        def __init__(self, place):
            self.place = place

        def select(self, rows):
            return self.place, rows.tolist()

    first, second, third = (
        street.objective.with_weights(street.objective.weights) for _ in range(3)
    )
    second = second.with_weights(second.weights, most_price=11.0)
    rows = {id(first): [0, 1, 2, 3], id(second): [0, 1, 2], id(third): [1, 2, 3]}
    prepared: Any = [
        SimpleNamespace(setting=SimpleNamespace(pool=Pool(k)), visibility=Pool(-k))
        for k in (1, 2, 3)
    ]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(buildable, "find_buildable", lambda each, most: np.array(rows[id(each)]))
        kept: Any = buildable.keep_buildable(prepared, [first, second, third], None)
        assert kept == [((k, [1, 2]), (-k, [1, 2])) for k in (1, 2, 3)]
        alone: Any = buildable.keep_buildable(prepared[:1], [first], None)
        assert alone == [((1, [0, 1, 2, 3]), (-1, [0, 1, 2, 3]))]
        two: Any = buildable.keep_buildable(prepared[:2], [first, second], None)
        assert two[0] == ((1, [0, 1, 2]), (-1, [0, 1, 2]))


class Blind:
    digest = "blind"

    def __call__(self, points, /):
        return Detections.empty()


def test_a_detector_that_is_blind_at_one_stage_stops_the_plan(street, ask):
    frames = type(street.detected.renders)(street.site, street.detected.renders.sensors, 48)

    def judge(detector):
        return judging.Judge((Detected(frames, detector, "early"),))

    found = Entrants(SETS, street.objective.scores(SETS).ap, ((),) * len(SETS), 30)
    sound, blind = (judge(detector) for detector in (street.detected.detector, Blind()))
    choices = [choosing.choose_set(street.objective, found, each) for each in (sound, blind)]
    ((judged,), _) = sound.judge_cases(choices[0].sets[[choices[0].chosen]])
    ((unseen,), _) = blind.judge_cases(choices[0].sets[[choices[0].chosen]])
    findings: Any = [
        SimpleNamespace(choice=each, question=ask(street.site), objective=street.objective)
        for each in choices
    ]
    check_stages(findings[0], judged.judged)
    check_stages(findings[1], unseen.judged)
    with pytest.raises(
        ValueError, match=r"AP 0\.000 in the comparison \(192 .*, but AP 0\.\d+ in the judgement"
    ):
        check_stages(findings[1], judged.judged)
    with pytest.raises(
        ValueError, match=r"AP 0\.\d+ in the comparison .*, but AP 0\.000 in the judgement"
    ):
        check_stages(findings[0], unseen.judged)
    known = judged_options.JudgedOptions(street.objective, found, sound)
    known.judge_rows([2])
    with pytest.raises(
        ValueError, match=r"AP 0\.00 in the race \(96 to find in 24 frames\), but AP 0\."
    ):
        known.check_race(2, 0.0, np.arange(24))
    divided = Judge((Detected(frames, street.detected.detector, "early"),), Cases(levels=2))
    worst = judged_options.JudgedOptions(street.objective, found, divided)
    worst.judge_rows([2])
    worst.check_race(2, 0.0, np.arange(24))  # the worst of several cases is not compared


def test_judging_of_the_closest_sets_and_of_the_schemes_is_counted_frame_by_frame(street):
    found = Entrants(SETS, street.objective.scores(SETS).ap, ((),) * len(SETS), 30)
    frames = type(street.detected.renders)(street.site, street.detected.renders.sensors, 48)
    judge = judging.Judge((Detected(frames, street.detected.detector, "early"),))
    told: list[tuple[str, int, int | None]] = []
    run = Run(progress=lambda *stage: told.append(stage))
    choice = choosing.choose_set(street.objective, found, judge, run=run)
    assert {("frames of the closest sets", done, 48) for done in range(1, 25)} <= set(
        told
    )  # the race saw the others
    chosen_set.ChosenSet(
        choice.members, choice.option.sensors, judge, street.objective, run
    ).schemes()
    assert {("frames of the fusion schemes", done, 48) for done in range(1, 49)} <= set(told)


def test_sureness_is_that_of_the_chosen_set_on_all_frames_and_never_below_what_the_judgement_shows(
    street,
):
    found = Entrants(SETS, street.objective.scores(SETS).ap, ((),) * len(SETS), 30)
    frames = type(street.detected.renders)(street.site, street.detected.renders.sensors, 48)
    judge = judging.Judge((Detected(frames, street.detected.detector, "early"),))
    choice = choosing.choose_set(street.objective, found, judge)
    assert choice.confidence is not None
    assert 0 <= choice.confidence <= 1
    perfect = Judgement(1.0, 0.99, 1.0, 1.0, 1.0, 400, 120)
    assert answer.judge_sureness(0.19, perfect, np.ones(100)) == 1.0
    assert answer.judge_sureness(0.19, replace(perfect, low=np.nan), np.ones(100)) is None
    assert answer.judge_sureness(0.19, replace(perfect, low=np.nan, ap=0.9), np.ones(100)) == 0.19
    assert answer.judge_sureness(0.8, perfect, np.full(100, 0.9)) == 0.8
    assert answer.judge_sureness(None, perfect, np.ones(100)) is None
