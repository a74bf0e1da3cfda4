"""coview evaluate: rows, files, and whose detector."""

import json
import sys

import pytest

OURS = """
import numpy as np
from toolkit.objects import Detections

def detect(points):
    return Detections(np.array([[0.0, 0, 1, 4, 2, 1.5, 0]]), np.array([0.5])) if len(points) else Detections.empty()

def make(site):
    assert site.name == "tjunction"
    return detect

class Everything:
    def __init__(self, area):
        self.area = area

    def __call__(self, points):
        return detect(points)

def wrong(points):
    return [1, 2, 3]

def broken(points):
    raise IndexError("list index out of range")

thing = 3
"""


@pytest.fixture
def ours(tmp_path, work_in):
    (tmp_path / "our_detectors.py").write_text(OURS)
    work_in(tmp_path)
    yield
    sys.modules.pop("our_detectors", None)


def test_it_prints_rows_and_leaves_table_and_curves(recording, tmp_path, run):
    arguments = (
        "evaluate",
        recording,
        "--schemes",
        "early",
        "late",
        "--sensors",
        "0,2,5",
        "all",
        "--iou",
        0.5,
    )
    code, out, _ = run(*arguments, "--out", tmp_path, "--json")
    rows = json.loads(out)["rows"]
    assert code == 0
    everyone = [0, 1, 2, 3, 4, 5]
    assert [(row["scheme"], row["sensors"], row["label"]) for row in rows] == [
        (scheme, sensors, label)
        for scheme in ("early", "late")
        for sensors in ([0, 2, 5], everyone)
        for label in ("vehicle", "cyclist", "pedestrian", "heavy")
    ]
    assert [each["label"] for each in json.loads(out)["classes"][:4]] == [
        "vehicle",
        "cyclist",
        "pedestrian",
        "heavy",
    ]
    assert (tmp_path / "pr_pedestrian_0.5.png").exists()
    assert {"ap", "recall", "kbit_per_sensor", "ms_per_frame", "iou"} <= set(rows[0])
    assert json.loads((tmp_path / "table.json").read_text())["rows"] == rows
    assert (tmp_path / "pr_0.5.png").stat().st_size > 1000


@pytest.mark.slow
def test_what_is_there_is_replaced_when_told_and_errors_are_written_down(
    recording, tmp_path, run, refused
):
    (tmp_path / "table.json").write_text("of another run")
    arguments = (
        "evaluate",
        recording,
        "--frames",
        1,
        "--schemes",
        "late",
        "--iou",
        0.7,
        "--out",
        tmp_path,
    )
    assert "--overwrite" in refused(*arguments)
    assert (tmp_path / "table.json").read_text() == "of another run"
    assert run(*arguments, "--overwrite")[0] == 0
    kbit = {}
    for errors in ("paper", "poor"):
        given = (
            "--frames",
            1,
            "--schemes",
            "early",
            "--iou",
            0.5,
            "--errors",
            errors,
            "--out",
            tmp_path / errors,
        )
        assert run("evaluate", recording, *given)[0] == 0
        written = json.loads((tmp_path / errors / "table.json").read_text())
        assert written["provenance"]["errors"]["profile"] == errors
        kbit[errors] = written["rows"][0]["kbit_per_sensor"]
    assert abs(kbit["poor"] / kbit["paper"] - 1) > 0.02
    assert "unknown error profile 'bad'" in refused("evaluate", recording, "--errors", "bad")


@pytest.mark.parametrize("name", ["detect", "make", "Everything"])
def test_anybodys_detector(name, ours, recording, tmp_path, run):
    arguments = (
        "--frames",
        1,
        "--schemes",
        "early",
        "--iou",
        0.7,
        "--out",
        tmp_path / "out",
        "--json",
    )
    code, out, err = run("evaluate", recording, "--detector", f"our_detectors:{name}", *arguments)
    assert (code, len(json.loads(out)["rows"])) == (0, 1), err


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("our_detectors:wrong", "must return toolkit.objects.Detections, got list"),
        ("our_detectors:broken", "(IndexError: list index out of range)"),
        *(
            ("our_detectors:thing", "must be callable, got int"),
            ("our_detectors:nothing", "cannot be imported"),
        ),
        *(
            ("no.such.module:detect", "cannot be imported"),
            ("our_detectors:", "named package.module:callable"),
        ),
    ],
)
def test_a_detector_that_is_none(name, message, ours, recording, refused):
    assert message in refused("evaluate", recording, "--detector", name)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        *((("--sensors", "0,9"), "choose among 0..5"), (("--detector", "telepathy"), "telepathy")),
        (("--sensors", "0, 2, 0"), "named once"),
        (("--frames", "0"), "frames must be a whole number of at least 1, got 0"),
        (("--seed", "-1"), "seed must be a whole number of at least 0, got -1"),
        *(
            (("--iou", "1.5"), "--iou must lie above 0 and at most at 1, got 1.5"),
            (("--iou", "70"), "--iou"),
        ),
        (("--radius", "-3"), "--radius must be at least 0"),
        (("--codec", "zip"), "choose among paper, range-images"),
        (("--step", "0.0005"), "step must be a whole number of millimetres"),
        (("--rate", "0"), "--rate must be above 0, got 0"),
        (("--schemes", "middle"), "choose among early, late, hybrid, foreground"),
        (("--schemes", "differences"), "choose among early, late, hybrid, foreground"),
        (("--key-every", "5"), "evaluate has no option --key-every"),
    ],
)
def test_wrong_arguments(arguments, message, recording, refused, tmp_path):
    assert message in refused("evaluate", recording, *arguments, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_missing_recordings_folders_and_unknown_classes_are_refused(recording, refused, tmp_path):
    (tmp_path / "file").write_text("")
    assert "give another path" in refused(
        "evaluate", recording, "--frames", 1, "--out", tmp_path / "file" / "out"
    )
    assert "is what is read" in refused("evaluate", recording, "--frames", 1, "--out", recording)
    assert "nowhere.hdf5" in refused("evaluate", "nowhere.hdf5")
    arguments = (
        "--detector",
        "vehicles/tjunction",
        "--classes",
        "vehicle",
        "cyclist",
        "--out",
        tmp_path / "out",
    )
    assert "the detector knows vehicle only, not cyclist: take one trained" in refused(
        "evaluate", recording, *arguments
    )


def test_bytes_and_what_they_put_on_a_link(recording, tmp_path, run):
    arguments = (
        "evaluate",
        recording,
        "--frames",
        1,
        "--iou",
        0.5,
        "--rate",
        10,
        "--classes",
        "vehicle",
    )
    schemes = ("--schemes", "early", "foreground", "--codec", "range-images", "--step", 0.08)
    code, out, _ = run(*arguments, *schemes, "--out", tmp_path / "a")
    assert code == 0
    assert "on a link at 10 Hz" in out
    assert "802.11p" in out
    written = json.loads((tmp_path / "a" / "table.json").read_text())
    early, foreground = written["loads"]
    assert 0 < foreground["mbit_per_s"] < early["mbit_per_s"]
    assert written["provenance"]["codec"] == "RangeImages(step=0.08)"
    assert "step=0.08" in written["provenance"]["schemes"]["foreground"]
    assert "loads" not in json.loads(
        run(*arguments[:6], "--schemes", "late", "--out", tmp_path / "b", "--json")[1]
    )


@pytest.mark.slow
def test_times_of_stages_are_stated_by_scheme_when_asked_for(ours, recording, tmp_path, run):
    asked = ("evaluate", recording, "--detector", "our_detectors:detect", "--schemes", "early")
    _, said, _ = run(*asked, "--timings", "--out", tmp_path / "a", "--json")
    times = json.loads(said)["schemes"]["early"]["timings"]
    assert list(times) == ["read", "level", "fuse"]
    assert 0 < times["fuse"]["median"] <= times["fuse"]["p95"] <= times["fuse"]["p99"]
    _, text, _ = run(*asked, "--timings", "--out", tmp_path / "b")
    assert "times of early:\nread: " in text
    _, said, _ = run(*asked, "--out", tmp_path / "c", "--json")
    assert "timings" not in json.loads(said)["schemes"]["early"]


def test_classes_restrict_the_rows_and_a_network_has_all_by_default(recording, tmp_path, run):
    arguments = ("evaluate", recording, "--frames", 1, "--schemes", "early", "--out", tmp_path)
    code, out, _ = run(*arguments, "--classes", "pedestrian", "--json")
    assert code == 0
    assert [(row["label"], row["iou"]) for row in json.loads(out)["rows"]] == [
        ("pedestrian", 0.25),
        ("pedestrian", 0.5),
        ("pedestrian", 0.7),
    ]
    code, out, _ = run(*arguments, "--overwrite", "--classes", "vehicle", "pedestrian")
    assert "vehicle, " in out
    assert "above the detector's threshold:" in out
    network = (
        "--detector",
        "tjunction",
        "--frames",
        1,
        "--schemes",
        "early",
        "--iou",
        0.5,
        "--json",
    )
    code, out, err = run("evaluate", recording, *network, "--out", tmp_path / "network")
    assert code == 0, err
    assert [row["label"] for row in json.loads(out)["rows"]] == [
        "vehicle",
        "cyclist",
        "pedestrian",
        "heavy",
    ]
