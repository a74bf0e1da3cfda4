"""coview what-if: before and after, at a site and in the folder of a plan, and what it refuses."""

import json

import pytest

COMMON = ("--frames", 8, "--cache", "None")


def test_before_and_after_of_a_site(run):
    code, out, _ = run("what-if", "tjunction", "--drop", "d2", "--carry", "d0", "pole05", *COMMON)
    assert code == 0
    rows = {line.split("  ")[0]: line.split() for line in out.splitlines()}
    assert rows["price"][-3:] == ["6", "5", "-1"]
    assert "predicted by the surrogate" in out
    assert "no interval from fewer than" in out


def test_the_same_figures_as_json(run):
    asked = ("what-if", "tjunction", "--move", "d0", 10, 12, "--add", "pole07", 200, 15, "--fail", "d3", *COMMON)
    _, out, _ = run(*asked, "--json")
    found = json.loads(out)
    assert found["before"]["sensors"] == 6
    assert found["after"]["sensors"] == 7
    assert found["after"]["change"] == pytest.approx(found["after"]["ap"] - found["before"]["ap"])


def test_a_plan_brings_its_sensors_poles_and_frames(tmp_path, run):
    poles = [("north", [3.0, 22.0]), ("south", [7.6, -21.8]), ("spare", [7.6, 22.0])]
    features = [
        {"type": "Feature", "properties": {"name": name}, "geometry": {"type": "Point", "coordinates": at}}
        for name, at in poles
    ]
    (tmp_path / "poles.geojson").write_text(
        json.dumps({"type": "FeatureCollection", "coview_site": 1, "features": features})
    )
    stock = ("--candidates", tmp_path / "poles.geojson", "--frames", 3, "--workers", 1)
    cache = ("--cache", tmp_path / "cache")
    assert run("plan", "tjunction", "--budget", 2, "--money", 2.5, *stock, *cache, "--out", tmp_path / "plan")[0] == 0
    made = json.loads((tmp_path / "plan" / "plan.json").read_text())
    (unused,) = {name for name, _ in poles} - {sensor["pole"] for sensor in made["sensors"]}
    moved = ("--carry", made["sensors"][0]["name"], unused)
    code, out, _ = run("what-if", tmp_path / "plan", *moved, *cache, "--json")
    found = json.loads(out)
    assert code == 0
    assert (found["before"]["sensors"], found["before"]["frames"]) == (2, 3)
    assert found["before"]["budget"] == 2.5
    assert "coview live FOLDER" in (tmp_path / "plan" / "report.html").read_text()
    assert found["before"]["ap"] == pytest.approx(made["chosen"]["predicted"], abs=0.005)
    assert found["before"]["kbit"] == pytest.approx(made["chosen"]["kbit"], rel=0.5)  # that is of other traffic
    assert unused in {link["pole"] for link in found["after"]["links"]}
    assert found["before"]["problems"] == []
    more = json.loads(run("what-if", tmp_path / "plan", "--add", unused, 0, 10, *cache, "--json")[1])
    assert "it has 3 sensors, more than the 2 of its plan" in more["after"]["problems"]


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
    code, _, err = run("what-if", *(str(tmp_path) if each == "{folder}" else each for each in options), *COMMON)
    assert code == 2
    assert said in err
    assert len(err.strip().splitlines()) == 1
