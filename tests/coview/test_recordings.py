"""The recording a command reads."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import pytest

import coview


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


@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    "command",
    [
        "survey",
        "pack",
        pytest.param("evaluate", marks=pytest.mark.slow),
        pytest.param("table", marks=pytest.mark.slow),
    ],
)
def test_an_object_without_width_is_refused_or_dropped(command, recording, tmp_path):
    damaged = tmp_path / "damaged.hdf5"
    shutil.copy(recording, damaged)
    with h5py.File(damaged, "a") as file:
        file["objects/1"][0, 7] = 0.0
    out = {"pack": "out.packed", "table": "out.npz", "evaluate": "out"}
    options = {"evaluate": ("--schemes", "early"), "table": ("--detector", "cluster")}.get(
        command, ()
    )
    arguments = [
        command,
        damaged,
        *options,
        *(("--out", tmp_path / out[command]) if command in out else ()),
    ]
    code, err = apart(*arguments)
    assert (code, err.count("\n")) == (2, 1), err
    assert "frame 1: objects/1 row 0 has half extents" in err
    assert err.endswith("pass --drop-invalid\n")
    assert sorted(path.name for path in tmp_path.iterdir() if ".detections" not in path.name) == [
        "damaged.hdf5"
    ]
    if command != "table":  # which scores all sets, for a minute
        code, err = apart(*arguments, "--drop-invalid")
        assert code == 0
        assert "1 objects in 1 frames are left out" in err


def apart(*arguments):
    """In a process of its own: the shape checker looks into sequences, and meets the frame that is
    refused there."""
    environment = {
        **os.environ,
        "PYTHONPATH": str(Path(coview.__file__).parents[1]),
        "OMP_NUM_THREADS": "1",
    }
    command = [sys.executable, "-m", "coview", *map(str, arguments)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    return done.returncode, done.stderr
