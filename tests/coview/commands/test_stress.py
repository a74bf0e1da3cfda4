"""coview stress: rows, files and what a recording cannot show."""

import json

import pytest

from examples.studies.stress.noticing import FalseAlarms, Noticed


def test_it_prints_a_table_and_leaves_json_and_svg(recording, tmp_path, run):
    arguments = (
        "stress",
        recording,
        "--frames",
        1,
        "--schemes",
        "foreground",
        "--kinds",
        "bytes",
        "--out",
        tmp_path,
    )
    code, out, _ = run(*arguments)
    assert code == 0
    assert out.splitlines()[0].split()[:4] == ["stress", "level", "scheme", "sent"]
    written = json.loads((tmp_path / "stress.json").read_text())
    assert [(row["scheme"], row["codec"]) for row in written["rows"]] == [
        ("foreground", f"{s} cm") for s in (2, 4, 8)
    ]
    assert written["provenance"]["kinds"] == ["bytes"]
    assert (tmp_path / "stress.svg").stat().st_size > 1000
    assert run(*arguments)[0] == 2
    code, out, _ = run(*arguments, "--overwrite", "--json")
    assert json.loads(out) == json.loads((tmp_path / "stress.json").read_text())


@pytest.mark.slow
def test_levels_several_ious_a_table_and_what_is_kept(recording, tmp_path, run):
    arguments = (
        "stress",
        recording,
        "--frames",
        1,
        "--schemes",
        "early",
        "foreground",
        "--kinds",
        "mounting",
        "--iou",
        "0.5",
        "0.7",
        "--table",
        "tjunction",
        "--cache",
        tmp_path / "kept",
        "--out",
        tmp_path / "out",
        "--overwrite",
    )
    code, out, _ = run(*arguments)
    assert code == 0
    assert "highest AP" in out
    assert "exact  scheme" in out
    assert "fault" not in out  # frames too far apart
    written = json.loads((tmp_path / "out" / "stress.json").read_text())
    assert len(written["rows"]) == 6 * 2 * 2
    assert {each["failing"] for each in written["exact"]} == {1, 2}
    assert "crossings" in written
    assert (tmp_path / "kept" / "cache.sqlite").stat().st_size > 0
    assert run(*arguments)[1] == out


@pytest.fixture
def as_sequence(monkeypatch):
    """Take any recording for a sequence."""
    monkeypatch.setattr("examples.studies.stress.stressing.is_sequence", lambda recording: True)


@pytest.mark.usefixtures("as_sequence")
def test_a_sequence_that_is_too_short_for_faults_is_refused_before_any_work(
    recording, tmp_path, refused
):
    line = refused("stress", recording, "--kinds", "silent", "--frames", 1, "--out", tmp_path / "o")
    assert "no stretch of traffic is 2 s long here: record more frames" in line
    assert "frames under stress" not in line
    assert not (tmp_path / "o").exists()


@pytest.mark.usefixtures("as_sequence")
def test_in_sequences_it_says_how_soon_a_fault_is_noticed(recording, tmp_path, run, monkeypatch):
    found = (
        (Noticed("frozen", "foreground", 6, 6, 0.2, 0.3),),
        (FalseAlarms("nothing wrong", "foreground", 1, 2.0),),
    )
    asked = []

    def time_faults(_recording, _detector, run):
        asked.append(run)
        return found

    monkeypatch.setattr("examples.studies.stress.noticing.time_faults", time_faults)
    monkeypatch.setattr(
        "examples.studies.stress.noticing.check_stretches", lambda recording, run: 0
    )
    common = (
        "stress",
        recording,
        "--frames",
        1,
        "--schemes",
        "late",
        "--seed",
        3,
        "--overwrite",
        "--out",
        tmp_path,
    )
    code, out, _ = run(*common, "--kinds", "frozen")
    assert code == 0
    assert out.splitlines()[-6].split() == [
        "frozen",
        "foreground",
        "6",
        "6",
        "0.2",
        "s",
        "0.3",
        "s",
    ]
    assert out.splitlines()[-3].split() == ["nothing", "wrong", "foreground", "1", "2.0"]
    assert [(asked_run.frames, asked_run.seed) for asked_run in asked] == [(1, 3)]
    assert json.loads((tmp_path / "stress.json").read_text())["false_alarms"][0]["alarms"] == 1
    run(*common, "--kinds", "bytes")
    assert len(asked) == 1  # nobody fails


def test_wrong_arguments(recording, refused, tmp_path):
    for arguments, said in (
        (("--kinds", "storm"), "choose among bytes, pose, mounting, silent"),
        (("--kinds", "delay"), "needs frames at most 0.5 s apart, these are 5 s"),
        *((("--schemes", "middle"), "choose among early"), (("--iou", "1.5"), "--iou")),
        (("--table", "nowhere"), "no table 'nowhere'"),
        (("--table", "tjunction", "--iou", "0.5"), "holds AP at IoU 0.7"),
        (("--frames", "0"), "frames must be a whole number of at least 1"),
        (("--seed", "-1"), "seed must be a whole number of at least 0"),
    ):
        assert said in refused("stress", recording, *arguments, "--out", tmp_path / "out")
        assert not (tmp_path / "out").exists()
