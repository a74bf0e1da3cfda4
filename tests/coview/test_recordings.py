"""The recording a command reads."""

import shutil

import h5py
import pytest


def test_an_unknown_place_asks_for_site(recording, tmp_path, run, refused):
    elsewhere = tmp_path / "elsewhere.hdf5"
    shutil.copy(recording, elsewhere)
    with h5py.File(elsewhere, "a") as file:
        del file["coview/site"]
        for camera in file["cameras"].values():
            camera["extrinsic"][:3, 3] += 1e4
        for objects in file["objects"].values():
            objects[:, :2] += 1e4
    assert "give --site" in refused("survey", elsewhere)
    assert run("survey", elsewhere, "--site", "tjunction")[0] == 0


@pytest.mark.parametrize("command", ["evaluate", "survey", "pack", "table"])
def test_an_object_without_width_is_refused_or_dropped(command, recording, tmp_path, run, refused):
    damaged = tmp_path / "damaged.hdf5"
    shutil.copy(recording, damaged)
    with h5py.File(damaged, "a") as file:
        file["objects/1"][0, 7] = 0.0
    out = {"pack": "out.packed", "table": "out.npz", "evaluate": "out"}
    options = {"evaluate": ("--schemes", "early"), "table": ("--detector", "cluster")}.get(command, ())
    arguments = [command, damaged, *options, *(("--out", tmp_path / out[command]) if command in out else ())]
    assert "frame 1: objects/1 row 0 has half extents" in (line := refused(*arguments))
    assert line.endswith("say --drop-invalid")
    assert sorted(path.name for path in tmp_path.iterdir() if not path.name.endswith(".detections")) == ["damaged.hdf5"]
    if command != "table":  # which keeps nothing of what it dropped, but takes a minute for all sets
        code, _, err = run(*arguments, "--drop-invalid")
        assert code == 0
        assert "1 objects in 1 frames are left out" in err
