"""coview detect: on a frame of a simulated recording as a plain folder of clouds."""

import json

import numpy as np
import pytest

from toolkit.datasets.box_files import read_entries
from toolkit.datasets.recording_views import read
from toolkit.datasets.recordings import write_recording


@pytest.fixture(scope="session")
def clouds(recording, tmp_path_factory):
    """One frame of the recording, as a folder of clouds, its labels beside them."""
    folder = tmp_path_factory.mktemp("clouds")
    write_recording([next(read(recording, "hdf5"))], folder, "folder")
    return folder


def test_cars_are_found_in_a_folder_of_clouds(clouds, tmp_path, run):
    out = tmp_path / "boxes.json"
    area = ("--area", -40, -20, 40, 20)
    code, said, _ = run("detect", clouds, "--level", "plane", *area, "--out", out, "--json")
    assert code == 0
    summary = json.loads(said)
    assert summary["samples"] == 1
    found = read_entries(out)["000000"]["objects"]
    assert len(found) == summary["detections"] > 0
    truth = next(read(clouds, "folder", classes=["vehicle"])).objects.boxes
    places = np.array([[each["x"], each["y"]] for each in found if each["label"] == "vehicle"])
    near = np.linalg.norm(places[:, None] - truth[:, :2], axis=2).min(axis=1) < 1.0
    assert near.mean() > 0.5


def test_times_of_stages_are_stated_when_asked_for(clouds, tmp_path, run):
    asked = ("detect", clouds, "--level", "plane", "--area", -40, -20, 40, 20)
    _, text, _ = run(*asked, "--out", tmp_path / "a.json", "--timings")
    assert [line.split(":")[0] for line in text.splitlines()[1:]] == [
        *("read", "fuse", "level", "detect")
    ]
    _, said, _ = run(*asked, "--out", tmp_path / "b.json", "--timings", "--json")
    summary = json.loads(said)
    assert set(summary["timings"]["detect"]) == {"median", "p95", "p99"}
    assert summary["timings"]["detect"]["median"] == pytest.approx(summary["detect_ms"], abs=0.01)
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    _, said, _ = run(*asked, "--out", tmp_path / "c.json", "--json")
    assert "timings" not in json.loads(said)


def test_shifted_grids_are_asked_for_by_number(clouds, tmp_path, run, refused):
    asked = ("detect", clouds, "--level", "plane", "--area", -40, -20, 40, 20, "--json", "--out")
    names = ("general", "general+phases3", "general+float32+phases3")
    found = [
        json.loads(run(*asked, tmp_path / f"{n}.json", "--detector", n)[1])["detections"]
        for n in names
    ]
    assert min(found[1:]) >= found[0] > 0
    assert "1 to 16 grids, got 0" in refused(
        *asked, tmp_path / "b.json", "--detector", "general+phases0"
    )
    alone = ("evaluate", clouds, "--detector", "cluster+phases2", "--out", tmp_path / "e")
    assert "leave it out" in refused(*alone)


def test_kitti_and_openlabel_text(clouds, tmp_path, run):
    cloud = sorted(clouds.glob("*/000000.pcd"))[0]
    for form in ("kitti", "openlabel"):
        code, said, _ = run(
            "detect", cloud, "--format", form, "--level", "none", "--out", tmp_path / form
        )
        assert code == 0
        assert "detections in 1 clouds" in said
        assert [each.suffix for each in (tmp_path / form).iterdir() if each.suffix] == [
            ".txt" if form == "kitti" else ".json"
        ]
    assert "exists" in run("detect", cloud, "--format", "kitti", "--out", tmp_path / "kitti")[2]


def test_what_detect_refuses(clouds, tmp_path, refused):
    out = tmp_path / "b.json"
    assert "give clouds" in refused("detect", "--out", out)
    assert "check the path" in refused("detect", tmp_path / "none", "--out", out)
    assert "no layout 'kiti'" in refused("detect", clouds, "--layout", "kiti", "--out", out)
    assert "--poses does not go with layout kitti" in refused(
        "detect", clouds, "--layout", "kitti", "--poses", "p.json", "--out", out
    )
    assert "is empty" in refused("detect", clouds, "--area", 1, 1, 0, 0, "--out", out)
    assert "needs a site" in refused("detect", clouds, "--detector", "voxelnet", "--out", out)
    assert "--frames must be at least 1" in refused("detect", clouds, "--frames", 0, "--out", out)
    assert not out.exists()


def test_what_evaluate_refuses(clouds, tmp_path, refused):
    evaluate = ("evaluate", clouds, "--out", tmp_path / "e")
    assert "--site does not go with layout folder" in refused(*evaluate, "--site", "tjunction")
    assert "recorded clouds have errors of their own" in refused(
        *evaluate, "--errors", "poor", "--detector", "general"
    )
    assert "no sensor 'x'" in refused(*evaluate, "--sensors", "x")


def test_evaluate_takes_the_same_folder(clouds, tmp_path, run):
    area = ("--area", -40, -20, 40, 20)
    code, said, _ = run(
        "evaluate", clouds, "--layout", "folder", *area, "--level", "none", "--out", tmp_path / "e"
    )
    assert code == 0
    for protocol in (
        "vehicle, ours",
        "vehicle, KITTI R40",
        "vehicle, nuScenes",
        "20-35 m",
        "5-19 points",
    ):
        assert protocol in said
    table = json.loads((tmp_path / "e/table.json").read_text())
    bev = [
        row["ap"]
        for row in table["breakdown"]
        if (row["label"], row["measure"], row["among"]) == ("vehicle", "BEV 0.5", "all")
    ]
    assert bev[0] > 0.5
