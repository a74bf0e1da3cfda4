"""coview table: every set of sensors."""

import json
from shutil import copyfile

import h5py
import numpy as np
import pytest

from placement_env.fidelity.table import load_table
from placement_env.fidelity.traffic import scored
from toolkit.datasets.dataset import CoopDataset


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


@pytest.fixture
def continuous(recording, tmp_path):
    """The recording of four frames, as if they were 0.1 s apart."""
    path = tmp_path / "continuous.hdf5"
    copyfile(recording, path)
    with h5py.File(path, "r+") as file:
        file["coview/time"][:] = np.arange(4) * 0.1
    return path


def test_in_a_continuous_recording_each_road_user_counts_once(continuous, tmp_path, run, refused):
    arguments = ("--frames", 2, "--detector", "cluster", "--out", tmp_path / "table.npz")
    code, printed, _ = run("table", continuous, *arguments)
    assert code == 0
    first_line = printed.splitlines()[0]
    table = load_table(tmp_path / "table.npz")
    ids = set()
    with CoopDataset(continuous) as recorded:
        for frame in recorded[:2]:
            is_counted = scored(frame.objects, recorded.site)
            ids |= set(frame.objects.ids[is_counted].tolist())
    assert table.origin.objects == len(ids)
    assert first_line == (
        f"continuous recording: each road user counts once, in {table.origin.frames} of 2 frames"
    )
    with h5py.File(continuous, "r+") as file:
        del file["coview/object_start"]
    said = refused("table", continuous, *arguments, "--overwrite")
    assert "frames less than 1 s apart and no ids" in said


def test_a_continuous_recording_without_road_users_is_refused(continuous, tmp_path, refused):
    with h5py.File(continuous, "r+") as file:
        for number in range(4):
            del file[f"objects/{number}"]
            file[f"objects/{number}"] = np.zeros((0, 10))
        del file["coview/object_ids"]
        file["coview/object_ids"] = np.zeros(0, np.int64)
        file["coview/object_start"][:] = 0
    arguments = ("--detector", "cluster", "--out", tmp_path / "table.npz")
    said = refused("table", continuous, *arguments)
    assert "no vehicle is in the area in 4 frames" in said
    assert "increase --frames" in said
