"""coview what-if: before and after, at a site and in the folder of a plan, and what it refuses."""

import csv
import json
import re
import shutil

import pytest

from coview.main import run as run_line
from placement_env import LivePlanner
from toolkit.display import format_share

COMMON = ("--frames", 4, "--cache", "None")


def test_before_and_after_of_a_site(run):
    code, out, _ = run("what-if", "tjunction", "--drop", "d2", "--carry", "d0", "pole05", *COMMON)
    assert code == 0
    rows = {line.split("  ")[0]: line.split() for line in out.splitlines()}
    assert rows["price"][-3:] == ["6", "5", "-1"]
    assert "predicted by the surrogate" in out
    assert "no interval from fewer than" in out


def test_the_same_figures_as_json(run):
    asked = (
        "what-if",
        "tjunction",
        "--move",
        "d0",
        10,
        12,
        "--add",
        "pole07",
        200,
        15,
        "--fail",
        "d3",
        *COMMON,
    )
    _, out, _ = run(*asked, "--json")
    found = json.loads(out)
    assert found["before"]["sensors"] == 6
    assert found["after"]["sensors"] == 7
    assert found["after"]["change"] == pytest.approx(found["after"]["ap"] - found["before"]["ap"])


CATALOGUE = """currency = "EUR"
pole_price = 1000
[[sensor]]
name = "eye"
model = "DepthCamera"
price = 1500
width = 120
height = 90
"""
OPTIONS = (
    "--budget",
    2,
    "--money",
    5500,
    "--iou",
    0.5,
    "--errors",
    "typical",
    "--scheme",
    "late",
    "--capacity",
    1700,
)


@pytest.fixture(scope="module")
def plan_folder(tmp_path_factory, without_report):
    """Folder of a plan that asks for nothing usual, from three poles, one of which is never
    used."""
    folder = tmp_path_factory.mktemp("planned")
    poles = [
        ("north", [3.0, 22.0], 800),
        ("south", [7.6, -21.8], 900),
        ("spare", [7.6, 22.0], 1100),
    ]
    features = [
        {
            "type": "Feature",
            "properties": {"name": name, "price": price},
            "geometry": {"type": "Point", "coordinates": at},
        }
        for name, at, price in poles
    ]
    away = [[30, 10], [35, 10], [35, 15], [30, 15], [30, 10]]
    area = {
        "type": "Feature",
        "properties": {},
        "geometry": {"type": "Polygon", "coordinates": [away]},
    }
    collection = {"type": "FeatureCollection", "coview_site": 1}
    (folder / "poles.geojson").write_text(json.dumps({**collection, "features": features}))
    (folder / "keep-out.geojson").write_text(json.dumps({**collection, "features": [area]}))
    (folder / "sensors.toml").write_text(CATALOGUE)
    poles_file, sensors_file, areas_file = (
        folder / f for f in ("poles.geojson", "sensors.toml", "keep-out.geojson")
    )
    files = ("--candidates", poles_file, "--sensors", sensors_file, "--keep-out", areas_file)
    line = (
        "plan",
        "tjunction",
        *OPTIONS,
        *files,
        "--frames",
        3,
        "--workers",
        1,
        "--cache",
        folder / "cache",
    )
    with without_report():
        assert run_line([*map(str, line), "--out", str(folder / "plan")]) == 0
    return folder / "plan"


@pytest.fixture
def ask(plan_folder, run):
    def what_if(*changes):
        code, out, _ = run(
            "what-if", plan_folder, *changes, "--cache", plan_folder.parent / "cache", "--json"
        )
        assert code == 0
        return json.loads(out)

    return what_if


def test_a_plan_brings_its_whole_question(plan_folder, ask):
    made = json.loads((plan_folder / "plan.json").read_text())
    (unused,) = {"north", "south", "spare"} - {sensor["pole"] for sensor in made["sensors"]}
    found = ask("--carry", made["sensors"][0]["name"], unused)
    before, chosen = found["before"], made["chosen"]
    assert (before["sensors"], before["frames"], before["budget"], before["currency"]) == (
        2,
        3,
        5500,
        "EUR",
    )
    assert before["price"] == chosen["price"]
    assert before["ap"] == pytest.approx(chosen["predicted"], abs=1e-6)
    assert before["stated"]["predicted"] == chosen["predicted"]
    assert (before["stated"]["ap"], before["stated"]["errors"]) == (
        chosen["judged"]["ap"],
        "typical",
    )
    assert before["kbit"] == pytest.approx(chosen["kbit"], rel=0.5)  # that is of other traffic
    assert before["problems"] == []
    assert {link["capacity_mbit_s"] for link in before["links"]} == {17.0}


def test_a_sensor_on_another_pole_has_its_price_and_link(plan_folder, ask):
    made = json.loads((plan_folder / "plan.json").read_text())
    (unused,) = {"north", "south", "spare"} - {sensor["pole"] for sensor in made["sensors"]}
    found = ask("--carry", made["sensors"][0]["name"], unused)
    before = found["before"]
    assert unused in {link["pole"] for link in found["after"]["links"]}
    poles = {pole["name"]: pole["price"] for pole in made["stock"]["poles"]}
    left = poles[made["sensors"][0]["pole"]]
    assert found["after"]["price"] == before["price"] - left + poles[unused]
    more = ask("--add", unused, 0, 10)["after"]
    assert "it has 3 sensors, more than the 2 of its plan" in more["problems"]
    assert more["price"] == before["price"] + poles[unused] + 1500


def test_a_plans_figures_are_before_in_words(plan_folder, run):
    made = json.loads((plan_folder / "plan.json").read_text())
    line = ("what-if", plan_folder, "--cache", plan_folder.parent / "cache")
    _, out, _ = run(*line)
    judged = made["chosen"]["judged"]
    ap = format_share(judged["ap"], judged["vehicles"])
    assert re.search(rf"AP that the plan states, by its detector, errors typical +{ap}\b", out)
    assert "price in EUR" in out
    assert "that the plan states" not in run(*line, "--iou", 0.7)[1]  # another question


def test_the_rows_of_the_schedule_change_nothing(plan_folder, ask):
    with (plan_folder / "schedule.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    changes = []
    for row in rows:
        changes += [
            "--move",
            row["sensor"],
            row["bearing_deg"],
            row["tilt_deg"],
            "--lift",
            row["sensor"],
        ]
        changes.append(row["height_m"])
    found = ask(*changes)
    assert found["after"]["change"] == 0.0
    for name in ("ap", "worst", "kbit", "price", "links", "approaches"):
        assert found["after"][name] == found["before"][name]


def test_options_that_a_plan_brings_are_refused(plan_folder, refused):
    said = refused("what-if", plan_folder, "--candidates", "poles.geojson")
    assert (
        "--candidates does not go with the folder of a plan, which brings its own: leave it out"
        in said
    )


def test_an_earlier_plan_is_refused_by_name(plan_folder, refused, tmp_path):
    shutil.copytree(plan_folder, tmp_path / "old")
    content = json.loads((tmp_path / "old/plan.json").read_text())
    del content["coview_plan"]
    (tmp_path / "old/plan.json").write_text(json.dumps(content))
    for command in ("what-if", "live"):
        options = ("--out", tmp_path / "live", "--no-browser") if command == "live" else ()
        said = refused(command, tmp_path / "old", *options)
        assert "it has no coview_plan, so it is of an earlier coview" in said


def test_the_python_planner_opens_what_the_command_opens(plan_folder, ask):
    planner = LivePlanner(str(plan_folder))
    assert planner.finish().ap == pytest.approx(ask()["before"]["ap"])
    assert (
        planner.currency,
        planner.asked_setting.cases.names,
        planner.asked_setting.fusion.name,
    ) == ("EUR", ("typical",), "late")
    assert [area.bounds for area in planner.yard.keep_out] == [(30.0, 10.0, 35.0, 15.0)]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("tjunction", "--drop", "nobody"), "there is no sensor 'nobody'"),
        (("tjunction", "--add", "post00", 0, 0), "carries all the sensors"),
        (("nowhere", "--drop", "d0"), "no site 'nowhere'"),
        (("{folder}", "--drop", "d0"), "is no folder of a plan"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(tmp_path, run, options, said):
    code, _, err = run(
        "what-if", *(str(tmp_path) if each == "{folder}" else each for each in options), *COMMON
    )
    assert code == 2
    assert said in err
    assert len(err.strip().splitlines()) == 1
