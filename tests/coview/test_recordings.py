"""The recording a command reads."""

import shutil

import h5py


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
