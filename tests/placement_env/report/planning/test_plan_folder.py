"""Folders of plans: everything comes back, and what does not fit is refused with file, member, rule
and value."""

import importlib.util
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from placement_env import LivePlanner
from placement_env.cases import Cases
from placement_env.report.content import PLAN_VERSION, Judgement
from placement_env.report.planning import plan_stock
from placement_env.report.planning.plan_folder import (
    found_nothing,
    is_plan_folder,
    read_plan_folder,
    read_stated_results,
)
from placement_env.report.planning.question import Question, Stock
from placement_env.setting import Setting
from toolkit.runtime.run import Run

SCRIPT = Path(__file__).parents[3] / "mutations/plan_formats.py"
SPEC = importlib.util.spec_from_file_location("plan_formats", SCRIPT)
PLANS = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(PLANS)


@pytest.fixture(scope="module")
def question():
    return PLANS.make_question()


@pytest.fixture
def folder(question, tmp_path):
    PLANS.write_plan_folder(question, [3, 500], tmp_path / "plan")
    return tmp_path / "plan"


def test_setting_and_run_come_back(question, folder):
    found = read_plan_folder(folder)
    before, after = question.setting, found.setting
    assert (after.cases, after.counted, after.fusion, after.codec) == (
        before.cases,
        before.counted,
        before.fusion,
        before.codec,
    )
    assert (after.most_price, found.sensors, found.frames, found.seed) == (9000.0, 3, 3, 5)


def test_the_stock_comes_back_with_its_sensors_and_poles(question, folder):
    found, before = read_plan_folder(folder), question.setting
    after = found.setting
    stock, pool, again = after.candidates, before.pool, after.pool
    assert stock.catalogue == replace(PLANS.CATALOGUE, report={"client": "City of Elm"})
    assert [area.wkt for area in stock.keep_out] == [area.wkt for area in PLANS.KEEP_OUT]
    assert [sensor.name for sensor in again.sensors] == [sensor.name for sensor in pool.sensors]
    assert again.axes.prices == pool.axes.prices == (1500.0, 4000.0)
    assert [(m.name, m.price, m.capacity) for m in again.mounts] == [
        (m.name, m.price, m.capacity) for m in pool.mounts
    ]
    assert {mount.capacity for mount in again.mounts} == {1234.0}
    np.testing.assert_allclose(
        [s.pose for s in again.sensors], [s.pose for s in pool.sensors], atol=1e-9
    )
    assert [sensor.name for sensor in after.place.sensors] == [
        pool.mounts[pool.mount[k]].name for k in (3, 500)
    ]


def test_stated_figures_come_back(folder):
    found = read_plan_folder(folder)
    assert (found.stated.ap, found.stated.errors, found.stated.predicted) == (0.75, "typical", 0.7)
    assert math.isnan(found.stated.low)
    assert found.stated.objects == 70


def test_sensors_that_hang_already_come_back_in_their_poses(tmp_path):
    question = Question(Setting("tjunction", candidates=Stock(candidates="paper")), Run(frames=2))
    PLANS.write_plan_folder(question, [1, 4], tmp_path / "plan")
    found, pool = read_plan_folder(tmp_path / "plan").setting.pool, question.setting.pool
    assert [sensor.name for sensor in found.sensors] == [sensor.name for sensor in pool.sensors]
    np.testing.assert_allclose(
        [s.pose for s in found.sensors], [s.pose for s in pool.sensors], atol=1e-8
    )
    assert found.mount.tolist() == pool.mount.tolist()
    assert found.axes.prices == ()


def test_a_class_keeps_its_own_iou_and_the_usual_one_stays_usual(question, tmp_path):
    classes = replace(question.setting.counted, ious=(None, 0.3))
    asked = replace(question, setting=replace(question.setting, classes=classes))
    PLANS.write_plan_folder(asked, [3], tmp_path / "plan")
    assert read_plan_folder(tmp_path / "plan").setting.counted == classes


def test_the_planner_opens_the_folder_and_states_its_figure(folder):
    planner = LivePlanner(folder)
    assert planner.frames == 3
    answer = planner.answer()
    assert (answer.currency, answer.budget) == ("EUR", 9000.0)
    assert answer.price == sum(2 * [900.0]) + sum(planner.yard.stock.model_prices[[3, 500]])
    assert planner.stated.ap == 0.75
    planner.ask(cases=Cases(iou=0.7))
    assert planner.stated is None
    assert planner.most_sensors == 3


def put(*path):
    *keys, last, value = path

    def damage(plan):
        node = plan
        for key in keys:
            node = node[key]
        node[last] = value

    return damage


def drop(*path):
    *keys, last = path

    def damage(plan):
        node = plan
        for key in keys:
            node = node[key]
        del node[last]

    return damage


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (drop("coview_plan"), "it has no coview_plan, so it is of an earlier coview"),
        (put("coview_plan", PLAN_VERSION + 1), "this coview reads up to 1: install a newer one"),
        (put("coview_plan", 0), "coview_plan must be 1, got 0"),
        (put("coview_plan", True), "coview_plan must be a whole number, got 'True'"),
        (put("chosen", None), r"the plan has no set of sensors to go on from \(A sentence\.\)"),
        (drop("chosen"), "chosen is missing"),
        (put("chosen", "judged", "ap", 1.5), "chosen.judged.ap must be from 0 to 1, got 1.5"),
        (put("question", []), "question must be an object"),
        *(
            (drop("question", key), f"question.{key} ")
            for key in ("scheme", "errors", "iou", "seed", "frames", "money")
        ),
        (put("question", "iou", 7), "iou must lie in"),
        (put("question", "iou", []), "IoU thresholds must be one or several"),
        (
            put("question", "errors", ["own"]),
            "question.errors has a profile 'own' that is not one of paper",
        ),
        (put("question", "scheme", "psychic"), "question.scheme must be one of early"),
        (
            put("question", "codec", "zip"),
            "question.codec must belong to paper or range-images, got 'zip'",
        ),
        (put("question", "money", -1), "question.money must be from 0 to 1e.15, got -1"),
        (put("question", "frames", [3, 3]), "question.frames must be 3 numbers, got 2"),
        (
            put("question", "frames", [0, 3, 3]),
            "question.frames must be three whole numbers from 1",
        ),
        (
            put("question", "frames", [1e9, 3, 3]),
            "question.frames must be three whole numbers from 1",
        ),
        (
            put("question", "class_ious", [0.5]),
            "class_ious must hold one for each of vehicle, pedestrian, got 1",
        ),
        (put("question", "keep", ["nobody"]), "no sensor may stand on a pole 'nobody'"),
        (put("sensors", [None]), r"sensors\[0\] must be an object"),
        (put("sensors", []), "plan and site must have the same sensors"),
        (put("sensors", 0, "pole", "moon"), r"sensors\[0\].pole must be one of post00"),
        (put("sensors", 0, "pole", "post05"), "m from its pole post05, more than 1.5 m"),
        (put("stock", {}), "stock.poles is missing"),
        (put("stock", "poles", []), "stock must hold a pole and a model"),
        (
            put("stock", "poles", 2, "x", 1e300),
            r"stock.poles\[2\].x must be from -1e.08 to 1e.08, got 1e.300",
        ),
        (
            put("stock", "poles", 2, "price", "much"),
            r"stock.poles\[2\].price must be a finite number, got much",
        ),
        (put("stock", "poles", 2, "name", "post00"), "must differ, got 'post00' twice"),
        (
            put("stock", "models", 0, "price", None),
            "stock.models must all have a price where there is a catalogue",
        ),
        (
            put("stock", "models", 0, "model", "type", "Eye"),
            r"stock.models\[0\].model.type must be one of",
        ),
        (put("stock", "headings", 10**9), "stock.headings must be a whole number from 1 to 360"),
        (put("stock", "tilts_deg", [200]), "tilts must lie in"),
        (
            put("stock", "keep_out_wkt", ["POINT (0 0)"]),
            r"stock.keep_out_wkt\[0\] must be a sound polygon",
        ),
        (
            put("stock", "keep_out_wkt", ["somewhere"]),
            r"stock.keep_out_wkt\[0\] must be a polygon as well-known text",
        ),
        (put("stock", "sensors", []), "stock.sensors must hold one sensor or more"),
        (put("stock", "catalogue", "rates", {"tea": 1}), "stock.catalogue.rates.tea is unknown"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(folder, damage, said):
    path = folder / "plan.json"
    content = json.loads(path.read_text())
    damage(content)
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=said) as refusal:
        read_plan_folder(folder)
    assert str(path) in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_what_costs_nothing_comes_back(folder):
    path = folder / "plan.json"
    content = json.loads(path.read_text())
    stock = content["stock"]
    stock["catalogue"] |= {"pole_price": 0, "years": 0, "rates": {"cable": 0}}
    stock["poles"][0] |= {"price": 0, "min_height": 0}
    stock["models"][0]["price"] = 0
    content["question"] |= {"money": 0, "seed": 0}
    path.write_text(json.dumps(content))
    plan = read_plan_folder(folder)
    stock = plan.setting.candidates
    assert (stock.catalogue.pole_price, stock.catalogue.years) == (0.0, 0.0)
    assert stock.catalogue.rates == {"cable": 0.0}
    assert plan.setting.pool.axes.prices == (0.0, 4000.0)
    assert (plan.setting.pool.mounts[0].price, plan.setting.pool.mounts[0].min_height) == (0.0, 0.0)
    assert (plan.setting.most_price, plan.seed) == (0.0, 0)


def test_a_stock_of_too_many_poses_is_refused_with_their_number(folder):
    path = folder / "plan.json"
    content = json.loads(path.read_text())
    stock = content["stock"]
    stock["headings"] = 360
    stock["tilts_deg"] = np.linspace(0.0, 80.0, 41).tolist()
    path.write_text(json.dumps(content))
    poses = len(stock["poles"]) * len(stock["heights_m"]) * 360 * 41 * len(stock["models"])
    assert len(stock["models"]) == 2
    with pytest.raises(ValueError, match=f"at most 400000 poses, got {poses}: leave out poles"):
        read_plan_folder(folder)


def test_more_keep_out_areas_than_the_limit_are_refused(folder, limits):
    path = folder / "plan.json"
    content = json.loads(path.read_text())
    areas = content["stock"]["keep_out_wkt"]
    limits(plan_stock, MAX_KEEP_OUT_AREAS=len(areas))
    read_plan_folder(folder)
    areas.append(areas[0])
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=f"hold at most {len(areas) - 1} areas"):
        read_plan_folder(folder)


def test_what_is_no_folder_of_a_plan_is_said(folder, tmp_path):
    assert is_plan_folder(folder)
    assert not is_plan_folder(folder / "plan.json")
    assert not is_plan_folder("tjunction")
    with pytest.raises(
        FileNotFoundError, match=r"is no folder of a plan: it needs plan\.json and site\.json"
    ):
        read_plan_folder(tmp_path)
    (folder / "site.json").unlink()
    with pytest.raises(FileNotFoundError, match=r"site\.json is missing"):
        read_plan_folder(folder)


@pytest.mark.parametrize(
    ("text", "nothing"),
    [
        ('{"verdict": {"met": false}}', True),
        ('{"verdict": {"met": null}}', False),
        ("[1]", False),
        ("{", False),
    ],
)
def test_a_plan_that_found_nothing_may_be_replaced(text, nothing, tmp_path):
    (tmp_path / "plan.json").write_text(text)
    assert found_nothing(tmp_path / "plan.json") is nothing
    assert not found_nothing(tmp_path / "none.json")


JUDGED_VEHICLES: dict[str, Any] = {
    "ap": 0.91,
    "low": 0.88,
    "high": 0.94,
    "recall": 0.93,
    "precision": 0.97,
    "vehicles": 312,
    "frames": 120,
    "kind": "vehicle",
}
STATED_VEHICLES = {"label": "vehicle", "weight": 1.0, "iou": 0.7, "judged": JUDGED_VEHICLES}


@pytest.fixture
def stated(tmp_path):
    """Write the results of classes as a plan states them, and read them again."""

    def write(*rows):
        (tmp_path / "plan.json").write_text(json.dumps({"detector": "general", "class_ap": rows}))
        return read_stated_results(tmp_path)

    return write


def test_results_of_classes_are_read_as_they_are_stated(stated):
    results = stated(STATED_VEHICLES)
    assert results.detector == "general"
    (vehicles,) = results.classes
    assert (vehicles.label, vehicles.weight, vehicles.iou) == ("vehicle", 1.0, 0.7)
    assert vehicles.judged == Judgement(**JUDGED_VEHICLES)


def test_results_without_an_interval_have_none(stated):
    judged = JUDGED_VEHICLES | {"low": None, "high": None, "precision": None}
    (vehicles,) = stated(STATED_VEHICLES | {"judged": judged, "iou": [0.7, 0.8]}).classes
    assert vehicles.iou == (0.7, 0.8)
    assert math.isnan(vehicles.judged.low)
    assert math.isnan(vehicles.judged.high)
    assert vehicles.judged.precision is None


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"ap": 1.2}, "ap must be from 0 to 1"),
        ({"recall": -0.1}, "recall must be from 0 to 1"),
        ({"vehicles": 1.5}, "vehicles must be a whole number"),
        ({"frames": 0}, "frames must be a whole number from 1"),
    ],
)
def test_a_damaged_result_of_a_class_is_refused_by_name(stated, change, said):
    judged = JUDGED_VEHICLES | change
    with pytest.raises(ValueError, match=said):
        stated(STATED_VEHICLES | {"judged": judged})
