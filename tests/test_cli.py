"""The command line: what users type, what they see, and exit codes."""

import json

import numpy as np
import pytest

import coview
from toolkit.clouds import from_points, save


def run(*arguments, capsys):
    with pytest.raises(SystemExit) as stopped:
        coview.main([str(argument) for argument in arguments])
    printed = capsys.readouterr()
    return stopped.value.code or 0, printed.out, printed.err


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("cli") / "few.hdf5"
    with pytest.raises(SystemExit):
        coview.main(["simulate", "tjunction", "--frames", "4", "--seed", "3", "--out", str(path), "--workers", "1"])
    return path


def test_simulate_says_what_it_made_and_does_nothing_twice(recording, capsys):
    same = ("simulate", "tjunction", "--frames", 4, "--seed", 3, "--out", recording, "--json")
    code, out, _ = run(*same, capsys=capsys)
    assert (code, json.loads(out)["frames_made_now"]) == (0, 0)


def test_evaluate_prints_rows_and_leaves_table_and_curves(recording, tmp_path, capsys):
    arguments = ("evaluate", recording, "--schemes", "early", "late", "--sensors", "0,2,5", "all", "--iou", 0.5)
    code, out, _ = run(*arguments, "--out", tmp_path, "--json", capsys=capsys)
    rows = json.loads(out)["rows"]
    assert code == 0
    assert [(row["scheme"], row["sensors"]) for row in rows] == [
        ("early", [0, 2, 5]), ("early", [0, 1, 2, 3, 4, 5]), ("late", [0, 2, 5]), ("late", [0, 1, 2, 3, 4, 5]),
    ]  # fmt: skip
    assert {"ap", "recall", "kbit_per_sensor", "ms_per_frame", "iou"} <= set(rows[0])
    assert json.loads((tmp_path / "table.json").read_text())["rows"] == rows
    assert (tmp_path / "pr_0.5.png").stat().st_size > 1000


def test_survey_counts(recording, capsys):
    code, out, _ = run("survey", recording, "--sensors", 4, "all", "--json", capsys=capsys)
    figures = json.loads(out)
    assert code == 0
    assert figures["frames"] == 4
    assert figures["unseen"]["4"] >= figures["unseen"]["0,1,2,3,4,5"]


def test_fuse_places_and_crops_clouds(tmp_path, capsys):
    for name in ("a", "b"):
        save(from_points(np.float32([[1.0, 0.0, 1.0], [50.0, 0.0, 1.0]])), tmp_path / f"{name}.ply")
    shifted = np.eye(4)
    shifted[1, 3] = 5.0
    poses = {"a": np.eye(4).tolist(), "b": shifted.tolist()}
    (tmp_path / "poses.json").write_text(json.dumps(poses))
    code, out, _ = run(
        "fuse", tmp_path / "a.ply", tmp_path / "b.ply", "--poses", tmp_path / "poses.json",
        "--area", -10, -10, 10, 10, "--out", tmp_path / "ab.ply", "--json", capsys=capsys,
    )  # fmt: skip
    assert (code, json.loads(out)["points"]) == (0, 2)
    assert (tmp_path / "ab.ply").exists()


def test_site_show(capsys, tmp_path):
    code, out, _ = run("site", "show", "roundabout", "--out", tmp_path / "site.png", capsys=capsys)
    assert code == 0
    assert "96 x 96 m" in out
    assert (tmp_path / "site.png").stat().st_size > 10_000


def test_doctor_has_nothing_to_say_of_a_healthy_recording_and_much_of_a_broken_one(recording, tmp_path, capsys):
    assert run("doctor", recording, "--json", capsys=capsys)[:2] == (0, "[]\n")
    broken = tmp_path / "broken.hdf5"
    broken.write_bytes(recording.read_bytes()[:5000])
    code, out, _ = run("doctor", broken, capsys=capsys)
    assert code == coview.FOUND
    assert out.startswith("error: ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("evaluate", "nowhere.hdf5"), "nowhere.hdf5"),
        (("evaluate", "{recording}", "--sensors", "0,9"), "choose among 0..5"),
        (("evaluate", "{recording}", "--detector", "telepathy"), "telepathy"),
        (("evaluate", "{recording}", "--sensors", "0, 2, 0"), "named once"),
        (("evaluate", "{recording}", "--frames", "0"), "--frames must be at least 1"),
        (("evaluate", "{recording}", "--seed", "-1"), "seed must not be negative"),
        (("survey", "{recording}", "--frames", "0"), "--frames must be at least 1"),
        (("evaluate", "{recording}", "--frames", "1", "--iou", "0.7", "--out", "{recording}"), "give another path"),
        (("simulate", "tjunction", "--frames", "2", "--workers", "0", "--out", "x.hdf5"), "leave it out"),
        (("simulate", "atlantis", "--out", "x.hdf5"), "roundabout, tjunction"),
        (("fuse",), "--poses"),
        (("site", "import", "--centre", "0", "0", "--size", "9", "9", "--out", "x.json"), "--opendrive"),
        (
            (
                "site",
                "import",
                "--opendrive",
                "a.xodr",
                "--lefthand",
                "--centre",
                "0",
                "0",
                "--size",
                "9",
                "9",
                "--out",
                "x.json",
            ),
            "--lefthand is for --osm",
        ),
        (("site", "random", "--seed", "-3", "--out", "x.json"), "from 0 up, got -3"),
    ],
)
def test_bad_input_is_one_line_that_says_what_to_do(arguments, message, recording, capsys):
    code, _, err = run(*(part.format(recording=recording) for part in arguments), capsys=capsys)
    last = err.strip().splitlines()[-1]
    assert code == coview.BAD_INPUT
    assert last.startswith("coview: ")
    assert message in last


def test_search_finds_sensors_verifies_them_and_keeps_what_it_rendered(tmp_path, capsys):
    arguments = ("--candidates", "paper", "--budget", 2, "--frames", 2, "--cache", tmp_path, "--method", "exhaustive")
    code, out, _ = run("search", "tjunction", *arguments, "--verify", "detector", "--json", capsys=capsys)
    found = json.loads(out)
    assert code == 0
    assert 1 <= len(found["sensors"]) <= 2
    assert found["certificate"]["kind"] == "optimal"
    assert found["verified"]["fidelity"] == "detector"
    assert {path.suffix for path in tmp_path.rglob("*.*")} >= {".npz", ".sqlite"}


def test_moved_sensors_are_told_and_verified_where_they_stand(tmp_path, monkeypatch, capsys):
    pytest.importorskip("cma")
    monkeypatch.chdir(tmp_path)
    arguments = ("--candidates", "paper", "--budget", 2, "--frames", 2, "--method", "cmaes", "--evaluations", 4)
    code, out, _ = run("search", "tjunction", *arguments, "--verify", "detector", "--json", capsys=capsys)
    found = json.loads(out, parse_constant=pytest.fail)
    assert code == 0
    assert found["certificate"]["bound"] is None
    assert all("moved to x" in sensor for sensor in found["sensors"])
    assert found["verified"]["fidelity"] == "detector"
    assert (tmp_path / "out" / "cache" / "detected.sqlite").exists()


def test_table_scores_every_set(recording, tmp_path, capsys):
    out = tmp_path / "table.npz"
    arguments = ("--out", out, "--frames", 1, "--detector", "cluster")
    code, printed, _ = run("table", recording, *arguments, capsys=capsys)
    assert code == 0
    assert "early   6 sensors  0,1,2,3,4,5" in printed
    assert out.exists()
