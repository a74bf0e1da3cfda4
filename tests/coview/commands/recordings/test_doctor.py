"""coview doctor: exit codes."""

import json

from coview.outputs import SUSPECTED


def test_it_has_nothing_to_say_of_a_healthy_recording_and_much_of_a_broken_one(
    recording, tmp_path, run
):
    assert run("doctor", recording, "--json")[:2] == (0, "[]\n")
    broken = tmp_path / "broken.hdf5"
    broken.write_bytes(recording.read_bytes()[:5000])
    code, out, _ = run("doctor", broken)
    assert code == SUSPECTED
    assert out.startswith("error: ")


def test_it_looks_at_recordings_of_clouds(recording, tmp_path, run, refused):
    assert run("doctor", recording, "--layout", "hdf5", "--frames", 1)[:2] == (
        0,
        "nothing suspected\n",
    )
    assert (
        run(
            "convert",
            recording,
            "--layout",
            "hdf5",
            "--to",
            "folder",
            "--frames",
            1,
            "--out",
            tmp_path / "f",
        )[0]
        == 0
    )
    labels = tmp_path / "f" / "labels.json"
    content = json.loads(labels.read_text())
    for each in content["samples"][0]["objects"]:
        each["length"], each["width"] = each["width"], each["length"]
    labels.write_text(json.dumps(content))
    code, said, _ = run("doctor", tmp_path / "f", "--layout", "folder")
    assert code == SUSPECTED
    assert "length and width swapped" in said
    assert "--site does not go with layout folder" in refused(
        "doctor", tmp_path / "f", "--layout", "folder", "--site", "tjunction"
    )


def test_clouds_without_a_label_are_no_healthy_ones(recording, tmp_path, run):
    assert (
        run(
            "convert",
            recording,
            "--layout",
            "hdf5",
            "--to",
            "folder",
            "--frames",
            1,
            "--out",
            tmp_path / "f",
        )[0]
        == 0
    )
    labels = tmp_path / "f" / "labels.json"
    content = json.loads(labels.read_text())
    content["samples"][0]["objects"] = []
    labels.write_text(json.dumps(content))
    said = "1 frames without a label: there is nothing to be checked\n"
    assert run("doctor", tmp_path / "f", "--layout", "folder")[:2] == (0, said)
    assert run("doctor", tmp_path / "f", "--layout", "folder", "--json")[:2] == (0, "[]\n")
