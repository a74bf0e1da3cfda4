"""coview table: every set of sensors."""

import json

import pytest


def test_it_scores_every_set_and_replaces_nothing_untold(recording, tmp_path, run, refused):
    out = tmp_path / "table.npz"
    arguments = ("--frames", 1, "--detector", "cluster")
    code, printed, _ = run("table", recording, "--out", out, *arguments)
    assert code == 0
    assert "early   6 sensors  0,1,2,3,4,5" in printed
    assert out.exists()
    assert "--overwrite" in refused("table", recording, "--out", out, *arguments)
    before = recording.read_bytes()
    assert ".npz" in refused("table", recording, "--out", recording, *arguments, "--overwrite")
    assert recording.read_bytes() == before


def test_errors_by_name(recording, tmp_path, run, refused, fail, spy):
    fail("coview.commands.placement.table", "make_table", ValueError("far enough"))
    calls = spy("coview.commands.placement.table", "make_table")
    arguments = ("--out", tmp_path / "rough.npz", "--frames", 1, "--detector", "cluster")
    assert "far enough" in refused("table", recording, *arguments, "--errors", "poor")
    assert [call.args[0].errors.name for call in calls] == ["poor"]
    assert "unknown error profile 'bad'" in refused(
        "table", recording, *arguments, "--errors", "bad"
    )


@pytest.mark.slow
def test_a_table_of_classes_is_searched(recording, tmp_path, run, refused):
    out, classes = (
        tmp_path / "all.npz",
        ("--classes", "vehicle", "pedestrian", "--combine", "worst"),
    )
    asked = ("table", recording, "--out", out, "--frames", 2, "--detector", "cluster", "--json")
    code, printed, err = run(*asked, *classes)
    assert code == 0, err
    best = json.loads(printed)["early"]["2"][0]
    search = (
        "search",
        "tjunction",
        "--candidates",
        "paper",
        "--fidelity",
        "table",
        "--budget",
        2,
        "--table",
        out,
    )
    code, printed, err = run(*search, *classes, "--method", "exhaustive", "--json")
    assert code == 0, err
    found = json.loads(printed)
    assert found["ap"] == min(found["class_ap"].values()) >= best[1] - 1e-12
    assert "holds vehicle, pedestrian, not cyclist" in refused(
        *search, "--classes", "vehicle", "cyclist"
    )
