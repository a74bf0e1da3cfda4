"""coview plan: what it writes, that a plan goes on where it was killed, and what it refuses, in one
line each."""

import json
from dataclasses import replace

import numpy as np
import pytest

from coview.outputs import NOT_MET
from toolkit.sites.files import load_site, save_site

PAPER = ("--candidates", "paper", "--frames", 3)
POLES = {
    "type": "FeatureCollection",
    "coview_site": 1,
    "features": [
        {
            "type": "Feature",
            "properties": {"name": name},
            "geometry": {"type": "Point", "coordinates": [x, y]},
        }
        for name, x, y in (("north", 3.0, 22.0), ("south", 7.6, -21.8))
    ],
}
CATALOGUE = (
    '[[sensor]]\nname = "eye"\nmodel = "DepthCamera"\nprice = 1500\nwidth = 120\nheight = 90\n'
)


@pytest.fixture
def poles(tmp_path):
    path = tmp_path / "poles.geojson"
    path.write_text(json.dumps(POLES))
    return path


@pytest.fixture
def catalogue(tmp_path):
    path = tmp_path / "sensors.toml"
    path.write_text(f'currency = "EUR"\npole_price = 4000\n{CATALOGUE}')
    return path


def test_a_plan_is_written_and_the_same_again(tmp_path, run, without_report):
    common = (
        "plan",
        "tjunction",
        "--budget",
        1,
        *PAPER,
        "--cache",
        tmp_path / "cache",
        "--workers",
        1,
    )
    with without_report():
        code, out, _ = run(*common, "--out", tmp_path / "a")
    assert code == 0
    assert "The best set found within the budget has AP" in out
    made = json.loads((tmp_path / "a" / "plan.json").read_text(), parse_constant=pytest.fail)
    assert len(made["sensors"]) == 1
    assert made["chosen"]["judged"]["frames"] == 3
    with without_report():
        code, out, _ = run(*common, "--out", tmp_path / "b", "--json")
    assert json.loads(out) == made
    assert (tmp_path / "a" / "plan.json").read_bytes() == (
        tmp_path / "b" / "plan.json"
    ).read_bytes()
    code, _, err = run(*common, "--out", tmp_path / "a")
    assert (code, "exists" in err) == (2, True)


RATES = (
    '[rates]\ncable = 900\npower = 60\nyears = 5\n[report]\ntitle = "Elm Street"\nclient = "City '
    'of Elm <b>"\n'
)


def test_money_buys_poles_and_sensors_of_a_catalogue(tmp_path, run, poles, catalogue):
    catalogue.write_text(catalogue.read_text() + RATES)
    code, out, _ = run(
        "plan",
        "tjunction",
        "--candidates",
        poles,
        "--sensors",
        catalogue,
        "--money",
        6000,
        "--frames",
        1,
        "--cache",
        "None",
        "--workers",
        1,
        "--out",
        tmp_path / "out",
    )
    assert code == 0, out
    made = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert made["currency"] == "EUR"
    assert [(item["item"], item["count"], item["price"]) for item in made["materials"]] == [
        ("eye", 1, 1500.0),
        ("pole", 1, 4000.0),
    ]
    assert "5,500 EUR" in out
    assert [(item["item"], item["count"], item["price"]) for item in made["running"]] == [
        ("cable", 1, 900.0),
        ("power for 5 years", 1, 300.0),
    ]
    page = (tmp_path / "out" / "report.html").read_text()
    assert "<h1>Elm Street</h1><p>City of Elm &lt;b&gt;" in page
    assert (
        "Beside it, 1,200 EUR: cable and power for 5 years. Not known: data links, permit, traffic"
        in page
    )


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (("--budget", 0), "The budget is 0 sensors"),
        (
            ("--capacity", 50),
            "The links exclude 6 of 6 candidates: the least that any of these sends in 95 % of",
        ),
        (
            ("--max-kbit", 50),
            "The limit of 50 kbit per sensor and frame excludes 6 of 6 candidates",
        ),
        (("--money", 0.5), "the cheapest of all costs the price of 1 ordinary pole"),
        (("--budget", 1, "--min-ap", 1), "The requirement of AP 1 is not met"),
    ],
)
def test_none_can_and_this_is_why(tmp_path, run, asked, said, without_report):
    options = (*PAPER, *asked, "--workers", 1, "--cache", tmp_path, "--out", tmp_path)
    with without_report():
        code, out, err = run("plan", "tjunction", *options)
    assert code == NOT_MET == 1
    assert said in out.splitlines()[0]
    assert "Traceback" not in err
    made = json.loads((tmp_path / "plan.json").read_text())
    assert made["verdict"]["met"] is False
    assert made["verdict"]["reasons"]


def test_poles_that_all_stand_on_the_carriageway(tmp_path, run, poles):
    for feature, place in zip(POLES["features"], ([0.0, 10.0], [0.0, 15.0]), strict=True):
        feature = {**feature, "geometry": {"type": "Point", "coordinates": place}}
        poles.write_text(json.dumps({**POLES, "features": [feature]}))
        code, out, err = run(
            "plan", "tjunction", "--candidates", poles, "--out", tmp_path / "out", "--overwrite"
        )
        assert (code, "There is no candidate" in out) == (1, True)
        assert "left out, since they stand on the carriageway" in err


@pytest.mark.slow
def test_sites_without_traffic_and_damaged_caches_have_plans(tmp_path, run):
    bare = tmp_path / "bare.geojson"
    save_site(replace(load_site("tjunction"), name="bare", network=""), bare)
    code, out, _ = run("plan", bare, "--out", tmp_path / "out")
    assert (code, "has no road network, so there is no traffic" in out) == (1, True)
    common = ("plan", "tjunction", "--budget", 1, *PAPER, "--workers", 1)
    run(*common, "--cache", tmp_path / "cache", "--out", tmp_path / "a")
    size = (tmp_path / "cache" / "cache.sqlite").stat().st_size
    noise = np.random.default_rng(0).integers(0, 256, size // 2, dtype=np.uint8).tobytes()
    (tmp_path / "cache" / "cache.sqlite").write_bytes(noise)
    code, _, _ = run(*common, "--cache", tmp_path / "cache", "--out", tmp_path / "b")
    assert code == 0
    assert (tmp_path / "a" / "plan.json").read_bytes() == (
        tmp_path / "b" / "plan.json"
    ).read_bytes()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--budget", -1), "--budget must be at least 0"),
        (("--frames", 0), "frames must be a whole number of at least 1"),
        (("--min-ap", 2), "min_ap must lie above 0 and up to 1"),
        (
            ("--classes", "cyclist", "--detector", "vehicles/general"),
            "the detector knows vehicle only",
        ),
        *(
            (("--scheme", "middle"), "there is no fusion scheme"),
            (("--iou", 2), "iou must lie in (0, 1]"),
        ),
        *(
            (("--sensors", "none.toml"), "none.toml"),
            (("--keep-out", "none.geojson"), "none.geojson"),
        ),
        (("--candidates", "none.geojson"), "none.geojson"),
        (("--detector", "cluster"), "detector cluster learns from a recording"),
    ],
)
def test_bad_input_is_refused_in_one_line(tmp_path, refused, arguments, said):
    assert said in refused(
        "plan", "tjunction", *arguments, "--out", tmp_path / "out", "--cache", tmp_path / "cache"
    )


def test_what_is_wrong_in_a_catalogue_is_named(tmp_path, refused, catalogue):
    catalogue.write_text(CATALOGUE + "colour = 3\n")
    assert "sensor[0].colour is unknown" in refused(
        "plan", "tjunction", "--sensors", catalogue, "--out", tmp_path
    )


@pytest.mark.slow
def test_a_plan_for_several_classes_says_the_ap_of_each(tmp_path, run):
    arguments = (
        "plan",
        "tjunction",
        "--budget",
        1,
        *PAPER,
        "--cache",
        tmp_path / "cache",
        "--workers",
        1,
    )
    classes = ("--classes", "vehicle", "pedestrian", "--combine", "worst")
    code, out, err = run(*arguments, *classes, "--out", tmp_path / "out")
    assert code == 0, err
    made = json.loads((tmp_path / "out" / "plan.json").read_text(), parse_constant=pytest.fail)
    each = {row["label"]: row for row in made["class_ap"]}
    assert [each[name]["iou"] for name in ("vehicle", "pedestrian")] == [0.7, 0.5]
    assert made["chosen"]["judged"]["ap"] == min(
        row["judged"]["ap"] for row in each.values() if row["weight"]
    )
    assert [row["weight"] for row in made["class_ap"]] == [
        0.5,
        0.5,
        *(0.0 for _ in made["class_ap"][2:]),
    ]
    assert made["chosen"]["judged"]["kind"] == "object"
    assert (made["question"]["classes"], made["question"]["combine"]) == (
        ["vehicle", "pedestrian"],
        "worst",
    )
    assert made["provenance"]["network"] == "tjunction"
    assert made["provenance"]["search_fidelity"] == "surrogate"
    assert [row["label"] for row in made["by_class"]] == [
        "vehicle",
        "cyclist",
        "pedestrian",
        "heavy",
    ]
    for name, row in each.items():
        judged = row["judged"]
        ends = "no interval from fewer than 80 frames"
        digits = 2 if judged["vehicles"] < 100 else 3
        assert f"  {name:<10} AP {judged['ap']:.{digits}f} ({ends}) at IoU" in out
    assert "AP of each class with the chosen set" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.slow
def test_a_plan_goes_by_the_mean_over_thresholds_and_by_what_is_left(tmp_path, run):
    code, out, err = run(
        "plan",
        "tjunction",
        "--budget",
        2,
        *PAPER,
        "--iou",
        "0.8:0.9",
        "--failing",
        1,
        "--failures",
        "mean",
        "--cache",
        "None",
        "--workers",
        1,
        "--out",
        tmp_path / "out",
        "--json",
    )
    assert code == 0, err
    made = json.loads(out)
    assert (made["iou"], made["question"]["failing"], made["question"]["failures"]) == (
        [0.8, 0.85, 0.9],
        1,
        "mean",
    )
    lost = [case["judged"]["ap"] for case in made["failures"]]
    assert made["chosen"]["left"]["ap"] == pytest.approx(np.mean(lost))
    assert "on average when 1 sensor fails" in (tmp_path / "out" / "report.html").read_text()
    code, _, err = run(
        "plan", "tjunction", "--budget", 1, "--failing", 1, *PAPER, "--out", tmp_path / "one"
    )
    assert (code, "nothing is left when 1 fail" in err) == (2, True)
