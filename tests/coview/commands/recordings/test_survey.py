"""coview survey: what a recording holds."""

import json


def test_it_counts_by_class(recording, run):
    code, out, _ = run("survey", recording, "--sensors", 4, "all", "--json")
    figures = json.loads(out)
    assert code == 0
    assert figures["frames"] == 4
    assert figures["unseen"]["4"] >= figures["unseen"]["0,1,2,3,4,5"]
    code, out, _ = run("survey", recording, "--sensors", 4, "all", "--frames", 2)
    assert code == 0
    assert "vehicle from 4: " in out
    assert "without a point, mean " in out
    code, out, _ = run("survey", recording, "--frames", 1, "--classes", "pedestrian", "--json")
    assert list(json.loads(out)["classes"]) == ["pedestrian"]


def test_no_frames(recording, refused):
    assert "--frames must be at least 1" in refused("survey", recording, "--frames", 0)


def test_errors_by_name(recording, run, refused):
    code, out, _ = run("survey", recording, "--errors", "poor", "--json")
    assert code == 0
    assert json.loads(out)["provenance"]["errors"]["profile"] == "poor"
    assert "unknown error profile 'bad': choose among paper" in refused(
        "survey", recording, "--errors", "bad"
    )
