"""`coview adapt`: a recording without labels in, weights out."""

import json

import numpy as np
import pytest

from coview.detectors import load_detector
from models.weight_files import load_weights
from toolkit.datasets.simulation import simulate_dataset
from toolkit.runtime.run import Simulation


def test_what_cannot_be_adapted_to_is_refused(recording, tmp_path, refused):
    assert "40 frames at least to adapt to, got 4" in refused(
        "adapt", recording, "--out", tmp_path / "a"
    )
    assert "no weights named" in refused(
        "adapt", recording, "--start", "nothing", "--out", tmp_path / "a"
    )
    assert "--frames must be at least 40" in refused(
        "adapt", recording, "--frames", "9", "--out", tmp_path / "a"
    )
    assert "--seconds must be at least 1" in refused(
        "adapt", recording, "--seconds", "0", "--out", tmp_path / "a"
    )
    assert not (tmp_path / "a").exists()


@pytest.mark.slow
def test_a_recording_without_labels_makes_weights(tmp_path, run, refused):
    path = tmp_path / "quick.hdf5"
    simulate_dataset("tjunction", path, run=Simulation(frames=40, seed=5), interval=0.5)
    asked = (
        "adapt",
        path,
        "--start",
        "tjunction",
        "--errors",
        "typical",
        "--seconds",
        "5",
        "--out",
        tmp_path / "a",
    )
    code, said, err = run(*asked, "--json")
    assert code == 0, err
    figures = json.loads(said)
    assert 0.5 < figures["before"] <= figures["after"] <= 1
    network, header = load_weights(tmp_path / "a" / "weights.safetensors")
    assert header.site == "tjunction"
    assert network.config.calibration
    assert sorted(each.name for each in (tmp_path / "a").iterdir()) == [
        "log.csv",
        "weights.safetensors",
    ]
    detect = load_detector(tmp_path / "a" / "weights.safetensors")
    assert len(detect(np.zeros((0, 3), np.float32))) == 0
    assert "exists" in refused(*asked)
    (tmp_path / "a" / "checkpoint.pt").write_bytes(b"of a run that was killed")
    code, said, err = run(*asked, "--overwrite", "--json")
    assert code == 0, err
    slow = tmp_path / "slow.hdf5"
    simulate_dataset("tjunction", slow, run=Simulation(frames=40, seed=5))
    assert "at most 1.6 s apart, got 5 to 5 s" in refused("adapt", slow, "--out", tmp_path / "b")


def test_frames_without_times_are_refused_before_any_work(tmp_path, refused):
    rng = np.random.default_rng(0)
    for k in range(40):
        np.save(tmp_path / f"frame{k:02d}.npy", rng.uniform(-20, 20, (200, 3)))
    said = refused("adapt", tmp_path, "--layout", "folder", "--out", tmp_path.with_name("adapted"))
    assert (
        "its frames have no times, by which objects are followed: name the files of each frame "
        "by its time"
    ) in said
