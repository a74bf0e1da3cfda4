"""coview search: what it finds, and what it refuses before anything is rendered."""

import json
from dataclasses import replace

import pytest

from placement_env.search.checkpoint import Checkpoint
from placement_env.search.methods import METHODS
from toolkit.sites.files import load_site, save_site

FEW = ("--candidates", "paper", "--budget", 2, "--frames", 2)


def test_it_finds_sensors_verifies_them_and_keeps_what_it_rendered(tmp_path, run):
    arguments = (
        "--candidates",
        "paper",
        "--budget",
        2,
        "--frames",
        2,
        "--cache",
        tmp_path,
        "--method",
        "exhaustive",
    )
    code, out, _ = run("search", "tjunction", *arguments, "--verify", "detector", "--json")
    result = json.loads(out)
    assert code == 0
    assert 1 <= len(result["sensors"]) <= 2
    assert result["certificate"]["kind"] == "optimal"
    assert result["verified"]["fidelity"] == "detector"
    assert (result["provenance"]["site"], result["provenance"]["frames"]) == ("tjunction", 2)
    assert "detector" in result["verified"]["provenance"]
    assert any(tmp_path.rglob("*.sqlite"))


def test_sensors_are_verified_with_the_errors_of_a_profile(tmp_path, run):
    arguments = (
        "--candidates",
        "paper",
        "--budget",
        1,
        "--frames",
        1,
        "--cache",
        tmp_path,
        "--errors",
        "typical",
    )
    code, out, _ = run("search", "tjunction", *arguments, "--verify", "detector", "--json")
    result = json.loads(out)
    assert code == 0
    assert result["provenance"]["errors"]["profile"] == "paper"  # of the surrogate
    assert result["verified"]["provenance"]["errors"]["profile"] == "typical"


@pytest.mark.slow
def test_moved_sensors_are_named_and_verified_where_they_stand(tmp_path, work_in, run):
    pytest.importorskip("cma")
    work_in(tmp_path)
    arguments = (
        "--candidates",
        "paper",
        "--budget",
        2,
        "--frames",
        2,
        "--method",
        "cmaes",
        "--evaluations",
        4,
    )
    code, out, _ = run("search", "tjunction", *arguments, "--verify", "detector", "--json")
    result = json.loads(out, parse_constant=pytest.fail)
    assert code == 0
    assert result["certificate"]["bound"] is None
    assert all("moved to x" in sensor for sensor in result["sensors"])
    assert result["verified"]["fidelity"] == "detector"
    assert any((tmp_path / "out" / "cache").glob("*.sqlite"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--budget", 0), "--budget must be at least 1, got 0"),
        (("--frames", 0), "frames must be a whole number of at least 1, got 0"),
        (("--workers", 0), "workers must be a whole number of at least 1, got 0"),
        *(
            (("--seconds", 0), "--seconds must be above 0"),
            (("--evaluations", -1), "--evaluations must be above 0"),
        ),
        (("--comm", -1), "weights must be finite and not negative, got comm -1.0"),
        (("--iou", 1.5), "iou must lie in (0, 1]"),
        (("--iou", 0.33), "no surrogate of general for early at IoU 0.33"),
        (("--method", "exhaustive"), "at most 16 candidates, got 2363"),
        (("--method", "raced"), "needs fidelity detector, got surrogate"),
        (("--fidelity", "table"), "pass --candidates paper"),
        (("--candidates", "paper", "--model", "telepathy"), "a site's sensors have theirs"),
        (
            ("--fidelity", "table", "--candidates", "paper", "--method", "cpsat"),
            "a table does not know",
        ),
        (
            ("--fidelity", "table", "--candidates", "paper", "--method", "cmaes"),
            "a table does not know",
        ),
        (("--fidelity", "table", "--candidates", "paper", "--iou", 0.33), "got 'early' and 0.33"),
        (
            ("--fidelity", "table", "--candidates", "paper", "--codec", "range-images"),
            "hold kbit of the paper's codec",
        ),
        *(
            (("--codec", "morse"), "unknown codec 'morse'"),
            (("--scheme", "adaptive"), "choose among"),
        ),
        (("--candidates", "nowhere.geojson"), "nowhere.geojson"),
        (
            ("--method", "greedy", "--detector", "general"),
            "--detector is for --fidelity, --verify or --judge detector",
        ),
        (("--verify", "detector", "--detector", "cluster"), "learns from a recording"),
        (("--errors", "bad"), "unknown error profile 'bad'"),
        (("--errors", "paper", "bad"), "unknown error profile 'bad'"),
        (
            ("--errors", "poor", "paper", "poor"),
            "must be different ones, got poor, paper, poor: name each once",
        ),
        (
            ("--method", "greedy", "--errors", "paper", "poor"),
            "--errors is for --fidelity, --verify or --judge",
        ),
        (
            ("--method", "greedy", "--errors", "typical"),
            "--errors is for --fidelity, --verify or --judge detector",
        ),
        (
            ("--judge", "surrogate", "--errors", "typical"),
            "--errors is for --fidelity, --verify or --judge detector",
        ),
        (
            ("--method", "portfolio", "--verify", "detector"),
            "--verify is for one method: portfolio is judged",
        ),
        (
            ("--method", "swap", "--judge", "detector"),
            "--judge is for --method portfolio, got swap",
        ),
        (
            ("--verify", "detector", "--judge", "detector"),
            "--judge is for --method portfolio, got greedy",
        ),
        (
            ("--at-least", 0.9, "--method", "swap"),
            "go with --at-least 0.9, and no other method does",
        ),
        *(
            (("--method", "cheapest"), "go with --at-least 0.9"),
            (("--parts", 2), "go with --at-least 0.9"),
        ),
        (("--iou", "0.9:0.5"), "iou must lie in (0, 1]"),
        (("--iou", "0.33:0.43"), "no surrogate of general for early at IoU 0.33"),
        (
            ("--failing", 1, "--method", "cmaes", "--candidates", "paper", "--frames", 1),
            "method cmaes knows one IoU threshold",
        ),
        (("--curve", "--method", "greedy"), "--curve is for --method portfolio, got greedy"),
        *(
            (("--money", -1), "--money must be at least 0"),
            (("--sensors", "none.toml"), "none.toml"),
        ),
        (("--sensors", "none.toml", "--model", "depth-camera"), "leave one out"),
        (("--sensors", "none.toml", "--candidates", "paper"), "a site's sensors have theirs"),
        (("--confidence", 1), "--confidence must lie between 0 and 1, got 1"),
        (
            ("--method", "portfolio", "--fidelity", "table", "--candidates", "paper"),
            "a table does not know",
        ),
    ],
)
def test_it_refuses_before_anything_is_rendered(arguments, message, refused, tmp_path):
    assert message in refused("search", "tjunction", *arguments, "--cache", tmp_path / "cache")
    assert not (tmp_path / "cache").exists()


def test_numbers_and_caches_that_cannot_be_are_refused(refused, tmp_path, run):
    (tmp_path / "file").write_text("")
    assert "is no folder" in refused("search", "tjunction", "--cache", tmp_path / "file" / "cache")
    asked = (
        "search",
        "tjunction",
        "--candidates",
        "paper",
        "--budget",
        1,
        "--frames",
        1,
        "--fidelity",
        "coverage",
    )
    said = refused(*asked, "--classes", "vehicle", "heavy", "--seed", 1, "--cache", tmp_path)
    assert "there is no heavy to find in these frames: say more --frames" in said
    assert run("search", "tjunction", "--budget", 1.5)[0] == 2


@pytest.mark.parametrize("method", ["cpsat", "cmaes", "ppo"])
def test_a_missing_package_is_named_before_anything_is_rendered(method, without_packages, run):
    without_packages(METHODS[method].needs)
    code, _, err = run("search", "tjunction", "--candidates", "paper", "--method", method)
    assert code == 3
    assert "pip install coview[" in err


@pytest.mark.slow
def test_sensor_models_by_name(run, refused, tmp_path):
    site, two_poles = load_site("tjunction"), tmp_path / "two-poles.json"
    save_site(replace(site, mounts=site.mounts[:2]), two_poles)
    arguments = (
        "--budget",
        1,
        "--frames",
        1,
        "--fidelity",
        "coverage",
        "--cache",
        tmp_path,
        "--json",
    )
    models = ("spinning-lidar", "depth-camera", "solid-state-lidar")
    assert run("search", two_poles, "--model", *models, *arguments)[0] == 0
    assert "telepathy" in refused("search", two_poles, "--model", "telepathy", *arguments)


def test_anybodys_detector(tmp_path, work_in, run, refused):
    work_in(tmp_path)
    code = (
        "from toolkit.objects import Detections\n\ndef nothing(points):\n    return "
        "Detections.empty()\n"
    )
    (tmp_path / "search_detectors.py").write_text(code)
    arguments = ("--candidates", "paper", "--budget", 1, "--frames", 1, "--fidelity", "detector")
    start = ("search", "tjunction", *arguments, "--detector", "search_detectors:nothing")
    assert "needs an attribute digest" in refused(*start)
    code, out, err = run(*start, "--cache", "None", "--json")
    assert (code, json.loads(out)["reward"], json.loads(out)["fidelity"]) == (1, 0.0, "detector"), (
        err
    )


ANSWER = ["plan.geojson", "schedule.csv", "search.json", "site.json", "site.png"]


def test_what_is_handed_over_is_taken_by_simulate(run, refused, tmp_path):
    out = tmp_path / "answer"
    code, printed, _ = run(
        "search", "tjunction", *FEW, "--cache", tmp_path / "c", "--out", out, "--json"
    )
    summary = json.loads(printed)
    assert code == 0
    assert sorted(path.name for path in out.iterdir()) == ANSWER
    assert json.loads((out / "search.json").read_text()) == summary
    names = [sensor.name for sensor in load_site(out / "site.json").sensors]
    assert names == summary["sensors"]
    assert [
        line.split(",")[1] for line in (out / "schedule.csv").read_text().splitlines()[1:]
    ] == names
    assert (
        run(
            "simulate",
            out / "site.json",
            "--frames",
            2,
            "--out",
            tmp_path / "r.hdf5",
            "--workers",
            1,
        )[0]
        == 0
    )
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    assert "search.json exists" in refused(
        "search", "tjunction", *FEW, "--cache", tmp_path / "c", "--out", out
    )
    again = ("--cache", tmp_path / "c", "--out", out, "--overwrite")
    assert run("search", "tjunction", *FEW, *again)[0] == 0
    same = [name for name in ANSWER if name != "search.json"]  # which says how many seconds it took
    assert [(out / name).read_bytes() for name in same] == [before[name] for name in same]
    (out / "search.json").unlink()
    assert "plan.geojson, which this command did not write" in refused(
        "search", "tjunction", *FEW, *again
    )


def test_moved_sensors_are_handed_over_where_they_are_now(run, tmp_path):
    pytest.importorskip("cma")
    arguments = (
        *FEW,
        "--method",
        "cmaes",
        "--evaluations",
        12,
        "--cache",
        tmp_path / "c",
        "--out",
        tmp_path / "o",
    )
    code, printed, _ = run("search", "tjunction", *arguments, "--json")
    assert code == 0
    moved = load_site(tmp_path / "o" / "site.json").sensors
    assert len(moved) == len(json.loads(printed)["sensors"]) == 2
    for sensor, said in zip(moved, json.loads(printed)["sensors"], strict=True):
        x, y, z = sensor.position
        assert f"moved to x {x:.2f} y {y:.2f} z {z:.2f} m" in said


def test_poles_of_ones_own_from_search_to_recording(run, tmp_path):
    poles, out = tmp_path / "poles.geojson", tmp_path / "answer"
    where = {"=cmd()": [-20.0, 24.0], "b": [20.0, 24.0], "c": [-20.0, -6.0]}
    features = [
        {
            "type": "Feature",
            "properties": {"name": n},
            "geometry": {"type": "Point", "coordinates": at},
        }
        for n, at in where.items()
    ]
    poles.write_text(
        json.dumps({"type": "FeatureCollection", "coview_site": 1, "features": features})
    )
    arguments = (
        "--candidates",
        poles,
        "--budget",
        1,
        "--frames",
        1,
        "--fidelity",
        "coverage",
        "--cache",
        "None",
    )
    code, _, err = run("search", "tjunction", *arguments, "--out", out)
    assert code == 0, err
    site, unused = (
        load_site(out / "site.json"),
        json.loads((out / "plan.geojson").read_text())["features"],
    )
    (used,) = {mount.name for mount in site.mounts} - {
        mount.name for mount in load_site("tjunction").mounts
    }
    left = [each["properties"]["name"] for each in unused if each["properties"]["layer"] == "mount"]
    assert sorted([used, *left]) == sorted(where)
    row = (out / "schedule.csv").read_text().splitlines()[1]
    assert row.startswith("'=" if used.startswith("=") else used)


def test_answers_without_sensors_and_small_links_are_one_line(run, tmp_path):
    out = tmp_path / "answer"
    arguments = (*FEW, "--cache", tmp_path / "c", "--out", out)
    code, printed, _ = run("search", "tjunction", *arguments, "--comm", 9)
    assert (code, printed) == (
        1,
        "no sensors: no sensor is worth what it costs: lower --comm and --price\n",
    )
    assert not out.exists()
    code, printed, _ = run("search", "tjunction", *arguments, "--comm", 9, "--json")
    assert (code, json.loads(printed)["sensors"]) == (1, [])
    site = load_site("tjunction")
    poor = tmp_path / "poor.geojson"
    save_site(
        replace(site, mounts=tuple(replace(mount, capacity=50.0) for mount in site.mounts)), poor
    )
    every = ("--method", "exhaustive", "--candidates", "paper", "--frames", 1, "--cache", "None")
    code, printed, _ = run("search", poor, *every)
    assert code == 1
    assert printed.startswith(
        "none may be built: The links exclude 6 of 6 candidates: the least that any of these"
    )
    code, printed, _ = run("search", poor, *every, "--json")
    assert json.loads(printed)["sensors"] == []


def test_it_refuses_other_files_sites_and_projections(refused, tmp_path):
    for name in ANSWER:
        (tmp_path / name).write_text("mine")
        line = refused("search", "tjunction", *FEW, "--out", tmp_path)
        reason = "exists" if name == "search.json" else "which this command did not write"
        assert name in line
        assert reason in line
        assert [path.name for path in tmp_path.iterdir()] == [name]
        (tmp_path / name).unlink()
    save_site(load_site("tjunction"), tmp_path / "site.json")
    line = refused("search", tmp_path / "site.json", *FEW, "--out", tmp_path, "--overwrite")
    assert "site.json is what is read" in line
    pytest.importorskip("pyproj")
    save_site(
        replace(load_site("tjunction"), geo_reference="+lat_0=49 +lon_0=8"), tmp_path / "lost.json"
    )
    line = refused(
        "search", tmp_path / "lost.json", *FEW, "--out", tmp_path / "o", "--cache", tmp_path / "c"
    )
    assert "names no projection that PROJ knows" in line
    assert not (tmp_path / "c").exists()


@pytest.mark.slow
def test_classes_are_weighed(run, tmp_path):
    asked = (
        "search",
        "tjunction",
        "--candidates",
        "paper",
        "--budget",
        2,
        "--frames",
        6,
        "--fidelity",
        "coverage",
    )
    classes = ("--classes", "pedestrian", "vehicle", "--class-weights", 1, 3)
    code, out, _ = run(*asked, *classes, "--cache", tmp_path, "--json")
    assert code == 0
    found = json.loads(out)
    assert found["provenance"]["classes"]["weights"] == [0.75, 0.25]
    assert found["ap"] == pytest.approx(
        0.75 * found["class_ap"]["vehicle"] + 0.25 * found["class_ap"]["pedestrian"]
    )
    code, out, _ = run(*asked, *classes, "--cache", tmp_path, "--method", "cpsat")
    assert code == 0
    assert (
        " of the mean of 0.75 vehicle and 0.25 pedestrian has 1 view(s) of 20 points or more from {"
        in out
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("--classes", "vehicle", "--class-weights", 1, 2),
            "--class-weights needs a weight for each of vehicle,",
        ),
        (
            ("--classes", "vehicle", "heavy", "--class-weights", 1, 0),
            "a weight above 0 for each of",
        ),
        (
            ("--classes", "vehicle", "heavy", "--class-weights", 1, 2, "--combine", "worst"),
            "the worst class takes no",
        ),
        (("--classes", "vehicle", "vehicle"), "classes must be one or several different ones"),
        (("--small-iou", 0), "--small-iou must lie above 0 and at most at 1, got 0"),
        (("--classes", "vehicle", "heavy"), "coview surrogate fits one"),
        (
            (
                "--classes",
                "vehicle",
                "cyclist",
                "--fidelity",
                "detector",
                "--detector",
                "vehicles/general",
            ),
            "knows vehicle only, not cyclist",
        ),
        (("--surrogate", "none.json"), "no surrogate none.json: fit one with coview surrogate"),
        (("--table", "none.npz"), "this file is for fidelity table, got 'surrogate'"),
        (
            ("--fidelity", "table", "--candidates", "paper", "--table", "none.npz"),
            "no table 'none.npz'",
        ),
    ],
)
def test_classes_that_do_not_fit_are_refused(arguments, message, refused, tmp_path):
    assert message in refused("search", "tjunction", "--frames", 2, "--cache", tmp_path, *arguments)


CATALOGUE = """
currency = "EUR"
pole_price = 4000

[[sensor]]
name = "camera"
model = "DepthCamera"
price = 1500

[[sensor]]
name = "lidar"
model = "solid-state-lidar"
price = 9000
"""


def test_mixed_models_with_prices_and_a_sum_of_money(tmp_path, run):
    pytest.importorskip("ortools")
    site, few = load_site("tjunction"), tmp_path / "few.json"
    save_site(replace(site, mounts=site.mounts[:2]), few)
    (tmp_path / "catalogue.toml").write_text(CATALOGUE)
    common = (
        "--sensors",
        tmp_path / "catalogue.toml",
        "--frames",
        2,
        "--fidelity",
        "coverage",
        "--cache",
        tmp_path,
    )
    code, out, _ = run(
        "search", few, *common, "--budget", 1, "--money", 6000, "--method", "greedy", "--json"
    )
    assert code == 0
    found = json.loads(out)
    assert found["price"] == 5500
    assert found["sensors"][0].endswith("_camera")
    code, out, _ = run("search", few, *common, "--budget", 2, "--money", 5000, "--method", "greedy")
    assert (code, "costs 5,500 EUR" in out) == (1, True)


def test_the_cheapest_set_and_the_curve(tmp_path, run):
    pytest.importorskip("ortools")
    few = (
        "--candidates",
        "paper",
        "--budget",
        3,
        "--frames",
        4,
        "--fidelity",
        "coverage",
        "--cache",
        tmp_path,
    )
    code, out, _ = run("search", "tjunction", *few, "--at-least", 0.5, "--json")
    assert code == 0
    found = json.loads(out)
    assert found["ap"] >= 0.5
    assert found["certificate"]["measure"] == "price"
    assert found["certificate"]["bound"] == found["price"]
    code, out, _ = run("search", "tjunction", *few, "--at-least", 1.0, "--failing", 1)
    assert (
        code,
        out.startswith(
            "no sensors: no set within the budget covers 100% of the objects, whichever"
        ),
    ) == (1, True)
    code, out, _ = run("search", "tjunction", *few, "--curve", "--judge", "coverage", "--json")
    assert code == 0
    curve = json.loads(out)["curve"]
    assert [len(row["sensors"]) for row in curve] == [1, 2, 3]
    assert curve[0]["price"] < curve[1]["price"]
    code, out, _ = run("search", "tjunction", *few, "--curve", "--judge", "coverage")
    assert out.splitlines()[1].startswith("  1 for the price of 1 ordinary pole: coverage ")
    code, out, _ = run(
        "search", "tjunction", *few, "--curve", "--judge", "coverage", "--money", 2.5
    )
    first, *rows = out.splitlines()
    assert (code, first[:34]) == (0, "best set for each amount of money,")
    assert [row[:26] for row in rows] == [
        "  1 for the price of 1 ord",
        "  2 for the price of 2 ord",
    ]


@pytest.mark.slow
def test_a_search_that_was_killed_goes_on_with_out(run, refused, tmp_path, monkeypatch):
    swapped = (
        "search",
        "tjunction",
        *FEW,
        "--method",
        "swap",
        "--evaluations",
        320,
        "--fidelity",
        "coverage",
    )
    asked = (*swapped, "--cache", tmp_path / "c")
    states = []

    def killed(checkpoint, state):
        states.append(state)
        if len(states) == 4:
            checkpoint.save(state())
            raise OSError("killed")

    with monkeypatch.context() as patched:
        patched.setattr(Checkpoint, "offer", killed)
        refused(*asked, "--out", tmp_path / "o")
    assert not (tmp_path / "o").exists()
    assert (tmp_path / "o.parts" / "search.state").exists()
    assert "unfinished run made from seed 0 instead of 1" in refused(
        *asked, "--out", tmp_path / "o", "--seed", 1
    )
    assert run(*asked, "--out", tmp_path / "o")[0] == 0
    assert not (tmp_path / "o.parts").exists()
    assert run(*asked, "--out", tmp_path / "whole")[0] == 0
    here, there = (
        json.loads((tmp_path / name / "search.json").read_text()) for name in ("o", "whole")
    )
    assert here.pop("seconds") != there.pop("seconds")
    assert here == there


def test_an_unfinished_search_keeps_what_it_saw_where_there_is_no_cache(run, tmp_path, fail, spy):
    fail("placement_env.search.search_run", "run_search", OSError("killed"))
    calls = spy("placement_env.search.search_run", "run_search")
    assert run("search", "tjunction", *FEW, "--cache", "None", "--out", tmp_path / "o")[0] == 2
    (call,) = calls
    assert call.args[0].run.cache == tmp_path / "o.parts" / "search.cache.state"


@pytest.mark.slow
def test_levels_of_traffic_are_searched_and_judged(run, refused, tmp_path):
    few = (
        "search",
        "tjunction",
        "--candidates",
        "paper",
        "--budget",
        2,
        "--frames",
        8,
        "--fidelity",
        "coverage",
    )
    asked = (*few, "--judge", "coverage", "--cache", tmp_path, "--json")
    worst, mean, one = (
        json.loads(run(*asked, *more)[1])
        for more in (("--levels", 3), ("--levels", 3, "--levels-by", "mean"), ())
    )
    assert worst["ap"] < mean["ap"]
    assert worst["provenance"]["levels"] == {"count": 3, "combine": "worst"}
    assert "levels" not in one["provenance"]
    assert (
        0 < worst["assessment"]["ap"] <= one["assessment"]["ap"] + 0.1
    )  # of another set, on few frames
    assert "known to fidelity coverage and surrogate" in refused(
        *few, "--fidelity", "detector", "--levels", 2
    )
